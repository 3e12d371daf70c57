"""Dependent uniforms: the results of operators and functions on Params outside a program.

Stage: record. The operations are kept as an expression. A program that uses the result has one uniform for it, which is
computed before each run from the current values of the Params.

    freq = sh.Param(sh.Attrib1f, 2.0)
    freq2 = sh.sqrt(freq) * 2      # a uniform that follows freq
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from shpy.errors import RecordError, ShpyTypeError
from shpy.ir.types import WIDEST_PORT, Type
from shpy.lang.recording.emit import DEFERRED, Emitter, Handle, Node, nodes_of, replay
from shpy.lang.recording.location import here
from shpy.lang.recording.names import assigned_name
from shpy.lang.recording.recorder import Frame, current_frame

Evaluator = Callable[["Dependent", str, str], NDArray[Any]]
"""Computes a uniform, () or (size,), from its sources' current values, at a kernel's precision and in its mode."""
_evaluators: list[Evaluator] = []


def evaluate_with(evaluator: Evaluator) -> None:
    """Set the evaluator of dependent uniforms: `shpy.run.uniforms.evaluate`, since a uniform's value is a run's result.

    `.value` and `np.asarray` are methods of the uniform, and the import of the modules that run programs would be a
    circle.
    """
    _evaluators[:] = [evaluator]


@dataclass(slots=True, eq=False)
class Expression:
    """The expression of a dependent uniform, and the results that the evaluator keeps."""

    root: Node
    name: str | None
    sources: tuple[Any, ...] | None = None
    kept: dict[tuple[str, str], Any] = field(default_factory=dict)


class Dependent:
    """A uniform that follows others. Mixed into the class of the value that it is."""

    __slots__ = ()
    _uniform = True
    named = False
    type: Type
    _const: Any

    @property
    def name(self) -> str | None:
        """The Python name that it was assigned to, if that is known."""
        expression: Expression = self._const
        return expression.name

    @property
    def root(self) -> Node:
        """The expression that it is."""
        expression: Expression = self._const
        return expression.root

    @property
    def sources(self) -> tuple[Any, ...]:
        """The Params and Tables from which the uniform is computed."""
        expression: Expression = self._const
        if expression.sources is None:
            sources = {id(n.source): n.source for n in nodes_of(expression.root) if n.source is not None}
            expression.sources = tuple(sources.values())
        return expression.sources

    @property
    def value(self) -> Any:
        """The present value at f32 in strict mode: a numpy scalar or array of shape (size,). It cannot be set."""
        return self._now()[()]

    @value.setter
    def value(self, value: Any) -> None:
        self._refuse("cannot be set")

    def at(self, precision: str, math: str) -> NDArray[Any]:
        """Return the present value in a kernel of this precision and mode."""
        return _evaluators[0](self, precision, math)

    def __reduce__(self) -> Any:
        steps = list(nodes_of(self.root))  # iteratively, since an expression may be deep
        places = {id(node): k for k, node in enumerate(steps)}
        flat = [(n.op, tuple(places[id(a)] for a in n.args), n.type, n.attr, n.source) for n in steps]
        return _again, (type(self).__bases__[1], flat, self.name)

    def _now(self) -> NDArray[Any]:
        return self.at("f32", "strict")

    def _read(self, emitter: Emitter) -> Handle:
        frame = current_frame()
        if frame is None:
            assert emitter is DEFERRED
            return self.root
        name = frame.recording.use("param", frame.recording.params, self)
        return emitter.let("param", (), self.type, name)

    def _storable(self, spelled: str) -> Frame:
        self._refuse("cannot be stored into")

    def _called(self) -> str:
        return self.name or "this uniform"

    def _refuse(self, what: str) -> NoReturn:
        followed = [getattr(source, "name", None) or "p" for source in self.sources]
        raise RecordError(
            f"{self._called()} {what}: it is a dependent uniform, which follows {', '.join(followed)}",
            loc=here(),
            cure=f"{set_between_runs(followed[0])}, or an sh.Param of its own",
        )


def set_between_runs(name: str | None) -> str:
    """Return the statement that sets the Param of this name, of a row the matrix that it stands in."""
    return f"{(name or 'p').partition('[')[0]}.value = … between runs"


@lru_cache(maxsize=128)
def follower(cls: type) -> Any:
    """Return the class of dependent uniforms of a type; ShpyTypeError for vectors of eight, which live in programs."""
    size: int = getattr(cls, "size", 1)
    if size > WIDEST_PORT:
        text = f"an {cls.__name__} follows no Param outside of a program"
        raise ShpyTypeError(text, loc=here(), cure=f"sh.{cls.__name__}(…) inside of the program")
    return type(cls.__name__, (Dependent, cls), {"__slots__": ()})


def _again(cls: type, flat: list[tuple[Any, ...]], name: str | None) -> Any:
    """Return the uniform that another process sent, whose nodes refer to those before them."""
    nodes: list[Node] = []
    for op, args, type_, attr, source in flat:
        nodes.append(Node(op, tuple(nodes[k] for k in args), type_, attr, source))
    uniform: Any = object.__new__(follower(cls))
    slots = {"_frame": None, "_part": None, "_loc": None, "_variable": -1, "_const": Expression(nodes[-1], name)}
    for slot, start in slots.items():
        object.__setattr__(uniform, slot, start)
    return uniform


def name_parts(parts: dict[str, Any]) -> None:
    """Name the dependent uniforms of a matrix or struct after what the user assigns: `world[0]`, `ray.o`."""
    dependent = {path: part for path, part in parts.items() if isinstance(part, Dependent)}
    name = assigned_name() if dependent else None
    for path, part in dependent.items() if name is not None else ():
        part._const.name = f"{name}{path}"


def record_expression(frame: Frame, root: Node) -> int:
    """Record an expression into a program."""

    def let(node: Node, args: tuple[int, ...]) -> int:
        if node.op == "param":
            return int(node.source._read(frame))
        return frame.let(node.op, args, node.type, node.source._declared(frame) if node.op == "table" else node.attr)

    return int(replay(root, let))


def first_value(uniform: Any) -> list[Any]:
    """Return a uniform's present components: its value in the text of a program that is recorded now."""
    numbers: list[Any] = np.atleast_1d(np.asarray(uniform.at("f32", "strict"))).tolist()
    return numbers
