"""Derivatives of functions: the gradient, the Jacobian, and the derivative along a direction.

Stage: record, and above.

    n = sh.normalize(sh.gradient(distance)(p))              # the normal of an implicit surface
    J = sh.jacobian(f)(p)                                   # for a step of Newton's method
    z, dz = sh.jvp(iterate, [c], [sh.Attrib2f(1, 0)])       # the value and the derivative along a direction
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal

from shpy.backend.base import Options
from shpy.errors import RecordError, ShpyTypeError
from shpy.gradients.calls import call_derived, derived_name, forward_functions, moving_inputs, reverse_call, zero
from shpy.ir.collector import uncollected
from shpy.ir.nodes import Discard, Function, Variable
from shpy.ir.types import Base, Type, vec
from shpy.lang.data.tables import Table
from shpy.lang.programs.outline import Outline, Place, called, outlined, parameters
from shpy.lang.programs.record import call_explained, record_body
from shpy.lang.recording.location import here
from shpy.lang.recording.recorder import Frame, current_frame, recording
from shpy.lang.values import arithmetic
from shpy.lang.values.matrix import MATRICES
from shpy.lang.values.structure import Layout, Leaf, build_values, flatten, layout_from, leaves
from shpy.lang.values.value import Value
from shpy.passes.derivatives.forward import ForwardFunctions, Seed
from shpy.passes.derivatives.linear import TangentBuilder
from shpy.passes.derivatives.table_reads import Reads
from shpy.run.kernel import Kernel

_OF_PLACES = {"Point": "Normal", "Vector": "Normal", "Normal": "Vector"}
"""The kind of the gradient by a place or a direction: a matrix maps it as it maps normals."""

_LETTERS = "xyzw"


def gradient(
    f: Callable[..., Any],
    wrt: Any = 0,
    *,
    value: bool = False,
    mode: Literal["forward", "reverse"] = "forward",
    most: int | None = None,
) -> Callable[..., Any]:
    """Return the function that computes the gradient of f: its derivative by the argument `wrt`, by default the first.

    f gives one float; it is a Python function, a subroutine or a program. `wrt` is the position or name of an argument,
    or a tuple of them for a tuple of gradients. A gradient has the type of its argument: a float, a vector, a matrix or
    a struct. That by a Point or a Vector is a Normal. With `value` the function gives the value of f first, then the
    gradient. docs/gradients.md lists the derivatives at kinks.

    `mode="reverse"` computes all components in one walk backwards, at a cost that does not grow with their number: it
    is faster from about 8 components on. It keeps the state of each iteration of a loop, so a loop without a known
    bound needs `most`, and an element that takes more iterations gives NaN. The modes round differently.

    Raises ShpyTypeError for a function of another type and for an argument of ints or bools, RecordError where f does
    not depend on the argument.
    """
    what = "sh.gradient"
    if mode not in ("forward", "reverse"):
        raise ShpyTypeError(f"{what} does not take mode={mode!r}", loc=here(), cure='mode="forward" or "reverse"')

    def derive(outline: Outline) -> Any:
        check_scalar(what, outline)
        derivatives = gradient_values(outline, what, mode, most, value=value)
        result = tuple(derivatives.gradients) if isinstance(wrt, tuple | list) else derivatives.gradients[0]
        return (derivatives.results[0], result) if value else result

    return _derived(what, f, wrt, derive)


def jacobian(f: Callable[..., Any], wrt: Any = 0) -> Callable[..., Any]:
    """Return the function that computes the Jacobian of f, the derivative of a vector by the argument `wrt`.

    Entry [r, c] is d f_r / d x_c. It is a matrix where the argument has as many components as the result, a vector
    where the argument is a float, and else a tuple of columns, one for each component of the argument.

    Raises as `sh.gradient` does.
    """
    what = "sh.jacobian"

    def derive(outline: Outline) -> Any:
        if not isinstance(outline.layout, Leaf) or len(outline.moved) != 1 or len(outline.moved[0].inputs) != 1:
            raise ShpyTypeError(
                f"{what} takes a function that gives one vector, and one vector as the argument; {outline.spoken} has "
                f"other types",
                loc=here(),
                cure="sh.gradient for a float by several arguments, sh.jvp for structs",
            )
        cls, frame = outline.layout.cls, outline.frame
        world, forward, rows = _seeded(outline, what)
        handles = call_derived(outline, outline.reached, world.callees, forward, (), "jacobian")
        places = {v.id: handle for v, handle in zip(forward.outputs, handles, strict=True)}
        columns = [
            arithmetic.make_value("Attrib", cls.type, frame, zero(outline, cls.type) if row is None else places[row.id])
            for row in rows
        ]
        if len(columns) == 1:
            return columns[0]
        same = cls.size == len(columns)
        return MATRICES[f"Matrix{cls.size}f"].from_columns(*columns) if same else tuple(columns)

    return _derived(what, f, wrt, derive)


def jvp(f: Callable[..., Any], primals: Sequence[Any], tangents: Sequence[Any]) -> tuple[Any, Any]:
    """Return f at the primals, and its derivative there along the tangents.

    `tangents` has an entry for each of `primals`, of its type; None stands for zero. Both results have the type of f's.
    The name and the order are JAX's.

    Raises ShpyTypeError for tangents that do not fit, and as `sh.gradient` does.
    """
    _check_callable("sh.jvp", f)
    if not isinstance(primals, list | tuple) or not isinstance(tangents, list | tuple):
        text = "sh.jvp takes a list of arguments and a list of their tangents"
        raise ShpyTypeError(text, loc=here(), cure="sh.jvp(f, [x], [dx])")
    if current_frame() is None:
        both = _at_once(lambda *args: jvp(f, args[: len(primals)], args[len(primals) :]), (*primals, *tangents), {})
        return both[0], both[1]
    what = "sh.jvp"
    if len(primals) != len(tangents) or all(t is None for t in tangents):
        raise ShpyTypeError(
            f"sh.jvp takes a tangent for each of {len(primals)} arguments, None for one that stays, and not all None",
            loc=here(),
            cure="sh.jvp(f, [x, y], [dx, None])",
        )
    places = [k for k, t in enumerate(tangents) if t is not None]
    outline = outlined(what, f, primals, {}, places)
    frame = outline.frame
    more = [
        arithmetic.convert(frame, entry, v.type, f"the tangent of {m.name}")
        for m, k in zip(outline.moved, places, strict=True)
        for entry, v in zip(flatten(m.layout, tangents[k], f"the tangent of {m.name}"), m.inputs, strict=True)
    ]
    simple, world = forward_functions(outline, what, [""])
    moving = moving_inputs(outline, simple)
    forward = world.seeded(simple, moving, {})
    moves = world.activities.in_function(simple, moving).outputs
    handles = call_derived(outline, outline.reached, world.callees, forward, more, "forward")
    values, rest = handles[: len(moves)], iter(handles[len(moves) :])
    changes = [next(rest) if m else zero(outline, v.type) for m, v in zip(moves, simple.outputs, strict=True)]
    moved = _values(frame, outline.layout, changes, lambda kind: "Vector" if kind == "Point" else kind)
    return _values(frame, outline.layout, values), moved


def _derived(what: str, f: Callable[..., Any], wrt: Any, derive: Callable[[Outline], Any]) -> Callable[..., Any]:
    """Return the function that calls f with the arguments `wrt` symbolic, and derives the outline of that."""
    _check_callable(what, f)

    @functools.wraps(f, updated=())
    def derived(*args: Any, **named: Any) -> Any:
        if current_frame() is None:
            return _at_once(derived, args, named)
        return derive(outlined(what, f, args, named, _places(f, args, named, wrt)))

    derived.__name__ = derived.__qualname__ = derived_name(called(f), what.removeprefix("sh."))
    return derived


def _check_callable(what: str, f: Any) -> None:
    if not callable(f):
        raise ShpyTypeError(
            f"{what} takes a function, not {type(f).__name__}",
            loc=here(),
            cure="sh.jvp(f, [x], [dx])" if what == "sh.jvp" else f"{what}(f)(x)",
        )


def _places(f: Any, args: Sequence[Any], named: Mapping[str, Any], wrt: Any) -> list[Place]:
    """Return the arguments that `wrt` names, as positions among `args` or keywords of `named`."""
    names = parameters(f)
    places: list[Place] = []
    for w in wrt if isinstance(wrt, tuple | list) else (wrt,):
        place = w
        if isinstance(w, str) and w not in named and w in names:
            place = names.index(w)
        elif isinstance(w, int) and not isinstance(w, bool) and len(args) <= w < len(names):
            place = names[w]
        in_place = place in named if isinstance(place, str) else isinstance(place, int) and 0 <= place < len(args)
        if not in_place:
            choices = [*names[: len(args)], *named]
            raise ShpyTypeError(
                f"wrt={w!r} names no argument of this call of {called(f) or 'the function'}",
                loc=here(),
                cure=f"wrt= one of {', '.join(map(repr, choices or range(len(args))))}",
            )
        places.append(place)
    return places


def check_scalar(what: str, outline: Outline) -> None:
    """Raise ShpyTypeError unless the function gives one float."""
    if isinstance(outline.layout, Leaf) and outline.layout.cls.size == 1 and outline.layout.cls.type.is_float:
        return
    if isinstance(outline.layout, Leaf) and not outline.layout.cls.type.is_float:
        text, cure = f"{outline.spoken} gives an {outline.layout.cls.__name__}, which has no derivative", "a float"
    else:
        name = outline.layout.cls.__name__ if isinstance(outline.layout, Leaf) else ""
        spoken = f"a{'n' if name.startswith('A') else ''} {name}" if name else "several values"
        text = f"{what} takes a function that gives one float, and {outline.spoken} gives {spoken}"
        cure = "sh.jacobian for a vector, sh.jvp for a derivative along a direction"
    raise ShpyTypeError(text, loc=here(), cure=cure)


def _result_type(outline: Outline) -> Type:
    assert isinstance(outline.layout, Leaf)
    return outline.layout.cls.type


# The derived function


@dataclass(frozen=True)
class GradientValues:
    """The result of a function, where it is asked for, and the gradient by each argument.

    `elements` has, for each of `reads` of tables, the number of the element, from 1 on, and the derivative by it.
    """

    results: list[Any]
    gradients: list[Any]
    reads: Reads
    elements: list[tuple[Any, Any]]


def gradient_values(
    outline: Outline,
    what: str,
    mode: Literal["forward", "reverse"],
    most: int | None,
    *,
    value: bool,
    tables: Mapping[str, Table] = MappingProxyType({}),
    first: Value | None = None,
) -> GradientValues:
    """Call the derived function; `tables` are those that move, by their names in the recording, in reverse mode.

    `first` is the number of the first read in loops that it gives.
    """
    results = [0] if value else []
    reads = Reads()
    if mode == "reverse":
        start = None if first is None else first._read(outline.frame)
        values, reverse = reverse_call(outline, what, results, most, tables=tables, first=start)
        handles, reads = iter(values), reverse.reads
    else:
        world, forward, rows = _seeded(outline, what)
        packed = _packed(forward, rows, results, _named_types(outline))
        handles = iter(call_derived(outline, outline.reached, world.callees, packed, (), "gradient"))

    def plain(type: Type) -> Any:
        return arithmetic.make_value("Attrib", type, outline.frame, next(handles))

    return GradientValues(
        [plain(_result_type(outline)) for _ in results],
        [_values(outline.frame, m.layout, handles, lambda kind: _OF_PLACES.get(kind, "Attrib")) for m in outline.moved],
        reads,
        [(plain(vec(Base.I)), plain(tables[name].type.type)) for name in reads.tables],
    )


def _seeded(outline: Outline, what: str) -> tuple[ForwardFunctions, Function, list[Variable | None]]:
    """Return the forward function along each component of the arguments, and its tangents, None for zero."""
    count = sum(v.type.size for m in outline.moved for v in m.inputs)
    several = len(outline.moved) > 1 or len(outline.moved[0].inputs) > 1
    labels: list[str] = []
    seeds: dict[int, Seed] = {}
    for v in (v for m in outline.moved for v in m.inputs):
        seeds[v.id] = [k - len(labels) if 0 <= k - len(labels) < v.type.size else None for k in range(count)]
        letters = [""] if v.type.size == 1 else [f"_{c}" if several else c for c in _LETTERS[: v.type.size]]
        labels += [f"d{_plain(v.name)}{c}" if several or not c else f"d{c}" for c in letters]
    simple, world = forward_functions(outline, what, labels)
    moving = moving_inputs(outline, simple)
    forward = world.seeded(simple, moving, seeds)
    moves = world.activities.in_function(simple, moving).outputs[0]
    rows: list[Variable | None] = list(forward.outputs[1:]) if moves else [None] * count
    return world, forward, rows


def _named_types(outline: Outline) -> list[tuple[str, Type]]:
    """Return the name and the type of the gradient by each leaf of the arguments."""
    inputs = [v for m in outline.moved for v in m.inputs]
    alone = len(inputs) == 1
    return [("gradient" if alone else f"d_{_plain(v.name)}", v.type) for v in inputs]


def _plain(name: str | None) -> str:
    """Return a leaf's name as an identifier: `ray_o` for `ray.o`, `m_0` for `m[0]`."""
    return (name or "x").replace(".", "_").replace("[", "_").replace("]", "")


def _packed(
    forward: Function, rows: Sequence[Variable | None], kept: Sequence[int], types: Sequence[tuple[str, Type]]
) -> Function:
    """Return a derived function that gives the outputs `kept` and, for each type, a vector of the next of `rows`."""
    b = TangentBuilder(replace(forward, outputs=(), variables=(*forward.variables, *forward.outputs)))
    b.loc = forward.loc
    b.extend(forward.body)
    results = [(b.output(forward.outputs[k].type, forward.outputs[k].name), forward.outputs[k]) for k in kept]
    gradients = [b.output(type, name) for name, type in types]
    if forward.body and isinstance(forward.body[-1], Discard):  # nothing after it is reached
        return b.finish()
    for new, old in results:
        b.store(new, b.load(old))
    rest = iter(rows)
    for (_, type), gradient in zip(types, gradients, strict=True):
        parts = []
        for slot in (next(rest) for _ in range(type.size)):
            part = b.load(slot) if slot is not None else b.const(forward.outputs[0].type, [0])
            parts.append(part if part.type is type.scalar else b.let("convert", part, type=type.scalar))
        b.store(gradient, parts[0] if len(parts) == 1 else b.let("construct", *parts, type=type))
    return b.finish()


def _values(frame: Frame, layout: Layout, handles: Iterable[int], kind_of: Callable[[str], str] = str) -> Any:
    """Return the next values of a layout; a single one has the kind that `kind_of` gives for the layout's."""
    classes = [cls for _, _, cls in leaves(layout, "")]
    kinds = [kind_of(cls.kind) if isinstance(layout, Leaf) else cls.kind for cls in classes]
    values = [arithmetic.make_value(k, c.type, frame, h) for k, c, h in zip(kinds, classes, handles, strict=False)]
    return build_values(layout, iter(values))


# Outside of a program


def _at_once(derived: Callable[..., Any], args: Sequence[Any], named: Mapping[str, Any]) -> Any:
    """Return the derivative at constants, computed on numpy at f32 in strict mode as a program of one element."""
    layouts = []

    def body(arguments: Any) -> Any:
        result = call_explained(derived, args, named)
        layouts.append(layout_from(result, "a derivative"))
        return tuple(flatten(layouts[0], result, "a derivative"))

    with uncollected(), recording("derivative", here()) as context:
        recorded = record_body(context, {}, None, body)
    if recorded.params:
        raise RecordError(
            f"a derivative outside of a program does not follow the Param {next(iter(recorded.params))}",
            loc=here(),
            cure="the derivative inside of a program, or the Param's value, p.value",
        )
    arrays = Kernel.on(recorded, "numpy", Options())()
    classes = [cls for _, _, cls in leaves(layouts[0], "")]
    values = [cls(*([array] if cls.size == 1 else array)) for cls, array in zip(classes, arrays, strict=True)]
    return build_values(layouts[0], iter(values))
