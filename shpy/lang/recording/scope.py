"""The objects that names in a function's text mean: in its globals, closure and builtins, without running code.

Stage: record. Takes an expression of the text; gives the object that it will be, or `UNRESOLVED` for what only the
run knows (locals, calls, properties).

    scope.resolve(ast.parse("sh.SH_IF", mode="eval").body)      # the object SH_IF
    scope.control(call.func)                                    # "SH_IF", under whatever alias
"""

from __future__ import annotations

import ast
import builtins
import functools
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import FunctionType, MethodType, ModuleType
from typing import Any

from shpy.lang.recording.text import Text
from shpy.lang.recording.tree import FunctionNode
from shpy.parsing import parse


class _UnresolvedName:
    """The type of `UNRESOLVED`, for names whose objects the text alone does not determine."""


UNRESOLVED = _UnresolvedName()


@dataclass(frozen=True)
class Scope:
    """The names of one function.

    `names` is what surrounds it, `arguments` holds those that are known (`self` of a bound method, those of a
    partial), `local` the names that the function itself binds.
    """

    text: Text
    names: Mapping[str, object]
    is_value: Callable[[object], bool]
    local: frozenset[str] = frozenset()
    arguments: Mapping[str, object] = field(default_factory=dict)

    def nested(self, node: FunctionNode) -> Scope:
        """Return the scope of a `def` inside this function: what it shares with this one is known only to the run."""
        names = {k: v for k, v in self.names.items() if k not in self.local} | dict(self.arguments)
        inner = bound_names(node)
        hidden = {name: UNRESOLVED for name in self.local if name not in self.arguments}
        return Scope(self.text, names | hidden, self.is_value, inner)

    def resolve(self, node: ast.expr) -> object:
        """Return the object that a name or a dotted name means."""
        if isinstance(node, ast.Name):
            if node.id in self.arguments:
                return self.arguments[node.id]
            if node.id in self.local:
                return UNRESOLVED
            return self.names.get(node.id, vars(builtins).get(node.id, UNRESOLVED))
        if isinstance(node, ast.Attribute):
            base = self.resolve(node.value)
            if isinstance(base, _UnresolvedName) or self.is_value(base):
                return UNRESOLVED
            if isinstance(base, ModuleType) and base.__name__ == "shpy":
                return getattr(base, node.attr, UNRESOLVED)  # loads `sh.library`, as running the text would
            return _attribute(base, node.attr)
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return UNRESOLVED
        return UNRESOLVED

    def control(self, node: ast.expr) -> str | None:
        """Return the name of the control block or exit that the expression means (`SH_IF`, `SH_BREAK`, …), or None."""
        if not isinstance(node, ast.Name | ast.Attribute):
            return None
        name = getattr(self.resolve(node), "__name__", None)
        if isinstance(name, str) and name.startswith("SH_"):
            return name
        written = node.id if isinstance(node, ast.Name) else node.attr
        return written if written.startswith("SH_") else None

    def annotation(self, node: ast.expr | None) -> tuple[object, str] | None:
        """Return the object that an annotation means, and how it is written; annotations in strings are parsed."""
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            try:
                node = parse(node.value, "eval").body
            except SyntaxError:
                return None
        if node is None:
            return None
        return self.resolve(node), ast.unparse(node)

    @functools.cached_property
    def prefix(self) -> str:
        """Return the prefix that the user writes before shpy's names: `sh.` after `import shpy as sh`."""
        for name, thing in self.names.items():
            if isinstance(thing, ModuleType) and thing.__name__ == "shpy":
                return f"{name}."
        return "sh."


def scope_of(
    function: FunctionType,
    node: FunctionNode,
    text: Text,
    arguments: Mapping[str, object],
    is_value: Callable[[object], bool],
) -> Scope:
    """Return the scope of a function that exists; `node` is its `def` in its text."""
    names = dict(function.__globals__)
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            names[name] = cell.cell_contents
        except ValueError:  # the cell is filled later
            names[name] = UNRESOLVED
    for argument in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs):
        type_ = function.__annotations__.get(argument.arg, "")
        if isinstance(argument.annotation, ast.Name) and not isinstance(type_, str):
            names[argument.annotation.id] = type_  # a local class is in the closure only if the body names it
    return Scope(text, names, is_value, bound_names(node), arguments)


def unwrapped(function: object) -> tuple[FunctionType, dict[str, object]] | None:
    """Return the plain function under methods, partials and wrappers, with the arguments that are fixed already."""
    positional: tuple[object, ...] = ()
    keywords: dict[str, object] = {}
    for _ in range(32):  # wrappers may go round in circles
        if isinstance(function, functools.partial):
            positional, keywords = (*function.args, *positional), {**function.keywords, **keywords}
            function = function.func
        elif isinstance(function, MethodType):
            positional, function = (function.__self__, *positional), function.__func__
        elif isinstance(wrapped := _attribute(function, "__wrapped__"), FunctionType | MethodType):
            function = wrapped
        elif isinstance(function, FunctionType):
            names = function.__code__.co_varnames[: function.__code__.co_argcount]
            return function, dict(zip(names, positional, strict=False)) | keywords
        elif isinstance(call := _attribute(type(function), "__call__"), FunctionType):
            positional, function = (function, *positional), call
        else:
            return None
    return None


def uses_shpy(function: FunctionType) -> bool:
    """Return whether the function's module knows anything of the language; others (numpy's, say) are left alone."""
    if function.__module__ and function.__module__.partition(".")[0] == "shpy":
        return False
    return any(
        (isinstance(thing, ModuleType) and thing.__name__.partition(".")[0] == "shpy")
        or str(getattr(thing, "__name__", "")).startswith("SH_")
        for thing in list(function.__globals__.values())
        if isinstance(thing, ModuleType | FunctionType | type)
    )


def from_shpy(thing: object) -> bool:
    """Return whether a class or function belongs to the language; classes made by its decorators count."""
    candidates: tuple[Any, ...] = (thing,)
    if isinstance(thing, type):
        candidates = (*thing.__mro__, type(thing))
    return any(str(getattr(c, "__module__", "")).partition(".")[0] == "shpy" for c in candidates)


@functools.lru_cache(maxsize=4096)  # kernels share functions, so their nodes are asked about again
def bound_names(node: FunctionNode | ast.Lambda) -> frozenset[str]:
    """Return the names that a function binds: arguments and all that it assigns, less `global` and `nonlocal`."""
    arguments = node.args
    names = {a.arg for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)}
    names |= {a.arg for a in (arguments.vararg, arguments.kwarg) if a is not None}
    outer: set[str] = set()
    for inner in _own(node):
        if isinstance(inner, ast.Name) and isinstance(inner.ctx, ast.Store | ast.Del):
            names.add(inner.id)
        elif isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(inner.name)
        elif isinstance(inner, ast.alias):
            names.add((inner.asname or inner.name).partition(".")[0])
        elif isinstance(inner, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and inner.name:
            names.add(inner.name)
        elif isinstance(inner, ast.MatchMapping) and inner.rest:
            names.add(inner.rest)
        elif isinstance(inner, ast.Global | ast.Nonlocal):
            outer |= set(inner.names)
    return frozenset(names - outer)


def _own(node: FunctionNode | ast.Lambda) -> Iterator[ast.AST]:
    """Yield the nodes of a function's body, without those of functions and classes inside it."""
    waiting: list[ast.AST] = list(node.body) if isinstance(node.body, list) else [node.body]
    while waiting:
        inner = waiting.pop()
        yield inner
        if not isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Lambda):
            waiting.extend(ast.iter_child_nodes(inner))


def _attribute(base: object, name: str) -> object:
    """Return an attribute as it is stored, so that no property or `__getattr__` runs."""
    try:
        value: object = inspect.getattr_static(base, name)
    except AttributeError:
        return UNRESOLVED
    if isinstance(value, property | functools.cached_property) or inspect.isdatadescriptor(value):
        return UNRESOLVED
    if isinstance(value, staticmethod | classmethod):
        return value.__func__ if isinstance(value, staticmethod) else UNRESOLVED
    if isinstance(value, FunctionType) and not isinstance(base, ModuleType | type):
        holder = vars(base).get(name) if hasattr(base, "__dict__") else None
        return value if holder is value else MethodType(value, base)
    return value
