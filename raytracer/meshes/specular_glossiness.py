"""Colours and numbers of KHR_materials_pbrSpecularGlossiness as those of metallic-roughness.

Stage: scene description. The conversion is that of Khronos's page "convert-between-workflows" of the extension: for
each texel, the share that is a metal follows from the brightnesses of both colours.

>>> [round(float(x), 3) for x in converted(np.zeros(3), np.ones(3))[0]]
[1.0, 1.0, 1.0]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.appearance.textures import AT_ONCE, linear
from raytracer.meshes.appearance import WHITE, GltfMaterial, resized
from raytracer.meshes.pictures import Picture, channel

Floats = NDArray[Any]
_DIELECTRIC: Final = 0.04
"""The share of light that non-metals reflect at normal incidence."""
_PERCEIVED: Final = np.array((0.299, 0.587, 0.114))
"""The weights of the squared channels in the brightness that is perceived."""


def converted(diffuse: Floats, specular: Floats) -> tuple[Floats, Floats]:
    """Return the base colours (..., 3) and the metallic shares (...) for linear colours (..., 3)."""
    left = 1 - specular.max(axis=-1)
    metallic = _metallic(_brightness(diffuse), _brightness(specular), left)[..., None]
    matt = diffuse * (left[..., None] / (1 - _DIELECTRIC) / np.maximum(1 - metallic, 1e-6))
    metal = (specular - _DIELECTRIC * (1 - metallic)) / np.maximum(metallic, 1e-6)
    return np.clip(matt + metallic**2 * (metal - matt), 0, 1), metallic[..., 0]


def _brightness(color: Floats) -> Floats:
    brightness: Floats = np.sqrt(color**2 @ _PERCEIVED)
    return brightness


def _metallic(diffuse: Floats, specular: Floats, left: Floats) -> Floats:
    """Solve for the share that is a metal, from brightnesses: a quadratic equation."""
    b = diffuse * left / (1 - _DIELECTRIC) + specular - 2 * _DIELECTRIC
    root = np.sqrt(np.maximum(b * b - 4 * _DIELECTRIC * (_DIELECTRIC - specular), 0))
    return np.where(specular < _DIELECTRIC, 0, np.clip((root - b) / (2 * _DIELECTRIC), 0, 1))


def glossy(
    material: GltfMaterial,
    specular: Sequence[float],
    glossiness: float,
    shine: Picture | None,
    mask: Picture | None,
) -> GltfMaterial:
    """Return a material with the metallic-roughness of its colour and of the other numbers.

    `shine` multiplies `specular` and `mask` the `glossiness`, as the picture of the material's colour does the colour.
    """
    factors = np.asarray(material.color, np.float64), np.asarray(specular, np.float64)
    pictures = material.color_picture, shine, mask
    first = next((picture for picture in pictures if picture is not None), None)
    if first is None:
        color, metallic = converted(*factors)
        red, green, blue = color.tolist()
        roughness = float(np.clip(1 - glossiness, 0, 1))
        return replace(material, color=(red, green, blue), metallic=float(metallic), roughness=roughness)

    def textures() -> tuple[Picture, Picture]:
        pixels = [None if picture is None else picture.fitting(2) for picture in pictures]
        shape = tuple(max(part.shape[k] for part in pixels if part is not None) for k in (0, 1))
        base, numbers = np.empty((*shape, 3), np.float32), np.zeros((*shape, 3), np.float32)
        count = max(1, AT_ONCE // shape[1])
        for top in range(0, shape[0], count):
            rows = slice(top, top + count)
            parts = [None if part is None else resized(part, shape[0], shape[1], rows) for part in pixels]
            seen, light = (
                factor if part is None else factor * linear(part, encoded=True).astype(np.float64)
                for factor, part in zip(factors, parts, strict=False)
            )
            colors, numbers[rows, :, 2] = converted(seen, light)
            base[rows] = sh.screen.srgb(colors)  # as pictures of colours are
            numbers[rows, :, 1] = np.clip(1 - glossiness * (1 if parts[2] is None else channel(parts[2], 0)), 0, 1)
        return first.like(base), first.like(numbers)

    key = ("glossy", *map(tuple, factors), glossiness, *pictures)
    colors, numbers = first.memoize(key, textures)
    look = replace(material, color=WHITE, metallic=1.0, roughness=1.0)
    return replace(look, color_picture=colors, roughness_picture=numbers)
