"""The numbers of the `MetallicRoughness` of a scene: their tables, and the variables that textures and programs change.

Stage: kernel. `kernels.microfacets` computes the lobes from them.
"""

from __future__ import annotations

from typing import Any

import shpy as sh
from raytracer.kernels.interactions import Interaction
from raytracer.kernels.kinds import MaterialKinds
from raytracer.scene.layout import Layout


class LayerTables:
    """The tables of a scene with a `MetallicRoughness`: of a sheen and of an anisotropy only where there is one."""

    def __init__(self, layout: Layout, kinds: MaterialKinds) -> None:
        self.kinds = kinds
        self.layers = sh.Table(layout.layers, sh.Attrib4f, "layers")
        if kinds.sheen:
            self.sheens = sh.Table(layout.sheens, sh.Attrib4f, "sheens")
        if kinds.brushed:
            self.brushes = sh.Table(layout.brushes, sh.Attrib2f, "brushes")

    def repaint(self, layout: Layout) -> None:
        """Update the tables from a layout that fits the kernel."""
        self.layers.update(layout.layers)
        if self.kinds.sheen:
            self.sheens.update(layout.sheens)
        if self.kinds.brushed:
            self.brushes.update(layout.brushes)

    def stack(self, surface: Interaction, number: Any) -> None:
        """Set the numbers of a `MetallicRoughness` that other materials have not."""
        row, upper = self.layers[2 * number], self.layers[2 * number + 1]
        surface.tint[:] = row.rgb
        surface.index[:] = row.a
        surface.coat[:] = upper.xyz
        surface.is_layered[:] = upper.w > 0
        if self.kinds.sheen:
            fibres = self.sheens[number]
            surface.sheen[:] = fibres.rgb
            surface.fuzz[:] = sh.Attrib3f(fibres.a, 1, 0)
        if self.kinds.brushed:
            strength, angle = self.brushes[number]
            surface.anisotropy[:], surface.rotation[:] = strength, angle
            surface.brush[:] = sh.Color3f(1, 0.5, 1)
        if self.kinds.multiscatter:
            surface.gain[:] = sh.Color3f(sh.cond(upper.w > 1, 1.0, 0.0))

    def variables(self, surface: Interaction) -> dict[str, Any]:
        """Return the variables of what a `MetallicRoughness` has, by the names of textures and programs."""
        coat, blur, thin = (sh.Attrib1f(surface.coat[k]) for k in range(3))
        variables = {"index": surface.index, "tint": surface.tint}
        variables |= {"clearcoat": coat, "clearcoat_roughness": blur, "thin": thin}
        if self.kinds.sheen:
            fuzz = sh.Attrib1f(surface.fuzz.x)
            variables |= {"sheen": surface.sheen, "sheen_roughness": fuzz}
        if self.kinds.brushed:
            strength, angle = sh.Attrib1f(surface.anisotropy), sh.Attrib1f(surface.rotation)
            variables |= {"anisotropy": strength, "anisotropy_rotation": angle, "brush": surface.brush}
        return variables

    def store(self, surface: Interaction, variables: dict[str, Any]) -> None:
        """Set the numbers of a surface to the variables."""
        surface.coat[:] = sh.Attrib3f(*(variables[name] for name in ("clearcoat", "clearcoat_roughness", "thin")))
        if self.kinds.sheen:
            surface.fuzz.x = variables["sheen_roughness"]
        if self.kinds.brushed:
            surface.anisotropy[:], surface.rotation[:] = variables["anisotropy"], variables["anisotropy_rotation"]
