"""The stages of the staged tracer: the unified tracer's loops taken apart into kernels over streams of rays.

Stage: kernel. Christen 2005, chapter 5. A ray's state says which stage it needs next; a kernel rejects rays of other
states, and the number of elements that it wrote says how many there were. All arithmetic is the unified tracer's, which
both share: a stream holds what a variable holds there, to the bit.

    generate     makes the eye ray of each pixel: active
    precalculate finds the first cell of an active ray that has none yet: dead, wait or active
    objects      tries the objects that move, which are not in the grid: inactive for a shadow ray that met one
    traverse     goes on from cell to cell: wait where there are triangles; inactive or overflow at the end
    intersect    tries the triangles of a cell: inactive for a shadow ray that met one; else active
    shade        takes in what the ray met, and makes its pixel's next ray: active or finished
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast, get_type_hints

import shpy as sh
from raytracer.accel.programs import LateProgram
from raytracer.kernels.eye_rays import EyeRays, PanoramaRays
from raytracer.kernels.grid_walk import GridBeside, GridIntersector, is_over
from raytracer.kernels.interactions import PlainInteraction
from raytracer.kernels.pixel import Pixel
from raytracer.kernels.tracer import Light, Ray, Tracer
from raytracer.kernels.triangle import RayHit, TriangleTest, Walk, is_ray
from shpy import SH_DISCARD, SH_DO, SH_ELSE, SH_IF, SH_UNTIL

ACTIVE, WAIT, DEAD, INACTIVE, OVERFLOW, FINISHED = range(6)
"""States of a ray: on its way from cell to cell; has triangles to try; meets no cell; has its hit; has left the grid.
The last is that of a pixel: no more rays."""
AT_ONCE = 64
"""Cells or triangles that a ray goes through in one call, unless the Param `at_once` says otherwise."""


@sh.struct
class Cell:
    """The cell that a ray comes to next: see `CellWalk`."""

    t: sh.Attrib1f
    voxel: sh.Attrib3i


@sh.struct
class Items:
    """Triangles that are to be tried next."""

    item: sh.Attrib1i
    end: sh.Attrib1i


@sh.struct
class Nearest:
    """A `RayHit` in a stream."""

    l: sh.Attrib1f  # noqa: E741 - as in RayHit
    uv: sh.TexCoord2f
    id: sh.Attrib1i


class EyeRayOutputs(NamedTuple):
    """The outputs of the generator of eye rays."""

    ray: Ray
    light: Light
    pixel: Pixel
    state: sh.Attrib1i


class PrecalculationOutputs(NamedTuple):
    """The outputs of the voxel precalculation."""

    cell: Cell
    items: Items
    nearest: Nearest
    state: sh.Attrib1i


class ObjectsOutputs(NamedTuple):
    """The outputs of the walk through the objects that move."""

    nearest: Nearest
    state: sh.Attrib1i


class TraverserOutputs(NamedTuple):
    """The outputs of the traverser."""

    cell: Cell
    items: Items
    state: sh.Attrib1i


class IntersectorOutputs(NamedTuple):
    """The outputs of the intersector."""

    items: Items
    nearest: Nearest
    state: sh.Attrib1i


SHADED: dict[str, Any] = {"ray": Ray, "light": Light, "point": PlainInteraction, "pixel": Pixel, "state": sh.Attrib1i}
"""The outputs of shading."""


WRITES = {
    "generate": EyeRayOutputs._fields,
    "precalculate": PrecalculationOutputs._fields,
    "objects": ObjectsOutputs._fields,
    "traverse": TraverserOutputs._fields,
    "intersect": IntersectorOutputs._fields,
    "shade": tuple(SHADED),
}
"""The streams that a stage writes; those that it reads are its inputs."""


def programs(tracer: Tracer, rays: EyeRays | PanoramaRays) -> dict[str, Any]:
    """Record the programs of a tracer's stages; return them by name. Its accelerator is a grid.

    Where objects move beside the grid, they have a stage of their own.
    """
    walk, moving_objects = tracer.intersector, {}
    if isinstance(walk, GridBeside):
        moving_objects = {"objects": _objects(walk)}
        walk.grid.accept = walk.accept
        walk = walk.grid
    assert isinstance(walk, GridIntersector)
    at_once = sh.Param(sh.Attrib1i, AT_ONCE, name="at_once")
    return moving_objects | {
        "generate": generator(tracer, rays),
        "precalculate": _precalculation(walk),
        "traverse": _traverser(walk, at_once),
        "intersect": _intersector(walk, at_once),
        "shade": shading(tracer),
        "waiting": waiting.program,
        "moving": moving.program,
        "unfinished": unfinished.program,
    }


@LateProgram
def waiting(state: sh.Attrib1i) -> sh.Attrib1b:
    """Write True for the rays that wait for the intersector; the others are discarded."""
    SH_DISCARD(state != WAIT)
    return sh.Attrib1b(True)


@LateProgram
def moving(state: sh.Attrib1i) -> sh.Attrib1b:
    """Return whether rays are on their way."""
    return sh.Attrib1b((state == ACTIVE) | (state == WAIT))


@LateProgram
def unfinished(state: sh.Attrib1i) -> sh.Attrib1b:
    """Return whether pixels have rays that are on their way or have yet to be shaded."""
    return sh.Attrib1b(state != FINISHED)


@LateProgram
def active(state: sh.Attrib1i) -> sh.Attrib1b:
    """Return whether rays go from cell to cell."""
    return sh.Attrib1b(state == ACTIVE)


@LateProgram
def stopped(state: sh.Attrib1i) -> sh.Attrib1b:
    """Return whether rays have triangles to try."""
    return sh.Attrib1b(state == WAIT)


MASKS = {"precalculate": active, "traverse": active, "intersect": stopped, "shade": unfinished}
"""The program that tells the rays of a stage from the others, for the passes of early-z culling."""


def generator(tracer: Tracer, rays: EyeRays | PanoramaRays) -> Any:
    """Record the program that makes the eye rays of a band."""
    types = get_type_hints(EyeRayOutputs) | {"light": tracer.light_struct}
    outputs = cast(Any, NamedTuple("EyeRayOutputs", list(types.items())))

    def generate() -> Any:
        row, column = sh.grid_index(2)
        ray, light, pixel = tracer.begin(*rays(row, column))
        return outputs(ray, light, pixel, sh.Attrib1i(ACTIVE))

    generate.__annotations__ = {"return": outputs}
    return sh.program(generate)


def _precalculation(walk: GridIntersector) -> Any:
    @sh.program
    def precalculate(ray: Ray, state: sh.Attrib1i) -> PrecalculationOutputs:
        SH_DISCARD(state != ACTIVE)
        cells = walk.walk(ray.direction, ray.eye, 0.0)
        lost = ~is_ray(ray.direction, ray.eye) | (ray.limit <= 0)
        beside = cells.t >= cells.far
        state[:] = sh.cond(lost, DEAD, sh.cond(walk.outside > 0, WAIT, sh.cond(beside, DEAD, ACTIVE)))
        nearest = Nearest(ray.limit, sh.TexCoord2f(0, 0), sh.Attrib1i(-1))
        items = Items(sh.Attrib1i(0), sh.Attrib1i(walk.outside))
        return PrecalculationOutputs(Cell(cells.t, cells.voxel), items, nearest, state)

    return precalculate


def _objects(walk: GridBeside) -> Any:
    @sh.program
    def objects(ray: Ray, nearest: Nearest, state: sh.Attrib1i) -> ObjectsOutputs:
        SH_DISCARD(state == FINISHED)
        hit = RayHit.held_in(nearest, walk.accept)
        walk.objects.collect(hit, ray.direction, ray.eye, 0.0, 0.0, ~ray.tracing)
        state[:] = sh.cond(~ray.tracing & (nearest.id >= 0), INACTIVE, state)
        return ObjectsOutputs(nearest, state)

    return objects


def _traverser(walk: GridIntersector, at_once: Any) -> Any:
    @sh.program
    def traverse(ray: Ray, nearest: Nearest, cell: Cell, items: Items, state: sh.Attrib1i) -> TraverserOutputs:
        SH_DISCARD(state != ACTIVE)
        hit: Any = nearest
        cells = walk.walk(ray.direction, ray.eye, 0.0)
        cells.t[:] = cell.t
        cells.voxel[:] = cell.voxel
        steps = sh.Attrib1i(0)
        with SH_DO():
            with SH_IF(is_over(cells, hit)):
                state[:] = sh.cond(nearest.id >= 0, INACTIVE, OVERFLOW)
            with SH_ELSE():
                walk.enter(cells, items.item, items.end)
                state[:] = sh.cond(items.item < items.end, WAIT, ACTIVE)
            steps += 1
            SH_UNTIL((state != ACTIVE) | (steps >= at_once))
        return TraverserOutputs(Cell(cells.t, cells.voxel), items, state)

    return traverse


def meeting(walk: Walk) -> Any:
    """Record the program that traces a ray through more triangles and replaces its nearest hit by nearer ones."""

    @sh.program
    def meet(ray: Ray, nearest: Nearest) -> Nearest:
        hit = RayHit.held_in(nearest, walk.accept)
        walk.collect(hit, ray.direction, ray.eye, 0.0, 0.0, ~ray.tracing)
        return nearest

    return meet


def _intersector(walk: GridIntersector, at_once: Any) -> Any:
    @sh.program
    def intersect(ray: Ray, items: Items, nearest: Nearest, state: sh.Attrib1i) -> IntersectorOutputs:
        SH_DISCARD(state != WAIT)
        hit = RayHit.held_in(nearest, walk.accept)
        test = TriangleTest(ray.direction, ray.eye, walk.bound)
        tests = sh.Attrib1i(0)
        with SH_DO():
            walk.try_next(test, items.item, 0.0, hit)
            state[:] = sh.cond(items.item < items.end, WAIT, ACTIVE)
            with SH_IF(~ray.tracing & (nearest.id >= 0)):
                state[:] = INACTIVE
            tests += 1
            SH_UNTIL((state != WAIT) | (tests >= at_once))
        return IntersectorOutputs(items, nearest, state)

    return intersect


def shading(tracer: Tracer) -> Any:
    """Record the program that adds the light of the hits and makes the next rays."""
    types = SHADED | {"point": tracer.surfaces.interaction, "light": tracer.light_struct}
    shaded = cast(Any, NamedTuple("Shaded", list(types.items())))

    def shade(ray: Any, nearest: Any, light: Any, point: Any, pixel: Any, state: Any) -> Any:
        SH_DISCARD(state == FINISHED)
        finished = tracer.shade_hit(ray, light, point, pixel, RayHit.held_in(nearest))
        with SH_IF(finished):
            state[:] = FINISHED
        with SH_ELSE():
            state[:] = ACTIVE
            tracer.aim(ray, light, point)
        return shaded(ray, light, point, pixel, state)

    shade.__annotations__ = types | {"nearest": Nearest, "return": shaded}
    return sh.program(shade)
