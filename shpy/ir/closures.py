"""Compile the functions of a module into closures, for the interpreter.

Stage: represent. It takes functions and the dtypes of the bases, and returns for each a `CompiledFunction`: a frame to
copy and a body to call on it. A frame is a list of the `Run`, the values and the variables, in this order. A step
executes one statement on a frame and returns how control leaves it.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyTypeError
from shpy.ir import meaning
from shpy.ir.constants import decode
from shpy.ir.nodes import (
    Break,
    Call,
    Continue,
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
from shpy.ir.ops import OPS
from shpy.ir.traverse import defined, test_length, variables_of
from shpy.ir.types import Base, Type

Array = NDArray[Any]
Trace = Callable[[Loc | None, str, Any, tuple[int, ...]], None]
"""Called with the line, the name and the new value of each named value and of each variable that is stored into, and
with the iterations of the loops around it, counted from 1, the outermost loop first."""

LaneOracle = Callable[[], bool]
"""Simulates other lanes: returns `any_lane(c)` where c is false in this lane, or `all_lanes(c)` where c is true."""

Frame = list[Any]
Step = Callable[[Frame], int | None]
"""Executes a statement; returns how control leaves it: _NEXT (or None), _BREAK, _CONTINUE or _RETURN."""

_NEXT, _BREAK, _CONTINUE, _RETURN = range(4)


def _selected(c: Any, a: Any, b: Any) -> Any:
    return (a if c else b) if c.ndim == 0 else np.where(c, a, b)


_OPERATORS: dict[str, Callable[..., Any]] = {
    "add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv, "sqrt": np.sqrt,
    "neg": operator.neg, "and": operator.and_, "or": operator.or_, "xor": operator.xor, "not": operator.invert,
    "eq": operator.eq, "ne": operator.ne, "lt": operator.lt, "le": operator.le, "gt": operator.gt, "ge": operator.ge,
    "cond": _selected,
}  # fmt: skip
"""Operators of Python with the results of the op table's meanings, but for the arithmetic of binary16.

Of numpy's scalars they take a tenth of the time of functions of arrays.
"""


class Ended(Exception):
    """The element has ended with this status."""

    def __init__(self, status: int) -> None:
        super().__init__(status)
        self.status = status


@dataclass(slots=True)
class Run:
    """The state of one run; item 0 of each frame holds it."""

    params: dict[str, Any]
    tables: dict[str, Array]
    index: tuple[int, ...]
    shape: tuple[int, ...]
    trace: Trace | None
    oracle: LaneOracle | None
    iterations: tuple[int, ...] = ()
    """The iteration number of each running loop, the outermost first; only traced runs count them."""

    def note(self, loc: Loc | None, name: str, value: Any) -> None:
        """Call the trace, if there is one."""
        if self.trace is not None:
            self.trace(loc, name, value, self.iterations)


@dataclass(slots=True)
class CompiledFunction:
    """A compiled function: `blank` is its initial frame; `arrays` are the places of arrays, created for each run."""

    function: Function
    places: dict[int, int]
    slots: dict[int, int]
    blank: Frame
    arrays: list[tuple[int, tuple[int, ...], Any]] = field(default_factory=list)
    body: Step = lambda frame: _NEXT

    def frame(self, run: Run) -> Frame:
        """Return a new frame with variables zero and values unset."""
        frame = self.blank.copy()
        frame[0] = run
        for place, shape, dtype in self.arrays:
            frame[place] = np.zeros(shape, dtype)
        return frame

    def run(self, frame: Frame) -> int:
        """Run over a frame; return the status with which the element ended, WRITTEN if it was not ended early."""
        with np.errstate(all="ignore"):
            try:
                self.body(frame)
            except Ended as ended:
                return ended.status
        return Status.WRITTEN


class Compiler:
    """Compiles the functions of a module to closures, callees first."""

    def __init__(self, module: Module, dtypes: Mapping[Base, Any], limit: int | None, traced: bool) -> None:
        self.dtypes = dtypes
        self.limit = limit
        self.traced = traced
        self.limited = 0
        self.functions: dict[str, CompiledFunction] = {}
        for function in module.functions:
            self.entry = self.function(function)
            self.functions[function.name] = self.entry

    def function(self, function: Function) -> CompiledFunction:
        """Compile one function, after the functions that it calls."""
        values, slots = list(defined(function)), list(variables_of(function))
        self.places = {value.id: n for n, value in enumerate(values, 1)}
        self.slots = {slot.id: n for n, slot in enumerate(slots, 1 + len(values))}
        self.variables = {slot.id: slot for slot in slots}
        blank: Frame = [None] * (1 + len(values) + len(slots))
        result = CompiledFunction(function, self.places, self.slots, blank)
        references = {port.id for port in function.inputs if isinstance(port, Variable)}
        for slot in slots:
            place, dtype = self.slots[slot.id], self.dtypes[slot.type.base]
            inner = (slot.type.size,) if slot.type.size > 1 else ()
            if slot.length is None:
                blank[place] = np.zeros(inner, dtype)[()]
            elif slot.id not in references:
                result.arrays.append((place, (slot.length, *inner), dtype))
        result.body = self.region(function.body)
        return result

    def region(self, region: Region) -> Step:
        """Return one step that runs the statements in order until one leaves the region."""
        steps = tuple(map(self.statement, region))

        def run(frame: Frame) -> int | None:
            for step in steps:
                left = step(frame)
                if left:
                    return left
            return _NEXT

        return steps[0] if len(steps) == 1 else run

    def statement(self, statement: Stmt) -> Step:
        """Return the step of one statement."""
        match statement:
            case Let():
                return self.let(statement)
            case Store():
                return self.store(statement)
            case Call(name, args, results):
                return self.call(name, args, results)
            case If(condition, then, orelse):
                return self.branch(self.places[condition], self.region(then), self.region(orelse))
            case Loop():
                return self.loop(statement)
            case Break():
                return lambda frame: _BREAK
            case Continue():
                return lambda frame: _CONTINUE
            case Return():
                return lambda frame: _RETURN
            case Discard(status):
                return self.end(status)

    @staticmethod
    def end(status: int) -> Step:
        """Return the step of a Discard, which ends the element with `status`."""

        def run(frame: Frame) -> int:
            raise Ended(status)

        return run

    @staticmethod
    def branch(condition: int, then: Step, orelse: Step) -> Step:
        """Return the step of an If."""
        return lambda frame: then(frame) if frame[condition] else orelse(frame)

    def loop(self, loop: Loop) -> Step:
        """Return the step of a Loop, which counts its iterations if it is limited."""
        limit = self.limit if loop.turns is None else None
        status = Status.FIRST_LOOP + self.limited
        self.limited += loop.turns is None
        head = 0 if limit is None else test_length(loop.body)
        test, body = self.region(loop.body[:head]), self.region(loop.body[head:])
        if self.traced:
            test, body = (_counted(test), body) if head else (test, _counted(body))
        continuing = self.region(loop.continuing)
        until = 0 if loop.until is None else self.places[loop.until]

        def run(frame: Frame) -> int:
            iterations = 0
            while True:
                if head and test(frame) == _BREAK:
                    return _NEXT
                if iterations == limit:
                    raise Ended(status)
                iterations += 1
                left = body(frame)
                if left == _BREAK:
                    return _NEXT
                if left == _RETURN:
                    return _RETURN
                continuing(frame)
                if until and frame[until]:
                    return _NEXT

        return _nested(run) if self.traced else run

    # Statements

    def let(self, let: Let) -> Step:
        """Return the step of a Let, which calls the trace for a named value in a traced run."""
        place = self.places[let.value.id]
        compute = self.operation(let, [self.places[a] for a in let.args])
        name, loc = let.value.name, let.value.loc
        if name is None or not self.traced:

            def run(frame: Frame) -> None:
                frame[place] = compute(frame)

            return run

        def run_traced(frame: Frame) -> None:
            frame[place] = value = compute(frame)
            frame[0].note(loc, name, value)

        return run_traced

    def store(self, store: Store) -> Step:
        """Return the step of a Store."""
        slot, value = self.slots[store.variable], self.places[store.value]
        picked = None if store.components is None else list(store.components)
        variable = self.variables[store.variable]
        if store.index is not None:
            return self.store_element(store, variable, self.places[store.index], picked)

        def whole(frame: Frame) -> None:
            frame[slot] = frame[value]

        def some(frame: Frame) -> None:
            changed = frame[slot].copy()  # earlier loads keep their components
            changed[picked] = frame[value]
            frame[slot] = changed

        run = whole if picked is None else some
        name, loc = variable.name, store.loc
        if name is None or not self.traced:
            return run

        def traced(frame: Frame) -> None:
            run(frame)
            frame[0].note(loc, name, frame[slot])

        return traced

    def store_element(self, store: Store, variable: Variable, index: int, picked: list[int] | None) -> Step:
        """Return the step of a store into an array, which has no effect if the index is out of range."""
        slot, value, length = self.slots[store.variable], self.places[store.value], variable.length or 0
        name, loc = variable.name if self.traced else None, store.loc

        def run(frame: Frame) -> None:
            n = int(frame[index])
            if not 0 <= n < length:
                return
            if picked is None:
                frame[slot][n] = frame[value]
            else:
                frame[slot][n, picked] = frame[value]
            if name is not None:
                frame[0].note(loc, f"{name}[{n}]", frame[slot][n].copy())

        return run

    def call(self, name: str, args: tuple[int, ...], results: tuple[Value, ...]) -> Step:
        """Return the step of a Call; references are copied in and out, since a call passes no variable twice."""
        callee = self.functions[name]
        ports = callee.function.inputs
        into: list[tuple[int, int]] = []
        back: list[tuple[int, int]] = []
        for port, arg in zip(ports, args, strict=True):
            if isinstance(port, Variable):
                into.append((callee.slots[port.id], self.slots[arg]))
                back.append((self.slots[arg], callee.slots[port.id]))
            else:
                into.append((callee.places[port.id], self.places[arg]))
        for value, output in zip(results, callee.function.outputs, strict=True):
            back.append((self.places[value.id], callee.slots[output.id]))

        def run(frame: Frame) -> None:
            inner = callee.frame(frame[0])
            for there, here in into:
                inner[there] = frame[here]
            callee.body(inner)
            for here, there in back:
                frame[here] = inner[there]

        return run

    # Operations

    def operation(self, let: Let, args: list[int]) -> Callable[[Frame], Any]:
        """Return a function that computes the right side of a Let from a frame; `args` are the operands' slots."""
        type, dtype = let.value.type, self.dtypes[let.value.type.base]
        match let.op, let.attr:
            case "const", tuple(bits):
                constant = _constant(type, bits, dtype)
                return lambda frame: constant
            case "load", int(id):
                return self.load(self.variables[id], self.slots[id], args)
            case "construct", _:
                return lambda frame: np.concatenate([np.atleast_1d(frame[a]) for a in args])
            case "splat", _:
                return lambda frame: np.full(type.size, frame[args[0]], dtype)
            case "swizzle", tuple(picked):
                index = picked[0] if len(picked) == 1 else list(picked)
                return lambda frame: frame[args[0]][index]
            case "component", _:
                return lambda frame: frame[args[0]][_clamped(frame[args[1]], len(frame[args[0]]))]
            case "convert", _:
                return lambda frame: meaning.convert(frame[args[0]], dtype)
            case "param", name:
                return lambda frame: frame[0].params[name]
            case "table", name:
                return lambda frame: _element(frame[0].tables[name], frame[args[0]])
            case "neighbour", name:
                return lambda frame: _element(frame[0].tables[name], _moved(frame[0].index, [frame[a] for a in args]))
            case "table_size", name:
                return lambda frame: np.array(frame[0].tables[name].shape[: type.size], dtype).reshape(_shape(type))[()]
            case "grid_line", _:
                return lambda frame: _grid(frame[0].index[:-1], type, "grid_line")
            case ("grid_index" | "grid_shape") as op, _:
                return lambda frame: _grid(frame[0].index if op == "grid_index" else frame[0].shape, type, op)
            case ("any_lane" | "all_lanes") as op, _:
                return _lanes(args[0], op == "any_lane")
            case "lane_mask", _:
                return lambda frame: np.True_
            case (("lane_any" | "min_lane" | "max_lane" | "lane_min" | "lane_max"), _):
                return lambda frame: frame[args[0]]
            case "half", _:
                return lambda frame: frame[args[0]].astype(np.float16).astype(dtype)
            case "call", str(name):
                return self.application(self.functions[name], args)
            case "unit_float", _:
                return _apply(partial(meaning.unit_float, dtype=dtype), args, None)
        f = OPS[let.op].meaning if dtype == np.float16 else _OPERATORS.get(let.op, OPS[let.op].meaning)
        return _apply(f, args, dtype if let.op == "float_from_bits" else None)

    @staticmethod
    def load(variable: Variable, slot: int, args: list[int]) -> Callable[[Frame], Any]:
        """Return a function that loads; a vector from an array is copied, so that later stores do not change it."""
        length = variable.length
        if length is None:
            return lambda frame: frame[slot]
        if variable.type.size == 1:
            return lambda frame: frame[slot][_clamped(frame[args[0]], length)]
        return lambda frame: frame[slot][_clamped(frame[args[0]], length)].copy()

    @staticmethod
    def application(callee: CompiledFunction, args: list[int]) -> Callable[[Frame], Any]:
        """Return a function that calls a pure function and returns its output."""
        places = [callee.places[port.id] for port in callee.function.inputs]
        output = callee.slots[callee.function.outputs[0].id]

        def run(frame: Frame) -> Any:
            inner = callee.frame(frame[0])
            for there, here in zip(places, args, strict=True):
                inner[there] = frame[here]
            callee.body(inner)
            return inner[output]

        return run


def _nested(loop: Step) -> Step:
    """Return the loop's step with a count of iterations of its own, after the counts of the enclosing loops."""

    def run(frame: Frame) -> int | None:
        around = frame[0].iterations
        frame[0].iterations = (*around, 0)
        left = loop(frame)
        frame[0].iterations = around
        return left

    return run


def _counted(step: Step) -> Step:
    """Return the first step of an iteration, extended to count the iteration."""

    def run(frame: Frame) -> int | None:
        *around, last = frame[0].iterations
        frame[0].iterations = (*around, last + 1)
        return step(frame)

    return run


def _apply(f: Callable[..., Any] | None, args: list[int], dtype: Any) -> Callable[[Frame], Any]:
    """Return the closure that applies `f` and rounds the result to `dtype` if that is given."""
    assert f is not None
    if dtype is not None:
        return lambda frame: f(frame[args[0]]).astype(dtype)
    match args:
        case [a]:
            return lambda frame: f(frame[a])
        case [a, b]:
            return lambda frame: f(frame[a], frame[b])
    return lambda frame: f(*[frame[a] for a in args])


def _shape(type: Type) -> tuple[int, ...]:
    return (type.size,) if type.size > 1 else ()


def _constant(type: Type, bits: tuple[int, ...], dtype: Any) -> Any:
    with np.errstate(all="ignore"):
        wide = np.array(decode(type, bits), np.float64 if type.is_float else dtype)
        return wide.astype(dtype).reshape(_shape(type))[()]


def _clamped(index: Any, length: int) -> int:
    return min(max(int(index), 0), length - 1)


def _element(table: Array, index: Any) -> Any:
    """Return the element at `index`, clamped on each axis."""
    axes = (index,) if index.ndim == 0 else index
    return table[tuple(_clamped(i, extent) for i, extent in zip(axes, table.shape, strict=False))]


def _moved(index: tuple[int, ...], offsets: list[Any]) -> Any:
    """Return an index plus an offset on each axis, wrapped as ints are, then taken modulo the moduli, if any."""
    rank = len(index)
    moved = np.array(index, np.int32) + np.array(offsets[:rank], np.int32)
    return moved if len(offsets) == rank else meaning.floor_mod_int(moved, np.array(offsets[rank:], np.int32))


def _grid(extents: tuple[int, ...], type: Type, op: str) -> Any:
    if len(extents) != type.size:
        raise ShpyTypeError(f"{op} of {type.size} axes in a run over {len(extents)}")
    return np.array(extents, np.int32).reshape(_shape(type))[()]


def _lanes(condition: int, any_lane: bool) -> Callable[[Frame], Any]:
    def run(frame: Frame) -> Any:
        holds, oracle = bool(frame[condition]), frame[0].oracle
        if oracle is None or holds == any_lane:
            return np.bool_(holds)
        return np.bool_(oracle())

    return run
