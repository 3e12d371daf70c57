"""numpy's text changes an array that nobody else reads, and no other one."""

from __future__ import annotations

import numpy as np
import pytest

import shpy as sh
from shpy import SH_FOR, SH_IF, SH_WHILE
from shpy.backend.numpy.lanes import MANY_ROWS, fold

X = np.linspace(-2, 2, 40, dtype=np.float32)
Y = np.cos(X).astype(np.float32)


def text_of(program, *inputs, **options):
    """numpy's text, after its results were compared with the interpreter's, bit by bit."""
    sh.testing.assert_equivalent(program, *inputs, backends=["interpreter", "numpy"], **options)
    return program.compile("numpy").source


def test_a_sum_grows_in_its_own_array():
    @sh.program
    def polynomial(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
        total = sh.Attrib1f(3 * x)
        total += y * y
        total -= 0.5
        total[:] = sh.mad(total, x, y)
        total *= 2
        return total

    lines = [line.partition("  #")[0].strip() for line in text_of(polynomial, X, Y).splitlines()[4:]]
    assert lines == [
        "total = 3.0 * x",
        "total += y * y",
        "total -= 0.5",
        "total *= x",
        "total += y",
        "total *= 2.0",
        "return total",
    ]


def test_what_is_read_again_is_kept():
    @sh.program
    def f(x: sh.Attrib1f, y: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f]:
        total = sh.Attrib1f(x * y)
        nameless = []
        nameless.append(total * 3)
        total += y
        kept = total.copy()
        total += x
        return nameless[0] * total, kept

    source = text_of(f, X, Y)
    assert "total += y" not in source, "what was made of it before is written later"
    assert "total += x" not in source, "it has a second name"


def test_an_input_and_what_a_slot_holds_too_are_kept():
    @sh.program
    def f(x: sh.Attrib1f, y: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f]:
        x += y
        x += 1
        slot = sh.Attrib1f(0)
        with SH_IF(y > 0):
            slot[:] = x
        x *= 2
        return x, slot

    given = X.copy()
    source = text_of(f, given, Y)
    assert "x += y" not in source
    assert "x *= 2" not in source
    np.testing.assert_array_equal(given, X)
    with_inputs = f.compile("numpy")
    with_inputs(given, Y)
    np.testing.assert_array_equal(given, X)


def test_what_is_made_before_a_loop_is_not_changed_in_it():
    @sh.program
    def f(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
        total = sh.Attrib1f(x * y)
        result = sh.Attrib1f(0)
        with SH_FOR(3) as i:
            result += sh.sin(total + i)
            with SH_IF(result > y):
                result *= total
        return result

    assert "total +=" not in text_of(f, X, Y)


@pytest.mark.parametrize("shape", [(3, 5), (1, 7), (6, 1)])
def test_a_row_does_not_become_a_block(shape):
    @sh.program
    def f() -> sh.Attrib1f:
        row, column = sh.grid_index(2)
        total = sh.Attrib1f(column * 0.5)
        total += 1
        total += row * 0.25
        total += row
        return total

    assert "total +=" not in text_of(f, shape=shape)


def test_neighbours_are_summed_in_one_block():
    rng = np.random.default_rng(1)
    heights = sh.Table(rng.random((6, 9), dtype=np.float32), sh.Attrib1f, "heights")

    @sh.program
    def f() -> sh.Attrib1f:
        row, column = sh.grid_index(2)
        total = sh.Attrib1f(0.5 * heights[row, column])
        for step in (-1, 1):
            total += 0.25 * heights[row, column + step]
        return total

    assert text_of(f, shape=(6, 9)).count("total += 0.25 * heights.neighbour") == 2


@pytest.mark.parametrize("lanes", [(), (1,), (2,), (3,), (70,), (2, 1), (1, 3), (4, 5)])
@pytest.mark.parametrize("rows", [1, MANY_ROWS - 1, MANY_ROWS, 9, 40])
def test_rows_are_summed_in_order(rows, lanes):
    rng = np.random.default_rng(rows)
    total = np.asarray(rng.normal(size=lanes), np.float32)
    terms = (rng.normal(size=(rows, *lanes)) * 10.0 ** rng.integers(-5, 5, (rows, *lanes))).astype(np.float32)
    given = terms.copy()
    wanted = total
    for term in terms:
        wanted = wanted + term
    np.testing.assert_array_equal(fold(np.add, total, terms), wanted)
    np.testing.assert_array_equal(terms, given)


def test_a_term_that_is_the_same_in_all_lanes_or_not_ours_is_summed_too():
    total = np.zeros(5, np.float32)
    column = np.arange(8, dtype=np.float32).reshape(8, 1)
    np.testing.assert_array_equal(fold(np.add, total, column), np.full(5, 28))
    seen = np.broadcast_to(column, (8, 5))
    np.testing.assert_array_equal(fold(np.add, total, seen), np.full(5, 28))


def test_what_a_loop_reads_and_a_sum_after_it_changes_has_all_lanes_again():
    """The loop goes on with fewer lanes and changes nothing that outlives it; then `first` grows in its own array."""

    @sh.program
    def grown(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
        first = sh.Attrib1f(x * 0.5)
        k = sh.Attrib1i(0)
        with SH_WHILE(lambda: (k < 20) & (first >= 0.05 * sh.Attrib1f(k))):
            k += 1
        first += y * y
        return first

    text = text_of(grown, X, Y)
    assert "first += " in text
    assert "compact(live" in text
