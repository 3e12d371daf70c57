"""Makes the output tree of a function in one walk: names, declarations, statements, returns.

Stage: emit. A target's operations give the expression of a value, which waits for its use and is written there. It is
declared instead where it is made if it is used more than once, long, or named by the user, and before a statement that
changes what it reads. What needs the whole function is found first (`survey`): where each value is used, where each
variable is declared, and which stores become returns.

    %3 = add %1, %2 (of $x)                        float t = x + y;
    store $x = 0                       ->          x = 0.0f;
    store $y = %3                                  y = t;

    $n is stored first in each iteration, and used in no other region  ->  declared inside the loop
    $n is loaded before it is stored in an iteration                   ->  declared, zero, before the loop
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

from shpy.backend.emit import tree
from shpy.backend.emit.loops import LoopParts, leading_test, opens_loop
from shpy.backend.emit.names import Names
from shpy.backend.emit.operations import Operations
from shpy.backend.emit.survey import Place, is_whole
from shpy.backend.emit.tree import BOOL, Expr, Literal, Name, measure
from shpy.backend.emit.waiting import Waiting
from shpy.ir.nodes import (
    Break,
    Call,
    Continue,
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
from shpy.ir.traverse import changed_variables, continues, defined, uses, walk

MAX_DEPTH: Final = 32
"""Expressions nest no deeper: compilers give up at 256 brackets, readers before."""
MAX_WIDTH: Final = 100
"""Letters, about, of an expression that needs no name."""


class Body:
    """Makes the tree of one function of a unit, with the expressions of `operations`.

    Whoever makes it names the parameters first; then `statements` makes the statements. With `direct` outputs are
    written where they are stored, by `Operations.output`.
    """

    def __init__(self, operations: Operations, direct: Collection[int] = ()) -> None:
        self.operations, self.direct = operations, direct
        self.function, self.unit = operations.function, operations.unit
        self.exprs, self.slots, self.variables = operations.exprs, operations.slots, operations.variables
        self.survey = operations.survey
        self.values = {v.id: v for v in defined(self.function)}
        self.waiting = Waiting(self.survey.uses)
        self.scope = self.unit.globals.scope()
        self.out: list[tree.Stmt] = []
        self.gives_value = False
        """Return whether the function returns its one result."""
        self._adopted: int | None = None
        """The value for which the variable stands that the next statement stores it into."""
        self._first_values: dict[int, tuple[Expr, Loc | None]] = {}
        self._declared: dict[Place, list[int]] = {}
        """Variables that are declared before a statement."""
        self._homes: dict[int, int] = {}
        """The regions in which variables are declared."""
        self._zeroed: set[int] = set()
        """Variables that may be read before they are stored."""
        self._returns: set[Place] = set()
        """Stores of the result that end the function."""
        self._unnamed: int | None = None
        """The result, if it needs no variable: every way through the function ends with a store of it."""
        self._load_names: dict[int, str] = {}
        for s in walk(self.function.body):
            if isinstance(s, Let) and s.op == "load" and isinstance(s.attr, int) and s.value.name:
                self._load_names.setdefault(s.attr, s.value.name)

    # The function

    def begin(self, *, returns: bool) -> None:
        """Survey the whole function; its parameters have names already."""
        single = len(self.function.outputs) == 1
        self.gives_value = returns and single
        self.inputs = {i.id for i in self.function.inputs if isinstance(i, Value)}
        self.inlined = {value for value in self.survey.lets if self.survey.may_inline(value)}
        self.inlined.difference_update(self.operations.need_names(self.inlined))
        self._find_declarations()
        if self.gives_value and self.operations.returns_expressions:
            self._returns, whole = self.survey.final_stores(self.function.outputs[0].id)
            self._unnamed = self.function.outputs[0].id if whole else None
        if returns and not single:
            zeroed = [o for o in self.function.outputs if o.id in self._zeroed]
            self.out += [tree.Assign(self.slots[o.id], self.operations.zero(o.type)) for o in zeroed]

    def _find_declarations(self) -> None:
        """Find where each variable is declared, and whether as zero."""
        function = self.function
        for variable in self.variables.values():
            place = self.survey.place(variable, output=variable in function.outputs)
            if place is not None and variable not in function.inputs:
                where, zero = place
                self._declared.setdefault(where, []).append(variable.id)
                self._homes[variable.id] = where[0]
                if zero:
                    self._zeroed.add(variable.id)

    def statements(self) -> None:
        """Make the function's statements, with a return at its end where it gives a value."""
        if not self.ended() and self.gives_value:
            self.out.append(self.leave())

    def ended(self) -> bool:
        """Append the statements of the body; return whether its end cannot be reached."""
        body = self.function.body
        if self.region(body, 0):
            return True
        for variable in self._declared.get((0, len(body)), ()):
            if self._is_missing(variable):
                self.declare_zero(self.variables[variable])
        return False

    def leave(self, loc: Loc | None = None) -> tree.Stmt:
        """Return the statement that leaves the function."""
        return tree.Exit("return", self.slots[self.function.outputs[0].id] if self.gives_value else None, loc)

    @contextmanager
    def block(self) -> Iterator[list[tree.Stmt]]:
        """Collect the statements emitted inside as a block, with names of its own."""
        outer, self.scope = self.scope, self.scope.scope()
        with self.collected() as out:
            yield out
        self.scope = outer

    @contextmanager
    def collected(self) -> Iterator[list[tree.Stmt]]:
        """Collect the statements that are made inside."""
        outer, self.out = self.out, []
        yield self.out
        self.out = outer

    # Values and variables

    def bind(self, value: int, e: Expr | None = None, loc: Loc | None = None) -> None:
        """Declare a temporary that holds the value; from now on it stands for that."""
        self._name(value, e, loc)
        self.waiting.remove(value)

    def _name(self, value: int, e: Expr | None = None, loc: Loc | None = None) -> None:
        definition = self.values[value]
        name = self.scope.take(definition.name)
        self.out.append(tree.Declare(definition.type, name, e or self.exprs[value], loc=loc or definition.loc))
        self.exprs[value] = Name(definition.type, name)

    def change(self, variables: Collection[int]) -> None:
        """Declare the values that read these variables and are used after the statement that changes them."""
        for value in self.waiting.readers(variables):
            self.bind(value)

    def repeat(self, s: Let | Store, place: Place) -> dict[int, Expr]:
        """Declare the operands that the statement writes more than once, unless they are names or numbers.

        Return the expressions of those from other regions, where the name is unknown: for after the statement.
        """
        outside: dict[int, Expr] = {}
        for value in self.operations.repeats(s):
            if measure(self.exprs[value])[0] == 0:
                continue
            if self.survey.region_of(value) == place[0]:
                self.bind(value)
            else:
                outside[value] = self.exprs[value]
                self._name(value)
        return outside

    def slot(self, variable: Variable, default: str = "v") -> str:
        """Take a name for the variable, which is declared with it."""
        name = self.scope.take(variable.name or self._load_names.get(variable.id), default)
        self.slots[variable.id] = Name(variable.type, name)
        return name

    def declare_zero(self, variable: Variable) -> None:
        """Declare a variable that may be read before it is stored."""
        zero, length = self.operations.zero(variable.type), self.operations.array_length(variable)
        self.out.append(tree.Declare(variable.type, self.slot(variable), zero, length, variable.loc))

    def _is_missing(self, variable: int) -> bool:
        """Return whether the variable is still to be declared."""
        return not (variable in self.slots or variable in self.direct or variable == self._unnamed)

    def _declare(self, place: Place, s: Stmt) -> None:
        """Declare the variables whose place is before this statement."""
        for v in self._declared.get(place, ()):
            variable = self.variables[v]
            if not self._is_missing(v):
                continue
            if v in self._zeroed:
                self.declare_zero(variable)
            elif not (isinstance(s, Store) and s.variable == v):
                self.out.append(tree.Declare(variable.type, self.slot(variable), loc=variable.loc))

    # Statements

    def region(self, region: Region, number: int, start: int = 0) -> bool:
        """Append a region's statements; return whether it cannot be left at its end."""
        return any(self._placed(region[index], (number, index)) for index in range(start, len(region)))

    def _placed(self, s: Stmt, place: Place) -> bool:
        """Append one statement and what is declared before it; return whether what follows cannot be reached."""
        if isinstance(s, Store) and place in self._returns:
            self.waiting.use([s.value])
            self.out.append(tree.Exit("return", self.exprs[s.value], s.loc))
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
                self.out.append(tree.Exit("break", None, s.loc))
                return True
            case Continue():
                self.out.append(tree.Exit("continue", None, s.loc))
                return True
            case Return():
                left = self.leave(s.loc)
                if place[0] or not (isinstance(left, tree.Exit) and left.value is None):
                    self.out.append(left)
                return True
        return False

    def let(self, s: Let, place: Place) -> None:
        """Make the expression of a value, which waits for its use or gets a name."""
        value = s.value.id
        if not self.survey.uses[value]:
            self.waiting.use(s.args)
            return
        outside = self.repeat(s, place)
        e = self.exprs[value] = self.operations.operation(s)
        self.exprs.update(outside)
        reads = self.waiting.reads(s)
        self.waiting.use(s.args)
        depth, width = measure(e)
        fits = depth <= MAX_DEPTH and (width <= MAX_WIDTH or self._is_result(value, place))
        if fits and value in self.inlined:
            self.waiting.add(value, reads)
        elif fits and self._goes_into_a_variable(s.value, place):
            self._adopted = value
        else:
            self.bind(value)

    def _is_result(self, value: int, place: Place) -> bool:
        """Return whether the next statement does nothing but return the value, or write it to an output."""
        store = self.survey.following(place)
        if not isinstance(store, Store) or store.value != value:
            return False
        return (place[0], place[1] + 1) in self._returns or store.variable in self.direct

    def _goes_into_a_variable(self, value: Value, place: Place) -> bool:
        """Return whether the next statement stores it: then that variable's name stands for it."""
        store = self.survey.following(place)
        if not isinstance(store, Store) or store.value != value.id or not is_whole(store):
            return False
        if value.name not in (None, self.variables[store.variable].name) or store.variable in self.direct:
            return False
        return not opens_loop(self.survey, store, (place[0], place[1] + 1))

    def store(self, s: Store, place: Place) -> None:
        """Append a store: an assignment, a declaration, or the start of a loop."""
        e, variable, reads = self.exprs[s.value], self.variables[s.variable], self.waiting.reads(s)
        adopted, self._adopted = s.value == self._adopted, None
        self.waiting.use([s.value])
        if s.variable in self.direct:
            self.out.append(self.operations.output(variable, e, s.loc))
        elif s.index is not None:
            self.change([s.variable])
            outside = self.repeat(s, place)
            self.waiting.use([s.index])
            self.out += self.operations.store_element(s, s.index, e)
            self.exprs.update(outside)
        elif s.variable in self.slots:
            self.change([s.variable])
            self.out.append(self.operations.assign(s, self.slots[s.variable], e))
        elif self._continues_input(s):
            self.slots[s.variable] = e
        elif not adopted and opens_loop(self.survey, s, place, reads):
            self._first_values[s.variable] = e, s.loc
        else:
            self.out.append(tree.Declare(variable.type, self.slot(variable), e, loc=s.loc))
        if adopted:
            self.exprs[s.value] = self.slots[s.variable]
            if self.waiting.left[s.value]:
                self.waiting.add(s.value, frozenset({s.variable}))

    def _continues_input(self, s: Store) -> bool:
        """Return whether the variable starts as an input of its name that is not used again."""
        if s.value not in self.inputs or self.waiting.left[s.value] or self._homes[s.variable]:
            return False
        return self.values[s.value].name == self.variables[s.variable].name is not None

    def call(self, s: Call, place: Place) -> None:
        """Append a call; a single result may stand in the store that follows."""
        function = self.unit.callees[s.function]
        args: list[Expr] = []
        for a, port in zip(s.args, function.inputs, strict=True):
            if isinstance(port, Value):
                args.append(self.operations.arg(a))
            else:
                args.append(self.slots[a] if port.length is not None else self.operations.reference(self.slots[a]))
        self.waiting.use(uses(s, self.unit.callees))
        self.change(changed_variables(s, self.unit.callees))
        if len(s.results) == 1:
            self._call_with_result(self.operations.called(s.function, s.results[0].type, args), s, place)
            return
        for result in s.results:
            temporary = Name(result.type, self.scope.take(result.name))
            self.out.append(tree.Declare(result.type, temporary.text, loc=s.loc))
            self.exprs[result.id] = temporary
            args.append(self.operations.reference(temporary))
        self.out.append(tree.Do(self.operations.called(s.function, BOOL, args), s.loc))

    def _call_with_result(self, call: Expr, s: Call, place: Place) -> None:
        (result,), after = s.results, self.survey.following(place)
        count = self.survey.uses[result.id]
        if not count:
            self.out.append(tree.Do(call, s.loc))
        elif count == 1 and isinstance(after, Store) and after.value == result.id and is_whole(after):
            self.exprs[result.id] = call
        else:
            self.bind(result.id, call, s.loc)

    def branch(self, s: If, place: Place) -> bool:
        """Append a choice; return whether what follows cannot be reached."""
        condition = self.exprs[s.condition]
        self.waiting.use([s.condition])
        self.change(self.survey.stored[place])
        blocks, ended = [], []
        for region, number in zip((s.then, s.orelse), self.survey.inner[place], strict=True):
            with self.waiting.region(), self.block() as out:
                ended.append(self.region(region, number))
            blocks.append(tuple(out))
        if not s.then and s.orelse:
            condition, blocks = tree.negation(condition), blocks[::-1]
        self.out.append(tree.If(condition, blocks[0], blocks[1], s.loc))
        return all(ended)

    # Loops

    def loop(self, s: Loop, place: Place) -> None:
        """Append a loop in the plainest shape that its parts allow."""
        self._hide_first_values(s, place)
        self.change(self.survey.stored[place])
        outer, self.scope = self.scope, self.scope.scope()
        starts, around = self._begin_counters(), self.scope
        body, continuing = self.survey.inner[place]
        with self.waiting.region(), self.block() as statements:
            start, test = self.first_test(s, body)
            reached = not self.region(s.body, body, start) or continues(s)
            with self.collected() as last:
                if reached:
                    self.region(s.continuing, continuing)
            until = self.exprs[s.until] if s.until is not None and reached else None
            self.waiting.use([] if s.until is None else [s.until])
        parts = LoopParts(s, starts, test, tuple(statements), tuple(last), until, around)
        loop = parts.counted()
        if loop is not None and loop.step is not None:
            changed = {self.slots[v] for v in self.survey.stored_in[body] if v in self.slots}
            steady = test is not None and changed.isdisjoint(tree.walk(test))
            loop = replace(loop, step=self.operations.step(test if steady else None, loop.step))
        else:
            for declared in starts:
                outer.reserve(declared.name)
                self.out.append(declared)
            loop = parts.plain() or parts.gated(self._gate(s, outer))
        self.out.append(self.operations.looped(s, loop))
        self.scope = outer

    def first_test(self, s: Loop, number: int) -> tuple[int, Expr | None]:
        """Return where the body goes on after a first `If(c) { Break }`, and the opposite of c; (0, None) without.

        It is a statement of the body if something has to be declared before it.
        """
        at = leading_test(s.body)
        if at is None:
            return 0, None
        self.region(s.body[:at], number)
        test = s.body[at]
        assert isinstance(test, If)
        self._declare((number, at), test)
        if self.out:
            self.statement(test, (number, at))
            return at + 1, None
        self.waiting.use([test.condition])
        return at + 1, tree.negation(self.exprs[test.condition])

    def _gate(self, s: Loop, outer: Names) -> Name:
        """Declare the bool that holds from a loop's second iteration on."""
        gate = Name(BOOL, outer.take("again"))
        self.out.append(tree.Declare(BOOL, gate.text, Literal(BOOL, False), loc=s.loc))
        return gate

    def _hide_first_values(self, s: Loop, place: Place) -> None:
        """Append the statements that hide the first values of a loop's variables from a driver that misreads its exits.

        Mesa 22.3 counts the iterations of a loop from the first value of a variable, its step and the constant that an
        exit compares it with. Where the comparison follows the step and holds for the first value, it leaves the loop
        at once. To find these variables alone took 170 lines, and no benchmark on llvmpipe was faster by it.
        """
        for variable in () if self.unit.leaves_loops else sorted(self.survey.stored[place]):
            type = self.variables[variable].type
            zero = self.operations.unknown_zero(type)
            if zero is not None and variable in self.slots and self.variables[variable].length is None:
                slot, op = self.slots[variable], "-" if type.is_float else "+"  # -0.0 + 0.0 is 0.0
                self.out.append(tree.Assign(slot, tree.infix(op, slot, zero), s.loc))

    def _begin_counters(self) -> tuple[tree.Declare, ...]:
        """Name the counters that begin with the loop; a loop inside has starts of its own."""
        starts, self._first_values = self._first_values, {}
        names = {v: self.slot(self.variables[v], "i") for v in starts}
        return tuple(tree.Declare(self.variables[v].type, names[v], e, loc=loc) for v, (e, loc) in starts.items())
