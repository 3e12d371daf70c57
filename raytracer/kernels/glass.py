"""The tracer of scenes with glass: a surface may send out a mirrored and a refracted ray (Whitted 1980).

Stage: kernel. The loop is that of `kernels.tracer`, with one call of the intersector. There is no recursion: one of the
two rays is followed at once, the other waits on a stack of the element's own. A ray carries the share of the picture
that it stands for, and the bodies that hold it (`kernels.media`). Shadow rays go straight through glass, which tints
them, from the medium of the surface on; they take the surfaces in their order, so that the product is the same on every
backend.
"""

from __future__ import annotations

from typing import Any

import shpy as sh
from raytracer.kernels.directions import largest, mirrored
from raytracer.kernels.interactions import Interaction, blank
from raytracer.kernels.media import RayBodies
from raytracer.kernels.microfacets import body_tint
from raytracer.kernels.pixel import Pixel
from raytracer.kernels.tracer import Tracer
from shpy import SH_DO, SH_ELSE, SH_IF, SH_UNTIL

WAITING = 8
"""Rays that have a place to wait, or the next power of two from `bounces` on: of as many rays, each has made another
number of bounces."""


@sh.struct
class Waiting:
    """A ray that is to be followed: its share of the picture, and how many more rays may follow it."""

    eye: sh.Point3f
    direction: sh.Vector3f
    share: sh.Color3f
    left: sh.Attrib1i


@sh.struct
class BlurredWaiting(Waiting):
    """The `Waiting` of a scene with rough mirrors and an environment; see `BlurredLight`."""

    blur: sh.Attrib1f


class MediaStack:
    """The rays that wait, and how many; with media, also the bodies that hold each."""

    def __init__(self, waiting_struct: Any, places: int, body_arrays: list[Any]) -> None:
        waiting = sh.Array(waiting_struct, places)  # emitted texts name the array after this variable
        self.rays, self.bodies = waiting, body_arrays
        count = sh.Attrib1i(0)
        self.count = count

    def push(self, ray: Waiting, ray_bodies: RayBodies | None) -> None:
        """Let a ray wait."""
        self.rays[self.count] = ray
        for row, slot in zip(self.bodies, ray_bodies.slots if ray_bodies else (), strict=True):
            row[self.count] = slot
        self.count += 1

    def pop(self, ray_bodies: RayBodies | None) -> Any:
        """Return the ray that came last; `ray_bodies` become its bodies."""
        self.count -= 1
        for row, slot in zip(self.bodies, ray_bodies.slots if ray_bodies else (), strict=True):
            slot[:] = row[self.count]
        return self.rays[self.count]


class GlassTracer(Tracer):
    """The tracer of a scene in which something is clear."""

    scattered = "secondary"

    @property
    def places(self) -> int:
        """The rays that may wait at a time."""
        return max(WAITING, 1 << (self.most_bounces - 1).bit_length())

    def __call__(self, direction: Any, eye: Any) -> Pixel:
        """Follow an eye ray of unit length."""
        ray, light, pixel = self.begin(direction, eye)
        surface = blank(self.surfaces.interaction)
        rays, media, walk = pixel.rays, self.surfaces.media, self.intersector
        share = sh.Color3f(1, 1, 1)
        ray_bodies, shadow, rows = (None, None, []) if media is None else media.of_rays(self.places)
        waiting = MediaStack(BlurredWaiting if self.blurs else Waiting, self.places, rows)
        through = sh.Attrib1b(False)  # the shadow ray is on its way, behind glass
        share_type = sh.Color3f if self.shares.tinted else sh.Attrib1f
        local, mirror, clear = share_type(1), share_type(0), share_type(0)
        bent = sh.Vector3f()
        self.surfaces.begin(ray_bodies, walk, ray.eye)
        with SH_DO():
            with SH_IF(~through):
                self.aim(ray, light, surface)
                self.surfaces.take(shadow, ray_bodies)
            hit = self.surfaces.meet(walk, lambda: rays == 0, ray.direction, ray.eye, ray.limit)
            rays += sh.cond(ray.limit > 0, 1, 0)
            with SH_IF(ray.tracing):
                ray.tracing[:] = False
                mirror[:] = 0
                clear[:] = 0
                local[:] = 1
                if self.background.plain:
                    light.scolor[:] = self.background.color
                with SH_IF(hit.id >= 0):
                    emission = sh.Color3f(0, 0, 0) if self.surfaces.glows else None
                    reflectivity = self.surfaces.arrive(hit, ray.direction, ray.eye, surface, emission)
                    with SH_IF(pixel.object < 0):
                        pixel.note(hit, surface, self.surfaces)
                    share *= self.surfaces.reach(ray_bodies, hit, surface)
                    self.divide(light, pixel, surface, share, emission, reflectivity, (local, mirror, clear, bent))
                self.show_sky(light, ray)
            if self.lights.count:
                with SH_ELSE():
                    self.meet_light(ray, light, surface, hit, through, shadow)
            finished = sh.Attrib1b(False)
            with SH_IF((light.shadows == 0) & ~through):
                pixel.color[:] += share * (local * light.scolor)
                finished[:] = self.branch(ray, light, surface, share, waiting, ray_bodies, (mirror, clear, bent))
            SH_UNTIL(finished)
        return pixel

    def divide(
        self,
        light: Any,
        pixel: Pixel,
        surface: Interaction,
        share: Any,
        emission: Any,
        reflectivity: Any,
        parts: tuple[Any, Any, Any, Any],
    ) -> None:
        """Divide the light of a surface that was hit into `parts`: its own, the mirrored and the refracted share.

        The last of them is the direction of the refracted ray. Begin with ambient light and emission.
        """
        local, mirror, clear, bent = parts
        reflected, bent[:] = refracted(surface)
        opaque = 1 - surface.transmission
        local[:] = self.shares.own(surface, opaque, reflectivity)
        reflectivity = self.shares.mirror(surface, reflectivity)
        mirror[:] = opaque * reflectivity + surface.transmission * reflected
        clear[:] = surface.transmission * (1 - reflected)
        if self.surfaces.kinds.bodies:
            clear *= body_tint(surface)
        if self.shares.thin:
            clear += self.shares.clear(surface, opaque)
        light.scolor[:] = self.light_around(light, surface)
        if emission is not None:  # mirrors and glass emit in full, too
            pixel.color[:] += share * emission
        light.shadows[:] = sh.cond(
            (largest(local) if self.shares.tinted else local) > 0,
            self.surfaces.lights_seen(surface, self.lights.number),
            0,
        )

    def show_sky(self, light: Any, ray: Any) -> None:
        """Take the background for a ray that has missed, after the branch of rays that have hit."""
        if not self.background.plain:
            with SH_ELSE():
                light.scolor[:] = self.light_from(ray, light)

    def meet_light(
        self, ray: Any, light: Any, surface: Interaction, hit: Any, through: Any, shadow: RayBodies | None
    ) -> None:
        """Add the light of a shadow ray that has hit no surface, or continue it through the glass that it has hit."""
        through[:] = False
        lightcol = light.lightcol
        with SH_IF(hit.id >= 0):
            lightcol *= self.surfaces.passed(shadow, hit, ray.direction, ray.eye)
            through[:] = sh.max(sh.max(lightcol.r, lightcol.g), lightcol.b) > 0
            ray.limit -= hit.l
            ray.eye[:] = self.surfaces.behind(hit, ray.direction, ray.eye)
        with SH_ELSE(), SH_IF(ray.limit > 0):
            if shadow is not None and self.lights.points:
                assert self.surfaces.media is not None
                lightcol *= self.surfaces.media.kept_to_light(shadow, ray.limit)
            light.scolor += self.surfaces.shade(surface, ray.direction) * lightcol

    def branch(
        self,
        ray: Any,
        light: Any,
        surface: Interaction,
        share: Any,
        waiting: MediaStack,
        ray_bodies: RayBodies | None,
        successors: tuple[Any, Any, Any],
    ) -> Any:
        """Choose the next ray.

        Of two rays it is the refracted one, and the mirrored one waits. Without a ray it is one that waits.
        `successors` are the shares of the mirrored and the refracted ray, and the direction of this. Return whether no
        ray is left.
        """
        mirror, clear, bent = successors
        finished = sh.Attrib1b(False)
        ray.tracing[:] = True
        goes_on = light.r > 0
        light.r -= 1
        reflects, refracts = (goes_on & self.least.counts(share, part) for part in (mirror, clear))
        mirror_ray = mirrored(surface)
        with SH_IF(refracts):
            with SH_IF(reflects):
                ray_values = surface.inter, mirror_ray, mirror * share, light.r
                mirror_image = BlurredWaiting(*ray_values, light.blur) if self.blurs else Waiting(*ray_values)
                waiting.push(mirror_image, ray_bodies)
            if ray_bodies is not None:
                ray_bodies.cross()
            ray.direction[:] = bent
            ray.eye[:] = surface.beyond
            share *= clear
        with SH_ELSE():
            with SH_IF(reflects):
                ray.direction[:] = mirror_ray
                ray.eye[:] = surface.inter
                share *= mirror
            with SH_ELSE():
                finished[:] = waiting.count == 0
                last = waiting.pop(ray_bodies)
                ray.direction[:] = last.direction
                ray.eye[:] = last.eye
                share[:] = last.share
                light.r[:] = last.left
                if self.blurs:
                    light.blur[:] = last.blur
        return finished


def refracted(surface: Interaction) -> tuple[Any, Any]:
    """Return the share of unpolarised light that is mirrored, by Fresnel's equations, and the refracted direction.

    The share is 1 where all is mirrored, beyond the critical angle. Where an interpolated normal would send the ray
    back outside, it is turned into the surface. (Pharr, Jakob and Humphreys 2023, sections 9.3 and 9.5)
    """
    ratio = sh.cond(surface.outside, surface.ior, 1 / surface.ior)  # behind the surface to before it
    cosine = sh.clamp(sh.dot(surface.view, surface.normal), 0, 1)
    square = (cosine * cosine + (ratio * ratio - 1)) / (ratio * ratio)  # where the ratio is 1, nothing is mirrored
    inner = sh.sqrt(sh.max(square, 0))
    across = (cosine - ratio * inner) / (cosine + ratio * inner)
    along = (ratio * cosine - inner) / (ratio * cosine + inner)
    share = sh.cond((square > 0) & (cosine > 0), 0.5 * (across * across + along * along), 1.0)
    bent = sh.normalize((cosine / ratio - inner) * surface.normal - surface.view / ratio)
    above = sh.max(sh.dot(bent, surface.face), 0)
    return share, bent - (2 * above) * surface.face
