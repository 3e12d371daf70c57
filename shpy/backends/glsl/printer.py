"""The GLSL printer: a prepared module as the text of a fragment shader, version 3.30 core.

Stage: emit. Takes a module after `pipeline.prepare`, gives a `Shader`: the text and the names in it. The entry is a
function like any other; `main` fetches its arguments from textures and writes its results to the framebuffer.

    precise float y = 2.0 * x;  // wave.py:7
"""

from __future__ import annotations

import re
from typing import Final

from shpy.backends import expressions as ex
from shpy.backends.expressions import Expr, Level
from shpy.backends.glsl.device.textures import FOLD
from shpy.backends.glsl.exactness import precise_conditions, precise_operands
from shpy.backends.glsl.nesting import sheltered_functions
from shpy.backends.glsl.prologue import spelled
from shpy.backends.glsl.shader import (
    FIRST,
    GRID_SHAPE,
    LAST,
    NOTHING,
    RUNNING,
    WIDTH,
    InputTexture,
    Shader,
    TableTexture,
)
from shpy.backends.glsl.spelling import Spelling
from shpy.backends.statements import text_of
from shpy.ir.nodes import Function, Loop, Module, Status, Table, Value, Variable
from shpy.ir.types import Base, Type, vec

_HEAD: Final = """\
#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif
"""

_ZERO: Final = "float(min(int(gl_FragCoord.x), 0))"
"""A zero that no driver knows: one may look at the value of a uniform that a loop's condition reads."""

_FOLD_BITS: Final = FOLD.bit_length() - 1
_SAMPLERS: Final = {Base.F: "sampler2D", Base.I: "isampler2D", Base.U: "usampler2D", Base.B: "usampler2D"}


class Printer(Spelling):
    """Prints one module as one shader."""

    def __init__(
        self,
        module: Module,
        *,
        flagged: bool = False,
        limited: bool = True,
        exact: bool = True,
        precise: bool = True,
        fuses: bool = False,
        stores_apart: bool = True,
        rejects: bool = False,
    ) -> None:
        """Begin a shader.

        `flagged` says that loops tell whether they finished, for the device may stop them of its own accord,
        `limited` that loops without a known bound have a limit of ours, `exact` that operations keep their order,
        `precise` that the device has the qualifier, `fuses` that its own `fma` rounds once, `stores_apart` that a
        store at a varying index reaches the element of each fragment. With `rejects`, the only output, a bool, becomes
        a depth: the depth test then keeps elements from running for which it is true, and their status is DISCARDED.
        """
        super().__init__(module, exact=exact, precise=precise, fuses=fuses, stores_apart=stores_apart)
        self.flagged = flagged
        self.limited = limited
        self.rejects = rejects
        self.sheltered = sheltered_functions(module)
        self.guarded = False
        self.tables: dict[str, TableTexture] = {}
        self.reader_names: dict[str, str] = {}
        self.readers: dict[str, str] = {}
        self.grids: dict[int, str] = {}

    # The shader

    def shader(self) -> Shader:
        """The whole text, with the names that the runtime needs."""
        for param in self.module.params:
            self.params[param.name] = ex.name(self.globals.take(param.name))
        for table in self.module.tables:
            self._name_table(table)
        for function in self.module.functions:
            self.function_names[function.name] = self.globals.take(function.name)
        functions = [self._function(f) for f in self.module.functions]
        inputs, declarations, main = self._main()
        body = "\n".join([*self.readers.values(), *self.grids.values(), *functions, main])
        interface = "".join(f"{line}\n" for line in [*self._uniforms(body, self.prologue.text()), *declarations])
        prologue = f"{text}\n" if (text := self.prologue.text()) else ""
        return Shader(
            "\n".join(part for part in (_HEAD, interface, prologue, body) if part),
            tuple(inputs),
            {p.name: (self.params[p.name].text, p.type) for p in self.module.params},
            tuple(self.tables.values()),
            tuple(o.type for o in self.module.entry.outputs),
        )

    def _uniforms(self, text: str, prologue: str) -> list[str]:
        """The declarations of params, of tables, and of what the runtime sets where the text needs it."""
        text += prologue
        lines = [f"uniform {spelled(p.type)} {self.params[p.name].text};" for p in self.module.params]
        for table in self.module.tables:
            names = self.tables[table.name]
            lines.append(f"uniform {_SAMPLERS[table.type.base]} {names.sampler};")
            lines.append(f"uniform {spelled(vec(Base.I, table.rank))} {names.shape};")
        ours = {
            self.zero_name: f"float {self.zero_name} = {_ZERO};  // 0.0, but the driver must not know",
            NOTHING: f"uint {NOTHING} = uint(min(int(gl_FragCoord.x), 0));  // 0u, but the driver must not know",
            RUNNING: f"uniform bool {RUNNING};  // true, but the driver must not know",
            LAST: f"uniform ivec2 {LAST};",
            FIRST: f"uniform int {FIRST};",
            WIDTH: f"uniform int {WIDTH};",
            GRID_SHAPE: f"uniform ivec4 {GRID_SHAPE};",
        }
        return lines + [line for name, line in ours.items() if re.search(rf"\b{name}\b", text)]

    def _name_table(self, table: Table) -> None:
        sampler = self.globals.take(table.name)
        shape = self.globals.take(f"{table.name}_shape")
        self.tables[table.name] = TableTexture(table.name, table.type, sampler, shape)
        self.reader_names[table.name] = self.globals.take(f"{table.name}_at")

    def _reader(self, table: Table) -> str:
        """The function that reads a table: its texels are the elements in C order, folded."""
        names = self.tables[table.name]
        index = spelled(vec(Base.I, table.rank))
        n, at = names.shape, "at"
        flat = {
            1: at,
            2: f"{at}.x * {n}.y + {at}.y",
            3: f"({at}.x * {n}.y + {at}.y) * {n}.z + {at}.z",
        }[table.rank]
        texel = fetched(f"texelFetch({names.sampler}, ivec2(i & {FOLD - 1}, i >> {_FOLD_BITS}), 0)", table.type)
        return (
            f"// An element of {names.sampler}, the nearest where the index is out of range.\n"
            f"{spelled(table.type)} {self.reader_names[table.name]}({index} at) {{\n"
            f"    at = clamp(at, {index}(0), {n} - 1);\n"
            f"    int i = {flat};\n"
            f"    return {texel};\n"
            "}\n"
        )

    def _grid(self, size: int) -> str:
        """The function that gives an element's index along `size` axes."""
        n = GRID_SHAPE
        rows = {
            1: "    return i;\n",
            2: f"    return sh_split(i, {n}.y);\n",
            3: f"    ivec2 z = sh_split(i, {n}.z);\n    return ivec3(sh_split(z.x, {n}.y), z.y);\n",
            4: (
                f"    ivec2 w = sh_split(i, {n}.w), z = sh_split(w.x, {n}.z);\n"
                f"    return ivec4(sh_split(z.x, {n}.y), z.y, w.y);\n"
            ),
        }[size]
        if size > 1:
            self.prologue.use("sh_split", (vec(Base.I), vec(Base.I)))
        return (
            f"{spelled(vec(Base.I, size))} sh_grid_index{size}() {{\n"
            f"    ivec2 at = min(ivec2(gl_FragCoord.xy), {LAST});\n"
            f"    int i = {FIRST} + at.y * {WIDTH} + at.x;\n"
            f"{rows}"
            "}\n"
        )

    def _main(self) -> tuple[list[InputTexture], list[str], str]:
        """The textures of the inputs, the declarations of inputs and outputs, and `main`."""
        entry = self.module.entry
        names = self.globals.scope()
        inputs, declarations, args = [], [], []
        at = names.take("at")
        for index, (port, value) in enumerate(zip(self.module.inputs, entry.inputs, strict=True)):
            sampler, each = names.take(f"in_{port.name}"), names.take(f"each_{port.name}")
            inputs.append(InputTexture(index, value.type, sampler, each))
            declarations.append(f"uniform {_SAMPLERS[value.type.base]} {sampler};")
            declarations.append(f"uniform int {each};  // 0 where one value serves all elements")
            args.append(fetched(f"texelFetch({sampler}, {at} * {each}, 0)", value.type))
        body = [f"ivec2 {at} = min(ivec2(gl_FragCoord.xy), {LAST});"] if args else []
        called = self.function_names[entry.name]
        if self.rejects:
            status, rejected = names.take("out_status"), ex.call(called, *map(Expr, args)).text
            declarations.append(f"layout(location = 0) out int {status};")
            body += [f"{status} = {Status.DISCARDED};", f"gl_FragDepth = {rejected} ? 0.0 : 1.0;"]
            return inputs, declarations, _main_of(body)
        ports = [p.name for p in self.module.outputs] + ["status"]
        targets = [names.take(f"out_{p}") for p, _ in zip(ports, entry.outputs, strict=False)]
        for location, (target, output) in enumerate(zip(targets, entry.outputs, strict=True)):
            declarations.append(f"layout(location = {location}) out {spelled(_texel(output.type))} {target};")
        if len(targets) == 1:
            made = ex.call(called, *map(Expr, args))
            body.append(f"{targets[0]} = {_as_texel(made.text, entry.outputs[0].type)};")
        else:
            results = [names.take(o.name) for o in entry.outputs]
            body += [f"{self.declaration(o.type, r)};" for o, r in zip(entry.outputs, results, strict=True)]
            body.append(f"{called}({', '.join([*args, *results])});")
            body += [f"{t} = {_as_texel(r, o.type)};" for t, r, o in zip(targets, results, entry.outputs, strict=True)]
        return inputs, declarations, _main_of(body)

    # Functions

    def begin(self, function: Function) -> None:
        """Plan the function; conditions on floats, and what else would lose its order, are named."""
        super().begin(function)
        if self.exact:
            self.layout.inlined -= precise_conditions(function, self.callees)
            self.layout.inlined -= precise_operands(function, self.layout.inlined, self.callees)

    def _function(self, function: Function) -> str:
        self.begin(function)
        self.lines = []
        takes = []
        for port in function.inputs:
            if isinstance(port, Value):
                name = self.names.take(port.name, "x")
                self.exprs[port.id] = ex.name(name)
                takes.append(self.declaration(port.type, name))
            else:
                takes.append(f"{self.declaration(port.type, self.slot(port), 'inout ')}{_extent(port)}")
        alone = len(function.outputs) == 1
        if not alone:
            takes += [self.declaration(o.type, self.slot(o), "out ") for o in function.outputs]
        result = spelled(function.outputs[0].type) if alone else "void"
        self.emit(f"{result} {self.function_names[function.name]}({', '.join(takes)}) {{", function.loc)
        with self.block(scope=False):
            for output in () if alone else function.outputs:
                place = self.layout.places.get(output.id)
                if place is None or place.zero:
                    self.emit(f"{self.slots[output.id].text} = {self.zero(output.type).text};")
            self.body(function, returns=alone)
        self.emit("}")
        return text_of(self.lines)

    def body(self, function: Function, *, returns: bool) -> None:
        """The statements; what is returned is a variable, for `precise` belongs to variables."""
        if function.name not in self.sheltered:
            self._statements(function, returns=returns)
            return
        self.emit(f"while ({RUNNING}) {{  // one iteration: so that returns do not nest what follows them")
        with self.block():
            self._statements(function, returns=returns, condition=RUNNING)
        self.emit("}")
        if returns:
            self.emit(f"return {self.zero(function.outputs[0].type).text};")

    def _statements(self, function: Function, *, returns: bool, condition: str | None = None) -> None:
        """The statements, and at the end a return where one is needed; under a condition that always holds."""
        if self.region(function.body, 0):
            return
        for variable in self.layout.declared.get((0, len(function.body)), []):
            if variable not in self.slots:
                self.declare_zero(self.variables[variable])
        if condition is not None:
            self.emit(f"if ({condition}) {{")
            with self.block():
                self.emit(self.leave(function))
            self.emit("}")
        elif returns:
            self.emit(self.leave(function))

    def loop(self, s: Loop, inner: tuple[int, ...]) -> None:
        """Print a loop, with a guard if the device may stop it before it stores that it finished.

        A limit is a second end, so a loop that has one needs no guard.
        """
        outer = self.guarded
        self.guarded = self.flagged and s.turns != 1 and not (self.limited and s.turns is None)
        super().loop(s, inner)
        self.guarded = outer

    def test(self, condition: Expr | None) -> Expr | None:
        """Add the guard: an end of the loop that the compiler cannot rule out.

        Without it the compiler concludes that what follows the loop is reached through `ended = true` alone.
        """
        if not self.guarded:
            return condition
        guard = Expr(RUNNING)
        return guard if condition is None else ex.infix("&&", Level.AND, condition, guard)

    # Tables and the grid

    def table(self, name: str, type: Type, index: Expr) -> Expr:
        """`heights_at(i)`."""
        if name not in self.readers:
            self.readers[name] = self._reader(next(t for t in self.module.tables if t.name == name))
        return ex.call(self.reader_names[name], index)

    def table_size(self, name: str) -> Expr:
        """The uniform of a table's shape."""
        return Expr(self.tables[name].shape)

    def grid(self, op: str, type: Type) -> Expr:
        """`sh_grid_index2()`, `sh_grid_shape.xy`."""
        if op == "grid_shape":
            return Expr(f"{GRID_SHAPE}.{'xyzw'[: type.size]}")
        self.grids.setdefault(type.size, self._grid(type.size))
        return Expr(f"sh_grid_index{type.size}()", Level.POSTFIX)


def _main_of(body: list[str]) -> str:
    return "void main() {\n" + "".join(f"    {line}\n" for line in body) + "}\n"


def fetched(texel: str, type: Type) -> str:
    """What `type` a texel holds."""
    picked = f"{texel}.{'xyzw'[: type.size]}"
    if not type.is_bool:
        return picked if type.size < 4 else texel
    return f"{picked} != 0u" if type.size == 1 else f"notEqual({picked}, uvec{type.size}(0u))"


def _texel(type: Type) -> Type:
    return type.based(Base.U) if type.is_bool else type


def _as_texel(text: str, type: Type) -> str:
    return f"{spelled(_texel(type))}({text})" if type.is_bool else text


def _extent(variable: Variable) -> str:
    return "" if variable.length is None else f"[{variable.length}]"
