"""Makes the output tree of a function: names, declarations, the shapes of loops, returns.

Stage: emit. A `Body` takes a prepared function and plans it; a target's operations give the expressions. The IR has
one loop; its usual shapes are found again:

    body begins with If(not c) { Break }                        while (c) { ... }
    ... and `continuing` is one store                           for (int i = 0; i < n; i += 1) { ... }
    until c, which reads nothing declared in the loop           do { ... } while (!c);
    any other                                                   while (true) { ... if (c) { break; } }
    one whose `continuing` cannot follow a `continue`           again = false; while (true) { if (again) { ... } ... }
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import ClassVar

from shpy.backend.emit import tree
from shpy.backend.emit.entry import Unit
from shpy.backend.emit.names import Names
from shpy.backend.emit.operations import Operations
from shpy.backend.emit.plan import Wishes, is_whole, plan
from shpy.backend.emit.survey import Place
from shpy.backend.emit.tree import BOOL, Assign, Declare, Do, Exit, Expr, Index, Literal, Name
from shpy.ir.nodes import (
    Break,
    Call,
    Continue,
    Function,
    If,
    Let,
    Loc,
    Loop,
    Region,
    Return,
    Stmt,
    Store,
    Value,
    Variable,
)
from shpy.ir.traverse import continues, defined, variables_of, walk
from shpy.ir.types import Type
from shpy.passes.known import Known


class Body(Operations):
    """Makes the tree of one function of a unit.

    `ports` makes the parameters first, then `statements` the statements. With `direct` outputs are written where they
    are stored, by `output`.
    """

    returns_expressions: ClassVar[bool] = True
    """Return whether a result may be returned without a variable."""

    def __init__(self, unit: Unit, function: Function, direct: Collection[int] = ()) -> None:
        self.unit = unit
        self.function = function
        self.direct = direct
        self.values = {v.id: v for v in defined(function)}
        self.types = {v.id: v.type for v in self.values.values()}
        self.variables = {v.id: v for v in variables_of(function)}
        self.ranges = Known(function)
        self.exprs = {}
        self.slots = {}
        self.scope = unit.globals.scope()
        self.out: list[tree.Stmt] = []
        self.gives_value = False
        """Return whether the function returns its one result."""
        self._first_values: dict[int, tuple[Expr, Loc | None]] = {}
        self._load_names: dict[int, str] = {}
        for s in walk(function.body):
            if isinstance(s, Let) and s.op == "load" and isinstance(s.attr, int) and s.value.name:
                self._load_names.setdefault(s.attr, s.value.name)

    # What a target may change

    def apart(self, inlined: set[int]) -> Collection[int]:
        """Return the values that must have a name, of those that may stand where they are used."""
        return ()

    def repeats(self, s: Let | Store) -> Collection[int]:
        """Return the operands that the target writes more than once: the index of a store, which is tested."""
        return (s.index,) if isinstance(s, Store) and s.index is not None else ()

    def letters(self, op: str) -> int:
        """Return how long the name of the function is that does an operation, nearly."""
        return len(op) + 3

    def reference(self, e: Expr) -> Expr:
        """Return a variable that is no array as an argument by reference."""
        return e

    def output(self, variable: Variable, e: Expr, loc: Loc | None) -> tree.Stmt:
        """Return the statement that gives a direct output its value."""
        raise KeyError(variable)

    def step(self, test: Expr | None, step: Assign) -> Assign:
        """Return the step of a `for`; `test` held when the iteration began, None if the iteration may change it."""
        return step

    def looped(self, s: Loop, loop: tree.Loop) -> tree.Loop:
        """Return the loop with the statements that the target adds; a hook for targets, which adds none by default."""
        return loop

    def unknown_zero(self, type: Type) -> Expr | None:
        """Return a zero that the target's compiler cannot recognise as a constant; None for targets that need none."""
        return None

    # The function

    def begin(self, *, returns: bool) -> None:
        """Plan the function, whose parameters have their names by now."""
        single = len(self.function.outputs) == 1
        self.gives_value = returns and single
        result = self.function.outputs[0].id if self.gives_value and self.returns_expressions else None
        wishes = Wishes(self.apart, self.repeats, self.letters, self.direct, tuple(self.slots), result)
        self.planned = plan(self.function, self.unit.callees, wishes)
        if returns and not single:
            zeroed = [o for o in self.function.outputs if o.id in self.planned.zeroed]
            self.out += [Assign(self.slots[o.id], self.zero(o.type)) for o in zeroed]

    def statements(self) -> None:
        """Make the function's statements, with a return at its end where it gives a value."""
        if not self.ended() and self.gives_value:
            self.out.append(self.leave())

    def ended(self) -> bool:
        """Append the statements of the body; return whether its end cannot be reached."""
        body = self.function.body
        if self.region(body, 0):
            return True
        for variable in self.planned.declared.get((0, len(body)), ()):
            if self._is_missing(variable):
                self.declare_zero(self.variables[variable])
        return False

    def leave(self, loc: Loc | None = None) -> tree.Stmt:
        """Return the statement that leaves the function."""
        return Exit("return", self.slots[self.function.outputs[0].id] if self.gives_value else None, loc)

    @contextmanager
    def block(self) -> Iterator[list[tree.Stmt]]:
        """Collect what is made inside as a block, with names of its own."""
        out, scope = self.out, self.scope
        self.out, self.scope = [], scope.scope()
        yield self.out
        self.out, self.scope = out, scope

    # Values and variables

    def bind(self, value: int, e: Expr | None = None, loc: Loc | None = None) -> None:
        """Declare a temporary that holds the value; from now on it stands for that."""
        definition = self.values[value]
        name = self.scope.take(definition.name)
        self.out.append(Declare(definition.type, name, e or self.exprs[value], loc=loc or definition.loc))
        self.exprs[value] = Name(definition.type, name)

    def settle(self, place: Place) -> None:
        """Declare the values that are used later and that this statement would change."""
        for value in self.planned.settled.get(place, ()):
            self.bind(value)

    def slot(self, variable: Variable, default: str = "v") -> str:
        """Take a name for the variable, which is declared with it."""
        name = self.scope.take(variable.name or self._load_names.get(variable.id), default)
        self.slots[variable.id] = Name(variable.type, name)
        return name

    def declare_zero(self, variable: Variable) -> None:
        """Declare a variable that may be read before it is stored."""
        zero = self.zero(variable.type)
        name = self.slot(variable)
        self.out.append(Declare(variable.type, name, zero, variable.length, variable.loc))

    def _is_missing(self, variable: int) -> bool:
        """Return whether the variable is still to be declared."""
        return not (variable in self.slots or variable in self.direct or variable == self.planned.unnamed)

    def _declare(self, place: Place, s: Stmt) -> None:
        """Declare the variables whose place is before this statement."""
        for v in self.planned.declared.get(place, ()):
            variable = self.variables[v]
            if not self._is_missing(v):
                continue
            if v in self.planned.zeroed:
                self.declare_zero(variable)
            elif not (isinstance(s, Store) and s.variable == v):
                self.out.append(Declare(variable.type, self.slot(variable), loc=variable.loc))

    # Statements

    def region(self, region: Region, number: int, start: int = 0) -> bool:
        """Append a region's statements; return whether it cannot be left at its end."""
        return any(self._placed(region[index], (number, index)) for index in range(start, len(region)))

    def _placed(self, s: Stmt, place: Place) -> bool:
        """Append one statement and what is declared before it; return whether what follows cannot be reached."""
        if isinstance(s, Store) and place in self.planned.returns:
            self.out.append(Exit("return", self.exprs[s.value], s.loc))
            return True
        self._declare(place, s)
        return self.statement(s, place)

    def statement(self, s: Stmt, place: Place) -> bool:
        """Append one statement; return whether what follows cannot be reached."""
        match s:
            case Let():
                self.let(s, place)
            case Store():
                self.store(s, place)
            case If():
                return self.branch(s, place)
            case Loop():
                self.loop(s, place)
            case Call():
                self.call(s, place)
            case Break():
                self.out.append(Exit("break", None, s.loc))
                return True
            case Continue():
                self.out.append(Exit("continue", None, s.loc))
                return True
            case Return():
                left = self.leave(s.loc)
                if place[0] or not (isinstance(left, Exit) and left.value is None):
                    self.out.append(left)
                return True
        return False

    def let(self, s: Let, place: Place) -> None:
        """Make the expression of a value, and a temporary where that is planned."""
        value = s.value.id
        if not self.planned.survey.uses[value]:
            return
        self.settle(place)
        self.exprs[value] = self.operation(s)
        if value in self.planned.named:
            self.bind(value)

    def store(self, s: Store, place: Place) -> None:
        """Append a store: an assignment, a declaration, or the start of a loop."""
        e, variable = self.exprs[s.value], self.variables[s.variable]
        if s.variable in self.direct:
            self.out.append(self.output(variable, e, s.loc))
            return
        self.settle(place)
        if s.index is not None:
            self.store_element(s, s.index, e)
        elif s.variable in self.slots:
            self.out.append(self.assign(s, self.slots[s.variable], e))
        elif place in self.planned.kept:
            self.slots[s.variable] = e
        elif place in self.planned.starts:
            self._first_values[s.variable] = e, s.loc
        else:
            self.out.append(Declare(variable.type, self.slot(variable), e, loc=s.loc))
        if place in self.planned.adopts:
            self.exprs[s.value] = self.slots[s.variable]

    def assign(self, s: Store, target: Expr, e: Expr) -> Assign:
        """Return the assignment to the components that are stored."""
        type = self.variables[s.variable].type
        if s.components is None or type.size == 1:
            return Assign(target, e, s.loc)
        part = self.part(target, s.components)
        return Assign(part, self.component(e) if len(s.components) == 1 else e, s.loc)

    def part(self, target: Expr, components: tuple[int, ...]) -> Expr:
        """Return the components of a variable as what is assigned to."""
        return tree.picked(target, components, target.type.sized(len(components)))

    def store_element(self, s: Store, index: int, e: Expr) -> None:
        """Append a store into an array: nothing happens where the index is out of range."""
        variable = self.variables[s.variable]
        length, at = variable.length or 0, self.arg(index)
        assign = self.assign(s, Index(variable.type, self.slots[s.variable], at), e)
        if not isinstance(at, Literal):
            self.out.append(tree.If(self.inside(at, length), (assign,), (), s.loc))
        elif 0 <= at.value < length:
            self.out.append(assign)

    def call(self, s: Call, place: Place) -> None:
        """Append a call; a single result may stand in the store that follows."""
        function = self.unit.callees[s.function]
        args: list[Expr] = []
        for a, port in zip(s.args, function.inputs, strict=True):
            if isinstance(port, Value):
                args.append(self.arg(a))
            else:
                args.append(self.slots[a] if port.length is not None else self.reference(self.slots[a]))
        self.settle(place)
        if len(s.results) == 1:
            self._call_with_result(self.called(s.function, s.results[0].type, args), s, place)
            return
        for result in s.results:
            temporary = Name(result.type, self.scope.take(result.name))
            self.out.append(Declare(result.type, temporary.text, loc=s.loc))
            self.exprs[result.id] = temporary
            args.append(self.reference(temporary))
        self.out.append(Do(self.called(s.function, BOOL, args), s.loc))

    def _call_with_result(self, call: Expr, s: Call, place: Place) -> None:
        (result,), after = s.results, self.planned.survey.following(place)
        uses = self.planned.survey.uses[result.id]
        if not uses:
            self.out.append(Do(call, s.loc))
        elif uses == 1 and isinstance(after, Store) and after.value == result.id and is_whole(after):
            self.exprs[result.id] = call
        else:
            self.bind(result.id, call, s.loc)

    def branch(self, s: If, place: Place) -> bool:
        """Append a choice; return whether what follows cannot be reached."""
        self.settle(place)
        condition = self.exprs[s.condition]
        blocks, ended = [], []
        for region, number in zip((s.then, s.orelse), self.planned.survey.inner[place], strict=True):
            with self.block() as out:
                ended.append(self.region(region, number))
            blocks.append(tuple(out))
        if not s.then and s.orelse:
            condition, blocks = tree.negation(condition), blocks[::-1]
        self.out.append(tree.If(condition, blocks[0], blocks[1], s.loc))
        return all(ended)

    # Loops

    def loop(self, s: Loop, place: Place) -> None:
        """Append a loop in the plainest shape that it has."""
        self._hide_first_values(s, place)
        self.settle(place)
        outer, self.scope = self.scope, self.scope.scope()
        starts = self._begin_counters()
        skips = continues(s) and bool(s.continuing or s.until is not None)
        if place in self.planned.steps:
            self.out.append(self.looped(s, self._counted(s, place, starts)))
        else:
            for declared in starts:
                outer.reserve(declared.name)
                self.out.append(declared)
            if not skips:
                loop = self._plain(s, place)
            elif place in self.planned.feet and place not in self.planned.tests:
                loop = self._tested_last(s, place)
            else:
                loop = self._gated(s, place, outer)
            self.out.append(self.looped(s, loop))
        self.scope = outer

    def _hide_first_values(self, s: Loop, place: Place) -> None:
        """Append the statements that hide the first values of a loop's variables from a driver that misreads its exits.

        Mesa 22.3 counts the iterations of a loop from the first value of a variable, its step and the constant that an
        exit compares it with. Where the comparison follows the step and holds for the first value, it leaves the loop
        at once. To find these variables alone took 170 lines, and no benchmark on llvmpipe was faster by it.
        """
        for variable in () if self.unit.leaves_loops else sorted(self.planned.survey.stored[place]):
            type = self.variables[variable].type
            zero = self.unknown_zero(type)
            if zero is not None and variable in self.slots and self.variables[variable].length is None:
                slot, op = self.slots[variable], "-" if type.is_float else "+"  # -0.0 + 0.0 is 0.0
                self.out.append(Assign(slot, tree.infix(op, slot, zero), s.loc))

    def _begin_counters(self) -> tuple[Declare, ...]:
        """Name the counters that begin with the loop; a loop inside has starts of its own."""
        starts, self._first_values = self._first_values, {}
        names = {v: self.slot(self.variables[v], "i") for v in starts}
        return tuple(Declare(self.variables[v].type, names[v], e, loc=loc) for v, (e, loc) in starts.items())

    def _counted(self, s: Loop, place: Place, starts: tuple[Declare, ...]) -> tree.Loop:
        """Return a `for`."""
        body, continuing = self.planned.survey.inner[place]
        start, test = self._first_test(s, place)
        for index, let in enumerate(s.continuing):
            if isinstance(let, Let):
                self.let(let, (continuing, index))
        store = s.continuing[-1]
        assert isinstance(store, Store)
        step = self.assign(store, self.slots[store.variable], self.exprs[store.value])
        changed = {self.slots[v] for v in self.planned.survey.stored_in[body] if v in self.slots}
        steady = test is not None and changed.isdisjoint(tree.walk(test))
        step = self.step(test if steady else None, step)
        with self.block() as statements:
            self.region(s.body, body, start)
        return tree.Loop(tuple(statements), starts, test, step, loc=s.loc)

    def _tested_last(self, s: Loop, place: Place) -> tree.Loop:
        """Return a `do` whose test `continue` goes to."""
        body, continuing = self.planned.survey.inner[place]
        self.region(s.continuing, continuing)
        assert s.until is not None
        again = tree.negation(self.exprs[s.until])
        with self.block() as statements:
            self.region(s.body, body)
        return tree.Loop(tuple(statements), again=again, loc=s.loc, again_loc=_line_of_test(s))

    def _plain(self, s: Loop, place: Place) -> tree.Loop:
        """Return a loop of body, continuing and test, one after the other."""
        body, continuing = self.planned.survey.inner[place]
        start, test = self._first_test(s, place)
        around, again = self.scope, None
        with self.block() as statements:
            if not self.region(s.body, body, start):
                self.region(s.continuing, continuing)
                if s.until is not None:
                    until = self.exprs[s.until]
                    if test is None and _is_visible(until, around):
                        again = tree.negation(until)
                    else:
                        statements.append(tree.If(until, (Exit("break"),), (), _line_of_test(s)))
        line = None if again is None else _line_of_test(s)
        return tree.Loop(tuple(statements), test=test, again=again, loc=s.loc, again_loc=line)

    def _gated(self, s: Loop, place: Place, outer: Names) -> tree.Loop:
        """Return a loop whose step and test are at its top, skipped in the first iteration: `continue` goes there."""
        body, continuing = self.planned.survey.inner[place]
        gate = Name(BOOL, outer.take("again"))
        self.scope.reserve(gate.text)
        self.out.append(Declare(BOOL, gate.text, Literal(BOOL, False), loc=s.loc))
        with self.block() as statements:
            with self.block() as last:
                self.region(s.continuing, continuing)
                if s.until is not None:
                    last.append(tree.If(self.exprs[s.until], (Exit("break"),)))
            statements += [tree.If(gate, tuple(last)), Assign(gate, Literal(BOOL, True))]
            self.region(s.body, body)
        return tree.Loop(tuple(statements), loc=s.loc)

    def _first_test(self, s: Loop, place: Place) -> tuple[int, Expr | None]:
        """Return where the body goes on after a first `If(c) { Break }`, and the opposite of c; (0, None) without."""
        start, number = self.planned.tests.get(place, 0), self.planned.survey.inner[place][0]
        test = s.body[start - 1] if start else None
        if not isinstance(test, If):
            return 0, None
        self.region(s.body[: start - 1], number)
        return start, tree.negation(self.exprs[test.condition])


def _is_visible(e: Expr, scope: Names) -> bool:
    """Return whether all names in an expression are known in a scope."""
    return all(part.text in scope for part in tree.walk(e) if isinstance(part, Name))


def _line_of_test(loop: Loop) -> Loc | None:
    """Return the user's line that computes what ends the loop."""
    values = (s.value for s in (*loop.body, *loop.continuing) if isinstance(s, Let))
    return next((value.loc for value in values if value.id == loop.until), None)
