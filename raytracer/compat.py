"""Ray queries with the interface of trimesh, so that a mesh of trimesh asks an `Intersector`.

Stage: query.

    mesh = trimesh.load("part.stl")
    mesh.ray = RayMeshIntersector(mesh, backend="opencl")
    mesh.ray.intersects_location(origins, directions)
    mesh.contains(points)
"""

from __future__ import annotations

from inspect import getattr_static
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raytracer.errors import SceneError
from raytracer.intersector import Intersector
from raytracer.meshes import Mesh
from raytracer.rays import Floats, triples

_SAME = 1e-8
"""Distance of locations that are taken for one, as a part of the mesh's size: trimesh's `tol.merge`."""
_STEEP = 1e-4
"""Least sine of the angle between a ray and a triangle at which the location is that of the plane."""

Ints = NDArray[np.int64]


class RayMeshIntersector:
    """Answers ray queries about a `trimesh.Trimesh` with the methods of trimesh's `ray_triangle.RayMeshIntersector`.

    `backend` and `precision` are those of `Intersector`. The accelerator is built at the first query, and again after
    the mesh has changed. Hits are sorted by ray, then by distance. Locations are computed in f64 from the triangles
    that are hit. Arguments are arrays (N, 3). Raises SceneError, a ValueError, where `Intersector` does, and for
    anything but a mesh.
    """

    def __init__(self, mesh: Any, backend: str | None = None, precision: str = "f32") -> None:
        # trimesh's primitives make this while they are constructed, when their properties cannot be evaluated yet.
        if any(getattr_static(mesh, name, None) is None for name in ("vertices", "faces")):
            raise SceneError(f"a RayMeshIntersector takes a trimesh.Trimesh, not {type(mesh).__name__}")
        self.mesh = mesh
        self._options: dict[str, Any] = {"backend": backend, "precision": precision}
        self._built: tuple[int, Intersector, NDArray[np.float64]] | None = None

    def intersects_id(
        self,
        ray_origins: ArrayLike,
        ray_directions: ArrayLike,
        return_locations: bool = False,
        multiple_hits: bool = True,
        max_hits: int | None = None,
    ) -> tuple[Any, ...]:
        """Find the triangles that rays hit: return `index_tri` (H,) and `index_ray` (H,) int64.

        With `return_locations` also `locations` (H, 3); of hits at the same location only the first is given then.
        `multiple_hits=False` gives the nearest hit of each ray, `max_hits` as many at most.
        """
        shoot, corners = self._current()
        origins, directions = _rows("origins", ray_origins), _rows("directions", ray_directions)
        if multiple_hits:
            every = shoot.all_hits(origins, directions)
            ray, tri, weights = every.ray, every.triangle, (every.u, every.v)
        else:
            first = shoot.intersect(origins, directions)
            ray = np.flatnonzero(first.triangle >= 0)
            tri, weights = first.triangle[ray], (first.u[ray], first.v[ray])
        tri = tri.astype(np.int64)
        kept = np.ones(len(ray), bool)
        if return_locations:
            locations = _locations(corners[tri], origins[ray], directions[ray], weights)
            near = np.abs(np.diff(locations, axis=0)).max(axis=1, initial=0) <= _SAME * _size(corners)
            kept[1:] = ~(near & (ray[1:] == ray[:-1]))
        if max_hits is not None:
            kept &= _ranks(ray, kept) < max_hits
        return (tri[kept], ray[kept], locations[kept]) if return_locations else (tri[kept], ray[kept])

    def intersects_location(
        self, ray_origins: ArrayLike, ray_directions: ArrayLike, **kwargs: Any
    ) -> tuple[NDArray[np.float64], Ints, Ints]:
        """Find the locations (H, 3) where rays hit the mesh; return them, `index_ray` (H,) and `index_tri` (H,).

        `multiple_hits` and `max_hits` are those of `intersects_id`.
        """
        tri, ray, locations = self.intersects_id(ray_origins, ray_directions, return_locations=True, **kwargs)
        return locations, ray, tri

    def intersects_first(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> Ints:
        """Return the first triangle that each ray hits, (N,), -1 for none."""
        rays = _rows("origins", ray_origins), _rows("directions", ray_directions)
        return self._current()[0].intersect(*rays).triangle.astype(np.int64)

    def intersects_any(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> NDArray[np.bool_]:
        """Return True for each ray that hits anything, (N,)."""
        return self._current()[0].occluded(_rows("origins", ray_origins), _rows("directions", ray_directions))

    def contains_points(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Return True for each point (N, 3) inside the mesh, which has to be closed; undefined on its surface.

        trimesh decides, from the numbers of hits of two opposite rays.
        """
        from trimesh.ray.ray_util import contains_points

        return np.asarray(contains_points(self, points))

    def _current(self) -> tuple[Intersector, NDArray[np.float64]]:
        """Return the intersector of the mesh as it is now, and its corners (F, 3, 3)."""
        key = hash(self.mesh)
        if self._built is None or self._built[0] != key:
            mesh = Mesh(np.asarray(self.mesh.vertices), np.asarray(self.mesh.faces))
            self._built = key, Intersector(mesh, **self._options), mesh.corners
        return self._built[1:]

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for copies and pickles, without the kernels."""
        return {**self.__dict__, "_built": None}


def _rows(what: str, values: ArrayLike) -> Floats:
    """Return an array (N, 3); SceneError for other shapes, such as a single ray's."""
    rows = triples(what, values)
    if rows.ndim != 2:
        raise SceneError(f"{what} have the shape (N, 3), not {rows.shape}: give np.reshape({what}, (-1, 3))")
    return rows


def _size(corners: NDArray[np.float64]) -> float:
    """Return the longest side of the box round triangles, 0 for none."""
    return float(np.ptp(corners, axis=(0, 1)).max()) if len(corners) else 0.0


def _locations(corners: NDArray[Any], origins: Any, directions: Any, weights: Any) -> NDArray[np.float64]:
    """Return where rays (H, 3) meet planes of triangles (H, 3, 3); a mean of corners where almost parallel."""
    origins, directions = origins.astype(np.float64), directions.astype(np.float64)
    u, v = (weight.astype(np.float64)[:, None] for weight in weights)
    a, b, c = corners.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    slope = np.einsum("ij,ij->i", normal, directions)
    steep = np.abs(slope) > _STEEP * np.linalg.norm(normal, axis=1) * np.linalg.norm(directions, axis=1)
    t = np.einsum("ij,ij->i", normal, a - origins) / np.where(steep, slope, 1)
    mean = (1 - u - v) * a + u * b + v * c
    return np.asarray(np.where(steep[:, None], origins + t[:, None] * directions, mean))


def _ranks(ray: Ints, kept: NDArray[np.bool_]) -> Ints:
    """Count for each hit the kept hits before it on its ray."""
    before: Ints = np.cumsum(kept) - kept
    return before - before[np.searchsorted(ray, ray)]
