"""Check the rays that a user gives as arrays, and convert them to the coordinates of kernels.

Stage: query. Where f32 holds the numbers, the arrays go to the kernel unchanged: the kernel converts them and reports
invalid rays (`kernels.queries.QueryRay`). Numbers out of the range of f32 are converted here, in f64.

    rays = Rays.of(origins, directions, t_min, t_max)
    inputs = frame.inputs(rays, exact=False)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.bounds import FAR
from raytracer.arrays import numbers
from raytracer.errors import SceneError, users_line
from raytracer.meshes.mesh import affine

Floats = NDArray[np.floating[Any]]
_RIGID = 1e-4
"""The tolerance of a rotation matrix: it admits a matrix that was rounded to f16 or written with four digits."""
_TRIPLES = sh.Attrib3f, sh.Point3f, sh.Vector3f, sh.Normal3f, sh.Color3f, sh.TexCoord3f
_DIRECT = 2.0**-40, 2.0**60
"""Scales with which f32 holds all numbers of the conversion."""
_NEIGHBOURS, _GROUPS = 16, 64
"""Rays of a group of neighbours, and how many groups tell whether rays diverge."""


class Hits(NamedTuple):
    """The nearest hits of rays, each of the rays' shape; t = infinity and triangle = -1 where nothing was met.

    `t` is in lengths of the ray's direction; the point is `(1 - u - v) a + u b + v c` of the triangle's corners. On
    a triangle far larger than the distance, `origin + t * direction` is closer to it.
    """

    t: NDArray[Any]
    triangle: NDArray[np.int32]
    u: NDArray[Any]
    v: NDArray[Any]


class AllHits(NamedTuple):
    """Every hit of N rays, ray by ray and in order of (t, triangle), as flat arrays of H hits.

    Those of ray k, counted in C order of the rays' shape, are at `offsets[k] : offsets[k + 1]`; `offsets` (N + 1,).
    `t`, `triangle`, `u` and `v`, each (H,), are those of `Hits`.
    """

    offsets: NDArray[np.int64]
    t: NDArray[Any]
    triangle: NDArray[np.int32]
    u: NDArray[Any]
    v: NDArray[Any]

    @property
    def ray(self) -> NDArray[np.int64]:
        """The number of each hit's ray, (H,)."""
        return np.repeat(np.arange(len(self.offsets) - 1), np.diff(self.offsets))


class Closest(NamedTuple):
    """The closest `points` (..., 3) of a mesh, their `distances` (...) and `triangles` (...).

    Where there is no triangle: NaN, infinity and -1.
    """

    points: NDArray[np.float64]
    distances: NDArray[np.float64]
    triangles: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Rays:
    """N rays: `eye` and `ray` (N, 3), the range `near` and `limit`, each () or (N,), all f32 or f64.

    `shape` is the one that the user's arrays have, without the last axis.
    """

    shape: tuple[int, ...]
    eye: Floats
    ray: Floats
    near: Floats
    limit: Floats

    @classmethod
    def of(cls, origins: Any, directions: Any, t_min: Any, t_max: Any) -> Rays:
        """Return the rays of arrays (..., 3), with `t_min` and `t_max` as numbers or arrays (...).

        Raises SceneError for other shapes, and for types that are not real numbers.
        """
        eye, ray = triples("origins", origins), triples("directions", directions)
        if eye.shape != ray.shape:
            if eye.ndim == ray.ndim == 2:
                raise SceneError(f"there are {len(eye)} origins but {len(ray)} directions")
            raise SceneError(f"origins have the shape {eye.shape}, but directions {ray.shape}")
        shape = eye.shape[:-1]
        near, limit = (_ends(what, values, shape) for what, values in (("t_min", t_min), ("t_max", t_max)))
        return cls(shape, eye.reshape(-1, 3), ray.reshape(-1, 3), near, limit)

    def __len__(self) -> int:
        return len(self.eye)

    def __getitem__(self, places: NDArray[Any]) -> Rays:
        """Return the rays at these places."""
        near, limit = (end[places] if end.ndim else end for end in (self.near, self.limit))
        return Rays(places.shape, self.eye[places], self.ray[places], near, limit)

    def check(self) -> None:
        """Raise SceneError for NaN, infinite origins and directions, and directions of length zero."""
        for what, array in (("origins", self.eye), ("directions", self.ray)):
            finite = np.isfinite(array).all(axis=1)
            if not finite.all():
                raise SceneError(f"{what} contain NaN or infinity, first in ray {self._first(~finite)}")
        zero = ~self.ray.any(axis=1)
        if zero.any():
            raise SceneError(f"a direction has length zero, first that of ray {self._first(zero)}")
        for what, end in (("t_min", self.near), ("t_max", self.limit)):
            if np.isnan(end).any():
                where = f", first for ray {self._first(np.isnan(end))}" if end.ndim else ""
                raise SceneError(f"{what} contains NaN{where}")

    def _first(self, wrong: Any) -> str:
        """Return the place of the first ray that is wrong, as an index of the user's array."""
        index = np.unravel_index(int(np.argmax(wrong)), self.shape)
        return ", ".join(str(int(k)) for k in index) or "0"


def triples(what: str, values: Any) -> Floats:
    """Return an array (..., 3) of f32 or f64; SceneError for other shapes and for other types than numbers."""
    try:
        array = numbers(what, values)
    except sh.RecordError:
        raise SceneError(
            f"{users_line()}: {what} are values of a program, and this method takes arrays: inside a program call "
            "trace or blocked"
        ) from None
    if array.ndim == 0 or array.shape[-1] != 3:
        raise SceneError(f"{what} have the shape (..., 3), not {array.shape}")
    return array


def _ends(what: str, values: Any, shape: tuple[int, ...]) -> Floats:
    """Return the begin or end of ranges: () or (N,)."""
    end = numbers(what, values)
    if end.shape not in ((), shape):
        raise SceneError(f"{what} is a number or has the shape {shape}, not {end.shape}")
    return end.reshape(-1) if end.ndim else end


def is_stream(*rays: Any) -> bool:
    """Return whether origins or directions are a stream."""
    return any(isinstance(ray, sh.Stream) for ray in rays)


def check_streams(origins: Any, directions: Any, t_min: Any, t_max: Any, backend: str, precision: str) -> Any:
    """Return the place of streams of rays; SceneError unless they fit each other, a backend and a precision.

    `t_min` and `t_max` are numbers, or streams of the same shape.
    """
    for what, ray, kind in (("origins", origins, sh.Point3f), ("directions", directions, sh.Vector3f)):
        if not isinstance(ray, sh.Stream):
            raise SceneError(
                f"one of origins and directions is a Stream, but {what} {'is' if ray is None else 'are'} not: "
                f"sh.Stream({what}, sh.{kind.__name__}, backend={backend!r})"
            )
        if ray.type not in _TRIPLES:
            raise SceneError(f"{what} are a stream of sh.{kind.__name__}, not of {ray.type.__name__}")
    streams = {"origins": origins, "directions": directions, "t_min": t_min, "t_max": t_max}
    for what, ends in list(streams.items())[2:]:
        if not isinstance(ends, sh.Stream):
            if numbers(what, ends).ndim:
                raise SceneError(f"beside streams of rays {what} is a number, or a stream of sh.Attrib1f")
            if np.isnan(ends):
                raise SceneError(f"{what} contains NaN")
            del streams[what]
    for what, stream in streams.items():
        if stream.shape != origins.shape:
            raise SceneError(f"origins have the shape {origins.shape}, but {what} {stream.shape}")
        if (stream.backend, stream.precision) != (backend, precision) or stream.place != origins.place:
            raise SceneError(
                f"{what} lie on {stream.place}, and this Intersector works on {backend} in {precision}: make "
                f"Intersector(..., backend={stream.backend!r}, precision={stream.precision!r}), or the streams there"
            )
    return origins.place


@dataclass(frozen=True, eq=False)
class Pose:
    """The pose of a rigid object: its own point x is at `turn @ x + offset`; `back` is the inverse of `turn`.

    Rays are taken into the object's own coordinates, so that it keeps its accelerator. They keep their t.
    """

    turn: Floats
    back: Floats
    offset: Floats

    @classmethod
    def of(cls, transform: Any) -> Pose:
        """Return the pose of a matrix (4, 4); SceneError unless it moves, rotates, mirrors or scales uniformly."""
        matrix = affine(transform)
        turn = matrix[:3, :3]
        size = float(np.abs(turn).max())
        square = (turn / size).T @ (turn / size) if size else turn
        if not np.allclose(square, np.eye(3) * square[0, 0], rtol=0, atol=_RIGID * square[0, 0]) or not square[0, 0]:
            raise SceneError(
                f"an Intersector is moved by rotations, moves and one scale for all axes, not by {matrix.tolist()}: "
                "make a new one of mesh.transformed(matrix)"
            )
        return cls(turn, np.linalg.inv(turn).astype(np.float64), matrix[:3, 3])

    def from_outside(self, rays: Rays) -> Rays:
        """Return the rays in the object's own coordinates, in f64."""
        with np.errstate(all="ignore"):  # infinity and NaN are refused later
            eye, ray = (rays.eye - self.offset) @ self.back.T, rays.ray @ self.back.T
        return Rays(rays.shape, eye, ray, rays.near, rays.limit)

    def inside(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert places (..., 3) to the object's own coordinates."""
        return np.asarray((places - self.offset) @ self.back.T)

    def outside(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert places (..., 3) from the object's coordinates to the scene's."""
        return np.asarray(places @ self.turn.T + self.offset)


@dataclass(frozen=True, eq=False)
class Frame:
    """A kernel's coordinates: (the user's coordinates - `origin`) * `scale`; `origin` (3,), `scale` a power of two."""

    origin: NDArray[np.float64]
    scale: float
    precision: str

    @property
    def is_direct(self) -> bool:
        """True if a kernel can convert rays by itself."""
        return self.precision == "f32" and _DIRECT[0] <= self.scale <= _DIRECT[1]

    def check_programs(self) -> None:
        """Raise SceneError where a program cannot convert rays of its own, whose numbers are those of binary32."""
        if self.precision == "f16":
            cure = 'Intersector(..., precision="f32")'
            raise SceneError(f"{users_line()}: programs trace scenes in f32 or f64, and this one is in f16: {cure}")
        if not _DIRECT[0] <= self.scale <= _DIRECT[1]:
            raise SceneError(f"{users_line()}: this scene's lengths are out of the range of programs: scale the scene")
        if np.any(self.origin != self.origin.astype(np.float32)):
            raise SceneError(f"{users_line()}: this scene is farther from 0 than binary32 can tell: move it nearer")

    def inputs(self, rays: Rays, exact: bool) -> tuple[Any, ...]:
        """Return the inputs of a kernel: eye, ray, near, limit, origin, scale; all in its coordinates if `exact`."""
        if exact:
            eye, ray, near, limit = self._converted(rays)
            return eye, ray, near, limit, np.zeros(3), 1.0
        eye, origin = rays.eye, self.origin
        if origin.any() and (eye.dtype != np.float32 or np.any(origin != np.float32(origin))):
            with np.errstate(over="ignore"):  # the kernel refuses infinities
                eye = np.subtract(eye, origin, out=np.empty(eye.shape, np.float32), casting="same_kind")
            origin = np.zeros(3)
        return eye, rays.ray, rays.near, rays.limit, origin.astype(np.float32), np.float32(self.scale)

    def _converted(self, rays: Rays) -> tuple[Floats, Floats, Floats, Floats]:
        """Convert rays to the kernel's coordinates on the host, in f64, for numbers that f32 holds only afterwards."""
        exponent = _exponents(rays.ray)
        with np.errstate(over="ignore"):  # an end beyond f64 is clipped
            eye = (rays.eye - self.origin) * self.scale
            ends = (np.ldexp(end.astype(np.float64) * self.scale, exponent) for end in (rays.near, rays.limit))
            near, limit = (np.clip(end, -FAR, FAR) for end in ends)
        return eye, np.ldexp(rays.ray.astype(np.float64), -exponent[:, None]), near, limit

    def distances(self, t: NDArray[Any], triangle: NDArray[Any], rays: Rays) -> NDArray[Any]:
        """Return distances (N,) or (N, K) in lengths of directions, for rays converted here; infinite for no hit."""
        distances = np.full_like(t, np.inf)
        with np.errstate(over="ignore", under="ignore"):
            pace = np.ldexp(self.scale, _exponents(rays.ray)).reshape(-1, *[1] * (t.ndim - 1))
            np.divide(t, pace, out=distances, where=triangle >= 0, casting="same_kind")
        return distances


def _exponents(ray: Floats) -> NDArray[Any]:
    """Return the powers of two that bring the largest component of directions into [1/4, 1/2)."""
    _, exponent = np.frexp(np.abs(ray).max(axis=1, initial=0).astype(np.float64))
    return np.asarray(exponent + 1)


def alike(eye: NDArray[Any], ray: NDArray[Any], low: NDArray[Any], high: NDArray[Any]) -> bool:
    """Return True if neighbouring rays (N, 3) go through much the same parts of a box.

    Judged by some groups of neighbours: at the middle of the box and a little farther on, half of the groups keep
    together to a tenth of the box's size. Packets and single rays are equally fast about there.
    """
    size = float(np.max(high - low))
    first = np.linspace(0, max(len(ray) - _NEIGHBOURS, 0), _GROUPS, dtype=np.int64)
    some = np.minimum(first[:, None] + np.arange(_NEIGHBOURS), len(ray) - 1)
    with np.errstate(all="ignore"):  # NaN is refused elsewhere
        eye, ray = eye[some].astype(np.float64), ray[some].astype(np.float64)
        ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
        along = np.sum(((low + high) / 2 - eye) * ray, axis=-1, keepdims=True)
        middle = eye + np.maximum(along, 0) * ray
        apart = [np.ptp(points, axis=1).max(axis=-1) for points in (middle, middle + size / 2 * ray)]
        return bool(np.median(np.maximum(*apart)) < size / 10)
