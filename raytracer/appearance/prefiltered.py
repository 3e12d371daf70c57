"""An environment as rough mirrors show it: its light, blurred by the lobes of rising roughness.

Stage: scene description. Takes the radiance of parts of the sphere, gives levels, one for each of some roughnesses. As
for the first sum of Karis (2013, Real Shading in Unreal Engine 4), the view and the normal are taken to lie in the
mirrored direction; so a lobe is a function of the angle to it, and to blur is to convolve on the sphere. Along a row
that is a product of Fourier series. At the roughness 1 the lobe is the cosine: the last level is the light that a white
matt surface sends out (Ramamoorthi and Hanrahan 2001, An Efficient Representation for Irradiance Environment Maps).

>>> prefiltered(np.ones((ROWS, 2 * ROWS, 3))).shape
(8, 64, 128, 3)
"""

from __future__ import annotations

from math import pi
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

LEVELS: Final = 8
"""The levels, of the roughnesses 1 / 8, 2 / 8, and so on to 1."""
ROWS: Final = 64
"""The rows of a level; it has twice as many columns. The lobe of roughness 1 / 8 is as wide as a row."""
Floats = NDArray[np.float64]


def prefiltered(cells: Any) -> NDArray[np.float32]:
    """Return the levels (LEVELS, H, W, 3) of the mean radiance of cells (H, W, 3), row 0 at the top.

    Each is a mean, whose weights add up to 1: a level of even light is that light.
    """
    height, width = cells.shape[:2]
    heights = np.cos((np.arange(height) + 0.5) * (pi / height))
    sines = np.sqrt(1 - heights**2)
    turns = np.cos(np.arange(width) * (2 * pi / width))
    cosines = heights[:, None, None] * heights[:, None] + sines[:, None, None] * sines[:, None] * turns
    areas = -np.diff(np.cos(np.linspace(0, pi, height + 1)))
    light = np.fft.rfft(cells, axis=1)
    levels = np.empty((LEVELS, *cells.shape), np.float32)
    for number, level in enumerate(levels, 1):
        weights = lobe_of(cosines, number / LEVELS) * areas[:, None]
        sums = weights.sum(axis=(1, 2))[:, None, None]
        blurred = np.einsum("ijk,jkc->ikc", np.fft.rfft(weights, axis=2).real, light, optimize=True)
        level[:] = np.fft.irfft(blurred, width, axis=1) / sums
    # Rounding leaves a part of 1e-16 of the brightest light where there is none.
    low, high = (end(cells, axis=(0, 1)).astype(np.float32) for end in (np.min, np.max))
    return np.asarray(np.clip(levels, low, high))


def lobe_of(cosines: Any, roughness: float) -> Floats:
    """Return the weights of light at these cosines to the mirrored direction: GGX times the cosine, up to a factor."""
    square = roughness**4
    facing = (1 + cosines) / 2  # the square of the cosine of half the angle
    return np.asarray(np.maximum(cosines, 0) / (facing * (square - 1) + 1) ** 2)


def means(values: Any, rows: int, columns: int) -> Floats:
    """Return the means of an equirectangular picture (H, W, 3) over cells that are no smaller than its texels."""
    height, width = values.shape[:2]
    down = _overlaps(np.cos(np.linspace(0, pi, rows + 1)), np.cos(np.linspace(0, pi, height + 1)))
    across = _overlaps(np.linspace(0, -1, columns + 1), np.linspace(0, -1, width + 1))
    return np.stack([down @ values[..., channel] @ across.T for channel in range(3)], axis=-1)


def _overlaps(cells: Floats, texels: Floats) -> Floats:
    """Return the share of each texel in each cell (cells, texels), for edges that descend."""
    shared = np.minimum(cells[:-1, None], texels[:-1]) - np.maximum(cells[1:, None], texels[1:])
    shared = np.maximum(shared, 0)
    return np.asarray(shared / shared.sum(axis=1, keepdims=True))
