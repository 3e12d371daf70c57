"""A prepared module on packets, and the shape of a packet: in a line of the grid, or in a block of several lines.

Stage: improve. The module is split into scalars, vectorised, and its varying values get the types of packets. Lanes
that diverge, or that read tables each at its own index, lie in blocks, since neighbours in both directions behave
alike. Other packets lie in lines, in which the index of the line is one number for all lanes:

    pack(prepared.module, 16, "strict", ()).columns       # 16: in lines
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from shpy.backend.opencl.packets.prologue_memory import QUAD
from shpy.backend.opencl.packets.widen import Lanes, Rows, widen
from shpy.backend.opencl.text.operations import hides_zeros
from shpy.ir.nodes import Call, Function, Let, Module
from shpy.ir.traverse import defined, variables_of, walk
from shpy.ir.types import Type
from shpy.passes.commoning import keep_for_next
from shpy.passes.components import ALL, LONG, SHORT, has_long, take_apart
from shpy.passes.hide import hide_derivable
from shpy.passes.inline import inline_calls
from shpy.passes.lines import in_lines, mixed, placed, reads_lines, together
from shpy.passes.modes import Math
from shpy.passes.neighbours import find_neighbours
from shpy.passes.pipeline import optimise
from shpy.passes.vectorize import VectorModule, vectorize


@dataclass(frozen=True, slots=True)
class PacketModule:
    """A module on packets of `lanes` elements, `columns` of them side by side, and its `ports` before the split."""

    module: Module
    ports: Function
    lanes: int
    columns: int


def pack(module: Module, lanes: int, math: Math, faults: Collection[str], near: int | None = None) -> PacketModule:
    """Return a prepared module on packets of `lanes`; or of `near`, if its entry reads neighbours in a grid."""
    module = together(module)
    called = {s.function for f in module.functions if f.alone for s in walk(f.body) if isinstance(s, Call)}
    if called:
        # A function that lanes run one after the other calls no other function.
        module = inline_calls(module, lambda f: f.name in called)
    vector = _vectorised(module, math, faults, padded=True, alone=True)
    if near is not None and any(isinstance(s, Let) and s.op == "neighbour" for s in walk(vector.module.entry.body)):
        lanes = near
    packets = widen(vector, lanes)
    columns = lanes if _stay_together(packets) else QUAD
    if columns == lanes and reads_lines(module):
        packets = widen(_vectorised(module, math, faults, padded=True, alone=True, lines=True), lanes)
    return PacketModule(packets, module.entry, lanes, columns)


def pack_parts(module: Module, lanes: int, faults: Collection[str]) -> PacketModule:
    """Return a prepared module on packets for a tree, whose entry is called with packets and reads no place."""
    return PacketModule(widen(_vectorised(module, "strict", faults), lanes), module.entry, lanes, lanes)


def _vectorised(
    module: Module,
    math: Math,
    faults: Collection[str],
    *,
    padded: bool = False,
    alone: bool = False,
    lines: bool = False,
) -> VectorModule:
    """Return a prepared module of scalars for many lanes; `padded` and `alone`: see `vectorize`.

    `lines`: packets lie in lines.
    """
    called = placed(module) | (mixed(module) if lines else frozenset())
    for sizes in (SHORT, ALL) if has_long(module) else (ALL,):
        scalar = keep_for_next(optimise(take_apart(module, sizes=sizes, called=called)))
        scalar = in_lines(scalar) if lines else scalar
        # A hidden zero adds arithmetic on vectors, which has to be split too.
        whole = take_apart(hide_derivable(scalar), sizes=sizes) if hides_zeros(math, faults) else scalar
        vector = vectorize(whole, padded=padded, alone=alone)
        if not _has_varying_long(vector):
            break
    return find_neighbours(vector)


def _has_varying_long(vector: VectorModule) -> bool:
    """Return whether a vector of eight differs from lane to lane: then all of them have to be split."""
    types: list[Type] = []
    for f in vector.module.functions:
        if (facts := vector.facts.get(f.name)) is not None:
            types += [v.type for v in defined(f) if v.id in facts.varying]
            types += [v.type for v in variables_of(f) if v.id in facts.slots]
    return any(type.size in LONG for type in types)


def _stay_together(module: Module) -> bool:
    """Return whether lanes neither diverge nor gather from tables; blocks then have no advantage over rows.

    Divergence inside functions without stores does not count, because rare numbers cause it.
    """
    lets = [(f.name, s) for f in module.functions for s in walk(f.body) if isinstance(s, Let)]
    pure = {str(s.attr) for _, s in lets if s.op == "call"}
    part = any(s.op == "lane_any" and name not in pure for name, s in lets)
    return not part and not any(s.op == "table" and isinstance(s.value.type, Lanes | Rows) for _, s in lets)
