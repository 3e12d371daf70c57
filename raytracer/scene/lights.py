"""Lights: points, spots, directions from infinitely far away, and the environment around the scene.

Stage: scene description. Each point and direction costs one shadow ray per surface that is seen.

>>> DirectionalLight(direction=(0, -2, 0)).direction
(0.0, -2.0, 0.0)
>>> EnvironmentLight((1, 1, 0.5)).color
(1.0, 1.0, 0.5)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from typing import Any, Literal, get_args

import numpy as np

from raytracer.appearance.materials import Triple
from raytracer.appearance.textures import Texture
from raytracer.arrays import array_of, finite_triple, one_float
from raytracer.errors import SceneError

Falloff = Literal["none", "square"]


def _hold(light: Any, *names: str) -> None:
    """Make floats of these triples of a light; SceneError for anything else."""
    for name in names:
        object.__setattr__(light, name, finite_triple(f"a light's {name}", getattr(light, name)))


def _check_fading(light: PointLight | SpotLight) -> None:
    """Raise SceneError for a falloff or a range that no light has; hold the range as a float."""
    if light.falloff not in get_args(Falloff):
        raise SceneError(f"a light's falloff is one of {', '.join(get_args(Falloff))}, not {light.falloff!r}")
    if light.range is not None:
        reach = one_float(light.range)
        if reach is None or not 0 < reach < math.inf:
            raise SceneError(f"a light's range is a distance above 0, or None for no end, not {light.range!r}")
        object.__setattr__(light, "range", reach)


@dataclass(frozen=True, slots=True)
class PointLight:
    """A light at `position`; `color` is linear RGB: the radiance of a white matt surface that faces the light.

    With the `falloff` "none" it is equally bright at every distance (as in the tracer of 2004). With "square" it shines
    as a light does, with `color` at the distance 1 and by the square of the distance less farther away. A `range` makes
    it fade to nothing there: at the distance d by the factor 1 - (d / range)**4 (glTF's KHR_lights_punctual).
    Raises SceneError for numbers that are not finite, for another falloff, and for a range of 0 or less.
    """

    position: Triple
    color: Triple = (1.0, 1.0, 1.0)
    falloff: Falloff = "none"
    range: float | None = None

    def __post_init__(self) -> None:
        _hold(self, "position", "color")
        _check_fading(self)


@dataclass(frozen=True, slots=True)
class SpotLight:
    """A light at `position` that shines in a cone about `direction`, of any length but zero.

    Up to the angle `inner` from the direction it has its `color`, as in a PointLight, and from `outer` on it is dark;
    angles are in degrees, 0 <= inner < outer <= 90. Between them the light falls as the square of a line in the cosine
    of the angle (glTF's KHR_lights_punctual). `falloff` and `range` are those of a PointLight.
    Raises SceneError for numbers that are not finite, other angles, a direction that is zero, and as a PointLight does.
    """

    position: Triple
    direction: Triple
    inner: float = 0.0
    outer: float = 45.0
    color: Triple = (1.0, 1.0, 1.0)
    falloff: Falloff = "square"
    range: float | None = None

    def __post_init__(self) -> None:
        _hold(self, "position", "direction", "color")
        if not any(self.direction):
            raise SceneError("a spot light needs a direction that is not zero")
        inner, outer = one_float(self.inner), one_float(self.outer)
        if inner is None or outer is None or not 0 <= inner < outer <= 90:
            raise SceneError(
                "the angles of a spot light are degrees with 0 <= inner < outer <= 90, not "
                f"inner={self.inner!r} and outer={self.outer!r}"
            )
        object.__setattr__(self, "inner", inner)
        object.__setattr__(self, "outer", outer)
        _check_fading(self)

    @property
    def ramp(self) -> tuple[float, float]:
        """The scale s and the offset t of the light at the cosine c: its square root is s c + t, clipped to [0, 1]."""
        dark = math.cos(math.radians(self.outer))
        scale = 1 / max(math.cos(math.radians(self.inner)) - dark, 1e-6)
        return scale, -dark * scale


@dataclass(frozen=True, slots=True)
class DirectionalLight:
    """A light shining along `direction` (of any length but zero) from infinitely far; `color` as in a PointLight."""

    direction: Triple
    color: Triple = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        _hold(self, "direction", "color")
        if not any(self.direction):
            raise SceneError("a directional light needs a direction that is not zero")


class EnvironmentLight:
    """Light from everywhere around the scene; it is also the background.

    `source` is a colour (r, g, b), linear radiance; an equirectangular picture, as an array (H, W, 3), the path of a
    file, such as an .hdr or .exr one, or a `Texture`; or a program from a unit `direction`, an sh.Vector3f, to an
    sh.Color3f. The middle of a picture lies in the direction (0, 0, -1), its right half in that of x, and its top row
    in that of y. `rotation` turns a picture or program about the axis y, in degrees, counter-clockwise as seen from y:
    with 90 the middle of a picture lies in the direction (-1, 0, 0). `strength` multiplies the light.

    In path tracing a picture is sampled by its brightness, a colour and a program are sampled evenly. The other
    integrators trace no rays to it: they light surfaces by averages of its light, which nothing shades
    (docs/raytracer.md, "Light from around").
    Raises SceneError for negative colours, other sources, a rotation that is not finite and a negative strength; see
    `Texture` for the errors of pictures.
    """

    color: Triple | None = None
    picture: Texture | None = None
    program: Callable[..., Any] | None = None

    def __init__(self, source: Any, rotation: float = 0.0, strength: float = 1.0) -> None:
        turn, factor = one_float(rotation), one_float(strength)
        if turn is None or not math.isfinite(turn):
            raise SceneError(f"the rotation of an EnvironmentLight is an angle in degrees, not {rotation!r}")
        if factor is None or not 0 <= factor < math.inf:
            raise SceneError(f"the strength of an EnvironmentLight is a number, 0 or more, not {strength!r}")
        self.rotation, self.strength = turn % 360, factor
        if callable(source):
            self.program = source
        elif isinstance(source, Texture):
            if source.transform is not None:
                raise SceneError("the picture of an EnvironmentLight has no transform: rotation= turns it")
            self.picture = source
        elif isinstance(source, str | PathLike) or array_of("the pixels of an EnvironmentLight", source).ndim in (2, 3):
            self.picture = Texture(source)
        else:
            color = np.asarray(source)
            if (
                color.shape != (3,)
                or color.dtype.kind not in "iuf"
                or not np.all(np.isfinite(color))
                or color.min() < 0
            ):
                raise SceneError(
                    "the source of an EnvironmentLight is a colour (r, g, b), not negative, an equirectangular picture "
                    f"or a program of the direction, not {source!r}"
                )
            r, g, b = map(float, color)
            self.color = (r, g, b)

    def __repr__(self) -> str:
        source = next(s for s in (self.color, self.picture, self.program) if s is not None)
        numbers = {"rotation": (self.rotation, 0), "strength": (self.strength, 1)}
        named = (f", {name}={value:g}" for name, (value, plain) in numbers.items() if value != plain)
        return f"EnvironmentLight({source!r}{''.join(named)})"


PlacedLight = PointLight | SpotLight | DirectionalLight
Light = PointLight | SpotLight | DirectionalLight | EnvironmentLight
