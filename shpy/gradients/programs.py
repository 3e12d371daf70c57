"""Derivatives of programs: programs again, which run on every backend, over streams and in chains.

Stage: above recording. A Param that the derivative is taken by becomes an input, and a Param again after it:

    shade.gradient("light", gain)      # shade_gradient(p, n) -> (d_light, d_gain)
    shade.jvp("p")                     # shade_forward(p, n, d_p) -> (value, d_value)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from shpy.algebra import bound, parts_of, tuple_class, values_of
from shpy.errors import ShpyTypeError
from shpy.gradients.functions import gradient, jvp
from shpy.ir.names import free
from shpy.ir.nodes import Call, Function, Let, Port, Value as IrValue
from shpy.ir.traverse import callee_of, walk
from shpy.lang.data.params import listed
from shpy.lang.data.tables import Table
from shpy.lang.data.textures import Texture
from shpy.lang.programs.inline import call_recorded
from shpy.lang.programs.joined import rerecorded
from shpy.lang.programs.record import RecordedProgram
from shpy.lang.recording.emit import Node, replay
from shpy.lang.recording.location import here
from shpy.lang.values.dependent import Dependent
from shpy.lang.values.structure import Layout, layout_from, leaves, leaves_of
from shpy.passes.rewriter import Rewriter


def gradient_of(
    recorded: RecordedProgram, wrt: Sequence[Any], *, value: bool, mode: Any, most: int | None
) -> RecordedProgram:
    """Return the program with an output d_x, the derivative of the only output, for each x of `wrt`."""
    names, params = names_of(recorded, wrt)
    opened = lifted(recorded, params)
    outputs = tuple_class("Gradient", (*(["value"] if value else []), *(f"d_{n}" for n in names)))

    def body(arguments: dict[str, Any]) -> Any:
        derived = gradient(function_of(opened, alone=True), tuple(names), value=value, mode=mode, most=most)(
            **arguments
        )
        return outputs(*((derived[0], *derived[1]) if value else derived))

    name = f"{recorded.module.name}_gradient"
    return bound(rerecorded(name, opened, opened.inputs, None, body, opened.defaults), params)


def jvp_of(recorded: RecordedProgram, wrt: Sequence[Any]) -> RecordedProgram:
    """Return the program with an input d_x for each x of `wrt`, and an output d_y after all outputs y."""
    names, params = names_of(recorded, wrt)
    opened = lifted(recorded, params)
    types = dict(opened.inputs)
    directions: dict[str, str] = {}
    for n in names:
        directions[n] = free(f"d_{n}", types)
        types[directions[n]] = opened.inputs[n]
    parts = parts_of(recorded.output, fields=True)
    outputs = ["value"] if len(parts) == 1 and parts[0][0] is None else [name for name, _ in parts if name is not None]
    both = tuple_class("Forward", (*outputs, *(f"d_{n}" for n in outputs))) if len(outputs) == len(parts) else None

    def body(arguments: dict[str, Any]) -> Any:
        tangents = [arguments.get(directions.get(n, "")) for n in opened.inputs]
        primal, change = jvp(function_of(opened), [arguments[n] for n in opened.inputs], tangents)
        results = [v for x in (primal, change) for v in values_of(recorded.output, x, fields=True)]
        return tuple(results) if both is None else both(*results)

    name = f"{recorded.module.name}_forward"
    return bound(rerecorded(name, opened, types, None, body, opened.defaults), params)


def function_of(recorded: RecordedProgram, *, alone: bool = False) -> Callable[..., Any]:
    """Return the program as a function of its inputs; with `alone`, a single output without its name."""

    def function(*args: Any, **named: Any) -> Any:
        result = call_recorded(recorded, dict(zip(recorded.inputs, args, strict=False)) | named)
        parts = values_of(recorded.output, result, fields=True)
        return parts[0] if alone and len(parts) == 1 else result

    function.__name__ = recorded.module.name
    function.inputs = recorded.inputs  # type: ignore[attr-defined]
    return function


def names_of(recorded: RecordedProgram, wrt: Sequence[Any]) -> tuple[list[str], dict[str, Any]]:
    """Return the names of the inputs and uniforms of `wrt`, and the uniforms among them by name."""
    uniforms = listed(recorded.params)
    names: list[str] = []
    for w in wrt or list(recorded.inputs)[:1]:
        name = w if isinstance(w, str) else next((n for n, u in uniforms.items() if u is w), None)
        if isinstance(w, Table | Texture) or name in recorded.tables:
            spoken = w if isinstance(w, str) else w.name or "the Table"
            raise ShpyTypeError(
                f"{spoken} is a Table, each element of which has a derivative of its own",
                loc=here(),
                cure=f"sh.value_and_gradient({recorded.module.name}, {spoken if w is not spoken else repr(w)})",
            )
        if name not in recorded.inputs and name not in uniforms:
            spoken = repr(w) if isinstance(w, str) else getattr(w, "name", None) or repr(w)
            raise ShpyTypeError(
                f"{spoken} is no input or Param of {recorded.module.name}",
                loc=here(),
                cure=f"one of {', '.join([*map(repr, recorded.inputs), *uniforms]) or 'none'}",
            )
        assert name is not None
        if name in names:
            text = f"{name} is named twice among the inputs and Params of a derivative of {recorded.module.name}"
            raise ShpyTypeError(text, loc=here(), cure=f"{name} once")
        names.append(name)
    return names, {n: uniforms[n] for n in names if n not in recorded.inputs}


# Params as inputs


def lifted(recorded: RecordedProgram, params: Mapping[str, Any], tables: Sequence[Table] = ()) -> RecordedProgram:
    """Return the program with these uniforms as its last inputs.

    The uniforms that follow them, or elements of the tables, are computed in it.
    """
    if not params and not tables:
        return recorded
    lift = _UniformInputs(recorded, params, tables)
    originals = {f.name: f for f in recorded.module.functions}
    functions = tuple(lift.function(f, originals) for f in recorded.module.functions)
    layouts: dict[str, Layout] = {n: layout_from(p, n) for n, p in params.items()}
    ports = [Port(leaf, kind) for n, layout in layouts.items() for leaf, kind, _ in leaves(layout, n)]
    module = replace(recorded.module, inputs=(*recorded.module.inputs, *ports), functions=functions)
    return replace(
        recorded, module=module, inputs={**recorded.inputs, **layouts}, params=lift.params, tables=lift.tables
    )


class _UniformInputs:
    """Makes inputs of uniforms, in every function that reads them or calls one that does."""

    def __init__(self, recorded: RecordedProgram, params: Mapping[str, Any], moving: Sequence[Table]) -> None:
        self.entry = recorded.module.entry
        self.params = dict(recorded.params)
        self.tables = dict(recorded.tables)
        self.moving = moving
        self.leaves = [leaf for p in params.values() for leaf in leaves_of(p)]
        self.paths = [path for n, p in params.items() for path, _, _ in leaves(layout_from(p, n), n)]
        self.users: set[str] = set()

    def place(self, uniform: Any) -> int | None:
        """Return the number of the input that a uniform becomes, or None."""
        return next((k for k, leaf in enumerate(self.leaves) if leaf is uniform), None)

    def follows(self, uniform: Any) -> bool:
        """Return whether a uniform is computed from one that becomes an input, or from a table that moves."""
        sources = uniform.sources if isinstance(uniform, Dependent) else ()
        return any(s in self.moving if isinstance(s, Table) else self.place(s) is not None for s in sources)

    def name_of(self, names: dict[str, Any], thing: Any, kind: str) -> str:
        """Return the name of a Param or Table in the program, entering it if it is new."""
        for name, other in names.items():
            if other is thing:
                return name
        name = free(getattr(thing, "name", None) or kind, names)
        names[name] = thing
        return name

    def function(self, function: Function, functions: Mapping[str, Function]) -> Function:
        """Return a function, with the uniforms as inputs if it needs them."""
        read = (self.params[str(s.attr)] for s in walk(function.body) if isinstance(s, Let) and s.op == "param")
        needs = any(self.place(u) is not None or self.follows(u) for u in read)
        if not (needs or function is self.entry or {callee_of(s) for s in walk(function.body)} & self.users):
            return function
        self.users.add(function.name)
        return _InputAdder(function, functions, self).run()


class _InputAdder(Rewriter):
    """Adds the inputs to one function, and to the calls in it."""

    def __init__(self, function: Function, functions: Mapping[str, Function], lift: _UniformInputs) -> None:
        super().__init__(function, functions)
        self.lift = lift
        self.added: list[IrValue] = []
        self.loc = function.loc
        for leaf, path in zip(lift.leaves, lift.paths, strict=True):
            self.added.append(self.value(leaf.type, path))
        self.types.update({v.id: v.type for v in self.added})

    def run(self) -> Function:
        function = super().run()
        return replace(function, inputs=(*function.inputs, *self.added))

    def let(self, let: Let) -> None:
        if let.op == "call" and let.attr in self.lift.users:
            let = replace(let, args=(*let.args, *(v.id for v in self.added)))
        uniform = self.lift.params[str(let.attr)] if let.op == "param" else None
        place = self.lift.place(uniform)
        if place is not None:
            self.replace(let.value, self.added[place].id)
        elif self.lift.follows(uniform):
            assert isinstance(uniform, Dependent)
            self.replace(let.value, replay(uniform.root, self._node))
        else:
            self.emit(let)

    def call(self, call: Call) -> None:
        more = [v.id for v in self.added] if call.function in self.lift.users else []
        self.emit(replace(call, args=(*call.args, *more)))

    def _node(self, node: Node, args: tuple[int, ...]) -> int:
        """Emit a step of a uniform's expression."""
        attr = node.attr
        if node.op == "param":
            place = self.lift.place(node.source)
            if place is not None:
                return self.added[place].id
            attr = self.lift.name_of(self.lift.params, node.source, "param")
        elif node.op == "table":
            attr = self.lift.name_of(self.lift.tables, node.source, "table")
        return self.make(node.op, *args, type=node.type, attr=attr)
