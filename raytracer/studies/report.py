"""The common parts of studies of papers: devices, the end in time, tables of Markdown, lines of CSV, and figures.

Stage: measure. A study derives from `Study`: its tables, and how its measurements are drawn.

    measured = measure(devices_of(["numpy"]), cases, bench, minutes=9, cpu=False)
    study = MyStudy(**measured)
    study.plot("study.png")                 # study.json and study.csv go beside it
"""

from __future__ import annotations

import csv
import dataclasses
import io
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

import shpy as sh
from raytracer.errors import SceneError
from raytracer.integrators.layers import Progress

Clock = Callable[[], float]


@dataclass(frozen=True)
class Study(ABC):
    """The measurements, the machine on which they were made, and the cases `skipped` for lack of time.

    With `cpu` all seconds are those of the processor's cores together.
    """

    machine: str
    backends: dict[str, str]
    measured: tuple[Any, ...]
    skipped: tuple[Any, ...]
    cpu: bool

    grid: ClassVar[tuple[int, int]] = (3, 3)
    """Rows and columns of plots, each 5 inches wide and a little less high."""
    legend: ClassVar[dict[str, Any]] = {
        "fontsize": 7,
        "ncol": 3,
        "loc": "upper center",
        "bbox_to_anchor": (0.5, -0.19),
        "handlelength": 3.5,
    }  # below the plots, not over the data

    @abstractmethod
    def pictures(self) -> str:
        """Return a description of the pictures, as a part of a sentence."""

    @abstractmethod
    def tables(self) -> Iterable[tuple[str, Sequence[str], Sequence[Sequence[Any]]]]:
        """Return the title, head and rows of each table."""

    @abstractmethod
    def draw(self, axes: Any) -> None:
        """Draw the measurements into `grid` axes."""

    def markdown(self) -> str:
        """Return all numbers as tables of Markdown."""
        devices = "; ".join(f"{name}: {device}" for name, device in self.backends.items())
        left = f" {len(self.skipped)} measurements were left out for want of time." if self.skipped else ""
        clock = "CPU time of all cores" if self.cpu else "wall time"
        tables = [f"**{title}**\n\n{sh.command.markdown([head, *rows])}" for title, head, rows in self.tables() if rows]
        return "\n\n".join([f"Measured on {self.machine} ({devices}), {self.pictures()}, {clock}.{left}", *tables])

    def json(self) -> dict[str, Any]:
        """Return everything but pictures, for `json.dump`."""
        measured = [_without_pictures(dataclasses.asdict(m)) for m in self.measured]
        return dataclasses.asdict(dataclasses.replace(self, measured=())) | {"measured": measured}

    def csv(self) -> str:
        """Return a line of CSV for each measurement: its case, and its numbers by their names."""
        rows = [_flat(dataclasses.asdict(m)) for m in self.measured]
        text = io.StringIO()
        writer = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)) or ["case"])
        writer.writeheader()
        writer.writerows(rows)
        return text.getvalue()

    def plot(self, path: str | Path) -> None:
        """Draw the measurements; JSON and CSV of the same name go beside the picture. Raises as `sh.outputs`."""
        path, (rows, columns) = Path(path), self.grid
        sh.outputs.check_output(path)
        figure = sh.outputs.new_figure(5 * columns, 1 + 11 * rows / 3)
        axes = figure.subplots(rows, columns)
        self.draw(axes)
        for axis in axes.flat:
            if axis.has_data():
                axis.legend(**self.legend)
            else:
                axis.set_axis_off()
        sh.outputs.save_figure(figure, path, self.json())
        with sh.files.replacing(path.with_suffix(".csv")) as temporary:
            temporary.write_text(self.csv())


def measure(
    backends: dict[str, str],
    cases: Sequence[Any],
    bench: Callable[[Any, Clock], Any],
    minutes: float,
    cpu: bool,
    progress: Progress | None,
) -> dict[str, Any]:
    """Measure cases until `minutes` are over, the last one to its end; return the fields of a `Study`."""
    tell: Progress = progress or (lambda done, total: None)
    end, measured = time.monotonic() + 60 * minutes, []
    for done, case in enumerate(cases):
        tell(done, len(cases))
        if time.monotonic() > end:
            break
        measured.append(bench(case, time.process_time if cpu else time.perf_counter))
    tell(len(cases), len(cases))
    left = tuple(cases[len(measured) :])
    return {"machine": machine(), "backends": backends, "measured": tuple(measured), "skipped": left, "cpu": cpu}


def curves(
    axis: Any,
    measured: Iterable[Any],
    x: Callable[[Any], Any],
    y: Callable[[Any], Any],
    style: Callable[[Any], dict[str, Any]],
) -> None:
    """Draw a line for each label that `style` gives, through the points of its measurements."""
    lines: dict[str, tuple[dict[str, Any], list[tuple[Any, Any]]]] = {}
    for m in measured:
        lines.setdefault(style(m)["label"], (style(m), []))[1].append((x(m), y(m)))
    for of_line, points in lines.values():
        axis.plot(*zip(*sorted(points), strict=True), **of_line)


def devices_of(backends: Sequence[str] | None) -> dict[str, str]:
    """Return the device of each backend; None stands for all backends that are available.

    Raises SceneError where no backend is left; sh.BackendUnavailable for a missing backend.
    """
    devices = {b.name: b.devices[0].name for b in sh.backends() if b.available}
    names = list(devices) if backends is None else list(backends)
    if not names:
        raise SceneError("a study needs a backend: `raytracer doctor` says what is missing")
    for name in names:
        if name not in devices:
            raise sh.BackendUnavailable(f"{name} is not available", cure="raytracer doctor, which says why")
    return {name: devices[name] for name in names}


def counted_on(backends: Iterable[str]) -> str:
    """Return the backend that calls of kernels are counted on: they are the same on all, and OpenCL is fast."""
    return "opencl" if "opencl" in backends else next(iter(backends))


def machine() -> str:
    """Return the processor, as the system names it, and how many cores this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{sh.command.processor()}, {cores} cores"


def _without_pictures(values: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if not isinstance(value, np.ndarray)}


def _flat(values: dict[str, Any]) -> dict[str, Any]:
    """Return the single values, and those of dictionaries by their own names; a part of one adds its name."""
    row: dict[str, Any] = {}
    for name, value in values.items():
        for key, part in value.items() if isinstance(value, dict) else [(name, value)]:
            row |= {f"{key} {k}": v for k, v in part.items()} if isinstance(part, dict) else {key: part}
    return {name: value for name, value in row.items() if not isinstance(value, tuple | np.ndarray)}
