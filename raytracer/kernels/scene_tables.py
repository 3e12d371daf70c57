"""The tables of a scene that its tracers read, the placed lights among them, and their upkeep between pictures.

Stage: kernel. `LightList.aim` is the tracer's `getLightValues`. A tracer adds the loop that follows a ray.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.accel.bounds import far
from raytracer.accel.grid import Grid
from raytracer.accel.two_levels import TwoLevels
from raytracer.kernels.deferred import SampledSurfaces
from raytracer.kernels.interactions import Interaction
from raytracer.kernels.sky import Sky
from raytracer.kernels.surfaces import SurfaceTables
from raytracer.kernels.walk import Scattered, renew_walk, scene_walk
from raytracer.scene.layout import Change, Layout
from raytracer.scene.light_tables import kinds_of
from raytracer.scene.scene import Background, Scene


class LightList:
    """The lights of a scene: `count` of them; `number` is a uniform of that value if there are several."""

    def __init__(self, layout: Layout, surfaces: SurfaceTables) -> None:
        rows = layout.lights
        self.count, self.points, self.directions, self.fades = kinds_of(rows)
        self.number = sh.Param(sh.Attrib1i, self.count, name="lights_count") if self.count > 1 else self.count
        self.surfaces = surfaces
        self.table = sh.Table(rows, sh.Attrib4f, "lights") if self.count else None
        self.cones = None if layout.cones is None else sh.Table(layout.cones, sh.Attrib4f, "cones")

    def renew(self, layout: Layout) -> None:
        """Replace the lights by as many others of the same kinds."""
        if self.table is not None:
            self.table.update(layout.lights)
        if self.cones is not None and layout.cones is not None:
            self.cones.update(layout.cones)

    def aim(self, n: Any, surface: Interaction, ray: Any, eye: Any, limit: Any, lightcol: Any) -> None:
        """Make the shadow ray toward light `n`, which need not go farther than `limit`: 0 for a light behind."""
        assert self.table is not None  # rays are aimed only if there is a table of lights
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
        if self.cones is not None:
            share = self.share_toward(self.cones[first], self.cones[first + 1], ray, distance)
            lightcol *= share
            limit[:] = sh.cond(share > 0, limit, 0.0)

    def share_toward(self, cone: Any, ramp: Any, ray: Any, distance: Any) -> Any:
        """Return the share of a light that its cone and its range leave, at the end of a ray to it."""
        bright = sh.saturate(ramp.y - ramp.x * sh.dot(sh.Vector3f(cone.xyz), ray))
        part = sh.min(distance * cone.w, 1.0)
        return bright * bright * (1 - (part * part) * (part * part))


class SceneTables:
    """The walk of a scene's rays, its surfaces and its background; `features` lists the features of their kernels."""

    scattered: Scattered = None
    """The rays of the tracer that have little in common with their neighbours: see `scene_walk`."""
    features: dict[str, bool | int]
    lights: LightList
    background: Any
    levels_around: NDArray[np.float32] | None = None
    """The numbers of the blurred environment, of tracers that read one."""
    ambient: Any = None
    """The param of the ambient light, for tracers that add it."""

    def __init__(self, layout: Layout, background: Background, backend: str) -> None:
        self.intersector = scene_walk(layout, backend, self.scattered)
        self.surfaces = SurfaceTables(layout, self.intersector.triangles)
        cube = layout.secondary
        if cube is not None and cube.options["shading"] == "deferred":
            self.surfaces.sampled = SampledSurfaces(self.surfaces, cube, backend)
        self.intersector.accept = self.surfaces.accept
        self.background = Sky(background)

    def renew_emitters(self, layout: Layout) -> bool:
        """Update how lights are chosen; return False, having changed nothing, where that needs another kernel."""
        return True

    def renew(self, layout: Layout, changes: Sequence[Change]) -> bool:
        """Update the tables after changes; return False where a kernel must be made anew."""
        renew_walk(self.intersector, layout, changes)
        return self.surfaces.renew(layout, changes) and self.renew_emitters(layout)

    def place(self, layout: Layout) -> bool:
        """Take the places of instances that have moved; return False where a kernel must be made anew."""
        assert isinstance(layout.structure, TwoLevels)
        media = self.surfaces.media
        if media is not None and not media.take(self.surfaces.bodies_of(layout)):
            return False
        return self.intersector.place(layout.structure) and self.renew_emitters(layout)

    def repaint(self, layout: Layout, tinted: Sequence[tuple[int, int]], scene: Scene) -> bool:
        """Take the materials and lights of `Layout.painted`, and a scene's background and ambient light.

        Return False, having changed nothing, where they need another kernel.
        """
        suits = self.surfaces.suit(layout) and self.background.suits(scene.background)
        if not suits or not self.renew_emitters(layout):
            return False
        self.surfaces.repaint(layout, tinted)
        self.lights.renew(layout)
        self.background.renew(scene.background)
        if self.ambient is not None:
            self.ambient.value = float(scene.ambient)
        return True


def whitted_features(tracer: Any, layout: Layout) -> dict[str, bool | int]:
    """Return what the kernel of a `Tracer` of this layout contains."""
    surfaces, lights = tracer.surfaces, tracer.lights
    features: dict[str, bool | int] = {
        "lights": lights.count,
        "point lights": lights.points,
        "directional lights": lights.directions,
        "reflections": tracer.most_bounces if tracer.reflects else 0,
        "smooth normals": layout.normals is not None,
        "vertex colours": layout.colors is not None,
        "materials": len(layout.material_rows) // 2,
        "highlights": surfaces.highlights,
    }
    if isinstance(layout.structure, Grid):
        features["triangles outside the grid"] = layout.structure.outside
    if surfaces.appearance:
        features["surface programs"] = len(surfaces.appearance.surfaces)
        features["shade programs"] = len(surfaces.appearance.shades)
        features["textures"] = len(surfaces.appearance.textured)
    others = {"glass": surfaces.clear, "cutouts": surfaces.accept is not None, "sky": not tracer.background.plain}
    others["metallic-roughness"] = surfaces.lobes is not None
    others |= {"cones and ranges": lights.cones is not None, "unlit": surfaces.kinds.unlit}
    return features | {name: True for name, there in others.items() if there}
