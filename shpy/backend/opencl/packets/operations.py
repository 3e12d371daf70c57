"""Operations on packets: those that differ from the operations on OpenCL C's vectors.

Stage: emit. A packet is a vector with a number for each lane (`widen`), so `z_x * z_x + 4.0f` reads as it does for one
element. Bools are masks: ints, -1 for true. `ClOperations` writes the operations on uniform values.

    lane_any %leaving   ->  sh_any(leaving)             table %i, points   ->  sh_gather_f3(points, clamp(i, ...))
    cond %c, %a, %b     ->  c ? a : b                   floor %x           ->  __builtin_elementwise_floor(x)
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from shpy.backend.emit import tree
from shpy.backend.emit.tree import BOOL, INT, UINT, Block, Construct, Do, Expr, Member, Name, number
from shpy.backend.opencl.packets.prologue import IN_REGISTERS, PacketPrologue
from shpy.backend.opencl.packets.widen import Lanes, Rows, lanes_of
from shpy.backend.opencl.text.operations import NATIVE, ClOperations, ClUnit
from shpy.backend.opencl.text.prologue import name_of
from shpy.ir.nodes import Let, Store, Variable
from shpy.ir.types import Base, Type

_PROLOGUE: Final = frozenset({"min", "max", "floordiv", "floormod", "half", "ldexp"})


class _PacketUnit(ClUnit):
    """The part of a packet kernel's state that operations use."""

    prologue: PacketPrologue
    packet: Name
    """The packet of the work item."""
    place: dict[Name, Type]
    """The parameters from which the entry makes its packet; none in a tree, whose entry is called for no packet."""
    around: dict[str, list[tuple[int, int]]]
    """The offsets at which the entry reads neighbours, if it takes whether all are in range as an argument."""
    inside: Name
    """The name of that argument."""


class PacketOperations(ClOperations):
    """The operations of one function of packets."""

    unit: _PacketUnit

    # Vectors and names

    def repeats(self, s: Let | Store) -> Collection[int]:
        """Return the operands that are picked apart; an index of each lane is written once."""
        if isinstance(s, Store):
            return () if s.index is None or isinstance(self.types[s.index], Lanes) else (s.index,)
        if not isinstance(s.value.type, Rows) or s.op not in ("construct", "splat", "swizzle"):
            return ()
        return [a for a in s.args if s.op != "construct" or isinstance(self.types[a], Rows)]

    def unknown_zero(self, type: Type) -> Expr | None:
        """Return a hidden zero for a uniform type, else None: exits by a varying condition test if any lane leaves."""
        return None if isinstance(type, Lanes | Rows) else super().unknown_zero(type)

    def splat_of(self, e: Expr) -> Expr | None:
        """Return the scalar that may take the place of a packet; None for bools, which are not masks."""
        return None if e.type.is_bool else e.splat

    def _components(self, value: int, components: Collection[int], lanes: Type) -> list[Expr]:
        """Return components of a packet of vectors."""
        return [tree.picked(self.exprs[value], (k,), lanes) for k in components]

    def op_construct(self, let: Let) -> Expr:
        """Return a packet of vectors from packets of their components; a vector among the operands is split first."""
        type = let.value.type
        if not isinstance(type, Rows):
            return super().op_construct(let)
        lanes = lanes_of(type.base, type.lanes)
        parts: list[Expr] = []
        for a in let.args:
            whole = isinstance(self.types[a], Rows)
            parts += self._components(a, range(self.types[a].size), lanes) if whole else [self.arg(a)]
        return Construct(type, tuple(parts))

    def op_splat(self, let: Let) -> Expr:
        """Broadcast a uniform value to all lanes, or repeat one packet for each component."""
        type, source = let.value.type, self.types[let.args[0]]
        if not isinstance(type, Rows):
            return super().op_splat(let)
        if isinstance(source, Lanes):
            return Construct(type, (self.exprs[let.args[0]],) * type.size)
        lanes = lanes_of(type.base, type.lanes)
        numbers = [self.picked(self.exprs[let.args[0]], (k,), source.scalar) for k in range(type.size)]
        return Construct(type, tuple([Construct(lanes, (n,)) for n in numbers]))

    def op_swizzle(self, let: Let) -> Expr:
        """Return `p.x`; several components of vectors are picked one by one."""
        type = let.value.type
        if not isinstance(type, Rows):
            return super().op_swizzle(let)
        assert isinstance(let.attr, tuple)
        return Construct(type, tuple(self._components(let.args[0], let.attr, lanes_of(type.base, type.lanes))))

    # Operations

    def convert(self, type: Type, e: Expr, source: Type) -> Expr:
        """Return a conversion of each lane; of floats to ints by the instruction of the device, if it has one."""
        if type.base is Base.I and source.base is Base.F and isinstance(source, Lanes):
            ints = self.unit.prologue.ints() if self.unit.math != "fast" else ""  # whose compiler takes x == x for true
            if ints:
                return tree.call(ints, type, e)
        return super().convert(type, e, source)

    def function_of(self, op: str, types: tuple[Type, ...]) -> str:
        """Return the name of OpenCL's function, of the compiler's, or of one of the prologue."""
        type = types[0]
        ours = op in _PROLOGUE if op not in ("min", "max") else type.is_float
        if op == "rsqrt" and self.unit.math == "relaxed" and isinstance(type, Lanes) and type.base is Base.F:
            name = name_of(op, type)
            if self.unit.prologue.rsqrt(name, near=True):
                return name
        fast = self.unit.math == "fast" and (op in NATIVE or op == "ldexp")
        if isinstance(type, Lanes) and ours and not fast:
            return self.unit.edge(op, types)
        return super().function_of(op, types)

    def is_wrong(self, op: str, type: Type) -> bool:
        """Return whether OpenCL's own function differs for this type."""
        return not isinstance(type, Lanes) and super().is_wrong(op, type)

    def not_vector(self, e: Expr) -> Expr:
        """Return `~mask`: every lane is 0 or -1."""
        return tree.prefix("~", e)

    def op_cond(self, let: Let) -> Expr:
        """Return a choice by a mask, or by a uniform condition."""
        if isinstance(let.value.type, Lanes) and not isinstance(self.types[let.args[0]], Lanes):
            c, a, b = self.args(let)
            return tree.choice(c, a, b)
        return super().op_cond(let)

    def op_lane_any(self, let: Let) -> Expr:
        """Return `sh_any(mask)`."""
        return tree.call(self.unit.prologue.any_lane(), BOOL, self.arg(let.args[0]))

    def op_lane_min(self, let: Let) -> Expr:
        """Return `sh_min_lane_f(x)`."""
        name = self.unit.prologue.extreme_lane(let.op.removeprefix("lane_"), let.value.type.base)
        return tree.call(name, let.value.type, self.arg(let.args[0]))

    op_lane_max = op_lane_min

    def op_lane_mask(self, let: Let) -> Expr:
        """Return the mask of the lanes that hold an element: of all lanes in a tree, where no packet is read."""
        if not self.unit.place:
            return Construct(let.value.type, (number(-1),))
        return Member(let.value.type, self.unit.packet, "active")

    # Tables and the grid

    def read(self, array: Expr, index: Expr, type: Type) -> Expr:
        """Return an element of a table; its vectors of three are padded to four."""
        if type.size != 3:
            return super().read(array, index, type)
        return Member(type, super().read(array, index, type.sized(4)), "xyz")

    def op_table(self, let: Let) -> Expr:
        """Return one element for all lanes, or a gather of one per lane."""
        type, name, unit = let.value.type, str(let.attr), self.unit
        if not isinstance(type, Lanes | Rows):
            return super().op_table(let)
        table, size, index = unit.tables[name], unit.size_names[name], self.arg(let.args[0])
        if table.rank == 1:
            at = tree.call("clamp", index.type, index, number(0), tree.infix("-", size, number(1)))
        else:
            at = tree.call(unit.prologue.flat_lanes(table.rank), index.type, index, size)
        gather = unit.prologue.memory("gather", table.type.base, table.type.size)
        return tree.call(gather, type, unit.table_names[name], at)

    def op_neighbour(self, let: Let) -> Expr:
        """Return `sh_near2_f(texels, texels_size, packet, (int2)(dy, dx))`, or `sh_around2_f` with the moduli too."""
        name, unit = str(let.attr), self.unit
        table, rank = unit.tables[name], unit.tables[name].rank
        args, wraps = self.args(let), len(let.args) > rank
        modulo = unit.edge("floormod", (lanes_of(Base.I, unit.prologue.lanes),) * 2) if wraps else ""
        near = unit.prologue.near(rank, table.type.base, table.type.size, modulo, tells=bool(unit.around))
        pairs = [args[:rank], *([args[rank:]] if wraps else [])]
        by = [pair[0] if rank == 1 else Construct(INT.sized(rank), tuple(pair)) for pair in pairs]
        by += [unit.inside] if unit.around else []
        return tree.call(near, let.value.type, unit.table_names[name], unit.size_names[name], unit.packet, *by)

    def op_grid_index(self, let: Let) -> Expr:
        """Return the kernel's variable for the shape, for the lanes' index, or for their line."""
        return self.unit.grid[let.op]

    op_grid_line = op_grid_shape = op_grid_index

    # Local arrays

    def array_length(self, variable: Variable) -> int | None:
        """Return the length of an array; a long one gets one more element, into which lanes store out of range."""
        length = variable.length
        is_long = isinstance(variable.type, Lanes) and length is not None and length > IN_REGISTERS
        return length + 1 if is_long and length is not None else length

    def op_load(self, let: Let) -> Expr:
        """Return a variable, or an element of an array, at each lane's own index."""
        if not let.args or not isinstance(self.types[let.args[0]], Lanes):
            return super().op_load(let)
        assert isinstance(let.attr, int)
        variable = self.variables[let.attr]
        pick = self._array("pick", variable)
        return tree.call(pick, let.value.type, self.slots[let.attr], self._index(let.args[0], variable))

    def _array(self, way: str, variable: Variable) -> str:
        """Name the function that picks from an array or stores into it."""
        varies = isinstance(variable.type, Lanes)
        return self.unit.prologue.array(way, variable.type.base, variable.length or 0, varies)

    def _index(self, index: int, variable: Variable) -> Expr:
        """Return each lane's index as an int; a uint is clamped to the length first, which is out of range as well."""
        e, type = self.arg(index), self.types[index]
        if type.base is not Base.U:
            return e
        return self.as_ints(tree.call("min", type, e, number(variable.length or 0, UINT)))

    def store_element(self, s: Store, index: int, e: Expr) -> Block:
        """Return the store into an array at each lane's own index."""
        if not isinstance(self.types[index], Lanes):
            return super().store_element(s, index, e)
        variable = self.variables[s.variable]
        at = self._index(index, variable)
        put = self._array("put", variable)
        return (Do(tree.call(put, BOOL, self.slots[s.variable], at, e), s.loc),)
