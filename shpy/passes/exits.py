"""Make the ends of an element explicit: loop limits and discards become Returns with a status.

Stage: improve, after inlining. Afterwards there is no Discard: a backend sees only Return.

    loop {                         |   store $iterations = 0
      ...                          |   loop {
    }                              |     %1 = add $iterations, 1
                                   |     store $iterations = %1
                                   |     if gt %1, 1048576 { store $status = 2; return }
                              ->   |     ...
                                   |   }
    if %c { discard }              |   if %c { store $status = 0; return }
    call f(%x)                     |   call f(%x, $status)
                                   |   if ne $status, 1 { return }

The entry gets a last output, `status`. A function that may end the element takes the status by reference, or, with
`by_value`, returns a status as its last result. A module in which nothing ends an element early gets no status. With
`loop_flags`, for devices that stop long loops on their own, each loop sets `$ended` when it finishes; where the flag is
not set after the loop, the status becomes DEVICE_STOPPED.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from shpy.ir.builder import Builder
from shpy.ir.nodes import (
    Break,
    Call,
    Discard,
    Function,
    If,
    Let,
    Loc,
    Loop,
    Module,
    Region,
    Return,
    Status,
    Stmt,
    Store,
    Value,
    Variable,
)
from shpy.ir.traverse import callee_of, limited_loops, loops, test_length, variables_of, walk
from shpy.ir.types import Base, vec
from shpy.passes.continuing import without_continuing

DEVICE_TURNS = 65_535
"""The total of iterations after which Mesa's llvmpipe silently stops the loops of an invocation."""

_INT, _BOOL = vec(Base.I), vec(Base.B)


@dataclass(frozen=True, slots=True)
class Ending:
    """A module whose exits are explicit.

    With `status` its entry's last output says how an element ended. `loops` are the lines of the limited loops:
    status FIRST_LOOP + k stands for the k-th. If none is limited, they are the lines of all loops if the device may
    stop one. With `flagged` each loop sets a flag when it finishes, and a printer has to keep the target's compiler
    from concluding that the flag is always set.
    """

    module: Module
    status: bool
    loops: tuple[Loc | None, ...]
    flagged: bool


def make_exits_explicit(
    module: Module, loop_limit: int | None = 1_048_576, *, loop_flags: bool = False, by_value: bool = False
) -> Ending:
    """Return the module with its exits explicit.

    A loop without a known bound may take `loop_limit` iterations each time it is entered; None sets no limit.
    """
    limited = limited_loops(module) if loop_limit is not None else ()
    flags = loop_flags and may_be_stopped(module)
    plan = _ExitPlan(module, {id(loop): k for k, loop in enumerate(limited)}, loop_limit or 0, flags, by_value)
    functions = tuple(_ExitRewriter(f, plan).run() if f.name in plan.ending else f for f in module.functions)
    has_status = module.entry.name in plan.ending
    told = limited or (loops(module) if flags else ())
    return Ending(replace(module, functions=functions), has_status, tuple(loop.loc for loop in told), flags)


def few_turns(module: Module) -> bool:
    """Return whether every element takes fewer iterations in all than DEVICE_TURNS."""
    return _most_iterations(module, printed=False) < DEVICE_TURNS


def may_be_stopped(module: Module) -> bool:
    """Return whether a device that stops loops after DEVICE_TURNS iterations in all may stop one of these.

    The count includes the loops that the GLSL printer may add: one of one iteration around the body of a function, and
    one over the elements of an array at its declaration and at each store.
    """
    return _most_iterations(module, printed=True) >= DEVICE_TURNS


def _most_iterations(module: Module, *, printed: bool) -> float:
    """Return the largest number of iterations of an element, infinity if there is no known bound.

    Both branches of an If count, since elements that run together and diverge take the iterations of both.
    """
    totals: dict[str, float] = {}

    def total(region: Region, lengths: dict[int, int]) -> float:
        iterations = 0.0
        for s in region:
            if isinstance(s, If):
                iterations += total(s.then, lengths) + total(s.orelse, lengths)
            elif isinstance(s, Loop):
                inside = 1 + total(s.body, lengths) + total(s.continuing, lengths)
                # The device also counts the iteration in which a loop ends, and the inner loops in it.
                iterations += float("inf") if s.turns is None else (s.turns + printed) * inside
            elif isinstance(s, Store):
                iterations += lengths.get(s.variable, 0)
            else:
                callee = callee_of(s)
                iterations += 0 if callee is None else totals[callee]
        return iterations

    for function in module.functions:
        lengths = {v.id: v.length + 1 for v in variables_of(function) if printed and v.length is not None}
        added = (not function.pure) + sum(lengths.values()) if printed else 0
        totals[function.name] = total(function.body, lengths) + added
    return totals[module.entry.name]


class _ExitPlan:
    """Facts about a module. `ending`: the names of the functions that may end the element."""

    def __init__(self, module: Module, limited: dict[int, int], limit: int, flags: bool, by_value: bool) -> None:
        self.entry = module.entry
        self.limited = limited
        self.limit = limit
        self.flags = flags
        self.by_value = by_value
        self.functions = {f.name: f for f in module.functions}
        self.ending: set[str] = set()
        for function in module.functions:
            if any(self.ends(s) for s in walk(function.body)):
                self.ending.add(function.name)

    def flagged(self, loop: Loop) -> bool:
        """Return whether the loop has a flag; a loop of at most one iteration needs none."""
        return self.flags and loop.turns not in (0, 1)

    def ends(self, s: Stmt) -> bool:
        """Return whether a statement may end the element."""
        if isinstance(s, Loop):
            return self.flagged(s) or id(s) in self.limited
        return isinstance(s, Discard) or (isinstance(s, Call) and s.function in self.ending)


class _ExitRewriter:
    """Rewrites one function that may end the element. `ended`: the flag of the innermost loop."""

    def __init__(self, function: Function, plan: _ExitPlan) -> None:
        self.plan = plan
        self.function = function
        self.b = Builder(function=function)
        self.gives = function is plan.entry or plan.by_value
        self.status = (self.b.output if self.gives else self.b.reference)(_INT, "status")

    def run(self) -> Function:
        """Return the function with its exits explicit."""
        if self.gives:
            self.b.loc = self.function.loc
            self._set_status(Status.WRITTEN)
        self.b.extend(self._region(self.function.body, None))
        return self.b.finish()

    def _number(self, number: int) -> Value:
        return self.b.const(_INT, [number])

    def _flag(self, flag: Variable, value: bool) -> None:
        self.b.store(flag, self.b.const(_BOOL, [value]))

    def _set_status(self, status: int) -> None:
        self.b.store(self.status, self._number(status))

    def _end(self, status: int) -> None:
        self._set_status(status)
        self.b.exit(Return)

    def _region(self, region: Region, ended: Variable | None) -> Region:
        self.b.push()
        for statement in region:
            self._statement(statement, ended)
        return self.b.pop()

    def _statement(self, s: Stmt, ended: Variable | None) -> None:
        if isinstance(s, Let):  # nearly always, and faster than a pattern
            self.b.append(s)
            return
        self.b.loc = s.loc
        match s:
            case Discard(status):
                self._end(status)
            case Break() if ended is not None:
                self._flag(ended, True)
                self.b.append(s)
            case If(condition, then, orelse, loc):
                self.b.append(If(condition, self._region(then, ended), self._region(orelse, ended), loc))
            case Loop():
                self._loop(s)
            case Call(name) if name in self.plan.ending:
                self._call(s)
                with self.b.when(self.b.let("ne", self.b.load(self.status), self._number(Status.WRITTEN))):
                    self.b.exit(Return)
            case _:
                self.b.append(s)

    def _call(self, s: Call) -> None:
        """Rewrite a call that may end the element; the statements after it test the status."""
        if not self.plan.by_value:
            self.b.append(replace(s, args=(*s.args, self.status.id)))
            return
        result = self.b.value(_INT, "status")
        self.b.append(replace(s, results=(*s.results, result)))
        self.b.store(self.status, result)

    def _loop(self, loop: Loop) -> None:
        b = self.b
        number = self.plan.limited.get(id(loop))
        if any(self.plan.ends(s) for s in walk(loop.continuing)):
            loop = without_continuing(b, loop)
        ended = b.variable(_BOOL, name="ended") if self.plan.flagged(loop) else None
        if ended is not None:
            self._flag(ended, False)
        budget: Region = ()
        if number is not None:
            iterations = b.variable(_INT, name="iterations")
            b.store(iterations, self._number(0))
            budget = self._budget(iterations, Status.FIRST_LOOP + number, flagged=ended is not None)
        head = test_length(loop.body)
        body = self._region(loop.body[:head], ended) + budget + self._region(loop.body[head:], ended)
        continuing = self._region(loop.continuing, ended)
        if ended is not None and loop.until is not None:
            continuing = (*continuing, Store(ended.id, loop.until))
        b.append(Loop(body, continuing, loop.until, loop.turns, loop.loc))
        if ended is None:
            return
        b.loc = loop.loc
        with b.when(b.let("not", b.load(ended))):
            if number is None:
                self._set_status(Status.DEVICE_STOPPED)
            else:
                # Do not test for WRITTEN: a store in a loop that the device stopped may be lost.
                with b.when(b.let("ne", b.load(self.status), self._number(Status.FIRST_LOOP + number))):
                    self._set_status(Status.DEVICE_STOPPED)
            b.exit(Return)

    def _budget(self, iterations: Variable, status: int, *, flagged: bool) -> Region:
        """Return statements that count an iteration and end the element at the first one past the limit.

        A loop with a flag is left by a Break that does not set the flag. On devices with flags that is cheaper than a
        Return. It also shows their compilers that the statements after the loop are not reached through
        `ended = true` alone.
        """
        b = self.b
        b.push()
        b.store(iterations, b.let("add", b.load(iterations), self._number(1)))
        with b.when(b.let("gt", b.load(iterations), self._number(self.plan.limit))):
            self._set_status(status)
            b.exit(Break if flagged else Return)
        return b.pop()
