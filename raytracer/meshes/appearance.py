"""What a mesh file says of a surface, as a `Material` of Phong's model.

Stage: scene description. The readers of files give an `Appearance`: a metallic-roughness material (glTF 2.0, section
3.9 and appendix B) or the words of an MTL file. These two functions are the only place that knows what becomes of them.

>>> metallic_roughness(MetallicRoughness(roughness=0.5)).shininess
7.5
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from raytracer.materials import Material, Triple
from raytracer.meshes.folder import Notices
from raytracer.meshes.pictures import Picture, channel
from raytracer.textures import Texture

CLAY = Material(color=(0.66, 0.40, 0.23), diffuse=0.9, specular=0.2, shininess=25)
"""What a mesh of a file is made of that has neither material nor colours: friendlier than white."""
WHITE: Triple = (1.0, 1.0, 1.0)
DIELECTRIC = 0.04
"""The share of light that a glTF surface reflects at normal incidence if it is no metal (appendix B.2)."""
SHARPEST = 1000.0
"""The largest exponent of a highlight: a roughness of about 0.15."""


@dataclass(frozen=True)
class MetallicRoughness:
    """A material of glTF: `color` is linear; `color_picture` multiplies it.

    `roughness_picture` multiplies `roughness` by its green channel and `metallic` by its blue one.
    """

    color: Triple = WHITE
    metallic: float = 0.0
    roughness: float = 1.0
    color_picture: Picture | None = None
    roughness_picture: Picture | None = None


def metallic_roughness(look: MetallicRoughness) -> Material:
    """Return the Phong material that comes near a material of glTF.

    With alpha = roughness**2 (Karis 2013), the exponent s of Blinn-Phong's highlight is 2 / alpha**2 - 2 (Walter et al.
    2007, section 5.2), and Phong's is a quarter of s (Fisher and Woo 1994). The highlight has the height F0 s / 8, at
    most 1: the normalization (s + 2) / 8 (Hoffman 2010) without the part that is spread over all directions, which is
    seen as diffuse light. F0 is 0.04, and a metal's own colour.

    Mirror images have no colour here: a metal mirrors the part of its colour that all channels share, times
    (1 - roughness)**2, as a rough one blurs what it mirrors. What is not mirrored is seen as diffuse light. The mirror
    image in surfaces that are no metals is left out.
    """
    mean = np.asarray(look.color) * (1 if look.color_picture is None else look.color_picture.mean())
    shared = float(mean.min())
    if look.roughness_picture is None:
        specular, shininess, reflectivity = (float(x) for x in _lobe(look.roughness, look.metallic, shared))
        return Material(_color(look.color, look.color_picture), 1.0, specular, shininess, reflectivity)
    picture = look.roughness_picture

    def textures() -> list[float | Texture]:
        pixels = picture.fitting(3)
        maps = _lobe(look.roughness * channel(pixels, 1), look.metallic * channel(pixels, 2), shared)
        return [
            float(numbers.flat[0]) if np.ptp(numbers) == 0 else picture.texture(numbers, srgb=False) for numbers in maps
        ]

    specular, shininess, reflectivity = picture.made((look.roughness, look.metallic, shared), textures)
    return Material(_color(look.color, look.color_picture), 1.0, specular, shininess, reflectivity)


def _lobe(roughness: Any, metallic: Any, shared: float) -> list[Any]:
    """Specular, shininess and reflectivity of numbers or of pictures (H, W)."""
    roughness, metallic = np.broadcast_arrays(np.clip(roughness, 0, 1), np.clip(metallic, 0, 1))
    alpha = np.maximum(roughness, 1e-3) ** 2
    exponent = np.minimum(2 / alpha**2 - 2, 4 * SHARPEST)
    f0 = DIELECTRIC + (shared - DIELECTRIC) * metallic
    specular = np.clip(f0 * exponent / 8, 0, 1)
    return [specular, np.maximum(exponent / 4, 1), np.clip(metallic * (1 - roughness) ** 2 * shared, 0, 1)]


_MTL_READ = {"newmtl", "kd", "ks", "ns", "illum", "map_kd", "ka", "d", "tr", "ke", "ni", "tf", "sharpness"}
_MTL_PICTURES = {"bump": "normal maps", "map_bump": "normal maps", "norm": "normal maps"}


def mtl(words: Mapping[str, list[str]], color_picture: Picture | None, notices: Notices) -> Material:
    """Return the material that the statements of an MTL file describe, by their names in lower case.

    Kd times map_Kd is the colour, Ks the height and Ns the exponent of the highlight; numbers are linear. Of Ks, the
    mean is taken. Surfaces of illum 3 to 9 mirror as much as Ks says; those of illum 0 and 1 have no highlight. Ka is
    not read: a scene has one ambient light. Raises ValueError for what is no number.
    """
    color, shiny = _rgb(words, "kd", 0.8), float(np.mean(_rgb(words, "ks", 0.0)))
    model = int(_number(words, "illum", 2))
    if _number(words, "d", 1) < 1 or _number(words, "tr", 0) > 0 or model in (4, 6, 7, 9):
        notices.ignore("transparency of materials")
    if any(_rgb(words, "ke", 0.0)):
        notices.ignore("emission of materials")
    for name in words:
        if name not in _MTL_READ:
            notices.ignore(_MTL_PICTURES.get(name, f"{name} of materials"))
    return Material(
        _color(color, color_picture),
        diffuse=1.0,
        specular=shiny if model >= 2 else 0.0,
        shininess=max(_number(words, "ns", 40.0), 0.0),  # old versions of Blender wrote negative ones
        reflectivity=min(shiny, 1.0) if model >= 3 else 0.0,
    )


def _color(factor: Triple, picture: Picture | None) -> Triple | Texture:
    return factor if picture is None else picture.color(factor)


def _number(words: Mapping[str, list[str]], name: str, default: float) -> float:
    """The last number of a statement; the default where it is missing."""
    given = words.get(name, [])
    return float(given[-1]) if given else default


def _rgb(words: Mapping[str, list[str]], name: str, default: float) -> Triple:
    """The colour of a statement; one number stands for three."""
    given = [float(word) for word in words.get(name, [default])]
    if len(given) == 1:
        given *= 3
    if len(given) != 3 or not all(0 <= x < np.inf for x in given):
        raise ValueError(f"{name} of a material is three numbers, not {words.get(name)}")
    return (given[0], given[1], given[2])
