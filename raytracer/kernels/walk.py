"""The walk through an accelerator, whichever it is.

Stage: kernel. Takes what `accel.choice.build` gives; gives a `Walk`, which a kernel calls with a ray for its `Hit`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from raytracer.accel.bvh import Bvh
from raytracer.accel.grid import Grid
from raytracer.kernels.bvh_walk import BvhIntersector
from raytracer.kernels.intersector import GridIntersector
from raytracer.kernels.layered_walk import LayeredIntersector
from raytracer.kernels.triangle import Accept, AheadBound, Hit, Triangles
from raytracer.kernels.wide_walk import WideIntersector
from raytracer.layered.cube import LayeredCube
from raytracer.layout import Layout
from shpy import SH_ELSE, SH_IF

Structure = Grid | Bvh | LayeredCube

TOGETHER = frozenset({"opencl"})
"""Where rays that run side by side are few enough to share their way: packets of up to 16, not numpy's tiles."""
MANY = 6000
"""Triangles from which on scattered rays walk faster alone; measured: it is between 2,400 and 10,000."""


class Walk(Protocol):
    """The walk that finds a ray's hit among `triangles`, at points that pass the filter `accept`."""

    triangles: Triangles
    accept: Accept | None

    def __call__(self, ray: Any, eye: Any, near: Any, limit: Any, any_hit: Any) -> Hit:
        """The nearest hit at a distance in [near, limit); where `any_hit` holds, the first that is found."""
        ...

    def collect(self, hit: Any, ray: Any, eye: Any, near: Any, begin: Any, any_hit: Any) -> None:
        """Offer to `hit` each triangle that is met at a distance in [near, hit.l), boxes from `begin` on."""
        ...


@dataclass
class SplitWalk:
    """Two walks through the same triangles: an exact one for eye rays, and one for the rays that come of them."""

    exact: Walk
    secondary: Walk
    accept: Accept | None = None

    @property
    def triangles(self) -> Triangles:
        """The triangles of both."""
        return self.exact.triangles


def rays_part(layout: Layout, backend: str, scattered: bool) -> bool:
    """Return whether rays that start side by side soon have so little in common that each had better walk alone.

    A kernel of such rays runs at one lane. Rays of a mesh of many triangles part where they are `scattered`: by matt
    surfaces, as in path tracing, or by glass. Rays in a cube part too.
    """
    if backend not in TOGETHER:
        return False
    structure = layout.structure
    wide = isinstance(structure, Bvh) and structure.low.dtype == np.float32 and len(structure.items) >= MANY
    return layout.secondary is not None or (scattered and wide)


def scene_walk(layout: Layout, backend: str, scattered: bool = False) -> Walk | SplitWalk:
    """The walk through a scene for rays of unit length that may start from a triangle; `scattered`: see `rays_part`."""
    if layout.secondary is None and rays_part(layout, backend, scattered):
        assert isinstance(layout.structure, Bvh)
        return WideIntersector(layout.structure, layout.triangles, AheadBound(layout.roundoff))
    exact = walk_through(layout.structure, layout.triangles, backend, layout.roundoff)
    if layout.secondary is None:
        return exact
    secondary = LayeredIntersector(layout.secondary, layout.triangles, AheadBound(layout.roundoff))
    secondary.triangles = exact.triangles  # one table for both
    return SplitWalk(exact, secondary)


def meet(walk: Walk | SplitWalk, is_eye: Callable[[], Any], ray: Any, eye: Any, limit: Any, any_hit: Any) -> Hit:
    """The nearest hit of a ray before `limit`, which `is_eye` tells from a secondary one; `any_hit` as in `Walk`."""
    if not isinstance(walk, SplitWalk):
        return walk(ray, eye, 0.0, limit, any_hit)
    hit = Hit(limit, walk.accept)
    with SH_IF(is_eye()):
        walk.exact.collect(hit, ray, eye, 0.0, 0.0, False)
    with SH_ELSE():
        walk.secondary.collect(hit, ray, eye, 0.0, 0.0, any_hit)
    return hit


def walk_through(structure: Structure, triangles: Any, backend: str, roundoff: float | None = None) -> Walk:
    """The walk through a structure over `triangles` (see `layout.triangle_rows`), in the way that suits a backend.

    `roundoff` is for rays of unit length that may start from a triangle (see `AheadBound`).
    """
    bound = None if roundoff is None else AheadBound(roundoff)
    return walk_with(structure, triangles, backend, bound)


def walk_with(structure: Structure, triangles: Any, backend: str, bound: AheadBound | None) -> Walk:
    """The walk as in `walk_through`, with the bound of rays that may start from a triangle."""
    if isinstance(structure, LayeredCube):
        return LayeredIntersector(structure, triangles, bound)
    if isinstance(structure, Bvh):
        return BvhIntersector(structure, triangles, together=backend in TOGETHER, bound=bound)
    return GridIntersector(structure, triangles, bound)
