"""The elementary functions of binary32 as strict mode means them: the exact value, rounded half to even.

Stage: represent. Numpy's function of binary64 gives a value y with an error of a few units of 2**-53. If
y (1 - 2**-46) and y (1 + 2**-46) round to the same binary32, that is the result. For a few hundred of all 2**32 inputs
they do not: the exact value lies next to a midpoint between two binary32 numbers. Every input whose value lies within
2**-45 of a midpoint is a hard case with a known result; `scripts/hard_cases` writes them to files beside this one.

>>> exp(np.float32(1))
array(2.7182817, dtype=float32)

Of binary64 and binary16 the functions give numpy's value in binary64, rounded to the type.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from fractions import Fraction
from functools import cache, wraps
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyError

Array = NDArray[Any]

HARD: Final = os.path.join(os.path.dirname(__file__), "hard")
"""The folder of the hard cases: no Path, since importing pathlib takes 6 ms of CPU."""
MARGIN: Final = 2.0**-46
"""The relative error allowed for a function of binary64. Hard cases are known up to twice that distance."""
ODD: Final = frozenset({"sin", "tan", "asin", "atan", "sinh", "tanh", "asinh", "atanh", "cbrt", "erf", "sinpi"})
"""The functions with f(-x) = -f(x); the files hold only their positive inputs."""
EVEN: Final = frozenset({"cos", "cosh", "cospi"})
"""The functions with f(-x) = f(x); the files hold only their positive inputs."""


@cache
def hard_cases(name: str) -> tuple[Array, Array]:
    """Return the inputs of a function that are hardest to round, ascending, and the answers, in float32."""
    x, answers = np.load(os.path.join(HARD, f"{name}.npy"))
    if name in ODD | EVEN:
        mirrored = -answers if name in ODD else answers
        x, answers = np.concatenate([-x[::-1], x]), np.concatenate([mirrored[::-1], answers])
    return x, answers


def _around(f: Callable[..., Array], x: Array) -> tuple[Array, Array]:
    """Return the binary32 roundings of f(x) less and plus its allowed error."""
    wide: Any = np.asarray(x, np.float64)
    wide = f(wide, out=wide)
    low, high = np.empty(wide.shape, np.float32), np.empty(wide.shape, np.float32)
    return np.multiply(wide, 1 - MARGIN, out=low), np.multiply(wide, 1 + MARGIN, out=high)


def _resolve(name: str, x: Array, result: Array, undecided: Array) -> None:
    """Store the results of hard cases into `result` where it is undecided; NaN stays."""
    at = np.flatnonzero(undecided & (result == result))
    if not at.size:
        return
    cases, answers = hard_cases(name)
    inputs = x.reshape(-1)[at]
    indices = np.searchsorted(cases, inputs) % cases.size
    if not np.array_equal(cases[indices], inputs):
        wrong = inputs[cases[indices] != inputs][0]
        raise ShpyError(
            f"the {name} of binary64 of numpy {np.__version__} is off by more than 2**-46 at {wrong!r}",
            cure="another version of numpy",
        )
    result.reshape(-1)[at] = answers[indices]


@cache
def trusted(name: str) -> bool:
    """Return whether numpy's function of binary64 is close enough, tested with the hard cases."""
    x, answers = hard_cases(name)
    with np.errstate(all="ignore"):
        low, high = _around(FUNCTIONS[name].__wrapped__, x)
    return bool(np.all((low == answers) | (high == answers)))


@cache
def _reliable(name: str) -> Callable[..., Array]:
    """Return numpy's function, or Python's, element by element, if numpy's is not close enough."""
    f: Callable[..., Array] = FUNCTIONS[name].__wrapped__
    if trusted(name):
        return f

    def one(x: float) -> float:
        try:
            return float(getattr(math, name, f)(x))
        except (ValueError, OverflowError):  # infinities and NaN are right in numpy
            return float(f(np.float64(x)))

    def each(x: Array, out: Array) -> Array:
        out[...] = np.vectorize(one, otypes=[np.float64])(x)
        return out

    return each


def _exact(name: str, f: Callable[..., Array], *, decides: bool = False) -> Callable[..., Array]:
    """Return the function that rounds the exact values of f once.

    `decides`: the rounded f is correct for all hard cases on every processor, and so for all numbers.
    """

    @wraps(f)
    def rounded(x: Array) -> Array:
        if x.dtype != np.float32:
            return np.asarray(f(np.asarray(x, np.float64))).astype(x.dtype)
        if decides:
            wide: Any = np.asarray(x, np.float64)
            return np.asarray(f(wide, out=wide)).astype(np.float32)
        result, high = _around(_reliable(name), x)
        undecided = result != high
        if undecided.any():
            _resolve(name, np.asarray(x), result, undecided)
        return result

    FUNCTIONS[name] = rounded
    return rounded


def _each(f: Callable[[float], float]) -> Callable[..., Array]:
    """Return a function of Python for arrays, which takes one number at a time."""

    def on_arrays(x: Array, out: Array | None = None) -> Array:
        results = np.vectorize(f, otypes=[np.float64])(x)
        return np.asarray(np.positive(results, out=out))

    return on_arrays


def _sinpi(x: Array, out: Array | None = None) -> Array:
    """Return the sine of pi x in binary64; a zero has the sign of x."""
    whole = np.rint(x)
    fraction = x - whole
    turned = np.where(_odd(whole), -fraction, fraction)
    return np.sin(np.pi * np.where(fraction == 0, np.copysign(0, x), turned), out=out)


def _cospi(x: Array, out: Array | None = None) -> Array:
    """Return the cosine of pi x in binary64, the sine of pi (1/2 - |f|) for the fraction f; all zeros are positive."""
    whole = np.rint(x)
    fraction = np.abs(x - whole)
    return np.asarray(np.sin(np.pi * np.where(_odd(whole), fraction - 0.5, 0.5 - fraction), out=out))


def _odd(whole: Array) -> Array:
    """Return which whole numbers are odd."""
    half = whole * 0.5
    return np.asarray(half != np.floor(half))


FUNCTIONS: Final[dict[str, Any]] = {}
"""The functions by the names of their operations."""

exp, exp2 = _exact("exp", np.exp), _exact("exp2", np.exp2)
log, log2, log10 = _exact("log", np.log), _exact("log2", np.log2), _exact("log10", np.log10)
sin, cos, tan = _exact("sin", np.sin), _exact("cos", np.cos), _exact("tan", np.tan)
asin, acos, atan = _exact("asin", np.arcsin), _exact("acos", np.arccos), _exact("atan", np.arctan)
sinh, cosh, tanh = _exact("sinh", np.sinh), _exact("cosh", np.cosh), _exact("tanh", np.tanh)
asinh, acosh, atanh = _exact("asinh", np.arcsinh), _exact("acosh", np.arccosh), _exact("atanh", np.arctanh)
expm1, log1p, cbrt = _exact("expm1", np.expm1), _exact("log1p", np.log1p), _exact("cbrt", np.cbrt)
exp10 = _exact("exp10", lambda x, out=None: np.power(10.0, x, out=out))
erf, erfc = _exact("erf", _each(math.erf)), _exact("erfc", _each(math.erfc))
sinpi, cospi = _exact("sinpi", _sinpi), _exact("cospi", _cospi)
rsqrt = _exact("rsqrt", lambda x, out=None: np.divide(1, np.sqrt(x, out=out), out=out), decides=True)


@wraps(np.hypot, assigned=())  # backends find the function of numpy; the docstring stays
def hypot(x: Array, y: Array) -> Array:
    """Return sqrt(x * x + y * y) as C99 has it, rounded once; the exact value in binary32 and binary16.

    The squares are exact in binary64. With binary16 the sum is exact too, wherever the root is close to the middle of
    two; with binary32 it can be so close to one that fractions have to decide.
    """
    if x.dtype == np.float64:
        return np.asarray(np.hypot(x, y))
    a, b = np.float64(x), np.float64(y)
    wide = np.sqrt(a * a + b * b)
    wide = np.asarray(np.where(np.isinf(a) | np.isinf(b), np.inf, wide))
    if x.dtype != np.float32:
        return wide.astype(x.dtype)
    low, high = _around(lambda v, out: v, wide)
    sides = np.broadcast_arrays(a, b)
    for k in np.flatnonzero(low < high):
        low.flat[k] = _nearest_root(sum((Fraction(float(s.flat[k])) ** 2 for s in sides), Fraction(0)), low.flat[k])
    return low


def _nearest_root(square: Fraction, low: Any) -> np.float32:
    """Return the binary32 nearest to the root of `square`, which lies between `low` and the next binary32."""
    unit = Fraction(2) ** (max(math.frexp(float(low))[1], -125) - 24)
    middle = Fraction(float(low)) + unit / 2
    if square == middle**2:
        return np.float32(float(middle))
    return low if square < middle**2 else np.float32(float(low) + float(unit))
