"""Lights: points, directions from infinitely far away, and the environment around the scene.

Stage: scene description. Each point and direction costs one shadow ray per surface that is seen.

>>> DirectionalLight(direction=(0, -2, 0)).direction
(0.0, -2.0, 0.0)
>>> EnvironmentLight((1, 1, 0.5)).color
(1.0, 1.0, 0.5)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from typing import Any, Literal, get_args

import numpy as np

from raytracer.appearance.materials import Triple
from raytracer.appearance.textures import Texture
from raytracer.arrays import array_of, finite_triple
from raytracer.errors import SceneError

Falloff = Literal["none", "square"]


def _hold(light: Any, *names: str) -> None:
    """Make floats of these triples of a light; SceneError for anything else."""
    for name in names:
        object.__setattr__(light, name, finite_triple(f"a light's {name}", getattr(light, name)))


@dataclass(frozen=True, slots=True)
class PointLight:
    """A light at `position`; `color` is linear RGB: the radiance of a white matt surface that faces the light.

    With the `falloff` "none" it is equally bright at every distance (as in the tracer of 2004). With "square" it shines
    as a light does, with `color` at the distance 1 and by the square of the distance less farther away.
    Raises SceneError for numbers that are not finite and for another falloff.
    """

    position: Triple
    color: Triple = (1.0, 1.0, 1.0)
    falloff: Falloff = "none"

    def __post_init__(self) -> None:
        _hold(self, "position", "color")
        if self.falloff not in get_args(Falloff):
            raise SceneError(f"a light's falloff is one of {', '.join(get_args(Falloff))}, not {self.falloff!r}")


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
    """Light from everywhere around the scene, for `integrator="path"`; it is also the background.

    `source` is a colour (r, g, b), linear radiance; an equirectangular picture, as an array (H, W, 3), the path of a
    file, such as an .hdr or .exr one, or a `Texture`; or a program from a unit `direction`, an sh.Vector3f, to an
    sh.Color3f. The middle of a picture lies in the direction (0, 0, -1), its right half in that of x, and its top row
    in that of y.

    A picture is sampled by its brightness, a colour and a program are sampled evenly.
    Raises SceneError for negative colours and other sources; see `Texture` for the errors of pictures.
    """

    color: Triple | None = None
    picture: Texture | None = None
    program: Callable[..., Any] | None = None

    def __init__(self, source: Any) -> None:
        if callable(source):
            self.program = source
        elif isinstance(source, Texture):
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
        return f"EnvironmentLight({source!r})"


PlacedLight = PointLight | DirectionalLight
Light = PointLight | DirectionalLight | EnvironmentLight
