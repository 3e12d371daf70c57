"""The light that comes from infinitely far: a colour, a picture of all directions, or a program of the direction.

Stage: kernel. It is seen by rays that meet nothing: the background of a scene, or its environment light. A picture is
equirectangular (a latitude-longitude map), as `EnvironmentLight` describes it.

    sky = Sky(scene.background)
    sky.radiance(ray)                  # an sh.Color3f, for the unit vector of a ray
"""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.appearance.programs import UserProgram, ask_sky, examine_sky
from raytracer.appearance.textures import Texture
from raytracer.scene.lights import EnvironmentLight


class Sky:
    """The radiance of each direction by a `source`: a colour, a Texture, or a program.

    `name` names the picture's table, `color` the Param, and `whose` the owner of the source in errors.
    `plain` says whether it is a colour, the same in all directions.
    `examined` is the program as it was recorded, None where there is none. Raises SceneError and ShpyError for mistakes
    in the program.
    """

    def __init__(
        self, source: Any, name: str = "background", color: str = "background", whose: str = "a background"
    ) -> None:
        self.source, self._whose = source, whose
        self.picture = source if isinstance(source, Texture) else None
        self.plain = self.picture is None and not callable(source)
        self.examined: UserProgram | None = None
        if self.picture is not None:
            self.size = self.picture.image.shape[:2]
            self._texels = sh.Texture2D(padded(self.picture.image), filter=self.picture.filter, name=name)
        elif self.plain:
            self.color = sh.Param(sh.Color3f, tuple(map(float, source)), name=color)
        else:
            self.examined = examine_sky(source, whose)

    def suits(self, source: Any) -> bool:
        """Return whether another source needs no other kernel."""
        return source is self.source or (self.plain and not (isinstance(source, Texture) or callable(source)))

    def renew(self, source: Any) -> None:
        """Take another source, which suits."""
        if self.plain:
            self.color.value = tuple(map(float, source))

    def radiance(self, ray: Any) -> Any:
        """Return the light from the direction of a unit vector."""
        if self.plain:
            return self.color
        if self.picture is None:
            return ask_sky(self.source, sh.Vector3f(ray), self._whose)
        height, width = self.size
        column = turn_of(ray) * width + 1
        row = sh.acos(sh.clamp(ray.y, -1, 1)) * (height / pi) + 1
        return self._texels(sh.TexCoord2f(column * (1 / (width + 2)), row * (1 / (height + 2))))


class EnvironmentSky:
    """The light around a scene: a `sky` that may be turned and has a strength."""

    def __init__(self, light: EnvironmentLight) -> None:
        source = next(s for s in (light.color, light.picture, light.program) if s is not None)
        self.light = light
        self.sky = Sky(source, "environment", "environment_color", "an EnvironmentLight")
        angle = pi * light.rotation / 180
        self.turn: Any = None  # the cosine and the sine of the rotation
        if light.rotation and not self.sky.plain:
            self.turn = sh.Param(sh.Attrib2f, (cos(angle), sin(angle)), name="environment_turn")
        self.strength = None if light.strength == 1 else sh.Param(sh.Attrib1f, light.strength, name="strength")

    def radiance(self, ray: Any) -> Any:
        """Return the light from the direction of a unit vector."""
        return self.strengthened(self.sky.radiance(self.turned(ray, back=True)))

    def strengthened(self, light: Any) -> Any:
        """Return light of the sky as the scene gets it."""
        return light if self.strength is None else self.strength * light

    def turned(self, ray: Any, *, back: bool = False) -> Any:
        """Return a direction of the picture in the scene; `back`, a direction of the scene in the picture."""
        if self.turn is None:
            return ray
        cosine, sine = self.turn.x, -self.turn.y if back else self.turn.y
        return sh.Vector3f(cosine * ray.x + sine * ray.z, ray.y, cosine * ray.z - sine * ray.x)


def turn_of(ray: Any) -> Any:
    """Return the place of a direction across an equirectangular picture, from 0 to 1."""
    return sh.atan2(ray.x, -ray.z) * (1 / (2 * pi)) + 0.5


def padded(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Pad a picture by one texel on each side: columns wrap around, and beyond a pole lies its other side."""
    half = image.shape[1] // 2
    tall = np.concatenate([np.roll(image[:1], half, axis=1), image, np.roll(image[-1:], half, axis=1)])
    return np.concatenate([tall[:, -1:], tall, tall[:, :1]], axis=1)
