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
from shpy.ir.names import free
from shpy.ir.nodes import Module, Port
from shpy.lang.data.params import Param, constant_of, constants_for, listed
from shpy.lang.data.tables import Table, TableType
from shpy.lang.data.textures import Texture2D, TextureType
from shpy.lang.programs.inline import call_recorded
from shpy.lang.programs.joined import rerecorded
from shpy.lang.programs.record import RESERVED, InputType, RecordedProgram
from shpy.lang.recording.location import here
from shpy.lang.values.coerce import widens
from shpy.lang.values.matrix import MATRICES
from shpy.lang.values.snapshot import Same
from shpy.lang.values.structure import Group, Layout, Leaf, Rows, build_values, flatten, is_value, leaves, leaves_of
from shpy.lang.values.value import CLASSES

_Part = tuple[str | None, Layout]


def parts_of(layout: Layout, *, fields: bool = False) -> list[_Part]:
    """Return the outputs one by one, with their names where they have any; a struct by its `fields` or whole."""
    if not isinstance(layout, Group) or (layout.form == "struct" and not fields):
        return [(None, layout)]
    names = [None] * len(layout.parts) if layout.form in ("tuple", "list") else layout.names
    return list(zip(names, layout.parts, strict=True))


def values_of(layout: Layout, result: Any, *, fields: bool = False) -> list[Any]:
    """Return the values of `parts_of`."""
    if not isinstance(layout, Group) or (layout.form == "struct" and not fields):
        return [result]
    if layout.form == "struct":
        return [getattr(result, name) for name in layout.names]
    return list(result.values() if layout.form == "dict" else result)


def _join(parts: list[_Part]) -> Layout:
    """Join several outputs to one layout: a single one stays itself."""
    if len(parts) == 1 and parts[0][0] is None:
        return parts[0][1]
    names = tuple(name for name, _ in parts if name is not None)
    if len(names) == len(parts) == len(set(names)):
        return Group("namedtuple", names, tuple(p for _, p in parts), tuple_class("Outputs", names))
    return Group("tuple", tuple(map(str, range(len(parts)))), tuple(p for _, p in parts))


def _under(defaults: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Return the defaults of the inputs that go on under these names."""
    return {names[n]: default for n, default in defaults.items() if n in names}


def compose(g: RecordedProgram, f: RecordedProgram) -> RecordedProgram:
    """Return `g << f`: f's outputs by the names that are g's inputs; by position where no name is, or f's have none.

    The other outputs follow g's, the other inputs follow f's. Raises ShpyTypeError where both could be meant, and where
    an output does not fit its input.
    """
    whole, parts, fed = _connection(g, f)
    types: dict[str, InputType] = dict(f.inputs)
    extra: dict[str, str] = {}
    for name, type_ in g.inputs.items():
        if name not in fed:
            extra[name] = free(name, types)
            types[extra[name]] = type_
    left_over = [part for part, name in zip(parts, fed, strict=True) if name is None]
    layout = g.output if not left_over else _join(parts_of(g.output) + left_over)

    def body(arguments: Mapping[str, Any]) -> Any:
        result = call_recorded(f, {n: arguments[n] for n in f.inputs})
        results = [result] if whole else values_of(f.output, result, fields=True)
        to_g = {name: value for name, value in zip(fed, results, strict=True) if name is not None}
        to_g |= {name: arguments[fresh] for name, fresh in extra.items()}
        last = call_recorded(g, to_g)
        if not left_over:
            return last
        rest = [value for value, name in zip(results, fed, strict=True) if name is None]
        return tuple(values_of(g.output, last) + rest)

    defaults = f.defaults | _under(g.defaults, extra)
    return rerecorded(f"{g.module.name}_{f.module.name}", g, types, layout, body, defaults)


def _connection(g: RecordedProgram, f: RecordedProgram) -> tuple[bool, list[_Part], list[str | None]]:
    """Return whether f's output goes to g as one; its parts; and the input of g that each part goes to."""
    inputs = {name: type_ for name, type_ in g.inputs.items() if not isinstance(type_, TableType | TextureType)}
    parts = parts_of(f.output, fields=True)
    fed = [name if name in inputs else None for name, _ in parts]
    first = next(iter(inputs), None)
    whole = isinstance(f.output, Group) and first is not None and alike(f.output, inputs[first])
    if any(fed):
        _check_one_reading(g, f, parts, fed, inputs, whole)
        whole = False
    elif whole:
        parts, fed = [(None, f.output)], [first]
    else:
        names = [*inputs, *[None] * len(parts)]
        fed = list(names[: len(parts)])
    for (name, layout), target in zip(parts, fed, strict=True):
        if target is not None and not _fits(layout, inputs[target]):
            spoken = f"the output {name}" if name is not None else "an output"
            raise ShpyTypeError(
                f"{spoken} of {f.module.name} is {with_article(layout)} and cannot be the input {target} of "
                f"{g.module.name}, {with_article(inputs[target])}: {signature(f)} goes into {signature(g)}",
                loc=here(),
                cure="a program between the two that converts"
                + (f", or {f.module.name}.rename({name}=…), so that names join as they are meant" if name else ""),
            )
    return whole, parts, fed


def _check_one_reading(
    g: RecordedProgram,
    f: RecordedProgram,
    parts: list[_Part],
    fed: list[str | None],
    inputs: Mapping[str, Layout],
    whole: bool,
) -> None:
    """Error where some names match and what is left could go on by position."""
    free = {name: type_ for name, type_ in inputs.items() if name not in fed}
    for (name, layout), target in zip(parts, fed, strict=True):
        fitting = next((n for n, t in free.items() if target is None and alike(layout, t)), None)
        if fitting is not None:
            raise ShpyTypeError(
                f"{g.module.name} << {f.module.name} can be read in two ways: by name, {name} is no input of "
                f"{g.module.name}; by position it could be {fitting}: {signature(f)} goes into {signature(g)}",
                loc=here(),
                cure=f"{f.module.name}.rename({name}={fitting!r}) to join the two, or, to keep them apart, a program "
                f"that calls {f.module.name} and {g.module.name}",
            )
    if whole:
        first = next(iter(inputs))
        raise ShpyTypeError(
            f"{g.module.name} << {f.module.name} can be read in two ways: all of it could be {first}, and a part "
            f"of it is named as an input: {signature(f)} goes into {signature(g)}",
            loc=here(),
            cure=f"{g.module.name}.rename(…), so that no input has the name of a part that is not meant for it",
        )


def _leaf_types(layout: InputType) -> list[Any]:
    """Return the types of the parts in the IR, which knows no kinds."""
    return [] if isinstance(layout, TableType | TextureType) else [cls.type for _, _, cls in leaves(layout, "")]


def alike(a: Layout, b: Layout) -> bool:
    """Return whether two layouts hold the same types in the same way, kinds aside."""
    same_form = isinstance(a, Group) == isinstance(b, Group) and isinstance(a, Rows) == isinstance(b, Rows)
    names = not (isinstance(a, Group) and isinstance(b, Group)) or a.names == b.names
    return same_form and names and _leaf_types(a) == _leaf_types(b)


def _fits(source: Layout, target: Layout) -> bool:
    """Return whether an input takes a value: an equal structure, or a leaf that widens or is a scalar."""
    if isinstance(source, Leaf) and isinstance(target, Leaf):
        old, new = source.cls.type, target.cls.type
        return old.size in (1, new.size) and widens(old.base, new.base)
    return alike(source, target)


def with_article(layout: InputType) -> str:
    """Return the type of an input or output with its article."""
    spoken = type_name(layout)
    return f"a{'n' if spoken[0] in 'AEIOU' else ''} {spoken}"


def type_name(type_: InputType) -> str:
    """Return the type of an input or output as a message spells it."""
    if isinstance(type_, Group):
        inner = ", ".join(type_name(part) for part in type_.parts)
        return type_.cls.__name__ if type_.cls is not None else f"({inner})"
    if isinstance(type_, TableType):
        return f"Table[{type_.cls.__name__}, {type_.rank}]"
    return f"Texture2D[{type_.cls.__name__}]" if isinstance(type_, TextureType) else type_.cls.__name__


def signature(p: RecordedProgram) -> str:
    """Return the text `f(x: Attrib1f) -> (a: Point3f, b: Attrib1f)`."""
    inputs = ", ".join(f"{name}: {type_name(type_)}" for name, type_ in p.inputs.items())
    outputs = [
        f"{name}: {type_name(part)}" if name else type_name(part) for name, part in parts_of(p.output, fields=True)
    ]
    named = len(outputs) > 1 or parts_of(p.output, fields=True)[0][0] is not None
    return f"{p.module.name}({inputs}) -> {'(' * named}{', '.join(outputs)}{')' * named}"


def beside(f: RecordedProgram, g: RecordedProgram, share: bool) -> RecordedProgram:
    """Return `f & g`, or `f.merge(g)` with `share`: inputs of equal name and type are one."""
    types: dict[str, InputType] = dict(f.inputs)
    names: dict[str, str] = {}
    for name, type_ in g.inputs.items():
        if share and types.get(name) == type_:
            names[name] = name
        else:
            names[name] = free(name, types)
            types[names[name]] = type_
    layout = _join(parts_of(f.output) + parts_of(g.output))

    def body(arguments: Mapping[str, Any]) -> Any:
        first = values_of(f.output, call_recorded(f, {n: arguments[n] for n in f.inputs}))
        second = values_of(g.output, call_recorded(g, {n: arguments[fresh] for n, fresh in names.items()}))
        return tuple(first + second)

    defaults = _under(g.defaults, names) | f.defaults
    return rerecorded(f"{f.module.name}_{g.module.name}", f, types, layout, body, defaults)


def renamed(p: RecordedProgram, names: Mapping[str, str]) -> RecordedProgram:
    """Rename inputs and named outputs; outputs with new names become a NamedTuple."""
    parts = parts_of(p.output, fields=True)
    outputs = [name for name, _ in parts if name is not None]
    _check_names(p, names, [*p.inputs, *outputs], "input or output")
    for name in names.values():
        if not isinstance(name, str) or not name.isidentifier():
            raise ShpyTypeError(f"{name!r} is no name", loc=here(), cure='rename(old="new")')
        if name in RESERVED:
            raise ShpyTypeError(f"{name} is a reserved name for an input", loc=here(), cure=f"{name}_")
    types = {names.get(n, n): t for n, t in p.inputs.items()}
    fresh = tuple(names.get(n, n) for n in outputs)
    for what, count, distinct in (("inputs", len(p.inputs), types), ("outputs", len(outputs), set(fresh))):
        if len(distinct) != count:
            raise ShpyTypeError(f"two {what} would have one name", loc=here(), cure="names that differ")
    changed = fresh != tuple(outputs)
    layout = p.output
    if changed:
        layout = Group("namedtuple", fresh, tuple(part for _, part in parts), tuple_class("Outputs", fresh))

    def body(arguments: Mapping[str, Any]) -> Any:
        result = call_recorded(p, {n: arguments[names.get(n, n)] for n in p.inputs})
        return tuple(values_of(p.output, result, fields=True)) if changed else result

    return rerecorded(p.module.name, p, types, layout, body, _under(p.defaults, {n: names.get(n, n) for n in p.inputs}))


def _check_names(p: RecordedProgram, names: Mapping[str, Any], choices: list[str], what: str) -> None:
    for name in names:
        if name not in choices:
            raise ShpyTypeError(
                f"{name} is no {what} of {p.module.name}", loc=here(), cure=f"one of {', '.join(choices) or 'none'}"
            )


def bound(p: RecordedProgram, values: Mapping[str, Any]) -> RecordedProgram:
    """Return the program with inputs replaced by uniforms: Params, Tables and textures that hold these values."""
    _check_names(p, values, list(p.inputs), "input")
    fixed = {name: _uniform(name, p.inputs[name], value) for name, value in values.items()}
    types = {n: t for n, t in p.inputs.items() if n not in fixed}
    return rerecorded(
        p.module.name, p, types, p.output, lambda arguments: call_recorded(p, {**arguments, **fixed}), p.defaults
    )


def _uniform(name: str, type_: InputType, value: Any) -> Any:
    if isinstance(type_, TableType):
        return value if isinstance(value, Table) else Table(value, type_.cls, name)
    if isinstance(type_, TextureType):
        return value if isinstance(value, Texture2D) else Texture2D(value, name=name)
    if is_value(value) and any(leaf._uniform for leaf in leaves_of(value)):
        return value
    if isinstance(type_, Leaf | Rows) or type_.form == "struct":
        return Param(type_.cls, value, name=name)
    entries = zip(flatten(type_, value, name), leaves(type_, name), strict=True)
    return build_values(type_, iter([Param(cls, entry, name=leaf) for entry, (leaf, _, cls) in entries]))


def specialized(p: RecordedProgram, values: Mapping[str, Any]) -> RecordedProgram:
    """Fold inputs and params, given as constants."""
    uniforms = {**p.params, **listed(p.params)}
    _check_names(p, values, [*p.inputs, *uniforms], "input or param")
    types = {n: t for n, t in p.inputs.items() if n not in values}
    constants: dict[Same, tuple[int, ...]] = {}
    for name, value in values.items():
        if name not in p.inputs:
            constants |= constants_for(name, uniforms[name], value)

    def body(arguments: Mapping[str, Any]) -> Any:
        fixed = {n: _constant(p.inputs[n], n, v) for n, v in values.items() if n in p.inputs}
        return call_recorded(p, {**arguments, **fixed}, constants)

    recorded = rerecorded(p.module.name, p, types, p.output, body, p.defaults)
    from shpy.passes.pipeline import optimise  # here: a program that is only recorded needs no passes

    return replace(recorded, module=optimise(recorded.module, fixed=False))


def _constant(type_: InputType, name: str, value: Any) -> Any:
    if isinstance(type_, TableType | TextureType):
        return _uniform(name, type_, value)
    if isinstance(type_, Leaf):
        constant_of(type_.cls, value, f"the input {name}")  # refuses 2.5 for an int, which a constructor truncates
    return type_.cls(value) if isinstance(type_, Leaf | Rows) else value


# Programs of modules


def recorded_from(module: Module) -> RecordedProgram:
    """Return the data with which the host runs a module; its tables become inputs."""
    inputs: dict[str, InputType] = {}
    tree = _tree(module.inputs)
    inputs.update(tree)
    for table in module.tables:
        inputs[table.name] = TableType(CLASSES["Attrib", table.type.size, table.type.base], table.rank)
    outputs = _tree(module.outputs)
    numbered = all(name.isdigit() or not name for name in outputs)  # the rows of one matrix have no name before them
    parts: list[_Part] = [(None if numbered else name, part) for name, part in outputs.items()]
    params = {
        p.name: Param.declared(_class_named(p.kind, p.type.base, p.type.size), decode(p.type, p.value), p.name, p.about)
        for p in module.params
    }
    return RecordedProgram(module, inputs, _join(parts), params, {})


def _tree(ports: tuple[Port, ...]) -> dict[str, Layout]:
    """Return the layouts that dotted and indexed names of ports stand for."""
    layouts: dict[str, Layout] = {}
    for head, group in groupby(ports, key=lambda port: port.name.partition(".")[0].partition("[")[0]):
        members = list(group)
        first = members[0]
        if first.name == head:
            layouts[head] = Leaf(_class_named(first.kind))
        elif first.name.startswith(f"{head}["):
            layouts[head] = Rows(MATRICES[first.kind.partition("[")[0]])
        else:
            inner = _tree(tuple(Port(m.name.partition(".")[2], m.kind) for m in members))
            names = tuple(inner)
            cls = tuple_class(head, names)
            layouts[head] = Group("namedtuple", names, tuple(inner.values()), cls)
    return layouts


def tuple_class(name: str, names: tuple[str, ...]) -> Any:
    """Return a named tuple class with these fields; a name that the IR allows and Python refuses becomes its number."""
    make: Any = namedtuple
    return make(name if name.isidentifier() and not iskeyword(name) else "Parts", names, rename=True)


def _class_named(kind: str, base: Any = None, size: int | None = None) -> Any:
    """Return the class of the language called `kind`; Attrib where only the type is known."""
    for cls in CLASSES.values():
        if cls.__name__ == kind:
            return cls
    if base is None or size is None:
        raise ShpyTypeError(f"{kind} is no type of the language", cure="Attrib3f, for example")
    return CLASSES["Attrib", size, base]
