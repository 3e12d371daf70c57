"""The walk through a function's text that finds names which blocks rebind, aliases, and jumps out of blocks.

Stage: record, before the function runs. Takes the syntax tree of a function and its scope; raises the first mistake
as a `RecordError`, and collects the functions that are called, which deserve the same look.

    Flow(node, scope).check()

Statements are visited once, in order. At the end of a block, what it assigned is marked as escaped; a use of such a
place is the mistake "rebound and used after". At the end of a loop, what was read before it was assigned in the body
and is assigned at the end of it is the mistake "used in its next iteration".
"""

from __future__ import annotations

import ast
import itertools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FunctionType

from shpy.errors import RecordError
from shpy.lang.mistakes import findings
from shpy.lang.mistakes.expressions import Expressions
from shpy.lang.mistakes.facts import NO_OBJECT, Block, State, joined
from shpy.lang.mistakes.kinds import HOST, NUMBER, UNKNOWN, VALUE, Kind, Known, plain_fields
from shpy.lang.mistakes.places import Places
from shpy.lang.mistakes.repeats import depth_of_repeats
from shpy.lang.recording.scope import UNRESOLVED, Scope
from shpy.lang.recording.tree import FunctionNode, quoted

_OPENERS = frozenset({"SH_IF", "SH_ELIF", "SH_ELSE", "SH_WHILE", "SH_DO", "SH_FOR"})
_EXITS = frozenset({"SH_BREAK", "SH_CONTINUE", "SH_RETURN", "SH_DISCARD", "SH_UNTIL"})


class Flow:
    """The walk through one function's statements."""

    def __init__(
        self, node: FunctionNode, scope: Scope, *, is_program: bool = False, function: FunctionType | None = None
    ) -> None:
        self.scope = scope
        self.places = Places(scope)
        self.expressions = Expressions(scope, self.places)
        self.judge = self.places.judge
        self.reachable = True
        self.definitions: list[FunctionNode] = []
        self.node = node
        self.is_program = is_program
        self.annotations = dict(function.__annotations__) if function is not None else {}
        self.loop_exits: list[list[State]] = []

    def check(self) -> None:
        """Raise the first mistake, if there is any; functions defined inside are checked after it."""
        self._arguments()
        self._body(self.node.body)
        for inner in self.definitions:
            flow = Flow(inner, self.scope.nested(inner))
            flow.expressions.called = self.called
            flow.check()

    @property
    def called(self) -> list[object]:
        """The functions that the text calls, which deserve the same check."""
        return self.expressions.called

    def _arguments(self) -> None:
        arguments = self.node.args
        for argument in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs):
            if argument.arg in self.scope.arguments:
                inference = self.judge.thing(self.scope.arguments[argument.arg])
            else:
                annotated = self._annotation(argument)
                inference = self.judge.made_by(*annotated) if annotated is not None else UNKNOWN
            self.places.bind_name(argument.arg, argument, inference)

    def _annotation(self, argument: ast.arg) -> tuple[object, str] | None:
        """Return an argument's type and how it is written; the function's own where the text has another one.

        The code of a function does not hold its annotations, so those in an edited file may differ.
        """
        annotated = self.scope.annotation(argument.annotation)
        hint = self.annotations.get(argument.arg, annotated and annotated[0])
        if isinstance(hint, str) or annotated is None or hint is annotated[0]:
            return annotated
        return hint, f"{self.scope.prefix}{getattr(hint, '__name__', hint)}"

    def _body(self, statements: Sequence[ast.stmt]) -> None:
        for statement in statements:
            if not self.reachable:
                break
            self._statement(statement)

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Assign():
                self._assign(node)
            case ast.AnnAssign(value=value) if value is not None:
                self.expressions.visit(value)
                self._bind_value(node, [node.target], value)
            case ast.AugAssign():
                self._augment(node)
            case ast.With() | ast.AsyncWith():
                self._with(node, list(node.items))
            case ast.If():
                self.expressions.visit(node.test)
                self._branches([node.body, node.orelse])
            case ast.For() | ast.AsyncFor() | ast.While():
                self._python_loop(node)
            case ast.Match():
                self._match(node)
            case ast.Try() | ast.TryStar():
                self._try(node)
            case ast.Return() | ast.Break() | ast.Continue() | ast.Raise():
                self._jump(node)
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                self.definitions.append(node)
                self.places.bind_name(node.name, node, HOST)
            case ast.ClassDef():
                self.places.bind_name(node.name, node, HOST)
            case ast.Expr():
                self._alone(node)
            case ast.Import() | ast.ImportFrom():
                for alias in node.names:
                    self.places.bind_name((alias.asname or alias.name).partition(".")[0], node, HOST)
            case ast.Delete():
                for target in node.targets:
                    self.places.state.pop(ast.unparse(target), None)
            case ast.Assert():
                self.expressions.visit(node.test)
            case _:
                pass

    # Assignments.

    def _assign(self, node: ast.Assign) -> None:
        self.expressions.visit(node.value)
        if isinstance(node.value, ast.Tuple):
            for target in node.targets:
                if isinstance(target, ast.Tuple) and len(target.elts) == len(node.value.elts):
                    self._check_crossed(node, target.elts, node.value.elts)
        self._bind_value(node, node.targets, node.value)

    def _bind_value(self, node: ast.Assign | ast.AnnAssign, targets: list[ast.expr], value: ast.expr) -> None:
        inference = self.judge.kind(value)
        shared = self.places.object_of(value)
        for target in targets:
            if isinstance(target, ast.Name):
                fact = self.places.bind_name(target.id, node, inference, value=value, shared=shared)
                if inference.kind is Kind.VALUE:
                    shared = fact.object  # `a = b = x + 1` names one value twice
                else:
                    fact.repeats = depth_of_repeats(value, self.judge, self.scope)
                self._display(target.id, node, value)
            else:
                self._target(target, node, inference, value)

    def _display(self, name: str, node: ast.stmt, value: ast.expr) -> None:
        """Bind the items of a display, `d = {"k": x}` binds `d['k']` too, and the fields of plain data."""
        items: list[tuple[str, ast.expr]] = []
        if isinstance(value, ast.Dict):
            pairs = zip(value.keys, value.values, strict=True)
            items = [(ast.unparse(k), item) for k, item in pairs if isinstance(k, ast.Constant)]
        elif isinstance(value, ast.List) and not any(isinstance(e, ast.Starred) for e in value.elts):
            items = [(str(k), item) for k, item in enumerate(value.elts)]
        for key, item in items:
            self.places.bind_path(f"{name}[{key}]", node, self.judge.kind(item), value=item)
        if isinstance(value, ast.Call):
            for attribute, field in plain_fields(self.scope.resolve(value.func), value):
                kind = NUMBER if field is None else self.judge.kind(field)
                self.places.bind_path(f"{name}.{attribute}", node, kind, value=field)

    def _target(
        self, target: ast.expr, node: ast.stmt, inference: Known, value: ast.expr | None, shared: int = NO_OBJECT
    ) -> None:
        """Bind any target. `shared` is the object of a value that has another name already."""
        match target:
            case ast.Name():
                self.places.bind_name(target.id, node, inference, value=value, shared=shared)
            case ast.Tuple() | ast.List():
                pairs: list[ast.expr | None] = [None] * len(target.elts)
                if isinstance(value, ast.Tuple | ast.List) and len(value.elts) == len(target.elts):
                    pairs = list(value.elts)
                part = VALUE if inference.kind is Kind.VALUE else UNKNOWN
                # all values are found before the first name is bound, as Python does: `a, b = b, a`
                kinds = [self.judge.kind(p) if p is not None else part for p in pairs]
                objects = [self.places.object_of(p) for p in pairs]
                for element, pair, kind, thing in zip(target.elts, pairs, kinds, objects, strict=True):
                    self._target(element, node, kind, pair, thing)
            case ast.Starred():
                self._target(target.value, node, HOST, None)
            case ast.Attribute() | ast.Subscript():
                self._store(target, node, inference, value)
            case _:
                pass

    def _store(
        self, target: ast.Attribute | ast.Subscript, node: ast.stmt, inference: Known, value: ast.expr | None
    ) -> None:
        """Visit a store: `x.xy = …` and `x[:] = …` change a value; `self.k = …` and `d["k"] = …` rebind."""
        self.expressions.store_operands(target)
        self.places.check_repeats(target, node, rebinds=True)
        whole = self.judge.kind(target.value)
        if whole.kind is Kind.VALUE:
            root = _root(target)
            if root is not None:
                self.places.change(target, root, node)
        elif isinstance(target, ast.Subscript) and isinstance(target.slice, ast.Slice):
            if whole.holds and isinstance(target.value, ast.Name):  # other values for the items of a list
                self.places.bind_name(target.value.id, node, whole, value=value)
        elif whole.kind is Kind.HOST:
            path = ast.unparse(target)
            existed = path in self.expressions.read_paths or self.scope.resolve(target) is not UNRESOLVED
            self.places.bind_path(path, node, inference, value=value, existed=existed)

    def _augment(self, node: ast.AugAssign) -> None:
        """Visit `x += v`: a store in place for a value, a rebinding for a number of Python."""
        self.expressions.visit(node.value)
        target = node.target
        place = ast.unparse(target)
        inference = self.judge.kind(target)
        if isinstance(target, ast.Name):
            self.places.use(place, target)
        else:
            self.expressions.store_operands(target)
            self.places.use(place, target)
            self.places.check_repeats(target, node, rebinds=False)
        if inference.kind is Kind.VALUE:
            root = _root(target)
            if root is not None:
                self.places.change(target, root, node)
        elif inference.kind is Kind.NUMBER:
            added = self.judge.kind(node.value)
            result = NUMBER if added.kind is Kind.NUMBER else Known(added.kind)
            if isinstance(target, ast.Name):
                self.places.bind_name(place, node, result, value=node.value)
            else:
                self.places.bind_path(place, node, result, value=node.value, existed=True)

    def _check_crossed(self, node: ast.Assign, targets: list[ast.expr], values: list[ast.expr]) -> None:
        for first, target in enumerate(targets):
            name = self._stored_name(target)
            for later in range(first + 1, len(values)):
                value = values[later]
                if name is None or not isinstance(value, ast.Name) or value.id != name:
                    continue
                if self._stored_name(targets[later]) is None:
                    continue
                other = values[first]
                swap: tuple[str, str] | None = None
                if len(targets) == 2 and isinstance(other, ast.Name) and other.id == self._stored_name(targets[1]):
                    swap = (name, other.id)
                raise findings.crossed(self.scope.text, node, name, targets[later], swap, self.scope.prefix)

    def _stored_name(self, target: ast.expr) -> str | None:
        """Return the `x` of `x[:] = …`, or of any store into a plain name's value."""
        if not isinstance(target, ast.Subscript | ast.Attribute) or not isinstance(target.value, ast.Name):
            return None
        kind = self.judge.kind(target.value).kind
        whole = isinstance(target, ast.Subscript) and ast.unparse(target.slice) == ":"
        return target.value.id if kind is Kind.VALUE or (whole and kind is Kind.UNKNOWN) else None

    # Blocks and loops.

    def _with(self, node: ast.With | ast.AsyncWith, items: list[ast.withitem]) -> None:
        if not items:
            self._body(node.body)
            return
        item, *rest = items
        call = item.context_expr
        control = self.scope.control(call.func if isinstance(call, ast.Call) else call)
        if control not in _OPENERS:
            self.expressions.visit(call)
            if item.optional_vars is not None:
                self._target(item.optional_vars, node, UNKNOWN, None)
            self._with(node, rest)
            return
        if not isinstance(call, ast.Call):
            raise findings.without_call(self.scope.text, call, block=True)
        if control == "SH_DO" and not rest:
            self._check_until(node.body)
        self._block(node, item, call, control, rest)

    def _block(
        self, node: ast.With | ast.AsyncWith, item: ast.withitem, call: ast.Call, control: str, rest: list[ast.withitem]
    ) -> None:
        written = f"{quoted(self.scope.text, call.func)}({'…' if call.args or call.keywords else ''})"
        block = Block(control, written, node.lineno)
        with self.places.branch(control):
            if control != "SH_WHILE":
                self.expressions.visit(call)
            with self.inside(block):
                if control == "SH_WHILE":
                    self.expressions.visit(call)
                if isinstance(item.optional_vars, ast.Name):
                    self.places.bind_name(item.optional_vars.id, node, VALUE, index=True)
                self._with(node, rest)
        self.places.leave(block)

    @contextmanager
    def inside(self, block: Block) -> Iterator[None]:
        """Open a block or loop; at its end, consider its next iteration."""
        block.start = self.places.tick()
        self.places.open.append(block)
        yield
        self.places.open.pop()
        if block.is_loop:
            self._next_iteration(block)

    def _next_iteration(self, block: Block) -> None:
        """Check what the next iteration reads: the names as the body left them."""
        # `x is None` asks Python: metaprogramming that starts with nothing.
        asked = {use.place for use in block.exposed if use.asks_none}
        for use in block.exposed:
            for fact in self.places.state.get(use.place, ()):
                if fact.when < block.start or use.place in asked:
                    continue
                earlier = () if use.fact is None else (use.fact,)
                if not fact.suspicious(*earlier):
                    continue
                fact.before = (*fact.before, *earlier)
                if block.control is not None:
                    raise self.places.rebound(fact, block, use.node, next_iteration=True)
                if fact.escaped is not None:
                    raise self.places.rebound(fact, fact.escaped, use.node, next_iteration=False)
            same = use.fact
            if same is not None and use.reads and self.places.state.get(use.place) == (same,):
                self.places.check_alias(same, use.node, since=block.start, next_iteration=True)
            elif same is None and use.reads and isinstance(use.node, ast.Attribute):
                self.places.check_field(use.node, since=block.start, next_iteration=True)

    def _check_until(self, body: list[ast.stmt]) -> None:
        for statement, following in itertools.pairwise(body):
            if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call):
                if self.scope.control(statement.value.func) != "SH_UNTIL":
                    continue
                if isinstance(following, ast.Pass | ast.Expr) and not isinstance(
                    getattr(following, "value", None), ast.Call
                ):
                    continue
                raise findings.until_not_last(self.scope.text, statement, following)

    def _branches(self, bodies: list[list[ast.stmt]]) -> None:
        start, when = self.places.state, self.places.tick()
        ends: list[State] = []
        for body in bodies:
            self.places.state, self.reachable = dict(start), True
            self._body(body)
            if self.reachable:
                ends.append(self.places.state)
        self.reachable = bool(ends)
        self.places.state = joined(start, ends, when)

    def _python_loop(self, node: ast.For | ast.AsyncFor | ast.While) -> None:
        if not isinstance(node, ast.While):
            self.expressions.visit(node.iter)
        start = self.places.state
        self.places.state = dict(start)
        self.loop_exits.append([])
        block = Block(None, "", node.lineno)
        with self.inside(block):
            if isinstance(node, ast.While):
                self.expressions.visit(node.test)
            else:
                self._target(node.target, node, self._element(node.iter), None)
            self._body(node.body)
            ends = self.loop_exits.pop()
            self.places.state = joined(start, [*([self.places.state] if self.reachable else []), *ends], block.start)
        self.reachable = True
        self._body(node.orelse)

    def _element(self, iterated: ast.expr) -> Known:
        """Return what is known of a `for` loop's variable."""
        if isinstance(iterated, ast.Call) and self.scope.resolve(iterated.func) is range:
            return NUMBER
        if isinstance(iterated, ast.Tuple | ast.List):
            kinds = {self.judge.kind(e).kind for e in iterated.elts}
            return Known(kinds.pop()) if len(kinds) == 1 else UNKNOWN
        return VALUE if self.judge.kind(iterated).kind is Kind.VALUE else UNKNOWN

    def _match(self, node: ast.Match) -> None:
        self.expressions.visit(node.subject)
        bodies: list[list[ast.stmt]] = []
        for case in node.cases:
            for pattern in ast.walk(case.pattern):
                if isinstance(pattern, ast.MatchAs | ast.MatchStar) and pattern.name:
                    self.places.bind_name(pattern.name, case.pattern, UNKNOWN)
            if case.guard is not None:
                self.expressions.visit(case.guard)
            bodies.append(case.body)
        self._branches([*bodies, []])

    def _try(self, node: ast.Try | ast.TryStar) -> None:
        self._branches([[*node.body, *node.orelse], *([*h.body] for h in node.handlers)])
        self._body(node.finalbody)

    # Jumps, and expressions that stand alone.

    def _jump(self, node: ast.Return | ast.Break | ast.Continue | ast.Raise) -> None:
        for part in ast.iter_child_nodes(node):
            if isinstance(part, ast.expr):
                self.expressions.visit(part)
        if isinstance(node, ast.Return):
            self._check_returned(node, node.value)
        elif isinstance(node, ast.Break | ast.Continue):
            self._check_loop_jump(node)
            if self.loop_exits:
                self.loop_exits[-1].append(self.places.state)
        self.reachable = False

    def _check_loop_jump(self, node: ast.Break | ast.Continue) -> None:
        if not self.places.open or self.places.open[-1].control is None:
            return
        cure = "SH_BREAK()" if isinstance(node, ast.Break) else "SH_CONTINUE()"
        loop = next((b for b in reversed(self.places.open) if b.is_loop), None)
        if loop is None or loop.control is None:
            cure = f"make the loop a `with SH_FOR(…) as i:`, and write `{cure}`"
        raise self._left(node, self.places.open[-1], cure)

    def _check_returned(self, node: ast.AST, value: ast.expr | None) -> None:
        block = next((b for b in reversed(self.places.open) if b.control), None)
        if block is not None:
            raise self._left(node, block, f"SH_RETURN({ast.unparse(value) if value is not None else ''})")

    def _left(self, node: ast.AST, block: Block, cure: str) -> RecordError:
        word = {ast.Return: "return", ast.Break: "break", ast.Continue: "continue"}.get(type(node), "yield")
        return findings.leaves(findings.at(self.scope.text, node), word, block.written, cure)

    def _alone(self, node: ast.Expr) -> None:
        value = node.value
        if isinstance(value, ast.Call):
            control = self.scope.control(value.func)
            if control in _OPENERS:
                raise findings.without_with(self.scope.text, value, control)
        elif isinstance(value, ast.Name | ast.Attribute):
            control = self.scope.control(value)
            if control in _EXITS or control in _OPENERS:
                raise findings.without_call(self.scope.text, value, block=control in _OPENERS)
        elif isinstance(value, ast.Yield | ast.YieldFrom) and self.is_program:
            self._check_returned(value, value.value)
        self.expressions.visit(value)


def _root(node: ast.expr) -> str | None:
    """Return the name whose value a store changes: `ray` for `ray.o.x`."""
    while isinstance(node, ast.Attribute | ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else None
