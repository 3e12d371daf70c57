"""`lanes="auto"` tries a second width on the data of a run, keeps the faster one, and remembers it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

import shpy as sh
from shpy.backends.base import Call
from shpy.backends.opencl import widths
from shpy.backends.opencl.widths import Choosing, known_width
from shpy.errors import CompileError


@dataclass
class Clock:
    """Time as the fake kernels spend it."""

    now: float = 0.0

    def perf_counter(self) -> float:
        return self.now


@dataclass
class Fake:
    """A kernel of a width that takes so many seconds an element and writes its width."""

    lanes: int
    pace: float
    clock: Clock
    shapes: list[tuple[int, ...]] = field(default_factory=list)
    notes: tuple[str, ...] = ()
    loops: tuple[None, ...] = ()
    writes_all: bool = True

    @property
    def source(self) -> str:
        return f"float{self.lanes}"

    def run(self, call: Call) -> None:
        self.shapes.append(call.shape)
        self.clock.now += self.pace * call.count
        for out in call.outputs:
            out[:] = self.lanes


@pytest.fixture
def clock(monkeypatch, tmp_path):
    made = Clock()
    monkeypatch.setattr(widths, "time", made)
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "cache"))
    return made


def call(*shape: int) -> Call:
    count = int(np.prod(shape))
    return Call(shape, (np.zeros(count, np.float32), np.zeros(1, np.float32)), (np.zeros(count, np.float32),), {}, {})


def choosing(clock, paces, seconds=0.1):
    kernels = {8: Fake(8, paces[0], clock), 16: Fake(16, paces[1], clock)}
    return Choosing(kernels[8], 16, kernels.__getitem__, seconds, "0" * 64), kernels


@pytest.mark.parametrize(("paces", "chosen"), [((1e-6, 0.7e-6), 16), ((1e-6, 1.3e-6), 8), ((1e-6, 0.99e-6), 8)])
def test_the_faster_width_stays_and_is_remembered(clock, paces, chosen):
    choice, _ = choosing(clock, paces)
    for _ in range(9):
        given = call(20_000)
        choice.run(given)
    assert (given.outputs[0] == chosen).all()
    assert choice.source == f"float{chosen}"
    assert choice.notes[-1].startswith(f"{chosen} lanes, whose runs of this program take ")
    assert known_width("0" * 64, (8, 16)) == chosen
    assert known_width("0" * 64, (4, 32)) is None


def test_nothing_is_tried_before_the_runs_have_taken_as_long_as_compiling(clock):
    choice, kernels = choosing(clock, (1e-6, 1e-7), seconds=0.19)
    for _ in range(9):
        choice.run(call(20_000))
    assert kernels[16].shapes == []
    assert choice.notes == ("8 lanes; 16 are tried once runs have taken as long as compiling",)
    choice.run(call(20_000))
    assert kernels[16].shapes != []


def test_short_runs_say_nothing_about_a_width(clock):
    choice, kernels = choosing(clock, (1e-3, 1e-4))
    for _ in range(9):
        choice.run(call(1000))
    assert kernels[16].shapes == []


def test_the_results_of_the_run_that_is_tried_stay(clock):
    choice, _ = choosing(clock, (1e-5, 1e-6))
    given = call(100, 200)
    choice.run(given)
    assert (given.outputs[0] == 8).all()


def test_a_part_of_a_long_run_is_enough(clock):
    choice, kernels = choosing(clock, (1e-4, 1e-5))
    choice.run(call(100, 200))
    assert set(kernels[16].shapes) == {(5, 200)}
    assert kernels[8].shapes[0] == (100, 200)
    assert set(kernels[8].shapes[1:]) == {(5, 200)}


def test_a_width_that_does_not_compile_is_left_alone(clock):
    def refuse(lanes):
        raise CompileError("no float16 here")

    choice = Choosing(Fake(8, 1e-4, clock), 16, refuse, 0.1, "0" * 64)
    choice.run(call(20_000))
    choice.run(call(20_000))
    assert choice.source == "float8"
    assert choice.notes == ("8 lanes, since 16 do not compile: no float16 here",)


def test_a_kernel_that_changes_its_width_gives_the_same_bits(monkeypatch, tmp_path):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(widths, "_LEAST_SPENT", 0.0)
    monkeypatch.setattr(widths, "_MOST_SPENT", 0.0)
    monkeypatch.setattr(widths, "_GAIN", 1e9)  # the other width wins

    @sh.program
    def wave(x: sh.Attrib1f) -> sh.Attrib1f:
        return sh.sin(x) * sh.exp(-x) + 0.125 * sh.grid_index(1)

    x = np.linspace(0, 9, 20_000, dtype=np.float32)
    kernel = wave.compile("opencl", loop_limit=12_345)
    before, text = kernel(x), kernel.source
    assert kernel.source != text or "tried" not in kernel.notes[-1]
    assert np.array_equal(kernel(x), before)
    assert np.array_equal(wave.compile("numpy")(x), before)
