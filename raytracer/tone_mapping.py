"""Tone mapping: linear light of any brightness as linear colours from 0 to 1, for pictures that a screen shows.

Stage: picture. `Image.save(tonemap=...)` names a curve; files of numbers hold the light as it is.

>>> mapped(np.full((1, 3), 4.0), "reinhard").tolist()
[[0.8, 0.8, 0.8]]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from raytracer.errors import SceneError

Tonemap = Literal["none", "reinhard", "aces", "agx", "neutral"]
Colors = NDArray[Any]

_LUMINANCE: Final = np.array((0.2126, 0.7152, 0.0722))
_TO_ACES: Final = np.array(((0.59719, 0.35458, 0.04823), (0.07600, 0.90834, 0.01566), (0.02840, 0.13383, 0.83777)))
_OF_ACES: Final = np.array(
    ((1.60475, -0.53108, -0.07367), (-0.10208, 1.10813, -0.00605), (-0.00327, -0.07276, 1.07602))
)
_INSET: Final = 0.8 * np.eye(3) + 0.2 * np.array((0.21200536, 0.39218250, 0.39581214))
_DARKEST, _STOPS = -12.47393, 16.5
"""The logarithm, to the base 2, of the light that AgX shows as black, and the stops from there to white."""
_PIVOT: Final = 20 / 33
"""The place of AgX's middle grey between black and white; the curve has the slope 2 there, and the height 1/2."""
_BRIGHTEST = 2.0**256
"""Light beyond all of binary32 at every exposure, whose square is finite in binary64."""
_COMPRESSED, _DIELECTRIC, _DESATURATION = 0.8, 0.04, 0.15
"""The brightness from which Khronos's curve compresses, the share that surfaces mirror, and how fast colours fade."""


def none(color: Colors) -> Colors:
    """Return the colours themselves: what exceeds 1 is clipped when it is shown."""
    return color


def reinhard(color: Colors) -> Colors:
    """Divide colours by 1 + their luminance (Reinhard and others 2002, equation 3)."""
    luminance: Colors = color @ _LUMINANCE
    shown: Colors = color / (1 + luminance[..., None])
    return shown


def aces(color: Colors) -> Colors:
    """Apply Stephen Hill's fit of the reference and output transforms of ACES 1.0 (BakingLab, 2016)."""
    x = color @ _TO_ACES.T
    fit = (x * (x + 0.0245786) - 0.000090537) / (x * (0.983729 * x + 0.4329510) + 0.238081)
    shown: Colors = fit @ _OF_ACES.T
    return shown


def agx(color: Colors) -> Colors:
    """Apply Troy Sobotka's AgX (2022): logarithms of colours that were drawn together, and a sigmoid of them.

    The sigmoid is 1/2 + 2 d (1 + a |d|**p)**(-1/p) with d the distance from the pivot; p is 3.25 above it and 3 below,
    and a lets the curve end at 1 and at 0. Its result is for a screen of the exponent 2.2.
    """
    light = np.log2(np.maximum(color @ _INSET.T, 2.0**_DARKEST))
    d = np.clip((light - _DARKEST) / _STOPS, 0, 1) - _PIVOT
    above = d > 0
    power, reach = np.where(above, 3.25, 3.0), np.where(above, 1 - _PIVOT, _PIVOT)
    a = ((4 * reach) ** power - 1) / reach**power
    shown = 0.5 + 2 * d * (1 + a * np.abs(d) ** power) ** (-1 / power)
    ended: Colors = np.clip(shown @ np.linalg.inv(_INSET).T, 0, 1)
    return ended**2.2


def neutral(color: Colors) -> Colors:
    """Apply Khronos's PBR Neutral (2024), which keeps colours up to 0.8 less what a surface mirrors, 0.04."""
    least = color.min(axis=-1, keepdims=True)
    offset = np.where(least < 2 * _DIELECTRIC, least - least * least / (4 * _DIELECTRIC), _DIELECTRIC)
    below = color - offset
    peak = below.max(axis=-1, keepdims=True)
    start = _COMPRESSED - _DIELECTRIC
    room = 1 - start
    lower = 1 - room * room / np.maximum(peak + room - start, room)
    grey = 1 - 1 / (_DESATURATION * (peak - lower) + 1)
    bright = below * (lower / np.maximum(peak, start))
    return np.where(peak < start, below, bright + grey * (lower - bright))


CURVES: Final[Mapping[str, Callable[[Colors], Colors]]] = {
    "none": none, "reinhard": reinhard, "aces": aces, "agx": agx, "neutral": neutral,
}  # fmt: skip


def checked_curve(tonemap: Any) -> str:
    """Return the name of a curve; SceneError for another one."""
    if not (isinstance(tonemap, str) and tonemap in CURVES):
        raise SceneError(f"tonemap is one of {', '.join(map(repr, CURVES))}, not {tonemap!r}")
    return tonemap


def mapped(pixels: NDArray[Any], tonemap: str = "none", exposure: float = 0.0) -> Colors:
    """Return linear colours (..., 3) times 2**exposure through a curve, in binary64; negative light counts as 0.

    Infinite light counts as very bright light, which every curve shows as its white, and not as the NaN of inf / inf.
    """
    light: Colors = pixels.astype(np.float64) * 2.0**exposure
    return light if tonemap == "none" else CURVES[tonemap](np.clip(light, 0, _BRIGHTEST))
