"""The operations of the table on numbers of mpmath: nothing is rounded, so what comes out is what was meant.

Stage: measure, below `reference.py`. Floats are `mpf`, vectors object arrays of them. What mpmath cannot say (a zero's
sign, 1 / 0, a NaN's way through a power) raises `Unsayable`: there the reference is binary64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from shpy.errors import ShpyError
from shpy.packages import install

try:
    import mpmath
except ImportError as error:
    raise ShpyError("a reference by mpmath needs mpmath", cure=f'{install("mpmath")}, or reference="f64"') from error

__all__ = ["MP", "OPERATIONS", "Unsayable", "number"]

MP: Any = mpmath.mp.clone()
MP.prec = 240

_ZERO, _ONE, _TWO, _HALF = MP.mpf(0), MP.mpf(1), MP.mpf(2), MP.mpf(0.5)


class Unsayable(ArithmeticError):
    """mpmath has no such number."""


def number(value: Any) -> Any:
    """Convert exactly to an mpf."""
    as_float = float(value)
    if not np.isfinite(as_float) or (as_float == 0 and np.signbit(as_float)):
        raise Unsayable(value)
    return MP.mpf(as_float)


def _div(a: Any, b: Any) -> Any:
    if b == 0:
        raise Unsayable("1 / 0")
    return a / b


def _sqrt(x: Any) -> Any:
    if x < 0:
        raise Unsayable("sqrt(-1)")
    return MP.sqrt(x)


def _real(f: Callable[..., Any], inside: Callable[..., Any] = lambda *x: True) -> Callable[..., Any]:
    """Return a function of mpmath, limited to real results."""

    def real(*args: Any) -> Any:
        if not inside(*args):
            raise Unsayable(args)
        return f(*args)

    return real


def _round(x: Any) -> Any:
    return MP.nint(x)  # half to even


def _trunc(x: Any) -> Any:
    return MP.floor(x) if x >= 0 else MP.ceil(x)


def _sign(x: Any) -> Any:
    return MP.mpf((x > 0) - (x < 0))


def _mod(a: Any, b: Any) -> Any:
    return a - b * MP.floor(_div(a, b))


def _smoothstep(a: Any, b: Any, x: Any) -> Any:
    if a == b:
        return _ZERO if x < a else _ONE
    t = min(max(_div(x - a, b - a), _ZERO), _ONE)
    return t * t * (3 - 2 * t)


def _power(a: Any, b: Any) -> Any:
    if a == 0 or (a < 0 and b != MP.floor(b)):
        raise Unsayable("a power")
    return MP.power(a, b)


def _atan2(y: Any, x: Any) -> Any:
    if y == 0:
        raise Unsayable("the sign of a zero")
    return MP.atan2(y, x)


def _exp(f: Callable[..., Any]) -> Callable[..., Any]:
    """Limit a function that grows too fast for its digits to be written down: far beyond any type's range."""
    return _real(f, lambda x: abs(x) < 1e5)


_SCALAR: dict[str, Callable[..., Any]] = {
    "neg": lambda a: -a,
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": _div,
    "fma": lambda a, b, c: a * b + c,
    "mad": lambda a, b, c: a * b + c,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "gt": lambda a, b: a > b,
    "ge": lambda a, b: a >= b,
    "isnan": lambda a: False,
    "isinf": lambda a: False,
    "cond": lambda c, a, b: a if c else b,
    "abs": abs,
    "sign": _sign,
    "floor": MP.floor,
    "ceil": MP.ceil,
    "round": _round,
    "trunc": _trunc,
    "fract": lambda x: x - MP.floor(x),
    "mod": _mod,
    "min": lambda a, b: b if b < a else a,
    "max": lambda a, b: b if a < b else a,
    "clamp": lambda x, low, high: min(max(x, low), high),
    "mix": lambda a, b, t: a * (1 - t) + b * t,
    "step": lambda edge, x: _ZERO if x < edge else _ONE,
    "smoothstep": _smoothstep,
    "sqrt": _sqrt,
    "rsqrt": lambda x: _div(_ONE, _sqrt(x)),
    "ldexp": lambda x, n: MP.ldexp(x, int(n)),
    "exp": _exp(MP.exp),
    "exp2": _exp(lambda x: MP.power(2, x)),
    "log": _real(MP.log, lambda x: x > 0),
    "log10": _real(MP.log10, lambda x: x > 0),
    "log2": _real(lambda x: MP.log(x, 2), lambda x: x > 0),
    "sin": MP.sin,
    "cos": MP.cos,
    "tan": MP.tan,
    "asin": _real(MP.asin, lambda x: abs(x) <= 1),
    "acos": _real(MP.acos, lambda x: abs(x) <= 1),
    "atan": MP.atan,
    "sinh": _exp(MP.sinh),
    "cosh": _exp(MP.cosh),
    "tanh": _real(MP.tanh, lambda x: abs(x) < 1e5),
    "asinh": MP.asinh,
    "acosh": _real(MP.acosh, lambda x: x >= 1),
    "atanh": _real(MP.atanh, lambda x: abs(x) < 1),
    "pow": _power,
    "atan2": _atan2,
}


def _by_component(f: Callable[..., Any]) -> Callable[..., Any]:
    """Extend a function of scalars to vectors; a scalar beside vectors stands for all their components."""

    def mapped(*args: Any) -> Any:
        size = max(np.size(a) for a in args)
        if all(np.ndim(a) == 0 for a in args):
            return f(*args)
        columns = [a if np.ndim(a) else [a] * size for a in args]
        return array([f(*row) for row in zip(*columns, strict=True)])

    return mapped


def array(values: list[Any]) -> Any:
    """Return an object array, or one of bools."""
    if all(isinstance(v, bool | np.bool_) for v in values):
        return np.array(values, np.bool_)
    made = np.empty(len(values), object)
    made[:] = values
    return made


def _parts(a: Any) -> list[Any]:
    return list(a) if np.ndim(a) else [a]


def _dot(a: Any, b: Any) -> Any:
    return sum((x * y for x, y in zip(_parts(a), _parts(b), strict=True)), _ZERO)


def _length(a: Any) -> Any:
    return MP.sqrt(_dot(a, a))


def _cross(a: Any, b: Any) -> Any:
    return array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _normalize(a: Any) -> Any:
    length = _length(a)
    return a if length == 0 else a / length


def _reflect(i: Any, n: Any) -> Any:
    return i - n * (2 * _dot(n, i))


def _refract(i: Any, n: Any, eta: Any) -> Any:
    """GLSL 4.60 section 8.5."""
    cosine = _dot(n, i)
    k = 1 - eta * eta * (1 - cosine * cosine)
    return i * _ZERO if k < 0 else i * eta - n * (eta * cosine + MP.sqrt(k))


OPERATIONS: dict[str, Callable[..., Any]] = {
    **{name: _by_component(f) for name, f in _SCALAR.items()},
    "dot": _dot,
    "length": _length,
    "distance": lambda a, b: _length(a - b),
    "cross": _cross,
    "normalize": _normalize,
    "reflect": _reflect,
    "refract": _refract,
    "faceforward": lambda n, i, reference: n if _dot(reference, i) < 0 else -n,
}
"""Each operation of the table that takes or gives floats, but for those that ask for their bits."""
