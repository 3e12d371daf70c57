"""Blocks of a grid: a module that runs over a block computes what it would compute over the whole grid.

Stage: improve, of a recorded module, before anything else. The block's place comes by two uniforms. Tables that are cut
into the same blocks are read at the index within the block.

    %1: i2 = grid_index        ->    %5: i2 = grid_index ; %6: i2 = param block_origin ; %1: i2 = add %5, %6
    %2: i2 = grid_shape        ->    %2: i2 = param whole_shape
    %3: f = table u[%9]        ->    %7: i2 = param block_origin ; %8: i2 = sub %9, %7 ; %3: f = table u[%8]
    %4: i2 = table_size u      ->    %4: i2 = param whole_shape
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from shpy.ir.nodes import Function, Let, Module, Param
from shpy.ir.traverse import walk
from shpy.ir.types import Base, vec
from shpy.passes.rewriter import Functions, Rewriter, each_function

ORIGIN, WHOLE = "block_origin", "whole_shape"
"""The uniforms: the index of the block's first element, and the shape of the whole grid."""


def place_blocks(module: Module, cut: Collection[str], rank: int) -> Module:
    """Return the module for blocks of a grid of `rank` axes; the same object if it does not ask for a place.

    `cut` names the tables that are cut into the blocks.
    """
    lets = (s for f in module.functions for s in walk(f.body) if isinstance(s, Let))
    if not any(_asks(let, cut) for let in lets):
        return module
    made = each_function(module, lambda function, functions: _Placer(function, functions, cut).run())
    kind = f"Attrib{rank}i"
    uniforms = (Param(name, kind, vec(Base.I, rank), (0,) * rank) for name in (ORIGIN, WHOLE))
    return replace(made, params=(*made.params, *uniforms))


def _asks(let: Let, cut: Collection[str]) -> bool:
    return let.op in ("grid_index", "grid_shape") or (let.op in ("table", "table_size") and let.attr in cut)


class _Placer(Rewriter):
    def __init__(self, function: Function, functions: Functions, cut: Collection[str]) -> None:
        super().__init__(function, functions)
        self.cut = cut

    def let(self, let: Let) -> None:
        """Rewrite a statement that depends on the place of the element."""
        type_ = let.value.type
        if not _asks(let, self.cut):
            self.emit(let)
        elif let.op == "grid_index":
            within = self.value(type_)
            self.emit(Let(within, "grid_index"))
            self.emit(Let(let.value, "add", (within.id, self.make("param", type=type_, attr=ORIGIN))))
        elif let.op == "table":
            index = self.types[let.args[0]]
            origin = self.make("param", type=index, attr=ORIGIN)
            self.emit(replace(let, args=(self.make("sub", let.args[0], origin, type=index),)))
        else:
            self.emit(Let(let.value, "param", (), WHOLE))
