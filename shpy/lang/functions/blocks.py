"""The blocks under the constructs of control flow: regions that open and close, loops, and loops that count.

Stage: record. A block is a context manager: it opens a region of the recording, and when it closes, its `finish`
appends a statement.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from types import TracebackType
from typing import Any, NoReturn

from shpy.errors import RecordError, ShpyTypeError
from shpy.ir.nodes import Break, If, Loc, Loop, Region, Stmt
from shpy.ir.types import Base, vec
from shpy.lang.mistakes import frames
from shpy.lang.mistakes.statements import alone
from shpy.lang.recording.location import here
from shpy.lang.recording.names import for_name
from shpy.lang.recording.recorder import Frame, OpenRegion, need_frame
from shpy.lang.values import arithmetic
from shpy.lang.values.coerce import Literal

_BOOL, _INT = vec(Base.B), vec(Base.I)


class _Construct(type):
    """The metaclass of blocks: a block that is created but never opened is an error at the end of its function.

    Raises ShpyTypeError for arguments that the construct does not have.
    """

    what: str

    def __call__(cls, *args: Any, **named: Any) -> Any:
        try:
            block = super().__call__(*args, **named)
        except TypeError as error:
            if error.__traceback__ is None or error.__traceback__.tb_next is not None:
                raise
            takes = ", ".join(list(inspect.signature(cls.__init__).parameters)[1:])  # type: ignore[misc]
            raise ShpyTypeError(
                f"{cls.what} takes {takes or 'nothing'}", loc=here(), cure=f"{cls.what}({takes})"
            ) from None
        block.frame.waiting.append(block)
        return block

    def __enter__(cls) -> NoReturn:
        raise RecordError(f"`{cls.what}` is not called", loc=here(), cure=f"with {cls.what}():")

    def __exit__(cls, *error: object) -> None:
        """Exist, since Python looks for it before it enters."""


class Block(metaclass=_Construct):
    """A `with SH_…` block: opens a scope on entry, closes it on exit."""

    what = "SH block"
    loop = False

    def __init__(self) -> None:
        self.frame = need_frame(self.what)
        self.loc = here()
        self.scope: OpenRegion | None = None
        self.entries: list[frames.Entry] = []
        self.test: Callable[[], Any] | None = None

    def unopened(self) -> RecordError:
        """Return the error for a block that its function never opens."""
        return alone(self.what, self.loc)

    def open(self) -> None:
        """Open the block's region."""
        frame = need_frame(self.what)
        if frame is not self.frame:
            raise RecordError(f"this {self.what} belongs to another function", loc=self.loc, cure="make it here")
        if self.scope is not None:
            raise RecordError(f"this {self.what} was opened before", loc=here(), cure="a new one for each block")
        self.scope = OpenRegion(self.what, self.loc, frame.scope, loop=self.loop)
        frame.waiting.remove(self)
        frame.scopes.append(self.scope)
        frame.blocks.append(self)
        self.entries = frames.entered()

    def close(self) -> Region:
        """Close the region; return its statements."""
        frame = self.frame
        if frame.blocks[-1:] != [self]:
            frame.damage = frame.damage or RecordError(
                f"this {self.what} ends before a block that was opened inside it",
                loc=self.loc,
                cure="end the inner block first, as nested `with` statements do",
            )
            raise frame.damage
        scope = frame.scopes.pop()
        frame.blocks.pop()
        scope.closed = True
        return tuple(scope.statements)

    def abandon(self, kind: type[BaseException]) -> None:
        """Drop the block that an exception leaves, and refuse the program if its function catches the exception.

        The program is refused later, since an error that is raised while a generator is closed does not reach the user.
        """
        frame = self.frame
        left = f"{kind.__name__} left this {self.what} before its end and was caught outside of it"
        cure = "catch it inside the block, or check before the block"
        if kind is GeneratorExit:
            left = f"the generator that opened this {self.what} was not run to its end"
            cure = "a `for` over the generator, without a `break`"
        damage = RecordError(f"{left}, so the program would lack the block", loc=self.loc, cure=cure)
        frame.damage = frame.damage or damage
        if self in frame.blocks:
            place = frame.blocks.index(self)
            del frame.blocks[place:], frame.scopes[place + 1 :]

    def finish(self, region: Region) -> None:
        """Append the block's statement."""
        raise RecordError(f"{self.what} cannot stand alone")

    def __enter__(self) -> Any:
        self.open()
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        entries, self.entries = self.entries, []
        if kind is not None:
            self.abandon(kind)
            return
        region = self.close()
        try:
            frames.check_left(entries, self.what, self.loc, self.loop, self.test)
            self.finish(region)
        except RecordError as error:
            self.frame.damage = self.frame.damage or error
            raise

    def __bool__(self) -> bool:
        raise RecordError(f"{self.what} is a block", loc=self.loc, cure=f"with {self.what}(…):")

    def __iter__(self) -> Any:
        cure = f"with {self.what}(…) as i:" if self.loop else f"with {self.what}(…):"
        raise RecordError(f"{self.what} is a block, and no iterator of Python", loc=self.loc, cure=cure)


class LoopBlock(Block):
    """A loop, whose exits and test are collected while it is open."""

    loop = True

    def __init__(self) -> None:
        super().__init__()
        self.continuing: Region = ()
        self.until: int | None = None
        self.turns: int | None = None
        self.closed_by: Loc | None = None
        self.continued: Loc | None = None
        self.continued_at = 0

    def at_test(self, record: Callable[[], int]) -> None:
        """Record the loop's continuing part with `record`, which gives the value of `until` or -1."""
        scope = OpenRegion(self.what, self.loc, self.frame.scope)
        self.frame.scopes.append(scope)
        value = record()
        self.frame.scopes.pop()
        scope.closed = True
        self.continuing = tuple(scope.statements)
        self.until = value if value >= 0 else None

    def finish(self, region: Region) -> None:
        """Append the Loop."""
        self.frame.append(Loop(region, self.continuing, self.until, self.turns, self.loc))


class CountedLoop(LoopBlock):
    """A loop over a range of numbers: SH_FOR, and loops over the elements of an array."""

    what = "SH_FOR"

    def __init__(self, start: Any, stop: Any, step: Any, trip_count: Callable[..., Any] | None = None) -> None:
        """Take the range, and for bounds that only the run knows what computes the number of iterations as a u."""
        super().__init__()
        bounds = [arithmetic.operand(b, "SH_FOR") for b in (start, stop, step)]
        for b in bounds:
            if b.size != 1 or (b.weak != "int" if isinstance(b, Literal) else b.base is not Base.I):
                raise ShpyTypeError("SH_FOR counts with ints of type i", loc=self.loc, cure="SH_FOR(sh.Attrib1i(n))")
        constants = [b.components[0] if isinstance(b, Literal) else None for b in bounds]
        if constants[2] == 0:
            raise RecordError("SH_FOR with a step of 0 never ends", loc=self.loc, cure="another step")
        name = for_name(self.loc)
        self.name = name or "i"
        self.first = arithmetic.read(self.frame, bounds[0], _INT)
        self.last = arithmetic.read(self.frame, bounds[1], _INT)
        self.step = arithmetic.read(self.frame, bounds[2], _INT)
        first, _, by = constants
        if first is not None and constants[1] is not None and by is not None:
            self.turns = len(range(first, constants[1], by))
        # The last iteration's i + step must not wrap: with a step of one it cannot, with known bounds it is computed.
        simple = by in (1, -1) or (self.turns is not None and abs((first or 0) + self.turns * (by or 0)) < 2**31)
        self.down = constants[2] is not None and constants[2] < 0
        self.trips: int | None = None
        if not simple:
            assert trip_count is not None
            handles = (self.first, self.last, self.step)
            trips = trip_count(*(arithmetic.make_value("Attrib", _INT, self.frame, h) for h in handles))
            self.trips = int(trips._read(self.frame))

    def __enter__(self) -> Any:
        frame, loc = self.frame, self.loc
        unsigned = vec(Base.U)
        kind, begin = (_INT, self.first) if self.trips is None else (unsigned, frame.const(unsigned, (0,)))
        counter = frame.variable(kind, name=self.name, loc=loc)
        frame.store(counter, begin)
        self.open()
        now = frame.let("load", (), kind, counter)
        compare = "lt" if self.trips is not None else "gt" if self.down else "lt"
        more = frame.let(compare, (now, self.last if self.trips is None else self.trips), _BOOL)
        leave(frame, negated(frame, more), Break(loc), loc)
        index = frame.let("load", (), kind, counter)
        if self.trips is not None:
            signed = frame.let("convert", (index,), _INT)
            index = frame.let("add", (self.first, frame.let("mul", (signed, self.step), _INT)), _INT)
        i = arithmetic.make_value("Attrib", _INT, frame, index)
        frame.names[i._variable] = self.name
        self._advance(counter, kind)
        return i

    def _advance(self, counter: int, kind: Any) -> None:
        frame = self.frame

        def record() -> int:
            now = frame.let("load", (), kind, counter)
            by = self.step if self.trips is None else frame.const(kind, (1,))
            frame.store(counter, frame.let("add", (now, by), kind))
            return -1

        self.at_test(record)


def negated(frame: Frame, value: int) -> int:
    """Record the negation of a bool."""
    return frame.let("not", (value,), _BOOL)


def leave(frame: Frame, value: int, exit: Stmt, loc: Loc | None) -> None:
    """Record an exit under a condition."""
    frame.append(If(value, (exit,), (), loc))
