"""The first statement at which backends part: its line, variable, values, iterations; ways that part; denormals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from testing.faults import op, with_fault

import shpy as sh
from shpy import SH_BREAK, SH_DISCARD, SH_FOR, SH_IF, SH_WHILE
from shpy.ir.nodes import Let, Module, Value
from shpy.ir.traverse import rewrite
from shpy.ir.types import vec

HERE = Path(__file__).read_text().splitlines()
X = np.linspace(-4, 4, 17).astype(np.float32)
F, U = vec("f"), vec("u")


def line_of(text: str) -> int:
    """Return the number of the line in this file that ends in a mark."""
    return next(n for n, line in enumerate(HERE, 1) if line.endswith(f"# {text}"))


@sh.subroutine
def halve(z: sh.Attrib2f, x: sh.Attrib1f):
    with SH_IF(x > 0):
        z.y = sh.floor(z.x * 0.5)  # the subroutine's floor


@sh.program
def turning(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    z = sh.Attrib2f(x, 1)
    with SH_FOR(0, n) as i:
        step = z * 1.5 + sh.Attrib1f(i)
        z[:] = step
        with SH_IF(i == 3):
            low = sh.floor(z.x)  # the floor
            z.x = low
        SH_BREAK(z.x > 1000)
    return z.x + z.y


def test_agreement_is_none():
    assert sh.testing.first_divergence(turning, X, 6, backends=("numpy", "opencl-1", "glsl")) is None


@pytest.mark.sampled(3)
@pytest.mark.parametrize("faulty", ["numpy", "opencl", "glsl"])
def test_the_statement_is_named_with_line_values_and_iteration(monkeypatch, faulty):
    with_fault(monkeypatch, faulty, op("floor", "ceil"))
    program = sh.Program(turning.recorded)
    found = sh.testing.first_divergence(program, X, 6, backends=("interpreter", faulty))
    assert found is not None
    assert (found.loc.file, found.loc.line) == (__file__, line_of("the floor"))
    assert found.source == "low = sh.floor(z.x)  # the floor"
    assert found.name == "low"
    assert found.text.startswith("floor(")
    assert found.turns == (4,)
    element = found.element[0]
    steps = [step for step in turning.trace(x=X[element], n=6) if step.name == "low"]
    assert found.first == steps[0].value
    assert found.second == found.first + 1
    assert found.ulp > 1
    assert next(iter(found.operands.values())) == pytest.approx(found.first, abs=1)
    assert not found.denormal
    assert not found.path
    assert found.inputs == {"x": X[element], "n": 6}


def test_the_right_side_is_the_interpreter(monkeypatch):
    with_fault(monkeypatch, "numpy", op("floor", "ceil"))
    found = sh.testing.first_divergence(sh.Program(turning.recorded), X, 6, backends=("numpy", "glsl"))
    assert found.backends == ("interpreter", "numpy")


def test_both_traces_stand_side_by_side(monkeypatch):
    with_fault(monkeypatch, "numpy", op("floor", "ceil"))
    found = sh.testing.first_divergence(sh.Program(turning.recorded), X, 6, backends=("interpreter", "numpy"))
    parting = [row.same for row in found.rows].index(False)
    assert parting == 6
    assert all(row.same and np.array_equal(row.first, row.second) for row in found.rows[:parting])
    assert found.rows[parting].loc == found.loc
    assert (found.rows[parting].first, found.rows[parting].second) == (found.first, found.second)
    said = str(found)
    assert f"turning: interpreter and numpy part at {__file__}:{line_of('the floor')}, element " in said
    assert f"in iteration 4 of the loop at {__file__}:" in said
    assert "low = sh.floor(z.x)  # the floor" in said
    assert "→" in said


def test_a_statement_in_a_subroutine_is_found(monkeypatch):
    with_fault(monkeypatch, "opencl", op("floor", "ceil"))

    @sh.program
    def calls(x: sh.Attrib1f) -> sh.Attrib1f:
        z = sh.Attrib2f(x, 0)
        halve(z, x)
        return z.y

    found = sh.testing.first_divergence(calls, X, backends=("interpreter", "opencl-1"))
    assert found.loc.line == line_of("the subroutine's floor")


def test_ways_that_part_are_told(monkeypatch):
    """Bits agree up to the comparison: its result is the first difference."""
    with_fault(monkeypatch, "numpy", op("gt", "ge"))

    @sh.program
    def ways(x: sh.Attrib1f) -> sh.Attrib1f:
        y = sh.Attrib1f(x)
        with SH_WHILE(lambda: y > 1):  # the test
            y -= 1
        SH_DISCARD(y > 10)
        return y

    found = sh.testing.first_divergence(ways, X, backends=("interpreter", "numpy"))
    assert found.loc.line == line_of("the test")
    assert (found.first, found.second) == (False, True)
    after = [row for row in found.rows if row.first is None or row.second is None]
    assert after, "behind it the two are at different statements"


def test_elements_that_end_otherwise_are_found(monkeypatch):
    with_fault(monkeypatch, "numpy", op("gt", "ge"))

    @sh.program
    def ends(x: sh.Attrib1f) -> sh.Attrib1f:
        SH_DISCARD(x > 1)
        return x

    found = sh.testing.first_divergence(ends, np.float32([0, 1, 2]), backends=("interpreter", "numpy"))
    assert found.element == (1,)
    assert (found.first, found.second) == (False, True)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", ["f16", "f64"])
def test_other_precisions(monkeypatch, precision):
    with_fault(monkeypatch, "numpy", op("floor", "ceil"))
    found = sh.testing.first_divergence(
        sh.Program(turning.recorded), X, 6, backends=("interpreter", "numpy"), precision=precision
    )
    assert found.loc.line == line_of("the floor")
    assert found.second == found.first + 1


@pytest.mark.parametrize("precision", ["f16", "f32", "f64"])
def test_values_beside_elementary_functions_have_the_type_of_the_precision(monkeypatch, precision):
    with_fault(monkeypatch, "numpy", op("exp", "log"))

    @sh.program
    def grown(x: sh.Attrib1f) -> sh.Attrib1f:
        return sh.exp(x)

    found = sh.testing.first_divergence(grown, [2], backends=("interpreter", "numpy"), precision=precision)
    assert found.first.dtype == found.second.dtype == found.operands["x"].dtype == f"f{int(precision[1:]) // 8}"
    assert found.ulp == sh.units.steps(found.first[None], found.second[None])


def test_the_last_bit_of_a_double_counts(monkeypatch):
    with_fault(monkeypatch, "numpy", op("max", "min"))

    @sh.program
    def close(x: sh.Attrib1d) -> sh.Attrib1d:
        return sh.max(x, 1.0)

    found = sh.testing.first_divergence(close, np.nextafter(1, 2), backends=("interpreter", "numpy"))
    assert found.ulp == 1
    assert found.second == 1


@sh.program
def small(x: sh.Attrib1f) -> sh.Attrib1f:
    y = x * 1e-20
    z = y * 1e-20  # the denormal
    return z * 1e30


def test_a_flushed_denormal_is_told():
    found = sh.testing.first_divergence(small, X, backends=("numpy", "glsl"))
    assert found.loc.line == line_of("the denormal")
    assert found.denormal
    assert "a denormal: one of the two flushes it to zero" in str(found)


def off_by(count: int):
    """Every sine is `count` numbers further from 0 than it should be."""

    def fault(module: Module) -> Module:
        def changed(s):
            if not (isinstance(s, Let) and s.op == "sin"):
                return s
            wrong, bits, one, more = (Value(s.value.id + n, t) for n, t in ((9000, F), (9001, U), (9002, U), (9003, U)))
            return (
                replace(s, value=wrong),
                Let(bits, "bits_from_float", (wrong.id,)),
                Let(one, "const", (), (count,)),
                Let(more, "add", (bits.id, one.id)),
                Let(s.value, "float_from_bits", (more.id,)),
            )

        return replace(module, functions=tuple(replace(f, body=rewrite(f.body, changed)) for f in module.functions))

    return fault


@sh.program
def cancelling(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    y = sh.sin(x)  # off by a little
    with SH_FOR(0, n):
        y[:] = y * 2
    rest = y - 0.47942 * 2.0**3  # off by much
    return rest


def test_a_distance_may_be_allowed(monkeypatch):
    with_fault(monkeypatch, "numpy", off_by(2))
    program, given = sh.Program(cancelling.recorded), (np.float32([1.1, 0.5]), 3)
    between = {"backends": ("interpreter", "numpy")}
    found = sh.testing.first_divergence(program, *given, **between)
    assert (found.loc.line, found.ulp, found.element) == (line_of("off by a little"), 2, (0,))
    assert "   2 ULP apart" in str(found)
    found = sh.testing.first_divergence(program, *given, **between, ulp=16)
    assert (found.loc.line, found.name, found.element) == (line_of("off by much"), "rest", (1,))
    assert found.ulp > 1000
    assert [row.same for row in found.rows].index(False) == 6, "what is within the distance is not marked"
    assert sh.testing.first_divergence(program, *given, **between, ulp=found.ulp) is None
    assert sh.testing.first_divergence(program, *given, **between, ulp=16, atol=1) is None
    with pytest.raises(AssertionError, match=f"part at .*:{line_of('off by much')}, element 1(.|\n)* ULP apart"):
        sh.testing.assert_equivalent(program, *given, **between, ulp=16)


def test_ways_that_part_are_found_whatever_distance_is_allowed(monkeypatch):
    with_fault(monkeypatch, "numpy", off_by(2))

    @sh.program
    def ways(x: sh.Attrib1f) -> sh.Attrib1f:
        y = sh.sin(x)
        with SH_IF(y > 0.47942555):  # the way
            y += 1
        return y

    found = sh.testing.first_divergence(ways, np.float32(0.5), backends=("interpreter", "numpy"), ulp=16)
    assert found.loc.line == line_of("the way")


def test_one_backend_is_not_enough():
    with pytest.raises(sh.ShpyTypeError, match="two backends at least"):
        sh.testing.first_divergence(small, X, backends=["numpy"])


@pytest.mark.parametrize("modes", [(), ("strict",), ("strict", "fast", "relaxed")])
def test_two_modes_are_compared(modes):
    with pytest.raises(sh.ShpyTypeError, match="is no pair of modes"):
        sh.testing.first_divergence(small, X, backends=["numpy", "opencl"], math=modes)


@pytest.mark.parametrize("element", [-1, 1.5, (0, 1), len(X)])
def test_an_element_is_one_of_the_run(element):
    with pytest.raises(sh.ShpyIndexError, match=rf"element .* of a run over {len(X)}"):
        sh.testing.first_divergence(turning, X, 6, element=element)


def test_an_input_may_be_called_math():
    @sh.program
    def doubled(math: sh.Attrib1f) -> sh.Attrib1f:
        return 2 * math

    assert sh.testing.first_divergence(doubled, math=(0, 1, 2), backends=("numpy", "interpreter")) is None


def test_a_backend_that_is_none_is_named():
    with pytest.raises(sh.BackendUnavailable, match="there is no backend 'opencl-3'"):
        sh.testing.first_divergence(small, X, backends=["numpy", "opencl-3"])
