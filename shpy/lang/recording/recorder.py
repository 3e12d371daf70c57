"""The recording under way: appends to the IR as the user's function runs.

Stage: record. A `Recording` is a program; it holds one `Frame` for each function being recorded (the program, and the
subroutines called from it, innermost last). A frame holds the region that is open, the slots, and where each was made.

    with recording("mandelbrot") as recording:   # what `sh.program` does
        ...                                      # the user's function runs; operators append Lets
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from shpy.errors import RecordError
from shpy.ir.names import free, fresh
from shpy.ir.nodes import (
    EXITS,
    MAX_LOOP_DEPTH,
    MAX_REGION_DEPTH,
    Attr,
    Call,
    Function,
    If,
    Let,
    Loc,
    Loop,
    Store,
    Value,
    Variable,
)
from shpy.ir.ops import result_type
from shpy.ir.traverse import rewrite, walk
from shpy.ir.types import Type
from shpy.lang.recording.location import here
from shpy.lang.recording.names import name_for, unpacked_name

if TYPE_CHECKING:
    from shpy.ir.nodes import Region, Stmt

_GIVEN: Final = " given"
"""Follows a given name while a param or table without one holds that name."""


class OpenRegion:
    """A region that is open or was: what `SH_IF` and the like push. `what` and `loc` are for messages."""

    __slots__ = ("chain", "closed", "depth", "loc", "loops", "sealed", "statements", "what")

    def __init__(self, what: str, loc: Loc | None, parent: OpenRegion | None, *, loop: bool = False) -> None:
        self.what = what
        self.loc = loc
        self.statements: list[Stmt] = []
        self.closed = False
        self.sealed: Loc | None = None
        self.chain: Any = None
        self.depth: int = parent.depth + 1 if parent else 0
        self.loops: int = (parent.loops if parent else 0) + loop
        if self.depth > MAX_REGION_DEPTH:
            raise RecordError(
                f"{what} is nested {self.depth} deep; {MAX_REGION_DEPTH} is the most that every target runs correctly",
                loc=loc,
                cure="move inner blocks into a function marked @sh.subroutine",
            )
        if self.loops > MAX_LOOP_DEPTH:
            raise RecordError(
                f"loops are nested {self.loops} deep; {MAX_LOOP_DEPTH} is the most that every target compiles",
                loc=loc,
                cure="fold two loops into one over their product, SH_FOR(0, n * m)",
            )


class Frame:
    """One function being recorded."""

    def __init__(self, recording: Recording, name: str, loc: Loc | None) -> None:
        self.recording = recording
        self.name = name
        self.loc = loc
        self.scopes = [OpenRegion(name, loc, None)]
        self.variables: list[Variable] = []
        self.names: dict[int, str | None] = {}
        self.spelled: dict[int, str] = {}
        self.homes: dict[int, OpenRegion] = {}
        self.blocks: list[Any] = []
        self.returned: Any = None
        self.unset: set[int] = set()
        self.waiting: list[Any] = []
        self.damage: RecordError | None = None
        self._values = 0
        self._named_at: dict[tuple[str, int, str], int] = {}

    @property
    def scope(self) -> OpenRegion:
        """The region that is open."""
        return self.scopes[-1]

    def append(self, statement: Stmt) -> None:
        """Record a statement in the open region; an error after an exit."""
        scope = self.scopes[-1]
        statements = scope.statements
        if statements and isinstance(exit := statements[-1], EXITS):
            raise RecordError(
                f"this can never run: the block was left at {exit.loc}",
                loc=here(),
                cure="put it before, or give the exit a condition, as in SH_BREAK(c)",
            )
        if scope.sealed is not None:
            raise RecordError(
                f"this follows the SH_UNTIL at {scope.sealed}, which is the last statement of its SH_DO",
                loc=here(),
                cure="put it before the SH_UNTIL; `SH_BREAK(c)` leaves a loop in the middle",
            )
        statements.append(statement)

    def new_value(self, type: Type, name: str | None = None, loc: Loc | None = None) -> Value:
        """Return a fresh value, not yet recorded."""
        self._values += 1
        return Value(self._values - 1, type, name, loc)

    def let(self, op: str, args: tuple[int, ...], type: Type | None, attr: Attr = None, loc: Loc | None = None) -> int:
        """Record `op(args)`; return the value's id."""
        assert type is not None
        id = self._values
        self._values = id + 1
        self.append(Let(Value(id, type, None, loc if loc is not None else here()), op, args, attr))
        return id

    def call(self, function: Function, args: tuple[int, ...], names: bool = False) -> list[int]:
        """Record a call of `function`; return the ids of its results, with the `names` of its outputs if asked for."""
        if function.pure:
            return [self.let("call", args, function.outputs[0].type, function.name)]
        results = tuple(self.new_value(o.type, o.name if names else None, here()) for o in function.outputs)
        self.append(Call(function.name, args, results, here()))
        return [v.id for v in results]

    def op(self, name: str, args: tuple[tuple[int, Type], ...]) -> tuple[int, Type]:
        """Record an operation of the table; return the result's id and type."""
        type = result_type(name, tuple(t for _, t in args))
        return self.let(name, tuple(value for value, _ in args), type), type

    def const(self, type: Type, attr: tuple[int, ...]) -> int:
        """Record a constant; return its id."""
        return self.let("const", (), type, attr)

    def variable(
        self, type: Type, length: int | None = None, *, name: str | None = None, loc: Loc | None = None
    ) -> int:
        """Make a variable in the open region, named `name`, or after the name that the user's line assigns."""
        loc = loc or here()
        variable = Variable(len(self.variables), type, length, None, loc)
        self.variables.append(variable)
        self.homes[variable.id] = self.scopes[-1]
        if name is None and loc is not None:
            name = name_for(loc) or unpacked_name(loc)
            if name is not None:
                # The name on a line is bound to the last object that the line makes.
                before = self._named_at.get((loc.file, loc.line, name))
                if before is not None:
                    self.names[before] = None
                self._named_at[loc.file, loc.line, name] = variable.id
        self.names[variable.id] = name
        return variable.id

    def name_parts(self, parts: dict[str, int], spelling: str = "") -> None:
        """Name the slots of one object after what the user assigns on this line: `ray_o`, `ray_d`.

        Messages spell them as the user does: `ray.o` by the `spelling` "{}.{}".
        """
        loc = here()
        name = name_for(loc)
        for part, variable in parts.items():
            alone = None if part.isdigit() else part or None  # the number of a row is not a name
            self.names[variable] = f"{name}_{part}" if name and part else name or alone
            if spelling:
                self.spelled[variable] = spelling.format(name or "x", part)

    def store(
        self, variable: int, value: int, components: tuple[int, ...] | None = None, index: int | None = None
    ) -> None:
        """Record a store."""
        self.append(Store(variable, value, components, index, here()))

    def _check_blocks(self) -> None:
        if self.damage is not None:
            raise self.damage
        for block in self.blocks:
            text = f"this {block.what} is still open at the end"
            raise RecordError(text, loc=block.loc, cure=f"with {block.what}(…):")
        for block in self.waiting:
            raise block.unopened()

    def named(self, variable: Variable) -> Variable:
        """Return the variable with its final name."""
        return Variable(variable.id, variable.type, variable.length, self.names[variable.id], variable.loc)

    def finish(self, inputs: tuple[Value | Variable, ...], outputs: tuple[int, ...], pure: bool = False) -> Function:
        """Return the recorded function; an error where a block of it was not closed as Python's `with` does it."""
        self._check_blocks()
        check_reads(self)
        ids = set(outputs) | {v.id for v in inputs if isinstance(v, Variable)}
        slots = tuple(self.named(v) for v in self.variables if v.id not in ids)
        body = tuple(self.scopes[0].statements)
        named_inputs = tuple(self.named(v) if isinstance(v, Variable) else v for v in inputs)
        results = tuple(self.named(self.variables[v]) for v in outputs)
        return Function(self.name, named_inputs, results, slots, body, pure, self.loc)


class Rank(NamedTuple):
    """The number of axes that a program needs its elements to have, and the first line that needs it."""

    axes: int
    loc: Loc | None


class Recording:
    """One program being recorded: its frames, and the params, tables and subroutines that it uses."""

    def __init__(self, name: str, loc: Loc | None) -> None:
        self.name = name
        self.functions: list[Function] = []
        self.function_names: set[str] = {name}
        self.params: dict[str, Any] = {}
        self.tables: dict[str, Any] = {}
        self.subroutines: dict[Any, Any] = {}
        self.underway: list[Any] = []
        self.rank: Rank | None = None
        self.frames = [Frame(self, name, loc)]

    def other_rank(self, axes: int, loc: Loc | None) -> Rank | None:
        """Note how many axes a line needs the elements to have; return the other number that a line needs, or None."""
        self.rank = self.rank or Rank(axes, loc)
        return None if self.rank.axes == axes else self.rank

    @property
    def frame(self) -> Frame:
        """The function that is being recorded now."""
        return self.frames[-1]

    def use(self, kind: str, declared: dict[str, Any], thing: Any) -> str:
        """Enter a param or table under a name that no other has; return the name.

        Two with one given name are an error; names that were only read off the user's assignments are numbered. So one
        of these that holds a given name already gets a number in the end, by `settled`.
        """
        name: str | None = thing.name
        for other_name, other in declared.items():
            if other is thing:
                return other_name
        if name is not None:
            if name in declared and thing.named:
                if declared[name].named or f"{name}{_GIVEN}" in declared:
                    raise RecordError(
                        f"two {kind}s are named {name!r}", loc=here(), cure=f'give one another name: name="{name}2"'
                    )
                declared[f"{name}{_GIVEN}"] = thing
                return f"{name}{_GIVEN}"
            if name not in declared:
                declared[name] = thing
                return name
        entry = free(name or kind, declared)
        declared[entry] = thing
        return entry

    def with_names(self, functions: tuple[Function, ...]) -> tuple[Function, ...]:
        """Return the recorded functions in which params and tables with a given name have that name."""
        params, tables = _assign_names(self.params), _assign_names(self.tables)
        if not (params or tables):
            return functions

        def renamed(statement: Stmt) -> Stmt:
            match statement:
                case Let(_, "param", _, str(name)) if name in params:
                    return replace(statement, attr=params[name])
                case Let(_, "table" | "table_size", _, str(name)) if name in tables:
                    return replace(statement, attr=tables[name])
            return statement

        return tuple(replace(f, body=rewrite(f.body, renamed)) for f in functions)

    def referenced(self, call: Call) -> set[int]:
        """Return the variables that a call may store."""
        inputs = next(f.inputs for f in self.functions if f.name == call.function)
        return {a for a, port in zip(call.args, inputs, strict=True) if isinstance(port, Variable)}

    def function_name(self, base: str) -> str:
        """Return a function's name that no other has."""
        return fresh(base, self.function_names)


def _assign_names(declared: dict[str, Any]) -> dict[str, str]:
    """Give each name that was given to the thing that has it, in place; return the new names by the old ones."""
    names: dict[str, str] = {}
    for key in [name for name in declared if name.endswith(_GIVEN)]:
        name = key.removesuffix(_GIVEN)
        names |= {key: name, name: free(name, {*declared, *names.values()})}
    entries = [(names.get(name, name), thing) for name, thing in declared.items()]
    if names:
        declared.clear()
        declared.update(entries)
    return names


class _Local(threading.local):
    """The recording under way in a thread."""

    recording: Recording | None = None


_local = _Local()


def current() -> Recording | None:
    """Return the recording under way in this thread, or None."""
    return _local.recording


def current_frame() -> Frame | None:
    """Return the function being recorded in this thread, or None."""
    recording = _local.recording
    return recording.frames[-1] if recording is not None else None


def is_recording() -> bool:
    """Return whether this thread records a program: then values are those of the program, and have no numbers yet."""
    return current() is not None


@contextmanager
def recording(name: str, loc: Loc | None) -> Iterator[Recording]:
    """Make a recording the current one; recordings nest (a program decorated while another is recorded)."""
    outer = current()
    _local.recording = context = Recording(name, loc)
    try:
        yield context
    finally:
        _local.recording = outer


def need_frame(what: str) -> Frame:
    """Return the function being recorded; outside a recording raise an error that names `what`."""
    frame = current_frame()
    if frame is None:
        raise RecordError(
            f"{what} works only while a program is recorded", loc=here(), cure="put it in a function under @sh.program"
        )
    return frame


def check_reads(frame: Frame) -> None:
    """Raise the error for a variable made by an empty constructor and read where no store can have reached it."""
    if frame.unset:
        _reach(frame, tuple(frame.scopes[0].statements), set(), set())


def _reach(frame: Frame, region: Region, reached: set[int], declared: set[int]) -> None:
    for statement in region:
        if isinstance(statement, Let):  # nearly always, and faster than a pattern
            variable = statement.attr if statement.op == "load" else None
            if isinstance(variable, int) and variable in frame.unset and variable not in reached:
                name = frame.spelled.get(variable) or frame.names[variable] or "this value"
                raise RecordError(
                    f"{name} is read here, but nothing can have been stored in it before",
                    loc=statement.value.loc,
                    cure=f"{name}[:] = … first, or make it with a value",
                )
            continue
        match statement:
            case Store(variable=variable) if variable in frame.unset:
                # The first store is the constructor's own zero.
                (reached.add if variable in declared else reached.discard)(variable)
                declared.add(variable)
            case Call():
                reached |= frame.recording.referenced(statement)
            case If(then=then, orelse=orelse):
                other = set(reached)
                _reach(frame, then, reached, declared)
                _reach(frame, orelse, other, declared)
                reached |= other
            case Loop(body=body, continuing=continuing):
                reached |= stores_in(body + continuing)
                for inner in walk(body + continuing):
                    if isinstance(inner, Call):
                        reached |= frame.recording.referenced(inner)
                _reach(frame, body, reached, declared)
                _reach(frame, continuing, reached, declared)


def stores_in(region: Region) -> set[int]:
    """Return the variables that some statement of the region stores."""
    return {s.variable for s in walk(region) if isinstance(s, Store)}
