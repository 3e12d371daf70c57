"""Compute the operations of the table in multiprecision (mpmath), so that results show no rounding error.

Stage: measure, below `reference.py`. Primitive operations are written here; composite ones run their definition (see
`ir/formula.py`). Floats are `mpf`, vectors object arrays of them. A result that mpmath cannot represent (a zero's sign,
1 / 0, a power of NaN) raises `Unsayable`; the reference then computes in binary64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from shpy.errors import ShpyError
from shpy.ir.formula import Formula
from shpy.ir.ops import OPS
from shpy.packages import install

try:
    import mpmath
except ImportError as error:
    raise ShpyError("a reference by mpmath needs mpmath", cure=f'{install("mpmath")}, or reference="f64"') from error

MP: Any = mpmath.mp.clone()
MP.prec = 240


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


def _trunc(x: Any) -> Any:
    return MP.floor(x) if x >= 0 else MP.ceil(x)


def _power(a: Any, b: Any) -> Any:
    if a == 0 or (a < 0 and b != MP.floor(b)):
        raise Unsayable("a power")
    return MP.power(a, b)


def _atan2(y: Any, x: Any) -> Any:
    if y == 0:
        raise Unsayable("the sign of a zero")
    return MP.atan2(y, x)


def _exp(f: Callable[..., Any]) -> Callable[..., Any]:
    """Limit the argument of a function that grows like exp: results beyond are far out of any type's range."""
    return _real(f, lambda x: abs(x) < 1e5)


_SCALAR: dict[str, Callable[..., Any]] = {
    "neg": lambda a: -a,
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": _div,
    "fma": lambda a, b, c: a * b + c,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "gt": lambda a, b: a > b,
    "ge": lambda a, b: a >= b,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
    "isnan": lambda a: False,
    "isinf": lambda a: False,
    "cond": lambda c, a, b: a if c else b,
    "abs": abs,
    "sign": lambda x: MP.mpf((x > 0) - (x < 0)),
    "floor": MP.floor,
    "ceil": MP.ceil,
    "round": MP.nint,  # half to even
    "trunc": _trunc,
    "min": lambda a, b: b if b < a else a,
    "max": lambda a, b: b if a < b else a,
    "sqrt": _sqrt,
    "ldexp": lambda x, n: MP.ldexp(x, int(n)),
    "rsqrt": lambda x: _div(MP.mpf(1), _sqrt(x)),
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
    "hypot": MP.hypot,
    "expm1": _exp(MP.expm1),
    "log1p": _real(MP.log1p, lambda x: x > -1),
    "cbrt": lambda x: MP.sign(x) * MP.cbrt(abs(x)),
    "exp10": _exp(lambda x: MP.power(10, x)),
    "erf": MP.erf,
    "erfc": _real(MP.erfc, lambda x: abs(x) < 1e5),
    "sinpi": MP.sinpi,
    "cospi": MP.cospi,
}
"""The primitive operations, on scalars."""


def _by_component(f: Callable[..., Any]) -> Callable[..., Any]:
    """Apply a function of scalars to vectors too; a scalar beside vectors is broadcast."""

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
    objects = np.empty(len(values), object)
    objects[:] = values
    return objects


_UNKNOWN: Any = MP.nan
"""In a definition, a number that mpmath cannot represent. A `cond` may still choose the other side."""


def _is_unknown(x: Any) -> bool:
    return bool(x != x)


def _within(name: str, f: Callable[..., Any]) -> Callable[..., Any]:
    """Extend a primitive operation to unknown numbers: its result is unknown too.

    A comparison of an unknown number raises Unsayable.
    """
    compares = OPS[name].gives in ("B", "b")

    def extension(*args: Any) -> Any:
        if name != "cond" and any(map(_is_unknown, args)):
            if compares:
                raise Unsayable(name)
            return _UNKNOWN
        try:
            return f(*args)
        except Unsayable:
            return _UNKNOWN

    return _by_component(extension)


_WITHIN = {name: _within(name, f) for name, f in _SCALAR.items()}


class ExactValue(Formula):
    """A value of a definition: an mpf, a bool, or an array of them."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def op(self, name: str, *others: Any) -> ExactValue:
        """Apply an operation of the table: by its definition, or by mpmath's function where it has none."""
        operands = (self, *(o if isinstance(o, ExactValue) else self.constant(o) for o in others))
        definition = OPS[name].definition
        return definition(*operands) if definition else ExactValue(_WITHIN[name](*(o.value for o in operands)))

    def binary(self, name: str, other: Any) -> ExactValue:
        """Return the operation: numbers are broadcast by themselves."""
        return self.op(name, other)

    def constant(self, number: float) -> ExactValue:
        """Return the number, exactly."""
        return ExactValue(MP.mpf(number))

    def choose(self, a: Any, b: Any) -> ExactValue:
        """Return one of two values, component by component."""
        return self.op("cond", a, b)

    def __getitem__(self, key: int | list[int]) -> ExactValue:
        """Return one component or a list of them; a scalar is its own component."""
        return ExactValue(self.value[key]) if np.ndim(self.value) else self

    @property
    def size(self) -> int:
        """The number of components."""
        return int(np.size(self.value))

    @property
    def precision(self) -> Literal["f", "d"]:
        """The base of arithmetic, "d" for binary64: an mpf has at least its range and precision."""
        return "d"


def _defined(definition: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function that computes a composite operation by its definition."""

    def exact(*args: Any) -> Any:
        value = definition(*map(ExactValue, args)).value
        if any(map(_is_unknown, np.ravel(value))):
            raise Unsayable(args)
        return value

    return exact


OPERATIONS: dict[str, Callable[..., Any]] = {
    **{name: _by_component(f) for name, f in _SCALAR.items()},
    **{name: _defined(row.definition) for name, row in OPS.items() if row.definition},
}
"""Each operation of the table that takes or returns floats, except those that read their bits."""
