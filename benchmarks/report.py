"""Reports of measurements: tables for the terminal and for Markdown, and JSON.

print(table(measured).markdown())
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.peers import PEERS
from benchmarks.rounds import Measured
from benchmarks.tables import Table
from benchmarks.work import TARGETS

OURS = {
    "opencl": "shpy, OpenCL",
    "plain": "shpy, plain call",
    "opencl-fused": "shpy, OpenCL, fused",
    "opencl-relaxed": "shpy, OpenCL, relaxed",
    "opencl-1": "shpy, OpenCL, lanes=1",
    "glsl": "shpy, GLSL",
    "numpy": "shpy, numpy",
}


def label(name: str) -> str:
    """Return a contender's name in a report."""
    return OURS.get(name) or PEERS[name].label


def base_of(measured: Measured) -> str:
    """Return the contender that others are compared with: the first of ours that ran, or else the first of all."""
    return next((t for t in TARGETS if t in measured.seconds), next(iter(measured.seconds), ""))


def spread(values: Any) -> tuple[float, float, float]:
    """Median, first and third quartile."""
    q = np.percentile(values, (50, 25, 75))
    return float(q[0]), float(q[1]), float(q[2])


def table(measured: Measured) -> Table:
    """Return a row for each contender: milliseconds, and how many times as long as the first of ours it took.

    Of both the median and the quartiles; the best call; and the CPU time of all threads. The row of a contender that
    failed says how, in place of the difference.
    """
    base, rows = base_of(measured), []
    for name, seconds in measured.seconds.items():
        (time, *times), (ratio, *ratios) = spread(seconds), spread(measured.ratios(name, base))
        cpu, cpu_of_base = (float(np.median(measured.cpu[n])) for n in (name, base))
        cells = [1e3 * time, "{:.2f} to {:.2f}".format(*(1e3 * t for t in times)), 1e3 * measured.best[name], 1e3 * cpu]
        cells += [ratio, "{:.2f} to {:.2f}".format(*ratios), measured.best[name] / measured.best[base]]
        cells += [cpu / cpu_of_base, measured.first[name], measured.agreement[name].text]
        rows.append([label(name), *(c if isinstance(c, str) else f"{c:.2f}" for c in cells)])
    head = ("", "ms", "quartiles", "best", "CPU", "ratio", "quartiles", "of bests", "of CPU", "first s", "difference")
    rows += [[label(name), *[""] * (len(head) - 2), f"failed: {why}"] for name, why in measured.failed.items()]
    title = measured.work.title.format(size=measured.size)
    return Table(measured.work.name, f"{title}. {measured.work.note}".strip(), head, rows)


def processor(machine: dict[str, Any]) -> str:
    """Return the cores and the name of the processor."""
    return f"{machine['cores']} cores, {machine['processor']}"


def heading(machine: dict[str, Any], missing: dict[str, str]) -> str:
    """Machine, versions, and what is not installed with its cure."""
    versions = f"{machine['system']}; Python {machine['python']}, numpy {machine['numpy']}"
    lines = [f"{processor(machine)}; {versions}"]
    lines += [f"{name}: {what}" for name, what in machine["devices"].items()]
    if machine["peers"]:
        lines.append("peers: " + ", ".join(f"{name} {version}" for name, version in machine["peers"].items()))
    lines += [f"{PEERS[name].label} is missing: {cure}" for name, cure in missing.items()]
    if machine["load"]:
        lines.append(f"load of the machine at the start: {machine['load'][0]}")
    return "\n".join(lines)


def as_json(measured: Measured) -> dict[str, Any]:
    """Return a work's measurements, seconds of every round included; `table` has their ratios."""
    return {
        "work": measured.work.name,
        "size": measured.size,
        "seconds": measured.seconds,
        "best": measured.best,
        "cpu": measured.cpu,
        "first call": measured.first,
        "agreement": {name: vars(a) for name, a in measured.agreement.items()},
        "failed": measured.failed,
    }
