"""Turn variables into values: replace each load by the stored value.

Stage: improve. Recorded IR has a slot for every object and a load at every use. This pass removes most of them:

    store $y = %0                   |
    %1 = load $y                    |
    %2 = mul %1, %1          ->     |   %2 = mul %0, %0      (%0 is now named y)
    store $z = %2                   |
    if %c { %3 = load $z ... }      |   if %c { ... %2 ... }

One walk in program order tracks the known content of each variable: the value last stored on every path to the current
point, if it is visible there. After an If both sides must agree. A variable that a loop stores is unknown at the loop's
head, after the loop, and in `continuing` if a Continue goes there. Stores of components are tracked too: a load of a
vector whose components are known becomes a construct.

A variable with a load that cannot be resolved stays. It keeps its other loads as well, one between two stores, so that
the text reads `x = x + 1.0; f(x)` without temporaries. Only constants are forwarded from it. The name of a removed
variable moves to the values that it held. Dead stores are removed at the end (`dead_stores`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from shpy.ir.constants import encode
from shpy.ir.nodes import Call, Function, If, Let, Loop, Module, Region, Stmt, Store, Value
from shpy.ir.traverse import changed_variables, continues, regions_of, variables_of
from shpy.ir.types import SIZES, WIDEST_PORT
from shpy.passes.dead import remove_dead
from shpy.passes.dead_stores import remove_dead_stores
from shpy.passes.rewriter import Functions, Rewriter, each_function, falls_through

Piece = tuple[int, int]
"""A component of a value: (id of the value, index of the component)."""

State = int | tuple[Piece, ...]
"""The content of a variable: a value's id, or a piece for each component."""

_ZERO = -1
"""The id that stands for zero, the initial content of variables."""


def promote(module: Module) -> Module:
    """Return the module with loads replaced by stored values, and without variables that are no longer loaded."""
    promoted = each_function(module, _promote)
    return remove_dead_stores(remove_dead(promoted))


def _promote(function: Function, functions: Functions) -> Function:
    survey = _Survey(function, functions, frozenset(), {})
    survey.region(function.body)
    kept = frozenset(survey.unresolved)
    own = {v.id: v.name for v in function.variables if v.length is None and v.id not in kept}
    names = {value: own[variable] for value, variable in reversed(survey.stores) if own.get(variable)}
    return _Forward(function, functions, kept, names).run()


class _Forward(Rewriter):
    """Forwards stores to loads. `kept` are the variables that stay, `names` the new names of values.

    It finds `unresolved`, the variables with a load that must stay, and `stores`, pairs (stored value, variable).
    """

    def __init__(
        self, function: Function, functions: Functions, kept: frozenset[int], names: Mapping[int, str | None]
    ) -> None:
        super().__init__(function, functions)
        self.kept = kept
        self.names = names
        self.unresolved: set[int] = set()
        self.stores: list[tuple[int, int]] = []
        slots = tuple(variables_of(function))
        self.arrays = {v.id for v in slots if v.length is not None}
        self._sizes = {v.id: v.type.size for v in slots}
        self._states: dict[int, State | None] = {v.id: _ZERO for v in (*function.outputs, *function.variables)}
        self._journal: list[tuple[int, State | None]] = []
        self._born: dict[int, int] = {}
        self._stored: dict[int, set[int]] = {}
        _find_stored(function.body, functions, self._stored)

    # Contents of variables

    def _set(self, variable: int, state: State | None) -> None:
        self._journal.append((variable, self._states.get(variable)))
        self._states[variable] = state

    def _undo(self, mark: int) -> dict[int, State | None]:
        """Restore the contents of variables at `mark`; return the latest contents of those changed since then."""
        undone: dict[int, State | None] = {}
        while len(self._journal) > mark:
            variable, before = self._journal.pop()
            undone.setdefault(variable, self._states[variable])
            self._states[variable] = before
        return undone

    def _visible(self, state: State | None, since: int) -> bool:
        """Return whether all values in the state are older than the `since`-th value."""
        if state is None:
            return False
        values = (state,) if isinstance(state, int) else [v for v, _ in state]
        return all(self._born.get(v, -1) < since for v in values)

    # Statements

    def let(self, let: Let) -> None:
        if let.op == "load" and not let.args:
            self._load(let)
            return
        self._emit(let)

    def _emit(self, let: Let) -> None:
        self._born[let.value.id] = len(self._born)
        if let.value.id in self.names and let.op not in ("const", "param"):
            let = Let(self._named(let.value), let.op, let.args, let.attr)
        self.emit(let)

    def _named(self, value: Value) -> Value:
        """Return the value, which gets the name of the variable that it replaces unless it has a name."""
        name = value.name or self.names.get(value.id)
        return Value(value.id, value.type, name, value.loc)

    def _load(self, let: Let) -> None:
        assert isinstance(let.attr, int)
        variable = let.attr
        state = self._states.get(variable)
        if state is None:
            self.unresolved.add(variable)
        if state is None or (variable in self.kept and not self._cheap(state, variable)):
            self._emit(let)
            self._set(variable, let.value.id)
        elif isinstance(state, int) and state != _ZERO:
            self.replace(let.value, state)
        else:
            self._construct(let, state)
            self._set(variable, self.alias.get(let.value.id, let.value.id))

    def _cheap(self, state: State, variable: int) -> bool:
        """Return whether to replace a load of a kept variable: its content is a constant or an earlier load of it."""
        if not isinstance(state, int):
            return False
        let = self.lets.get(state)
        return state == _ZERO or (
            let is not None and (let.op == "const" or (let.op == "load" and let.attr == variable))
        )

    def _construct(self, let: Let, state: State) -> None:
        """Emit the loaded value as a construct of its pieces."""
        type = let.value.type
        pieces = _pieces(state, type.size)
        runs: list[list[Piece]] = []
        for piece in pieces:
            if runs and runs[-1][-1][0] == piece[0] and self.types.get(piece[0], type).size > 1:
                runs[-1].append(piece)
            else:
                runs.append([piece])
        if len(runs) == 1 and runs[0][0][0] == _ZERO:
            self._emit(Let(let.value, "const", (), encode(type, [0] * type.size)))
            return
        parts = [self._run(part, let.value) for run in runs for part in _divided(run)]
        if len(parts) == 1:
            self.replace(let.value, parts[0])
        else:
            self._emit(Let(let.value, "construct", tuple(parts)))

    def _run(self, run: list[Piece], whole: Value) -> int:
        """Return the id of a value for a run of pieces from one source; emit a swizzle or constant if needed."""
        source, picked = run[0][0], tuple(k for _, k in run)
        type = whole.type.sized(len(run))
        if source == _ZERO:
            return self.make("const", type=type, attr=encode(type, [0] * type.size))
        if picked == tuple(range(self.types[source].size)):
            return source
        return self.make("swizzle", source, type=type, attr=picked)

    def store(self, store: Store) -> None:
        self.emit(store)
        variable, value = store.variable, store.value
        if variable in self.arrays:
            return
        if store.components is None:
            self.stores.append((value, variable))
            self._set(variable, value)
            return
        before = self._states.get(variable)
        if before is not None:
            pieces = _pieces(before, self._sizes[variable])
            for k, component in enumerate(store.components):
                pieces[component] = (value, k)
            self._set(variable, tuple(pieces))

    def call(self, call: Call) -> None:
        self.emit(replace(call, results=tuple(map(self._named, call.results))))
        for result in call.results:
            self._born[result.id] = len(self._born)
        for variable in changed_variables(call, self.functions):
            self.unresolved.add(variable)
            self._set(variable, None)

    def branch(self, branch: If) -> None:
        mark, since = len(self._journal), len(self._born)
        then = self.region(branch.then)
        after_then = self._undo(mark)
        orelse = self.region(branch.orelse)
        after_orelse = self._undo(mark)
        self.emit(If(branch.condition, then, orelse, branch.loc))
        if not falls_through(then):
            after_then = after_orelse
        elif not falls_through(orelse):
            after_orelse = after_then
        for variable in {**after_then, **after_orelse}:
            before = self._states.get(variable)
            state = after_then.get(variable, before)
            agreed = state == after_orelse.get(variable, before) and self._visible(state, since)
            self._set(variable, state if agreed else None)

    def loop(self, loop: Loop) -> None:
        for variable in self._stored[id(loop)]:
            self._set(variable, None)
        mark = len(self._journal)
        body = self.region(loop.body)
        if continues(loop):
            self._undo(mark)
        continuing = self.region(loop.continuing)
        until = None if loop.until is None else self.alias.get(loop.until, loop.until)
        self._undo(mark)
        self.emit(Loop(body, continuing, until, loop.turns, loop.loc))


class _Survey(_Forward):
    """Finds `unresolved` and `stores`, and makes no statements: compiling pictures for numpy takes .955 of the time."""

    def region(self, region: Region) -> Region:
        """Return the region as it is."""
        self.statements(region)
        return region

    def statement(self, statement: Stmt) -> None:
        """Follow a statement; operands of a Let do not matter."""
        if isinstance(statement, Let):
            self.let(statement)
        else:
            super().statement(statement)

    def emit(self, statement: Stmt) -> None:
        """Keep the types of values."""
        if isinstance(statement, Let):
            self.types[statement.value.id] = statement.value.type
        elif isinstance(statement, Call):
            self.types.update({r.id: r.type for r in statement.results})


def _pieces(state: State, size: int) -> list[Piece]:
    return [(state, k) for k in range(size)] if isinstance(state, int) else list(state)


def _divided(run: list[Piece]) -> list[list[Piece]]:
    """Return the run in parts for which there are vectors."""
    if len(run) in SIZES:
        return [run]
    return [run[k : k + WIDEST_PORT] for k in range(0, len(run), WIDEST_PORT)]


def _find_stored(region: Region, functions: Functions, stored_by_loop: dict[int, set[int]]) -> set[int]:
    """Return the variables that the region stores into; enter those of each Loop in it by `id`."""
    stored: set[int] = set()
    for s in region:
        if isinstance(s, (Store, Call)):
            stored.update(changed_variables(s, functions))
        elif isinstance(s, (If, Loop)):
            inside: set[int] = set()
            for inner in regions_of(s):
                inside |= _find_stored(inner, functions, stored_by_loop)
            if isinstance(s, Loop):
                stored_by_loop[id(s)] = inside
            stored |= inside
    return stored
