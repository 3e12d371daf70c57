"""Pictures of programs: inputs that are filled by name, and outputs that are shown as pixels.

Stage: picture, below programs, which notebooks show as their pictures. A picture has rows from top to bottom and
columns from left to right; coordinates of a program are (x, y), where y goes down, as in a `Texture2D`.

    | input        | type       | value                                                             |
    |--------------|------------|-------------------------------------------------------------------|
    | `uv`         | TexCoord2f | the pixel's middle, from (0, 0) at the top left to (1, 1)         |
    | `pixel`      | Attrib2i   | (column, row); the middle of the pixel is pixel + 0.5             |
    | `resolution` | Attrib2f   | (width, height) in pixels                                         |
    | `time`       | Attrib1f   | seconds since the start                                           |
    | `frame`      | Attrib1i   | the number of the frame, from 0                                   |
    | `mouse`      | Attrib4f   | x, y of the last drag and of its press; the press is < 0 after it |

Other types of the same size are filled with the same numbers, and an Attrib2f `mouse` with the first two.

    moment = Moment(size=(640, 360), time=1.5)
    pixels(program.compile("opencl")(**filled(program.inputs, moment), shape=moment.shape))
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyTypeError
from shpy.ir.constants import is_int
from shpy.ir.nodes import Module
from shpy.lang.recording.location import here
from shpy.lang.values.value import Value
from shpy.passes.modes import Math

SIZES: Final[dict[str, tuple[int, ...]]] = {
    "uv": (2,),
    "pixel": (2,),
    "resolution": (2,),
    "time": (1,),
    "frame": (1,),
    "mouse": (2, 4),
}
"""The names that are filled, and how many components each may have."""
MOVING: Final = frozenset({"time", "frame"})
"""The names whose values differ from frame to frame without anybody's doing."""


class PixelProgram(Protocol):
    """A `Program`, as far as a picture needs it."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def recorded(self) -> Any:
        """Its recording."""

    @property
    def ir(self) -> Module:
        """Its IR."""

    @property
    def inputs(self) -> Mapping[str, Any]:
        """The types of its inputs by name."""

    @property
    def params(self) -> Mapping[str, Any]:
        """Its Params by name."""

    def compile(self, backend: str | None = None, *, math: Math = "strict") -> Callable[..., Any]:
        """Return its kernel."""


@dataclass(frozen=True, slots=True)
class Moment:
    """One frame of a picture: its size (width, height) in pixels, its time in seconds, its number, the mouse."""

    size: tuple[int, int]
    time: float = 0.0
    frame: int = 0
    mouse: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    @property
    def shape(self) -> tuple[int, int]:
        """The shape of a run over the pixels: (height, width)."""
        return self.size[1], self.size[0]

    def value(self, name: str, count: int) -> Any:
        """Return the host value of an input of this name with `count` components."""
        match name:
            case "uv":
                return _uv(self.size)
            case "pixel":
                return _pixel(self.size)
            case "resolution":
                return self.size
            case "time":
                return self.time
            case "frame":
                return self.frame
            case _:
                return self.mouse[:count]


def is_filled(name: str, type_: Any) -> bool:
    """Return whether an input of this name and type is filled."""
    numeric = isinstance(type_, type) and issubclass(type_, Value) and not type_.type.is_bool
    return numeric and type_.type.size in SIZES.get(name, ())


def filled(inputs: Mapping[str, Any], moment: Moment, *, names: Iterable[str] = ()) -> dict[str, Any]:
    """Return the values of the inputs that have a filled name, except `names`, which get their values in another way.

    `inputs` are types by name, as `Program.inputs` has them. Inputs of other names are left out.
    """
    left = set(names)
    return {
        name: _as(type_, moment.value(name, type_.type.size))
        for name, type_ in inputs.items()
        if name not in left and is_filled(name, type_)
    }


def values_of(inputs: Mapping[str, Any], moment: Moment, streams: Mapping[str, Any]) -> dict[str, Any]:
    """Return the value of each input: the stream of its name, or else the value that its name is filled with."""
    values = {name: streams[name] for name in inputs if name in streams}
    return values | filled(inputs, moment, names=values)


def _as(type_: Any, value: Any) -> Any:
    """Return the numbers in a form that an input of this type takes."""
    if type_.type.is_float or isinstance(value, int):
        return value
    return np.asarray(value).astype(np.int32)


@lru_cache(maxsize=4)
def _uv(size: tuple[int, int]) -> NDArray[np.float32]:
    return _fixed((_pixel(size) + 0.5) / size, np.float32)


@lru_cache(maxsize=4)
def _pixel(size: tuple[int, int]) -> NDArray[np.int32]:
    row, column = np.indices((size[1], size[0]), np.int32)
    return _fixed(np.stack([column, row], axis=-1), np.int32)


def _fixed(array: NDArray[Any], dtype: Any) -> NDArray[Any]:
    copy = np.ascontiguousarray(array, dtype)
    copy.flags.writeable = False  # runs share it
    return copy


def moves(program: PixelProgram) -> bool:
    """Return whether a program of pixels has another picture in each frame: an input of `MOVING` is filled."""
    return any(name in MOVING and is_filled(name, type_) for name, type_ in program.inputs.items())


def unfilled(program: PixelProgram, names: Iterable[str] = ()) -> dict[str, Any]:
    """Return the types, by name, of the inputs that nothing fills: no name, no default, and not in `names` either."""
    filled_names = {*program.recorded.defaults, *names}
    return {n: t for n, t in program.inputs.items() if n not in filled_names and not is_filled(n, t)}


def check_pictures(program: PixelProgram, size: tuple[int, int], names: Iterable[str] = ()) -> None:
    """Raise ShpyTypeError where a program of pixels lacks inputs, or `size` is no (width, height).

    An input is filled by its name, by its default, or named in `names`.
    """
    whole = isinstance(size, tuple | list) and all(is_int(n) and n > 0 for n in size)
    if not (whole and len(size) == 2):
        raise ShpyTypeError(f"size={size!r} is no width and height", loc=here(), cure="size=(640, 360)")
    types = unfilled(program, names)
    if types:
        spoken = ", ".join(f"{name}: {getattr(t, '__name__', t)}" for name, t in types.items())
        raise ShpyTypeError(
            f"{program.name} is no program of pixels: nothing fills its input {spoken}",
            loc=program.ir.entry.loc,
            cure=f"uv: sh.TexCoord2f, pixel: sh.Attrib2i, resolution, time, frame or mouse; a default; or "
            f"{program.name}.bind({next(iter(types))}=…)",
        )
    unknown = [n for n in names if n not in program.inputs and n not in program.params]
    if unknown:
        raise ShpyTypeError(
            f"{unknown[0]} is neither an input nor a Param of {program.name}",
            loc=here(),
            cure=f"one of {', '.join([*program.inputs, *program.params]) or 'none'}",
        )


def drawn(
    program: PixelProgram, moment: Moment, *, backend: str | None = None, math: Math = "strict", **arguments: Any
) -> NDArray[Any]:
    """Run a program of pixels at a moment; return its output, (height, width) or (height, width, components).

    `arguments` are the inputs that no name such as `uv` or `time` fills. Raises ShpyTypeError as `check_pictures` does.
    """
    check_pictures(program, moment.size, arguments)
    output: NDArray[Any] = run_at(program.compile(backend, math=math), program.inputs, moment, arguments)
    return output


def run_at(
    kernel: Callable[..., Any], inputs: Mapping[str, Any], moment: Moment, arguments: Mapping[str, Any] | None = None
) -> Any:
    """Return the picture of a program's kernel at a moment: `arguments`, and the inputs that their names fill."""
    values = dict(arguments or {})
    return first_output(kernel(**values, **filled(inputs, moment, names=values), shape=moment.shape))


def first_output(outputs: Any) -> Any:
    """Return the picture among the outputs of a program: the only one, or the first of several."""
    while isinstance(outputs, tuple | dict):
        outputs = next(iter(outputs.values() if isinstance(outputs, dict) else outputs))
    return outputs


def pixels(output: Any, *, encode: bool = False) -> NDArray[np.uint8]:
    """Return (height, width, 4) bytes, red, green, blue and alpha, of an output of a run over the pixels.

    One component is a grey, two are red and green, three a colour, and a fourth is its alpha. Numbers go from 0 to 1,
    beyond that they are clipped; NaN is 0. With `encode` they are linear light, which becomes sRGB.
    Raises ShpyTypeError for other shapes.
    """
    array = np.asarray(output)
    if array.ndim == 2:
        array = array[..., None]
    if array.ndim != 3 or not 1 <= array.shape[2] <= 4 or array.dtype.kind not in "fiub":
        raise ShpyTypeError(
            f"a picture has the shape (height, width) or (height, width, 1 to 4), not {np.shape(output)}",
            cure="one output of one to four components, such as sh.Color3f",
        )
    count = array.shape[2]
    color = array[..., :3]
    levels = _levels(srgb(color) if encode else color)
    picture = np.full((*array.shape[:2], 4), 255, np.uint8)
    # Plane by plane: numpy spends as much on each three bytes as on a long row.
    for plane, component in enumerate((0, 0, 0) if count == 1 else range(min(count, 3))):
        picture[..., plane] = levels[..., component]
    if count == 2:
        picture[..., 2] = 0
    elif count == 4:
        picture[..., 3] = _levels(array[..., 3])
    return picture


def _levels(numbers: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the byte of each number from 0 to 1; NaN, which fmax leaves out, gives 0."""
    scaled = np.fmax(numbers, 0, dtype=np.float32) if numbers.dtype.kind == "f" else numbers.astype(np.float32)
    np.clip(scaled, 0, 1, out=scaled)
    scaled *= 255
    scaled += 0.5
    return scaled.astype(np.uint8)


def srgb(linear: NDArray[Any]) -> NDArray[Any]:
    """Encode linear light in [0, 1] as sRGB (IEC 61966-2-1); numbers beyond are clipped, and NaN becomes 0.

    Arrays of binary64 give binary64; others are computed in binary32.
    """
    array = np.asarray(linear)
    number = np.float64 if array.dtype == np.float64 else np.float32
    light = np.clip(np.fmax(array.astype(number, copy=False), 0), 0, 1)
    curve: NDArray[Any] = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** number(1 / 2.4) - 0.055)
    return curve.astype(number, copy=False)
