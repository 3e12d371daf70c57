"""Recording, passes and printing do work in proportion to the program: lines of Python that run are counted."""

import sys

import numpy as np
import pytest

import shpy as sh
from shpy.backend.base import Options
from shpy.backend.emit.names import Names
from shpy.backend.opencl.packets.kernel import print_packets
from shpy.backend.opencl.packets.prologue import Abilities
from shpy.backend.opencl.text.kernel import print_kernel
from shpy.ir.parser import parse
from shpy.ir.text import print_module
from shpy.ir.verifier import verify
from shpy.passes import size
from shpy.passes.pipeline import Target, prepare


def additions(count):
    """One variable, added to again and again."""

    @sh.program
    def work(x: sh.Attrib1f, z: sh.Attrib1f) -> sh.Attrib1f:
        y = sh.Attrib1f(x)
        for _ in range(count):
            y += z
        return y

    return work


def chain(count):
    """Each value is made of the one before, and of one far away."""

    @sh.program
    def work(x: sh.Attrib1f, z: sh.Attrib1f) -> sh.Attrib1f:
        values = [x * z]
        for k in range(count):
            values.append(values[-1] * values[k // 2] + z)
        return values[-1]

    return work


def functions(count):
    """Small subroutines, all of one name, each called once."""

    def small(k):
        @sh.subroutine
        def bend(a: sh.Attrib1f) -> sh.Attrib1f:
            b = sh.Attrib1f(a * (k + 0.5) + 1)
            with sh.SH_IF(b > 3):
                b *= 0.5
            return b

        return bend

    bends = [small(k) for k in range(count // 8)]

    @sh.program
    def work(x: sh.Attrib1f) -> sh.Attrib1f:
        y = sh.Attrib1f(x)
        for bend in bends:
            y += bend(y)
        return y

    return work


def choices(count):
    """Blocks one after the other; values of before the first one wait for each, and for the end."""

    @sh.program
    def work(x: sh.Attrib1f, z: sh.Attrib1f) -> sh.Attrib1f:
        y = sh.Attrib1f(x)
        values = [x * (k + 0.5) + z for k in range(count)]
        for value in values:
            with sh.SH_IF(value > y):
                y += value * z
        return y * sum(values)

    return work


def on_numpy(program):
    program.compile("numpy")


def as_text(program):
    verify(program.ir)
    assert parse(print_module(program.ir)) == program.ir


def on_opencl(program):
    print_kernel(prepare(program.ir, Options(), Target("opencl")).module)


def in_packets(program):
    prepared = prepare(program.ir, Options(), Target("opencl packets", vector=True))
    print_packets(prepared.module, 8, Abilities())


def lines_of(work):
    """Count the lines of Python that the work runs, each iteration of a comprehension included."""
    count = 0

    def trace(frame, event, argument):
        nonlocal count
        count += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        work()
    finally:
        sys.settrace(before)
    return count


@pytest.mark.sampled(6)
@pytest.mark.parametrize("make", [choices, additions, chain, functions])
def test_work_grows_with_the_program(make):
    """Four times the statements take at most 4.4 times the work, in every stage."""
    sizes = 32, 128
    programs = [make(n) for n in (16, *sizes)]
    for stage in (as_text, on_numpy, on_opencl, in_packets):
        stage(programs[0])  # what is imported and made once
        small, large = (lines_of(lambda p=p, stage=stage: stage(p)) for p in programs[1:])
        assert large < 4.4 * small, stage.__name__
    small, large = (lines_of(lambda n=n: make(n)) for n in sizes)
    assert large < 4.4 * small


@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_a_program_that_a_driver_cannot_take_is_refused(backend, monkeypatch):
    monkeypatch.setattr(size, "MOST_STATEMENTS", 100)
    with pytest.raises(
        sh.CompileError, match=r"this program has 1\d\d statements, and Open.* at most 100 are"
    ) as error:
        additions(120).compile(backend)
    assert "SH_FOR" in str(error.value)


@pytest.mark.slow
def test_300_000_additions_run_on_numpy_and_are_refused_elsewhere():
    program = additions(300_000)
    x, z = np.float32([1, 2]), np.float32([1, 0])
    np.testing.assert_array_equal(program.compile("numpy")(x, z), [300_001, 2])
    for backend in ("opencl", "glsl"):
        with pytest.raises(sh.CompileError, match="this program has 300,"):
            program.compile(backend)


def test_a_scope_copies_no_names():
    outer = Names("opencl")
    for _ in range(100):
        outer.take("point")
    inner = outer.scope()
    assert inner.take("point") == "point_101"
    outer.take("later")
    assert inner.take("later") == "later_2"
    assert inner._used == {"point_101", "later_2"}
    assert "point_101" not in outer
