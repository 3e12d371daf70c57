"""The measurements of Christen 2005, chapter 6, on the backends at hand: the staged tracer beside the unified one.

Stage: measure. Three scenes at 256 x 256 pixels: time against the size of the grid and against the iterations, which
are bounces and the eye ray; calls of the kernels against the threshold; rays alive, and what a round of few rays costs;
and what early-z culling does: calls, passes and time where each call goes over few rays, over all, or over all masked.

    found = study(["numpy", "opencl"], minutes=9)
    print(found.markdown())
    found.plot("christen.png")              # christen.json and christen.csv go beside it
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from raytracer.integrators.integrator import THRESHOLD, chosen
from raytracer.integrators.layers import Progress
from raytracer.integrators.renderer import Renderer
from raytracer.kernels import stages
from raytracer.scene.scene import Scene
from raytracer.studies import report
from raytracer.studies.report import Clock, counted_on, curves, devices_of, measure

SCENES = {"A": "boxes", "B": "cubes", "C": "mixed"}
"""Our scenes that are nearest to those of the thesis, and have as many triangles: 36, 2,064 and 61,562."""
COMPARED = ("A", "C")
"""The scenes of which calls go over few rays, over all, or over all masked: in B every ray has a successor."""
WAYS = ("few", "all", "masked")
"""The rays that a call goes over: those on their way, once they are few; all; all, with others masked by a pass."""
SIZE = (256, 256)
GRID = 20
GRIDS = (5, 10, 20, 30, 50)
ITERATIONS = (1, 2, 4, 8)
THRESHOLDS = (0.0, 0.1, 0.2, 0.4, 0.7, 1.0)
AT_ONCE = (1, stages.AT_ONCE)
"""Cells or triangles per call: 1 as in the thesis, and the default of the tracer."""
TRACERS = ("staged", "unified")
_OFTEN = 3
_SOON = 0.5
"""Seconds: a picture that takes less is rendered `_OFTEN` times, and the fastest counts."""
_LATE = 5.0
"""Seconds: a picture that takes more is rendered once, and so is one whose calls alone are of interest."""
_MARKS = "os^"


@dataclass(frozen=True, slots=True)
class TracerCase:
    """One picture: a scene of the thesis, the backend and the tracer.

    `threshold`, `at_once` and `way`, one of `WAYS`, are for the tracer "staged". "all": each kernel goes over all rays,
    and its program discards those that do not need it. "masked": a pass before it masks them, as in the thesis.
    """

    scene: str
    backend: str
    tracer: str
    grid: int = GRID
    iterations: int = 1
    threshold: float = THRESHOLD
    at_once: int = AT_ONCE[-1]
    way: str = WAYS[0]


@dataclass(frozen=True, slots=True)
class TracerMeasurement:
    """The cost of a case: `seconds` of the fastest picture, calls of each kernel, rays and seconds of each round."""

    case: TracerCase
    seconds: float
    rays: int
    calls: dict[str, int]
    alive: tuple[int, ...]
    round_seconds: tuple[float, ...]


@dataclass(frozen=True)
class ChristenStudy(report.Study):
    """The measurements, in pictures of this size."""

    size: tuple[int, int] = SIZE

    def find(self, **values: Any) -> list[TracerMeasurement]:
        """Return the measurements whose case has these values, and the default ones for those that are not named.

        They are grouped by scene, then by backend.
        """
        full = {
            "grid": GRID,
            "iterations": 1,
            "threshold": THRESHOLD,
            "at_once": AT_ONCE[-1],
            "way": WAYS[0],
        } | values
        matches = [m for m in self.measured if all(getattr(m.case, k) == v for k, v in full.items() if v is not ...)]
        backends = list(self.backends)
        return sorted(matches, key=lambda m: (m.case.scene, backends.index(m.case.backend), WAYS.index(m.case.way)))

    def pictures(self) -> str:
        """Return a description of the pictures."""
        return f"{self.size[0]} x {self.size[1]} pixels"

    def tables(self) -> Iterable[tuple[str, Sequence[str], Sequence[Sequence[Any]]]]:
        """Return time by grid and iterations, calls by threshold, rays alive, and what early-z culling does."""
        for key, values in (("grid", GRIDS), ("iterations", ITERATIONS)):
            milliseconds: dict[tuple[str, str, str], dict[int, str]] = {
                (scene, backend, tracer): dict.fromkeys(values, "")
                for scene in SCENES
                for backend in self.backends
                for tracer in TRACERS
            }
            for m in self.find(**{key: ...}):
                milliseconds[m.case.scene, m.case.backend, m.case.tracer][getattr(m.case, key)] = _milliseconds(m)
            rows = [[*names, *cells.values()] for names, cells in milliseconds.items()]
            head = ["scene", "backend", "tracer", *(f"{key} {v}" for v in values)]
            yield f"{key.capitalize()}: milliseconds a picture", head, rows
        counted = sorted(
            (m.case.scene, m.case.at_once, m.case.threshold, m.calls["traverse"], m.calls["intersect"])
            for m in self._counted(at_once=...)
        )
        head = ["scene", "cells or triangles a call", "threshold", "calls of the traverser", "of the intersector"]
        yield "Threshold: calls of the kernels, 1 iteration", head, counted
        alive, culled = [], []
        for m in self._compared():
            names = [m.case.scene, m.case.backend, m.case.way]
            shown = [f"{n:,} / {1e6 * s / n:.2f}" for n, s in zip(*eye_rounds(m), strict=True)]
            alive.append([*names, *shown, *[""] * (ITERATIONS[-1] - len(shown))])
            other = [m.calls.get(name, 0) for name in ("mask", "compact")]
            culled.append([*names, sum(m.calls.values()) - sum(other), *other, _milliseconds(m)])
        head = ["scene", "backend", "a call goes over"]
        numbers = [str(k + 1) for k in range(ITERATIONS[-1])]
        yield "Rays alive in each iteration / microseconds for each of them", head + numbers, alive
        head += ["calls", "early-z passes", "copies", "milliseconds"]
        yield f"Early-z culling, {ITERATIONS[-1]} iterations", head, culled

    def _compared(self) -> list[TracerMeasurement]:
        """Return the measurements in all ways."""
        return self.find(iterations=ITERATIONS[-1], tracer="staged", way=...)

    def _counted(self, **values: Any) -> list[TracerMeasurement]:
        """Return the measurements of calls against the threshold."""
        return self.find(threshold=..., tracer="staged", backend=counted_on(self.backends), **values)

    def draw(self, axes: Any) -> None:
        """Draw time, calls and rays."""
        for column, backend in enumerate(list(self.backends)[:3]):
            for axis, key, values in zip(axes[:, column], ("grid", "iterations"), (GRIDS, ITERATIONS), strict=False):
                line = self.find(backend=backend, **{key: ...})
                curves(axis, line, attrgetter(f"case.{key}"), attrgetter("seconds"), _style_of_tracer)
                axis.set(yscale="log", xlabel=key, ylabel="seconds a picture", title=f"{backend}: time against {key}")
                axis.set_xticks([value for value in values if any(getattr(m.case, key) == value for m in line)])
        calls, alive, cost = axes[2]
        for at_once, dashes in zip(AT_ONCE, ("-", "--"), strict=True):
            curves(
                calls,
                self._counted(at_once=at_once),
                lambda m: m.case.threshold,
                lambda m: m.calls["traverse"] + m.calls["intersect"],
                lambda m: _style(m, f"{m.case.at_once} a call", dashes),  # noqa: B023  # which is called here
            )
        calls.set(yscale="log", xlabel="threshold", ylabel="calls", title="calls of traverser and intersector")
        for m in self._compared():
            (rays, seconds), way = eye_rounds(m), m.case.way
            if m.case.backend == counted_on(self.backends) and way == WAYS[0]:
                alive.plot(range(1, len(rays) + 1), rays, **_style(m, m.case.backend))
            each = [1e6 * s / n for n, s in zip(rays, seconds, strict=True)]
            full = {"few": "full", "all": "none", "masked": "top"}[way]
            cost.plot(rays, each, **_style(m, f"{m.case.backend}, {way}", "", list(self.backends)), fillstyle=full)
        alive.set(yscale="log", xlabel="iteration", ylabel="rays", title="eye rays and mirrored rays alive")
        cost.set(
            xscale="log",
            yscale="log",
            xlabel="rays of an iteration",
            ylabel="microseconds a ray",
            title="time of a ray",
        )


def _milliseconds(m: TracerMeasurement) -> str:
    return f"{1e3 * m.seconds:.0f}"


def _style(m: TracerMeasurement, name: str, dashes: str = "-", colored: Sequence[str] = ()) -> dict[str, Any]:
    """Return the label and looks of a line; `colored` are the backends, where the color tells these."""
    scene = list(SCENES).index(m.case.scene)
    color = colored.index(m.case.backend) if colored else scene
    return {"label": f"{m.case.scene}, {name}", "linestyle": dashes, "marker": _MARKS[scene], "color": f"C{color}"}


def _style_of_tracer(m: TracerMeasurement) -> dict[str, Any]:
    return _style(m, m.case.tracer, "-" if m.case.tracer == TRACERS[0] else "--")


def eye_rounds(measured: TracerMeasurement) -> tuple[list[int], list[float]]:
    """Return the rays and the seconds of each iteration's first round; its other rounds are for shadow rays."""
    every = 1 + len(Scene.builtin(SCENES[measured.case.scene]).lights)
    return list(measured.alive[::every]), list(measured.round_seconds[::every])


def cases(backends: Sequence[str]) -> list[TracerCase]:
    """Return every case once, the most telling ones first, and those last that take long."""
    fast = [name for name in backends if name != "numpy"]
    counted = counted_on(backends)
    all_cases = [TracerCase(*names) for names in _named(backends)]
    all_cases += [TracerCase(*names, iterations=n) for names in _named(fast) for n in reversed(ITERATIONS)]
    all_cases += _counted(SCENES, counted, AT_ONCE[-1])
    all_cases += [
        TracerCase(scene, backend, "staged", iterations=ITERATIONS[-1], way=way)
        for backend in fast or [counted]
        for scene in COMPARED
        for way in WAYS[1:]
    ]
    all_cases += _counted([scene for scene in SCENES if scene != "C"], counted, AT_ONCE[0])
    all_cases += [TracerCase(*names, grid=grid) for grid in GRIDS for names in _named(fast)]
    if "numpy" in backends:
        all_cases += [TracerCase(*names, iterations=n) for n in ITERATIONS[:-1] for names in _named(["numpy"])]
        all_cases += [TracerCase(*names, grid=grid) for grid in GRIDS[::2] for names in _named(["numpy"])]
    all_cases += _counted([scene for scene in SCENES if scene == "C"], counted, AT_ONCE[0])
    if "numpy" in backends:
        all_cases += [TracerCase(*names, iterations=ITERATIONS[-1]) for names in _named(["numpy"])]
    return list(dict.fromkeys(all_cases))


def _counted(scenes: Iterable[str], backend: str, at_once: int) -> list[TracerCase]:
    """Return the cases that count calls against the threshold."""
    return [
        TracerCase(scene, backend, "staged", threshold=threshold, at_once=at_once)
        for scene in scenes
        for threshold in THRESHOLDS
    ]


def _named(backends: Sequence[str]) -> list[tuple[str, str, str]]:
    return [(scene, backend, tracer) for backend in backends for scene in SCENES for tracer in TRACERS]


def study(
    backends: Sequence[str] | None = None,
    *,
    minutes: float = 9.0,
    size: tuple[int, int] = SIZE,
    cpu: bool = False,
    progress: Progress | None = None,
) -> ChristenStudy:
    """Measure the cases on `backends`, by default on all that are available, until `minutes` are over.

    The case that runs then is the last; `ChristenStudy.skipped` has the others. With `cpu` all seconds are those of the
    processor's cores together, for machines that do other things too; a GPU's are not among them.
    Raises SceneError where no backend is left; sh.BackendUnavailable for a missing backend.
    """
    devices = devices_of(backends)
    last: dict[tuple[Any, ...], Renderer] = {}

    def bench(case: TracerCase, clock: Clock) -> TracerMeasurement:
        kernels = case.scene, case.backend, case.tracer, case.grid, case.iterations, case.way == "masked"
        renderer = last.pop(kernels, None) or _renderer(case)  # the last one does where its kernels are the same
        last.clear()
        last[kernels] = renderer
        if renderer.staged is not None:
            renderer.staged.clock = clock
            renderer.staged.compacts = case.way == WAYS[0]
            renderer.staged.threshold = case.threshold
            renderer.staged.at_once.value = case.at_once
        return _measure(case, renderer, size, clock)

    return ChristenStudy(**measure(devices, cases(list(devices)), bench, minutes, cpu, progress), size=size)


def _renderer(case: TracerCase) -> Renderer:
    options = {"tracer": case.tracer, "bounces": case.iterations - 1, "accel": "grid", "grid": case.grid}
    options |= {"early_z": case.way == "masked"} if case.tracer == "staged" else {}
    scene = Scene.builtin(SCENES[case.scene])
    renderer = Renderer(scene, integrator=chosen("whitted", options), backend=case.backend)
    renderer.render((8, 8))  # drivers compile once more when a kernel runs for the first time
    return renderer


def _measure(case: TracerCase, renderer: Renderer, size: tuple[int, int], clock: Clock) -> TracerMeasurement:
    best: TracerMeasurement | None = None
    for taken_before in range(_OFTEN):
        started = clock()
        stats = renderer.render(size).stats
        duration = clock() - started
        seconds = () if renderer.staged is None else tuple(renderer.staged.log.seconds)
        measurement = TracerMeasurement(case, duration, stats.rays, dict(stats.calls), stats.alive, seconds)
        best = measurement if best is None or measurement.seconds < best.seconds else best
        once = case.backend == "numpy" or case.at_once == AT_ONCE[0] or duration > _LATE
        if duration > _SOON and (taken_before or once):
            break
    assert best is not None
    return best
