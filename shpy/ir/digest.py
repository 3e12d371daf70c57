"""The digest of a module: modules that have the same one have the same text, with its names and locations.

Stage: represent. Kernels are shared by it. It takes a sixth of the time of the text, 4 of 29 ms for paths in `boxes`,
which was a twelfth of the CPU time of the ray tracer's tests.

    digest(module) == digest(again)   # of a scene whose kernel is compiled already
"""

from __future__ import annotations

import hashlib
import marshal
from collections.abc import Iterable
from typing import Any

from shpy.errors import Loc
from shpy.ir.nodes import Break, Call, Continue, Discard, If, Let, Loop, Module, Region, Return, Store, Value, Variable

_EXITS: dict[type, int] = {Break: 4, Continue: 5, Return: 6}


def digest(module: Module) -> bytes:
    """Return 32 bytes that depend on all that the text of the module says, but for the metadata of its params."""
    lists = _Lists()
    words = lists.words
    words += (module.name, [(port.name, port.kind) for port in module.inputs])
    words.append([(port.name, port.kind) for port in module.outputs])
    words.append([(p.name, p.kind, repr(p.type), p.value) for p in module.params])
    words.append([(t.name, repr(t.type), t.rank, t.size) for t in module.tables])
    for function in module.functions:
        words += (function.name, function.pure, function.alone, function.tangent)
        lists.locate(function.loc)
        for slots in (function.inputs, function.outputs, function.variables):
            lists.declare(slots)
        lists.region(function.body)
    words.append([*lists.files])
    return hashlib.sha256(marshal.dumps(words, 2)).digest()  # 2: later versions depend on which objects are shared


class _Lists:
    """The words of a module in the order of its text, each list with its length, and its files."""

    def __init__(self) -> None:
        self.words: list[Any] = []
        self.files: dict[str, int] = {}

    def locate(self, loc: Loc | None) -> None:
        """Add a place in the user's code."""
        if loc is None:
            self.words.append(None)
        else:
            self.words += (self.files.setdefault(loc.file, len(self.files)), loc.line)

    def declare(self, things: Iterable[Value | Variable]) -> None:
        """Add definitions of values or variables."""
        things = tuple(things)
        self.words.append(len(things))
        for thing in things:
            length = False if isinstance(thing, Value) else thing.length
            self.words += (thing.id, thing.type.base._value_, thing.type.size, thing.name, length)
            self.locate(thing.loc)

    def region(self, region: Region) -> None:
        """Add statements: a Let begins with the name of its operation, any other one with a number."""
        words, files = self.words, self.files
        words.append(len(region))
        for statement in region:
            if type(statement) is Let:
                value = statement.value
                kind, loc = value.type, value.loc
                words += (statement.op, statement.args, statement.attr, value.id, kind.base._value_, kind.size)
                words.append(value.name)
                if loc is None:
                    words.append(None)
                else:
                    words += (files.setdefault(loc.file, len(files)), loc.line)
            else:
                self._other(statement)

    def _other(self, statement: Any) -> None:
        words = self.words
        match statement:
            case Store(variable, value, components, index):
                words += (0, variable, value, components, index)
            case Call(name, args, results):
                words += (1, name, args)
                self.declare(results)
            case If(condition, then, orelse):
                words += (2, condition)
                self.region(then)
                self.region(orelse)
            case Loop(body, continuing, until, turns):
                words += (3, until, turns)
                self.region(body)
                self.region(continuing)
            case Discard(status):
                words += (7, status)
            case _:
                words.append(_EXITS[type(statement)])
        self.locate(statement.loc)
