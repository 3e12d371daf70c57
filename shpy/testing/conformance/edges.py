"""Conformance cases of the edges that docs/numerics.md decides once for all targets, with what they must give."""

from __future__ import annotations

import numpy as np

import shpy as sh
from shpy.testing.conformance.cases import Case, by_decorator

CASES: list[Case] = []
case = by_decorator(CASES)
NAN, INF = float("nan"), float("inf")
I_MIN, I_MAX, U_MAX = -(2**31), 2**31 - 1, 2**32 - 1


def f(*numbers: float) -> np.ndarray:
    """Return a binary32 array."""
    return np.array(numbers, np.float32)


@case(x=f(NAN, 1, NAN, -0.0, 0.0, INF), y=f(2, NAN, NAN, 0.0, -0.0, NAN),
      expected=(f(2, 1, NAN, -0.0, 0.0, INF), f(2, 1, NAN, -0.0, 0.0, INF)))  # fmt: skip
def min_and_max_give_the_number_beside_a_nan(x: sh.Attrib1f, y: sh.Attrib1f):
    return sh.min(x, y), sh.max(x, y)


@case(x=f(NAN, -5, 5, 0.5), expected=f(0, 0, 1, 0.5))
def clamp_of_nan_is_the_lower_limit(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.clamp(x, 0, 1)


@case(x=f(NAN, 0.0, -0.0, 3, -3, INF, -INF, 1e-30), expected=f(0, 0, 0, 1, -1, 1, -1, 1))
def sign_of_nan_and_of_both_zeros_is_zero(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.sign(x)


@case(x=f(0.5, 1.5, 2.5, -0.5, -2.5, 8388607.5, 4194304.5, 0.49999997, -0.2, INF, NAN),
      expected=f(0, 2, 2, -0.0, -2, 8388608, 4194304, 0, -0.0, INF, NAN))  # fmt: skip
def round_halves_to_even(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.round(x)


@case(x=f(-1, 1, -7, 7, 5.5, -0.25, INF, 1), y=f(3, -3, 3, -3, 2, 1, 2, INF),
      expected=(f(2, -2, 2, -2, 1.5, 0.75, NAN, NAN), f(-1, -1, -3, -3, 2, -1, INF, 0)))  # fmt: skip
def mod_and_floor_division_of_floats(x: sh.Attrib1f, y: sh.Attrib1f):
    return x % y, x // y


@case(x=f(-0.0152, 0.0152, 1e-30, -1e-30, -2e-38, -0.0, -1, 1e-30),
      y=f(3.4e38, -3.4e38, 3e38, -3e38, 3, 3.4e38, INF, -3e38),
      expected=(f(3.4e38, -3.4e38, 1e-30, -1e-30, 3, 0, NAN, -3e38), f(-1, -1, 0, 0, -1, -0.0, -0.0, -1)))  # fmt: skip
def quotients_that_are_flushed_have_a_sign(x: sh.Attrib1f, y: sh.Attrib1f):
    return x % y, x // y


@case(a=f(1e-30, 1e-30, -1e-30, 0, 1e-30), b=f(-1e-30, 1e-30, -1e-30, -1, -1), c=f(0, -0.0, 0, 0, 0),
      expected=f(-0.0, 0, 0, 0, -1e-30))  # fmt: skip
def fma_keeps_the_sign_of_what_is_flushed(a: sh.Attrib1f, b: sh.Attrib1f, c: sh.Attrib1f) -> sh.Attrib1f:
    return sh.fma(a, b, c)


@case(a=np.array([-7, 7, -7, 7, 6, I_MIN, I_MIN, I_MAX, 5, 0, I_MIN]),
      b=np.array([2, -2, -2, 2, 3, -1, 2, I_MIN, 0, 0, 0]),
      expected=(np.array([-4, -4, 3, 3, 2, I_MIN, -(2**30), -1, 0, 0, 0]),
                np.array([1, -1, -1, 1, 0, 0, 0, -1, 0, 0, 0])))  # fmt: skip
def floor_division_and_modulo_of_ints(a: sh.Attrib1i, b: sh.Attrib1i):
    return a // b, a % b


@case(a=np.array([7, U_MAX, U_MAX, 5, 0, 2**31]), b=np.array([2, 2, U_MAX, 0, 0, 3]),
      expected=(np.array([3, I_MAX, 1, 0, 0, 715827882]), np.array([1, 1, 0, 0, 0, 2])))  # fmt: skip
def floor_division_and_modulo_of_uints(a: sh.Attrib1u, b: sh.Attrib1u):
    return a // b, a % b


@case(x=f(0, -2, -2, 0, 2, -0.0, 1, -1, INF, 0.5, -8), y=f(0, 2, 0.5, -1, -1, -1, NAN, INF, 0, INF, 3),
      expected=f(1, 4, NAN, INF, 0.5, -INF, 1, 1, 1, 0, -512))  # fmt: skip
def pow_at_its_edges(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
    return x**y


PI = np.float64(np.pi)


@case(y=f(0, 0, -0.0, -0.0, 1, -1, 1, 1, INF, INF, -INF, 1, 1, NAN),
      x=f(0, -0.0, 0, -0.0, 0, 0, 1, -1, INF, -INF, 0, INF, -INF, 1), ulp=1,
      expected=PI * f(0, 1, -0.0, -1, 0.5, -0.5, 0.25, 0.75, 0.25, 0.75, -0.5, 0, 1, NAN))  # fmt: skip
def atan2_as_c99(y: sh.Attrib1f, x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.atan2(y, x)


@case(x=f(3, -5, 0, INF, NAN, NAN, 1, 3 * 2.0**110, 2.0**126, 3.4028235e38, 14784729, 12525682),
      y=f(4, 12, -0.0, NAN, -INF, 0, INF, 2.0**112, 2.0**126, 3.4028235e38, 7946000, 3539.1640625),
      expected=f(5, 13, 0, INF, INF, NAN, INF, 5 * 2.0**110, 2**0.5 * 2.0**126, INF, 16784728, 12525683))  # fmt: skip
def hypot_as_c99(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
    return sh.hypot(x, y)


@case(x=f(-0.0, -INF, INF, NAN, 1, -1, -2), ulp=1,
      expected=(f(-0.0, -1, INF, NAN, np.e - 1, 1 / np.e - 1, np.exp(-2) - 1),
                f(-0.0, NAN, INF, NAN, np.log(2), -INF, NAN),
                f(-0.0, -INF, INF, NAN, 1, -1, -(2 ** (1 / 3))),
                f(1, 0, INF, NAN, 10, 0.1, 0.01),
                f(-0.0, -1, 1, NAN, 0.8427007929497149, -0.8427007929497149, -0.9953222650189527),
                f(1, 2, 0, NAN, 0.15729920705028513, 1.8427007929497149, 1.9953222650189527)))  # fmt: skip
def functions_by_annex_f(x: sh.Attrib1f):
    return sh.expm1(x), sh.log1p(x), sh.cbrt(x), sh.exp10(x), sh.erf(x), sh.erfc(x)


@case(x=f(-0.0, 1, -1, 2, -3, 0.5, -0.5, 1.5, 2.0**23 + 1, -(2.0**24), INF, NAN), expected=(
          f(-0.0, 0, -0.0, 0, -0.0, 1, -1, -1, 0, -0.0, NAN, NAN), f(1, -1, -1, 1, -1, 0, 0, 0, -1, 1, NAN, NAN)
      ))  # fmt: skip
def multiples_of_pi_as_ieee_754(x: sh.Attrib1f):
    return sh.sinpi(x), sh.cospi(x)


@case(v=np.array([[0, 0, 0], [-0.0, 0, 0], [3, 0, 4], [0, -2, 0]], np.float32),
      expected=np.array([[0, 0, 0], [0, 0, 0], [0.6, 0, 0.8], [0, -1, 0]], np.float32))  # fmt: skip
def normalize_of_zero_is_zero(v: sh.Vector3f) -> sh.Vector3f:
    return sh.normalize(v)


@case(v=np.array([[1e25, 0, 0], [-3e18, 4e18, 0], [3e-25, 0, -4e-25], [1e38, 1e38, 0], [INF, 1, 0], [3, 4, 0]], "f"),
      expected=(f(1e25, 5e18, 5e-25, 2**0.5 * 1e38, INF, 5),
                np.array([[1, 0, 0], [-0.6, 0.8, 0], [0.6, 0, -0.8], [0.5**0.5, 0.5**0.5, 0], [NAN, 0, 0],
                          [0.6, 0.8, 0]])),
      ulp=2)  # fmt: skip
def length_of_what_cannot_be_squared(v: sh.Attrib3f):
    return sh.length(v), sh.normalize(v)


@case(a=f(1, 1, 1, -0.0, 2), x=f(0.5, 1, 1.5, 0, NAN), expected=(f(0, 1, 1, 1, 1), f(0, 1, 1, 1, 1)))
def smoothstep_between_equals_is_step(a: sh.Attrib1f, x: sh.Attrib1f):
    return sh.smoothstep(a, a, x), sh.step(a, x)


@case(n=np.array([0, 1, 2, 255, I_MAX, -1, I_MIN]), expected=(np.array([32, 31, 30, 24, 1, 0, 0]),) * 2)
def leading_zeros_of_ints(n: sh.Attrib1i):
    return sh.count_leading_zeros(n), sh.count_leading_zeros(sh.Attrib1u(n))


@case(x=f(-1, 0, 0.25, 0.5, 0.75, 1, 2, INF, -INF), expected=f(0, 0, 0.103515625, 0.5, 0.896484375, 1, 1, 1, 0))
def smootherstep_from_end_to_end(x: sh.Attrib1f):
    return sh.smootherstep(0, 1, x)


@case(a=f(1, 1, 1, -0.0, 2), x=f(0.5, 1, 1.5, 0, NAN), expected=(f(0, 1, 1, 1, 1), f(0, 1, 1, 1, 1)))
def smootherstep_between_equals_is_step(a: sh.Attrib1f, x: sh.Attrib1f):
    return sh.smootherstep(a, a, x), sh.step(a, x)


@case(x=f(0, 1, 100, 3e3, 1e4, 1e5, 2.0**20, -2.0**20), ulp=1,
      expected=lambda x: (np.sin(x.astype(np.float64)), np.cos(x.astype(np.float64))))  # fmt: skip
def sin_and_cos_up_to_a_million(x: sh.Attrib1f):
    return sh.sin(x), sh.cos(x)


@case(x=f(NAN, INF, -INF, 1e10, -1e10, 2147483520, -2147483648, 1.9, -1.9, -0.5),
      expected=(np.array([0, I_MAX, I_MIN, I_MAX, I_MIN, 2147483520, I_MIN, 1, -1, 0]),
                np.array([0, U_MAX, 0, U_MAX, 0, 2147483520, 0, 1, 0, 0])))  # fmt: skip
def floats_saturate_to_ints_and_nan_is_zero(x: sh.Attrib1f):
    return sh.Attrib1i(x), sh.Attrib1u(x)


@case(
    i=np.array([-1, I_MIN, 7]),
    u=np.array([U_MAX, 2**31, 7]),
    expected=(np.array([U_MAX, 2**31, 7]), np.array([-1, I_MIN, 7])),
)
def ints_and_uints_wrap_into_each_other(i: sh.Attrib1i, u: sh.Attrib1u):
    return sh.Attrib1u(i), sh.Attrib1i(u)


@case(i=np.array([2**24 + 1, -(2**24) - 1, I_MAX, I_MIN]), u=np.array([2**24 + 1, 2**24 + 3, U_MAX, 2**31 + 128]),
      expected=(f(2**24, -(2**24), 2**31, -(2**31)), f(2**24, 2**24 + 4, 2**32, 2**31)))  # fmt: skip
def ints_round_to_the_nearest_float(i: sh.Attrib1i, u: sh.Attrib1u):
    return sh.Attrib1f(i), sh.Attrib1f(u)


@case(a=np.array([1, 1, -8, -8, I_MIN, 5]), n=np.array([32, 33, 1, 33, 31, -1]),
      expected=(np.array([1, 2, -16, -16, 0, I_MIN]), np.array([1, 0, -4, -4, -1, 0])))  # fmt: skip
def shifts_count_modulo_32(a: sh.Attrib1i, n: sh.Attrib1i):
    return a << n, a >> n


@case(
    a=np.array([1, U_MAX, 2**31]),
    n=np.array([63, 4, 31]),
    expected=(np.array([2**31, U_MAX - 15, 0]), np.array([0, 2**28 - 1, 1])),
)
def shifts_of_uints_are_logical(a: sh.Attrib1u, n: sh.Attrib1u):
    return a << n, a >> n


@case(a=np.array([I_MAX, I_MIN, I_MIN, 2**16, 12345]), b=np.array([1, 1, -1, 2**16, -54321]),
      expected=(np.array([I_MIN, I_MIN + 1, I_MAX, 2**17, -41976]), np.array([I_MAX - 1, I_MAX, I_MIN + 1, 0, 66666]),
                np.array([I_MAX, I_MIN, I_MIN, 0, -670592745]), np.array([-I_MAX, I_MIN, I_MIN, -(2**16), -12345]),
                np.array([I_MAX, I_MIN, I_MIN, 2**16, 12345])))  # fmt: skip
def ints_wrap(a: sh.Attrib1i, b: sh.Attrib1i):
    return a + b, a - b, a * b, -a, sh.abs(a)


@case(a=np.array([7, -7, 1, 0]), b=np.array([2, 2, 0, 0]), expected=f(3.5, -3.5, INF, NAN))
def division_of_ints_gives_floats(a: sh.Attrib1i, b: sh.Attrib1i) -> sh.Attrib1f:
    return a / b


NUMBERS = sh.Table([10, 20, 30], sh.Attrib1i)


@case(i=np.array([-1, 0, 1, 2, 3, I_MIN, I_MAX]), expected=np.array([10, 10, 20, 30, 30, 10, 30]))
def reads_of_tables_out_of_range_give_the_nearest(i: sh.Attrib1i) -> sh.Attrib1i:
    return NUMBERS[i]


@case(u=np.array([0, 2, 3, 2**31, U_MAX]), expected=np.array([10, 30, 30, 30, 30]))
def reads_at_a_uint_out_of_range_give_the_nearest(u: sh.Attrib1u) -> sh.Attrib1i:
    return NUMBERS[u]


@case(i=np.array([-1, 0, 1, 2, 3, I_MIN, I_MAX]),
      expected=(np.array([1, 5, 1, 1, 1, 1, 1]), np.array([3, 3, 3, 5, 3, 3, 3]),
                np.array([1, 5, 5, 5, 3, 1, 3])))  # fmt: skip
def arrays_clamp_reads_and_drop_writes(i: sh.Attrib1i):
    a = sh.Array(sh.Attrib1i, [1, 2, 3])
    a[i] = 5
    return a[0], a[2], a[i]


@case(x=f(5), expected=(f(1), f(3), f(2)))
def arrays_take_constant_indices_out_of_range(x: sh.Attrib1f):
    a = sh.Array(sh.Attrib1f, [1, 2, 3])
    low, high = sh.Attrib1i(I_MIN), sh.Attrib1i(7)
    a[low] = x
    a[high] = x
    a[-low - 1 - I_MAX - 1] = x
    return a[low], a[high], a[1]


@case(i=np.array([-1, 0, 2, 3, I_MAX]), expected=f(1, 1, 3, 3, 3))
def components_at_an_index_are_clamped(i: sh.Attrib1i) -> sh.Attrib1f:
    v = sh.Attrib3f(1, 2, 3)
    return v[i]


@case(x=f(1e-38, 1e-40), y=f(0.1, 1), expected=lambda x, y: x * y)
def denormals_are_kept(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
    return x * y


@case(x=f(0.0, -0.0, 1, INF, -INF, NAN), y=f(-0.0, -0.0, 0, INF, 0, 1),
      expected=(f(0, -0.0, 1, INF, -INF, NAN), f(0, 0, 1, NAN, -INF, NAN),
                f(-0.0, 0.0, 0, INF, NAN, NAN), f(NAN, NAN, INF, NAN, -INF, NAN)))  # fmt: skip
def signed_zeros_and_infinities(x: sh.Attrib1f, y: sh.Attrib1f):
    return x + y, x - y, x * y, x / y


@case(x=f(0.0, -0.0, 1, NAN, -INF, INF),
      expected=(f(0, -0.0, 0, NAN, NAN, NAN), f(0, 0, 1, NAN, -INF, INF), f(0, 0, -1, NAN, INF, -INF),
                f(-0.0, 0, -1, NAN, INF, -INF), f(0, 0, 0, NAN, NAN, NAN)))  # fmt: skip
def arithmetic_with_zero_is_not_folded(x: sh.Attrib1f):
    return x * 0.0, x + 0.0, 0.0 - x, -x, x - x


@case(x=f(NAN, 1, INF, -INF, 0), y=f(NAN, NAN, INF, INF, -0.0),
      expected=tuple(np.array([d == "1" for d in digits]) for digits in (
          "00101", "11010", "00010", "00111", "00000", "00101", "10000", "00110")))  # fmt: skip
def comparisons_with_nan(x: sh.Attrib1f, y: sh.Attrib1f):
    return x == y, x != y, x < y, x <= y, x > y, x >= y, sh.isnan(x), sh.isinf(x)


@case(x=f(NAN, 1, -0.0, INF), expected=np.array([0x7FC00000, 0x3F800000, 0x80000000, 0x7F800000]))
def bits_of_every_nan_are_the_same(x: sh.Attrib1f) -> sh.Attrib1u:
    return sh.bits_from_float(x * 1)


@case(
    u=np.array([0x3F800000, 0x80000000, 0x7F800000, 0xFFC00001, 0x7F7FFFFF]),
    expected=f(1, -0.0, INF, NAN, 3.4028235e38),
)
def floats_from_bits(u: sh.Attrib1u) -> sh.Attrib1f:
    return sh.float_from_bits(u)


WORDS = np.array([0, 1, -1, 2, 0x12345678, 2**31 - 1, -(2**31), -(2**31) + 1, -7, 65535, 65536, -65536], np.int32)


@case(
    a=np.repeat(WORDS, 12),
    b=np.tile(WORDS, 12),
    expected=lambda a, b: (
        (a.astype(np.int64) * b >> 32).astype(np.int32),
        (a.astype(np.uint32).astype(np.uint64) * b.astype(np.uint32) >> np.uint64(32)).astype(np.uint32),
    ),
)
def upper_halves_of_products(a: sh.Attrib1i, b: sh.Attrib1i):
    return sh.mulhi(a, b), sh.mulhi(sh.Attrib1u(a), sh.Attrib1u(b))


def _rotated(x, n):
    word, count = x.astype(np.uint32).astype(np.uint64), (n & 31).astype(np.uint64)
    return ((word << count | word >> (np.uint64(32) - count)) & np.uint64(0xFFFFFFFF)).astype(np.uint32)


@case(
    x=np.repeat(WORDS, 9),
    n=np.tile([0, 1, 7, 31, 32, 33, -1, -32, 1000], 12),
    expected=lambda x, n: (
        _rotated(x, n).view(np.int32),
        _rotated(x, n),
        _rotated(x, -n).view(np.int32),
        _rotated(x, -n),
    ),
)
def rotations(x: sh.Attrib1i, n: sh.Attrib1i):
    u, count = sh.Attrib1u(x), sh.Attrib1u(n)
    return sh.rotl(x, n), sh.rotl(u, n), sh.rotr(x, count), sh.rotr(u, n)


@case(u=np.array([0, 0xFF, 0x100, 0x00FFF000, 0x80000000, 0xFFFFFFFF]))
def unit_floats_stay_below_one(u: sh.Attrib1u) -> sh.Attrib1f:
    return sh.unit_float(u)


TIE = np.float32(1 + 2**-12)


@case(a=np.full(1, TIE), b=np.full(1, TIE), c=f(-(1 + 2**-11)), expected=(f(2.0**-24), f(0)))
def fma_rounds_once_and_mad_twice(a: sh.Attrib1f, b: sh.Attrib1f, c: sh.Attrib1f):
    return sh.fma(a, b, c), sh.mad(a, b, c)


FUSED = {"fuse": True}
SMALL = 2.0**-24
"""The rounding error of the square of TIE."""


@case(a=np.full(1, TIE), options=FUSED, expected=(f(SMALL), f(SMALL), f(SMALL - 1), f(1 - SMALL)))
def sums_of_products_are_contracted(a: sh.Attrib1f):
    p = a * a
    return a * a - p, p - (1 + 2**-11), (p - (2 + 2**-11)), (2 + 2**-11) - a * a


@case(a=np.full(1, TIE), options=FUSED, expected=(f(SMALL), f(SMALL), f(-1 - 2**-11), f(0)))
def composites_are_contracted_and_a_product_through_fma_is_not(a: sh.Attrib1f):
    v = sh.Attrib2f(a, 1)
    return (
        sh.dot(v, sh.Attrib2f(a, -1 - 2**-11)),
        sh.mad(a, a, -1 - 2**-11),
        sh.cross(sh.Vector3f(a, 1, 0), sh.Vector3f(0, a, 0)).z - 2 * (a * a),
        sh.fma(a, a, -0.0) - sh.fma(a, a, -0.0),
    )


@case(a=np.array([[TIE, 2, 0.5]], np.float32), options=FUSED, expected=np.array([[SMALL, 2, -0.75]], np.float32))
def vectors_are_contracted_by_component(a: sh.Attrib3f) -> sh.Attrib3f:
    total = sh.Attrib3f(-1 - 2**-11, -2, -1)
    total += a * a
    return total


@case(x=f(1, 1, 0.75, -3, 1e-3), n=np.array([127, -126, 10, 0, 3]), expected=lambda x, n: np.ldexp(x, n))
def ldexp_scales_exactly(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    return sh.ldexp(x, n)


@case(a=f(1e10), b=f(0.3), t=f(1), expected=f(0.3))
def mix_ends_at_its_ends(a: sh.Attrib1f, b: sh.Attrib1f, t: sh.Attrib1f) -> sh.Attrib1f:
    return sh.mix(a, b, t)


@case(i=np.array([[0.8, -0.6]], np.float32), n=np.array([[0, 1]], np.float32), eta=f(1.5),
      expected=lambda i, n, eta: np.zeros((1, 2)))  # fmt: skip
def refract_of_total_reflection_is_zero(i: sh.Vector2f, n: sh.Vector2f, eta: sh.Attrib1f) -> sh.Vector2f:
    return sh.refract(i, n, eta)


@case(x=f(-1, -0.0, 0.0, 4, INF), expected=(f(NAN, -0.0, 0.0, 2, INF), f(NAN, -INF, INF, 0.5, 0)))
def roots_of_edges(x: sh.Attrib1f):
    return sh.sqrt(x), sh.rsqrt(x)


@case(x=f(-3, 0.1, 2, 3, 0.7, INF), expected=f(NAN, 0.1, 1.9999999, 3, 0.7, INF))
def the_square_of_a_root_is_not_its_radicand(x: sh.Attrib1f) -> sh.Attrib1f:
    root = sh.sqrt(x)
    return root * root


DECIMALS = (4.4709815e-38, 9.8848554e-33, -86.000626, 6.1870016e29, 1.1920929e-07, 0.99999905, 3.4028235e38, 1e23)


@case(x=f(1), expected=tuple(f(n) for n in DECIMALS))
def decimal_numbers_are_read_to_the_last_digit(x: sh.Attrib1f):
    return tuple(sh.cond(x > 0, n, x) for n in DECIMALS)


@case(x=f(NAN, 1, NAN, 2, 3), y=f(1, NAN, NAN, 2, 2),
      expected=(f(1, 1, 1, 1, 1), f(1, 1, 1, 0, 1), f(1, 1, 1, 1, 0), f(1, 1, 1, 0, 0)))  # fmt: skip
def a_comparison_that_is_false_is_not_its_opposite(x: sh.Attrib1f, y: sh.Attrib1f):
    found = [sh.Attrib1f(0) for _ in range(4)]
    for one, holds in zip(found, (x < y, x <= y, x > y, x >= y), strict=True):
        with sh.SH_IF(holds):
            pass
        with sh.SH_ELSE():
            one += 1
    return tuple(found)


@case(x=f(0.0, -0.0, 1, -1), expected=(f(0.0, 0.0, 0.0, -1), f(-0.0, -0.0, 1, -0.0), f(0.0, 0.0, 1, -0.0)))
def choices_between_zeros_are_no_minima(x: sh.Attrib1f):
    return sh.cond(x < 0, x, 0.0), sh.cond(x > 0, x, -0.0), sh.cond(x >= 0, sh.abs(x), -0.0)


def cases() -> list[Case]:
    """Return every edge."""
    return CASES
