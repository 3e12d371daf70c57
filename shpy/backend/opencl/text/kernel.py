"""The OpenCL C kernel of a prepared module, one element per work item.

Stage: emit. OpenCL C has no global variables, so the kernel passes tables, params and the grid to the functions that
need them. An entry that returns early becomes a function that the kernel calls.

    print_kernel(prepared.module).text
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

from shpy.backend.emit import tree
from shpy.backend.emit.spell_c import Line, text_of
from shpy.backend.emit.structure import Body
from shpy.backend.emit.survey import is_whole
from shpy.backend.emit.tree import (
    BOOL,
    INT,
    UINT,
    AnyType,
    Block,
    Cast,
    Declare,
    Exit,
    Expr,
    Name,
    Own,
    Parameter,
    Pointer,
    number,
)
from shpy.backend.opencl.text.operations import INDEX, SHAPE, ClOperations, ClUnit, hides_zeros
from shpy.backend.opencl.text.prologue import NOINLINE
from shpy.backend.opencl.text.spell_cl import ClSpeller, element_type
from shpy.ir.nodes import Function, Let, Loc, Module, Return, Store, Table, Value, Variable
from shpy.ir.traverse import bases_of, changed_variables, defined, walk
from shpy.ir.types import Base, Type
from shpy.passes.hide import hide_derivable
from shpy.passes.modes import REPRODUCIBLE, Math
from shpy.passes.private import NONE, Private, bytes_of, private_memory
from shpy.passes.size import not_inlined

ULONG: Final = Own("ulong")
SIZE: Final = Own("size_t")


@dataclass(frozen=True, slots=True)
class KernelText:
    """The text of a kernel, its name, the source line of each line, and whether it needs doubles.

    The kernel's arguments are, in this order: the number of elements and the first element of this dispatch (ulong);
    the grid's shape if `grid` (its rank) is not 0; a pointer and a step for each of `inputs` (positions among those of
    the entry; the step is 1, or 0 for a uniform input); a pointer and a shape for each of `tables`; each of `params`;
    a pointer for each output. A packet has `lanes` elements, `columns` of them side by side. A kernel of packets takes,
    after the number of elements, the first packet (or line of packets) of this dispatch and, unless it is `listed`, the
    length of a row (ints). Its tables of three components are padded to four. A work item computes one packet, or if
    `packets` is more, as many as a row has, at most `packets`; then the dispatch begins with a work item.
    """

    text: str
    name: str
    lines: tuple[Loc | None, ...]
    doubles: bool
    grid: int
    inputs: tuple[int, ...]
    tables: tuple[Table, ...]
    params: tuple[str, ...]
    lanes: int = 1
    columns: int = 1
    listed: bool = False
    packets: int = 1
    private: Private = NONE
    """The local arrays of a work item."""


def print_kernel(
    module: Module, math: Math = "strict", *, elementwise: bool = False, faults: Collection[str] = ()
) -> KernelText:
    """Return the kernel of a prepared module; raise CompileError for an operation that OpenCL C cannot express.

    `elementwise` tells whether the compiler has the functions of ELEMENTWISE; `faults` are its faults, of FAULTS.
    """
    whole = hide_derivable(module) if hides_zeros(math, faults) else module
    return KernelMaker(whole, math, elementwise=elementwise, faults=faults).kernel()


class KernelMaker(ClUnit):
    """The emitter of one module's kernel."""

    operations: ClassVar[type[ClOperations]] = ClOperations
    work: ClassVar[str] = "element"

    def __init__(self, module: Module, math: Math, *, elementwise: bool = False, faults: Collection[str] = ()) -> None:
        super().__init__(module, math, elementwise=elementwise, faults=faults)
        self.not_inlined = not_inlined(module)
        self.outer = module.entry
        """The entry with its inputs and outputs as they are in memory."""
        self.dispatch = [Parameter(ULONG, self.count.text), Parameter(ULONG, self.first.text)]
        self.place: dict[Name, AnyType] = {}
        """The arguments that pass the place in the grid to the entry's own function, with their parameters' types."""
        self.speller, self.doubles = self.own_speller(), Base.D in bases_of(module)

    # Methods that a kernel of packets overrides

    def declared(self) -> Sequence[str]:
        """Return the lines that declare the types that the text uses and OpenCL C lacks."""
        return ()

    def qualifiers(self, function: Function) -> tuple[str, ...]:
        """Return what stands before a function: whether the compiler must inline it, or must not."""
        return (NOINLINE,) if function.name in self.not_inlined else ()

    # The text

    def kernel(self) -> KernelText:
        """Emit all functions and return the kernel."""
        self.add_functions()
        entry = self.module.entry
        return self.finished(self.add_kernel(entry, self.functions[entry.name]))

    def kernels_around(self, text: Callable[[str], str]) -> KernelText:
        """Return kernels that call the entry as a function; `text` returns their source for its name."""
        entry = self.module.entry
        self.place = {}
        self.add_functions()
        self.begin_kernel()
        inner = self.globals.take(f"{self.functions[entry.name]}_pairs")
        self.add(entry, inner)
        self.speller.paragraph(text(inner))
        return self.finished(())

    def add_functions(self) -> None:
        """Add all functions but the entry."""
        for function in self.module.functions[:-1]:
            self.add(function, self.functions[function.name])

    def finished(self, inputs: tuple[int, ...]) -> KernelText:
        """Return the kernel with all text that was added; `inputs` are the positions of the inputs that it reads."""
        entry = self.module.entry
        doubles, prologue, needs = self.doubles, self.prologue.text(), self.needs[entry.name]
        head = [f"#pragma OPENCL FP_CONTRACT {'OFF' if self.math in REPRODUCIBLE else 'ON'}"]
        head += ["#pragma OPENCL EXTENSION cl_khr_fp64 : enable"] if doubles else []
        lines: list[Line] = [(text, None) for text in [*head, *self.declared(), "", *prologue.splitlines()]]
        lines += self.speller.lines if prologue else self.speller.lines[1:]
        return KernelText(
            text_of(lines),
            self.functions[entry.name],
            tuple([loc for _, loc in lines]),
            doubles,
            self.grid_rank if self.grid_of(entry.name) else 0,
            inputs,
            tuple(t for t in self.module.tables if ("table", t.name) in needs),
            tuple(p for p in self.params if ("param", p) in needs),
            private=private_memory(self.module, self.private_bytes),
        )

    def private_bytes(self, array: Variable) -> int:
        """Return the bytes of a local array of a work item."""
        return bytes_of(array)

    # The extra arguments of functions

    def declares(self, e: Name) -> Parameter:
        """Return the parameter for an extra argument; a bool is passed as an int."""
        if e in self.table_names.values():
            return Parameter(self.array(e.type, "const "), e.text)
        return Parameter(e.type.based(Base.I) if e.type.is_bool else e.type, e.text)

    def array(self, type: Type, qualifier: str = "") -> Pointer:
        """Return the type of an array in memory."""
        return Pointer(element_type(type), f"__global {qualifier}")

    # Functions

    def add(self, function: Function, name: str) -> None:
        """Add a function to the text."""
        body, single = Body(self.operations(self, function)), len(function.outputs) == 1
        parameters = self.ports(body, (*function.inputs, *(() if single else function.outputs)))
        parameters += [self.declares(e) for e in self.handed(function.name)]
        body.begin(returns=True)
        body.out += self.prelude(function.name)
        body.statements()
        result = function.outputs[0].type if single else None
        block = tuple(body.out)
        self.speller.function(
            tree.Function(name, result, tuple(parameters), block, function.loc, self.qualifiers(function))
        )

    def printed(self, function: Function, name: str) -> str:
        """Return the text of a function that the prologue is to have."""
        outer, self.speller = self.speller, self.own_speller()
        self.doubles |= any(v.type.base is Base.D for v in defined(function))
        self.add(function, name)
        text = "\n".join([line for line, _ in self.speller.lines[1:]])
        self.speller = outer
        return text

    def own_speller(self) -> ClSpeller:
        """Return a speller of functions."""
        return ClSpeller()

    def prelude(self, function: str) -> Block:
        """Return the first statements of a function."""
        return ()

    def ports(self, body: Body, ports: Sequence[Value | Variable]) -> list[Parameter]:
        """Name the parameters of a function and return them; variables are passed by pointer."""
        parameters = []
        for port in ports:
            name = Name(port.type, body.scope.take(port.name, "a" if isinstance(port, Value) else "v"))
            if isinstance(port, Value):
                body.exprs[port.id] = name
            else:
                body.slots[port.id] = name if port.length is not None else tree.prefix("*", name)
            parameters.append(Parameter(port.type if isinstance(port, Value) else Pointer(port.type), name.text))
        return parameters

    # The kernel

    def add_kernel(self, entry: Function, name: str) -> tuple[int, ...]:
        """Add the kernel itself; return the positions of the inputs that it reads."""
        inner = self.globals.take(f"{name}_{self.work}") if self.has_function(entry) else ""
        self.begin_kernel()
        if inner:
            self.add(entry, inner)
        operations = self.operations(self, entry)
        body = Body(operations, () if inner else self.direct(entry))
        body.begin(returns=False)
        uses, take, outer = body.survey.uses, body.scope.take, self.outer
        read = [(at, i) for at, i in enumerate(entry.inputs) if isinstance(i, Value) and uses[i.id]]
        arrays = [Name(i.type, take(f"{i.name or 'a'}_in")) for _, i in read]
        steps = [Name(INT, take(f"{i.name or 'a'}_step")) for _, i in read]
        self.arrays = {o.id: Name(o.type, take(f"{o.name or 'result'}_out")) for o in outer.outputs}
        parameters = [*self.dispatch, *([self.declares(self.grid[SHAPE])] if self.grid_of(entry.name) else [])]
        for (at, _), array, step in zip(read, arrays, steps, strict=True):
            parameters.append(Parameter(self.array(self.stored(outer.inputs[at].type), "const "), array.text))
            parameters.append(Parameter(INT, step.text))
        place_names = {*self.place, *self.grid.values()}
        parameters += [self.declares(e) for e in self.handed(entry.name) if e not in place_names]
        parameters += [Parameter(self.array(self.stored(o.type)), self.arrays[o.id].text) for o in outer.outputs]
        body.out += self.find_element(has_function=bool(inner))
        for (at, i), array, step in zip(read, arrays, steps, strict=True):
            body.bind(i.id, self.fetched(operations, array, step, outer.inputs[at].type))
        if inner:
            self.call_entry(body, operations, inner)
        else:
            body.statements()
        self.write_outputs(body, operations)
        self.add_kernel_function(
            tree.Function(name, None, tuple(parameters), tuple(body.out), entry.loc, ("__kernel",))
        )
        return tuple(at for at, _ in read)

    def add_kernel_function(self, kernel: tree.Function) -> None:
        """Add the function that the host calls."""
        self.speller.function(kernel)

    def call_entry(self, body: Body, operations: ClOperations, inner: str) -> None:
        """Emit the call of the entry's function, and bind its results to the slots of the outputs."""
        inputs, outputs = body.function.inputs, body.function.outputs
        args = [body.exprs[i.id] if i.id in body.exprs else self.nothing(operations, i.type) for i in inputs]
        handed = self.handed(body.function.name)
        if len(outputs) == 1:
            body.slots[outputs[0].id] = tree.call(inner, outputs[0].type, *args, *handed)
            return
        body.out += [Declare(o.type, body.slot(o)) for o in outputs]
        results = [tree.prefix("&", body.slots[o.id]) for o in outputs]
        body.out.append(tree.Do(tree.call(inner, BOOL, *args, *results, *handed)))

    # The statements of a work item

    def has_function(self, entry: Function) -> bool:
        """Return whether the entry is a function that the kernel calls: a Return stands before its end."""
        return any(isinstance(s, Return) for s in walk(entry.body) if s is not entry.body[-1])

    def direct(self, entry: Function) -> Collection[int]:
        """Return the outputs that the kernel writes to memory at their Store instead of at its end.

        They are stored once, at the top of the body, and touched by nothing else.
        """
        touched: Counter[int] = Counter()
        for s in walk(entry.body):
            if isinstance(s, Let):
                if s.op == "load" and isinstance(s.attr, int):
                    touched[s.attr] += 1
            else:
                touched.update(changed_variables(s, self.callees))
        whole = {s.variable for s in entry.body if isinstance(s, Store) and is_whole(s)}
        return frozenset(o.id for o in entry.outputs if o.id in whole and touched[o.id] == 1)

    def begin_kernel(self) -> None:
        """Add the parts of the prologue that have to precede all functions."""

    def stored(self, type: Type) -> Type:
        """Return the type of an array that holds an input or output."""
        return type

    def nothing(self, operations: ClOperations, type: Type) -> Expr:
        """Return a zero as the argument for an input that is not used."""
        return operations.zero(type)

    def fetched(self, operations: ClOperations, array: Name, step: Name, type: Type) -> Expr:
        """Return the expression that reads this work item's element of an input."""
        return operations.read(array, tree.infix("*", self.element, step), type)

    def write_outputs(self, body: Body, operations: ClOperations) -> None:
        """Append the stores of the outputs that are not written yet."""
        left = [o for o in body.function.outputs if o.id not in body.direct]
        body.out += [operations.write(self.arrays[o.id], body.slots[o.id], o.type) for o in left]

    def find_element(self, *, has_function: bool) -> Block:
        """Return the statements that compute a work item's element and its index in the grid.

        `has_function` tells whether the entry is a function that the kernel calls.
        """
        element, index = self.element, self.grid[INDEX]
        start = tree.infix("+", self.first, tree.call("get_global_id", UINT, number(0)))
        outside = tree.If(tree.infix(">=", element, self.count, BOOL), (Exit("return"),))
        block: Block = (Declare(SIZE, element.text, start), outside)
        if (INDEX, "") not in self.needs[self.module.entry.name]:
            return block
        axes = tuple(self.split(element, self.grid_rank))
        indices: Expr = Cast(INT, element) if self.grid_rank == 1 else tree.Construct(index.type, axes)
        return (*block, Declare(index.type, index.text, indices))
