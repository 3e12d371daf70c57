"""The measurements of Christen 2005, chapter 6, on the backends at hand: the staged tracer beside the unified one.

Stage: measure. Three scenes at 256 x 256 pixels: time against the size of the grid and against the iterations, which
are bounces and the eye ray; calls of the kernels against the threshold; rays alive, and what a round of few rays costs;
and what early-z culling does: calls, passes and time where each call goes over few rays, over all, or over all masked.

    found = study(["numpy", "opencl"], minutes=9)
    print(found.markdown())
    found.plot("christen.png")              # christen.json and christen.csv go beside it
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from raytracer.integrators.integrator import THRESHOLD, chosen
from raytracer.integrators.renderer import Renderer
from raytracer.kernels import stages
from raytracer.scene.scene import Scene
from raytracer.studies.report import (
    Told,
    about,
    counted_on,
    csv_of,
    devices_of,
    finish,
    in_time,
    machine,
    new_figure,
    save_figure,
    table,
)  # fmt: skip

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

Clock = Callable[[], float]


@dataclass(frozen=True, slots=True)
class Case:
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
class Measured:
    """The cost of a case: `seconds` of the fastest picture, calls of each kernel, rays and seconds of each round."""

    case: Case
    seconds: float
    rays: int
    calls: dict[str, int]
    alive: tuple[int, ...]
    round_seconds: tuple[float, ...]


@dataclass(frozen=True)
class Study:
    """The measurements, the machine on which they were made, and the cases `skipped` for lack of time."""

    machine: str
    backends: dict[str, str]
    measured: tuple[Measured, ...]
    skipped: tuple[Case, ...]
    size: tuple[int, int] = SIZE
    cpu: bool = False

    def find(self, **values: Any) -> list[Measured]:
        """Return the measurements whose case has these values, and the default ones for those that are not named."""
        full = {
            "grid": GRID,
            "iterations": 1,
            "threshold": THRESHOLD,
            "at_once": AT_ONCE[-1],
            "way": WAYS[0],
        } | values
        return [m for m in self.measured if all(getattr(m.case, k) == v for k, v in full.items() if v is not ...)]

    def markdown(self) -> str:
        """Return all numbers as tables of Markdown."""
        return "\n\n".join([self._about(), *(part for part in self._tables() if part)])

    def _about(self) -> str:
        pictures = f"{self.size[0]} x {self.size[1]} pixels"
        return about(self.machine, self.backends, pictures, self.cpu, len(self.skipped))

    def _tables(self) -> Iterable[str]:
        for title, key, values in (("Grid", "grid", GRIDS), ("Iterations", "iterations", ITERATIONS)):
            rows = [
                [scene, backend, tracer, *self._milliseconds(key, values, scene, backend, tracer)]
                for scene in SCENES
                for backend in self.backends
                for tracer in TRACERS
            ]
            head = ["scene", "backend", "tracer", *(f"{title.lower()} {v}" for v in values)]
            yield table(f"{title}: milliseconds a picture", head, rows)
        rows = [
            [
                str(e)
                for e in (m.case.scene, m.case.at_once, m.case.threshold, m.calls["traverse"], m.calls["intersect"])
            ]
            for m in self.find(threshold=..., at_once=..., tracer="staged", backend=self._counted)
        ]
        head = ["scene", "cells or triangles a call", "threshold", "calls of the traverser", "of the intersector"]
        yield table("Threshold: calls of the kernels, 1 iteration", head, sorted(rows))
        yield self._alive_table()
        yield self._ways_table()

    def _ways_table(self) -> str:
        rows = []
        for m in self._compared():
            other = {name: m.calls.get(name, 0) for name in ("mask", "compact")}
            calls = sum(m.calls.values()) - sum(other.values())
            rows.append([m.case.scene, m.case.backend, m.case.way, calls, *other.values(), f"{1e3 * m.seconds:.0f}"])
        head = ["scene", "backend", "a call goes over", "calls", "early-z passes", "copies", "milliseconds"]
        return table(f"Early-z culling, {ITERATIONS[-1]} iterations", head, rows)

    def _compared(self) -> list[Measured]:
        """Return the measurements in all ways, those of one scene and backend together."""
        measurements = self.find(iterations=ITERATIONS[-1], tracer="staged", way=...)
        places = [
            (m.case.scene, list(self.backends).index(m.case.backend), WAYS.index(m.case.way)) for m in measurements
        ]
        return [measurements[k] for k in sorted(range(len(measurements)), key=places.__getitem__)]

    def _alive_table(self) -> str:
        rows = []
        for m in self._compared():
            alive, seconds = eye_rounds(m)
            shown = [f"{n:,} / {1e6 * s / n:.2f}" for n, s in zip(alive, seconds, strict=True)]
            left = [""] * (ITERATIONS[-1] - len(shown))
            rows.append([m.case.scene, m.case.backend, m.case.way, *shown, *left])
        head = ["scene", "backend", "a call goes over", *(str(k + 1) for k in range(ITERATIONS[-1]))]
        return table("Rays alive in each iteration / microseconds for each of them", head, rows)

    @property
    def _counted(self) -> str:
        return counted_on(list(self.backends))

    def _milliseconds(self, key: str, values: Sequence[int], scene: str, backend: str, tracer: str) -> list[str]:
        seconds_by_value = {
            getattr(m.case, key): m.seconds
            for m in self.find(scene=scene, backend=backend, tracer=tracer, **{key: ...})
        }
        return [f"{1e3 * seconds_by_value[v]:.0f}" if v in seconds_by_value else "" for v in values]

    def json(self) -> dict[str, Any]:
        """Return everything, for `json.dump`."""
        return dataclasses.asdict(self)

    def csv(self) -> str:
        """Return a line of CSV for each measurement."""
        rows = [
            dataclasses.asdict(m.case) | {"seconds": m.seconds, "rays": m.rays, "calls": sum(m.calls.values())}
            for m in self.measured
        ]
        return csv_of(rows, "scene")

    def plot(self, path: str | Path) -> None:
        """Draw time, calls and rays; JSON and CSV of the same name go beside the picture. Raises as `new_figure`."""
        figure = new_figure(path, (15, 12))
        axes = figure.subplots(3, 3)
        for column, backend in enumerate(list(self.backends)[:3]):
            self._draw_times(axes[0, column], backend, "grid", f"{backend}: time against the size of the grid")
            self._draw_times(axes[1, column], backend, "iterations", f"{backend}: time against iterations")
        self._draw_calls(axes[2, 0])
        self._draw_alive(axes[2, 1], axes[2, 2])
        finish(axes.flat, fontsize=6)
        save_figure(figure, path, self.json(), self.csv(), dpi=100)

    def _draw_times(self, axis: Any, backend: str, key: str, title: str) -> None:
        for k, scene in enumerate(SCENES):
            for tracer, style in zip(TRACERS, ("-", "--"), strict=True):
                measurements = self.find(scene=scene, backend=backend, tracer=tracer, **{key: ...})
                points = sorted((getattr(m.case, key), m.seconds) for m in measurements)
                if points:
                    x, y = zip(*points, strict=True)
                    axis.plot(x, y, style, marker=_MARKS[k], color=f"C{k}", label=f"{scene}, {tracer}")
        axis.set(yscale="log", xlabel=key, ylabel="seconds a picture")
        axis.set_title(title, fontsize=9)

    def _draw_calls(self, axis: Any) -> None:
        for k, scene in enumerate(SCENES):
            for at_once, style in zip(AT_ONCE, ("-", "--"), strict=True):
                measurements = self.find(
                    scene=scene, backend=self._counted, tracer="staged", threshold=..., at_once=at_once
                )
                points = sorted((m.case.threshold, m.calls["traverse"] + m.calls["intersect"]) for m in measurements)
                if len(points) > 1:
                    x, y = zip(*points, strict=True)
                    axis.plot(x, y, style, marker=_MARKS[k], color=f"C{k}", label=f"{scene}, {at_once} a call")
        axis.set(yscale="log", xlabel="threshold", ylabel="calls of traverser and intersector")
        axis.set_title("calls of kernels against the threshold", fontsize=9)

    def _draw_alive(self, alive_axis: Any, cost_axis: Any) -> None:
        for m in self._compared():
            k, b = list(SCENES).index(m.case.scene), list(self.backends).index(m.case.backend)
            alive, _ = eye_rounds(m)
            few = m.case.way == WAYS[0]
            if m.case.backend == self._counted and few:
                label = f"{m.case.scene}, {m.case.backend}"
                alive_axis.plot(range(1, len(alive) + 1), alive, "-", marker=_MARKS[k], color=f"C{k}", label=label)
            cost = [1e6 * s / n for n, s in zip(m.alive, m.round_seconds, strict=True)]
            label = f"{m.case.scene}, {m.case.backend}{'' if few else f', {m.case.way}'}"
            full = {"few": "full", "all": "none", "masked": "top"}[m.case.way]
            cost_axis.plot(m.alive, cost, _MARKS[k], color=f"C{b}", fillstyle=full, label=label)
        alive_axis.set(yscale="log", xlabel="iteration", ylabel="eye rays and mirrored rays")
        alive_axis.set_title("rays alive", fontsize=9)
        cost_axis.set(xscale="log", yscale="log", xlabel="rays of a round", ylabel="microseconds a ray")
        cost_axis.set_title("what a round costs for each of its rays", fontsize=9)


def eye_rounds(measured: Measured) -> tuple[list[int], list[float]]:
    """Return the rays and the seconds of each iteration's first round; its other rounds are for shadow rays."""
    every = 1 + len(Scene.builtin(SCENES[measured.case.scene]).lights)
    return list(measured.alive[::every]), list(measured.round_seconds[::every])


def cases(backends: Sequence[str]) -> list[Case]:
    """Return every case once, the most telling ones first, and those last that take long."""
    fast = [name for name in backends if name != "numpy"]
    counted = counted_on(backends)
    all_cases = [Case(*names) for names in _named(backends)]
    all_cases += [Case(*names, iterations=n) for names in _named(fast) for n in reversed(ITERATIONS)]
    all_cases += _counted(SCENES, counted, AT_ONCE[-1])
    all_cases += [
        Case(scene, backend, "staged", iterations=ITERATIONS[-1], way=way)
        for backend in fast or [counted]
        for scene in COMPARED
        for way in WAYS[1:]
    ]
    all_cases += _counted([scene for scene in SCENES if scene != "C"], counted, AT_ONCE[0])
    all_cases += [Case(*names, grid=grid) for grid in GRIDS for names in _named(fast)]
    if "numpy" in backends:
        all_cases += [Case(*names, iterations=n) for n in ITERATIONS[:-1] for names in _named(["numpy"])]
        all_cases += [Case(*names, grid=grid) for grid in GRIDS[::2] for names in _named(["numpy"])]
    all_cases += _counted([scene for scene in SCENES if scene == "C"], counted, AT_ONCE[0])
    if "numpy" in backends:
        all_cases += [Case(*names, iterations=ITERATIONS[-1]) for names in _named(["numpy"])]
    return list(dict.fromkeys(all_cases))


def _counted(scenes: Iterable[str], backend: str, at_once: int) -> list[Case]:
    """Return the cases that count calls against the threshold."""
    return [
        Case(scene, backend, "staged", threshold=threshold, at_once=at_once)
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
    progress: Told | None = None,
) -> Study:
    """Measure the cases on `backends`, by default on all that are available, until `minutes` are over.

    The case that runs then is the last; `Study.skipped` has the others. With `cpu` all seconds are those of the
    processor's cores together, for machines that do other things too; a GPU's are not among them.
    Raises SceneError where no backend is left; sh.BackendUnavailable for one that is not there.
    """
    devices = devices_of(backends)
    all_cases, measured = cases(list(devices)), []
    clock = time.process_time if cpu else time.perf_counter
    last: tuple[Case, Renderer] | None = None
    for case in in_time(all_cases, minutes, progress):
        renderer = _renderer(case, last, clock)
        last = case, renderer
        measured.append(_measure(case, renderer, size, clock))
    return Study(machine(), devices, tuple(measured), tuple(all_cases[len(measured) :]), size, cpu)


def _renderer(case: Case, last: tuple[Case, Renderer] | None, clock: Clock) -> Renderer:
    """Return a renderer for a case: the last one where it differs in what can be set between pictures."""
    if last is not None and _kernels(last[0]) == _kernels(case):
        renderer = last[1]
    else:
        scene = Scene.builtin(SCENES[case.scene])
        options = {"tracer": case.tracer, "bounces": case.iterations - 1, "accel": "grid", "grid": case.grid}
        options |= {"early_z": case.way == "masked"} if case.tracer == "staged" else {}
        renderer = Renderer(scene, integrator=chosen("whitted", options), backend=case.backend)
        renderer.render((8, 8))  # drivers compile once more when a kernel runs for the first time
    if renderer.staged is not None:
        renderer.staged.clock = clock
        renderer.staged.compacts = case.way == WAYS[0]
        renderer.staged.threshold = case.threshold
        renderer.staged.at_once.value = case.at_once
    return renderer


def _kernels(case: Case) -> tuple[Any, ...]:
    """Return the fields of a case that its compiled kernels depend on."""
    return case.scene, case.backend, case.tracer, case.grid, case.iterations, case.way == "masked"


def _measure(case: Case, renderer: Renderer, size: tuple[int, int], clock: Clock) -> Measured:
    best: Measured | None = None
    for taken_before in range(_OFTEN):
        started = clock()
        stats = renderer.render(size).stats
        duration = clock() - started
        seconds = () if renderer.staged is None else tuple(renderer.staged.log.seconds)
        measurement = Measured(case, duration, stats.rays, dict(stats.calls), stats.alive, seconds)
        best = measurement if best is None or measurement.seconds < best.seconds else best
        # OpenCL may try another width of packets within the first picture, which takes a compilation.
        once = case.backend == "numpy" or case.at_once == AT_ONCE[0] or (duration > _LATE and case.backend != "opencl")
        if duration > _SOON and (taken_before or once):
            break
    assert best is not None
    return best
