"""The pictures of a mesh file, each decoded once, as the textures that materials take from them.

Stage: scene description. The pictures of a file may have 64 million pixels in all, and so may the textures that are
made of them, so that a small file from a stranger cannot fill the memory; what exceeds that is made smaller.

    pictures = Pictures(notices)
    wood = pictures.get("wood", "wood.png", lambda: folder.find("wood.png"))
    material = Material(color=wood.color((1, 1, 1)) if wood else (0.8, 0.8, 0.8))
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable
from contextlib import nullcontext
from pathlib import Path
from typing import Any, BinaryIO, Final, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance.deep_pictures import is_deep
from raytracer.appearance.materials import CUTOFF, Triple
from raytracer.appearance.textures import Filter, Texture, Transform, Wrap, linear, opened, pixels_of
from raytracer.errors import SceneError
from raytracer.meshes.folder import Notices, shown

MOST: Final = 1 << 26
"""Pixels of all pictures of a file."""
MOST_DECODED: Final = 4 * MOST
"""Pixels of all pictures before they are made smaller: a small file may hold large pictures of one colour."""
_DEEP: Final = 4
"""Pixels as which one of 16 bits in several channels counts: it takes that much more memory to decode."""
Pixels = NDArray[Any]
_Method = TypeVar("_Method", bound=Callable[..., Any])


class Budget:
    """The pixels that are left of `MOST` for further pictures."""

    def __init__(self, notices: Notices) -> None:
        self.notices = notices
        self.left = MOST

    def factor(self, width: int, height: int, count: int = 1) -> int:
        """Return the power of two by which `count` pictures are made smaller, to take at most half of the rest."""
        factor = 1
        while factor < max(width, height) and count * (width // factor) * (height // factor) > self.left // 2:
            factor *= 2
        if factor > 1:
            self.notices.ignore(f"detail of pictures beyond {MOST:,} pixels")
        self.left -= count * (width // factor) * (height // factor)
        return factor


def _once(method: _Method) -> _Method:
    """Make a method of Picture one that is computed once for the same arguments."""

    def wrapper(self: Picture, *args: Any) -> Any:
        return self.memoize((method.__name__, *args), lambda: method(self, *args))

    return cast(_Method, functools.update_wrapper(wrapper, method))


class Picture:
    """The pixels (H, W, 1 or 3) of a picture, uint8 or floats in [0, 1], with how a material reads them.

    `budget` is that of the textures which are made of pictures.
    """

    def __init__(
        self,
        pixels: Pixels,
        name: str,
        wrap: Wrap,
        filter: Filter,
        budget: Budget,
        transform: Transform | None = None,
    ) -> None:
        self.transform = transform
        self.pixels = pixels if pixels.ndim == 3 else pixels[..., None]
        self.budget = budget
        self.name, self.wrap, self.filter = name, wrap, filter
        self._cache: dict[Hashable, Any] = {}

    @_once
    def color(self, factor: Triple) -> Texture:
        """Return the sRGB colours of the picture times a linear factor; the same Texture for the same factor."""
        if factor == (1.0, 1.0, 1.0):
            return self.texture(self.fitting(1), srgb=True)
        numbers = linear(self.fitting(1), encoded=True)
        numbers *= np.asarray(factor, np.float32)
        return self.texture(numbers, srgb=False)

    @_once
    def cutout(self, factor: float) -> Texture | None:
        """Return the Texture of a material's `cutout`, the mean of the channels as they are times a factor.

        None if no point is cut out.
        """
        pixels = self.fitting(1)
        channels = [channel(pixels, k) for k in range(pixels.shape[2])]
        numbers = np.asarray(factor * np.mean(channels, axis=0, dtype=np.float64))
        return None if numbers.min() >= CUTOFF else self.texture(numbers, srgb=False)

    def is_partly_clear(self) -> bool:
        """Return whether a pixel is neither 0 nor 1."""
        return not np.isin(self.pixels, (0, 255 if self.pixels.dtype == np.uint8 else 1)).all()

    def share_between(self, low: float, high: float) -> float:
        """Return the share of numbers between `low` and `high` in the first channel; large pictures are sampled."""
        step = max(1, int((self.pixels.size / (1 << 20)) ** 0.5))
        numbers = channel(self.pixels[::step, ::step], 0)
        return float(np.mean((low < numbers) & (numbers < high)))

    @_once
    def alpha(self, factor: float) -> Texture:
        """Return the Texture of factor * alpha, where this is a picture of alpha."""
        return self.texture(np.float32(factor) * channel(self.fitting(1), 0), srgb=False)

    @_once
    def number(self, factor: float, place: int) -> float | Texture:
        """Return a channel times a factor as the Texture of a number; a number where all pixels are equal."""
        numbers = np.float32(factor) * channel(self.fitting(1), place)
        return float(numbers.flat[0]) if np.ptp(numbers) == 0 else self.texture(numbers, srgb=False)

    @_once
    def normals(self, scale: float) -> Texture:
        """Return the Texture of a material's `normal_map`, whose slopes are multiplied by a factor."""
        pixels = self.fitting(1)
        x, y, z = (2 * channel(pixels, k) - 1 for k in range(3))
        part = max(abs(scale), 1.0)  # the colours of a picture end at 0 and 1
        slopes = [x * (scale / part), y * (scale / part), z / part]
        return self.texture((np.stack(slopes, axis=2).astype(np.float32) + 1) / 2, srgb=False)

    @_once
    def directions(self, strength: float) -> Texture:
        """Return the Texture of an anisotropy, whose blue channel, the strength, is multiplied by a factor."""
        pixels = self.fitting(1)
        channels = [channel(pixels, k) * np.float32(strength if k == 2 else 1) for k in range(3)]
        return self.texture(np.stack(channels, axis=2), srgb=False)

    @_once
    def mean(self) -> NDArray[np.float64]:
        """Return the mean of the linear colours, (3,); of a large picture, that of about a million pixels."""
        step = max(1, int((self.pixels.size / (3 << 20)) ** 0.5))
        numbers = linear(self.pixels[::step, ::step], encoded=True, channels=self.pixels.shape[2])
        return np.asarray(np.broadcast_to(numbers.mean(axis=(0, 1), dtype=np.float64), 3))

    def fitting(self, count: int) -> Pixels:
        """Return the pixels (h, w, 1 or 3) for `count` textures to be made of, fewer of them where the budget ends."""
        factor = self.budget.factor(self.pixels.shape[1], self.pixels.shape[0], count)
        part = slice(factor // 2, None, factor)
        return self.pixels[part, part]

    def texture(self, pixels: Pixels, *, srgb: bool) -> Texture:
        """Return a Texture of other pixels that is read as this picture is."""
        texture = Texture(pixels, srgb=srgb, filter=self.filter, wrap=self.wrap, transform=self.transform)
        texture.name = self.name
        return texture

    def like(self, pixels: Pixels) -> Picture:
        """Return a picture of other pixels that materials read as this one."""
        return Picture(pixels, self.name, self.wrap, self.filter, self.budget, self.transform)

    def memoize(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return the result of `make`, which is called once for each key."""
        if key not in self._cache:
            self._cache[key] = make()
        return self._cache[key]


def channel(pixels: Pixels, number: int) -> NDArray[np.float32]:
    """Return one channel of pixels (H, W, 1 or 3) without decoding, (H, W) in [0, 1]."""
    values = pixels[..., min(number, pixels.shape[2] - 1)]
    return values.astype(np.float32) / np.float32(255 if values.dtype == np.uint8 else 1)


class Pictures:
    """The pictures of one mesh file."""

    def __init__(self, notices: Notices) -> None:
        self.notices = notices
        self._read_budget, self._made_budget = Budget(notices), Budget(notices)
        self._decoded = 0
        self._pixels: dict[Hashable, Pixels | None] = {}
        self._pictures: dict[Hashable, Picture] = {}

    def get(
        self,
        key: Hashable,
        name: str,
        source: Callable[[], Path | BinaryIO | Any],
        *,
        wrap: Wrap = "repeat",
        filter: Filter = "linear",
        alpha: bool = False,
        transform: Transform | None = None,
    ) -> Picture | None:
        """Return the picture that is known by `key`; None, with a notice that has its `name`, if it cannot be read.

        `source` gives its file, the contents of a file, or a picture of Pillow's. With `alpha` it is a grey picture of
        the alpha, and None where there is none.
        """
        key = (key, alpha)
        if key not in self._pixels:
            self._pixels[key] = self._read(name, source, alpha)
        pixels = self._pixels[key]
        if pixels is None:
            return None
        picture = Picture(pixels, name, wrap, filter, self._made_budget, transform)
        return self._pictures.setdefault((key, wrap, filter, transform), picture)

    def _read(self, name: str, source: Callable[[], Any], alpha: bool) -> Pixels | None:
        try:
            content = source()
            with nullcontext(content) if hasattr(content, "convert") else opened(content) as picture:
                self._decoded += picture.size[0] * picture.size[1] * (_DEEP if is_deep(picture) else 1)
                if self._decoded > MOST_DECODED:
                    raise SceneError(f"all pictures have more than {MOST_DECODED:,} pixels")
                return pixels_of(picture, alpha=alpha, fit=lambda: self._read_budget.factor(*picture.size))
        # Decoders raise errors of many types. Whichever it is, the user can only repair the file.
        except Exception as error:
            self.notices.miss(name, shown(str(error) or type(error).__name__, 100))
            return None
