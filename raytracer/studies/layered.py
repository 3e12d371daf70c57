"""The measurements of the paper on layered depth cubes, and how wrong their hits are: `raytracer study layered`.

Stage: measure. Source: Bürger et al., GPU Rendering of Secondary Effects (VMV 2007), Table 1: time to build
and to trace for models of 8 to 300 thousand triangles and a deforming one, at 512 x 512 and 1024 x 1024 texels. Then
errors over resolution, hit test and tolerance. Everything is beside the BVH and the grid of this package.

    found = study(["opencl"], minutes=9)
    print(found.markdown())
    found.plot("layered.png")               # layered.json, layered.csv and layered-pictures.png go beside it
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import shpy as sh
from raytracer.errors import SceneError
from raytracer.integrators.layers import Progress
from raytracer.layered.cube import HITS
from raytracer.meshes import Mesh
from raytracer.studies import report
from raytracer.studies.layered_measuring import KINDS, SMALLER, Bench, Case, Measurement, Model, models, unit
from raytracer.studies.report import Clock, counted_on, curves, devices_of, measure

_TESTS = ("plane", "triangle", "sample")
"""The hit tests, those first without which the others mean little."""
_MARKS = {"plane": "o", "triangle": "^", "sample": "s"}
_TINY = 1e-4
"""The value at which a logarithmic axis shows errors of 0."""
_AMPLIFIED = 8


@dataclass(frozen=True)
class Plan:
    """The measurements: `framed` are the resolutions of Table 1, `tolerances` those of the hit test "sample".

    `blocks` are the sizes of the blocks of the coarse level, compared at the first of `framed`. The last size is the
    whole image: no coarse level.
    """

    size: tuple[int, int]
    framed: tuple[int, ...]
    resolutions: tuple[int, ...]
    tolerances: tuple[float, ...]
    blocks: tuple[int, ...]
    studied: str = "knot"
    """The model whose errors are measured over all of these."""


FULL = Plan((1280, 1024), (512, 1024), (128, 256, 512, 1024, 2048), (1e-4, 1e-3, 1e-2), (1, 4, 16, 64, 512))
QUICK = Plan((64, 48), (32,), (32,), (1e-2,), (4, 32))


@dataclass(frozen=True)
class LayeredStudy(report.Study):
    """The measurements of a plan."""

    plan: Plan = FULL
    grid: ClassVar[tuple[int, int]] = (2, 3)

    def pictures(self) -> str:
        """Return a description of the pictures."""
        (width, height), small = self.plan.size, [n // SMALLER for n in self.plan.size]
        return f"pictures of {width} x {height} pixels, errors and rays of {small[0]} x {small[1]}"

    def tables(self) -> Iterable[tuple[str, Sequence[str], Sequence[Sequence[Any]]]]:
        """Return Table 1 of the paper, the errors, and the blocks of the coarse level, for each backend."""
        name = self.plan.studied
        for backend in self.backends:
            rows = [_table_row(m) for m in sorted(self._framed(backend), key=lambda m: m.triangles)]
            head = ["model", "triangles", "secondary rays by", "build ms", "picture ms", "with BVH", "secondary rays"]
            yield f"Build and picture, {backend}", [*head, "layers", "samples", "MiB", "RMSE/255", "FLIP"], rows
        for backend in self.backends:
            head = ["hit test", "texels", "build ms", "MiB", "secondary rays", "RMSE/255", "FLIP"]
            head += [f"{kind}: missed / false / misplaced" for kind in KINDS]
            yield f"Errors, {name}, {backend}", head, [_error_row(m) for m in self.studied(backend)]
        for backend in self.backends:
            rows = [_block_row(m) for m in self._of(backend) if m.case.block is not None]
            head = ["block", "build ms", "MiB", "secondary rays", *(f"{kind} ms" for kind in KINDS)]
            yield f"Blocks of the coarse level, {name}, {self.plan.framed[0]}² plane, {backend}", head, rows

    def _of(self, backend: str) -> list[Measurement]:
        return [m for m in self.measured if m.case.backend == backend]

    def _framed(self, backend: str) -> list[Measurement]:
        return [m for m in self._of(backend) if m.frame_seconds is not None]

    def studied(self, backend: str) -> list[Measurement]:
        """Return the cubes of the model whose errors are studied, by test and resolution."""
        cubes = [m for m in self._of(backend) if (m.case.model, m.case.accel) == (self.plan.studied, "ldc")]
        return sorted(
            (m for m in cubes if m.case.block is None),
            key=lambda m: (
                _TESTS.index(m.case.hit),
                m.case.depths == "half",
                m.case.tolerance or 0,
                m.case.resolution,
            ),
        )

    def plot(self, path: str | Path) -> None:
        """Draw times and errors, and pictures beside the exact one; JSON and CSV go beside them.

        The pictures have the path's name with "-pictures" at its end. Raises as `sh.outputs`.
        """
        super().plot(path)
        self.compare(Path(path).with_stem(f"{Path(path).stem}-pictures"))

    def draw(self, axes: Any) -> None:
        """Draw times over triangles, and errors over resolution, time and memory."""
        backend = next(iter(self.backends))
        framed, cubes = self._framed(backend), self.studied(backend)
        (build, trace, shares), (times, memory, pictures) = axes
        style = _colored(framed, lambda m: str(m.case))
        curves(build, framed, lambda m: m.triangles, lambda m: m.build_seconds, style)
        build.set(xscale="log", yscale="log", xlabel="triangles", ylabel="seconds", title="build")
        curves(trace, framed, lambda m: m.triangles, lambda m: m.frame_seconds / m.bvh_seconds, style)
        trace.set(xscale="log", yscale="log", xlabel="triangles", ylabel="times that of the BVH", title="picture")
        name, style = self.plan.studied, _colored(cubes, lambda m: m.case.test)
        for kind, dashes in zip(KINDS[::2], ("-", "--"), strict=True):
            look = {"linestyle": dashes}
            curves(
                shares,
                cubes,
                lambda m: m.case.resolution,
                lambda m: max(m.wrong[kind].all, _TINY),  # noqa: B023  # which is called here
                lambda m: style(m) | look | {"label": f"{m.case.test}, {kind}"},  # noqa: B023
            )
        shares.set(yscale="log", xlabel="texels along a side", ylabel="share of rays", title=f"{name}: wrong hits")
        shares.set_xscale("log", base=2)
        cost, rmse = "secondary rays: times that of the BVH", "RMSE, 255ths"
        seen = [m for m in cubes if "flip" in m.errors]
        curves(times, cubes, lambda m: m.cost, lambda m: max(m.errors["rmse"], _TINY), style)
        curves(memory, cubes, lambda m: m.nbytes / 2**20, lambda m: max(m.errors["rmse"], _TINY), style)
        curves(pictures, seen, lambda m: m.cost, lambda m: max(m.errors["flip"], _TINY), style)
        for axis, x, y in ((times, cost, rmse), (memory, "MiB", rmse), (pictures, cost, "mean FLIP")):
            axis.set(xscale="log", yscale="log", xlabel=x, ylabel=y, title=f"{name}: error")

    def compare(self, path: Path) -> None:
        """Draw the exact small picture, those through cubes of a low resolution, and how they differ."""
        backend = next(iter(self.backends))
        resolution = self.plan.resolutions[len(self.plan.resolutions) // 2 - 1]
        pictures = {
            m.case.hit: m.pixels
            for m in self.studied(backend)
            if (m.case.resolution, m.case.tolerance, m.case.depths) == (resolution, None, "single")
        }
        exact = [m.pixels for m in self._of(backend) if (m.case.model, m.case.accel) == (self.plan.studied, "bvh")]
        if not pictures or not exact:
            return
        figure = sh.outputs.new_figure(4 * len(pictures) + 4, 6.6)
        axes = figure.subplots(2, 1 + len(pictures), squeeze=False)
        axes[0, 0].imshow(exact[0])
        axes[0, 0].set_title("exact")
        for column, (hit, pixels) in enumerate(pictures.items(), 1):
            off = _AMPLIFIED * abs(pixels.astype(int) - exact[0])
            axes[0, column].imshow(pixels)
            axes[0, column].set_title(f'{resolution}², "{hit}"')
            axes[1, column].imshow(off.clip(0, 255).astype("uint8"))
            axes[1, column].set_title(f"difference, times {_AMPLIFIED}")
        for axis in axes.flat:
            axis.set_axis_off()
        with sh.files.replacing(path) as temporary:
            figure.savefig(temporary, dpi=100)


def _colored(
    measured: Sequence[Measurement], label: Callable[[Measurement], str]
) -> Callable[[Measurement], dict[str, Any]]:
    """Return what gives the label and looks of a measurement's line: a color for each label, a mark for the test."""
    labels = list(dict.fromkeys(map(label, measured)))
    return lambda m: {
        "label": label(m),
        "color": f"C{labels.index(label(m))}",
        "marker": _MARKS.get(m.case.hit, "x"),
    }


def _table_row(m: Measurement) -> list[str]:
    assert m.frame_seconds is not None
    assert m.bvh_seconds is not None
    return [
        m.case.model, f"{m.triangles:,}", str(m.case), f"{1e3 * m.build_seconds:.0f}", f"{1e3 * m.frame_seconds:.0f}",
        f"{1e3 * m.bvh_seconds:.0f}", f"{m.cost:.2f} x", str(m.layers or ""), f"{m.samples:,}" if m.samples else "",
        f"{m.nbytes / 2**20:.1f}", *_error(m),
    ]  # fmt: skip


def _error_row(m: Measurement) -> list[str]:
    shares = [f"{w.missed:.2%} / {w.false:.2%} / {w.misplaced:.2%}" for w in m.wrong.values()]
    build, memory = f"{1e3 * m.build_seconds:.0f}", f"{m.nbytes / 2**20:.1f}"
    return [m.case.test, str(m.case.resolution), build, memory, f"{m.cost:.2f} x", *_error(m), *shares]


def _block_row(m: Measurement) -> list[str]:
    times = [f"{1e3 * w.seconds:.0f}" for w in m.wrong.values()]
    build, memory = f"{1e3 * m.build_seconds:.0f}", f"{m.nbytes / 2**20:.1f}"
    return [str(m.case.block), build, memory, f"{m.cost:.2f} x", *times]


def _error(m: Measurement) -> list[str]:
    return [f"{m.errors['rmse']:.3g}", f"{m.errors['flip']:.4f}" if "flip" in m.errors else ""]


def cases(backends: Sequence[str], all_models: Sequence[Model], plan: Plan) -> list[Case]:
    """Return every case once, the most telling ones first."""
    names = [(model.name, backend) for backend in backends for model in all_models]
    studied = [(plan.studied, backend) for backend in backends]
    all_cases = [Case(*name, "bvh") for name in studied]
    all_cases += [Case(*name, "ldc", r, hit) for name in studied for hit in _TESTS for r in plan.resolutions]
    all_cases += [Case(*name, "bvh") for name in names]
    all_cases += [Case(*name, "ldc", resolution, "plane") for name in names for resolution in plan.framed]
    all_cases += [Case(*name, "grid") for name in names]
    rounded = [test for test in _TESTS if test != "triangle"]
    all_cases += [
        Case(*name, "ldc", resolution, hit, depths="half")
        for name in studied
        for hit in rounded
        for resolution in plan.resolutions
    ]
    all_cases += [Case(*name, "ldc", plan.framed[0], "plane", block=block) for name in studied for block in plan.blocks]
    all_cases += [
        Case(*name, "ldc", resolution, "sample", tolerance)
        for name in studied
        for tolerance in plan.tolerances
        for resolution in plan.resolutions
    ]
    return list(dict.fromkeys(all_cases))


def study(
    backends: Sequence[str] | None = None,
    *,
    minutes: float = 9.0,
    size: tuple[int, int] | None = None,
    files: Sequence[str | Path] = (),
    quick: bool = False,
    cpu: bool = False,
    progress: Progress | None = None,
) -> LayeredStudy:
    """Measure the cases on `backends`, by default on OpenCL if it is available, until `minutes` are over.

    The case that runs then is the last; `LayeredStudy.skipped` has the others. `files` name meshes, measured too;
    `quick` takes small models and pictures. With `cpu` all seconds are those of the processor's cores together.
    Raises SceneError where no backend is left, and for files that cannot be read; sh.BackendUnavailable for a missing
    backend.
    """
    devices = devices_of(backends)
    if backends is None:
        chosen = counted_on(list(devices))
        devices = {chosen: devices[chosen]}
    plan = QUICK if quick else FULL
    plan = plan if size is None else dataclasses.replace(plan, size=size)
    all_models = [*models(quick), *(_loaded(path) for path in files)]
    benches = {(m.name, name): Bench(m, name, plan.size) for m in all_models for name in devices}

    def bench(case: Case, clock: Clock) -> Measurement:
        framed = case.accel != "ldc" or (
            case.resolution in plan.framed and case.tolerance is None and case.block is None
        )
        chosen = benches[case.model, case.backend]
        chosen.clock = clock
        return chosen.measure(case, framed=framed)

    all_cases = cases(list(devices), all_models, plan)
    return LayeredStudy(**measure(devices, all_cases, bench, minutes, cpu, progress), plan=plan)


def _loaded(path: str | Path) -> Model:
    mesh = Mesh.load(path)
    if not len(mesh):
        raise SceneError(f"{path}: a study needs triangles")
    return Model(Path(path).stem, (unit(mesh),))


assert set(_TESTS) == set(HITS)
