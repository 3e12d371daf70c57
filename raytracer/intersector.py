"""Rays given as arrays against the triangles of a mesh or scene: what is hit, or whether anything is.

Stage: query. The same walk as the pictures', without their shading.

    hits = Intersector(mesh, backend="opencl").intersect(origins, directions)
    hits.t, hits.triangle, hits.u, hits.v
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import shpy as sh
from raytracer.accel.bvh import Bvh
from raytracer.accel.choice import build, check
from raytracer.errors import SceneError
from raytracer.kernels.triangle import FAR
from raytracer.kernels.walk import Walk, walk_through
from raytracer.kernels.wide_walk import WideIntersector
from raytracer.layout import origin_of, rounded, scale_of, triangle_rows
from raytracer.meshes import Mesh
from raytracer.scene import Scene

Floats = NDArray[np.float64]
_NEIGHBOURS, _GROUPS = 16, 64


class Hits(NamedTuple):
    """What N rays met: each (N,); t = infinity and triangle = -1 where nothing was met.

    `t` is in lengths of the ray's direction; the point is `(1 - u - v) a + u b + v c` of the triangle's corners. On
    a triangle far larger than the distance, `origin + t * direction` is closer to it.
    """

    t: NDArray[Any]
    triangle: NDArray[np.int32]
    u: NDArray[Any]
    v: NDArray[Any]


class _Nearest(NamedTuple):
    t: sh.Attrib1f
    triangle: sh.Attrib1i
    uv: sh.TexCoord2f


class Intersector:
    """Finds hits with the triangles of a mesh, or of all meshes of a scene one after the other.

    `accel` is "bvh", "grid" or "brute", which differ in time alone; `backend` one of `sh.backends()`, None for the
    default. Raises SceneError for what is neither mesh nor scene, and for another accelerator.

    On OpenCL rays that have little in common with their neighbours in the arrays walk through the hierarchy one by one,
    others together; which it is to be is seen from a few of them. The hits are the same.
    """

    def __init__(
        self, mesh_or_scene: Mesh | Scene, accel: str = "bvh", backend: str | None = None, precision: str = "f32"
    ) -> None:
        check(accel)
        if not isinstance(mesh_or_scene, Mesh | Scene):
            raise SceneError(f"an Intersector takes a Mesh or a Scene, not {type(mesh_or_scene).__name__}")
        meshes = mesh_or_scene.meshes if isinstance(mesh_or_scene, Scene) else (mesh_or_scene,)
        meshes = [mesh for mesh in meshes if len(mesh)]
        self._options: dict[str, Any] = {"backend": backend, "precision": precision, "loop_limit": None}
        self._walk: Walk | None = None
        self._alone: Callable[[], Walk] | None = None
        self._origin, self._scale = np.zeros(3), 1.0
        self._kernels: dict[tuple[str, bool], Any] = {}
        if meshes:
            corners = np.concatenate([mesh.corners for mesh in meshes])
            self._origin = origin_of(corners)
            corners -= self._origin
            self._scale = scale_of(corners, precision)
            self._corners = rounded(corners * self._scale, precision)
            structure, rows = build(accel, self._corners, precision), triangle_rows(self._corners)
            target = backend or sh.default_backend()
            self._walk = walk_through(structure, rows, target)
            if isinstance(structure, Bvh) and precision == "f32":
                self._box = structure.low[0], structure.high[0]
                self._wide = partial(WideIntersector, structure, rows)
                self._alone = self._wide if target == "opencl" else None

    def intersect(
        self, origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike = 0.0, t_max: ArrayLike = np.inf
    ) -> Hits:
        """The nearest hit of each ray with t in [t_min, t_max).

        `origins` and `directions` (N, 3), `t_min` and `t_max` numbers or (N,). Raises SceneError for wrong shapes,
        NaN, infinite origins or directions, and directions of length zero.
        """
        eye, ray, near, limit, length = _checked(origins, directions, t_min, t_max)
        if self._walk is None or not len(eye):
            n = len(eye)
            return Hits(np.full(n, np.inf, np.float32), np.full(n, -1, np.int32), *np.zeros((2, n), np.float32))
        return self._hits(self._run("intersect", eye, ray, near, limit), length)

    def occluded(
        self, origins: ArrayLike, directions: ArrayLike, t_max: ArrayLike = np.inf, t_min: ArrayLike = 0.0
    ) -> NDArray[np.bool_]:
        """Whether anything is hit with t in [t_min, t_max), (N,); arguments and errors as in `intersect`."""
        eye, ray, near, limit, _ = _checked(origins, directions, t_min, t_max)
        if self._walk is None or not len(eye):
            return np.zeros(len(eye), dtype=bool)
        return np.asarray(self._run("occluded", eye, ray, near, limit))

    def _run(self, name: str, eye: Floats, ray: Floats, near: Floats, limit: Floats) -> Any:
        """What the kernel of this name says of these rays."""
        eye, near, limit = self._moved(eye, near, limit)
        return self._kernel(name, eye, ray, near)(eye, ray, near, limit)

    def _moved(self, eye: Floats, near: Floats, limit: Floats) -> tuple[Floats, Floats, Floats]:
        """Origins and ranges of rays in the kernels' coordinates."""
        if self._origin.any():
            eye = eye - self._origin
        if self._scale != 1:
            with np.errstate(over="ignore"):  # a range's end that leaves f64 is clipped
                eye, near, limit = eye * self._scale, *(np.clip(end * self._scale, -FAR, FAR) for end in (near, limit))
        return eye, near, limit

    def _hits(self, found: Any, length: Floats) -> Hits:
        """The outputs of a kernel; distances are in lengths of the directions."""
        t, triangle, uv = found
        distance = np.full_like(t, np.inf)
        np.divide(t, length * self._scale, out=distance, where=triangle >= 0, casting="same_kind")
        return Hits(distance, triangle, uv[:, 0], uv[:, 1])

    def _kernel(self, name: str, eye: Floats, ray: Floats, near: Floats) -> Any:
        """The kernel for these rays."""
        assert self._walk is not None
        alone = self._alone is not None and bool(np.all(near >= 0)) and not alike(eye, ray, *self._box)
        if (name, alone) not in self._kernels:
            walk = self._alone() if alone and self._alone is not None else self._walk
            program = {"intersect": _intersect, "occluded": _occluded}[name](walk)
            lanes: dict[str, Any] = {"lanes": 1} if alone else {}
            self._kernels[name, alone] = program.compile(**self._options, **lanes)
        return self._kernels[name, alone]


def alike(eye: Floats, ray: Floats, low: NDArray[Any], high: NDArray[Any]) -> bool:
    """Whether neighbouring rays (N, 3) go through much the same parts of a box.

    Judged by some groups of neighbours: at the middle of the box and a little farther on, half of the groups keep
    together to a tenth of the box's size. Packets and single rays are equally fast about there.
    """
    size = float(np.max(high - low))
    first = np.linspace(0, max(len(ray) - _NEIGHBOURS, 0), _GROUPS, dtype=np.int64)
    some = np.minimum(first[:, None] + np.arange(_NEIGHBOURS), len(ray) - 1)
    eye, ray = eye[some], ray[some]
    along = np.sum(((low + high) / 2 - eye) * ray, axis=-1, keepdims=True)
    middle = eye + np.maximum(along, 0) * ray
    apart = [np.ptp(points, axis=1).max(axis=-1) for points in (middle, middle + size / 2 * ray)]
    return bool(np.median(np.maximum(*apart)) < size / 10)


def _intersect(walk: Walk) -> Any:
    @sh.program
    def intersect(eye: sh.Point3f, ray: sh.Vector3f, near: sh.Attrib1f, limit: sh.Attrib1f) -> _Nearest:
        hit = walk(ray, eye, near, limit, False)
        return _Nearest(hit.l, hit.id, hit.uv)

    return intersect


def _occluded(walk: Walk) -> Any:
    @sh.program
    def occluded(eye: sh.Point3f, ray: sh.Vector3f, near: sh.Attrib1f, limit: sh.Attrib1f) -> sh.Attrib1b:
        hit = walk(ray, eye, near, limit, True)
        found = sh.Attrib1b(hit.id >= 0)
        return found

    return occluded


def _checked(origins: Any, directions: Any, t_min: Any, t_max: Any) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Origins, unit directions, and the range in units of those; with the lengths that the directions had."""
    eye, ray = (np.asarray(a, dtype=np.float64) for a in (origins, directions))
    for what, array in (("origins", eye), ("directions", ray)):
        if array.ndim != 2 or array.shape[1] != 3:
            raise SceneError(f"{what} have the shape (N, 3), not {array.shape}")
        if not np.isfinite(array.sum()) and not np.all(np.isfinite(array)):
            raise SceneError(f"{what} contain NaN or infinity, first in ray {_first(~np.isfinite(array).all(axis=1))}")
    if len(eye) != len(ray):
        raise SceneError(f"there are {len(eye)} origins but {len(ray)} directions")
    ray, length = _unit(ray)
    ends = []
    for what, values in (("t_min", t_min), ("t_max", t_max)):
        end = np.asarray(values, dtype=np.float64)
        if end.shape not in ((), eye.shape[:1]):
            raise SceneError(f"{what} is a number or has the shape ({len(eye)},), not {end.shape}")
        if np.any(np.isnan(end)):
            raise SceneError(f"{what} contains NaN")
        ends.append(np.clip(end * length, -FAR, FAR) if np.any(end) else np.zeros(len(eye)))
    return eye, ray, ends[0], ends[1], length


def _unit(ray: Floats) -> tuple[Floats, Floats]:
    """Directions of unit length, and the lengths that they had."""
    square = np.einsum("ij,ij->i", ray, ray)
    if len(ray) and 1e-200 < square.min() and square.max() < 1e200:
        length = np.sqrt(square)
        return ray / length[:, None], length
    largest = np.abs(ray).max(axis=1, initial=0)
    if np.any(largest == 0):
        raise SceneError(f"a direction has length zero, first that of ray {_first(largest == 0)}")
    scaled = ray / largest[:, None]
    short = np.linalg.norm(scaled, axis=1)
    return scaled / short[:, None], short * largest


def _first(wrong: Any) -> int:
    return int(np.flatnonzero(wrong)[0])
