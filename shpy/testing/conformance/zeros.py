"""Conformance cases of zeros that a driver's compiler can derive: a counter of an unrolled loop, 1 - 1, floor(0.5).

A compiler that takes 0 * x for 0, or x + 0 for x, is wrong where x is infinite, NaN or -0.0. So is one that makes a
number of a NaN which it derives.
"""

from __future__ import annotations

import numpy as np

import shpy as sh
from shpy import SH_BREAK, SH_DO, SH_FOR, SH_IF, SH_RETURN, SH_UNTIL, SH_WHILE
from shpy.testing.conformance.cases import Case, by_decorator

CASES: list[Case] = []
case = by_decorator(CASES)
NAN, INF = float("nan"), float("inf")
X = np.array([INF, -INF, NAN, -0.0, 0.0, 1.5, -2.0, 3e38], np.float32)
COUNT = sh.Param(sh.Attrib1i, 2, name="count")
NOTHING = sh.Param(sh.Attrib1i, 0, name="nothing")


@case(x=X, expected=np.array([NAN, NAN, NAN, 0.0, 0.0, 1.5, -2.0, 3e38], np.float32))
def a_counter_times_infinity(x: sh.Attrib1f) -> sh.Attrib1f:
    c = sh.Attrib1f(0)
    with SH_FOR(0, 2) as i:
        c += x * i
    return c


@case(x=X, expected=np.array([NAN, NAN, NAN, 0.0, 0.0, 1.5, -2.0, 3e38], np.float32))
def a_counter_to_a_param_times_infinity(x: sh.Attrib1f) -> sh.Attrib1f:
    c = sh.Attrib1f(0)
    with SH_FOR(0, COUNT) as i:
        c += x * i
    return c


@case(x=X)
def a_counter_that_is_compared_with_a_param(x: sh.Attrib1f) -> sh.Attrib1f:
    c = sh.Attrib1f(1)
    with SH_FOR(0, 3) as i:
        with SH_IF(i < COUNT):
            c += x * (i - NOTHING)
        with SH_IF(NOTHING == i):
            c -= x * NOTHING
    return c


@case(x=X)
def a_choice_by_a_counter(x: sh.Attrib1f) -> sh.Attrib1f:
    c = sh.Attrib1f(0)
    with SH_FOR(0, 2) as i:
        c += x * sh.cond(i < 1, 0.0, 2.0)
        c += x * (sh.cond(i < 1, 1.0, 2.0) - 1)
    return c


@case(x=X)
def bools_of_a_counter(x: sh.Attrib1f) -> sh.Attrib1f:
    c = sh.Attrib1f(0)
    with SH_FOR(0, 2) as i:
        c += x * sh.Attrib1f(i > 0)
        c += x * (1 - sh.Attrib1f(i < 1))
    return c


@case(x=X)
def one_minus_a_counter(x: sh.Attrib1f) -> sh.Attrib1f:
    c = sh.Attrib1f(0)
    with SH_FOR(0, 2) as i:
        c += x * (1 - sh.Attrib1f(i))
    return c


@case(x=X)
def a_variable_that_is_counted_down(x: sh.Attrib1f) -> sh.Attrib1f:
    y, c = sh.Attrib1f(1), sh.Attrib1f(0)
    with SH_FOR(0, 2):
        y -= 1
        c += x * y
    return c


@case(x=X)
def a_variable_that_is_halved(x: sh.Attrib1f) -> sh.Attrib1f:
    y, c = sh.Attrib1f(2), sh.Attrib1f(0)
    with SH_DO():
        y *= 0.5
        c += x * sh.floor(y)
        SH_UNTIL(y < 0.5)
    return c


@case(x=X)
def a_vector_that_is_counted_down(x: sh.Attrib1f) -> sh.Attrib3f:
    y, c = sh.Attrib3f(1, x, 2), sh.Attrib3f(0)
    with SH_FOR(0, 2):
        y -= sh.Attrib3f(1, 1, 2)
        c += x * y
    return c


@case(x=X)
def products_of_constants(x: sh.Attrib1f):
    small, half, one = sh.Attrib1f(1e-30), sh.Attrib1f(0.5), sh.Attrib1f(1)
    return x * (small * small), x * sh.floor(half), x * (one - 1), x * sh.sqrt(small * small)


@case(a=X, b=X[::-1].copy())
def mix_at_its_ends(a: sh.Attrib1f, b: sh.Attrib1f):
    return sh.mix(a, b, 1.0), sh.mix(a, b, 0.0), sh.mix(a, b, sh.Attrib1f(1)), sh.mix(1.0, 1.0, a)


@case(a=X, i=np.arange(8, dtype=np.int32))
def an_int_less_itself(a: sh.Attrib1f, i: sh.Attrib1i):
    zero = sh.Attrib1f(i - i)
    return zero * a, a + zero, sh.Attrib1f(i ^ i) * a, sh.Attrib1f(sh.Attrib1u(i) >> 31) * a


@case(v=np.stack([X, X[::-1], np.full_like(X, np.nan), np.ones_like(X)], axis=1))
def a_component_less_itself(v: sh.Attrib4f):
    constants = sh.distance(sh.Attrib4f(np.nan, 3, 3, 3), sh.Attrib4f(np.nan, np.inf, 1, 1e10))
    return v - v.xwzy, v + -v.xwzy, v.wzyx / v, less(v.x, v.x), constants + v.w


@sh.subroutine
def less(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
    """Return x - y."""
    with SH_IF(y > 1):
        SH_RETURN(x - y)
    return x - y


@case(x=X)
def bits_of_a_counter(x: sh.Attrib1f) -> sh.Attrib1f:
    c = sh.Attrib1f(0)
    with SH_FOR(0, 2) as i:
        c += x * sh.float_from_bits(sh.Attrib1u(i) << 30)
    return c


@case(x=X, n=np.arange(8, dtype=np.int32))
def an_int_that_is_known_in_a_branch(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    c = sh.Attrib1f(1)
    with SH_IF(n == 0):
        c += x * n
    with SH_IF((n & 1) == 0):
        c += x * (n & 1)
    return c


@sh.subroutine
def scaled(x: sh.Attrib1f, y: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    """Return x times 0 for y = 1 and n = 3."""
    return x * (y - 1) + x * (sh.Attrib1f(n) - 3)


@case(x=X)
def literals_as_arguments(x: sh.Attrib1f):
    return scaled(x, sh.Attrib1f(1), sh.Attrib1i(3)), sh.smoothstep(1, 1, x), sh.smoothstep(0.25, 0.5, x)


@case(x=X)
def a_quotient_that_is_counted(x: sh.Attrib1f):
    q, r = sh.Attrib1f(1), sh.Attrib1f(0)
    n = sh.Attrib1i(3)
    with SH_WHILE(lambda: n > 0):
        n -= 1
        q += x / sh.Attrib1f(n)
        r += sh.Attrib1f(n) / x
    return q, r


@case(x=X)
def an_array_of_literals(x: sh.Attrib1f) -> sh.Attrib1f:
    weights, c = sh.Array(sh.Attrib1f, [0.0, 1.0, 0.5]), sh.Attrib1f(0)
    with SH_FOR(0, 3) as i:
        c += x * weights[i]
        c += x * (weights[i] - 1)
        SH_BREAK(x > 2)
    return c


@case(x=X)
def roundings_of_a_derived_nan(x: sh.Attrib1f):
    nothing = np.float32("nan") - x
    never = sh.Attrib1f(np.float32("inf")) * (x - x)
    return sh.floor(nothing), sh.ceil(nothing), sh.trunc(never), sh.round(nothing), sh.fract(nothing), nothing % 2


@case(x=X, expected=(np.full(8, NAN),) * 6, options={"math": "relaxed"})
def exponentials_of_a_derived_nan(x: sh.Attrib1f):
    nothing = np.float32("nan") - x
    never = sh.Attrib1f(np.float32("inf")) * (x - x)
    return sh.exp(nothing), sh.exp2(nothing), sh.sinh(nothing), sh.tanh(nothing), sh.exp(never), sh.tanh(never)


@case(x=X, expected=(np.full((8, 3), NAN),) * 4, options={"math": "relaxed"})
def vectors_of_a_derived_nan(x: sh.Attrib1f):
    nothing = sh.Attrib3f(np.float32("nan")) - x
    return sh.exp(nothing), sh.exp2(nothing), sh.sinh(nothing), sh.tanh(nothing)


def cases() -> list[Case]:
    """Return every case of this module."""
    return CASES
