"""Put small faults into backends, passes and kernels, and see whether the tests find them.

    python -m tests.mutation --seed 7301                    # 60 faults; at first every test runs without one
    python -m tests.mutation --seed 7301 --list             # print the faults and run nothing
    python -m tests.mutation --seed 7301 --results found    # note each result in a file, and leave out those it has
    python -m tests.mutation --seed 7301 --only 7,12        # run these of them
    python -m tests.mutation --seed 7301 --only 7 --tests tests/passes tests/chains  # by these tests, and no others

A fault goes into a copy of the repository. The tests that enter its function run until one fails: short ones first,
then all others that enter its function or its file, up to `--most` seconds; with `--whole` then every test there is. A
fault that no test finds is a survivor: either it changes nothing, or a test is missing.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.mutation.judge import Copy, Judge, Unjudged
from tests.mutation.map import Reach, digest
from tests.mutation.small_faults import DRAWN, PARTS, Fault, chosen
from tests.pages import end_by_signal


def noted(folder: Path, copy: Copy, jobs: str) -> Reach:
    """Return which tests enter which functions; all tests run without a fault where that is not known yet."""
    if not folder.exists():
        folder.mkdir(parents=True)
        (folder / "digest").write_text(digest())
        # Tests of the repository's own texts enter no function.
        arguments = ["-q", "-n", jobs, "-p", "no:cacheprovider", "-p", "tests.mutation.reach"]
        copy.run(["-m", "pytest", *arguments, "--deselect", "tests/test_house.py"], None, {"SHPY_REACH": str(folder)})
    if (folder / "digest").read_text() != digest():
        raise SystemExit(f"{folder} was noted for other source: name another folder")
    reach = Reach(folder)
    if not reach.took:
        raise SystemExit(f"{folder} has no test that passes without a fault")
    print(f"without a fault {len(reach.took)} tests pass; these fail and are left out: {reach.failed or 'none'}")
    return reach


def judged(judge: Judge, fault: Fault, tests: list[str], whole: bool) -> tuple[str, str]:
    """Return the kind of a find and its test, ("survives", ...) or ("unjudged", why)."""
    try:
        found = judge.finding(fault, tests, whole)
    except Unjudged as reason:
        return "unjudged", str(reason)
    return (found.kind, found.test) if found else ("survives", f"{judge.tried} tests")


def parsed() -> argparse.Namespace:
    """Return what the command line says."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1, help="chooses the places (default: 1)")
    parser.add_argument("--count", type=int, default=60, help="how many faults (default: 60)")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=DRAWN, help=f"default: {' '.join(DRAWN)}")
    parser.add_argument("--only", help="the numbers of those to run, such as 3,7")
    parser.add_argument("--results", type=Path, help="a file of results: those it has are not run again")
    parser.add_argument("--reach", type=Path, help="the folder that says which test enters which function")
    parser.add_argument("--jobs", default="auto", help="processes of a run of every test (default: auto)")
    parser.add_argument("--most", type=float, default=600, help="seconds of tests for one fault (default: 600)")
    parser.add_argument("--whole", action="store_true", help="run every test of a fault that would survive")
    parser.add_argument("--tests", nargs="+", default=[], help="run these tests of each fault in place of all")
    parser.add_argument("--list", action="store_true", help="print the faults and run nothing")
    return parser.parse_args()


def main() -> int:
    """Do what the command line says; the exit status is 1 where a fault is not found."""
    given = parsed()
    numbered = dict(enumerate(chosen(given.seed, given.count, tuple(given.parts)), 1))
    if given.only:
        numbered = {n: numbered[n] for n in map(int, given.only.split(","))}
    if given.list:
        for n, fault in numbered.items():
            print(f"{n:3} {fault.shown()}")
        return 0
    results: dict[str, list[str]] = {}
    if given.results and given.results.exists():
        results = dict(json.loads(line) for line in given.results.read_text().splitlines())
    end_by_signal()
    with Copy() as copy:
        folder = given.reach or Path(tempfile.gettempdir()) / f"mutation-reach-{digest()}"
        reach = Reach() if given.tests else noted(folder, copy, given.jobs)
        judge = Judge(copy, reach, given.most)
        for n, fault in numbered.items():
            if fault.shown() in results:
                continue
            began = time.monotonic()
            kind, test = results[fault.shown()] = list(judged(judge, fault, given.tests, given.whole))
            print(f"{n:3} {kind}: {test} ({time.monotonic() - began:.0f} s)\n    {fault.shown()}", flush=True)
            if given.results:
                with given.results.open("a") as file:
                    file.write(json.dumps([fault.shown(), [kind, test]]) + "\n")
    kinds = {n: results[fault.shown()][0] for n, fault in numbered.items()}
    print(", ".join(f"{kind} {count}" for kind, count in Counter(kinds.values()).most_common()))
    left = [n for n, kind in kinds.items() if kind in ("survives", "unjudged")]
    print(f"{len(kinds) - len(left)} of {len(kinds)} found; not found: {left or 'none'}")
    return bool(left)


if __name__ == "__main__":
    sys.exit(main())
