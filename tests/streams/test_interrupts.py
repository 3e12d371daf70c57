"""Ctrl-C at each dispatch of a run, and at any other point: the calls after it give what they gave before."""

import random
import sys

import numpy as np
import pytest
from stream_programs import kept, smooth

import shpy as sh
from shpy.backend.device.pace import Pace
from shpy.backend.glsl.device.context import Context
from shpy.backend.numpy.device.run import NumpyExecutable
from shpy.backend.opencl.device.waiting import Waiter
from shpy.backend.registry import NAMES

DISPATCH = {"numpy": (NumpyExecutable, "_run_tile"), "opencl": (Waiter, "wait"), "glsl": (Context, "go_on")}
"""The method that each dispatch calls, by backend."""
SIZE = 5000


@sh.program
def bend(x: sh.Attrib3f, by: sh.Attrib1f) -> sh.Attrib3f:
    return sh.Attrib3f(x.y * by, x.z - x.x, x.x)


@sh.program
def ended(n: sh.Attrib1i) -> sh.Attrib1i:
    sh.SH_DISCARD(n <= 0)
    return n - 1


@sh.program
def add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


@pytest.fixture(params=NAMES)
def backend(request, monkeypatch):
    """The name of a backend whose runs all take several dispatches."""

    def parts(self, rows, width=1, least=1):
        count = max(least, -(-rows // 3))
        return ((first, min(count, rows - first)) for first in range(0, rows, count))

    monkeypatch.setattr(Pace, "parts", parts)
    for known in ("fits", "is_brief", "was_brief"):
        monkeypatch.setattr(Pace, known, lambda self, elements: False)
    return request.param


class Interrupts:
    """Raise KeyboardInterrupt at the dispatch whose number is `at`."""

    def __init__(self, backend, monkeypatch):
        owner, name = DISPATCH[backend]
        dispatch, self.at = getattr(owner, name), None

        def interrupted(*args):
            if self.at is not None:
                self.at -= 1
                if self.at < 0:
                    self.at = None
                    raise KeyboardInterrupt
            return dispatch(*args)

        monkeypatch.setattr(owner, name, interrupted)


def interrupted_at(call, number=None):
    """Raise KeyboardInterrupt at this thread's nth call of a function of shpy; return the number of calls.

    Python handles Ctrl-C at such calls.
    """
    count, before = 0, sys.gettrace()

    def look(frame, event, given):
        nonlocal count
        if "/shpy/" in frame.f_code.co_filename:
            count += 1
            if count == number:
                raise KeyboardInterrupt

    sys.settrace(look)
    try:
        call()
    except KeyboardInterrupt:
        pass
    finally:
        sys.settrace(before)
    return count


def calls(name):
    """Return calls that each give an array: of all ways to run something."""
    x = np.random.default_rng(5).normal(size=(SIZE, 3)).astype(np.float32)
    many = np.tile(x, (4, 1))
    stream, line = sh.Stream(x, sh.Attrib3f, name), sh.Stream(x[:, 0], sh.Attrib1f, name)
    numbers = sh.Stream(np.arange(SIZE, dtype=np.int32) % 3, sh.Attrib1i, name)
    out, mask = sh.Stream.empty(SIZE, sh.Attrib1f, name), x[:, 1] > 0.5
    bent, kept_, smoothed = (program.compile(name) for program in (bend, kept, smooth))
    lines = np.ascontiguousarray(x[:, 0])
    return {
        "few elements": lambda: bent(x[:300], 2.0),
        "arrays": lambda: bent(many, 2.0),
        "discarded elements of arrays": lambda: kept_(lines),
        "streams": lambda: bent(stream, 2.0),
        "discarded elements": lambda: kept_.run(line).outputs,
        "out": lambda: kept_.run(line, out=out).outputs,
        "where": lambda: bent.run(stream, 2.0, where=mask).outputs,
        "written": lambda: kept_.run(line).written,
        "table": lambda: smoothed(sh.Table(line), shape=SIZE),
        "repeat": lambda: sh.repeat(smooth, 3).run(u=line).streams["u"],
        "loop": lambda: sh.loop(ended).run(n=numbers).streams["n"],
        "sum": lambda: line.sum(),
        "scan": lambda: sh.scan(add, line),
        "sort": lambda: sh.sort(line),
        "scatter": lambda: sh.scatter(line, numbers, 3, combine=add),
        "upload": lambda: sh.Stream(x, sh.Attrib3f, name).copy(),
    }


@pytest.mark.sampled(3)
def test_the_next_call_is_right(backend, monkeypatch):
    works = calls(backend)
    wanted = {spoken: np.asarray(call()).tobytes() for spoken, call in works.items()}
    interrupts, wrong = Interrupts(backend, monkeypatch), []
    for spoken, call in works.items():
        for at in (0, 1, 3):
            interrupts.at = at
            try:
                found = np.asarray(call()).tobytes()
            except KeyboardInterrupt:
                found = wanted[spoken]
            interrupts.at = None
            others = {
                other: np.asarray(works[other]()).tobytes() for other in dict.fromkeys((spoken, *list(works)[:3]))
            }
            wrong += [(spoken, at, other) for other, again in others.items() if again != wanted[other]]
            wrong += [(spoken, at)] if found != wanted[spoken] else []
    assert wrong == []


@pytest.mark.sampled(3)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # an interrupt in a generator's end
@pytest.mark.parametrize("name", NAMES)
def test_the_next_call_is_right_after_an_interrupt_anywhere(name):
    works, chosen, wrong = calls(name), random.Random(name), []
    wanted = {spoken: np.asarray(call()).tobytes() for spoken, call in works.items()}
    for spoken, call in works.items():
        for number in chosen.choices(range(1, interrupted_at(call) + 1), k=3):
            interrupted_at(call, number)
            wrong += [(spoken, number)] if np.asarray(call()).tobytes() != wanted[spoken] else []
    assert wrong == []
