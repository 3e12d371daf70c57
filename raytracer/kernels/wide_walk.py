"""The walk of one ray alone through a BVH: eight boxes at a time, and eight triangles at a time.

Stage: kernel, for rays that have little in common with their neighbours. A vector of eight holds numbers of eight boxes
or triangles for one ray, so a CPU's vectors are full though the ray walks alone. The time of a walk is the number of
nodes times the latency from one node to the next, in which a few more operations cost little, or another ray can take a
turn.

The nearest box that a ray meets is visited next. The others go on a stack, the second nearest on top, and are visited
unless a nearer hit has been found by then. A search for any hit visits boxes in the order in which they are stored.

A triangle's hit has the bits that `TriangleTest` gives.

In times of blocks of four on vectors of four (knot of 70,400 triangles, Intel Xeon, AVX-512): .89 for the nearest
and .92 for any hit of 67,523 rays in random directions. Rays are not sorted first: 63,192 rays from the surface of the
bunny, in the order of pixels, take .95 (any hit .90) of the time in the order of place and octant, and the sort .06.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import shpy as sh
from raytracer.accel.bounds import FAR, higher, lower
from raytracer.accel.families import HALF, WIDTH
from raytracer.accel.wide import BLOCK, FIRST, LEAF, LEVEL, NORMALS, NUMBERS, ROWS, TAGS, WideBvh, widen
from raytracer.kernels.bvh_walk import MARGIN
from raytracer.kernels.triangle import (
    AheadBound,
    PlaneView,
    Sight,
    Triangles,
    Walk,
    farther,
    inverse_of,
    is_ray,
    meets,
    same_side,
    within,
)
from shpy import SH_DO, SH_ELSE, SH_IF, SH_UNTIL, SH_WHILE

NONE = 0xFFFFFFFF
"""The key of a box that is not met: it comes after all others."""
LEVELS = 8
"""Levels of nodes for which a stack has room, at least.

The number is in the text, for a stack costs its length. All small meshes share a kernel. Larger ones do with as many
levels, rounded to a multiple of 4, and records, to a power of 2 (see `WideBvh.last`).
"""
LEAST = 2.0**-126
"""Farther than 0 by more than a tag adds to a key."""


class WideIntersector(Walk):
    """The table of the wide form of a hierarchy over `triangles` (see `triangle_rows`), and the walk.

    It works at f32, on ranges that begin at 0 or beyond. `bound` is for rays that may start from a triangle.
    The wide form is made on `backend`.
    """

    def __init__(self, structure: Any, triangles: Any, bound: AheadBound | None = None, backend: str = "numpy") -> None:
        self.bound = bound
        self.triangles = Triangles.of(triangles, np.float32)
        wide = self.widened(structure, backend)
        self.last = wide.last
        self.records = sh.Table(wide.table.reshape(-1, HALF), sh.Attrib4u, "records", copy=False, unique=False)
        self.depth = max(LEVELS, -(-wide.depth // 4) * 4)
        self.margin = MARGIN * float(np.finfo(np.float32).eps)

    def widened(self, bvh: Any, backend: str) -> WideBvh:
        """Return the wide form of the hierarchy."""
        return widen(bvh, *self.triangles.sources, backend)

    def collect(self, hit: Any, ray: Any, eye: Any, near: Any, begin: Any, any_hit: Any) -> None:
        """Offer to `hit` each triangle that is met at a distance in [near, hit.l), boxes from `begin` on."""
        wanted = (near < hit.l) & is_ray(ray, eye)
        node, block = NodeTest(ray, eye, begin, self.margin), BlockTest(ray, eye, near, self.bound)
        if any_hit is True:
            with SH_IF(wanted):
                self.find_any(node, block, hit)
        else:
            self.find_nearest(node, block, hit, any_hit, wanted)

    def find_nearest(self, node: Any, block: Any, hit: Any, any_hit: Any = False, wanted: Any = True) -> None:
        """Visit the nearest box first, and skip boxes that begin behind the nearest hit.

        Where `any_hit` holds, end at the first block with a hit; unless `wanted`, visit no node. Each iteration
        visits one node or one block, so that rays that alternate do not wait long for each other.
        """
        wanted = sh.Attrib1b(wanted)
        stack = Stack((WIDTH - 1) * self.depth + 2)
        reach = farther(hit.l) + LEAST
        place = sh.Attrib1i(0)
        key = sh.Attrib1u(0)
        with SH_WHILE(lambda: wanted):
            with SH_IF((key & LEAF) == 0):  # false for NONE, too
                self.descend(node, stack, place, key, reach)
            with SH_ELSE():
                with SH_IF(key != NONE):
                    block(self.records, ROWS * place, hit)
                    reach[:] = farther(hit.l) + LEAST
                number, met = stack.pop(reach)
                place[:] = self.number(number)
                key[:] = met
                wanted[:] = (stack.top != 0) if any_hit is False else (stack.top != 0) & ~(any_hit & (hit.id >= 0))

    def descend(self, node: NodeTest, stack: Stack, place: Any, key: Any, reach: Any) -> None:
        """Go on from the node at `place` to the nearest box that it has within `reach`; the others go on the stack."""
        row = ROWS * place
        keys = node.keys(self.records, row, reach)
        first = self.number(self.records[row + FIRST].x)
        nearest = stack.push_children(keys, first)
        key[:] = nearest
        place[:] = child(nearest, first)

    def find_any(self, node: NodeTest, block: BlockTest, hit: Any) -> None:
        """Visit boxes in their stored order: a bit for each sibling that the ray meets marks those that remain."""
        held = sh.Array(sh.Attrib2u, self.depth + 2)
        top, last = sh.Attrib1u(1), sh.Attrib1u(self.depth + 1)
        reach = farther(hit.l)
        first = sh.Attrib1i(0)
        bits = sh.Attrib1u(1)
        with SH_DO():
            rest = bits & (bits - 1)
            tag = sh.popcount(~bits & (bits - 1))  # the place of the lowest bit
            row = ROWS * child(tag, first)
            held[sh.Attrib1i(sh.min(top, last))] = sh.Attrib2u(sh.Attrib1u(first), rest)
            top += sh.cond(rest != 0, sh.Attrib1u(1), sh.Attrib1u(0))
            with SH_IF(tag < LEAF):
                bits[:] = node.bits(self.records, row, reach)
                first[:] = self.number(self.records[row + FIRST].x)
            with SH_ELSE():
                block(self.records, row, hit)
                bits[:] = 0
            with SH_IF(bits == 0):
                top -= 1
                place, left = held[sh.Attrib1i(sh.min(top, last))]
                first[:] = self.number(place)
                bits[:] = left
            SH_UNTIL((bits == 0) | (hit.id >= 0))

    def number(self, read: Any) -> Any:
        """Clamp a record's number to the last one, which it never exceeds, so that it is known to be in range."""
        return sh.Attrib1i(sh.min(read, sh.Attrib1u(self.last)))


def both_rows(records: Any, row: Any) -> Any:
    """Return the eight words of two rows."""
    return sh.Attrib8u(records[row], records[row + 1])


def floats(records: Any, row: Any) -> Any:
    """Return the eight floats of two rows."""
    return sh.float_from_bits(both_rows(records, row))


def keys_of(begin: Any, met: Any, tags: Any) -> Any:
    """Return the keys of eight boxes: the begin, 0 or beyond, whether they are met, and their tags.

    A key is where the box begins, its last bits the box's tag; NONE for a box that is not met.
    """
    return sh.cond(met, (sh.bits_from_float(begin) & (NONE - 2 * LEAF + 1)) | tags, sh.Attrib8u(NONE))


def least_of(keys: Any) -> Any:
    """Return the least of eight keys, in each component."""
    least = sh.min(keys, keys[4, 5, 6, 7, 0, 1, 2, 3])
    least = sh.min(least, least[2, 3, 0, 1, 6, 7, 4, 5])
    return sh.min(least, least[1, 0, 3, 2, 5, 4, 7, 6])


def greatest_of(keys: Any) -> Any:
    """Return the greatest of eight keys, in each component."""
    greatest = sh.max(keys, keys[4, 5, 6, 7, 0, 1, 2, 3])
    greatest = sh.max(greatest, greatest[2, 3, 0, 1, 6, 7, 4, 5])
    return sh.max(greatest, greatest[1, 0, 3, 2, 5, 4, 7, 6])


def beyond(least: Any, keys: Any) -> Any:
    """Return the keys, with NONE in the place of those that are not greater than `least`."""
    return sh.cond(keys > least, keys, sh.Attrib8u(NONE))


def child(key: Any, first: Any) -> Any:
    """Return the number of a box's record, by the tag in its key."""
    return first + sh.Attrib1i(key & (LEAF - 1))


class Stack:
    """Boxes that are still to be visited: the record's number and the box's key, which holds the box's begin."""

    def __init__(self, size: int, child: Callable[[Any, Any], Any] = child) -> None:
        held = sh.Array(sh.Attrib2u, size)
        top = sh.Attrib1u(1)
        self.entries, self.top, self.child, self.last = held, top, child, sh.Attrib1u(size - 1)

    @property
    def place(self) -> Any:
        """The index of the top, which is known to be in range: a test would cost 5 % of a walk."""
        return sh.Attrib1i(sh.min(self.top, self.last))

    def push(self, key: Any, first: Any) -> None:
        """Push a box onto the stack if the ray meets it. There is no branch, because processors would mispredict it."""
        self.entries[self.place] = sh.Attrib2u(sh.Attrib1u(self.child(key, first)), key)
        self.top += sh.cond(key != NONE, sh.Attrib1u(1), sh.Attrib1u(0))

    def push_children(self, keys: Any, first: Any) -> Any:
        """Push the children of a node but for the nearest; return the key of that."""
        nearest = least_of(keys)
        keys = beyond(nearest, keys)
        second = least_of(keys)
        self.push_all(beyond(second, keys), first)
        self.push(second[0], first)
        return nearest[0]

    def push_all(self, keys: Any, first: Any) -> None:
        """Push the third and further children, the farthest first. There are seldom any, so that a branch pays."""
        with SH_IF(sh.any(keys != NONE)):
            none = sh.Attrib8u(0)  # 0 is no key: every key on the stack is greater
            rest = sh.Attrib8u(sh.cond(keys != NONE, keys, none))
            farthest = sh.Attrib1u(greatest_of(rest)[0])
            with SH_WHILE(lambda: farthest != 0):
                self.push(farthest, first)
                rest[:] = sh.cond(rest < farthest, rest, none)
                farthest[:] = greatest_of(rest)[0]

    def pop(self, reach: Any) -> tuple[Any, Any]:
        """Pop entries until one begins within `reach`, and return it; the bottom one begins at 0."""
        with SH_DO():
            self.top -= 1
            SH_UNTIL(sh.float_from_bits(self.entries[self.place].y) <= reach)
        number, key = self.entries[self.place]
        return number, key


class NodeTest:
    """The constants of a ray for tests against eight boxes at a time.

    Which side of a box a ray comes to first is known from the ray's sign, so `first` and `last` are rows of a node.
    `eye` is where the ray starts for the sides that it comes to first, `beyond` for the others.
    """

    def __init__(self, ray: Any, eye: Any, near: Any, margin: float) -> None:
        inverse = inverse_of(ray)
        self.eye, self.beyond, self.near = eye, eye, near
        self.sooner = inverse * (1 - margin)
        self.later = sh.clamp(inverse * (1 + margin), -FAR, FAR)
        self.first = [sh.cond(inverse[axis] < 0, 2 * (axis + 3), 2 * axis) for axis in range(3)]  # -0.0 goes down too
        self.last = [4 * axis + 6 - first for axis, first in enumerate(self.first)]

    def keys(self, records: Any, row: Any, reach: Any) -> Any:
        """Return the keys of a node's boxes; see `keys_of`."""
        return keys_of(*self.boxes(records, row, reach))

    def bits(self, records: Any, row: Any, reach: Any) -> Any:
        """Return a bit for each of a node's boxes that is met, at the place that is the box's tag."""
        _, met, tags = self.boxes(records, row, reach)
        some = sh.cond(met, sh.Attrib8u(1) << tags, sh.Attrib8u(0))
        some = some | some[4, 5, 6, 7, 0, 1, 2, 3]
        some = some | some[2, 3, 0, 1, 6, 7, 4, 5]
        return (some | some[1, 0, 3, 2, 5, 4, 7, 6])[0]

    def boxes(self, records: Any, row: Any, reach: Any) -> tuple[Any, Any, Any]:
        """Return where a node's boxes begin, whether they are met before `reach`, and their tags."""

        def along(axis: int, side: Any, eye: Any, inverse: Any) -> Any:
            return (floats(records, row + side) - eye[axis]) * inverse[axis]

        x, y, z = (along(axis, self.first[axis], self.eye, self.sooner) for axis in range(3))
        begin = higher(higher(x, y), higher(z, self.near))
        x, y, z = (along(axis, self.last[axis], self.beyond, self.later) for axis in range(3))
        end = lower(lower(x, y), lower(z, reach))
        return begin, begin <= end, both_rows(records, row + TAGS)


class BlockTest:
    """`TriangleTest` for eight triangles at a time; the axes are turned by the choice of rows."""

    def __init__(self, ray: Any, eye: Any, near: Any, bound: AheadBound | None) -> None:
        self.near, self.bound = near, bound
        self.ray, self.eye = ray, eye
        self.sight = Sight(ray, eye)
        by_x, by_xy = self.sight.by_x, self.sight.by_xy
        self.rows = (sh.cond(by_x, 2, 0), sh.cond(by_xy, 4, 2), sh.cond(by_x, 0, sh.cond(by_xy, 2, 4)))

    def __call__(self, records: Any, row: Any, hit: Any) -> None:
        """Offer a block's triangles to `hit`; see `TriangleTest`."""
        sight = self.sight
        a, b, c = (self.corner(records, row + 6 * k) for k in range(3))
        wa, wb, wc = sight.edges(a, b, c)
        whole = wa + wb + wc
        met = same_side(wa, wb, wc) & (whole != 0)
        with SH_IF(sh.any(met)):
            normal, plane = self.plane(records, row)
            enter, leave = sight.span(a, b, c)
            t = within(enter, leave, sight.distance((wa, wb, wc), whole, (a[2], b[2], c[2]), plane))
            met = met & (t >= self.near) & meets(enter, leave, self.near)
            if self.bound is not None:
                met = met & self.bound(plane, normal, self.straight(records, row, a))
            numbers = sh.Attrib8i(both_rows(records, row + 2 * NUMBERS))
            for k in range(BLOCK):
                hit.offer(met[k], t[k], numbers[k], (wb[k], wc[k], whole[k]))

    def corner(self, records: Any, place: Any) -> list[Any]:
        """Return the turned coordinates of a corner of each triangle, relative to the ray's origin."""
        return [floats(records, place + self.rows[axis]) - self.sight.eye[axis] for axis in range(3)]

    def straight(self, records: Any, row: Any, corner: Sequence[Any]) -> list[Any]:
        """Return the coordinates of the first corner of each triangle, whose turned ones are those of `corner`."""
        return [floats(records, row + 2 * axis) - self.eye[axis] for axis in range(3)]

    def plane(self, records: Any, row: Any) -> tuple[list[Any], PlaneView]:
        """Return the unit normal of each triangle, and its plane."""
        normal = [floats(records, row + 2 * (NORMALS + k)) for k in range(3)]
        return normal, PlaneView(normal, floats(records, row + 2 * LEVEL), self.ray, self.eye)
