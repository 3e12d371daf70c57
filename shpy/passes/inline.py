"""Inline subroutines: replace calls by the bodies of the functions.

Stage: improve, before `vectorize`, for functions that take arrays, since arrays cannot be passed by value.

    function f(%x, $y) { if %x { return }; store $y = 1.0 }
    ...                                                        ->   ...
    call f(%c, $v)                                                  if %c { } else { store $v = 1.0 }

If a branch returns, the statements after it move into the other branch. Where that is not possible, the body becomes a
loop of one iteration, and Break replaces Return. Variables of the callee become variables of the caller. Inside a loop
they are set to zero first, as at each start of a function.

`inline_independent` inlines pure functions whose result does not depend on their arguments, once functions are simple:
passes and printers can assume that a call with varying arguments has a varying result.

    pure function f(%a.0: f) -> ($0: f) {
      %1: f = const 0x1p+0                           |
      store $0 = %1                           ->     |   %9: f = const 0x1p+0
    }                                                |
    %9: f = call f(%8)                               |
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from shpy.errors import CompileError
from shpy.ir.builder import Builder
from shpy.ir.constants import encode
from shpy.ir.nodes import (
    EXITS,
    MAX_LOOP_DEPTH,
    MAX_REGION_DEPTH,
    Break,
    Call,
    Discard,
    Function,
    If,
    Let,
    Loop,
    Module,
    Region,
    Return,
    Stmt,
    Store,
    Value,
    Variable,
)
from shpy.ir.traverse import Copy, regions_of, rewrite, walk
from shpy.ir.types import Base, vec
from shpy.passes.continuing import without_continuing
from shpy.passes.returns import returns_outside_loops
from shpy.passes.rewriter import falls_through, map_exits
from shpy.passes.size import check_growth

_MOST_STATEMENTS = 50_000
"""The largest size of a function after inlining; larger ones are refused, as text and compile time could explode."""
_DEEPEST_GUARD = 8
"""The limit of consecutive Returns, each of which nests the rest of the body one region deeper."""


def inline_calls(module: Module, chosen: Callable[[Function], bool] = lambda function: True) -> Module:
    """Return the module with the `chosen` functions inlined; raise CompileError if regions then nest too deep.

    Pure functions and the entry are never inlined.
    """
    inlined: dict[str, Function] = {}
    gone: set[str] = set()
    stay = {f.name for f in module.functions if f.pure or not chosen(f)}
    check_growth(module, _MOST_STATEMENTS, "functions that take arrays are copied to where they are called", stay)
    for function in module.functions:
        result = _Inliner(function, inlined, gone).run() if gone else function
        inlined[function.name] = result
        if chosen(function) and not function.pure and function is not module.entry:
            gone.add(function.name)
        elif result is not function:
            _check_depth(result, result.body, 1, 0)
    return replace(module, functions=tuple(f for name, f in inlined.items() if name not in gone))


def _check_depth(function: Function, region: Region, regions: int, loops: int) -> None:
    for s in region:
        deeper = loops + isinstance(s, Loop)
        if regions > MAX_REGION_DEPTH or deeper > MAX_LOOP_DEPTH:
            loc = s.value.loc if isinstance(s, Let) else s.loc
            raise CompileError("with its subroutines inlined, this nests too deep for the target", loc=loc)
        for inner in regions_of(s):
            _check_depth(function, inner, regions + 1, deeper)


class _Inliner:
    """Copies a function and inlines its calls of the functions named in `gone`."""

    def __init__(self, function: Function, inlined: dict[str, Function], gone: set[str]) -> None:
        self.function = function
        self.inlined = inlined
        self.gone = gone
        self.b = Builder(function=function)

    def run(self) -> Function:
        """Return the function with these calls inlined."""
        self.b.extend(self._region(self.function.body, in_loop=False))
        return self.b.finish()

    def _region(self, region: Region, *, in_loop: bool) -> Region:
        self.b.push()
        for s in region:
            match s:
                case Call(name) if name in self.gone:
                    self.b.loc = s.loc
                    self._inline(s, in_loop)
                case If(condition, then, orelse, loc):
                    then = self._region(then, in_loop=in_loop)
                    self.b.append(If(condition, then, self._region(orelse, in_loop=in_loop), loc))
                case Loop(body, continuing, until, turns, loc):
                    body = self._region(body, in_loop=True)
                    loop = Loop(body, self._region(continuing, in_loop=True), until, turns, loc)
                    discards = any(isinstance(inner, Discard) for inner in walk(loop.continuing))
                    self.b.append(without_continuing(self.b, loop) if discards else loop)
                case _:
                    self.b.append(s)
        return self.b.pop()

    def _inline(self, call: Call, in_loop: bool) -> None:
        callee = returns_outside_loops(self.inlined[call.function])
        copy = Copy(self.b.value, self.inlined)
        for port, argument in zip(callee.inputs, call.args, strict=True):
            (copy.values if isinstance(port, Value) else copy.slots)[port.id] = argument
        for slot in (*callee.outputs, *callee.variables):
            own = self.b.variable(slot.type, slot.length, slot.name, slot.loc)
            copy.slots[slot.id] = own.id
            if in_loop:
                self._zero(own)
        body = without_returns(callee.body)
        if body is None:
            body = map_exits(callee.body, lambda s: (Break(s.loc),) if isinstance(s, Return) else (s,))
            last = () if body and isinstance(body[-1], EXITS) else (Break(),)
            body = (Loop((*body, *last), (), None, 1, call.loc),)
        self.b.extend(copy.region(body))
        for result, output in zip(call.results, callee.outputs, strict=True):
            self.b.append(Let(result, "load", (), copy.slots[output.id]))

    def _zero(self, slot: Variable) -> None:
        b = self.b
        zero = b.let("const", type=slot.type, attr=encode(slot.type, [0] * slot.type.size))
        if slot.length is None:
            b.store(slot, zero)
            return
        index = vec(Base.I)
        k = b.variable(index, name="k")
        b.store(k, b.const(index, [0]))
        with b.loop(turns=slot.length) as loop:
            at = b.load(k)
            b.store(slot, zero, index=at)
            b.store(k, b.let("add", at, b.const(index, [1])))
            loop.until(b.let("ge", b.load(k), b.const(index, [slot.length])))


def _returns(region: Region) -> bool:
    return any(isinstance(s, Return) for s in walk(region))


def without_returns(region: Region, guards: int = _DEEPEST_GUARD) -> Region | None:
    """Return the region with its Returns replaced by nested Ifs; None if that is not possible.

    `guards`: the number of nested Ifs into whose branches the statements after them may move.
    """
    for n, s in enumerate(region):
        if isinstance(s, Return):
            return region[:n]
        if not isinstance(s, If) or not _returns((s,)):
            continue
        rest = region[n + 1 :]
        then, orelse = s.then, s.orelse
        if rest and guards and not falls_through(then):
            orelse, rest = (orelse + rest if falls_through(orelse) else orelse), ()
        elif rest and guards and not falls_through(orelse):
            then, rest = then + rest, ()
        if rest:
            return None
        new_then, new_orelse = without_returns(then, guards - 1), without_returns(orelse, guards - 1)
        if new_then is None or new_orelse is None:
            return None
        return (*region[:n], If(s.condition, new_then, new_orelse, s.loc))
    return region


def inline_independent(module: Module) -> Module:
    """Return the module without calls of such functions; the same object if it has no such function."""
    lets_by_name: dict[str, tuple[Let, ...]] = {}
    functions = []
    for function in module.functions:
        changed = _inlined(function, lets_by_name) if lets_by_name else function
        functions.append(changed)
        needed = _independent(changed)
        if needed:
            lets_by_name[function.name] = needed
    same = all(a is b for a, b in zip(functions, module.functions, strict=True))
    return module if same else replace(module, functions=tuple(functions))


def _independent(function: Function) -> tuple[Let, ...]:
    """Return the Lets that compute the result, in order, if it depends on no input; else an empty tuple."""
    lets = {s.value.id: s for s in function.body if isinstance(s, Let)}
    stores = [s for s in walk(function.body) if isinstance(s, Store)]
    if not function.pure or len(stores) != 1 or len(lets) + 1 != len(function.body) or stores[0].components:
        return ()
    needed: list[Let] = []
    pending = [stores[0].value]
    while pending:
        let = lets.get(pending.pop())
        if let is None or let.op in ("load", "grid_index"):
            return ()
        needed.append(let)
        pending.extend(let.args)
    order = {id: n for n, id in enumerate(lets)}
    return tuple(sorted({let.value.id: let for let in needed}.values(), key=lambda let: order[let.value.id]))


def _inlined(function: Function, lets_by_name: dict[str, tuple[Let, ...]]) -> Function:
    b = Builder(function=function)

    def change(s: Stmt) -> Stmt | tuple[Stmt, ...]:
        if not (isinstance(s, Let) and s.op == "call" and s.attr in lets_by_name):
            return s
        copy = Copy(lambda type, name, _: b.value(type, name, s.value.loc), {})
        *before, last = lets_by_name[str(s.attr)]
        lets = copy.region(tuple(before))
        return (*lets, replace(last, value=s.value, args=tuple(copy.values[a] for a in last.args)))

    body = rewrite(function.body, change)
    return function if body is function.body else replace(function, body=body)
