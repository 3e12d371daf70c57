"""The reference by mpmath: digits that binary64 lacks, every operation, control flow, tables, special values."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

import shpy as sh
from shpy import SH_BREAK, SH_DISCARD, SH_FOR, SH_IF
from shpy.accuracy.multiprecision import OPERATIONS
from shpy.accuracy.reference import evaluate
from shpy.ir.builder import Builder
from shpy.ir.nodes import Module, Port
from shpy.ir.ops import OPS
from shpy.ir.types import vec
from shpy.testing.observers import Setting


def exact(program, *inputs, reference="mpmath", **options):
    return evaluate(Setting(program, inputs, {}, None, options), reference)


def test_what_binary64_cannot_hold():
    @sh.program
    def lost(x: sh.Attrib1f) -> sh.Attrib1f:
        return ((x + 1e30) - 1e30) * 3

    found = exact(lost, np.float32([1.25]))
    assert found.outputs[0].high.tolist() == [[3.75]]
    assert exact(lost, np.float32([1.25]), reference="f64").outputs[0].high.tolist() == [[0]]


def test_the_rest_of_a_number_is_kept():
    @sh.program
    def root(x: sh.Attrib1f) -> sh.Attrib1f:
        return sh.sqrt(x)

    found = exact(root, np.float32([2])).outputs[0]
    with mpmath.workprec(200):
        whole = mpmath.mpf(found.high[0, 0]) + mpmath.mpf(found.low[0, 0])
        assert abs(whole - mpmath.sqrt(2)) < mpmath.mpf(2) ** -104
    assert found.low[0, 0] != 0


def one_operation(name: str) -> tuple[sh.Program, int]:
    """Return a program of one operation, on scalars or, for an operation on vectors, on three components."""
    row = OPS[name]
    size = 3 if "V3" in row.takes or name in ("reflect", "refract", "faceforward") else 1
    b = Builder(name)
    types = row.arguments(vec("f", size))
    assert types is not None
    args = [b.input(t, f"x{n}") for n, t in enumerate(types)]
    value = b.let(name, *args)
    b.store(b.output(value.type, "y"), value)
    inputs = tuple(Port(f"x{n}", f"Attrib{t.size}{t.base}") for n, t in enumerate(types))
    module = Module(name, inputs, (Port("y", f"Attrib{value.type.size}{value.type.base}"),), (), (), (b.finish(),))
    return sh.Program.from_ir(module), size


FLOATS = sorted(n for n, op in OPS.items() if op.signature[0] in "fna" and n not in ("bits_from_float", "any", "all"))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", FLOATS)
def test_each_operation_is_that_of_the_table(name):
    """On ordinary numbers binary64 is right to nearly its last bits."""
    assert name in OPERATIONS
    program, _ = one_operation(name)
    rng = np.random.default_rng(len(name))
    inputs = sh.testing.inputs(program, 40)
    low, high = {"acosh": (1, 5), "atanh": (-0.9, 0.9), "asin": (-1, 1), "acos": (-1, 1), "refract": (-0.7, 0.7)}.get(
        name, (0.01, 3)
    )
    for n, array in enumerate(inputs):
        if array.dtype.kind == "f":
            inputs[n] = rng.uniform(low, high, array.shape).astype(np.float32)
    right, double = exact(program, *inputs).outputs[0], exact(program, *inputs, reference="f64").outputs[0]
    assert right.high.shape == double.high.shape
    np.testing.assert_allclose(right.high.astype(float), double.high.astype(float), rtol=1e-13, atol=1e-13)


def test_special_values_are_those_of_binary64():
    @sh.program
    def edges(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f, sh.Attrib1f]:
        return 1 / x, sh.log(x), sh.atan2(x, sh.Attrib1f(-1))

    given = np.float32([0, -0.0, np.inf, -np.inf, np.nan, -1])
    for one, two in zip(exact(edges, given).outputs, exact(edges, given, reference="f64").outputs, strict=True):
        np.testing.assert_array_equal(one.high, two.high)


def test_control_flow_tables_params_ints_and_discards():
    table = sh.Table(np.float32([0.1, 0.2, 0.3]), sh.Attrib1f)
    gain = sh.Param(sh.Attrib1f, 0.1)

    @sh.program
    def sums(x: sh.Attrib1f, n: sh.Attrib1i) -> tuple[sh.Attrib1f, sh.Attrib1i]:
        total = sh.Attrib1f(0)
        count = sh.Attrib1i(0)
        with SH_FOR(0, n) as i:
            total += table[i] * x
            count += sh.Attrib1i(total * 10)
            SH_BREAK(total > 1)
        with SH_IF(x < 0):
            SH_DISCARD()
        return total * gain, count

    found = exact(sums, np.float32([1, 3, -1]), np.int32([2, 9, 9]))
    assert found.written.tolist() == [True, True, False]
    parts = np.float32([0.1, 0.2, 0.3]).astype(float)
    assert found.outputs[0].high[0, 0] == pytest.approx((parts[0] + parts[1]) * 0.1, rel=1e-15)
    assert found.outputs[1].high[:2, 0].tolist() == [1 + 3, 3 + 9 + 18]


def test_the_reference_is_one_of_two():
    @sh.program
    def same(x: sh.Attrib1f) -> sh.Attrib1f:
        return x

    with pytest.raises(sh.ShpyTypeError, match='reference="mpmath" or "f64"'):
        exact(same, 1.0, reference="exact")
