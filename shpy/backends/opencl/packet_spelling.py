"""How operations on packets are spelled: as on vectors of OpenCL C, but for what this file says.

Stage: emit. A packet is a vector of as many numbers as there are lanes (`packet_types`), so `z_x * z_x + 4.0f` reads
as it does for one element. Bools are ints, -1 for true: masks. What is the same for all lanes is left to `Spelling`.

    lane_any %leaving   ->  sh_any(leaving)             table %i, points   ->  sh_gather_f3(points, clamp(i, ...))
    cond %c, %a, %b     ->  c ? a : b                   floor %x           ->  __builtin_elementwise_floor(x)
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from shpy.backends import expressions as ex
from shpy.backends.expressions import Expr, Level
from shpy.backends.opencl.packet_prologue import IN_REGISTERS, PacketPrologue
from shpy.backends.opencl.packet_types import Lanes, Rows, lanes_of
from shpy.backends.opencl.spelling import Spelling
from shpy.backends.opencl.text.operations import FAST, NATIVE
from shpy.ir.nodes import Let, Store, Variable
from shpy.ir.types import Base, Type

_PROLOGUE: Final = frozenset({"min", "max", "floordiv", "floormod", "half", "ldexp", "sin", "cos", "tan"})


class PacketSpelling(Spelling):
    """Operations on packets. `PacketPrinter` gives the prologue, and the names of the packet."""

    prologue: PacketPrologue
    packet = "packet"

    # Types and vectors

    def type_name(self, type: Type) -> str:
        """`float16`, or `float16x3` for vectors."""
        if isinstance(type, Rows):
            self.doubles = self.doubles or type.base is Base.D
            return self.prologue.struct(type)
        return super().type_name(type)

    def construct(self, type: Type, parts: list[Expr], types: list[Type]) -> Expr:
        """`(float16x3){x, y, z}`."""
        if not isinstance(type, Rows):
            return super().construct(type, parts, types)
        made = ex.call("", *parts)
        return replace(made, text=f"({self.type_name(type)}){{{made.text[1:-1]}}}", level=Level.POSTFIX)

    def op_construct(self, let: Let) -> Expr:
        """A struct has a packet for each component: vectors among the parts are picked apart."""
        type = let.value.type
        if not isinstance(type, Rows):
            return super().op_construct(let)
        lanes = lanes_of(type.base, type.lanes)
        parts: list[Expr] = []
        for a in let.args:
            if isinstance(self.types[a], Rows):
                whole = self.simple(a)
                parts += [self.picked(whole, (k,), lanes) for k in range(self.types[a].size)]
            else:
                parts.append(self.signed(self.take(a)))
        return self.construct(type, parts, [])

    def op_splat(self, let: Let) -> Expr:
        """What is the same for all lanes, for each of them; or one number, for each component."""
        type, source = let.value.type, self.types[let.args[0]]
        if isinstance(type, Rows):
            whole = self.simple(let.args[0])
            parts = [whole] * type.size
            if not isinstance(source, Lanes):
                lanes = lanes_of(type.base, type.lanes)
                numbers = [self.picked(whole, (k,), source.scalar) for k in range(type.size)]
                parts = [self.construct(lanes, [n], [source.scalar]) for n in numbers]
            return self.construct(type, parts, [])
        made = super().op_splat(let)
        return replace(made, scalar=None) if type.is_bool else made

    def op_swizzle(self, let: Let) -> Expr:
        """`p.x`; several components of vectors are picked one by one."""
        type = let.value.type
        if not isinstance(type, Rows):
            return super().op_swizzle(let)
        assert isinstance(let.attr, tuple)
        whole = self.simple(let.args[0])
        lanes = lanes_of(type.base, type.lanes)
        return self.construct(type, [self.picked(whole, (k,), lanes) for k in let.attr], [])

    # Operations

    def function(self, op: str, types: tuple[Type, ...]) -> str:
        """OpenCL's function, the compiler's, or one of the prologue."""
        if not isinstance(types[0], Lanes):
            return super().function(op, types)
        if op in ("min", "max") and types[0].is_int:
            return op
        if self.math == "fast" and (op in FAST | NATIVE.keys() or op == "ldexp"):
            return Spelling.function(self, op, types)
        ours = op in _PROLOGUE or (op == "pow" and types[0].base is Base.D)
        return self.prologue.use(op, types[0]) if ours else super().function(op, types)

    def not_vector(self, e: Expr) -> Expr:
        """`~mask`: every lane is 0 or -1."""
        return ex.prefix("~", e)

    def op_cond(self, let: Let) -> Expr:
        """A choice by a mask, or by what holds for all lanes."""
        condition = self.types[let.args[0]]
        if isinstance(let.value.type, Lanes) and not isinstance(condition, Lanes):
            return ex.ternary(*self.args(let))
        return super().op_cond(let)

    def op_abs(self, let: Let) -> Expr:
        """`fabs(a)`, `sh_abs_i16(a)`."""
        type = let.value.type
        if isinstance(type, Lanes) and type.base is Base.I:
            return ex.call(self.prologue.use("abs", type), *self.args(let))
        return super().op_abs(let)

    def op_lane_any(self, let: Let) -> Expr:
        """`sh_any(mask)`."""
        return ex.call(self.prologue.use("lane_any", self.types[let.args[0]]), *self.args(let))

    def op_lane_mask(self, let: Let) -> Expr:
        """The lanes that hold an element."""
        return ex.member(ex.name(self.packet), "active")

    # Tables and the grid

    def pointer(self, type: Type, qualifier: str = "") -> str:
        """Vectors of three are kept as four."""
        return super().pointer(type.sized(4) if type.size == 3 else type, qualifier)

    def read(self, array: Expr, index: Expr, type: Type) -> Expr:
        """An element of a table."""
        if type.size != 3:
            return super().read(array, index, type)
        whole = super().read(array, index, type.sized(4))
        return ex.member(whole, "xyz")

    def op_table(self, let: Let) -> Expr:
        """An element for all lanes, or one for each."""
        type = let.value.type
        if not isinstance(type, Lanes | Rows):
            return super().op_table(let)
        name = str(let.attr)
        table, size = self.tables[name], Expr(self.size_names[name])
        (index,) = self.args(let)
        if table.rank == 1:
            last = ex.infix("-", Level.ADD, size, Expr("1"))
            at = ex.call("clamp", index, Expr("0"), last)
        else:
            at = ex.call(self.prologue.flat_lanes(table.rank), index, size)
        gather = self.prologue.memory("gather", table.type.base, table.type.size)
        return ex.call(gather, ex.name(self.table_names[name]), at)

    def op_neighbour(self, let: Let) -> Expr:
        """`sh_near2_f(texels, texels_size, packet, (int2)(dy, dx))`, or `sh_around2_f` with the moduli after it."""
        name = str(let.attr)
        table, rank = self.tables[name], self.tables[name].rank
        args, wraps = self.args(let), len(let.args) > rank
        near = self.prologue.near(rank, table.type.base, table.type.size, wraps=wraps)
        pairs = [args[:rank], *([args[rank:]] if wraps else [])]
        by = [pair[0] if rank == 1 else ex.call(f"(int{rank})", *pair) for pair in pairs]
        return ex.call(near, ex.name(self.table_names[name]), Expr(self.size_names[name]), ex.name(self.packet), *by)

    def grid(self, op: str, type: Type) -> Expr:
        """A variable of the kernel, or the lanes' own index."""
        return ex.name(self.grid_names[op])

    # Local arrays

    def declare_array(self, variable: Variable, name: str) -> str:
        """A long array has one more element, for lanes that store nowhere."""
        if isinstance(variable.type, Lanes) and (variable.length or 0) > IN_REGISTERS:
            variable = replace(variable, length=(variable.length or 0) + 1)
        return super().declare_array(variable, name)

    def op_load(self, let: Let) -> Expr:
        """A variable, or an element of an array, at each lane's own index."""
        if not let.args or not isinstance(self.types[let.args[0]], Lanes):
            return super().op_load(let)
        assert isinstance(let.attr, int)
        variable = self.variables[let.attr]
        pick = self._array("pick", variable)
        return ex.call(pick, self.slots[let.attr], self._index(let.args[0], variable))

    def _array(self, way: str, variable: Variable) -> str:
        assert variable.length is not None
        return self.prologue.array(way, variable.type.base, variable.length, isinstance(variable.type, Lanes))

    def _index(self, index: int, variable: Variable) -> Expr:
        """Return each lane's index as an int; a uint too large for one is out of range as well."""
        type = self.types[index]
        (e,) = (self.signed(self.take(index)),)
        if type.base is not Base.U:
            return e
        return ex.call(f"as_int{type.size}", ex.call("min", e, Expr(f"{variable.length}u")))

    def _store_element(self, s: Store, index: int, e: Expr) -> None:
        """A store into an array at each lane's own index."""
        if not isinstance(self.types[index], Lanes):
            super()._store_element(s, index, e)
            return
        variable = self.variables[s.variable]
        at = self._index(index, variable)
        self.settle([s.variable])
        self.emit(f"{self._array('put', variable)}({self.slots[s.variable].text}, {at.text}, {e.text});", s.loc)
