"""Emitters: operations go into the recording under way or, outside of a recording, straight to their meaning.

Stage: record. A handle is the id of an IR value in the first case and a number of the host in the second; the code that
types operands and picks operations is the same for both. Outside a recording, operations on uniforms are kept as an
expression, whose nodes are the handles: their results are known only when a program runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shpy.ir import meaning
from shpy.ir.constants import DTYPES, encode, from_array, to_array
from shpy.ir.nodes import Attr
from shpy.ir.ops import OPS, result_type
from shpy.ir.types import Base, Type
from shpy.lang.recording.recorder import Frame

Handle = Any


@dataclass(frozen=True, slots=True, eq=False)
class HostNumber:
    """A number of the host: rounded to its type at each step and, of type f, in binary64 (`wide`)."""

    narrow: NDArray[Any]
    wide: NDArray[Any]


class Constant(tuple[int, ...]):
    """The `attr` of a constant of type f whose binary64, `wide`, does not round to its binary32.

    A program chooses between the two when its precision is known: see `embed`.
    """

    wide: tuple[int, ...]

    def __new__(cls, narrow: Iterable[int], wide: tuple[int, ...]) -> Constant:
        """Return the constant of both."""
        constant = super().__new__(cls, narrow)
        constant.wide = wide
        return constant

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Constant) and tuple(self) == tuple(other) and self.wide == other.wide

    def __hash__(self) -> int:
        return hash((tuple(self), self.wide))

    def __reduce__(self) -> Any:
        return Constant, (tuple(self), self.wide)


class HostEmitter:
    """Evaluates at once, by the meanings in the op table; numbers of type f in binary32 and in binary64."""

    def op(self, name: str, args: tuple[tuple[Handle, Type], ...]) -> tuple[Handle, Type]:
        """Execute the operation's meaning; raise TypeError if it does not take these types."""
        type = result_type(name, tuple(t for _, t in args))
        return _both(type, OPS[name].meaning, [h for h, _ in args]), type

    def let(self, op: str, args: tuple[Handle, ...], type: Type, attr: Attr = None) -> Handle:
        """Execute a structural operation."""
        if op == "convert":
            narrow = _quiet(meaning.convert, args[0].narrow, DTYPES[type.base])
            wide = _quiet(meaning.convert, args[0].wide, np.float64) if type.base is Base.F else narrow
            return HostNumber(narrow, wide)
        return _both(type, partial(_structural, op, type, attr), args)

    def const(self, type: Type, attr: tuple[int, ...]) -> Handle:
        """Return the constant as arrays."""
        narrow = to_array(type, attr)
        return HostNumber(narrow, to_array(type.based(Base.D), wide(attr)) if type.base is Base.F else narrow)


def _both(type: Type, f: Callable[..., Any], args: Sequence[HostNumber]) -> HostNumber:
    narrow = _quiet(f, *(a.narrow for a in args))
    return HostNumber(narrow, _quiet(f, *(a.wide for a in args)).astype(np.float64) if type.base is Base.F else narrow)


def _quiet(f: Callable[..., Any], *args: Any) -> NDArray[Any]:
    with np.errstate(all="ignore"):
        return np.asarray(f(*args))


def _structural(op: str, type: Type, attr: Attr, *args: Any) -> Any:
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
    raise AssertionError(f"{op} is recorded only")


def constant_of(type: Type, number: HostNumber) -> tuple[int, ...]:
    """Return the `attr` of a number of the host: in binary64, where that rounds to what binary32 gives."""
    narrow = from_array(type, number.narrow)
    if type.base is not Base.F:
        return narrow
    wide = from_array(type, number.wide)
    if not np.isfinite(number.narrow).all() or not (np.abs(number.wide) <= np.finfo(np.float32).max).all():
        return narrow  # a program would refuse a number beyond binary32
    return wide if from_array(type, to_array(type, wide)) == narrow else Constant(narrow, wide)


def wide(const: tuple[int, ...]) -> tuple[int, ...]:
    """Return the `attr` of a constant in binary64."""
    return const.wide if isinstance(const, Constant) else const


def embed(emitter: Emitter, type: Type, const: tuple[int, ...]) -> Handle:
    """Emit a constant; of a `Constant` the part that belongs to the working precision, which is known later."""
    if not isinstance(const, Constant) or isinstance(emitter, HostEmitter):
        return emitter.const(type, const)
    above, one = (encode(type, [number] * type.size) for number in (1 + 2.0**-40, 1.0))
    finer, unit, wide, narrow = ((emitter.const(type, attr), type) for attr in (above, one, const.wide, tuple(const)))
    return emitter.op("cond", (emitter.op("gt", (finer, unit)), wide, narrow))[0]


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
