"""The surface that a ray hits.

Stage: kernel. The tracer's `readTables`. A scene of one material or light reads the first row without an index. No
number of a scene is a constant of its kernel, so scenes with the same features share one kernel.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from contextlib import nullcontext
from math import pi
from typing import Any, Final

import numpy as np

import shpy as sh
from raytracer.accel.space import Rows
from raytracer.appearance import programs
from raytracer.appearance.albedo import SMOOTHEST
from raytracer.appearance.materials import CUTOFF
from raytracer.errors import SceneError
from raytracer.kernels.anisotropy import orient
from raytracer.kernels.appearance import Appearance
from raytracer.kernels.bsdf import FAINT, diffuse_lobe, highlight
from raytracer.kernels.directions import largest
from raytracer.kernels.interactions import (
    ClearInteraction,
    DetailedInteraction,
    Interaction,
    LayeredInteraction,
    PlainInteraction,
    ProgrammedInteraction,
    SheenInteraction,
    blank,
)
from raytracer.kernels.kinds import MaterialKinds, glow_rows
from raytracer.kernels.layers import LayerTables
from raytracer.kernels.media import Media, RayBodies
from raytracer.kernels.microfacets import Microfacets, body_tint
from raytracer.kernels.normal_maps import tilted
from raytracer.kernels.point import SeenHit, barylerp, curve_depth, curved_normal, place_of, rows_of
from raytracer.kernels.triangle import Accept, CandidateHit, RayHit, Triangles
from raytracer.kernels.walk import meet
from raytracer.scene.bodies import Bodies
from raytracer.scene.layout import Change, Layout, is_programmed
from shpy import SH_ELSE, SH_IF

BLURRED: Final = 1 / 16
"""The least roughness of the highlight of a point light in a Whitted tracer, so that it is seen."""


class SurfaceTables:
    """Normals, colours and materials of a scene's triangles."""

    def __init__(self, layout: Layout, triangles: Triangles) -> None:
        self.triangles = triangles
        self.numbers: Any = None  # the table of the numbers by which programs know triangles, if not their places
        self.roundoff = layout.roundoff
        self.normals = _table(layout, layout.normals, sh.Attrib4f, "normals")
        self.colors = _table(layout, layout.colors, sh.Attrib4f, "colors")
        self.appearance = Appearance(layout)
        self.tints = any(map(is_programmed, layout.materials))
        self.uvs = _table(layout, layout.uvs if "uv" in self.appearance.reads else None, sh.TexCoord2f, "uvs")
        self.layout = layout
        self.glow = glow_rows(layout, self.appearance)
        self.kinds = MaterialKinds.of(layout, self.appearance)
        self.glows, self.highlights, self.clear, self.black, self.dark, self.reflects, *_ = self.kinds
        self.tinted, self.mixed = self.kinds.tinted, self.kinds.mixed
        self.lobes = Microfacets(self.kinds, binary16=layout.dtype == np.float16) if self.kinds.layered else None
        if self.tinted:
            self.mirrors = sh.Table(layout.mirrors, sh.Attrib4f, "mirrors")
        if self.lobes is not None:
            self.layers = LayerTables(layout, self.kinds)
        self.media: Media | None = None
        if self.clear:
            self.glass = sh.Table(layout.glass, sh.Attrib4f, "glass")
        if self.kinds.media:
            bodies = Bodies.of(layout, self.appearance.clears)
            self.media = Media(bodies, triangles, self.scale, layout.roundoff)
        # A surface between equal media lets light go straight on.
        self.straight = self.kinds.straight or (self.media is not None and self.media.bodies.slots > 1)
        self.materials = sh.Table(layout.material_rows, sh.Attrib4f, "materials")
        several = len(layout.material_rows) > 2
        self.material_of = sh.Table(layout.material_of, sh.Attrib1i, "material_of") if several else None
        if self.glows:
            self.emissions = sh.Table(self.glow, sh.Attrib4f, "emissions")
        self.object_of = sh.Table(layout.object_of, sh.Attrib1i, "object_of") if layout.object_of.any() else None
        self.instanced_meshes: Any = None  # the mesh and the material of each instance
        if layout.instanced is not None:
            self.instanced_meshes = sh.Table(layout.instanced.meshes, sh.Attrib2i, "instanced_meshes")
            self.numbers = triangles.instances.order
        self.sampled: Any = None  # the SampledSurfaces of a layered depth cube (`kernels.deferred`)

    @property
    def interaction(self) -> Any:
        """The struct of interactions in this scene."""
        if self.kinds.detailed:
            return DetailedInteraction
        if self.lobes is not None:
            return SheenInteraction if self.kinds.sheen else LayeredInteraction
        if self.clear:
            return ClearInteraction
        return ProgrammedInteraction if self.appearance.shades else PlainInteraction

    def renew(self, layout: Layout, changes: Sequence[Change]) -> bool:
        """Update the normals, colours and uv coordinates that changed; return whether the colours fit the kernel."""
        for name in ("normals", "colors", "uvs"):
            table, rows = getattr(self, name), getattr(layout, name)
            for first, past, _, stale in changes:
                if table is not None and name in stale:
                    table.update(rows[3 * first : 3 * past], start=3 * first)
        if self.sampled is not None:
            self.sampled.renew([(change.first, change.past) for change in changes])
        if self.media is not None and self.media.heeds(changes) and not self.media.take(self.bodies_of(layout)):
            return False
        return self.suit(layout) if any("colors" in change.stale for change in changes) else True

    def suit(self, layout: Layout) -> bool:
        """Return whether the materials of another layout fit the kernel; `Layout.painted` compares the rest."""
        if MaterialKinds.of(layout, self.appearance) != self.kinds:
            return False
        return self.media is None or self.media.suit(self.bodies_of(layout))

    def bodies_of(self, layout: Layout) -> Bodies:
        """Return the bodies of another layout, whose clear meshes are in the same places."""
        assert self.media is not None
        return Bodies.of(layout, self.appearance.clears, self.media.bodies.shells)

    def repaint(self, layout: Layout, tinted: Sequence[tuple[int, int]]) -> None:
        """Update the materials from a layout that fits the kernel, and the colours of these ranges of triangles."""
        for first, past in tinted:
            assert self.colors is not None
            assert layout.colors is not None
            self.colors.update(layout.colors[3 * first : 3 * past], start=3 * first)
        self.glow = glow_rows(layout, self.appearance)
        self.materials.update(layout.material_rows)
        if self.clear:
            self.glass.update(layout.glass)
        if self.tinted:
            self.mirrors.update(layout.mirrors)
        if self.lobes is not None:
            self.layers.repaint(layout)
        if self.media is not None:
            self.media.renew(self.bodies_of(layout))
        if self.glows:
            self.emissions.update(self.glow)
        if self.sampled is not None:
            self.sampled.renew()

    @functools.cached_property
    def scale(self) -> Any:
        """The factor of the scene's lengths; SceneError where a Param does not hold it."""
        if self.layout.scale > float(np.finfo(np.float32).max):
            raise SceneError(
                "glass, lights that fade and programs need the scene's lengths, and in a scene as small as this they "
                "are out of the range of binary32: scale the scene"
            )
        return sh.Param(sh.Attrib1f, self.layout.scale, name="scale")

    @functools.cached_property
    def origin(self) -> Any:
        """The place in the scene that is 0 in the kernel; None if it is the scene's own."""
        return sh.Param(sh.Point3f, self.layout.origin, name="origin") if self.layout.origin.any() else None

    def arrive(self, hit: RayHit, ray: Any, eye: Any, surface: Interaction, emission: Any = None) -> Any:
        """Fill in `surface` for a hit, and `emission` in a scene that glows; return the reflectivity."""
        corners = self.triangles.corners_of(hit)
        face = sh.Normal3f(corners[0].w, corners[1].w, corners[2].w)
        side = sh.cond(sh.dot(face, ray) > 0, -1.0, 1.0)
        facing = side * face
        places = tuple(corner.xyz for corner in corners)
        point, bound = self.place(hit, places, face, ray, eye)
        surface.view[:] = -ray
        surface.face[:] = facing
        surface.normal[:] = facing
        surface.inter[:] = point + bound * facing
        with nullcontext() if hit.sample is None else SH_IF(hit.sample < 0):
            self.bend(hit, surface, point, places, side, facing)
        if self.clear:
            row = self.glass[2 * self.material_at(hit)]
            surface.beyond[:] = point - bound * facing
            surface.outside[:] = side > 0
            surface.transmission[:] = row.x
            surface.ior[:] = row.y
            if self.kinds.bodies:
                surface.is_body[:] = row.z > 0
        if self.glows:
            emission[:] = self.glow_at(hit).rgb
        if hit.sample is None:
            return self.look(hit, surface, point, side, emission)
        reflectivity = sh.Color3f(0, 0, 0) if self.tinted else sh.Attrib1f()
        with SH_IF(hit.sample < 0):
            reflectivity[:] = self.look(hit, surface, point, side, emission)
        with SH_ELSE():
            reflectivity[:] = self.recall(hit, surface, side)
            if self.kinds.unlit:
                self.show_unlit(hit, surface, emission)
        return reflectivity

    def bend(self, hit: RayHit, surface: Interaction, point: Any, places: Any, side: Any, facing: Any) -> None:
        """Set the surface's normal to the interpolated one, if there are normals at the corners."""
        if self.normals is None:
            return
        normals: Any = rows_of(self.normals, hit)
        if self.instanced_meshes is not None and hit.instance is not None:
            placement = self.triangles.instances[hit.instance]
            normals = [placement.normal(normal) for normal in normals]
        surface.normal[:] = curved_normal(hit, normals, side, facing)
        surface.inter -= curve_depth(hit, normals, point, places, side)

    def look(self, hit: RayHit | SeenHit, surface: Interaction, point: Any, side: Any, emission: Any) -> Any:
        """Set the surface's colour and coefficients to those of its triangle; return its reflectivity."""
        if not self.kinds.unlit:
            return self.paint_or_describe(hit, surface, point, side, emission)
        reflectivity = self.paint_or_describe(hit, surface, point, side, emission)
        self.show_unlit(hit, surface, emission)
        return reflectivity

    def show_unlit(self, hit: RayHit | SeenHit, surface: Interaction, emission: Any) -> None:
        """Let the colour of an `Unlit` be its emission, and the surface black: no light changes it."""
        unlit = self.glow_at(hit).w < 0
        shown = (1 - surface.transmission) * surface.color if self.clear else surface.color
        emission[:] = sh.cond(unlit, shown, emission)
        surface.color[:] = sh.cond(unlit, 0.0, surface.color)

    def paint_or_describe(
        self, hit: RayHit | SeenHit, surface: Interaction, point: Any, side: Any, emission: Any
    ) -> Any:
        """Set the colour and coefficients of a lit surface to those of its triangle; return its reflectivity."""
        if self.lobes is None:
            if not self.appearance:
                return self.paint(hit, surface, self.material_at(hit))
            return self.describe(hit, surface, point, side, emission)
        self.layers.stack(surface, self.material_at(hit))
        if self.appearance:
            reflectivity = self.describe(hit, surface, point, side, emission)
        else:
            reflectivity = self.paint(hit, surface, self.material_at(hit))
        self.prepare(hit, surface, side)
        return reflectivity

    def prepare(self, hit: RayHit | SeenHit, surface: Interaction, side: Any) -> None:
        """Compute what follows from the view and the numbers of a `MetallicRoughness`."""
        assert self.lobes is not None
        if self.kinds.brushed:
            orient(self, hit, surface, side)
        with SH_IF(surface.is_layered) if self.mixed else nullcontext():
            self.lobes.prepare(surface)

    def recall(self, hit: RayHit, surface: Interaction, side: Any) -> Any:
        """Set the surface's normal and colour to those of its sample, the rest to the numbers of its material.

        Return the material's reflectivity.
        """
        assert self.sampled is not None
        number = self.material_at(hit)
        normal, color = self.sampled.at(hit.sample)
        normal = side * normal
        surface.normal[:] = sh.cond(sh.dot(normal, surface.face) < 0, -normal, normal)
        surface.color[:] = color
        surface.coefficients[:] = self.materials[2 * number + 1].xyz
        if self.lobes is not None:
            self.layers.stack(surface, number)
            self.prepare(hit, surface, side)
        reflectivity = self.mirrors[number].rgb if self.tinted else self.materials[2 * number].a
        return self._noted(surface, reflectivity, number)

    def _noted(self, surface: Interaction, reflectivity: Any, number: Any) -> Any:
        """Return the reflectivity, which the surface keeps for shades of users, as it does the shade's number."""
        if self.appearance.shades:
            surface.reflectivity[:] = largest(reflectivity) if self.tinted else reflectivity
            surface.shade[:] = self.appearance.shade_of(number)
        return reflectivity

    def behind(self, hit: RayHit, ray: Any, eye: Any) -> Any:
        """Return the point that was hit, moved off the surface to the side on which the ray leaves."""
        corners = self.triangles.corners_of(hit)
        face = sh.Normal3f(corners[0].w, corners[1].w, corners[2].w)
        point, bound = self.place(hit, tuple(corner.xyz for corner in corners), face, ray, eye)
        return point + bound * sh.cond(sh.dot(face, ray) > 0, face, -face)

    def reach(self, ray_bodies: RayBodies | None, hit: RayHit, surface: Interaction) -> Any:
        """Return the share (r, g, b) of light that the way to a hit has left, in the medium that the ray was in.

        It also makes the surface's `ior` that inside relative to that outside.
        """
        if self.media is None or ray_bodies is None:
            return sh.Color3f(1, 1, 1)
        kept, ratio = self.media.reach(ray_bodies, hit, surface.outside, surface.ior)
        surface.ior[:] = ratio
        return kept

    def reached(self, hit: RayHit, ray: Any, eye: Any) -> Interaction:
        """Return the interaction with a surface that a shadow ray goes through."""
        surface = blank(self.interaction)
        self.arrive(hit, ray, eye, surface, sh.Color3f(0, 0, 0) if self.glows else None)
        return surface

    def thin_at(self, hit: RayHit, ray: Any, eye: Any, *, smooth: bool) -> Any:
        """Return the share (r, g, b) of light that goes through the thin wall that was hit; if `smooth`, unblurred."""
        surface = self.reached(hit, ray, eye)
        counts = surface.is_layered
        if smooth:
            counts &= surface.coefficients.z < SMOOTHEST
        return sh.cond(counts, surface.thin, sh.Color3f(0, 0, 0))

    def passed(self, ray_bodies: RayBodies | None, hit: RayHit, ray: Any, eye: Any, *, straight: bool = False) -> Any:
        """Return the share (r, g, b) of light that comes to a hit and goes straight on, in the medium behind it.

        `straight`: only where it would be neither refracted nor blurred.
        """
        material = self.material_at(hit)
        row = self.glass[2 * material]
        clear = row.x
        if "transmission" in self.appearance.textured:
            clear = sh.min(self.appearance.number_at("transmission", material, lambda: self.uv_at(hit), clear), 1.0)
        if self.kinds.thin:
            clear = clear + (1 - clear) * self.thin_at(hit, ray, eye, smooth=straight)
        if self.kinds.bodies:
            clear = clear * body_tint(self.reached(hit, ray, eye))
        if self.media is None or ray_bodies is None:
            return clear * sh.cond(row.y == 1, sh.Color3f(1, 1, 1), 0.0) if straight else clear * sh.Color3f(1, 1, 1)
        kept, ratio = self.media.reach(ray_bodies, hit, ~self.comes_from_inside(hit, ray), row.y)
        ray_bodies.cross()
        if straight:
            clear = sh.cond(ratio == 1, clear, 0.0)
        return clear * kept

    def meet(self, walk: Any, is_eye: Any, ray: Any, eye: Any, limit: Any, any_hit: Any = False) -> RayHit:
        """Find the nearest hit as `kernels.walk.meet` does; with media, also the surfaces in contact with it."""
        media = self.media
        if media is None or not media.touches:
            return meet(walk, is_eye, ray, eye, limit, any_hit)
        hit = meet(walk, is_eye, ray, eye, limit, any_hit, lambda accept: media.touching(limit, ray, accept))
        media.merge(hit, ray, lambda: self.behind(hit, ray, eye))
        return hit

    def take(self, shadow: RayBodies | None, ray_bodies: RayBodies | None) -> None:
        """Let a shadow ray start in the medium of a ray."""
        if shadow is not None and ray_bodies is not None:
            shadow.take(ray_bodies)

    def begin(self, ray_bodies: RayBodies | None, walk: Any, eye: Any) -> None:
        """Let `ray_bodies` be the bodies in which an eye ray from `eye` starts."""
        if self.media is not None and ray_bodies is not None:
            eyes = functools.partial(self.meet, walk, lambda: sh.Attrib1b(True))
            self.media.begin(ray_bodies, eyes, self.behind, eye)

    def comes_from_inside(self, hit: RayHit, ray: Any) -> Any:
        """Return whether a ray hits a triangle from behind."""
        corners = self.triangles.corners_of(hit)
        return sh.dot(sh.Normal3f(corners[0].w, corners[1].w, corners[2].w), ray) > 0

    def place(self, hit: RayHit, places: Any, face: Any, ray: Any, eye: Any) -> tuple[Any, Any]:
        """Return the point that was hit, and how far it may be off the triangle's plane; see `place_of`."""
        return place_of(self.triangles, self.roundoff, hit, places, face, ray, eye)

    def material_at(self, hit: RayHit | CandidateHit | SeenHit) -> Any:
        """Return the number of the material that was hit."""
        return 0 if self.material_of is None else self._of_instance(hit, self.material_of[hit.id], 1)

    def glow_at(self, hit: RayHit | SeenHit) -> Any:
        """Return the emission of the material that was hit, and its expected brightness; see `glow_rows`."""
        return self.emissions[self.material_at(hit)]

    def paint(self, hit: RayHit | SeenHit, surface: Interaction, number: Any) -> Any:
        """Set the surface's colour and coefficients to the numbers of its material; return its reflectivity."""
        row = self.materials[2 * number]
        surface.coefficients[:] = self.materials[2 * number + 1].xyz
        surface.color[:] = row.rgb if self.colors is None else self.vertex_color(hit)
        if self.tints and self.colors is not None:
            surface.color *= row.rgb
        return self.mirrors[number].rgb if self.tinted else row.a

    @property
    def accept(self) -> Accept | None:
        """The filter of candidate hits; None if no material has a cutout."""
        return self.is_there if "cutout" in self.appearance.gives else None

    def is_there(self, hit: RayHit | CandidateHit) -> Any:
        """Return whether a material's cutout leaves a surface at a point of a triangle."""
        return self.appearance.number_at("cutout", self.material_at(hit), lambda: self.uv_at(hit), 1.0) >= CUTOFF

    def uv_at(self, hit: RayHit | CandidateHit | SeenHit) -> Any:
        """Interpolate the uv coordinates, where a rasteriser has not."""
        return hit.texcoord if isinstance(hit, SeenHit) else barylerp(hit, *rows_of(self.uvs, hit))

    def vertex_color(self, hit: RayHit | SeenHit) -> Any:
        """Interpolate the colours at the corners; white where there are none."""
        if self.colors is None:
            return sh.Color3f(1, 1, 1)
        return barylerp(hit, *(c.rgb for c in rows_of(self.colors, hit)))

    def describe(self, hit: RayHit | SeenHit, surface: Interaction, point: Any, side: Any, emission: Any) -> Any:
        """Set the surface's colour and coefficients by textures and programs; return its reflectivity."""
        number = self.material_at(hit)
        reflectivity = (sh.Color3f if self.tinted else sh.Attrib1f)(self.paint(hit, surface, number))
        diffuse, specular, shininess = (sh.Attrib1f(surface.coefficients[k]) for k in range(3))
        seen = programs.Hit(
            {
                "position": lambda: self.world(point),
                "normal": lambda: surface.normal,
                "face": lambda: surface.face,
                "view": lambda: surface.view,
                "uv": lambda: self.uv_at(hit),
                "color": lambda: self.vertex_color(hit),
                "object": lambda: self.object_at(hit),
                "triangle": lambda: self.triangle_at(hit),
                "distance": lambda: hit.l / self.scale,
                "outside": lambda: side > 0,
            }
        )
        variables = {"color": surface.color, "diffuse": diffuse, "specular": specular, "shininess": shininess}
        variables |= {"reflectivity": reflectivity, "normal": surface.normal, "emission": emission}
        if self.clear:
            variables |= {"transmission": surface.transmission, "ior": surface.ior}
        if self.lobes is not None:
            variables |= {"metallic": diffuse, "roughness": shininess, **self.layers.variables(surface)}
        self.appearance.describe(number, seen, variables, lambda color: tilted(self, hit, surface.normal, side, color))
        surface.coefficients[:] = sh.Attrib3f(diffuse, specular, shininess)
        if self.lobes is not None:
            self.layers.store(surface, variables)
        return self._noted(surface, reflectivity, number)

    def world(self, point: Any) -> Any:
        """Return a point in the scene's coordinates."""
        place = point / self.scale
        return place if self.origin is None else place + self.origin

    def object_at(self, hit: RayHit | SeenHit) -> Any:
        """Return the number of the mesh that was hit."""
        return self._of_instance(hit, 0 if self.object_of is None else self.object_of[hit.id], 0)

    def triangle_at(self, hit: RayHit | SeenHit) -> Any:
        """Return the number of the triangle that was hit among those of all meshes."""
        number, instances = hit.id if self.numbers is None else self.numbers[hit.id], self.triangles.instances
        return number if instances is None or hit.instance is None else number + instances.numbers[hit.instance].y

    def _of_instance(self, hit: RayHit | CandidateHit | SeenHit, number: Any, column: int) -> Any:
        """Add the number of the instance that was hit in a column of their table."""
        if self.instanced_meshes is None or hit.instance is None:
            return number
        return number + self.instanced_meshes[hit.instance][column]

    def lights_seen(self, surface: Interaction, count: Any) -> Any:
        """Return the number of lights that show on the surface: 0 on a perfect mirror, which needs no shadow rays."""
        if not self.dark:
            return count
        if self.lobes is not None:
            lit = surface.is_layered | (surface.coefficients.x > 0) | (surface.coefficients.y > 0)
            return sh.cond(lit, count, 0)
        return sh.cond((surface.coefficients.x > 0) | (surface.coefficients.y > 0), count, 0)

    def shade(self, surface: Interaction, light: Any) -> Any:
        """Return the colour under white light from direction `light`."""
        if not self.appearance.shades:
            return self.lobes_under(surface, light)
        seen = programs.Surface.of_sources(
            {
                "color": lambda: surface.color,
                "diffuse": lambda: surface.coefficients.x,
                "specular": lambda: surface.coefficients.y,
                "shininess": lambda: surface.coefficients.z,
                "reflectivity": lambda: surface.reflectivity,
                "normal": lambda: surface.normal,
                "position": lambda: self.world(surface.inter),
                "face": lambda: surface.face,
                "view": lambda: surface.view,
            }
        )
        return self.appearance.shade(surface.shade, seen, light, lambda: self.lobes_under(surface, light))

    def lobes_under(self, surface: Interaction, light: Any) -> Any:
        """Return the colour under white light from direction `light` in the model of the surface's material."""
        if self.lobes is None:
            return self.phong(surface, light)
        if not self.mixed:
            return pi * self.lobes.evaluate(surface, light, BLURRED)[0]
        shown = sh.Color3f(0, 0, 0)
        with SH_IF(surface.is_layered):
            shown[:] = pi * self.lobes.evaluate(surface, light, BLURRED)[0]
        with SH_ELSE():
            shown[:] = self.phong(surface, light)
        return shown

    def phong(self, surface: Interaction, light: Any) -> Any:
        """Return the colour under white light from direction `light` in Phong's model."""
        diffuse, specular, shininess = surface.coefficients
        shade = diffuse * diffuse_lobe(surface.normal, light) * surface.color
        if self.highlights:
            shine = highlight(surface.view, surface.normal, light, shininess)
            shade += specular * (sh.cond(shine > FAINT, shine, 0.0) if self.black else shine)
        return shade


def _table(layout: Layout, rows: Rows | None, kind: Any, name: str) -> Any:
    return None if rows is None else sh.Table(layout.table_rows(rows), kind, name)
