"""Formulas: write the definition of a composite operation once and run it on three kinds of values.

Stage: represent. A definition is a function that uses Python's operators, the functions of this file, and functions of
numpy that mean the same as in the op table. It computes with plain numpy arrays, at numpy's speed. It also computes
with a `Formula`: a term of the IR under construction (`passes/terms`), or a number of mpmath
(`accuracy/multiprecision`).

>>> @operation
... def halfway(a, b):
...     return where(a < b, (a + b) / 2, number(0, a))
>>> float(halfway(np.float32(1), np.float32(2)))
1.5
"""

from __future__ import annotations

import functools
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Literal, Self, TypeVar

import numpy as np

Values = Any
"""A numpy array, or a Formula."""

_F = TypeVar("_F", bound=Callable[..., Any])


class Formula:
    """A value to which operations are applied by name; a number among the operands gets the type of this value.

    It is not an ABC, because `isinstance` with an ABC takes longer than a small numpy operation.
    """

    @abstractmethod
    def op(self, name: str, *others: Any) -> Self:
        """Return the operation `name` of the op table, applied to this value and the others."""

    @abstractmethod
    def binary(self, name: str, other: Any) -> Self:
        """Return the operation on two operands; a scalar is broadcast to the size of the other operand."""

    @abstractmethod
    def constant(self, number: float) -> Self:
        """Return a constant of this value's type."""

    @abstractmethod
    def choose(self, a: Any, b: Any) -> Self:
        """Return `a` where this bool holds, else `b`."""

    @abstractmethod
    def __getitem__(self, key: int | list[int]) -> Self:
        """Return a component, or the vector of several; the only component of a scalar is itself."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Return the number of components."""

    @property
    @abstractmethod
    def precision(self) -> Literal["f", "d"]:
        """Return the letter of the base of arithmetic with this value."""

    def __array_ufunc__(self, function: np.ufunc, method: str, first: Any, *others: Any) -> Any:
        """Return the operation for one of numpy's functions, such as `np.floor(x)`."""
        return first.op(_UFUNCS[function], *others)

    def named(self, name: str) -> Self:
        """Return this value; emitted text uses the name."""
        return self

    def __add__(self, other: Any) -> Self:
        return self.binary("add", other)

    def __sub__(self, other: Any) -> Self:
        return self.binary("sub", other)

    def __mul__(self, other: Any) -> Self:
        return self.binary("mul", other)

    def __truediv__(self, other: Any) -> Self:
        return self.binary("div", other)

    def __radd__(self, other: float) -> Self:
        return self.constant(other) + self

    def __rsub__(self, other: float) -> Self:
        return self.constant(other) - self

    def __rmul__(self, other: float) -> Self:
        return self.constant(other) * self

    def __rtruediv__(self, other: float) -> Self:
        return self.constant(other) / self

    def __lt__(self, other: Any) -> Self:
        return self.binary("lt", other)

    def __le__(self, other: Any) -> Self:
        return self.binary("le", other)

    def __gt__(self, other: Any) -> Self:
        return self.binary("gt", other)

    def __ge__(self, other: Any) -> Self:
        return self.binary("ge", other)

    def __and__(self, other: Any) -> Self:
        return self.binary("and", other)

    def __or__(self, other: Any) -> Self:
        return self.binary("or", other)

    def __xor__(self, other: Any) -> Self:
        return self.binary("xor", other)

    def __neg__(self) -> Self:
        return self.op("neg")

    def __invert__(self) -> Self:
        return self.op("not")

    def __abs__(self) -> Self:
        return self.op("abs")


_UFUNCS = {
    np.abs: "abs", np.floor: "floor", np.sqrt: "sqrt", np.isinf: "isinf", np.equal: "eq", np.not_equal: "ne",
}  # fmt: skip
"""The functions of numpy that definitions call."""


def operation(f: _F, name: str = "") -> _F:
    """Return `f` for use in definitions: it computes on arrays; on formulas it applies the operation `name`.

    The default of `name` is the name of `f`. So a definition keeps other composite operations, for targets with these.
    """
    op = name or f.__name__

    @functools.wraps(f)
    def applied(first: Values, *others: Values) -> Values:
        return first.op(op, *others) if isinstance(first, Formula) else f(first, *others)

    return applied  # type: ignore[return-value]


def where(c: Values, a: Values, b: Values) -> Values:
    """Return `a` where `c` holds, else `b`; both are evaluated."""
    return c.choose(a, b) if isinstance(c, Formula) else np.where(c, a, b)


def number(value: float, like: Values) -> Values:
    """Return a constant of the type of `like`."""
    return like.constant(value) if isinstance(like, Formula) else like.dtype.type(value)


def named(name: str, value: Values) -> Values:
    """Return the value; emitted text uses the name."""
    return value.named(name) if isinstance(value, Formula) else value


def components(v: Values) -> Sequence[Values]:
    """Return the components of a vector as a sequence; for a scalar, the scalar alone."""
    if isinstance(v, Formula):
        return _Components(v)
    return v if np.ndim(v) else (v,)


def precision_of(v: Values) -> str:
    """Return the letter of the base of arithmetic with `v`."""
    return v.precision if isinstance(v, Formula) else v.dtype.char


class _Components(Sequence[Any]):
    """The components of a formula, each created at its use, so that emitted text has them in the order of use."""

    def __init__(self, whole: Formula) -> None:
        self.whole = whole

    def __len__(self) -> int:
        return self.whole.size

    def __getitem__(self, k: Any) -> Any:
        if k >= len(self):
            raise IndexError(k)
        return self.whole[k]
