"""Path tracing: the light that a path brings to the eye, with a ray to one light from each surface.

Stage: kernel. The estimate of Kajiya (1986, The Rendering Equation). Both ways of finding a light, aiming at it and
meeting it by chance, are combined by the power heuristic with exponent 2 (Veach 1997, section 9.2). One loop with one
call of the intersector follows all samples of a pixel: an iteration traces the ray that continues the path, or the one
to a light. Where many elements run side by side the next path begins where one ends, so that they do not wait for the
longest one. Lanes of a packet, whose rays walk together, begin their paths together.

A surface between equal media, or a thin wall of `ior` 1, lets light go straight on: neither the ray to a light ends
there, nor does the path count it as a bounce, so that both ways find the same light. What is refracted ends a ray to a
light. The medium travels with each ray (`kernels.media`).

Random numbers are points of Sobol', which hashes of the seed, the pixel and the dimension order and shift
(`kernels.points`).
Samples are averaged in their order, by a running mean, so that a picture may be continued: it is the same whoever
computes which samples.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import shpy as sh
from raytracer.accel.bounds import FAR
from raytracer.appearance.albedo import SMOOTHEST
from raytracer.errors import SceneError, place_of
from raytracer.kernels.bsdf import Bsdf
from raytracer.kernels.directions import largest, mirrored
from raytracer.kernels.emitters import Emitters
from raytracer.kernels.eye_rays import EyeRays, PanoramaRays
from raytracer.kernels.glass import refracted
from raytracer.kernels.interactions import Interaction, blank
from raytracer.kernels.media import Media, RayBodies
from raytracer.kernels.microfacets import body_tint
from raytracer.kernels.pixel import CoveredPixel, Pixel, background_pixel
from raytracer.kernels.points import reversed_bits, sobol_pair
from raytracer.kernels.scene_tables import SceneTables
from raytracer.kernels.triangle import RayHit
from raytracer.kernels.walk import TOGETHER
from raytracer.scene.layout import Layout
from raytracer.scene.scene import Scene
from shpy import SH_DO, SH_ELSE, SH_IF, SH_UNTIL

ROULETTE = 4
"""The depth at which Russian roulette starts."""
EYE, LIGHTS, DIMENSIONS = 4, 8, 14
"""The dimensions of a sample: four for its eye ray, then 14 for each surface, those from `LIGHTS` on for its light."""
STRAIGHT = 2**32 - 1
"""Hashed with the key of a path that went straight through a surface: the next one gets other random numbers."""


class PathSample:
    """A path on its way.

    `color` is the light that it has brought, `weight` the part of what comes along the ray that reaches the eye;
    `depth` counts the surfaces that have scattered it. `density` is that of the ray's direction, per steradian, 0 where
    no light could have been aimed at instead. `lighting` says whether the next ray goes to a light, `mirror` and
    `clear` whether the surface is taken for a mirror, or for glass. With `media`, `held` and `shadow` are the bodies
    that hold the path's ray, and the ray to a light.

    Where rays may go `straight` on: `through` says whether the ray to a light has done so, and `rest` how far it still
    goes; `way` is how far the path has come since it was scattered, and `aimed` the density with which the direction to
    the environment would have been chosen there.

    In a transparent picture `covered` says whether a surface has scattered the path, None in others.
    """

    def __init__(self, media: Media | None = None, straight: bool = False, transparent: bool = False) -> None:
        color = sh.Color3f(0, 0, 0)
        throughput = sh.Color3f(1, 1, 1)
        density = sh.Attrib1f(0)
        depth = sh.Attrib1i(0)
        number = sh.Attrib1i(0)
        key, order = sh.Attrib1u(0), sh.Attrib1u(0)
        lighting, mirror, clear = sh.Attrib1b(False), sh.Attrib1b(False), sh.Attrib1b(False)
        finished = sh.Attrib1b(True)
        self.color, self.throughput, self.density, self.depth = color, throughput, density, depth
        self.number, self.key, self.order = number, key, order
        self.lighting, self.mirror, self.clear, self.finished = lighting, mirror, clear, finished
        self.ray_bodies: RayBodies | None = None if media is None else media.make_ray_bodies()
        self.shadow: RayBodies | None = None if media is None else media.make_ray_bodies()
        if straight:
            through, goes_on = sh.Attrib1b(False), sh.Attrib1b(False)
            rest, way, aimed = sh.Attrib1f(0), sh.Attrib1f(0), sh.Attrib1f(0)
            self.through, self.goes_on, self.rest, self.way, self.aimed = through, goes_on, rest, way, aimed
        self.covered: Any = sh.Attrib1b(False) if transparent else None

    def words(self, dimension: int) -> tuple[Any, Any]:
        """Return two random words of the surface that the path has reached, for an even dimension and the next one."""
        place = sh.Attrib1u(self.depth * DIMENSIONS + (EYE + dimension))
        return sobol_pair(self.order, sh.hash(self.key, place))

    def random(self, dimension: int) -> Any:
        """Return a number in [0, 1) of the surface that the path has reached."""
        return sh.unit_float(self.words(dimension & ~1)[dimension & 1])


def power(density: Any, other: Any) -> Any:
    """Return the weight of a sample of this density where the other way has the density `other` (power heuristic).

    It is density**2 / (density**2 + other**2), without squares that leave the range of numbers.
    """
    ratio = other / density
    return 1 / (1 + ratio * ratio)


class PathTracer(SceneTables):
    """The tables of a scene, and the loop that follows the samples of a pixel.

    `seed`, `first_sample` and `past_sample` are uniforms: a run adds the samples from the first to the last to a mean.
    `clamp` is that of `Path`.
    Raises SceneError for a material whose `shade` says how it is lit: path tracing needs a function of two directions.
    """

    scattered = "all"
    aimed_share = staticmethod(power)
    met_share = staticmethod(power)

    def __init__(self, layout: Layout, scene: Scene, bounces: int, backend: str, clamp: float | None = None) -> None:
        for material in layout.materials:
            if material.shade is not None:
                raise SceneError(
                    f'{place_of(material.shade)}: a shade is for integrator="whitted", as path tracing knows no light '
                    "without its direction: describe the surface by surface=..., or leave shade out"
                )
        super().__init__(layout, scene.background, backend)
        self.together = backend in TOGETHER
        self.emitters = Emitters(layout, self.surfaces, scene.environment)
        self.lights = self.emitters.placed
        self.bsdf = Bsdf(self.surfaces.highlights, self.surfaces.lobes, self.surfaces.mixed)
        self.bounces = sh.Param(sh.Attrib1i, bounces, name="bounces")
        self.clamp = None if clamp is None else sh.Param(sh.Attrib1f, clamp, name="clamp")
        appearance = self.surfaces.appearance
        self.mirrors = self.surfaces.reflects
        self.straight = self.surfaces.clear and self.surfaces.straight
        self.first_row = sh.Param(sh.Attrib1f, 0, name="top_row")
        self.seed = sh.Param(sh.Attrib1u, 0, name="seed")
        self.first_sample = sh.Param(sh.Attrib1i, 0, name="first_sample")
        self.past_sample = sh.Param(sh.Attrib1i, 1, name="past_sample")
        self.features = {
            "lights": self.lights.count,
            **self.emitters.features,
            "bounces": bounces,
            "mirrors": self.mirrors,
            "glass": self.surfaces.clear,
            "highlights": self.bsdf.highlights,
            "smooth normals": layout.normals is not None,
            "materials": len(layout.materials),
            "surface programs": len(appearance.surfaces),
            "textures": len(appearance.textured),
            "cutouts": self.surfaces.accept is not None,
        }
        if self.emitters.around is None and not self.background.plain:
            self.features["sky"] = True
        if self.surfaces.lobes is not None:
            self.features["metallic-roughness"] = True
        if self.surfaces.kinds.unlit:
            self.features["unlit"] = True

    def renew_emitters(self, layout: Layout) -> bool:
        """Update how lights are chosen."""
        return self.emitters.renew(layout)

    def program(self, eyes: EyeRays | PanoramaRays, transparent: bool = False) -> Any:
        """Record the program of a band of the picture: it adds new samples to the mean of the samples before.

        With `transparent`, it also takes and gives the share of paths that a surface has scattered.
        """
        if transparent:

            @sh.program
            def covered_paths(mean: sh.Color3f, alpha: sh.Attrib1f) -> CoveredPixel:
                row, column = sh.grid_index(2)
                return CoveredPixel(*self.follow(eyes, mean, row, column, alpha), alpha)

            return covered_paths

        @sh.program
        def paths(mean: sh.Color3f) -> Pixel:
            row, column = sh.grid_index(2)
            return self.follow(eyes, mean, row, column)

        return paths

    def follow(self, eyes: EyeRays | PanoramaRays, mean: Any, row: Any, column: Any, alpha: Any = None) -> Pixel:
        """Follow all samples of a pixel of the band; `alpha` is the share of paths that were scattered, if needed."""
        row = row + self.first_row  # an exact float, so that bands make no difference
        rays = sh.Attrib1i(0)
        pixel = background_pixel(mean, rays)
        path = PathSample(self.surfaces.media, self.straight, alpha is not None)
        surface = blank(self.surfaces.interaction)
        pending, around = sh.Color3f(0, 0, 0), sh.Attrib1b(False)
        ray, eye = sh.Vector3f(0, 0, 1), sh.Point3f(0, 0, 0)
        path.number[:] = self.first_sample

        def begin() -> None:
            self.begin(eyes, path, ray, eye, row, column)

        def step() -> None:
            self.step(path, surface, pixel, ray, eye, pending, around)

        def end() -> None:
            path.number += 1
            mean[:] += (path.color - mean) / sh.Attrib1f(path.number)
            if alpha is not None:
                alpha[:] += (sh.cond(path.covered, 1.0, 0.0) - alpha) / sh.Attrib1f(path.number)

        with SH_DO():
            if self.together:
                # Rays of the same depth have more in common than those of samples that began at different times: though
                # .6 of the lanes are at work in place of .8, `cornell` takes .94 and `mixed` .95 of the time.
                begin()
                with SH_DO():
                    step()
                    SH_UNTIL(path.finished)
                end()
            else:
                with SH_IF(path.finished):
                    begin()
                step()
                with SH_IF(path.finished):
                    end()
            SH_UNTIL(path.number >= self.past_sample)
        return pixel

    def step(
        self, path: PathSample, surface: Interaction, pixel: Pixel, ray: Any, eye: Any, pending: Any, around: Any
    ) -> None:
        """Trace the next ray of a path, and prepare the one after it."""
        limit = sh.Attrib1f(FAR)
        if self.emitters.count:
            with SH_IF(path.lighting & ~path.through) if self.straight else SH_IF(path.lighting):
                self.aim(path, surface, ray, eye, limit, pending, around)
            if self.straight:
                limit[:] = sh.cond(path.through, path.rest, limit)
        any_hit = False if self.straight else path.lighting  # light that goes straight on needs the surfaces in order
        hit = self.surfaces.meet(self.intersector, lambda: (path.depth == 0) & ~path.lighting, ray, eye, limit, any_hit)
        pixel.rays[:] += sh.cond(limit > 0, 1, 0)
        with SH_IF((hit.id < 0) & (limit > 0)):
            self.leave(path, surface, ray, pending, around, limit)
        lighted = path.lighting.copy()
        path.lighting[:] = False
        if self.straight and self.emitters.count:
            self.pass_on(path, hit, ray, eye, limit, pending, lighted)
        with SH_IF(~lighted):
            with SH_IF(hit.id >= 0):
                self.arrive(path, surface, pixel, hit, ray, eye)
            with SH_ELSE():
                path.finished[:] = True
        with SH_IF(~(path.lighting | path.finished)):
            self.scatter(path, surface, ray, eye)

    def begin(self, eyes: EyeRays | PanoramaRays, path: PathSample, ray: Any, eye: Any, row: Any, column: Any) -> None:
        """Make the eye ray of the next sample, anywhere in the pixel."""
        place = (sh.Attrib1u(sh.Attrib1i(row)) << 16) | sh.Attrib1u(column)
        path.key[:] = sh.hash(place, self.seed)
        path.order[:] = reversed_bits(sh.Attrib1u(path.number))
        words = [word for pair in range(0, EYE, 2) for word in sobol_pair(path.order, sh.hash(path.key, pair))]
        across, down, *lens = map(sh.unit_float, words)
        ray[:], eye[:] = eyes(row + (down - 0.5), column + (across - 0.5), lens)
        path.color[:] = sh.Color3f(0, 0, 0)
        path.throughput[:] = sh.Color3f(1, 1, 1)
        path.density[:] = 0
        path.depth[:] = 0
        path.finished[:] = False
        if path.covered is not None:
            path.covered[:] = False
        if self.straight:
            path.way[:] = 0
        self.surfaces.begin(path.ray_bodies, self.intersector, eye)

    def pass_on(
        self, path: PathSample, hit: RayHit, ray: Any, eye: Any, limit: Any, pending: Any, lighted: Any
    ) -> None:
        """Send a ray to a light straight on through the clear surface that it has met."""
        path.through[:] = False
        with SH_IF(lighted & (hit.id >= 0)):
            pending *= self.surfaces.passed(path.shadow, hit, ray, eye, straight=True)
            path.through[:] = largest(abs(pending)) > 0
            path.lighting[:] = path.through
            path.rest[:] = limit - hit.l
            eye[:] = self.surfaces.behind(hit, ray, eye)

    def aim(
        self, path: PathSample, surface: Interaction, ray: Any, eye: Any, limit: Any, pending: Any, around: Any
    ) -> None:
        """Make the ray to a light, with `limit` 0 where the light could not be seen."""
        aim = self.emitters.aim(surface, lambda k: path.words(LIGHTS + k))
        value, density = self.bsdf.evaluate(surface, aim.ray)
        share = sh.cond(aim.density > 0, self.aimed_share(aim.density, density), 1.0)
        pending[:] = path.throughput * value * aim.incoming * share
        ray[:] = aim.ray
        eye[:] = surface.inter
        limit[:] = sh.cond(largest(abs(pending)) > 0, aim.limit, 0.0)  # a light may be negative
        around[:] = aim.around
        self.surfaces.take(path.shadow, path.ray_bodies)

    def leave(self, path: PathSample, surface: Interaction, ray: Any, pending: Any, around: Any, limit: Any) -> None:
        """Add the light of a ray that has missed everything."""
        if path.shadow is not None and self.emitters.count:
            assert self.surfaces.media is not None
            pending *= self.surfaces.media.kept_to_light(path.shadow, limit)
        brought = sh.Color3f(path.throughput)
        if path.covered is not None:
            brought[:] = sh.cond(path.covered, brought, 0.0)
        of_light = path.lighting
        if self.emitters.around is None:
            # A background is seen by the eye, directly or in mirrors, and lights nothing.
            if self.background.plain:
                brought *= sh.cond(path.density > 0, sh.Color3f(0, 0, 0), self.background.color)
                path.color += self.clamped(path, sh.cond(of_light, pending, brought))
                return
            with SH_IF(of_light):
                path.color += self.clamped(path, pending)
            with SH_ELSE(), SH_IF(~(path.density > 0)):
                path.color += self.clamped(path, brought * self.background.radiance(ray))
            return
        with SH_IF(path.density > 0):
            other = path.aimed if self.straight else self.density_around(ray, surface)
            brought *= self.met_share(path.density, other)
        brought[:] = sh.cond(of_light, pending, brought)
        with SH_IF(~of_light | around):
            brought *= self.emitters.around.radiance(ray)
        path.color += self.clamped(path, brought)

    def clamped(self, path: PathSample, light: Any) -> Any:
        """Return the light that a sample brings, at most as bright as `clamp` if it was scattered more than once."""
        if self.clamp is None:
            return light
        scattered = path.depth + sh.cond(path.lighting, 1, 0)
        share = sh.min(self.clamp / sh.max(largest(abs(light)), 2.0**-60), 1.0)
        return sh.cond(scattered > 1, share, 1.0) * light

    def density_around(self, ray: Any, surface: Interaction) -> Any:
        """Return the density with which a surface chooses a direction to the environment."""
        assert self.emitters.around is not None
        return self.emitters.share_around * self.emitters.around.density_at(ray, surface)

    def arrive(self, path: PathSample, surface: Interaction, pixel: Pixel, hit: RayHit, ray: Any, eye: Any) -> None:
        """Add the light of the surface that was hit, and prepare the next ray."""
        emission = sh.Color3f(0, 0, 0) if self.surfaces.glows else None
        reflectivity = self.surfaces.arrive(hit, ray, eye, surface, emission)
        if path.ray_bodies is not None:
            path.throughput *= self.surfaces.reach(path.ray_bodies, hit, surface)
        with SH_IF(self.is_first(path)):
            pixel.note(hit, surface, self.surfaces)
        if self.straight:
            path.way += hit.l
        if emission is not None:
            with SH_IF(largest(abs(emission)) > 0):
                way = path.way if self.straight else hit.l
                other = self.emitters.density_of(hit, ray, surface.face, way)
                share = sh.cond(path.density > 0, self.met_share(path.density, other), 1.0)
                if self.surfaces.kinds.unlit:  # it is no light
                    share = sh.cond((path.density > 0) & (self.surfaces.glow_at(hit).w < 0), 0.0, share)
                path.color += self.clamped(path, path.throughput * emission * share)
        path.finished[:] = path.depth >= self.bounces
        if self.mirrors:
            chance = largest(reflectivity) if self.surfaces.tinted else reflectivity
            path.mirror[:] = path.random(0) < chance
            if self.surfaces.tinted:
                self.tint(path, reflectivity, chance)
        if self.surfaces.clear:
            path.clear[:] = path.random(4) < self.clear_chance(surface)
            if self.surfaces.kinds.thin:
                self.tint_clear(path, surface)
        if self.straight:
            path.goes_on[:] = path.clear & (surface.ior == 1)
            path.finished &= ~path.goes_on
        if path.covered is not None:
            path.covered |= ~path.goes_on if self.straight else True
        if self.emitters.count:
            path.lighting[:] = ~(path.finished | path.mirror | path.clear)

    def tint(self, path: PathSample, reflectivity: Any, chance: Any) -> None:
        """Weigh a path by the colour of a mirror that is taken by `chance`, or by the colour of what that leaves."""
        rest = (1 - reflectivity) / sh.max(1 - chance, 2.0**-24)
        path.throughput *= sh.cond(path.mirror, reflectivity / sh.max(chance, 2.0**-24), rest)

    def clear_chance(self, surface: Interaction) -> Any:
        """Return the probability with which the clear share of a surface is taken."""
        if not self.surfaces.kinds.thin:
            return surface.transmission
        thin = sh.cond(surface.is_layered, surface.straight, 0.0)
        return surface.transmission + (1 - surface.transmission) * thin

    def tint_clear(self, path: PathSample, surface: Interaction) -> None:
        """Weigh a path by the colour of a thin wall that it goes through, or by the probability that it does not."""
        chance, opaque = self.clear_chance(surface), 1 - surface.transmission
        thin = surface.is_layered & (surface.straight > 0)
        clear = surface.transmission + opaque * sh.cond(thin, surface.thin, sh.Color3f(0, 0, 0))
        clear, rest = clear / sh.max(chance, 2.0**-24), opaque / sh.max(1 - chance, 2.0**-24)
        path.throughput *= sh.cond(thin, sh.cond(path.clear, clear, sh.Color3f(rest)), sh.Color3f(1, 1, 1))

    def is_first(self, path: PathSample) -> Any:
        """Return whether a hit is what the eye sees in the first sample, which the layers show."""
        if self.straight:
            return (path.depth == 0) & (path.number == self.first_sample) & (path.way == 0)
        return (path.depth == 0) & (path.number == self.first_sample)

    def scatter(self, path: PathSample, surface: Interaction, ray: Any, eye: Any) -> None:
        """Go on in a direction that the surface chooses, or end."""
        with SH_IF(~(path.mirror | path.clear)):
            self.diffuse(path, surface, ray, eye)
        if self.mirrors or self.surfaces.clear:
            with SH_ELSE():
                density = path.density.copy() if self.straight else None
                ray[:] = mirrored(surface)
                eye[:] = surface.inter
                path.density[:] = 0
                if self.surfaces.clear:
                    self.refract(path, surface, ray, eye)
                if density is not None:
                    path.density[:] = sh.cond(path.goes_on, density, 0.0)
        with SH_IF(path.depth >= ROULETTE):
            staying = sh.min(largest(path.throughput), 1.0)
            path.throughput /= sh.max(staying, 2.0**-60)
            path.finished |= path.random(6) >= staying
        if not self.straight:
            path.depth += 1
            return
        with SH_IF(path.goes_on):
            path.key[:] = sh.hash(path.key, STRAIGHT)
        with SH_ELSE():
            path.way[:] = 0
            path.depth += 1

    def refract(self, path: PathSample, surface: Interaction, ray: Any, eye: Any) -> None:
        """Make the mirrored ray of a clear surface the refracted one, by the share that Fresnel's equations leave."""
        facet: Any = surface
        if lobes := self.surfaces.lobes if self.surfaces.kinds.bodies else None:
            rough = path.clear & surface.is_body & (surface.coefficients.z >= SMOOTHEST) & (surface.ior != 1)
            is_rough, crosses = sh.Attrib1b(rough), sh.Attrib1b(False)
            facet = lobes.facet(surface, is_rough, (path.random(2), path.random(3)))
            ray[:] = sh.cond(is_rough, mirrored(facet), ray)
        share, bent = refracted(facet)
        with SH_IF(path.clear & (path.random(5) >= share)):
            ray[:] = bent
            eye[:] = surface.beyond
            if path.ray_bodies is not None:
                path.ray_bodies.cross()
            if lobes is not None:
                crosses[:] = True
                path.throughput *= body_tint(surface)
        if lobes is not None:
            with SH_IF(is_rough):
                leaves = (sh.dot(surface.normal, ray) < 0) == crosses
                path.throughput *= sh.cond(leaves, lobes.unmasked(surface, ray), 0.0)
                path.finished |= ~(largest(path.throughput) > 0)

    def diffuse(self, path: PathSample, surface: Interaction, ray: Any, eye: Any) -> None:
        """Go on along a lobe, into which the whole of the path's weight goes."""
        if self.surfaces.lobes is None:
            self.sample_phong(path, surface, ray, eye)
        else:
            with SH_IF(surface.is_layered) if self.surfaces.mixed else nullcontext():
                self.sample_layers(path, surface, ray, eye)
            if self.surfaces.mixed:
                with SH_ELSE():
                    self.sample_phong(path, surface, ray, eye)
        if self.straight and self.emitters.around is not None:
            path.aimed[:] = self.density_around(ray, surface)

    def sample_layers(self, path: PathSample, surface: Interaction, ray: Any, eye: Any) -> None:
        """Go on along a lobe of a `MetallicRoughness`."""
        assert self.surfaces.lobes is not None
        scattering = self.surfaces.lobes.scatter(surface, [path.random(k) for k in (1, 2, 3)], mirrored(surface))
        ray[:] = scattering.ray
        eye[:] = surface.inter
        if self.surfaces.kinds.thin:
            eye[:] = sh.cond(scattering.through, surface.beyond, surface.inter)
        path.finished[:] = ~(largest(scattering.weight) > 0)
        path.throughput *= scattering.weight
        path.density[:] = scattering.density

    def sample_phong(self, path: PathSample, surface: Interaction, ray: Any, eye: Any) -> None:
        """Go on along a lobe of Phong's model."""
        ray[:] = self.bsdf.sample(surface, *(path.random(k) for k in (1, 2, 3)))
        eye[:] = surface.inter
        value, density = self.bsdf.evaluate(surface, ray)
        path.finished[:] = ~((largest(value) > 0) & (density > 0))
        path.throughput *= value / sh.max(density, 2.0**-100)
        path.density[:] = density
