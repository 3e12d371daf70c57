"""The colour of an eye ray: light, shadow and reflection rays in one loop, with one call of the intersector.

Stage: kernel. The unified `tracer` of Moreno-Fortuny and McCool. A state says what the ray is for: tracing (an eye or
reflection ray), or the `shadows`-th shadow ray. Reflection needs no recursion: `rn` carries the product of the
reflection coefficients (Christen 2005, equation 5.1). docs/unified.md lists the differences from the code as it was
printed: `tracing` holds at the start; a ray that leaves the scene sets the reflection coefficient to 0, since there the
background is the whole colour; `reflect` takes the ray's own direction, as GLSL's does; and five more.

What the scene does not need is not recorded: no light, no shadow rays; nothing that mirrors, no reflections; flat
meshes, no interpolated normals; one material, no lookup.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from math import inf
from typing import Any, Final, NamedTuple

import shpy as sh
from raytracer.accel.bounds import far
from raytracer.accel.grid import Grid
from raytracer.kernels.point import SeenHit
from raytracer.kernels.scene_tables import LightList, SceneTables
from raytracer.kernels.surfaces import Interaction, blank
from raytracer.kernels.triangle import RayHit
from raytracer.kernels.walk import meet
from raytracer.scene.layout import Layout
from raytracer.scene.scene import Background, Scene
from shpy import SH_DO, SH_ELSE, SH_IF, SH_UNTIL

MIN_CONTRIBUTION: Final = 2.0**-17
"""The share of the picture, in its brightest channel, below which a ray is not followed: 1/512 of a step of 8 bits."""


class Pixel(NamedTuple):
    """The result of an eye ray: the layers of an `Image`."""

    color: sh.Color3f
    depth: sh.Attrib1f
    normal: sh.Normal3f
    object: sh.Attrib1i
    rays: sh.Attrib1i


@sh.struct
class Ray:
    """A ray, how far it goes, and whether it is an eye ray or a mirrored one, not a shadow ray."""

    eye: sh.Point3f
    direction: sh.Vector3f
    limit: sh.Attrib1f
    tracing: sh.Attrib1b


@sh.struct
class Light:
    """The light that an eye ray and its mirrored rays bring, until it is in the pixel.

    `scolor` is the colour of the surface that was hit last; `rn` the product of the reflection coefficients and the
    last of them; `r` how many more mirrored rays may follow, `shadows` how many shadow rays of this surface; `lightcol`
    the colour of the light to which the ray goes.
    """

    scolor: sh.Color3f
    rn: sh.Attrib2f
    r: sh.Attrib1i
    shadows: sh.Attrib1i
    lightcol: sh.Color3f


class Tracer(SceneTables):
    """The tables of a scene, and the loop that follows a ray through it.

    `most_bounces` is the number that the kernel has room for; the param `bounces` may be less. A `min_contribution`
    other than the default one ends the rays of a smaller share of the picture.
    """

    def __init__(
        self,
        layout: Layout,
        background: Background,
        ambient: float,
        bounces: int,
        backend: str,
        min_contribution: float = MIN_CONTRIBUTION,
    ) -> None:
        super().__init__(layout, background, backend)
        self.ambient = sh.Param(sh.Attrib1f, float(ambient), name="ambient")
        self.most_bounces, self.bounces = bounces, sh.Param(sh.Attrib1i, bounces, name="bounces")
        self.least: Any = min_contribution
        self.cuts = min_contribution != MIN_CONTRIBUTION
        if self.cuts:
            self.least = sh.Param(sh.Attrib1f, min_contribution, name="min_contribution")
        self.lights = LightList(layout.lights, self.surfaces)
        self.reflects = self.surfaces.reflects
        self.loops = self.reflects or self.lights.count > 0
        self.features = self._features(layout)

    def _features(self, layout: Layout) -> dict[str, bool | int]:
        appearance = self.surfaces.appearance
        features: dict[str, bool | int] = {
            "lights": self.lights.count,
            "point lights": self.lights.points,
            "directional lights": self.lights.directions,
            "reflections": self.most_bounces if self.reflects else 0,
            "smooth normals": layout.normals is not None,
            "vertex colours": layout.colors is not None,
            "materials": len(layout.material_rows) // 2,
            "highlights": self.surfaces.highlights,
        }
        if isinstance(layout.structure, Grid):
            features["triangles outside the grid"] = layout.structure.outside
        if appearance:
            features |= {"surface programs": len(appearance.surfaces), "shade programs": len(appearance.shades)}
            features["textures"] = len(appearance.textured)
        others = {
            "glass": self.surfaces.clear, "cutouts": self.surfaces.accept is not None, "sky": not self.background.plain
        }  # fmt: skip
        return features | {name: True for name, there in others.items() if there}

    def repaint(self, layout: Layout, tinted: Sequence[tuple[int, int]], scene: Scene) -> bool:
        """Take other materials and lights as every tracer does, and a scene's ambient."""
        if not super().repaint(layout, tinted, scene):
            return False
        self.ambient.value = float(scene.ambient)
        return True

    def __call__(self, direction: Any, eye: Any) -> Pixel:
        """Follow an eye ray of unit length."""
        ray, light, pixel = self.begin(direction, eye)
        surface = blank(self.surfaces.interaction)
        with SH_DO() if self.loops else nullcontext():
            self.aim(ray, light, surface)
            hit = meet(self.intersector, lambda: pixel.rays == 0, ray.direction, ray.eye, ray.limit, ~ray.tracing)
            finished = self.settle(ray, light, surface, pixel, hit)
            if self.loops:
                SH_UNTIL(finished)
        return pixel

    def begin(self, direction: Any, eye: Any) -> tuple[Ray, Light, Pixel]:
        """Return an eye ray, its light and its pixel before its first hit."""
        ray = Ray(eye, direction, far(), sh.Attrib1b(True))
        black = sh.Color3f(0, 0, 0)
        light = Light(black, sh.Attrib2f(1, 0), sh.Attrib1i(self.bounces), sh.Attrib1i(0), black)
        return ray, light, background_pixel(sh.Color3f(black), sh.Attrib1i(0))

    def aim(self, ray: Any, light: Any, surface: Interaction) -> None:
        """Make the ray that comes next a shadow ray where lights are left to be seen."""
        ray.limit[:] = far()
        light.lightcol[:] = 0
        if self.lights.count:
            with SH_IF(light.shadows > 0):
                light.shadows -= 1
                self.lights.aim(light.shadows, surface, ray.direction, ray.eye, ray.limit, light.lightcol)

    def settle(self, ray: Any, light: Any, surface: Interaction, pixel: Pixel, hit: RayHit) -> Any:
        """Shade what a ray has met, and mirror the ray after the last light; return whether the path ended."""
        rays = pixel.rays
        rays += sh.cond(ray.limit > 0, 1, 0)
        with SH_IF(ray.tracing):
            ray.tracing[:] = False
            with SH_IF(hit.id >= 0):
                emission = sh.Color3f(0, 0, 0) if self.surfaces.glows else None
                light.rn.y = self.surfaces.arrive(hit, ray.direction, ray.eye, surface, emission)
                with SH_IF(pixel.object < 0):
                    self.note(pixel, hit, surface)
                self.gather(light, pixel, surface, emission)
            with SH_ELSE():
                light.scolor[:] = self.background.radiance(ray.direction)
                light.rn.y = 0
        if self.lights.count:
            with SH_ELSE():
                lit = (hit.id < 0) & (ray.limit > 0)
                if self.surfaces.appearance.shades:
                    with SH_IF(lit):
                        light.scolor += self.surfaces.shade(surface, ray.direction) * light.lightcol
                else:
                    shade = self.surfaces.shade(surface, ray.direction)
                    light.scolor += sh.cond(lit, shade * light.lightcol, 0.0)
        return self.go_on(ray, light, surface, pixel)

    def gather(self, light: Any, pixel: Pixel, surface: Interaction, emission: Any) -> None:
        """Begin with the light of a surface that a ray has reached: ambient light, emission, and the lights to ask."""
        light.scolor[:] = self.ambient * surface.color
        if emission is not None:  # a mirror sends out all of it, too
            pixel.color[:] += light.rn.x * emission
        light.shadows[:] = self.surfaces.lights_seen(surface, self.lights.number)

    def go_on(self, ray: Any, light: Any, surface: Interaction, pixel: Pixel) -> Any:
        """Once all light is in, accumulate it, and go on to the reflection if there is one; return whether it ended."""
        finished = sh.Attrib1b(False)
        with SH_IF(light.shadows == 0):
            pixel.color[:] += light.rn.x * light.scolor
            finished[:] = True
            if self.reflects:
                light.rn.x *= light.rn.y
                pixel.color[:] -= light.rn.x * light.scolor
                finished[:] = self.is_last(light)
                light.r -= 1
                ray.tracing[:] = True
                ray.direction[:] = mirrored(surface)
                ray.eye[:] = surface.inter
        return finished

    def is_last(self, light: Any) -> Any:
        """Return whether no mirrored ray follows."""
        if self.cuts:
            return (light.r == 0) | (light.rn.y == 0) | ~(light.rn.x > self.least)
        return (light.r == 0) | (light.rn.y == 0)

    def note(self, pixel: Pixel, hit: RayHit | SeenHit, surface: Interaction) -> None:
        """Store the first surface that the eye ray hits in the layers."""
        pixel.depth[:] = hit.l
        pixel.normal[:] = surface.normal
        pixel.object[:] = self.surfaces.object_at(hit)


def background_pixel(color: Any, rays: Any) -> Pixel:
    """Return the layers where nothing is hit."""
    depth = sh.Attrib1f(inf)
    normal = sh.Normal3f(0, 0, 0)
    number = sh.Attrib1i(-1)
    return Pixel(color, depth, normal, number, rays)


def mirrored(surface: Interaction) -> Any:
    """Return the mirrored ray, turned back outside where an interpolated normal would send it into the surface."""
    mirrored = sh.reflect(-surface.view, surface.normal)
    below = sh.min(sh.dot(mirrored, surface.face), 0.0)
    return mirrored - (2 * below) * surface.face
