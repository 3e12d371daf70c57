"""Let a module run over a block of a grid with the results that it would have over the whole grid.

Stage: improve; the first pass over a recorded module. Two uniforms pass the position of the block. Tables that are cut
into the same blocks are read at the index within the block.

    %1: i2 = grid_index        ->    %5: i2 = grid_index ; %6: i2 = param block_origin ; %1: i2 = add %5, %6
    %2: i2 = grid_shape        ->    %2: i2 = param whole_shape
    %3: f = table u[%9]        ->    %7: i2 = param block_origin ; %8: i2 = sub %9, %7 ; %3: f = table u[%8]
    %4: i2 = table_size u      ->    %4: i2 = param whole_shape

Where reads wrap around, the halo of a block at the border holds texels of the opposite border. A third uniform, the
period, is the whole shape on these axes, and larger than any index on the others. The position of the element is taken
modulo the period. An index reads the texel that is congruent to it modulo the period and within reach of the element.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from shpy.ir.nodes import Function, Let, Module, Param
from shpy.ir.traverse import walk
from shpy.ir.types import Base, Type, vec
from shpy.passes.rewriter import Functions, Rewriter, each_function

ORIGIN, WHOLE, PERIOD = "block_origin", "whole_shape", "period"
"""The uniforms: the index of the block's first element, the shape of the whole grid, and the modulus of indices."""


def place_blocks(module: Module, cut: Collection[str], rank: int, reach: Sequence[int] | None = None) -> Module:
    """Return the module for blocks of a grid of `rank` axes; the same object if it does not depend on a position.

    `cut` names the tables that are cut into the blocks. `reach` is how far an element reads along each axis if any
    read wraps around, else None.
    """
    lets = (s for f in module.functions for s in walk(f.body) if isinstance(s, Let))
    if not any(_asks(let, cut) for let in lets):
        return module
    result = each_function(module, lambda function, functions: _Placer(function, functions, cut, reach).run())
    kind = f"Attrib{rank}i"
    uniforms = (
        Param(name, kind, vec(Base.I, rank), (0,) * rank)
        for name in (ORIGIN, WHOLE, PERIOD)[: 2 if reach is None else 3]
    )
    return replace(result, params=(*result.params, *uniforms))


def _asks(let: Let, cut: Collection[str]) -> bool:
    return let.op in ("grid_index", "grid_shape") or (let.op in ("table", "table_size") and let.attr in cut)


class _Placer(Rewriter):
    def __init__(
        self, function: Function, functions: Functions, cut: Collection[str], reach: Sequence[int] | None
    ) -> None:
        super().__init__(function, functions)
        self.cut, self.reach = cut, reach

    def let(self, let: Let) -> None:
        """Rewrite a statement that depends on the position of the element."""
        if not _asks(let, self.cut):
            self.emit(let)
        elif let.op == "grid_index":
            self._place(let)
        elif let.op == "table":
            self.emit(replace(let, args=(self._within(let.args[0]),)))
        else:
            self.emit(Let(let.value, "param", (), WHOLE))

    def _place(self, let: Let) -> None:
        """Emit the position of the element in the whole grid as the value of `let`."""
        type_ = let.value.type
        place = self._own(type_), self.make("param", type=type_, attr=ORIGIN)
        if self.reach is None:
            self.emit(Let(let.value, "add", place))
            return
        unwrapped = self.make("add", *place, type=type_)
        self.emit(Let(let.value, "floormod", (unwrapped, self.make("param", type=type_, attr=PERIOD))))

    def _own(self, type_: Type) -> int:
        """Emit the position of the element in its block; return its id."""
        within = self.value(type_)
        self.emit(Let(within, "grid_index"))
        return within.id

    def _within(self, index: int) -> int:
        """Emit the conversion of an index in the whole grid to one in the block; return its id."""
        type_ = self.types[index]
        origin = self.make("param", type=type_, attr=ORIGIN)
        local = self.make("sub", index, origin, type=type_)
        if self.reach is None:
            return local
        own, reach = self._own(type_), self.const(type_, *self.reach)
        ahead = self.make("add", self.make("sub", local, own, type=type_), reach, type=type_)
        ahead = self.make("floormod", ahead, self.make("param", type=type_, attr=PERIOD), type=type_)
        return self.make("sub", self.make("add", own, ahead, type=type_), reach, type=type_)
