"""The operators of Python on values: which operation of the table each one is.

Stage: record. Written out one by one, so that type checkers and editors see them.
"""

from __future__ import annotations

from typing import Any


class Operators:
    """Gives a class with `_binary`, `_inplace` and `_unary` the operators of Python."""

    __slots__ = ()

    def _unary(self, op: str, what: str) -> Any:
        raise TypeError(what)

    def _binary(self, op: str, other: Any, what: str, reflected: bool = False) -> Any:
        raise TypeError(what)

    def _inplace(self, op: str, other: Any, what: str) -> Any:
        raise TypeError(what)

    def __neg__(self) -> Any:
        return self._unary("neg", "-")

    def __abs__(self) -> Any:
        return self._unary("abs", "abs")

    def __invert__(self) -> Any:
        return self._unary("not", "~")

    def __add__(self, other: Any) -> Any:
        return self._binary("add", other, "+")

    def __radd__(self, other: Any) -> Any:
        return self._binary("add", other, "+", True)

    def __iadd__(self, other: Any) -> Any:
        return self._inplace("add", other, "+")

    def __sub__(self, other: Any) -> Any:
        return self._binary("sub", other, "-")

    def __rsub__(self, other: Any) -> Any:
        return self._binary("sub", other, "-", True)

    def __isub__(self, other: Any) -> Any:
        return self._inplace("sub", other, "-")

    def __mul__(self, other: Any) -> Any:
        return self._binary("mul", other, "*")

    def __rmul__(self, other: Any) -> Any:
        return self._binary("mul", other, "*", True)

    def __imul__(self, other: Any) -> Any:
        return self._inplace("mul", other, "*")

    def __truediv__(self, other: Any) -> Any:
        return self._binary("div", other, "/")

    def __rtruediv__(self, other: Any) -> Any:
        return self._binary("div", other, "/", True)

    def __itruediv__(self, other: Any) -> Any:
        return self._inplace("div", other, "/")

    def __floordiv__(self, other: Any) -> Any:
        return self._binary("floordiv", other, "//")

    def __rfloordiv__(self, other: Any) -> Any:
        return self._binary("floordiv", other, "//", True)

    def __ifloordiv__(self, other: Any) -> Any:
        return self._inplace("floordiv", other, "//")

    def __mod__(self, other: Any) -> Any:
        return self._binary("floormod", other, "%")

    def __rmod__(self, other: Any) -> Any:
        return self._binary("floormod", other, "%", True)

    def __imod__(self, other: Any) -> Any:
        return self._inplace("floormod", other, "%")

    def __pow__(self, other: Any) -> Any:
        return self._binary("pow", other, "**")

    def __rpow__(self, other: Any) -> Any:
        return self._binary("pow", other, "**", True)

    def __ipow__(self, other: Any) -> Any:
        return self._inplace("pow", other, "**")

    def __and__(self, other: Any) -> Any:
        return self._binary("and", other, "&")

    def __rand__(self, other: Any) -> Any:
        return self._binary("and", other, "&", True)

    def __iand__(self, other: Any) -> Any:
        return self._inplace("and", other, "&")

    def __or__(self, other: Any) -> Any:
        return self._binary("or", other, "|")

    def __ror__(self, other: Any) -> Any:
        return self._binary("or", other, "|", True)

    def __ior__(self, other: Any) -> Any:
        return self._inplace("or", other, "|")

    def __xor__(self, other: Any) -> Any:
        return self._binary("xor", other, "^")

    def __rxor__(self, other: Any) -> Any:
        return self._binary("xor", other, "^", True)

    def __ixor__(self, other: Any) -> Any:
        return self._inplace("xor", other, "^")

    def __lshift__(self, other: Any) -> Any:
        return self._binary("shl", other, "<<")

    def __rlshift__(self, other: Any) -> Any:
        return self._binary("shl", other, "<<", True)

    def __ilshift__(self, other: Any) -> Any:
        return self._inplace("shl", other, "<<")

    def __rshift__(self, other: Any) -> Any:
        return self._binary("shr", other, ">>")

    def __rrshift__(self, other: Any) -> Any:
        return self._binary("shr", other, ">>", True)

    def __irshift__(self, other: Any) -> Any:
        return self._inplace("shr", other, ">>")

    def __lt__(self, other: Any) -> Any:
        return self._binary("lt", other, "<")

    def __le__(self, other: Any) -> Any:
        return self._binary("le", other, "<=")

    def __gt__(self, other: Any) -> Any:
        return self._binary("gt", other, ">")

    def __ge__(self, other: Any) -> Any:
        return self._binary("ge", other, ">=")

    def __eq__(self, other: object) -> Any:
        return self._binary("eq", other, "==")

    def __ne__(self, other: object) -> Any:
        return self._binary("ne", other, "!=")

    __hash__ = None  # type: ignore[assignment]
