"""Structure: how matrices, structs, tuples and the like are made of plain values, and put together again.

Stage: record. A `Layout` is the shape of an input or output as the user wrote it; its leaves are the scalars and
vectors that the IR knows. The same layout takes apart and puts together values while recording, and arrays at run time.

    @sh.struct
    class Ray:
        o: sh.Point3f
        d: sh.Vector3f

    ports(layout_of(Ray), "ray")   # ray.o Point3f, ray.d Vector3f
"""

from __future__ import annotations

import functools
import importlib
import sys
import typing
from collections import namedtuple
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar, NoReturn

import numpy as np

from shpy.errors import RecordError, ShpyAttributeError, ShpyTypeError
from shpy.ir.types import WIDEST_PORT
from shpy.lang.recording.location import here
from shpy.lang.recording.recorder import Frame, current_frame
from shpy.lang.recording.symbolic import Symbolic
from shpy.lang.values import arithmetic
from shpy.lang.values.coerce import literal
from shpy.lang.values.dependent import name_parts
from shpy.lang.values.matrix import Matrix, rows_of_array
from shpy.lang.values.value import CLASSES, Value


@dataclass(frozen=True, slots=True)
class Leaf:
    """One value of a class of the language."""

    cls: type[Value]


@dataclass(frozen=True, slots=True)
class Rows:
    """A matrix, as its rows."""

    cls: type[Matrix]


@dataclass(frozen=True, slots=True)
class Group:
    """Named parts. `form` is "struct", "namedtuple", "tuple", "list" or "dict"; `cls` the class of the first two."""

    form: str
    names: tuple[str, ...]
    parts: tuple[Layout, ...]
    cls: Any = None

    def __reduce__(self) -> Any:
        where = None if self.cls is None else (self.cls.__module__, self.cls.__qualname__)
        return _group, (self.form, self.names, self.parts, where)

    def __deepcopy__(self, memo: Any) -> Group:
        return self


Layout = Leaf | Rows | Group


def layout_of(annotation: Any, name: str) -> Layout:
    """Return the layout that an annotation names; ShpyTypeError for anything that is no type of the language."""
    if isinstance(annotation, type):
        if issubclass(annotation, Value) and hasattr(annotation, "kind"):
            return Leaf(annotation)
        if issubclass(annotation, Matrix) and hasattr(annotation, "size"):
            return Rows(annotation)
        fields = getattr(annotation, "_shpy_fields", None)
        if fields is not None:
            parts = tuple(layout_of(t, f"{name}.{f}") for f, t in fields.items())
            return Group("struct", tuple(fields), parts, getattr(annotation, "_shpy_class", annotation))
        if issubclass(annotation, tuple) and hasattr(annotation, "_fields"):
            hints = typing.get_type_hints(annotation)
            parts = tuple(layout_of(hints[f], f"{name}.{f}") for f in annotation._fields)
            return Group("namedtuple", tuple(annotation._fields), parts, annotation)
    if typing.get_origin(annotation) is tuple:
        parts = tuple(layout_of(a, f"{name}[{i}]") for i, a in enumerate(typing.get_args(annotation)))
        return Group("tuple", tuple(map(str, range(len(parts)))), parts)
    written = f"{name}: " if name.isidentifier() else ""
    cure = f"{written}sh.Attrib1f, or another type of shpy, a @sh.struct, a NamedTuple of types"
    if isinstance(annotation, tuple | list) and annotation:
        several = ", ".join(f"sh.{getattr(part, '__name__', 'Attrib1f')}" for part in annotation)
        cure = f"{written}tuple[{several}]"
    message = f"{name} is annotated {annotation!r}, which is no type of the language"
    raise ShpyTypeError(message, loc=here(), cure=cure)


def outside(layout: Layout, name: str) -> Layout:
    """Return the layout of data that a program takes or gives; ShpyTypeError where it has vectors of eight."""
    for path, _, cls in leaves(layout, name):
        if cls.size > WIDEST_PORT:
            text = f"{path} is an {cls.__name__}, and vectors of eight live inside of programs"
            pair = f"sh.{cls.__name__.replace('8', '4')}"
            raise ShpyTypeError(text, loc=here(), cure=f"two of {pair}, and sh.{cls.__name__}(a, b) inside")
    return layout


def layout_from(value: Any, what: str) -> Layout:
    """Return the layout of a value that a function gives back."""
    if isinstance(value, Value):
        return Leaf(CLASSES[value.kind, value.size, value.base])
    if isinstance(value, Matrix):
        return Rows(value._plain())
    fields = getattr(type(value), "_shpy_fields", None)
    if fields is not None:
        return layout_of(type(value), what)
    constant = literal(value)
    if constant is not None:
        base = {"int": "i", "float": "f", "bool": "b"}[constant.weak]
        return Leaf(CLASSES["Attrib", 1, base])  # type: ignore[index]
    if isinstance(value, dict):
        for unnamed in (key for key in value if not isinstance(key, str)):
            raise RecordError(
                f"{what} gives back a dict with the key {unnamed!r}, and the keys are the names of outputs",
                loc=here(),
                cure=f"{str(unnamed)!r}: …",
            )
        return Group("dict", tuple(value), tuple(layout_from(v, what) for v in value.values()))
    if isinstance(value, tuple | list) and value:
        parts = tuple(layout_from(v, what) for v in value)
        if hasattr(value, "_fields"):
            return Group("namedtuple", tuple(value._fields), parts, type(value))
        return Group("list" if isinstance(value, list) else "tuple", tuple(map(str, range(len(parts)))), parts)
    raise RecordError(
        f"{what} gives back {type(value).__name__}, which is no value of the language",
        loc=here(),
        cure="values, numbers, matrices or structs, or a tuple of them",
    )


def type_of(layout: Layout) -> Any:
    """Return the type whose layout this is, as users annotate it."""
    match layout:
        case Leaf(cls) | Rows(cls):
            return cls
        case Group(cls=None, parts=parts):
            return tuple[tuple(map(type_of, parts))]  # type: ignore[misc]
        case Group(cls=cls):
            return cls


def annotation_of(layout: Layout) -> str:
    """Return an annotation that names the layout, as users write it."""
    match layout:
        case Leaf(cls) | Rows(cls):
            return f"sh.{cls.__name__}"
        case Group(form="tuple" | "list", parts=parts):
            return f"tuple[{', '.join(map(annotation_of, parts))}]"
        case Group(form=form, cls=cls):
            return form if cls is None else str(cls.__name__)


def spoken_type(type_: Any) -> str:
    """Return a type as users write it: `sh.Attrib1f`, or the name of their own struct."""
    return annotation_of(layout_of(type_, "a type"))


def leaves(layout: Layout, prefix: str) -> Iterator[tuple[str, str, type[Value]]]:
    """Yield the name, kind and class of each leaf: `ray.o`; `m[0]`, of kind `Matrix3f[0]`, for a row of a matrix."""
    match layout:
        case Leaf(cls):
            yield prefix, cls.__name__, cls
        case Rows(cls):
            for r in range(cls.size):
                yield f"{prefix}[{r}]", f"{cls.__name__}[{r}]", cls._row_type()
        case Group(_, names, parts):
            for name, part in zip(names, parts, strict=True):
                yield from leaves(part, f"{prefix}.{name}" if prefix else name)


def build(layout: Layout, values: Iterator[Any], rows: Callable[[Any, list[Any]], Any]) -> Any:
    """Put leaves together; `rows(cls, list)` makes a matrix."""
    match layout:
        case Leaf():
            return next(values)
        case Rows(cls):
            return rows(cls, [next(values) for _ in range(cls.size)])
        case Group(form, names, parts, cls):
            members = [build(part, values, rows) for part in parts]
            if form == "struct":
                return cls._of(dict(zip(names, members, strict=True)))
            if form == "namedtuple":
                return cls(*members)
            if form == "dict":
                return dict(zip(names, members, strict=True))
            return members if form == "list" else tuple(members)


def build_values(layout: Layout, values: Iterator[Value]) -> Any:
    """Put values together while recording: the values themselves, not copies."""
    return build(layout, values, lambda cls, rows: cls.of_rows(rows))


def built(frame: Frame, layout: Layout, results: Sequence[int]) -> Any:
    """Put values that `frame` has recorded, by their ids, together."""
    classes = [cls for _, _, cls in leaves(layout, "")]
    values = [arithmetic.make_value(c.kind, c.type, frame, r) for c, r in zip(classes, results, strict=True)]
    return build_values(layout, iter(values))


def build_arrays(layout: Layout, arrays: Iterator[Any]) -> Any:
    """Put the arrays of a run together: structs become named tuples, matrices (*S, N, N).

    A struct with a field that begins with an underscore, which no named tuple has, becomes a namespace.
    """
    if isinstance(layout, Group) and layout.form == "struct":
        members = [build_arrays(part, arrays) for part in layout.parts]
        if any(name.startswith("_") for name in layout.names):
            return SimpleNamespace(**dict(zip(layout.names, members, strict=True)))
        return namedtuple(layout.cls.__name__, layout.names)(*members)
    if isinstance(layout, Group):
        return build_group(layout, [build_arrays(part, arrays) for part in layout.parts])
    return build(layout, arrays, lambda cls, rows: np.stack(rows, axis=-2))


def build_group(layout: Group, parts: Sequence[Any]) -> Any:
    """Put the parts of a tuple, list, dict or named tuple together, each of them whole."""
    flat = Group(layout.form, layout.names, tuple(Leaf(Value) for _ in parts), layout.cls)
    return build(flat, iter(parts), lambda _, rows: rows)


def flatten(layout: Layout, value: Any, what: str) -> list[Any]:
    """Take a value, or an array or nest of arrays, apart into one entry a leaf, by the layout."""
    match layout:
        case Leaf():
            return [value]
        case Rows(cls):
            rows = value if isinstance(value, tuple | list) and current_frame() is not None else ()
            if any(isinstance(v, Value) for row in rows for v in (row if isinstance(row, tuple | list) else (row,))):
                value = cls.for_store(rows, what)
            if isinstance(value, Matrix):
                if value.size != cls.size:
                    raise ShpyTypeError(f"{what} is a {type(value).__name__}", loc=here(), cure=f"a {cls.__name__}")
                return list(value.rows)
            array = value if is_lazy(value) else np.asarray(value)  # Dask's arrays are not computed here
            return rows_of_array(array, cls, what)
        case Group(form, names, parts):
            entries = entries_of(value, form, names, what)
            return [leaf for part, entry in zip(parts, entries, strict=True) for leaf in flatten(part, entry, what)]


def is_lazy(data: Any) -> bool:
    """Return whether this is an array of Dask, in chunks that are computed when they are asked for."""
    return hasattr(data, "__dask_graph__") and hasattr(data, "chunks")


def entries_of(value: Any, form: str, names: tuple[str, ...], what: str) -> list[Any]:
    """Return the parts of a dict, tuple, structured array or object, ordered as `names`; ShpyTypeError for others."""
    fields = getattr(getattr(value, "dtype", None), "names", None)
    if fields is not None:
        entries = [value[n] for n in names] if set(fields) == set(names) else None
    elif isinstance(value, dict):
        entries = [value.get(n, None) for n in names] if set(value) == set(names) else None
    elif form in ("struct", "namedtuple") and all(hasattr(value, n) for n in names):
        entries = [getattr(value, n) for n in names]
    elif isinstance(value, tuple | list) and len(value) == len(names):
        entries = list(value)
    else:
        entries = None
    if entries is None:
        raise ShpyTypeError(
            f"{what} has the parts {', '.join(names)}, and {type(value).__name__} does not give just these",
            loc=here(),
            cure="a dict, tuple, structured array or object with these parts",
        )
    return entries


def is_value(x: object) -> bool:
    """Return whether `x` is a value, matrix or struct of the language."""
    return isinstance(x, Value | Matrix | Struct)


def leaves_of(value: Any) -> list[Value]:
    """Return the values that a value, matrix or struct is made of."""
    return [v for v in flatten(layout_from(value, "this"), value, "this") if isinstance(v, Value)]


def swap(a: Any, b: Any) -> None:
    """Exchange the contents of two values, matrices or structs in place."""
    if not (is_value(a) and is_value(b) and len(leaves_of(a)) == len(leaves_of(b))):
        text = f"sh.swap exchanges two values of one type, not {type(a).__name__} and {type(b).__name__}"
        raise ShpyTypeError(text, loc=here(), cure="two values, matrices or structs of one type")
    for x, y in zip(leaves_of(a), leaves_of(b), strict=True):
        kept = x.copy()
        x[:] = y
        y[:] = kept


# Structs


class Struct(Symbolic):
    """Base class of the classes that `@sh.struct` makes: attribute assignment stores in place."""

    _shpy_fields: ClassVar[dict[str, Any]]
    _shpy_class: ClassVar[Any]

    def __init__(self, *args: Any, **named: Any) -> None:
        fields = self._shpy_fields
        if len(args) > len(fields) or set(named) - set(fields) or set(named) & set(list(fields)[: len(args)]):
            raise ShpyTypeError(
                f"{type(self).__name__} takes the fields {', '.join(fields)}",
                loc=here(),
                cure=f"{type(self).__name__}({', '.join(fields)})",
            )
        values = dict(zip(fields, args, strict=False)) | named
        if values and len(values) != len(fields):
            missing = ", ".join(f for f in fields if f not in values)
            raise ShpyTypeError(f"{type(self).__name__} lacks {missing}", loc=here(), cure="every field, or none")
        for name, type_ in fields.items():
            what = f"{type(self).__name__}.{name}"
            object.__setattr__(self, name, _field(type_, values[name], what) if values else type_())
        frame = current_frame()
        paths = [path for path, _, _ in leaves(layout_of(type(self), ""), "")]
        if frame is not None:
            frame.name_parts({p: v._variable for p, v in zip(paths, leaves_of(self), strict=True)}, "{}.{}")
        else:
            name_parts({f".{p}": v for p, v in zip(paths, leaves_of(self), strict=True)})

    @classmethod
    def _plain(cls) -> Any:
        """Return the class that the user wrote: that of a Param is another."""
        return cls._shpy_class

    @classmethod
    def _of(cls, parts: dict[str, Any]) -> Any:
        instance = object.__new__(cls)
        for name, part in parts.items():
            object.__setattr__(instance, name, part)
        return instance

    __hash__ = object.__hash__

    def __eq__(self, other: object) -> Any:
        return self._compared("==", " & ") if current_frame() is not None else self is other

    def __ne__(self, other: object) -> Any:
        return self._compared("!=", " | ") if current_frame() is not None else self is not other

    def _compared(self, sign: str, join: str) -> NoReturn:
        """Refuse to compare structs while a program is recorded: Python would compare the objects, not the values."""
        fields = join.join(f"(a.{name} {sign} b.{name})" for name in self._shpy_fields)
        raise ShpyTypeError(f"{sign} cannot take {type(self).__name__}, a struct", loc=here(), cure=fields)

    def __reduce__(self) -> Any:
        return _struct_of, (layout_of(type(self), "struct"), {n: getattr(self, n) for n in self._shpy_fields})

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self._shpy_fields:
            cure = f"one of {', '.join(self._shpy_fields)}"
            raise ShpyAttributeError(f"{type(self).__name__!r} has no field {name!r}", loc=here(), cure=cure)
        if name not in vars(self):
            raise ShpyAttributeError(
                f"this {type(self).__name__} has no fields yet: super().__init__ makes them",
                loc=here(),
                cure=f"super().__init__({', '.join(self._shpy_fields)}) first",
            )
        field = getattr(self, name)
        if field is not value:
            field[:] = value
        else:  # `ray.o += d` stored already
            for leaf in leaves_of(field):
                leaf._storable("[:]")

    def __setitem__(self, key: Any, value: Any) -> None:
        if not (isinstance(key, slice) and key == slice(None)):
            raise ShpyTypeError("a struct is stored whole, or by field", loc=here(), cure="ray[:] = other; ray.o = p")
        entries = flatten(layout_of(type(self), "struct"), value, type(self).__name__)
        fresh = [_kept(entry) for entry in entries]  # all are read before the first store
        for old, new in zip(leaves_of(self), fresh, strict=True):
            old[:] = new

    def copy(self) -> Any:
        """Return a new struct with the same fields."""
        return self._plain()._of({n: getattr(self, n).copy() for n in self._shpy_fields})

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{n}={getattr(self, n)!r}' for n in self._shpy_fields)})"


def is_struct(type_: Any) -> bool:
    """Return whether this is a struct's class."""
    return isinstance(type_, type) and issubclass(type_, Struct)


def _field(type_: Any, value: Any, what: str) -> Any:
    """Return a field of a new struct: a copy, or for a struct one of the parts of a dict, tuple or other struct."""
    if not is_struct(type_):
        if issubclass(type_, Value):
            for part in arithmetic.parts(type_, value):
                arithmetic.check_width(part, type_.type, f"the field {what}")
            return type_(value)
        return type_.for_store(value, f"the field {what}")
    if isinstance(value, Struct) and value._plain() is type_._shpy_class:
        return value.copy()
    fields = type_._shpy_fields
    entries = entries_of(value, "struct", tuple(fields), what)
    return type_._of({n: _field(t, e, f"{what}.{n}") for (n, t), e in zip(fields.items(), entries, strict=True)})


def _kept(entry: Any) -> Any:
    """Return what a value holds now, also inside of a tuple or list."""
    if isinstance(entry, tuple | list):
        return [_kept(e) for e in entry]
    return entry.copy() if isinstance(entry, Value) else entry


def struct_class(cls: type, fields: dict[str, Any]) -> Any:
    """Return the struct of a class: a subclass with the same name, whose first base is that class."""
    body = {name: getattr(cls, name) for name in ("__doc__", "__module__", "__qualname__")}
    # With the user's class among the bases, super() in its methods finds the class behind it.
    subclass: Any = type(cls.__name__, (cls, Struct), {**body, "_shpy_fields": fields})
    subclass._shpy_class = subclass
    return subclass


# Layouts that another process sent


def _group(form: str, names: tuple[str, ...], parts: tuple[Layout, ...], where: tuple[str, str] | None) -> Group:
    """Return the layout with the user's class, where this process can import it, or else with one like it."""
    cls = None if where is None else _imported(*where)
    own = Group(form, names, parts, cls)
    if where is not None and not _describes(cls, own):
        own = Group(form, names, parts, _class_like(form, names, parts, *where))
    return own


def _imported(module: str, name: str) -> Any:
    """Return the class of this name; None where there is no such module or name, as on a machine without it."""
    try:
        value: Any = sys.modules[module] if module in sys.modules else importlib.import_module(module)
        for part in name.split("."):
            value = getattr(value, part)
    except (ImportError, AttributeError):
        return None
    return value


def _describes(cls: Any, group: Group) -> bool:
    """Return whether a class has the fields of a group; after a change of the user's module it may have others."""
    if group.form == "namedtuple" and not getattr(cls, "__annotations__", None):
        return getattr(cls, "_fields", None) == group.names
    try:
        return layout_of(cls, "") == group
    except ShpyTypeError:
        return False


@functools.lru_cache(maxsize=1024)
def _class_like(form: str, names: tuple[str, ...], parts: tuple[Layout, ...], module: str, name: str) -> Any:
    """Return a struct or NamedTuple of these parts: one class for the same parts and name."""
    types = {n: type_of(part) for n, part in zip(names, parts, strict=True)}
    plain = name.rpartition(".")[2]
    if form == "struct":
        return struct_class(type(plain, (), {"__module__": module}), types)
    make: Any = namedtuple
    cls = make(plain, names, rename=True, module=module)
    cls.__annotations__ = types
    return cls


def _struct_of(layout: Group, parts: dict[str, Any]) -> Any:
    return layout.cls._of(parts)
