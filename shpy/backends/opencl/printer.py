"""The OpenCL C printer: a prepared module as one kernel, one element a work item.

Stage: emit. There are no globals in OpenCL C: tables, params and the grid are handed on to the functions that need
them. An entry that returns early is a function of its own, which the kernel calls.

    print_kernel(prepared.module).text
"""

from __future__ import annotations

from dataclasses import dataclass

from shpy.backends import expressions as ex
from shpy.backends.expressions import Expr, Level
from shpy.backends.layout import access_count
from shpy.backends.opencl.spelling import Spelling, as_bool
from shpy.backends.opencl.text.kernel import Kernel
from shpy.backends.opencl.text.prologue import NOINLINE, spelled
from shpy.backends.statements import Line, text_of
from shpy.ir.nodes import Call, Function, Let, Loc, Module, Return, Store, Table, Value, Variable
from shpy.ir.traverse import walk
from shpy.ir.types import Base, Type, vec
from shpy.passes.modes import Math
from shpy.passes.size import kept_apart

_INDEX, _SHAPE = "grid_index", "grid_shape"
_WIDTH = 110


@dataclass(frozen=True, slots=True)
class Needs:
    """What a function and those that it calls read that is not theirs, each in the module's order."""

    tables: frozenset[str] = frozenset()
    params: frozenset[str] = frozenset()
    grid: frozenset[str] = frozenset()

    def __or__(self, other: Needs) -> Needs:
        return Needs(self.tables | other.tables, self.params | other.params, self.grid | other.grid)


class OpenCLPrinter(Spelling):
    """Prints one module."""

    def __init__(
        self, module: Module, math: Math = "strict", *, elementwise: bool = False, hides_zeros: bool = False
    ) -> None:
        super().__init__(module, math)
        self.elementwise = elementwise
        self.hides_zeros = hides_zeros
        self.count = self.globals.take("count")
        self.first = self.globals.take("first")
        self.grid_names = {op: self.globals.take(op) for op in (_INDEX, _SHAPE)}
        self.function_names = {f.name: self.globals.take(f.name, "f") for f in module.functions}
        self.table_names = {t.name: self.globals.take(t.name, "table") for t in module.tables}
        self.size_names = {t: self.globals.take(f"{name}_size") for t, name in self.table_names.items()}
        self.param_types = {p.name: p.type for p in module.params}
        self.param_names = {p.name: self.globals.take(p.name, "param") for p in module.params}
        self.params = {p.name: self._param(p.type, self.param_names[p.name]) for p in module.params}
        self.needs: dict[str, Needs] = {}
        self.inputs: tuple[int, ...] = ()
        self.arrays: dict[int, str] = {}
        self.apart = kept_apart(module)
        for function in module.functions:
            self.needs[function.name] = self._needs(function)

    def print(self) -> Kernel:
        """The whole text."""
        for function in self.module.functions[:-1]:
            self._function(function, self.function_names[function.name])
        self._kernel(self.module.entry)
        head = [f"#pragma OPENCL FP_CONTRACT {'OFF' if self.math == 'strict' else 'ON'}"]
        if self.doubles:
            head.append("#pragma OPENCL EXTENSION cl_khr_fp64 : enable")
        head += self.declared()
        lines: list[Line] = [(text, None) for text in [*head, "", *self.prologue.text().splitlines()]]
        lines += self.lines if self.prologue.text() else self.lines[1:]
        entry = self.needs[self.module.entry.name]
        return Kernel(
            text_of(lines),
            self.function_names[self.module.entry.name],
            tuple(loc for _, loc in lines),
            self.doubles,
            self.grid_rank if entry.grid else 0,
            self.inputs,
            tuple(t for t in self.module.tables if t.name in entry.tables),
            tuple(p for p in self.params if p in entry.params),
        )

    def declared(self) -> list[str]:
        """Lines that declare types which the text uses and OpenCL C does not have."""
        return []

    # What a function needs besides its arguments

    def _needs(self, function: Function) -> Needs:
        found = Needs()
        for s in walk(function.body):
            match s:
                case Let(_, "table" | "table_size" | "neighbour", _, str(name)):
                    found |= Needs(tables=frozenset({name}))
                case Let(_, "param", _, str(name)):
                    found |= Needs(params=frozenset({name}))
                case Let(value, "grid_index" | "grid_shape" as op):
                    found |= Needs(grid=frozenset({op}))
                    self.grid_rank = value.type.size
                case Let(_, "call", _, str(name)) | Call(name):
                    found |= self.needs[name]
        return found

    def _handed(self, function: Function) -> list[tuple[str, str]]:
        """The declarations and names of what is handed on to a function."""
        needs = self.needs[function.name]
        grid = vec(Base.I, max(self.grid_rank, 1))
        pairs = [(f"{spelled(grid)} {self.grid_names[op]}", self.grid_names[op]) for op in sorted(needs.grid)]
        for table in self.module.tables:
            if table.name in needs.tables:
                pairs += self._table_arguments(table)
        for name, type in self.param_types.items():
            if name in needs.params:
                pairs.append((self._param_argument(name, type), self.param_names[name]))
        return pairs

    def _table_arguments(self, table: Table) -> list[tuple[str, str]]:
        name, size = self.table_names[table.name], self.size_names[table.name]
        shape = spelled(vec(Base.I, table.rank))
        return [(f"{self.pointer(table.type, 'const ')}{name}", name), (f"{shape} {size}", size)]

    def _param_argument(self, name: str, type: Type) -> str:
        held = vec(Base.I, type.size) if type.is_bool else type
        return f"{self.type_name(held)} {self.param_names[name]}"

    @staticmethod
    def _param(type: Type, name: str) -> Expr:
        e = ex.name(name)
        return as_bool(e) if type.is_bool and type.size == 1 else e

    def context(self, function: Function) -> list[str]:
        """What a call hands on."""
        return [name for _, name in self._handed(function)]

    # Functions and the kernel

    def leave(self, function: Function) -> str:
        """The result is returned if there is one; several are stored through pointers."""
        return super().leave(function) if self.returned is not None else "return;"

    def step(self, condition: Expr | None, statement: str) -> str:
        """`i += 1` cannot wrap where `i < n` holds."""
        counter, _, increment = statement.partition(" ")
        bounded = condition is not None and condition.text.startswith(f"{counter} < ") and increment == "+= 1u"
        signed = any(e.text == counter and self.variables[v].type.base is Base.I for v, e in self.slots.items())
        return f"{counter} += 1" if bounded and signed else statement

    def reference(self, variable: int) -> str:
        """`&x`; a parameter by reference, or an array, is a pointer already."""
        text = self.slots[variable].text
        if self.variables[variable].length is not None:
            return text
        return text[1:] if text.startswith("*") else f"&{text}"

    def out_argument(self, name: str) -> str:
        """`&x`."""
        return f"&{name}"

    def _function(self, function: Function, name: str) -> None:
        self.begin(function)
        prefix = f"{NOINLINE} " if self.stands_apart(function) else ""
        single = len(function.outputs) == 1
        declarations = [self._parameter(port) for port in function.inputs]
        if not single:
            declarations += [self._parameter(o) for o in function.outputs]
        declarations += [declaration for declaration, _ in self._handed(function)]
        self.emit("")
        result = self.type_name(function.outputs[0].type) if single else "void"
        self._head(f"{prefix}{result} {name}", declarations, function.loc)
        with self.block(scope=False):
            if not single:
                for output in (o for o in function.outputs if self.layout.places[o.id].zero):
                    self.emit(f"{self.slots[output.id].text} = {self.zero(output.type).text};")
            self.body(function, returns=single)
        self.emit("}")

    def stands_apart(self, function: Function) -> bool:
        """Return whether the compiler is told not to inline the function."""
        return function.name in self.apart

    def _parameter(self, port: Value | Variable) -> str:
        default = "a" if isinstance(port, Value) else "v"
        name = self.names.take(port.name, default)
        if isinstance(port, Value):
            self.exprs[port.id] = ex.name(name)
            return self.declaration(port.type, name)
        text = name if port.length is not None else f"*{name}"
        level = Level.ATOM if port.length is not None else Level.UNARY
        self.slots[port.id] = Expr(text, level, frozenset({text}))
        return self.declaration(port.type, f"*{name}")

    def _kernel(self, entry: Function) -> None:
        name = self.function_names[entry.name]
        early = leaves_early(entry)
        if early:
            inner = self.globals.take(f"{name}_element")
            self._function(entry, inner)
        self.begin(entry)
        read = [i for i in entry.inputs if isinstance(i, Value) and self.layout.uses[i.id]]
        self.inputs = tuple(at for at, i in enumerate(entry.inputs) if i in read)
        inputs = [(i, self.names.take(f"{i.name or 'a'}_in")) for i in read]
        steps = {i.id: self.names.take(f"{i.name or 'a'}_step") for i, _ in inputs}
        self.arrays = {o.id: self.names.take(f"{o.name or 'result'}_out") for o in entry.outputs}
        self.emit("")
        self._signature(name, entry, inputs, steps)
        with self.block(scope=False):
            self._prelude(entry)
            for value, array in inputs:
                index = Expr(f"{self.element} * {steps[value.id]}", Level.MUL)
                self.bind(value, self.read(Expr(array), index, value.type))
            if early:
                self._call_entry(entry, inner)
            else:
                self._inline_entry(entry)
        self.emit("}")

    def _signature(self, name: str, entry: Function, inputs: list[tuple[Value, str]], steps: dict[int, str]) -> None:
        needs = self.needs[entry.name]
        parameters = [f"ulong {self.count}", f"ulong {self.first}"]
        if needs.grid:
            parameters.append(f"{spelled(vec(Base.I, self.grid_rank))} {self.grid_names[_SHAPE]}")
        for value, array in inputs:
            parameters += [f"{self.pointer(value.type, 'const ')}{array}", f"int {steps[value.id]}"]
        grid = set(self.grid_names.values())
        parameters += [declaration for declaration, name in self._handed(entry) if name not in grid]
        parameters += [f"{self.pointer(o.type)}{self.arrays[o.id]}" for o in entry.outputs]
        self._head(f"__kernel void {name}", parameters, entry.loc)

    def _head(self, name: str, parameters: list[str], loc: Loc | None) -> None:
        """The head of a function, on one line if it fits."""
        line = f"{name}({', '.join(parameters)}) {{"
        if len(line) <= _WIDTH:
            self.emit(line, loc)
            return
        self.emit(f"{name}(", loc)
        for at, parameter in enumerate(parameters):
            self.emit(f"    {parameter}{',' if at + 1 < len(parameters) else ') {'}")

    def _prelude(self, entry: Function) -> None:
        self.emit(f"size_t {self.element} = {self.first} + get_global_id(0);")
        self.emit(f"if ({self.element} >= {self.count}) {{")
        with self.block():
            self.emit("return;")
        self.emit("}")
        if _INDEX in self.needs[entry.name].grid:
            self.emit(self._grid_index())

    def _grid_index(self) -> str:
        """The index along each axis: the last one runs fastest."""
        rank, shape = self.grid_rank, self.grid_names[_SHAPE]
        axes = []
        rest = self.element
        for axis in "xyzw"[1:rank][::-1]:
            axes.append(f"{rest} % {shape}.{axis}")
            rest = f"{rest} / {shape}.{axis}"
        axes.append(rest)
        type = spelled(vec(Base.I, rank))
        made = f"(int){self.element}" if rank == 1 else f"({type})({', '.join(reversed(axes))})"
        return f"{type} {self.grid_names[_INDEX]} = {made};"

    def _inline_entry(self, entry: Function) -> None:
        stored = [s.variable for s in entry.body if isinstance(s, Store) and s.components is None]
        self.direct = frozenset(
            o.id
            for o in entry.outputs
            if o.id in stored and access_count(entry.body, o.id, entry, self.callees) - self._returns(entry) == 1
        )
        self.body(entry, returns=False)
        for output in entry.outputs:
            if output.id not in self.direct:
                self.emit(self.write(self.arrays[output.id], self.slots[output.id], output.type))

    @staticmethod
    def _returns(entry: Function) -> int:
        return sum(isinstance(s, Return) for s in entry.body)

    def output(self, variable: Variable, e: Expr) -> str:
        """The element of the output's array."""
        return self.write(self.arrays[variable.id], e, variable.type)

    def _call_entry(self, entry: Function, inner: str) -> None:
        args = [self.exprs[i.id].text if i.id in self.exprs else self.zero(i.type).text for i in entry.inputs]
        if len(entry.outputs) == 1:
            made = Expr(f"{inner}({', '.join([*args, *self.context(entry)])})", Level.POSTFIX)
            self.emit(self.output(entry.outputs[0], made))
            return
        for o in entry.outputs:
            self.emit(f"{self.declaration(o.type, self.slot(o))};")
            args.append(f"&{self.slots[o.id].text}")
        self.emit(f"{inner}({', '.join([*args, *self.context(entry)])});")
        for o in entry.outputs:
            self.emit(self.write(self.arrays[o.id], self.slots[o.id], o.type))


def leaves_early(function: Function) -> bool:
    """Whether a Return stands anywhere but at the function's end."""
    return any(isinstance(s, Return) for s in walk(function.body) if s is not function.body[-1])
