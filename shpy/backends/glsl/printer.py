"""The GLSL printer: a prepared module as the text of a fragment shader, version 3.30 core.

Stage: emit. Takes a module after `pipeline.prepare`, gives a `Shader`: the text and the names in it. The entry is a
function like any other; `main` fetches its arguments from textures and writes its results to the framebuffer.

    precise float y = 2.0 * x;  // wave.py:7

`precise` keeps the order of operations and stops contraction. A literal zero would be folded all the same (`0.0 * x`
is 0 to Mesa, NaN or not), so zeros that take part in arithmetic are a uniform that is never set.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from shpy.backends import expressions as ex
from shpy.backends.clike import CLike
from shpy.backends.expressions import Expr, Level
from shpy.backends.glsl.exactness import precise_conditions
from shpy.backends.glsl.nesting import sheltered_functions
from shpy.backends.glsl.prologue import Prologue, spelled
from shpy.backends.glsl.shader import (
    FIRST,
    GRID_SHAPE,
    LAST,
    RUNNING,
    WIDTH,
    InputTexture,
    Shader,
    TableTexture,
)
from shpy.backends.glsl.textures import FOLD
from shpy.backends.naming import Target
from shpy.backends.operations import COMPARISONS
from shpy.backends.statements import text_of
from shpy.ir.nodes import Function, Let, Loop, Module, Table, Value, Variable
from shpy.ir.ops import TRANSCENDENTALS
from shpy.ir.types import Base, Type, vec

NATIVE: Final = frozenset({"clamp"})
"""Composite operations that are one call here, with exactly the table's meaning."""

GEOMETRIC: Final = frozenset({"dot", "length", "distance", "normalize", "cross", "reflect", "refract", "faceforward"})
FAST: Final = TRANSCENDENTALS | GEOMETRIC | {"rsqrt"}
"""Operations that are one call here, but GLSL says too little of how exact they are and of their edges."""

_HEAD: Final = """\
#version 330 core
#ifdef GL_ARB_gpu_shader5
#extension GL_ARB_gpu_shader5 : enable
#else
#define precise
#endif
"""

_FOLD_BITS: Final = FOLD.bit_length() - 1
_WRITTEN_OUT: Final = 16
_SAMPLERS: Final = {Base.F: "sampler2D", Base.I: "isampler2D", Base.U: "usampler2D", Base.B: "usampler2D"}

# The functions of GLSL that do what the table says; those of FAST come here in fast mode alone.
_OWN: Final[Mapping[str, str]] = {
    "abs": "abs",
    "floor": "floor",
    "ceil": "ceil",
    "round": "roundEven",
    "trunc": "trunc",
    "sqrt": "sqrt",
    "any": "any",
    "all": "all",
    "float_from_bits": "uintBitsToFloat",
    **{name: name for name in TRANSCENDENTALS | GEOMETRIC},
    "atan2": "atan",
    "rsqrt": "inversesqrt",
}
_OWN_OF_INTS: Final = frozenset({"min", "max", "clamp", "sign"})
_HELPERS: Final[Mapping[str, str]] = {"bits_from_float": "sh_bits"}
_OF_VECTORS: Final[Mapping[str, str]] = {
    "eq": "equal",
    "ne": "notEqual",
    "lt": "lessThan",
    "le": "lessThanEqual",
    "gt": "greaterThan",
    "ge": "greaterThanEqual",
}


_ONE = re.compile(r"-?1\.0|vec\d\([^()]*\b1\.0\b[^()]*\)")  # or a vector that has one


class Printer(CLike):
    """Prints one module as one shader."""

    target: Target = "glsl"
    inputs_are_variables = True

    def __init__(
        self,
        module: Module,
        *,
        loops_stop: bool = False,
        limited: bool = True,
        exact: bool = True,
    ) -> None:
        """What to mind: loops that the device stops of its own accord.

        `limited` says that loops without a known bound have a limit of ours, `exact` that operations keep their order.
        """
        super().__init__(module)
        self.loops_stop = loops_stop
        self.limited = limited
        self.exact = exact
        self.sheltered = sheltered_functions(module)
        self.guarded = False
        self.prologue = Prologue(exact=exact)
        self.tables: dict[str, TableTexture] = {}
        self.reader_names: dict[str, str] = {}
        self.readers: dict[str, str] = {}
        self.grids: dict[int, str] = {}
        self.globals.reserve("main")
        self.zero_name = self.globals.take("zero")

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
        interface = "".join(f"{line}\n" for line in [*self._uniforms(body), *declarations])
        prologue = f"{text}\n" if (text := self.prologue.text()) else ""
        return Shader(
            "\n".join(part for part in (_HEAD, interface, prologue, body) if part),
            tuple(inputs),
            {p.name: (self.params[p.name].text, p.type) for p in self.module.params},
            tuple(self.tables.values()),
            tuple(o.type for o in self.module.entry.outputs),
        )

    def _uniforms(self, text: str) -> list[str]:
        """The declarations of params, of tables, and of what the runtime sets where the text needs it."""
        lines = [f"uniform {spelled(p.type)} {self.params[p.name].text};" for p in self.module.params]
        for table in self.module.tables:
            names = self.tables[table.name]
            lines.append(f"uniform {_SAMPLERS[table.type.base]} {names.sampler};")
            lines.append(f"uniform {spelled(vec(Base.I, table.rank))} {names.shape};")
        ours = {
            self.zero_name: f"uniform float {self.zero_name};  // 0.0, but the driver must not know",
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
        index = {
            1: "i",
            2: f"ivec2(i / {n}.y, i % {n}.y)",
            3: f"ivec3(i / {n}.z / {n}.y, i / {n}.z % {n}.y, i % {n}.z)",
            4: f"ivec4(i / {n}.w / {n}.z / {n}.y, i / {n}.w / {n}.z % {n}.y, i / {n}.w % {n}.z, i % {n}.w)",
        }[size]
        return (
            f"{spelled(vec(Base.I, size))} sh_grid_index{size}() {{\n"
            f"    ivec2 at = min(ivec2(gl_FragCoord.xy), {LAST});\n"
            f"    int i = {FIRST} + at.y * {WIDTH} + at.x;\n"
            f"    return {index};\n"
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
        ports = [p.name for p in self.module.outputs] + ["status"]
        targets = [names.take(f"out_{p}") for p, _ in zip(ports, entry.outputs, strict=False)]
        for location, (target, output) in enumerate(zip(targets, entry.outputs, strict=True)):
            declarations.append(f"layout(location = {location}) out {spelled(_texel(output.type))} {target};")
        called = self.function_names[entry.name]
        if len(targets) == 1:
            made = ex.call(called, *map(Expr, args))
            body.append(f"{targets[0]} = {_as_texel(made.text, entry.outputs[0].type)};")
        else:
            results = [names.take(o.name) for o in entry.outputs]
            body += [f"{self.declaration(o.type, r)};" for o, r in zip(entry.outputs, results, strict=True)]
            body.append(f"{called}({', '.join([*args, *results])});")
            body += [f"{t} = {_as_texel(r, o.type)};" for t, r, o in zip(targets, results, entry.outputs, strict=True)]
        lines = "".join(f"    {line}\n" for line in body)
        return inputs, declarations, f"void main() {{\n{lines}}}\n"

    # Functions

    def begin(self, function: Function) -> None:
        """Plan the function; conditions on floats are not printed where they are used."""
        super().begin(function)
        if self.exact:
            self.layout.inlined -= precise_conditions(function, self.callees)

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
        self.emit(f"while ({RUNNING}) {{  // one turn: so that returns do not nest what follows them")
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
        """A loop that the device may stop needs an end that the compiler cannot rule out.

        Else that concludes that what follows is reached through `ended = true` alone. A limit is such an end.
        """
        outer = self.guarded, self.forever
        self.guarded = self.loops_stop and s.turns != 1 and not (self.limited and s.turns is None)
        self.forever = f"while ({RUNNING})" if self.guarded else "while (true)"
        super().loop(s, inner)
        self.guarded, self.forever = outer

    # Declarations

    def declaration(self, type: Type, name: str, passed: str = "") -> str:
        """`precise float x`; how a parameter is passed comes after `precise`, as it must before GLSL 4.20."""
        precise = "precise " if self.exact and (type.is_float or type.is_bool) else ""
        return f"{precise}{passed}{spelled(type)} {name}"

    def declare_array(self, variable: Variable, name: str) -> str:
        """An array of zeros: written out where it is short."""
        assert variable.length is not None
        declared = f"{self.declaration(variable.type, name)}[{variable.length}]"
        zero = self.zero(variable.type).text
        if variable.length <= _WRITTEN_OUT:
            zeros = ", ".join([zero] * variable.length)
            return f"{declared} = {spelled(variable.type)}[{variable.length}]({zeros});"
        return f"{declared}; for (int sh_i = 0; sh_i < {variable.length}; sh_i++) {{ {name}[sh_i] = {zero}; }}"

    # Types, literals, constructors

    def type_name(self, type: Type) -> str:
        """`vec3`."""
        return spelled(type)

    def literal(self, type: Type, component: float | int | bool) -> Expr:
        """One number; a float zero is the uniform."""
        if type.is_bool:
            return Expr("true" if component else "false")
        if type.base is Base.U:
            return Expr(f"{component}u")
        if type.is_int:
            return _signed(str(component)) if component != -(2**31) else Expr("(-2147483647 - 1)")
        rounded = np.float32(component)
        if rounded == 0 and self.exact:
            return Expr(f"-{self.zero_name}", Level.UNARY) if np.signbit(rounded) else Expr(self.zero_name)
        if not np.isfinite(rounded) or 0 < abs(rounded) < np.finfo(np.float32).tiny:
            return Expr(f"uintBitsToFloat(0x{rounded.view(np.uint32):08x}u)")
        return _signed(str(rounded))

    def known_zero(self, e: Expr) -> Expr:
        """The expression with a literal zero where it was the uniform: in comparisons and choices that is the same.

        A literal -0.0 is not: llvmpipe takes it for 0.0 where it makes a choice the lesser of two numbers.
        """
        if e.text == self.zero_name:
            return replace(e, text="0.0")
        if e.scalar is not None and e.scalar.text == self.zero_name:
            return replace(e, text=e.text.replace(self.zero_name, "0.0"), scalar=self.known_zero(e.scalar))
        return e

    def construct(self, type: Type, parts: list[Expr], types: list[Type]) -> Expr:
        """`vec3(a, b)`."""
        return ex.call(spelled(type), *parts)

    def convert(self, type: Type, e: Expr, source: Type) -> Expr:
        """`float(i)`; floats to ints by a helper, for it saturates."""
        if type.is_bool:
            return self._nonzero(e, source)
        if source.is_float and type.is_int:
            name = "sh_int" if type.base is Base.I else "sh_uint"
            return ex.call(self.prologue.use(name, (source,)), e)
        if source.is_bool and type.is_float and self.exact:
            return self._one_or_zero(type, e)
        return ex.call(spelled(type), e)

    def _one_or_zero(self, type: Type, e: Expr) -> Expr:
        """`b ? 1.0 : zero`: Mesa makes products with what it knows to be 0 or 1 choices, although 0 * inf is NaN."""
        if type.size == 1:
            return ex.ternary(e, Expr("1.0"), Expr(self.zero_name))
        name = spelled(type)
        return ex.call("mix", Expr(f"{name}({self.zero_name})"), Expr(f"{name}(1.0)"), e)

    def _nonzero(self, e: Expr, source: Type) -> Expr:
        zero = {Base.F: "0.0", Base.I: "0", Base.U: "0u"}[source.base]
        if source.size == 1:
            return ex.comparison("!=", e, Expr(zero), ordered=source.is_int)
        return ex.call("notEqual", e, Expr(f"{spelled(source)}({zero})"))

    # Operations

    def function(self, op: str, types: tuple[Type, ...]) -> str:
        """GLSL's function, or one of the prologue."""
        of_ints = not types[0].is_float and op in _OWN_OF_INTS
        if op in _OWN:
            return _OWN[op]
        return op if of_ints else self.prologue.use(_HELPERS.get(op, f"sh_{op}"), types)

    def infix(self, let: Let) -> Expr:
        """Operators; those that GLSL has not for vectors of bools by a helper."""
        type = let.value.type
        if type.is_bool and type.size > 1:
            return self.plain_call(let)
        if let.op not in ("shl", "shr"):
            return super().infix(let)
        left, right = self.args(let)
        left, right = self.without_splats(left, right, right_only=True)
        mask = "31u" if self.types[let.args[1]].base is Base.U else "31"
        if not (right.text.rstrip("u").isdigit() and int(right.text.rstrip("u")) < 32):
            right = ex.infix("&", Level.BIT_AND, right, Expr(mask))
        return ex.infix("<<" if let.op == "shl" else ">>", Level.SHIFT, left, right)

    def comparison(self, let: Let) -> Expr:
        """`a < b`, `lessThan(a, b)` of vectors."""
        if self.types[let.args[0]].size > 1:
            return ex.call(_OF_VECTORS[let.op], *map(self.known_zero, self.args(let)))
        left, right = map(self.known_zero, self.args(let))
        ordered = not self.types[let.args[0]].is_float
        return ex.comparison(COMPARISONS[let.op], left, right, ordered=ordered)

    def op_abs(self, let: Let) -> Expr:
        """GLSL has no abs of uints, which are their own."""
        return self.args(let)[0] if let.value.type.base is Base.U else self.plain_call(let)

    def op_sign(self, let: Let) -> Expr:
        """Nor a sign of uints: it is 0 or 1."""
        if let.value.type.base is not Base.U:
            return self.plain_call(let)
        return ex.call("min", *self.args(let), Expr("1u"))

    def op_cond(self, let: Let) -> Expr:
        """`c ? a : b` for one c, `mix` for one a component."""
        c, a, b = self.args(let)
        if not any(map(_ONE.fullmatch, (a.text, b.text))):  # see _one_or_zero
            a, b = self.known_zero(a), self.known_zero(b)
        type = let.value.type
        if type.size == 1:
            return ex.ternary(c, a, b)
        if c.scalar is not None:
            return ex.ternary(c.scalar, a, b)
        if type.is_float:
            return ex.call("mix", b, a, c)
        return ex.call(self.prologue.use("sh_select", (type.based(Base.B), type, type)), c, a, b)

    def not_vector(self, e: Expr) -> Expr:
        """`not(e)`."""
        return ex.call("not", e)

    def again(self, until: Expr) -> Expr:
        """The condition of a `do`, with the end that the compiler cannot rule out."""
        condition = super().again(until)
        return ex.infix("&&", Level.AND, condition, Expr(RUNNING)) if self.guarded else condition

    def op_component(self, let: Let) -> Expr:
        """`v[clamp(i, 0, 2)]`."""
        vector, index = self.args(let)
        size = self.types[let.args[0]].size
        return vector if size == 1 else ex.element(vector, self.in_range(index, size))

    def in_range(self, index: Expr, length: int) -> Expr:
        """`clamp(i, 0, 7)`."""
        return ex.call("clamp", index, Expr("0"), Expr(str(length - 1)))

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


def _signed(text: str) -> Expr:
    return Expr(text, Level.UNARY if text.startswith("-") else Level.ATOM)


def _extent(variable: Variable) -> str:
    return "" if variable.length is None else f"[{variable.length}]"
