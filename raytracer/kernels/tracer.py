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

from contextlib import nullcontext
from typing import Any

import shpy as sh
from raytracer.accel.bounds import far
from raytracer.kernels.directions import mirrored
from raytracer.kernels.interactions import Interaction, blank
from raytracer.kernels.pixel import Pixel, background_pixel
from raytracer.kernels.scene_tables import LightList, SceneTables, whitted_features
from raytracer.kernels.shares import MIN_CONTRIBUTION, ColoredShares, LeastShare, MirrorShares
from raytracer.kernels.surroundings import Surroundings
from raytracer.kernels.triangle import RayHit
from raytracer.kernels.walk import meet
from raytracer.scene.layout import Layout
from raytracer.scene.lights import EnvironmentLight
from raytracer.scene.scene import Background
from shpy import SH_DO, SH_ELSE, SH_IF, SH_UNTIL


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


@sh.struct
class TintedLight(Light):
    """The `Light` of a scene whose mirrors have colours."""

    rn: ColoredShares  # type: ignore[assignment]


@sh.struct
class BlurredLight(TintedLight):
    """The `TintedLight` of a scene with rough mirrors and an environment; `blur` is the largest roughness so far."""

    blur: sh.Attrib1f


class Tracer(SceneTables):
    """The tables of a scene, and the loop that follows a ray through it.

    `most_bounces` is the number that the kernel has room for; the param `bounces` may be less. A `min_contribution`
    other than the default one ends the rays of a smaller share of the picture. An `environment` takes the place of the
    background and of the ambient light.
    """

    def __init__(
        self,
        layout: Layout,
        background: Background,
        ambient: float,
        bounces: int,
        backend: str,
        min_contribution: float = MIN_CONTRIBUTION,
        environment: EnvironmentLight | None = None,
    ) -> None:
        super().__init__(layout, background, backend)
        self.around = None if environment is None else Surroundings(environment, self.surfaces)
        if self.around is not None:
            self.background, self.levels_around = self.around, self.around.levels
        self.ambient = sh.Param(sh.Attrib1f, float(ambient), name="ambient")
        self.most_bounces, self.bounces = bounces, sh.Param(sh.Attrib1i, bounces, name="bounces")
        self.shares = MirrorShares(self.surfaces)
        self.least = LeastShare(min_contribution, self.shares)
        self.lights = LightList(layout, self.surfaces)
        self.reflects = self.shares.reflects
        self.blurs = self.around is not None and self.around.blurs
        self.light_struct: Any = TintedLight if self.shares.tinted else Light
        if self.blurs:
            self.light_struct = BlurredLight
        self.loops = self.reflects or self.lights.count > 0
        self.features = whitted_features(self, layout)

    def __call__(self, direction: Any, eye: Any) -> Pixel:
        """Follow an eye ray of unit length."""
        ray, light, pixel = self.begin(direction, eye)
        surface = blank(self.surfaces.interaction)
        with SH_DO() if self.loops else nullcontext():
            self.aim(ray, light, surface)
            hit = meet(self.intersector, lambda: pixel.rays == 0, ray.direction, ray.eye, ray.limit, ~ray.tracing)
            finished = self.shade_hit(ray, light, surface, pixel, hit)
            if self.loops:
                SH_UNTIL(finished)
        return pixel

    def begin(self, direction: Any, eye: Any) -> tuple[Ray, Light, Pixel]:
        """Return an eye ray, its light and its pixel before its first hit."""
        ray = Ray(eye, direction, far(), sh.Attrib1b(True))
        black = sh.Color3f(0, 0, 0)
        blur = [sh.Attrib1f(0)] if self.blurs else []
        light = self.light_struct(black, self.shares.first(), sh.Attrib1i(self.bounces), sh.Attrib1i(0), black, *blur)
        return ray, light, background_pixel(sh.Color3f(black), sh.Attrib1i(0))

    def aim(self, ray: Any, light: Any, surface: Interaction) -> None:
        """Make the ray that comes next a shadow ray where lights are left to be seen."""
        ray.limit[:] = far()
        light.lightcol[:] = 0
        if self.lights.count:
            with SH_IF(light.shadows > 0):
                light.shadows -= 1
                self.lights.aim(light.shadows, surface, ray.direction, ray.eye, ray.limit, light.lightcol)

    def shade_hit(self, ray: Any, light: Any, surface: Interaction, pixel: Pixel, hit: RayHit) -> Any:
        """Shade what a ray has met, and mirror the ray after the last light; return whether the path ended."""
        rays = pixel.rays
        rays += sh.cond(ray.limit > 0, 1, 0)
        with SH_IF(ray.tracing):
            ray.tracing[:] = False
            with SH_IF(hit.id >= 0):
                emission = sh.Color3f(0, 0, 0) if self.surfaces.glows else None
                light.rn.y = self.surfaces.arrive(hit, ray.direction, ray.eye, surface, emission)
                with SH_IF(pixel.object < 0):
                    pixel.note(hit, surface, self.surfaces)
                self.gather(light, pixel, surface, emission)
            with SH_ELSE():
                light.scolor[:] = self.light_from(ray, light)
                light.rn.y = 0
        if self.lights.count:
            with SH_ELSE():
                lit = (hit.id < 0) & (ray.limit > 0)
                if self.surfaces.appearance.shades or self.shares.layered:
                    with SH_IF(lit):
                        light.scolor += self.surfaces.shade(surface, ray.direction) * light.lightcol
                else:
                    shade = self.surfaces.shade(surface, ray.direction)
                    light.scolor += sh.cond(lit, shade * light.lightcol, 0.0)
        return self.go_on(ray, light, surface, pixel)

    def light_from(self, ray: Any, light: Any) -> Any:
        """Return what a ray shows that has met nothing."""
        if self.around is not None and self.blurs:
            return self.around.blurred(ray.direction, light.blur)
        return self.background.radiance(ray.direction)

    def light_around(self, light: Any, surface: Interaction) -> Any:
        """Return the light of a surface in ambient light, or under the environment."""
        if self.around is None:
            return self.ambient * self.shares.ambient(surface)
        shown, roughness = self.around.scattered_by(surface)
        if self.blurs:
            light.blur[:] = sh.max(light.blur, roughness)
        return shown

    def gather(self, light: Any, pixel: Pixel, surface: Interaction, emission: Any) -> None:
        """Begin with the light of a surface that a ray has reached: ambient light, emission, and the lights to ask."""
        light.scolor[:] = self.light_around(light, surface)
        if self.shares.layered:
            light.rn.y = self.shares.mirror(surface, light.rn.y)
        if emission is not None:  # mirrors emit in full, too
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
                self.shares.leave(surface, light, pixel)
                finished[:] = self.least.ends(light)
                light.r -= 1
                ray.tracing[:] = True
                ray.direction[:] = mirrored(surface)
                ray.eye[:] = surface.inter
        return finished
