"""The material of a surface: the coefficients of Phong's model, mirror and glass, textures, or programs.

Stage: scene description. A `Material` belongs to a mesh; `layout` puts the materials of a scene into a table.

>>> Material(color=(1, 0, 0), reflectivity=0.2).reflectivity
0.2
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from raytracer.appearance.textures import Texture
from raytracer.arrays import one_float, three_floats
from raytracer.errors import SceneError

Triple = tuple[float, float, float]

NUMBERS: Final = ("diffuse", "specular", "shininess", "reflectivity", "transmission")
"""The coefficients that are one number."""
PICTURED: Final = ("color", *NUMBERS, "emission", "cutout", "normal_map")
"""The fields of a `Material` that may be a `Texture`."""
LAYERED: Final = (
    *("metallic", "roughness", "index", "tint", "clearcoat", "clearcoat_roughness", "thin"),
    *("sheen", "sheen_roughness", "brush"),
)
"""The kernels' names of what only a `MetallicRoughness` may have as a `Texture`."""
_REAL: Final = float | int | np.integer | np.floating
CUTOFF: Final = 0.5
"""The threshold of a `cutout`: below it there is no surface."""


@dataclass(frozen=True, slots=True)
class Material:
    """A surface in Phong's model (Phong 1975), or one that programs describe.

    `color` is linear RGB; a mesh's vertex colours multiply it. `diffuse` and `specular` weigh the two lobes,
    `shininess` is the exponent of the highlight, and `reflectivity` in [0, 1] the share of the colour that is the
    mirror image: a number, or (r, g, b) for a mirror with a colour, as of a metal.

    `transmission` in [0, 1] is the share of the surface that is clear, such as glass of the refractive index `ior`: it
    mirrors what Fresnel's equations say and refracts the rest, and `color` and `reflectivity` are those of the other
    share. `absorption` (r, g, b) is how much light is lost inside, per unit of length (Beer's law: exp(-absorption
    distance) is left). Light goes in where the corners of a triangle run counter-clockwise, and out where they do not:
    a mesh of glass is closed. It is a body of a medium, in which other things may lie: see docs/raytracer.md, Media.

    `emission` (r, g, b) is the linear radiance that the surface sends out, on both sides: it is an area light for
    `integrator="path"`; for the other integrator it is a colour that is seen and lights nothing.

    Each number but `ior` and `absorption` may be a `Texture`, which is read at the mesh's uv coordinates. `cutout` is
    None or a Texture: there is no surface where its number is below 0.5, and rays of all kinds go on to what lies
    behind, as through the gaps between leaves. `Texture("leaf.png", alpha=True)` reads a picture's alpha.

    `normal_map` is None or a Texture of normals that turn the surface's own, as in glTF: (0.5, 0.5, 1) leaves it, red
    above 0.5 turns it to where u grows, and green to where v grows. The picture's numbers are not to be decoded:
    `Texture("bricks.png", srgb=False)`. Where the uv coordinates of a triangle have no area the normal stays.

    `surface` is a function from a `Hit` to a `Surface`, recorded into the tracer and run once for each hit: what it
    leaves open is as the material says. It may also be an `sh.Program` whose inputs have names of a Hit and whose
    outputs have names of a Surface. `shade` gives the colour under white light, from a Surface and the unit vector to
    the light, once for each light that is seen; without it, Phong's model does. A program's inputs are those of a
    Surface and `light`.

        def checker(hit: Hit) -> Surface:
            even = (sh.Attrib1i(sh.floor(8 * hit.uv.x)) + sh.Attrib1i(sh.floor(8 * hit.uv.y))) % 2 == 0
            return Surface(color=sh.cond(even, sh.Color3f(0.9), sh.Color3f(0.1)), reflectivity=0.2)

        Material(surface=checker)

    Raises SceneError for what is negative, not finite, a reflectivity above 1, and programs that cannot be called.
    """

    color: Triple | Texture = (0.8, 0.8, 0.8)
    diffuse: float | Texture = 0.9
    specular: float | Texture = 0.25
    shininess: float | Texture = 40.0
    reflectivity: float | Triple | Texture = 0.0
    transmission: float | Texture = 0.0
    ior: float = 1.5
    absorption: Triple = (0.0, 0.0, 0.0)
    emission: Triple | Texture = (0.0, 0.0, 0.0)
    surface: Callable[..., Any] | None = None
    shade: Callable[..., Any] | None = None
    cutout: Texture | None = None
    normal_map: Texture | None = None

    def __post_init__(self) -> None:
        color = None if isinstance(self.color, Texture) else three_floats(self.color)
        if color is None and not isinstance(self.color, Texture):
            raise SceneError(f"a material's color is three numbers (r, g, b) or a Texture, not {self.color!r}")
        if not isinstance(self.reflectivity, Texture | _REAL):
            object.__setattr__(self, "reflectivity", three_floats(self.reflectivity) or self.reflectivity)
        for name in NUMBERS:
            number = getattr(self, name)
            if not isinstance(number, Texture | _REAL) and not (name == "reflectivity" and three_floats(number)):
                colored = ", (r, g, b)" if name == "reflectivity" else ""
                raise SceneError(f"a material's {name} is a number{colored} or a Texture, not {number!r}")
        fields = [x for name in NUMBERS if not isinstance(x := getattr(self, name), Texture)]
        numbers = [one_float(x) for value in fields for x in (value if isinstance(value, tuple) else (value,))]
        if color is not None:
            object.__setattr__(self, "color", color)
            numbers += color
        if not all(x is not None and 0 <= x < math.inf for x in numbers):
            raise SceneError(f"a material's numbers are finite and not negative: {self}")
        for name in ("reflectivity", "transmission"):
            share = getattr(self, name)
            if not isinstance(share, Texture) and np.max(share) > 1:
                raise SceneError(f"a {name} lies in [0, 1], not {share}")
        if not (isinstance(self.ior, _REAL) and 0 < (one_float(self.ior) or 0) < math.inf):
            raise SceneError(f"an ior, the refractive index, is a positive number such as 1.5, not {self.ior!r}")
        for name, what in (("absorption", "per unit of length"), ("emission", "of linear radiance")):
            triple = getattr(self, name)
            if name == "emission" and isinstance(triple, Texture):
                continue
            values = three_floats(triple)
            if values is None or not all(0 <= x < math.inf for x in values):
                raise SceneError(f"an {name} is (r, g, b) {what}, 0 or more, not {triple!r}")
            object.__setattr__(self, name, values)
        for name in ("surface", "shade"):
            program = getattr(self, name)
            if program is not None and not callable(program):
                raise SceneError(f"a material's {name} is a function or a program, not {program!r}")
            object.__setattr__(self, name, hashable(program))
        if not isinstance(self.cutout, Texture | None):
            raise SceneError(
                f"a material's cutout is a Texture or None, not {self.cutout!r}; a surface that is clear all over has "
                "transmission=..., ior=1"
            )
        if not isinstance(self.normal_map, Texture | None):
            raise SceneError(f"a material's normal_map is a Texture or None, not {self.normal_map!r}")

    @property
    def textures(self) -> dict[str, Texture]:
        """The textures by the names of their fields."""
        return {name: texture for name in PICTURED if isinstance(texture := getattr(self, name), Texture)}

    @property
    def numbers(self) -> dict[str, float]:
        """The coefficients that are one number; 1 where they are read from pictures."""
        numbers = {name: getattr(self, name) for name in NUMBERS} | {"reflectivity": max(self.mirror)}
        return {name: 1.0 if isinstance(x, Texture) else float(x) for name, x in numbers.items()}

    @property
    def mirror(self) -> Triple:
        """The reflectivity as a colour; white where it is read from a picture."""
        if isinstance(self.reflectivity, tuple):
            return self.reflectivity
        share = 1.0 if isinstance(self.reflectivity, Texture) else float(self.reflectivity)
        return (share, share, share)

    @property
    def is_clear(self) -> bool:
        """True if light goes through a share of the surface, unless a program alone says so."""
        return self.numbers["transmission"] > 0

    @property
    def clear_ior(self) -> float:
        """The refractive index of the clear share."""
        return self.ior

    @property
    def tint(self) -> Triple:
        """The colour; white where it is read from a picture."""
        return (1.0, 1.0, 1.0) if isinstance(self.color, Texture) else self.color

    @property
    def glow(self) -> Triple:
        """The emission; its mean where it is read from a picture."""
        return mean_color(self.emission)

    @property
    def may_mirror(self) -> bool:
        """True if any point of the surface can mirror or be clear."""
        numbers = self.numbers
        return self.surface is not None or numbers["reflectivity"] > 0 or numbers["transmission"] > 0


def mean_color(color: Triple | Texture) -> Triple:
    """Return a colour; its mean where it is read from a picture."""
    if not isinstance(color, Texture):
        return color
    r, g, b = color.image.mean(axis=(0, 1), dtype=np.float64).tolist()
    return (r, g, b)


def hashable(program: Any) -> Any:
    """Return a program by which scenes are searched: for an object without a hash, such as a dataclass, its method."""
    try:
        hash(program)
    except TypeError:
        return program.__call__
    return program


PLAIN: Final = Material()
"""The default material of a mesh."""
