"""Exact snapshots of the host objects on which the recording of a function depends.

Stage: record. Two snapshots are equal if the objects have the same types and bits, at every depth: 0.0 is not -0.0, and
(1,) is not (1.0,). The snapshot of a function holds its code, its defaults, and the closure cells and globals that its
code reads. An object whose state cannot be read, such as an instance of a user's class, has no snapshot.

A subroutine is recorded once for all calls with equal snapshots. Without them, each call would record it again with all
that it calls: two calls on each of n levels make 2**n recordings.

    snapshot([1, 2.0]) == snapshot([1, 2.0])      snapshot([1, 2.0]) != snapshot([1.0, 2.0])
"""

from __future__ import annotations

import builtins
import dis
import functools
import math
import operator
import struct
from collections.abc import Callable, Hashable, Iterable
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType, NoneType
from typing import Any, Final

import numpy as np

from shpy.lang.recording.location import is_users
from shpy.lang.values.value import Value

_MOST_PARTS: Final = 4096
_MOST_BYTES: Final = 1 << 20
"""The largest object with a snapshot; for larger ones recording again is faster than comparing."""
_EXACT: Final = frozenset({NoneType, bool, int, str, bytes, type(...)})
"""Types of which two objects are identical in all respects if `==` holds between them."""
_PURE: Final = (builtins, math, operator)
_IMPURE: Final = frozenset(
    {"__import__", "breakpoint", "compile", "dir", "eval", "exec", "globals", "id", "input", "locals", "open", "vars"}
)
"""Builtins that read more than their arguments."""


class Same:
    """An object as a part of a key: compared by identity, and held, so that no other object takes its place."""

    __slots__ = ("referent",)

    def __init__(self, referent: object) -> None:
        self.referent = referent

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and other.referent is self.referent

    def __hash__(self) -> int:
        return object.__hash__(self.referent)


class _Unreadable(Exception):
    """Raised for an object with state that no snapshot can hold."""


def snapshot(*things: Any) -> Hashable | None:
    """Return a key that equals another one only if these objects have the same types and bits; None if unknown."""
    try:
        return _Reader().each(things)
    except (_Unreadable, RecursionError):
        return None


class _Reader:
    """Reads objects, each mutable one once: an object that is met again is a reference to its first place."""

    def __init__(self) -> None:
        self.met: dict[Same, int] = {}
        self.parts = 0
        self.bytes = 0

    def each(self, things: Iterable[Any]) -> Hashable:
        return tuple(self.of(thing) for thing in things)

    def of(self, thing: Any) -> Hashable:
        """Return the key of one object; raise _Unreadable where there is none."""
        self._count(1, 0)
        kind = type(thing)
        if kind in _EXACT:
            return kind, thing
        if kind in (float, complex):
            return kind, struct.pack("<dd", thing.real, thing.imag)
        if isinstance(thing, np.generic) or kind is np.ndarray:
            return self._numbers(np.asarray(thing), kind)
        if isinstance(thing, Value):
            return self._constant(thing)
        read = _READ.get(kind)
        if read is not None:
            return self._once(thing, read)
        if isinstance(thing, tuple) and hasattr(kind, "_fields"):  # a NamedTuple
            return Same(kind), self.each(tuple.__iter__(thing))
        if _is_fixed(thing):
            return Same(thing)
        if hasattr(kind, "_is_subroutine"):
            return Same(thing), self.of(thing.function)
        raise _Unreadable

    def _count(self, parts: int, size: int) -> None:
        self.parts += parts
        self.bytes += size
        if self.parts > _MOST_PARTS or self.bytes > _MOST_BYTES:
            raise _Unreadable

    def _numbers(self, array: Any, kind: type) -> Hashable:
        if array.dtype.hasobject:
            raise _Unreadable
        self._count(0, array.nbytes)
        return kind, repr(array.dtype), array.shape, array.tobytes()

    def _constant(self, value: Any) -> Hashable:
        if value._frame is not None or value._uniform:
            raise _Unreadable
        return Same(type(value)), value._const

    def _once(self, thing: Any, read: Callable[[_Reader, Any], Hashable]) -> Hashable:
        key = Same(thing)
        if key in self.met:
            return "again", self.met[key]
        self.met[key] = len(self.met)
        return type(thing), read(self, thing)

    def _function(self, function: FunctionType) -> Hashable:
        code = function.__code__
        if not is_users(code.co_filename):
            return Same(function)
        names = _globals_read(code)
        if names is None:
            raise _Unreadable
        scopes = function.__globals__, vars(builtins)
        read = [(name, *(self.of(scope[name]) for scope in scopes if name in scope)) for name in names]
        cells = [self._cell(cell) for cell in function.__closure__ or ()]
        own = self.each((function.__defaults__, function.__kwdefaults__, vars(function)))
        return Same(code), own, tuple(cells), tuple(read)

    def _cell(self, cell: Any) -> Hashable:
        try:
            value = cell.cell_contents
        except ValueError:
            return None  # a variable that is not set yet
        return self.of(value)


_READ: Final[dict[type, Callable[[_Reader, Any], Hashable]]] = {
    tuple: _Reader.each,
    list: _Reader.each,
    set: _Reader.each,  # in the order in which a loop over it goes
    frozenset: _Reader.each,
    dict: lambda reader, d: reader.each(part for item in d.items() for part in item),
    range: lambda reader, r: reader.each((r.start, r.stop, r.step)),
    slice: lambda reader, s: reader.each((s.start, s.stop, s.step)),
    FunctionType: _Reader._function,
    MethodType: lambda reader, m: reader.each((m.__func__, m.__self__)),
    functools.partial: lambda reader, p: reader.each((p.func, p.args, p.keywords)),
}


def _is_fixed(thing: Any) -> bool:
    """Return whether an object is part of Python, numpy or shpy, and has no state that changes."""
    if isinstance(thing, ModuleType):
        return thing is math or thing.__name__.partition(".")[0] == "shpy"
    if isinstance(thing, type):
        return str(thing.__module__).partition(".")[0] in ("builtins", "itertools", "numpy", "shpy")
    if isinstance(thing, BuiltinFunctionType):
        return any(thing.__self__ is module for module in _PURE) and thing.__name__ not in _IMPURE
    return isinstance(thing, np.ufunc)


@functools.lru_cache(maxsize=1024)
def _globals_read(code: CodeType) -> tuple[str, ...] | None:
    """Return the globals that code reads, in functions inside it too; None where it imports or defines a class."""
    names: dict[str, None] = {}
    for instruction in dis.get_instructions(code):
        if instruction.opname in ("IMPORT_NAME", "LOAD_BUILD_CLASS"):
            return None
        if instruction.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
            names[instruction.argval] = None
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            inner = _globals_read(constant)
            if inner is None:
                return None
            names.update(dict.fromkeys(inner))
    return tuple(names)
