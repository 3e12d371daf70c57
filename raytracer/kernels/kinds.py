"""The features of a kernel that the numbers of a scene's materials decide.

Stage: kernel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raytracer.accel.space import Rows
from raytracer.appearance.unlit import Unlit
from raytracer.kernels.appearance import Appearance
from raytracer.scene.layout import Layout


class MaterialKinds(NamedTuple):
    """The features of a kernel that the numbers of materials decide: True for those that it has code for.

    `glows`: emission; `highlights`: the glossy lobe; `clear`: glass; `black`: highlights of surfaces that send no other
    light in some channel; `dark`: surfaces that need no shadow rays; `reflects`: mirrors; `media`: bodies that refract
    or absorb; `straight`: clear surfaces that let light go straight on. `tinted`: mirrors with a colour. `layered`: a
    `MetallicRoughness`, with `coats`, or as `thin` walls; `mixed`: other materials beside it. `unlit`: an `Unlit`.
    `sheen`: a `MetallicRoughness` with one. `brushed`: one with an anisotropy. `multiscatter`: one whose microfacets
    lose no light. `bodies`: one that bounds a body.
    """

    glows: bool
    highlights: bool
    clear: bool
    black: bool
    dark: bool
    reflects: bool
    media: bool
    straight: bool
    tinted: bool
    layered: bool
    coats: bool
    thin: bool
    mixed: bool
    unlit: bool
    sheen: bool
    brushed: bool
    multiscatter: bool
    bodies: bool

    @property
    def detailed(self) -> bool:
        """True if interactions have the fields of `DetailedInteraction`."""
        return self.brushed or self.multiscatter or self.bodies

    @classmethod
    def of(cls, layout: Layout, appearance: Appearance) -> MaterialKinds:
        """Return the kinds of a layout, whose materials have this appearance."""
        layers, gives = layout.layers, appearance.gives
        layered = layers[1::2, 3] > 0
        lobes = layout.material_rows[1::2, :2][~layered]
        clear = np.array(appearance.clears)
        indices, absorptions = layout.glass[::2, 1][clear], layout.glass[1::2][clear]
        return cls(
            glows=bool(glow_rows(layout, appearance)[:, 3].any()) or "emission" in gives,
            highlights=bool((lobes[:, 1] > 0).any()) or ("specular" in gives and not layered.all()),
            clear=bool(clear.any()),
            black=bool(appearance) or is_black(layout),
            dark=bool((lobes == 0).all(axis=1).any()) and not appearance.shades,
            reflects=bool((layout.material_rows[::2, 3] > 0).any()) or "reflectivity" in gives,
            media=bool((indices != 1).any() or absorptions.any() or (clear.any() and "ior" in gives)),
            straight=bool((indices == 1).any() or (clear.any() and "ior" in gives)),
            tinted=bool(np.ptp(layout.mirrors[:, :3], axis=1).any()),
            layered=bool(layered.any()),
            coats=bool((layers[1::2, 0] > 0).any()) or "clearcoat" in gives,
            thin=bool((layers[1::2, 2] > 0).any()),
            mixed=bool(layered.any() and not layered.all()),
            unlit=any(isinstance(material, Unlit) for material in layout.materials),
            sheen=bool((layout.sheens[:, :3] > 0).any()) or "sheen_color" in gives,
            brushed=bool((layout.brushes[:, 0] > 0).any()) or "anisotropy" in gives,
            multiscatter=bool((layers[1::2, 3] > 1).any()),
            bodies=bool(layout.glass[::2, 2].any()),
        )


def is_black(layout: Layout) -> bool:
    """Return whether a surface can have a highlight and no other light in some channel."""
    colors = layout.material_rows[::2, :3] if layout.colors is None else layout.colors[:, :3]
    return bool((colors == 0).any() or (layout.material_rows[1::2, 0] == 0).any())


def glow_rows(layout: Layout, appearance: Appearance) -> Rows:
    """Return the emission of each material and its mean over the channels, (M, 4): 0 for materials without emission.

    Where a program decides a material's emission and the material gives no number, the mean is taken as 1. That of an
    `Unlit`, which is no light, is -1.
    """
    rows = np.zeros((len(layout.materials), 4))
    for row, material, glowing in zip(rows, layout.materials, appearance.glowing, strict=True):
        row[:3] = material.glow
        row[3] = -1 if isinstance(material, Unlit) else np.mean(material.glow) or float(glowing)
    return rows
