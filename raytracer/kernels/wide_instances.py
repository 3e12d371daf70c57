"""The walk of one ray alone through two levels: eight boxes at a time, and eight triangles at a time.

Stage: kernel. As in `wide_walk`, on a stack, boxes of both levels among each other. Where the nearest box is that of an
instance, the ray enters it: boxes are then met in the part's coordinates, and the corners of triangles are placed in
the scene, as in `instances`. It leaves the instance where the stack is down to what it held when the ray entered.

Path traced pictures take .42 of the CPU time of packets alone in `examples/meadow.py`, and .9 with ten knots of 10,000
triangles (Intel Xeon, AVX-512). With eye rays in packets beside it, those of the knots take .7 of the time with
triangles of their own (`python -m benchmarks --only instances`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import shpy as sh
from raytracer.accel.families import HALF, WIDTH
from raytracer.accel.two_levels import TwoLevels
from raytracer.accel.wide import LEAF, LEVEL, NORMALS, ROWS, WideBvh, top_records, widen_levels
from raytracer.kernels.instances import InstanceHit, Instances, Placement
from raytracer.kernels.triangle import AheadBound, PlaneView, RayHit, farther, is_ray, product
from raytracer.kernels.wide_walk import LEAST, NONE, BlockTest, NodeTest, Stack, WideIntersector, floats
from shpy import SH_ELSE, SH_IF, SH_WHILE


class WideInstanceIntersector(WideIntersector):
    """The table of the wide form of two levels over `triangles`, each part's in its own coordinates, and the walk."""

    def widened(self, levels: Any, backend: str) -> WideBvh:
        """Return the wide form of two levels."""
        self.instances = Instances.of(levels, self.triangles)
        wide, self.roots, self.below = widen_levels(levels, *self.triangles.sources, backend)
        return wide

    def place(self, levels: TwoLevels) -> bool:
        """Update the tables of instances that have moved; return False where a walk needs a deeper stack."""
        records, depth = top_records(levels, self.roots)
        if depth + self.below > self.depth:
            return False
        self.instances.place(levels)
        self.records.update(records.reshape(-1, HALF), start=0)
        return True

    def hit_before(self, limit: Any) -> RayHit:
        """Return a hit to be searched at distances less than `limit`."""
        return InstanceHit(self.instances, limit, self.accept)

    def collect(self, hit: Any, ray: Any, eye: Any, near: Any, begin: Any, any_hit: Any) -> None:
        """Offer to `hit` each triangle that is met at a distance in [near, hit.l), boxes from `begin` on."""
        going = sh.Attrib1b((near < hit.l) & is_ray(ray, eye))
        hit = self.instances.hit_of(hit)
        node = LevelNodeTest(ray, eye, begin, self.margin)
        block = PlacedBlockTest(ray, eye, near, self.bound, self.instances)
        stack = Stack((WIDTH - 1) * self.depth + 2)
        reach = farther(hit.l) + LEAST
        place, key = sh.Attrib1i(0), sh.Attrib1u(0)
        bottom = sh.Attrib1u(0)  # of the stack in the instance; 0 outside of all
        with SH_WHILE(lambda: going):
            with SH_IF((key & LEAF) == 0):  # false for NONE, too
                self.descend(node, stack, place, key, reach)
            with SH_ELSE():
                with SH_IF((key != NONE) & (bottom == 0)):
                    entered = self.records[ROWS * place]
                    hit.inside[:] = sh.Attrib1i(entered.x)
                    placement = self.instances[hit.inside]
                    node.enter(placement)
                    block.enter(placement)
                    bottom[:] = stack.top
                    place[:] = self.number(entered.y)
                    key[:] = 0
                with SH_ELSE():
                    with SH_IF(key != NONE):
                        block(self.records, ROWS * place, hit)
                        reach[:] = farther(hit.l) + LEAST
                    number, met = stack.pop(reach)
                    place[:] = self.number(number)
                    key[:] = met
                    with SH_IF(stack.top < bottom):
                        bottom[:] = 0
                        node.leave()
                    more = stack.top != 0
                    going[:] = more if any_hit is False else more & ~(any_hit & (hit.id >= 0))


class LevelNodeTest(NodeTest):
    """A `NodeTest` whose ray is that in the coordinates of the level in which the walk is."""

    def __init__(self, ray: Any, eye: Any, near: Any, margin: float) -> None:
        super().__init__(ray, eye, near, margin)
        self.ray, self.margin = ray, margin
        self.outside = NodeTest(ray, eye, near, margin)
        sooner, later = sh.Vector3f(self.sooner), sh.Vector3f(self.later)
        before, beyond = sh.Point3f(eye), sh.Point3f(eye)
        self.sooner, self.later, self.eye, self.beyond = sooner, later, before, beyond
        self.first = [sh.Attrib1i(row) for row in self.first]
        self.last = [sh.Attrib1i(row) for row in self.last]

    def enter(self, placement: Placement) -> None:
        """Go on in the coordinates of an instance's part, where the ray may be off along each axis."""
        direction, origin, slack = placement.ray(self.ray, self.outside.eye)
        inside = NodeTest(direction, origin, self.near, self.margin)
        self._take(inside)
        off = sh.cond(direction < 0, -slack, slack)
        self.eye[:] = origin + off
        self.beyond[:] = origin - off

    def leave(self) -> None:
        """Go on in the scene's coordinates."""
        self._take(self.outside)
        self.eye[:] = self.outside.eye
        self.beyond[:] = self.outside.eye

    def _take(self, test: NodeTest) -> None:
        self.sooner[:] = test.sooner
        self.later[:] = test.later
        for rows, others in ((self.first, test.first), (self.last, test.last)):
            for row, other in zip(rows, others, strict=True):
                row[:] = other


class PlacedBlockTest(BlockTest):
    """A `BlockTest` of triangles in the place of the instance in which a walk is, whose rows begin at `first`."""

    def __init__(self, ray: Any, eye: Any, near: Any, bound: AheadBound | None, instances: Instances) -> None:
        super().__init__(ray, eye, near, bound)
        self.instances = instances
        first = sh.Attrib1i(0)
        self.first = first
        self.matrix: list[Any] = [sh.Attrib4f(0, 0, 0, 0) for _ in range(3)]

    def enter(self, placement: Placement) -> None:
        """Go on in the place of an instance: the rows of its matrix are turned as the axes are."""
        self.first[:] = placement.first
        for row, other in zip(self.matrix, self.sight.turned(placement.matrix), strict=True):
            row[:] = other

    def corner(self, records: Any, place: Any) -> list[Any]:
        """Return the turned coordinates of a corner of each triangle in the scene, relative to the ray's origin."""
        own = [floats(records, place + 2 * axis) for axis in range(3)]
        return [product(row, own) + row.w - eye for row, eye in zip(self.matrix, self.sight.eye, strict=True)]

    def straight(self, records: Any, row: Any, corner: Sequence[Any]) -> list[Any]:
        """Return the coordinates of the first corner of each triangle, whose turned ones are those of `corner`."""
        return self.sight.straight(corner)

    def plane(self, records: Any, row: Any) -> tuple[list[Any], PlaneView]:
        """Return the unit normal of each triangle in the scene, and its plane."""
        normal = [floats(records, row + 2 * (NORMALS + k)) for k in range(3)]
        placement = Placement(self.instances.rows, self.first)
        return placement.plane(normal, floats(records, row + 2 * LEVEL), self.ray, self.eye)
