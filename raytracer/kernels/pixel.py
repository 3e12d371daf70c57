"""The pixel of an eye ray: a value for each layer of an `Image`.

Stage: kernel. Every tracer begins with the background's pixel, notes the first surface in it, and adds light to it.
"""

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple

import shpy as sh
from raytracer.kernels.interactions import Interaction
from raytracer.kernels.point import SeenHit
from raytracer.kernels.surfaces import SurfaceTables
from raytracer.kernels.triangle import RayHit


class Pixel(NamedTuple):
    """The result of an eye ray: the layers of an `Image`."""

    color: sh.Color3f
    depth: sh.Attrib1f
    normal: sh.Normal3f
    object: sh.Attrib1i
    rays: sh.Attrib1i

    def note(self, hit: RayHit | SeenHit, surface: Interaction, surfaces: SurfaceTables) -> None:
        """Store the first surface that the eye ray hits."""
        self.depth[:] = hit.l
        self.normal[:] = surface.normal
        self.object[:] = surfaces.object_at(hit)


class CoveredPixel(NamedTuple):
    """The result of the eye rays of a transparent picture; `alpha` is the share of them that met a surface."""

    color: sh.Color3f
    depth: sh.Attrib1f
    normal: sh.Normal3f
    object: sh.Attrib1i
    rays: sh.Attrib1i
    alpha: sh.Attrib1f


def background_pixel(color: Any, rays: Any) -> Pixel:
    """Return the layers where nothing is hit."""
    depth = sh.Attrib1f(inf)
    normal = sh.Normal3f(0, 0, 0)
    number = sh.Attrib1i(-1)
    return Pixel(color, depth, normal, number, rays)
