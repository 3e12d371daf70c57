"""The expressions of an FPCore: a graph in which what several expressions share is one node.

Stage: above the passes. `count` finds the nodes that the text needs and how often each is used.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from shpy.ir.types import Base


@dataclass(eq=False, slots=True)
class Scope:
    """The expressions of a program, or those of one iteration of a loop, in the order in which they were made."""

    nodes: list[Node] = field(default_factory=list)


@dataclass(eq=False, slots=True)
class Node:
    """An expression: an operation `head` of others, a loop, or the text of a number or name.

    `base` is the type of its value, `state` the state of a loop that it names. `far`: an inner scope uses it.
    """

    head: str
    args: tuple[Node, ...]
    base: Base
    scope: Scope
    name: str = ""
    loop: While | None = None
    state: State | None = None
    uses: int = 0
    far: bool = False

    def __post_init__(self) -> None:
        self.scope.nodes.append(self)

    @property
    def is_atom(self) -> bool:
        """True for a number or a name."""
        return not self.args and self.loop is None


Nodes = tuple[Node, ...]


@dataclass(eq=False, slots=True)
class State:
    """A component of a variable that a loop changes: its name inside, and its values before and after an iteration."""

    leaf: Node
    first: Node
    update: Node


@dataclass(eq=False, slots=True)
class While:
    """A loop. `tests` is the scope of its condition; `results` are the states whose last values are read after it."""

    scope: Scope
    tests: Scope
    condition: Node
    states: list[State] = field(default_factory=list)
    results: list[State] = field(default_factory=list)


def count(root: Node, scope: Scope) -> None:
    """Count the uses of each node that the root needs; a loop keeps the states that are needed."""
    pending: list[tuple[Node, Scope]] = [(root, scope)]
    while pending:
        node, user = pending.pop()
        node.uses += 1
        node.far |= node.scope is not user
        if node.uses > 1:
            continue
        if node.state is not None:
            pending += [(node.state.first, node.state.first.scope), (node.state.update, node.scope)]
        elif node.head == "last":
            whole, leaf = node.args
            assert whole.loop is not None
            assert leaf.state is not None
            whole.loop.results.append(leaf.state)
            pending += [(whole, node.scope), (leaf, leaf.scope)]
        elif node.loop is not None:
            pending.append((node.loop.condition, node.loop.tests))
        else:
            pending += [(a, node.scope) for a in node.args]
