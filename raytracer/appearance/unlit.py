"""A surface that is seen as it is: no light and no shadow changes it (glTF's KHR_materials_unlit).

Stage: scene description. `kernels.surfaces` shows its colour in place of light.

>>> Unlit((1, 0.5, 0)).tint
(1.0, 0.5, 0.0)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from raytracer.appearance.materials import Triple
from raytracer.appearance.textures import Texture
from raytracer.arrays import one_float, three_floats
from raytracer.errors import SceneError


@dataclass(frozen=True, slots=True)
class Unlit:
    """A surface whose `color`, linear RGB, is what the eye sees, directly, in mirrors and through glass.

    No light shines on it, and it is none: in path tracing light that other surfaces scatter finds it black, as it finds
    a background. It casts shadows. Vertex colours multiply `color`, which may be a `Texture`. `alpha` is the share of
    the surface that is there, a number or a Texture; through the rest light goes straight on. `cutout` is as in
    `Material`. Raises SceneError for negative colours and other numbers than those.
    """

    color: Triple | Texture = (0.8, 0.8, 0.8)
    alpha: float | Texture = 1.0
    cutout: Texture | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.color, Texture):
            color = three_floats(self.color)
            if color is None or not all(0 <= x < math.inf for x in color):
                raise SceneError(
                    f"the color of an Unlit is (r, g, b), each 0 or more, or a Texture, not {self.color!r}"
                )
            object.__setattr__(self, "color", color)
        if not isinstance(self.alpha, Texture):
            alpha = one_float(self.alpha)
            if alpha is None or not 0 <= alpha <= 1:
                raise SceneError(f"the alpha of an Unlit is a number from 0 to 1, or a Texture, not {self.alpha!r}")
            object.__setattr__(self, "alpha", alpha)
        if not isinstance(self.cutout, Texture | None):
            raise SceneError(f"the cutout of an Unlit is a Texture or None, not {self.cutout!r}")

    # What follows has the names of a `Material`: layouts and kernels read both by them.

    surface = shade = None
    absorption = emission = glow = mirror = (0.0, 0.0, 0.0)
    clear_ior = 1.0
    may_mirror = False

    @property
    def textures(self) -> dict[str, Texture]:
        """The textures by the names that kernels have for them."""
        alpha = self.alpha.complement if isinstance(self.alpha, Texture) else None
        fields = {"color": self.color, "transmission": alpha, "cutout": self.cutout}
        return {name: texture for name, texture in fields.items() if isinstance(texture, Texture)}

    @property
    def numbers(self) -> dict[str, float]:
        """The coefficients of Phong's model: it sends out no light that it receives."""
        clear = 1.0 if isinstance(self.alpha, Texture) else 1 - self.alpha
        black = dict.fromkeys(("diffuse", "specular", "shininess", "reflectivity"), 0.0)
        return {**black, "transmission": clear}

    @property
    def is_clear(self) -> bool:
        """True if light goes through a share of the surface."""
        return self.numbers["transmission"] > 0

    @property
    def tint(self) -> Triple:
        """The color; white where it is read from a picture."""
        return (1.0, 1.0, 1.0) if isinstance(self.color, Texture) else self.color
