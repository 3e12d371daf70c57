"""Programs that rasterise triangles into the three layered depth images of a cube: rows, spans, samples, coarse ranges.

Stage: kernel. Source: Bürger et al., GPU Rendering of Secondary Effects (VMV 2007), section 1.2. A triangle
goes only into the image across the largest component of its normal, so its depth changes by at most one side of a texel
along either side. Image 0, 1, 2 looks along x, y, z; its columns run along the next axis, its rows along the one after.

A triangle is cut into the rows of texels that it reaches, a row into a span of columns. Both are intervals because a
triangle is convex, so every texel of a span is a sample and nothing has to be sorted out. Ends of edges are taken in
one order, so that the two triangles of an edge have the same spans there.

With conservative rasterisation a triangle reaches each texel that it touches, and `MARGIN` farther, for rounding.
Without it, it reaches the texels whose centres it covers: of two triangles that share an edge in an image, one has a
centre on the edge, as intervals do not hold their ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import shpy as sh
from raytracer.accel.bounds import FAR, higher, highest, lower, lowest
from raytracer.accel.programs import LateProgram
from shpy import SH_FOR, SH_IF

MARGIN = 2.0**-6
"""The margin of a conservative triangle beyond its texels, in texels: more than the roundings of the walk."""
LOW, INVERSE, SIZE, SLACK, NEAREST, FARTHEST, HIGH, COUNTS = range(8)
"""Rows of a cube's `frame`: the corner of its box, 1 / texel, texel, the depth by which a surface may leave its sample
within a texel; the least and largest depth of samples in each image; the box's other corner; resolution, block,
blocks along a side, and slices for a texel's side."""
SLICES = 64
"""Slices of the box's depth, a bit of a block's coarse level for each: 1 where samples lie."""


class Rows(NamedTuple):
    """The rows that a triangle reaches: the first one, and how many."""

    first: sh.Attrib1i
    number: sh.Attrib1i


class Span(NamedTuple):
    """The columns that a triangle reaches within a row: the triangle, the row, the first column, and how many."""

    triangle: sh.Attrib1i
    row: sh.Attrib1i
    first: sh.Attrib1i
    number: sh.Attrib1i


class Sample(NamedTuple):
    """A sample: its texel among those of all images, its depth, its triangle, and its depth's change by a texel."""

    texel: sh.Attrib1i
    depth: sh.Attrib1f
    triangle: sh.Attrib1i
    slope: sh.Attrib2f


class Plane(NamedTuple):
    """A triangle's image, a corner of it there (column, row, depth), and its depth's change by a texel."""

    image: sh.Attrib1i
    corner: sh.Point3f
    slope: sh.Attrib2f


class Block(NamedTuple):
    """The coarse level of a block: the least and largest depth, and its occupied slices, the first one in bit 0.

    Of an empty block (FAR, -FAR) and no slices.
    """

    ends: sh.Attrib2f
    slices: sh.Attrib2u


class ProjectedTriangle:
    """A triangle as the image sees it: `corners` (column, row, depth) in texels and lengths; `axis`, -1 for no image.

    `slope` is how the depth changes by a texel along a row and along a column.
    """

    def __init__(self, triangles: Any, frame: Any, number: Any) -> None:
        rows = [triangles[3 * number + corner] for corner in range(3)]
        normal = sh.Vector3f(*(row.w for row in rows))
        axis = largest_axis(normal)
        across, down, along = turned(normal, axis)
        self.axis = sh.cond(along == 0, -1, axis)
        low, inverse = frame[LOW].xyz, frame[INVERSE].xyz
        self.corners = []
        for row in rows:
            place = (row.xyz - low) * inverse
            self.corners.append((*turned(place, axis)[:2], turned(row.xyz, axis)[2]))
        size = turned(frame[SIZE].xyz, axis)
        self.slope = (-across / along) * size[0], (-down / along) * size[1]

    def place_of(self, texel: Any, frame: Any) -> tuple[Any, Any]:
        """Return the column and row of one of its image's texels, which is known by its number among all images'."""
        resolution = sh.Attrib1i(frame[COUNTS].x)
        return texel % resolution, texel // resolution - self.axis * resolution

    def depth(self, column: Any, row: Any) -> Any:
        """Return the depth of the triangle's plane at the centre of a texel."""
        x, y, depth = self.corners[0]
        ahead = (sh.Attrib1f(column) + 0.5 - x) * self.slope[0]
        return depth + ahead + (sh.Attrib1f(row) + 0.5 - y) * self.slope[1]


def largest_axis(v: Any) -> Any:
    """Return the axis of a vector's largest component, the first of equal ones."""
    size = abs(v)
    return sh.cond((size.x >= size.y) & (size.x >= size.z), 0, sh.cond(size.y >= size.z, 1, 2))


def turned(v: Any, axis: Any) -> tuple[Any, Any, Any]:
    """Return the components of a vector along the columns, the rows and the depth of an image."""
    by_x, by_y = axis == 0, axis == 1
    return (
        sh.cond(by_x, v.y, sh.cond(by_y, v.z, v.x)),
        sh.cond(by_x, v.z, sh.cond(by_y, v.x, v.y)),
        sh.cond(by_x, v.x, sh.cond(by_y, v.y, v.z)),
    )


def texels_between(begin: Any, end: Any, resolution: Any, conservative: bool) -> tuple[Any, Any]:
    """Return the first texel that an interval reaches, and how many."""
    if conservative:
        first, last = sh.floor(begin - MARGIN), sh.floor(end + MARGIN)
    else:
        first, last = sh.ceil(begin - 0.5), sh.ceil(end - 0.5) - 1
    first, last = sh.max(sh.Attrib1i(first), 0), sh.min(sh.Attrib1i(last), resolution - 1)
    return first, sh.max(last - first + 1, 0)


def span_of(corners: Sequence[Any], low: Any, high: Any) -> tuple[Any, Any]:
    """Return the begin and end of a triangle along the columns, between two heights; where it is not, begin > end."""
    begin, end = sh.Attrib1f(FAR), sh.Attrib1f(-FAR)
    for k in range(3):
        (x0, y0, _), (x1, y1, _) = corners[k], corners[(k + 1) % 3]
        swapped = (y1 < y0) | ((y1 == y0) & (x1 < x0))
        (x0, y0), (x1, y1) = (
            (sh.cond(swapped, x1, x0), sh.cond(swapped, y1, y0)),
            (sh.cond(swapped, x0, x1), sh.cond(swapped, y0, y1)),
        )
        slope = (x1 - x0) / sh.cond(y1 > y0, y1 - y0, 1.0)
        left, right = lower(x0, x1), higher(x0, x1)
        first = sh.cond(y0 >= low, x0, sh.clamp(x0 + (low - y0) * slope, left, right))
        last = sh.cond(y1 <= high, x1, sh.clamp(x0 + (high - y0) * slope, left, right))
        with SH_IF((y1 >= low) & (y0 <= high)):
            begin[:] = lower(begin, lower(first, last))
            end[:] = higher(end, higher(first, last))
    return begin, end


@cache
def rows_of_triangles(conservative: bool) -> Any:
    """Record the program that gives the rows of each triangle."""

    @LateProgram
    def rows(triangles: sh.Table[sh.Attrib4f], frame: sh.Table[sh.Attrib4f]) -> Rows:
        seen = ProjectedTriangle(triangles, frame, sh.grid_index(1))
        heights = [corner[1] for corner in seen.corners]
        resolution = sh.Attrib1i(frame[COUNTS].x)
        first, count = texels_between(lowest(*heights), highest(*heights), resolution, conservative)
        return Rows(first, sh.cond(seen.axis < 0, 0, count))

    return rows


@cache
def spans_of_rows(conservative: bool) -> Any:
    """Record the program that gives the span of each row; `starts` is where each triangle's rows begin."""

    @LateProgram
    def spans(
        triangles: sh.Table[sh.Attrib4f],
        frame: sh.Table[sh.Attrib4f],
        number: sh.Attrib1i,
        starts: sh.Table[sh.Attrib1i],
        first_rows: sh.Table[sh.Attrib1i],
    ) -> Span:
        seen = ProjectedTriangle(triangles, frame, number)
        row = first_rows[number] + sh.grid_index(1) - starts[number]
        middle = sh.Attrib1f(row) + 0.5
        reach = 0.5 + MARGIN if conservative else 0.0
        begin, end = span_of(seen.corners, middle - reach, middle + reach)
        first, count = texels_between(begin, end, sh.Attrib1i(frame[COUNTS].x), conservative)
        return Span(number, row, first, sh.cond(begin <= end, count, 0))

    return spans


@LateProgram
def samples_of_spans(
    triangles: sh.Table[sh.Attrib4f],
    frame: sh.Table[sh.Attrib4f],
    number: sh.Attrib1i,
    starts: sh.Table[sh.Attrib1i],
    span_triangle: sh.Table[sh.Attrib1i],
    span_row: sh.Table[sh.Attrib1i],
    span_first: sh.Table[sh.Attrib1i],
) -> Sample:
    """Return the samples of all spans.

    `number` is the span of each, `starts` where each span's samples begin.
    """
    triangle, row = span_triangle[number], span_row[number]
    column = span_first[number] + sh.grid_index(1) - starts[number]
    seen = ProjectedTriangle(triangles, frame, triangle)
    resolution = sh.Attrib1i(frame[COUNTS].x)
    texel = (seen.axis * resolution + row) * resolution + column
    return Sample(texel, seen.depth(column, row), triangle, sh.Attrib2f(*seen.slope))


def bits_below(count: Any) -> Any:
    """Return the first bits of two words, as many as `count`, clamped to what they have."""
    inside = sh.clamp(count - sh.Attrib2i(0, 32), 0, 32)
    return sh.cond(inside == 32, sh.Attrib2u(0xFFFFFFFF), (sh.Attrib2u(1) << sh.Attrib2u(sh.min(inside, 31))) - 1)


@LateProgram
def planes_of_spans(triangles: sh.Table[sh.Attrib4f], frame: sh.Table[sh.Attrib4f], number: sh.Attrib1i) -> Plane:
    """Return the plane of the triangle of each span."""
    seen = ProjectedTriangle(triangles, frame, number)
    return Plane(seen.axis, sh.Point3f(*seen.corners[0]), sh.Attrib2f(*seen.slope))


@LateProgram
def samples_of_texels(
    triangles: sh.Table[sh.Attrib4f], frame: sh.Table[sh.Attrib4f], texel: sh.Attrib1i, triangle: sh.Attrib1i
) -> Sample:
    """Return the samples of texels that are known to be reached by triangles."""
    seen = ProjectedTriangle(triangles, frame, triangle)
    return Sample(texel, seen.depth(*seen.place_of(texel, frame)), triangle, sh.Attrib2f(*seen.slope))


@LateProgram
def weights_of_samples(
    triangles: sh.Table[sh.Attrib4f], frame: sh.Table[sh.Attrib4f], texel: sh.Attrib1i, triangle: sh.Attrib1i
) -> sh.TexCoord2f:
    """Return where samples lie in their triangles: the weights of corners 1 and 2.

    The centre of a texel that a triangle only touches is moved into the triangle.
    """
    seen = ProjectedTriangle(triangles, frame, triangle)
    column, row = seen.place_of(texel, frame)
    middle = sh.Attrib2f(sh.Attrib1f(column) + 0.5, sh.Attrib1f(row) + 0.5)
    b, c, whole = weights_at([(x - middle.x, y - middle.y) for x, y, _ in seen.corners])
    return sh.TexCoord2f(b / whole, c / whole)


def weights_at(corners: Sequence[tuple[Any, Any]]) -> tuple[Any, Any, Any]:
    """Return the weights of corners 1 and 2, and of all, at the origin of two axes moved into a triangle."""
    (ax, ay), (bx, by), (cx, cy) = corners
    weights = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
    side = sh.cond(weights[0] + weights[1] + weights[2] < 0, -1.0, 1.0)
    a, b, c = (higher(side * weight, 0.0) for weight in weights)
    whole = a + b + c
    return b, c, sh.cond(whole > 0, whole, 1.0)


@LateProgram
def coarse_blocks(frame: sh.Table[sh.Attrib4f], offsets: sh.Table[sh.Attrib1i], depths: sh.Table[sh.Attrib1f]) -> Block:
    """Return the coarse level of each block of texels, over all layers."""
    resolution, block, blocks = (sh.Attrib1i(frame[COUNTS][k]) for k in range(3))
    number = sh.grid_index(1)
    image, place = number // (blocks * blocks), number % (blocks * blocks)
    top, left = place // blocks * block, place % blocks * block
    low, inverse = (turned(frame[k].xyz, image)[2] for k in (LOW, INVERSE))
    inverse = inverse * frame[COUNTS].w
    ends, slices = sh.Attrib2f(FAR, -FAR), sh.Attrib2u(0)
    width = sh.min(block, resolution - left)
    with SH_FOR(top, sh.min(top + block, resolution)) as row:
        texel = (image * resolution + row) * resolution + left
        with SH_FOR(texel, texel + width) as here:
            begin, end = offsets[here], offsets[here + 1]
            with SH_FOR(begin, end) as item:
                depth = depths[item]
                ends.x = lower(ends.x, depth)
                ends.y = higher(ends.y, depth)
                slice = sh.Attrib1i((depth - low) * inverse)
                slices |= bits_below(slice + 1) & ~bits_below(slice)
    return Block(ends, slices)


@LateProgram
def added(a: sh.Attrib1i, b: sh.Attrib1i) -> sh.Attrib1i:
    """Add two counts."""
    return a + b


@LateProgram
def larger(a: sh.Attrib1i, b: sh.Attrib1i) -> sh.Attrib1i:
    """Return the larger of two numbers."""
    return sh.max(a, b)


@LateProgram
def numbered() -> sh.Attrib1i:
    """Return the place of each element."""
    return sh.grid_index(1)
