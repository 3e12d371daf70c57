"""Where light comes from: points, and directions from infinitely far away.

Stage: scene description. Each light costs one shadow ray per surface that is seen.

>>> DirectionalLight(direction=(0, -2, 0)).direction
(0, -2, 0)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from raytracer.errors import SceneError
from raytracer.materials import Triple

Falloff = Literal["none", "square"]


def _finite(what: str, values: Triple) -> None:
    if len(values) != 3 or not all(math.isfinite(x) for x in values):
        raise SceneError(f"a light's {what} is three finite numbers, not {values!r}")


@dataclass(frozen=True, slots=True)
class PointLight:
    """A light at `position`; `color` is linear RGB.

    With the `falloff` "none" it is equally bright at every distance (as in the tracer of 2004). With "square" it shines
    as a light does, with `color` at the distance 1 and by the square of the distance less farther away.
    Raises SceneError for what is not finite and for another falloff.
    """

    position: Triple
    color: Triple = (1.0, 1.0, 1.0)
    falloff: Falloff = "none"

    def __post_init__(self) -> None:
        _finite("position", self.position)
        _finite("color", self.color)
        if self.falloff not in get_args(Falloff):
            raise SceneError(f"a light's falloff is one of {', '.join(get_args(Falloff))}, not {self.falloff!r}")


@dataclass(frozen=True, slots=True)
class DirectionalLight:
    """A light shining along `direction` (of any length but zero) from infinitely far; `color` is linear RGB."""

    direction: Triple
    color: Triple = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        _finite("direction", self.direction)
        _finite("color", self.color)
        if not any(self.direction):
            raise SceneError("a directional light needs a direction that is not zero")


Light = PointLight | DirectionalLight
