"""Pictures of linear numbers without an upper end, as skies are stored: Radiance's .hdr and OpenEXR's .exr.

Stage: scene description. Both give (H, W, 3) float32, row 0 at the top.
Sources: G. Ward, "Real Pixels", Graphics Gems II, 1991; the Radiance manual, "Picture File Format".
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raytracer.arrays import real
from raytracer.errors import SceneError
from raytracer.image import openexr

_SIZE = re.compile(rb"([-+])Y (\d{1,9}) ([-+])X (\d{1,9})")
_NARROWEST, _WIDEST = 8, 32767
"""The widths of rows whose four channels may be stored one after the other, in runs."""


def read_hdr(path: Path, largest: int) -> NDArray[np.float32]:
    """Read a Radiance picture, RGBE in runs or not; what its EXPOSURE lines multiplied is divided again.

    Raises SceneError for another file, one that ends early, XYZE colours, and more than `largest` pixels along a side.
    """
    content = path.read_bytes()
    head, blank, rest = content.partition(b"\n\n")
    first, *lines = head.split(b"\n")
    if first not in (b"#?RADIANCE", b"#?RGBE") or not blank:
        raise SceneError("not a Radiance picture: it begins with #?RADIANCE and a header that ends with an empty line")
    variables = [line.partition(b"=") for line in lines if not line.startswith(b"#")]
    formats = {value.strip() for name, _, value in variables if name == b"FORMAT"}
    if formats - {b"32-bit_rle_rgbe"}:
        raise SceneError(f"its FORMAT is {b', '.join(sorted(formats)).decode(errors='replace')}, not 32-bit_rle_rgbe")
    size, _, data = rest.partition(b"\n")
    match = _SIZE.fullmatch(size)
    if match is None:
        raise SceneError(f"its size is written as -Y height +X width, not {size[:40].decode(errors='replace')!r}")
    down, height, right, width = match[1], int(match[2]), match[3], int(match[4])
    check_size(width, height, largest)
    numbers = _colors(_rows(data, height, width)) / np.float32(_exposure(variables))
    return np.ascontiguousarray(numbers[:: 1 if down == b"-" else -1, :: 1 if right == b"+" else -1])


def check_size(width: int, height: int, largest: int) -> None:
    """Raise SceneError for a picture without pixels and for one with too many along a side."""
    if not 0 < width <= largest or not 0 < height <= largest:
        raise SceneError(f"a texture has 1 to {largest} pixels along a side, not {width} x {height}")


def _exposure(variables: list[tuple[bytes, bytes, bytes]]) -> float:
    """Return the product of the EXPOSURE lines."""
    try:
        product = math.prod(real(value.decode("latin-1")) for name, _, value in variables if name == b"EXPOSURE")
    except ValueError:
        product = math.nan
    if not 0 < product < math.inf:
        raise SceneError("its EXPOSURE is a positive number")
    return product


def _rows(data: bytes, height: int, width: int) -> NDArray[np.uint8]:
    """Decode the rows, (H, W, 4) bytes: three mantissas and their exponent."""
    rows = np.empty((height, width, 4), np.uint8)
    head, at = bytes((2, 2, width >> 8, width & 255)), 0
    for row in rows:
        if _NARROWEST <= width <= _WIDEST and data[at : at + 4] == head:
            at = _channels(data, at + 4, row)
        else:
            at = _pixels(data, at, row)
    return rows


def _channels(data: bytes, at: int, row: NDArray[np.uint8]) -> int:
    """Decode a row whose channels follow each other; return where the next row begins."""
    width = len(row)
    for channel in range(4):
        line, done = bytearray(), 0
        while done < width:
            count = data[at] if at < len(data) else 0
            if count > 128:
                line += data[at + 1 : at + 2] * (count - 128)
                at += 2
            else:
                line += data[at + 1 : at + 1 + count]
                at += 1 + count
            if not done < len(line) <= width:
                raise SceneError("it ends early, or a run of its pixels goes beyond the end of a row")
            done = len(line)
        row[:, channel] = np.frombuffer(line, np.uint8)
    return at


def _pixels(data: bytes, at: int, row: NDArray[np.uint8]) -> int:
    """Decode a row of whole pixels, in which 1, 1, 1, n repeats the last one; return where the next row begins."""
    width, done, shift = len(row), 0, 0
    while done < width:
        pixel = data[at : at + 4]
        repeats = pixel[:3] == b"\1\1\1"
        if len(pixel) < 4 or (repeats and not done):
            raise SceneError("it ends early, or its first pixel repeats another")
        count = pixel[3] << shift if repeats else 1
        if done + count > width:
            raise SceneError("a run of its pixels goes beyond the end of a row")
        row[done : done + count] = row[done - 1] if repeats else np.frombuffer(pixel, np.uint8)
        shift = min(shift + 8, 32) if repeats else 0  # further counts are the higher bytes
        done, at = done + count, at + 4
    return at


def _colors(rows: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the colours of RGBE: a mantissa stands for the middle of its step, as Radiance's writer rounds down."""
    exponents = rows[..., 3:].astype(np.int32)
    colors = np.ldexp(rows[..., :3].astype(np.float32) + np.float32(0.5), exponents - (128 + 8))
    return np.where(exponents == 0, np.float32(0), colors)


def read_exr(path: Path, largest: int) -> NDArray[np.float32]:
    """Read the channels R, G and B of an OpenEXR picture, or Y, a grey one.

    Raises SceneError where the package is missing, for other channels and more than `largest` pixels along a side.
    """
    with openexr("reading EXR").File(str(path), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    names = next((names for names in (("R", "G", "B"), ("Y",)) if set(names) <= set(channels)), None)
    if names is None or "RY" in channels:
        raise SceneError(f"it has the channels {', '.join(sorted(channels))}, not R, G and B, or Y alone")
    height, width = channels[names[0]].shape
    check_size(width, height, largest)
    return np.stack([channels[name].astype(np.float32) for name in names], axis=-1)


READERS: Mapping[str, Callable[[Path, int], NDArray[np.float32]]] = {".hdr": read_hdr, ".exr": read_exr}
"""By the ending of the file's name."""
