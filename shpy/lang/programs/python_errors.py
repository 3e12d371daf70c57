"""Cures for the errors of Python and numpy where a value of the language is taken for another kind of object.

Stage: record. Takes an error that left the user's function; gives shpy's own error at the user's line, or None where
the error has nothing to do with the language.

    table(i)            # a Table is read with an index: table[i]
    {1.0, 2.0}[i]       # a set has no order: sh.Array(sh.Attrib1f, [a, b])[i]
"""

from __future__ import annotations

import ast
import builtins
import inspect
import re
import traceback
from collections import Counter
from itertools import islice
from types import FrameType, TracebackType
from typing import Any

import numpy as np

from shpy.errors import RecordError, ShpyAttributeError, ShpyError, ShpyTypeError
from shpy.ir.nodes import Loc
from shpy.lang.data.tables import Table
from shpy.lang.data.textures import Texture
from shpy.lang.functions.array import Array
from shpy.lang.mistakes.explain import conversion_of
from shpy.lang.mistakes.expressions import named
from shpy.lang.recording.location import here, is_users, loc_in
from shpy.lang.recording.text import text_of, written
from shpy.lang.values.matrix import Matrix
from shpy.lang.values.structure import Struct
from shpy.lang.values.value import Value

_CALLED = re.compile(r"'(\w+)' object is not callable")
_INDEXED = re.compile(r"'(\w+)' object is not subscriptable")
_COUNTED = re.compile(r"'(\w+)' object is not iterable|non-iterable (\w+) object|type '(\w+)' has no len")
_ARGUMENTS = re.compile(r"\(\) ((missing|takes|got) .*argument.*)")
_FIXED = re.compile(r"can't set attribute|'(\w+)' object does not support item assignment")
_OPERATOR = re.compile(r"(?:operand type(?:\(s\))? for (?:unary )?|^')(\S+?)(?: or pow\(\))?(?:: |' not supported)")
_OPERANDS = re.compile(r"'(\w+)'|(?:not|type) (\w+)")
_HASHED = re.compile(r"unhashable type: '(\w+)'")
_KINDS: dict[str, tuple[type, str]] = {
    "Array": (Array, "array[i]"),
    "Table": (Table, "table[i], table[row, column]: an index for each axis"),
}
_OF_ARRAYS = {
    "sum": "sum({0}), Python's, which is unrolled; or total += {0}[i] in a loop, with SH_FOR(0, {1}) as i",
    "size": "{1}",
    "shape": "{1}",
    "max": "sh.max(*{0})",
    "min": "sh.min(*{0})",
    "copy": "sh.Array(type, list({0}))",
}


_OFTEN = 50
"""The number of calls of a function from one of its own lines in a stack, from which it counts as endless recursion."""
_ENDLESS = "Python calls it while the program is recorded, and no condition on values ends that"
_STACK = "a loop, with an sh.Array as the stack; or a depth that Python counts, if depth > 0: f(x, depth - 1)"


def explain_python_error(
    error: TypeError | ValueError | AttributeError | NameError | RecursionError, recorded: str
) -> ShpyError | None:
    """Return shpy's error at the user's line; None for an error that is unrelated to the language.

    `recorded` is the name of the function that is recorded.
    """
    if isinstance(error, RecursionError):
        return _recursion(error)
    if isinstance(error.__cause__, ShpyError):  # numpy replaces errors of an array's elements by its own
        return error.__cause__
    places = list(traceback.walk_tb(error.__traceback__))
    place = next((p for p in reversed(places) if is_users(p[0].f_code.co_filename)), None)
    text = str(error)
    if place is None:
        return _of_numpy(here()) if "does not support ufuncs" in text else None
    loc = loc_in(place[0].f_code, place[1])
    if isinstance(error, NameError):
        itself = error.name == recorded  # the name is bound when the recording is done
        return RecordError(f"{recorded} calls itself: {_ENDLESS}", loc=loc, cure=_STACK) if itself else None
    if isinstance(error, AttributeError):
        return _attribute(error, loc) or _tuple(text, loc)
    if "does not support ufuncs" in text:
        call = _running(error.__traceback__, place[0])
        if isinstance(call, ast.Call) and loc.text is not None and isinstance(named(call.func, place[0]), np.ufunc):
            message, cure = conversion_of(call, loc.text, place[0])
            return RecordError(message, loc=loc, cure=cure)
        return _of_numpy(loc)
    if places[-1] is not place:  # raised inside a library
        return None
    explanation = _call(text, loc) or _container(text, loc) or _tuple(text, loc) or _operands(text, loc)
    return explanation or _arguments(error, loc)


def _of_numpy(loc: Loc | None) -> RecordError:
    cure = "the function of the same name in shpy, sh.sin(x) for np.sin(x)"
    return RecordError("numpy's functions cannot take values of the language", loc=loc, cure=cure)


def _recursion(error: RecursionError) -> ShpyError | None:
    """Return the error for a function of the user's that has called itself until Python's stack was full."""
    stack = ((frame.f_code, line) for frame, line in traceback.walk_tb(error.__traceback__))
    calls = Counter((code, line) for code, line in stack if is_users(code.co_filename))
    (code, line), count = calls.most_common(1)[0]
    if count < _OFTEN:
        return None
    loc = loc_in(code, line)
    return RecordError(
        f"{code.co_name} calls itself {count} times deep, and Python's stack is full: Python calls it while the "
        "program is recorded, and a condition on values does not end that",
        loc=loc,
        cure="a loop, with an sh.Array as the stack; or, where Python counts the depth, a loop of Python",
    )


def _call(text: str, loc: Loc) -> ShpyError | None:
    called = _CALLED.search(text)
    if called is None:
        return None
    name = called[1]
    if name in _KINDS:
        return ShpyTypeError(
            f"this {_KINDS[name][0].__name__} is read by an index, not called", loc=loc, cure=_KINDS[name][1]
        )
    if name in _classes(Matrix):
        return ShpyTypeError(f"this {name} is read by an index, not called", loc=loc, cure="m[r] for a row, m[r, c]")
    if name in _classes(Value):
        cure = "v[i] for a component; a * (b + c) for a product"
        return ShpyTypeError(f"this {name} is a value, which nothing can call", loc=loc, cure=cure)
    size = re.search(r"(\w+)\.(size|shape)\(\)", written(loc))
    if size is not None:
        attribute = f"{size[1]}.{size[2]}"
        return ShpyTypeError(
            f"{attribute} is no method but the number itself", loc=loc, cure=f"{attribute}, or len({size[1]})"
        )
    return None


def _operands(text: str, loc: Loc) -> ShpyError | None:
    """Return the error for an operator or a function of Python's that takes no Table, struct or matrix."""
    operator = _OPERATOR.search(text)
    cures = {name: cure for name, (_, cure) in _KINDS.items()}
    cures |= dict.fromkeys(_classes(Struct), "ray.o, for one field") | dict.fromkeys(_classes(Texture), "texture(uv)")
    cures |= dict.fromkeys(("Program", "Subroutine"), "f(x), a call") | {"Stream": "an input of the program"}
    cures |= dict.fromkeys(_classes(Matrix), "m[r], for one row")
    for name in (quoted or bare for quoted, bare in _OPERANDS.findall(text)):
        if name in cures:
            takes = f"no {name}" if name in _classes(Matrix) else f"values, and {name} is none"
            return ShpyTypeError(f"{operator[1]} takes {takes}" if operator else text, loc=loc, cure=cures[name])
    return None


def _arguments(error: Exception, loc: Loc) -> ShpyError | None:
    """Return the error for a call of a function or class of shpy with arguments that it does not take."""
    match, call = _ARGUMENTS.search(str(error)), _running(error.__traceback__)
    if match is None or not isinstance(call, ast.Call):
        return None
    assert error.__traceback__ is not None
    *_, (frame, _) = traceback.walk_tb(error.__traceback__)
    called = named(call.func, frame)
    if called is None or not _is_ours(called):
        return None
    spelled, parameters = ast.unparse(call.func), inspect.signature(called).parameters.values()
    takes = [str(p.replace(annotation=p.empty, default=p.empty)) for p in parameters if p.kind is not p.KEYWORD_ONLY]
    return ShpyTypeError(f"{spelled}() {match[1]}", loc=loc, cure=f"{spelled}({', '.join(takes)})")


def _is_ours(thing: object) -> bool:
    """Return whether a class or function belongs to the language; classes made by its decorators count."""
    candidates: tuple[Any, ...] = (thing,)
    if isinstance(thing, type):
        candidates = (*thing.__mro__, type(thing))
    return any(str(getattr(c, "__module__", "")).partition(".")[0] == "shpy" for c in candidates)


def _running(trace: TracebackType | None, frame: FrameType | None = None) -> ast.expr | None:
    """Return the expression that raised an error, in a frame of its traceback, or else the innermost."""
    if trace is None:
        return None
    while trace.tb_next is not None and trace.tb_frame is not frame:
        trace = trace.tb_next
    code = trace.tb_frame.f_code
    line, end, column, end_column = next(islice(code.co_positions(), trace.tb_lasti // 2, None))
    text = text_of(code)
    tree = text.tree if text is not None else None
    for node in ast.walk(tree) if tree is not None else ():
        if isinstance(node, ast.expr) and (node.lineno, node.end_lineno) == (line, end):
            if (node.col_offset, node.end_col_offset) == (column, end_column):
                return node
    return None


def _tuple(text: str, loc: Loc) -> ShpyError | None:
    """Return the error for a store that would bind a field of a tuple to another value."""
    fixed = _FIXED.search(text)
    if fixed is None or getattr(builtins, fixed[1] or "", tuple) is not tuple:  # a NamedTuple is not a tuple
        return None
    return ShpyTypeError(
        f"{text}: Python would bind another value, and a tuple keeps those that it has",
        loc=loc,
        cure="point.x[:] = …, which stores into the value; or a @sh.struct, whose fields take stores",
    )


def _container(text: str, loc: Loc) -> ShpyError | None:
    if "'set' object is not subscriptable" in text:
        return ShpyTypeError(
            "{…} without keys is a set, which has no order and no elements by number",
            loc=loc,
            cure="sh.Array(sh.Attrib1f, [a, b])[i]; with an i of Python's (a, b)[i]",
        )
    indexed = _INDEXED.search(text)
    if indexed is not None and indexed[1] in _classes(Texture):
        return ShpyTypeError(
            f"this {_shown(indexed[1])} is read at coordinates, not by an index",
            loc=loc,
            cure="texture(uv); sh.Table(array, sh.Color3f)[row, column] for a pixel",
        )
    counted = indexed or _COUNTED.search(text)
    if counted is not None and counted[counted.lastindex or 0] in _classes(Struct):
        kind = counted[counted.lastindex or 0]
        return ShpyTypeError(f"{kind} is a struct, whose fields have names alone", loc=loc, cure="ray.o, for one field")
    hashed = _HASHED.search(text)
    if hashed is not None and hashed[1] in _classes(Value):
        return ShpyTypeError(
            f"this {hashed[1]} is known only when the program runs: it is no key of a dict, and no member of a set",
            loc=loc,
            cure="sh.Array(sh.Attrib1f, [a, b])[i], sh.Table(array, sh.Attrib1f)[i], or sh.cond(i == 0, a, b)",
        )
    return None


def _attribute(error: AttributeError, loc: Loc) -> ShpyError | None:
    if isinstance(error, ShpyError) or not isinstance(error.obj, Array | Table | Texture | Struct):
        return None
    name, missing = _name(error.name, loc), error.name or ""
    match error.obj:
        case Array():
            kind, cure = "Array", _OF_ARRAYS.get(missing, "{0}[i], and {1}").format(name, f"len({name})")
        case Struct():
            kind, cure = type(error.obj).__name__, f"one of {', '.join(error.obj._shpy_fields)}"
        case Texture():
            kind, cure = _shown(type(error.obj).__name__), f"{name}.shape" if missing == "size" else f"{name}(uv)"
        case _:
            of_tables = {"sum": _OF_ARRAYS["sum"].partition("; or ")[2], "size": "{0}.shape"}
            kind, cure = "Table", of_tables.get(missing, "{0}[i], and {1}").format(name, f"{name}.shape[0]")
    return ShpyAttributeError(f"{kind!r} object has no attribute {error.name!r}", loc=loc, cure=cure)


def _shown(name: str) -> str:
    """Return the name of a texture's class as the user writes it: an argument is one, too."""
    return name.replace("Argument", "2D")


def _name(attribute: str | None, loc: Loc) -> str:
    """Return the user's name for the object whose attribute is missing, as far as the line tells."""
    match = re.search(rf"([A-Za-z_]\w*)\.{attribute}\b", written(loc))
    return match[1] if match else "a"


def _classes(base: type[Any]) -> frozenset[str]:
    """Return the names of a class and of all that derive from it."""
    names = {base.__name__}
    for cls in base.__subclasses__():
        names |= _classes(cls)
    return frozenset(names)
