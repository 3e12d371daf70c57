"""Shapes made from formulas: boxes, spheres, tori, a torus knot, cylinders, icosahedra, floors.

Stage: scene description. Each gives a `Mesh` about the origin, y up, outside counter-clockwise; curved ones with the
exact normals of the surface that they approximate. All but the checkerboard have uv coordinates: each face of a box, a
floor and each triangle of an icosahedron is a whole picture; round shapes have u around them and v along them.

>>> len(sphere(rings=8, segments=16)), len(box())
(224, 12)
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import ParamSpec

import numpy as np
from numpy.typing import NDArray

from raytracer.accel.planes import normals_of
from raytracer.appearance.materials import PLAIN, Triple
from raytracer.appearance.metallic_roughness import AnyMaterial
from raytracer.arrays import finite_number, finite_triple, is_whole
from raytracer.errors import SceneError
from raytracer.meshes.mesh import Mesh

Floats = NDArray[np.float64]
Count = int
"""A whole number above 0."""
_MOST = 1 << 31
_Given = ParamSpec("_Given")


def shape(make: Callable[_Given, Mesh]) -> Callable[_Given, Mesh]:
    """Let a function check the numbers that it is given, by their annotations; SceneError for others."""
    kinds = make.__annotations__

    @functools.wraps(make)
    def checked(*args: _Given.args, **named: _Given.kwargs) -> Mesh:
        for name, value in [*zip(kinds, args, strict=False), *named.items()]:
            what, kind = f"a {make.__name__}'s {name}", kinds.get(name)
            if kind == "Count" and not is_whole(value, 1, _MOST):
                raise SceneError(f"{what} is a whole number above 0, not {value!r}")
            if kind == "int" and not is_whole(value, -_MOST, _MOST):
                raise SceneError(f"{what} is a whole number, not {value!r}")
            if kind == "float" or (kind == "Triple" and isinstance(value, float | int | np.number)):
                finite_number(what, value)
            elif kind == "Triple":
                finite_triple(what, value)
        return make(*args, **named)

    return checked


@shape
def box(size: Triple = (1, 1, 1), material: AnyMaterial = PLAIN, *, inward: bool = False) -> Mesh:
    """Make a box of 12 triangles; `inward` turns its faces so that it is a room."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    # Seen from the side that its faces turn to, a picture on each side stands upright.
    normals = normals_of(signs[faces])
    level = normals[:, 1]
    up = np.where(np.abs(level) < 0.5, [[0], [1], [0]], [0 * level, 0 * level, -level]).T
    right = np.cross(up, normals) * (-1 if inward else 1)
    uv = (signs[faces] @ np.stack([right, up], axis=2) + 1) / 2
    if inward:
        faces, uv = faces[:, ::-1], uv[:, ::-1]
    return Mesh(signs * np.asarray(size) / 2, faces, material=material, name="box", uv=uv)


@shape
def floor(size: float = 1.0, material: AnyMaterial = PLAIN) -> Mesh:
    """Make a square of two triangles in the plane y = 0, facing up."""
    s = size / 2
    corners = [[-s, 0, -s], [-s, 0, s], [s, 0, s], [s, 0, -s]]
    uv = [[0, 1], [0, 0], [1, 0], [1, 1]]
    return Mesh(corners, [[0, 1, 2], [0, 2, 3]], material=material, name="floor", uv=uv)


@shape
def checkerboard(size: float, squares: Count, light: Triple, dark: Triple, material: AnyMaterial = PLAIN) -> Mesh:
    """Make a floor of `squares` by `squares` in two colours: 2 * squares**2 triangles."""
    lines = np.linspace(-size / 2, size / 2, squares + 1)
    x, z = (g.reshape(-1) for g in np.meshgrid(lines, lines, indexing="ij"))
    i, j = (g.reshape(-1) for g in np.mgrid[:squares, :squares])
    a = i * (squares + 1) + j
    quads = np.stack([a, a + 1, a + squares + 2, a, a + squares + 2, a + squares + 1], axis=1)
    tone = np.where(((i + j) % 2 == 0)[:, None], light, dark)
    colors = np.repeat(np.repeat(tone, 2, axis=0)[:, None], 3, axis=1)
    vertices = np.stack([x, np.zeros_like(x), z], axis=1)
    return Mesh(vertices, quads.reshape(-1, 3), colors=colors, material=material, name="checkerboard")


@shape
def sphere(radius: float = 1.0, material: AnyMaterial = PLAIN, *, rings: Count = 32, segments: Count = 64) -> Mesh:
    """Make a sphere of `rings` bands, 2 * segments * (rings - 1) triangles."""
    vertices, faces = lattice(rings, segments, closed=False)
    theta, phi = np.pi * vertices[:, 0], 2 * np.pi * vertices[:, 1]
    around = np.where(theta < np.pi, np.sin(theta), 0.0)  # exactly one pole, where sin(pi) is not quite 0
    units = np.stack([around * np.sin(phi), np.cos(theta), around * np.cos(phi)], axis=1)
    poles = (faces < segments).sum(axis=1) > 1
    poles |= (faces >= rings * segments).sum(axis=1) > 1
    uv = unwrapped(np.stack([vertices[:, 1], 1 - vertices[:, 0]], axis=1)[faces], (0,))[~poles]
    return Mesh(units * radius, faces[~poles], units, material=material, name="sphere", uv=uv)


@shape
def torus(
    radius: float = 1.0, tube: float = 0.35, material: AnyMaterial = PLAIN, *, segments: Count = 96, sides: Count = 48
) -> Mesh:
    """Make a ring about the y axis: 2 * segments * sides triangles."""

    def ring(t: Floats) -> Floats:
        return np.stack([radius * np.sin(t), np.zeros_like(t), radius * np.cos(t)], axis=1)

    return _tube(ring, tube, segments, sides, material, "torus")


@shape
def knot(
    p: int = 2, q: int = 3, radius: float = 1.0, tube: float = 0.3, material: AnyMaterial = PLAIN,
    *, segments: Count = 400, sides: Count = 40,
) -> Mesh:  # fmt: skip
    """Make a tube along the (p, q) torus knot: 2 * segments * sides triangles."""

    def curve(t: Floats) -> Floats:
        r = radius * (1 + 0.45 * np.cos(q * t))
        return np.stack([r * np.cos(p * t), r * np.sin(p * t), 0.6 * radius * np.sin(q * t)], axis=1)

    return _tube(curve, tube, segments, sides, material, "knot")


@shape
def cylinder(radius: float = 1.0, height: float = 2.0, material: AnyMaterial = PLAIN, *, segments: Count = 64) -> Mesh:
    """Make a closed cylinder about the y axis: 4 * segments triangles; its caps are flat, its side is smooth."""
    angle = 2 * np.pi * np.arange(segments) / segments
    circle = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    rim = np.insert(radius * circle, 1, 0, axis=1)
    up = np.array([0, height / 2, 0])
    top, bottom = rim + up, rim - up
    vertices = np.concatenate([top, bottom, [up, -up]])
    k = np.arange(segments)
    n = (k + 1) % segments
    upper, lower = np.full(segments, 2 * segments), np.full(segments, 2 * segments + 1)
    sides = [(k, k + segments, n + segments), (k, n + segments, n)]
    faces = np.concatenate([np.stack(f, axis=1) for f in (*sides, (k, n, upper), (n + segments, k + segments, lower))])
    turns = np.tile(k / segments, 2)
    side = np.stack([turns, np.repeat([1.0, 0.0], segments)], axis=1)
    caps = np.concatenate([circle, circle, np.zeros((2, 2))]) / 2 * [1, -1] + 0.5
    uv = np.concatenate([unwrapped(side[faces[: 2 * segments]], (0,)), caps[faces[2 * segments :]]])
    return Mesh(vertices, faces, material=material, name="cylinder", uv=uv).smoothed(60)


@shape
def icosahedron(radius: float = 1.0, material: AnyMaterial = PLAIN) -> Mesh:
    """Make twenty flat triangles."""
    g = (1 + 5**0.5) / 2
    points = [[-1, g, 0], [1, g, 0], [-1, -g, 0], [1, -g, 0], [0, -1, g], [0, 1, g],
              [0, -1, -g], [0, 1, -g], [g, 0, -1], [g, 0, 1], [-g, 0, -1], [-g, 0, 1]]  # fmt: skip
    faces = [[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2], [10, 7, 6],
             [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10],
             [8, 6, 7], [9, 8, 1]]  # fmt: skip
    uv = np.tile([[0.0, 0.0], [1.0, 0.0], [0.5, 1.0]], (20, 1, 1))
    return Mesh(np.array(points) * radius / np.hypot(1, g), faces, material=material, name="icosahedron", uv=uv)


def _tube(
    curve: Callable[[Floats], Floats], tube: float, segments: int, sides: int, material: AnyMaterial, name: str
) -> Mesh:
    """Make a tube of radius `tube` along a closed curve over [0, 2 pi), whose cross sections turn the least."""
    parameters, faces = lattice(segments, sides, closed=True)
    t = 2 * np.pi * np.arange(segments) / segments
    step = 1e-4
    tangent = curve(t + step) - curve(t - step)
    pace = np.linalg.norm(tangent, axis=1, keepdims=True)
    if not pace.all():
        raise SceneError(f"the curve of a {name} has a length above 0: its radius is not 0, and p and q are not both 0")
    tangent /= pace
    frame = np.empty_like(tangent)
    start = np.array([0.0, 1.0, 0.0]) if abs(tangent[0, 1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    for here in range(segments):
        start = start - tangent[here] * (start @ tangent[here])
        start /= np.linalg.norm(start)
        frame[here] = start
    # Carried once round, the frame comes back turned: spread the difference over the whole curve.
    last = start - tangent[0] * (start @ tangent[0])
    twist = np.arctan2(np.cross(frame[0], last) @ tangent[0], frame[0] @ last)
    angle = 2 * np.pi * parameters[:, 1] - twist * parameters[:, 0]
    k = np.rint(parameters[:, 0] * segments).astype(int)
    across = np.cross(tangent, frame)
    normals = np.cos(angle)[:, None] * frame[k] + np.sin(angle)[:, None] * across[k]
    uv = unwrapped(parameters[faces[:, ::-1]], (0, 1))
    return Mesh(curve(t)[k] + tube * normals, faces[:, ::-1], normals, material=material, name=name, uv=uv)


def unwrapped(uv: Floats, axes: Sequence[int]) -> Floats:
    """Return coordinates (F, 3, 2) of corners; a triangle that wraps around along one of the axes ends at 1, not 0."""
    for axis in axes:
        there = uv[..., axis]
        ends = np.ptp(there, axis=1, keepdims=True) > 0.5
        there += ends & (there < 0.5)
    return uv


def lattice(rows: int, columns: int, *, closed: bool) -> tuple[Floats, NDArray[np.int64]]:
    """Return parameters (V, 2) in [0, 1] and two triangles a cell; columns wrap around, rows too where `closed`."""
    count = rows if closed else rows + 1
    i, j = np.mgrid[:count, :columns]
    parameters = np.stack([i.reshape(-1) / rows, j.reshape(-1) / columns], axis=1)
    i, j = np.mgrid[:rows, :columns]
    below, beside = (i + 1) % count, (j + 1) % columns
    a, b = (i * columns + j).reshape(-1), (below * columns + j).reshape(-1)
    c, d = (below * columns + beside).reshape(-1), (i * columns + beside).reshape(-1)
    faces = np.stack([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)], axis=1)
    return parameters, faces.reshape(-1, 3)
