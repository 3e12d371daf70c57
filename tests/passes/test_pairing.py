"""`pair`: the function of two lanes gives each lane the outputs of the function of one lane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_ir import Sizes, random_inputs, random_module

import shpy as sh
from shpy import SH_BREAK, SH_CONTINUE, SH_DISCARD, SH_DO, SH_ELSE, SH_FOR, SH_IF, SH_RETURN, SH_UNTIL, SH_WHILE
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Port
from shpy.ir.traverse import loops
from shpy.ir.verifier import verify
from shpy.passes.inline import inline_calls
from shpy.passes.pairing import pair
from shpy.passes.pipeline import optimise


def paired(module):
    """Return the module whose entry is the pair of the given one's entry; None if there is none."""
    entry = optimise(inline_calls(module)).entry
    two = pair(entry)
    if two is None:
        return None
    ports = [Port(v.name or "a", "Attrib") for v in two.inputs], [Port(v.name or "r", "Attrib") for v in two.outputs]
    kept = tuple(f for f in module.functions if f.pure)
    made = replace(
        module, inputs=tuple(ports[0]), outputs=tuple(ports[1]), functions=(*kept, replace(two, alone=False))
    )
    verify(made)
    return made


def assert_pairs(module, given, tables=None):
    """Assert that each two neighbours of `given`, and the last without another, get their own results in a pair."""
    two = paired(module)
    assert two is not None
    one, both = Interpreter(module, loop_limit=None), Interpreter(two, loop_limit=None)
    wanted = [one.run_element(args, tables=tables)[0] for args in given]
    for at, args in enumerate(given):
        other = (at + 1) % len(given)
        found, _ = both.run_element([*args, True, *given[other]], tables=tables)
        for a, b in zip([*wanted[at], *wanted[other]], found, strict=True):
            np.testing.assert_array_equal(a, b)
    found, _ = both.run_element([*given[0], False, *given[-1]], tables=tables)
    for a, b in zip(wanted[0], found, strict=False):
        np.testing.assert_array_equal(a, b)


GIVEN = [(np.float32(x),) for x in (0.5, 3.0, -2.0, 7.25, 0.0, 40.0, 1.0)]


def while_loop(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1i]:
    n = sh.Attrib1i(0)
    with SH_WHILE(lambda: x < 10):
        x += 0.5 + x * x
        n += 1
    return -x, n


def do_until(x: sh.Attrib1f) -> sh.Attrib1f:
    total = sh.Attrib1f(1)
    with SH_DO():
        total += x
        x[:] = x * 0.5 - 1
        SH_UNTIL(total < x)
    return total


def counted(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_FOR(0, 7) as i:
        x += sh.Attrib1f(i) * x
    return x


def breaks(x: sh.Attrib1f) -> sh.Attrib1f:
    """Leaves its loop in four places; statements follow each."""
    steps = sh.Attrib1f(0)
    with SH_DO():
        steps += 1
        SH_BREAK(x > 30)
        x -= 0.5
        with SH_IF(x < -1):
            x += 100
            SH_BREAK()
        x += 0.125
        SH_BREAK(steps > 5)
        x += 0.25
        SH_UNTIL(steps > 9)
    return x * 8 + steps


def of_arrays(x: sh.Attrib1f) -> sh.Attrib1f:
    """Reads what no statement stored, and leaves an inner loop."""
    held = sh.Array(sh.Attrib1f, 5)
    at = sh.Attrib1i(0)
    total = sh.Attrib1f(0)
    with SH_WHILE(lambda: at < 9):
        held[at & 3] = x * sh.Attrib1f(at)
        with SH_FOR(0, 5) as k:
            SH_BREAK(sh.Attrib1f(k) > x)
            total += held[k]
        at += sh.cond(x > 1, 1, 2)
    return total + held[4]


def branches_around(x: sh.Attrib1f) -> sh.Attrib1f:
    """Has branches before and after its loop."""
    y = sh.Attrib1f(x)
    with SH_IF(x > 2):
        y[:] = 2
    with SH_WHILE(lambda: y < 30):
        y += sh.abs(x) + 1
    with SH_IF(y > 31):
        y[:] = -y
    return y


@pytest.mark.parametrize("function", [while_loop, do_until, counted, breaks, of_arrays, branches_around])
def test_each_of_two_lanes_gets_its_own_results(function):
    assert_pairs(sh.program(function).ir, GIVEN)


@pytest.mark.slow
def test_random_functions():
    """Functions of random statements around one loop, as far as `pair` takes them."""
    taken = 0
    for seed in range(2000):
        module = random_module(seed, Sizes(4, 3), lanes=False)
        if paired(module) is None or any(loop.turns is None for loop in loops(module)):
            continue
        taken += 1
        inputs = [random_inputs(5 * seed + k) for k in range(4)]
        assert_pairs(module, [given for given, _ in inputs], inputs[0][1])
    assert taken > 20


def test_names_for_the_other_lane_have_a_prefix():
    two = paired(sh.program(while_loop).ir).entry
    assert [i.name for i in two.inputs] == ["x", "there", "other_x"]
    assert [v.name for v in two.variables if v.name and v.name.endswith("going")] == ["going", "other_going"]


def no_loop(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * x


def two_loops(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_FOR(0, 3):
        x += 1
    with SH_FOR(0, 3):
        x *= x
    return x


def continues(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_FOR(0, 9) as i:
        SH_CONTINUE(x > 3)
        x += sh.Attrib1f(i)
    return x


def breaks_from_two_branches(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_DO():
        with SH_IF(x > 2):
            SH_BREAK(x > 9)
            x += 1
        with SH_ELSE():
            SH_BREAK(x < 0)
            x += 2
        x += 3
        SH_UNTIL(x > 30)
    return x


def loop_in_a_branch(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_IF(x > 0), SH_WHILE(lambda: x < 10):
        x += 1
    return x


def returns(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_WHILE(lambda: x < 10):
        x += 1
        with SH_IF(x > 7):
            SH_RETURN(-x)
    return x


def discards(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_WHILE(lambda: x < 10):
        x += 1
        SH_DISCARD(x > 7)
    return x


OTHERS = [no_loop, two_loops, continues, breaks_from_two_branches, loop_in_a_branch, returns, discards]


@pytest.mark.parametrize("function", OTHERS)
def test_other_functions_are_not_paired(function):
    assert pair(sh.program(function).ir.entry) is None
