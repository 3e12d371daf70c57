"""Reverse mode: a function that computes the cotangents of its inputs from those of its outputs.

Stage: improve. The cotangent, or bar, of a value is the derivative of the result by it. The function runs forward
first, and then its statements run backwards; each adds to the bars of the values that it read:

    function f(%x) -> ($y)                  |    function f_reverse(%x, %bar_y) -> ($bar_x)
      %1 = sin %x                           |      %1 = sin %x
      store $y = %1                  ->     |      %2 = cos %x
                                            |      %3 = mul %bar_y, %2
                                            |      store $bar_x = %3

The rule of an operation is its tangent, transposed (`transposed.py`), so an operation needs no second rule (Radul et
al. 2022, You Only Linearize Once).

The backward part reads values of the forward part as follows:

- A value of the same region, or of one around it, is visible.
- A value of a branch is kept in a variable.
- A loop keeps the variables that its iterations hand on, at the start of each iteration, in arrays. Backwards, each
  iteration is computed again from these. So a loop needs a bound; `structured.py` splits long ones into two.
- Arrays that loops read go back to their earlier contents: the backward part of a store restores the element that it
  overwrote, and before an iteration is computed again, the elements that it overwrote are restored.
- A call is computed again, by the callee's own reverse function.
- A read of a table that moves gives outputs of its own (`table_reads.py`).

The bars of values that inner regions read, and those of variables, are variables themselves. The functions have to be
`prepared`: structured, with inputs by value, and arrays by reference in the entry alone. After the backward part such
an array has the contents that the forward part stored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from shpy.ir.nodes import (
    EXITS,
    Call,
    Discard,
    Function,
    If,
    Let,
    Loc,
    Loop,
    Region,
    Stmt,
    Store,
    Value,
    Variable,
)
from shpy.ir.ops import OPS
from shpy.ir.traverse import results, rewrite, variables_of, walk
from shpy.ir.types import Base, Type, vec
from shpy.passes.derivatives.activity import Activities, Activity, Moving
from shpy.passes.derivatives.linear import Live, Tangent, TangentBuilder, Zero, dense, tangent_of
from shpy.passes.derivatives.loop_state import (
    ArrayLog,
    LoopLimits,
    LoopState,
    arrays_to_restore,
    copy_array,
    free_values,
    make_loop_state,
)
from shpy.passes.derivatives.own_rules import check_linear, reverse_by_rule
from shpy.passes.derivatives.places import Place
from shpy.passes.derivatives.rounding import LineErrors, is_rounded, is_scale, rounding_error
from shpy.passes.derivatives.structured import head_of
from shpy.passes.derivatives.table_reads import Reads, TableReads
from shpy.passes.derivatives.transposed import Transposition, spread

_INT, _BOOL = vec(Base.I), vec(Base.B)


@dataclass(frozen=True)
class Reverse:
    """A reverse function. Its last outputs are a place and a bar for each of `reads`.

    Before these come the errors of `lines`, where roundings are asked for. Where a loop reads the tables, the last
    input is the number of the first of these reads that a run gives.
    """

    function: Function
    lines: tuple[Loc | None, ...]
    reads: Reads


@dataclass
class ReverseFunctions:
    """The reverse functions of a prepared module; see `forward.ForwardFunctions`.

    `rules` are the users' rules of tangents, by the functions that have one; `limits` are those of loops. With
    `rounding` a function has an output for each line more: the most by which the roundings of the operations of this
    line may change the result, to the first order. `tables` are the names of the tables that move.
    """

    functions: Callable[[str], Function]
    fresh: Callable[[str], str]
    rules: Mapping[str, Function]
    limits: LoopLimits
    rounding: bool = False
    tables: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        self.activities = Activities(self.functions, self.rules, self.tables, rounding=self.rounding)
        self._kept: dict[tuple[str, Moving], Reverse] = {}

    @property
    def callees(self) -> list[Function]:
        """The reverse functions of callees, innermost first."""
        return [reverse.function for reverse in self._kept.values()]

    def of(self, name: str, moving: Moving) -> Reverse:
        """Return the reverse function of a function by name whose inputs `moving` move."""
        key = name, moving
        if key not in self._kept:
            original, activity = self.functions(name), self.activities.of(name, moving)
            if name in self.rules:
                reverse = Reverse(self._by_rule(original, moving), (), Reads())
            else:
                reverse = _ReverseRewriter(original, activity, self, ()).run(unit=False)
            function = replace(reverse.function, name=self.fresh(f"{name}_reverse"), pure=False)
            self._kept[key] = replace(reverse, function=function)
        return self._kept[key]

    def _by_rule(self, function: Function, moving: Moving) -> Function:
        """Return the reverse function of one with a rule."""
        rule = self.rules[function.name]
        directions = [m for m, port in zip(moving, function.inputs, strict=True) if port.type.is_float]
        others = [False] * (len(rule.inputs) - len(directions))
        outputs = {v.id for v in rule.outputs}
        check_linear(rule, (*others, *[True] * len(directions)), self.activities, self.limits, outputs)
        moves = self.activities.of(rule.name, tangents := (*others, *directions)).outputs
        return reverse_by_rule(function, moving, self.of(rule.name, tangents).function, moves)

    def reversed(self, function: Function, moving: Moving, kept: Sequence[int], *, unit: bool) -> Reverse:
        """Return the reverse function, with the outputs `kept`, by position, and the bars of the inputs that move.

        The bars of the outputs that move are its last inputs; with `unit` that of the first is 1, of the others 0.
        """
        return _ReverseRewriter(function, self.activities.in_function(function, moving), self, kept).run(unit)


class _ReverseRewriter:
    """Makes the reverse of one function. `env` maps its values to those of the latest forward part."""

    def __init__(self, function: Function, activity: Activity, world: ReverseFunctions, kept: Sequence[int]) -> None:
        self.function = function
        self.activity = activity
        self.world = world
        self.kept = kept
        slots = (*function.variables, *function.outputs)
        self.b = TangentBuilder(replace(function, outputs=(), variables=slots, pure=False, tangent=None))
        self.env: dict[int, int] = {}
        self.spills: dict[int, Variable] = {}
        """The variables that keep values of branches."""
        self.slots: dict[int, Variable] = {}
        """The variables that hold the bars of values which inner regions read."""
        self.shadows: dict[int, Variable] = {}
        """The variables that hold the bars of variables."""
        self.loops: dict[int, LoopState] = {}
        self.restored = arrays_to_restore(function)
        self.overwritten: dict[int, int] = {}
        """The element that a store into such an array overwrites, by the id of the statement, as a value."""
        self.logs: dict[int, ArrayLog] = {}
        """The logs, by array, of the loop whose state is being kept."""
        self.errors = LineErrors(self.b)
        self.scales = {s.value.id for s in walk(function.body) if isinstance(s, Let) and is_scale(s)}
        self.reads = TableReads(self.b)

    def run(self, unit: bool) -> Reverse:
        """Return the reverse function."""
        b, f = self.b, self.function
        top = Place(None)
        for port in f.inputs:
            if isinstance(port, Value):
                self.env[port.id] = port.id
                top.visible.add(port.id)
                top.own.add(port.id)
        for v in variables_of(f):
            if v.id in self.activity.variables:
                self.shadows[v.id] = b.variable(v.type, v.length, _bar(v.name))
        moving = [v for v in (f.outputs[:1] if unit else f.outputs) if v.id in self.activity.variables]
        seeds = [b.const(v.type, [1] * v.type.size) if unit else b.input(v.type, _bar(v.name)) for v in moving]
        self.forward(f.body, top, keep=True)
        restored = [p for p in f.inputs if isinstance(p, Variable) and p.id in self.restored]
        contents = [(p, b.variable(p.type, p.length, p.name)) for p in restored]
        primals = [(b.output(f.outputs[k].type, f.outputs[k].name), f.outputs[k]) for k in self.kept]
        values = [p for p in f.inputs if isinstance(p, Value)]
        bars = [(p, b.output(p.type, _bar(p.name))) for p in values if p.id in self.activity.values]
        if not self._ended():  # a function that always discards has no backward part
            for slot, seed in zip(moving, seeds, strict=True):
                b.store(self.shadows[slot.id], seed)
            for output, slot in primals:
                b.store(output, b.load(slot))
            for array, stored in contents:
                copy_array(b, array, stored)
            self.backward(f.body, top)
            for array, stored in contents:
                copy_array(b, stored, array)
            for port, output in bars:
                b.store(output, dense(self.take(port.id, port.type, top)).value)
            b.outputs += self.errors.slots.values()
            b.outputs += self.reads.finish()
            around = {output.id for output, slot in primals if slot is not f.outputs[0]}
            self._poison([v for v in b.outputs if v.id not in around])
        reverse = b.finish()
        function = replace(reverse, body=rewrite(reverse.body, self._spilled))
        return Reverse(function, tuple(self.errors.slots), self.reads.reads)

    def _spilled(self, s: Stmt) -> Any:
        """Return a statement, followed by stores of its values that the backward part reads."""
        kept = [v for v in results(s) if v.id in self.spills]
        return (s, *(Store(self.spills[v.id].id, v.id) for v in kept)) if kept else s

    def _ended(self) -> bool:
        """Return whether the open region ends with an exit."""
        return bool(self.b.region) and isinstance(self.b.region[-1], EXITS)

    def _poison(self, outputs: Sequence[Variable]) -> None:
        """Make the outputs NaN where a loop took more iterations than are kept."""
        b = self.b
        for state in self.loops.values():
            if state.over is not None:
                with b.when(b.load(state.over)):
                    for slot in outputs:
                        if slot.type.is_float:
                            b.store(slot, b.const(slot.type, [float("nan")] * slot.type.size))

    # The forward part

    def forward(self, region: Region, place: Place | None, *, keep: bool) -> None:
        """Append the statements of a region, or a copy of them.

        With `keep`, its loops keep the states that the backward part of the same place needs.
        """
        b = self.b
        for s in region:
            b.loc = s.value.loc if isinstance(s, Let) else s.loc
            match s:
                case Let(value, op, args, attr):
                    copy = self._copy(value)
                    b.append(Let(copy, op, tuple(self.env[a] for a in args), attr))
                    self._enter(value, copy, place)
                case Call(name, args, outputs, loc):
                    arguments = tuple(self.env[a] for a in args)
                    copies = tuple(self._copy(v) for v in outputs)
                    b.append(Call(name, arguments, copies, loc))
                    for value, copy in zip(outputs, copies, strict=True):
                        self._enter(value, copy, place)
                case Store(variable, stored, components, index, loc):
                    at = None if index is None else self.env[index]
                    if at is not None and variable in self.logs:
                        self.logs[variable].keep(b, variable, at)
                    elif at is not None and variable in self.restored and place is not None:
                        self._keep_overwritten(s, at, place)
                    b.append(Store(variable, self.env[stored], components, at, loc))
                case If(condition, then, orelse, loc):
                    parts = []
                    for inner in (then, orelse):
                        b.push()
                        self.forward(inner, Place(place) if place else None, keep=keep)
                        parts.append(b.pop())
                    b.append(If(self.env[condition], parts[0], parts[1], loc))
                case Loop():
                    self._forward_loop(s, keep=keep)
                case _:
                    b.append(s)

    def _copy(self, value: Value) -> Value:
        """Return a value for a copy of a statement; that of the first one keeps its id."""
        return value if value.id not in self.env else self.b.value(value.type, value.name, value.loc)

    def _enter(self, value: Value, copy: Value, place: Place | None) -> None:
        self.env[value.id] = copy.id
        if place is not None:
            place.visible.add(copy.id)
            place.own.add(value.id)

    def _keep_overwritten(self, s: Store, index: int, place: Place) -> None:
        """Append a load of the element that a store overwrites."""
        b = self.b
        old = b.load(s.variable, index)
        value = self.overwritten.setdefault(id(s), old.id)
        self.env[value] = old.id
        place.visible.add(old.id)

    def _forward_loop(self, loop: Loop, *, keep: bool) -> None:
        b = self.b
        head = head_of(loop)
        state = self._state(loop) if keep else None
        if state is not None:
            state.begin(b)
            self.logs = state.logs
        b.push()
        self.forward(loop.body[:head], None, keep=False)
        if state is not None:
            state.keep(b)
        self.forward(loop.body[head:], None, keep=False)
        body = b.pop()
        b.push()
        self.forward(loop.continuing, None, keep=False)
        until = None if loop.until is None else self.env[loop.until]
        b.append(Loop(body, b.pop(), until, loop.turns, loop.loc))
        if state is not None:
            self.logs = {}

    def _state(self, loop: Loop) -> LoopState:
        """Return the slots of a loop, made once for each loop."""
        if id(loop) not in self.loops:
            self.loops[id(loop)] = make_loop_state(self.b, self.function, loop, self.restored, self.world.limits)
        return self.loops[id(loop)]

    # Values and bars

    def need(self, value: int, place: Place) -> Live:
        """Return a value of the function, where the backward part stands."""
        here, b = self.env[value], self.b
        if place.sees(here):
            return b.live(here)
        load = place.load_of(here)
        if load is None:
            if here not in self.spills:
                self.spills[here] = b.variable(b.type_of(here), None, "kept")
            load = place.loads[here] = b.load(self.spills[here]).id
        return b.live(load)

    def add(self, value: int, bar: Tangent, place: Place) -> None:
        """Add to the bar of a value."""
        if isinstance(bar, Zero) or value not in self.activity.values:
            return
        if value in place.own:
            before = place.bars.get(value)
            place.bars[value] = bar if before is None else before + bar
            return
        b = self.b
        if value not in self.slots:
            self.slots[value] = b.variable(bar.type, None, "bar")
        b.store(self.slots[value], (Live(b, b.load(self.slots[value])) + bar).value)

    def take(self, value: int, type: Type, place: Place) -> Tangent:
        """Return the bar of a value that is computed here; all its uses are behind."""
        b = self.b
        bar = place.bars.pop(value, None)
        slot = self.slots.get(value)
        if slot is not None:
            inner = Live(b, b.load(slot))
            b.store(slot, b.const(type, [0] * type.size))
            bar = inner if bar is None else inner + bar
        return Zero(b, type) if bar is None else bar

    # The backward part

    def backward(self, region: Region, place: Place) -> None:
        """Append the statements of a region backwards."""
        b = self.b
        for s in reversed(region):
            b.loc = s.value.loc if isinstance(s, Let) else s.loc
            match s:
                case Let():
                    if s.value.id in self.activity.values:
                        self._let(s, place)
                case Store():
                    if s.variable in self.shadows:
                        self._store(s, place)
                    if id(s) in self.overwritten:
                        assert s.index is not None
                        old = self.need(self.overwritten[id(s)], place)
                        b.store(s.variable, old.value, index=self.need(s.index, place).value)
                case Call():
                    bars = [self.take(r.id, r.type, place) for r in s.results if r.id in self.activity.values]
                    self._call(s.function, s.args, [r.id for r in s.results], bars, place)
                case If(condition, then, orelse, loc):
                    test = self.need(condition, place).value.id
                    parts = []
                    for inner in (then, orelse):
                        b.push()
                        self.backward(inner, Place(place, own={v.id for x in inner for v in results(x)}))
                        parts.append(b.pop())
                    if parts[0] or parts[1]:
                        b.append(If(test, parts[0], parts[1], loc))
                case Loop():
                    self._backward_loop(s, place)
                case _:
                    assert isinstance(s, Discard), "a structured function has no other exits"

    def _backward_loop(self, loop: Loop, place: Place) -> None:
        b = self.b
        state = self._state(loop)
        head = head_of(loop)
        body = (*loop.body[: max(head - 1, 0)], *loop.body[head:], *loop.continuing)
        with b.loop(turns=state.most if loop.turns is not None else None):
            state.restore(b)
            own = Place(place)
            outer = {v: self.env[v] for v in free_values(body)}
            for v in outer:
                self.env[v] = self.need(v, own).value.id
                own.visible.add(self.env[v])
            self.forward(body, own, keep=True)
            self.reads.times *= state.most
            if not self._ended():
                self.backward(body, own)
            self.reads.times //= state.most
            self.env.update(outer)

    def _store(self, s: Store, place: Place) -> None:
        b, shadow = self.b, self.shadows[s.variable]
        index = None if s.index is None else self.need(s.index, place)
        at = None if index is None else index.value
        bar: Any = Live(b, b.load(shadow, at))
        if index is not None:
            assert shadow.length is not None
            inside = (index >= 0) & (index < shadow.length)
            bar = inside.wide(bar.size).choose(bar, Zero(b, bar.type))
        if s.components is not None and shadow.type.size > 1:
            bar = bar[list(s.components)] if len(s.components) > 1 else bar[s.components[0]]
        b.store(shadow, b.const(bar.type, [0] * bar.type.size), s.components, at)
        self.add(s.value, bar, place)

    def _let(self, let: Let, place: Place) -> None:
        b = self.b
        bar = self.take(let.value.id, let.value.type, place)
        if isinstance(bar, Zero):
            return
        row = OPS.get(let.op)
        if self.world.rounding and is_rounded(let):
            error = rounding_error(let, bar, self.need(let.value.id, place), lambda a: self.need(a, place), self.scales)
            if error is not None:
                self.errors.add(let.value.loc, error)
        match let.op:
            case "load":
                self._load(let, bar, place)
            case "call":
                self._call(str(let.attr), let.args, [let.value.id], [bar], place)
            case "table":
                table = str(let.attr)
                at = self.reads.place_of(table, self.need(let.args[0], place))
                self.reads.add(table, at, dense(bar).value)
            case "const" | "param":
                pass
            case _ if row is None:
                if let.op == "component":
                    let = replace(let, args=(let.args[0], self.need(let.args[1], place).value.id))
                spread(b, let, bar, lambda a, part: self.add(a, part, place))
            case _:
                self._linear(let, bar, place)

    def _load(self, let: Let, bar: Tangent, place: Place) -> None:
        b, shadow = self.b, self.shadows[int(let.attr)]  # type: ignore[arg-type]
        if not let.args:
            b.store(shadow, (Live(b, b.load(shadow)) + bar).value)
            return
        assert shadow.length is not None
        index = self.need(let.args[0], place).op("clamp", 0, shadow.length - 1).value
        b.store(shadow, (Live(b, b.load(shadow, index)) + bar).value, index=index)

    def _call(self, name: str, args: tuple[int, ...], outputs: list[int], bars: list[Tangent], place: Place) -> None:
        """Append a call of the reverse function of a function that the forward part calls."""
        b = self.b
        if all(isinstance(bar, Zero) for bar in bars):
            return
        reverse = self.world.of(name, tuple(a in self.activity.values for a in args))
        callee = reverse.function
        values = [*args, *(outputs if name in self.world.rules else ())]
        arguments = [self.need(v, place).value.id for v in values] + [dense(bar).value.id for bar in bars]
        derived = tuple(b.value(v.type) for v in callee.outputs)
        b.append(Call(callee.name, tuple(arguments), derived, b.loc))
        moving = [a for a in args if a in self.activity.values]
        for a, v in zip(moving, derived, strict=False):
            self.add(a, Live(b, v), place)
        rest = iter(derived[len(moving) :])
        for loc in reverse.lines:
            self.errors.add(loc or b.loc, Live(b, next(rest)))
        for table in reverse.reads.tables:
            self.reads.add(table, next(rest), next(rest))

    def _linear(self, let: Let, bar: Tangent, place: Place) -> None:
        """Emit the tangent of an operation with placeholders, and transpose the statements that depend on them."""
        b = self.b
        operands = [self.need(a, place) for a in let.args]
        marks = {a: b.value(b.type_of(self.env[a])) for a in dict.fromkeys(let.args) if a in self.activity.values}
        tangents = [
            Live(b, marks[a]) if a in marks else Zero(b, x.type) for a, x in zip(let.args, operands, strict=True)
        ]
        y = self.need(let.value.id, place)
        count = len(b.region)
        tangent = tangent_of(let.op, y, operands, tangents)
        if isinstance(tangent, Zero):
            return
        transposition = Transposition(b, {v.id for v in marks.values()})
        transposition.run(b.since(count), {tangent.value.id: bar})
        for a, v in marks.items():
            self.add(a, transposition.bars.get(v.id, Zero(b, v.type)), place)


def _bar(name: str | None) -> str:
    return f"bar_{name}" if name else "bar"
