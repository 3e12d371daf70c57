"""The walk through an accelerator: which one runs when is decided here.

Stage: kernel. Takes what `accel.choice.build` gives; gives a `Walk`, which a kernel calls with a ray for its `RayHit`.

| accelerator         | rays                                        | walk                                     |
| ---                 | ---                                         | ---                                      |
| grid, brute         | all                                         | GridIntersector                          |
| grid beside objects | all                                         | GridBeside: the hierarchy, then the grid |
| grid                | queries for several hits, closest points    | those of a hierarchy built for them      |
| instances           | scattered, on OpenCL                        | WideInstanceIntersector, each ray alone  |
| instances           | all others                                  | InstanceIntersector, on OpenCL in packets |
| bvh                 | all that are named in no other row          | BvhIntersector, on OpenCL in packets     |
| bvh                 | queries for alike rays, on OpenCL in f32    | PacketIntersector                        |
| bvh                 | scattered, on OpenCL in f32; closest points | WideIntersector, each ray alone          |
| cube, cubes         | all but the eye's                           | LayeredIntersector, each ray alone       |
| cube, cubes         | the eye's                                   | that of the exact accelerator            |

The walks of eight boxes at a time begin at 0 or beyond. A hierarchy in which objects move has no wide form: its nodes
gather boxes of several levels and lie in the order of the whole hierarchy, so that no part of them belongs to one
object and could be replaced by itself. Rays of pictures are scattered after matt surfaces and in glass; the rays of a
query are judged by `rays.alike`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, cast

import numpy as np

import shpy as sh
from raytracer.accel.bvh import Bvh
from raytracer.accel.forest import Forest
from raytracer.accel.grid import Grid
from raytracer.accel.ploc import build_bvh
from raytracer.accel.space import WORKING, Rows
from raytracer.accel.two_levels import TwoLevels
from raytracer.kernels.bvh_walk import BvhIntersector
from raytracer.kernels.grid_walk import GridBeside, GridIntersector
from raytracer.kernels.instances import InstanceIntersector
from raytracer.kernels.layered_walk import LayeredIntersector
from raytracer.kernels.packet_walk import PacketIntersector
from raytracer.kernels.triangle import Accept, AheadBound, RayHit, TouchingHit, Triangles, Walk
from raytracer.kernels.wide_instances import WideInstanceIntersector
from raytracer.kernels.wide_walk import WideIntersector
from raytracer.layered.cube import LayeredCube
from raytracer.layered.placed import PlacedCubes
from raytracer.scene.layout import Change, Layout
from shpy import SH_ELSE, SH_IF

Structure = Grid | Bvh | TwoLevels | LayeredCube | PlacedCubes

TOGETHER = frozenset({"opencl"})
"""Backends on which rays that run side by side share their traversal: packets of up to 16, not numpy's tiles."""
SEVERAL = ("count", "list_hits", "list_more")
"""The queries for more than the nearest hit."""
Way = Literal["any", "alone", "packets"]
"""The walk of a query through a hierarchy: for any rays and ranges, or from 0 on for scattered or for alike rays."""
Scattered = Literal["secondary", "all"] | None
"""Rays that have little in common with their neighbours: none, all but the eye's, or all."""
MANY = 6000
"""Triangles from which on scattered rays walk faster alone; measured: it is between 2,400 and 10,000."""
ROOMY = 1 << 18
"""Triangles up to which eye rays of a path traced picture walk in packets beside scattered ones that walk alone.

Packets have tables of their own, 115 bytes a triangle. Alone, eye rays take 1.035 of the time of a picture of 192 x 192
pixels (100,000 triangles in a room, 1.075 in the open, 1.03 of a knot), and 1.00 to 1.03 for 400,000 triangles. Of
instances the distinct triangles count: alone, eye rays take 1.5 of the time of a picture of ten knots of 10,000
triangles, 1.1 of one of a hundred and of `examples/meadow.py`.
"""


@dataclass
class SplitWalk:
    """Two walks through the same triangles: an exact walk for eye rays, and a walk for secondary rays."""

    exact: Walk
    secondary: Walk
    accept: Accept | None = None

    def place(self, levels: TwoLevels) -> bool:
        """Update the tables of both walks after instances have moved; return whether they fit."""
        return self.secondary.place(levels) and self.exact.place(levels)

    def hit_before(self, limit: Any) -> RayHit:
        """Return a hit to be searched at distances less than `limit`."""
        hit = self.exact.hit_before(limit)
        hit.accept = self.accept
        return hit

    @property
    def triangles(self) -> Triangles:
        """The triangles, which both walks share."""
        return self.exact.triangles


class HitValue(NamedTuple):
    """The nearest hit of a ray: distance `l`, triangle `id` (-1 for no hit) and `uv`, named as in `RayHit`."""

    l: sh.Attrib1f  # noqa: E741 - as in RayHit
    id: sh.Attrib1i
    uv: sh.TexCoord2f


class InstanceValue(NamedTuple):
    """A `HitValue` and the instance of its triangle."""

    l: sh.Attrib1f  # noqa: E741 - as in RayHit
    id: sh.Attrib1i
    uv: sh.TexCoord2f
    instance: sh.Attrib1i


_RAY: dict[str, Any] = {"ray": sh.Vector3f, "eye": sh.Point3f, "limit": sh.Attrib1f, "any_hit": sh.Attrib1b}
"""The inputs of a search for a hit."""


class AloneWalk(Walk):
    """A walk that each lane of a packet takes alone; two of them take turns."""

    def __init__(self, walk: WideIntersector) -> None:
        self.walk, self.triangles = walk, walk.triangles
        kind = HitValue if self.triangles.instances is None else InstanceValue

        def find(ray: Any, eye: Any, limit: Any, any_hit: Any) -> Any:
            return kind(*walk(ray, eye, 0.0, limit, any_hit).parts)

        find.__annotations__ = _RAY | {"return": kind}
        self.find = sh.subroutine(alone=True)(find)

    def place(self, levels: TwoLevels) -> bool:
        """Update the tables of instances that have moved; return whether they fit."""
        return self.walk.place(levels)

    def hit_before(self, limit: Any) -> RayHit:
        """Return a hit to be searched at distances less than `limit`."""
        hit = self.walk.hit_before(limit)
        hit.accept = self.accept
        return hit

    def find_touching(self, hit: TouchingHit) -> Any:
        """Return the walk for hits such as this one, whose result has all of their variables."""
        kinds = [sh.Attrib1f, sh.TexCoord2f, *[sh.Attrib1i] * (len(hit.places[0].parts) - 2)] * len(hit.places)
        fields = [(f"part_{k}", kind) for k, kind in enumerate(kinds)]
        found_places = cast(Any, NamedTuple("FoundPlaces", fields))

        def find(ray: Any, eye: Any, limit: Any, any_hit: Any) -> Any:
            touching_hit = hit.anew(limit, ray)
            self.walk.collect(touching_hit, ray, eye, 0.0, 0.0, any_hit)
            return found_places(*(part for place in touching_hit.places for part in place.parts))

        find.__annotations__ = _RAY | {"return": found_places}
        return sh.subroutine(alone=True)(find)

    def collect(self, hit: Any, ray: Any, eye: Any, near: Any, begin: Any, any_hit: Any) -> None:
        """Offer to `hit` each triangle that is met at a distance in [near, hit.l), boxes from `begin` on."""
        self.walk.accept = hit.accept
        touching = isinstance(hit, TouchingHit)
        find = self.find_touching(hit) if touching else self.find
        found = find(ray, eye, hit.l, sh.Attrib1b(any_hit))
        parts = [part for place in hit.places for part in place.parts] if touching else hit.parts
        for part, value in zip(parts, found, strict=True):
            part[:] = value


def scene_walk(layout: Layout, backend: str, scattered: Scattered = None) -> Walk | SplitWalk:
    """Return the walk through a scene for rays of unit length that may start from a triangle.

    `scattered` names the rays that walk alone among many triangles, as they have little in common with their
    neighbours; `ROOMY` says when eye rays are among all of them.
    """
    bound = AheadBound(layout.roundoff)
    structure, forest = layout.structure, layout.forest
    alone = None
    if layout.secondary is None and has_wide(structure, backend, forest) and _is_large(structure):
        alone = WideInstanceIntersector if isinstance(structure, TwoLevels) else WideIntersector
    if alone is not None and scattered == "all" and len(layout.material_of) > ROOMY:
        return AloneWalk(alone(structure, layout.triangles, bound, backend))
    exact = walk_with(structure, layout.triangles, backend, bound, forest)
    if layout.secondary is not None:
        notes = layout.secondary.options["shading"] == "deferred"
        secondary = LayeredIntersector(layout.secondary, layout.triangles, bound, notes=notes)
        secondary.triangles = exact.triangles  # one table for both
        return SplitWalk(exact, secondary)
    if alone is not None and scattered is not None:
        return SplitWalk(exact, AloneWalk(alone(structure, exact.triangles, bound, backend)))
    return exact


def _is_large(structure: Any) -> bool:
    """Return whether scattered rays walk faster alone."""
    if isinstance(structure, TwoLevels):
        return sum(len(structure.parts[part].items) for part in structure.part_of) >= MANY
    return len(structure.items) >= MANY


def walk_with(
    structure: Structure, triangles: Any, backend: str, bound: AheadBound | None = None, forest: Forest | None = None
) -> Walk:
    """Return the walk of packets through a structure over `triangles` (see `triangle_rows`), on a backend.

    `bound` is for rays of unit length that may start from a triangle; `forest` has the objects that move, if any.
    """
    if isinstance(structure, LayeredCube | PlacedCubes):
        return LayeredIntersector(structure, triangles, bound)
    if isinstance(structure, TwoLevels):
        return InstanceIntersector(structure, triangles, together=backend in TOGETHER, bound=bound)
    if isinstance(structure, Bvh):
        return BvhIntersector(structure, triangles, together=backend in TOGETHER, bound=bound)
    if forest is not None:
        return GridBeside(structure, forest, triangles, backend in TOGETHER, bound)
    return GridIntersector(structure, triangles, bound)


def has_wide(structure: Any, backend: str, forest: Forest | None) -> bool:
    """Return whether rays may walk through the wide form of a hierarchy, in packets or alone."""
    is_single = isinstance(structure, TwoLevels) or (isinstance(structure, Bvh) and structure.low.dtype == np.float32)
    return is_single and backend in TOGETHER and forest is None


def lanes_of(backend: str, structure: Any, *, alone: bool = False) -> dict[str, int]:
    """Return the option of `Program.compile` for rays through a structure: one lane where each of them walks alone."""
    alone = alone or isinstance(structure, LayeredCube | PlacedCubes)
    return {"lanes": 1} if alone and backend in TOGETHER else {}


class QueryWalks:
    """The walks of queries through a structure over triangles, each made on first use.

    `corners` (N, 3, 3) and `rows` (see `triangle_rows`) are those of the triangles. `moved` is the walk through objects
    that have moved, and what it reads.
    """

    def __init__(
        self, structure: Structure, corners: Rows, rows: Rows, precision: str, backend: str, moved: Walk | None = None
    ) -> None:
        self.structure, self.corners, self.rows, self.backend, self.moved = structure, corners, rows, backend, moved
        self.floats = WORKING[precision]

    def walk_for(self, query: str, bound: AheadBound | None, way: Way = "any") -> Walk:
        """Return the walk for a query of this name, of rays that go this way."""
        if way == "alone":
            return self.wide.bounded(bound)
        if way == "packets" and not isinstance(self.structure, TwoLevels):
            return self.packets.bounded(bound)
        # A grid of several cells may visit a triangle twice.
        if query in SEVERAL and isinstance(self.structure, Grid) and self.structure.shape != (1, 1, 1):
            return walk_with(self.tree, self.tree_triangles, self.backend, bound)
        return self.walk.bounded(bound)

    @property
    def has_wide(self) -> bool:
        """Return whether scattered rays walk alone, and alike ones as packets."""
        return self.moved is None and has_wide(self.structure, self.backend, None)

    def place(self, levels: TwoLevels) -> bool:
        """Update the walks that were made after instances have moved; return whether they fit."""
        self.structure = levels
        return all(walk.place(levels) for name in ("wide", "walk") if (walk := vars(self).get(name)) is not None)

    @cached_property
    def walk(self) -> Walk:
        """The walk of any rays: those that walk otherwise do not need it."""
        return walk_with(self.structure, self.triangles, self.backend) if self.moved is None else self.moved

    @cached_property
    def packets(self) -> PacketIntersector:
        """The walk of alike rays."""
        return PacketIntersector(self.tree, self.tree_triangles, backend=self.backend)

    @cached_property
    def wide(self) -> WideIntersector:
        """The walk of lone rays."""
        if isinstance(self.structure, TwoLevels):
            return WideInstanceIntersector(self.structure, self.triangles, backend=self.backend)
        return WideIntersector(self.tree, self.tree_triangles, backend=self.backend)

    @cached_property
    def tree(self) -> Bvh:
        """The hierarchy over the triangles."""
        if isinstance(self.structure, Bvh) and self.moved is None:
            return self.structure
        return build_bvh(self.corners, self.floats, self.backend)

    @cached_property
    def triangles(self) -> Any:
        """The tables of the triangles, which all walks share; a cube is compared with their rows."""
        return self.rows if isinstance(self.structure, LayeredCube) else Triangles.of(self.rows, self.floats)

    @property
    def tree_triangles(self) -> Any:
        """The triangles of `tree`: the walk's own, or tables of the present positions if objects have moved."""
        return self.triangles if self.moved is None else Triangles.of(self.rows, self.floats)


def renew_walk(walk: Walk | SplitWalk, layout: Layout, changes: Sequence[Change]) -> None:
    """Update the tables of a walk through moving objects after changes."""
    if isinstance(walk, SplitWalk):
        assert isinstance(walk.secondary, LayeredIntersector)
        assert isinstance(layout.secondary, PlacedCubes)
        walk.secondary.renew(layout.secondary)
        walk = walk.exact
    assert isinstance(walk, BvhIntersector | GridBeside)
    assert layout.forest is not None
    walk.renew(layout.forest, changes)


def meet(
    walk: Walk | SplitWalk,
    is_eye: Callable[[], Any],
    ray: Any,
    eye: Any,
    limit: Any,
    any_hit: Any,
    touching: Callable[[Any], TouchingHit] | None = None,
) -> RayHit:
    """Find the nearest hit of a ray before `limit`; `is_eye` tells eye rays from others, `any_hit` as in `Walk`.

    With `touching`, which makes one of the filter of hits, it is a `TouchingHit`, unless rays go through a layered
    depth cube.
    """
    layered = isinstance(walk, SplitWalk) and isinstance(walk.secondary, LayeredIntersector)
    touches = touching is not None and not layered
    if not (touches or isinstance(walk, SplitWalk)):
        return walk(ray, eye, 0.0, limit, any_hit)
    hit = touching(walk.accept) if touching is not None and touches else walk.hit_before(limit)
    if not isinstance(walk, SplitWalk):
        walk.collect(hit, ray, eye, 0.0, 0.0, any_hit)
        return hit
    if isinstance(walk.secondary, LayeredIntersector) and walk.secondary.notes:
        hit.sample = sh.Attrib1i(-1)
    with SH_IF(is_eye()):
        walk.exact.collect(hit, ray, eye, 0.0, 0.0, False)
    with SH_ELSE():
        walk.secondary.collect(hit, ray, eye, 0.0, 0.0, any_hit)
    return hit
