"""Write docs/benchmarks.md, one page of answers, from the files in benchmarks/results: `python -m benchmarks page`.

Each file is what `python -m benchmarks --json FILE` writes: the date, the machine, the command, and its tables.

>>> Results.read().cell("main/frame-1024", "shpy, OpenCL", "ms")
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
MITSUBA: Final = "Mitsuba 3 (llvm_ad_rgb)"

Rows = list[list[str]]


@dataclass(frozen=True)
class Results:
    """Runs by the name of their file; each holds tables by name. A table is called `file/name`."""

    runs: dict[str, dict[str, Any]]

    @classmethod
    def read(cls, folder: Path = FOLDER) -> Results:
        """Read every file of a folder."""
        runs = {path.stem: json.loads(path.read_text()) for path in folder.glob("*.json")}
        return cls({stem: run | {"tables": {t["name"]: t for t in run["tables"]}} for stem, run in runs.items()})

    def table(self, name: str) -> dict[str, Any]:
        """Return the head and the rows of a table."""
        stem, _, own = name.partition("/")
        table: dict[str, Any] = self.runs[stem]["tables"][own]
        return table

    def cell(self, name: str, row: str, column: str) -> str:
        """Return a cell by the first cell of its row and the head of its column; "" where there is no such row."""
        table = self.table(name)
        place = table["head"].index(column)
        return next((cells[place] for cells in table["rows"] if cells[0] == row), "")

    def whole(self, name: str) -> Rows:
        """Return a table with its head."""
        return [self.table(name)["head"], *self.table(name)["rows"]]

    def part(self, name: str, *columns: str, but: str | None = None) -> Rows:
        """Return columns of a table without its head, or all; rows whose first cell ends with `but` are left out."""
        table = self.table(name)
        places = [table["head"].index(column) for column in columns] or range(len(table["head"]))
        return [[cells[k] for k in places] for cells in table["rows"] if but is None or not cells[0].endswith(but)]

    def times(self, stem: str, works: Sequence[str], mean: bool = True) -> Rows:
        """Return the milliseconds of ours for works, how many times as long others take, and the geometric means."""
        names = [f"{stem}/{work}" for work in works]
        labels = dict.fromkeys(row[0] for name in names for row in self.table(name)["rows"])
        rows = [["", *works], [f"{OURS}, ms", *(self.cell(name, OURS, "ms") for name in names)]]
        rows += [[label, *(self.cell(name, label, "ratio") for name in names)] for label in labels if label != OURS]
        if mean:
            rows[0].append("geometric mean")
            rows[1].append("")
            for row in rows[2:]:
                row.append(f"{geometric_mean(map(float, row[1:])):.2f}" if all(row) else "")
        return rows

    def machines(self, stems: Sequence[str]) -> Rows:
        """Return the geometric means over the six kernels on several machines, of those that all of them ran."""
        means = [{row[0]: row[-1] for row in self.times(stem, KERNELS)[2:]} for stem in stems]
        labels = [label for label in means[0] if all(mean.get(label) for mean in means)]
        processors = (self.runs[stem]["machine"].split(";")[0].removeprefix("2 cores, ") for stem in stems)
        head = ["geometric means", *processors]
        return [head, *([label, *(mean[label] for mean in means)] for label in labels)]


PREFACE: Final = """\
`python -m benchmarks` measures all of this on your machine and `--only NAMES` a part; `scripts/setup bench` installs
those that we compare with. `python -m benchmarks page` writes this page from `benchmarks/results`, where the other
columns are: quartiles, best calls, CPU time, and how far answers differ.

Contenders take turns in one process, round after round. Unless a table says otherwise, a number is the median over
the rounds of a contender's time as a multiple of ours in the same round, so **2.0 takes twice as long as ours**. Time
begins with arrays in the host's memory and ends with an array there. Contenders compute in binary32 on all cores, but
numpy, Embree and Warp use one core. shpy runs in strict mode unless a row names another, so its bits are the same on
all backends; Warp rounds as written, too. numba, Taichi, Dr.Jit and JAX may fuse and reorder arithmetic."""


def page(results: Results) -> str:
    """Return the page."""
    parts: list[str | Rows] = ["# Benchmarks", *PREFACE.split("\n\n"), sources(results)]
    for write in (kernels, rays, paths, features, chains, calls, starts):
        parts += write(results)
    return "\n\n".join(written(part) for part in parts) + "\n"


def written(part: str | Rows) -> str:
    """Return a part of the page: a table, a paragraph in lines of 130 characters, or lines that stay as they are."""
    if not isinstance(part, str):
        return markdown(part)
    return part if part.startswith(("#", "- ")) else fill(part, 130, break_long_words=False, break_on_hyphens=False)


def section(title: str, results: Results, *stems: str) -> list[str | Rows]:
    """Return a heading, and where and how its numbers were measured."""
    runs = [results.runs[stem] for stem in stems]
    places = (f"{run['date']}, {run['machine'].split(';')[0]}: `{run['command']}`." for run in runs)
    return [f"## {title}", " ".join(places)]


def sources(results: Results) -> str:
    """Return which runs have no rounds of their own in the tree."""
    texts = dict.fromkeys(run["source"] for run in results.runs.values() if "source" in run)
    return " ".join(f"Taken over from {text}." for text in texts)


def kernels(results: Results) -> list[str | Rows]:
    """Return the six kernels beside other systems, and on other machines."""
    return [
        *section("How fast are kernels?", results, "main"),
        results.times("main", KERNELS),
        results.machines(("main", "xeon", "avx2")),
    ]


def rays(results: Results) -> list[str | Rows]:
    """Return rays and frames, and how their time grows."""
    return [
        *section("How fast are rays and pictures?", results, "main"),
        "Rays meet the Stanford bunny: a million coherent ones from the eye, a quarter of a million incoherent ones "
        "from its surface, the closest hit or any. Frames show it on a mirror, at 256 and 1,024 pixels along each "
        "side. Below, million rays a second, closest hit; and milliseconds of a frame.",
        results.times("main", (*RAYS, *FRAMES), mean=False),
        results.whole("main/triangles"),
        "\n".join(growth(results, name) for name in ("main/pixels", "main/bounces", "main/lights")),
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
        [["", *columns], *results.part("equal-error/equal-error", "scene", *columns, but=MITSUBA)],
    ]


def features(results: Results) -> list[str | Rows]:
    """Return what features of the ray tracer cost; those that cost little are named in one sentence."""
    head = ["", "rays a pixel", "numpy", "opencl", "glsl"]
    plain, *rows = results.part("features/features", "feature", *head[1:])
    cheap = [row[0] for row in rows if max(map(float, row[2:])) < 1.2]
    return [
        *section("What does a feature of the ray tracer cost?", results, "features"),
        "CPU time in multiples of the plain picture's, which has two matt materials and one light. Less than 1.2 on "
        f"every backend: {', '.join(cheap)}.",
        [head, plain, *(row for row in rows if row[0] not in cheap)],
    ]


def chains(results: Results) -> list[str | Rows]:
    """Return chains and collective operations beside each other, a row for each contender of either."""
    sides = [
        results.times("chains", ("jacobi", "particles"), mean=False),
        results.times("collectives", ("sum", "scan", "compact", "sort"), mean=False),
    ]
    labels = dict.fromkeys(row[0] for side in sides for row in side)
    cells = [({row[0]: row[1:] for row in side}, [""] * (len(side[0]) - 1)) for side in sides]
    return [
        *section("What do chains and collective operations cost?", results, "chains", "collectives"),
        "Chains: 500 steps of Jacobi's iteration at 1,024 x 1,024, and 50 steps that sort and count 65,536 "
        "particles, for which Taichi, numba and pyopencl have a counting sort written by hand. Collective "
        "operations: over ten million numbers.",
        [[label, *(cell for rows, empty in cells for cell in rows.get(label, empty))] for label in labels],
    ]


def calls(results: Results) -> list[str | Rows]:
    """Return the time of a call, a row for each backend."""
    name = "chains/calls"
    ways = {"arrays": "", "`out=`": ", out=", "streams": ", streams", "in a chain": ", in a chain"}
    ours = [
        [f"shpy, {backend}", *(results.cell(name, f"shpy, {backend}{way}", "median") for way in ways.values())]
        for backend in ("numpy", "opencl", "glsl")
    ]
    others = [f"{row[0]} takes {row[1]}" for row in results.part(name) if not row[0].startswith("shpy")]
    return [
        *section("What does a call cost?", results, "chains"),
        "Microseconds of x + 1 over 64 numbers; in a chain of 100 kernels, one of them. With arrays, "
        f"{', '.join(others)}.",
        [["", *ways], *ours],
    ]


def starts(results: Results) -> list[str | Rows]:
    """Return the seconds until programs are compiled and a picture is written, by backend, and those of imports."""
    backends = ("numpy", "opencl", "glsl")
    rows: dict[str, list[str]] = {}
    for program, backend, *_, cold, warm in results.part("starting/compiling"):
        if backend in backends:
            rows.setdefault(program, []).extend((cold, warm))
    rows["`raytracer render`"] = [cell for row in results.part("starting/starting") for cell in row[1:]]
    head = ["", *(f"{backend}, {state}" for backend in backends for state in ("cold", "warm"))]
    imports = [f"{row[0]} {row[1]} ({row[2]})" for row in results.part("starting/importing")]
    return [
        *section("How soon does a program run?", results, "starting"),
        "Seconds until a program is compiled, and of `raytracer render boxes --size 256x256` in all: cold in a "
        "process that finds nothing kept, warm in a later one. Imports without bytecode (with it): "
        f"{', '.join(imports)}.",
        [head, *([name, *cells] for name, cells in rows.items())],
    ]


def write_page() -> None:
    """Write docs/benchmarks.md."""
    with replacing(PAGE) as path:
        path.write_text(page(Results.read()))
