"""The signature of the user's function: names, annotations, where it stands.

Stage: record. Annotations that are strings are resolved in the function's globals and closure.
"""

from __future__ import annotations

import ast
import functools
import inspect
import typing
from collections.abc import Callable, Iterator
from types import CodeType
from typing import Any

from shpy.errors import ShpyError, ShpyTypeError
from shpy.ir.nodes import Loc
from shpy.lang.recording.location import loc_in, user_frame
from shpy.lang.recording.tree import definition_of


def _layers(function: Any) -> Iterator[Any]:
    """Yield a callable, and what it calls: the function inside a partial, a method or a callable object."""
    while True:
        yield function
        if isinstance(function, functools.partial):
            function = function.func
        elif inspect.ismethod(function):
            function = function.__func__
        elif not inspect.isfunction(function) and inspect.isfunction(vars(type(function)).get("__call__")):
            function = vars(type(function))["__call__"]
        else:
            return


def plain_function(function: Any) -> Any:
    """Return the function inside a partial, a method or a callable object."""
    *_, plain = _layers(function)
    return plain


def fixed_by_partials(function: Any) -> set[str]:
    """Return the names of the parameters that partials give by keyword."""
    return {name for layer in _layers(function) if isinstance(layer, functools.partial) for name in layer.keywords}


def bodies_of(function: Any) -> frozenset[CodeType]:
    """Return the code of the function, and of each function that its decorators wrap (`functools.wraps`)."""
    codes: set[CodeType] = set()
    for _ in range(32):  # wrappers may go round in circles
        plain = plain_function(function)
        code = getattr(plain, "__code__", None)
        if isinstance(code, CodeType):
            codes.add(code)
        wrapped = getattr(function, "__wrapped__", getattr(plain, "__wrapped__", None))
        if wrapped is None:
            break
        function = wrapped
    return frozenset(codes)


def loc_of(function: Any) -> Loc | None:
    """Return the line where the function is defined."""
    code = getattr(plain_function(function), "__code__", None)
    return loc_in(code, code.co_firstlineno) if code is not None else None


def return_loc(function: Any) -> Loc | None:
    """Return the line of the function's last return, or of the function where that is not known."""
    loc = loc_of(function)
    if loc is None:
        return None
    definition = definition_of(plain_function(function).__code__)
    if definition is None:
        return loc
    last = definition[0].body[-1]
    return Loc(loc.file, last.lineno, definition[1]) if isinstance(last, ast.Return) else loc


def hints_of(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations, strings resolved; ShpyTypeError for one that names nothing."""
    plain = plain_function(function)
    hints = dict(getattr(plain, "__annotations__", {}))
    if any(isinstance(h, str) for h in hints.values()):
        namespace = dict(getattr(plain, "__globals__", {}))
        code = plain.__code__
        for name, cell in zip(code.co_freevars, plain.__closure__ or (), strict=True):
            try:
                namespace[name] = cell.cell_contents
            except ValueError:
                continue  # a variable that is not set yet
        frame = user_frame()  # a name that only annotations use is no free variable of the function
        if frame is not None and code in frame.f_code.co_consts:
            namespace = {**frame.f_locals, **namespace}
        for name, hint in hints.items():
            if isinstance(hint, str):
                hints[name] = _resolve(hint, namespace, name, loc_of(plain))
    return {name: _meant(hint) for name, hint in hints.items()}


def _meant(hint: Any) -> Any:
    """Return the type that `Annotated[T, …]`, `NewType("N", T)` or `type N = T` stands for."""
    while True:
        if typing.get_origin(hint) is typing.Annotated:
            hint = hint.__origin__
        elif isinstance(hint, typing.NewType):
            hint = hint.__supertype__
        elif type(hint).__name__ == "TypeAliasType":  # a `type` statement of Python 3.12
            hint = hint.__value__
        else:
            return hint


def _resolve(hint: str, namespace: dict[str, Any], name: str, loc: Loc | None) -> Any:
    try:
        value = eval(hint, namespace)
        # With `from __future__ import annotations`, an annotation in quotes is a string in a string.
        return _resolve(value, namespace, name, loc) if isinstance(value, str) and value != hint else value
    except Exception as error:
        text, cure = str(error), "a type that the module's globals or the enclosing function know, such as sh.Attrib1f"
        if isinstance(error, ShpyError):  # the evaluated string has no line of the user's
            text, cure = error.message, error.cure or cure
        raise ShpyTypeError(
            f"{name} is annotated {hint!r}, which cannot be resolved: {text}", loc=loc, cure=cure
        ) from error
