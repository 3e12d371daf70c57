"""Textures: images that are read between their pixels, filtered.

Stage: record. Used by closure, or as arguments annotated `sh.Texture2D[sh.Color3f]`.

    image = sh.Texture2D(array, filter="linear", wrap="repeat")
    image(uv)              # the colour at uv, in [0, 1] over the image
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyTypeError
from shpy.ir.types import Base
from shpy.lang.data.hostdata import as_base
from shpy.lang.data.params import Param
from shpy.lang.data.tables import Table, TableType, argument, element_class
from shpy.lang.library import WRAPS, sample
from shpy.lang.recording.location import here
from shpy.lang.recording.names import assigned_name
from shpy.lang.values.coerce import literal
from shpy.lang.values.types import Attrib1i
from shpy.lang.values.value import CLASSES, Value

WrapName = Literal["clamp", "repeat", "mirror"]


@dataclass(frozen=True, slots=True)
class TextureType:
    """The annotation `Texture2D[type]`."""

    cls: type[Value]

    def __repr__(self) -> str:
        return f"Texture2D[{self.cls.__name__}]"


class Texture:
    """An image of `AXES` axes, (*shape) or (*shape, c), with c channels; `texture(uv)` reads it.

    The first coordinate goes along the image's last axis. Raises ShpyTypeError for other arrays or names.
    """

    AXES: ClassVar[int]
    FILTERS: ClassVar = ("nearest", "linear", "cubic")
    known: ClassVar[bool] = True
    """True where the filter and the wraps are known while recording."""

    def __init__(self, array: Any, filter: str = "linear", wrap: Any = "clamp", name: str | None = None) -> None:
        self.wraps = tuple(wrap) if isinstance(wrap, tuple | list) else (wrap,) * self.AXES
        self.wrap, self.filter = wrap, filter
        checks = [(filter, self.FILTERS, "filter"), *((w, tuple(WRAPS), "wrap") for w in self.wraps)]
        for choice, choices, what in checks:
            if choice not in choices:
                cure = " or ".join(f'{what}="{k}"' for k in choices)
                raise ShpyTypeError(f"{what}={choice!r} is not a {what}", loc=here(), cure=cure)
        if len(self.wraps) != self.AXES:
            cure = f"wrap={('repeat', 'clamp', 'mirror')[: self.AXES]}, one for each coordinate"
            raise ShpyTypeError(f"wrap={wrap!r} does not have {self.AXES} wraps", loc=here(), cure=cure)
        self.name = name if name is not None else assigned_name()
        unique = name is not None
        if hasattr(array, "table_source"):
            self.table = _stream_pixels(array, self.name, self.AXES, unique)
            self.type = CLASSES["Color", self.table.type.size, Base.F]
        else:
            pixels, channels = checked_pixels(array, self.AXES)
            self.type = CLASSES["Color", channels, Base.F]
            self.table = Table(pixels, self.type, self.name, unique=unique)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the subroutine of `sample`, which holds this very texture and cannot be pickled."""
        return {name: value for name, value in self.__dict__.items() if name != "_routine"}

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

    def __call__(self, uv: Any, *others: Any) -> Any:
        """Return the colour at `uv`: a float for each axis, in [0, 1] over the image."""
        if others or literal(uv) is not None:
            place = ", ".join("uvw"[: self.AXES])
            raise ShpyTypeError(
                f"a texture is read at one place of {self.AXES} coordinates, not at each by itself",
                loc=here(),
                cure=f"{self.name or 'texture'}(({place}))",
            )
        return sample(self, uv if isinstance(uv, Value) else CLASSES["Attrib", self.AXES, Base.F](uv))


class Texture2D(Texture):
    """`Texture2D(array, filter="linear", wrap="clamp")`: an image (h, w[, c]), read by `texture(uv)`.

    Row 0 is v = 0: `texture(((c + .5)/w, (r + .5)/h))` is `array[r, c]`; nothing is flipped. Numbers of uint8 are
    divided by 255, and those of uint16 by 65535; other numbers stay as they are.
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
        """Return the annotation of a texture argument: the type of its pixels."""
        return TextureType(element_class(key))


class TextureArgument(Texture2D):
    """A texture that a run is given: its filter and wrap are known only then."""

    known = False

    def __init__(self, name: str, type_: TextureType) -> None:
        self.name = name
        self.filter = "linear"
        self.type = type_.cls
        self.table = argument(name, TableType(type_.cls, 2))
        self._mode = Param(Attrib1i, 0, name=f"{name}.mode")

    @property
    def mode(self) -> Any:
        """The filter and the wrap as a uniform."""
        return self._mode


def _stream_pixels(stream: Any, name: str | None, axes: int, unique: bool) -> Table:
    """Make the table over an image's stream."""
    table = Table(stream, name=name, unique=unique)
    if table.rank != axes or not issubclass(table.type, Value) or table.type.base is not Base.F:
        raise ShpyTypeError(
            f"a texture of a stream takes colours in {axes} axes, not {stream!r}",
            loc=here(),
            cure='sh.Stream(image, sh.Color3f, backend="opencl"), where image is (h, w, 3)',
        )
    return table


def checked_pixels(array: Any, axes: int = 2) -> tuple[NDArray[Any], int]:
    """Return an image as floats and its channels; one channel has no axis of its own.

    Pixels of uint8 or uint16 are divided by the largest number of their type.
    """
    data = as_base(array, Base.F, "a texture")
    if data.ndim not in (axes, axes + 1) or (data.ndim == axes + 1 and not 1 <= data.shape[-1] <= 4):
        shape = ", ".join("dhw"[-axes:])
        raise ShpyTypeError(
            f"a texture is an array ({shape}) or ({shape}, c) with c up to 4, not {data.shape}",
            loc=here(),
            cure="array[..., :3]",
        )
    if not data.size:
        raise ShpyTypeError("a texture cannot be empty", loc=here(), cure="an image of one pixel or more")
    levels = {"uint8": 255, "uint16": 65535}.get(np.asarray(array).dtype.name)
    if levels is not None:
        data = data.astype(np.float32) / np.float32(levels)
    channels = 1 if data.ndim == axes else data.shape[-1]
    return (data.reshape(data.shape[:axes]) if channels == 1 else data), channels
