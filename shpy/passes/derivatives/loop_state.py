"""The state of a loop that reverse mode keeps, so that its iterations can run once more, the last one first.

Stage: improve; for `reverse`. It keeps the variables that iterations hand on, at the start of each iteration; those
that they only read, before the loop; and of arrays the elements that the loop overwrites, in the order of its stores:

    store $a[%i] = %x          ->      store $a_kept[$height] = $a[%i]; store $a_index[$height] = %i; $height += 1
                                       store $a[%i] = %x
"""

from __future__ import annotations

from dataclasses import dataclass

from shpy.errors import RecordError
from shpy.ir.builder import Builder
from shpy.ir.nodes import MAX_ARRAY, Break, Function, If, Let, Loop, Region, Store, Value, Variable
from shpy.ir.traverse import results, uses, variables_of, walk
from shpy.ir.types import Base, vec
from shpy.passes.liveness import live_before, stored_in

_INT, _BOOL = vec(Base.I), vec(Base.B)


@dataclass(frozen=True)
class ArrayLog:
    """The elements of an array that a loop overwrites, their indices, and how many there are.

    `starts` holds this number at the start of each iteration, `over` whether there were more than there is room for.
    """

    elements: Variable
    indices: Variable
    height: Variable
    starts: Variable
    over: Variable | None

    def keep(self, b: Builder, array: int, index: int) -> None:
        """Append statements that keep the element at an index, before it is overwritten."""
        at = b.load(self.height)
        b.store(self.elements, b.load(array, index), index=at)
        b.store(self.indices, index, index=at)
        most = b.const(_INT, [self.elements.length or 0])  # `restore` takes no more iterations
        if self.over is not None:
            with b.when(b.let("ge", at, most)):
                b.store(self.over, b.const(_BOOL, [True]))
        b.store(self.height, b.let("min", b.let("add", at, b.const(_INT, [1])), most))

    def restore(self, b: Builder, array: int, iteration: Value) -> None:
        """Append a loop that restores the elements which this iteration, the last one that is kept, overwrote."""
        low = b.load(self.starts, iteration)
        with b.loop(turns=self.elements.length):
            at = b.load(self.height)
            with b.when(b.let("le", at, low)):
                b.exit(Break)
            last = b.let("sub", at, b.const(_INT, [1]))
            b.store(array, b.load(self.elements, last), index=b.load(self.indices, last))
            b.store(self.height, last)


@dataclass(frozen=True)
class LoopState:
    """The slots of a loop: the count of iterations, the variables that change, and those that only stay, before it.

    `logs` are those of arrays that it changes; `over` holds where an element needs more room than there is.
    """

    count: Variable
    changing: dict[int, Variable]
    steady: dict[int, Variable]
    logs: dict[int, ArrayLog]
    most: int
    over: Variable | None

    def begin(self, b: Builder) -> None:
        """Append statements before the loop that keep what it only reads."""
        b.store(self.count, b.const(_INT, [0]))
        for variable, slot in self.steady.items():
            b.store(slot, b.load(variable))
        for log in self.logs.values():
            b.store(log.height, b.const(_INT, [0]))

    def keep(self, b: Builder) -> None:
        """Append statements at the start of an iteration that keep its state."""
        at = b.load(self.count)
        for variable, array in self.changing.items():
            b.store(array, b.load(variable), index=at)
        for log in self.logs.values():
            b.store(log.starts, b.load(log.height), index=at)
        b.store(self.count, b.let("add", at, b.const(_INT, [1])))
        if self.over is not None:
            with b.when(b.let("ge", at, b.const(_INT, [self.most]))):
                b.store(self.over, b.const(_BOOL, [True]))

    def restore(self, b: Builder) -> None:
        """Append statements that restore the state of the last iteration that is left; without one, leave."""
        at = b.load(self.count)
        with b.when(b.let("le", at, b.const(_INT, [0]))):
            b.exit(Break)
        last = b.let("sub", at, b.const(_INT, [1]))
        b.store(self.count, last)
        for variable, array in self.changing.items():
            b.store(variable, b.load(array, last))
        for variable, slot in self.steady.items():
            b.store(variable, b.load(slot))
        for variable, log in self.logs.items():
            log.restore(b, variable, last)


@dataclass(frozen=True)
class LoopLimits:
    """The number of iterations of a loop without a known bound, `most`, and whether the caller has forward mode too."""

    most: int | None = None
    forward: bool = True

    def cure(self, *choices: str) -> str:
        """Return a cure of these choices, and of forward mode where the caller has it."""
        return "; or ".join((*choices, 'mode="forward"') if self.forward else choices)

    def iterations(self, loop: Loop) -> int:
        """Return the most iterations of a loop; RecordError without a bound and beyond the length of an array."""
        most = loop.turns if loop.turns is not None else self.most
        if most is None:
            raise RecordError(
                "reverse mode keeps the state of each iteration, and this loop has no known bound",
                loc=loop.loc,
                cure=self.cure(
                    "SH_FOR with numbers of Python and SH_BREAK(c) in it",
                    "most=64, where elements that take more iterations give NaN",
                ),
            )
        if most > MAX_ARRAY:
            raise RecordError(
                f"reverse mode keeps the states of {most:,} iterations, and an array has at most {MAX_ARRAY:,}",
                loc=loop.loc,
                cure=self.cure("fewer iterations"),
            )
        return most

    def stores(self, region: Region, array: int) -> int:
        """Return the most stores into an array that a region runs."""
        total = 0
        for s in region:
            match s:
                case Store(variable):
                    total += variable == array
                case If(_, then, orelse):
                    total += max(self.stores(then, array), self.stores(orelse, array))
                case Loop(body, continuing):
                    inner = self.stores((*body, *continuing), array)
                    total += self.iterations(s) * inner if inner else 0
        return total


def make_loop_state(b: Builder, function: Function, loop: Loop, arrays: set[int], limits: LoopLimits) -> LoopState:
    """Return new slots for a loop of a function; `arrays` are those that have to be restored.

    Where loops without a bound may store too often into an array, there is room for as many elements as an array takes.
    Raises RecordError for a loop without a bound, with too large a one, and with too many stores into an array.
    """
    most = limits.iterations(loop)
    body = (*loop.body, *loop.continuing)
    read, stored = live_before(body), stored_in(body)
    slots = {v.id: v for v in variables_of(function)}

    def new(v: int, ending: str, length: int | None = None) -> Variable:
        return b.variable(slots[v].type, length, f"{slots[v].name or 'state'}_{ending}")

    kept = {v: new(v, "kept", most) for v in sorted(read & stored) if slots[v].length is None}
    before = {v: new(v, "before") for v in sorted(read - stored) if slots[v].length is None}
    bounded = all(s.turns is not None for s in walk((loop,)) if isinstance(s, Loop))
    over = None if bounded else b.variable(_BOOL, None, "over")
    logs: dict[int, ArrayLog] = {}
    for v in sorted(arrays):
        count = limits.stores((loop,), v)
        if count > MAX_ARRAY and bounded:
            raise RecordError(
                f"reverse mode keeps the elements of {slots[v].name or 'an array'} that this loop overwrites, up to "
                f"{count:,}, and an array has at most {MAX_ARRAY:,}",
                loc=loop.loc,
                cure=limits.cure("fewer iterations"),
            )
        if count:
            height = b.variable(_INT, None, f"{slots[v].name or 'array'}_height")
            room = min(count, MAX_ARRAY)
            logs[v] = ArrayLog(new(v, "kept", room), b.variable(_INT, room), height, b.variable(_INT, most), over)
    return LoopState(b.variable(_INT, None, "turns"), kept, before, logs, most, over)


def arrays_to_restore(function: Function) -> set[int]:
    """Return the arrays that change and that a loop reads: its iterations read earlier contents when they run again."""
    stored = {s.variable for s in walk(function.body) if isinstance(s, Store) and s.index is not None}
    loops = tuple(s for s in walk(function.body) if isinstance(s, Loop))
    return stored & {s.attr for s in walk(loops) if isinstance(s, Let) and s.op == "load" and s.args}


def free_values(body: Region) -> list[int]:
    """Return the values that statements read from outside."""
    own = {v.id for s in walk(body) for v in results(s)}
    return list(dict.fromkeys(u for s in walk(body) for u in uses(s) if u not in own))


def copy_array(b: Builder, source: Variable, target: Variable) -> None:
    """Append a loop that copies an array."""
    step = b.variable(_INT, None, "step")
    b.store(step, b.const(_INT, [0]))
    with b.loop(turns=source.length) as loop:
        at = b.load(step)
        b.store(target, b.load(source, at), index=at)
        following = b.let("add", at, b.const(_INT, [1]))
        b.store(step, following)
        loop.until(b.let("ge", following, b.const(_INT, [source.length or 0])))
