"""The text of an FPCore: names for expressions that are used several times, contexts of precision, lines.

Stage: above the passes. Takes the nodes that `count` has marked.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

from shpy.fpcore.nodes import Node, Scope, While
from shpy.ir.types import Base

PRECISIONS: Final = {Base.F: "binary32", Base.D: "binary64", Base.H: "binary16", Base.I: "integer"}
"""The name of each type's precision."""
ONCE: Final[dict[str, Callable[..., Any]]] = {
    "rsqrt": lambda x: ["/", "1", ["sqrt", x]],
    "exp10": lambda x: ["pow", "10", x],
    "sinpi": lambda x: ["sin", ["*", "PI", x]],
    "cospi": lambda x: ["cos", ["*", "PI", x]],
    "ldexp": lambda x, n: ["*", x, ["pow", "2", n]],
}
"""Operations that are several of FPCore, whose exact value is rounded once."""
_EXACT: Final = frozenset("if array ref last while and or not < <= > >= == != isnan isinf TRUE FALSE".split())
"""Expressions that round nothing."""
_WIDTH: Final = 100
_SMALL: Final = 2048
"""Whole numbers below this are numbers of every precision."""

Text = str | list[Any]
"""A word, or a list of texts that stands in brackets."""


class Row(list[Any]):
    """A binding, which stands in square brackets."""


class Printer:
    """Writes nodes; `unique` gives a name that nothing else has."""

    def __init__(self, unique: Callable[[str], str]) -> None:
        self.unique = unique
        self.words: dict[Node, str] = {}

    def scope(self, scope: Scope, root: Node, context: Base | None) -> Text:
        """Return an expression of a scope within the names that it needs."""
        bindings = list(self.bindings(scope, context, root))
        whole = self.text(root, context)
        return ["let*", bindings, whole] if bindings else whole

    def bindings(self, scope: Scope, context: Base | None, root: Node | None = None) -> Iterator[Row]:
        """Yield the name and expression of each node that has to have a name; with a root, of all that users named."""
        for node in scope.nodes:
            own = root not in (None, node) and (node.name or node.loop) and node.head != "ref"
            if node.is_atom or not node.uses or not (node.far or node.uses > 1 or own):
                continue
            text = self.text(node, context)
            if isinstance(text, str):
                self.words[node] = text
                continue
            self.words[node] = self.unique(node.name or (_name(node.loop) if node.loop else "value"))
            yield Row([self.words[node], text])

    def text(self, node: Node, context: Base | None) -> Text:
        """Return an expression in a context of a precision; None is `real`."""
        if node in self.words:
            return self.words[node]
        if node.loop is not None:
            return self.loop(node.loop, context)
        if node.is_atom:
            return self.atom(node, context)
        if node.head == "last":
            whole, leaf = node.args
            assert whole.loop is not None
            if len(whole.loop.results) == 1:
                return self.text(whole, context)
            place = next(k for k, state in enumerate(whole.loop.results) if state.leaf is leaf)
            return ["ref", self.text(whole, context), str(place)]
        if node.head in _EXACT:
            return [node.head, *(self.text(a, context) for a in node.args)]
        own: Base | None = node.base
        if node.head in ONCE:
            exact = ONCE[node.head](*(self.text(a, None) for a in node.args))
            whole_text: Text = ["cast", ["!", ":precision", "real", exact]]
        else:
            whole_text = [node.head, *(self.text(a, own) for a in node.args)]
        return whole_text if own is context else ["!", ":precision", PRECISIONS[node.base], whole_text]

    def atom(self, node: Node, context: Base | None) -> Text:
        """Return a name, or a number that is rounded to its own precision."""
        plain = node.head.removeprefix("-")
        is_small = plain.isdigit() and int(plain) < _SMALL
        if node.base is context or node.head in _EXACT or is_small or not (plain[0].isdigit()):
            return node.head
        return ["!", ":precision", PRECISIONS[node.base], node.head]

    def loop(self, loop: While, context: Base | None) -> Text:
        """Return a `while`, or a `while*` where new values share expressions: these become states too."""
        states = [s for s in loop.states if s.leaf.uses]
        for state in states:
            state.leaf.head = self.unique(state.leaf.name)
        condition = self.scope(loop.tests, loop.condition, context)
        shared = list(self.bindings(loop.scope, context))
        bools = {self.words[n] for n in loop.scope.nodes if n in self.words and n.base is Base.B}
        rows = [Row([name, "FALSE" if name in bools else "0", text]) for name, text in shared]
        changed: set[Node] = set()
        updates = []
        for state in states:
            text = self.text(state.update, context)
            if shared and self.reads(state.update) & changed:  # a `while*` has changed these already
                dummy = "FALSE" if state.leaf.base is Base.B else "0"
                rows.append(Row([name := self.unique(f"{state.leaf.head}.next"), dummy, text]))
                text = name
            changed.add(state.leaf)
            updates.append(Row([state.leaf.head, self.text(state.first, context), text]))
        names = [s.leaf.head for s in loop.results]
        result: Text = names[0] if len(names) == 1 else ["array", *names]
        return ["while*" if shared else "while", condition, [*rows, *updates], result]

    def reads(self, node: Node) -> set[Node]:
        """Return the states that the text of an expression names."""
        found, pending = set(), [node]
        while pending:
            n = pending.pop()
            if n.state is not None:
                found.add(n)
            if n.loop is not None:
                pending += [n.loop.condition, *(s for t in n.loop.states if t.leaf.uses for s in (t.first, t.update))]
            elif n not in self.words:
                pending += n.args
        return found


def _name(loop: While) -> str:
    """Return a name for the value of a loop."""
    return loop.results[0].leaf.name if len(loop.results) == 1 else "loop"


def _flat(text: Text) -> str:
    if isinstance(text, str):
        return text
    inside = " ".join(map(_flat, text))
    return f"[{inside}]" if isinstance(text, Row) else f"({inside})"


def laid_out(text: Text, indent: int) -> str:
    """Return a text in lines of at most 100 columns where that is possible; its first line begins at `indent`."""
    flat = _flat(text)
    if isinstance(text, str) or len(flat) + indent <= _WIDTH:
        return flat
    inner = indent + 2
    break_ = "\n" + " " * inner
    match text:
        case ["let*", list() as rows, body]:
            return f"(let* {_rows(rows, indent + 7)}{break_}{laid_out(body, inner)})"
        case ["while" | "while*" as head, condition, list() as rows, body]:
            test, states = laid_out(condition, indent + 8), _rows(rows, inner + 3)
            return f"({head} {test}{break_}  {states}{break_}{laid_out(body, inner)})"
        case [str() as head, *others]:
            return f"({head}{break_}{break_.join(laid_out(o, inner) for o in others)})"
    return flat


def _rows(rows: list[Any], indent: int) -> str:
    """Return bindings, one a line, in square brackets."""
    between = "\n" + " " * indent
    return f"({between.join(_row(row, indent) for row in rows)})"


def _row(row: Row, indent: int) -> str:
    flat = _flat(row)
    if len(flat) + indent <= _WIDTH:
        return flat
    between = "\n" + " " * (indent + 2)
    name, *others = row
    if len(others) > 1 and len(_flat(others[0])) + indent <= _WIDTH // 2:
        name, *others = f"{name} {_flat(others[0])}", others[1]
    return f"[{between.join([name, *(laid_out(o, indent + 2) for o in others)])}]"
