"""Scenes and rays made up at random, and what of a hit can be known: an oracle in binary64 with bounds of its doubt.

A `Sketch` is what hypothesis draws and shrinks: a few parts, each of a kind, a size and a place. Sizes go from 1e-6 to
1e12 in one scene; the whole may be scaled and moved once more.
"""

from typing import NamedTuple

import numpy as np
from hypothesis import strategies as st

UNIT = 2.0**-24
"""The largest relative error of one rounding in f32."""
F64 = 2.0**-53
"""The same in f64."""
ACROSS = 16 * UNIT
"""The margin across a ray in which an edge is in doubt, relative to a corner's largest coordinate."""


class Part(NamedTuple):
    """Some triangles of about `size`, at a place that is `away` times that size from 0."""

    kind: str
    size: float
    away: float
    seed: int


class Sketch(NamedTuple):
    """The parts of a scene; then all is scaled by `scale` and moved by `offset` times its own size."""

    parts: tuple[Part, ...]
    scale: float
    offset: float
    seed: int

    def corners(self):
        """The triangles, (N, 3, 3)."""
        corners = np.concatenate([KINDS[p.kind](np.random.default_rng(p.seed)) * p.size + place(p) for p in self.parts])
        direction = np.random.default_rng(self.seed).normal(size=3)
        return (corners + self.offset * np.abs(corners).max() * direction) * self.scale


def place(part):
    return part.away * part.size * np.random.default_rng(part.seed + 1).normal(size=3)


def soup(rng):
    return rng.normal(size=(12, 3, 3))


def fan(rng):
    """Thin triangles about one corner."""
    angle = np.linspace(0, 2 * np.pi, 17)
    rim = np.stack([np.cos(angle), np.sin(angle), rng.normal() * np.ones(17)], axis=1) @ turn(rng)
    return np.stack([np.zeros((16, 3)), rim[:-1], rim[1:]], axis=1)


def ball(rng):
    """A closed body."""
    g = (1 + 5**0.5) / 2
    points = np.array([[0, s, t * g] for s in (-1, 1) for t in (-1, 1)])
    points = np.concatenate([np.roll(points, k, axis=1) for k in range(3)]) @ turn(rng)
    near = np.linalg.norm(points[:, None] - points, axis=2) < 2.1
    faces = [
        (i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i, j] and near[j, k] and near[i, k]
    ]
    return points[np.array(faces)]


def slab(rng):
    """A square of two triangles, across an axis or tilted."""
    s = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]], float)
    s = s @ turn(rng) if rng.random() < 0.5 else np.roll(s, rng.integers(3), axis=1)
    return s[[[0, 1, 2], [0, 2, 3]]]


def slivers(rng):
    a, along, across = rng.normal(size=(3, 8, 3))
    thin = 10 ** rng.uniform(-7, -1, (8, 1))
    return np.stack([a, a + along, a + along * rng.random((8, 1)) + thin * across], axis=1)


def degenerate(rng):
    """Points, lines, the same triangle twice, and one good one."""
    good, point, line = rng.normal(size=(3, 2, 3, 3))
    point[:, 1:] = point[:, :1]
    line[:, 1:] = line[:, :1] + np.array([1.0, 2.0])[:, None] * (line[:, 1:2] - line[:, :1])
    return np.concatenate([good, point, line, good[:1], np.roll(good[:1], 1, axis=1)])


KINDS = {f.__name__: f for f in (soup, fan, ball, slab, slivers, degenerate)}


def turn(rng):
    return np.linalg.qr(rng.normal(size=(3, 3)))[0]


def sketches():
    """The strategy of sketches."""
    seeds = st.integers(0, 2**20)
    sizes = st.integers(-6, 12).map(lambda e: 10.0**e)
    away = st.sampled_from([0.0, 0.0, 1.0, 100.0])
    parts = st.lists(st.builds(Part, st.sampled_from(sorted(KINDS)), sizes, away, seeds), min_size=1, max_size=4)
    scales = st.sampled_from([1.0, 1.0, 1.0, 1e-18, 1e-12, 1e-6, 1e6, 1e12, 1e18])
    every = st.builds(Sketch, parts.map(tuple), scales, st.sampled_from([0.0, 0.0, 0.0, 1e3, 1e6]), seeds)
    return every.filter(lambda sketch: np.abs(sketch.corners()).max() <= 1e36)  # farther off, a mesh is refused


def rays(sketch, corners, count):
    """Rays (count, 3) twice, at triangles of all parts: from near and far, inside and outside, along axes, at edges."""
    rng = np.random.default_rng(sketch.seed)
    triangle = corners[rng.integers(0, len(corners), count)]
    weights = rng.dirichlet([1, 1, 1], count)
    weights[::5] = np.eye(3)[rng.integers(0, 3, len(weights[::5]))]
    weights[1::5, 0] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    target = (weights[:, :, None] * triangle).sum(axis=1)
    own = np.ptp(triangle, axis=1).max(axis=1, keepdims=True)
    every = np.ptp(corners, axis=(0, 1)).max()
    size = np.where(rng.random((count, 1)) < 0.6, own * 10 ** rng.uniform(-1, 3, (count, 1)), every)
    away = rng.normal(size=(count, 3))
    away[2::7] *= np.eye(3)[rng.integers(0, 3, len(away[2::7]))]
    origin = target + away * np.where(size > 0, size, every)
    beside = np.where(rng.random((count, 1)) < 0.3, own * 10 ** rng.uniform(-1, 1, (count, 1)), 0)
    direction = target + beside * rng.normal(size=(count, 3)) - origin
    direction[2::7] = -away[2::7]
    bad = ~direction.any(axis=1)
    direction[bad] = 1
    return origin, direction


class Known(NamedTuple):
    """Facts about rays (R,) and triangles (N,): each has shape (R, N).

    `sure` and `never`: met, or not, beyond doubt; `t` the distance and `doubt` how far an answer in f32 may be off.
    """

    sure: np.ndarray
    never: np.ndarray
    t: np.ndarray
    doubt: np.ndarray


@np.errstate(all="ignore")
def known(corners, eye, ray):
    """All rays against all triangles in binary64, with inputs that are binary32."""
    rows = np.arange(len(ray))[:, None, None]
    z = np.argmax(np.abs(ray), axis=1)[:, None, None]
    p = corners[None] - eye[:, None, None]  # (R, N, 3, 3)
    parts = [
        np.take_along_axis(p, np.broadcast_to((z[..., None] + k) % 3, (*p.shape[:3], 1)), 3)[..., 0] for k in (1, 2, 0)
    ]
    slope = [(ray[rows, (z + k) % 3] / ray[rows, z]) for k in (1, 2)]
    x, y = (part - s * parts[2] for part, s in zip(parts[:2], slope, strict=True))
    scale = np.abs(p).max(axis=(2, 3))
    i, j = [1, 2, 0], [2, 0, 1]
    w = x[..., i] * y[..., j] - y[..., i] * x[..., j]
    length = np.hypot(x[..., i] - x[..., j], y[..., i] - y[..., j])
    clear = np.nan_to_num(np.abs(w) / length, nan=0.0).min(axis=2) / scale
    whole = w.sum(axis=2)
    inside = (whole != 0) & ((w >= 0).all(axis=2) | (w <= 0).all(axis=2))
    outside = clear_outside(x, y, scale)
    along = parts[2] / ray[rows, z]
    # A triangle that is seen as a line, but for rounding, has no such mean: a hit lies between its corners.
    t = np.where(whole == 0, along.mean(axis=2), (w / whole[..., None] * along).sum(axis=2))
    t = np.clip(t, along.min(axis=2), along.max(axis=2))
    spread = np.ptp(along, axis=2)
    reach = np.maximum(np.abs(x), np.abs(y)).max(axis=2)
    of_mean = 64 * UNIT * scale * (reach * spread / np.abs(whole) + 1)
    # Of a sliver, or one seen edge-on, no more is known than that the hit is in its box.
    full = np.abs(whole) > 1e-3 * reach**2
    doubt = np.where(full, np.minimum(of_mean, of_plane(corners, eye, ray, t)), of_mean)
    doubt = doubt + of_mean * (F64 / UNIT)  # the mean in f64 is rounded too
    doubt = np.minimum(np.where(np.isfinite(doubt), doubt, np.inf), spread + 64 * UNIT * scale + 2.0**-11 * np.abs(t))
    sure = inside & (clear > ACROSS)
    return Known(sure, outside, np.nan_to_num(t, nan=0.0, posinf=0.0, neginf=0.0), doubt)


def clear_outside(x, y, scale):
    """Return whether all of a triangle, seen at (x, y), lies beside the ray: farther from it than is in doubt."""
    least = np.full(x.shape[:2], np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        ex, ey = x[..., j] - x[..., i], y[..., j] - y[..., i]
        square = ex * ex + ey * ey
        s = np.clip(np.where(square > 0, -(x[..., i] * ex + y[..., i] * ey) / square, 0), 0, 1)
        least = np.minimum(least, np.hypot(x[..., i] + s * ex, y[..., i] + s * ey))
    w = [x[..., i] * y[..., j] - y[..., i] * x[..., j] for i, j in ((1, 2), (2, 0), (0, 1))]
    around = np.logical_and.reduce([v > 0 for v in w]) | np.logical_and.reduce([v < 0 for v in w])
    return ~around & (least > ACROSS * scale)


def of_plane(corners, eye, ray, t):
    """The doubt of a distance that is taken from the plane: in f32 it does not know the triangle's size.

    The level of the plane is computed in f64 before it is rounded. There an edge scaled to 1 has 2 roundings, so the
    cross product of both errs by 6 * 2**0.5 of the product of their lengths, the unit normal by 3 roundings more, and
    its product with a corner, no longer than 3**0.5 times its largest coordinate, by 3 * 3**0.5: all less than 32.
    """
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one / np.abs(one).max(), other / np.abs(other).max())
    area = np.linalg.norm(normal, axis=1)
    sides = [np.linalg.norm(edge, axis=1) / np.abs(edge).max(axis=1) for edge in (one, other)]
    of_level = 32 * F64 * np.abs(corners).max(axis=(1, 2)) * (sides[0] * sides[1] / area)
    normal /= area[:, None]
    level = np.abs(np.einsum("ni,ni->n", normal, corners[:, 0]))
    slope = np.abs(ray @ normal.T)
    size = level + np.abs(eye) @ np.abs(normal).T + np.abs(t) * (np.abs(ray) @ np.abs(normal).T)
    return (1024 * UNIT * size + of_level) / slope
