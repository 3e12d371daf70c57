"""A pytest plugin of the mutation check: notes which functions of the product each test enters.

    SHPY_REACH=folder python -m pytest -p tests.mutation.reach

Each process writes lines of JSON into a file of the folder: a test, its outcome, its seconds and the numbers of the
functions; a line before it names each function that is new, by its file and its first line.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

from tests.mutation.small_faults import PARTS, ROOT

FOLDERS = [ROOT / folder for part in PARTS.values() for folder in part]
entered: set[CodeType] = set()
outcomes: list[str] = []
numbers: dict[CodeType, int] = {}


def note(frame: FrameType, event: str, argument: Any) -> None:
    """Note that a function is entered; its lines are not traced."""
    entered.add(frame.f_code)


def told(code: CodeType) -> str | None:
    """Return the file and the first line of a function that a fault can be put into, None for others."""
    path = Path(code.co_filename)
    if any(path.is_relative_to(folder) for folder in FOLDERS):
        return f"{path.relative_to(ROOT)}:{code.co_firstlineno}"
    return None


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Write what a test entered, its fixtures included."""
    entered.clear()
    outcomes.clear()
    began = time.monotonic()
    threading.settrace(note)
    sys.settrace(note)
    yield
    sys.settrace(None)
    threading.settrace(None)  # type: ignore[arg-type]
    seconds = time.monotonic() - began
    with (Path(os.environ["SHPY_REACH"]) / f"{os.getpid()}.jsonl").open("a") as file:
        functions = set(entered)  # a thread may still add to it
        for code in functions - numbers.keys():
            name = told(code)
            numbers[code] = -1 if name is None else len(numbers)
            if name is not None:
                file.write(json.dumps({"function": name, "number": numbers[code]}) + "\n")
        reached = sorted({numbers[code] for code in functions} - {-1})
        test = {"test": item.nodeid, "outcomes": outcomes, "seconds": round(seconds, 3), "reached": reached}
        file.write(json.dumps(test) + "\n")


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Keep the outcome of each phase of the test that runs."""
    outcomes.append(report.outcome)
