"""The material of glTF 2.0: a base colour, how metallic it is, and how rough; with a clear coat, or as a thin wall.

Stage: scene description. `kernels.microfacets` says how it scatters light.

>>> MetallicRoughness(base_color=(1, 0.77, 0.34), metallic=1).tint
(1.0, 0.77, 0.34)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from raytracer.appearance.materials import Material, Triple, hashable, mean_color
from raytracer.appearance.textures import Texture
from raytracer.appearance.unlit import Unlit
from raytracer.arrays import one_float, three_floats
from raytracer.errors import SceneError

_SHARES: Final = (
    *("metallic", "roughness", "specular", "clearcoat", "clearcoat_roughness", "sheen_roughness"),
    *("anisotropy", "transmission", "alpha"),
)
"""The fields that are a number from 0 to 1."""
_COLORS: Final = {"base_color": 1.0, "specular_color": math.inf, "sheen_color": 1.0, "emission": math.inf}
"""The fields that are a colour, and the largest number of each."""
_DARKEST: Final = 2.0**-24
"""The least share of light that an attenuation leaves: a finite absorption never reaches 0."""
_KERNEL_NAMES: Final = {
    "base_color": "color", "metallic": "metallic", "roughness": "roughness", "ior": "index", "specular": "specular",
    "specular_color": "tint", "clearcoat": "clearcoat", "clearcoat_roughness": "clearcoat_roughness",
    "sheen_color": "sheen", "sheen_roughness": "sheen_roughness", "transmission": "thin", "emission": "emission",
    "cutout": "cutout", "normal": "normal_map", "anisotropy": "brush",
}  # fmt: skip
"""The names that kernels have for the fields that may be a `Texture`; `alpha` is a transmission there."""


@dataclass(frozen=True, slots=True)
class MetallicRoughness:
    """A surface in the metallic-roughness model of glTF 2.0, which never sends out more light than it receives.

    `base_color`, linear RGB in [0, 1], is the colour of the matt light of what is no metal (`metallic` 0) and of the
    mirror image in a metal (`metallic` 1). `roughness` goes from a mirror (0) to a surface without highlights (1). What
    is no metal mirrors by its refractive index `ior`, times `specular`, tinted by `specular_color`; `ior` 0 mirrors
    all. `clearcoat` is the share of a clear coat over it, of the roughness `clearcoat_roughness`. Between both lies a
    sheen, as of the fibres of velvet, of the colour `sheen_color` and the roughness `sheen_roughness`.

    `anisotropy` stretches highlights, as brushed metal does: from 0 to 1, the surface is rougher along the direction in
    which u grows, turned by `anisotropy_rotation` degrees to where v grows. Its mesh needs uv coordinates. A `Texture`
    of it has the direction in red and green, 0.5 for 0, and the strength in blue, as in KHR_materials_anisotropy.
    With `multiscatter` a rough metal sends out the light, too, that goes from microfacet to microfacet.

    `transmission` is the share of what is no metal that is a thin clear wall, tinted by the base colour: light goes
    straight on, in path tracing blurred by `roughness`. With a `thickness` above 0 it is the surface of a body instead,
    whose mesh is closed: light is refracted by `ior`, and the base colour tints it on its way in and out. A way of
    `attenuation_distance` inside leaves `attenuation_color` of white light.

    `emission` is as in `Material`. `alpha` is the share of the surface that is there; through the rest light goes
    straight on. `cutout` is as in `Material`, and `normal` is a picture of normals as its `normal_map`.

    Each number and colour may be a `Texture`. `surface` is a program as in `Material`; its Surface gives base_color (or
    color), metallic, roughness, specular, clearcoat, clearcoat_roughness, sheen_color, sheen_roughness, anisotropy,
    anisotropy_rotation, emission and normal.

    Both sides of a triangle are seen, as of every material. docs/materials.md has the model and its sources. Raises
    SceneError for numbers out of their ranges, for what is neither a number nor a Texture, and for a body with an alpha
    or a picture of its metal or its refractive index.
    """

    base_color: Triple | Texture = (0.8, 0.8, 0.8)
    metallic: float | Texture = 0.0
    roughness: float | Texture = 0.5
    ior: float | Texture = 1.5
    specular: float | Texture = 1.0
    specular_color: Triple | Texture = (1.0, 1.0, 1.0)
    clearcoat: float | Texture = 0.0
    clearcoat_roughness: float | Texture = 0.0
    sheen_color: Triple | Texture = (0.0, 0.0, 0.0)
    sheen_roughness: float | Texture = 0.0
    anisotropy: float | Texture = 0.0
    anisotropy_rotation: float = 0.0
    transmission: float | Texture = 0.0
    thickness: float = 0.0
    attenuation_color: Triple = (1.0, 1.0, 1.0)
    attenuation_distance: float = math.inf
    emission: Triple | Texture = (0.0, 0.0, 0.0)
    alpha: float | Texture = 1.0
    normal: Texture | None = None
    cutout: Texture | None = None
    surface: Callable[..., Any] | None = None
    multiscatter: bool = False

    def __post_init__(self) -> None:
        for name in _SHARES:
            self._check_number(name, 1.0, "a number from 0 to 1")
        self._check_number("ior", math.inf, "a refractive index, such as 1.5, or 0 for what mirrors all")
        for name, largest in _COLORS.items():
            color = getattr(self, name)
            if isinstance(color, Texture):
                continue
            triple = three_floats(color)
            if triple is None or not all(0 <= x <= largest and x < math.inf for x in triple):
                bound = "from 0 to 1" if largest == 1 else "0 or more"
                raise SceneError(f"the {name} of a material is (r, g, b), each {bound}, or a Texture, not {color!r}")
            object.__setattr__(self, name, triple)
        self._check_body()
        rotation = one_float(self.anisotropy_rotation)
        if rotation is None or not math.isfinite(rotation):
            raise SceneError(f"an anisotropy_rotation is a number of degrees, not {self.anisotropy_rotation!r}")
        object.__setattr__(self, "anisotropy_rotation", rotation)
        if not isinstance(self.multiscatter, bool):
            raise SceneError(f"multiscatter is True or False, not {self.multiscatter!r}")
        for name in ("normal", "cutout"):
            if not isinstance(picture := getattr(self, name), Texture | None):
                raise SceneError(f"the {name} of a material is a Texture or None, not {picture!r}")
        if self.surface is not None and not callable(self.surface):
            raise SceneError(f"a material's surface is a function or a program, not {self.surface!r}")
        object.__setattr__(self, "surface", hashable(self.surface))

    def _check_number(self, name: str, largest: float, kind: str) -> None:
        value = getattr(self, name)
        if isinstance(value, Texture):
            return
        number = one_float(value)
        if number is None or not 0 <= number <= largest or number == math.inf:
            raise SceneError(f"the {name} of a material is {kind}, or a Texture, not {value!r}")
        object.__setattr__(self, name, number)

    def _check_body(self) -> None:
        thickness, distance = one_float(self.thickness), one_float(self.attenuation_distance)
        color = three_floats(self.attenuation_color)
        if thickness is None or not 0 <= thickness < math.inf:
            raise SceneError(f"the thickness of a material is a number, 0 or more, not {self.thickness!r}")
        if distance is None or not distance > 0:
            raise SceneError(f"an attenuation_distance is a number above 0, or inf, not {self.attenuation_distance!r}")
        if color is None or not all(0 <= x <= 1 for x in color):
            raise SceneError(f"an attenuation_color is (r, g, b), each from 0 to 1, not {self.attenuation_color!r}")
        numbers = {"thickness": thickness, "attenuation_distance": distance, "attenuation_color": color}
        for name, number in numbers.items():
            object.__setattr__(self, name, number)
        if not self.is_body:
            return
        if self.alpha != 1:
            raise SceneError("a body, of a thickness above 0, has an alpha of 1: write transmission=... alone")
        if isinstance(self.metallic, Texture) or isinstance(self.ior, Texture) or not self.ior > 0:
            raise SceneError(
                "the metallic and the ior of a body, of a thickness above 0, are numbers, and its ior is above 0: "
                "leave thickness out for a thin wall"
            )

    # What follows has the names of a `Material`: layouts and kernels read both by them.

    shade = None

    @property
    def is_body(self) -> bool:
        """True if it bounds a body that refracts light."""
        return self.thickness > 0 and _number(self.transmission) > 0

    @property
    def absorption(self) -> Triple:
        """The absorption per length inside a body, by Beer's law."""
        if not self.is_body:
            return (0.0, 0.0, 0.0)
        r, g, b = (abs(math.log(max(x, _DARKEST)) / self.attenuation_distance) for x in self.attenuation_color)
        return (r, g, b)

    @property
    def textures(self) -> dict[str, Texture]:
        """The textures by the names that kernels have for them."""
        fields = {kernel: getattr(self, name) for name, kernel in _KERNEL_NAMES.items()}
        if isinstance(self.alpha, Texture):
            fields["transmission"] = self.alpha.complement
        elif self.is_body:
            fields["transmission"] = fields.pop("thin")
        return {name: texture for name, texture in fields.items() if isinstance(texture, Texture)}

    @property
    def numbers(self) -> dict[str, float]:
        """The coefficients, in the places of Phong's: metallic, specular, roughness; 1 where they are pictures."""
        numbers = {"diffuse": self.metallic, "specular": self.specular, "shininess": self.roughness}
        clear = self.alpha if isinstance(self.alpha, Texture) else 1 - self.alpha
        if self.is_body:
            clear = _number(self.transmission) * (1 - _number(self.metallic))
        return {name: _number(x) for name, x in numbers.items()} | {"reflectivity": 0.0, "transmission": _number(clear)}

    @property
    def layers(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The rows of `Layout.layers`: specular colour and refractive index; the coat, its roughness, thin share.

        The last number is 1, with `multiscatter` 2.
        """
        tint = (1.0, 1.0, 1.0) if isinstance(self.specular_color, Texture) else self.specular_color
        coat = _number(self.clearcoat), _number(self.clearcoat_roughness)
        thin = 0.0 if self.is_body else _number(self.transmission)
        return (*tint, _number(self.ior)), (*coat, thin, 1.0 + self.multiscatter)

    @property
    def sheen(self) -> tuple[float, ...]:
        """The row of `Layout.sheens`: the sheen's colour and roughness, white and 1 where they are pictures."""
        tint = (1.0, 1.0, 1.0) if isinstance(self.sheen_color, Texture) else self.sheen_color
        return (*tint, _number(self.sheen_roughness))

    @property
    def brush(self) -> tuple[float, float]:
        """The row of `Layout.brushes`: the anisotropy, 1 where it is a picture, and its rotation."""
        return _number(self.anisotropy), self.anisotropy_rotation % 360

    @property
    def mirror(self) -> Triple:
        """The reflectivity of Phong's model, which it has not."""
        return (0.0, 0.0, 0.0)

    @property
    def is_clear(self) -> bool:
        """True if light goes through a share of the surface."""
        return self.numbers["transmission"] > 0 or _number(self.transmission) > 0

    @property
    def clear_ior(self) -> float:
        """The refractive index of a body; that of the share that is not there, and of thin walls, is 1."""
        return _number(self.ior) if self.is_body else 1.0

    @property
    def tint(self) -> Triple:
        """The base colour; white where it is read from a picture."""
        return (1.0, 1.0, 1.0) if isinstance(self.base_color, Texture) else self.base_color

    @property
    def glow(self) -> Triple:
        """The emission; its mean where it is read from a picture."""
        return mean_color(self.emission)

    @property
    def may_mirror(self) -> bool:
        """True: every such surface mirrors a share of the light."""
        return True


AnyMaterial = Material | MetallicRoughness | Unlit


def _number(value: float | Texture) -> float:
    """Return a number; 1 where it is read from a picture."""
    return 1.0 if isinstance(value, Texture) else value
