"""Microfacets that are rougher along a direction of the surface, as those of brushed metal.

Stage: kernel. With the widths a along the `tangent` and b across it GGX is 1 / (pi a b s**2) for
s = (h.t)**2 / a**2 + (h.b)**2 / b**2 + (h.n)**2, and Smith's masking has the root of (a v.t)**2 + (b v.b)**2 + (v.n)**2
(Burley 2012, Physically Based Shading at Disney, appendix B; Heitz 2014, section 5.3). b is the square of the
roughness, and a is b + (1 - b) strength**2 as in KHR_materials_anisotropy.
"""

from __future__ import annotations

from math import pi
from typing import Any

import shpy as sh
from raytracer.appearance.albedo import SMOOTHEST
from raytracer.kernels.directions import frame
from raytracer.kernels.interactions import Interaction
from raytracer.kernels.normal_maps import direction_of_u
from raytracer.kernels.point import SeenHit
from raytracer.kernels.triangle import RayHit

SHORTEST = 2.0**-60
"""The length of a triangle's direction of u, in scaled units, below which the surface is taken for isotropic."""
SHARPER = 0.3
"""The share of an anisotropic roughness by which one is lower whose albedo at grazing light is as large.

`tests/raytracer/test_anisotropy.py` compares both bounds with the integrals.
"""
MARGIN = 0.003
"""The albedo of an anisotropic surface is at most the larger one of those at both bounds, and this."""


def orient(surfaces: Any, hit: RayHit | SeenHit, surface: Interaction, side: Any) -> None:
    """Set the `tangent` of a surface, and the square of its strength; `surfaces` are `SurfaceTables`.

    The rotation goes from where u grows to where v grows. Without uv coordinates of any area it is isotropic.
    """
    growing, hand, area = direction_of_u(surfaces, hit)
    normal = sh.Vector3f(surface.normal)
    flat = growing - normal * sh.dot(growing, normal)
    size = sh.length(flat)
    there = (area != 0) & (size > SHORTEST)
    across_u = hand * sh.cross(side * normal, flat / sh.max(size, SHORTEST))
    angle = surface.rotation * (pi / 180)
    cosine, sine = sh.cos(angle), sh.sin(angle)
    strength = sh.saturate(surface.anisotropy)
    if "brush" in surfaces.appearance.textured:
        x, y = 2 * surface.brush.r - 1, 2 * surface.brush.g - 1
        long = sh.sqrt(x * x + y * y)
        x, y = (sh.cond(long > 0, part / sh.max(long, SHORTEST), other) for part, other in ((x, 1.0), (y, 0.0)))
        cosine, sine = x * cosine - y * sine, x * sine + y * cosine
        strength = strength * surface.brush.b
    turned = sh.normalize((cosine / sh.max(size, SHORTEST)) * flat + sine * across_u)
    surface.tangent[:] = sh.cond(there, turned, frame(normal)[0])
    surface.anisotropy[:] = sh.cond(there, strength * strength, 0.0)


def widen(surface: Interaction, roughness: Any) -> Any:
    """Set the `bounds` of a surface; return its roughness across the tangent. Nothing anisotropic is a mirror."""
    square = surface.anisotropy
    roughness = sh.cond(square > 0, sh.max(roughness, SMOOTHEST), roughness)
    surface.coefficients.z = roughness
    across = roughness * roughness
    least = sh.cond(square > 0, sh.max((1 - SHARPER * sh.sqrt(square)) * roughness, SMOOTHEST), roughness)
    surface.bounds[:] = sh.Attrib2f(least, sh.sqrt(across + square * (1 - across)))
    return roughness


def brushed_lobe(
    surface: Interaction, half: Any, light: Any, numbers: tuple[Any, Any, Any], least: float
) -> tuple[Any, Any]:
    """Return what `lobe` of `kernels.microfacets` does; `numbers` are the cosines of light and view, and the roughness.

    With `least` at 0 surfaces of a roughness below `SMOOTHEST`, which are mirrors, send out nothing.
    """
    cosine, away, roughness = numbers
    alpha = sh.max(roughness, sh.Attrib1f(least or SMOOTHEST))
    across = alpha * alpha
    along = sh.max(surface.bounds.y * surface.bounds.y, across)
    axes = surface.tangent, sh.cross(surface.normal, surface.tangent), surface.normal
    x, y, z = (sh.dot(axis, half) for axis in axes)
    spread = x * x * (across / along) + y * y * (along / across) + along * across * z * z
    facets = sh.cond(z > 0, (along / spread) * (across / (pi * spread)), 0.0)  # as binary16 has no square of it
    if not least:
        facets = sh.cond(roughness < SMOOTHEST, 0.0, facets)
    out, into = (masking_root(axes, direction, along, across) for direction in (surface.seen, light))
    shown = facets * cosine / (2 * sh.max(cosine * out + away * into, 2.0**-40))
    return shown, facets / (2 * (away + out))


def masking_root(axes: tuple[Any, Any, Any], direction: Any, along: Any, across: Any) -> Any:
    """Return the root in Smith's masking of a direction."""
    x, y, z = (sh.dot(axis, direction) for axis in axes)
    return sh.length(sh.Vector3f(along * x, across * y, z))
