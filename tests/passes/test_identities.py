"""Operations with a constant that leaves the other operand unchanged, or absorbs it, and with its neighbours."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy.backend.base import Options
from shpy.ir.nodes import Let
from shpy.ir.traverse import walk
from shpy.passes.pipeline import Target, prepare
from shpy.run.kernel import Kernel
from shpy.testing.reference import Reference

INTS = np.array([0, 1, -1, 2, -2, 5, -7, 2**31 - 1, -(2**31)], np.int32)
FLOATS = np.array([0.0, -0.0, 1, -1.5, 3e38, np.inf, -np.inf, np.nan], np.float32)
NEAR = (-2, -1, 0, 1, 2)

INT_CASES: dict[str, tuple[Callable[[Any, Any], Any], Any, int | None, int | None]] = {
    "add": (operator.add, np.add, 0, None),
    "sub": (operator.sub, np.subtract, 0, None),
    "mul": (operator.mul, np.multiply, 1, 0),
    "floordiv": (operator.floordiv, None, 1, None),
    "and": (operator.and_, np.bitwise_and, -1, 0),
    "or": (operator.or_, np.bitwise_or, 0, -1),
    "xor": (operator.xor, np.bitwise_xor, 0, None),
}
"""By operation of the IR: Python's and numpy's function, the neutral right operand, and the absorbing operand."""


def operations(program: sh.Program) -> set[str]:
    """Return the operations of a program after the passes."""
    module = prepare(program.ir, Options(), Target("numpy")).module
    return {s.op for function in module.functions for s in walk(function.body) if isinstance(s, Let)}


@pytest.mark.parametrize("constant", NEAR)
@pytest.mark.parametrize("op", INT_CASES)
def test_an_int_with_a_constant_on_either_side(op: str, constant: int) -> None:
    python, meaning, neutral, absorbing = INT_CASES[op]

    @sh.program
    def right(i: sh.Attrib1i) -> sh.Attrib1i:
        return python(i, constant)

    @sh.program
    def left(i: sh.Attrib1i) -> sh.Attrib1i:
        return python(sh.Attrib1i(constant), i)

    for program, given in ((right, (INTS, np.int32(constant))), (left, (np.int32(constant), INTS))):
        wanted = Kernel(program.recorded, Reference(), Options())(INTS)
        np.testing.assert_array_equal(program.compile("numpy")(INTS), wanted)
        if meaning is not None:
            with np.errstate(all="ignore"):
                np.testing.assert_array_equal(wanted, meaning(*given))
    assert (op in operations(right)) == (constant not in (neutral, absorbing))


@pytest.mark.parametrize("constant", [-0.0, 0.0, 1.0, -1.0, 0.99999994])
@pytest.mark.parametrize("op", ["add", "sub", "mul", "truediv", "pow"])
def test_a_float_with_a_constant_keeps_its_bits(op: str, constant: float) -> None:
    @sh.program
    def right(x: sh.Attrib1f) -> sh.Attrib1f:
        return getattr(operator, op)(x, constant)

    found = right.compile("numpy")(FLOATS)
    wanted = Kernel(right.recorded, Reference(), Options())(FLOATS)
    np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(np.signbit(found), np.signbit(wanted))


@pytest.mark.parametrize("constant", [True, False])
@pytest.mark.parametrize("op", ["and_", "or_", "xor", "eq", "ne"])
def test_a_bool_with_a_constant(op: str, constant: bool) -> None:
    python = getattr(operator, op)

    @sh.program
    def right(b: sh.Attrib1b) -> sh.Attrib1b:
        return python(b, constant)

    assert right.compile("numpy")(np.array([True, False])).tolist() == [python(True, constant), python(False, constant)]


@pytest.mark.parametrize(("m", "n"), [(-24, 1), (3, -8), (-30, -30), (32, 32), (-40, 1)])
@pytest.mark.parametrize("vector", [False, True])
def test_powers_of_two_times_a_number_that_was_an_int(m: int, n: int, vector: bool) -> None:
    kind = sh.Attrib2i if vector else sh.Attrib1i

    @sh.program
    def scaled(i: kind) -> sh.Attrib2f if vector else sh.Attrib1f:
        return (sh.Attrib2f if vector else sh.Attrib1f)(i) * 2.0**m * 2.0**n

    ints = np.stack([INTS, INTS[::-1]], axis=-1) if vector else INTS
    expected = ints.astype(np.float32) * np.float32(2.0**m) * np.float32(2.0**n)
    np.testing.assert_array_equal(scaled.compile("numpy")(ints), expected)
    module = prepare(scaled.ir, Options(), Target("numpy")).module
    products = [s for f in module.functions for s in walk(f.body) if isinstance(s, Let) and s.op == "mul"]
    assert len(products) == (2 if m == -40 else 1)


def test_powers_of_two_times_other_numbers_round_twice() -> None:
    @sh.program
    def scaled(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * 2.0**-24 * 2.0**24

    assert scaled.compile("numpy")(np.float32([1.5e-38])).tolist() != [np.float32(1.5e-38)]

    @sh.program
    def halved(i: sh.Attrib1i) -> sh.Attrib1f:
        return sh.Attrib1f(i) * 2.0**10 * 2.0**-10

    assert np.isinf(halved.compile("numpy", precision="f16")(np.int32([1000]))).all()
