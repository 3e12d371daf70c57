"""Programs of pixels as PNG files, which notebooks show; they show programs with other inputs by their text.

Stage: picture.
"""

from __future__ import annotations

import io
from typing import Final

import numpy as np
from numpy.typing import NDArray

from shpy.display.screen import Moment, PixelProgram, drawn, is_filled, pixels, unfilled
from shpy.ir.traverse import grid_rank
from shpy.lang.values.structure import Group, Leaf

_SIZE: Final = (384, 384)
"""The width and height of a program's picture in pixels."""


def of_pixels(program: PixelProgram) -> bool:
    """Return whether a program is one of pixels: it reads its place in the picture, and needs no other input.

    Its first output is what is shown, and no matrix.
    """
    shown = program.recorded.output
    while isinstance(shown, Group):
        shown = shown.parts[0]
    is_number = isinstance(shown, Leaf)
    has_place = any(name in ("uv", "pixel") and is_filled(name, type_) for name, type_ in program.inputs.items())
    return is_number and not unfilled(program) and (has_place or grid_rank(program.ir) == 2)


def png(levels: NDArray[np.uint8]) -> bytes | None:
    """Return the PNG file of (height, width, 3 or 4) bytes; None where Pillow is missing."""
    try:
        from PIL import Image
    except ImportError:
        return None
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(levels)).save(file, "PNG")
    return file.getvalue()


def picture(program: PixelProgram) -> bytes | None:
    """Return the PNG file of a program of pixels; None for another program."""
    return png(pixels(drawn(program, Moment(_SIZE)))) if of_pixels(program) else None
