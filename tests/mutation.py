"""Put small faults into backends, passes, kernels, accelerators and the view, and see whether the tests find them.

    python -m tests.mutation --seed 1                   # 60 faults; hours on two cores
    python -m tests.mutation --seed 1 --count 5 --fast  # only the fast tests of each part
    python -m tests.mutation --seed 1 --list            # print the faults and run nothing
    python -m tests.mutation --seed 1 --only 7,12       # run these of them
    python -m tests.mutation --seed 1 --only 7 --tests tests/passes tests/chains  # by these tests, and no others

A fault changes one place: another comparison or operator, a negated condition, a constant that is one larger, a
statement left out. It goes into a copy of the repository. The fast tests of its part run first, then the whole default
run. A fault that no test finds is a survivor: either it changes nothing, or a test is missing.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
COPIED = ("shpy", "raytracer", "shpy_start", "tests", "examples", "benchmarks", "docs", "scripts")
SECONDS = 3600
"""Time for the tests of one fault; one that makes them endless is found."""


@dataclass(frozen=True)
class Part:
    """A part of the product with the tests that most likely find a fault in it, and take a minute."""

    folders: tuple[str, ...]
    tests: tuple[str, ...]


PARTS = {
    "backends": Part(
        ("shpy/backends",),
        ("tests/backends/test_snapshots.py", "tests/backends/test_numpy_ops.py", "tests/backends/test_packets.py"),
    ),
    "passes": Part(("shpy/passes",), ("tests/passes", "tests/backends/test_snapshots.py")),
    "kernels": Part(
        ("raytracer/kernels", "raytracer/integrators", "shpy/library"),
        ("tests/raytracer/test_kernel_texts.py", "tests/raytracer/test_render.py", "tests/library"),
    ),
    "structures": Part(
        ("raytracer/accel", "raytracer/view"),
        (
            "tests/raytracer/test_ploc.py",
            "tests/raytracer/test_wide.py",
            "tests/raytracer/test_moving.py",
            "tests/raytracer/test_view_session.py",
        ),
    ),
}

COMPARISONS = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "is": "is not", "is not": "is",
               "in": "not in", "not in": "in"}  # fmt: skip
OPERATORS = {"+": "-", "-": "+", "*": "+", "/": "*", "//": "*", "%": "+", "<<": ">>", ">>": "<<", "&": "|", "|": "&"}
WORDS = {"and": "or", "or": "and"}


@dataclass(frozen=True)
class Fault:
    """A replacement of the text between two offsets of a file."""

    part: str
    path: str
    start: int
    end: int
    text: str

    def applied(self, source: str) -> str:
        """Return the text of the file with the fault."""
        return source[: self.start] + self.text + source[self.end :]

    def shown(self) -> str:
        """Return the file, the line, and how it changes."""
        source = (ROOT / self.path).read_text()
        lines = difflib.unified_diff(source.splitlines(), self.applied(source).splitlines(), n=0, lineterm="")
        changed = [line for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---")]
        return f"{self.path}:{source.count(chr(10), 0, self.start) + 1}\n    " + "\n    ".join(changed)


class Places:
    """Offsets of the nodes of a file."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.lines = [0]
        for line in source.splitlines(keepends=True):
            self.lines.append(self.lines[-1] + len(line))

    def offset(self, line: int, column: int) -> int:
        """Return the offset of a place that ast tells in bytes."""
        start = self.lines[line - 1]
        text = self.source[start : self.lines[line]]
        return start + len(text.encode()[:column].decode())

    def span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        """Return where a node begins and ends."""
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self.offset(node.lineno, node.col_offset), self.offset(node.end_lineno, node.end_col_offset)

    def between(self, left: ast.expr, right: ast.expr, words: dict[str, str]) -> tuple[int, int, str] | None:
        """Return the operator between two operands, by its span, and its replacement."""
        start, end = self.span(left)[1], self.span(right)[0]
        found = re.fullmatch(r"([\s)]*)(\S+|is not|not in)([\s(\\]*)", self.source[start:end])
        if found is None or found[2] not in words:
            return None
        return start + found.start(2), start + found.end(2), words[found[2]]


def faults_in(part: str, path: str) -> Iterator[Fault]:
    """Yield every fault that can be put into a file."""
    source = (ROOT / path).read_text()
    places = Places(source)
    for node in running(ast.parse(source)):
        for start, end, text in changes(node, places):
            yield Fault(part, path, start, end, text)


def running(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes that run, without annotations, decorators, imports and what raises errors."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "bases", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not isinstance(
                child, ast.Import | ast.ImportFrom | ast.Raise | ast.Assert
            ):
                if not (isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING"):
                    yield child
                    yield from running(child)


def changes(node: ast.AST, places: Places) -> Iterator[tuple[int, int, str]]:
    """Yield the changes of one node: (start, end, text)."""
    found: list[tuple[int, int, str] | None] = []
    match node:
        case ast.Compare(left, [_], [right]):
            found.append(places.between(left, right, COMPARISONS))
        case ast.BinOp(left, _, right) if not (isinstance(left, ast.Constant) and isinstance(left.value, str)):
            found.append(places.between(left, right, OPERATORS))
        case ast.BoolOp(_, [left, right, *_]):
            found.append(places.between(left, right, WORDS))
        case ast.If(test) | ast.IfExp(test) | ast.While(test):
            start, end = places.span(test)
            found.append((start, end, f"not ({places.source[start:end]})"))
        case ast.Constant(bool(value)):
            found.append((*places.span(node), str(not value)))
        case ast.Constant(int(value)):
            found.append((*places.span(node), str(value + 1)))
        case ast.Expr(ast.Call()):
            found.append((*places.span(node), "pass"))
    yield from (change for change in found if change is not None)


def chosen(seed: int, count: int) -> list[Fault]:
    """Return faults at random places, as many in each part; within a part, each place is as likely as any other."""
    drawn = random.Random(seed)
    faults = []
    for n, (name, part) in enumerate(PARTS.items()):
        files = sorted(p for folder in part.folders for p in (ROOT / folder).rglob("*.py"))
        every = [fault for path in files for fault in faults_in(name, str(path.relative_to(ROOT)))]
        faults += drawn.sample(every, count // len(PARTS) + (n < count % len(PARTS)))
    return faults


def first_failure(folder: Path, arguments: list[str]) -> str | None:
    """Run tests until one fails: return its name, or None where all pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--no-header", "-p", "no:cacheprovider", *arguments]
    environment = os.environ | {"PYTHONPATH": str(folder)}
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        return "the tests do not end"
    if done.returncode == 0:
        return None
    failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    return failed[0] if failed else f"pytest ended with {done.returncode}"


def copied(folder: Path) -> None:
    """Copy the repository without what is not under version control."""
    ignored = shutil.ignore_patterns("__pycache__", ".*_cache", ".hypothesis")
    for name in COPIED:
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    for path in [*ROOT.glob("*.md"), *ROOT.glob("*.toml"), *ROOT.glob("LICENSE*")]:
        shutil.copy(path, folder)
    if (ROOT / ".ci").exists():
        shutil.copytree(ROOT / ".ci", folder / ".ci")


def finder_of(fault: Fault, folder: Path, fast: bool, tests: list[str]) -> str | None:
    """Return the test that finds a fault, among `tests` if there are any; None where it survives."""
    source = (folder / fault.path).read_text()  # the copy is as it was when the faults were drawn
    (folder / fault.path).write_text(fault.applied(source))
    try:
        found = first_failure(folder, ["-n0", *(tests or PARTS[fault.part].tests)])
        # Tests of the text of the product find any change of it, and say nothing about what it does.
        return (
            found
            if found or fast or tests
            else first_failure(folder, ["-n", "auto", "--deselect", "tests/test_house.py"])
        )
    finally:
        (folder / fault.path).write_text(source)


def main() -> int:
    """Do what the command line says; the exit status is 1 where a fault survives."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1, help="chooses the places (default: 1)")
    parser.add_argument("--count", type=int, default=60, help="how many faults (default: 60)")
    parser.add_argument("--only", help="the numbers of those to run, such as 3,7")
    parser.add_argument("--fast", action="store_true", help="run only the fast tests of each part")
    parser.add_argument("--tests", nargs="+", default=[], help="run these tests of each fault in place of all")
    parser.add_argument("--list", action="store_true", help="print the faults and run nothing")
    given = parser.parse_args()
    numbered = dict(enumerate(chosen(given.seed, given.count), 1))
    if given.only:
        numbered = {n: numbered[n] for n in map(int, given.only.split(","))}
    if given.list:
        for n, fault in numbered.items():
            print(f"{n:3} {fault.shown()}")
        return 0
    survivors = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        copied(folder)
        for n, fault in numbered.items():
            began = time.monotonic()
            found = finder_of(fault, folder, given.fast, given.tests)
            print(f"{n:3} {found or 'SURVIVES'} ({time.monotonic() - began:.0f} s)\n    {fault.shown()}", flush=True)
            if found is None:
                survivors.append(n)
    print(f"{len(numbered) - len(survivors)} of {len(numbered)} found; survivors: {survivors or 'none'}")
    return bool(survivors)


if __name__ == "__main__":
    sys.exit(main())
