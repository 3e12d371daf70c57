"""The printer of C-like text: loops and functions, above the statements and operations.

Stage: emit. Takes a prepared module (no Discard, no composite operation that the target lacks) and gives lines of
text that read as if a person had written them. A target subclasses `CLike` and fills in the hooks of `Operations`
(types, literals, functions), `Statements` (declarations) and those below. The IR has one loop; its usual shapes are
found again:

    body begins with If(not c) { Break }                        while (c) { ... }
    ... and `continuing` is one store                           for (int i = 0; i < n; i += 1) { ... }
    until c, which reads nothing declared in the loop           do { ... } while (!c);
    any other                                                   while (true) { ... if (c) { break; } }
    one whose `continuing` cannot follow a `continue`           again = false; while (true) { if (again) { ... } ... }
"""

from __future__ import annotations

from collections import Counter

from shpy.backends import expressions as ex
from shpy.backends.emit.names import Names
from shpy.backends.expressions import Expr
from shpy.backends.layout import After, access_count, lay_out, stored_variables
from shpy.backends.statements import NeedsVariable, NotAnExpression, Statements, is_whole
from shpy.ir.nodes import Break, Function, If, Let, Loc, Loop, Module, Region, Store
from shpy.ir.traverse import continues, defined, uses, variables_of, walk
from shpy.ir.types import vec


class CLike(Statements):
    """Prints the functions of one module into `lines`."""

    def __init__(self, module: Module) -> None:
        super().__init__(module)
        self.globals = Names(self.target)

    # Hooks

    def step(self, condition: Expr | None, statement: str) -> str:
        """The last part of a `for`, from the statement that makes the step.

        `condition` held when the iteration began; it is None if the iteration may change its value.
        """
        return statement

    def test(self, condition: Expr | None) -> Expr | None:
        """Return what stands in the head or foot of a loop that goes on while `condition` holds; None: always."""
        return condition

    # Functions

    def begin(self, function: Function) -> None:
        """Forget the last function; plan this one."""
        self.current = function
        self.layout = lay_out(function, self.callees)
        self.names = self.globals.scope()
        self.exprs, self.slots, self.pending, self.held = {}, {}, {}, {}
        self.direct = frozenset()
        self.returned, self.unnamed = None, False
        self.values = {v.id: v for v in defined(function)}
        self.types = {v.id: v.type for v in self.values.values()}
        self.variables = {v.id: v for v in variables_of(function)}
        self.remaining = Counter(self.layout.uses)
        self.load_names = {}
        for s in walk(function.body):
            if isinstance(s, Let) and s.op == "load" and isinstance(s.attr, int) and s.value.name:
                self.load_names.setdefault(s.attr, s.value.name)
        self.last = None

    def body(self, function: Function, *, returns: bool) -> None:
        """The statements of `function`; `returns` if it has one result and returns it at its end.

        Where every way ends in a store of the result, each becomes a `return`, and there is no variable for it.
        """
        if returns:
            self.returned = function.outputs[0].id
            self.unnamed = True
            saved = (self.state(), len(self.lines), dict(self.slots), self.names.scope())
            try:
                self._body(function)
                return
            except NeedsVariable:
                (self.exprs, self.remaining, self.pending), length, self.slots, self.names = saved
                del self.lines[length:]
                self.unnamed, self.last = False, None
        self._body(function)

    def _body(self, function: Function) -> None:
        if not self.region(function.body, 0, tail=self.returned):
            for variable in self.layout.declared.get((0, len(function.body)), []):
                if variable not in self.slots and variable not in self.direct and not self.is_unnamed(variable):
                    self.declare_zero(self.variables[variable])
            if self.returned is not None:
                self.emit(self.leave(function))

    # Loops

    def loop(self, s: Loop, inner: tuple[int, ...]) -> None:
        """Print a loop in the plainest shape that it has."""
        self.settle(stored_variables((s,), self.callees))
        outer, self.names = self.names, self.names.scope()
        held, self.held = self.held, {}  # a loop inside has starts of its own
        counters = {v: self.slot(self.variables[v], "i") for v in held}
        starts = {v: self._declared(v, held[v][0]) for v in held}
        saved = self.state()
        start, condition = self._first_test(s, inner[0])
        step = self._step(s, inner, start)
        if step is not None:
            start_text = ", ".join(starts.values())
            tested = self.test(condition)
            test = f" {tested.text}" if tested else ""
            changed = {self.slots[v].text for v in stored_variables(s.body, self.callees) if v in self.slots}
            holds = None if condition is None or changed & condition.reads else condition
            self._iterations(f"for ({start_text};{test}; {self.step(holds, step)})", s, inner, start)
        else:
            for v, name in counters.items():
                outer.reserve(name)
                self.emit(f"{starts[v]};", held[v][1])
            skips = continues(s) and (s.continuing or s.until is not None)
            until = self._until_of_continues(s, inner[1]) if skips and not condition else None
            if until is not None:
                self._iterations("do", s, inner, start, f"}} {self._while(ex.negation(until))};")
            elif skips:
                self.restore(saved)
                self._gated(s, inner, outer)
            else:
                self._plain(condition, s, inner, start)
        self.names = outer

    def _while(self, condition: Expr | None) -> str:
        tested = self.test(condition)
        return f"while ({tested.text if tested else 'true'})"

    def _declared(self, variable: int, begin: Expr) -> str:
        declaration = self.declaration(self.variables[variable].type, self.slots[variable].text)
        return f"{declaration} = {begin.text}"

    def _first_test(self, s: Loop, number: int) -> tuple[int, Expr | None]:
        """Where the body goes on after a first `If(c) { Break }`, and the opposite of c; (0, None) without one."""
        at = leading_test(s.body)
        if at is None or self.declares(number, at + 1):
            return 0, None
        with self.head() as found:
            for index, let in enumerate(s.body[:at]):
                self.statement(let, number, index, None, After((), 0))
            test = s.body[at]
            assert isinstance(test, If)
            found.append(ex.negation(self.take(test.condition)))
        return (at + 1, found[0]) if found else (0, None)

    def _step(self, s: Loop, inner: tuple[int, ...], start: int) -> str | None:
        """The one assignment that `continuing` is, if it is one that can stand in the head of a `for`."""
        number = inner[1]
        if s.until is not None or not is_step(s.continuing) or self.declares(number, len(s.continuing)):
            return None
        changed = {self.slots[v].text for v in stored_variables(s.body, self.callees) if v in self.slots}
        early = {let.value.id for let in s.body[:start] if isinstance(let, Let)}
        # Nothing that is pending now is pending any more when the step comes.
        waiting, self.pending = self.pending, {}
        last = self.last
        with self.captured() as lines, self.head() as found:
            for let in s.continuing:
                if any(v in early and changed & self.exprs[v].reads for v in uses(let)):
                    raise NotAnExpression
            self.region(s.continuing, number)
            found.append(Expr(lines[-1][0].strip().removesuffix(";")))
        self.pending = {v: None for v in waiting if self.remaining[v]}
        self.last = last
        return found[0].text if found else None

    def _until_of_continues(self, s: Loop, number: int) -> Expr | None:
        """The condition that ends a loop with a `continue`, if `continuing` does nothing but compute it."""
        if s.until is None or not all(isinstance(let, Let) for let in s.continuing):
            return None
        with self.head() as found:
            for index, let in enumerate(s.continuing):
                self.statement(let, number, index, None, After((), 0))
            found.append(self.take(s.until))
        return found[0] if found else None

    def _iterations(self, head: str, s: Loop, inner: tuple[int, ...], start: int, foot: str = "}") -> None:
        self.emit(f"{head} {{", s.loc)
        with self.block():
            self.region(s.body, inner[0], start=start)
        self.emit(foot, None if foot == "}" else _line_of_test(s))

    def _plain(self, condition: Expr | None, s: Loop, inner: tuple[int, ...], start: int) -> None:
        """Body, continuing and test, one after the other."""
        around = self.names
        before, self.last = self.last, s.loc
        until: Expr | None = None
        with self.captured() as lines, self.block():
            ended = self.region(s.body, inner[0], start=start)
            if not ended:
                self.region(s.continuing, inner[1])
            if s.until is not None and not ended:
                until = self.take(s.until)
                outside = all(r.lstrip("*") in around for r in until.reads)
                if condition is not None or not outside:
                    self.emit(f"if ({until.text}) {{", _line_of_test(s))
                    with self.block():
                        self.emit("break;")
                    self.emit("}")
                    until = None
        self.last = before
        self.emit(f"{'do' if until else self._while(condition)} {{", s.loc)
        self.lines += lines
        self.last = None
        if until:
            self.emit(f"}} {self._while(ex.negation(until))};", _line_of_test(s))
        else:
            self.emit("}")

    def _gated(self, s: Loop, inner: tuple[int, ...], outer: Names) -> None:
        """Print a loop whose step and test are at its top, skipped in the first iteration: `continue` goes there."""
        again = outer.take("again")
        self.names.reserve(again)
        self.emit(f"{self.declaration(vec('b'), again)} = false;", s.loc)
        self.emit(f"{self._while(None)} {{")
        with self.block():
            self.emit(f"if ({again}) {{")
            with self.block():
                self.region(s.continuing, inner[1])
                if s.until is not None:
                    self.emit(f"if ({self.take(s.until).text}) {{")
                    with self.block():
                        self.emit("break;")
                    self.emit("}")
            self.emit("}")
            self.emit(f"{again} = true;")
            self.region(s.body, inner[0])
        self.emit("}")

    def opens_for(self, s: Store, e: Expr | None, following: After) -> bool:
        """Whether the store gives a counter its start, and nothing but the loop that follows touches it.

        Stores of what `e`, the start, does not read may come between.
        """
        if s.variable not in self.layout.counters:
            return False
        between: list[int] = []
        loop = None
        for loop in following.all():
            if isinstance(loop, Store):
                between.append(loop.variable)
            elif not isinstance(loop, Let):
                break
        if not isinstance(loop, Loop) or loop.until is not None or not is_step(loop.continuing):
            return False
        step = loop.continuing[-1]
        assert isinstance(step, Store)
        if step.variable != s.variable or leading_test(loop.body) is None:
            return False
        if e is not None and any(self.slots[v].text in e.reads for v in between if v in self.slots):
            return False
        inside = access_count((loop,), s.variable, self.current, self.callees)
        return self.layout.accesses[s.variable] == inside + 1


def leading_test(body: Region) -> int | None:
    """The index of the `If(c) { Break }` that comes after nothing but Lets."""
    at = next((i for i, s in enumerate(body) if not isinstance(s, Let)), None)
    if at is None:
        return None
    test = body[at]
    breaks = isinstance(test, If) and not test.orelse and len(test.then) == 1 and isinstance(test.then[0], Break)
    return at if breaks else None


def is_step(region: Region) -> bool:
    """Whether the region is Lets and then one store of a whole variable."""
    *lets, last = region or (None,)
    return isinstance(last, Store) and is_whole(last) and all(isinstance(s, Let) for s in lets)


def _line_of_test(loop: Loop) -> Loc | None:
    """The user's line that computes what ends the loop."""
    made = (s.value for s in (*loop.body, *loop.continuing) if isinstance(s, Let))
    return next((value.loc for value in made if value.id == loop.until), None)
