"""The BSDF of a surface in path tracing, as functions and as densities.

Stage: kernel. In Phong's model the matt lobe is Lambert's, and the glossy lobe has the factor that keeps its energy at
grazing light below `specular` (Lafortune and Willems 1994, Using the Modified Phong Reflectance Model).
`kernels.microfacets` has the lobes of a `MetallicRoughness`. `diffuse_lobe` and `highlight` are those of Whitted's
tracer (Phong 1975).
"""

from __future__ import annotations

from math import pi
from typing import Any

import shpy as sh
from raytracer.kernels.directions import around, largest
from raytracer.kernels.microfacets import Microfacets
from shpy import SH_ELSE, SH_IF

FAINT = 2.0**-64
"""A highlight that is no light. Where nothing else is seen, its last bits are denormal, which not every GL keeps."""


class Bsdf:
    """The lobes of a scene's surfaces; without `highlights` Phong's model has the matt one alone.

    `layers` are those of its `MetallicRoughness`, if there are any; `mixed` says whether other surfaces stand beside.
    """

    def __init__(self, highlights: bool, layers: Microfacets | None = None, mixed: bool = False) -> None:
        self.highlights, self.layers, self.mixed = highlights, layers, mixed

    def evaluate(self, surface: Any, light: Any) -> tuple[Any, Any]:
        """Return the radiance toward the viewer for radiance 1 a steradian about `light`, and `sample`'s density there.

        The radiance is 0 for a light behind the surface or its triangle.
        """
        if self.layers is None:
            return self.evaluate_phong(surface, light)
        if not self.mixed:
            return self.layers.evaluate(surface, light)
        value, density = sh.Color3f(0, 0, 0), sh.Attrib1f(0)
        with SH_IF(surface.is_layered):
            value[:], density[:] = self.layers.evaluate(surface, light)
        with SH_ELSE():
            value[:], density[:] = self.evaluate_phong(surface, light)
        return value, density

    def evaluate_phong(self, surface: Any, light: Any) -> tuple[Any, Any]:
        """Return what `evaluate` does for a surface in Phong's model."""
        cosine = sh.max(sh.dot(surface.normal, light), 0.0)
        diffuse, specular, shininess = surface.coefficients
        matt = cosine * (1 / pi)
        value, density = matt * diffuse * surface.color, matt
        if self.highlights:
            mirrored = sh.reflect(-surface.view, surface.normal)
            along = sh.dot(mirrored, light)
            power = sh.pow(sh.saturate(along), shininess) * (1 / (2 * pi))  # rounding may make a cosine greater than 1
            # The lobe ends across the mirrored ray also where the exponent is 0, and pow(0, 0) is 1.
            power = sh.cond((along > 0) & (power > FAINT), power, 0.0)
            share = self.glossy_share(surface)
            value = value + specular * (shininess + 2) * power * cosine
            density = density + share * ((shininess + 1) * power - density)
        return sh.cond(sh.dot(surface.face, light) > 0, value, 0.0), density

    def sample(self, surface: Any, which: Any, turn: Any, away: Any) -> Any:
        """Sample a direction by three numbers in [0, 1): about the normal, or about the mirrored ray of the viewer."""
        if not self.highlights:
            return around(surface.normal, sh.sqrt(1 - away), turn)
        glossy = which < self.glossy_share(surface)
        axis = sh.cond(glossy, sh.reflect(-surface.view, surface.normal), surface.normal)
        exponent = sh.cond(glossy, 1 / (surface.coefficients.z + 1), 0.5)
        return around(axis, sh.pow(1 - away, exponent), turn)

    def glossy_share(self, surface: Any) -> Any:
        """Return the probability of the glossy lobe: its part of what is scattered under light from everywhere."""
        diffuse, specular, _ = surface.coefficients
        matt = diffuse * largest(surface.color)
        return sh.cond(specular > 0, specular / (specular + matt), 0.0)


def diffuse_lobe(normal: Any, light: Any) -> Any:
    """Return the cosine between the unit vectors `normal` and `light`; 0 for a light behind the surface."""
    return sh.max(sh.dot(normal, light), 0.0)


def highlight(view: Any, normal: Any, light: Any, shininess: Any) -> Any:
    """Return the share of a light that a shiny surface mirrors to the viewer; `view` and `light` point away from it."""
    mirrored = sh.reflect(-light, normal)
    along = sh.dot(mirrored, view)
    strength = sh.pow(sh.saturate(along), shininess)  # a cosine that rounding makes greater than 1 has large powers
    return sh.cond((sh.dot(normal, light) > 0) & (along > 0), strength, 0.0)
