"""Data that programs read: Param (a uniform), Table (random access), Texture2D (filtered).

Stage: record. Used by closure, or as arguments annotated `sh.Table[sh.Attrib4f, 2]`, `sh.Texture2D[sh.Color3f]`.

    sky = sh.Param(sh.Color3f, (0.2, 0.4, 1), name="sky")
    heights = sh.Table(np.zeros((64, 64)), sh.Attrib1f)
    heights[row, col]      # the nearest element where row or col is out of range
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from shpy.errors import RecordError, ShpyError, ShpyIndexError, ShpyTypeError
from shpy.ir.constants import decode, to_array
from shpy.ir.tabledata import TableData
from shpy.ir.types import Base, vec
from shpy.lang import arithmetic, coerce
from shpy.lang.emit import HOST, Emitter, FrameEmitter, Handle
from shpy.lang.hostdata import as_base
from shpy.lang.location import here
from shpy.lang.matrix import Matrix
from shpy.lang.names import name_for
from shpy.lang.recorder import Frame, current_frame, need_frame
from shpy.lang.types import Attrib1i, Attrib2f
from shpy.lang.values import CLASSES, Value


def _python_name() -> str | None:
    """What the user assigns to on this line."""
    loc = here()
    return name_for(loc.file, loc.line) if loc is not None else None


class Param:
    """`Param(type, value, name=None)`: a uniform. It is used like a value of `type`; set `.value` between runs.

    The name defaults to the Python name that it is assigned to. Raises ShpyTypeError for a value that does not fit.
    """

    _name: str | None
    named: bool
    _held: Any

    def __new__(cls, type_: Any, value: Any, name: str | None = None) -> Any:
        """Make an object that is both a Param and a value (or matrix) of `type_`."""
        known = name if name is not None else _python_name()
        named = name is not None
        if isinstance(type_, type) and issubclass(type_, Matrix):
            rows = [
                _param(type_._row_type(), row, f"{known}[{r}]" if known else None, named)
                for r, row in enumerate(_matrix_rows(type_, value, known))
            ]
            made: Any = object.__new__(type(type_.__name__, (_MatrixParam, type_), {}))
            object.__setattr__(made, "_name", known)
            object.__setattr__(made, "rows", tuple(rows))
            return made
        if not (isinstance(type_, type) and issubclass(type_, Value)):
            raise ShpyTypeError(f"a Param cannot be a {type_!r}", loc=here(), cure="sh.Param(sh.Color3f, (1, 1, 1))")
        return _param(type_, value, known, named)


def _param(type_: type[Value], value: Any, name: str | None, named: bool) -> Any:
    made: Any = object.__new__(type(type_.__name__, (_ValueParam, type_), {}))
    slots = {"_frame": None, "_variable": -1, "_part": None, "_loc": here(), "_name": name, "named": named}
    for slot, start in slots.items():
        object.__setattr__(made, slot, start)
    made.value = value
    return made


class _ValueParam(Param):
    """A Param of a scalar or vector type."""

    def __new__(cls, *args: Any, **named: Any) -> Any:
        raise RecordError("a Param is made by sh.Param", loc=here())

    def __init__(self, *args: Any, **named: Any) -> None:
        pass

    @property
    def exact(self) -> Any:
        """What the uniform is now as binary64, a float or a tuple of them: a kernel rounds it to its own precision."""
        numbers = decode(self.type, self._const)  # type: ignore[attr-defined]
        return numbers if len(numbers) > 1 else numbers[0]

    @property
    def value(self) -> Any:
        """What the uniform is now: a numpy scalar or array of shape (size,)."""
        held = to_array(self.type, self._const)  # type: ignore[attr-defined]
        return held[()] if held.ndim == 0 else held

    @value.setter
    def value(self, value: Any) -> None:
        object.__setattr__(self, "_const", self._constant(value))

    def _constant(self, value: Any) -> tuple[int, ...]:
        """The value as a constant; ShpyTypeError, naming the Param, where an input would refuse it as well."""
        cls = CLASSES[self.kind, self.size, self.base]  # type: ignore[attr-defined]
        try:
            parts = arithmetic.parts(cls, value)
            if any(isinstance(p, Value) and p._frame is not None for p in parts):
                raise RecordError("a Param's value is set between runs", loc=here(), cure="a number")
            flat = [p if isinstance(p, coerce.Literal) else _literal_of(p) for p in parts]
            for part in flat:
                coerce.check_base(part, cls.base)
            return arithmetic.constant(cls.type, flat, cls)
        except ShpyError as error:
            what = f"the Param {self._name}" if self._name else "a Param"
            raise type(error)(f"{what}: {error.message}", loc=error.loc, cure=error.cure) from error

    @property
    def name(self) -> str | None:
        """The name, or None where none is known before the program is recorded."""
        return self._name

    def _read(self, emitter: Emitter) -> Handle:
        frame = current_frame()
        if frame is None:
            return emitter.const(self.type, self._const)  # type: ignore[attr-defined]
        name = frame.recording.use("param", frame.recording.params, self)
        return emitter.let("param", (), self.type, name)  # type: ignore[attr-defined]

    def _storable(self, spelled: str) -> Frame:
        raise RecordError(
            f"{self._name or 'a Param'} is a Param: the same for all elements, and not stored into by a program",
            loc=here(),
            cure=f"{self._name or 'p'}.value = … between runs, or a copy, y = x.copy()",
        )


class _MatrixParam(Param):
    """A Param of a matrix type: one Param a row."""

    def __new__(cls, *args: Any, **named: Any) -> Any:
        raise RecordError("a Param is made by sh.Param", loc=here())

    def __init__(self, *args: Any, **named: Any) -> None:
        pass

    @property
    def value(self) -> NDArray[Any]:
        """What the uniform is now: an array (N, N)."""
        return np.stack([row.value for row in self.rows])  # type: ignore[attr-defined]

    @value.setter
    def value(self, value: Any) -> None:
        rows: tuple[Any, ...] = self.rows  # type: ignore[attr-defined]
        given = _matrix_rows(type(self), value, self._name)
        constants = [row._constant(new) for row, new in zip(rows, given, strict=True)]
        for row, constant in zip(rows, constants, strict=True):  # only when all of them fit
            object.__setattr__(row, "_const", constant)

    def __setattr__(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)


def _matrix_rows(cls: Any, value: Any, name: str | None) -> Sequence[Any]:
    """The rows of a matrix Param's value: of a matrix, or of an array (N, N)."""
    if isinstance(value, Matrix) and value.size == cls.size:
        return value.rows
    what = f"the Param {name}" if name else "a Param"
    array = as_base(value, Base.F, what)
    if array.shape != (cls.size, cls.size):
        raise ShpyTypeError(
            f"{what} is a {cls.__name__} and takes an array ({cls.size}, {cls.size}), not {array.shape}",
            loc=here(),
            cure=f"sh.{cls.__name__}(row0, row1, …), or an array of {cls.size} rows",
        )
    return list(array)


def _literal_of(value: Value) -> coerce.Literal:
    weak = "float" if value.type.is_float else "bool" if value.type.is_bool else "int"
    return coerce.Literal(weak, tuple(np.atleast_1d(to_array(value.type, value._const)).tolist()))


@dataclass(frozen=True, slots=True)
class TableType:
    """What `Table[type, rank]` is in an annotation."""

    cls: type[Value]
    rank: int


@dataclass(frozen=True, slots=True)
class TextureType:
    """What `Texture2D[type]` is in an annotation."""

    cls: type[Value]


class Table:
    """`Table(array, type)`: random-access data, (*shape, N) for N components and (*shape,) for one, 1-D to 3-D.

    `table[i]`, `table[row, col]`, `table[k, j, i]` in the order of numpy's axes, or `table[v]` with an integer vector.
    A symbolic index out of range reads the nearest element on each axis; a constant one raises ShpyIndexError.
    Raises ShpyTypeError for arrays that are empty, of another rank, or whose numbers do not fit the type.
    """

    __hash__ = object.__hash__

    def __init__(self, array: Any, type: type[Value], name: str | None = None) -> None:
        self.type = _element_class(type)
        self.named = name is not None
        self.name = name if name is not None else _python_name()
        self._array = self._checked(array)
        self.rank = self._array.ndim - (self.type.size > 1)
        self._version = 0
        self._data: dict[Any, TableData] = {}

    @classmethod
    def __class_getitem__(cls, key: Any) -> TableType:
        """The annotation of a table argument: its element type, and its rank if that is not 1.

        A type checker takes no bare number there (PEP 586): `sh.Table[sh.Attrib4f, Literal[2]]` means the same.
        """
        type_, rank = key if isinstance(key, tuple) else (key, 1)
        (rank,) = get_args(rank) or (rank,)  # Literal[2], or 2
        if rank not in (1, 2, 3):
            raise ShpyTypeError(f"a Table has 1 to 3 axes, not {rank}", loc=here(), cure="sh.Table[sh.Attrib4f, 2]")
        return TableType(_element_class(type_), rank)

    def _checked(self, array: Any) -> NDArray[Any]:
        what = f"the Table {self.name}" if self.name else "a Table"
        data = as_base(array, self.type.base, what)
        n = self.type.size
        rank = data.ndim - (n > 1)
        if n > 1 and (data.ndim == 0 or data.shape[-1] != n):
            raise ShpyTypeError(
                f"{what} of {self.type.__name__} takes an array (*shape, {n}), not {data.shape}",
                loc=here(),
                cure=f"array.reshape(-1, {n})",
            )
        if rank not in (1, 2, 3):
            raise ShpyTypeError(
                f"{what} has 1 to 3 axes, and this array, {data.shape}, has {rank}",
                loc=here(),
                cure="array.reshape(-1)",
            )
        if data.size == 0:
            raise ShpyTypeError(f"{what} cannot be empty", loc=here(), cure="one element that stands for none")
        return data.copy() if np.may_share_memory(data, array) else data

    @property
    def shape(self) -> tuple[Any, ...]:
        """The number of elements on each axis, in the order of numpy's."""
        return self._array.shape[: self.rank]

    def update(self, array: Any) -> None:
        """Replace the data; the shape stays. Kernels use the new data from their next run on."""
        data = self._checked(array)
        if data.shape != self._array.shape:
            raise ShpyTypeError(
                f"update of the Table {self.name or ''} keeps the shape: {self._array.shape}, not {data.shape}",
                loc=here(),
                cure="a new sh.Table",
            )
        self._array = data
        self._version += 1

    def data(self, dtype: Any) -> TableData:
        """The data for a runtime, floats as `dtype`; the same object until the next update, which counts `version`."""
        key = np.dtype(dtype) if self._array.dtype.kind == "f" else self._array.dtype
        held = self._data.get(key)
        if held is None:
            held = self._data[key] = TableData(_frozen(self._array, key), self._version)
        elif held.version != self._version:
            held.array, held.version = _frozen(self._array, key), self._version
        return held

    def _declared(self, frame: Frame) -> str:
        return frame.recording.use("table", frame.recording.tables, self)

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, Value) and key.size == self.rank and key.size > 1:
            entries: list[Any] = [key]
        else:
            entries = list(key) if isinstance(key, tuple) else [key]
            if len(entries) != self.rank:
                raise ShpyTypeError(
                    f"this Table has {self.rank} axes and takes as many indices, not {len(entries)}",
                    loc=here(),
                    cure=f"table[{', '.join('kji'[-self.rank :])}]",
                )
        operands = [arithmetic.operand(e, "an index") for e in entries]
        self._check(operands)
        emitter = arithmetic.emitter_of(*operands)
        if emitter is HOST:
            return self._at_once(operands)
        assert isinstance(emitter, FrameEmitter)
        scalars = [
            arithmetic.index(emitter, o) if isinstance(o, Value) else arithmetic.read(emitter, o, vec(Base.I))
            for o in operands
        ]
        index = scalars[0] if len(scalars) == 1 else emitter.let("construct", tuple(scalars), vec(Base.I, self.rank))
        handle = emitter.let("table", (index,), self.type.type, self._declared(emitter.frame))
        element = arithmetic.made(self.type.kind, self.type.type, emitter, handle)
        object.__setattr__(element, "_part", f"{self.name or 'table'}[…]")
        return element

    def _check(self, operands: list[Any]) -> None:
        for axis, o in enumerate(operands):
            if isinstance(o, coerce.Literal):
                if o.weak != "int":
                    raise ShpyTypeError("a Table takes ints as indices", loc=here(), cure="sh.Attrib1i(x)")
                extent = self._extent(axis)
                if o.components[0] < 0 or (extent is not None and o.components[0] >= extent):
                    raise ShpyIndexError(
                        f"index {o.components[0]} on axis {axis} of a Table of shape {self.shape}",
                        loc=here(),
                        cure="a constant index in range; a symbolic one reads the nearest element",
                    )
            elif not o.type.is_int:
                raise ShpyTypeError(
                    f"a Table takes ints as indices, not {o.type!r}", loc=here(), cure="sh.Attrib1i(x), which truncates"
                )

    def _extent(self, axis: int) -> int | None:
        return int(self._array.shape[axis])

    def _at_once(self, operands: list[Any]) -> Value:
        index = [
            int(c)
            for o in operands
            for c in (o.components if isinstance(o, coerce.Literal) else np.atleast_1d(np.asarray(o)))
        ]
        clamped = tuple(min(max(i, 0), n - 1) for i, n in zip(index, self._array.shape, strict=False))
        return CLASSES[self.type.kind, self.type.size, self.type.base](self._array[clamped])

    def __setitem__(self, key: Any, value: Any) -> None:
        raise RecordError(
            f"{self.name or 'a Table'} is read only", loc=here(), cure="an sh.Array, an output, or table.update(array)"
        )

    def __len__(self) -> int:
        return int(self.shape[0])


def _frozen(array: NDArray[Any], dtype: Any) -> NDArray[Any]:
    with np.errstate(over="ignore"):
        frozen = np.ascontiguousarray(array.astype(dtype))
    frozen.flags.writeable = False
    return frozen


def _element_class(type_: Any) -> type[Value]:
    if not (isinstance(type_, type) and issubclass(type_, Value) and hasattr(type_, "kind")):
        raise ShpyTypeError(f"a Table holds values of the language, not {type_!r}", loc=here(), cure="sh.Attrib4f")
    return type_


class TableArgument(Table):
    """A table that a run is given: its shape is known only then."""

    def __init__(self, name: str, type_: TableType) -> None:
        self.type = type_.cls
        self.name, self.named = name, True
        self.rank = type_.rank

    @property
    def shape(self) -> tuple[Any, ...]:
        """One Attrib1i an axis."""
        emitter = FrameEmitter(need_frame("a table's shape"))
        size = vec(Base.I, self.rank)
        handle = emitter.let("table_size", (), size, self._declared(emitter.frame))
        whole = arithmetic.made("Attrib", size, emitter, handle)
        return (whole,) if self.rank == 1 else tuple(whole)

    def _extent(self, axis: int) -> int | None:
        return None

    def _at_once(self, operands: list[Any]) -> Value:
        raise RecordError(f"{self.name} has data only when the program runs", loc=here())


class Texture2D:
    """`Texture2D(array, filter="linear"|"nearest", wrap="clamp"|"repeat")`: an image (h, w[, c]), read by `t(uv)`.

    Row 0 is v = 0: `texture(((c + .5)/w, (r + .5)/h))` is `array[r, c]`; nothing is flipped; uint8 is divided by 255.
    Filtering is the same arithmetic on every target. Gives Color{c}f. Raises ShpyTypeError for other arrays or names.
    """

    FILTERS: ClassVar = ("nearest", "linear")
    WRAPS: ClassVar = ("clamp", "repeat")

    def __init__(
        self,
        array: Any,
        filter: Literal["linear", "nearest"] = "linear",
        wrap: Literal["clamp", "repeat"] = "clamp",
        name: str | None = None,
    ) -> None:
        for given, known, what in ((filter, self.FILTERS, "filter"), (wrap, self.WRAPS, "wrap")):
            if given not in known:
                raise ShpyTypeError(f"{what}={given!r}", loc=here(), cure=" or ".join(f'{what}="{k}"' for k in known))
        pixels, channels = _pixels(array)
        self.filter, self.wrap = filter, wrap
        self.type = CLASSES["Color", channels, Base.F]
        self.name = name if name is not None else _python_name()
        self.table = Table(pixels, self.type, self.name)
        self.table.named = name is not None

    @classmethod
    def __class_getitem__(cls, key: Any) -> TextureType:
        """The annotation of a texture argument: the type of its pixels."""
        return TextureType(_element_class(key))

    @property
    def shape(self) -> tuple[Any, ...]:
        """Height and width."""
        return self.table.shape

    @property
    def mode(self) -> Any:
        """Filter and wrap as a number: 1 for linear, plus 2 for repeat."""
        return self.FILTERS.index(self.filter) + 2 * self.WRAPS.index(self.wrap)

    def update(self, array: Any) -> None:
        """Replace the image; the shape stays."""
        self.table.update(_pixels(array)[0])

    def __call__(self, uv: Any) -> Any:
        """The colour at `uv`, two floats in [0, 1]² over the image."""
        from shpy.lang.library import sample

        return sample(self, uv if isinstance(uv, Value) else Attrib2f(*uv))


class TextureArgument(Texture2D):
    """A texture that a run is given: its filter and wrap are known only then."""

    def __init__(self, name: str, type_: TextureType) -> None:
        self.name = name
        self.type = type_.cls
        self.table = TableArgument(name, TableType(type_.cls, 2))
        self._mode = Param(Attrib1i, 0, name=f"{name}.mode")

    @property
    def mode(self) -> Any:
        """Filter and wrap as a uniform."""
        return self._mode


def _pixels(array: Any) -> tuple[NDArray[Any], int]:
    data = np.asarray(array)
    if data.ndim not in (2, 3) or (data.ndim == 3 and not 1 <= data.shape[2] <= 4):
        raise ShpyTypeError(
            f"a texture is an array (h, w) or (h, w, c) with c up to 4, not {data.shape}",
            loc=here(),
            cure="array[..., :3]",
        )
    if data.dtype == np.uint8:
        data = data.astype(np.float32) / np.float32(255)
    channels = 1 if data.ndim == 2 else data.shape[2]
    return (data.reshape(data.shape[:2]) if channels == 1 else data), channels
