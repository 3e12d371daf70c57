"""Vectors beside scalars, vectors of vectors, indices of either sign: small programs against plain numpy."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from backends.running import TARGETS

import shpy as sh
from shpy import SH_FOR, SH_WHILE

WAYS = [("numpy", None), *(("opencl", n) for n in (1, 8)), ("glsl", None)]
everywhere = pytest.mark.parametrize(("backend", "lanes"), WAYS)
assert {backend for backend, _ in WAYS} == set(TARGETS)

A = np.float32([[-1, 2, -3], [1, -2, 3], [-1, -1, -1], [1, 1, 1]])
B = np.float32([-1, -1, 1, 1])
LEAST = -(2**31)


def outputs(program: sh.Program, backend: str, lanes: int | None, *arrays: Any) -> list[Any]:
    """Return the program's result at the requested width: a fall back to another width would warn."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", sh.ShpyWarning)
        found = program.compile(backend, lanes=lanes or "auto")(*arrays)
    return list(found) if isinstance(found, tuple) else [found]


@pytest.mark.sampled(2)
@everywhere
def test_one_bool_beside_a_vector_of_bools(backend: str, lanes: int | None) -> None:
    @sh.program
    def mixed(a: sh.Attrib3f, b: sh.Attrib1f):
        m, one = a < 0, b < 0
        return (
            sh.cond(m & one, 1, 2), sh.cond(one | m, 1, 2), sh.cond(m ^ one, 1, 2), sh.cond(m == one, 1, 2),
            sh.cond(one != m, 1, 2), sh.any(m & one), sh.all(m | one), m & one,
        )  # fmt: skip

    m, one = A < 0, (B < 0)[:, None]
    expected = [np.where(w, 1, 2) for w in (m & one, m | one, m ^ one, m == one, m != one)]
    expected += [(m & one).any(axis=1), (m | one).all(axis=1), m & one]
    for found, wanted in zip(outputs(mixed, backend, lanes, A, B), expected, strict=True):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.sampled(2)
@everywhere
def test_the_least_int_has_no_absolute_value(backend: str, lanes: int | None) -> None:
    @sh.program
    def least(i: sh.Attrib3i, k: sh.Attrib1i):
        a, b = sh.abs(i), sh.abs(k)
        return a < 0, a >> 1, sh.min(a, 5), b < 0, b // 2, sh.max(sh.abs(i), sh.abs(k))

    i = np.int32([[LEAST, 5, -7], [1, LEAST, 3]])
    k = i[:, 0]
    a, b = np.abs(i), np.abs(k)
    expected = [a < 0, a >> 1, np.minimum(a, 5), b < 0, b // 2, np.maximum(a, b[:, None])]
    for found, wanted in zip(outputs(least, backend, lanes, i, k), expected, strict=True):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.sampled(2)
@everywhere
def test_vectors_are_parts_of_vectors(backend: str, lanes: int | None) -> None:
    """Each meets an operation of whole vectors, for which packets put the vectors together again."""
    shift = sh.Param(sh.Attrib1f, 0.5, name="shift")

    @sh.program
    def parts(p: sh.Attrib3f, k: sh.Attrib1i):
        pairs = sh.Attrib2i(k, k + 1)
        whole = sh.Attrib4f(p.xy, p.zx)
        return (
            sh.length(sh.vec3(p.x - 1, p.yz)), sh.length(p - sh.vec3(shift, 0, 0)), sh.normalize(whole),
            sh.Attrib4i(pairs, pairs.yx), sh.any(sh.Attrib3b(p.x < 0, p.yz < 0)),
        )  # fmt: skip

    k = np.int32([1, 2, 3, -4])
    wanted = parts.compile("opencl", lanes=1)(A, k)
    np.testing.assert_array_equal(wanted[3], np.stack([k, k + 1, k + 1, k], axis=1))
    np.testing.assert_allclose(wanted[0], np.linalg.norm(A - [1, 0, 0], axis=1), rtol=1e-6)
    for found, expected in zip(outputs(parts, backend, lanes, A, k), wanted, strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.sampled(2)
@everywhere
def test_a_lane_query_may_pick_what_a_constructor_takes(backend: str, lanes: int | None) -> None:
    """Either index is beyond the table's end, so that the element is the last one at every width."""
    table = sh.Table(np.float32([[1, 2], [3, 4]]), sh.Attrib2f, name="table")

    @sh.program
    def picked(x: sh.Attrib1f) -> sh.Attrib4f:
        pair = table[sh.cond(sh.any_lane(x > 0), 7, 9)]
        return sh.pow(sh.Attrib4f(pair, x, x), sh.Attrib4f(2, x, pair))

    (found,) = outputs(picked, backend, lanes, np.float32([1, 2]))
    np.testing.assert_array_equal(found, np.float32([[9, 4, 1, 1], [9, 16, 8, 16]]))


@pytest.mark.sampled(2)
@everywhere
def test_repeated_scalars_are_stored_at_places_that_differ(backend: str, lanes: int | None) -> None:
    @sh.program
    def repeated(i: sh.Attrib1i, x: sh.Attrib1f):
        a, b = sh.Array(sh.Attrib3f, 2), sh.Array(sh.Attrib3f, 2)
        a[i] = sh.Color3f(1, 1, 1)
        b[i] = sh.Attrib3f(x)
        return a[0], b[1]

    i, x = np.int32([0, 1, 2, 0, -1]), np.float32([1, 2, 3, 4, 5])
    first, second = outputs(repeated, backend, lanes, i, x)
    np.testing.assert_array_equal(first, np.float32([[1] * 3, [0] * 3, [0] * 3, [1] * 3, [0] * 3]))
    np.testing.assert_array_equal(second, np.float32([[0] * 3, [2] * 3, [0] * 3, [0] * 3, [0] * 3]))


@pytest.mark.sampled(2)
@everywhere
def test_an_unsigned_index_of_an_array(backend: str, lanes: int | None) -> None:
    """Beyond the range of an int it is beyond the end, not before the start."""

    @sh.program
    def unsigned(u: sh.Attrib1u, x: sh.Attrib1f):
        a = sh.Array(sh.Attrib1f, [x, x + 1, x + 2])
        b = sh.Array(sh.Attrib1f, 2)
        b[u] = x
        b[u] += 1
        return a[u], b[0], b[1]

    u, x = np.uint32([0, 1, 2, 3, 2**31 + 1, 2**32 - 1]), np.float32([1, 2, 3, 4, 5, 6])
    read, zero, one = outputs(unsigned, backend, lanes, u, x)
    np.testing.assert_array_equal(read, np.float32([1, 3, 5, 6, 7, 8]))
    np.testing.assert_array_equal(zero, np.float32([2, 0, 0, 0, 0, 0]))
    np.testing.assert_array_equal(one, np.float32([0, 3, 0, 0, 0, 0]))


@pytest.mark.sampled(2)
@everywhere
def test_what_is_the_same_for_all_is_stored_while_elements_leave_a_loop(backend: str, lanes: int | None) -> None:
    """The result of a function is the same for all lanes, and the variable that takes it is not."""

    @sh.subroutine
    def number(k):
        r = sh.Attrib1f(3.0)
        with SH_FOR(2):
            r += k
        return r

    @sh.program
    def leaving(a: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
        k = sh.Attrib1i(0)
        with SH_WHILE(lambda: k < n):
            k += 1
            a[:] = number(sh.Attrib1f(0.5))
        return a

    n = np.int32([0, 1, 2, 3, 0, 3, 1, 1])
    (found,) = outputs(leaving, backend, lanes, np.arange(8, dtype=np.float32), n)
    np.testing.assert_array_equal(found, np.where(n > 0, 4, np.arange(8)))
