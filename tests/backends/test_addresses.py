"""Indices of tables in loops: the address of the part that a loop does not change is computed before it."""

import re

import numpy as np
import pytest

import shpy as sh
from shpy import SH_FOR

VALUES = np.random.default_rng(0).random(64).astype(np.float32)
ROWS = sh.Table(VALUES, sh.Attrib1f, "rows")


def summing(index, start=lambda at: sh.clamp(at, 0, 7)):
    """Return the program that adds up ROWS[index(k, side, x)] for k < 5."""

    def sums(at: sh.Attrib1i, x: sh.Attrib1f) -> sh.Attrib1f:
        side = start(at)
        total = sh.Attrib1f(0)
        with SH_FOR(0, 5) as k:
            row = sh.min(8 * k, 48)
            total += x * ROWS[index(sh.max(row, 0), side)]
        return total

    return sh.program(sums)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("base", [np.float32, np.int32, np.uint32, np.bool_])
def test_elements_of_every_type(base):
    """Tables of each size, which one program reads."""
    letter = {np.float32: "f", np.int32: "i", np.uint32: "u", np.bool_: "b"}[base]
    tables = []
    for size in (1, 2, 3, 4):
        values = np.random.default_rng(1).integers(0, 2 if base is np.bool_ else 99, (64, size)).astype(base)
        kind = getattr(sh, f"Attrib{size}{letter}")
        tables.append((kind, sh.Table(values if size > 1 else values[:, 0], kind, f"rows_{size}")))

    def last(at: sh.Attrib1i, n: sh.Attrib1i):
        side = sh.clamp(at, 0, 7)
        found = [kind(*[0] * kind.size) for kind, _ in tables]
        with SH_FOR(0, n) as k:
            for element, (kind, rows) in zip(found, tables, strict=True):
                element[:] = rows[sh.clamp(5 * k, 0, 48 - kind.size) + side]
        return tuple(found)

    program = sh.program(last)
    source = program.compile("opencl", lanes=1).source
    assert re.findall(r"\(rows_(\d) \+ \w+\)\[", source) == ["1", "2", "4"]
    at, n = np.arange(-3, 61, dtype=np.int32), np.arange(64, dtype=np.int32) % 9
    wanted = program.compile("numpy")(at, n)
    for elements in wanted:
        assert len(np.unique(elements)) == 2 if base is np.bool_ else len(np.unique(elements)) > 9
    for lanes in (1, 8):
        for expected, found in zip(wanted, program.compile("opencl", lanes=lanes)(at, n), strict=True):
            np.testing.assert_array_equal(expected, found)


def assert_same_bits(program):
    at, x = np.arange(-3, 61, dtype=np.int32), np.linspace(-2, 2, 64, dtype=np.float32)
    wanted = program.compile("numpy")(at, x)
    for lanes in (1, 8):
        np.testing.assert_array_equal(wanted, program.compile("opencl", lanes=lanes)(at, x))


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "index", [lambda row, side: row + side, lambda row, side: side + row, lambda row, side: (row + 1) + side]
)
def test_the_steady_part_of_an_index_is_added_to_the_table(index):
    program = summing(index)
    assert "(rows + t)[" in program.compile("opencl", lanes=1).source
    assert_same_bits(program)


@pytest.mark.sampled(6)
@pytest.mark.parametrize(
    ("index", "start"),
    [
        (lambda row, side: row + side, lambda at: at),  # may wrap
        (lambda row, side: row + side, lambda at: sh.clamp(at, 0, 40)),  # may be out of range
        (lambda row, side: row + 3, lambda at: at),  # a constant costs nothing
        (lambda row, side: side, lambda at: sh.clamp(at, 0, 40)),
        (lambda row, side: sh.max(row + side, 2), lambda at: sh.clamp(at, 0, 7)),
    ],
)
def test_other_indices_stay_as_they_are(index, start):
    program = summing(index, start)
    assert "(rows +" not in program.compile("opencl", lanes=1).source
    assert_same_bits(program)


def test_ints_that_cannot_wrap_are_added_as_ints():
    def indices(at: sh.Attrib1i) -> tuple[sh.Attrib1i, sh.Attrib1i, sh.Attrib1i]:
        low = sh.clamp(at, -9, 9)
        return 3 * low - 4, low + at, sh.clamp(at, 0, 2**31 - 1) + sh.clamp(at, 0, 1)

    program = sh.program(indices)
    source = program.compile("opencl", lanes=1).source
    assert "3 * low - 4;" in source
    assert "low + (uint)at" in source
    assert source.count("(uint)") == 2
    at = np.array([2**31 - 1, -(2**31), 0, 5, -7], np.int32)
    for wanted, found in zip(program.compile("numpy")(at), program.compile("opencl", lanes=1)(at), strict=True):
        np.testing.assert_array_equal(wanted, found)
