"""A part of a scene in a worker: its triangles with an accelerator of their own, and its work on rays.

Stage: cluster. The stages are those of the staged tracer (`kernels.stages`), so the pictures are the same to the bit.
A ray visits parts one after the other, as it enters their boxes, and takes its nearest hit along; of triangles at the
same distance the lowest number of the whole scene is hit, in whatever order it comes to them. A record holds all that
its pixel needs: the ray, its nearest hit so far, the light and the layers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.choice import build
from raytracer.cluster.job import probed
from raytracer.integrators.integrator import Whitted
from raytracer.kernels import stages
from raytracer.kernels.bvh_walk import BvhIntersector
from raytracer.kernels.eye_rays import eye_rays_of
from raytracer.kernels.pixel import Pixel
from raytracer.kernels.tracer import Tracer
from raytracer.kernels.triangle import REACH
from raytracer.scene.camera import Camera
from raytracer.scene.layout import Layout
from raytracer.scene.lights import EnvironmentLight

SLACK = 2 * REACH
"""The part of a distance by which a part's box is taken to begin earlier and to end later."""
AT_ONCE = 1 << 20
"""Pairs of a ray and a box that are computed at once."""
GROWTH = 2.0**-16
"""The fraction of the largest coordinate by which boxes are grown: many roundings of f32, one rounding of f16."""


@dataclass(frozen=True, eq=False)
class PartData:
    """The layout of the part `number` of a scene, and what all parts share, as a worker is sent them.

    `numbers` are those of its triangles in the whole scene, ascending; `low` and `high` (k, 3) are the boxes of all
    parts; `black` is `SurfaceTables.black` of the whole scene, and `uniforms` are those of its eye rays.
    """

    number: int
    layout: Layout
    numbers: NDArray[np.int32]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    black: bool
    camera: Camera
    background: Any
    ambient: float
    environment: EnvironmentLight | None
    uniforms: dict[str, Any]
    integrator: Whitted
    backend: str


@dataclass
class StepResult:
    """The records that go to each other part, those that are finished, and the fingerprint of the worker's arithmetic.

    `visits` counts the rays that were intersected.
    """

    sent: dict[int, Records]
    done: Records
    visits: int
    fingerprint: str


class Part:
    """The compiled stages of a part."""

    def __init__(self, data: PartData) -> None:
        self.data, integrator = data, data.integrator
        corners = data.layout.triangles[:, :3].reshape(-1, 3, 3)
        structure = build(integrator.structure, corners, integrator.precision, backend=data.backend)
        layout = dataclasses.replace(data.layout, structure=structure)
        tracer = Tracer(
            layout,
            data.background,
            data.ambient,
            integrator.bounces,
            data.backend,
            integrator.min_contribution,
            data.environment,
        )
        tracer.surfaces.black = data.black
        walk = tracer.intersector
        assert isinstance(walk, BvhIntersector)
        tracer.surfaces.numbers = sh.Table(data.numbers, sh.Attrib1i, "numbers")
        self.eyes = stages.generator(tracer, eye_rays_of(data.camera))
        programs = {"generate": self.eyes, "meet": stages.meeting(walk), "shade": stages.shading(tracer)}
        options = {**integrator.arithmetic, "loop_limit": None}
        self.kernels = {name: program.compile(data.backend, **options) for name, program in programs.items()}
        for name, value in data.uniforms.items():
            self.eyes.params[name].value = value
        self.point = tracer.surfaces.interaction
        self.fingerprint = probed(data.backend, integrator, tracer.levels_around)
        self.visits, self.done = 0, list[Records]()

    def begin(self, top: int, count: int, width: int, first: int) -> Records:
        """Make the eye rays of rows from `top` on; `first` is the number of the first pixel."""
        self.eyes.params["first_row"].value = top
        rays = self.kernels["generate"](shape=(count, width))
        records, size = Records({}), count * width
        for name in stages.EyeRayOutputs._fields:
            records.take(name, getattr(rays, name))
        for name, column in records.columns.items():
            records.columns[name] = column.reshape(size, *column.shape[2:])
        records.take("point", sh.Stream.empty(size, self.point, backend="numpy").numpy())
        records.columns["place"] = np.arange(first, first + size)
        return records

    def first_step(self, *band: int) -> StepResult:
        """Make eye rays (`begin`) and trace them until each is finished or goes to another part."""
        return self._follow([self._aimed(self.begin(*band))])

    def step(self, incoming: Records) -> StepResult:
        """Trace the incoming rays until each is finished or goes to another part."""
        return self._follow(self._advanced(incoming))

    def _follow(self, batches: list[Records]) -> StepResult:
        sent: dict[int, list[Records]] = {}
        while len(records := joined(batches)):
            goals = records.columns["goal"]
            for goal in np.unique(goals).tolist():
                if goal != self.data.number:
                    sent.setdefault(goal, []).append(records[goals == goal])
            batches = self._advanced(records[goals == self.data.number])
        done, visits = joined(self.done), self.visits
        self.done, self.visits = [], 0
        return StepResult({goal: joined(parts) for goal, parts in sent.items()}, done, visits, self.fingerprint)

    def _advanced(self, records: Records) -> list[Records]:
        """Shade the rays that are to be shaded here, and let the others meet the triangles; return where they go."""
        if not len(records):
            return []
        shading, batches = records.columns["shading"], []
        if shading.any():
            shaded = self._shade(records[shading])
            finished = shaded.columns["state"] == stages.FINISHED
            self.done.append(_pixels(shaded[finished]))
            batches.append(self._aimed(shaded[~finished]))
        if not shading.all():
            batches.append(self._meet(records[~shading]))
        return batches

    def _aimed(self, records: Records) -> Records:
        """Send new rays on their way: they have met nothing."""
        size, columns = len(records), records.columns
        columns["nearest.l"] = columns["ray.limit"].copy()
        columns["nearest.uv"] = np.zeros((size, 2), np.float32)
        columns["nearest.id"] = np.full(size, -1, np.int32)
        columns["last"] = np.full(size, -1, np.int64)
        columns["owner"] = np.full(size, -1, np.int64)
        return self._routed(records)

    def _meet(self, records: Records) -> Records:
        """Intersect rays with the triangles of this part.

        The nearest hit so far may be of another part. The kernel gets it as the place that its number would have among
        the numbers of this part: at the same distance, the triangle of the lowest number is hit.
        """
        columns, numbers = records.columns, self.data.numbers
        self.visits += len(records)
        before, reach = columns["nearest.id"], columns["nearest.l"]
        place = np.where(before >= 0, np.searchsorted(numbers, before), -1).astype(np.int32)
        columns["nearest.id"] = place
        records.take("nearest", self.kernels["meet"](ray=records.argument("ray"), nearest=records.argument("nearest")))
        mine = (columns["nearest.id"] != place) | (columns["nearest.l"] != reach)
        columns["nearest.id"] = np.where(mine, numbers[columns["nearest.id"].clip(0, len(numbers) - 1)], before)
        columns["owner"] = np.where(mine, self.data.number, columns["owner"])
        columns["last"] = np.full(len(records), self.data.number)
        return self._routed(records)

    def _routed(self, records: Records) -> Records:
        """Set the part to which each ray goes next, and whether it is to be shaded there."""
        columns = records.columns
        goal = next_part(records, self.data.low, self.data.high)
        tracing = columns["ray.tracing"].astype(bool)
        met = columns["nearest.id"] >= 0
        columns["shading"] = (goal < 0) | (met & ~tracing)  # any hit ends a shadow ray
        owner = np.where(met & tracing, columns["owner"], self.data.number)
        columns["goal"] = np.where(columns["shading"], owner, goal)
        return records

    def _shade(self, records: Records) -> Records:
        """Shade the nearest hits of eye and mirrored rays, all of them on triangles of this part."""
        columns = records.columns
        met = columns["nearest.id"] >= 0
        own = np.searchsorted(self.data.numbers, columns["nearest.id"]).clip(0, len(self.data.numbers) - 1)
        columns["nearest.id"] = np.where(met, own, -1).astype(np.int32)
        program = self.kernels["shade"]
        names = ("ray", "nearest", "light", "point", "pixel", "state")
        shading = program(**{name: records.argument(name) for name in names})
        for name in stages.SHADED:
            records.take(name, getattr(shading, name))
        return records


def _pixels(records: Records) -> Records:
    """Return the layers of pixels that are finished, in the order of `Pixel`, and their places."""
    names = [f"pixel.{name}" for name in Pixel._fields]
    return Records({name: records.columns[name] for name in (*names, "place")})


class Records:
    """Arrays of the same length by name; those of a struct are named `struct.field`."""

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        self.columns = dict(columns)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def __getitem__(self, which: Any) -> Records:
        """Return the records of a mask or of indices."""
        return Records({name: column[which] for name, column in self.columns.items()})

    @property
    def nbytes(self) -> int:
        """The bytes of all arrays."""
        return sum(column.nbytes for column in self.columns.values())

    def argument(self, name: str) -> Any:
        """Return an array, or the arrays of a struct by field, as kernels take them; a field may be a struct."""
        if name in self.columns:
            return self.columns[name]
        fields = dict.fromkeys(
            key[len(name) + 1 :].partition(".")[0] for key in self.columns if key.startswith(f"{name}.")
        )
        return {field: self.argument(f"{name}.{field}") for field in fields}

    def take(self, name: str, value: Any) -> None:
        """Replace an array, or those of a struct, by the result of a kernel."""
        if hasattr(value, "_fields"):
            for field in value._fields:
                self.take(f"{name}.{field}", getattr(value, field))
        else:
            self.columns[name] = np.asarray(value)


def joined(parts: Iterable[Records]) -> Records:
    """Return the records of several batches, in their order."""
    batches = [part for part in parts if len(part)]
    if len(batches) <= 1:
        return batches[0] if batches else Records({})
    return Records({name: np.concatenate([part.columns[name] for part in batches]) for name in batches[0].columns})


def next_part(records: Records, low: NDArray[Any], high: NDArray[Any]) -> NDArray[np.int64]:
    """Return for each ray the part, of boxes from `low` to `high` (k, 3), that it enters next; -1 for none.

    A ray visits parts in the order of the distances at which it enters them, and at equal distances in that of their
    numbers. So those after its `last` one in this order are left, and `last` = -1 is before all. Parts that begin
    behind the nearest hit are left out. Boxes are met with a margin, so that no triangle is missed that its part would
    find; a visit too many finds nothing.
    """
    rays = max(1, AT_ONCE // len(low))
    blocks = [records[slice(first, first + rays)] for first in range(0, len(records), rays)]
    return np.concatenate([np.empty(0, np.int64), *(_next_part(block, low, high) for block in blocks)])


def _next_part(records: Records, low: NDArray[Any], high: NDArray[Any]) -> NDArray[np.int64]:
    eye, ray = (records.columns[name].astype(np.float64)[:, None] for name in ("ray.eye", "ray.direction"))
    reach = records.columns["nearest.l"].astype(np.float64)[:, None]
    grown = GROWTH * np.maximum(np.abs(low).max(initial=0), np.abs(high).max(initial=0))
    grown = grown + GROWTH * np.abs(eye).max(axis=2, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        first, last = (low - grown - eye) / ray, (high + grown - eye) / ray
        inside = (low - grown <= eye) & (eye <= high + grown)
    still = ray == 0  # along such an axis a ray stays where it is
    enter = np.where(still, np.where(inside, -np.inf, np.inf), np.minimum(first, last)).max(axis=2)
    leave = np.where(still, np.where(inside, np.inf, -np.inf), np.maximum(first, last)).min(axis=2)
    enter = np.maximum(enter, 0)
    met = (enter * (1 - SLACK) <= leave * (1 + SLACK)) & (enter * (1 - SLACK) <= reach)
    last, numbers = records.columns["last"][:, None], np.arange(len(low))
    before = np.take_along_axis(enter, last, axis=1)
    met &= (last < 0) | (enter > before) | ((enter == before) & (numbers > last))
    enter = np.where(met, enter, np.inf)
    return np.where(met.any(axis=1), enter.argmin(axis=1), -1)
