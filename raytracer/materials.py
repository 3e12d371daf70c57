"""What a surface looks like: the coefficients of Phong's model and how much it mirrors.

Stage: scene description. A `Material` belongs to a mesh; `layout` puts the materials of a scene into a table.

>>> Material(color=(1, 0, 0), reflectivity=0.2).reflectivity
0.2
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from raytracer.errors import SceneError

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Material:
    """A surface in Phong's model (Phong 1975).

    `color` is linear RGB; a mesh's vertex colours multiply it. `diffuse` and `specular` weigh the two lobes,
    `shininess` is the exponent of the highlight, and `reflectivity` in [0, 1] the share of the colour that is the
    mirror image.
    Raises SceneError for what is negative, not finite, or a reflectivity above 1.
    """

    color: Triple = (0.8, 0.8, 0.8)
    diffuse: float = 0.9
    specular: float = 0.25
    shininess: float = 40.0
    reflectivity: float = 0.0

    def __post_init__(self) -> None:
        if len(self.color) != 3:
            raise SceneError(f"a material's color is three numbers (r, g, b), not {self.color!r}")
        numbers = (*self.color, self.diffuse, self.specular, self.shininess, self.reflectivity)
        if not all(math.isfinite(x) and x >= 0 for x in numbers):
            raise SceneError(f"a material's numbers are finite and not negative: {self}")
        if self.reflectivity > 1:
            raise SceneError(f"a reflectivity lies in [0, 1], not {self.reflectivity}")


PLAIN: Final = Material()
"""What a mesh is made of when nothing is said."""
