"""What each operation means: numpy functions that the op table refers to and the interpreter executes.

Stage: represent. A scalar is an array of any shape L (() for one element, (lanes,) for many); a vector of n components
is (n, *L). Every function takes and gives arrays of the types in the op table. Edges are those of docs/numerics.md.
Floating-point warnings are the caller's to silence.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def through_f64(f: Callable[..., Array]) -> Callable[..., Array]:
    """`f` evaluated in binary64 and rounded once: the reference for a transcendental of a narrower type."""

    def rounded(*args: Array) -> Array:
        wide = f(*(np.asarray(a, dtype=np.float64) for a in args))
        return np.asarray(wide).astype(args[0].dtype)

    return rounded


def in_f32(f: Callable[..., Array]) -> Callable[..., Array]:
    """`f` as it is for f and d; for h, evaluated in binary32 and rounded (exact for + - * / and square root)."""

    def rounded(*args: Array) -> Array:
        if args[0].dtype == np.float16:
            return np.asarray(f(*(a.astype(np.float32) for a in args))).astype(np.float16)
        return np.asarray(f(*args))

    return rounded


def minimum(a: Array, b: Array) -> Array:
    """GLSL's min, with the number where one is NaN."""
    return np.where((b < a) | (a != a), b, a)


def maximum(a: Array, b: Array) -> Array:
    """GLSL's max, with the number where one is NaN."""
    return np.where((a < b) | (a != a), b, a)


def clamp(x: Array, low: Array, high: Array) -> Array:
    """min(max(x, low), high)."""
    return minimum(maximum(x, low), high)


def sign(x: Array) -> Array:
    """-1, 0 or 1; 0 for NaN and both zeros."""
    return np.asarray((x > 0).astype(x.dtype) - (x < 0).astype(x.dtype))


def fract(x: Array) -> Array:
    """x - floor(x)."""
    return np.asarray(x - np.floor(x))


def floor_div(x: Array, y: Array) -> Array:
    """floor(x / y); -1 where the quotient is negative and too small for a number: flushing it changes nothing."""
    quotient = np.floor(x / y)
    below = (quotient == 0) & (x != 0) & ((x < 0) != (y < 0)) & ~np.isinf(y)
    return np.where(below, np.asarray(-1, quotient.dtype), quotient)


def mod(x: Array, y: Array) -> Array:
    """x - y * floor(x / y): the sign of the divisor."""
    return np.asarray(x - y * floor_div(x, y))


def rsqrt(x: Array) -> Array:
    """1 / sqrt(x)."""
    return np.asarray(1, dtype=x.dtype) / np.sqrt(x)


def step(edge: Array, x: Array) -> Array:
    """0 where x < edge, else 1."""
    return np.where(x < edge, 0, 1).astype(x.dtype)


def mix(a: Array, b: Array, t: Array) -> Array:
    """a * (1 - t) + b * t."""
    return np.asarray(a * (np.asarray(1, dtype=t.dtype) - t) + b * t)


def smoothstep(a: Array, b: Array, x: Array) -> Array:
    """The cubic Hermite step between a and b; step(a, x) where a = b."""
    one = np.asarray(1, dtype=x.dtype)
    t = clamp((x - a) / (b - a), one - one, one)
    curve = t * t * (np.asarray(3, dtype=x.dtype) - np.asarray(2, dtype=x.dtype) * t)
    return np.where(a == b, step(a, x), curve)


def fma(a: Array, b: Array, c: Array) -> Array:
    """a * b + c, rounded once.

    For f and h through binary64 rounded to odd (Boldo and Melquiond 2008); for d in exact rational arithmetic.
    """
    if a.dtype == np.float64:
        return np.asarray(np.vectorize(_fma_exact, otypes=[np.float64])(a, b, c))
    x, y, z = (np.asarray(v, dtype=np.float64) for v in (a, b, c))
    product = x * y
    total = product + z
    back = total - product
    error = (product - (total - back)) + (z - back)
    bits = np.asarray(total).view(np.int64)
    toward = np.where(error > 0, np.inf, -np.inf)
    inexact = np.isfinite(total) & (error != 0) & (bits & 1 == 0)
    return np.where(inexact, np.nextafter(total, toward), total).astype(a.dtype)


def _fma_exact(a: float, b: float, c: float) -> float:
    from fractions import Fraction

    if not (np.isfinite(a) and np.isfinite(b)):
        return float(a * b + c)
    if not np.isfinite(c):
        return float(c)
    exact = Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c))
    if exact == 0:
        return float(a * b + c)
    try:
        return float(exact)
    except OverflowError:
        return float("inf") if exact > 0 else float("-inf")


def power(x: Array, y: Array) -> Array:
    """x to the power of y, as C99 has it.

    For a single exponent of 0.5 numpy takes the square root, which differs at -0 and -inf: hence an array of them.
    """
    shape = np.broadcast_shapes(np.shape(x), np.shape(y))
    exponents = np.array(np.broadcast_to(y, shape or (1,)))
    return np.asarray(np.power(x, exponents)).reshape(shape)


def floor_div_int(a: Array, b: Array) -> Array:
    """Floor division; 0 for a zero divisor, wrapping for INT_MIN // -1."""
    wide, divisor = a.astype(np.int64), b.astype(np.int64)
    safe = np.where(divisor == 0, 1, divisor)
    return np.where(divisor == 0, 0, wide // safe).astype(a.dtype)


def floor_mod_int(a: Array, b: Array) -> Array:
    """Floor modulo, with the sign of the divisor; 0 for a zero divisor."""
    wide, divisor = a.astype(np.int64), b.astype(np.int64)
    safe = np.where(divisor == 0, 1, divisor)
    return np.where(divisor == 0, 0, wide % safe).astype(a.dtype)


def shift_left(a: Array, n: Array) -> Array:
    """a << (n mod 32)."""
    return np.asarray(np.left_shift(a, (n & n.dtype.type(31)).astype(a.dtype)))


def shift_right(a: Array, n: Array) -> Array:
    """a >> (n mod 32), arithmetic for i, logical for u."""
    return np.asarray(np.right_shift(a, (n & n.dtype.type(31)).astype(a.dtype, copy=False)))


def popcount(a: Array) -> Array:
    """The number of one bits."""
    return np.bitwise_count(a.view(np.uint32)).astype(a.dtype)


def ldexp(x: Array, n: Array) -> Array:
    """x * 2**n, rounded once."""
    return np.asarray(np.ldexp(np.asarray(x, dtype=np.float64), np.clip(n, -2200, 2200)).astype(x.dtype))


def bits_from_float(x: Array) -> Array:
    """The binary32 bits of x; 0x7fc00000 for every NaN."""
    narrow = x.astype(np.float32)
    return np.where(narrow != narrow, np.uint32(0x7FC00000), narrow.view(np.uint32))


def dot(a: Array, b: Array) -> Array:
    """The sum of products, from the first component on."""
    if a.ndim == 0 or a.shape == ():
        return a * b
    products = a * b
    if len(products) == 1:
        return np.asarray(products[0])
    total = products[0] + products[1]
    for product in products[2:]:
        total += product
    return np.asarray(total)


RANGES: dict[str, tuple[float, float, float]] = {
    "f": (2.0**-50, 2.0**62, 2.0**100),
    "d": (2.0**-450, 2.0**500, 2.0**700),
}
"""Of binary32 and binary64: components below and above which squares lose bits, and by what those are scaled."""


def in_range(squares: Array) -> bool:
    """Whether every sum of squares is one that no scaling would change."""
    low, high, _ = RANGES[squares.dtype.char]
    return bool(np.all((squares >= 4 * low * low) & (squares <= high * high)))


def _scale(v: Array) -> Array:
    """A power of two by which v can be squared: 1 but for very large and very small vectors."""
    size = np.abs(v)
    largest = size if v.ndim == 0 else np.max(size, axis=0)
    low, high, factor = RANGES[v.dtype.char]
    return np.where(largest > high, 1 / factor, np.where(largest < low, factor, 1.0)).astype(v.dtype)


def length(v: Array) -> Array:
    """sqrt(dot(v, v)), also where the squares would overflow or vanish."""
    squares = dot(v, v)
    if in_range(squares):
        return np.sqrt(squares)
    scale = _scale(v)
    scaled = v * scale
    return np.asarray(np.sqrt(dot(scaled, scaled)) / scale)


def distance(a: Array, b: Array) -> Array:
    """length(a - b)."""
    return length(a - b)


def normalize(v: Array) -> Array:
    """v / length(v); zero for the zero vector."""
    v = np.asarray(v * _scale(v))
    size = np.sqrt(dot(v, v))
    return np.where(size > 0, v / np.where(size > 0, size, np.asarray(1, dtype=v.dtype)), np.asarray(0, dtype=v.dtype))


def cross(a: Array, b: Array) -> Array:
    """The vector product of three-component vectors."""
    return np.asarray(a[[1, 2, 0]] * b[[2, 0, 1]] - a[[2, 0, 1]] * b[[1, 2, 0]])


def reflect(i: Array, n: Array) -> Array:
    """i - 2 * dot(n, i) * n (GLSL 4.60 section 8.5)."""
    return np.asarray(i - np.asarray(2, dtype=i.dtype) * dot(n, i) * n)


def refract(i: Array, n: Array, eta: Array) -> Array:
    """GLSL 4.60 section 8.5; zero at total reflection."""
    one: Array = np.asarray(1, dtype=i.dtype)
    cosine = dot(n, i)
    k = one - eta * eta * (one - cosine * cosine)
    bent = eta * i - (eta * cosine + np.sqrt(k)) * n
    return np.where(k < 0, np.asarray(0, dtype=i.dtype), bent)


def faceforward(n: Array, i: Array, reference: Array) -> Array:
    """n where dot(reference, i) < 0, else -n."""
    return np.where(dot(reference, i) < 0, n, -n)


def select(c: Array, a: Array, b: Array) -> Array:
    """a where c holds, else b, component by component."""
    return np.where(c, a, b)


def convert(x: Array, dtype: type[np.generic]) -> Array:
    """Conversion: float to int truncates and saturates, NaN gives 0; ints wrap; to float rounds to nearest even."""
    target: np.dtype[Any] = np.dtype(dtype)
    if x.dtype.kind == "f" and target.kind in "iu":
        limits = np.iinfo(target)
        if x.size and float(x.min()) > limits.min - 1.0 and float(x.max()) < limits.max + 1.0:  # and no NaN
            return x.astype(target)
        whole = np.trunc(np.where(x != x, 0, x).astype(np.float64))
        return np.asarray(np.clip(whole, limits.min, limits.max).astype(target))
    if target.kind == "b":
        return np.asarray(x != 0)
    return x.astype(target)


def gather(table: Array, index: Array, rank: int, size: int) -> Array:
    """The element of `table` (*shape[, size]) at `index`, clamped to the nearest one on every axis."""
    axes = [index] if rank == 1 else list(index)
    clamped = tuple(np.clip(i.astype(np.int64), 0, n - 1) for i, n in zip(axes, table.shape, strict=False))
    element = table[clamped]
    return np.asarray(element) if size == 1 else np.moveaxis(np.asarray(element), -1, 0)
