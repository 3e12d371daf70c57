"""Normals that the picture of a material turns, as in glTF.

Stage: kernel. `surfaces` are `SurfaceTables`.
"""

from __future__ import annotations

from typing import Any

import shpy as sh
from raytracer.kernels.point import SeenHit, rows_of
from raytracer.kernels.triangle import RayHit

FLAT = 1 / 250
"""The largest slope of a normal map that is taken for 0: 8 bits store 0 as 127 or 128 of 255, which is 1/255 off."""


def direction_of_u(surfaces: Any, hit: RayHit | SeenHit) -> tuple[Any, Any, Any]:
    """Return where u grows on a triangle, a vector of any length, and the area of the uv coordinates.

    Between them is 1 where v grows to the left of it, seen from the front, and -1 where v grows to the right.
    """
    a, b, c = (corner.xyz for corner in surfaces.triangles.corners_of(hit))
    start, to_b, to_c = rows_of(surfaces.uvs, hit)
    to_b, to_c = to_b - start, to_c - start
    area = to_b.x * to_c.y - to_c.x * to_b.y
    hand = sh.cond(area > 0, 1.0, -1.0)
    along = sh.Vector3f(hand * ((b - a) * to_c.y - (c - a) * to_b.y))
    instances = surfaces.triangles.instances
    if instances is not None and hit.instance is not None:
        hand = hand * instances[hit.instance].hand
    return along, hand, area


def tilted(surfaces: Any, hit: RayHit | SeenHit, normal: Any, side: Any, color: Any) -> Any:
    """Return a unit normal on the viewer's side, turned by a colour of a normal map.

    The tangent is where u grows on the triangle, made perpendicular to the normal. The bitangent is perpendicular
    to both, on the side where v grows, as MikkTSpace has them, but of each triangle by itself. Seen from behind,
    bumps become dents.
    """
    along, hand, area = direction_of_u(surfaces, hit)
    outward = side * sh.Vector3f(normal)
    tangent = sh.normalize(along - outward * sh.dot(along, outward))
    bitangent = hand * sh.cross(outward, tangent)
    slope = 2 * color - 1
    turned = sh.normalize(slope.r * tangent + slope.g * bitangent + slope.b * outward)
    flat = (sh.max(abs(slope.r), abs(slope.g)) <= FLAT) | (area == 0)
    return sh.cond(flat, normal, sh.Normal3f(side * turned))
