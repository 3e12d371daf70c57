"""Statements of C-like text: temporaries, stores, ifs and calls.

Stage: emit, between `Operations` (expressions) and `CLike` (loops and functions). Values with a name become
temporaries of that name, others stand where they are used (`layout.py`); a pending expression that loads a variable
becomes a temporary before that variable is stored.

    if (t < t_max) {  // tracer.py:41
        hit.xyz += 0.5f * d;
    }
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import ClassVar

from shpy.backends import expressions as ex
from shpy.backends.emit.names import Names, Target
from shpy.backends.expressions import Expr
from shpy.backends.layout import After, Layout, changed_variables, stored_variables
from shpy.backends.operations import COMPONENTS, Operations
from shpy.ir.constants import encode
from shpy.ir.nodes import (
    Break,
    Call,
    Continue,
    Function,
    If,
    Let,
    Loc,
    Loop,
    Module,
    Region,
    Return,
    Stmt,
    Store,
    Value,
    Variable,
)
from shpy.ir.types import Type

MAX_DEPTH = 32
"""Expressions nest no deeper: compilers give up at 256 brackets, readers before."""
MAX_WIDTH = 100
"""A longer expression becomes a temporary."""

State = tuple[dict[int, Expr], Counter[int], dict[int, None]]
Line = tuple[str, Loc | None]
"""One line of text, and the line of the user's code that it comes from."""


class NotAnExpression(Exception):
    """What should stand in a loop's or an else-if's head needs a statement of its own."""


class NeedsVariable(Exception):
    """The function's result cannot do without a variable."""


class Statements(Operations):
    """Prints statements of one function at a time, which has its own names, values and slots, into `lines`."""

    target: Target
    inputs_are_variables: ClassVar[bool] = False
    """Whether a function may store into its parameters by value."""

    def __init__(self, module: Module) -> None:
        super().__init__({f.name: f for f in module.functions})
        self.module = module
        self.globals = Names(self.target)
        self.names = self.globals
        self.lines: list[Line] = []
        self.indent = 0
        self.layout = Layout()
        self.exprs: dict[int, Expr] = {}
        self.values: dict[int, Value] = {}
        self.remaining: Counter[int] = Counter()
        self.pending: dict[int, None] = {}
        self.held: dict[int, tuple[Expr, Loc | None]] = {}
        self.load_names: dict[int, str] = {}
        self.direct: frozenset[int] = frozenset()
        self.returned: int | None = None
        """The output that the function returns."""
        self.unnamed = False
        """Whether that output is to do without a variable."""
        self.kept: int | None = None
        """The value that the next statement stores, and whose variable will stand for it."""
        self.in_head = False
        self.last: Loc | None = None
        """The user's line that was named last."""
        self.current = module.entry

    # Hooks for declarations and functions

    def declaration(self, type: Type, name: str) -> str:
        """`float x`."""
        return f"{self.type_name(type)} {name}"

    def declare_array(self, variable: Variable, name: str) -> str:
        """An array, zero everywhere: `float a[8] = {0.0f};`."""
        raise KeyError(variable)

    def reference(self, variable: int) -> str:
        """The variable as an argument by reference."""
        return self.slots[variable].text

    def leave(self, function: Function) -> str:
        """The text of a Return of `function`."""
        if len(function.outputs) == 1:
            if self.unnamed:
                raise NeedsVariable
            return f"return {self.slots[function.outputs[0].id].text};"
        return "return;"

    def output(self, variable: Variable, e: Expr) -> str:
        """The statement that gives an output of the entry its value; for those in `direct`."""
        raise KeyError(variable)

    def component(self, e: Expr, type: Type) -> Expr:
        """A scalar as it is stored into a component of a vector."""
        return e

    # Lines

    def emit(self, text: str, loc: Loc | None = None) -> None:
        """One line; the first of several from one line of the user's code says which."""
        shown = loc if loc is not None and loc != self.last else None
        self.last = loc or self.last
        self.lines.append(("    " * self.indent + text, shown))

    @contextmanager
    def block(self, scope: bool = True) -> Iterator[None]:
        """What is printed inside is indented; its names, and values that are still pending there, are its own."""
        outer, pending = self.names, set(self.pending)
        self.names = outer.scope() if scope else outer
        self.indent += 1
        try:
            yield
        finally:
            self.indent -= 1
        self.names = outer
        self.pending = {v: None for v in self.pending if v in pending}

    @contextmanager
    def captured(self) -> Iterator[list[Line]]:
        """What is printed inside goes into the list instead."""
        outer = self.lines
        inner: list[Line] = []
        self.lines = inner
        try:
            yield inner
        finally:
            self.lines = outer

    # Values

    def take(self, value: int) -> Expr:
        """The expression of a value, for one of its uses."""
        if value not in self.exprs:
            raise NotAnExpression
        self.remaining[value] -= 1
        if not self.remaining[value]:
            self.pending.pop(value, None)
        return self.exprs[value]

    def simple(self, value: int) -> Expr:
        """The expression of a value, for an operation that writes it more than once: at most a name."""
        e = self.take(value)
        return e if e.is_simple else self.bind(self.values[value], e)

    def bind(self, value: Value, e: Expr) -> Expr:
        """Print a temporary that holds the value; from now on that is its expression."""
        if self.in_head:
            raise NotAnExpression
        name = self.names.take(value.name)
        self.emit(f"{self.declaration(value.type, name)} = {e.text};", value.loc)
        self.pending.pop(value.id, None)
        self.exprs[value.id] = ex.name(name)
        return self.exprs[value.id]

    def settle(self, variables: Iterable[int]) -> None:
        """Before these variables change: print temporaries for pending expressions that load them."""
        names = {self.slots[v].text for v in variables if v in self.slots}
        for value in [v for v in self.pending if names & self.exprs[v].reads]:
            self.bind(self.values[value], self.exprs[value])

    def _let(self, let: Let, following: After) -> None:
        if not self.layout.uses[let.value.id]:
            return
        if let.op == "load" and isinstance(let.attr, int) and self.is_unnamed(let.attr):
            raise NeedsVariable
        e = self.operation(let)
        fits = e.depth <= MAX_DEPTH and len(e.text) <= MAX_WIDTH
        inlined = let.value.id in self.layout.inlined
        if fits and not inlined and self._goes_into_a_variable(let.value, following):
            self.exprs[let.value.id] = e
            self.kept = let.value.id
        elif fits and inlined:
            self.exprs[let.value.id] = e
            self.pending[let.value.id] = None
        else:
            self.bind(let.value, e)

    def _goes_into_a_variable(self, value: Value, following: After) -> bool:
        """Whether the next statement stores it: then that variable's name stands for it, not a temporary."""
        store = following.first
        if not isinstance(store, Store) or store.value != value.id or not is_whole(store):
            return False
        if value.name not in (None, self.variables[store.variable].name) or store.variable in self.direct:
            return False
        return not self.opens_for(store, None, After(following.region, following.start + 1))

    # Statements

    def region(self, region: Region, number: int, tail: int | None = None, start: int = 0) -> bool:
        """Print a region from statement `start` on; whether it cannot be left at its end.

        `tail` is the variable that the function returns if the region is the last thing that it does. A store of it
        that ends the function becomes a `return`.
        """
        end = len(region)
        while end > start and isinstance(region[end - 1], Return):
            end -= 1
        for index in range(start, len(region)):
            statement, following = region[index], After(region, index + 1)
            last = index + 1 >= end
            ends = last and (following.first is not None or tail is not None)
            if ends and isinstance(statement, Store) and statement.variable == self.returned and is_whole(statement):
                self.emit(f"return {self.take(statement.value).text};", statement.loc)
                return True
            self._declare(number, index, statement, following)
            if self.statement(statement, number, index, tail if last else None, following):
                return True
        return False

    def _declare(self, number: int, index: int, statement: Stmt, following: After) -> None:
        for v in self.layout.declared.get((number, index), []):
            variable, zero = self.variables[v], self.layout.places[v].zero
            if v in self.slots or v in self.direct or self.is_unnamed(v):
                continue
            if zero:
                self.declare_zero(variable)
            elif not (isinstance(statement, Store) and statement.variable == v):
                name = self.slot(variable)
                self.emit(f"{self.declaration(variable.type, name)};", variable.loc)

    def slot(self, variable: Variable, default: str = "v") -> str:
        """A name for the variable, which is declared with it."""
        name = self.names.take(variable.name or self.load_names.get(variable.id), default)
        self.slots[variable.id] = ex.name(name)
        return name

    def declare_zero(self, variable: Variable) -> None:
        """Declare a variable that may be read before it is stored."""
        name = self.slot(variable)
        if variable.length is not None:
            self.emit(self.declare_array(variable, name), variable.loc)
        else:
            self.emit(f"{self.declaration(variable.type, name)} = {self.zero(variable.type).text};", variable.loc)

    def zero(self, type: Type) -> Expr:
        """The zero of a type."""
        return self.op_const(Let(Value(-1, type), "const", (), encode(type, [0] * type.size)))

    def statement(self, s: Stmt, number: int, index: int, tail: int | None, following: After) -> bool:
        """Print one statement; whether what follows cannot be reached."""
        inner = self.layout.inner.get((number, index), ())
        match s:
            case Let():
                self._let(s, following)
            case Store():
                self._store(s, following)
            case If():
                return self._if(s, inner, tail)
            case Loop():
                self.loop(s, inner)
            case Call():
                self._call(s, following)
            case Break():
                self.emit("break;", s.loc)
                return True
            case Continue():
                self.emit("continue;", s.loc)
                return True
            case Return():
                self._return(s, number)
                return True
        return False

    def is_unnamed(self, variable: int) -> bool:
        """Whether the variable is the function's result and has no name."""
        return self.unnamed and variable == self.returned

    def _return(self, s: Return, number: int) -> None:
        text = self.leave(self.current)
        if number or text != "return;":
            self.emit(text, s.loc)

    def _store(self, s: Store, following: After) -> None:
        e = self.take(s.value)
        variable = self.variables[s.variable]
        if self.is_unnamed(s.variable):
            raise NeedsVariable
        if s.variable in self.direct:
            self.emit(self.output(variable, e), s.loc)
        elif s.index is not None:
            self._store_element(s, s.index, e)
        elif s.variable in self.slots:
            self.settle([s.variable])
            self.emit(assignment(*self._part(s, self.slots[s.variable], e)), s.loc)
        elif self._continues_an_input(s.value, variable):
            self.slots[s.variable] = e
        elif self.opens_for(s, e, following):
            self.held[s.variable] = (e, s.loc)
        else:
            self.emit(f"{self.declaration(variable.type, self.slot(variable))} = {e.text};", s.loc)
        kept, self.kept = self.kept, None
        if kept == s.value and self.remaining[s.value]:
            self.exprs[s.value] = self.slots[s.variable]
            self.pending[s.value] = None

    def _continues_an_input(self, value: int, variable: Variable) -> bool:
        """Whether the variable starts as an input of its name that is not used again: then it is that parameter."""
        of_input = any(isinstance(i, Value) and i.id == value for i in self.current.inputs)
        if not of_input or self.remaining[value] or self.layout.places[variable.id].region:
            return False
        return self.inputs_are_variables and self.values[value].name == variable.name is not None

    def _part(self, s: Store, target: Expr, e: Expr) -> tuple[Expr, Expr]:
        """The components that are stored, and what is stored there."""
        type = self.variables[s.variable].type
        if s.components is None or type.size == 1:
            return target, e
        part = ex.member(target, "".join(COMPONENTS[c] for c in s.components))
        return part, self.component(e, type) if len(s.components) == 1 else e

    def _store_element(self, s: Store, index: int, e: Expr) -> None:
        """A store into an array: nothing happens where the index is out of range."""
        length = self.variables[s.variable].length
        assert length is not None
        self.settle([s.variable])
        at = self.signed(self.simple(index))
        text = assignment(*self._part(s, ex.element(self.slots[s.variable], at), e))
        fixed = constant_index(at)
        if fixed is None:
            self.emit(f"if ({self.inside(at, length).text}) {{", s.loc)
            with self.block():
                self.emit(text, s.loc)
            self.emit("}")
        elif 0 <= fixed < length:
            self.emit(text, s.loc)

    def inside(self, index: Expr, length: int) -> Expr:
        """Whether the index is in [0, length)."""
        return Expr(f"{index.text} >= 0 && {index.text} < {length}", ex.Level.AND, index.reads)

    def _call(self, s: Call, following: After) -> None:
        function = self.callees[s.function]
        changed = changed_variables(s, self.callees)
        if any(map(self.is_unnamed, changed)):
            raise NeedsVariable
        args = [
            self.signed(self.take(a)).text if isinstance(port, Value) else self.reference(a)
            for a, port in zip(s.args, function.inputs, strict=True)
        ]
        self.settle(changed)
        name = self.function_names[s.function]
        if len(s.results) == 1:
            self._call_with_result(name, [*args, *self.context(function)], s, following)
            return
        for result in s.results:
            temporary = self.names.take(result.name)
            self.emit(f"{self.declaration(result.type, temporary)};", s.loc)
            self.exprs[result.id] = ex.name(temporary)
            args.append(self.out_argument(temporary))
        self.emit(f"{name}({', '.join([*args, *self.context(function)])});", s.loc)

    def out_argument(self, name: str) -> str:
        """A temporary as an argument that the function only writes."""
        return name

    def _call_with_result(self, name: str, args: list[str], s: Call, following: After) -> None:
        result = s.results[0]
        made = Expr(f"{name}({', '.join(args)})", ex.Level.POSTFIX)
        after = following.first
        uses = self.layout.uses[result.id]
        if not uses:
            self.emit(f"{made.text};", s.loc)
        elif uses == 1 and isinstance(after, Store) and after.value == result.id and is_whole(after):
            self.exprs[result.id] = made  # the store that follows prints it at once
        else:
            self.bind(replace(result, loc=s.loc), made)

    def _if(self, s: If, inner: tuple[int, ...], tail: int | None) -> bool:
        condition = self.take(s.condition)
        self.settle(stored_variables((s,), self.callees))
        return self._branches(s, condition, inner, tail, "")

    def _branches(self, s: If, condition: Expr, inner: tuple[int, ...], tail: int | None, before: str) -> bool:
        then, orelse = (s.then, inner[0]), (s.orelse, inner[1])
        if not s.then and s.orelse:
            condition, then, orelse = ex.negation(condition), orelse, then
        self.emit(f"{before}if ({condition.text}) {{", s.loc)
        with self.block():
            ended = self.region(*then, tail)
        return self._else(*orelse, tail) and ended

    def _else(self, region: Region, number: int, tail: int | None) -> bool:
        if not region:
            self.emit("}")
            return False
        *lets, last = region
        if isinstance(last, If) and all(isinstance(s, Let) for s in lets) and not self.declares(number, len(region)):
            with self.head() as found:
                for s in lets:
                    self.statement(s, number, 0, None, After((), 0))
                found.append(self.take(last.condition))
                self.settle(stored_variables((last,), self.callees))
            if found:
                return self._branches(last, found[0], self.layout.inner[number, len(lets)], tail, "} else ")
        self.emit("} else {")
        with self.block():
            ended = self.region(region, number, tail)
        self.emit("}")
        return ended

    def declares(self, number: int, length: int) -> bool:
        """Whether a variable is declared before one of the region's first `length` statements."""
        return any((number, index) in self.layout.declared for index in range(length))

    @contextmanager
    def head(self) -> Iterator[list[Expr]]:
        """Try to print inside as expressions only; the list is empty, and nothing has happened, if that fails."""
        saved = self.state()
        outer, self.in_head = self.in_head, True
        found: list[Expr] = []
        try:
            yield found
        except NotAnExpression:
            found.clear()
            self.restore(saved)
        finally:
            self.in_head = outer

    def state(self) -> State:
        """What is known of values, to come back to."""
        return dict(self.exprs), Counter(self.remaining), dict(self.pending)

    def restore(self, saved: State) -> None:
        """Come back to an earlier state."""
        self.exprs, self.remaining, self.pending = saved

    # What `CLike` gives

    def loop(self, s: Loop, inner: tuple[int, ...]) -> None:
        """Print a loop."""
        raise KeyError(s)

    def opens_for(self, s: Store, e: Expr | None, following: After) -> bool:
        """Whether the store stands in the head of the `for` that follows."""
        return False


def is_whole(store: Store) -> bool:
    """Whether all of a variable is stored."""
    return store.components is None and store.index is None


def constant_index(index: Expr) -> int | None:
    """The index if it is a literal."""
    return int(index.text) if re.fullmatch(r"-?\d+", index.text) else None


def assignment(target: Expr, e: Expr) -> str:
    """`x = e;`, or `x += e;` where e is x + e."""
    if e.update is not None and e.update[1] == target.text:
        return f"{target.text} {e.update[0]}= {e.update[2]};"
    return f"{target.text} = {e.text};"


def comment(loc: Loc) -> str:
    """`// file.py:12`, whatever the file is called."""
    file = re.sub(r"[^A-Za-z0-9_. -]", "_", loc.file.replace("\\", "/").rsplit("/", 1)[-1])[:60]
    return f"// {file}:{loc.line}"


def text_of(lines: Iterable[Line]) -> str:
    """The lines as text, with their comments."""
    return "".join(f"{text}  {comment(loc)}\n" if loc else f"{text}\n" for text, loc in lines)
