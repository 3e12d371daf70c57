"""Pictures that a material's colour or number is read from, by the uv coordinates of the surface.

Stage: scene description. A `Texture` holds linear numbers; `kernels.appearance` reads them.

>>> Texture([[0.0, 1.0]]).image.shape
(1, 2, 3)
"""

from __future__ import annotations

import functools
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

import shpy as sh
from raytracer.appearance.deep_pictures import deep_pixels
from raytracer.appearance.radiance import READERS
from raytracer.arrays import array_of
from raytracer.errors import SceneError

logging.getLogger("PIL").addHandler(logging.NullHandler())
"""Pillow logs faults besides raising them; without a handler Python prints them."""
Filter = Literal["linear", "nearest"]
Wrap = Literal["repeat", "clamp", "mirror"]
WRAPS: Final = get_args(Wrap)
Transform = tuple[tuple[float, float, float], tuple[float, float, float]]
"""The rows of an affine map of uv coordinates."""
UNMOVED: Final[Transform] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
"""The transform that leaves uv coordinates as they are."""
LARGEST: Final = 16384
"""Pixels along a side."""
_BRIGHTEST: Final = np.finfo(np.float32).max
AT_ONCE: Final = 1 << 16
"""Pixels that are converted at once."""
MOST_SCANS: Final = 100
"""Scans of a JPEG file; ten are usual."""
FORMATS: Final = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "GIF", "TIFF", "PPM")
"""The formats of pictures that are read, by Pillow's names. Pillow knows others that run programs, such as EPS."""


class Texture:
    """A picture over uv coordinates: (0, 0) is its lower left corner and (1, 1) its upper right one.

    `source` is a picture file, or an array (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) with row 0 at the top. Files hold
    sRGB colours, which are decoded, except .hdr and .exr files and TIFF files of floats, which hold linear ones. Arrays
    of uint8 are sRGB, arrays of floats linear. `srgb` overrides this: False for numbers that are not colours, such as a
    reflectivity. A number of a material is read from the red channel. With `alpha` the picture's alpha is read instead
    of its colours, 1 where it has none; otherwise alpha is not used.

    `filter` is "linear" or "nearest". `wrap` decides what lies beyond the picture: it repeats ("repeat"), its edge goes
    on ("clamp"), or it is mirrored ("mirror").

    `transform` ((a, b, c), (d, e, f)) reads the picture at (a u + b v + c, d u + e v + f) in place of (u, v), so
    ((4, 0, 0), (0, 4, 0)) shows it four times along each side. The slopes of a normal map stay along the mesh's uv.

    `image` (H, W, 3) float32 holds the linear numbers. Raises FileNotFoundError, and SceneError for a file that is not
    a picture, another shape, more than 16384 pixels along a side, numbers that are negative or not finite, and another
    transform.
    """

    def __init__(
        self,
        source: str | PathLike[str] | ArrayLike,
        *,
        srgb: bool | None = None,
        filter: Filter = "linear",
        wrap: Wrap = "repeat",
        alpha: bool = False,
        transform: Transform | None = None,
    ) -> None:
        for choice, choices, what in ((filter, get_args(Filter), "filter"), (wrap, WRAPS, "wrap")):
            if choice not in choices:
                raise SceneError(f"a texture's {what} is one of {', '.join(map(repr, choices))}, not {choice!r}")
        self.filter: Filter = filter
        self.wrap: Wrap = wrap
        self.transform = None if transform is None else _affine(transform)
        if isinstance(source, str | PathLike):
            self.name = str(source)
            pixels, encoded = _read(Path(source), alpha)
            srgb = encoded if srgb is None else srgb
        else:
            self.name = "a texture"
            pixels = array_of("the pixels of a texture", source)
            if alpha:
                pixels = pixels[..., 3:] if pixels.ndim == 3 and pixels.shape[2] == 4 else np.ones((1, 1))
        self.image: NDArray[np.float32] = _linear(pixels, False if alpha else srgb, self.name)

    @functools.cached_property
    def complement(self) -> Texture:
        """The texture of 1 minus the numbers of this one, where these are at most 1."""
        other = Texture(1 - np.minimum(self.image, 1), srgb=False, filter=self.filter, wrap=self.wrap)
        other.name, other.transform = self.name, self.transform
        return other

    def __repr__(self) -> str:
        height, width = self.image.shape[:2]
        return f"<Texture {self.name}, {width} x {height}>"


def _affine(transform: Any) -> Transform:
    """Return the rows of a transform of uv coordinates."""
    rows = array_of("the transform of a texture", transform).astype(np.float64)
    if rows.shape != (2, 3) or not (np.abs(rows) <= _BRIGHTEST).all():
        raise SceneError(f"the transform of a texture is two rows of three finite numbers, not {transform!r}")
    (a, b, c), (d, e, f) = rows.tolist()
    return (a, b, c), (d, e, f)


def _read(path: Path, alpha: bool) -> tuple[NDArray[Any], bool]:
    """Read the pixels of a picture file, (H, W, 1 or 3): uint8, or float32 where the file has more than 8 bits.

    Return also whether they are sRGB. With `alpha`, read its alpha channel instead; a picture without one gives a
    single pixel of 1.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no picture {path}")
    read = READERS.get(path.suffix.lower())
    try:
        if read is not None:
            return np.ones((1, 1), np.float32) if alpha else read(path, LARGEST), False
        with opened(path) as picture:
            pixels = pixels_of(picture, alpha=alpha)
            return np.ones((1, 1), np.float32) if pixels is None else pixels, not alpha and picture.mode != "F"
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    # Decoders raise errors of many types. Whichever it is, the user can only repair the file.
    except Exception as error:
        raise SceneError(f"{path}: not a readable picture ({' '.join(str(error).split())[:200]})") from error


@contextmanager
def opened(source: Path | BinaryIO) -> Iterator[Any]:
    """Open a picture with Pillow, from a file or its contents, without decoding it; raise whatever Pillow raises.

    Hide Pillow's warnings: they come at half the number of pixels that it refuses, and for faults that it repairs.
    Raises SceneError where Pillow is missing, and for a picture with more than 16384 pixels along a side.
    """
    try:
        from PIL import Image as pillow, UnidentifiedImageError
    except ImportError as error:
        raise SceneError(f"reading pictures needs Pillow: {sh.packages.install('pillow')}") from error
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            picture = pillow.open(source, formats=FORMATS)
        except UnidentifiedImageError:
            raise SceneError(f"not a readable picture: none of {', '.join(FORMATS)}") from None
        with picture:
            if max(picture.size) > LARGEST:
                raise SceneError(f"a texture has at most {LARGEST} pixels along a side, not {picture.size}")
            if picture.format == "JPEG" and _scans(picture.fp) > MOST_SCANS:
                raise SceneError(f"it goes over its pixels more than {MOST_SCANS} times")
            yield picture


def _scans(file: Any) -> int:
    """Count the scans of a JPEG file: each of a few bytes may change all pixels."""
    place = file.tell()
    file.seek(0)
    count: int = file.read().count(b"\xff\xda")
    file.seek(place)
    return count


def pixels_of(picture: Any, *, alpha: bool = False, fit: Callable[[], int] = lambda: 1) -> NDArray[Any] | None:
    """Return the colours of a Pillow picture, (H, W) or (H, W, 1 or 3), or its alpha, (H, W); None if it has none.

    They are uint8, or float32 in [0, 1] where it has 16 bits a channel. `fit` gives the factor by which each side is
    made shorter; it is called where there are pixels.
    """
    deep = deep_pixels(picture)
    if deep is not None:
        clear = deep.shape[2] % 2 == 0
        if alpha:
            return _reduced(deep[..., -1:], fit())[..., 0] if clear else None
        return _reduced(deep[..., :-1] if clear else deep, fit())
    if alpha:
        picture = alpha_of(picture)
        if picture is None:
            return None
    factor = fit()
    if picture.mode != "F":
        picture = picture.convert("L" if picture.mode in ("1", "L", "LA") else "RGB")
    return np.asarray(picture if factor == 1 else picture.reduce(factor))


def _reduced(numbers: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Return the means of numbers (H, W, C) over squares, as `reduce` of Pillow gives them."""
    if factor == 1:
        return numbers
    from PIL import Image as pillow

    channels = [pillow.fromarray(np.ascontiguousarray(part)) for part in np.moveaxis(numbers, 2, 0)]
    return np.stack([np.asarray(part.reduce(factor)) for part in channels], axis=2)


def alpha_of(picture: Any) -> Any:
    """Return the alpha of a Pillow picture as a grey picture; None if it has none."""
    keyed = "transparency" in picture.info and picture.mode in ("1", "L", "RGB")  # one colour is transparent
    if keyed or picture.mode in ("P", "PA"):  # colours of a palette may be transparent
        picture = picture.convert("RGBA")
    return picture.getchannel("A") if picture.mode in ("LA", "RGBA") else None  # the A of LAB is a colour


def _linear(pixels: NDArray[Any], srgb: bool | None, name: str) -> NDArray[np.float32]:
    """Return linear RGB (H, W, 3)."""
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 3, 4) or not pixels.size:
        raise SceneError(f"{name} has the shape (H, W), (H, W, 1), (H, W, 3) or (H, W, 4), not {pixels.shape}")
    if max(pixels.shape[:2]) > LARGEST:
        raise SceneError(f"{name} has at most {LARGEST} pixels along a side, not {pixels.shape[1]} x {pixels.shape[0]}")
    whole = pixels.dtype.kind in "iub"
    if pixels.dtype.kind not in "iubf" or (whole and pixels.dtype != np.uint8):
        cures = {"bool": ": write array.astype(float)", "uint16": ": write array / 65535, and srgb=True for colours"}
        cure = cures.get(str(pixels.dtype), ": write array.astype(np.uint8)" if whole else "")
        raise SceneError(f"{name} holds floats or uint8, not {pixels.dtype}{cure}")
    encoded = whole if srgb is None else srgb
    if not whole and not ((pixels[..., :3] >= 0) & (pixels[..., :3] <= _BRIGHTEST)).all():
        raise SceneError(f"{name} holds numbers that are negative, not finite, or out of the range of binary32")
    return linear(pixels, encoded=encoded)


def linear(pixels: NDArray[Any], *, encoded: bool, channels: int = 3) -> NDArray[np.float32]:
    """Return linear numbers (H, W, channels) of pixels (H, W, 1, 3 or 4), uint8 or floats, which are sRGB if `encoded`.

    Some rows are converted at a time, as formulas in binary64 take several times the memory of the pixels.
    """
    height, width = pixels.shape[:2]
    image = np.empty((height, width, channels), np.float32)
    levels = np.arange(256) / 255
    table = (decoded(levels) if encoded else levels).astype(np.float32)
    rows = max(1, AT_ONCE // width)
    for top in range(0, height, rows):
        part = pixels[top : top + rows, :, :3]
        if part.dtype == np.uint8:
            part = table[part]
        elif encoded:
            part = decoded(part.astype(np.float64))
        image[top : top + rows] = part
    return image


def decoded(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert sRGB numbers in [0, 1] to linear ones (IEC 61966-2-1)."""
    return np.where(numbers <= 0.04045, numbers / 12.92, ((numbers + 0.055) / 1.055) ** 2.4)
