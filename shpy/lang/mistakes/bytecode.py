"""Find names that a block rebinds without the text of the function, from its frame and its bytecode.

Stage: record, while blocks open and close. If there is text, `check_source` finds the mistake before anything runs. In
a REPL, under `exec` and `python -c` there is no text, and where a file was edited since, its text is not the
function's. There the local names of the user's frames are compared at the exit of each block with those at its entry,
and the bytecode shows which of them are read afterwards.

    with SH_IF(x > 1):
        x = x - 1           # x is another object now, and `return x` reads it: RecordError
    return x

A name that is first bound inside the block, or bound again before it is read, is no mistake. The items of lists and
dicts and the attributes of objects are compared too, one level deep.
"""

from __future__ import annotations

import contextlib
import dis
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from types import CodeType, FrameType, FunctionType, ModuleType
from typing import Any

import numpy as np

from shpy.ir.nodes import Loc
from shpy.lang.mistakes import findings
from shpy.lang.recording.location import called_frames, loc_in
from shpy.lang.recording.tree import definition_of
from shpy.lang.values.abstract import Symbolic
from shpy.lang.values.structure import is_value, leaves_of
from shpy.lang.values.value import Value

_ENDS = frozenset({"RETURN_VALUE", "RETURN_CONST", "RERAISE", "RAISE_VARARGS"})
_NAMES = re.compile(r"(LOAD|STORE|DELETE)_(?:FAST|DEREF|CLOSURE)(?!_AND_CLEAR)")
_NUMBERS = (int, float, complex, np.number, np.bool_)
_DISPLAYS = (tuple, list, dict)
_GONE = object()


@dataclass(frozen=True, slots=True)
class Place:
    """A local name, or an item (its key, and the length of a list) or attribute of the object with that name."""

    name: str
    key: tuple[Any, int | None] | None = None
    attribute: str | None = None

    def __str__(self) -> str:
        if self.attribute is not None:
            return f"{self.name}.{self.attribute}"
        return self.name if self.key is None else f"{self.name}[{self.key[0]!r}]"


@dataclass(frozen=True, slots=True)
class Entry:
    """The state of a frame at the entry of a block: its position, and the contents of its places."""

    frame: FrameType
    offset: int
    values: dict[Place, Any]


def entered() -> list[Entry]:
    """Return the frames of the user's functions that have no text, innermost first, as a block opens."""
    frames = [f for f in called_frames() if not _has_text(f.f_code)]
    return [Entry(f, f.f_lasti, {p: x for p, x in _places(f) if _matters(x)}) for f in frames]


def check_left(entries: list[Entry], what: str, loc: Loc | None, loop: bool, test: Callable[[], Any] | None) -> None:
    """Raise RecordError if a block rebound a place that is read after it, or in the next iteration of its loop.

    `test` is the callable that a loop evaluates in every iteration.
    """
    frames = called_frames()
    written = f"{what}()" if what in ("SH_DO", "SH_ELSE") else f"{what}(…)"
    for entry in entries:
        if all(frame is not entry.frame for frame in frames):
            continue
        code, leaving = entry.frame.f_code, entry.frame.f_lasti
        if entry.frame is frames[0] and _returns(code, leaving):
            raise findings.leaves(loc, "return", written, "SH_RETURN(…)")
        now = dict(_places(entry.frame))
        for place, old in entry.values.items():
            new = now.get(place, _GONE)
            if not _rebound(old, new):
                continue
            use, when = _first_read(code, leaving, place), "after it"
            if loop and old is not None:
                again = _first_read(code, entry.offset, place)
                if again is not None and again[0] <= leaving:
                    use, when = again, "in its next iteration"
                elif test is not None and place.name in getattr(getattr(test, "__code__", None), "co_freevars", ()):
                    use, when = (0, test.__code__.co_firstlineno), "in its next iteration"
            if use is not None:
                where = loc_in(code, _line_of_store(code, entry.offset, leaving, place))
                cure = _declaration(place, old, new)
                raise findings.rebound(where, str(place), written, f"{when} (line {use[1]})", cure)


def _declaration(place: Place, old: Any, new: Any) -> str:
    """Return the cure: a store, and a declaration before the block if the place held no value."""
    if old is None:
        return findings.stored(f"make `{place}` a value", f"{place}[:] = …")
    if isinstance(old, _DISPLAYS):
        return findings.stored_each(str(place))
    if not isinstance(old, _NUMBERS):
        return f"{place}[:] = …"
    kind = "b" if isinstance(old, bool | np.bool_) else "i" if isinstance(old, int | np.integer) else "f"
    if isinstance(new, float | np.floating):
        kind = "f"
    constructor = f"sh.{type(new).__name__}" if isinstance(new, Value) else f"sh.Attrib1{kind}"
    local = place.attribute or str(place)  # what is stored into an object would outlive the recording
    return findings.stored(f"`{local} = {constructor}({old})`", f"{local}[:] = …")


def called_by(function: FunctionType) -> list[object]:
    """Return the functions that a function without text calls by their names, or as those of a module."""
    code, functions = function.__code__, list[object]()
    cells = dict(zip(code.co_freevars, function.__closure__ or (), strict=True))
    base: object = None
    for instruction in _instructions(code):
        name, before = instruction.argval, base
        base = None
        if instruction.opname == "LOAD_GLOBAL":
            base = function.__globals__.get(name)
        elif instruction.opname == "LOAD_DEREF" and name in cells:
            with contextlib.suppress(ValueError):  # the cell is filled later
                base = cells[name].cell_contents
        elif instruction.opname in ("LOAD_METHOD", "LOAD_ATTR") and isinstance(before, ModuleType):
            base = vars(before).get(name)
        if isinstance(base, FunctionType):
            functions.append(base)
    return functions


# Contents of a frame


def _has_text(code: CodeType) -> bool:
    """Return whether the check of the source has seen the function."""
    return definition_of(code) is not None


def _places(frame: FrameType) -> Iterator[tuple[Place, Any]]:
    for name, thing in dict(frame.f_locals).items():
        yield Place(name), thing
        if type(thing) is list:
            # If the length differs, Python has filled or emptied the list: its items were not rebound.
            yield from ((Place(name, (k, len(thing))), x) for k, x in enumerate(thing))
        elif type(thing) is dict:
            yield from ((Place(name, (k, None)), x) for k, x in thing.items())
        elif hasattr(thing, "__dict__") and not isinstance(thing, Symbolic):
            if not isinstance(thing, ModuleType | FunctionType | type):
                yield from ((Place(name, None, k), x) for k, x in vars(thing).items())


def _matters(x: Any) -> bool:
    """Return whether a place with this content at the entry of a block has to be compared at its exit.

    A value of a closed block need not be, since each use of it is an error anyway.
    """
    if isinstance(x, Symbolic):
        return not is_value(x) or all(v._frame is None or not v._frame.homes[v._variable].closed for v in leaves_of(x))
    return x is None or isinstance(x, (*_NUMBERS, *_DISPLAYS))


def _holds(x: Any, depth: int = 3) -> bool:
    """Return whether this is a value, or a tuple, list or dict with one."""
    parts = () if not depth else x.values() if isinstance(x, dict) else x if isinstance(x, tuple | list) else ()
    return isinstance(x, Symbolic) or any(_holds(part, depth - 1) for part in parts)


def _rebound(old: Any, new: Any) -> bool:
    if new is old or new is _GONE:
        return False
    if isinstance(old, Symbolic) or isinstance(new, Symbolic):
        return True
    if isinstance(old, _DISPLAYS):
        return isinstance(new, _DISPLAYS) and (_holds(old) or _holds(new))
    return old is not None and isinstance(new, _NUMBERS) and bool(new != old)


# Reads in the bytecode


@lru_cache(maxsize=256)
def _instructions(code: CodeType) -> tuple[dis.Instruction, ...]:
    return tuple(dis.get_instructions(code))


def _after(instructions: tuple[dis.Instruction, ...], offset: int) -> int:
    return next((k for k, i in enumerate(instructions) if i.offset > offset), len(instructions))


def _effects(instruction: dis.Instruction, place: Place) -> Iterator[str]:
    """Yield LOAD and STORE, in order, where the instruction reads or binds the place."""
    if place.attribute is not None:
        if instruction.argval == place.attribute and instruction.opname in ("LOAD_ATTR", "LOAD_METHOD", "STORE_ATTR"):
            yield instruction.opname.partition("_")[0]
        return
    names = instruction.argval if isinstance(instruction.argval, tuple) else (instruction.argval,)
    kinds = _NAMES.findall(instruction.opname)
    for kind, name in zip(kinds, names, strict=False):
        if name == place.name:
            yield kind


def _first_read(code: CodeType, offset: int, place: Place) -> tuple[int, int] | None:
    """Return the offset and line where, after `offset`, the place may first be read before it is bound, or None."""
    instructions = _instructions(code)
    index = {i.offset: k for k, i in enumerate(instructions)}
    waiting, seen = [_after(instructions, offset)], set[int]()
    reads: list[int] = []
    while waiting:
        k = waiting.pop()
        while k < len(instructions) and k not in seen:
            seen.add(k)
            instruction = instructions[k]
            effect = next(_effects(instruction, place), None)
            if effect == "LOAD":
                reads.append(k)
            if effect is not None or instruction.opname in _ENDS:
                break
            if instruction.opcode in dis.hasjrel or instruction.opcode in dis.hasjabs:
                waiting += _targets(instructions, k, index, place)
                if re.match("JUMP_(?!IF)", instruction.opname):
                    break
            k += 1
    if not reads:
        return None
    first = instructions[min(reads)]
    return first.offset, _line(first, code)


def _targets(instructions: tuple[dis.Instruction, ...], k: int, index: dict[int, int], place: Place) -> Iterator[int]:
    """Yield the targets of the jump at `k`, besides its successor.

    Python's own loops are assumed to run at least once, and the body of an `if` that binds the place to run. They are
    decided while recording, and correlated conditions must not look like a mistake.
    """
    target = index[instructions[k].argval]
    if instructions[k].opname == "FOR_ITER":
        return
    if instructions[target].opname == "FOR_ITER" and target < k:
        yield from (target + 1, index[instructions[target].argval])
        return
    body = instructions[k + 1 : target]
    if body and body[-1].opname != "JUMP_FORWARD" and any("STORE" in _effects(i, place) for i in body):
        return
    yield target


def _line(instruction: dis.Instruction, code: CodeType) -> int:
    positions = instruction.positions
    return (positions.lineno if positions is not None else None) or code.co_firstlineno


def _line_of_store(code: CodeType, start: int, end: int, place: Place) -> int:
    """Return the line on which a block, from offset to offset, binds the place; for an item, the first that stores."""
    inside = [i for i in _instructions(code) if start < i.offset <= end]
    if place.key is not None:
        stores = [i for i in inside if i.opname in ("STORE_SUBSCR", "STORE_SLICE")]
    else:
        stores = [i for i in inside if "STORE" in _effects(i, place)]
    return next((_line(i, code) for i in (*stores, *inside)), code.co_firstlineno)


def _returns(code: CodeType, offset: int) -> bool:
    """Return whether Python's `return` leaves the block; the returned object is on the stack already."""
    names = [i.opname for i in _instructions(code)[_after(_instructions(code), offset) :]]
    text = " ".join(names[:64])
    return re.match(r"POP_TOP (SWAP |(LOAD_CONST ){3}(PRECALL )?CALL POP_TOP )*RETURN_VALUE", text) is not None
