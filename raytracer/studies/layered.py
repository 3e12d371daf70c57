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
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import shpy as sh
from raytracer.errors import SceneError
from raytracer.layered.cube import HITS
from raytracer.meshes import Mesh
from raytracer.studies.layered_measuring import KINDS, SMALLER, Bench, Case, Measured, Model, models, unit
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
class Study:
    """Everything that was measured, the machine, and the cases that the time did not suffice for."""

    machine: str
    backends: dict[str, str]
    plan: Plan
    measured: tuple[Measured, ...]
    skipped: tuple[Case, ...]
    cpu: bool = False

    def markdown(self) -> str:
        """Return all numbers as tables of Markdown."""
        return "\n\n".join([self._about(), *(part for part in self._tables() if part)])

    def _about(self) -> str:
        (width, height), small = self.plan.size, [n // SMALLER for n in self.plan.size]
        pictures = f"pictures of {width} x {height} pixels, errors and rays of {small[0]} x {small[1]}"
        return about(self.machine, self.backends, pictures, self.cpu, len(self.skipped))

    def _tables(self) -> Iterable[str]:
        for backend in self.backends:
            rows = [_table_row(m) for m in self._of(backend) if m.frame_seconds is not None]
            head = ["model", "triangles", "secondary rays by", "build ms", "picture ms", "with BVH", "secondary rays"]
            head += ["layers", "samples", "MiB", "RMSE/255", "FLIP"]
            yield table(
                f"Build and picture, {backend}", head, sorted(rows, key=lambda row: int(row[1].replace(",", "")))
            )
        for backend in self.backends:
            rows = [_error_row(m) for m in self.studied(backend)]
            head = ["hit test", "texels", "build ms", "MiB", "secondary rays", "RMSE/255", "FLIP"]
            head += [f"{kind}: missed / false / misplaced" for kind in KINDS]
            yield table(f"Errors, {self.plan.studied}, {backend}", head, rows)
        for backend in self.backends:
            rows = [_block_row(m) for m in self._of(backend) if m.case.block is not None]
            title = f"Blocks of the coarse level, {self.plan.studied}, {self.plan.framed[0]}² plane, {backend}"
            head = ["block", "build ms", "MiB", "secondary rays", *(f"{kind} ms" for kind in KINDS)]
            yield table(title, head, rows)

    def _of(self, backend: str) -> list[Measured]:
        return [m for m in self.measured if m.case.backend == backend]

    def studied(self, backend: str) -> list[Measured]:
        """Return the cubes of the model whose errors are studied, by test and resolution."""
        cubes = [m for m in self._of(backend) if m.case.model == self.plan.studied and m.case.accel == "ldc"]
        of_default_block = [m for m in cubes if m.case.block is None]
        order = {test: k for k, test in enumerate(_TESTS)}
        return sorted(
            of_default_block,
            key=lambda m: (order[m.case.hit], m.case.depths == "half", m.case.tolerance or 0, m.case.resolution),
        )

    def json(self) -> dict[str, Any]:
        """Return everything but pictures, for `json.dump`."""
        measured = [{k: v for k, v in dataclasses.asdict(m).items() if k != "pixels"} for m in self.measured]
        return dataclasses.asdict(dataclasses.replace(self, measured=())) | {"measured": measured}

    def csv(self) -> str:
        """Return a line of CSV for each measurement."""
        rows = []
        for m in self.measured:
            row = dataclasses.asdict(m.case) | {k: v for k, v in dataclasses.asdict(m).items() if not _nested(v)}
            for kind, wrong in m.wrong.items():
                row |= {f"{kind} {k}": v for k, v in dataclasses.asdict(wrong).items()}
            rows.append(row | m.errors)
        return csv_of(rows, "model")

    def plot(self, path: str | Path) -> None:
        """Draw times and errors, and pictures beside the exact one; JSON and CSV go beside them.

        The pictures have the path's name with "-pictures" at its end. Raises as `new_figure`.
        """
        path = Path(path)
        figure = new_figure(path, (15, 11))
        axes = figure.subplots(2, 3)
        backend = next(iter(self.backends))
        self._draw_table(axes[0, 0], axes[0, 1], backend)
        self._draw_errors(axes.flat[2:], self.studied(backend))
        finish(axes.flat, fontsize=7, ncol=3, loc="upper center", bbox_to_anchor=(0.5, -0.13))  # not over the data
        save_figure(figure, path, self.json(), self.csv(), dpi=100)
        self.compare(path.with_stem(f"{path.stem}-pictures"))

    def _draw_table(self, build: Any, trace: Any, backend: str) -> None:
        framed = [m for m in self._of(backend) if m.frame_seconds is not None]
        for k, name in enumerate(dict.fromkeys(str(m.case) for m in framed)):
            measurements = sorted((m for m in framed if str(m.case) == name), key=lambda m: m.triangles)
            style = {"marker": _MARKS.get(measurements[0].case.hit, "x"), "color": f"C{k}", "label": name}
            build.plot([m.triangles for m in measurements], [m.build_seconds for m in measurements], **style)
            trace.plot(
                [m.triangles for m in measurements],
                [(m.frame_seconds or 0) / (m.bvh_seconds or 1) for m in measurements],
                **style,
            )
        build.set(xscale="log", yscale="log", xlabel="triangles", ylabel="seconds")
        build.set_title("build", fontsize=10)
        trace.set(xscale="log", yscale="log", xlabel="triangles", ylabel="times that of the BVH")
        trace.set_title("picture", fontsize=10)

    def _draw_errors(self, axes: Any, measurements: Sequence[Measured]) -> None:
        shares, times, memory, pictures = axes
        for k, test in enumerate(dict.fromkeys(m.case.test for m in measurements)):
            line = [m for m in measurements if m.case.test == test]
            style = {"marker": _MARKS[line[0].case.hit], "color": f"C{k}", "label": test}
            for kind, dashes in zip(KINDS[::2], ("-", "--"), strict=True):
                wrong = [max(m.wrong[kind].all, _TINY) for m in line]
                label = {"label": f"{test}, {kind}"}
                shares.plot([m.case.resolution for m in line], wrong, dashes, **style | label)
            rmse = [max(m.errors["rmse"], _TINY) for m in line]
            times.plot([m.cost for m in line], rmse, **style)
            memory.plot([m.nbytes / 2**20 for m in line], rmse, **style)
            if all("flip" in m.errors for m in line):
                pictures.plot([m.cost for m in line], [max(m.errors["flip"], _TINY) for m in line], **style)
        name, cost = self.plan.studied, "secondary rays: times that of the BVH"
        shares.set(yscale="log", xlabel="texels along a side", ylabel="share of rays")
        shares.set_xscale("log", base=2)
        shares.set_title(f"{name}: wrong hits", fontsize=10)
        for axis, x, y in (
            (times, cost, "RMSE, 255ths"),
            (memory, "MiB", "RMSE, 255ths"),
            (pictures, cost, "mean FLIP"),
        ):
            axis.set(xscale="log", yscale="log", xlabel=x, ylabel=y)
            axis.set_title(f"{name}: error", fontsize=10)

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
        figure = new_figure(path, (4 * len(pictures) + 4, 6.6))
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


def _nested(value: Any) -> bool:
    return not isinstance(value, int | float | None)


def _table_row(m: Measured) -> list[str]:
    assert m.frame_seconds is not None
    assert m.bvh_seconds is not None
    return [
        m.case.model, f"{m.triangles:,}", str(m.case), f"{1e3 * m.build_seconds:.0f}", f"{1e3 * m.frame_seconds:.0f}",
        f"{1e3 * m.bvh_seconds:.0f}", f"{m.cost:.2f} x", str(m.layers or ""), f"{m.samples:,}" if m.samples else "",
        f"{m.nbytes / 2**20:.1f}", *_error(m),
    ]  # fmt: skip


def _error_row(m: Measured) -> list[str]:
    shares = [f"{w.missed:.2%} / {w.false:.2%} / {w.misplaced:.2%}" for w in m.wrong.values()]
    build, memory = f"{1e3 * m.build_seconds:.0f}", f"{m.nbytes / 2**20:.1f}"
    return [m.case.test, str(m.case.resolution), build, memory, f"{m.cost:.2f} x", *_error(m), *shares]


def _block_row(m: Measured) -> list[str]:
    times = [f"{1e3 * w.seconds:.0f}" for w in m.wrong.values()]
    build, memory = f"{1e3 * m.build_seconds:.0f}", f"{m.nbytes / 2**20:.1f}"
    return [str(m.case.block), build, memory, f"{m.cost:.2f} x", *times]


def _error(m: Measured) -> list[str]:
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
    progress: Told | None = None,
) -> Study:
    """Measure the cases on `backends`, by default on OpenCL if it is available, until `minutes` are over.

    The case that runs then is the last; `Study.skipped` has the others. `files` name meshes that are measured too;
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
    all_cases, measured = cases(list(devices), all_models, plan), []
    clock = time.process_time if cpu else time.perf_counter
    benches = {(m.name, name): Bench(m, name, plan.size, clock) for m in all_models for name in devices}
    for case in in_time(all_cases, minutes, progress):
        framed = case.accel != "ldc" or (
            case.resolution in plan.framed and case.tolerance is None and case.block is None
        )
        measured.append(benches[case.model, case.backend].measure(case, framed=framed))
    return Study(machine(), devices, plan, tuple(measured), tuple(all_cases[len(measured) :]), cpu)


def _loaded(path: str | Path) -> Model:
    mesh = Mesh.load(path)
    if not len(mesh):
        raise SceneError(f"{path}: a study needs triangles")
    return Model(Path(path).stem, (unit(mesh),))


assert set(_TESTS) == set(HITS)
