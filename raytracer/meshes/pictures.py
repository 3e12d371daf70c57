"""The pictures of a mesh file, each decoded once, as the textures that materials take from them.

Stage: scene description. The pictures of a file may have 64 million pixels in all, so that a small file from a stranger
cannot fill the memory; what exceeds that is made smaller.

    pictures = Pictures(notices)
    wood = pictures.get("wood", "wood.png", lambda: folder.find("wood.png"))
    material = Material(color=wood.color((1, 1, 1)) if wood else (0.8, 0.8, 0.8))
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from raytracer.materials import Triple
from raytracer.meshes.folder import Notices, shown
from raytracer.textures import Filter, Texture, Wrap, decoded, opened, pixels_of

MOST: Final = 1 << 26
"""Pixels of all pictures of a file."""
Pixels = NDArray[Any]


class Picture:
    """The pixels (H, W, 1 or 3) of a picture, uint8 or floats in [0, 1], with how a material reads them."""

    def __init__(self, pixels: Pixels, name: str, wrap: Wrap, filter: Filter) -> None:
        self.pixels = pixels if pixels.ndim == 3 else pixels[..., None]
        self.name, self.wrap, self.filter = name, wrap, filter
        self._made: dict[Hashable, Any] = {}

    def color(self, factor: Triple) -> Texture:
        """Return the sRGB colours of the picture times a linear factor; the same Texture for the same factor."""
        if factor == (1.0, 1.0, 1.0):
            made: Texture = self.made(factor, lambda: self.texture(self.pixels, srgb=True))
        else:
            scale = np.asarray(factor, np.float32)
            made = self.made(factor, lambda: self.texture(self._linear() * scale, srgb=False))
        return made

    def mean(self) -> NDArray[np.float64]:
        """The mean of the linear colours, (3,)."""
        found = self.made("mean", lambda: self._linear().mean(axis=(0, 1), dtype=np.float64))
        return np.asarray(np.broadcast_to(found, 3))

    def channel(self, number: int) -> NDArray[np.float32]:
        """Return one channel as it is, (H, W) in [0, 1]."""
        found = self.pixels[..., min(number, self.pixels.shape[2] - 1)]
        return found.astype(np.float32) / np.float32(255 if found.dtype == np.uint8 else 1)

    def texture(self, pixels: Pixels, *, srgb: bool) -> Texture:
        """Return a Texture of other pixels that is read as this picture is."""
        made = Texture(pixels, srgb=srgb, filter=self.filter, wrap=self.wrap)
        made.name = self.name
        return made

    def made(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return what `make` gives, made once for a key."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]

    def _linear(self) -> NDArray[np.float32]:
        if self.pixels.dtype == np.uint8:
            return decoded(np.arange(256) / 255).astype(np.float32)[self.pixels]
        return decoded(self.pixels.astype(np.float64)).astype(np.float32)


class Pictures:
    """The pictures of one mesh file."""

    def __init__(self, notices: Notices) -> None:
        self.notices = notices
        self._left = MOST
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
    ) -> Picture | None:
        """Return the picture that is known by `key`; None, with a notice that has its `name`, if it cannot be read.

        `source` gives its file, the contents of a file, or a picture of Pillow's.
        """
        if key not in self._pixels:
            self._pixels[key] = self._read(name, source)
        pixels = self._pixels[key]
        if pixels is None:
            return None
        return self._pictures.setdefault((key, wrap, filter), Picture(pixels, name, wrap, filter))

    def _read(self, name: str, source: Callable[[], Any]) -> Pixels | None:
        try:
            found = source()
            picture = found if hasattr(found, "convert") else opened(found)
            width, height = picture.size
            factor = 1
            while factor < max(width, height) and (width // factor) * (height // factor) > self._left // 2:
                factor *= 2
            if factor > 1:
                self.notices.ignore(f"detail of pictures beyond {MOST:,} pixels")
                picture = picture.convert("RGB").reduce(factor)
            pixels = pixels_of(picture)
            self._left -= pixels.shape[0] * pixels.shape[1]
            return pixels
        # A decoder's faults have no common type: whatever it raises, the file is what the user can mend.
        except Exception as error:
            self.notices.miss(name, shown(str(error) or type(error).__name__, 100))
            return None
