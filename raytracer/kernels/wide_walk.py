"""What one ray meets first: four boxes at a time, and four triangles at a time.

Stage: kernel, for rays that have little in common with their neighbours. A vector of four holds what four boxes or
triangles say to one ray, so a CPU's vectors are full though the ray walks alone. Boxes that the ray meets are put on a
stack, the farthest first, and are looked into unless a hit has been found before them.

What is computed of a triangle is what `TriangleTest` computes, to the bit, and so is the hit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.bvh import Bvh
from raytracer.accel.wide import BASES, BLOCKS_FROM, LEAF, NUMBERS, TAGS, WIDTH, widen
from raytracer.kernels.bvh_walk import MARGIN
from raytracer.kernels.triangle import FAR, Hit, Sight, farther, higher, inverse_of, is_ray, lower, product, same_side
from shpy import SH_DO, SH_IF, SH_UNTIL, SH_WHILE

ROWS_OF_A_NODE = 8
ROWS_OF_A_BLOCK = 10
NONE = 0xFFFFFFFF
"""The key of a box that is not met: it comes after all others."""
LEAST = 2.0**-126
"""Farther than 0 by more than a tag adds to a key."""
END = -(1 << 31) + 1
"""The code at the bottom of the stack."""


class WideIntersector:
    """The tables of the wide form of a hierarchy over `triangles` (see `layout.triangle_rows`), and the walk.

    It works at f32, on ranges that begin at 0 or beyond.
    """

    def __init__(self, bvh: Bvh, triangles: NDArray[Any]) -> None:
        wide = widen(bvh, np.reshape(triangles, (-1, 3, 4))[..., :3])
        self.triangles = sh.Table(triangles, sh.Attrib4f, "triangles")
        self.nodes = sh.Table(wide.nodes.reshape(-1, WIDTH), sh.Attrib4u, "nodes")
        self.blocks = sh.Table(wide.blocks.reshape(-1, WIDTH), sh.Attrib4u, "blocks")
        self.deepest = (WIDTH - 1) * wide.depth + 2
        self.margin = MARGIN * float(np.finfo(np.float32).eps)

    def __call__(self, ray: Any, eye: Any, near: Any, limit: Any, any_hit: Any) -> Hit:
        """The nearest hit at a distance in [near, limit); where `any_hit` holds, the first that is found."""
        hit = Hit(limit)
        node = NodeTest(ray, eye, near, self.margin)
        block = BlockTest(ray, eye, near)
        stack = Stack(self.deepest)
        reach = farther(limit) + LEAST
        code = sh.Attrib1i(0)
        with SH_IF((near < limit) & is_ray(ray, eye)), SH_DO():
            with SH_WHILE(lambda: code >= 0):
                keys, inner, leaves = node(self.nodes, ROWS_OF_A_NODE * code, reach)
                codes = [code_of(key, inner, leaves) for key in keys]
                with SH_IF(keys[2] != NONE):  # more than two are met seldom enough for a branch
                    stack.push(keys[3], codes[3])
                    stack.push(keys[2], codes[2])
                stack.push(keys[1], codes[1])
                code[:] = codes[0]
                with SH_IF(keys[0] == NONE):
                    stack.pop(code, reach)
            with SH_IF(code != END):
                block(self.blocks, ROWS_OF_A_BLOCK * (code - BLOCKS_FROM), hit)
                reach[:] = farther(hit.l) + LEAST
                stack.pop(code, reach)
            SH_UNTIL((code == END) | (any_hit & (hit.id >= 0)))
        return hit


def code_of(key: Any, inner: Any, leaves: Any) -> Any:
    """The code of a box, by the tag in its key."""
    return sh.cond((key & LEAF) != 0, leaves, inner) + sh.Attrib1i(key & (WIDTH - 1))


class Stack:
    """What is still to be looked into, each with the distance where it begins."""

    def __init__(self, size: int) -> None:
        codes = sh.Array(sh.Attrib1i, size)
        begins = sh.Array(sh.Attrib1f, size)
        top = sh.Attrib1i(1)
        codes[0] = END
        begins[0] = -FAR
        self.codes, self.begins, self.top = codes, begins, top

    def push(self, key: Any, code: Any) -> None:
        """Put a box on the stack if it is met: without a branch, which nobody could foresee."""
        self.codes[self.top] = code
        self.begins[self.top] = sh.float_from_bits(key)
        self.top += sh.cond(key != NONE, 1, 0)

    def pop(self, code: Any, reach: Any) -> None:
        """Take off what begins beyond `reach`, and store the code of the first that does not."""
        with SH_DO():
            self.top -= 1
            SH_UNTIL(self.begins[self.top] <= reach)
        code[:] = self.codes[self.top]


class NodeTest:
    """What a ray needs to be tried against four boxes at a time.

    Which side of a box a ray comes to first is known from the ray's sign, so `first` and `last` are rows of a node.
    """

    def __init__(self, ray: Any, eye: Any, near: Any, margin: float) -> None:
        inverse = inverse_of(ray)
        self.eye, self.near = eye, near
        self.sooner = inverse * (1 - margin)
        self.later = sh.clamp(inverse * (1 + margin), -FAR, FAR)
        self.first = [sh.cond(inverse[axis] < 0, axis + 3, axis) for axis in range(3)]  # -0.0 goes down too
        self.last = [2 * axis + 3 - first for axis, first in enumerate(self.first)]

    def __call__(self, nodes: Any, row: Any, reach: Any) -> tuple[list[Any], Any, Any]:
        """The keys of a node's boxes, nearest first, and the codes from which its children are counted.

        A key is where the box begins, its last bits the box's tag; NONE for a box that is not met.
        """
        enter, leave = sh.Attrib4f(self.near), sh.Attrib4f(reach)
        for axis in range(3):
            side = sh.float_from_bits(nodes[row + self.first[axis]])
            enter = higher((side - self.eye[axis]) * self.sooner[axis], enter)
        for axis in range(3):
            side = sh.float_from_bits(nodes[row + self.last[axis]])
            leave = lower((side - self.eye[axis]) * self.later[axis], leave)
        tagged = (sh.bits_from_float(enter) & (NONE - 2 * LEAF + 1)) | nodes[row + TAGS]
        bases = sh.Attrib4i(nodes[row + BASES])
        return sorted_keys(sh.cond(enter <= leave, tagged, sh.Attrib4u(NONE))), bases.x, bases.y


def sorted_keys(keys: Any) -> list[Any]:
    """The four components in ascending order: a sorting network, as far as it goes on vectors."""
    low, high = sh.min(keys, keys.yxwz), sh.max(keys, keys.yxwz)
    second, third = sh.max(low, low.zwxy).x, sh.min(high, high.zwxy).x
    least, greatest = sh.min(low, low.zwxy).x, sh.max(high, high.zwxy).x
    return [sh.Attrib1u(key) for key in (least, sh.min(second, third), sh.max(second, third), greatest)]


class BlockTest:
    """`TriangleTest` for four triangles at a time; the axes are turned by the choice of rows."""

    def __init__(self, ray: Any, eye: Any, near: Any) -> None:
        self.near = near
        self.sight = Sight(ray, eye)
        by_x, by_xy = self.sight.by_x, self.sight.by_xy
        self.rows = (sh.cond(by_x, 1, 0), sh.cond(by_xy, 2, 1), sh.cond(by_x, 0, sh.cond(by_xy, 1, 2)))

    def __call__(self, blocks: Any, row: Any, hit: Hit) -> None:
        """Store a block's triangle in `hit` if the ray meets it; see `TriangleTest`."""
        sight = self.sight
        a, b, c = ([self.side(blocks, row + 3 * k, axis) for axis in range(3)] for k in range(3))
        wa, wb, wc = sight.edges(a, b, c)
        whole = wa + wb + wc
        t = product((wa, wb, wc), (a[2], b[2], c[2])) / (whole * sight.pace)
        met = same_side(wa, wb, wc) & (whole != 0) & (t >= self.near) & (t <= hit.l)
        with SH_IF(met.x | met.y | met.z | met.w):
            t = higher(t, sight.begin(a, b, c))
            numbers = sh.Attrib4i(blocks[row + NUMBERS])
            for k in range(WIDTH):
                nearer = (t[k] < hit.l) | ((t[k] == hit.l) & (numbers[k] < hit.id))
                with SH_IF(met[k] & nearer):
                    hit.l[:] = t[k]
                    hit.uv[:] = sh.TexCoord2f(wb[k], wc[k]) / whole[k]
                    hit.id[:] = numbers[k]

    def side(self, blocks: Any, row: Any, axis: int) -> Any:
        """A coordinate of a corner of each triangle, relative to the ray's origin."""
        return sh.float_from_bits(blocks[row + self.rows[axis]]) - self.sight.eye[axis]
