"""The kernel of a prepared module in packets: a work item computes many elements.

Stage: emit. The module is split into scalars and vectorised. A varying value becomes a `float16`, a uniform value stays
a `float`, and uniform control flow stays as it is:

    __kernel void f(ulong count, int first, int row, __global const float *c_in, int c_step, __global float *y_out) {
        int2 corner = sh_corner(first, row);
        sh_packet packet = sh_packet_at(corner, count, row);
        ...
        float16x2 c = sh_read_f2(c_in, c_step, packet);
        float16 z_x = (float16)(0.0f);
        ...

    print_packets(prepared.module, 16, Abilities()).text
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import reduce
from typing import ClassVar, Final

from shpy.backend.emit import tree
from shpy.backend.emit.entry import Needs, needed_by
from shpy.backend.emit.structure import Body
from shpy.backend.emit.tree import (
    BOOL,
    INT,
    UINT,
    Assign,
    Block,
    Cast,
    Construct,
    Declare,
    Do,
    Exit,
    Expr,
    Loop,
    Member,
    Name,
    Own,
    Parameter,
    Pointer,
    number,
)
from shpy.backend.opencl.packets.alone import LaneCalls
from shpy.backend.opencl.packets.module import PacketModule, pack
from shpy.backend.opencl.packets.operations import PacketOperations
from shpy.backend.opencl.packets.prologue import Abilities, PacketPrologue
from shpy.backend.opencl.packets.prologue_memory import spelled_wide
from shpy.backend.opencl.packets.prologue_packet import INLINE
from shpy.backend.opencl.packets.prologue_wide import LONGEST, Words, declare_wide
from shpy.backend.opencl.packets.spell_packets import PacketSpeller
from shpy.backend.opencl.packets.surroundings import surroundings
from shpy.backend.opencl.packets.widen import Lanes, Rows, lanes_of, rows_of, widened
from shpy.backend.opencl.text.kernel import SIZE, ULONG, KernelMaker, KernelText
from shpy.backend.opencl.text.operations import INDEX, LINE, SHAPE, ClOperations
from shpy.backend.opencl.text.prologue import NOINLINE
from shpy.backend.opencl.text.spell_cl import ClSpeller
from shpy.ir.nodes import Function, Let, Module, Variable
from shpy.ir.traverse import walk
from shpy.ir.types import Base, Type, vec
from shpy.passes.formulas.edges import edge, remark
from shpy.passes.modes import Math
from shpy.passes.pairing import pair
from shpy.passes.private import bytes_of
from shpy.passes.size import inlined_sizes

_LARGE: Final = 400
"""The most statements of an entry, with those that it calls, that is not a function of its own: PoCL generates the code
of a kernel three times. Other functions with more statements of their own are not inlined.
"""

_CALLED: Final = 16
_INLINED: Final = 100
"""The least and the most statements of a function that the compiler is told to inline; smaller ones are inlined anyway.

A call passes packets through memory, and no register survives it: five octaves of noise take 0.87 of the time in line,
and 1.1 of the time to compile. Other programs of the benchmarks gain and lose nothing, nor do they with a limit of 200.
"""

_IN_LINE: Final = 64
"""The most packets of a line that one work item computes, where it reads neighbours: long lines keep all cores busy."""

_FUSED_RSQRT: Final = "sqrt div mul neg fma fma mul sub eq mul mul add mul add cond".split()


def print_packets(
    module: Module,
    lanes: int,
    abilities: Abilities,
    math: Math = "strict",
    *,
    faults: Collection[str] = (),
    near: int | None = None,
) -> KernelText:
    """Return the kernel of a prepared module for packets of `lanes`; raise CompileError if OpenCL lacks something.

    `faults` are the compiler's faults, of FAULTS. `near` are the lanes of a kernel that reads neighbours in a grid, if
    they are others.
    """
    return PacketMaker(pack(module, lanes, math, faults, near), abilities, math, faults=faults).kernel()


def _is_fused_rsqrt(function: Function) -> bool:
    """Return whether a function of lanes is strict mode's 1 / sqrt(x) with fma (`passes/formulas/strict/root`)."""
    if function.name != "rsqrt_strict" or not isinstance(function.inputs[0].type, Lanes):
        return False
    return [s.op for s in walk(function.body) if isinstance(s, Let) and s.op not in ("const", "splat")] == _FUSED_RSQRT


def _length(function: Function) -> int:
    return sum(1 for _ in walk(function.body))


class PacketMaker(KernelMaker):
    """The emitter of a kernel of packets."""

    prologue: PacketPrologue
    operations: ClassVar[type[ClOperations]] = PacketOperations
    work: ClassVar[str] = "packet"

    def __init__(
        self,
        packets: PacketModule,
        abilities: Abilities,
        math: Math = "strict",
        *,
        faults: Collection[str],
    ) -> None:
        module, lanes, columns = packets.module, packets.lanes, packets.columns
        self.lanes, self.columns = lanes, columns
        self.words = Words()
        """The names in the text, which select the declarations of vectors longer than OpenCL C's."""
        super().__init__(module, math, elementwise=abilities.elementwise, faults=faults)
        self.grid[INDEX] = Name(rows_of(Base.I, max(self.grid_rank, 1), lanes), self.grid[INDEX].text)
        self.grid[LINE] = Name(vec(Base.I, max(self.grid_rank - 1, 1)), self.globals.take(LINE))
        self.listed = columns == lanes and not self.grid_of(module.entry.name)
        for base in Base:
            for size in (2, 3, 4):
                if base is not Base.H:
                    self.globals.reserve(spelled_wide(rows_of(base, size, lanes)))
        take = self.globals.take
        self.outer = packets.ports
        self.row = Name(INT, "" if self.listed else take("row"))
        self.corner = Name(UINT if self.listed else vec(Base.I, 2), take("start" if self.listed else "corner"))
        self.place = {self.corner: SIZE if self.listed else self.corner.type, self.count: ULONG}
        self.place |= {} if self.listed else {self.row: INT}
        self.dispatch = [Parameter(ULONG, self.count.text), Parameter(INT, self.first.text)]
        self.dispatch += [] if self.listed else [Parameter(INT, self.row.text)]
        self.packet = Name(INT, take("packet"))
        self.is_large = inlined_sizes(module)[module.entry.name] > _LARGE
        whole_rows = not self.listed and columns == lanes and _length(module.entry) <= _LARGE
        self.around = surroundings(module.entry, self.tables) if whole_rows else {}
        """The offsets from a packet at which a kernel reads that asks once whether all neighbours are in range."""
        self.inside = Name(BOOL, take("inside") if self.around else "")
        self.place |= {self.inside: BOOL} if self.around else {}
        self.packets = _IN_LINE if self.around else 1
        self.prologue = PacketPrologue(lanes, abilities, columns, listed=self.listed, packets=self.packets)

    def kernels_around(self, text: Callable[[str], str]) -> KernelText:
        """Return kernels that call the entry as a function of packets; `text` returns their source for its name."""

        def noted(inner: str) -> str:
            around = text(inner)
            self.words.add_text(around)
            return around

        return super().kernels_around(noted)

    def finished(self, inputs: tuple[int, ...]) -> KernelText:
        """Return the kernel with the whole text that was added."""
        return replace(
            super().finished(inputs), lanes=self.lanes, columns=self.columns, listed=self.listed, packets=self.packets
        )

    def private_bytes(self, array: Variable) -> int:
        """Return the bytes of a local array; one that varies has a place for what lanes store out of range."""
        if not isinstance(array.type, Lanes | Rows):
            return bytes_of(array)
        one = array.type.scalar if isinstance(array.type, Lanes) else vec(array.type.base, array.type.size)
        return bytes_of(replace(array, type=one, length=(array.length or 0) + 1)) * self.lanes

    def own_speller(self) -> ClSpeller:
        """Return a speller of functions of packets."""
        return PacketSpeller(lambda type: self.prologue.struct(type), self.words)

    def edge_text(self, op: str, types: tuple[Type, ...], name: str) -> str:
        """Return the function that computes `op`: a text, or a definition."""
        if not isinstance(types[0], Lanes):
            return super().edge_text(op, types, name)
        written = self.prologue.written(op, types[0])
        if written is not None:
            return written
        function = edge(op, tuple([t.scalar for t in types]), by_doubles=True)
        return remark(op, by_doubles=True) + self.printed(widened(function, self.lanes), name)

    def declared(self) -> Sequence[str]:
        """Return declarations of vectors longer than OpenCL C's."""
        if self.lanes <= LONGEST:
            return ()
        self.words.add_text(self.prologue.text())
        return ["", *declare_wide(self.words, self.lanes).splitlines()]

    # The extra arguments of functions

    def needed(self, let: Let) -> Needs:
        """Return the tables, params and grid variables that an operation reads.

        Neighbours, and indices of more than two axes, need the grid's shape, because rows are counted through planes.
        """
        shape = let.op == "neighbour" or self.rank_of(let) > 2
        return needed_by(let) | ({(SHAPE, "")} if shape else frozenset())

    def rank_of(self, let: Let) -> int:
        """Return the number of axes on which an operation reads the place in the grid; 0 for others."""
        if let.op == "neighbour":
            return self.tables[str(let.attr)].rank
        if let.op == LINE:
            return let.value.type.size + 1
        return min(super().rank_of(let), 1) if isinstance(let.value.type, Lanes) else super().rank_of(let)

    def handed(self, function: str) -> tuple[Name, ...]:
        """Return the extra arguments of a function; the entry's own function computes its index in the grid itself."""
        names = super().handed(function)
        if function != self.module.entry.name or not self.place:
            return names
        return (*self.place, *(e for e in names if e not in (self.grid[INDEX], self.grid[LINE])))

    def declares(self, e: Name) -> Parameter:
        """Return the parameter for an extra argument."""
        return Parameter(self.place[e], e.text) if e in self.place else super().declares(e)

    def array(self, type: Type, qualifier: str = "") -> Pointer:
        """Return the type of an array in memory; vectors of three are padded to four."""
        return super().array(type.sized(4) if type.size == 3 else type, qualifier)

    # Functions

    def qualifiers(self, function: Function) -> tuple[str, ...]:
        """Return what stands before a function: the entry's own is inlined, where borders have a function, too."""
        if self.around and function is self.module.entry:
            return (INLINE,)
        is_entry, length = function is self.module.entry, _length(function)
        if length > _LARGE or (is_entry and self.is_large):
            return (NOINLINE,)
        inline = () if is_entry or not _CALLED < length <= _INLINED else (INLINE,)
        return super().qualifiers(function) or inline

    def add(self, function: Function, name: str) -> None:
        """Add a function to the text; for one that lanes run alone, add the loop over the lanes too.

        Where `pair` can interleave two lanes, the function computes two, which hides the latency of their loads.
        """
        if _is_fused_rsqrt(function) and self.prologue.rsqrt(name):
            return
        if not function.alone:
            super().add(function, name)
            return
        function = replace(function, inputs=function.inputs[:-1])  # the mask is for the loop
        two = pair(function)
        inner = self.globals.take(f"{name}_alone" if two is None else f"{name}_two")
        super().add(two or function, inner)
        names = self.globals.scope()
        active = Name(BOOL, names.take("active"))
        inputs, outputs = (
            [Name(port.type.scalar, names.take(port.name or "a")) for port in ports]
            for ports in (function.inputs, function.outputs)
        )
        handed = self.handed(function.name)
        parameters = [Parameter(lanes_of(e.type.base, self.lanes), e.text) for e in (*inputs, active)]
        single = len(outputs) == 1
        if not single:
            parameters += [Parameter(Pointer(lanes_of(e.type.base, self.lanes)), e.text) for e in outputs]
        parameters += [self.declares(e) for e in handed]
        result = lanes_of(outputs[0].type.base, self.lanes) if single else None
        calls = LaneCalls(active, inputs, outputs, handed, self.lanes, names.take)
        block = calls.one_by_one(inner) if two is None else calls.two_by_two(inner)
        self.speller.function(tree.Function(name, result, tuple(parameters), block, function.loc, (NOINLINE,)))

    def prelude(self, function: str) -> Block:
        """Return the first statements of a function.

        The entry's own function makes its packet again, because a struct of vectors would be passed through memory.
        """
        if function != self.module.entry.name or not self.place:
            return ()
        return (self._make_packet(), *self._find_place())

    # The statements of a work item

    def has_function(self, entry: Function) -> bool:
        """Return whether the entry is a function that the kernel calls."""
        return self.is_large or bool(self.around) or super().has_function(entry)

    def add_kernel_function(self, kernel: tree.Function) -> None:
        """Add the kernel; packets at the border of a table go to a function of their own, where each read has a test.

        The rare way needs indices of all lanes, which would fill registers across the others. CPU time at 16 and 32
        lanes: 0.60 and 0.67 for the game of life, 0.81 and 0.80 for Jacobi's iteration, 0.93 and 0.90 for Gray-Scott of
        256 columns, the type of `PacketMemory.packed` included. That function is not inlined. A work item computes the
        packets of a line one after the other, so that what belongs to the line is computed once, and each packet asks
        for its column alone. On AVX2, medians of 25 launches in turns, 1,024 x 1,024: Jacobi's iteration takes 0.84 of
        the time of a packet for each work item, the game of life 0.92, Gray-Scott 0.88, a blur of 5 x 5 0.99.
        """
        if not self.around:
            super().add_kernel_function(kernel)
            return
        corner, packet, _, *rest = kernel.body
        assert isinstance(corner, Declare)
        place = [self.declares(e) for e in self.place if e is not self.inside]
        border = tree.Function(
            self.globals.take(f"{kernel.name}_border"),
            None,
            (*place, *kernel.parameters[len(self.dispatch) :]),
            (Declare(BOOL, self.inside.text, number(0)), packet, *rest),
            kernel.loc,
            (NOINLINE,),
        )
        self.speller.function(border)
        inside = (Declare(BOOL, self.inside.text, number(1)), packet, *rest)
        self.speller.function(replace(kernel, body=self._line(corner, inside, border)))

    def _line(self, corner: Declare, inside: Block, border: tree.Function) -> Block:
        """Return the loop over the packets of a work item, which are in a line.

        Each of them is computed by the statements `inside` where all neighbours are in range, else by the function.
        """
        start, x, y, end, last = (Name(INT, self.globals.take(name)) for name in ("start", "x", "y", "end", "last"))
        here = Construct(self.corner.type, (x, y))
        step = Assign(x, tree.infix("+", x, number(self.lanes)))
        first, line_is_inside, behind = self._inside_of(y, end)
        among = tree.infix("&&", tree.infix(">=", x, number(first), BOOL), tree.infix("<=", x, last, BOOL), BOOL)
        left = tree.infix("<", x, end, BOOL)
        args = [Name(INT, p.name) for p in border.parameters[1:]]
        outside = tree.If(left, (Do(tree.call(border.name, BOOL, here, *args)), step))
        loop = Loop((replace(corner, value=here), *inside), test=among, step=step)
        last_inside = tree.choice(line_is_inside, tree.infix("-", behind, number(self.lanes)), number(-1))
        return (
            replace(corner, name=start.text),
            Declare(INT, x.text, Member(INT, start, "x")),
            Declare(INT, y.text, Member(INT, start, "y")),
            Declare(INT, end.text, tree.call("sh_end", INT, start, *args[:2])),
            Declare(INT, last.text, last_inside),
            Loop((loop, outside), test=left),
        )

    def _inside_of(self, y: Expr, end: Expr) -> tuple[int, Expr, Expr]:
        """Return where all elements around a packet of line `y` that the entry reads are in range of their tables.

        It is the first column, whether the line is among these lines, and the column behind the last packet, which is
        at most `end`.
        """
        first, tests = (
            0,
            [tree.infix(">=", y, number(max(0, *(-above for (above, _), _ in self.around.values()))), BOOL)],
        )
        for name, ((_, below), (before, behind)) in self.around.items():
            lines, columns = (
                tree.call("min", INT, *[Member(INT, e, axis) for e in (self.size_names[name], self.grid[SHAPE])])
                for axis in "xy"
            )
            tests.append(tree.infix("<", y, tree.infix("-", lines, number(below)) if below > 0 else lines, BOOL))
            first = max(first, -before)
            end = tree.call("min", INT, end, tree.infix("-", columns, number(behind)) if behind > 0 else columns)
        return first, reduce(lambda a, b: tree.infix("&&", a, b, BOOL), tests), end

    def direct(self, entry: Function) -> Collection[int]:
        """Return no output, because the kernel writes each for all lanes at its end."""
        return ()

    def begin_kernel(self) -> None:
        """Add the struct of a packet to the prologue."""
        self.prologue.packet()

    def stored(self, type: Type) -> Type:
        """Return the type of an array that holds an input or output: an array of scalars."""
        return type.scalar

    def nothing(self, operations: ClOperations, type: Type) -> Expr:
        """Return a zero as the argument for an input that is not used."""
        zero = Construct(lanes_of(type.base, self.lanes), (number(0),))
        return zero if isinstance(type, Lanes) else Construct(type, (zero,))

    def fetched(self, operations: ClOperations, array: Name, step: Name, type: Type) -> Expr:
        """Return the expression that reads the packet's elements of an input."""
        read = self.prologue.memory("read", type.base, type.size)
        return tree.call(read, rows_of(type.base, type.size, self.lanes), array, step, self.packet)

    def write_outputs(self, body: Body, operations: ClOperations) -> None:
        """Append the stores of the outputs, each lane's number to its element."""
        parts = iter(body.function.outputs)
        for output in self.outer.outputs:
            type, array = output.type, self.arrays[output.id]
            numbers = [self._wide(body, next(parts)) for _ in range(type.size)]
            rows = rows_of(type.base, type.size, self.lanes)
            value = numbers[0] if type.size == 1 else Construct(rows, tuple(numbers))
            write = self.prologue.memory("write", type.base, type.size)
            body.out.append(Do(tree.call(write, BOOL, array, value, self.packet)))

    def _wide(self, body: Body, variable: Variable) -> Expr:
        """Return an output as a packet; a uniform one is broadcast."""
        e, type = body.slots[variable.id], variable.type
        return e if isinstance(type, Lanes) else Construct(lanes_of(type.base, self.lanes), (e,))

    def find_element(self, *, has_function: bool) -> Block:
        """Return the statements that compute a work item's packet, and end the work item if the packet is empty."""
        if self.listed:
            number_of = tree.infix("+", Cast(UINT, self.first, SIZE), tree.call("get_global_id", UINT, number(0)))
            start: Expr = tree.infix("*", number_of, number(self.lanes))
            empty: Expr = tree.infix("==", Member(INT, self.packet, "left"), number(0), BOOL)
        else:
            start = tree.call("sh_corner", self.corner.type, self.first, self.row)
            empty = Member(BOOL, self.packet, "empty")
        corner = Declare(self.place[self.corner], self.corner.text, start)
        block: Block = (corner, self._make_packet(), tree.If(empty, (Exit("return"),)))
        return block if has_function else (*block, *self._find_place())

    def _make_packet(self) -> tree.Stmt:
        return Declare(Own("sh_packet"), self.packet.text, tree.call("sh_packet_at", INT, *self.place))

    def _find_place(self) -> Block:
        """Return the statements that compute the lanes' index in the grid, and their line, if operations read them."""
        needs, index, line = self.needs[self.module.entry.name], self.grid[INDEX], self.grid[LINE]
        block: list[tree.Stmt] = []
        if (LINE, "") in needs:
            parts = self.split(Member(INT, self.corner, "y"), self.grid_rank - 1)
            place = parts[0] if len(parts) == 1 else Construct(line.type, tuple(parts))
            block.append(Declare(line.type, line.text, place))
        if (INDEX, "") in needs:
            block.append(Declare(index.type, index.text, self._grid_of_lanes(index.type)))
        return tuple(block)

    def _grid_of_lanes(self, type: Type) -> Expr:
        """Return the lanes' index along each axis; `y` of the packet counts rows through all planes."""
        lanes = lanes_of(Base.I, self.lanes)
        x, y = (Member(lanes, self.packet, axis) for axis in "xy")
        if self.grid_rank == 1:
            return tree.infix("+", x, tree.infix("*", y, self.row))
        return Construct(type, (*self.split(y, self.grid_rank - 1), x))
