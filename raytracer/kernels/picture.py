"""The programs of a picture: from the eye rays of a camera, or from the surfaces that a rasteriser has seen.

Stage: kernel. With a G-buffer the eye ray is not traced: its surface is given, and the tracer goes on from there with
shadow rays and mirrored rays, as the hybrid renderers that Christen 2005 and Bürger et al. 2007 have in view.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import shpy as sh
from raytracer.kernels.eye_rays import EyeRays, PanoramaRays
from raytracer.kernels.interactions import Interaction, blank
from raytracer.kernels.pixel import Pixel
from raytracer.kernels.point import SeenHit
from raytracer.kernels.tracer import Tracer
from raytracer.kernels.walk import meet
from shpy import SH_ELSE, SH_IF, SH_WHILE


class SeenSurface(NamedTuple):
    """The surface that a rasteriser has seen in a pixel, in the kernel's coordinates; `object` is -1 for nothing."""

    position: Any
    normal: Any
    object: Any
    uv: Any


def eye_rays(tracer: Tracer, rays: EyeRays | PanoramaRays) -> Any:
    """Record the program of a picture, which makes the eye ray of each pixel of a band and traces it."""

    @sh.program
    def picture() -> Pixel:
        row, column = sh.grid_index(2)
        return tracer(*rays(row, column))

    return picture


def seen_rays(tracer: Tracer, rays: EyeRays | PanoramaRays, first_of: Any, instance_of: Any = None) -> Any:
    """Record the program of a picture whose eye rays end where a rasteriser says.

    `first_of` is the table of the first triangle of each mesh, `instance_of` that of its instance, None without any.
    `slack` is a param: how far positions may be off their surfaces, as a part of their distance.
    """
    slack = sh.Param(sh.Attrib1f, 0, name="slack")

    @sh.program
    def picture(position: sh.Point3f, normal: sh.Normal3f, object: sh.Attrib1i, uv: sh.TexCoord2f) -> Pixel:
        row, column = sh.grid_index(2)
        return _follow(
            tracer, SeenSurface(position, normal, object, uv), *rays(row, column), first_of, instance_of, slack
        )

    return picture


def _follow(
    tracer: Tracer, seen: SeenSurface, direction: Any, eye: Any, first_of: Any, instance_of: Any, slack: Any
) -> Pixel:
    """Follow a ray from the surface that was seen."""
    ray, light, pixel = tracer.begin(direction, eye)
    surface = blank(tracer.surfaces.interaction)
    ray.tracing[:] = False
    with SH_IF(seen.object >= 0):
        distance = sh.dot(seen.position - ray.eye, ray.direction)
        instance = None if instance_of is None else instance_of[seen.object]
        hit = SeenHit(distance, first_of[seen.object], sh.TexCoord2f(0, 0), seen.uv, instance)
        emission = sh.Color3f(0, 0, 0) if tracer.surfaces.glows else None
        light.rn.y = _arrive(tracer, seen, hit, ray.direction, surface, emission, slack)
        pixel.note(hit, surface, tracer.surfaces)
        tracer.gather(light, pixel, surface, emission)
    with SH_ELSE():
        light.scolor[:] = tracer.light_from(ray, light)
        light.rn.y = 0
    finished = tracer.go_on(ray, light, surface, pixel)
    if tracer.loops:
        with SH_WHILE(lambda: ~finished):
            tracer.aim(ray, light, surface)
            never = sh.Attrib1b(False)
            met = meet(tracer.intersector, lambda: never, ray.direction, ray.eye, ray.limit, ~ray.tracing)
            finished[:] = tracer.shade_hit(ray, light, surface, pixel, met)
    return pixel


def _arrive(
    tracer: Tracer, seen: SeenSurface, hit: SeenHit, ray: Any, surface: Interaction, emission: Any, slack: Any
) -> Any:
    """Fill in `surface` for what was seen, and `emission` in a scene that glows; return the reflectivity."""
    normal = sh.normalize(seen.normal)
    side = sh.cond(sh.dot(normal, ray) > 0, -1.0, 1.0)
    surface.view[:] = -ray
    surface.face[:] = side * normal
    surface.normal[:] = surface.face
    surface.inter[:] = seen.position + (slack * hit.l) * surface.face
    if tracer.surfaces.glows:
        emission[:] = tracer.surfaces.glow_at(hit).rgb
    return tracer.surfaces.look(hit, surface, seen.position, side, emission)
