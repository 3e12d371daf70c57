"""Tell which tests enter which functions of the product, from one run of the tests without a fault.

reach = Reach(folder)
reach.tests(fault)       # those that enter the function of the fault, then those that enter its file
reach.longest(tests)     # the seconds of the longest one without a fault
"""

from __future__ import annotations

import hashlib
import json
import re
from collections import defaultdict
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path

from tests.mutation.small_faults import PARTS, ROOT, Fault

EACH_ROUND = 20
"""Tests taken in each round from a file that has a word of the faulty module in its name; of others it is one."""
WIDE_WORDS = {*"shpy raytracer backend backends kernels passes device text tests test py".split(), ""}
"""Words of paths that say nothing about what a module does."""


def digest() -> str:
    """Return a digest of the source that faults are put into: functions are known by their lines."""
    files = sorted(path for part in PARTS.values() for folder in part for path in (ROOT / folder).rglob("*.py"))
    texts = (f"{path.relative_to(ROOT)}\n{path.read_text()}" for path in files)
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:16]


def words(path: str) -> set[str]:
    """Return what a path says about a module or a test."""
    return set(re.split(r"[/_.]", path)) - WIDE_WORDS


class Reach:
    """The tests that pass without a fault, with their seconds and the functions that each enters."""

    def __init__(self, folder: Path | None = None) -> None:
        self.took: dict[str, float] = {}
        self.failed: list[str] = []
        self.entering: dict[str, set[str]] = defaultdict(set)
        """The tests by function ("path:line") and by file ("path")."""
        for file in sorted(folder.glob("*.jsonl")) if folder else ():
            self._read(file)

    def _read(self, file: Path) -> None:
        """Add what one process wrote; the last line may be broken off."""
        names = {}
        for line in file.read_text().splitlines():
            try:
                told = json.loads(line)
            except json.JSONDecodeError:
                continue
            if "function" in told:
                names[told["number"]] = told["function"]
            elif "failed" in told["outcomes"]:
                self.failed.append(told["test"])
            elif told["outcomes"] == ["passed"] * 3:
                self.took[told["test"]] = told["seconds"]
                for name in (names[number] for number in told["reached"]):
                    self.entering[name].add(told["test"])
                    self.entering[name.partition(":")[0]].add(told["test"])

    def longest(self, tests: Sequence[str]) -> float:
        """Return the seconds of the longest test without a fault, of all where there are none; 0 for unknown tests."""
        return max(self.took.get(test, 0.0) for test in tests or self.took)

    def tests(self, fault: Fault) -> list[str]:
        """Return the tests that enter a fault's function, then those that enter its file; see `_ordered`."""
        in_file = self.entering[fault.path]
        in_function = self.entering[f"{fault.path}:{fault.function}"] if fault.function else in_file
        return self._ordered(in_function, fault.path) + self._ordered(in_file - in_function, fault.path)

    def _ordered(self, tests: set[str], path: str) -> list[str]:
        """Return tests in rounds: each takes the shortest tests that are left of every file, fitting files first."""
        files: dict[str, list[str]] = defaultdict(list)
        for test in sorted(tests, key=lambda test: (self.took[test], test)):
            files[test.partition("::")[0]].append(test)
        fitting = sorted(files, key=lambda file: (-len(words(file) & words(path)), file))
        taken = []
        for file in fitting:
            size = EACH_ROUND if words(file) & words(path) else 1
            taken.append([files[file][n : n + size] for n in range(0, len(files[file]), size)])
        rounds = zip_longest(*taken, fillvalue=[])
        return [test for parts in rounds for part in parts for test in part]

    def split(self, tests: list[str], seconds: Sequence[float]) -> list[list[str]]:
        """Return tests as several runs that take about these seconds; what takes longer than all is left out."""
        runs: list[list[str]] = [[] for _ in seconds]
        at = 0
        spent = 0.0
        for test in tests:
            while at < len(runs) and spent + self.took[test] > seconds[at] and runs[at]:
                at, spent = at + 1, 0.0
            if at == len(runs):
                break
            runs[at].append(test)
            spent += self.took[test]
        return runs
