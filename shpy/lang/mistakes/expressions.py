"""The expressions of a walk (flow.py): which places they use, which names they bind, which functions they call.

Stage: record. Goes through an expression in the order of its evaluation.
"""

from __future__ import annotations

import ast

from shpy.errors import RecordError
from shpy.lang.mistakes import findings
from shpy.lang.mistakes.explain import conversion_of
from shpy.lang.mistakes.kinds import Kind
from shpy.lang.mistakes.places import Places
from shpy.lang.recording.scope import Scope, bound_names


class Expressions:
    """The part of a function's walk that goes through expressions."""

    def __init__(self, scope: Scope, places: Places) -> None:
        self.scope, self.places = scope, places
        self.called: list[object] = []
        self.read_paths: set[str] = set()

    def visit(self, node: ast.expr) -> None:
        """Go through an expression."""
        match node:
            case ast.Name(ctx=ast.Load()) | ast.Attribute() | ast.Subscript():
                self._place(node)
                self.places.check_fields(node)
            case ast.Lambda():
                pass  # runs later, if at all
            case ast.ListComp() | ast.SetComp() | ast.GeneratorExp():
                self._comprehension(node.generators, [node.elt])
            case ast.DictComp():
                self._comprehension(node.generators, [node.key, node.value])
            case ast.NamedExpr():
                self.visit(node.value)
                inference, shared = self.places.judge.kind(node.value), self.places.object_of(node.value)
                self.places.bind_name(node.target.id, node, inference, value=node.value, shared=shared)
            case ast.Call():
                self._call(node)
            case ast.Compare():
                self._compare(node)
            case _:
                for child in ast.iter_child_nodes(node):
                    if isinstance(child, ast.expr):
                        self.visit(child)

    def _place(self, node: ast.Name | ast.Attribute | ast.Subscript) -> None:
        path = ast.unparse(node)
        self.places.use(path, node)
        if isinstance(node, ast.Name):
            return
        self.read_paths.add(path)
        if isinstance(node.value, ast.Name | ast.Attribute | ast.Subscript):
            self._place(node.value)
        else:
            self.visit(node.value)
        if isinstance(node, ast.Subscript):
            self.visit(node.slice)

    def store_operands(self, target: ast.Attribute | ast.Subscript) -> None:
        """Visit the base and the index of a store: the base is used, but not read."""
        base = target.value
        if isinstance(base, ast.Name):
            self.places.use(base.id, base, reads=False)
        elif isinstance(base, ast.Attribute | ast.Subscript):
            self.places.use(ast.unparse(base), base, reads=False)
            self.store_operands(base)
        else:
            self.visit(base)
        if isinstance(target, ast.Subscript):
            self.visit(target.slice)

    def _comprehension(self, generators: list[ast.comprehension], results: list[ast.expr]) -> None:
        self.visit(generators[0].iter)
        names = {n.id for g in generators for n in ast.walk(g.target) if isinstance(n, ast.Name)}
        self.places.hidden.append(names)
        for count, generator in enumerate(generators):
            if count:
                self.visit(generator.iter)
            for test in generator.ifs:
                self.visit(test)
        for result in results:
            self.visit(result)
        self.places.hidden.pop()

    def _compare(self, node: ast.Compare) -> None:
        asks = len(node.ops) == 1 and isinstance(node.ops[0], ast.Is | ast.IsNot)
        before, self.places.asking_none = self.places.asking_none, self.places.asking_none or asks
        for part in (node.left, *node.comparators):
            self.visit(part)
        self.places.asking_none = before
        if isinstance(node.ops[0], ast.Eq | ast.NotEq) and len(node.ops) == 1:
            sides = (node.left, node.comparators[0])
            for none, value in (sides, sides[::-1]):
                against_none = isinstance(none, ast.Constant) and none.value is None
                if against_none and self.places.judge.kind(value).kind is Kind.VALUE:
                    raise findings.none_compared(self.scope.text, node, value)

    def _call(self, node: ast.Call) -> None:
        self.visit(node.func)
        control = self.scope.control(node.func)
        for argument in (*node.args, *(k.value for k in node.keywords)):
            if control is not None and isinstance(argument, ast.Lambda):
                self.places.hidden.append(bound_names(argument))
                self.visit(argument.body)  # the block calls it at once
                self.places.hidden.pop()
            else:
                self.visit(argument)
        called = self.scope.resolve(node.func)
        if getattr(called, "__module__", "") != "builtins":
            self.places.hand_over([a.id for a in node.args if isinstance(a, ast.Name)])
        if type(called).__name__ == "ufunc" and any(self.places.judge.kind(a).kind is Kind.VALUE for a in node.args):
            # numpy answers before the value is asked, so only the text can name the cure
            message, cure = conversion_of(node, self.scope.text)
            raise RecordError(message, loc=findings.at(self.scope.text, node), cure=cure)
        if callable(called) and not isinstance(called, type):
            self.called.append(called)
