"""Parts that studies share: devices, time limits, tables of Markdown, lines of CSV, and figures with their numbers.

Stage: measure. Paths are checked before anything is measured, and files are written whole or not at all.

    for case in in_time(cases, minutes=9.0):
        measured.append(measure(case))
    figure = new_figure("found.png")
    save_figure(figure, "found.png", {"x": 1})     # and found.json
"""

from __future__ import annotations

import csv
import io
import json
import os
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import shpy as sh
from raytracer.errors import SceneError

Told = Callable[[int, int], None]
"""Called with the measurements that are done and all measurements."""
Case = TypeVar("Case")


def devices_of(backends: Sequence[str] | None) -> dict[str, str]:
    """Return the device of each backend; None stands for all backends that are available.

    Raises SceneError where no backend is left; sh.BackendUnavailable for one that is not there.
    """
    devices = {b.name: b.devices[0].name for b in sh.backends() if b.available}
    names = list(devices) if backends is None else list(backends)
    if not names:
        raise SceneError("a study needs a backend: `raytracer doctor` says what is missing")
    for name in names:
        if name not in devices:
            raise sh.BackendUnavailable(f"{name} is not available", cure="raytracer doctor, which says why")
    return {name: devices[name] for name in names}


def machine() -> str:
    """Return the processor, as the system names it, and how many cores this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    name = platform.processor() or platform.machine()
    for line in Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else ():
        if line.startswith("model name"):
            name = line.partition(":")[2].strip()
            break
    return f"{name}, {cores} cores"


def counted_on(backends: Sequence[str]) -> str:
    """Return the backend that calls of kernels are counted on: they are the same on all, and OpenCL is fast."""
    return "opencl" if "opencl" in backends else backends[0]


def in_time(cases: Sequence[Case], minutes: float, progress: Told | None = None) -> Iterator[Case]:
    """Yield cases until `minutes` are over; the case that runs then is the last."""
    told: Told = progress or (lambda done, total: None)
    end = time.monotonic() + 60 * minutes
    for done, case in enumerate(cases):
        told(done, len(cases))
        if time.monotonic() > end:
            break
        yield case
    told(len(cases), len(cases))


def about(machine: str, backends: Mapping[str, str], pictures: str, cpu: bool, skipped: int) -> str:
    """Return the sentence above the tables of a study; `skipped` counts the cases that the time did not suffice for."""
    devices = "; ".join(f"{name}: {device}" for name, device in backends.items())
    left = f" {skipped} measurements were left out for want of time." if skipped else ""
    return f"Measured on {machine} ({devices}), {pictures}, {'CPU time of all cores' if cpu else 'wall time'}.{left}"


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a Markdown table under its title; an empty text if it has no rows."""
    if not rows:
        return ""
    return f"**{title}**\n\n{sh.command.markdown([head, *rows])}"


def csv_of(rows: Sequence[Mapping[str, Any]], first: str) -> str:
    """Return lines of CSV under the names of the first row, `first` where there is none."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [first])
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def finish(axes: Iterable[Any], **legend: Any) -> None:
    """Give each of the axes that has data a legend, and hide the others."""
    for axis in axes:
        if axis.has_data():
            axis.legend(**legend)
        else:
            axis.set_axis_off()


def new_figure(path: str | Path, size: tuple[float, float] = (10, 6)) -> Any:
    """Return a matplotlib Figure of `size` in inches that can be written to `path`.

    Raises SceneError for an ending that is no picture format, or if matplotlib is missing; OSError if the picture, or
    the JSON beside it, cannot be written: FileNotFoundError if the folder does not exist.
    """
    path = Path(path)
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise SceneError(f"plots need matplotlib: {sh.packages.install('matplotlib')}") from error
    figure = Figure(figsize=size, layout="constrained")
    formats = sorted(figure.canvas.get_supported_filetypes())
    if path.suffix[1:].lower() not in formats:
        raise SceneError(f"{path}: plots are written as .{', .'.join(formats)}, not as {path.suffix or 'this'}")
    for written in (path, path.with_suffix(".json")):
        sh.files.check_writable(written)
    return figure


def save_figure(figure: Any, path: str | Path, content: Any, csv: str | None = None, dpi: int = 120) -> None:
    """Write the picture to `path`; `content` as JSON and `csv`, if given, go to files of the same name beside it."""
    path = Path(path)
    with sh.files.replacing(path) as temporary:
        figure.savefig(temporary, dpi=dpi)
    with sh.files.replacing(path.with_suffix(".json")) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n")
    if csv is not None:
        with sh.files.replacing(path.with_suffix(".csv")) as temporary:
            temporary.write_text(csv)
