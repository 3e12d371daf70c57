"""The bytecode of a function: which places it binds, and where a place is read first after an instruction.

Stage: record. Takes a code object; gives its `Listing`, which is made once.

    listing_of(code).first_read(offset, Place("x"))     # (the offset, the line), or None
"""

from __future__ import annotations

import dis
import functools
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from types import CodeType
from typing import Any

from shpy.lang.recording.location import IN_PLACE
from shpy.lang.recording.text import Text, origin, tell_of_change

_ENDS = frozenset({"RETURN_VALUE", "RETURN_CONST", "RERAISE", "RAISE_VARARGS"})
_NAMES = re.compile(r"(LOAD|STORE|DELETE)_(?:FAST|DEREF|CLOSURE)(?!_AND_CLEAR)")
_PASSES_ON = re.compile(r"LOAD_(FAST|DEREF|ATTR|METHOD)|COPY|SWAP|STORE_|UNPACK_|DUP_|ROT_")
"""Instructions before the binding of a name that may give it an object which has another name already."""


@dataclass(slots=True)
class Bound:
    """The places that some instructions bind: names, attributes of any object, and whether items, or those of calls."""

    names: dict[str, None] = field(default_factory=dict)
    attributes: dict[str, None] = field(default_factory=dict)
    items: bool = False
    calls: bool = False


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


Effect = Callable[[int], str | None]
"""Tells of an instruction, by its number, whether it is a LOAD of a place, a STORE, or neither."""


class Listing:
    """The instructions of a code object, and the names, attributes and items that it binds."""

    def __init__(self, code: CodeType, text: Text | None) -> None:
        self.code, self.text = code, text
        self.instructions = tuple(dis.get_instructions(code))
        self.aliases: set[str] = set()
        self.innocent: set[Any] = set()
        self.checked = False
        self._bound: dict[int, Bound] = {}
        opnames = {instruction.opname for instruction in self.instructions}
        for before, instruction in pairwise(self.instructions):
            if instruction.opname.startswith("STORE_"):
                names = [name for kind, name in _named(instruction) if kind == "STORE"]
                if _PASSES_ON.match(before.opname) or len(names) > 1:
                    self.aliases.update(names)
        multiplies = any(i.opname == "BINARY_OP" and i.argrepr == "*" for i in self.instructions)
        inner = (c for c in code.co_consts if isinstance(c, CodeType) and c.co_name in IN_PLACE)
        self.repeats = (multiplies and "BUILD_LIST" in opnames) or "fromkeys" in code.co_names
        self.repeats = self.repeats or any(Listing(c, text).repeats for c in inner)

    def bound_in(self, offset: int) -> Bound:
        """Return the names that the block at an offset binds; to the end of the code where no `with` opens it."""
        bound = self._bound.get(offset)
        if bound is None:
            bound = self._bound[offset] = Bound()
            first, end = self.number_after(offset), self._end_of_block(offset)
            for instruction in self.instructions[first:]:
                if instruction.offset >= end:
                    break
                bound.calls = bound.calls or instruction.opname.startswith("CALL")
                if instruction.opname.startswith("STORE_"):
                    bound.names |= {name: None for kind, name in _named(instruction) if kind == "STORE"}
                    bound.items = bound.items or instruction.opname in ("STORE_SUBSCR", "STORE_SLICE")
                    if instruction.opname == "STORE_ATTR":
                        bound.attributes[instruction.argval] = None
            order = {name: k for k, name in enumerate(self.code.co_varnames)}
            bound.names = dict.fromkeys(sorted(bound.names, key=lambda name: order.get(name, len(order))))
        return bound

    def _end_of_block(self, offset: int) -> float:
        """Return the offset at which the handler ends that a `with` sets up."""
        k = self.number_after(offset)
        start = self.instructions[k].offset if k < len(self.instructions) else None
        handler = next((e.target for e in self.handlers if e.start == start), None)
        return max((e.end for e in self.handlers if e.target == handler), default=math.inf)

    @functools.cached_property
    def handlers(self) -> list[Any]:
        """The ranges of the code that have a handler of exceptions."""
        return list(dis.Bytecode(self.code).exception_entries)  # type: ignore[attr-defined]

    @functools.cached_property
    def numbers(self) -> dict[int, int]:
        """The number of each instruction by its offset."""
        return {instruction.offset: k for k, instruction in enumerate(self.instructions)}

    def number_after(self, offset: int) -> int:
        """Return the number of the first instruction after an offset."""
        return next((k for k, i in enumerate(self.instructions) if i.offset > offset), len(self.instructions))

    def first_read(self, offset: int, place: Place, effect: Effect | None = None) -> tuple[int, int] | None:
        """Return the offset and line where, after `offset`, the place may first be read before it is bound, or None.

        `effect` replaces the rule by which instructions read and bind the place.
        """
        effect = effect or (lambda k: self.effect_on(k, place))
        waiting, seen = [self.number_after(offset)], set[int]()
        reads: list[int] = []
        while waiting:
            k = waiting.pop()
            while k < len(self.instructions) and k not in seen:
                seen.add(k)
                instruction = self.instructions[k]
                happens = effect(k)
                if happens == "LOAD":
                    reads.append(k)
                if happens is not None or instruction.opname in _ENDS:
                    break
                if instruction.opcode in dis.hasjrel or instruction.opcode in dis.hasjabs:
                    waiting += self._targets(k, effect)
                    if re.match("JUMP_(?!IF)", instruction.opname):
                        break
                k += 1
        if not reads:
            return None
        first = self.instructions[min(reads)]
        return first.offset, self.line(first)

    def effect_on(self, k: int, place: Place) -> str | None:
        """Return the first effect of an instruction on a place, LOAD, STORE or DELETE; None without one."""
        instruction = self.instructions[k]
        if place.attribute is None:
            return next((kind for kind, name in _named(instruction) if name == place.name), None)
        uses = instruction.opname in ("LOAD_ATTR", "LOAD_METHOD", "STORE_ATTR")
        return instruction.opname.partition("_")[0] if uses and instruction.argval == place.attribute else None

    def _targets(self, k: int, effect: Effect) -> Iterator[int]:
        """Yield the targets of the jump at `k`, besides its successor.

        Python's own loops are assumed to run at least once, and the body of an `if` that binds the place to run. They
        are decided while recording, and correlated conditions must not look like a mistake.
        """
        target = self.numbers[self.instructions[k].argval]
        if self.instructions[k].opname == "FOR_ITER":
            return
        if self.instructions[target].opname == "FOR_ITER" and target < k:
            yield from (target + 1, self.numbers[self.instructions[target].argval])
            return
        body = range(k + 1, target)
        if body and self.instructions[body[-1]].opname != "JUMP_FORWARD" and any(effect(i) == "STORE" for i in body):
            return
        yield target

    def position_at(self, offset: int) -> tuple[int, int] | None:
        """Return the line and column of the text of the instruction at an offset."""
        where: Any = self.instructions[self.number_after(offset) - 1].positions
        return None if where is None else (where.lineno, where.col_offset)

    def line(self, instruction: dis.Instruction) -> int:
        """Return the line of an instruction; the function's where it has none."""
        positions = instruction.positions
        return (positions.lineno if positions is not None else None) or self.code.co_firstlineno

    def line_of_store(self, start: int, end: int, place: Place) -> int:
        """Return the line on which a block, from offset to offset, binds the place; for an item, the first store."""
        inside = [k for k, i in enumerate(self.instructions) if start < i.offset <= end]
        if place.key is not None:
            stores = [k for k in inside if self.instructions[k].opname in ("STORE_SUBSCR", "STORE_SLICE")]
        else:
            stores = [k for k in inside if self.effect_on(k, place) == "STORE"]
        return next((self.line(self.instructions[k]) for k in (*stores, *inside)), self.code.co_firstlineno)

    def returns_at(self, offset: int) -> bool:
        """Return whether Python's `return` leaves a block here; the returned object is on the stack already."""
        names = [i.opname for i in self.instructions[self.number_after(offset) :]]
        text = " ".join(names[:64])
        return re.match(r"POP_TOP (SWAP |(LOAD_CONST ){3}(PRECALL )?CALL POP_TOP )*RETURN_VALUE", text) is not None


def _named(instruction: dis.Instruction) -> Iterator[tuple[str, str]]:
    """Yield LOAD, STORE or DELETE with the name of a variable; some instructions do two of these."""
    kinds = _NAMES.findall(instruction.opname)
    if kinds:
        names = instruction.argval if isinstance(instruction.argval, tuple) else (instruction.argval,)
        yield from zip(kinds, names, strict=False)


def listing_of(code: CodeType) -> Listing:
    """Return the listing of a code object."""
    entry = origin(code)
    if entry.listing is None or entry.listing.text is not entry.text:
        tell_of_change(code)
        entry.listing = Listing(code, entry.text)
    listing: Listing = entry.listing
    return listing
