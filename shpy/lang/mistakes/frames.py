"""Find names that a block rebinds: the locals of the user's frame at a block's exit, compared with those at its entry.

Stage: record, while blocks open and close. Recording runs Python once: a name that a block rebinds keeps the block's
value, whether or not the block will run. The bytecode tells which places a function binds, so only these are compared,
and which of them are read afterwards. The text is read only for the message (`statements`).

    with SH_IF(x > 1):
        x = x - 1           # x is another object now, and `return x` reads it: RecordError
    return x

A name that is first bound inside the block, or bound again before it is read, is no mistake. The items of lists and
dicts and the attributes of objects are compared too, one level deep, also where functions bind them that the block
calls. Without text (a REPL, `exec`, a file edited since) the same mistakes are found, with more general cures.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType, FunctionType, ModuleType
from typing import Any

from shpy.errors import is_standard
from shpy.ir.nodes import Loc
from shpy.lang.mistakes import statements
from shpy.lang.mistakes.listing import Bound, Place, listing_of
from shpy.lang.mistakes.statements import DISPLAYS, NUMBERS
from shpy.lang.recording.location import called_frames, loc_in, user_frame
from shpy.lang.recording.symbolic import Symbolic

_GONE = object()


@dataclass(frozen=True, slots=True)
class Entry:
    """The state of a frame at the entry of a block: its position, and the contents of the places that it binds."""

    frame: FrameType
    offset: int
    values: dict[Place, Any]


def entered() -> list[Entry]:
    """Return the frames in which a block that opens may rebind names, the innermost first.

    They are the user's function, and where that is a generator the function that runs it, since its statements stand
    inside the block. Raises RecordError for a jump of Python's out of the block.
    """
    entries: list[Entry] = []
    for frame in called_frames():
        if is_standard(frame.f_code.co_filename):  # contextlib, which runs a generator
            continue
        listing = listing_of(frame.f_code)
        if not entries:
            statements.check_block(listing, frame)
        bound = listing.bound_in(frame.f_lasti)
        values = {p: x for p, x in _places(frame, bound) if _matters(x)}
        entries.append(Entry(frame, frame.f_lasti, values))
        if not frame.f_code.co_flags & inspect.CO_GENERATOR:
            break
    return entries


def check_left(entries: list[Entry], what: str, loc: Loc | None, loop: bool, test: Callable[[], Any] | None) -> None:
    """Raise RecordError if a block rebound a place that is read after it, or in the next iteration of its loop.

    `test` is the callable that a loop evaluates in every iteration.
    """
    for number, entry in enumerate(entries):
        frame = entry.frame
        listing, leaving = listing_of(frame.f_code), frame.f_lasti
        if not number and listing.text is None and listing.returns_at(leaving):
            raise statements.left(loc, "return", statements.spelled(what), "SH_RETURN(…)")
        if not entry.values or (number and frame not in called_frames()):
            continue
        now = dict(_places(frame, listing.bound_in(entry.offset)))
        for place, old in entry.values.items():
            new = now.get(place, _GONE)
            if not _rebound(old, new):
                continue
            use, when = listing.first_read(leaving, place), "after it"
            if loop and old is not None:
                again = listing.first_read(entry.offset, place)
                if test is not None and place.name in getattr(getattr(test, "__code__", None), "co_freevars", ()):
                    use, when = (0, test.__code__.co_firstlineno), "in its next iteration"
                elif again is not None and again[0] <= leaving:
                    use, when = again, "in its next iteration"
            if use is not None:
                where = loc_in(frame.f_code, listing.line_of_store(entry.offset, leaving, place))
                used = f"{when} (line {use[1]})"
                raise statements.rebound(what, loc, frame, where, place, (old, new), used)


# Contents of a frame


def _places(frame: FrameType, bound: Bound) -> Iterator[tuple[Place, Any]]:
    """Yield the places of a frame that some of its code binds, and what they hold."""
    names = frame.f_locals
    of_others = frame.f_code.co_cellvars + frame.f_code.co_freevars if bound.calls else ()  # inner functions bind them
    yield from ((Place(name), names[name]) for name in dict.fromkeys((*bound.names, *of_others)) if name in names)
    if bound.attributes or bound.items or bound.calls:
        for name, thing in names.items():
            yield from _parts(name, thing, bound)


def _contents(thing: Any) -> dict[str, Any]:
    """Return the values of the language that an object has as attributes, by their names."""
    slots = (slot for cls in type(thing).__mro__ for slot in cls.__dict__.get("__slots__", ()))
    inside = getattr(thing, "__dict__", {}) | {slot: getattr(thing, slot, None) for slot in slots}
    return {name: x for name, x in inside.items() if isinstance(x, Symbolic)}


def _parts(name: str, thing: Any, bound: Bound) -> Iterator[tuple[Place, Any]]:
    """Yield the items of a list or dict, and the attributes of an object, that the code may bind."""
    if type(thing) in (list, dict):
        # If the length differs, Python has filled or emptied the list: its items were not rebound.
        pairs, length = (thing.items(), None) if type(thing) is dict else (enumerate(thing), len(thing))
        if bound.items or len(thing) < 1000:  # more are the host's numbers
            yield from ((Place(name, (k, length)), x) for k, x in pairs if bound.items or isinstance(x, Symbolic))
    elif not isinstance(thing, Symbolic | ModuleType | FunctionType | type):
        inside = _contents(thing)
        if hasattr(thing, "__dict__"):
            inside |= {k: vars(thing).get(k, getattr(type(thing), k, _GONE)) for k in bound.attributes}
        yield from ((Place(name, None, k), x) for k, x in inside.items() if x is not _GONE)


def refuse_closed(value: Any, name: str | None, used: Loc | None) -> None:
    """Raise RecordError for a value that is used on a line after the block which made it, if the text shows where.

    `name` is the one that the recording gave the value, for a function that has returned.
    """
    frame = user_frame()
    if frame is not None and used == loc_in(frame.f_code, frame.f_lineno):
        everything = _places(frame, listing_of(frame.f_code).bound_in(-1))
        places = [place for place, x in everything if any(part is value for part in parts_of(x))]
    else:
        frame, places = None, [Place(name or "")]
    for place in places:
        error = statements.used_after(place, used, frame)
        if error is not None:
            raise error


def _matters(x: Any) -> bool:
    """Return whether a place with this content at the entry of a block has to be compared at its exit.

    A value of a closed block need not be, since each use of it is an error anyway.
    """
    if isinstance(x, Symbolic):
        return not any(part._frame is not None and part._frame.homes[part._variable].closed for part in parts_of(x))
    return x is None or isinstance(x, (*NUMBERS, *DISPLAYS))


def parts_of(thing: Any) -> Iterator[Any]:
    """Yield the scalars and vectors that a value, matrix or struct is made of; none for an array."""
    if not isinstance(thing, Symbolic):
        return
    if hasattr(thing, "_variable"):
        yield thing
        return
    for part in (*getattr(thing, "rows", ()), *(vars(thing)[f] for f in getattr(type(thing), "_shpy_fields", ()))):
        yield from parts_of(part)


def _holds(x: Any, depth: int = 3) -> bool:
    """Return whether this is a value, or a tuple, list or dict with one."""
    parts = () if not depth else x.values() if isinstance(x, dict) else x if isinstance(x, tuple | list) else ()
    return isinstance(x, Symbolic) or any(_holds(part, depth - 1) for part in parts)


def _rebound(old: Any, new: Any) -> bool:
    if new is old or new is _GONE:
        return False
    if isinstance(old, Symbolic) or isinstance(new, Symbolic):
        return True
    if isinstance(old, DISPLAYS):
        return isinstance(new, DISPLAYS) and (_holds(old) or _holds(new))
    return old is not None and isinstance(new, NUMBERS) and bool(new != old)
