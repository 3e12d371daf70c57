"""Data that programs read: Table (random access), Texture2D (filtered). Uniforms are in `params.py`.

Stage: record. Used by closure, or as arguments annotated `sh.Table[sh.Attrib4f, 2]`, `sh.Texture2D[sh.Color3f]`.

    heights = sh.Table(np.zeros((64, 64)), sh.Attrib1f)
    heights[row, col]      # the nearest element where row or col is out of range
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from shpy.errors import RecordError, ShpyIndexError, ShpyTypeError
from shpy.ir.tabledata import TableData
from shpy.ir.types import Base, vec
from shpy.lang.data.hostdata import as_base, working
from shpy.lang.data.params import Param
from shpy.lang.recording.emit import DEFERRED, HOST, FrameEmitter
from shpy.lang.recording.location import here
from shpy.lang.recording.names import assigned_name
from shpy.lang.recording.recorder import Frame, need_frame
from shpy.lang.values import arithmetic, coerce
from shpy.lang.values.types import Attrib1i
from shpy.lang.values.value import CLASSES, Value

WrapName = Literal["clamp", "repeat", "mirror"]


@dataclass(frozen=True, slots=True)
class TableType:
    """What `Table[type, rank]` is in an annotation."""

    cls: Any
    rank: int


@dataclass(frozen=True, slots=True)
class TextureType:
    """What `Texture2D[type]` is in an annotation."""

    cls: type[Value]


class Table:
    """`Table(array, type)`: random-access data, (*shape, N) for N components and (*shape,) for one, 1-D to 3-D.

    `table[i]`, `table[row, col]`, `table[k, j, i]` in the order of numpy's axes, or `table[v]` with an integer vector.
    The type may be a matrix, from an array (*shape, N, N), or a struct, from a dict of fields or a structured array.
    A symbolic index out of range reads the nearest element on each axis; a constant one raises ShpyIndexError.
    Raises ShpyTypeError for arrays that are empty, of another rank, or whose numbers do not fit the type.
    """

    __hash__ = object.__hash__
    type: Any
    name: str | None
    named: bool
    rank: int
    _owner: Table | None = None

    def __new__(cls, array: Any = None, type: Any = None, name: str | None = None) -> Table:
        """A Table of structs or matrices is one of another class, and so is one over the memory of a stream."""
        from shpy.lang.data.compound import CompoundTable, is_compound

        if hasattr(array, "_table_class"):
            made: Table = object.__new__(array._table_class())
            return made
        return object.__new__(CompoundTable if cls is Table and is_compound(type) else cls)

    def __init__(self, array: Any, type: Any = None, name: str | None = None) -> None:
        self.type = _element_class(type)
        self.named = name is not None
        self.name = name if name is not None else assigned_name()
        self._array = self._checked(array)
        self.rank = self._array.ndim - (self.type.size > 1)
        self._version = 0
        self._data: dict[Any, TableData] = {}

    @classmethod
    def __class_getitem__(cls, key: Any) -> TableType:
        """The annotation of a table argument: its element type, and its rank if that is not 1.

        A type checker takes no plain number there (PEP 586): `sh.Table[sh.Attrib4f, Literal[2]]` means the same.
        """
        type_, rank = key if isinstance(key, tuple) else (key, 1)
        (rank,) = get_args(rank) or (rank,)  # Literal[2], or 2
        if rank not in (1, 2, 3):
            raise ShpyTypeError(f"a Table has 1 to 3 axes, not {rank}", loc=here(), cure="sh.Table[sh.Attrib4f, 2]")
        from shpy.lang.data.compound import is_compound

        return TableType(type_ if is_compound(type_) else _element_class(type_), rank)

    def _checked(self, array: Any) -> NDArray[Any]:
        what = f"the Table {self.name}" if self.name else "a Table"
        data = as_base(array, self.type.base, what)
        n = self.type.size
        rank = data.ndim - (n > 1)
        if n > 1 and (data.ndim == 0 or data.shape[-1] != n):
            raise ShpyTypeError(
                f"{what} of {self.type.__name__} takes an array (*shape, {n}), not {data.shape}",
                loc=here(),
                cure=f"array[..., :{n}]" if data.ndim > 1 and data.shape[-1] > n else f"array.reshape(-1, {n})",
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
        self._replace(self._for_update(array))

    def _for_update(self, array: Any) -> NDArray[Any]:
        data = self._checked(array)
        if data.shape != self._array.shape:
            raise ShpyTypeError(
                f"update of the Table {self.name or ''} keeps the shape: {self._array.shape}, not {data.shape}",
                loc=here(),
                cure="a new sh.Table",
            )
        return data

    def _replace(self, data: NDArray[Any]) -> None:
        self._array = data
        self._version += 1

    def data(self, dtype: Any) -> TableData:
        """The data for a runtime, floats as `dtype`; the same object until the next update, which counts `version`."""
        key = np.dtype(dtype) if self._array.dtype.kind == "f" else self._array.dtype
        held = self._data.get(key)
        if held is None:
            held = self._data[key] = TableData(self._frozen(key), self._version)
        elif held.version != self._version:
            held.array, held.version = self._frozen(key), self._version
        return held

    def _frozen(self, dtype: np.dtype[Any]) -> NDArray[Any]:
        """Return the data as a dtype, read-only; ShpyTypeError for a number that is out of its range."""
        what = f"the Table {self.name}" if self.name else "a Table"
        same = self._array.dtype == dtype
        array = self._array.copy() if same else working(self._array, self.type.base, dtype, what)
        frozen = np.ascontiguousarray(array)
        frozen.flags.writeable = False
        return frozen

    def leaves(self, name: str) -> dict[str, Table]:
        """The tables that this one is in a module where it is called `name`: itself, as it holds scalars or vectors."""
        return {name: self}

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
        scalars = [
            arithmetic.index(emitter, o) if isinstance(o, Value) else arithmetic.read(emitter, o, vec(Base.I))
            for o in operands
        ]
        index = scalars[0] if len(scalars) == 1 else emitter.let("construct", tuple(scalars), vec(Base.I, self.rank))
        source: Any = self if emitter is DEFERRED else self._declared(need_frame("a Table"))
        handle = emitter.let("table", (index,), self.type.type, source)
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
        array = self._host_array()
        clamped = tuple(min(max(i, 0), n - 1) for i, n in zip(index, array.shape, strict=False))
        return CLASSES[self.type.kind, self.type.size, self.type.base](array[clamped])

    def _host_array(self) -> NDArray[Any]:
        """The elements on the host."""
        return self._array

    def __setitem__(self, key: Any, value: Any) -> None:
        raise RecordError(
            f"{self.name or 'a Table'} is read only", loc=here(), cure="an sh.Array, an output, or table.update(array)"
        )

    def __len__(self) -> int:
        return int(self.shape[0])


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


class Texture:
    """An image of `AXES` axes, (*shape) or (*shape, c), with c channels; `texture(uv)` reads it.

    The first coordinate goes along the image's last axis. Raises ShpyTypeError for other arrays or names.
    """

    AXES: ClassVar[int]
    FILTERS: ClassVar = ("nearest", "linear", "cubic")
    known: ClassVar[bool] = True
    """Whether the filter and the wraps are known while recording."""

    def __init__(self, array: Any, filter: str = "linear", wrap: Any = "clamp", name: str | None = None) -> None:
        from shpy.lang.library import WRAPS

        self.wraps = tuple(wrap) if isinstance(wrap, tuple | list) else (wrap,) * self.AXES
        self.wrap, self.filter = wrap, filter
        checks = [(filter, self.FILTERS, "filter"), *((w, tuple(WRAPS), "wrap") for w in self.wraps)]
        for given, known, what in checks:
            if given not in known:
                raise ShpyTypeError(f"{what}={given!r}", loc=here(), cure=" or ".join(f'{what}="{k}"' for k in known))
        if len(self.wraps) != self.AXES:
            cure = f"wrap={('repeat', 'clamp', 'mirror')[: self.AXES]}, one for each coordinate"
            raise ShpyTypeError(f"wrap={wrap!r}", loc=here(), cure=cure)
        self.name = name if name is not None else assigned_name()
        if hasattr(array, "_table_class"):
            self.table = _stream_pixels(array, self.name, self.AXES)
            self.type = CLASSES["Color", self.table.type.size, Base.F]
        else:
            pixels, channels = checked_pixels(array, self.AXES)
            self.type = CLASSES["Color", channels, Base.F]
            self.table = Table(pixels, self.type, self.name)
        self.table.named = name is not None

    @property
    def shape(self) -> tuple[Any, ...]:
        """The extents along numpy's axes: height and width."""
        return self.table.shape

    @property
    def mode(self) -> Any:
        """Filter and wrap as a number for an argument: 1 for linear, plus 2 for repeat.

        Raises ShpyTypeError for a filter or wrap that arguments do not have.
        """
        if self.filter not in ("nearest", "linear") or self.wraps not in (("clamp", "clamp"), ("repeat", "repeat")):
            raise ShpyTypeError(
                f'a texture that is an argument is filtered "nearest" or "linear" and wrapped "clamp" or "repeat" on '
                f"both axes, not {self.filter!r} and {self.wrap!r}",
                loc=here(),
                cure="a Texture2D that the program uses by closure",
            )
        return self.FILTERS.index(self.filter) + 2 * ("repeat" in self.wraps)

    def update(self, array: Any) -> None:
        """Replace the image; the shape stays."""
        self.table.update(checked_pixels(array, self.AXES)[0])

    def __call__(self, uv: Any) -> Any:
        """The colour at `uv`, a float for each axis, in [0, 1] over the image."""
        from shpy.lang.library import sample

        return sample(self, uv if isinstance(uv, Value) else CLASSES["Attrib", self.AXES, Base.F](*uv))


class Texture2D(Texture):
    """`Texture2D(array, filter="linear", wrap="clamp")`: an image (h, w[, c]), read by `texture(uv)`.

    Row 0 is v = 0: `texture(((c + .5)/w, (r + .5)/h))` is `array[r, c]`; nothing is flipped; uint8 is divided by 255.
    The filter is "nearest", "linear" or "cubic" (Catmull-Rom: through the pixels, and beyond their range beside edges),
    the wrap "clamp", "repeat" or "mirror", or two of them, for u and v. Filtering is the same arithmetic on every
    target. Gives Color{c}f. Raises ShpyTypeError for other arrays or names.
    """

    AXES = 2

    def __init__(
        self,
        array: Any,
        filter: Literal["linear", "nearest", "cubic"] = "linear",
        wrap: WrapName | tuple[WrapName, WrapName] = "clamp",
        name: str | None = None,
    ) -> None:
        super().__init__(array, filter, wrap, name)

    @classmethod
    def __class_getitem__(cls, key: Any) -> TextureType:
        """The annotation of a texture argument: the type of its pixels."""
        return TextureType(_element_class(key))


class TextureArgument(Texture2D):
    """A texture that a run is given: its filter and wrap are known only then."""

    known = False

    def __init__(self, name: str, type_: TextureType) -> None:
        self.name = name
        self.filter = "linear"
        self.type = type_.cls
        self.table = TableArgument(name, TableType(type_.cls, 2))
        self._mode = Param(Attrib1i, 0, name=f"{name}.mode")

    @property
    def mode(self) -> Any:
        """Filter and wrap as a uniform."""
        return self._mode


def _stream_pixels(stream: Any, name: str | None, axes: int) -> Table:
    """The table over an image's stream."""
    table = Table(stream, name=name)
    if table.rank != axes or not issubclass(table.type, Value) or table.type.base is not Base.F:
        raise ShpyTypeError(
            f"a texture of a stream takes colours in {axes} axes, not {stream!r}",
            loc=here(),
            cure='sh.Stream(image, sh.Color3f, backend="opencl"), where image is (h, w, 3)',
        )
    return table


def checked_pixels(array: Any, axes: int = 2) -> tuple[NDArray[Any], int]:
    """Return an image as numbers and its channels; uint8 is divided by 255, and one channel has no axis of its own."""
    data = np.asarray(array)
    if data.ndim not in (axes, axes + 1) or (data.ndim == axes + 1 and not 1 <= data.shape[-1] <= 4):
        shape = ", ".join("dhw"[-axes:])
        raise ShpyTypeError(
            f"a texture is an array ({shape}) or ({shape}, c) with c up to 4, not {data.shape}",
            loc=here(),
            cure="array[..., :3]",
        )
    if data.dtype == np.uint8:
        data = data.astype(np.float32) / np.float32(255)
    channels = 1 if data.ndim == axes else data.shape[-1]
    return (data.reshape(data.shape[:axes]) if channels == 1 else data), channels
