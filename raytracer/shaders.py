"""Ready-made surfaces and shades for materials: patterns, bumps, and models of reflection other than Phong's.

Stage: scene description. Each function gives a program for `Material(surface=...)` or `Material(shade=...)`. They use
nothing but what any program can: copy one to begin with.

>>> from raytracer import Material
>>> Material(surface=marble()).surface.__name__
'marble'
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, pi

import shpy as sh
from raytracer.appearance.materials import Triple
from raytracer.appearance.programs import Hit, Surface
from raytracer.errors import SceneError

OfHit = Callable[[Hit], Surface]
OfLight = Callable[[Surface, sh.Vector3f], sh.Color3f]


def _check_positive(what: str, value: float) -> None:
    """Raise SceneError for a number by which a program divides, unless it is finite and above 0; a Param may change."""
    if isinstance(value, int | float) and not 0 < value < inf:
        raise SceneError(f"{what} is a finite number above 0, not {value!r}")


def checker(one: Triple = (0.75, 0.75, 0.72), other: Triple = (0.08, 0.08, 0.09), squares: float = 8.0) -> OfHit:
    """Paint two colours in squares, as many along u and v as `squares`."""

    def checker(hit: Hit) -> Surface:
        column, row = (sh.Attrib1i(sh.floor(squares * x)) for x in hit.uv)
        return Surface(color=sh.cond((column + row) % 2 == 0, sh.Color3f(one), sh.Color3f(other)))

    return checker


def marble(
    stone: Triple = (0.86, 0.84, 0.80), vein: Triple = (0.10, 0.12, 0.17), size: float = 1.0, octaves: int = 6
) -> OfHit:
    """Paint stone whose layers, as thick as `size`, are disturbed by turbulence (Perlin 1985)."""
    _check_positive("the size of marble", size)

    def marble(hit: Hit) -> Surface:
        place = hit.position / size
        layer = sh.sin(2 * pi * (0.6 * place.y + 0.4 * place.x) + 7 * sh.library.turbulence(place, octaves))
        return Surface(color=sh.mix(sh.Color3f(vein), sh.Color3f(stone), sh.pow(0.5 + 0.5 * layer, 0.4)))

    return marble


def wood(
    early: Triple = (0.50, 0.27, 0.11), late: Triple = (0.20, 0.08, 0.03), size: float = 0.12, grain: float = 0.35
) -> OfHit:
    """Paint rings about the y axis, each as wide as `size`, and the grain between them (Peachey 1985)."""
    _check_positive("the size of wood", size)

    def wood(hit: Hit) -> Surface:
        place = hit.position / size
        bent = 0.7 * sh.noise(0.25 * place)
        ring = sh.fract(sh.length(place.xz) + bent)
        fibre = sh.noise(place * sh.Vector3f(6, 0.4, 6))
        part = sh.smoothstep(0.1, 0.85, ring) * (1 - sh.smoothstep(0.9, 1.0, ring)) + grain * fibre
        return Surface(color=sh.mix(sh.Color3f(early), sh.Color3f(late), sh.clamp(part, 0, 1)))

    return wood


def spots(color: Triple = (0.70, 0.08, 0.05), size: float = 0.3, shine: float = 0.5) -> OfHit:
    """Return a colour with a darker spot about each of some scattered points, `size` apart (Worley 1996)."""
    _check_positive("the size of spots", size)

    def spots(hit: Hit) -> Surface:
        near = sh.library.worley(hit.position / size)
        part = sh.smoothstep(0.25, 0.4, near)
        return Surface(color=sh.mix(0.15, 1.0, part) * sh.Color3f(color), specular=shine * part)

    return spots


def bumps(depth: float = 0.15, size: float = 0.15) -> OfHit:
    """Turn normals by bumps of noise, `size` apart; places stay (Blinn 1978)."""
    _check_positive("the size of bumps", size)

    def bumps(hit: Hit) -> Surface:
        place, step = hit.position / size, 0.02
        here = sh.noise(place)
        beside = [sh.noise(place + step * sh.Vector3f(*axis)) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
        slope = (sh.Vector3f(*beside) - here) / step
        slope -= sh.dot(slope, hit.normal) * hit.normal
        return Surface(normal=hit.normal - depth * slope)

    return bumps


def toon(steps: int = 3) -> OfLight:
    """Return the cosine in a few steps, and a hard highlight."""
    _check_positive("the number of steps of toon", steps)

    def toon(surface: Surface, light: sh.Vector3f) -> sh.Color3f:
        lit = sh.max(sh.dot(surface.normal, light), 0)
        shine = sh.dot(sh.reflect(-light, surface.normal), surface.view) > 0.95
        return sh.Color3f(surface.diffuse * sh.ceil(steps * lit) / steps * surface.color) + sh.cond(shine, 0.5, 0.0)

    return toon


def oren_nayar(roughness: float = 0.5) -> OfLight:
    """Shade a rough matte surface (Oren and Nayar 1994, equation 30); `roughness`: deviation of slopes in radians."""
    square = roughness * roughness
    level, relief = 1 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)

    def oren_nayar(surface: Surface, light: sh.Vector3f) -> sh.Color3f:
        toward, away = sh.dot(surface.normal, light), sh.dot(surface.normal, surface.view)
        facing = sh.dot(light, surface.view) - toward * away
        steep = sh.cond(facing > 0, sh.max(sh.max(toward, away), 0.001), 1.0)
        return surface.color * (sh.max(toward, 0) * surface.diffuse * (level + relief * facing / steep))

    return oren_nayar


def cook_torrance(roughness: float = 0.25, base: Triple = (0.95, 0.64, 0.54)) -> OfLight:
    """Shade a metal: microfacets with Beckmann's distribution, which reflect `base` of the light at normal incidence.

    Cook and Torrance 1982, with Schlick's approximation (1994) of Fresnel's equations. The default is copper.
    """
    _check_positive("the roughness of cook_torrance", roughness)
    square = roughness * roughness

    def cook_torrance(surface: Surface, light: sh.Vector3f) -> sh.Color3f:
        half = sh.normalize(light + surface.view)
        facet = sh.max(sh.dot(surface.normal, half), 1e-3)
        toward = sh.max(sh.dot(surface.normal, light), 1e-3)
        away = sh.max(sh.dot(surface.normal, surface.view), 1e-3)
        across = sh.max(sh.dot(surface.view, half), 1e-3)
        slope = (facet * facet - 1) / (facet * facet * square)
        share = sh.exp(slope) / (pi * square * facet * facet * facet * facet)
        masked = sh.min(1, 2 * facet * sh.min(toward, away) / across)
        grazing = sh.pow(1 - sh.min(across, 1.0), 5)
        mirrored = sh.mix(sh.Color3f(base), sh.Color3f(1), grazing)
        return mirrored * (share * masked / (4 * away))

    return cook_torrance
