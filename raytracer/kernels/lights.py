"""The placed lights of a scene, and the shadow rays toward them.

Stage: kernel. The tracer's `getLightValues`.
"""

from __future__ import annotations

from typing import Any

import shpy as sh
from raytracer.accel.bounds import far
from raytracer.accel.space import Rows
from raytracer.kernels.surfaces import Interaction, SurfaceTables
from raytracer.scene.layout import kinds_of


class LightList:
    """The lights of a scene: `count` of them; `number` is a uniform of that value if there are several."""

    def __init__(self, rows: Rows, surfaces: SurfaceTables) -> None:
        self.count, self.points, self.directions, self.fades = kinds_of(rows)
        self.number = sh.Param(sh.Attrib1i, self.count, name="lights_count") if self.count > 1 else self.count
        self.surfaces = surfaces
        self.table = sh.Table(rows, sh.Attrib4f, "lights") if self.count else None

    def renew(self, rows: Rows) -> None:
        """Replace the lights by as many others of the same kinds."""
        if self.table is not None:
            self.table.update(rows)

    def aim(self, n: Any, surface: Interaction, ray: Any, eye: Any, limit: Any, lightcol: Any) -> None:
        """Make the shadow ray toward light `n`, which need not go farther than `limit`: 0 for a light behind."""
        assert self.table is not None  # else no ray is aimed
        first = 2 * n if self.count > 1 else 0
        place, color = self.table[first], self.table[first + 1]
        toward = sh.Vector3f(place.xyz)
        distance = sh.Attrib1f(far())
        if self.points:
            toward -= place.w * surface.inter
            distance[:] = sh.cond(place.w > 0, sh.length(toward), far())
        ray[:] = sh.normalize(toward)
        eye[:] = surface.inter
        limit[:] = sh.cond(sh.dot(surface.normal, ray) > 0, distance, 0.0)
        lightcol[:] = color.rgb
        if self.fades:
            way = distance / self.surfaces.scale
            lightcol[:] = sh.cond(color.w > 0, color.rgb / (way * way), color.rgb)
