"""The walk through a layered depth cube: its samples, block by block and texel by texel.

Stage: kernel. Source: Bürger et al., GPU Rendering of Secondary Effects (VMV 2007), section 1.4. The images are walked
one after the other, each hit shortening the rest of the way; first that along the ray's largest component, where the
way through the texels is shortest. Both levels are a DDA in two dimensions (Amanatides and Woo 1987), whose crossings
are computed anew from the integer cell, so that nothing drifts. A block or texel is visited if the ray's depths there
are close enough to its samples' depths for a surface to be met.

The walk begins where the ray enters the cube's box. That point is rounded once, so it lies on the ray however far away
the ray comes from. Triangles are tested along the ray as it was given: a hit of theirs has the bits of other walks.
Those that the cube leaves out are tried at the end.
"""

from __future__ import annotations

from typing import Any

import shpy as sh
from raytracer.accel.bounds import FAR, higher, highest, lower, lowest
from raytracer.kernels.layered_samples import Sample, sample_tables
from raytracer.kernels.triangle import (
    AheadBound,
    PlaneView,
    Triangles,
    TriangleTest,
    Walk,
    farther,
    inverse_of,
    is_ray,
)
from raytracer.layered import raster
from raytracer.layered.cube import LayeredCube
from raytracer.layered.placed import PlacedCubes
from shpy import SH_BREAK, SH_DO, SH_FOR, SH_IF, SH_UNTIL, SH_WHILE

ROUNDED = 2.0**-8
"""The error bound of a depth, in slices."""
CLOSE, CLOSER = 4.0, 2.0
"""The distance within which a ray that leaves a surface hits no sample, in half the sum of a texel's sides, or in the
tolerance if that is larger; the second one for planes of triangles that cover the texel's centre.

There the plane of a neighbour of its triangle may lie ahead, though the neighbour itself does not reach so far. A hit
is moved into its triangle (`DepthTest.finish`) by less than this, at most 3.7 and 1.5: so a ray that goes on from hit
to hit, through glass, comes to an end.
"""
OUTSIDE = 2.0**-20
"""The margin before and behind the box at which the walk begins and ends, as a part of the distance: 16 roundings."""


class LayeredIntersector(Walk):
    """The tables of a cube over `triangles` (see `triangle_rows`), and the walk through them.

    `bound` is for rays that may start from a triangle. The cubes of objects that move are walked one after the other,
    with the ray as it is seen from each; planes and triangles are tested where they are in the scene. With `notes` a
    hit keeps the number of its sample, -1 for a triangle without samples.
    """

    def __init__(
        self,
        cube: LayeredCube | PlacedCubes,
        triangles: Any,
        bound: AheadBound | None = None,
        *,
        notes: bool = False,
    ) -> None:
        self.notes = notes
        self.poses: Any = None
        if isinstance(cube, LayeredCube):
            cube.check_triangles(triangles)
        else:
            self.poses = sh.Table(cube.poses, sh.Attrib4f, "poses", unique=False)
            cubes = sh.Param(sh.Attrib1i, len(cube.cubes), title="")
            self.cubes = cubes
        self.bound, self.test, self.conservative = bound, cube.options["hit"], cube.options["conservative"]
        self.triangles = Triangles.of(triangles)
        self.frame = sh.Table(cube.frame, sh.Attrib4f, "frame", unique=False)
        self.blocks = sh.Table(cube.blocks, sh.Attrib4u, "blocks", unique=False)
        self.outside = sh.Table(cube.outside, sh.Attrib1i, "outside", unique=False) if len(cube.outside) else None
        left_out = sh.Param(sh.Attrib1i, len(cube.outside), title="")
        self.left_out = left_out
        self.samples: Any = sample_tables(cube)

    def collect(self, hit: Any, ray: Any, eye: Any, near: Any, begin: Any, any_hit: Any) -> None:
        """Update `hit` with the samples that the ray hits at a distance in [near, hit.l), for texels from `begin` on.

        A triangle is tested once for each of its samples.
        """
        if self.poses is None:
            self.collect_from(CubeTables(self.frame), hit, ray, eye, near, begin, any_hit, (ray, eye))
        else:
            with SH_FOR(0, self.cubes) as k:
                SH_BREAK(any_hit & (hit.id >= 0))
                rows = [self.poses[3 * k + axis] for axis in range(3)]
                seen = sh.Vector3f(*(sh.dot(row.xyz, ray) for row in rows))
                place = sh.Point3f(*(sh.dot(row.xyz, eye) + row.w for row in rows))
                self.collect_from(CubeTables(self.frame, k), hit, ray, eye, near, begin, any_hit, (seen, place))
        if self.outside is not None:
            self.try_outside(self.outside, hit, ray, eye, near, any_hit)

    def collect_from(
        self, cube: CubeTables, hit: Any, ray: Any, eye: Any, near: Any, begin: Any, any_hit: Any, seen: tuple[Any, Any]
    ) -> None:
        """Update `hit` from one cube; `seen` is the ray's direction and origin in the cube's coordinates."""
        frame, (heading, place) = cube, seen
        low, high = frame[raster.LOW].xyz, frame[raster.HIGH].xyz
        inverse = inverse_of(heading)
        t0, t1 = (low - place) * inverse, (high - place) * inverse
        enter = highest(begin, *(lower(t0[k], t1[k]) for k in range(3)))
        leave = lowest(hit.l, *(higher(t0[k], t1[k]) for k in range(3)))
        enter, leave = higher(enter - OUTSIDE * abs(enter), begin), leave + OUTSIDE * abs(leave)
        with SH_IF((near < hit.l) & (enter <= leave) & is_ray(ray, eye)):
            begin_at = sh.Attrib1f(enter)
            way = Way(hit, ray, eye, near, begin_at, leave - begin_at, seen)
            test = TESTS[self.test](self, way)
            major = raster.largest_axis(heading)
            with SH_FOR(0, 3) as k:
                axis = sh.cond(major + k >= 3, major + k - 3, major + k)
                self.walk(ImageRay(frame, way, axis, self.samples.coding(frame, axis)), test, any_hit)
                SH_BREAK(any_hit & (hit.id >= 0))
            test.finish()

    def renew(self, cubes: PlacedCubes) -> None:
        """Update the poses."""
        assert self.poses is not None
        self.poses.update(cubes.poses)

    def try_outside(self, numbers: Any, hit: Any, ray: Any, eye: Any, near: Any, any_hit: Any) -> None:
        """Update `hit` with the triangles that have no samples."""
        with SH_IF((near < hit.l) & is_ray(ray, eye)):
            test = TriangleTest(ray, eye, self.bound)
            with SH_FOR(0, self.left_out) as k:
                SH_BREAK(any_hit & (hit.id >= 0))
                test(self.triangles, numbers[k], near, hit)
                if self.notes:
                    hit.sample[:] = sh.cond(hit.id == numbers[k], -1, hit.sample)

    def walk(self, image: ImageRay, test: Any, any_hit: Any) -> None:
        """Walk through the blocks of an image."""
        hit = image.way.hit
        blocks = Cells(image, image.begin(), image.block, sh.Attrib2i(0, 0), image.blocks - 1)
        with SH_DO():
            with SH_WHILE(lambda: blocks.t <= image.end()):
                blocks.look()
                number = (image.axis * image.blocks + blocks.cell.y) * image.blocks + blocks.cell.x
                block = self.blocks[image.frame.block(number, image.blocks)]
                SH_BREAK(image.reaches_block(blocks.t, blocks.out, block))
                blocks.advance()
            with SH_IF(blocks.t <= image.end()):
                self.walk_block(image, blocks, test, any_hit)
                blocks.advance()
            SH_UNTIL((blocks.t > image.end()) | (any_hit & (hit.id >= 0)))

    def walk_block(self, image: ImageRay, blocks: Cells, test: Any, any_hit: Any) -> None:
        """Walk through the texels of a block, and test their samples."""
        first = blocks.cell * image.block
        last = sh.min(first + image.block, image.resolution) - 1
        texels = Cells(image, blocks.t, sh.Attrib1i(1), first, last)
        item, end, far = sh.Attrib1i(0), sh.Attrib1i(0), sh.Attrib1f(0)
        hit = image.way.hit
        with SH_DO():
            with SH_WHILE(lambda: texels.t <= image.end()):
                texels.look()
                number = (image.axis * image.resolution + texels.cell.y) * image.resolution + texels.cell.x
                texel = image.frame.texel(number, image.resolution)
                item[:] = self.samples.offset(texel)
                end[:] = self.samples.offset(texel + 1)
                near, beyond = image.depths(texels.t, texels.out)
                far[:] = beyond
                self.skip(image, item, end, near)
                SH_BREAK((item < end) & (self.depth(image, item) <= far))
                texels.advance()
            with SH_WHILE(lambda: (item < end) & (self.depth(image, item) <= far)):
                self.try_sample(test, image, texels, item)
                item += 1
            texels.advance()
            SH_UNTIL((texels.t > image.end()) | (any_hit & (hit.id >= 0)))

    def try_sample(self, test: Any, image: ImageRay, texels: Cells, item: Any) -> None:
        """Try a sample; note it where it is hit, or where the ray comes to a hit of its triangle in this texel.

        The exact test finds a triangle by its first sample on the way, and the hit may lie texels ahead.
        """
        sample = self.samples.sample(item, image.coding)
        hit = image.way.hit
        if not self.notes:
            test(image, texels, sample)
            return
        reach = sh.Attrib1f(hit.l)
        test(image, texels, sample)
        is_own = hit.id == sample.number
        is_here = (hit.l < reach) | (texels.t <= hit.l - image.way.begin)
        hit.sample[:] = sh.cond(is_own & is_here, item, hit.sample)

    def skip(self, image: ImageRay, item: Any, end: Any, near: Any) -> None:
        """Go on to the first of a texel's samples at the depth `near` or beyond, by bisection."""
        last = sh.Attrib1i(end)
        with SH_WHILE(lambda: item < last):
            middle = (item + last) >> 1
            before = self.depth(image, middle) < near
            item[:] = sh.cond(before, middle + 1, item)
            last[:] = sh.cond(before, last, middle)

    def depth(self, image: ImageRay, item: Any) -> Any:
        """Return the depth of a sample."""
        return self.samples.depth(item, image.coding)


class CubeTables:
    """The rows of the raster of a cube, and its places in the tables of several; `number` is None for the only one."""

    def __init__(self, frame: Any, number: Any = None) -> None:
        self.frame, self.number = frame, number

    def __getitem__(self, row: int) -> Any:
        """Return a row of the raster."""
        return self.frame[row] if self.number is None else self.frame[8 * self.number + row]

    def block(self, number: Any, side: Any) -> Any:
        """Return the place of a block; there are `side` along a side of each image."""
        return number if self.number is None else number + self.number * (3 * side * side)

    def texel(self, number: Any, side: Any) -> Any:
        """Return the place of a texel; the end of the last one's samples follows those of a cube."""
        return number if self.number is None else number + self.number * (3 * side * side + 1)


class Way:
    """A ray's way through the box: from `begin` on as a point `start`, and the distance from there to its `end`.

    `seen` are its direction and origin as they are seen from the cube.
    """

    def __init__(self, hit: Any, ray: Any, eye: Any, near: Any, begin: Any, end: Any, seen: tuple[Any, Any]) -> None:
        self.hit, self.ray, self.eye, self.near, self.begin = hit, ray, eye, near, begin
        self.heading, place = seen
        self.start = sh.Point3f(*(sh.fma(begin, self.heading[k], place[k]) for k in range(3)))
        rest = sh.Attrib1f(end)
        self.end = rest

    def shorten(self) -> None:
        """Let the way end behind the nearest hit."""
        self.end[:] = lower(self.end, farther(self.hit.l) - self.begin)


class ImageRay:
    """A ray in the coordinates of an image: column, row and depth at its start, and how they change along it.

    `coding` decodes the image's depths; see `layered_samples`.
    """

    def __init__(self, frame: CubeTables, way: Way, axis: Any, coding: Any) -> None:
        self.frame, self.way, self.axis, self.coding = frame, way, axis, coding
        inverse = frame[raster.INVERSE].xyz
        self.resolution, self.block, self.blocks = (sh.Attrib1i(frame[raster.COUNTS][k]) for k in range(3))
        x, y, _ = raster.turned((way.start - frame[raster.LOW].xyz) * inverse, axis)
        dx, dy, _ = raster.turned(way.heading * inverse, axis)
        self.place, self.pace = sh.Attrib2f(x, y), sh.Attrib2f(dx, dy)
        self.depth, self.deepening = raster.turned(way.start, axis)[2], raster.turned(way.heading, axis)[2]
        self.per_depth = sh.clamp(1 / self.deepening, -FAR, FAR)
        self.slack, self.low, self.high = (
            raster.turned(frame[k].xyz, axis)[2] for k in (raster.SLACK, raster.NEAREST, raster.FARTHEST)
        )
        across, down, _ = raster.turned(frame[raster.SIZE].xyz, axis)
        self.coarseness = higher((across + down) / 2, self.slack)
        self.moving = self.pace != 0
        self.inverse = 1 / sh.cond(self.moving, self.pace, 1.0)
        self.step = sh.Attrib2i(sh.sign(self.pace))
        self.ahead = sh.max(self.step, 0)
        self.low_end, per_slice = (raster.turned(frame[k].xyz, axis)[2] for k in (raster.LOW, raster.INVERSE))
        self.slices = per_slice * frame[raster.COUNTS].w
        # Where the ray goes through the depths of the image's samples.
        ends = [(depth - self.depth) * self.per_depth for depth in (self.low - self.slack, self.high + self.slack)]
        self.first = sh.Attrib1f(higher(lower(*ends), 0.0))
        self.last = sh.Attrib1f(sh.cond(self.low <= self.high, higher(*ends), -1.0))

    def begin(self) -> Any:
        """Return the distance at which the walk begins."""
        return sh.Attrib1f(self.first)

    def end(self) -> Any:
        """Return the distance at which the walk ends."""
        return lower(self.way.end, self.last)

    def at(self, t: Any) -> Any:
        """Return the column and row at a distance from the start."""
        return self.place + t * self.pace

    def depths(self, begin: Any, end: Any) -> tuple[Any, Any]:
        """Return the least and the largest depth of samples to which the ray comes near between two distances."""
        a, b = self.depth + begin * self.deepening, self.depth + lower(end, self.end()) * self.deepening
        return lower(a, b) - self.slack, higher(a, b) + self.slack

    def reaches_block(self, begin: Any, end: Any, block: Any) -> Any:
        """Return whether the ray comes near a block's range of depths between two distances."""
        near, far = self.depths(begin, end)
        first, last = ((depth - self.low_end) * self.slices for depth in (near, far))
        up_to = raster.bits_below(sh.Attrib1i(last + ROUNDED) + 1)
        crossed = up_to & ~raster.bits_below(sh.Attrib1i(sh.floor(first - ROUNDED)))
        found = crossed & block.zw
        low, high = sh.float_from_bits(block.x), sh.float_from_bits(block.y)
        return (near <= high) & (far >= low) & ((found.x | found.y) != 0)


class Cells:
    """The cells, `side` texels wide, that a ray goes through: it is in `cell` from the distance `t` on until `out`.

    They are those from `first` to `last`; beyond them `t` is FAR.
    """

    def __init__(self, image: ImageRay, t: Any, side: Any, first: Any, last: Any) -> None:
        self.image, self.side, self.first, self.last = image, side, first, last
        here, out = sh.Attrib1f(t), sh.Attrib1f(FAR)
        crossing = sh.Attrib2f(FAR, FAR)
        cell = sh.clamp(sh.Attrib2i(image.at(t) / sh.Attrib1f(side)), first, last)
        self.t, self.out, self.crossing, self.cell = here, out, crossing, cell

    def look(self) -> None:
        """Find the distance at which the ray leaves the cell."""
        image = self.image
        side = sh.Attrib2f((self.cell + image.ahead) * self.side)
        self.crossing[:] = sh.cond(image.moving, (side - image.place) * image.inverse, FAR)
        self.out[:] = lower(self.crossing.x, self.crossing.y)

    def advance(self) -> None:
        """Go on to the next cell, or diagonally where two borders meet."""
        self.cell += sh.cond(self.crossing <= self.out, self.image.step, 0)
        beyond = (self.cell < self.first) | (self.cell > self.last)
        self.t[:] = sh.cond(beyond.x | beyond.y, FAR, self.out)


class ExactTest:
    """The exact test of a sample's triangle."""

    def __init__(self, walk: LayeredIntersector, way: Way) -> None:
        self.way, self.triangles = way, walk.triangles
        self.test = TriangleTest(way.ray, way.eye, walk.bound)

    def __call__(self, image: ImageRay, texels: Cells, sample: Sample) -> None:
        """Try the triangle."""
        self.test(self.triangles, sample.number, self.way.near, self.way.hit)
        self.way.shorten()

    def finish(self) -> None:
        """Leave the hit as it is."""


class DepthTest:
    """The hit test "sample": within the texel, the ray's depth comes as near to the sample's as the tolerance."""

    def __init__(self, walk: LayeredIntersector, way: Way) -> None:
        self.way, self.triangles, self.bound = way, walk.triangles, walk.bound
        self.pace = sh.length(way.heading)
        self.close = CLOSER if walk.test == "plane" and not walk.conservative else CLOSE

    def __call__(self, image: ImageRay, texels: Cells, sample: Sample) -> None:
        """Offer the sample to the way's hit."""
        depth = sample.depth
        s = sh.clamp((depth - image.depth) * image.per_depth, texels.t, lower(texels.out, image.end()))
        self.offer(image, abs(image.depth + s * image.deepening - depth) <= image.slack, s, sample.number)

    def offer(self, image: ImageRay, met: Any, s: Any, number: Any) -> None:
        """Offer what is `met` at a distance from the way's start, unless it may be the surface that the ray left."""
        way = self.way
        t = way.begin + s
        met = met & (t >= way.near)
        with SH_IF(met & (t < way.hit.l)):
            if self.bound is not None:
                met = met & (t * self.pace >= self.close * image.coarseness)
                rows = self.triangles[number]
                normal = [row.w for row in rows]
                plane = PlaneView(normal, self.triangles.levels[number], way.ray, way.eye)
                met = met & self.bound(plane, normal, rows[0].xyz - way.eye)
            way.hit.offer(met, t, number, (0.0, 0.0, 1.0) if way.hit.accept is None else self.weights(number, t))
            way.shorten()

    def finish(self) -> None:
        """Give the hit its place in its triangle."""
        hit = self.way.hit
        if hit.accept is not None:
            return
        with SH_IF(hit.id >= 0):
            b, c, whole = self.weights(hit.id, hit.l)
            hit.uv[:] = sh.TexCoord2f(b, c) / whole

    def weights(self, number: Any, t: Any) -> tuple[Any, Any, Any]:
        """Return the weights of corners 1 and 2, and of all, at the ray's point moved in its image into a triangle."""
        rows = self.triangles[number]
        axis = raster.largest_axis(sh.Vector3f(*(row.w for row in rows)))
        point = self.way.eye + t * self.way.ray
        return raster.weights_at([raster.turned(row.xyz - point, axis)[:2] for row in rows])


class PlaneTest(DepthTest):
    """The test of the plane of a sample's triangle, within the sample's texel."""

    def __call__(self, image: ImageRay, texels: Cells, sample: Sample) -> None:
        """Offer the plane to the way's hit."""
        depth, slope = sample.depth, sample.slope
        middle = sh.Attrib2f(texels.cell) + 0.5
        s = (depth - image.depth + sh.dot(slope, image.place - middle)) / (image.deepening - sh.dot(slope, image.pace))
        beside = abs(image.at(s) - middle)
        met = (beside.x <= 0.5 + raster.MARGIN) & (beside.y <= 0.5 + raster.MARGIN)
        self.offer(image, met, s, sample.number)


TESTS: dict[str, Any] = {"sample": DepthTest, "plane": PlaneTest, "triangle": ExactTest}
"""By the cube's `hit`."""
