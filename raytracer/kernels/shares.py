"""The shares of light that a surface mirrors and scatters, as Whitted's tracers follow them.

Stage: kernel. In Phong's model the mirror image takes its share from the surface's own colour (Christen 2005, equation
5.1). A `MetallicRoughness` mirrors a part of the albedo of its upper layers (`Microfacets.prepare`), and its own colour
has the rest. Where shares are grey, they are numbers.
"""

from __future__ import annotations

from typing import Any, Final

import shpy as sh
from raytracer.kernels.directions import largest
from raytracer.kernels.interactions import Interaction
from raytracer.kernels.surfaces import SurfaceTables

MIN_CONTRIBUTION: Final = 2.0**-17
"""The share of the picture, in its brightest channel, below which a ray is not followed: 1/512 of a step of 8 bits."""
UNSEEN: Final = 2.0**-9
"""The same in scenes with a `MetallicRoughness`: each of these mirrors a little, and most of them 0.04."""


@sh.struct
class ColoredShares:
    """The product of reflection coefficients that have colours, and the last of them: `Light.rn` in such scenes."""

    x: sh.Color3f
    y: sh.Color3f


class MirrorShares:
    """The shares of a scene's surfaces; `tinted` if some have colours."""

    def __init__(self, surfaces: SurfaceTables) -> None:
        self.layered, self.mixed = surfaces.lobes is not None, surfaces.mixed
        self.tinted, self.reflects = surfaces.tinted or self.layered, surfaces.reflects or self.layered
        self.thin = surfaces.kinds.thin

    def first(self) -> Any:
        """Return `Light.rn` of an eye ray."""
        return ColoredShares(sh.Color3f(1, 1, 1), sh.Color3f(0, 0, 0)) if self.tinted else sh.Attrib2f(1, 0)

    def ambient(self, surface: Interaction) -> Any:
        """Return the colour of a surface in ambient light."""
        return self._chosen(surface, surface.spread, surface.color) if self.layered else surface.color

    def mirror(self, surface: Interaction, reflectivity: Any) -> Any:
        """Return the share of the mirrored ray, where Phong's model has this reflectivity."""
        return self._chosen(surface, surface.mirror, sh.Color3f(reflectivity)) if self.layered else reflectivity

    def clear(self, surface: Interaction, opaque: Any) -> Any:
        """Return the share that goes through a thin wall, of the `opaque` share of a surface."""
        return sh.cond(surface.is_layered, opaque * surface.thin, 0.0)

    def own(self, surface: Interaction, opaque: Any, reflectivity: Any) -> Any:
        """Return the share of a surface's own colour, of which the `opaque` share is not clear."""
        if not self.layered:
            return opaque * (1 - reflectivity)
        return self._chosen(surface, sh.Color3f(opaque), sh.Color3f(opaque * (1 - reflectivity)))

    def leave(self, surface: Interaction, light: Any, pixel: Any) -> None:
        """Take the mirror image's share from a surface's own colour."""
        if not self.layered:
            pixel.color[:] -= light.rn.x * light.scolor
        elif self.mixed:
            pixel.color[:] -= sh.cond(surface.is_layered, sh.Color3f(0, 0, 0), light.rn.x * light.scolor)

    def _chosen(self, surface: Interaction, layered: Any, phong: Any) -> Any:
        """Return the value for the model of the surface's material."""
        return sh.cond(surface.is_layered, layered, phong) if self.mixed else layered


class LeastShare:
    """The `share` of the picture below which no ray is followed: a param, if it is another than MIN_CONTRIBUTION."""

    def __init__(self, share: float, shares: MirrorShares) -> None:
        self.shares = shares
        self.cuts = share != MIN_CONTRIBUTION
        self.share: Any = UNSEEN if shares.layered else share
        if self.cuts:
            self.share = sh.Param(sh.Attrib1f, share, name="min_contribution")

    def ends(self, light: Any) -> Any:
        """Return whether no mirrored ray follows; by default scenes of Phong's model without glass follow all."""
        if self.shares.tinted:
            share = largest(light.rn.x)
            return (light.r == 0) | ~(share > (self.share if self.cuts or self.shares.layered else 0))
        if self.cuts:
            return (light.r == 0) | (light.rn.y == 0) | ~(light.rn.x > self.share)
        return (light.r == 0) | (light.rn.y == 0)

    def counts(self, share: Any, part: Any) -> Any:
        """Return whether a part of a share of the picture is followed."""
        if self.shares.tinted:
            return largest(share * part) > self.share
        return largest(share) * part > self.share
