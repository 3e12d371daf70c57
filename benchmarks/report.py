"""What is printed and written about measurements: tables for the terminal and for Markdown, and JSON.

print(table(measured))
print(means(all_measured))
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks.peers import PEERS
from benchmarks.rounds import Measured
from benchmarks.work import TARGETS

OURS = {
    "opencl": "shpy, OpenCL",
    "opencl-1": "shpy, OpenCL, lanes=1",
    "glsl": "shpy, GLSL",
    "numpy": "shpy, numpy",
}
HEAD = ("", "median ms", "from", "to", "ratio", "from", "to", "first call s", "largest difference")
SIDES = "<>>>>>>><"


def label(name: str) -> str:
    """What a contender is called in a report."""
    return OURS.get(name) or PEERS[name].label


def base_of(measured: Measured) -> str:
    """The contender that others are compared with: the first of ours that ran, or else the first of all."""
    return next((t for t in TARGETS if t in measured.seconds), next(iter(measured.seconds), ""))


def spread(values: Any) -> tuple[float, float, float]:
    """Median, first and third quartile."""
    q = np.percentile(values, (50, 25, 75))
    return float(q[0]), float(q[1]), float(q[2])


def rows(measured: Measured) -> list[tuple[str, ...]]:
    """A row for each contender: seconds, and how many times as long as the first of ours it took."""
    base, found = base_of(measured), []
    for name, seconds in measured.seconds.items():
        times = [f"{1e3 * t:.2f}" for t in spread(seconds)]
        ratios = [f"{r:.2f}" for r in spread(measured.ratios(name, base))]
        found.append((label(name), *times, *ratios, f"{measured.first[name]:.2f}", measured.agreement[name].text))
    return found


def title(measured: Measured) -> str:
    """What was measured, at which size."""
    return measured.work.title.format(size=measured.size)


def table(measured: Measured) -> str:
    """The rows for the terminal, with who failed."""
    lines = [HEAD, *rows(measured)]
    widths = [max(len(row[i]) for row in lines) for i in range(len(HEAD))]
    text = [
        "  ".join(f"{c:{side}{w}}" for c, side, w in zip(row, SIDES, widths, strict=True)).rstrip() for row in lines
    ]
    failures = [f"{label(name)} failed: {why}" for name, why in measured.failed.items()]
    return "\n".join([f"{measured.work.name}: {title(measured)}", *text, *failures])


def markdown(measured: Measured) -> str:
    """The rows as Markdown."""
    head = ("", "ms, median", "quartiles", "ratio, median", "quartiles", "difference")
    body = [(r[0], r[1], f"{r[2]} to {r[3]}", r[4], f"{r[5]} to {r[6]}", r[8]) for r in rows(measured)]
    lines = [f"### {measured.work.name}", "", title(measured) + ". " + measured.work.note, ""]
    lines += ["| " + " | ".join(row) + " |" for row in (head, ("---", *["---:"] * 4, "---"), *body)]
    lines += [f"\n{label(name)} failed: {why}" for name, why in measured.failed.items()]
    return "\n".join(lines).replace(". \n", ".\n") + "\n"


def geometric_means(results: Iterable[Measured], base: str) -> dict[str, tuple[float, float, int]]:
    """By contender: the geometric mean of its median ratios to `base`, the least of them, and how many works."""
    found: dict[str, list[float]] = {}
    for measured in results:
        if base in measured.seconds:
            for name in measured.seconds:
                if name != base:
                    found.setdefault(name, []).append(float(np.median(measured.ratios(name, base))))
    return {n: (float(np.exp(np.mean(np.log(r)))), min(r), len(r)) for n, r in found.items()}


def means(results: Sequence[Measured], bases: Sequence[str] = ("opencl", "numpy")) -> str:
    """The geometric means over all works, as Markdown that a terminal shows well too."""
    lines = []
    for base in bases:
        found = geometric_means(results, base)
        if not found:
            continue
        lines += [f"{label(base)} against:", "", "| | geometric mean | least | works |", "|---|---:|---:|---:|"]
        lines += [f"| {label(n)} | {mean:.2f} | {least:.2f} | {count} |" for n, (mean, least, count) in found.items()]
        lines.append("")
    return "\n".join(lines)


def heading(machine: dict[str, Any], missing: dict[str, str]) -> str:
    """Machine, versions, and what is not installed with its cure."""
    versions = f"{machine['system']}; Python {machine['python']}, numpy {machine['numpy']}"
    lines = [f"{machine['cores']} cores, {machine['processor']}; {versions}"]
    lines += [f"{name}: {what}" for name, what in machine["devices"].items()]
    if machine["peers"]:
        lines.append("peers: " + ", ".join(f"{name} {version}" for name, version in machine["peers"].items()))
    lines += [f"{PEERS[name].label} is missing: {cure}" for name, cure in missing.items()]
    if machine["load"]:
        lines.append(f"load of the machine at the start: {machine['load'][0]}")
    return "\n".join(lines)


def as_json(measured: Measured) -> dict[str, Any]:
    """A work's measurements, seconds of every round included."""
    base = base_of(measured)
    return {
        "work": measured.work.name,
        "title": title(measured),
        "size": measured.size,
        "seconds": measured.seconds,
        "first call": measured.first,
        "ratio to": base,
        "ratios": {name: spread(measured.ratios(name, base)) for name in measured.seconds},
        "agreement": {name: vars(a) for name, a in measured.agreement.items()},
        "failed": measured.failed,
    }
