"""What colour an eye ray brings back: light, shadow and reflection rays in one loop, with one call of the intersector.

Stage: kernel. The unified `tracer` of Moreno-Fortuny and McCool. A state says what the ray is for: tracing (an eye or
reflection ray), or the `shadows`-th shadow ray. Reflection needs no recursion: `rn` carries the product of the
reflection coefficients (Christen 2005, equation 5.1). Three things differ from the code as it was printed: `tracing`
holds at the start; a ray that leaves the scene sets the reflection coefficient to 0, since there the background is all
there is; and `reflect` takes the ray's own direction, as GLSL's does.

What the scene does not need is not recorded: no light, no shadow rays; nothing that mirrors, no reflections; flat
meshes, no interpolated normals; one material, no lookup.
"""

from __future__ import annotations

from contextlib import nullcontext
from math import inf
from typing import Any, NamedTuple

import shpy as sh
from raytracer.accel.grid import Grid
from raytracer.kernels.surfaces import LightList, Surface, SurfaceTables
from raytracer.kernels.triangle import FAR, Hit
from raytracer.kernels.walk import walk_through
from raytracer.layout import Layout
from shpy import SH_DO, SH_ELSE, SH_IF, SH_UNTIL


class Pixel(NamedTuple):
    """What the tracer gives for an eye ray: the layers of an `Image`."""

    color: sh.Color3f
    depth: sh.Attrib1f
    normal: sh.Normal3f
    object: sh.Attrib1i
    rays: sh.Attrib1i


class Tracer:
    """The tables of a scene, and the loop that follows a ray through it.

    `features` says what the recorded kernel contains.
    """

    def __init__(self, layout: Layout, background: Any, ambient: float, bounces: int, backend: str) -> None:
        self.intersector = walk_through(layout.structure, layout.triangles, backend, layout.roundoff)
        self.background = tuple(map(float, background))
        self.ambient = float(ambient)
        self.bounces = bounces
        self.surfaces = SurfaceTables(layout, self.intersector.triangles)
        self.lights = LightList(layout.lights)
        self.features: dict[str, bool | int] = {
            "lights": self.lights.count,
            "point lights": self.lights.points,
            "directional lights": self.lights.directions,
            "reflections": bounces if layout.reflects else 0,
            "smooth normals": layout.normals is not None,
            "vertex colours": layout.colors is not None,
            "materials": len(layout.materials) // 2,
            "highlights": self.surfaces.highlights,
        }
        if isinstance(layout.structure, Grid):
            self.features["triangles outside the grid"] = layout.structure.outside
        self.reflects = layout.reflects
        self.loops = self.reflects or self.lights.count > 0

    def __call__(self, ray: Any, eye: Any) -> Pixel:
        """Follow an eye ray of unit length; `ray` and `eye` are changed on the way."""
        color = sh.Color3f(0, 0, 0)
        scolor = sh.Color3f(0, 0, 0)
        rn = sh.Attrib2f(1, 0)
        r = sh.Attrib1i(self.bounces)
        shadows = sh.Attrib1i(0)
        tracing = sh.Attrib1b(True)
        finished = sh.Attrib1b(False)
        surface = Surface()
        rays = sh.Attrib1i(0)
        pixel = background_pixel(color, rays)
        with SH_DO() if self.loops else nullcontext():
            limit = sh.Attrib1f(FAR)
            lightcol = sh.Color3f(0, 0, 0)
            if self.lights.count:
                with SH_IF(shadows > 0):
                    shadows -= 1
                    self.lights.aim(shadows, surface, ray, eye, limit, lightcol)
            hit = self.intersector(ray, eye, 0.0, limit, ~tracing)
            rays += sh.cond(limit > 0, 1, 0)
            with SH_IF(tracing):
                tracing[:] = False
                with SH_IF(hit.id >= 0):
                    rn.y = self.surfaces.arrive(hit, ray, eye, surface)
                    with SH_IF(pixel.object < 0):
                        self.note(pixel, hit, surface)
                    scolor[:] = self.ambient * surface.color
                    shadows[:] = self.surfaces.lights_seen(surface, self.lights.count)
                with SH_ELSE():
                    scolor[:] = self.background
                    rn.y = 0
            if self.lights.count:
                with SH_ELSE():
                    lit = (hit.id < 0) & (limit > 0)
                    scolor += sh.cond(lit, self.surfaces.shade(surface, ray) * lightcol, 0.0)
            with SH_IF(shadows == 0):
                # All light is in: accumulate, then go on to the reflection if there is one.
                color += rn.x * scolor
                finished[:] = True
                if self.reflects:
                    rn.x *= rn.y
                    color -= rn.x * scolor
                    finished[:] = (r == 0) | (rn.y == 0)
                    r -= 1
                    tracing[:] = True
                    reflect(surface, ray, eye)
            if self.loops:
                SH_UNTIL(finished)
        return pixel

    def note(self, pixel: Pixel, hit: Hit, surface: Surface) -> None:
        """The layers show the first surface that the eye ray hits."""
        pixel.depth[:] = hit.l
        pixel.normal[:] = surface.normal
        pixel.object[:] = self.surfaces.object_at(hit)


def background_pixel(color: Any, rays: Any) -> Pixel:
    """The layers where nothing is hit."""
    depth = sh.Attrib1f(inf)
    normal = sh.Normal3f(0, 0, 0)
    number = sh.Attrib1i(-1)
    return Pixel(color, depth, normal, number, rays)


def reflect(surface: Surface, ray: Any, eye: Any) -> None:
    """The mirrored ray; where an interpolated normal would send it into the surface, it is turned back outside."""
    mirrored = sh.reflect(-surface.view, surface.normal)
    below = sh.min(sh.dot(mirrored, surface.face), 0.0)
    ray[:] = mirrored - (2 * below) * surface.face
    eye[:] = surface.inter
