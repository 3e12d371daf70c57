"""Source texts, trusted only where they belong to the code that runs.

Stage: record. Takes a code object; gives the text that it was compiled from, or None. A file may have been edited, or
written by another program, since Python compiled it. So its text is compiled again and compared with the code object:
bytecode, constants, names and the positions of all instructions. Where an editor has changed the file, the versions
that were read before are compared, too. Code without a text (a REPL, `exec`, a file that has changed) is judged by its
bytecode alone, see `mistakes/frames.py`.

    text_of(function.__code__)      # Text: file, lines, tree; or None
    origin(code).loc(12)            # Loc of line 12, which carries its text
"""

from __future__ import annotations
import __future__

import ast
import dis
import functools
import importlib.util
import inspect
import linecache
import marshal
import os
import re
import struct
from collections import defaultdict
from collections.abc import Iterator
from types import CodeType
from typing import Any, Final

from shpy.errors import warn
from shpy.ir.nodes import Loc
from shpy.parsing import parse

Codes = dict[tuple[str, int], list[CodeType]]

_VERSIONS: Final = 8
"""The most versions of one file that are kept."""
_ORIGINS: Final = 16_384
"""The most code objects whose texts are kept."""
_FUTURES: Final = functools.reduce(
    lambda a, b: a | b, (getattr(__future__, name).compiler_flag for name in __future__.all_feature_names)
)
_MODULE: Final = ("<module>", 1)
_ROOT: Final = os.path.dirname(os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__)))))
_PRODUCT: Final = tuple(os.path.join(_ROOT, package, "") for package in ("shpy", "raytracer"))
_OWN_FORMS: Final = (
    "co_name co_qualname co_firstlineno co_flags co_argcount co_posonlyargcount co_kwonlyargcount co_code co_names "
    "co_varnames co_freevars co_cellvars co_linetable co_exceptiontable"
).split()


class Text:
    """One version of a file: its name, its lines, and its syntax tree, None where it does not parse."""

    def __init__(self, file: str, lines: list[str]) -> None:
        self.file = file
        self.lines = lines
        self._codes: dict[int, Codes] = {}

    @functools.cached_property
    def tree(self) -> ast.Module | None:
        """The syntax tree; None where the text does not parse."""
        try:
            tree: ast.Module = parse("".join(self.lines))
        except (SyntaxError, ValueError, RecursionError, MemoryError):  # the bytecode tells what it can
            return None
        return tree

    @functools.cached_property
    def statements(self) -> list[ast.stmt]:
        """All statements of the text, in no order; expressions, of which there are many more, are not looked into."""
        statements: list[ast.stmt] = []
        waiting: list[Any] = [self.tree] if self.tree is not None else []
        while waiting:
            node = waiting.pop()
            if isinstance(node, ast.stmt):
                statements.append(node)
            for part in ("body", "orelse", "finalbody", "handlers", "cases"):
                waiting += getattr(node, part, ())
        return statements

    def line(self, number: int) -> str:
        """Return a line, counted from 1; "" where there is none."""
        return self.lines[number - 1] if 0 < number <= len(self.lines) else ""

    def holds(self, code: CodeType) -> bool:
        """Return whether the text, compiled, gives this code object, apart from what pytest makes of assertions."""
        if self._kept and any(_same(own, code) for own in self._kept.get(_key(code), ())):
            return True
        flags = code.co_flags & _FUTURES
        codes = self._codes.get(flags)
        if codes is None:
            codes = self._codes[flags] = self._compiled(flags)
        alike = codes.get(_key(code), ())
        if any(_same(own, code) for own in alike):
            return True
        rewritten = self._asserted or any(name.startswith("@") for name in code.co_names)
        return bool(rewritten) and any(_same_besides(own, code, self._asserted) for own in alike)

    @functools.cached_property
    def _kept(self) -> Codes:
        """The code objects of the bytecode that Python keeps of this text, if it is one of the product; else empty.

        To compile the files of the ray tracer again takes 0.09 s of CPU of a path-traced picture. A file of the user's
        is compiled nevertheless: Python tells versions apart by whole seconds and by their length alone.
        """
        entry = linecache.cache.get(self.file)
        if not self.file.startswith(_PRODUCT) or entry is None or len(entry) < 4 or entry[2] is not self.lines:
            return {}
        size, time = entry[:2]
        try:
            with open(importlib.util.cache_from_source(self.file), "rb") as file:
                header, bytecode = file.read(16), file.read()
            if time is None or header != importlib.util.MAGIC_NUMBER + struct.pack("<III", 0, int(time), size):
                return {}
            return _enter({}, marshal.loads(bytecode))
        except (OSError, RuntimeError, ValueError, EOFError, TypeError, struct.error):  # none is kept, or it is damaged
            return {}

    def _compiled(self, flags: int) -> Codes:
        """Return the code objects of the text by name and first line.

        A notebook compiles each statement of a cell by itself, and CPython then calls what the cell imports otherwise.
        """
        codes: Codes = {}
        pieces: list[Any] = ["".join(self.lines)]
        if not os.path.exists(self.file) and self.tree is not None:
            pieces += [ast.Module([node], []) for node in self.tree.body]
            pieces += [ast.Interactive([node]) for node in self.tree.body]
        for piece in pieces:
            mode = "single" if isinstance(piece, ast.Interactive) else "exec"
            try:
                _enter(codes, compile(piece, self.file, mode, flags, dont_inherit=True))
            except (SyntaxError, ValueError, RecursionError, MemoryError):  # for instance, `return` outside a function
                continue
        return codes

    @functools.cached_property
    def _asserted(self) -> frozenset[int]:
        """The lines of assertions, for which pytest compiles code of its own."""
        nodes = [node for node in ast.walk(self.tree or ast.Module([], [])) if isinstance(node, ast.Assert)]
        return frozenset(line for n in nodes for line in range(n.lineno, (n.end_lineno or n.lineno) + 1))


class Origin:
    """The text of a code object, or None, and the locations of its lines and of its instructions.

    `listing` is what `mistakes` reads off the code.
    """

    __slots__ = ("code", "listing", "locs", "places", "tested", "text")

    def __init__(self, code: CodeType, text: Text | None, tested: Any) -> None:
        self.code = code
        self.text = text
        self.tested = tested
        self.locs: dict[int, Loc] = {}
        self.places: dict[int, Loc] = {}
        self.listing: Any = None


_origins: dict[int, Origin] = {}
_versions: dict[str, list[Text]] = {}


def origin(code: CodeType) -> Origin:
    """Return the origin of a code object; without a text it is looked up again when linecache has another one."""
    entry = _origins.get(id(code))
    if entry is not None and (entry.text is not None or linecache.cache.get(code.co_filename) is entry.tested):
        return entry
    if len(_origins) >= _ORIGINS:
        _origins.clear()
    text = _find_text(code)
    entry = _origins[id(code)] = Origin(code, text, linecache.cache.get(code.co_filename))
    return entry


def text_of(code: CodeType) -> Text | None:
    """Return the text that a code object was compiled from; None where none is there, or where it has changed."""
    return origin(code).text


def has_changed(code: CodeType) -> bool:
    """Return whether a text lies under the name of the code's file, but another one than it was compiled from."""
    return text_of(code) is None and bool(linecache.getlines(code.co_filename))


def tell_of_change(code: CodeType) -> None:
    """Warn of a function whose file has changed since, and name the checks that are left out."""
    if has_changed(code):
        warn(
            f"{code.co_filename}:{code.co_firstlineno}: Python runs another {code.co_name} than the file's text has "
            "there: the text was changed after it was loaded, or as it was loaded. Names that a block binds anew are "
            "found in the bytecode; mistakes that only a text shows, such as two names of one value, are not looked "
            "for. Load the file again"
        )


def latest(file: str) -> Text | None:
    """Return the text of a file as it is now; None where it has none."""
    linecache.checkcache(file)
    return _entered(file)


def written(loc: Loc | None) -> str:
    """Return the user's line as it was recorded, without spaces around it; "" where it is not known."""
    return loc.text.line(loc.line).strip() if loc is not None and loc.text is not None else ""


def _find_text(code: CodeType) -> Text | None:
    """Return the version of the file that holds the code: what linecache has, an earlier one, or the file's own."""
    file = code.co_filename
    tried = set[int]()
    for _ in range(2):
        _entered(file)
        for text in _versions.get(file, ()):
            if id(text) not in tried and text.holds(code):
                return text
            tried.add(id(text))
        entry = linecache.cache.get(file)
        if entry is None or len(entry) < 4 or entry[1] is None or not os.path.exists(file):
            return None  # the text of a cell, or of an archive, has no other version on the disk
        linecache.updatecache(file)  # also where its size and its time are those of the version before
    return None


def _entered(file: str) -> Text | None:
    """Enter the text that linecache has of a file among the versions, the newest first; return it."""
    lines = linecache.getlines(file)
    if not lines:
        return None
    versions = _versions.setdefault(file, [])
    for text in versions:
        if text.lines is lines or text.lines == lines:
            if text is not versions[0]:
                versions.remove(text)
                versions.insert(0, text)
            return text
    versions.insert(0, Text(file, lines))
    del versions[_VERSIONS:]
    return versions[0]


def _enter(codes: Codes, code: CodeType) -> Codes:
    """Enter a code object and those of the functions in it by name and first line."""
    waiting = [code]
    while waiting:
        code = waiting.pop()
        codes.setdefault(_key(code), []).append(code)
        waiting += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    return codes


# Comparison of code objects


def _key(code: CodeType) -> tuple[str, int]:
    """Return the key under which a code object is looked up; notebooks name the code of a cell otherwise."""
    of_module = code.co_name.startswith("<") and not code.co_flags & inspect.CO_OPTIMIZED
    return _MODULE if of_module else (code.co_name, code.co_firstlineno)


def _same(own: CodeType, code: CodeType) -> bool:
    """Return whether two code objects do the same at the same places of their texts."""
    return all(getattr(own, form) == getattr(code, form) for form in _OWN_FORMS) and _same_constants(
        own.co_consts, code.co_consts
    )


def _same_constants(own: tuple[Any, ...], other: tuple[Any, ...]) -> bool:
    return len(own) == len(other) and all(map(_same_constant, own, other))


def _same_constant(own: Any, other: Any) -> bool:
    if type(own) is not type(other):
        return False
    if isinstance(own, CodeType):
        return _same(own, other)
    if isinstance(own, tuple):
        return _same_constants(own, other)
    return bool(own == other) if isinstance(own, frozenset) else repr(own) == repr(other)  # -0.0 == 0.0


_PASSED: Final = re.compile("RESUME|NOP|CACHE|EXTENDED_ARG|MAKE_CELL|COPY_FREE_VARS|PUSH_NULL")
_WAYS: Final = re.compile("(FORWARD|BACKWARD)_|_CHECK|_AND_CLEAR")


def _same_besides(own: CodeType, code: CodeType, lines: frozenset[int]) -> bool:
    """Return whether two code objects are alike but for these lines, and those of names that no text can have.

    pytest writes assertions anew, and puts imports of names that begin with @ before a module's first statement. Of
    the functions that the code defines, names and lines count: each is compared when it runs. To compare all of a file
    for the first line of its module took a sixth of the time in which pytest collects tests.
    """
    first, second = _by_line(own), _by_line(code)
    besides = {line for line, parts in second.items() if any(part.startswith("STORE_NAME '@") for part, *_ in parts)}
    return all(
        first.get(line) == second.get(line)
        for line in first.keys() | second.keys()
        if line not in lines and line not in besides
    )


def _by_line(code: CodeType) -> dict[int, list[tuple[Any, ...]]]:
    """Return the instructions of each line with their positions, without those that other surroundings change."""
    by_line: dict[int, list[tuple[Any, ...]]] = defaultdict(list)
    for name, argument, line, *columns in _instructions(code):
        by_line[line].append((f"{name} {argument}", *columns))
    return dict(by_line)


def _instructions(code: CodeType) -> Iterator[tuple[Any, ...]]:
    jumps = {*dis.hasjrel, *dis.hasjabs}
    for instruction in dis.get_instructions(code):
        place, argument = instruction.positions, instruction.argval
        if place is None or place.lineno is None or _PASSED.match(instruction.opname):
            continue
        if instruction.opcode in jumps:
            argument = ""
        elif isinstance(argument, CodeType):
            argument = _key(argument)
        name = _WAYS.sub("", instruction.opname)
        yield name, f"{argument!r}", place.lineno, place.end_lineno, place.col_offset, place.end_col_offset
