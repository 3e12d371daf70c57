"""Turn consecutive calls of one large function into iterations of a loop, so that the code of the function exists once.

Stage: improve, before `exits`, for targets whose compilers inline every call: there a hundred unrolled calls take as
long to compile as a hundred functions.

    %1 = call noise(%p)       |   store $k = 0
    store $y = %1             |   loop turns 3 {
    %2 = mul %p, %two         |     if $k >= 3 { break }
    %3 = call noise(%2)       |     if $k == 0 { store $a = %p }
    %4 = load $y              |     if $k == 1 { store $y = $r; store $a = %p * %two }
    ...                 ->    |     if $k == 2 { ... }
                              |     store $r = call noise($a)
                              |     continuing: store $k = $k + 1
                              |   }

The statements between two calls run in the iteration of the second call; they are called a part. Where several
functions alternate, an iteration calls each of them. A value that another part uses is passed there in a variable.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

from shpy.ir.nodes import (
    MAX_LOOP_DEPTH,
    Break,
    Call,
    Continue,
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
from shpy.ir.traverse import callee_of, changed_variables, has_exit, regions_of, results, uses, variables_of, walk
from shpy.ir.types import Base, Type, vec
from shpy.passes.exits import may_be_stopped
from shpy.passes.rewriter import Rewriter
from shpy.passes.size import inlined_sizes

WORTH_SHARING = 20_000
"""The least number of statements of a program, with all calls inlined, at which calls share code."""
_LARGE = 60
"""The least number of statements of a function whose calls share code; smaller functions are copied."""
_FEWEST_ITERATIONS = 10
"""The limit of iterations for a program barely WORTH_SHARING; a lower limit would save too little code."""
_MOST_ITERATIONS = 32
"""The most iterations of any loop. Each compares its number with that of every part, which takes time as well."""
_MOST_CALLS = 8
"""The most calls in one iteration."""

_INDEX = vec(Base.I)


def share_calls(module: Module) -> Module:
    """Return the module with its calls in loops, if it would be large with every call inlined."""
    sizes = inlined_sizes(module)
    depths = {module.entry.name: 0}
    stopped = may_be_stopped(module)
    for function in reversed(module.functions):
        total = sizes[module.entry.name]
        if total < WORTH_SHARING:
            break
        iterations = min(_MOST_ITERATIONS, max(_FEWEST_ITERATIONS, 1 + total // WORTH_SHARING))
        work = _Sharing(function, module, sizes, depths, iterations)
        made = work.run()
        if function.pure or not work.shared:
            continue
        changed = replace(module, functions=tuple(made if f is function else f for f in module.functions))
        if stopped or not may_be_stopped(changed):
            module, sizes = changed, inlined_sizes(changed)
    return module


@dataclass(frozen=True, slots=True)
class _Run:
    """Calls of a region that become a loop: their indices in the region, and how many calls an iteration has."""

    calls: tuple[int, ...]
    period: int

    @property
    def iterations(self) -> int:
        return len(self.calls) // self.period


class _Sharing(Rewriter):
    """Rewrites one function; records in `depths` the largest loop depth at which each function is called."""

    def __init__(
        self, function: Function, module: Module, sizes: dict[str, int], depths: dict[str, int], iterations: int
    ) -> None:
        super().__init__(function, {f.name: f for f in module.functions})
        self.sizes = sizes
        self.depths = depths
        self.iterations = iterations
        self.depth = depths.get(function.name, 0)
        self.inner = _inner_depths(module)
        self.shared = False
        self.variables: list[Variable] = []
        self.known: dict[tuple[object, ...], int] = {}
        self.free: dict[Type, list[int]] = {}
        self.next_slot = max((v.id for v in variables_of(function)), default=-1) + 1
        self.used = Counter(v for s in walk(function.body) for v in uses(s, self.functions))

    def run(self) -> Function:
        made = super().run()
        return replace(made, variables=(*made.variables, *self.variables))

    # Where calls stand

    def loop(self, loop: Loop) -> None:
        self.depth += 1
        super().loop(loop)
        self.depth -= 1

    def statements(self, region: Region) -> None:
        done = 0
        for run in self._runs(region):
            super().statements(region[done : run.calls[0]])
            self._share(region, run)
            done = run.calls[-1] + 1
        super().statements(region[done:])

    def statement(self, statement: Stmt) -> None:
        callee = callee_of(statement)
        if callee is not None:
            self.depths[callee] = max(self.depths.get(callee, 0), self.depth)
        super().statement(statement)

    def _runs(self, region: Region) -> Iterator[_Run]:
        """Yield the longest periodic runs of calls in program order, split where one loop has its most iterations."""
        places: list[int] = []
        for at, s in enumerate(region):
            if places and _leaves(s):
                yield from self._parts(region, places)
                places = []
            elif self._is_large(s):
                places.append(at)
        yield from self._parts(region, places)

    def _is_large(self, s: Stmt) -> bool:
        callee = callee_of(s)
        if callee is None or self.sizes[callee] < _LARGE:
            return False
        return self.depth + 1 + self.inner[callee] <= MAX_LOOP_DEPTH

    def _parts(self, region: Region, places: list[int]) -> Iterator[_Run]:
        keys = [self._key(region[at]) for at in places]
        first = 0
        while first < len(keys):
            best, period = 0, 0
            for length in range(1, min(_MOST_CALLS, (len(keys) - first) // 2) + 1):
                n = first + length
                while n < len(keys) and keys[n] == keys[n - length]:
                    n += 1
                covered = (n - first) // length * length
                if covered >= 2 * length and covered > best:
                    best, period = covered, length
            if not best:
                first += 1
                continue
            step = self.iterations * period
            for start in range(first, first + best, step):
                calls = tuple(places[start : min(start + step, first + best)])
                if len(calls) > period:
                    yield _Run(calls, period)
            first += best

    def _key(self, s: Stmt) -> tuple[object, ...]:
        """Return the key by which calls are grouped into a loop: the function and the variables passed by reference."""
        if isinstance(s, Call):
            return s.function, *changed_variables(s, self.functions)
        return (callee_of(s),)

    # The loop

    def _share(self, region: Region, run: _Run) -> None:
        self.shared = True
        self.depth += 1
        shared = _Iterations(self, region, run)
        k = self.slot(_INDEX, "k")
        self.emit(Store(k, self.const(_INDEX, 0), loc=self.loc))
        self._open.append([])
        at = self.make("load", type=_INDEX, attr=k)
        done = self.make("ge", at, self.const(_INDEX, run.iterations), type=vec(Base.B))
        self.emit(If(done, (Break(self.loc),), (), self.loc))
        for part in range(run.period):
            shared.part(part, at)
        body = tuple(self._open.pop())
        self._open.append([])
        more = self.make("add", self.make("load", type=_INDEX, attr=k), self.const(_INDEX, 1), type=_INDEX)
        self.emit(Store(k, more, loc=self.loc))
        continuing = tuple(self._open.pop())
        self.emit(Loop(body, continuing, None, run.iterations, self.loc))
        shared.after()
        self.depth -= 1

    def slot(self, type: Type, name: str | None = None) -> int:
        """Return a new variable."""
        self.variables.append(Variable(self.next_slot, type, None, name, self.loc))
        self.next_slot += 1
        return self.next_slot - 1

    def slot_of(self, key: tuple[object, ...], type: Type, name: str | None) -> int:
        """Return the variable with this key; several loops of a function share it."""
        if key not in self.known:
            self.known[key] = self.slot(type, name)
        return self.known[key]

    def load(self, variable: int, value: Value) -> int:
        """Emit a load of the variable that holds a value; return its id."""
        return self.make("load", type=value.type, attr=variable)


class _Iterations:
    """The iterations of one run: the parts between its calls, and the variables that connect them."""

    def __init__(self, work: _Sharing, region: Region, run: _Run) -> None:
        self.work = work
        self.run = run
        self.calls = [region[at] for at in run.calls]
        starts = (run.calls[0], *(at + 1 for at in run.calls))
        self.between = [region[a:b] for a, b in zip(starts, run.calls, strict=False)]
        inside = Counter(v for s in walk(region[run.calls[0] : run.calls[-1] + 1]) for v in uses(s, work.functions))
        made = {v.id for s in region[run.calls[0] : run.calls[-1] + 1] for v in results(s)}
        self.inside = made
        self.later = {v for v in made if work.used[v] > inside[v]}
        self.users = self._users()
        self.kept: dict[int, int] = {}  # the variable that holds a value which other parts use
        self.types: dict[int, Value] = {}
        self._keep()
        first = self.calls[: run.period]
        self.keys = [(callee_of(call), work.depth, n) for n, call in enumerate(first)]
        self.results = [
            [work.slot_of(("result", at, *key), v.type, v.name) for at, v in enumerate(results(call))]
            for key, call in zip(self.keys, first, strict=True)
        ]
        self.arguments: list[dict[int, int]] = [{} for _ in first]

    def _made(self, n: int) -> tuple[Value, ...]:
        """Return the values of a part, and the results of the call before it."""
        made = tuple(v for s in self.between[n] for v in results(s))
        return made if n == 0 else results(self.calls[n - 1]) + made

    def _keep(self) -> None:
        """Assign a variable to each value that other parts use; reuse a variable after the last use of its value."""
        free = self.work.free
        ends: dict[int, list[Value]] = {}
        for n in range(len(self.calls)):
            for value in ends.get(n, ()):
                free.setdefault(value.type, []).append(self.kept[value.id])
            for value in self._made(n):
                last = max(self.users.get(value.id, {n}))
                if value.id not in self.later and last <= n:
                    continue
                known = free.get(value.type)
                self.kept[value.id] = known.pop() if known else self.work.slot(value.type, value.name)
                self.types[value.id] = value
                ends.setdefault(len(self.calls) if value.id in self.later else last, []).append(value)
        for value in ends.get(len(self.calls), ()):
            free.setdefault(value.type, []).append(self.kept[value.id])

    def _users(self) -> dict[int, set[int]]:
        """Return the parts that use each value; the arguments of a call belong to the part before it."""
        users: dict[int, set[int]] = {}
        for n, (part, call) in enumerate(zip(self.between, self.calls, strict=True)):
            for s in (*walk(part), call):
                for v in uses(s, self.work.functions):
                    users.setdefault(v, set()).add(n)
        return users

    def part(self, number: int, iteration: int) -> None:
        """Emit the parts before call `number` of an iteration, one branch for each iteration, and then the call."""
        work = self.work
        for n in range(number, len(self.calls), self.run.period):
            here = work.make("eq", iteration, work.const(_INDEX, n // self.run.period), type=vec(Base.B))
            work._open.append([])
            self._one(n)
            work.emit(If(here, tuple(work._open.pop()), (), work.loc))
        self._call(number)

    def _one(self, n: int) -> None:
        work = self.work
        made = {v.id: v for v in self._made(n)}
        for own in made:  # a later part may have left an alias
            work.alias.pop(own, None)
        for used in sorted(v for v in self.kept if v not in made and n in self.users.get(v, ())):
            work.alias[used] = work.load(self.kept[used], self.types[used])
        if n:
            before = (n - 1) % self.run.period
            for value, result in zip(results(self.calls[n - 1]), self.results[before], strict=True):
                work.alias[value.id] = work.load(result, value)
        Rewriter.statements(work, self.between[n])
        for value in made.values():
            if value.id in self.kept:
                work.emit(Store(self.kept[value.id], work.alias.get(value.id, value.id)))
        for place, argument in self._values(self.calls[n]):
            if self._differs(n % self.run.period, place):
                slots = self.arguments[n % self.run.period]
                if place not in slots:
                    port = work.functions[str(callee_of(self.calls[n]))].inputs[place]
                    key = ("argument", place, *self.keys[n % self.run.period])
                    slots[place] = work.slot_of(key, port.type, port.name)
                work.emit(Store(slots[place], work.alias.get(argument, argument)))

    def _values(self, call: Stmt) -> Iterator[tuple[int, int]]:
        """Yield the index and the id of each argument that is passed by value."""
        ports = self.work.functions[str(callee_of(call))].inputs
        args = call.args if isinstance(call, (Let, Call)) else ()
        for place, (argument, port) in enumerate(zip(args, ports, strict=True)):
            if isinstance(port, Value):
                yield place, argument

    def _differs(self, number: int, place: int) -> bool:
        """Return whether an argument differs between iterations or is computed inside the loop."""
        given = {dict(self._values(call))[place] for call in self.calls[number :: self.run.period]}
        return len(given) > 1 or bool(given & self.inside)

    def _call(self, number: int) -> None:
        work, call = self.work, self.calls[number]
        assert isinstance(call, (Let, Call))
        args = list(call.args)
        for place, argument in self._values(call):
            slot = self.arguments[number].get(place)
            port = work.functions[str(callee_of(call))].inputs[place]
            args[place] = (
                work.alias.get(argument, argument) if slot is None else work.make("load", type=port.type, attr=slot)
            )
        made = tuple(work.value(v.type, v.name) for v in results(call))
        if isinstance(call, Let):
            work.statement(Let(made[0], "call", tuple(args), call.attr))
        else:
            work.statement(Call(call.function, tuple(args), made, call.loc))
        for slot, value in zip(self.results[number], made, strict=True):
            work.emit(Store(slot, value.id))

    def after(self) -> None:
        """Emit loads of the values that are used after the loop."""
        work = self.work
        last = len(self.calls) - 1
        for value, slot in zip(results(self.calls[last]), self.results[last % self.run.period], strict=True):
            work.alias[value.id] = work.load(slot, value)
        for kept, slot in self.kept.items():
            if kept in self.later:
                work.alias[kept] = work.load(slot, self.types[kept])


def _leaves(s: Stmt) -> bool:
    """Return whether a statement may leave the region around it, other than by a Discard."""
    return has_exit((s,), Break | Continue) or any(isinstance(t, Return) for t in walk((s,)))


def _inner_depths(module: Module) -> dict[str, int]:
    """Return for each function the depth of nested loops, including loops of the functions that it calls."""
    depths: dict[str, int] = {}

    def depth(region: Region) -> int:
        deepest = 0
        for s in region:
            callee = callee_of(s)
            inner = depths[callee] if callee is not None else max((depth(r) for r in regions_of(s)), default=0)
            deepest = max(deepest, inner + isinstance(s, Loop))
        return deepest

    for function in module.functions:
        depths[function.name] = depth(function.body)
    return depths
