"""The reach of a stencil: how far from its own place an element reads tables, found from the indices' expressions.

Stage: improve; it changes nothing. Each component of an int is described as the element's own index on an axis, or the
grid's extent on an axis, plus an offset between two bounds; or as a number between two bounds.

    %1: i2 = grid_index
    %3: i2 = add %1, %2         (%2 is the constant -1, 2)
    %4: f = table u[%3]         reach(module, {"u"}, 2) == Reach((1, 2), (False, False), (True, True))

An index modulo the grid's extent wraps around; its distance is that of the index before the modulo.

Functions are followed for each call. Variables hold the join of what is stored into them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from shpy.errors import ShpyTypeError
from shpy.ir.constants import decode
from shpy.ir.nodes import Call, Function, Let, Module, Region, Store, Variable
from shpy.ir.traverse import changed_variables, regions_of, results
from shpy.ir.types import Base, Type

_ROUNDS: Final = 4
"""The most rounds over a function; variables that still change after these may be anything."""


@dataclass(frozen=True, slots=True)
class _Part:
    """A component: `of` ("index", "wrapped", "extent" or "number") on an axis, plus an offset in [low, high].

    "wrapped" is an index modulo the extent.
    """

    of: str
    axis: int
    low: int
    high: int


class Reach(NamedTuple):
    """The largest distance between an element and its reads on each axis, and whether such reads wrap or clamp."""

    distance: tuple[int, ...]
    wraps: tuple[bool, ...]
    clamps: tuple[bool, ...]


_Parts = tuple[_Part | None, ...]
"""A description of each component; None if it may be anything."""


@dataclass(slots=True)
class _Contents:
    """The contents of variables: the join of all stores, unless `opaque`. `first` is the region of the first store."""

    opaque: set[int]
    contents: dict[int, _Parts] = field(default_factory=dict)
    first: dict[int, tuple[int, ...]] = field(default_factory=dict)

    def load(self, variable: int, path: tuple[int, ...]) -> _Parts | None:
        """Return the parts of a load, or None if they are unknown, as for a variable that may not be stored yet."""
        first = self.first.get(variable)
        if first is None or path[: len(first)] != first:
            self.opaque.add(variable)
        return None if variable in self.opaque else self.contents.get(variable)


def reach(module: Module, cut: Collection[str], rank: int) -> Reach:
    """Return the distances between an element and its reads of the tables `cut`.

    Raises ShpyTypeError, at the line of the read, for an index whose distance from the element is not bounded.
    """
    finder = _ReachFinder(module, cut, rank)
    finder.function(module.entry, [_unknown(i.type) for i in module.entry.inputs])
    return Reach(tuple(finder.distances), tuple(finder.wraps), tuple(finder.clamps))


class _ReachFinder:
    def __init__(self, module: Module, cut: Collection[str], rank: int) -> None:
        self.functions = {f.name: f for f in module.functions}
        self.cut = cut
        self.distances = [0] * rank
        self.wraps, self.clamps = [False] * rank, [False] * rank

    def function(self, function: Function, input_parts: Sequence[_Parts]) -> list[_Parts]:
        """Return the parts of the outputs of a function, given those of its inputs."""
        inputs = zip(function.inputs, input_parts, strict=True)
        values = {i.id: parts for i, parts in inputs if not isinstance(i, Variable)}
        slots = _Contents({i.id for i in function.inputs if isinstance(i, Variable)})
        count = 0
        while True:
            before, opaque = dict(slots.contents), set(slots.opaque)
            self._region(function.body, dict(values), slots, ())
            changed = {v for v, parts in slots.contents.items() if before.get(v) != parts}
            if not changed and slots.opaque == opaque:
                contents = {v: parts for v, parts in slots.contents.items() if v not in opaque}
                return [contents.get(o.id, _unknown(o.type)) for o in function.outputs]
            count += 1
            if count >= _ROUNDS:
                slots.opaque |= changed

    def _region(self, region: Region, values: dict[int, _Parts], slots: _Contents, path: tuple[int, ...]) -> None:
        for place, s in enumerate(region):
            match s:
                case Let():
                    values[s.value.id] = self._let(s, values, slots, path) or _unknown(s.value.type)
                case Store(variable, value, components, index):
                    stored = values[value]
                    slots.first.setdefault(variable, path)
                    if components is not None or index is not None:
                        slots.opaque.add(variable)
                    else:
                        slots.contents[variable] = _each(_joined, slots.contents.get(variable, stored), stored)
                case Call(name, args):
                    inputs = list(zip(args, self.functions[name].inputs, strict=True))
                    slots.opaque.update(changed_variables(s, self.functions))
                    input_parts = [_unknown(i.type) if isinstance(i, Variable) else values[a] for a, i in inputs]
                    output_parts = self.function(self.functions[name], input_parts)
                    values.update(zip((r.id for r in results(s)), output_parts, strict=True))
            for k, inner in enumerate(regions_of(s)):
                self._region(inner, values, slots, (*path, place, k))

    def _let(self, s: Let, values: dict[int, _Parts], slots: _Contents, path: tuple[int, ...]) -> _Parts | None:
        type_ = s.value.type
        if s.op == "table" and s.attr in self.cut:
            self._read(s, values[s.args[0]])
        if s.op == "call":
            callee = self.functions[str(s.attr)]
            return self.function(callee, [values[a] for a in s.args])[0]
        if type_.base is not Base.I:
            return None
        if s.op == "load":
            return None if s.args or not isinstance(s.attr, int) else slots.load(s.attr, path)
        if s.op in ("grid_index", "grid_shape"):
            of = "index" if s.op == "grid_index" else "extent"
            return tuple(_Part(of, k, 0, 0) for k in range(type_.size))
        if s.op == "table_size" and s.attr in self.cut:
            return tuple(_Part("extent", k, 0, 0) for k in range(type_.size))
        if s.op == "const" and isinstance(s.attr, tuple):
            return tuple(_Part("number", 0, int(n), int(n)) for n in decode(type_, s.attr))
        return _OPERATIONS[s.op](s, [values[a] for a in s.args]) if s.op in _OPERATIONS else None

    def _read(self, s: Let, index: _Parts) -> None:
        for axis, part in enumerate(index):
            if part is None or part.of not in ("index", "wrapped") or part.axis != axis:
                raise ShpyTypeError(
                    f"{s.attr} is read at an index whose distance from sh.grid_index has no known bound, so no halo is "
                    "wide enough",
                    loc=s.value.loc,
                    cure=f"{s.attr}[i + (0, 1)] with i = sh.grid_index({len(self.distances)}) and constants, or the "
                    "whole array as a sh.Table",
                )
            distance = max(-part.low, part.high)
            self.distances[axis] = max(self.distances[axis], distance)
            self.wraps[axis] |= part.of == "wrapped"
            self.clamps[axis] |= part.of == "index" and distance > 0


def _unknown(type: Type) -> _Parts:
    return (None,) * type.size


def _each(f: Callable[..., _Part | None], *args: _Parts) -> _Parts:
    """Return `f` of each component; what is computed from one that may be anything may be anything."""
    return tuple(None if None in parts else f(*parts) for parts in zip(*args, strict=True))


def _joined(a: _Part, b: _Part) -> _Part | None:
    return _Part(a.of, a.axis, min(a.low, b.low), max(a.high, b.high)) if (a.of, a.axis) == (b.of, b.axis) else None


def _sum(a: _Part, b: _Part) -> _Part | None:
    base = b if a.of == "number" else a
    if "number" not in (a.of, b.of) or base.of == "wrapped":
        return None
    return _Part(base.of, base.axis, a.low + b.low, a.high + b.high)


def _minus(a: _Part) -> _Part | None:
    return _Part("number", 0, -a.high, -a.low) if a.of == "number" else None


def _modulo(a: _Part, b: _Part) -> _Part | None:
    """Return a modulo b: an index modulo the extent of its axis wraps around."""
    wraps = (a.of, b.of, a.axis) == ("index", "extent", b.axis) and (b.low, b.high) == (0, 0)
    return _Part("wrapped", a.axis, a.low, a.high) if wraps else None


def _least(a: _Part, b: _Part) -> _Part | None:
    """Return min(a, b): an index never exceeds the extent of its axis, less one."""
    if a.of == "extent":
        a, b = b, a
    if a.of == "index" and b.of == "extent" and a.axis == b.axis and b.low >= -1:
        return _Part("index", a.axis, min(a.low, b.low + 1), a.high)
    return _joined(a, b)


def _greatest(a: _Part, b: _Part) -> _Part | None:
    """Return max(a, b): an index is never negative."""
    if a.of == "number":
        a, b = b, a
    if a.of == "index" and b.of == "number" and b.high <= 0:
        return _Part("index", a.axis, a.low, max(a.high, b.high))
    return _joined(a, b)


_OPERATIONS: dict[str, Callable[[Any, list[_Parts]], _Parts]] = {
    "add": lambda s, args: _each(_sum, *args),
    "sub": lambda s, args: _each(_sum, args[0], _each(_minus, args[1])),
    "floormod": lambda s, args: _each(_modulo, *args),
    "neg": lambda s, args: _each(_minus, args[0]),
    "min": lambda s, args: _each(_least, *args),
    "max": lambda s, args: _each(_greatest, *args),
    "clamp": lambda s, args: _each(_least, _each(_greatest, *args[:2]), args[2]),
    "cond": lambda s, args: _each(_joined, *args[1:]),
    "splat": lambda s, args: args[0][:1] * s.value.type.size,
    "construct": lambda s, args: tuple(part for parts in args for part in parts),
    "swizzle": lambda s, args: tuple(args[0][k] for k in s.attr),
}
