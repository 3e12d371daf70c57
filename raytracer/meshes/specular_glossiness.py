"""The material of KHR_materials_pbrSpecularGlossiness as one of metallic-roughness.

Stage: scene description. The conversion is that of the extension's own examples (Khronos, "Converting between workflows
in glTF"): a surface that is a metal by the share m has the colour c and the specular colour 0.04 (1 - m) + c m.

>>> color, metallic, roughness = converted((0, 0, 0), (1, 0.7, 0.3), 0.75, None)
>>> color, metallic, roughness
((1.0, 0.7, 0.3), 1.0, 0.25)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance.materials import Triple

_DIELECTRIC: Final = 0.04
"""The share of light that is reflected at normal incidence by what is no metal."""
_PERCEIVED: Final = np.array((0.299, 0.587, 0.114))
"""The weights of the squared channels in the brightness that is perceived."""


def converted(
    diffuse: Sequence[float], specular: Sequence[float], glossiness: float, picture: NDArray[np.float64] | None
) -> tuple[Triple, float, float]:
    """Return the colour, metallic and roughness for colours (3,).

    `picture` (3,) is the mean of the picture that multiplies `diffuse`. With a picture, the colour is the factor that
    multiplies it; for a surface that is more than half a metal, the colour replaces the picture.
    """
    factor, shine = np.asarray(diffuse, np.float64), np.asarray(specular, np.float64)
    seen = factor if picture is None else factor * picture
    left = 1 - float(shine.max())
    metallic = _metallic(_brightness(seen), _brightness(shine), left)
    matt = factor * (left / (1 - _DIELECTRIC) / max(1 - metallic, 1e-6))
    metal = (shine - _DIELECTRIC * (1 - metallic)) / max(metallic, 1e-6)
    share = metallic**2 if picture is None else float(is_metal(metallic))
    r, g, b = np.clip(matt + share * (metal - matt), 0, 1).tolist()
    return (r, g, b), metallic, min(max(1 - glossiness, 0.0), 1.0)


def is_metal(metallic: float) -> bool:
    """Return whether a surface shows its specular colour more than its diffuse one."""
    return metallic**2 > 0.5


def _brightness(color: NDArray[np.float64]) -> float:
    return float(np.sqrt(_PERCEIVED @ color**2))


def _metallic(diffuse: float, specular: float, left: float) -> float:
    """Solve for the share that is a metal, from brightnesses: a quadratic equation."""
    if specular < _DIELECTRIC:
        return 0.0
    b = diffuse * left / (1 - _DIELECTRIC) + specular - 2 * _DIELECTRIC
    root = math.sqrt(max(b * b - 4 * _DIELECTRIC * (_DIELECTRIC - specular), 0.0))
    return min(max((root - b) / (2 * _DIELECTRIC), 0.0), 1.0)
