"""The kind of an expression of the text: a value of the language, a host number, another host object, or unknown.

Stage: record. A kind is given only if it is certain; the checks accept `UNKNOWN` wherever they can.

    sh.Point3f(1, 2, 3) → VALUE, "sh.Point3f"   p + d → VALUE   len(a) * 2 → NUMBER   {"k": 1} → HOST   f(x) → UNKNOWN
"""

from __future__ import annotations

import ast
import builtins
import dataclasses
import inspect
import numbers
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from types import FunctionType, SimpleNamespace

import numpy as np

from shpy.lang.recording.scope import UNRESOLVED, Scope, from_shpy

_PLAIN = re.compile(r"(Attrib|Point|Vector|Normal|Color|TexCoord)[1-4][fdhiub]$")
_COMPOUND = re.compile(r"(Matrix[234]f|Array)$")
_LANGUAGE = (
    "shpy.lang.values.builtins",
    "shpy.lang.data.textures",
    "shpy.lang.values.derivatives",
    "shpy.lang.library",
    "shpy.lang.values.matrix",
)
"""The modules whose functions are the language, besides those of `shpy.library`."""
_NUMBERS = ("len", "int", "float", "bool", "ord", "id", "round", "isinstance", "hasattr", "callable")
_KEPT = ("abs", "min", "max", "sum", "pow", "divmod")  # numbers of numbers


class Kind(Enum):
    """The kinds of objects while a program is recorded."""

    VALUE = "a value of the language"
    NUMBER = "a number of Python"
    HOST = "another object of Python"
    UNKNOWN = "not known from the text"


@dataclass(frozen=True, slots=True)
class Known:
    """A kind, and for scalars and vectors the type as the user writes it, where it is known.

    `holds` says that a tuple, list or dict holds a value, or what may be one; `struct` is the class of a struct.
    """

    kind: Kind
    type: str | None = None
    holds: bool = False
    struct: builtins.type | None = None


VALUE, NUMBER, HOST, UNKNOWN = Known(Kind.VALUE), Known(Kind.NUMBER), Known(Kind.HOST), Known(Kind.UNKNOWN)


@dataclass(frozen=True)
class Judge:
    """Finds the kinds of expressions; `look` returns the `Known` of a local name or path (`self.k`), or None."""

    scope: Scope
    look: Callable[[str], Known | None]

    def kind(self, node: ast.expr) -> Known:
        """Return what is known of an expression's result."""
        match node:
            case ast.Constant(value=value):
                return NUMBER if isinstance(value, int | float | complex) else HOST
            case ast.Name() | ast.Attribute() | ast.Subscript():
                return self._place(node)
            case ast.UnaryOp(op=ast.Not()):
                return NUMBER if self.kind(node.operand).kind in (Kind.NUMBER, Kind.HOST) else UNKNOWN
            case ast.UnaryOp():
                return _of(self.kind(node.operand))
            case ast.BinOp():
                return _combined([self.kind(node.left), self.kind(node.right)])
            case ast.Compare(ops=ops) if any(isinstance(o, ast.Is | ast.IsNot) for o in ops):
                return NUMBER
            case ast.Compare(ops=ops) if any(isinstance(o, ast.In | ast.NotIn) for o in ops):
                return UNKNOWN
            case ast.Compare():
                kinds = [self.kind(e) for e in (node.left, *node.comparators)]
                return NUMBER if all(k.kind in (Kind.NUMBER, Kind.HOST) for k in kinds) else _combined(kinds)
            case ast.IfExp():
                yes, no = self.kind(node.body), self.kind(node.orelse)
                return yes if yes == no else Known(yes.kind) if yes.kind is no.kind else UNKNOWN
            case ast.NamedExpr():
                return self.kind(node.value)
            case ast.Call():
                return self._call(node)
            case ast.BoolOp() | ast.Await() | ast.Yield() | ast.YieldFrom() | ast.Starred():
                return UNKNOWN
            case ast.Tuple(elts=parts) | ast.List(elts=parts) | ast.Dict(values=parts):
                inferences = map(self.kind, parts)
                return Known(Kind.HOST, holds=any(k.kind in (Kind.VALUE, Kind.UNKNOWN) or k.holds for k in inferences))
            case _:  # sets, comprehensions, strings, lambdas
                return HOST

    def thing(self, thing: object) -> Known:
        """Return what is known of an object that the text names."""
        if thing is UNRESOLVED:
            return UNKNOWN
        if self.scope.is_value(thing):
            return VALUE
        if isinstance(thing, numbers.Number):
            return NUMBER
        return UNKNOWN if from_shpy(type(thing)) else HOST  # an Array's items are stored, not rebound

    def made_by(self, thing: object, written: str) -> Known:
        """Return what is known of an instance of this class: a call's result, or an argument annotated with it."""
        if not isinstance(thing, type) or thing is object or thing.__module__ == "typing":
            return UNKNOWN
        if issubclass(thing, numbers.Number | np.bool_):
            return NUMBER
        if not from_shpy(thing):
            return HOST
        if _PLAIN.match(thing.__name__):
            return Known(Kind.VALUE, written)
        if thing.__module__.partition(".")[0] != "shpy":
            return Known(Kind.VALUE, struct=thing)
        return VALUE if _COMPOUND.match(thing.__name__) else HOST

    def field(self, node: ast.Attribute) -> Known | None:
        """Return what is known of a field of a struct, which is the value itself; None for other attributes."""
        fields = getattr(self.kind(node.value).struct, "_shpy_fields", {})
        inference = self.made_by(fields.get(node.attr), "")
        return Known(Kind.VALUE, struct=inference.struct) if inference.kind is Kind.VALUE else None

    def _place(self, node: ast.Name | ast.Attribute | ast.Subscript) -> Known:
        inference = self.look(ast.unparse(node))
        if inference is not None:
            return inference
        if not isinstance(node, ast.Name) and self.kind(node.value).kind is Kind.VALUE:
            return (self.field(node) if isinstance(node, ast.Attribute) else None) or VALUE
        return self.thing(self.scope.resolve(node))

    def _call(self, node: ast.Call) -> Known:
        thing = self.scope.resolve(node.func)
        if isinstance(node.func, ast.Attribute) and node.func.attr == "copy":
            base = self.kind(node.func.value)
            return base if base.kind is Kind.VALUE else UNKNOWN
        if isinstance(thing, type):
            if thing in (int, float, bool, complex):
                return NUMBER
            return self.made_by(thing, ast.unparse(node.func))
        name = getattr(thing, "__name__", "")
        if thing is not UNRESOLVED and vars(builtins).get(name) is thing:
            if name in _NUMBERS:
                return NUMBER
            kept = name in _KEPT and all(self.kind(a) == NUMBER for a in node.args)
            return NUMBER if kept else HOST if name == "sorted" else UNKNOWN
        return VALUE if gives_value(thing) else UNKNOWN


def gives_value(thing: object) -> bool:
    """Return whether a call of an object gives one value: a function of the language, a texture, a texture's method.

    The return annotation tells: `Any` is one value, and a function that gives several, or none, says so.
    """
    if isinstance(thing, type):
        return False
    function = getattr(thing, "__func__", thing)
    if not isinstance(function, FunctionType):
        function = inspect.getattr_static(type(thing), "__call__", None)
    if not isinstance(function, FunctionType) or function.__annotations__.get("return") != "Any":
        return False
    module = str(function.__module__)
    return module in _LANGUAGE or module.startswith("shpy.library.")


def plain_fields(cls: object, call: ast.Call) -> Iterator[tuple[str, ast.expr | None]]:
    """Yield the attributes, and what they hold, that a call of a dataclass or SimpleNamespace gives its instance.

    A number that is the default of its field has no text there: None.
    """
    if any(isinstance(a, ast.Starred) for a in call.args) or any(k.arg is None for k in call.keywords):
        return
    nodes = {k.arg: k.value for k in call.keywords if k.arg is not None}
    if cls is SimpleNamespace:
        yield from nodes.items()
    elif (
        isinstance(cls, type)
        and dataclasses.is_dataclass(cls)
        and not (from_shpy(cls) or hasattr(cls, "__post_init__"))
    ):
        fields = [f for f in dataclasses.fields(cls) if f.init]
        nodes |= {f.name: value for f, value in zip(fields, call.args, strict=False)}
        for f in fields:
            if f.name in nodes:
                yield f.name, nodes[f.name]
            elif isinstance(f.default, bool | int | float):
                yield f.name, None


def functions() -> list[str]:
    """Return the names in `shpy` of the functions that give one value."""
    return [name for name, thing in vars(sys.modules["shpy"]).items() if gives_value(thing)]


def _of(inference: Known) -> Known:
    return inference if inference.kind in (Kind.VALUE, Kind.NUMBER) else UNKNOWN


def _combined(parts: list[Known]) -> Known:
    """Return what is known of an operator's result: a value if any operand is one, of a type that is left open."""
    kinds = {p.kind for p in parts}
    if Kind.VALUE in kinds:
        return VALUE
    if Kind.UNKNOWN in kinds:
        return UNKNOWN
    return NUMBER if kinds == {Kind.NUMBER} else HOST
