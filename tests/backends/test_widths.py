"""The lanes that `lanes="auto"` takes, by the form of a program."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy import SH_FOR
from shpy.backend.base import Options
from shpy.backend.opencl.device.building import widths_of
from shpy.backend.opencl.device.driver import PACKET_TARGET, machine_of
from shpy.passes.pipeline import prepare

ALL = (4, 8, 16, 32, 64)


@sh.program
def straight(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * x + 1


@sh.program
def long(x: sh.Attrib1f) -> sh.Attrib1f:
    for _ in range(250):
        x = x * x + 1
    return x


def carrying(count: int) -> sh.Program:
    """A loop that carries `count` numbers beside its counter."""

    @sh.program
    def looping(x: sh.Attrib1f) -> sh.Attrib1f:
        parts = [sh.Attrib1f(k) for k in range(count)]
        with SH_FOR(0, 5):
            for part in parts:
                part *= x + 1
        return sum(parts, sh.Attrib1f(0))

    return looping


@sh.program
def smooth(image: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    row, column = sh.grid_index(2)
    return image[row, column - 1] + image[row, column + 1]


def gathering(count: int) -> sh.Program:
    """Read `count` numbers at places of each element's own."""

    @sh.program
    def reading(numbers: sh.Table[sh.Attrib1f], i: sh.Attrib1i) -> sh.Attrib1f:
        return sum((numbers[i * k] for k in range(count)), sh.Attrib1f(0))

    return reading


@sh.program
def stacked(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    kept = sh.Array(sh.Attrib1f, 256)
    kept[n] = x
    return kept[n + 1]


def waving(count: int) -> sh.Program:
    """A sine after `count` products and sums."""

    @sh.program
    def wave(x: sh.Attrib1f) -> sh.Attrib1f:
        for _ in range(count):
            x = x * x + 1
        return sh.sin(x)

    return wave


def widths(
    program: sh.Program, native: int, precision: Any = "f32", most_private: int = 1 << 20, math: Any = "strict"
) -> tuple[int, int]:
    machine: Any = SimpleNamespace(lanes=native, widths=ALL, most_private=most_private)
    options = Options(precision=precision, math=math)
    return widths_of(machine, prepare(program.ir, options, PACKET_TARGET).module, precision)


@pytest.mark.parametrize("native", [4, 8, 16])
def test_values_take_as_many_registers_as_there_are_for_what_a_loop_carries(native: int) -> None:
    registers = {program: widths(carrying(program), native)[0] // native for program in (3, 8, 9, 16, 17, 40)}
    as_many = {3: 4, 8: 4, 9: 2, 16: 2, 17: 1, 40: 1} if native == 16 else {3: 4, 8: 2, 9: 1, 16: 1, 17: 1, 40: 1}
    assert registers == as_many
    beside = min(4 * native, 32)
    assert widths(straight, native) == (4 * native, beside)
    assert widths(long, native) == (2 * native, 2 * native)
    assert widths(straight, native, "f64") == (2 * native, beside // 2)


def test_values_of_programs_that_gather_take_two_registers() -> None:
    assert widths(gathering(15), 16) == (64, 32)
    assert widths(gathering(16), 16) == (32, 32)
    assert widths(gathering(16), 4, "f64") == (4, 4)


@pytest.mark.parametrize("math", ["strict", "portable", "relaxed"])
def test_the_reduction_of_far_angles_leaves_packets_as_wide(math: Any) -> None:
    assert widths(waving(60), 16, math=math) == (64, 32)
    assert widths(waving(200), 16, math=math) == (32, 32)


def test_packets_whose_local_arrays_do_not_fit_are_narrower() -> None:
    assert widths(stacked, 16) == (64, 32)
    assert widths(stacked, 16, most_private=16 * 8 * 1024) == (8, 8)
    assert widths(stacked, 16, most_private=1) == (4, 4)


def test_kernels_that_read_neighbours_have_32_numbers_and_the_same_bits() -> None:
    machine = machine_of(None)
    image = np.random.default_rng(1).random((9, 300), np.float32)
    kernel = smooth.compile("opencl")
    most = max(n for n in machine.widths if n <= min(4 * machine.lanes, max(2 * machine.lanes, 32)))
    assert f"float{most} " in kernel.source
    assert np.array_equal(kernel(image, shape=image.shape), smooth.compile("numpy")(image, shape=image.shape))
    if 4 * machine.lanes in machine.widths:
        assert f"float{4 * machine.lanes} " in straight.compile("opencl").source
