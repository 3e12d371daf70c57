"""The tracer of scenes with glass: a surface may send out a mirrored and a refracted ray (Whitted 1980).

Stage: kernel. The loop is that of `kernels.tracer`, with one call of the intersector. There is no recursion: one of the
two rays is followed at once, the other waits on a stack of the element's own. A ray carries the share of the picture
that it stands for. Shadow rays go straight through glass, which tints them; they take the surfaces in their order, so
that the product is the same on every backend.
"""

from __future__ import annotations

from typing import Any

import shpy as sh
from raytracer.accel.bounds import far
from raytracer.kernels.bsdf import largest
from raytracer.kernels.surfaces import Interaction
from raytracer.kernels.tracer import PathState, Pixel, Tracer, mirrored
from raytracer.kernels.walk import meet
from shpy import SH_DO, SH_ELSE, SH_IF, SH_UNTIL

WAITING = 8
"""Rays that may wait. A mirrored ray that finds no place is not followed: `bounces` must exceed 8 for that."""
LEAST = 2.0**-17
"""The share of the picture, in its brightest channel, below which a ray is not followed: 1/512 of a step of 8 bits."""


@sh.struct
class Waiting:
    """A ray that is to be followed: its share of the picture, and how many more rays may follow it."""

    eye: sh.Point3f
    direction: sh.Vector3f
    share: sh.Color3f
    left: sh.Attrib1i


class GlassTracer(Tracer):
    """The tracer of a scene in which something is clear."""

    scattered = True

    def __call__(self, ray: Any, eye: Any) -> Pixel:
        """Follow an eye ray of unit length; `ray` and `eye` are changed on the way."""
        path, surface, pixel = self.begin()
        rays = pixel.rays
        share = sh.Color3f(1, 1, 1)
        waiting = sh.Array(Waiting, WAITING)
        count = sh.Attrib1i(0)
        limit = sh.Attrib1f(far())
        lightcol = sh.Color3f(0, 0, 0)
        through = sh.Attrib1b(False)  # the shadow ray is on its way, behind glass
        local, mirror, clear = sh.Attrib1f(1), sh.Attrib1f(0), sh.Attrib1f(0)
        bent = sh.Vector3f()
        with SH_DO():
            with SH_IF(~through):
                limit[:] = far()
                lightcol[:] = 0
                self.aim(path, surface, ray, eye, limit, lightcol)
            hit = meet(self.intersector, lambda: rays == 0, ray, eye, limit, False)
            rays += sh.cond(limit > 0, 1, 0)
            with SH_IF(path.tracing):
                path.tracing[:] = False
                mirror[:] = 0
                clear[:] = 0
                local[:] = 1
                path.scolor[:] = self.background
                with SH_IF(hit.id >= 0):
                    emission = sh.Color3f(0, 0, 0) if self.surfaces.glows else None
                    reflectivity = self.surfaces.arrive(hit, ray, eye, surface, emission)
                    with SH_IF(pixel.object < 0):
                        self.note(pixel, hit, surface)
                    share *= self.surfaces.kept(hit, ~surface.outside)
                    reflected, turned = refracted(surface)
                    bent[:] = turned
                    opaque = 1 - surface.transmission
                    local[:] = opaque * (1 - reflectivity)
                    mirror[:] = opaque * reflectivity + surface.transmission * reflected
                    clear[:] = surface.transmission * (1 - reflected)
                    path.scolor[:] = self.ambient * surface.color
                    if emission is not None:  # mirrors and glass send out all of it, too
                        path.color += share * emission
                    path.shadows[:] = sh.cond(local > 0, self.surfaces.lights_seen(surface, self.lights.number), 0)
            if self.lights.count:
                with SH_ELSE():
                    self.meet_light(path, surface, hit, ray, eye, limit, lightcol, through)
            with SH_IF((path.shadows == 0) & ~through):
                path.color += share * (local * path.scolor)
                self.branch(path, surface, share, waiting, count, (mirror, clear, bent), ray, eye)
            SH_UNTIL(path.finished)
        return pixel

    def meet_light(
        self,
        path: PathState,
        surface: Interaction,
        hit: Any,
        ray: Any,
        eye: Any,
        limit: Any,
        lightcol: Any,
        through: Any,
    ) -> None:
        """Add the light of a shadow ray that has met nothing, or send it on through the glass that it has met."""
        through[:] = False
        with SH_IF(hit.id >= 0):
            lightcol *= self.surfaces.passed(hit, ray)
            through[:] = sh.max(sh.max(lightcol.r, lightcol.g), lightcol.b) > 0
            limit -= hit.l
            eye[:] = self.surfaces.behind(hit, ray, eye)
        with SH_ELSE(), SH_IF(limit > 0):
            path.scolor += self.surfaces.shade(surface, ray) * lightcol

    def branch(
        self, path: PathState, surface: Interaction, share: Any, waiting: Any, count: Any, rays: Any, ray: Any, eye: Any
    ) -> None:
        """Go on to the refracted ray while the mirrored one waits, or to the one there is, or to one that waits."""
        mirror, clear, bent = rays
        path.tracing[:] = True
        goes_on = path.r > 0
        path.r -= 1
        reflects, refracts = (goes_on & (largest(share) * part > LEAST) for part in (mirror, clear))
        mirror_ray = mirrored(surface)
        with SH_IF(refracts):
            with SH_IF(reflects):
                waiting[count] = Waiting(surface.inter, mirror_ray, mirror * share, path.r)
                count[:] = sh.min(count + 1, len(waiting))
            ray[:] = bent
            eye[:] = surface.beyond
            share *= clear
        with SH_ELSE():
            with SH_IF(reflects):
                ray[:] = mirror_ray
                eye[:] = surface.inter
                share *= mirror
            with SH_ELSE():
                path.finished[:] = count == 0
                count -= 1
                held = waiting[count]
                ray[:] = held.direction
                eye[:] = held.eye
                share[:] = held.share
                path.r[:] = held.left


def refracted(surface: Interaction) -> tuple[Any, Any]:
    """Return the share of unpolarised light that is mirrored, by Fresnel's equations, and the refracted direction.

    The share is 1 where all is mirrored, beyond the critical angle. Where an interpolated normal would send the ray
    back outside, it is turned into the surface. (Pharr, Jakob and Humphreys 2023, sections 9.3 and 9.5)
    """
    ratio = sh.cond(surface.outside, surface.ior, 1 / surface.ior)  # behind the surface to before it
    cosine = sh.clamp(sh.dot(surface.view, surface.normal), 0, 1)
    square = 1 - (1 - cosine * cosine) / (ratio * ratio)
    inner = sh.sqrt(sh.max(square, 0))
    across = (cosine - ratio * inner) / (cosine + ratio * inner)
    along = (ratio * cosine - inner) / (ratio * cosine + inner)
    share = sh.cond((square > 0) & (cosine > 0), 0.5 * (across * across + along * along), 1.0)
    bent = sh.normalize((cosine / ratio - inner) * surface.normal - surface.view / ratio)
    above = sh.max(sh.dot(bent, surface.face), 0)
    return share, bent - (2 * above) * surface.face
