"""The kernels of a program of two elements, which fold and scan a stream in packets.

Stage: emit. See `prologue_trees` for the text around the program.

    print_trees(prepared.module, NodeTypes((F,), (F,), lifted=False), 16, Abilities()).text
"""

from __future__ import annotations

from collections.abc import Collection

from shpy.backend.base import NodeTypes
from shpy.backend.opencl.packets.kernel import PacketMaker, in_packets
from shpy.backend.opencl.packets.prologue import Abilities
from shpy.backend.opencl.packets.prologue_trees import TreePrologue
from shpy.backend.opencl.packets.widen import Lanes
from shpy.backend.opencl.text.kernel import KernelText
from shpy.ir.nodes import Module
from shpy.ir.types import Base


def print_trees(
    module: Module,
    types: NodeTypes,
    lanes: int,
    abilities: Abilities,
    *,
    joins: bool = False,
    faults: Collection[str] = (),
) -> KernelText | None:
    """Return the kernels of a prepared program of two nodes; None with tables, params, binary16 or uniform outputs.

    The inputs are the parts of two nodes, and the outputs are those of one. If elements are lifted, an element and its
    index precede these inputs, and the node of that element precedes the result. `joins`: see `TreePrologue`;
    `faults`: see `print_packets`.
    """
    if module.tables or module.params or any(t.base is Base.H for t in (*types.element, *types.part)):
        return None
    packets = in_packets(module, lanes, "strict", faults)
    if not all(isinstance(o.type, Lanes) for o in packets.entry.outputs):
        return None
    maker = PacketMaker(packets, module.entry, lanes, lanes, abilities, faults=faults)
    return maker.kernels_around(TreePrologue(maker.prologue, types, joins=joins).text)
