"""Textures beyond sh.Texture2D: in space, on a cube, and with smaller copies for distant surfaces.

Stage: record. Each is used by closure: `sky = TextureCube(faces)`, then `sky(direction)` in a program. Filtering is the
same arithmetic on every backend.

Sources: faces of a cube: OpenGL 4.6, table 8.19; levels of detail: Williams 1983, OpenGL 4.6, section 8.14.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyTypeError
from shpy.ir.types import Base
from shpy.lang.data.tables import Table
from shpy.lang.data.textures import Texture, WrapName, checked_pixels
from shpy.lang.functions.subroutine import Subroutine
from shpy.lang.library import WRAPS, filtered
from shpy.lang.recording.location import here
from shpy.lang.recording.names import assigned_name
from shpy.lang.values.builtins import clamp, cond, floor, length, log2, max, min, mix
from shpy.lang.values.types import Attrib1f, Attrib1i, Attrib2f, Attrib3f, Attrib3i, TexCoord2f
from shpy.lang.values.value import CLASSES
from shpy.library.operands import vector


class Texture3D(Texture):
    """`Texture3D(array, filter="linear", wrap="clamp")`: numbers in space (d, h, w[, c]), read by `texture(uvw)`.

    `texture(((c + .5)/w, (r + .5)/h, (k + .5)/d))` is `array[k, r, c]`. Filters and wraps are those of `sh.Texture2D`,
    the wraps of three axes in the order u, v, w. Gives Color{c}f.
    """

    AXES = 3

    def __init__(
        self,
        array: Any,
        filter: Literal["linear", "nearest", "cubic"] = "linear",
        wrap: WrapName | tuple[WrapName, WrapName, WrapName] = "clamp",
        name: str | None = None,
    ) -> None:
        super().__init__(array, filter, wrap, name)


class Mipmap:
    """`Mipmap(array, wrap="clamp")`: an image (h, w[, c]) and its halves, read by `mipmap(uv, level)`.

    Level 0 is the image. Each further one is half as wide and high, rounded down, until it is a single pixel; a pixel
    is the mean of the area that it covers. Each level is filtered linearly, and a number between two levels blends
    them; below 0 it is level 0, and past the last one the last. Wraps are those of `sh.Texture2D`. Gives Color{c}f.
    Raises ShpyTypeError for other arrays or names.
    """

    def __init__(
        self, array: Any, wrap: WrapName | tuple[WrapName, WrapName] = "clamp", name: str | None = None
    ) -> None:
        self.wraps = tuple(wrap) if isinstance(wrap, tuple | list) else (wrap, wrap)
        if len(self.wraps) != 2 or any(w not in WRAPS for w in self.wraps):
            cure = " or ".join(f'wrap="{w}"' for w in WRAPS)
            raise ShpyTypeError(f"wrap={wrap!r} is not a wrap", loc=here(), cure=f"{cure}, or two of them for u and v")
        self.name = name if name is not None else assigned_name()
        levels, channels = _levels(array)
        self.type = CLASSES["Color", channels, Base.F]
        self.shape = levels[0].shape[:2]
        """Height and width of level 0."""
        self.count = len(levels)
        """The number of levels."""
        sizes = [level.shape[:2] for level in levels]
        starts = np.cumsum([0, *(h * w for h, w in sizes[:-1])])
        unique = name is not None
        self._texels = Table(_listed(levels, channels), self.type, self.name, unique=unique)
        self._sizes = Table(
            [(start, h, w) for start, (h, w) in zip(starts, sizes, strict=True)],
            Attrib3i,
            f"{self.name}_levels" if self.name else None,
            unique=unique,
        )
        self._level = Subroutine(self._filtered, f"sample_{self.name or 'mipmap'}")

    def update(self, array: Any) -> None:
        """Replace the image and its halves; the shape stays."""
        levels, channels = _levels(array)
        if levels[0].shape[:2] != self.shape or channels != self.type.size:
            raise ShpyTypeError(
                f"update of a Mipmap keeps the shape: {(*self.shape, self.type.size)}, not "
                f"{(*levels[0].shape[:2], channels)}",
                loc=here(),
                cure="a new Mipmap",
            )
        self._texels.update(_listed(levels, channels))

    def __call__(self, uv: Any, level: Any = 0) -> Any:
        """Return the colour at `uv`, two floats in [0, 1] over the image, in a level of detail."""
        place = Attrib2f(vector(uv, (2,), "a Mipmap"))
        detail = clamp(Attrib1f(vector(level, (1,), "a Mipmap's level")), 0, self.count - 1)
        finer = floor(detail)
        number = Attrib1i(finer)
        fine, coarse = (self._level(place, n, self.wraps) for n in (number, min(number + 1, self.count - 1)))
        return self.type(mix(fine, coarse, detail - finer))

    def level(self, dx: Any, dy: Any) -> Any:
        """Return the level whose pixels are as large as a pixel of the picture.

        `dx` and `dy` are the changes of uv to the next pixel in x and in y: the binary logarithm of the longer one, in
        pixels of level 0.
        """
        size = Attrib2f(self.shape[1], self.shape[0])
        changes = (length(size * Attrib2f(vector(d, (2,), "sh.library.Mipmap.level"))) for d in (dx, dy))
        return log2(max(*changes))

    def _filtered(self, uv: Attrib2f, level: Attrib1i, wraps: tuple[str, str]) -> Any:
        start, height, width = self._sizes[level]

        def texel(row: Any, column: Any) -> Any:
            return self._texels[start + clamp(row, 0, height - 1) * width + clamp(column, 0, width - 1)]

        return filtered(uv, (width, height), [WRAPS[wrap] for wrap in wraps], True, False, texel)


def _levels(array: Any) -> tuple[list[NDArray[Any]], int]:
    """Return an image and its halves, with the number of its channels."""
    pixels, channels = checked_pixels(array)
    levels = [np.asarray(pixels, np.float64)]
    while levels[-1].shape[:2] != (1, 1):
        finer = levels[-1]
        for axis in (0, 1):
            finer = _halved(finer, axis)
        levels.append(finer)
    return levels, channels


def _halved(image: NDArray[Any], axis: int) -> NDArray[Any]:
    """Halve the number of pixels along an axis, to at least 1; a new pixel is the mean of the area that it covers."""
    extent = image.shape[axis]
    fewer = np.maximum(extent // 2, 1)
    edges = np.linspace(0, extent, fewer + 1)
    # The overlap of each new pixel with each old one.
    reach = np.clip(edges[1:, None], np.arange(extent), np.arange(extent) + 1) - np.clip(
        edges[:-1, None], np.arange(extent), np.arange(extent) + 1
    )
    return np.moveaxis(np.tensordot(reach * (fewer / extent), image, axes=(1, axis)), 0, axis)


def _listed(levels: list[NDArray[Any]], channels: int) -> NDArray[Any]:
    """Return the pixels of all levels, one after another."""
    flat = np.concatenate([level.reshape(-1, channels) for level in levels])
    return flat[:, 0] if channels == 1 else flat


def _face(x: Any, y: Any, z: Any, choose: Callable[..., Any]) -> tuple[Any, Any, Any]:
    """Return the face of a cube that a direction meets, and where: of values, or of arrays."""
    by_x = (abs(x) >= abs(y)) & (abs(x) >= abs(z))
    by_y = ~by_x & (abs(y) >= abs(z))
    major = choose(by_x, x, choose(by_y, y, z))
    side = choose(major < 0, -1.0, 1.0)
    face = choose(by_x, 0, choose(by_y, 2, 4)) + choose(major < 0, 1, 0)
    s = choose(by_x, -z * side, choose(by_y, x, x * side))
    t = choose(by_y, z * side, -y)
    reach = choose(abs(major) > 0, abs(major), 1.0)
    return face, (s / reach + 1) / 2, (t / reach + 1) / 2


def cubemap(direction: Any) -> tuple[Any, Any]:
    """Return the face of a cube that a direction meets, an i, and where, a TexCoord2f.

    Faces are 0 to 5: +x, -x, +y, -y, +z, -z, with coordinates as in OpenGL. On an edge, x comes before y and y before
    z. A direction of zeros meets the middle of face 0.
    """
    v = Attrib3f(vector(direction, (3,), "sh.library.cubemap"))
    face, s, t = _face(v.x, v.y, v.z, cond)
    return face, TexCoord2f(s, t)


class TextureCube:
    """`TextureCube(faces, filter="linear")`: six images (6, n, n[, c]) on a cube, read by `texture(direction)`.

    Faces and their coordinates are those of `cubemap`; row 0 is t = 0. A linear filter goes on across the edges: there
    is no seam. Gives Color{c}f. Raises ShpyTypeError for other arrays or names.
    """

    def __init__(self, faces: Any, filter: Literal["linear", "nearest"] = "linear", name: str | None = None) -> None:
        if filter not in ("linear", "nearest"):
            raise ShpyTypeError(
                f"filter={filter!r} is not a filter of a cube", loc=here(), cure='filter="nearest" or filter="linear"'
            )
        self.filter = filter
        self.name = name if name is not None else assigned_name()
        bordered, self.type = _bordered(faces)
        self.table = Table(bordered, self.type, self.name, unique=name is not None)
        self._routine = Subroutine(self._filtered, f"sample_{self.name or 'cube'}")

    @property
    def shape(self) -> tuple[int, int, int]:
        """(6, n, n)."""
        n = self.table.shape[1] - 2
        return 6, n, n

    def update(self, faces: Any) -> None:
        """Replace the images; the shape stays."""
        bordered, type = _bordered(faces)
        n = bordered.shape[1] - 2
        kept, shape = (*self.shape, self.type.size), (6, n, n, type.size)
        if shape != kept:
            message = f"update of a TextureCube keeps the shape: {kept}, not {shape}"
            raise ShpyTypeError(message, loc=here(), cure="a new TextureCube")
        self.table.update(bordered)

    def __call__(self, direction: Any) -> Any:
        """Return the colour in a direction; its length does not matter."""
        return self.type(self._routine(Attrib3f(vector(direction, (3,), "a TextureCube")), self.filter))

    def _filtered(self, direction: Attrib3f, filter: str) -> Any:
        face, uv = cubemap(direction)
        n = self.shape[1]
        return filtered(
            uv,
            (n, n),
            [WRAPS["clamp"]] * 2,
            filter == "linear",
            False,
            lambda row, column: self.table[face, row + 1, column + 1],
        )

    @staticmethod
    def directions(n: int) -> NDArray[np.float64]:
        """Return the directions to the middles of the pixels of six faces, (6, n, n, 3)."""
        return _directions((np.arange(n) + 0.5) / n)


def _directions(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the directions to a grid of places, from 0 to 1, on each face."""
    t, s = np.meshgrid(2 * places - 1, 2 * places - 1, indexing="ij")
    one = np.ones_like(s)
    faces = [(one, -t, -s), (-one, -t, s), (s, one, t), (s, -one, -t), (s, -t, one), (-s, -t, -one)]
    return np.stack([np.stack(face, axis=-1) for face in faces])


def _bordered(faces: Any) -> tuple[NDArray[Any], Any]:
    """Return the faces, each inside a border of the pixels beyond its edges, and the type of a pixel."""
    pixels, channels = checked_pixels(faces, 3)
    if pixels.shape[0] != 6 or pixels.shape[1] != pixels.shape[2]:
        raise ShpyTypeError(
            f"a TextureCube is an array (6, n, n) or (6, n, n, c), not {np.shape(faces)}",
            loc=here(),
            cure="np.stack([right, left, top, bottom, front, back]), of squares of one size",
        )
    n = pixels.shape[1]
    x, y, z = np.moveaxis(_directions((np.arange(-1, n + 1) + 0.5) / n), -1, 0)
    face, s, t = _face(x, y, z, np.where)
    row, column = (np.clip((place * n).astype(int), 0, n - 1) for place in (t, s))
    bordered = pixels[face, row, column]
    bordered[:, 1:-1, 1:-1] = pixels
    for i, beside in ((0, 1), (-1, -2)):
        for j, over in ((0, 1), (-1, -2)):  # three faces meet where a border has its corner
            bordered[:, i, j] = (bordered[:, beside, j] + bordered[:, i, over] + bordered[:, beside, over]) / 3
    return bordered, CLASSES["Color", channels, Base.F]
