"""Runs shpy and every installed peer side by side: `python -m benchmarks --help`.

    python -m benchmarks                                  # everything: half an hour on two cores
    python -m benchmarks --only mandelbrot,nbody --peers numba,drjit --rounds 9
    python -m benchmarks --only primary,secondary --mesh bunny.obj
    python -m benchmarks --quick                          # small sizes, few rounds: does it work?
    python -m benchmarks --write --mesh bunny.obj         # measure docs/benchmarks.md anew, on a quiet machine
    python -m benchmarks --only calls --write             # a part of it
    python -m benchmarks --quick --write FOLDER           # the page and its results in another folder: does it work?
    python -m benchmarks --json bench.json
    python -m benchmarks page                             # docs/benchmarks.md, from benchmarks/results

The exit status is 1 if an answer is wrong, or a contender, a work or a study fails; the rest goes on. A peer has ten
minutes for an answer. `--json` and `--write` write what there is after each table, to FILE.unfinished until the run
ends. After Ctrl-C that file stays: without the ending `.unfinished` it is a file of results as every other.
"""

from __future__ import annotations

import argparse
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import (
    answers,
    calls,
    chains,
    collectives,
    equal_error,
    features,
    frames,
    gradients,
    looks,
    machine,
    peers,
    rays,
    report,
    rounds,
    startup,
    studies,
)
from benchmarks.kernels import blur, mandelbrot, nbody, polynomial, shader, spheres
from benchmarks.rounds import Measured
from benchmarks.tables import Setup, Table
from benchmarks.work import TARGETS, Work
from raytracer import Mesh
from raytracer.meshes.shapes import knot
from shpy.command import run, whole
from shpy.errors import ShpyError
from shpy.pictures.outputs import check_file, write_json

KERNELS = {m.WORK.name: m.WORK for m in (mandelbrot, nbody, polynomial, shader, spheres, blur)}
CHAINS = {w.name: w for w in (*chains.WORKS, *collectives.WORKS)}
WORKS = (*KERNELS, *CHAINS, *rays.NAMES, *frames.NAMES)
"""The names of what is run side by side."""
STUDIES: dict[str, Callable[[Setup], Table]] = {
    **{f.__name__: f for f in (studies.triangles, studies.pixels, studies.bounces, studies.lights, studies.instances)},
    **{f.__name__: f for f in (startup.compiling, startup.starting, startup.importing, startup.sessions)},
    **{f.__name__: f for f in (gradients.gradients, gradients.fitting, gradients.components)},
    **{f.__name__: f for f in (calls.calls, features.features, looks.looks)},
    "equal-error": equal_error.equal_error,
}
"""Studies of shpy, most of them without a peer."""
WHAT = "page: write docs/benchmarks.md from benchmarks/results, and measure nothing"
WRITE = "keep the results there (benchmarks/results), and write the page of answers (docs/benchmarks.md)"


def works(names: Sequence[str], mesh: Mesh) -> list[Work]:
    """Return the works of these names; those with triangles have the mesh's."""
    works_by_name = KERNELS | CHAINS | {w.name: w for w in (*rays.works(mesh), *frames.works(mesh))}
    return [works_by_name[name] for name in names]


def work_of(name: str, mesh: Mesh, peer: str) -> Work:
    """Return the work of a name in the process of a peer, which is started."""
    peers.start(peer)
    return works([name], mesh)[0]


def mesh_of(path: Path | None, quick: bool) -> Mesh:
    """Return the mesh in a file; a knot of 70,400 triangles if there is none, of 1,440 if it is to be quick."""
    if path is not None:
        return Mesh.load(path)
    return knot(segments=60, sides=12) if quick else knot(segments=880, sides=40)


def chosen(text: str | None, choices: Any, what: str) -> list[str]:
    """Return the names in a list with commas; all where there is none. Exits where a name is not known."""
    names = text.split(",") if text else list(choices)
    unknown = [name for name in names if name not in choices]
    if unknown:
        sys.exit(f"no {what} {', '.join(unknown)}; there are {', '.join(choices)}")
    return names


def arguments(argv: list[str] | None) -> argparse.Namespace:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__, formatter_class=plain)
    parser.add_argument("what", nargs="?", choices=["all", "page"], default="all", help=WHAT)
    parser.add_argument("--only", metavar="WORKS", help=f"some of {','.join((*WORKS, *STUDIES))}")
    parser.add_argument("--peers", metavar="PEERS", help=f"some of {','.join(peers.PEERS)}; 'none' for none")
    parser.add_argument("--targets", metavar="TARGETS", help=f"some of {','.join(TARGETS)}")
    parser.add_argument("--rounds", type=whole(1), help="how often each is timed (default: 9, quick: 2)")
    parser.add_argument("--mesh", type=Path, metavar="FILE", help="OBJ, PLY, STL or GLB for rays and frames")
    parser.add_argument("--size", type=whole(1), help="a size other than a work's own")
    parser.add_argument("--quick", action="store_true", help="small sizes")
    parser.add_argument("--json", type=Path, metavar="FILE", help="every number")
    parser.add_argument("--write", type=Path, nargs="?", const=answers.FOLDER, metavar="FOLDER", help=WRITE)
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Run the command; 1 if an answer was wrong or a contender failed, 2 for a file that cannot be written."""
    return run("benchmarks", lambda: compare(arguments(argv)))


def compare(options: argparse.Namespace) -> int:
    """Measure and write what the options ask for; gives the exit status."""
    if options.what == "page":
        answers.write_page()
        return 0
    try:
        check_files(options)
    except ShpyError as error:
        print(f"benchmarks: {error}", file=sys.stderr)
        return 2
    peer_names = [] if options.peers == "none" else chosen(options.peers, peers.PEERS, "peer")
    names = chosen(options.only, (*WORKS, *STUDIES), "work")
    targets = chosen(options.targets, TARGETS, "target")
    present, missing = peers.available(peer_names)
    setup = Setup(mesh_of(options.mesh, options.quick), options.quick, peer_names)
    here = machine.describe(present)
    print(report.heading(here, missing), end="\n\n")
    outcome = Outcome(options, here, missing)
    try:
        for name in names:
            progress(name)
            outcome.take(name, partial(study_or_work, name, setup, [*targets, *present], options))
    except KeyboardInterrupt as error:
        raise type(error)(outcome.stopped()) from None
    for name, why in outcome.failed.items():
        print(f"{name} failed: {why}")
    outcome.write(ended=True)
    return 1 if outcome.failed or not all(m.right for m in outcome.works) else 0


def check_files(options: argparse.Namespace) -> None:
    """Raise ShpyError for a file that cannot be written, before anything is measured."""
    if options.json:
        check_file(options.json)
    if options.write == answers.FOLDER and (options.quick or options.size):
        raise ShpyError("results of --quick and --size are not for the page: --write FOLDER, another one")


def study_or_work(name: str, setup: Setup, contenders: list[str], options: argparse.Namespace) -> Measured | Table:
    """Measure a study or a work."""
    if name in STUDIES:
        return STUDIES[name](setup)
    (work,) = works([name], setup.mesh)
    size = options.size or (work.quick if options.quick else work.size)
    count = options.rounds or (2 if options.quick else 9)
    return rounds.run(work, size, contenders, count, progress, partial(work_of, name, setup.mesh))


def progress(text: str) -> None:
    """One line that is written over, on a terminal."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


@dataclass
class Outcome:
    """The results of a run, which are printed and written after each work and study.

    `failed` has the errors of works and studies that gave no table.
    """

    options: argparse.Namespace
    here: dict[str, Any]
    missing: dict[str, str]
    works: list[Measured] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)

    def take(self, name: str, measure: Callable[[], Measured | Table]) -> None:
        """Measure a work or a study and print its result, or keep its error; write all results that there are."""
        try:
            result = measure()
        except Exception as error:
            traceback.print_exc(limit=-3)
            self.failed[name] = rounds.reason(error)
            return
        if isinstance(result, Measured):
            self.works.append(result)
            result = report.table(result)
        self.tables.append(result)
        progress("")
        print(result.markdown(), flush=True)
        self.write(ended=False)

    def write(self, *, ended: bool) -> None:
        """Write the files that were asked for, and after the last result the page; a run that is stopped replaces none.

        Until the last result the name of a file ends with `.unfinished`.
        """
        folder = self.options.write
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
        for path, unfinished in self.files():
            write_json(path if ended else unfinished, self.document())
            if ended:
                unfinished.unlink(missing_ok=True)
        if folder and ended:
            answers.drop_superseded(folder)
            answers.write_page(folder)

    def files(self) -> list[tuple[Path, Path]]:
        """Return the files that were asked for, each with its name until the run ends."""
        folder, name = self.options.write, f"{(self.options.only or 'all').replace(',', '-')[:60]}.json"
        paths = filter(None, (self.options.json, folder and folder / name))
        return [(path, path.with_name(f"{path.name}.unfinished")) for path in paths]

    def stopped(self) -> str:
        """Return the last line of a run that was stopped."""
        kept = " and ".join(str(unfinished) for _, unfinished in self.files()) if self.tables else ""
        return f"stopped; results so far: {kept} (to use them, drop .unfinished from the name)" if kept else "stopped"

    def document(self) -> dict[str, Any]:
        """Return what a file holds."""
        words = ["python -m benchmarks", *sys.argv[1:]]
        files = {"--json", f"{self.options.json}", "--write", f"{self.options.write}"}
        return {
            "date": f"{datetime.now():%Y-%m-%d %H:%M}",
            "machine": report.processor(self.here),
            "command": " ".join(word for word in words if word not in files),
            "apart": True,  # peers had processes of their own
            "system": self.here,
            "missing": self.missing,
            "failed": self.failed,
            "works": [report.as_json(m) for m in self.works],
            "tables": [vars(table) for table in self.tables],
        }
