"""Shader algebra: programs joined, renamed, bound and specialised, each giving a new recording.

Stage: record, from recordings to a recording (McCool et al. 2004, Shader Algebra). Every operation records a fresh
program whose body calls the old ones.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping
from dataclasses import replace
from itertools import groupby
from keyword import iskeyword
from typing import Any

from shpy.errors import ShpyTypeError
from shpy.ir.constants import decode
from shpy.ir.nodes import Module, Port
from shpy.lang.data import Param, Table, TableType, Texture2D, TextureType
from shpy.lang.inline import call_recorded
from shpy.lang.location import here
from shpy.lang.matrix import MATRICES
from shpy.lang.record import InputType, Recorded, record_body
from shpy.lang.recorder import current_frame, recording
from shpy.lang.structure import Group, Layout, Leaf, Rows, build_values, leaves
from shpy.lang.values import CLASSES
from shpy.passes.pipeline import optimise

_Part = tuple[str | None, Layout]


def _parts(layout: Layout) -> list[_Part]:
    """The outputs one by one, with their names where they have any."""
    if isinstance(layout, Group) and layout.form in ("tuple", "list"):
        return [(None, part) for part in layout.parts]
    if isinstance(layout, Group) and layout.form in ("namedtuple", "dict"):
        return list(zip(layout.names, layout.parts, strict=True))
    return [(None, layout)]


def _values(layout: Layout, result: Any) -> list[Any]:
    if isinstance(layout, Group) and layout.form == "dict":
        return list(result.values())
    return list(result) if isinstance(layout, Group) and layout.form != "struct" else [result]


def _join(parts: list[_Part]) -> Layout:
    """One layout of several outputs: a single one stays itself."""
    if len(parts) == 1 and parts[0][0] is None:
        return parts[0][1]
    names = tuple(name for name, _ in parts if name is not None)
    if len(names) == len(parts) == len(set(names)):
        return Group("namedtuple", names, tuple(p for _, p in parts), _tuple_class("Outputs", names))
    return Group("tuple", tuple(map(str, range(len(parts)))), tuple(p for _, p in parts))


def _again(name: str, like: Recorded, types: dict[str, InputType], layout: Layout | None, body: Any) -> Recorded:
    loc = like.module.entry.loc
    with recording(name, loc) as made:
        return record_body(made, types, layout, body)


def _call(recorded: Recorded, given: Mapping[str, Any], constants: Mapping[str, Any] | None = None) -> Any:
    frame = current_frame()
    assert frame is not None
    return call_recorded(frame, recorded, given, constants or {})


def _free(name: str, taken: Mapping[str, Any]) -> str:
    fresh, count = name, 2
    while fresh in taken:
        fresh, count = f"{name}_{count}", count + 1
    return fresh


def _is_array(type_: InputType) -> bool:
    return not isinstance(type_, TableType | TextureType)


def compose(g: Recorded, f: Recorded) -> Recorded:
    """`g << f`: by name if every output of f is named and each is an input of g, else by position."""
    parts = _parts(f.output)
    wanted = [name for name, type_ in g.inputs.items() if _is_array(type_)]
    by_name = all(name is not None and name in wanted for name, _ in parts)
    fed = [name if by_name else wanted[i] if i < len(wanted) else None for i, (name, _) in enumerate(parts)]
    types: dict[str, InputType] = dict(f.inputs)
    extra: dict[str, str] = {}
    for name, type_ in g.inputs.items():
        if name not in fed:
            extra[name] = _free(name, types)
            types[extra[name]] = type_
    left_over = [part for part, name in zip(parts, fed, strict=True) if name is None]
    layout = g.output if not left_over else _join(_parts(g.output) + left_over)

    def body(given: Mapping[str, Any]) -> Any:
        results = _values(f.output, _call(f, {n: given[n] for n in f.inputs}))
        to_g = {name: value for name, value in zip(fed, results, strict=True) if name is not None}
        to_g |= {name: given[fresh] for name, fresh in extra.items()}
        last = _call(g, to_g)
        if not left_over:
            return last
        rest = [value for value, name in zip(results, fed, strict=True) if name is None]
        return tuple(_values(g.output, last) + rest)

    return _again(f"{g.module.name}_{f.module.name}", g, types, layout, body)


def beside(f: Recorded, g: Recorded, share: bool) -> Recorded:
    """`f & g`, or `f.merge(g)` with `share`: inputs of equal name and type are one."""
    types: dict[str, InputType] = dict(f.inputs)
    names: dict[str, str] = {}
    for name, type_ in g.inputs.items():
        if share and types.get(name) == type_:
            names[name] = name
        else:
            names[name] = _free(name, types)
            types[names[name]] = type_
    layout = _join(_parts(f.output) + _parts(g.output))

    def body(given: Mapping[str, Any]) -> Any:
        first = _values(f.output, _call(f, {n: given[n] for n in f.inputs}))
        second = _values(g.output, _call(g, {n: given[fresh] for n, fresh in names.items()}))
        return tuple(first + second)

    return _again(f"{f.module.name}_{g.module.name}", f, types, layout, body)


def renamed(p: Recorded, names: Mapping[str, str]) -> Recorded:
    """Inputs and named outputs under other names."""
    outputs = [name for name, _ in _parts(p.output) if name is not None]
    _known(p, names, [*p.inputs, *outputs], "input or output")
    types = {names.get(n, n): t for n, t in p.inputs.items()}
    if len(types) != len(p.inputs):
        raise ShpyTypeError("two inputs would have one name", loc=here(), cure="names that differ")
    layout = p.output
    if isinstance(layout, Group) and outputs:
        fresh = tuple(names.get(n, n) for n in layout.names)
        layout = Group("namedtuple", fresh, layout.parts, namedtuple("Outputs", fresh))

    def body(given: Mapping[str, Any]) -> Any:
        result = _call(p, {n: given[names.get(n, n)] for n in p.inputs})
        return tuple(_values(p.output, result)) if layout is not p.output else result

    return _again(p.module.name, p, types, layout, body)


def _known(p: Recorded, given: Mapping[str, Any], known: list[str], what: str) -> None:
    for name in given:
        if name not in known:
            raise ShpyTypeError(
                f"{name} is no {what} of {p.module.name}", loc=here(), cure=f"one of {', '.join(known) or 'none'}"
            )


def bound(p: Recorded, values: Mapping[str, Any]) -> Recorded:
    """Inputs given as uniforms."""
    _known(p, values, list(p.inputs), "input")
    fixed = {name: _uniform(name, p.inputs[name], value) for name, value in values.items()}
    types = {n: t for n, t in p.inputs.items() if n not in fixed}
    return _again(p.module.name, p, types, p.output, lambda given: _call(p, {**given, **fixed}))


def _uniform(name: str, type_: InputType, value: Any) -> Any:
    if isinstance(type_, TableType):
        return value if isinstance(value, Table) else Table(value, type_.cls, name)
    if isinstance(type_, TextureType):
        return value if isinstance(value, Texture2D) else Texture2D(value, name=name)
    if isinstance(value, Param):
        return value
    if isinstance(type_, Leaf | Rows):
        return Param(type_.cls, value, name=name)
    from shpy.lang.structure import flatten

    entries = zip(flatten(type_, value, name), leaves(type_, name), strict=True)
    return build_values(type_, iter([Param(cls, entry, name=leaf) for entry, (leaf, _, cls) in entries]))


def specialized(p: Recorded, values: Mapping[str, Any]) -> Recorded:
    """Inputs and params as constants, folded."""
    _known(p, values, [*p.inputs, *p.params], "input or param")
    types = {n: t for n, t in p.inputs.items() if n not in values}
    constants = {n: v for n, v in values.items() if n in p.params and n not in p.inputs}

    def body(given: Mapping[str, Any]) -> Any:
        fixed = {n: _constant(p.inputs[n], n, v) for n, v in values.items() if n in p.inputs}
        return _call(p, {**given, **fixed}, constants)

    made = _again(p.module.name, p, types, p.output, body)
    return replace(made, module=optimise(made.module, fixed=False))


def _constant(type_: InputType, name: str, value: Any) -> Any:
    if isinstance(type_, TableType | TextureType):
        return _uniform(name, type_, value)
    return type_.cls(value) if isinstance(type_, Leaf | Rows) else value


# Programs of modules


def recorded_from(module: Module) -> Recorded:
    """What the host must know to run a module; its tables become inputs."""
    inputs: dict[str, InputType] = {}
    tree = _tree(module.inputs)
    inputs.update(tree)
    for table in module.tables:
        inputs[table.name] = TableType(CLASSES["Attrib", table.type.size, table.type.base], table.rank)
    outputs = _tree(module.outputs)
    numbered = all(name.isdigit() for name in outputs)
    parts: list[_Part] = [(None if numbered else name, part) for name, part in outputs.items()]
    params = {
        p.name: Param(_class_named(p.kind, p.type.base, p.type.size), decode(p.type, p.value), name=p.name)
        for p in module.params
    }
    return Recorded(module, inputs, _join(parts), params, {})


def _tree(ports: tuple[Port, ...]) -> dict[str, Layout]:
    """The layouts that dotted and indexed names of ports stand for."""
    found: dict[str, Layout] = {}
    for head, group in groupby(ports, key=lambda port: port.name.partition(".")[0].partition("[")[0]):
        members = list(group)
        first = members[0]
        if first.name == head:
            found[head] = Leaf(_class_named(first.kind))
        elif first.name.startswith(f"{head}["):
            found[head] = Rows(MATRICES[first.kind.partition("[")[0]])
        else:
            inner = _tree(tuple(Port(m.name.partition(".")[2], m.kind) for m in members))
            names = tuple(inner)
            cls = _tuple_class(head, names)
            found[head] = Group("namedtuple", names, tuple(inner.values()), cls)
    return found


def _tuple_class(name: str, names: tuple[str, ...]) -> Any:
    """A class for parts of these names. Any text is a name in the IR; what Python cannot call so is numbered."""
    make: Any = namedtuple
    return make(name if name.isidentifier() and not iskeyword(name) else "Parts", names, rename=True)


def _class_named(kind: str, base: Any = None, size: int | None = None) -> Any:
    """The class of the language called `kind`; Attrib where only the type is known."""
    for cls in CLASSES.values():
        if cls.__name__ == kind:
            return cls
    if base is None or size is None:
        raise ShpyTypeError(f"{kind} is no type of the language", cure="Attrib3f, for example")
    return CLASSES["Attrib", size, base]
