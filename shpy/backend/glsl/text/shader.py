"""The fragment shader of a prepared module, version 3.30 core.

Stage: emit. Takes a module after `pipeline.prepare`, gives a `Shader`: the text and the names in it. The entry is a
function like any other; `main` fetches its arguments from textures and writes its results to the framebuffer.

    precise float y = 2.0 * x;  // wave.py:7
"""

from __future__ import annotations

from collections.abc import Sequence

from shpy.backend.emit import tree
from shpy.backend.emit.names import Names
from shpy.backend.emit.spell_c import text_of
from shpy.backend.emit.structure import Body
from shpy.backend.emit.tree import BOOL, INT, Expr, Literal, Name, number
from shpy.backend.glsl.text.interface import LAST, InputTexture, Limits, Shader
from shpy.backend.glsl.text.operations import GlslOperations, GlslUnit
from shpy.backend.glsl.text.prologue import (
    input_uniforms,
    output,
    uniforms,
    whole_text,
)
from shpy.backend.glsl.text.spell_glsl import GlslSpeller
from shpy.ir.nodes import Function, Module, Status, Value, Variable
from shpy.ir.traverse import bases_of
from shpy.ir.types import Base, Type, vec

_PIXEL = vec(Base.I, 2)
_FLOAT = vec(Base.F)
_LIMITS = Limits()


def print_shader(
    module: Module,
    limits: Limits = _LIMITS,
    *,
    exact: bool = True,
    flagged: bool = False,
    limited: bool = True,
    rejects: bool = False,
) -> Shader:
    """Print the shader of a prepared module for a device; for `exact`, `flagged` and `limited` see `GlslUnit`.

    With `rejects`, the only output, a bool, becomes a depth: the depth test then keeps elements from running for which
    it is true, and their status is DISCARDED.
    """
    return _ShaderMaker(module, limits, exact=exact, flagged=flagged, limited=limited).shader(rejects=rejects)


class GlslBody(Body):
    """Makes the tree of one function."""

    operations: GlslOperations

    def statements(self) -> None:
        """Make the function's statements, in a loop of one iteration if it is sheltered."""
        if self.function.name not in self.operations.unit.sheltered:
            super().statements()
            return
        with self.block() as inside:
            if not self.ended():
                inside.append(self.leave())
        self.out.append(self.operations.shelter(tree.Loop(tuple(inside), loc=self.function.loc)))
        if self.gives_value:
            self.out.append(tree.Exit("return", self.operations.zero(self.function.outputs[0].type)))


class _ShaderMaker(GlslUnit):
    """Makes one module one shader."""

    def shader(self, *, rejects: bool) -> Shader:
        """Return the whole text, with the names that the runtime needs."""
        module = self.module
        self.speller = self.own_speller()
        for function in module.functions:
            self.add(function, self.functions[function.name])
        inputs, outputs = self.add_main(rejects=rejects)
        own = uniforms(self.params.values(), self.tables.values(), self.used, self.zero.text)
        declared = [*own, *(line for i in inputs for line in input_uniforms(i)), *outputs]
        functions = [*self.read.values(), *self.placed.values(), text_of(self.speller.lines[1:])]
        return Shader(
            whole_text(declared, "\n\n".join(self.prologue.values()), functions, doubles=Base.D in bases_of(module)),
            inputs,
            {p.name: (self.params[p.name].text, p.type) for p in module.params},
            tuple(self.tables.values()),
            tuple(o.type for o in module.entry.outputs),
        )

    # Functions

    def add(self, function: Function, name: str) -> None:
        """Add a function to the text."""
        body, alone = GlslBody(GlslOperations(self, function)), len(function.outputs) == 1
        parameters = [self.parameter(body, port) for port in function.inputs]
        if not alone:
            parameters += [tree.Parameter(o.type, body.slot(o), "out") for o in function.outputs]
        body.begin(returns=True)
        body.statements()
        result = function.outputs[0].type if alone else None
        self.speller.function(tree.Function(name, result, tuple(parameters), tuple(body.out), function.loc))

    def printed(self, function: Function, name: str) -> str:
        """Return the text of a function that the shader is to have."""
        outer, self.speller = self.speller, self.own_speller()
        self.add(function, name)
        text = text_of(self.speller.lines[1:]).rstrip("\n")
        self.speller = outer
        return text

    def own_speller(self) -> GlslSpeller:
        """Return a speller of functions."""
        return GlslSpeller(exact=self.exact, reads=self.limits.reads)

    def parameter(self, body: GlslBody, port: Value | Variable) -> tree.Parameter:
        """Name a parameter."""
        if isinstance(port, Variable):
            return tree.Parameter(port.type, body.slot(port), "inout", port.length)
        name = Name(port.type, body.scope.take(port.name, "x"))
        body.exprs[port.id] = name
        return tree.Parameter(port.type, name.text)

    def add_main(self, *, rejects: bool) -> tuple[tuple[InputTexture, ...], list[str]]:
        """Add `main`; return the textures of the inputs, and the declarations of the outputs."""
        entry, names = self.module.entry, self.globals.scope()
        at = Name(_PIXEL, names.take("at"))
        inputs, args = [], []
        for index, (port, value) in enumerate(zip(self.module.inputs, entry.inputs, strict=True)):
            texture = InputTexture(index, value.type, names.take(f"in_{port.name}"), names.take(f"each_{port.name}"))
            inputs.append(texture)
            args.append(_fetched(texture, at))
        body: list[tree.Stmt] = []
        if args:
            corner = tree.picked(Name(_FLOAT.sized(4), "gl_FragCoord"), (0, 1), _FLOAT.sized(2))
            last = self.runtime_name(LAST, _PIXEL)
            body.append(tree.Declare(_PIXEL, at.text, tree.call("min", _PIXEL, tree.Cast(_PIXEL, corner), last)))
        called = self.functions[entry.name]
        if rejects:
            status = Name(INT, names.take("out_status"))
            depth = tree.choice(tree.call(called, BOOL, *args), Literal(_FLOAT, 0.0), Literal(_FLOAT, 1.0))
            body += [tree.Assign(status, number(Status.DISCARDED)), tree.Assign(Name(_FLOAT, "gl_FragDepth"), depth)]
            outputs = [output(0, INT, status.text)]
        else:
            ports = [*(p.name for p in self.module.outputs), "status"]
            targets = [names.take(f"out_{p}") for p, _ in zip(ports, entry.outputs, strict=False)]
            body += self._results(called, args, targets, names)
            pairs = enumerate(zip(targets, entry.outputs, strict=True))
            outputs = [output(location, _texel(o.type), target) for location, (target, o) in pairs]
        self.speller.function(tree.Function("main", None, (), tuple(body)))
        return tuple(inputs), outputs

    def _results(self, called: str, args: Sequence[Expr], targets: Sequence[str], names: Names) -> list[tree.Stmt]:
        """Return the call of the entry, and what stores its results in the framebuffer."""
        outputs = self.module.entry.outputs
        pairs = [(Name(_texel(o.type), target), o) for target, o in zip(targets, outputs, strict=True)]
        if len(pairs) == 1:
            ((target, o),) = pairs
            return [tree.Assign(target, _as_texel(tree.call(called, o.type, *args)))]
        results = [Name(o.type, names.take(o.name)) for o in outputs]
        stores = [tree.Assign(target, _as_texel(r)) for r, (target, _) in zip(results, pairs, strict=True)]
        return [
            *(tree.Declare(r.type, r.text) for r in results),
            tree.Do(tree.call(called, BOOL, *args, *results)),
            *stores,
        ]


def _fetched(texture: InputTexture, at: Name) -> Expr:
    """Return this element of an input: at the first texel where `each` is 0."""
    type = texture.type
    place = tree.infix("*", at, Name(INT, texture.each))
    texel = tree.call("texelFetch", _texel(type).sized(4), Name(INT, texture.sampler), place, number(0))
    texel_type = _texel(type)
    e: Expr = texel if type.size == 4 and not type.is_bool else tree.picked(texel, range(type.size), texel_type)
    if not type.is_bool:
        return e
    zero = Literal(texel_type.scalar, 0)
    return (
        tree.infix("!=", e, zero, type)
        if type.size == 1
        else tree.call("notEqual", type, e, tree.Construct(texel_type, (zero,)))
    )


def _texel(type: Type) -> Type:
    """Return the type in which a texel holds a value."""
    return type.based(Base.U) if type.is_bool else type


def _as_texel(e: Expr) -> Expr:
    """Return a value as a texel holds it."""
    return tree.Cast(_texel(e.type), e) if e.type.is_bool else e
