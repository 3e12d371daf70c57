"""The meaning of each operation: numpy functions that the op table refers to and the interpreter executes.

Stage: represent. A scalar is an array of any shape L (() for one element, (lanes,) for many); a vector of n components
is (n, *L). Every function takes and gives arrays of the types in the op table. Edges are those of docs/numerics.md.
Floating-point warnings are the caller's to silence.

Composite operations are defined by others: see `formula`. Their definition is their meaning on arrays; `lower` writes
it for targets that lack them, and the reference evaluates it without rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, reduce, wraps
from operator import add
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.ir.formula import Values, components, named, number, operation, precision_of, where
from shpy.ir.multiply_add import multiply_add

Array = NDArray[Any]


def through_f64(f: Callable[..., Array]) -> Callable[..., Array]:
    """Return `f` evaluated in binary64 and rounded once: the reference for a transcendental of a narrower type."""

    @wraps(f)
    def rounded(*args: Array) -> Array:
        wide = f(*(np.asarray(a, dtype=np.float64) for a in args))
        return np.asarray(wide).astype(args[0].dtype)

    return rounded


def in_f32(f: Callable[..., Array]) -> Callable[..., Array]:
    """Return `f` as it is for f and d; for h, evaluated in binary32 and rounded (exact for + - * / and square root)."""

    @wraps(f)
    def rounded(*args: Array) -> Array:
        if args[0].dtype == np.float16:
            return np.asarray(f(*(a.astype(np.float32) for a in args))).astype(np.float16)
        return np.asarray(f(*args))

    return rounded


@partial(operation, name="min")
def minimum(a: Array, b: Array) -> Array:
    """Return GLSL's min, with the number where one is NaN."""
    return np.where((b < a) | (a != a), b, a)


@partial(operation, name="max")
def maximum(a: Array, b: Array) -> Array:
    """Return GLSL's max, with the number where one is NaN."""
    return np.where((a < b) | (a != a), b, a)


def sign(x: Array) -> Array:
    """Return -1, 0 or 1; 0 for NaN and both zeros."""
    return np.asarray((x > 0).astype(x.dtype) - (x < 0).astype(x.dtype))


def fma(a: Array, b: Array, c: Array) -> Array:
    """Return a * b + c, rounded once."""
    return multiply_add(a, b, c)


def power(x: Array, y: Array) -> Array:
    """Return x to the power of y, as C99 has it.

    For a single exponent of 0.5 numpy takes the square root, which differs at -0 and -inf: hence an array of them.
    """
    shape = np.broadcast_shapes(np.shape(x), np.shape(y))
    exponents = np.array(np.broadcast_to(y, shape or (1,)))
    return np.asarray(np.power(x, exponents)).reshape(shape)


def floor_div_int(a: Array, b: Array) -> Array:
    """Divide and round down; 0 for a zero divisor, wrapping for INT_MIN // -1."""
    wide, divisor = a.astype(np.int64), b.astype(np.int64)
    safe = np.where(divisor == 0, 1, divisor)
    return np.where(divisor == 0, 0, wide // safe).astype(a.dtype)


def floor_mod_int(a: Array, b: Array) -> Array:
    """Return the floor modulo, with the sign of the divisor; 0 for a zero divisor."""
    wide, divisor = a.astype(np.int64), b.astype(np.int64)
    safe = np.where(divisor == 0, 1, divisor)
    return np.where(divisor == 0, 0, wide % safe).astype(a.dtype)


@partial(operation, name="shl")
def shift_left(a: Array, n: Array) -> Array:
    """Return a << (n mod 32)."""
    return np.asarray(np.left_shift(a, (n & n.dtype.type(31)).astype(a.dtype)))


@partial(operation, name="shr")
def shift_right(a: Array, n: Array) -> Array:
    """Return a >> (n mod 32), arithmetic for i, logical for u."""
    return np.asarray(np.right_shift(a, (n & n.dtype.type(31)).astype(a.dtype, copy=False)))


def popcount(a: Array) -> Array:
    """Return the number of one bits."""
    return np.bitwise_count(a.view(np.uint32)).astype(a.dtype)


def count_leading_zeros(a: Array) -> Array:
    """Return the number of zero bits above the highest one bit; 32 for 0."""
    bits = a.view(np.uint32)
    for by in (1, 2, 4, 8, 16):
        bits = bits | (bits >> np.uint32(by))
    return (32 - np.bitwise_count(bits)).astype(a.dtype)


def ldexp(x: Array, n: Array) -> Array:
    """Return x * 2**n, rounded once."""
    return np.asarray(np.ldexp(np.asarray(x, dtype=np.float64), np.clip(n, -2200, 2200)).astype(x.dtype))


def bits_from_float(x: Array) -> Array:
    """Return the binary32 bits of x; 0x7fc00000 for every NaN."""
    narrow = x.astype(np.float32)
    return np.where(narrow != narrow, np.uint32(0x7FC00000), narrow.view(np.uint32))


def unit_float(u: Array, dtype: type[np.floating[Any]] = np.float32) -> Array:
    """Return the upper bits of a u as a fraction in [0, 1): 24 of them; 11 for binary16, which holds no more."""
    bits = 11 if dtype is np.float16 else 24
    return np.asarray((u >> np.uint32(32 - bits)).astype(dtype) * dtype(2.0**-bits))


def float_from_bits(u: Array) -> Array:
    """Return the binary32 with these bits."""
    return u.view(np.float32)


# Composite operations


@operation
def mulhi(a: Values, b: Values) -> Values:
    """Return the upper 32 bits of the product of two ints, which has 64 bits; component-wise."""
    low, half = number(0xFFFF, a), number(16, a)
    a_low, a_high = a & low, shift_right(a, half)
    b_low, b_high = b & low, shift_right(b, half)
    middle = named("middle", a_high * b_low + (shift_right(a_low * b_low, half) & low))
    other = named("other", a_low * b_high + (middle & low))
    return a_high * b_high + shift_right(middle, half) + shift_right(other, half)


@operation
def rotl(x: Values, n: Values) -> Values:
    """Rotate the bits of an int to the left by n mod 32, component-wise."""
    lowest = ~shift_left(~number(0, x), n)
    return shift_left(x, n) | (shift_right(x, -n) & lowest)


@operation
def rotr(x: Values, n: Values) -> Values:
    """Rotate the bits of an int to the right by n mod 32, component-wise."""
    return rotl(x, -n)


@operation
def mad(a: Values, b: Values, c: Values) -> Values:
    """Return a * b + c, rounded twice."""
    return a * b + c


@operation
def fract(x: Values) -> Values:
    """Return x - floor(x)."""
    return x - np.floor(x)


@operation
def mod(x: Values, y: Values) -> Values:
    """Return x modulo y, x - y * floor(x / y) with each operation rounded: the sign of y but for that; ints too."""
    quotient = named("quotient", np.floor(x / y))
    # A negative quotient that is flushed to zero, or too small for a number, is -1 all the same.
    below = np.equal(quotient, 0) & np.not_equal(x, 0) & np.not_equal(x < 0, y < 0) & ~np.isinf(y)
    return x - y * where(below, number(-1, quotient), quotient)


@operation
def clamp(x: Values, low: Values, high: Values) -> Values:
    """Limit x: min(max(x, low), high); ints too."""
    return minimum(maximum(x, low), high)


@operation
def mix(a: Values, b: Values, t: Values) -> Values:
    """Return a * (1 - t) + b * t; with a bool t, b where t holds, else a."""
    return a * (1 - t) + b * t


@operation
def step(edge: Values, x: Values) -> Values:
    """Return 0 where x < edge, else 1."""
    return where(x < edge, number(0, x), number(1, x))


@operation
def smoothstep(a: Values, b: Values, x: Values) -> Values:
    """Return the cubic Hermite step from 0 at a to 1 at b; step(a, x) where a = b."""
    t = named("t", clamp((x - a) / (b - a), 0, 1))
    curve = t * t * (3 - 2 * t)
    return where(np.equal(a, b), step(a, x), curve)


@operation
def smootherstep(a: Values, b: Values, x: Values) -> Values:
    """Return the quintic step from 0 at a to 1 at b, level and without curvature at both; step(a, x) where a = b."""
    t = named("t", clamp((x - a) / (b - a), 0, 1))
    curve = t * t * t * (t * (6 * t - 15) + 10)
    return where(np.equal(a, b), step(a, x), curve)


@operation
def dot(a: Values, b: Values) -> Values:
    """Return the scalar product, summed from the first component on."""
    if isinstance(a, np.ndarray) and a.ndim > 1:  # the same sum, in less time
        return _sum_of_rows(a * b)
    return reduce(add, (x * y for x, y in zip(components(a), components(b), strict=True)))


def _sum_of_rows(rows: Array) -> Array:
    """Return the sum from the first row on."""
    if len(rows) == 1:
        return np.asarray(rows[0])
    total = rows[0] + rows[1]
    for row in rows[2:]:
        total += row
    return np.asarray(total)


@operation
def cross(a: Values, b: Values) -> Values:
    """Return the vector product of two vectors of three components."""
    return a[[1, 2, 0]] * b[[2, 0, 1]] - a[[2, 0, 1]] * b[[1, 2, 0]]


RANGES: dict[str, tuple[float, float, float]] = {
    "f": (2.0**-50, 2.0**62, 2.0**100),
    "d": (2.0**-450, 2.0**500, 2.0**700),
}
"""For binary32 and binary64: bounds beyond which squares of components lose bits, and the factors that scale those."""


def in_range(squares: Array) -> bool:
    """Return whether every sum of squares is one that no scaling would change."""
    low, high, _ = RANGES[squares.dtype.char]
    return bool(np.all((squares >= 4 * low * low) & (squares <= high * high)))


def _scale(v: Values) -> tuple[Values, Callable[[], Values]]:
    """Return a power of two by which v can be squared, 1 but for very large and very small vectors; and its inverse."""
    low, high, factor = RANGES[precision_of(v)]
    if isinstance(v, np.ndarray) and v.ndim:  # the same, in less time
        largest = np.max(np.abs(v), axis=0)
    else:
        sizes = [np.abs(c) for c in components(v)]
        largest = named("largest", reduce(lambda a, b: where(a < b, b, a), sizes))  # NaN gives NaN
    one, up, down = number(1, largest), number(factor, largest), number(1 / factor, largest)
    large, small = largest > high, largest < low
    return where(large, down, where(small, up, one)), lambda: where(large, up, where(small, down, one))


@operation
def length(v: Values) -> Values:
    """Return sqrt(dot(v, v)), also where the squares would overflow or vanish."""
    if isinstance(v, np.ndarray) and in_range(squares := dot(v, v)):  # the code below gives the same in more time
        return np.sqrt(squares)
    scale, inverse = _scale(v)
    back = inverse()
    scaled = named("scaled", v * scale)
    return np.sqrt(dot(scaled, scaled)) * back


@operation
def distance(a: Values, b: Values) -> Values:
    """Return length(a - b)."""
    return length(a - b)


@operation
def normalize(v: Values) -> Values:
    """Return v / length(v); zero for the zero vector. Keeps the kind."""
    scaled = named("scaled", v * _scale(v)[0])
    size = named("size", np.sqrt(dot(scaled, scaled)))
    return where(size > 0, scaled / where(size > 0, size, number(1, size)), number(0, v))


@operation
def reflect(i: Values, n: Values) -> Values:
    """Return the incident vector i mirrored at the unit normal n: i - 2 * dot(n, i) * n (GLSL 4.60 section 8.5)."""
    return i - 2 * dot(n, i) * n


@operation
def refract(i: Values, n: Values, eta: Values) -> Values:
    """Return the incident vector i refracted at ratio eta (GLSL 4.60 section 8.5); zero at total reflection."""
    cosine = named("cosine", dot(n, i))
    k = named("k", 1 - eta * eta * (1 - cosine * cosine))
    bent = eta * i - (eta * cosine + np.sqrt(k)) * n
    return where(k < 0, number(0, i), bent)


@operation
def faceforward(n: Values, i: Values, reference: Values) -> Values:
    """Return n where dot(reference, i) < 0, else -n."""
    return where(dot(reference, i) < 0, n, -n)


# Structural operations


def any_component(c: Array) -> Array:
    """Return whether one component holds."""
    return c if c.ndim == 0 else np.any(c, axis=0)


def all_components(c: Array) -> Array:
    """Return whether every component holds."""
    return c if c.ndim == 0 else np.all(c, axis=0)


def select(c: Array, a: Array, b: Array) -> Array:
    """Return a where c holds, else b, component by component."""
    return np.where(c, a, b)


def convert(x: Array, dtype: type[np.generic]) -> Array:
    """Convert: float to int truncates and saturates, NaN gives 0; ints wrap; to float rounds to nearest even."""
    target: np.dtype[Any] = np.dtype(dtype)
    if x.dtype.kind == "f" and target.kind in "iu":
        limits = np.iinfo(target)
        if x.size and float(x.min()) > limits.min - 1.0 and float(x.max()) < limits.max + 1.0:  # also false for NaN
            return x.astype(target)
        whole = np.trunc(np.where(x != x, 0, x).astype(np.float64))
        return np.asarray(np.clip(whole, limits.min, limits.max).astype(target))
    if target.kind == "b":
        return np.asarray(x != 0)
    return x.astype(target)


def gather(table: Array, index: Array, rank: int, size: int) -> Array:
    """Return the element of `table` (*shape[, size]) at `index`, clamped to the nearest one on every axis."""
    axes = [index] if rank == 1 else list(index)
    clamped = tuple(np.clip(i.astype(np.int64), 0, n - 1) for i, n in zip(axes, table.shape, strict=False))
    element = table[clamped]
    return np.asarray(element) if size == 1 else np.moveaxis(np.asarray(element), -1, 0)
