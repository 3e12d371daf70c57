"""Find reads of a table at a uniform offset from the element: adjacent lanes read adjacent texels.

Stage: improve, after `vectorize`, for the entry of packets and tiles. If an index is the element's own index plus a
uniform offset, the read needs the offset only, not an index for each lane:

    %1: i2 = grid_index
    %2: i = swizzle.x %1
    %3: i = swizzle.y %1
    %4: i = add %2, %k                      (%k is uniform)
    %5: i2 = construct %4, %3
    %6: f = table texels[%5]         ->     %6: f = neighbour texels[%k, %zero]

The same holds for an index modulo a uniform on every axis, as on a board that wraps around. The moduli follow the
offsets as operands:

    %7: i2 = grid_shape
    %8: i2 = floormod %5, %7
    %9: f = table texels[%8]         ->     %9: f = neighbour texels[%k, %zero, %7.x, %7.y]

Blurs, differences and other stencils read so. The pass skips loops that lanes leave one by one, since the lanes that
stay are not adjacent. Sums of offsets wrap around as the original additions do, so the results are the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from shpy.ir.constants import Base, decode, vec
from shpy.ir.nodes import Let, Loop, Module, Store
from shpy.ir.traverse import walk
from shpy.passes.calls import LaneFacts
from shpy.passes.dead import without_dead
from shpy.passes.rewriter import Rewriter
from shpy.passes.vectorize import VectorModule

_INT = vec(Base.I)
_RANKS = (1, 2)


@dataclass(frozen=True, slots=True)
class _Offset:
    """The sum of the element's index along `axis` (None: no index) and signed uniform terms.

    A term is (sign, id, component). The modulus of the sum, if there is one, is (id, component).
    """

    axis: int | None
    terms: tuple[tuple[int, int, int], ...] = ()
    modulus: tuple[int, int] | None = None


Parts = tuple[_Offset, ...]
"""The origin of each component of a value."""


def find_neighbours(vector: VectorModule) -> VectorModule:
    """Rewrite such reads of tables of one or two axes as `neighbour`; return the same object if there are none."""
    module = vector.module
    finder = _NeighbourFinder(module, vector.entry)
    entry = finder.run()
    if not finder.has_neighbours:
        return vector
    entry = without_dead(entry, finder.functions)
    return replace(vector, module=replace(module, functions=(*module.functions[:-1], entry)))


class _NeighbourFinder(Rewriter):
    """Rewrites the entry. `parts` maps the id of a value to its components, where they are known.

    `together`: the lanes that run are adjacent.
    """

    def __init__(self, module: Module, facts: LaneFacts) -> None:
        super().__init__(module.entry, {f.name: f for f in module.functions})
        self.facts = facts
        self.ranks = {t.name: t.rank for t in module.tables if t.rank in _RANKS}
        self.parts: dict[int, Parts] = {}
        self.constants: dict[int, tuple[int, ...]] = {}
        self.axes = 0
        self.together = True
        self.has_neighbours = False

    def loop(self, loop: Loop) -> None:
        around = self.together
        stays = any(isinstance(n, Store) and n.variable in self.facts.live for n in walk((loop,)))
        self.together = around and not stays
        super().loop(loop)
        self.together = around

    def let(self, let: Let) -> None:
        if let.op == "table" and self.together and self.is_neighbour(str(let.attr), let.args[0]):
            self.neighbour(let, let.args[0])
        else:
            self.record(let)
            self.emit(let)

    # Analysis of values

    def record(self, s: Let) -> None:
        """Record the components of a value that is uniform or derived from the element's index.

        The index of the line is both: a value that is not a sum of it and uniforms is a uniform.
        """
        value, args = s.value, s.args
        if value.type.base is not Base.I:
            return
        if s.op == "const" and isinstance(s.attr, tuple):
            self.constants[value.id] = decode(value.type, s.attr)
        operands = [self.parts[a] for a in args if a in self.parts]
        if value.id not in self.facts.varying:
            self.parts[value.id] = tuple(_Offset(None, ((1, value.id, k),)) for k in range(value.type.size))
            if s.op != "grid_line" and all(part.axis is None for parts in operands for part in parts):
                return
        if len(operands) < len(args):
            return
        match s.op, s.attr:
            case (("grid_index" | "grid_line"), _):
                self.axes = value.type.size + (s.op == "grid_line")
                self.parts[value.id] = tuple(_Offset(k) for k in range(value.type.size))
            case "swizzle", tuple(picked):
                self.parts[value.id] = tuple(operands[0][k] for k in picked)
            case "construct", _:
                self.parts[value.id] = tuple(part for parts in operands for part in parts)
            case ("add" | "sub") as op, _:
                sums = [_sum(a, b, 1 if op == "add" else -1) for a, b in zip(*operands, strict=True)]
                if all(part is not None for part in sums):
                    self.parts[value.id] = tuple(part for part in sums if part is not None)
            case "floormod", _:
                wrapped = [_wrapped(a, b) for a, b in zip(*operands, strict=True)]
                if all(part is not None for part in wrapped):
                    self.parts[value.id] = tuple(part for part in wrapped if part is not None)

    def is_neighbour(self, name: str, index: int) -> bool:
        """Return whether the index is the element's own plus uniform offsets on every axis."""
        parts = self.parts.get(index, ())
        if len({part.modulus is None for part in parts}) != 1:
            return False
        return self.ranks.get(name) == self.axes == len(parts) and [p.axis for p in parts] == [*range(len(parts))]

    def neighbour(self, s: Let, index: int) -> None:
        self.has_neighbours = True
        parts = self.parts[index]
        offsets = tuple(self.offset(part) for part in parts)
        moduli = tuple(self.component(*part.modulus) for part in parts if part.modulus is not None)
        self.emit(Let(s.value, "neighbour", offsets + moduli, s.attr))

    def component(self, value: int, component: int) -> int:
        """Return a component of a uniform."""
        return value if self.types[value].size == 1 else self.make("swizzle", value, type=_INT, attr=(component,))

    def offset(self, part: _Offset) -> int:
        """Return the sum of the terms."""
        if all(value in self.constants for _, value, _ in part.terms):
            distance = sum(sign * self.constants[value][component] for sign, value, component in part.terms)
            return self.const(_INT, (distance + 2**31) % 2**32 - 2**31)
        total: int | None = None
        for sign, value, component in part.terms:
            term = self.component(value, component)
            if total is None:
                total = term if sign > 0 else self.make("neg", term, type=_INT)
            else:
                total = self.make("add" if sign > 0 else "sub", total, term, type=_INT)
        assert total is not None, "no terms are a constant"
        return total


def _sum(a: _Offset, b: _Offset, sign: int) -> _Offset | None:
    """Return a + b or a - b, or None if both vary, the varying one is subtracted, or either has a modulus."""
    if (b.axis is not None and (sign < 0 or a.axis is not None)) or a.modulus or b.modulus:
        return None
    terms = tuple((sign * s, value, component) for s, value, component in b.terms)
    return _Offset(b.axis if a.axis is None else a.axis, a.terms + terms)


def _wrapped(a: _Offset, b: _Offset) -> _Offset | None:
    """Return a modulo b if a is the element's own index plus an offset and b is a single uniform value; else None."""
    if a.axis is None or a.modulus or b.axis is not None or b.modulus or len(b.terms) != 1 or b.terms[0][0] < 0:
        return None
    return replace(a, modulus=b.terms[0][1:])
