"""Differences between neighbouring elements: dFdx and dFdy.

Stage: record. Elements form quads of two rows and two columns. The difference is taken between the two elements of a
quad that stand beside each other, so both get the same. No element sees another one's values, so the other's value is
computed again: the statements that the value follows from become a function of the element's index, called with the
neighbour's.

    x = sh.grid_index(2)[1] * 0.5
    d = sh.dFdx(x * x)

    fn d_beside(index) { … }                     # x * x of the element at index
    beside = d_beside(row, column ^ 1)
    d = column is odd ? x * x - beside : beside - x * x
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from shpy.errors import RecordError, ShpyTypeError
from shpy.ir.nodes import Call, Discard, Function, Let, Region, Return, Stmt, Store, Variable
from shpy.ir.traverse import callee_of, calls_of, is_straight, results, rewrite, uses, walk
from shpy.ir.types import INTS, Base, Type, vec
from shpy.lang.recording.location import here
from shpy.lang.recording.recorder import Frame, need_frame
from shpy.lang.values import arithmetic
from shpy.lang.values.builtins import cond, grid_index
from shpy.lang.values.value import CLASSES, Value


def dFdx(x: Any) -> Any:
    """Return the difference of x along the columns: at the odd column of a pair minus at the even one.

    Columns 2 k and 2 k + 1 are a pair, along the last axis of the elements' shape; both get the same. x is of floats
    and follows from `sh.grid_index`, Params, Tables and Textures; in strict mode the result has the bits of a
    difference of the two elements' own values. Where the other element lies outside of the grid, past an odd number of
    columns, x is computed there all the same, and a Table gives its nearest element. Statements that end an element
    before (SH_DISCARD, SH_RETURN) do not count for the other one. Computes x twice.

    Raises RecordError where there is no neighbour: x does not depend on `sh.grid_index`, or depends on an input, which
    is known for this element alone; and inside of a block or a subroutine.
    """
    return _difference(x, "sh.dFdx", 1)


def dFdy(x: Any) -> Any:
    """Return the difference of x along the rows: at the odd row of a pair minus at the even one.

    Rows lie along the last axis but one of the elements' shape, which needs two axes; all else is as with `dFdx`.
    """
    return _difference(x, "sh.dFdy", 2)


def _difference(x: Any, what: str, axis: int) -> Any:
    frame = need_frame(what)
    _check_place(frame, what)
    own = _floats(x, what)
    beside, rank = _Slice(frame, what).of(own._read(frame), own.type)
    if rank < axis:
        raise RecordError(
            f"{what} takes rows, and the elements have one axis: no element has a neighbour above or below",
            loc=here(),
            cure="sh.dFdx(x), or a program over two axes, with sh.grid_index(2)",
        )
    index = grid_index(rank)
    places = list(index) if rank > 1 else [index]
    place = places[-axis]
    places[-axis] = place ^ 1
    (result,) = frame.call(beside, (CLASSES["Attrib", rank, Base.I](*places)._read(frame),))
    other = arithmetic.make_value(own.kind, own.type, frame, result)
    return cond((place & 1) == 1, own - other, other - own)


def _check_place(frame: Frame, what: str) -> None:
    inside = f"a block, {frame.scopes[-1].what}" if len(frame.scopes) > 1 else None
    if len(frame.recording.frames) > 1:
        inside = f"the subroutine {frame.name}"
    if inside is not None:
        raise RecordError(
            f"{what} inside {inside}: the neighbour may not come there",
            loc=here(),
            cure=f"d = {what}(x) before it, in the body of the program",
        )


def _floats(x: Any, what: str) -> Any:
    operand = arithmetic.operand(x, what)
    if not isinstance(operand, Value):
        raise _no_neighbour(f"{what} of a constant")
    if operand.type.is_bool:
        raise ShpyTypeError(f"{what} takes floats, not bools", loc=here(), cure=f"{what}(sh.cond(c, 1.0, 0.0))")
    base = Base.F if operand.base in INTS else operand.base
    return CLASSES[operand.kind, operand.size, base](operand)


def _no_neighbour(what: str, cure: str = "a value that is computed from sh.grid_index(2)") -> RecordError:
    return RecordError(f"{what}: no element has a neighbour there", loc=here(), cure=cure)


class _Slice:
    """The statements of a frame that a value is computed from, gathered from the last to the first."""

    def __init__(self, frame: Frame, what: str) -> None:
        self.frame = frame
        self.what = what
        self.callees = {f.name: f for f in frame.recording.functions}
        self.values: set[int] = set()
        self.live: set[int] = set()
        """The variables that a kept statement reads, and that no statement kept so far stores whole before that."""
        self.slots: set[int] = set()

    def of(self, value: int, type: Type) -> tuple[Function, int]:
        """Return the value as a function of the element's index, and the rank of the index."""
        frame = self.frame
        self.values.add(value)
        kept = tuple(reversed([s for s in reversed(frame.scopes[0].statements) if self._keeps(s)]))
        self._check(kept)
        ranks = [s.value.type.size for s in walk(kept) if isinstance(s, Let) and s.op == "grid_index"]
        if not ranks:
            raise _no_neighbour(f"{self.what} of a value that does not depend on sh.grid_index")
        loc = here()
        parameter = frame.new_value(vec(Base.I, ranks[0]), "index", loc)
        index = Variable(len(frame.variables), parameter.type, None, "index", loc)
        result = Variable(index.id + 1, type, None, "result", loc)

        def with_index(s: Stmt) -> Stmt:
            if isinstance(s, Let) and s.op == "grid_index":
                return replace(s, op="load", attr=index.id)
            return s

        body = (
            Store(index.id, parameter.id, None, None, loc),
            *rewrite(kept, with_index),
            Store(result.id, value, None, None, loc),
        )
        slots = (*(frame.named(v) for v in frame.variables if v.id in self.slots), index)
        name = frame.recording.function_name("beside")
        function = Function(name, (parameter,), (result,), slots, body, is_straight(body), loc)
        frame.recording.functions.append(function)
        return function, ranks[0]

    def _keeps(self, s: Stmt) -> bool:
        """Return whether the value follows from the statement; what it reads is needed then too."""
        changed = self._changed(s)
        if not any(v.id in self.values for v in results(s)) and not changed & self.live:
            return False
        if isinstance(s, Store) and s.components is None and s.index is None:
            self.live -= changed
        for inner in walk((s,)):
            self.values.update(uses(inner, self.callees))
            read = self._changed(inner) if isinstance(inner, Call) else set()
            if isinstance(inner, Let) and inner.op == "load" and isinstance(inner.attr, int):
                read.add(inner.attr)
            self.live |= read
            self.slots |= read | self._changed(inner)
        return True

    def _changed(self, s: Stmt) -> set[int]:
        """Return the variables that a statement, or one inside it, may store."""
        stored = {inner.variable for inner in walk((s,)) if isinstance(inner, Store)}
        calls = (inner for inner in walk((s,)) if isinstance(inner, Call))
        return stored.union(*(self.frame.recording.referenced(call) for call in calls))

    def _check(self, kept: Region) -> None:
        """Raise RecordError where a neighbour's value cannot be computed."""
        ids = {v.id for s in walk(kept) for v in results(s)}
        for s in walk(kept):
            if isinstance(s, Store) and s.value not in ids:
                name = self.frame.names[s.variable]
                raise _no_neighbour(
                    f"{self.what} of a value that depends on the input {name}, which is known for this element alone",
                    f"{name}: sh.Table[…, 2] as the input, read at sh.grid_index(2)",
                )
            if isinstance(s, Return | Discard):
                raise RecordError(
                    f"{self.what} of a value that is stored where the element may end (line {_line(s)})",
                    loc=here(),
                    cure="SH_DISCARD(c) or SH_RETURN(value, c) outside of the block that computes the value",
                )
            called = callee_of(s)
            if called is not None and self._asks(called):
                raise RecordError(
                    f"{self.what} of a value that {called} computes, which asks for the index of this element",
                    loc=here(),
                    cure=f"sh.grid_index outside, and the index as an argument of {called}",
                )

    def _asks(self, name: str) -> bool:
        """Return whether a function, or one that it calls, reads grid_index."""
        function = self.callees[name]
        own = any(isinstance(s, Let) and s.op == "grid_index" for s in walk(function.body))
        return own or any(map(self._asks, calls_of(function)))


def _line(s: Return | Discard) -> int | None:
    return s.loc.line if s.loc is not None else None
