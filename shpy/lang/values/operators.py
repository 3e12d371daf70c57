"""The operators of Python on values: which operation of the table each one is.

Stage: record. A line here makes the method of an operator, its reflected and its in-place form.

    __add__, __radd__, __iadd__ = _operator("add", "+")      # x + y, 2 + x, x += y
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here

_Binary = Callable[[Any, Any], Any]


def _operator(op: str, what: str) -> tuple[_Binary, _Binary, _Binary]:
    def plain(self: Any, other: Any, modulus: Any = None) -> Any:  # Python's pow gives the third
        if modulus is not None:
            raise ShpyTypeError("pow takes a base and an exponent", loc=here(), cure="(x ** y) % modulus")
        return self._binary(op, other, what)

    def reflected(self: Any, other: Any) -> Any:
        return self._binary(op, other, what, True)

    def in_place(self: Any, other: Any) -> Any:
        return self._inplace(op, other, what)

    return plain, reflected, in_place


def _unary(op: str, what: str) -> Callable[[Any], Any]:
    return lambda self: self._unary(op, what)


class Operators:
    """Gives a class with `_binary`, `_inplace` and `_unary` the operators of Python."""

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]

    __neg__ = _unary("neg", "-")
    __abs__ = _unary("abs", "abs")
    __invert__ = _unary("not", "~")

    __add__, __radd__, __iadd__ = _operator("add", "+")
    __sub__, __rsub__, __isub__ = _operator("sub", "-")
    __mul__, __rmul__, __imul__ = _operator("mul", "*")
    __truediv__, __rtruediv__, __itruediv__ = _operator("div", "/")
    __floordiv__, __rfloordiv__, __ifloordiv__ = _operator("floordiv", "//")
    __mod__, __rmod__, __imod__ = _operator("floormod", "%")
    __pow__, __rpow__, __ipow__ = _operator("pow", "**")
    __and__, __rand__, __iand__ = _operator("and", "&")
    __or__, __ror__, __ior__ = _operator("or", "|")
    __xor__, __rxor__, __ixor__ = _operator("xor", "^")
    __lshift__, __rlshift__, __ilshift__ = _operator("shl", "<<")
    __rshift__, __rrshift__, __irshift__ = _operator("shr", ">>")

    __lt__ = _operator("lt", "<")[0]
    __le__ = _operator("le", "<=")[0]
    __gt__ = _operator("gt", ">")[0]
    __ge__ = _operator("ge", ">=")[0]
    __eq__ = _operator("eq", "==")[0]
    __ne__ = _operator("ne", "!=")[0]
