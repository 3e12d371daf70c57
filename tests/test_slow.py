"""A compilation that takes long says so once, with what makes it long, and leaves no thread behind."""

from __future__ import annotations

import threading

import numpy as np
import pytest

import shpy as sh
from shpy.backend import slow


@sh.subroutine
def wave(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.sin(x) * sh.cos(x) + x * x


@sh.subroutine
def twice(x: sh.Attrib1f) -> sh.Attrib1f:
    return wave(wave(x))


def recorded():
    @sh.program
    def waves(x: sh.Attrib1f) -> sh.Attrib1f:
        return twice(twice(x)) + 1

    return waves


@pytest.fixture
def loud(monkeypatch):
    monkeypatch.setenv("SHPY_QUIET", "")
    monkeypatch.setattr(slow, "PATIENCE", 0.0)


def test_a_long_compilation_says_so_once(loud, capfd):
    threads = set(threading.enumerate())
    with slow.announced(recorded().ir, "numpy"):
        for _ in range(1000):  # until the line is there
            threading.Event().wait(0.01)
            said = capfd.readouterr().err
            if said:
                break
    assert said.startswith("shpy: compiling waves for numpy (")
    assert said.count("\n") == 1
    assert capfd.readouterr().err == ""
    assert set(threading.enumerate()) <= threads


def test_kernels_are_announced(loud, capfd, monkeypatch):
    assert recorded().compile("numpy", loop_limit=123_457)(np.float32(0)) == 1
    assert capfd.readouterr().err.startswith("shpy: compil")
    # A program that is compiled already takes no time.
    recorded().compile("numpy", loop_limit=123_457)
    assert capfd.readouterr().err == ""


def test_quiet_and_quick_compilations_say_nothing(capfd, monkeypatch):
    threads = set(threading.enumerate())
    monkeypatch.setenv("SHPY_QUIET", "")
    recorded().compile("numpy", loop_limit=123_458)
    monkeypatch.setenv("SHPY_QUIET", "1")
    monkeypatch.setattr(slow, "PATIENCE", 0.0)
    recorded().compile("numpy", loop_limit=123_459)
    assert capfd.readouterr().err == ""
    assert set(threading.enumerate()) <= threads


def test_whoever_hears_is_told_of_each_compilation_and_of_its_end(monkeypatch):
    heard = []
    monkeypatch.setattr(slow, "_hearing", [heard.append])
    first, second = recorded().ir, recorded().ir
    with slow.announced(first, "opencl"):
        with slow.announced(second, "glsl"):
            pass
    assert heard == [
        "compiling 109 operations for OpenCL",
        "compiling 109 operations for GLSL",
        "compiling 109 operations for OpenCL",
        "",
    ]


def test_the_line_names_the_function_with_most_operations():
    text = """module m
input x: Attrib1f
output y: Attrib1f
pure function small(%0: f) -> ($0: f) {
  %1: f = sin %0
  store $0 = %1
}
pure function large(%0: f) -> ($0: f) {
  %1: f = call small(%0)
  %2: f = add %0, %1
  %3: f = add %0, %2
  store $0 = %3
}
function m(%0: f) -> ($0: f) {
  %1: f = call large(%0)
  %2: f = call large(%1)
  store $0 = %2
}
"""
    module = sh.parse(text)
    assert slow.describe(module, "glsl") == "m for glsl (11 operations; 2 calls of large with 6 of them)"


def test_the_line_names_a_loop_where_opengl_would_copy_a_function_many_times():
    @sh.program
    def waves(x: sh.Attrib1f) -> sh.Attrib1f:
        for _ in range(12):
            x = wave(x)
        return x

    advice = "; SH_FOR around one call of wave compiles faster than a Python loop around many)"
    assert slow.describe(waves.ir, "glsl").endswith(f"12 calls of wave with 252 of them{advice}")
    assert "SH_FOR" not in slow.describe(waves.ir, "opencl")
    assert "SH_FOR" not in slow.describe(recorded().ir, "glsl")


def test_the_count_of_exponential_calls_takes_no_time():
    functions = ["pure function f0(%0: f) -> ($0: f) {\n%1: f = sin %0\nstore $0 = %1\n}"]
    functions += [
        f"pure function f{n}(%0: f) -> ($0: f) {{\n%1: f = call f{n - 1}(%0)\n%2: f = call f{n - 1}(%1)\n"
        "store $0 = %2\n}"
        for n in range(1, 60)
    ]
    module = sh.parse("\n".join(["module m\ninput x: Attrib1f\noutput y: Attrib1f", *functions, ""]))
    assert f"{2**59:,} calls of f0" in slow.describe(module, "numpy")
