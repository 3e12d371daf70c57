"""The lobes of a `MetallicRoughness`: a coat, a sheen, a rough mirror, and matt light; as functions and densities.

Stage: kernel. Microfacets have the distribution GGX (Walter and others 2007, equation 33) with Smith's masking, which
is height-correlated (Heitz 2014, equation 99), and Schlick's approximation of Fresnel's equations (1994). Directions
are mirrored at visible normals, drawn on a spherical cap (Dupuy and Benyoub 2023). The matt lobe is lit by the light
that its upper layer lets in and out, (1 - E(view)) (1 - E(light)) / (1 - mean E), so that a white one loses nothing
(Kelemen and Szirmay-Kalos 2001, equations 5 to 8). Light crosses a coat twice, too. What lies below a sheen of the
colour c has the factor min(1 - max(c) E(view), 1 - max(c) E(light)) of KHR_materials_sheen. All of it is reciprocal,
but where `lift` has raised the view, and where `multiscatter` scales the rough mirror.

Lobes of a roughness below `SMOOTHEST` are mirrors in path tracing, as binary32 does not resolve them. A thin wall as
smooth as that lets light go straight on, and is no lobe: a tracer takes it with the probability `straight`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import Any, NamedTuple

import shpy as sh
from raytracer.appearance.albedo import ACROSS, FINEST, SMOOTHEST, albedo_table, sheen_table
from raytracer.kernels.anisotropy import MARGIN, brushed_lobe, masking_root, widen
from raytracer.kernels.directions import around, frame, largest
from raytracer.kernels.kinds import MaterialKinds
from shpy import SH_ELSE, SH_IF

COAT = 0.04
"""The share that a coat mirrors at normal incidence, as its refractive index is 1.5."""
LOWEST = 2.0**-7
"""The least cosine of the view to the normal: an interpolated normal may point away from the viewer."""


class Scattering(NamedTuple):
    """A direction, the factor of the path's light that goes there, and its density; the last tells if it goes through.

    The density is 0 where no light could be aimed at in place of the direction.
    """

    ray: Any
    weight: Any
    density: Any
    through: Any


class Microfacets:
    """The lobes of the layered surfaces of a scene, of which `kinds` tells the features; see `lobe` for `binary16`.

    A mirror image has one roughness. So if `hides` is set, it leaves out a base to the extent that this has a coat.
    """

    def __init__(self, kinds: MaterialKinds, binary16: bool = False) -> None:
        self.binary16 = binary16
        self.coats, self.thin, self.hides = kinds.coats, kinds.thin, False
        self.brushed, self.multiscatter = kinds.brushed, kinds.multiscatter
        self.sheen = Sheen() if kinds.sheen else None
        self.table = sh.Table(albedo_table(), sh.Attrib2f, "albedos")

    def prepare(self, surface: Any) -> None:
        """Compute the fields of a `LayeredInteraction` that follow from the view and the surface's numbers."""
        metallic, specular, roughness = (sh.clamp(part, 0, 1) for part in surface.coefficients)
        surface.coefficients[:] = sh.Attrib3f(metallic, specular, roughness)
        surface.color[:] = sh.clamp(surface.color, 0, 1)
        index = (surface.index - 1) / (surface.index + 1)
        surface.upper[:] = specular * sh.min(index * index * surface.tint, 1.0)
        surface.upper_edge[:] = specular
        surface.f0[:] = sh.mix(surface.upper, surface.color, metallic)
        surface.f90[:] = sh.mix(specular, sh.Attrib1f(1), metallic)
        surface.seen[:] = lift(surface.view, surface.normal)
        away = sh.dot(surface.normal, surface.seen)
        if self.brushed:
            roughness = widen(surface, roughness)
        scale, mean = self.base_albedo(surface, away, roughness), self.base_mean(surface, roughness)
        glossy = sh.min(surface.f0 * scale.x + surface.f90 * scale.y, 1.0)
        gain = None
        if self.multiscatter:
            white = scale.x + scale.y
            lost = surface.gain.r * ((1 - white) / white)
            surface.gain[:] = 1 + lost * surface.f0
            glossy = sh.min(surface.gain * glossy, 1.0)
            gain = 1 + lost * surface.upper
        matt = ((1 - metallic) * surface.color) * (1 - self.upper_albedo(surface, scale, gain))
        if self.thin:
            surface.thin[:] = sh.clamp(surface.coat.z, 0, 1) * matt
            matt = matt - surface.thin
        surface.matt[:] = matt / sh.max(1 - self.upper_albedo(surface, mean), 2.0**-20)
        blunt = surface.bounds.y if self.brushed else roughness
        sharp = (1 - blunt) * (1 - blunt)
        surface.mirror[:] = sharp * glossy
        surface.spread[:] = matt + glossy - surface.mirror
        surface.chances.y = share_of(largest(glossy), largest(matt))
        opaque = largest(glossy) + largest(matt)
        if self.sheen is not None:
            opaque = self.sheen.cover(surface, away, opaque, thin=self.thin)
        if self.coats:
            opaque = self.cover(surface, away, opaque)
        if self.thin:
            chance, smooth = share_of(largest(surface.thin), opaque), roughness < SMOOTHEST
            surface.straight[:] = sh.cond(smooth, chance, 0.0)
            surface.chances.z = sh.cond(smooth, 0.0, chance)

    def cover(self, surface: Any, away: Any, opaque: Any) -> Any:
        """Put the coat over a surface whose lobes send out about the share `opaque`; return that of both."""
        coat, blur = sh.clamp(surface.coat.x, 0, 1), sh.clamp(surface.coat.y, 0, 1)
        surface.coat[:] = sh.Attrib3f(coat, blur, surface.coat.z)
        covered = self.coat_albedo(surface, away)
        through = 1 - covered
        if self.thin:
            surface.thin *= through * through
        surface.through[:] = through
        surface.matt *= through
        below = through * through * opaque
        surface.chances.x = share_of(covered, below)
        if self.hides:
            hidden = surface.coat.x * surface.mirror
            surface.mirror -= hidden
            surface.spread += hidden
        sharp = (1 - blur) * (1 - blur)
        surface.mirror[:] = through * through * surface.mirror + sharp * covered
        surface.spread[:] = through * through * surface.spread + (1 - sharp) * covered
        return covered + below

    def blurred_shares(self, surface: Any) -> tuple[Any, Any, Any]:
        """Return the shares of `spread` that the base and the coat mirror, and the roughness of the mirror image.

        The coat's share is None where nothing has one. See `hides`.
        """
        roughness, away = surface.coefficients.z, sh.dot(surface.normal, surface.seen)
        if self.brushed:
            roughness = surface.bounds.y
        scale, sharp = self.base_albedo(surface, away, roughness), (1 - roughness) * (1 - roughness)
        glossy = sh.min(surface.f0 * scale.x + surface.f90 * scale.y, 1.0)
        if self.multiscatter:
            glossy = sh.min(surface.gain * glossy, 1.0)
        if self.sheen is not None:
            glossy = glossy * surface.fuzz.y
        if not self.coats:
            return (1 - sharp) * glossy, None, roughness
        glossy = glossy * (surface.through * surface.through)
        sharp = (1 - surface.coat.x) * sharp
        blur, covered = surface.coat.y, self.coat_albedo(surface, away)
        clear = (1 - blur) * (1 - blur) * covered
        shown = largest(sharp * glossy)
        seen = (shown * roughness + clear * blur) / sh.max(shown + clear, 2.0**-20)
        return (1 - sharp) * glossy, covered - clear, seen

    def upper_albedo(self, surface: Any, scale: Any, gain: Any = None) -> Any:
        """Return the albedo of the clear layer over the matt lobe, for the integrals `scale`, times a gain."""
        if gain is not None:
            return sh.min(gain * (surface.upper * scale.x + surface.upper_edge * scale.y), 1.0)
        return sh.min(surface.upper * scale.x + surface.upper_edge * scale.y, 1.0)

    def coat_albedo(self, surface: Any, cosine: Any) -> Any:
        """Return the share of the light at an angle that the coat mirrors."""
        scale = self.albedo(cosine, surface.coat.y)
        return surface.coat.x * (COAT * scale.x + scale.y)

    def base_albedo(self, surface: Any, cosine: Any, roughness: Any) -> Any:
        """Return the integrals a - b and b of the base: at least those of an anisotropic one, and a at most 1."""
        if not self.brushed:
            return self.albedo(cosine, roughness)
        scale = sh.max(*(self.albedo(cosine, bound) for bound in surface.bounds))
        edge = scale.y + sh.cond(surface.anisotropy > 0, MARGIN, 0.0)
        return sh.Attrib2f(sh.min(scale.x, 1 - edge), edge)

    def base_mean(self, surface: Any, roughness: Any) -> Any:
        """Return the means of the integrals of the base: at most as large as those of `base_albedo`."""
        if not self.brushed:
            return self.mean_albedo(roughness)
        return sh.max(*(self.mean_albedo(bound) for bound in surface.bounds))

    def albedo(self, cosine: Any, roughness: Any) -> Any:
        """Interpolate the integrals a - b and b (`appearance.albedo`)."""
        row, down = self._row(roughness)
        place = sh.sqrt(sh.clamp(cosine, 0, 1)) * (ACROSS - 1)
        column = sh.min(sh.Attrib1i(sh.floor(place)), ACROSS - 2)
        part = place - sh.Attrib1f(column)
        upper, lower = (sh.mix(self.table[row + k, column], self.table[row + k, column + 1], part) for k in (0, 1))
        return sh.mix(upper, lower, down)

    def mean_albedo(self, roughness: Any) -> Any:
        """Interpolate the means of a - b and b over light from everywhere."""
        row, down = self._row(roughness)
        return sh.mix(self.table[row, ACROSS], self.table[row + 1, ACROSS], down)

    def _row(self, roughness: Any) -> tuple[Any, Any]:
        """Return a row of the table and the part of the way to the next; all below row 1 are mirrors, row 0."""
        place = sh.cond(roughness < SMOOTHEST, 0.0, roughness * (ACROSS - 1))
        row = sh.min(sh.Attrib1i(sh.floor(place)), ACROSS - 2)
        return row, place - sh.Attrib1f(row)

    def evaluate(self, surface: Any, light: Any, least: float = 0.0) -> tuple[Any, Any]:
        """Return the radiance toward the viewer for radiance 1 a steradian about `light`, and the density of `scatter`.

        The radiance is 0 for a light behind the surface or its triangle. With `least` at 0 mirrors are left out; else
        lobes that are smoother than that roughness are as rough as that.
        """
        normal, view, roughness = surface.normal, surface.seen, surface.coefficients.z
        cosine, away = sh.max(sh.dot(normal, light), 0.0), sh.dot(normal, view)
        half = light + view
        half = half / sh.max(sh.length(half), 2.0**-20)
        grazing = fifth(1 - sh.saturate(sh.dot(view, half)))
        if self.brushed:
            glossy, glossy_density = brushed_lobe(surface, half, light, (cosine, away, roughness), least)
        else:
            glossy, glossy_density = lobe(normal, half, cosine, away, roughness, least, self.binary16)
        glossy = glossy * (surface.f0 + (surface.f90 - surface.f0) * grazing)
        if self.multiscatter:
            glossy = surface.gain * glossy
        lambert = cosine * (1 / pi)
        matt = lambert * (1 - self.upper_albedo(surface, self.base_albedo(surface, cosine, roughness))) * surface.matt
        density = lambert + surface.chances.y * (glossy_density - lambert)
        if self.sheen is not None:
            below, fuzz = self.sheen.evaluate(surface, half, cosine, away)
            glossy, matt = below * glossy + fuzz, below * matt
            density = density + surface.fuzz.z * (lambert - density)
        value = glossy + matt
        if self.coats:
            coat, coat_density = lobe(normal, half, cosine, away, surface.coat.y, least, self.binary16)
            through = 1 - self.coat_albedo(surface, cosine)
            value = through * (surface.through * glossy + matt)
            value = value + surface.coat.x * (COAT + (1 - COAT) * grazing) * coat
            density = density + surface.chances.x * (coat_density - density)
        if self.thin:
            density = density * (1 - surface.chances.z)
        return sh.cond(sh.dot(surface.face, light) > 0, value, 0.0), density

    def scatter(self, surface: Any, numbers: Sequence[Any], mirrored: Any) -> Scattering:
        """Sample a direction by three numbers in [0, 1); `mirrored` is that of a perfect mirror."""
        chances, normal, view = surface.chances, surface.normal, surface.seen
        which, turn, height = sh.Attrib1f(numbers[0]), *numbers[1:]
        likely, roughness = sh.Attrib1f(1), sh.Attrib1f(surface.coefficients.z)
        is_coat, is_thin = sh.Attrib1b(False), sh.Attrib1b(False)
        if self.thin:
            is_thin[:] = which < chances.z
            likely[:] = sh.cond(is_thin, chances.z, 1 - chances.z)
            which[:] = (which - chances.z) / sh.max(1 - chances.z, 2.0**-24)
        if self.coats:
            is_coat[:] = ~is_thin & (which < chances.x)
            roughness[:] = sh.cond(is_coat, surface.coat.y, roughness)
            likely *= sh.cond(is_thin, 1.0, sh.cond(is_coat, chances.x, 1 - chances.x))
            which[:] = (which - chances.x) / sh.max(1 - chances.x, 2.0**-24)
        if self.sheen is not None:
            fuzzy = surface.fuzz.z
            is_fibre = sh.Attrib1b(~(is_coat | is_thin) & (which < fuzzy))
            likely *= sh.cond(is_coat | is_thin, 1.0, 1 - fuzzy)
            which[:] = sh.cond(is_fibre, 1.0, (which - fuzzy) / sh.max(1 - fuzzy, 2.0**-24))
        is_glossy = sh.Attrib1b(is_coat | is_thin | (which < chances.y))
        is_mirror = sh.Attrib1b(is_glossy & (roughness < SMOOTHEST))
        ray = sh.Vector3f(mirrored)
        weight, density = sh.Color3f(0, 0, 0), sh.Attrib1f(0)
        with SH_IF(is_mirror):
            likely *= sh.cond(is_coat, 1.0, chances.y)
            weight[:] = self.mirror_share(surface, is_coat) / sh.max(likely, 2.0**-24)
        with SH_ELSE():
            with SH_IF(is_glossy):
                along = sh.cond(is_coat, roughness, surface.bounds.y) if self.brushed else roughness
                half = visible_normal(surface, roughness, along, (turn, height))
                ray[:] = (2 * sh.dot(view, half)) * half - view
            with SH_ELSE():
                ray[:] = around(normal, sh.sqrt(1 - height), turn)
            value, likely_there = self.evaluate(surface, ray)
            density[:] = likely_there
            weight[:] = sh.cond(likely_there > 0, value / sh.max(likely_there, 2.0**-100), 0.0)
        if self.thin:
            with SH_IF(is_thin):
                rise = sh.dot(ray, normal)
                ray[:] = ray - (2 * rise) * normal
                ray[:] = ray - (2 * sh.max(sh.dot(ray, surface.face), 0.0)) * surface.face
                weight[:] = sh.cond(rise > 0, surface.thin / sh.max(likely, 2.0**-24), 0.0)
                density[:] = 0
        return Scattering(ray, weight, density, is_thin)

    def mirror_share(self, surface: Any, is_coat: Any) -> Any:
        """Return the share of the light that the coat, or the base below it, mirrors as a perfect mirror."""
        grazing = fifth(1 - sh.saturate(sh.dot(surface.normal, surface.seen)))
        share = surface.f0 + (surface.f90 - surface.f0) * grazing
        if self.sheen is not None:
            share = share * surface.fuzz.y
        if not self.coats:
            return share
        coat = surface.coat.x * (COAT + (1 - COAT) * grazing)
        return sh.cond(is_coat, sh.Color3f(coat), surface.through * surface.through * share)

    def facet(self, surface: Any, rough: Any, numbers: tuple[Any, Any]) -> Facet:
        """Return the facet of a body by two numbers in [0, 1): the surface itself unless it is `rough`."""
        view, normal = sh.Vector3f(surface.view), sh.Normal3f(surface.normal)
        with SH_IF(rough):
            roughness = surface.coefficients.z
            along = surface.bounds.y if self.brushed else roughness
            view[:] = surface.seen
            normal[:] = visible_normal(surface, roughness, along, numbers)
        return Facet(view, normal, surface.face, surface.outside, surface.ior)

    def unmasked(self, surface: Any, ray: Any) -> Any:
        """Return the share of what a facet sends along a ray, to either side, that other facets do not stop."""
        roughness = surface.coefficients.z
        axes = (*frame(surface.normal), surface.normal)
        along = across = roughness * roughness
        if self.brushed:
            axes = surface.tangent, sh.cross(surface.normal, surface.tangent), surface.normal
            along = surface.bounds.y * surface.bounds.y
        away, cosine = sh.dot(surface.normal, surface.seen), abs(sh.dot(surface.normal, ray))
        out, into = (masking_root(axes, direction, along, across) for direction in (surface.seen, ray))
        return cosine * (away + out) / sh.max(cosine * out + away * into, 2.0**-40)


class Facet(NamedTuple):
    """A facet of the surface of a body, by the names of an interaction."""

    view: Any
    normal: Any
    face: Any
    outside: Any
    ior: Any


def body_tint(surface: Any) -> Any:
    """Return the colour that tints what crosses the surface of a body; white for other surfaces."""
    return sh.cond(surface.is_body, surface.color, sh.Color3f(1, 1, 1))


class Sheen:
    """The lobe of fibres (`appearance.albedo`).

    It is divided by its albedos at the view and at the light where they exceed 1, so that it never sends out more.
    """

    def __init__(self) -> None:
        self.table = sh.Table(sheen_table(), sh.Attrib1f, "sheen_albedos")

    def cover(self, surface: Any, away: Any, opaque: Any, *, thin: bool) -> Any:
        """Put the sheen over a surface whose lobes send out about the share `opaque`; return that of both."""
        surface.sheen[:] = sh.clamp(surface.sheen, 0, 1)
        roughness = sh.clamp(surface.fuzz.x, FINEST, 1)
        sent = sh.min(self.albedo(away, roughness), 1.0) * surface.sheen
        below = 1 - largest(sent)
        surface.mirror *= below
        surface.spread[:] = below * surface.spread + sent
        if thin:
            surface.thin *= below
        surface.fuzz[:] = sh.Attrib3f(roughness, below, share_of(largest(sent), below * opaque))
        return largest(sent) + below * opaque

    def evaluate(self, surface: Any, half: Any, cosine: Any, away: Any) -> tuple[Any, Any]:
        """Return the share of light that the base below gets and sends out, and the light of the fibres."""
        roughness = surface.fuzz.x
        from_view, from_light = (self.albedo(c, roughness) for c in (away, cosine))
        left = 1 - largest(surface.sheen) * sh.min(from_light, 1.0)
        inverse = 1 / (roughness * roughness)
        across = sh.cross(surface.normal, half)
        sine = sh.sqrt(sh.saturate(sh.dot(across, across)))
        fibres = (2 + inverse) * sh.pow(sine, inverse) * (1 / (2 * pi))
        shown = fibres * cosine / (4 * sh.max(cosine + away - cosine * away, 2.0**-20))
        shown = shown / (sh.max(from_view, 1.0) * sh.max(from_light, 1.0))
        return sh.min(surface.fuzz.y, left), shown * surface.sheen

    def albedo(self, cosine: Any, roughness: Any) -> Any:
        """Interpolate the albedo of white fibres."""
        row, down = cell_of(roughness)
        column, part = cell_of(sh.sqrt(sh.clamp(cosine, 0, 1)))
        upper, lower = (sh.mix(self.table[row + k, column], self.table[row + k, column + 1], part) for k in (0, 1))
        return sh.mix(upper, lower, down)


def cell_of(part: Any) -> tuple[Any, Any]:
    """Return a row or column of a table from 0 to 1, and the part of the way to the next."""
    place = part * (ACROSS - 1)
    cell = sh.min(sh.Attrib1i(sh.floor(place)), ACROSS - 2)
    return cell, place - sh.Attrib1f(cell)


def lobe(
    normal: Any, half: Any, cosine: Any, away: Any, roughness: Any, least: float, binary16: bool
) -> tuple[Any, Any]:
    """Return the light of white microfacets, and the density of directions that are mirrored at visible normals.

    `cosine` is that of the light and `away` that of the view to the normal. In `binary16` the square of `spread` would
    be 0.
    """
    alpha = sh.max(roughness, sh.Attrib1f(least or SMOOTHEST))
    square = alpha * alpha
    square = square * square
    across, along = sh.cross(normal, half), sh.dot(normal, half)
    spread = sh.dot(across, across) + square * along * along  # as 1 - along * along cancels in binary32
    if binary16:
        ratio = alpha * alpha / spread
        facets = sh.cond(along > 0, ratio * (ratio / pi), 0.0)
    else:
        facets = sh.cond(along > 0, square / (pi * spread * spread), 0.0)
    if not least:
        facets = sh.cond(roughness < SMOOTHEST, 0.0, facets)
    out, into = (sh.sqrt(square + (1 - square) * c * c) for c in (away, cosine))
    light = facets * cosine / (2 * sh.max(cosine * out + away * into, 2.0**-40))
    return light, facets / (2 * (away + out))


def lift(view: Any, normal: Any) -> Any:
    """Return the view, raised to the least cosine where the normal points away from the viewer."""
    away = sh.dot(view, normal)
    raised = sh.normalize(view + (LOWEST - away) * normal)
    return sh.cond(away < LOWEST, raised, view)


def visible_normal(surface: Any, roughness: Any, along: Any, numbers: tuple[Any, Any]) -> Any:
    """Draw a microfacet's normal that the view sees, by two numbers in [0, 1) (Dupuy and Benyoub 2023, listing 1).

    `along` is the roughness along the tangent; without an anisotropy it is `roughness`.
    """
    normal, view, (turn, height) = surface.normal, surface.seen, numbers
    alpha = roughness * roughness
    across, beside = frame(normal) if along is roughness else (surface.tangent, sh.cross(normal, surface.tangent))
    long = alpha if along is roughness else along * along
    x, y, z = (sh.dot(view, axis) for axis in (across, beside, normal))
    stretched = sh.normalize(sh.Vector3f(long * x, alpha * y, z))
    level = (1 - height) * (1 + stretched.z) - stretched.z
    radius = sh.sqrt(sh.saturate(1 - level * level))
    angle = (2 * pi) * turn
    x, y = long * (radius * sh.cos(angle) + stretched.x), alpha * (radius * sh.sin(angle) + stretched.y)
    return sh.normalize(x * across + y * beside + sh.max(level + stretched.z, 2.0**-20) * normal)


def fifth(x: Any) -> Any:
    """Return the fifth power."""
    square = x * x
    return square * square * x


def share_of(part: Any, rest: Any) -> Any:
    """Return the share of `part` in the sum of both; 0 where both are 0."""
    return part / sh.max(part + rest, 2.0**-40)
