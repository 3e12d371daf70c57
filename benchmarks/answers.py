"""Write docs/benchmarks.md, one page of answers, from the files in benchmarks/results: `python -m benchmarks page`.

Each file is what `python -m benchmarks --json FILE` writes: the date, the machine, the command, the seconds of every
round, and its tables. `--write` puts one there. Of a table that several files have, the page shows the newest; files in
`machines` are for the means of kernels on other machines alone.

>>> Results.read().cell("frame-1024", "shpy, OpenCL", "ms")
'32.70'
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import geometric_mean
from textwrap import fill
from typing import Any, Final

from shpy.command import markdown
from shpy.files import replacing

FOLDER: Final = Path(__file__).parent / "results"
PAGE: Final = Path(__file__).parents[1] / "docs" / "benchmarks.md"
OURS: Final = "shpy, OpenCL"
KERNELS: Final = ("mandelbrot", "nbody", "polynomial", "shader", "spheres", "blur")
RAYS: Final = ("primary", "primary-any", "secondary", "secondary-any")
FRAMES: Final = ("frame-256", "frame-1024")
CHAINS: Final = ("jacobi", "particles")
COLLECTIVES: Final = ("sum", "scan", "compact", "sort")
GROWTH: Final = ("pixels", "bounces", "lights")
MITSUBA: Final = "Mitsuba 3 (llvm_ad_rgb)"
OTHER_OPTIONS: Final = (f"{OURS}, fused", f"{OURS}, relaxed", f"{OURS}, lanes=1")
"""Contenders that the page shows for kernels alone."""

Rows = list[list[str]]


class NotMeasured(LookupError):
    """Raised where no run has a table."""


@dataclass(frozen=True)
class Results:
    """Runs by the name of their file; each holds tables by name. `machines` are runs on other machines."""

    runs: dict[str, dict[str, Any]]
    machines: dict[str, dict[str, Any]]

    @classmethod
    def read(cls, folder: Path = FOLDER) -> Results:
        """Read every file of a folder."""
        return cls(
            *({path.stem: _run(path) for path in sorted(f.glob("*.json"))} for f in (folder, folder / "machines"))
        )

    def stem(self, name: str) -> str:
        """Return the newest run with a table; NotMeasured if no run has it."""
        stems = [stem for stem, run in self.runs.items() if name in run["tables"]]
        if not stems:
            raise NotMeasured(f"no run has the table {name}: `python -m benchmarks --only {name} --write`")
        return max(stems, key=lambda stem: str(self.runs[stem]["date"]))

    def table(self, name: str, run: dict[str, Any] | None = None) -> dict[str, Any]:
        """Return the head and the rows of a table, of the newest run or of this one."""
        table: dict[str, Any] = (run or self.runs[self.stem(name)])["tables"][name]
        return table

    def cell(self, name: str, row: str, column: str, run: dict[str, Any] | None = None) -> str:
        """Return a cell by the first cell of its row and the head of its column; "" where there is no such cell."""
        table = self.table(name, run)
        cells = next((cells for cells in table["rows"] if cells[0] == row), ())
        return dict(zip(table["head"], cells, strict=False)).get(column, "")

    def part(self, name: str, *columns: str, but: str | None = None) -> Rows:
        """Return columns of a table without its head, or all; rows whose first cell ends with `but` are left out."""
        table = self.table(name)
        rows = [row for row in table["rows"] if but is None or not row[0].endswith(but)]
        by_head = [dict(zip(table["head"], row, strict=True)) for row in rows]
        return [[row.get(column, "") for column in columns] for row in by_head] if columns else rows

    def times(self, works: Sequence[str], mean: bool = True, run: dict[str, Any] | None = None) -> Rows:
        """Return the milliseconds of ours for works, how many times as long others take, and the geometric means."""
        labels = dict.fromkeys(row[0] for name in works for row in self.table(name, run)["rows"])
        rows = [["", *works], [f"{OURS}, ms", *(self.cell(name, OURS, "ms", run) for name in works)]]
        rows += [[label, *(self.cell(n, label, "ratio", run) for n in works)] for label in labels if label != OURS]
        if mean:
            rows[0].append("geometric mean")
            rows[1].append("")
            for row in rows[2:]:
                row.append(f"{geometric_mean(map(float, row[1:])):.2f}" if all(row) else "")
        return rows

    def with_means(self, rows: Rows) -> Rows:
        """Return the rows of kernels with the geometric means of other machines in further columns."""
        for run in self.machines.values():
            means = {row[0]: row[-1] for row in self.times(KERNELS, run=run)}
            machine = run["machine"].split(";")[0].removeprefix("2 cores, ").replace("(R)", "")
            rows = [[*row, means.get(row[0], "") if row[0] else f"mean on {machine}"] for row in rows]
        return rows


def _run(path: Path) -> dict[str, Any]:
    run: dict[str, Any] = json.loads(path.read_text())
    return run | {"tables": {table["name"]: table for table in run["tables"]}}


def drop_superseded(folder: Path) -> None:
    """Remove the files of a folder of whose tables newer files have each."""
    results = Results.read(folder)
    for stem, run in results.runs.items():
        if all(results.stem(name) != stem for name in run["tables"]):
            (folder / f"{stem}.json").unlink()


PREFACE: Final = """\
`python -m benchmarks` measures all of this on your machine and `--only NAMES` a part; `scripts/setup bench` installs
those that we compare with. With `--write --mesh bunny.obj` it measures this page anew, on a machine without other work.
`benchmarks/results` has the rounds and the other columns: quartiles, best calls, CPU time, and how far answers differ.

Contenders take turns, round after round, {processes}. Unless a table says otherwise, a number is the median over
the rounds of a contender's time as a multiple of ours in the same round, so **2.0 takes twice as long as ours**. Time
begins with arrays in the host's memory and ends with an array there. Contenders compute in binary32 on all cores, but
numpy and Warp use one core. shpy runs in strict mode unless a row names another, so its bits are the same on
all backends; Warp rounds as written, too. numba, Taichi, Dr.Jit and JAX may fuse and reorder arithmetic. Three seconds
of plain calls settle their backend first."""


STRICT: Final = """\
Two rows show the price of strict mode's roundings. It rounds each product and each sum of the polynomial, 62 operations
for the 31 of contenders that fuse them; OpenCL C by hand with the same roundings is no faster. A pair of bodies takes
31 operations, 13 of them for a correctly rounded 1 / sqrt(x), and about 17 where products fuse with sums. Relaxed
mode's 1 / sqrt(x) has an error of at most 1.5 units in the last place; numba's, with one step less and no case for 0,
of 2.4."""


def page(results: Results) -> str:
    """Return the page; sections whose tables are not all measured are named at its end."""
    apart = all(run.get("apart") for run in results.runs.values())
    preface = PREFACE.format(processes="peers in processes of their own" if apart else "in one process")
    preface = " ".join([preface, *sources(results)])
    parts: list[str | Rows] = ["# Benchmarks", *preface.split("\n\n")]
    lacking = []
    for write in (kernels, rays, paths, features, chains, calls, starts):
        try:
            parts += write(results)
        except NotMeasured as error:
            lacking.append(f"- {write.__name__} are not on this page: {error.args[0]}")
    parts += ["\n".join(lacking)] if lacking else []
    return "\n\n".join(written(part) for part in parts) + "\n"


def written(part: str | Rows) -> str:
    """Return a part of the page: a table, a paragraph in lines of 130 characters, or lines that stay as they are."""
    if not isinstance(part, str):
        return markdown(part)
    return part if part.startswith(("#", "- ")) else fill(part, 130, break_long_words=False, break_on_hyphens=False)


def section(title: str, results: Results, *names: str) -> list[str | Rows]:
    """Return a heading, and where and how the numbers of these tables were measured."""
    runs = [results.runs[stem] for stem in dict.fromkeys(map(results.stem, names))]
    places = (f"{run['date'][:10]}, {run['machine'].split(';')[0]}: `{run['command']}`." for run in runs)
    return [f"## {title}", " ".join(places)]


def sources(results: Results) -> list[str]:
    """Return a sentence on the runs that have no rounds in the tree."""
    return [f"Older figures are from {text}." for text in {run.get("source") for run in results.runs.values()} - {None}]


def kernels(results: Results) -> list[str | Rows]:
    """Return the six kernels beside other systems, and on other machines."""
    return [
        *section("How fast are kernels?", results, *KERNELS),
        results.with_means(results.times(KERNELS)),
        STRICT,
    ]


def rays(results: Results) -> list[str | Rows]:
    """Return rays and frames, and how their time grows."""
    mesh = results.table(RAYS[0])["note"].split(", ")[-1].partition(".")[0]
    return [
        *section("How fast are rays and pictures?", results, *RAYS, *FRAMES, "triangles", *GROWTH),
        f"Rays meet {mesh.replace('stanford-bunny', 'the Stanford bunny')}: a million coherent ones from the eye, a "
        "quarter of a million incoherent ones from its surface, the closest hit or any. Frames show it on a mirror, at "
        "256 and 1,024 pixels along each side. Below, million rays a second, closest hit; and milliseconds of a frame.",
        [row for row in results.times((*RAYS, *FRAMES), mean=False) if row[0] not in OTHER_OPTIONS],
        [results.table("triangles")["head"], *results.part("triangles")],
        "\n".join(growth(results, name) for name in GROWTH),
    ]


def growth(results: Results, name: str) -> str:
    """Return how the time of a frame grows with one number, as a line of a list."""
    table = results.table(name)
    return f"- {table['head'][0]}: " + ", ".join(f"{row[0]} takes {row[1]}" for row in table["rows"])


def paths(results: Results) -> list[str | Rows]:
    """Return path tracing beside Mitsuba."""
    columns = ("of times", "of variances", "to equal error")
    return [
        *section("How long does path tracing take to equal error?", results, "equal-error"),
        f"In multiples of {MITSUBA}. To equal error: the ratio of times, times that of variances.",
        [["", *columns], *results.part("equal-error", "scene", *columns, but=MITSUBA)],
    ]


def features(results: Results) -> list[str | Rows]:
    """Return what features of the ray tracer cost; those that cost little are named in one sentence."""
    head = ["", "rays a pixel", "numpy", "opencl", "glsl"]
    plain, *rows = results.part("features", "feature", *head[1:])
    cheap = [row[0] for row in rows if max(float(cell) for cell in row[2:] if cell) < 1.2]
    return [
        *section("What does a feature of the ray tracer cost?", results, "features"),
        "CPU time in multiples of the plain picture's, which has two matt materials and one light. Less than 1.2 on "
        f"every backend: {', '.join(cheap)}.",
        [head, plain, *(row for row in rows if row[0] not in cheap)],
    ]


def chains(results: Results) -> list[str | Rows]:
    """Return chains and collective operations beside each other, a row for each contender of either."""
    sides = [
        results.times(CHAINS, mean=False),
        results.times(COLLECTIVES, mean=False),
    ]
    labels = dict.fromkeys(row[0] for side in sides for row in side if row[0] not in OTHER_OPTIONS)
    cells = [({row[0]: row[1:] for row in side}, [""] * (len(side[0]) - 1)) for side in sides]
    return [
        *section("What do chains and collective operations cost?", results, *CHAINS, *COLLECTIVES),
        "Chains: 500 steps of Jacobi's iteration at 1,024 x 1,024, and 50 steps that sort and count 65,536 "
        "particles, for which numba has a counting sort written by hand. Collective "
        "operations: over ten million numbers. Streams that name no backend lie on numpy: so do the plain ones of all "
        "but Jacobi's iteration, which is a chain over an array.",
        [[label, *(cell for rows, empty in cells for cell in rows.get(label, empty))] for label in labels],
    ]


def calls(results: Results) -> list[str | Rows]:
    """Return the time of a call, a row for each backend."""
    name = "calls"
    ways = {"arrays": "", "`out=`": ", out=", "streams": ", streams", "in a chain": ", in a chain"}
    ours = [
        [f"shpy, {backend}", *(results.cell(name, f"shpy, {backend}{way}", "median") for way in ways.values())]
        for backend in ("plain call", "numpy", "opencl", "glsl")
    ]
    others = [f"{row[0]} takes {row[1]}" for row in results.part(name) if not row[0].startswith("shpy")]
    return [
        *section("What does a call cost?", results, name),
        "Microseconds of x + 1 over 64 numbers; in a chain of 100 kernels, one of them. With arrays, "
        f"{', '.join(others)}.",
        [["", *ways], *ours],
    ]


def starts(results: Results) -> list[str | Rows]:
    """Return the seconds until programs are compiled and a picture is written, by backend, and those of imports."""
    backends = ("numpy", "opencl", "glsl")
    rows: dict[str, list[str]] = {}
    for program, backend, *_, cold, warm in results.part("compiling"):
        if backend in backends:
            rows.setdefault(program, []).extend((cold, warm))
    rows["`raytracer render`"] = [cell for row in results.part("starting") if row[0] in backends for cell in row[1:3]]
    head = ["", *(f"{backend}, {state}" for backend in backends for state in ("cold", "warm"))]
    imports = [f"{row[0]} {row[1]} ({row[2]})" for row in results.part("importing")]
    return [
        *section("How soon does a program run?", results, "compiling", "starting", "importing"),
        "Seconds until a program is compiled, and of `raytracer render boxes --size 256x256` in all: cold in a "
        "process that finds nothing kept, warm in a later one. Imports without bytecode (with it): "
        f"{', '.join(imports)}.",
        [head, *([name, *cells] for name, cells in rows.items())],
    ]


def write_page(folder: Path = FOLDER) -> None:
    """Write docs/benchmarks.md; for another folder of results, benchmarks.md there."""
    with replacing(PAGE if folder == FOLDER else folder / PAGE.name) as path:
        path.write_text(page(Results.read(folder)))
