"""The albedo of a sheen: the share of light that the fibres of a cloth send out in all, by the angle of the view.

Stage: scene description. The lobe is that of `charlie`: fibres have the distribution of Estevez and Kulla (2017,
Production Friendly Microfacet Sheen BRDF), and V is Neubelt's and Pettineo's (2013, Crafting a Next-Gen Material
Pipeline for The Order: 1886), as in KHR_materials_sheen. At grazing angles smooth fibres would send out more than 1.

The table is a file of the package, sheen_albedos.npy, by the root of the cosine and by roughness.

>>> sheen_table().shape
(32, 32)
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance.albedo import ACROSS, FINE, ROUNDS, Floats, lack

FINEST: Final = 1 / 15
"""The least roughness of a sheen: its lobe would have no width below it."""
_STEP: Final = 2.0**-12
"""The numbers of the file are multiples of it."""
_DIRECTIONS: Final = 128
"""Directions to the light lie on a lattice of this many heights by as many angles."""


@lru_cache(maxsize=1)
def sheen_table() -> NDArray[np.float32]:
    """Return the albedos, (ACROSS, ACROSS): a row for each roughness."""
    return np.asarray(np.load(Path(__file__).with_name("sheen_albedos.npy")) * _STEP, np.float32)


def compute_sheen_table() -> NDArray[np.uint16]:
    """Compute the contents of the file: the numbers of `sheen_table` in steps of 2**-12.

    Nodes are raised until interpolation errs upward alone: the base below is then a little too dark, never too bright.
    """
    roots = np.linspace(0, 1, FINE * (ACROSS - 1) + 1)
    exact = np.stack([albedos(roots**2, roughness) for roughness in roots])[..., None]
    nodes = exact[::FINE, ::FINE].copy()
    for _ in range(ROUNDS):
        nodes += 0.5 * lack(nodes, exact)
    return np.asarray(np.clip(np.ceil(nodes[..., 0] / _STEP - 1e-9), 0, 65535), np.uint16)


def albedos(cosines: Any, roughness: float) -> Floats:
    """Return the integral of `charlie` over all lights, for cosines (n,) of the view.

    Heights of the light are the squares of numbers that are spread evenly, as the lobe is narrow near the horizon.
    """
    cosines = np.maximum(np.atleast_1d(np.asarray(cosines, np.float64)), 1e-6)[:, None, None]
    part = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    light, angle = np.meshgrid(part**2, np.pi * part, indexing="ij")
    across = np.sqrt(1 - cosines**2) * np.sqrt(1 - light**2) * np.cos(angle)
    both = np.maximum(2 + 2 * (across + cosines * light), 1e-300)  # the square of the sum of the two directions
    sine = np.sqrt(np.clip(1 - (cosines + light) ** 2 / both, 0, 1))
    values = charlie(sine, cosines, light, max(roughness, FINEST)) * light
    measure = 2 * np.pi * 2 * part[:, None]  # d light = 2 part d part; the other half of the circle is the same
    result: Floats = (values * measure).mean(axis=(1, 2))
    return result


def charlie(sine: Any, view: Any, light: Any, roughness: float) -> Any:
    """Return the lobe for white fibres, by the sine of the half vector and the cosines of view and light."""
    inverse = 1 / roughness**2
    fibres = (2 + inverse) * sine**inverse / (2 * np.pi)
    return fibres / (4 * np.maximum(view + light - view * light, 1e-12))
