"""Find the test that finds a fault: tests run in a copy of the repository, with the fault and without.

    with Copy() as copy:
        found = Judge(copy, reach, 600).finding(fault, [], whole=False)
    found.kind, found.test        # ("behaviour", "tests/passes/test_known.py::test_bounds")

A find is a test that has a name and fails with the fault, and passes alone without it. The same holds for a test that
kills the process, and for one that does not end in ten times the seconds of the longest test of its run. Modules
that cannot be imported are a find of their own. Any other end of pytest (interrupted, an internal error, no tests)
says nothing about the fault: it raises `Unjudged`.
"""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO

from tests.mutation.map import Reach
from tests.mutation.small_faults import ROOT, Fault

COPIED = ("shpy", "raytracer", "shpy_start", "tests", "examples", "benchmarks", "docs", "scripts")
IMPORTED = ("shpy", "raytracer", "shpy_start.pytest_plugin")
OF_TEXT = (
    "tests/backends/test_snapshots.py",
    "tests/backends/test_numpy_text.py",
    "tests/backends/test_opencl_text.py",
    "tests/backends/test_glsl_text.py",
    "tests/raytracer/test_kernel_texts.py",
    "tests/test_documentation.py",
    "tests/test_docstrings.py",
    "tests/test_house.py",
)
"""Tests that compare a text of the product, or one it emits, with one that is kept: they find changes of every kind."""
SLOWER = 10
"""A test may take this many times those of the longest of its run without a fault; other work may share the cores."""
LEAST_SECONDS = 60.0
LONGEST_ALONE = 900.0
"""Seconds for a test without a fault."""
MEMORY = 12 << 30
"""Bytes of address space for a run: a fault that asks for memory without end must not take the machine's."""
OUTCOME = re.compile(r"^(tests/\S+\.py(?:::.*?)?) (PASSED|FAILED|ERROR|SKIPPED|XFAIL|XPASS)\b", re.MULTILINE)
STARTED = re.compile(r"^(tests/\S+\.py::.*?) *(?:Fatal Python error.*)?$", re.MULTILINE)


class Unjudged(Exception):
    """The tests ended in a way that says nothing about the fault."""


@dataclass(frozen=True)
class Found:
    """A find: its kind (behaviour, text, crash, time limit or import), and the name of the test."""

    kind: str
    test: str


@dataclass(frozen=True)
class Ended:
    """The end of a run of pytest: `stopped` where its time ran out, `at` the test that was running then."""

    status: int
    stopped: bool
    failed: str | None
    at: str | None
    tail: str


class Copy:
    """A copy of the repository, into which one fault after the other is put; gone at the end."""

    def __enter__(self) -> Copy:
        self.folder = Path(tempfile.mkdtemp(prefix="mutation-"))
        ignored = shutil.ignore_patterns("__pycache__", ".*_cache", ".hypothesis")
        for name in COPIED:
            shutil.copytree(ROOT / name, self.folder / name, ignore=ignored)
        for path in [*ROOT.glob("*.md"), *ROOT.glob("*.toml"), *ROOT.glob("LICENSE*")]:
            shutil.copy(path, self.folder)
        if (ROOT / ".ci").exists():
            shutil.copytree(ROOT / ".ci", self.folder / ".ci")
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)

    def run(self, command: list[str], seconds: float | None, more: dict[str, str]) -> tuple[int, bool, str]:
        """Run Python in a session of its own, all of whose processes end with it: status, out of time, output.

        It is out of time where it prints nothing for this many seconds.
        """
        environment = os.environ | {"PYTHONPATH": str(self.folder)} | more
        with tempfile.TemporaryFile("w+", errors="replace") as output:
            process = subprocess.Popen(
                [sys.executable, *command],
                cwd=self.folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY)),
            )
            try:
                stopped = not ends(process, seconds, output)
            finally:
                # The session is gone where nothing of it is left.
                try:
                    os.killpg(process.pid, signal.SIGKILL)
                except ProcessLookupError:
                    pass
                process.wait()
            output.seek(0)
            return process.returncode, stopped, output.read()

    def pytest(self, tests: list[str], seconds: float | None, *arguments: str) -> Ended:
        """Run these tests in this order, or all there are if `tests` is empty, until one fails."""
        command = ["-m", "pytest", "-x", "-v", "--no-header", "--tb=no", "-p", "no:cacheprovider", *arguments]
        with tempfile.NamedTemporaryFile("w", suffix=".tests") as wanted:
            wanted.write("\n".join(tests))
            wanted.flush()
            files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
            more = {"SHPY_WANTED": wanted.name} if tests else {}
            plugin = ["-p", "tests.mutation.wanted"] if tests else []
            status, stopped, text = self.run([*command, *plugin, *files], seconds, more)
        failed = [test for test, outcome in OUTCOME.findall(text) if outcome in ("FAILED", "ERROR")]
        if not failed:  # an error of collection has its line in the summary alone
            failed = re.findall(r"^(?:FAILED|ERROR) (tests/\S+\.py(?:::\S+)?)", text, re.MULTILINE)
        running = [test for test in STARTED.findall(text) if not OUTCOME.match(test)]
        return Ended(status, stopped, failed[0] if failed else None, running[-1] if running else None, text[-2000:])


def ends(process: subprocess.Popen[bytes], seconds: float | None, output: IO[str]) -> bool:
    """Wait for the end of a process; False where it prints nothing for `seconds`. Where we are halted, none pass."""
    waited, printed = 0.0, 0
    while seconds is None or waited < seconds:
        try:
            process.wait(0.25)
            return True
        except subprocess.TimeoutExpired:
            before, printed = printed, os.fstat(output.fileno()).st_size
            waited = waited + 0.25 if printed == before else 0.0
    return False


def put(path: Path, source: str) -> None:
    """Write a module; what Python compiled of it before is removed: it looks at sizes and whole seconds alone."""
    for compiled in path.parent.glob(f"__pycache__/{path.stem}.*.pyc"):
        compiled.unlink()
    path.write_text(source)


def of_text(test: str) -> bool:
    """Tell whether a test compares texts of the product."""
    return test.partition("::")[0] in OF_TEXT


class Judge:
    """Looks for a test that finds a fault, those that reach its function first."""

    def __init__(self, copy: Copy, reach: Reach, most: float) -> None:
        self.copy = copy
        self.reach = reach
        self.most = most
        self.passing: dict[str, float] = {}
        """Tests that passed alone without a fault, with their seconds."""
        self.tried = 0
        """Tests that ran in the search for the last fault."""

    def finding(self, fault: Fault, tests: list[str], whole: bool) -> Found | None:
        """Return what finds a fault, among `tests` if there are any; None where it survives."""
        path = self.copy.folder / fault.path
        source = path.read_text()
        self.tried = 0
        try:
            put(path, fault.applied(source))
            for stage in [tests] if tests else filter(None, self.stages(fault)):
                if found := self.among(stage, fault, path, source):
                    return found
            return self.among([], fault, path, source) if whole and not tests else None
        finally:
            put(path, source)

    def stages(self, fault: Fault) -> Iterator[list[str]]:
        """Yield tests by how likely and how soon they find a fault: behaviour, then texts, then the others."""
        every = self.reach.tests(fault)
        behaviour = [test for test in every if not of_text(test)]
        first, second, left = self.reach.split(behaviour, (30, 120, self.most))
        yield first
        yield second
        yield [test for test in every if of_text(test)]
        yield left

    def imported(self, fault: Fault, path: Path, source: str) -> Found | None:
        """Return the find of a module that cannot be imported with the fault, and can be without."""
        module = fault.path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        command = ["-c", f"import {', '.join([*IMPORTED, module])}"]
        status, stopped, _ = self.copy.run(command, LEAST_SECONDS, {})
        if status == 0:
            return None
        put(path, source)
        before, _, text = self.copy.run(command, LEAST_SECONDS, {})
        put(path, fault.applied(source))
        if before:
            raise Unjudged(f"{module} cannot be imported without the fault: {text[-500:]}")
        return Found("time limit" if stopped else "import", f"import {module}")

    def among(self, tests: list[str], fault: Fault, path: Path, source: str) -> Found | None:
        """Run tests with the fault until one fails; it has to pass alone without it."""
        usual = self.reach.longest(tests) if self.reach.took else self.most
        ended = self.copy.pytest(tests, LEAST_SECONDS + SLOWER * usual, "-n0")
        self.tried += len(tests)
        if not ended.stopped and ended.status == 0:
            return None
        if ended.stopped or ended.status < 0:
            return self.confirmed(ended, fault, path, source)
        if (ended.failed is None or "::" not in ended.failed) and (found := self.imported(fault, path, source)):
            return found
        if ended.failed is None or ended.status not in (1, 2):
            raise Unjudged(f"pytest ended with {ended.status}: {ended.tail[-500:]}")
        self.passes_without(ended.failed, path, source, fault)
        return Found("text" if of_text(ended.failed) else "behaviour", ended.failed)

    def confirmed(self, ended: Ended, fault: Fault, path: Path, source: str) -> Found | None:
        """Return the find of a test that did not end or killed the process, if it does so alone and passes without."""
        if ended.at is None:
            raise Unjudged(f"the run ended between tests: {ended.tail[-500:]}")
        took = self.passes_without(ended.at, path, source, fault)
        again = self.copy.pytest([ended.at], LEAST_SECONDS + SLOWER * took, "-n0")
        if again.stopped or again.status < 0:
            return Found("time limit" if again.stopped else "crash", ended.at)
        if again.status == 1 and again.failed:
            return Found("text" if of_text(again.failed) else "behaviour", again.failed)
        raise Unjudged(f"{ended.at} did not end among other tests, and passes alone")

    def passes_without(self, test: str, path: Path, source: str, fault: Fault) -> float:
        """Check that a test passes without the fault, and return the seconds that it takes alone."""
        if test in self.passing:
            return self.passing[test]
        put(path, source)
        began = time.monotonic()
        # What has no test after its file could not be collected.
        ended = self.copy.pytest([test], LONGEST_ALONE, "-n0", *([] if "::" in test else ["--collect-only"]))
        put(path, fault.applied(source))
        if ended.status or ended.stopped:
            raise Unjudged(f"{test} fails without the fault: {ended.tail[-500:]}")
        self.passing[test] = time.monotonic() - began
        return self.passing[test]
