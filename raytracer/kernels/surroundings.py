"""The light around a scene, as a Whitted tracer shows it: by one number for each lobe of a surface.

Stage: kernel. No ray is traced to the environment, so that nothing shades its light. Matt surfaces are lit by the light
from the whole half of directions above them, rough mirrors by the light about the mirrored ray; both are levels of a
table that is computed once (`appearance.prefiltered`). A ray that meets nothing shows the environment as blurred as the
roughest surface that has mirrored it.
"""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.appearance.prefiltered import LEVELS, ROWS, Floats, means, prefiltered
from raytracer.errors import SceneError, place_of
from raytracer.kernels.directions import mirrored
from raytracer.kernels.interactions import Interaction
from raytracer.kernels.sky import EnvironmentSky, Sky, padded, turn_of
from raytracer.kernels.surfaces import SurfaceTables
from raytracer.scene.lights import EnvironmentLight
from shpy import SH_ELSE, SH_IF

FINE = 4
"""A picture of fewer rows than FINE * ROWS, or a program, is sampled at so many places across each cell."""


class Surroundings(EnvironmentSky):
    """The environment of a scene with these surfaces; `blurs` says whether a ray needs to know how rough mirrors were.

    `levels` are the numbers of its table; workers of a cluster must agree on them.
    Raises SceneError for a material with a shade.
    """

    plain = False
    """Radiance depends on the direction, or has a strength: a tracer asks for it."""

    def __init__(self, light: EnvironmentLight, surfaces: SurfaceTables) -> None:
        for material in surfaces.layout.materials:
            if material.shade is not None:
                raise SceneError(
                    f"{place_of(material.shade)}: a shade says how light from one direction looks, and this scene has "
                    "an EnvironmentLight: describe the surface by surface=..., or leave the light out"
                )
        super().__init__(light)
        self.surfaces = surfaces
        self.blurs = surfaces.lobes is not None and not self.sky.plain
        if surfaces.lobes is not None:
            surfaces.lobes.hides = True
        self.levels: NDArray[np.float32] | None = None
        if not self.sky.plain:
            self.levels = np.stack([padded(level) for level in prefiltered(cells_of(self.sky))])
            self.table = sh.Table(self.levels, sh.Color3f, "prefiltered")

    def suits(self, source: Any) -> bool:
        """Return whether another background needs no other kernel: it is not seen."""
        return True

    def renew(self, source: Any) -> None:
        """Take another background."""

    def blurred(self, ray: Any, roughness: Any) -> Any:
        """Return the light about the direction of a unit vector, as a mirror of this roughness shows it."""
        if self.sky.plain:
            return self.radiance(ray)
        ray = self.turned(ray, back=True)
        place = sh.clamp(roughness, 0, 1) * LEVELS
        level = sh.min(sh.Attrib1i(sh.floor(place)), LEVELS - 1)
        finer, rougher = sh.Color3f(0, 0, 0), self._level(level, ray)
        with SH_IF(level == 0):
            finer[:] = self.sky.radiance(ray)
        with SH_ELSE():
            finer[:] = self._level(level - 1, ray)
        return self.strengthened(sh.mix(finer, rougher, place - sh.Attrib1f(level)))

    def onto(self, normal: Any) -> Any:
        """Return the light that a white matt surface with this normal sends out."""
        if self.sky.plain:
            return self.radiance(normal)
        return self.strengthened(self._level(LEVELS - 1, self.turned(normal, back=True)))

    def _level(self, level: Any, ray: Any) -> Any:
        """Interpolate a level of the table at a direction of the picture."""
        row = sh.acos(sh.clamp(ray.y, -1, 1)) * (ROWS / pi) + 0.5
        column = turn_of(ray) * (2 * ROWS) + 0.5
        top, left = (sh.Attrib1i(sh.floor(place)) for place in (row, column))
        down, across = row - sh.Attrib1f(top), column - sh.Attrib1f(left)
        upper, lower = (
            sh.mix(self.table[level, top + k, left], self.table[level, top + k, left + 1], across) for k in (0, 1)
        )
        return sh.mix(upper, lower, down)

    def scattered_by(self, surface: Interaction) -> tuple[Any, Any]:
        """Return the light that a surface sends to the viewer, but for its mirror image, and the roughness of that."""
        lobes, roughness = self.surfaces.lobes, sh.Attrib1f(0)
        if lobes is None:
            return self._phong(surface), roughness
        if not self.surfaces.mixed:
            return self._layers(surface)
        light = sh.Color3f(0, 0, 0)
        with SH_IF(surface.is_layered):
            light[:], roughness[:] = self._layers(surface)
        with SH_ELSE():
            light[:] = self._phong(surface)
        return light, roughness

    def _phong(self, surface: Interaction) -> Any:
        """Return the light of Phong's model, as path tracing has it: a lobe scatters the share `specular`."""
        diffuse, specular, shininess = surface.coefficients
        light = diffuse * surface.color * self.onto(surface.normal)
        if self.surfaces.highlights:
            roughness = sh.sqrt(sh.sqrt(2 / (shininess + 2)))  # that of the GGX lobe of the same width
            light = light + specular * self.blurred(mirrored(surface), roughness)
        return light

    def _layers(self, surface: Interaction) -> tuple[Any, Any]:
        """Return the light of a `MetallicRoughness`, and the roughness of its mirror image."""
        assert self.surfaces.lobes is not None
        base, coat, roughness = self.surfaces.lobes.blurred_shares(surface)
        matt = sh.max(surface.spread - base, 0.0)
        light = base * self._lobe(surface, self._base_roughness(surface))
        if coat is not None:
            matt = sh.max(matt - coat, 0.0)
            light = light + coat * self._lobe(surface, surface.coat.y)
        return light + matt * self.onto(surface.normal), roughness

    def _base_roughness(self, surface: Interaction) -> Any:
        """Return the roughness of the base; of an anisotropic one, that of the mean of its widths."""
        if not self.surfaces.kinds.brushed:
            return surface.coefficients.z
        return sh.sqrt(surface.coefficients.z * surface.bounds.y)

    def _lobe(self, surface: Interaction, roughness: Any) -> Any:
        """Return the light of a rough mirror; the middle of its lobe moves from the mirrored ray to the normal.

        Source: Lagarde and de Rousiers 2014, Moving Frostbite to Physically Based Rendering, section 4.9.3.
        """
        alpha = roughness * roughness
        part = (1 - alpha) * (sh.sqrt(1 - alpha) + alpha)
        ray = sh.normalize(sh.mix(sh.Vector3f(surface.normal), mirrored(surface), part))
        return self.blurred(ray, roughness)


def cells_of(sky: Sky) -> Floats:
    """Return the mean radiance of cells of the sphere, (ROWS, 2 * ROWS, 3).

    Raises SceneError for a program that gives a number that is not finite.
    """
    columns = 2 * ROWS
    if sky.picture is not None and len(sky.picture.image) >= FINE * ROWS:
        return means(sky.picture.image, ROWS, columns)
    down = (np.arange(FINE * ROWS) + 0.5) * (pi / (FINE * ROWS))
    turn = (np.arange(FINE * columns) + 0.5) * (2 * pi / (FINE * columns)) - pi
    sine = np.sin(down)[:, None]
    directions = np.stack(
        np.broadcast_arrays(sine * np.sin(turn), np.cos(down)[:, None], -sine * np.cos(turn)), axis=-1
    )

    @sh.program
    def shown(direction: sh.Vector3f) -> sh.Color3f:
        return sh.Color3f(sky.radiance(direction))

    light = shown.compile("numpy")(directions.astype(np.float32))
    if not np.isfinite(light).all():
        raise SceneError(
            "the program of an EnvironmentLight gives a number that is not finite for some direction: Whitted and "
            "Staged need the mean of its light; let it give finite numbers, or choose Path()"
        )
    return means(light, ROWS, columns)
