"""Pixels that are no colours: NaN and infinite ones are counted, marked and found.

Stage: view. A screen shows NaN as black and infinity as white, which nobody can tell from black and white.

    counts(output)              # {"nan": 3, "infinite": 0}
    first(output)               # (row, column) of the first such pixel, or None
    marked(pixels, output)      # the picture, dark, with such pixels in colours that stand out
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_NAN: Final = (255, 0, 200)
_INFINITE: Final = (0, 230, 255)
_DARK: Final = 4
"""By how much the other pixels are darker."""
_SPREAD: Final = 256
"""The pixels along the longer side of a picture for each by which a mark is larger than its pixel, on each side."""


def _kinds(output: Any) -> tuple[NDArray[np.bool_], NDArray[np.bool_]] | None:
    """Return where pixels are NaN, and where they are infinite and not NaN; None where all are finite."""
    array = np.asarray(output)
    if array.dtype.kind != "f" or np.isfinite(array).all():
        return None
    array = array.reshape(*array.shape[:2], -1)
    nan = np.isnan(array).any(axis=-1)
    return nan, np.isinf(array).any(axis=-1) & ~nan


def counts(output: Any) -> dict[str, int]:
    """Return how many pixels are NaN, and how many others infinite."""
    kinds = _kinds(output)
    nan, infinite = (int(kind.sum()) for kind in kinds) if kinds else (0, 0)
    return {"nan": nan, "infinite": infinite}


def first(output: Any) -> tuple[int, int] | None:
    """Return the row and column of the first pixel that is not finite, row by row; None if all are."""
    kinds = _kinds(output)
    if kinds is None:
        return None
    row, column = np.unravel_index(int(np.argmax(kinds[0] | kinds[1])), kinds[0].shape)
    return int(row), int(column)


def marked(pixels: NDArray[np.uint8], output: Any) -> NDArray[np.uint8]:
    """Return pixels (height, width, 4) with marks of NaN and infinite ones, which cover some of their neighbours."""
    kinds = _kinds(output)
    picture = pixels.copy()
    picture[..., :3] //= _DARK
    for kind, color in zip(kinds or (), (_NAN, _INFINITE), strict=False):
        picture[_spread(kind, max(pixels.shape[:2]) // _SPREAD)] = (*color, 255)
    return picture


def _spread(places: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    """Return the places with their neighbours along both axes, up to a distance."""
    mask = places
    for axis in (0, 1):
        padded = np.pad(mask, [(by, by) if k == axis else (0, 0) for k in (0, 1)])
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * by + 1, axis=axis)
        mask = np.asarray(windows.any(axis=-1))
    return mask
