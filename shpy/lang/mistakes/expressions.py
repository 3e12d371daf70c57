"""The expressions of a walk (flow.py): which places they use, which names they bind, which functions they call.

Stage: record. Keeps the state that statements change; raises when a place is used that a closed block has rebound, or
when a value is read that was changed through another name.
"""

from __future__ import annotations

import ast

from shpy.errors import RecordError
from shpy.ir.nodes import Loc
from shpy.lang.mistakes import findings
from shpy.lang.mistakes.explain import conversion_of
from shpy.lang.mistakes.facts import NO_OBJECT, Block, Change, Fact, State, Use, copy_instead, store_instead
from shpy.lang.mistakes.kinds import Judge, Kind, Known
from shpy.lang.recording.scope import Scope, bound_names
from shpy.lang.recording.tree import FunctionNode, quoted


class Expressions:
    """The state of one function's walk, and its steps through expressions."""

    def __init__(self, scope: Scope) -> None:
        self.scope = scope
        self.state: State = {}
        self.reachable = True
        self.open: list[Block] = []
        self.changes: dict[int, list[Change]] = {}
        self.definitions: list[FunctionNode] = []
        self.called: list[object] = []
        self.judge = Judge(scope, self._known)
        self.read_paths: set[str] = set()
        self._hidden: list[set[str]] = []
        self._asking_none = False
        self._clock = 0
        self._objects = NO_OBJECT

    # The clock and the state.

    def tick(self) -> int:
        """Return the next moment in the order of the text."""
        self._clock += 1
        return self._clock

    def new_object(self) -> int:
        """Return an object that no name has yet."""
        self._objects += 1
        return self._objects

    def single(self, place: str) -> Fact | None:
        """Return the assignment that a place comes from, if there is just one."""
        facts = self.state.get(place, ())
        return facts[0] if len(facts) == 1 else None

    def _known(self, place: str) -> Known | None:
        if any(place in hidden for hidden in self._hidden):
            return Known(Kind.UNKNOWN)
        facts = self.state.get(place)
        if not facts:
            return None
        kinds = {f.known.kind for f in facts}
        if len(kinds) > 1:
            return Known(Kind.UNKNOWN)
        return facts[0].known if len(facts) == 1 else Known(kinds.pop())

    def bind_name(
        self, name: str, node: ast.AST, known: Known, *, value: ast.expr | None = None, index: bool = False
    ) -> Fact:
        """Bind a name; what was known of its items and attributes is forgotten."""
        for place in [p for p in self.state if p.startswith((f"{name}.", f"{name}["))]:
            del self.state[place]
        return self.bind_path(name, node, known, value=value, index=index)

    def bind_path(
        self,
        place: str,
        node: ast.AST,
        known: Known,
        *,
        value: ast.expr | None = None,
        existed: bool = False,
        index: bool = False,
    ) -> Fact:
        """Bind a place: from here on it comes from this assignment."""
        before = self.state.get(place, ())
        existed = existed or any(f.escaped is None for f in before)
        fact = Fact(place, node, self.tick(), known, self.new_object(), before, existed, value, index=index)
        self.state[place] = (fact,)
        return fact

    def change(self, place: str, node: ast.stmt) -> None:
        """Note a store into the value of a name."""
        fact = self.single(place)
        if fact is not None and fact.object != NO_OBJECT:
            self.changes.setdefault(fact.object, []).append(Change(place, node, self.tick(), fact))

    # Uses.

    def use(self, place: str, node: ast.AST, *, reads: bool = True) -> None:
        """Note the use of a place: for what it holds (`reads`), or only to store into it."""
        if any(place in hidden for hidden in self._hidden):
            return
        facts = self.state.get(place, ())
        for fact in facts:
            if fact.escaped is not None and fact.suspicious():
                raise self.rebound(fact, fact.escaped, node, next_iteration=False)
            self._expose(Use(place, node, fact, reads, self._asking_none), fact.when)
            if reads and len(facts) == 1:
                self.check_alias(fact, node)
        if not facts:
            self._expose(Use(place, node, None, reads, self._asking_none), 0)

    def _expose(self, use: Use, when: int) -> None:
        for block in self.open:
            if block.is_loop and when < block.start:
                block.exposed.append(use)

    def rebound(self, fact: Fact, block: Block, node: ast.AST, *, next_iteration: bool) -> RecordError:
        """Return the error for a place that a block rebinds."""
        file, prefix = self.scope.file, self.scope.prefix
        loc = findings.at(file, fact.node)
        if fact.index:
            return findings.index_used(loc, fact.place, block.written, node, prefix)
        place = fact.place if fact.place.isidentifier() else quoted(file, node)
        cure = store_instead(file, prefix, place, fact)
        made = not (fact.existed or next_iteration)
        return findings.rebound(loc, place, block.written, _used(node, next_iteration), cure, made=made)

    def check_alias(self, fact: Fact, node: ast.AST, *, since: int = 0, next_iteration: bool = False) -> None:
        """Raise the error for a value read here that was changed through another of its names since it got this one."""
        if fact.object == NO_OBJECT:
            return
        for change in self.changes.get(fact.object, ()):
            if change.place == fact.place or change.when < max(fact.when, since):
                continue
            aliases = [f for f in (fact, change.fact) if f.alias is not None]
            if aliases:
                alias = max(aliases, key=lambda f: f.when)
                assert alias.alias is not None
                file, when = self.scope.file, _used(node, next_iteration).replace(" its ", " the ")
                cure = copy_instead(file, alias)
                raise findings.aliased(file, alias.alias, change.node, fact.place, when, cure)

    # Expressions, in the order in which they are evaluated.

    def expression(self, node: ast.expr) -> None:
        """Go through an expression."""
        match node:
            case ast.Name(ctx=ast.Load()):
                self.use(node.id, node)
            case ast.Attribute() | ast.Subscript():
                self._place(node)
            case ast.Lambda():
                pass  # runs later, if at all
            case ast.ListComp() | ast.SetComp() | ast.GeneratorExp():
                self._comprehension(node.generators, [node.elt])
            case ast.DictComp():
                self._comprehension(node.generators, [node.key, node.value])
            case ast.NamedExpr():
                self.expression(node.value)
                self.bind_name(node.target.id, node, self.judge.kind(node.value), value=node.value)
            case ast.Call():
                self._call(node)
            case ast.Compare():
                self._compare(node)
            case _:
                for child in ast.iter_child_nodes(node):
                    if isinstance(child, ast.expr):
                        self.expression(child)

    def _place(self, node: ast.Attribute | ast.Subscript) -> None:
        path = ast.unparse(node)
        self.use(path, node)
        self.read_paths.add(path)
        self.expression(node.value)
        if isinstance(node, ast.Subscript):
            self.expression(node.slice)

    def store_operands(self, target: ast.Attribute | ast.Subscript) -> None:
        """Visit the base and the index of a store: the base is used, but not read."""
        base = target.value
        if isinstance(base, ast.Name):
            self.use(base.id, base, reads=False)
        elif isinstance(base, ast.Attribute | ast.Subscript):
            self.use(ast.unparse(base), base, reads=False)
            self.store_operands(base)
        else:
            self.expression(base)
        if isinstance(target, ast.Subscript):
            self.expression(target.slice)

    def _comprehension(self, generators: list[ast.comprehension], results: list[ast.expr]) -> None:
        self.expression(generators[0].iter)
        names = {n.id for g in generators for n in ast.walk(g.target) if isinstance(n, ast.Name)}
        self._hidden.append(names)
        for count, generator in enumerate(generators):
            if count:
                self.expression(generator.iter)
            for test in generator.ifs:
                self.expression(test)
        for result in results:
            self.expression(result)
        self._hidden.pop()

    def _compare(self, node: ast.Compare) -> None:
        asks = len(node.ops) == 1 and isinstance(node.ops[0], ast.Is | ast.IsNot)
        before, self._asking_none = self._asking_none, self._asking_none or asks
        for part in (node.left, *node.comparators):
            self.expression(part)
        self._asking_none = before
        if isinstance(node.ops[0], ast.Eq | ast.NotEq) and len(node.ops) == 1:
            against_none = isinstance(node.comparators[0], ast.Constant) and node.comparators[0].value is None
            if against_none and self.judge.kind(node.left).kind is Kind.VALUE:
                raise findings.none_compared(self.scope.file, node)

    def _call(self, node: ast.Call) -> None:
        self.expression(node.func)
        control = self.scope.control(node.func)
        for argument in (*node.args, *(k.value for k in node.keywords)):
            if control is not None and isinstance(argument, ast.Lambda):
                self._hidden.append(bound_names(argument))
                self.expression(argument.body)  # the block calls it at once
                self._hidden.pop()
            else:
                self.expression(argument)
        called = self.scope.resolve(node.func)
        if type(called).__name__ == "ufunc" and any(self.judge.kind(a).kind is Kind.VALUE for a in node.args):
            # numpy answers before the value is asked, so only the text can name the cure
            message, cure = conversion_of(node, self.scope.file)
            raise RecordError(message, loc=Loc(self.scope.file, node.lineno), cure=cure)
        if callable(called) and not isinstance(called, type):
            self.called.append(called)


def _used(node: ast.AST, next_iteration: bool) -> str:
    return f"{'in its next iteration' if next_iteration else 'after it'} (line {findings.line_of(node)})"
