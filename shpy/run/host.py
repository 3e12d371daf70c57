"""Check, broadcast and flatten the arrays that a kernel reads, and give the arrays that it writes their shape.

Stage: run. A stream of N-tuples is an array (*S, N), and (*S,) where N = 1; the element shapes S of all inputs
broadcast. Everything is checked before anything runs.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyTypeError
from shpy.ir.constants import decode, dtypes_at
from shpy.ir.types import Base
from shpy.lang.data.tables import Table, TableType, fits
from shpy.lang.data.textures import Texture2D, TextureType
from shpy.lang.programs.record import InputType, RecordedProgram
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Group, Layout, annotation_of, entries_of, flatten, leaves, spoken_type
from shpy.lang.values.value import Value, with_article
from shpy.streams.elements import InputLeaf, Shape, given_shape

_MAX_RANK = 31
"""The most axes of S: numpy broadcasts 32, and the components may take one of them."""
_COMPILE_OPTIONS = ("backend", "device", "precision", "math", "fuse", "lanes", "loop_limit")
_RUN_OPTIONS = ("out", "where")


def uniforms(params: Mapping[str, Any], precision: str, math: str) -> dict[str, NDArray[Any]]:
    """Return the value of each Param and dependent uniform for a kernel of this precision and mode."""
    dtypes = dtypes_at(precision)
    with np.errstate(over="ignore"):  # as data are rounded
        return {name: np.asarray(p.at(precision, math), dtypes[p.base]) for name, p in params.items()}


def bind(recorded: RecordedProgram, args: Sequence[Any], named: Mapping[str, Any]) -> dict[str, Any]:
    """Return the value of each input: the one that the caller gave by position or keyword, or else its default.

    Raises ShpyTypeError for missing and unknown inputs.
    """
    types, what = recorded.inputs, recorded.module.name
    names = list(types)
    signature = f"{what}({', '.join(names)})"
    if len(args) > len(names):
        raise ShpyTypeError(f"{what} takes {len(names)} inputs, not {len(args)}", loc=here(), cure=signature)
    values = dict(zip(names, args, strict=False))
    for name, value in named.items():
        if name not in types or name in values:
            wrong = "is given twice" if name in values else "is no input"
            compiled = name in _COMPILE_OPTIONS and name not in types
            cure = f"{what}.compile({name}={value!r})({', '.join(names)})" if compiled else signature
            if name in _RUN_OPTIONS:
                cure = f"{what}.compile().run({', '.join((*names, f'{name}={name}'))})"
            raise ShpyTypeError(f"{name} {wrong} of {what}", loc=here(), cure=cure)
        values[name] = value
    values = {**{n: d for n, d in recorded.defaults.items() if n not in values}, **values}
    missing = [n for n in names if n not in values]
    if missing:
        raise ShpyTypeError(f"{what} lacks its input {', '.join(missing)}", loc=here(), cure=signature)
    return values


class InputSize(Protocol):
    """A leaf of an input with its name, number of components and element shape, which checks of shapes need."""

    @property
    def name(self) -> str:
        """The name of the leaf."""

    @property
    def size(self) -> int:
        """The number of components."""

    @property
    def shape(self) -> Shape:
        """The shape of the elements."""


class DeviceLeaf:
    """One leaf of an input that lies in a stream: `entry` has its memory and its element shape."""

    def __init__(self, name: str, cls: type[Value], entry: Any) -> None:
        self.name = name
        self.cls: Any = cls
        self.size = cls.size
        self.entry = entry
        self.shape: Shape = entry.shape
        if entry.memory.type is not cls.type:
            raise ShpyTypeError(
                f"{name} is {with_article(cls)}, {cls.type!r}, and {entry.stream!r} holds {entry.memory.type!r}",
                loc=here(),
                cure=f"sh.Stream(array, sh.{cls.__name__})",
            )


def exact(data: Any, precision: str, math: str) -> Any:
    """Return the unrounded numbers of a Param or another constant, since a kernel of f64 uses all their digits."""
    if isinstance(data, Value) and data._uniform:
        return data.at(precision, math)
    if isinstance(data, Value) and data._frame is None:
        numbers = decode(data.type, data._const)
        return numbers if len(numbers) > 1 else numbers[0]
    return data


def streams(
    types: Mapping[str, InputType], values: Mapping[str, Any], precision: str, math: str = "strict"
) -> list[InputLeaf]:
    """Return the inputs that are arrays of the host, as `inputs` does, without those that are streams."""
    return [leaf for leaf in inputs(types, values, precision, math) if isinstance(leaf, InputLeaf)]


def inputs(
    types: Mapping[str, InputType], values: Mapping[str, Any], precision: str, math: str = "strict"
) -> list[InputLeaf | DeviceLeaf]:
    """Return the array inputs, leaf by leaf in the entry's order; dependent uniforms are computed in mode `math`."""
    entries: list[InputLeaf | DeviceLeaf] = []
    dtypes = dtypes_at(precision)
    for name, type_ in types.items():
        if isinstance(type_, TableType | TextureType):
            continue
        paths = list(leaves(type_, name))
        for entry, (leaf, _, cls) in zip(entries_of_input(type_, values[name], name), paths, strict=True):
            if hasattr(entry, "memory"):
                entries.append(DeviceLeaf(leaf, cls, entry))
            else:
                entries.append(InputLeaf(leaf, cls, exact(entry, precision, math), dtypes[cls.base]))
    return entries


def entries_of_input(layout: Layout, value: Any, what: str) -> list[Any]:
    """Return the entry of each leaf: an array, a number, or the leaf of a stream with its memory."""
    if not hasattr(value, "leaf_entries"):
        if not isinstance(layout, Group):
            return flatten(layout, value, what)
        parts = zip(layout.names, layout.parts, entries_of(value, layout.form, layout.names, what), strict=True)
        return [leaf for name, part, entry in parts for leaf in entries_of_input(part, entry, f"{what}.{name}")]
    entries, fields = value.leaf_entries(), list(leaves(layout, what))
    if len(entries) != len(fields):
        listed = ", ".join(path for path, _, _ in fields)
        raise ShpyTypeError(
            f"{what} has the parts {listed}, and {value!r} has others",
            loc=here(),
            cure=f"a stream of {annotation_of(layout)}",
        )
    return list(entries)


def common_shape(inputs: Sequence[InputSize], shape: Any) -> Shape:
    """Return the element shape S: `shape` if given, to which the inputs must broadcast, else their broadcast shape."""
    shapes = [s.shape for s in inputs]
    target_shape = None if shape is None else given_shape(shape)
    for name, extents in [*((s.name, s.shape) for s in inputs), ("shape", target_shape or ())]:
        if len(extents) > _MAX_RANK:
            raise ShpyTypeError(
                f"{name} has {len(extents)} axes of elements, and a run {_MAX_RANK} at most",
                loc=here(),
                cure="x.reshape(-1), or x.reshape(-1, N) where an element has N components",
            )
    try:
        common = _broadcast(shapes)
        whole = common if target_shape is None else _broadcast([common, target_shape])
    except ValueError as error:
        listed = ", ".join(
            [*(f"{s.name} {s.shape}" for s in inputs), *([f"shape={target_shape}"] if target_shape else [])]
        )
        raise ShpyTypeError(
            f"the element shapes do not broadcast: {listed}", loc=here(), cure="shapes as numpy's rules join them"
        ) from error
    if target_shape is not None and whole != target_shape:
        raise ShpyTypeError(
            f"the inputs have the element shape {common}, which is not shape={target_shape}",
            loc=here(),
            cure="leave shape= away, or give inputs that broadcast to it",
        )
    return whole


def _broadcast(shapes: Sequence[Shape]) -> Shape:
    """Return the shape that these broadcast to, or raise ValueError. numpy's function refuses large products."""
    rank = max(map(len, shapes), default=0)
    whole = []
    for axis in range(-rank, 0):
        extents = {s[axis] for s in shapes if len(s) >= -axis} - {1}
        if len(extents) > 1:
            raise ValueError
        whole.append(extents.pop() if extents else 1)
    return tuple(whole)


def tables(types: Mapping[str, InputType], values: Mapping[str, Any], closure: Mapping[str, Any]) -> dict[str, Table]:
    """Return all tables, by their names in the module: those of the closure and those given as inputs."""
    tables_by_name = {name: table for name, table in closure.items() if not table.is_argument}
    for name, type_ in types.items():
        if isinstance(type_, TableType | TextureType):
            tables_by_name |= table_of(name, type_, values[name]).leaves(name)
    return tables_by_name


def table_of(name: str, type_: TableType | TextureType, value: Any) -> Table:
    """Return the value of an input as a Table, that of a texture for one; ShpyTypeError where it does not fit."""
    if isinstance(type_, TextureType):
        texture = value if isinstance(value, Texture2D) else Texture2D(value)
        if texture.type.type is not type_.cls.type:
            raise ShpyTypeError(
                f"{name} is a Texture2D[{type_.cls.__name__}], and this one holds {texture.type.__name__}",
                loc=here(),
                cure=f"an array (h, w, {type_.cls.size})",
            )
        return texture.table
    table = value if isinstance(value, Table) else Table(value, type_.cls, name)
    if not fits(table, type_):
        raise ShpyTypeError(
            f"{name} is a Table[{type_.cls.__name__}, {type_.rank}], "
            f"and this one a Table[{table.type.__name__}, {table.rank}]",
            loc=here(),
            cure=f"sh.Table(array, {spoken_type(type_.cls)}) with {type_.rank} axes",
        )
    return table


class OutputTarget:
    """One leaf of the outputs: the user's array, if there is one, and the contiguous array that the kernel writes."""

    def __init__(
        self, cls: type[Value], dtype: Any, shape: Shape, destination: NDArray[Any] | None, zeros: bool
    ) -> None:
        tail = (cls.size,) if cls.size > 1 else ()
        self.destination = destination
        direct = destination is not None and destination.flags.c_contiguous
        if destination is None:
            self.array: NDArray[Any] = (np.zeros if zeros else np.empty)(shape + tail, dtype)
        else:
            self.array = destination if direct else np.ascontiguousarray(destination)
        self.flat = self.array.reshape((-1, *tail))

    def finish(self) -> None:
        """Copy the results into the user's `out` array if that is not contiguous; a contiguous one has them already."""
        if self.destination is not None and self.destination is not self.array:
            self.destination[...] = self.array


def targets(layout: Layout, dtypes: Mapping[Base, Any], shape: Shape, out: Any, *, zeros: bool) -> list[OutputTarget]:
    """Return the arrays to write, leaf by leaf; with `zeros`, new ones are filled with zeros.

    Raises ShpyTypeError where `out` has another dtype or shape.
    """
    classes = list(leaves(layout, "out"))
    arrays: Iterator[Any] = iter(flatten(layout, out, "out") if out is not None else [None] * len(classes))
    results = []
    for (name, _, cls), array in zip(classes, arrays, strict=True):
        expected = shape + ((cls.size,) if cls.size > 1 else ())
        dtype = np.dtype(dtypes[cls.base])
        if out is not None and not (isinstance(array, np.ndarray) and array.dtype == dtype and array.shape == expected):
            spoken = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
            raise ShpyTypeError(
                f"{name} is {spoken}, not {dtype} {expected}", loc=here(), cure=f"np.zeros({expected}, np.{dtype})"
            )
        if out is not None and not array.flags.writeable:
            raise ShpyTypeError(f"{name} is read only", loc=here(), cure="an array of your own, array.copy()")
        results.append(OutputTarget(cls, dtype, shape, array, zeros))
    if out is not None:
        _check_apart(
            [
                (name, t.destination)
                for (name, _, _), t in zip(classes, results, strict=True)
                if t.destination is not None
            ]
        )
    return results


def bytes_each(inputs: Sequence[InputLeaf], output: Layout, dtypes: Mapping[Base, Any]) -> int:
    """Return the bytes of one element in all inputs and outputs on the host."""
    outputs: list[int] = [cls.size * np.dtype(dtypes[cls.base]).itemsize for _, _, cls in leaves(output, "out")]
    return sum(outputs) + sum(s.size * s.array.itemsize for s in inputs)


def _check_apart(outputs: Sequence[tuple[str, NDArray[Any]]]) -> None:
    """Raise ShpyTypeError if elements of `out` share memory: only the last one written would stay."""
    for name, array in outputs:
        if _overlaps_itself(array):
            raise ShpyTypeError(
                f"elements of {name} share memory: its strides are {array.strides}",
                loc=here(),
                cure="an array of your own, array.copy()",
            )
    for (one, first), (other, second) in itertools.combinations(outputs, 2):
        if np.shares_memory(first, second):
            raise ShpyTypeError(
                f"{one} and {other} share memory, and each output needs its own",
                loc=here(),
                cure=f"np.zeros({second.shape}, np.{second.dtype}) for {other}",
            )


def _overlaps_itself(array: NDArray[Any]) -> bool:
    """Return whether two elements may share memory; False for slices and transposes of a contiguous array."""
    reach = array.itemsize
    for stride, extent in sorted((abs(s), n) for s, n in zip(array.strides, array.shape, strict=True) if n > 1):
        if stride < reach:
            return array.size > 0
        reach = stride * extent
    return False
