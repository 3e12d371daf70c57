"""Uniforms: Param, a value that is the same for all elements and may change between runs.

Stage: record. Used by closure. Outside a program, operators on Params give uniforms, too: see `dependent.py`.

    sky = sh.Param(sh.Color3f, (0.2, 0.4, 1), name="sky")
    sky.value = (1, 1, 1)      # between runs
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, NoReturn

import numpy as np

from shpy.errors import RecordError, ShpyError, ShpyTypeError
from shpy.ir.constants import decode, to_array
from shpy.ir.metadata import NOTHING, About
from shpy.ir.names import free
from shpy.ir.types import Base
from shpy.lang.data.hostdata import as_base
from shpy.lang.recording.emit import DEFERRED, Emitter, Handle, wide
from shpy.lang.recording.location import here
from shpy.lang.recording.names import assigned_name
from shpy.lang.recording.recorder import Frame, current_frame
from shpy.lang.values import arithmetic, coerce
from shpy.lang.values.dependent import Dependent, set_between_runs
from shpy.lang.values.matrix import Matrix
from shpy.lang.values.snapshot import Same
from shpy.lang.values.structure import Group, Layout, Leaf, Rows, build_arrays, entries_of, layout_of, leaves, outside
from shpy.lang.values.value import CLASSES, Value


class Param:
    """`Param(type, value, name=None)`: a uniform, used like a value of `type`; set `.value` between runs.

    The type may be a matrix or a struct. The name defaults to the Python name that it is assigned to. `range=(low,
    high)` bounds each component, ends included; `step`, `title` and `description` are for pages and viewers, which show
    no control of a Param with `title=""`.
    Raises ShpyTypeError, naming the Param, for a value that does not fit the type or lies outside the range.
    """

    named: bool
    _name: str | None
    _about: About

    def __new__(
        cls,
        type_: Any,
        value: Any,
        name: str | None = None,
        *,
        range: tuple[float, float] | None = None,
        step: float | None = None,
        title: str | None = None,
        description: str | None = None,
    ) -> Any:
        """Make an object that is both a Param and a value, matrix or struct of `type_`."""
        python_name = name if name is not None else assigned_name()
        layout = _layout(type_)
        about = _about(layout, range, step, title, description, _called(python_name))
        if isinstance(layout, Leaf):
            return _param(layout.cls, value, python_name, name is not None, about)
        entries = _leaf_entries(layout, value, _called(python_name))
        parts = [
            _param(leaf, entry, path, name is not None, NOTHING)
            for (path, _, leaf), entry in zip(leaves(layout, python_name or "param"), entries, strict=True)
        ]
        return _owning(layout, python_name or "param", about, parts)

    @classmethod
    def declared(cls, type_: type[Value], value: Any, name: str, about: About) -> Any:
        """Make the Param that a verified module declares."""
        return _param(type_, value, name, True, about)

    @property
    def name(self) -> str | None:
        """The name, or None where none is known before the program is recorded."""
        return self._name

    @property
    def range(self) -> tuple[float, float] | None:
        """The least and the greatest value of a component, or None."""
        return self._about.range

    @property
    def step(self) -> float | None:
        """The distance between the values that a viewer offers, or None."""
        return self._about.step

    @property
    def title(self) -> str | None:
        """The title in a viewer, or None."""
        return self._about.title

    @property
    def description(self) -> str | None:
        """The description in a viewer, or None."""
        return self._about.description


def _called(name: str | None) -> str:
    return f"the Param {name}" if name else "a Param"


def _layout(type_: Any) -> Layout:
    """Return the layout of a Param's type: a scalar, vector, matrix or struct."""
    try:
        layout = layout_of(type_, "a Param")
    except ShpyTypeError:
        layout = None
    if layout is None or (isinstance(layout, Group) and layout.form != "struct"):
        raise ShpyTypeError(
            f"a Param cannot be a {type_!r}",
            loc=here(),
            cure="sh.Param(sh.Color3f, (1, 1, 1)), a matrix or a @sh.struct",
        )
    if isinstance(layout, Group) and "value" in layout.names:
        raise ShpyTypeError(
            f"{type_.__name__} has a field named value, which is what a Param's value is set by",
            loc=here(),
            cure="another name for the field",
        )
    return outside(layout, "a Param")


def _about(layout: Layout, bounds: Any, step: Any, title: Any, description: Any, what: str) -> About:
    """Return the metadata; ShpyTypeError where it is malformed."""

    def refuse(message: str, cure: str) -> NoReturn:
        raise ShpyTypeError(f"{what}: {message}", loc=here(), cure=cure)

    for word, text in (("title", title), ("description", description)):
        if not (text is None or isinstance(text, str)):
            refuse(f"{word}={text!r} is no text", f'{word}="Gain"')
    pair = isinstance(bounds, tuple | list) and len(bounds) == 2 and all(map(_is_number, bounds))
    if not (bounds is None or pair):
        refuse(f"range={bounds!r} is no pair of numbers, the lower first", "range=(0, 1)")
    if not (step is None or _is_number(step)):
        refuse(f"step={step!r} is no positive number", "step=0.1")
    about = About(
        None if bounds is None else (_plain(bounds[0]), _plain(bounds[1])),
        None if step is None else _plain(step),
        title,
        description,
    )
    type_ = layout.cls.type if isinstance(layout, Leaf) else None
    fault = about.fault(type_)
    if fault:
        single = type_ is not None and not type_.is_bool
        cure = "a Param of its own for the number that is bounded"
        refuse(fault, cure if not single else "step=0.1" if fault.startswith("step") else "range=(0, 1)")
    return about


def _plain(x: Any) -> float:
    """Return a number as a Python int or float that the text of the IR can hold."""
    return int(x) if isinstance(x, int | np.integer) and -(2**53) <= int(x) <= 2**53 else float(x)


def _is_number(x: Any) -> bool:
    constant = coerce.literal(x)
    if constant is None or constant.weak == "bool":
        return False
    number = constant.components[0]
    return bool(number == number and (constant.weak == "float" or abs(number) < 2**1000))


def _param(type_: type[Value], value: Any, name: str | None, named: bool, about: About) -> Any:
    param = _unset(type_, name, named, about)
    param.value = value
    return param


def _unset(type_: type[Value], name: str | None, named: bool, about: About, const: tuple[int, ...] = ()) -> Any:
    param: Any = object.__new__(_class_of(type_))  # type: ignore[arg-type]
    slots = {"_frame": None, "_variable": -1, "_part": None, "_loc": here(), "_name": name, "named": named}
    for slot, start in {**slots, "_about": about, "_owner": None, "_const": const}.items():
        object.__setattr__(param, slot, start)
    return param


@lru_cache(maxsize=128)
def _class_of(type_: Any) -> type:
    """Return the class of the Params of a scalar or vector type."""
    return type(type_.__name__, (_ValueParam, type_), {})


class _MadeParam(Param):
    """A Param as `sh.Param` makes it: its class is not called."""

    def __new__(cls, *args: Any, **named: Any) -> Any:
        raise RecordError("a Param is made by sh.Param", loc=here())

    def __init__(self, *args: Any, **named: Any) -> None:
        pass


class _ValueParam(_MadeParam):
    """A Param of a scalar or vector type."""

    _uniform = True
    _owner: Any

    def __reduce__(self) -> Any:
        if self._owner is not None:
            place = next(k for k, leaf in enumerate(self._owner._leaves) if leaf is self)
            return _leaf_of, (self._owner, place)
        return _unset, self._state()

    def _state(self) -> tuple[Any, ...]:
        cls = CLASSES[self.kind, self.size, self.base]  # type: ignore[attr-defined]
        return cls, self._name, self.named, self._about, self._const  # type: ignore[attr-defined]

    @property
    def exact(self) -> Any:
        """The present value as binary64, a float or a tuple of floats: a kernel rounds it to its own precision."""
        numbers = decode(self.type, self._const)  # type: ignore[attr-defined]
        return numbers if len(numbers) > 1 else numbers[0]

    def at(self, precision: str, math: str) -> Any:
        """Return the value for a kernel, exactly; a Param has the same value in all precisions and modes."""
        return self.exact

    @property
    def value(self) -> Any:
        """The present value: a numpy scalar or a read-only array of shape (size,)."""
        array = to_array(self.type, self._const)  # type: ignore[attr-defined]
        array.flags.writeable = False  # a store into it would not reach the Param
        return array[()] if array.ndim == 0 else array

    @value.setter
    def value(self, value: Any) -> None:
        object.__setattr__(self, "_const", self._constant(value))

    def _constant(self, value: Any) -> tuple[int, ...]:
        """Return the value as a constant; ShpyTypeError, naming the Param, where an input would refuse it as well."""
        cls = CLASSES[self.kind, self.size, self.base]  # type: ignore[attr-defined]
        constant = constant_of(cls, value, _called(self._name))
        number = self._about.outside(decode(cls.type, constant))
        if number is not None and self._about.range is not None:
            low, high = self._about.range
            raise ShpyTypeError(
                f"{_called(self._name)}: {number} is outside of its range, {low} to {high}",
                loc=here(),
                cure="a value in range, or a Param with another range=(low, high)",
            )
        return constant

    def _read(self, emitter: Emitter) -> Handle:
        frame = current_frame()
        if frame is None:
            assert emitter is DEFERRED
            return emitter.let("param", (), self.type, self)  # type: ignore[attr-defined]
        name = frame.recording.use("param", frame.recording.params, self)
        return emitter.let("param", (), self.type, name)  # type: ignore[attr-defined]

    def _called(self) -> str:
        return self._name or "a Param"

    def _storable(self, spelled: str) -> Frame:
        raise RecordError(
            f"{self._called()} is a Param: the same for all elements, and not stored into by a program",
            loc=here(),
            cure=f"{set_between_runs(self._name)}, or a copy, y = x.copy()",
        )


def constant_of(cls: type[Value], value: Any, what: str) -> tuple[int, ...]:
    """Return a host value as a constant of `cls`; ShpyTypeError, naming `what`, where an input would refuse it."""
    try:
        parts = arithmetic.parts(cls, value)
        if any(isinstance(p, Value) and p._frame is not None for p in parts):
            raise RecordError("its value is set between runs", loc=here(), cure="a number")
        flat = [p if isinstance(p, coerce.Literal) else _literal_of(p) for p in parts]
        for part in flat:
            coerce.check_base(part, cls.base)
        return arithmetic.constant(cls.type, flat, cls)
    except ShpyError as error:
        raise type(error)(f"{what}: {error.message}", loc=error.loc, cure=error.cure) from error


def _literal_of(value: Value) -> coerce.Literal:
    weak = "float" if value.type.is_float else "bool" if value.type.is_bool else "int"
    is_wide = not value._uniform and value.base is Base.F  # kept in binary64 until the precision is known
    numbers = decode(value.type, wide(value._const)) if is_wide else np.atleast_1d(value._now()).tolist()
    return coerce.Literal(weak, tuple(numbers))


# Matrices and structs


class _CompoundParam(_MadeParam):
    """A Param of a matrix or struct: one Param a leaf."""

    _layout: Layout
    _leaves: tuple[_ValueParam, ...]

    def __reduce__(self) -> Any:
        return _whole, (self._layout, self._name, self._about, [leaf._state() for leaf in self._leaves])

    @property
    def value(self) -> Any:
        """The present value: an array (N, N), or a named tuple of the fields' values."""
        return _read_only(build_arrays(self._layout, (leaf.value for leaf in self._leaves)))

    @value.setter
    def value(self, value: Any) -> None:
        entries = _leaf_entries(self._layout, value, _called(self._name))
        constants = [leaf._constant(entry) for leaf, entry in zip(self._leaves, entries, strict=True)]
        for leaf, constant in zip(self._leaves, constants, strict=True):  # assigned only after all have been checked
            object.__setattr__(leaf, "_const", constant)

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "value":
            object.__setattr__(self, name, value)
        else:
            super().__setattr__(name, value)


def _read_only(value: Any) -> Any:
    """Make the arrays of a value read-only: a store into one would not reach the Param."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    for part in value if isinstance(value, tuple) else ():
        _read_only(part)
    return value


def _compound(layout: Layout, parts: Iterator[Any], name: str, about: About = NOTHING) -> Any:
    """Return the Param of a matrix or struct with these leaves, or the leaf itself."""
    if isinstance(layout, Leaf):
        return next(parts)
    fields: dict[str, Any]
    if isinstance(layout, Rows):
        rows = tuple(next(parts) for _ in range(layout.cls.size))
        flat, fields = list(rows), {"rows": rows}
    else:
        inner = zip(layout.names, layout.parts, strict=True)
        fields = {n: _compound(part, parts, f"{name}.{n}") for n, part in inner}
        flat = [leaf for field in fields.values() for leaf in getattr(field, "_leaves", (field,))]
    cls = _compound_class(layout.cls, tuple(fields))  # type: ignore[arg-type]
    compound: Any = object.__new__(cls)
    for attribute, value in (("_name", name), ("_about", about), ("_layout", layout), ("_leaves", tuple(flat))):
        object.__setattr__(compound, attribute, value)
    for attribute, value in fields.items():
        if hasattr(Param, attribute):
            vars(compound)[attribute] = value
        else:
            object.__setattr__(compound, attribute, value)
    return compound


@lru_cache(maxsize=256)
def _compound_class(type_: Any, fields: tuple[str, ...]) -> type:
    """Return the class of the Params of a matrix or struct type.

    A field called `range`, say, comes before what a Param has of that name.
    """
    hidden = {n: property(_reader(n)) for n in fields if hasattr(Param, n)}
    return type(type_.__name__, (_CompoundParam, type_), hidden)


def _owning(layout: Layout, name: str, about: About, parts: list[Any]) -> Any:
    whole = _compound(layout, iter(parts), name, about)
    for part in parts:
        object.__setattr__(part, "_owner", whole)
    return whole


def _whole(layout: Layout, name: str, about: About, states: list[tuple[Any, ...]]) -> Any:
    """Return the Param that another process sent."""
    return _owning(layout, name, about, [_unset(*state) for state in states])


def _leaf_of(owner: Any, place: int) -> Any:
    return owner._leaves[place]


def _reader(name: str) -> Callable[[Any], Any]:
    return lambda self: vars(self)[name]


def _leaf_entries(layout: Layout, value: Any, what: str) -> list[Any]:
    """Take a Param's value apart: structs by fields, matrices by rows."""
    match layout:
        case Leaf():
            return [value]
        case Rows(cls):
            return list(_matrix_rows(cls, value, what))
        case Group(form, names, parts):
            entries = zip(names, parts, entries_of(value, form, names, what), strict=True)
            return [leaf for n, part, entry in entries for leaf in _leaf_entries(part, entry, f"{what}.{n}")]


def _matrix_rows(cls: Any, value: Any, what: str) -> Sequence[Any]:
    """Return the rows of a matrix Param's value: of a matrix, or of an array (N, N)."""
    if isinstance(value, Matrix) and value.size == cls.size:
        return value.rows
    array = as_base(value, Base.F, what)
    if array.shape != (cls.size, cls.size):
        raise ShpyTypeError(
            f"{what} is a {cls.__name__} and takes an array ({cls.size}, {cls.size}), not {array.shape}",
            loc=here(),
            cure=f"sh.{cls.__name__}(row0, row1, …), or an array of {cls.size} rows",
        )
    return list(array)


# What a program has


def listed(params: Mapping[str, Any]) -> dict[str, Any]:
    """Return a program's uniforms as the user made them: matrices and structs whole, sources of dependent ones."""
    uniforms: dict[str, Any] = {}

    def enter(name: str, uniform: Any) -> None:
        owner = getattr(uniform, "_owner", None)
        if owner is not None:
            path = (uniform.name or "").removeprefix(owner._name)
            name, uniform = name.removesuffix(path), owner
        if any(uniform is other for other in uniforms.values()):
            return
        uniforms[free(name, uniforms)] = uniform

    for name, uniform in params.items():
        enter(name, uniform)
    for uniform in params.values():
        for source in uniform.sources if isinstance(uniform, Dependent) else ():
            if isinstance(source, Param):
                enter(source.name or "param", source)
    return uniforms


def constants_for(name: str, uniform: Any, value: Any) -> dict[Same, tuple[int, ...]]:
    """Return the constants that fix a uniform of a program, by leaf."""
    if isinstance(uniform, _CompoundParam):
        entries = _leaf_entries(uniform._layout, value, name)
        return {Same(leaf): leaf._constant(entry) for leaf, entry in zip(uniform._leaves, entries, strict=True)}
    if isinstance(uniform, _ValueParam):
        return {Same(uniform): uniform._constant(value)}
    return {Same(uniform): constant_of(CLASSES[uniform.kind, uniform.size, uniform.base], value, name)}
