"""Reports of measurements: tables for the terminal and for Markdown, and JSON.

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
    "opencl-relaxed": "shpy, OpenCL, relaxed",
    "opencl-1": "shpy, OpenCL, lanes=1",
    "glsl": "shpy, GLSL",
    "numpy": "shpy, numpy",
    "numpy-relaxed": "shpy, numpy, relaxed",
}
PREFACE = """\
# Benchmarks

Made by `python -m benchmarks --mesh bunny.obj --markdown FILE`; `scripts/setup bench` installs the peers, and
those that are missing are left out. Everything runs in one process, in turns: each contender once, then each again,
round after round, after a warm-up that compiles what is to be compiled. Answers are compared with numpy's, in the
tolerance that the source of each work states.

- **ms** is the median of the rounds, with the first and the third quartile; **best** the fastest single call; **CPU**
  the time that all threads of the process spent computing, of which threads that wait for work by looking for it have
  more than they need. **ratio** is how many times as long as the first row a contender took, round by round.
- Time begins with arrays in the host's memory and ends with an array there. Pictures that are computed from nothing but
  their size have no inputs. Mitsuba and embreex hold rays as arrays of their own from the start.
- Every contender uses the cores that it uses by default: all, but for numpy, embreex and Warp, which use one. All work
  with 32-bit floats. numba, Taichi, Dr.Jit and JAX may fuse and reorder arithmetic, and so may ours where it says
  relaxed; otherwise ours, which is strict, and Warp round as written.
- Where the machine does other work at the same time, the ratios of the best calls and of CPU time say more than
  milliseconds.
"""

HEAD = (
    "",
    "median ms",
    "from",
    "to",
    "best",
    "CPU",
    "ratio",
    "from",
    "to",
    "of bests",
    "of CPU",
    "first s",
    "difference",
)
SIDES = "<" + ">" * 11 + "<"


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


def rows(measured: Measured) -> list[tuple[str, ...]]:
    """Return a row for each contender: milliseconds, and how many times as long as the first of ours it took.

    Of both the median, the first and the third quartile; the best call; and the CPU time of all threads.
    """
    base, lines = base_of(measured), []
    for name, seconds in measured.seconds.items():
        times = [f"{1e3 * t:.2f}" for t in spread(seconds)]
        ratios = [f"{r:.2f}" for r in spread(measured.ratios(name, base))]
        cpu, cpu_of_base = (float(np.median(measured.cpu[n])) for n in (name, base))
        times += [f"{1e3 * measured.best[name]:.2f}", f"{1e3 * cpu:.2f}"]
        ratios += [f"{measured.best[name] / measured.best[base]:.2f}", f"{cpu / cpu_of_base:.2f}"]
        lines.append((label(name), *times, *ratios, f"{measured.first[name]:.2f}", measured.agreement[name].text))
    return lines


def title(measured: Measured) -> str:
    """Return the title of a measurement, with its size."""
    return measured.work.title.format(size=measured.size)


def table(measured: Measured) -> str:
    """Return the rows for the terminal, with who failed."""
    lines = [HEAD, *rows(measured)]
    widths = [max(len(row[i]) for row in lines) for i in range(len(HEAD))]
    text = [
        "  ".join(f"{c:{side}{w}}" for c, side, w in zip(row, SIDES, widths, strict=True)).rstrip() for row in lines
    ]
    failures = [f"{label(name)} failed: {why}" for name, why in measured.failed.items()]
    return "\n".join([f"{measured.work.name}: {title(measured)}", *text, *failures])


def markdown(measured: Measured) -> str:
    """Return the rows as Markdown."""
    head = ("", "ms", "quartiles", "best", "CPU", "ratio", "quartiles", "of bests", "of CPU", "difference")
    body = [
        (r[0], r[1], f"{r[2]} to {r[3]}", r[4], r[5], r[6], f"{r[7]} to {r[8]}", *r[9:11], r[12])
        for r in rows(measured)
    ]
    lines = [f"### {measured.work.name}", "", title(measured) + ". " + measured.work.note, ""]
    lines += ["| " + " | ".join(row) + " |" for row in (head, ("---", *["---:"] * 8, "---"), *body)]
    lines += [f"\n{label(name)} failed: {why}" for name, why in measured.failed.items()]
    return "\n".join(lines).replace(". \n", ".\n") + "\n"


def geometric_means(results: Iterable[Measured], base: str) -> dict[str, tuple[float, float, float, float, int]]:
    """By contender, geometric means of its ratios to `base`: medians, best calls, CPU; the least median; how many."""
    ratios_by_name: dict[str, list[tuple[float, float, float]]] = {}
    for m in results:
        for name in m.seconds if base in m.seconds else ():
            if name != base:
                cpu = np.median(m.cpu[name]) / np.median(m.cpu[base])
                median = float(np.median(m.ratios(name, base)))
                ratios_by_name.setdefault(name, []).append((median, m.best[name] / m.best[base], float(cpu)))
    means = {}
    for name, ratios in ratios_by_name.items():
        median, best, cpu = np.exp(np.mean(np.log(ratios), axis=0)).tolist()
        means[name] = (median, best, cpu, min(r[0] for r in ratios), len(ratios))
    return means


def means(results: Sequence[Measured], bases: Sequence[str] = ("opencl", "opencl-relaxed", "numpy")) -> str:
    """Return the geometric means over each group of works, as Markdown that a terminal shows well too."""
    lines = []
    for group in dict.fromkeys(m.work.group for m in results):
        members = [m for m in results if m.work.group == group]
        for base in bases:
            means_by_name = geometric_means(members, base)
            if means_by_name:
                lines += [f"How many times as long as {label(base)} they take, geometric means of {group}:", ""]
                lines += ["| | medians | best calls | CPU | least median | works |", "|---|---:|---:|---:|---:|---:|"]
                lines += [
                    f"| {label(n)} | {' | '.join(f'{x:.2f}' for x in m)} | {c} |"
                    for n, (*m, c) in means_by_name.items()
                ]
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
    """Return a work's measurements, seconds of every round included."""
    base = base_of(measured)
    return {
        "work": measured.work.name,
        "title": title(measured),
        "size": measured.size,
        "seconds": measured.seconds,
        "best": measured.best,
        "cpu": measured.cpu,
        "first call": measured.first,
        "ratio to": base,
        "ratios": {name: spread(measured.ratios(name, base)) for name in measured.seconds},
        "agreement": {name: vars(a) for name, a in measured.agreement.items()},
        "failed": measured.failed,
    }
