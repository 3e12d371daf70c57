"""The printer of packets: a prepared module as one kernel, many elements a work item.

Stage: emit. The module is taken apart into scalars and vectorised; what varies from lane to lane becomes a `float16`,
what does not stays a `float`, and control flow is what it was where it is the same for all:

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

from dataclasses import replace

from shpy.backends.expressions import Expr
from shpy.backends.opencl.packet_alone import each_lane, packet_of
from shpy.backends.opencl.packet_halves import declare_wide
from shpy.backends.opencl.packet_memory import QUAD, spelled_wide
from shpy.backends.opencl.packet_prologue import Abilities, PacketPrologue
from shpy.backends.opencl.packet_spelling import PacketSpelling
from shpy.backends.opencl.packet_types import Lanes, Rows, lanes_of, rows_of, widen
from shpy.backends.opencl.printer import Needs, OpenCLPrinter, leaves_early
from shpy.backends.opencl.text.kernel import Kernel
from shpy.backends.opencl.text.prologue import NOINLINE, spelled
from shpy.ir.nodes import Call, Function, Let, Module, Value, Variable
from shpy.ir.traverse import walk
from shpy.ir.types import Base, Type, vec
from shpy.passes.components import take_apart
from shpy.passes.hide import hide_derivable
from shpy.passes.inline import inline_calls
from shpy.passes.modes import Math
from shpy.passes.neighbours import find_neighbours
from shpy.passes.pipeline import optimise
from shpy.passes.vectorize import vectorize

__all__ = ["print_packets"]

_LARGE = 400
"""A kernel of more statements is a function that the kernel calls: PoCL generates the code of a kernel three times.

Functions of so many are not inlined either.
"""


def print_packets(
    module: Module, lanes: int, abilities: Abilities, math: Math = "strict", *, hides_zeros: bool = False
) -> Kernel:
    """The kernel of a prepared module for packets of `lanes` elements; CompileError for what OpenCL cannot do.

    `hides_zeros`: the compiler takes `0 * x` for 0.
    """
    called = {s.function for f in module.functions if f.alone for s in walk(f.body) if isinstance(s, Call)}
    if called:
        module = inline_calls(module, lambda f: f.name in called)  # what an element runs alone calls nothing else
    scalar = optimise(take_apart(module))
    # What hides a vector is arithmetic on it, which packets take apart too.
    whole = take_apart(hide_derivable(scalar)) if hides_zeros else scalar
    packets = widen(find_neighbours(vectorize(whole, padded=True, alone=True)), lanes)
    columns = lanes if _stay_together(packets) else QUAD
    return PacketPrinter(packets, module.entry, lanes, columns, abilities, math, hides_zeros=hides_zeros).print()


def _stay_together(module: Module) -> bool:
    """Return whether no lane diverges or reads an index of its own, so that a block of the image gains nothing.

    What a function without stores does apart is for numbers that are rare.
    """
    lets = [(f.name, s) for f in module.functions for s in walk(f.body) if isinstance(s, Let)]
    pure = {str(s.attr) for _, s in lets if s.op == "call"}
    part = any(s.op == "lane_any" and name not in pure for name, s in lets)
    return not part and not any(s.op == "table" and isinstance(s.value.type, Lanes | Rows) for _, s in lets)


def _is_large(function: Function) -> bool:
    return sum(1 for _ in walk(function.body)) > _LARGE


class PacketPrinter(PacketSpelling, OpenCLPrinter):
    """Prints one module of packets; `ports` has the inputs and outputs as they were before they were taken apart."""

    def __init__(
        self,
        module: Module,
        ports: Function,
        lanes: int,
        columns: int,
        abilities: Abilities,
        math: Math = "strict",
        *,
        hides_zeros: bool = False,
    ) -> None:
        super().__init__(module, math, hides_zeros=hides_zeros)
        self.lanes = lanes
        self.columns = columns
        self.ports = ports
        self.listed = columns == lanes and not self.needs[module.entry.name].grid
        self.prologue = PacketPrologue(lanes, abilities, columns, listed=self.listed)
        self.elementwise = abilities.elementwise
        for base in Base:
            for size in (2, 3, 4):
                if base is not Base.H:
                    self.globals.reserve(spelled_wide(rows_of(base, size, lanes)))
        self.row = "" if self.listed else self.globals.take("row")
        self.corner = self.globals.take("start" if self.listed else "corner")
        self.place = [("size_t" if self.listed else "int2", self.corner), ("ulong", self.count)]
        self.place += [] if self.listed else [("int", self.row)]
        self.packet = self.globals.take("packet")
        self.is_inner = False

    def print(self) -> Kernel:
        """The whole text."""
        made = super().print()
        doubles = made.doubles or self.prologue.doubles
        return replace(made, doubles=doubles, lanes=self.lanes, columns=self.columns, listed=self.listed)

    def declared(self) -> list[str]:
        """Vectors of more numbers than OpenCL C has."""
        text = "\n".join([self.prologue.text(), *(text for text, _ in self.lines)])
        wide = declare_wide(text, self.lanes)
        return ["", *wide.splitlines()] if wide else []

    # What a function needs besides its arguments

    def _needs(self, function: Function) -> Needs:
        found = super()._needs(function)
        for s in walk(function.body):
            if isinstance(s, Let) and s.op in ("grid_index", "grid_shape"):
                self.grid_rank = 1 if isinstance(s.value.type, Lanes) else s.value.type.size
                if self.grid_rank > 2:
                    # The rows of an image are numbered through its planes.
                    found |= Needs(grid=frozenset({"grid_shape"}))
            elif isinstance(s, Let) and s.op == "neighbour":
                self.grid_rank = next(t.rank for t in self.module.tables if t.name == s.attr)
                found |= Needs(grid=frozenset({"grid_shape"}))  # packets are blocks of the grid
        return found

    def _handed(self, function: Function) -> list[tuple[str, str]]:
        """A lane's place in the grid is wide; the entry's own function is handed what its packet is made of."""
        pairs = super()._handed(function)
        index = self.grid_names["grid_index"]
        if function.name == self.module.entry.name:
            here = [(f"{type} {name}", name) for type, name in self.place]
            return [*here, *(pair for pair in pairs if pair[1] != index)]
        return [(self.declaration(self._index_type(), name) if name == index else text, name) for text, name in pairs]

    def _index_type(self) -> Type:
        return rows_of(Base.I, max(self.grid_rank, 1), self.lanes)

    # Functions and the kernel

    def stands_apart(self, function: Function) -> bool:
        """Return whether the compiler is told not to inline the function."""
        return super().stands_apart(function) or _is_large(function)

    def _function(self, function: Function, name: str) -> None:
        """A function; one that each lane runs alone, and the loop over the lanes that do."""
        if not function.alone:
            super()._function(function, name)
            return
        one = self.globals.take(f"{name}_alone")
        function = replace(function, inputs=function.inputs[:-1])  # the mask is for the loop
        super()._function(function, one)
        self.begin(function)
        active = self.names.take("active")
        inputs, outputs = (
            [(self.names.take(port.name or "a"), spelled(port.type.scalar)) for port in ports]
            for ports in (function.inputs, function.outputs)
        )
        single = len(outputs) == 1
        parameters = [*(f"{packet_of(t, self.lanes)} {n}" for n, t in inputs), f"int{self.lanes} {active}"]
        parameters += [] if single else [f"{packet_of(t, self.lanes)} *{n}" for n, t in outputs]
        handed = self._handed(function)
        self.emit("")
        result = packet_of(outputs[0][1], self.lanes) if single else "void"
        self._head(f"{NOINLINE} {result} {name}", [*parameters, *(text for text, _ in handed)], function.loc)
        with self.block(scope=False):
            for line in each_lane(one, active, inputs, outputs, [n for _, n in handed], self.lanes):
                self.emit(line)
        self.emit("}")

    def _kernel(self, entry: Function) -> None:
        name = self.function_names[entry.name]
        apart = _is_large(entry) or leaves_early(entry)
        inner = self.globals.take(f"{name}_packet") if apart else ""
        self.prologue.packet()
        if apart:
            self.is_inner = True
            self._function(entry, inner)
            self.is_inner = False
        self.begin(entry)
        read = [i for i in entry.inputs if isinstance(i, Value) and self.layout.uses[i.id]]
        self.inputs = tuple(at for at, i in enumerate(entry.inputs) if i in read)
        inputs = [(self.inputs[k], i, self.names.take(f"{i.name or 'a'}_in")) for k, i in enumerate(read)]
        steps = [self.names.take(f"{i.name or 'a'}_step") for i in read]
        outputs = [self.names.take(f"{o.name or 'result'}_out") for o in self.ports.outputs]
        self.emit("")
        self._packet_signature(name, entry, inputs, steps, outputs)
        with self.block(scope=False):
            self._packet_prelude(entry, apart)
            for (at, value, array), step in zip(inputs, steps, strict=True):
                type = self.ports.inputs[at].type
                function = self.prologue.memory("read", type.base, type.size)
                self.bind(value, Expr(f"{function}({array}, {step}, {self.packet})"))
            if apart:
                self._call_packet(entry, inner)
            else:
                self.body(entry, returns=False)
            self._write_outputs(entry, outputs)
        self.emit("}")

    def _packet_signature(
        self,
        name: str,
        entry: Function,
        inputs: list[tuple[int, Value, str]],
        steps: list[str],
        outputs: list[str],
    ) -> None:
        parameters = [f"ulong {self.count}", f"int {self.first}", *([] if self.listed else [f"int {self.row}"])]
        if self.needs[entry.name].grid:
            parameters.append(f"{spelled(vec(Base.I, self.grid_rank))} {self.grid_names['grid_shape']}")
        for (at, _, array), step in zip(inputs, steps, strict=True):
            parameters += [f"{self._array_of(self.ports.inputs[at].type, 'const ')}{array}", f"int {step}"]
        own = {*(name for _, name in self.place), *self.grid_names.values()}
        parameters += [text for text, handed in self._handed(entry) if handed not in own]
        parameters += [f"{self._array_of(o.type)}{n}" for o, n in zip(self.ports.outputs, outputs, strict=True)]
        self._head(f"__kernel void {name}", parameters, entry.loc)

    def _array_of(self, type: Type, qualifier: str = "") -> str:
        """Inputs and outputs are arrays of numbers."""
        return self.pointer(type.scalar, qualifier)

    def body(self, function: Function, *, returns: bool) -> None:
        """The entry's own function makes its packet again: a struct of vectors that is handed over waits for memory."""
        if self.is_inner:
            self._make_packet()
            self._find_place(function)
        super().body(function, returns=returns)

    def _packet_prelude(self, entry: Function, apart: bool) -> None:
        if self.listed:
            self.emit(f"size_t {self.corner} = ((size_t){self.first} + get_global_id(0)) * {self.lanes};")
        else:
            self.emit(f"int2 {self.corner} = sh_corner({self.first}, {self.row});")
        self._make_packet()
        self.emit(f"if ({self.packet}.{'left == 0' if self.listed else 'empty'}) {{")
        with self.block():
            self.emit("return;")
        self.emit("}")
        if not apart:
            self._find_place(entry)

    def _make_packet(self) -> None:
        place = ", ".join(name for _, name in self.place)
        self.emit(f"sh_packet {self.packet} = sh_packet_at({place});")

    def _find_place(self, entry: Function) -> None:
        if "grid_index" in self.needs[entry.name].grid:
            declaration = self.declaration(self._index_type(), self.grid_names["grid_index"])
            self.emit(f"{declaration} = {self._grid_of_lanes()};")

    def _grid_of_lanes(self) -> str:
        """The lanes' index along each axis; an image's rows are numbered through all its planes."""
        x, y = f"{self.packet}.x", f"{self.packet}.y"
        if self.grid_rank == 1:
            return f"{x} + {y} * {self.row}"
        shape = self.grid_names["grid_shape"]
        axes = [x]
        for axis in "xyzw"[1 : self.grid_rank - 1][::-1]:
            axes.append(f"{y} % {shape}.{axis}")
            y = f"{y} / {shape}.{axis}"
        return f"({spelled_wide(self._index_type())}){{{', '.join([y, *reversed(axes)])}}}"

    def _call_packet(self, entry: Function, inner: str) -> None:
        args = [self.exprs[i.id].text if i.id in self.exprs else self._nothing(i.type) for i in entry.inputs]
        if len(entry.outputs) == 1:
            made = Expr(f"{inner}({', '.join([*args, *self.context(entry)])})")
            self.emit(f"{self.declaration(entry.outputs[0].type, self.slot(entry.outputs[0]))} = {made.text};")
            return
        for o in entry.outputs:
            self.emit(f"{self.declaration(o.type, self.slot(o))};")
            args.append(f"&{self.slots[o.id].text}")
        self.emit(f"{inner}({', '.join([*args, *self.context(entry)])});")

    def _nothing(self, type: Type) -> str:
        """An input that is not used."""
        number = f"({spelled_wide(lanes_of(type.base, self.lanes))})(0)"
        return number if isinstance(type, Lanes) else f"({self.type_name(type)}){{{number}}}"

    def _write_outputs(self, entry: Function, arrays: list[str]) -> None:
        parts = iter(entry.outputs)
        for output, array in zip(self.ports.outputs, arrays, strict=True):
            type = output.type
            numbers = [self._wide(next(parts)) for _ in range(type.size)]
            value = numbers[0]
            if type.size > 1:
                value = self.construct(rows_of(type.base, type.size, self.lanes), numbers, [])
            write = self.prologue.memory("write", type.base, type.size)
            self.emit(f"{write}({array}, {value.text}, {self.packet});")

    def _wide(self, variable: Variable) -> Expr:
        """An output, for each lane."""
        e, type = self.slots[variable.id], variable.type
        return e if isinstance(type, Lanes) else self.construct(lanes_of(type.base, self.lanes), [e], [type])
