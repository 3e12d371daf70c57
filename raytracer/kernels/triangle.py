"""Where a ray meets a triangle.

Stage: kernel. Recorded into the walk of an accelerator. The triangle is seen along the ray: its corners, projected on
the plane across the ray's largest component, lie round the origin if the ray meets it (Woop, Benthin and Wald 2013).
A corner's projection depends on nothing but the corner and the ray, and swapping an edge's ends negates its edge
function to the bit: a ray cannot slip between triangles that share an edge or a corner.
"""

from __future__ import annotations

from typing import Any

import shpy as sh
from shpy import SH_IF


class Hit:
    """The nearest hit so far: distance `l`, barycentric `uv` of corners 1 and 2, and triangle `id`, -1 for none."""

    def __init__(self, limit: Any) -> None:
        l = sh.Attrib1f(limit)  # noqa: E741 - the paper's name
        uv = sh.TexCoord2f(0, 0)
        id = sh.Attrib1i(-1)
        self.l, self.uv, self.id = l, uv, id


class TriangleTest:
    """What a ray needs to be tried against many triangles: `across` and `along`, the rows of the projection.

    For a ray whose largest component is z they are (1, 0, -x/z) and (0, 1, -y/z), which takes the ray to the origin.
    """

    def __init__(self, ray: Any, eye: Any) -> None:
        size = abs(ray)
        by_x = (size.x >= size.y) & (size.x >= size.z)
        by_y = size.y >= size.z
        q = ray / sh.cond(by_x, ray.x, sh.cond(by_y, ray.y, ray.z))
        across = sh.cond(by_x, sh.Vector3f(-q.y, 1, 0), sh.cond(by_y, sh.Vector3f(1, -q.x, 0), sh.Vector3f(1, 0, -q.x)))
        along = sh.cond(by_x, sh.Vector3f(-q.z, 0, 1), sh.cond(by_y, sh.Vector3f(0, -q.z, 1), sh.Vector3f(0, 1, -q.y)))
        self.ray, self.eye, self.across, self.along = ray, eye, across, along

    def project(self, p: Any) -> Any:
        """A point relative to the ray's origin, seen along the ray."""
        return sh.Attrib2f(sh.dot(self.across, p), sh.dot(self.along, p))

    def __call__(self, triangles: Any, k: Any, near: Any, hit: Hit, *, numbers: Any = None, least: Any = None) -> None:
        """Store triangle `k` in `hit` if the ray meets it at a distance in [near, hit.l).

        Of triangles at the same distance that of the lowest number is stored, whichever is tried first. `triangles` is
        the table of `layout.triangle_rows`, `numbers` that of the numbers by which they are known, if not k itself.
        A distance below `least` is known to be wrong, and taken to be that. A triangle without area, or edge-on, is
        never met.
        """
        row0 = triangles[3 * k]
        row1 = triangles[3 * k + 1]
        row2 = triangles[3 * k + 2]
        corner = row0.xyz - self.eye
        a = self.project(corner)
        b = self.project(row1.xyz - self.eye)
        c = self.project(row2.xyz - self.eye)
        wa = b.x * c.y - b.y * c.x
        wb = c.x * a.y - c.y * a.x
        wc = a.x * b.y - a.y * b.x
        left = (wa >= 0) & (wb >= 0) & (wc >= 0)
        right = (wa <= 0) & (wb <= 0) & (wc <= 0)
        whole = wa + wb + wc
        with SH_IF((left | right) & (whole != 0)):
            normal = sh.Normal3f(row0.w, row1.w, row2.w)
            t = sh.dot(normal, corner) / sh.dot(normal, self.ray)
            ahead = t >= near
            if least is not None:
                t = sh.max(t, least)
            number = k if numbers is None else numbers[k]
            with SH_IF(ahead & ((t < hit.l) | ((t == hit.l) & (number < hit.id)))):
                hit.l[:] = t
                hit.uv[:] = sh.TexCoord2f(wb, wc) / whole
                hit.id[:] = number
