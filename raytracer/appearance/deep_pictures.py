"""Pictures of more than 8 bits a channel, whole: Pillow keeps 8 bits of each where there are several channels.

Stage: scene description. Pillow's decoders unpack 16 bits of a channel to their upper byte, by the byte order that they
are told. Told the other order, they give the lower byte. So such a picture is decoded twice, by the decoders of PNG and
TIFF, and the bytes are put together here.

    with opened(path) as picture:
        numbers = deep_pixels(picture)      # None for 8 bits
"""

from __future__ import annotations

import re
import sys
from io import BytesIO
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from raytracer.errors import SceneError

Numbers = NDArray[np.float32]
_DEEP: Final = re.compile("(LA|RGB|RGBA|RGBX|RGBa|CMYK);16([BLN])")
"""Pillow's names of the layouts that it cuts to 8 bits: channels, then the byte order, N for the machine's own."""
_BITS_PER_SAMPLE, _PLANAR, _PLANES = 258, 284, 2
"""Tags of TIFF, and the value of the second that stands for planes."""


def is_deep(picture: Any) -> bool:
    """Return whether a picture that Pillow has not decoded yet has several channels of 16 bits."""
    return picture.mode not in ("I", "F") and _layout(picture) is not None


def deep_pixels(picture: Any) -> Numbers | None:
    """Return the numbers (H, W, C) in [0, 1] of a picture of 16 bits a channel that Pillow has not decoded yet.

    C is 1 for grey, 3 for RGB; 2 and 4 are those with alpha. None for pictures of 8 bits and for floats. Raises
    SceneError for a TIFF of 16 bits whose channels lie in planes.
    """
    layout = _layout(picture)
    if picture.mode.startswith("I"):
        numbers = np.asarray(picture, np.float32)[..., None] / np.float32(65535)
    elif layout is None:
        return None
    elif layout[0] == "ppm":
        numbers = _ppm(picture)
    else:
        numbers = _joined(picture, *layout)
    key = picture.info.get("transparency")
    if picture.format != "PNG" or not isinstance(key, int | tuple):
        return numbers
    clear = (np.rint(numbers * 65535) == key).all(axis=2, keepdims=True)
    return np.concatenate([numbers, 1 - clear.astype(np.float32)], axis=2)


def _layout(picture: Any) -> tuple[str, str] | None:
    """Return the channels and the order of the bytes where Pillow would keep the upper ones alone."""
    tiles = getattr(picture, "tile", ())
    if not tiles:
        return None
    arguments = tiles[0][3]
    layout = arguments if isinstance(arguments, str) else arguments[0]
    if picture.format == "PPM":
        return ("ppm", "B") if picture.mode == "RGB" and layout == "RGB" and _most(picture) > 255 else None
    if picture.format == "TIFF" and picture.tag_v2.get(_PLANAR) == _PLANES:
        bits = picture.tag_v2.get(_BITS_PER_SAMPLE, (8,))
        if len(bits) > 1 and max(bits) > 8:
            raise SceneError(
                "its channels of 16 bits lie in planes, which are not read: save it with interleaved channels"
            )
    match = _DEEP.fullmatch(str(layout))
    return None if match is None else (match[1], match[2])


def _joined(picture: Any, channels: str, order: str) -> Numbers:
    """Return the numbers of a picture from its two bytes."""
    if channels == "LA":  # as four channels of 8 bits
        both = _decoded(picture, "RGBA")
        upper, lower = both[..., ::2], both[..., 1::2]
    else:
        order = order if order != "N" else "L" if sys.byteorder == "little" else "B"
        stored = "RGBA" if channels == "RGBa" else channels  # Pillow would divide each byte by the alpha
        upper, lower = (_decoded(picture, f"{stored};16{way}") for way in (order, "L" if order == "B" else "B"))
    numbers = np.multiply(upper, np.float32(256), dtype=np.float32)
    numbers += lower
    numbers /= np.float32(65535)
    if channels == "RGBa":
        numbers[..., :3] = np.minimum(numbers[..., :3] / np.maximum(numbers[..., 3:], np.float32(1 / 65535)), 1)
    return (1 - numbers[..., :3]) * (1 - numbers[..., 3:]) if channels == "CMYK" else numbers


def _decoded(picture: Any, layout: str) -> NDArray[np.uint8]:
    """Return the bytes that Pillow unpacks from a picture by this layout."""
    from PIL import Image as pillow

    place = picture.fp.tell()
    picture.fp.seek(0)
    data = picture.fp.read()
    picture.fp.seek(place)
    with pillow.open(BytesIO(data), formats=[picture.format]) as again:
        again.tile = [_unpacked_by(layout, tile) for tile in again.tile]
        return np.asarray(again)


def _unpacked_by(layout: str, tile: Any) -> Any:
    """Return a tile of Pillow's with another layout: a tuple, from version 11 on one with names."""
    before = tile[3]
    arguments = layout if isinstance(before, str) else (layout, *before[1:])
    return tile._replace(args=arguments) if hasattr(tile, "_replace") else (*tile[:3], arguments)


def _most(picture: Any) -> int:
    """Return the largest number of a PPM picture, 255 where Pillow does not say it."""
    arguments = picture.tile[0][3]
    return 255 if isinstance(arguments, str) else int(arguments[1])


def _ppm(picture: Any) -> Numbers:
    """Return the numbers of a coloured PPM picture, in bytes or as a text."""
    decoder, _, start = picture.tile[0][:3]
    width, height = picture.size
    count, most = 3 * width * height, np.float32(_most(picture))
    picture.fp.seek(start)
    if decoder == "ppm":
        numbers = np.frombuffer(picture.fp.read(2 * count), ">u2")
    else:
        numbers = np.array(re.sub(rb"#[^\r\n]*", b" ", picture.fp.read()).split()[:count], np.uint16)
    if numbers.size < count:
        raise SceneError(f"it ends after {numbers.size:,} of {count:,} numbers")
    return np.minimum(numbers.reshape(height, width, 3) / most, np.float32(1))
