"""Emitters: operations go into the recording under way or, outside of a recording, straight to their meaning.

Stage: record. A handle is the id of an IR value in the first case and an array in the second; the code that types
operands and picks operations is the same for both. Outside a recording, operations on uniforms are kept as an
expression, whose nodes are the handles: what they give is known only when a program runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from shpy.ir import meaning
from shpy.ir.constants import DTYPES, to_array
from shpy.ir.nodes import Attr
from shpy.ir.ops import OPS, result_type
from shpy.ir.types import Type
from shpy.lang.recording.recorder import Frame

Handle = Any


class HostEmitter:
    """Evaluates at once, by the meanings in the op table."""

    def op(self, name: str, args: tuple[tuple[Handle, Type], ...]) -> tuple[Handle, Type]:
        """Execute the operation's meaning; raise TypeError if it does not take these types."""
        type = result_type(name, tuple(t for _, t in args))
        with np.errstate(all="ignore"):
            return np.asarray(OPS[name].meaning(*(h for h, _ in args))), type

    def let(self, op: str, args: tuple[Handle, ...], type: Type, attr: Attr = None) -> Handle:
        """Execute a structural operation."""
        match op:
            case "splat":
                return np.broadcast_to(args[0], (type.size,)).copy()
            case "construct":
                return np.concatenate([np.atleast_1d(a) for a in args])
            case "swizzle":
                assert isinstance(attr, tuple)
                picked = np.atleast_1d(args[0])[list(attr)]
                return picked if type.size > 1 else picked[0]
            case "component":
                vector = np.atleast_1d(args[0])
                return vector[min(max(int(args[1]), 0), len(vector) - 1)]
            case "convert":
                with np.errstate(all="ignore"):
                    return meaning.convert(np.asarray(args[0]), DTYPES[type.base])
        raise AssertionError(f"{op} is recorded only")

    def const(self, type: Type, attr: tuple[int, ...]) -> Handle:
        """Return the constant as an array."""
        return to_array(type, attr)


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """An operation of an expression of uniforms. `source` is the Param or Table that a `param` or `table` reads."""

    op: str
    args: tuple[Node, ...]
    type: Type
    attr: Attr = None
    source: Any = None


class DeferredEmitter:
    """Keeps operations on uniforms as expressions."""

    def op(self, name: str, args: tuple[tuple[Handle, Type], ...]) -> tuple[Handle, Type]:
        """Make a node."""
        type = result_type(name, tuple(t for _, t in args))
        return Node(name, tuple(h for h, _ in args), type), type

    def let(self, op: str, args: tuple[Handle, ...], type: Type, attr: Any = None) -> Handle:
        """Make a node; a `param` or `table` takes what it reads as its attr."""
        if op in ("param", "table"):
            return Node(op, args, type, None, attr)
        return Node(op, args, type, attr)

    def const(self, type: Type, attr: tuple[int, ...]) -> Handle:
        """Make a node of a constant."""
        return Node("const", (), type, attr)


def nodes_of(root: Node) -> Iterator[Node]:
    """Return the nodes of an expression, each once, operands before the nodes that use them."""
    seen: set[int] = set()
    pending = [(root, False)]
    while pending:
        node, ready = pending.pop()
        if ready:
            yield node
        elif id(node) not in seen:
            seen.add(id(node))
            pending.append((node, True))
            pending += ((arg, False) for arg in reversed(node.args))


def replay(root: Node, let: Callable[[Node, tuple[Handle, ...]], Handle]) -> Handle:
    """Emit an expression node by node: `let` takes a node and the handles of its operands, and gives the node's own."""
    handles: dict[int, Handle] = {}
    for node in nodes_of(root):
        handles[id(node)] = let(node, tuple(handles[id(arg)] for arg in node.args))
    return handles[id(root)]


HOST: Final = HostEmitter()
DEFERRED: Final = DeferredEmitter()
Emitter = HostEmitter | DeferredEmitter | Frame
"""Applies operations of the table (`op`), structural operations (`let`) and constants (`const`) to handles."""
