"""The walk through two levels of hierarchies: a ray enters an instance, and meets its triangles in the scene's place.

Stage: kernel. The boxes of a part are met by the ray in the part's coordinates. The corners of a triangle are moved to
the scene's coordinates instead, where the test is that of all other triangles: so neighbours share their corners to the
bit, no ray slips between them, and a ray that starts from a triangle is known to be off it. A ray in the part's
coordinates starts a rounding of the scene's size beside the triangle, which may be many times the part's size.

The boxes are met with a margin for the roundings of the ray, so they are where a triangle is met, and the hits are the
same however many rays walk together. For the same reason no ray is compared with the box of the instance by itself.

Pictures of ten knots of 10,000 triangles take 1.1 of the CPU time with triangles of their own (256 x 256, Intel Xeon,
AVX-512; `python -m benchmarks --only instances`): normals of unit length are one division, and the bound of roundings
is kept for each instance. 1.25 without these.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

import shpy as sh
from raytracer.accel.bvh import COUNT_BITS, END
from raytracer.accel.two_levels import ROWS, TwoLevels
from raytracer.kernels.bvh_walk import BoxTest, BvhIntersector, box_rows, try_leaf
from raytracer.kernels.triangle import (
    AheadBound,
    Place,
    PlaneView,
    RayHit,
    TouchingHit,
    Triangles,
    TriangleTest,
    farther,
    product,
)
from shpy import SH_BREAK, SH_DO, SH_ELSE, SH_IF, SH_UNTIL, SH_WHILE

ROUNDOFF: Final = 2.0**-24
"""The largest relative error of one rounding."""
RAY: Final = 10.0
"""The largest error of a ray in the coordinates of a part, in roundings of its way: 5 of the origin, 4 of the
direction, and one more. A rounding of the reach is for the corners of triangles."""


class InstanceHit(RayHit):
    """A `RayHit` of the triangle `id` of an `instance`; `order` is its number among the triangles of all instances.

    `inside` is the instance in which the walk is.
    """

    def __init__(self, instances: Instances, limit: Any, accept: Any = None) -> None:
        super().__init__(limit, accept)
        self.instances = instances
        instance, order = sh.Attrib1i(-1), sh.Attrib1i(-1)
        inside = sh.Attrib1i(0)
        self.instance, self.order, self.inside = instance, order, inside

    @property
    def parts(self) -> tuple[Any, ...]:
        """The variables that say what was hit, and where."""
        return *super().parts, self.instance

    @property
    def in_scene(self) -> tuple[Any, Any]:
        """The number of the triangle among those of all meshes, and the weights of its corners 1 and 2 there."""
        weights = self.instances.weights_in_scene(sh.max(self.instance, 0), self.uv.x, self.uv.y, 1.0)
        return self.order, sh.TexCoord2f(*weights)

    def offer(self, met: Any, t: Any, number: Any, weights: Sequence[Any]) -> None:
        """Take the triangle `number` of the instance if it is `met` at a distance `t` less than `l`.

        Of triangles at the same distance the first one in the order is taken.
        """
        order = self.instances.order_of(number, self.inside)
        with (
            SH_IF(met & ((t < self.l) | ((t == self.l) & (order < self.order)))),
            self.accepting(number, weights),
        ):
            wb, wc, whole = weights
            self.l[:] = t
            self.uv[:] = sh.TexCoord2f(wb, wc) / whole
            self.id[:] = number
            self.instance[:] = self.inside
            self.order[:] = order


class TouchingInstanceHit(TouchingHit):
    """A `TouchingHit` whose triangles are those of instances, as those of an `InstanceHit` are."""

    def __init__(self, instances: Instances, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.instances = instances
        self.instance, self.order = self.blank_place()
        inside = sh.Attrib1i(0)
        self.inside = inside

    @property
    def places(self) -> list[Place]:
        """The nearest hit and the others."""
        return [Place(self.l, self.uv, self.id, self.surface, self.instance, self.order), *self.others]

    def anew(self, limit: Any, ray: Any) -> TouchingHit:
        """Return a hit of the same kind for a search at distances less than `limit`."""
        return TouchingInstanceHit(self.instances, limit, self.accept, self.surface_of, ray, len(self.others))

    def blank_place(self) -> tuple[Any, ...]:
        """Return variables for what `placed` gives."""
        return sh.Attrib1i(-1), sh.Attrib1i(-1)

    def placed(self, number: Any) -> tuple[Any, ...]:
        """Return the instance of a triangle and its place in the order of all triangles."""
        return sh.Attrib1i(self.inside), sh.Attrib1i(self.instances.order_of(number, self.inside))


class NumberedHit:
    """A hit of `queries`, which knows triangles by their numbers among those of all instances."""

    def __init__(self, hit: Any, instances: Instances) -> None:
        self.hit, self.instances = hit, instances
        inside = sh.Attrib1i(0)
        self.inside = inside

    @property
    def l(self) -> Any:  # noqa: E743 - as in RayHit
        """The distance up to which triangles are met."""
        return self.hit.l

    @property
    def id(self) -> Any:
        """The number of the triangle that was hit, -1 for none."""
        return self.hit.id

    def offer(self, met: Any, t: Any, number: Any, weights: Sequence[Any]) -> None:
        """Offer the triangle `number` of the instance to the hit."""
        weights = *self.instances.weights_in_scene(self.inside, *weights), weights[2]
        self.hit.offer(met, t, self.instances.order_of(number, self.inside), weights)


class Instances:
    """The tables of instances; see `TwoLevels`."""

    def __init__(self, levels: TwoLevels) -> None:
        self.latest = levels.rows
        self.rows = sh.Table(levels.rows, sh.Attrib4f, "instances", unique=False)
        numbers = np.stack([levels.roots[levels.part_of], levels.firsts], axis=1)
        self.numbers = sh.Table(numbers.astype(np.int32), sh.Attrib2i, "instance_numbers", unique=False)
        self.order = sh.Table(levels.order, sh.Attrib1i, "order", unique=False)

    @classmethod
    def of(cls, levels: TwoLevels, triangles: Triangles) -> Instances:
        """Return the tables of the instances of triangles, which all walks through these share."""
        instances: Instances = triangles.instances or cls(levels)
        triangles.instances = instances
        return instances

    def place(self, levels: TwoLevels) -> None:
        """Take the places of instances that have moved."""
        if levels.rows is not self.latest:
            self.latest = levels.rows
            self.rows.update(levels.rows)

    def order_of(self, number: Any, instance: Any) -> Any:
        """Return the number of a triangle of an instance among those of all instances."""
        return self.order[number] + self.numbers[instance].y

    def weights_in_scene(self, instance: Any, wb: Any, wc: Any, whole: Any) -> tuple[Any, Any]:
        """Return the weights of corners 1 and 2 in the scene, where those of a mirrored mesh are in the other order."""
        return wb, sh.cond(self[instance].hand < 0, whole - wb - wc, wc)

    def hit_of(self, hit: Any) -> Any:
        """Return a hit to which a walk offers the triangles of instances."""
        return hit if isinstance(hit, InstanceHit | TouchingInstanceHit) else NumberedHit(hit, self)

    def __getitem__(self, k: Any) -> Placement:
        """Return the place of instance `k`."""
        return Placement(self.rows, ROWS * k)


class Placement:
    """The place of an instance, whose rows begin at `first`; `matrix` are the first three of them."""

    def __init__(self, rows: Any, first: Any, matrix: Sequence[Any] | None = None) -> None:
        self.rows, self.first = rows, first
        self.matrix = [rows[first + axis] for axis in range(3)] if matrix is None else matrix

    def point(self, corner: Any) -> Any:
        """Return where a corner of the part lies in the scene."""
        return sh.Point3f(*(product(row, corner) + row.w for row in self.matrix))

    def normal(self, normal: Any) -> Any:
        """Return a unit normal of the part in the scene."""
        return sh.Normal3f(*self._across(normal)[0])

    @property
    def hand(self) -> Any:
        """Return -1 where the instance is mirrored, so that corners go round triangles the other way; otherwise 1."""
        return self.rows[self.first + 8].w

    def _across(self, normal: Any) -> tuple[list[Any], Any]:
        """Return a unit normal in the scene, and the factor to it from the product of the matrix for normals."""
        rows = [self.rows[self.first + 3 + axis] for axis in range(3)]
        across = [product(row, normal) for row in rows]
        square = product(across, across)
        # The normals of what is not moved stay as they are, to the bit.
        kept = (square == 0) | (rows[0].w + rows[1].w + rows[2].w == 0)
        factor = sh.cond(kept, 1.0, 1 / sh.sqrt(square))
        return [component * factor for component in across], factor

    def plane(self, normal: Sequence[Any], level: Any, ray: Any, eye: Any) -> tuple[list[Any], PlaneView]:
        """Return the unit normal in the scene of a triangle of the part, and its plane."""
        across, factor = self._across(normal)
        last = self.rows[self.first + 9]
        level = last.w * level * factor + product(across, [row.w for row in self.matrix])
        return across, PlaneView(across, level, ray, eye, product([abs(n) for n in normal], last) * factor)

    def ray(self, ray: Any, eye: Any) -> tuple[Any, Any, Any]:
        """Return a ray in the part's coordinates, its origin, and how far it may be off along each axis."""
        back = [self.rows[self.first + 6 + axis] for axis in range(3)]
        way = [eye[axis] - self.matrix[axis].w for axis in range(3)]
        reach = [RAY * abs(way[axis]) + self.rows[self.first + 3 + axis].w for axis in range(3)]
        slack = [ROUNDOFF * product([abs(row[k]) for k in range(3)], reach) for row in back]
        direction, origin = ([product(row, vector) for row in back] for vector in (ray, way))
        return sh.Vector3f(*direction), sh.Point3f(*origin), sh.Vector3f(*slack)


class PlacedLeaves:
    """The triangles of leaves as `TriangleTest` reads them, in the place of the instance in which a walk is."""

    def __init__(self, leaves: Triangles, placement: Placement) -> None:
        self.leaves, self.placement = leaves, placement

    def __getitem__(self, k: Any) -> list[Any]:
        """Return the corners of the triangle at place `k`, in the scene."""
        return [self.placement.point(row) for row in self.leaves[k]]

    def plane(self, k: Any, rows: Sequence[Any], ray: Any, eye: Any) -> tuple[Sequence[Any], PlaneView]:
        """Return the unit normal of the triangle at place `k`, and its plane, in the scene."""
        return self.placement.plane([row.w for row in self.leaves[k]], self.leaves.levels[k], ray, eye)

    def number(self, k: Any) -> Any:
        """Return the number of the triangle at place `k`."""
        return self.leaves.number(k)


class LevelBoxTest(BoxTest):
    """A `BoxTest` whose ray is that in the coordinates of the level in which the walk is."""

    def __init__(self, ray: Any, eye: Any, near: Any, margin: float, steepest: float) -> None:
        super().__init__(ray, eye, near, margin, steepest)
        inverse, before, beyond = sh.Vector3f(self.inverse), sh.Point3f(eye), sh.Point3f(eye)
        self.inverse, self.eye, self.beyond = inverse, before, beyond
        self.steepest = steepest

    def take(self, ray: Any, eye: Any, slack: Any = 0) -> None:
        """Go on with another ray, which may be off by `slack` along each axis."""
        self.inverse[:] = sh.clamp(1 / ray, -self.steepest, self.steepest)
        self.eye[:] = eye + slack
        self.beyond[:] = eye - slack


class InstanceIntersector(BvhIntersector):
    """The tables of two levels over `triangles`, each part's in coordinates of its own, and the walk.

    Rays go on to the next leaf of either level. In packets a ray meets triangles only of instances whose boxes it meets
    itself. The other arguments are those of `BvhIntersector`.
    """

    def __init__(self, levels: TwoLevels, triangles: Any, together: bool, bound: AheadBound | None = None) -> None:
        super().__init__(levels.bvh, triangles, together, bound)
        self.instances = Instances.of(levels, self.triangles)

    def hit_before(self, limit: Any) -> RayHit:
        """Return a hit to be searched at distances less than `limit`."""
        return InstanceHit(self.instances, limit, self.accept)

    def place(self, levels: TwoLevels) -> bool:
        """Update the tables of instances that have moved."""
        top, links = levels.top, levels.top_links
        self.instances.place(levels)
        self.boxes.update(box_rows(top.low, top.high), start=0)
        for octant, rows in enumerate(links):
            self.first.update(rows[:, 0], start=octant * self.nodes.value)
            self.past.update(rows[:, 1], start=octant * self.nodes.value)
        return True

    def walk(self, ray: Any, eye: Any, near: Any, any_hit: Any, box: BoxTest, reach: Any, hit: Any) -> None:
        """Go through all nodes of both levels whose boxes are met no farther than `reach`."""
        hit, test = self.instances.hit_of(hit), TriangleTest(ray, eye, self.bound)
        box = LevelBoxTest(ray, eye, box.near, self.margin, self.steepest)
        matrix = [sh.Attrib4f(0, 0, 0, 0) for _ in range(3)]
        first = sh.Attrib1i(0)
        leaves: Any = PlacedLeaves(self.leaves, Placement(self.instances.rows, first, matrix))
        top_links = sh.Attrib1i(self.octant_of(ray) * self.nodes)
        links = sh.Attrib1i(top_links)
        node, after = sh.Attrib1i(0), sh.Attrib1i(END)
        with SH_DO():
            # All rays go on to a leaf, or to the end, before any tries triangles.
            leaf = sh.Attrib1i(-1)
            there = sh.Attrib1i(0)
            with SH_WHILE(lambda: node >= 0):
                there[:] = node
                node[:] = self.past[links + there]
                with SH_IF(self.vote(self.meets(box, there, reach))):
                    link = self.first[links + there]
                    with SH_IF(link < 0):
                        leaf[:] = -1 - link
                        SH_BREAK()
                    node[:] = link
            with SH_IF((leaf >= 0) & ((leaf & ((1 << COUNT_BITS) - 1)) == 0)):
                hit.inside[:] = leaf >> COUNT_BITS
                placement = self.instances[hit.inside]
                first[:] = placement.first
                for row, read in zip(matrix, placement.matrix, strict=True):
                    row[:] = read
                direction, origin, slack = placement.ray(ray, eye)
                box.take(direction, origin, slack)
                links[:] = self.octant_of(direction) * self.nodes
                after[:] = node
                node[:] = self.instances.numbers[hit.inside].x
            with SH_ELSE():
                with SH_IF(leaf > 0), SH_IF(self.meets(box, there, reach)):
                    try_leaf(leaves, leaf, near, test, hit)
                    reach[:] = farther(hit.l)
                with SH_IF(node < 0):
                    node[:] = after
                    after[:] = END
                    box.take(ray, eye)
                    links[:] = top_links
            SH_UNTIL((node < 0) | (any_hit & (hit.id >= 0)))
