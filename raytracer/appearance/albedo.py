"""Tables of albedos: the share of light that a rough mirror, or a sheen, sends out in all, by the angle of the view.

Stage: scene description. With Schlick's approximation (1994) the albedo of GGX is linear in the shares F0 and F90 that
are mirrored at normal and at grazing incidence: F0 (a - b) + F90 b. The integrals a, of white, and b, of Schlick's
fifth power, stand in a table by the root of the cosine and by roughness (Karis 2013, Real Shading in Unreal Engine 4;
Kulla and Conty 2017, Revisiting Physically Based Shading at Imageworks).

The lobe of a sheen is that of KHR_materials_sheen: fibres have the distribution of Estevez and Kulla (2017, Production
Friendly Microfacet Sheen BRDF), and V is Neubelt's and Pettineo's (2013, Crafting a Next-Gen Material Pipeline for The
Order: 1886). At grazing angles smooth fibres would send out more than 1.

The tables are files of the package, albedos.npy and sheen_albedos.npy, since the workers of a cluster must agree on the
last bits, which would depend on a machine's library of functions. tests/raytracer/albedo_integrals.py computes them, in
15 s and more.

>>> albedo_table().shape, sheen_table().shape
((32, 33, 2), (32, 32))
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

ACROSS: Final = 32
"""The cosines, and the roughnesses, of a table."""
SMOOTHEST: Final = 1 / (ACROSS - 1)
"""The roughness below which a surface is a mirror: that of the second row of the table."""
FINEST: Final = 1 / 15
"""The least roughness of a sheen: its lobe would have no width below it."""
STEP: Final = 1 / 65535
SHEEN_STEP: Final = 2.0**-12
"""The numbers of the files are multiples of these."""


@lru_cache(maxsize=1)
def albedo_table() -> NDArray[np.float32]:
    """Return a - b and b, (ACROSS, ACROSS + 1, 2): a row for each roughness; its last element is the cosines' mean."""
    return np.asarray(np.load(Path(__file__).with_name("albedos.npy")) * STEP, np.float32)


@lru_cache(maxsize=1)
def sheen_table() -> NDArray[np.float32]:
    """Return the albedos of a sheen, (ACROSS, ACROSS): a row for each roughness."""
    return np.asarray(np.load(Path(__file__).with_name("sheen_albedos.npy")) * SHEEN_STEP, np.float32)
