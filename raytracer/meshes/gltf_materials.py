"""The materials of a glTF document: factors, pictures, emission, alpha, and what is clear.

Stage: scene description. Section numbers are those of glTF 2.0; the extensions KHR_materials_emissive_strength, _ior,
_transmission, _volume and KHR_texture_transform are read as well. `appearance` says what becomes of a material; what
has no counterpart is counted in `Notices`.

    materials = GltfMaterials(document, notices)
    material = materials.get(0, has_uv=True)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from io import BytesIO
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance.materials import Material, Triple
from raytracer.appearance.textures import Filter, Texture, Wrap
from raytracer.errors import SceneError
from raytracer.meshes.appearance import BLACK, Alpha, MetallicRoughness, alpha_of, metallic_roughness
from raytracer.meshes.folder import Notices
from raytracer.meshes.gltf import Document
from raytracer.meshes.pictures import Picture, Pictures, channel
from raytracer.meshes.specular_glossiness import converted, is_metal

_WRAPS: Final[dict[int, Wrap]] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_NEAREST: Final = 9728
_GLOSSY: Final = "pbrSpecularGlossiness"
_ALPHA_MODES: Final = ("MASK", "BLEND")
_SHARP: Final = 0.2
"""The roughness from which one sees that a clear material blurs what is behind it."""
_DARKEST: Final = 2.0**-24
"""The least share of light that is taken to be left by an attenuation: no finite absorption leaves nothing."""


class GltfMaterials:
    """The materials of a document, each read once."""

    def __init__(self, document: Document, notices: Notices) -> None:
        self.document, self.notices = document, notices
        self.pictures = Pictures(notices)
        self._read: dict[tuple[Any, bool], Material] = {}

    def uv_set(self, number: Any) -> int:
        """Return the number of the uv coordinates that the pictures of a material are read at."""
        return _place(self._first(number)).uv_set

    def placed(self, number: Any, uv: NDArray[Any]) -> NDArray[Any]:
        """Move uv coordinates (N, 2) to where KHR_texture_transform puts those of a material's pictures."""
        place = _place(self._first(number))
        return uv if place.is_plain else uv @ place.turn.T + place.offset

    def _first(self, number: Any) -> dict[str, Any]:
        """Return the first texture of a material; {} where it has none."""
        used = {} if number is None else self._textures(self.document.one("materials", number))
        return next(iter(used.values()), {})

    def uses_alpha(self, number: Any) -> bool:
        """Return whether a material has a mode in which alpha counts."""
        return number is not None and self.document.one("materials", number).get("alphaMode") in _ALPHA_MODES

    def get(self, number: Any, has_uv: bool) -> Material:
        """Return the material of this number for a mesh, without pictures where the mesh has no uv coordinates."""
        entry = self.document.one("materials", number)
        used = self._textures(entry)
        place = _place(self._first(number))
        elsewhere = [name for name, texture in used.items() if _place(texture) != place]
        if elsewhere:
            self.notices.ignore("second uv coordinates of materials")
        if used and not has_uv:
            self.notices.ignore("pictures of meshes without uv coordinates")
        key = (number, bool(used) and has_uv)
        if key not in self._read:
            used = {name: texture for name, texture in used.items() if has_uv and name not in elsewhere}
            self._read[key] = self._material(entry, used)
        return self._read[key]

    def _textures(self, entry: dict[str, Any]) -> dict[str, dict[str, Any]]:
        """Return the textures of a material by our names for them."""
        look, clear = entry.get("pbrMetallicRoughness", {}), _extension(entry, "transmission")
        found = {"color": look.get("baseColorTexture"), "roughness": look.get("metallicRoughnessTexture")}
        if gloss := _extension(entry, _GLOSSY):
            found = {"color": gloss.get("diffuseTexture"), "gloss": gloss.get("specularGlossinessTexture")}
        found |= {"emission": entry.get("emissiveTexture"), "transmission": clear.get("transmissionTexture")}
        found["normals"] = entry.get("normalTexture")
        return {name: texture for name, texture in found.items() if texture}

    def _material(self, entry: dict[str, Any], used: dict[str, dict[str, Any]]) -> Material:
        """Make a material with these textures (section 3.9)."""
        look = entry.get("pbrMetallicRoughness", {})
        color = _numbers(look.get("baseColorFactor", (1, 1, 1, 1)), 4)
        self.notices.ignore("occlusion maps", int("occlusionTexture" in entry))
        strength = float(_extension(entry, "emissive_strength").get("emissiveStrength", 1))
        r, g, b = (strength * x for x in _numbers(entry.get("emissiveFactor", (0, 0, 0)), 3))
        found = MetallicRoughness(
            (color[0], color[1], color[2]),
            float(look.get("metallicFactor", 1)),
            float(look.get("roughnessFactor", 1)),
            self._picture(used.get("color")),
            self._picture(used.get("roughness")),
            emission=(r, g, b),
            emission_picture=self._picture(used.get("emission")),
            ior=_ior(entry),
            normal_map=self._normals(used.get("normals")),
        )
        if gloss := _extension(entry, _GLOSSY):
            color = _numbers(gloss.get("diffuseFactor", (1, 1, 1, 1)), 4)
            found = self._glossy(found, gloss, color[:3], used.get("gloss"))
        found = replace(found, **self._alpha(entry, color[3], used.get("color"))._asdict())
        return metallic_roughness(self._clear(found, entry, used.get("transmission")))

    def _normals(self, used: dict[str, Any] | None) -> Texture | None:
        """Return the picture of normals (section 3.9.3)."""
        picture = self._picture(used)
        return None if picture is None or used is None else picture.normals(float(used.get("scale", 1)))

    def _glossy(
        self, found: MetallicRoughness, gloss: dict[str, Any], diffuse: Sequence[float], used: dict[str, Any] | None
    ) -> MetallicRoughness:
        """Return a material with what KHR_materials_pbrSpecularGlossiness says, and of its second picture the mean."""
        specular = np.asarray(_numbers(gloss.get("specularFactor", (1, 1, 1)), 3))
        glossiness = float(gloss.get("glossinessFactor", 1))
        picture, mask = self._picture(used), self._picture(used, alpha=True)
        if picture is not None:
            self.notices.ignore("detail of pictures of glossiness")
            specular = specular * picture.mean()
        if mask is not None:
            glossiness *= float(channel(mask.pixels, 0).mean())
        seen = found.color_picture
        color, metallic, roughness = converted(
            diffuse, specular.tolist(), glossiness, None if seen is None else seen.mean()
        )
        seen = None if is_metal(metallic) else seen
        return replace(found, color=color, metallic=metallic, roughness=roughness, color_picture=seen)

    def _alpha(self, entry: dict[str, Any], factor: float, used: dict[str, Any] | None) -> Alpha:
        """Return the effect of alpha (section 3.9.4): a mask cuts out, blending makes clear."""
        mode, cutoff = entry.get("alphaMode", "OPAQUE"), float(entry.get("alphaCutoff", 0.5))
        if mode not in _ALPHA_MODES:
            return Alpha()
        picture = self._picture(used, alpha=True)
        return alpha_of(mode, factor, cutoff, picture, self.notices)

    def _clear(self, found: MetallicRoughness, entry: dict[str, Any], used: dict[str, Any] | None) -> MetallicRoughness:
        """Return a material with its transmission, and the medium inside the body."""
        factor = float(_extension(entry, "transmission").get("transmissionFactor", 0))
        if factor <= 0:
            return found
        if found.opacity < 1 or found.clear is not None:
            self.notices.ignore("alpha of clear materials")
        if found.roughness > _SHARP:
            self.notices.ignore("blur of clear materials")
        if found.color != (1, 1, 1) or found.color_picture is not None:
            self.notices.ignore("tints of clear materials")
        volume = _extension(entry, "volume")
        absorption = None
        if float(volume.get("thicknessFactor", 0)) > 0:
            absorption = _absorption(volume)
        return replace(
            found,
            transmission=factor,
            transmission_picture=self._picture(used),
            absorption=absorption,
            opacity=1.0,
            clear=None,
        )

    def _picture(self, used: dict[str, Any] | None, *, alpha: bool = False) -> Picture | None:
        """Return the picture of a texture that a material uses; None, with a notice, where it cannot be read."""
        if not used:
            return None
        texture = self.document.one("textures", used.get("index"))
        sampler = self.document.one("samplers", texture["sampler"]) if "sampler" in texture else {}
        across, down = (sampler.get(key, 10497) for key in ("wrapS", "wrapT"))
        if across != down and not alpha:
            self.notices.ignore("wraps of textures that differ across and down")
        source = texture.get("extensions", {}).get("EXT_texture_webp", texture).get("source")
        if source is None:
            self.notices.miss("a texture", "its picture is of a kind that is not read")
            return None
        image = self.document.one("images", source)
        uri = image.get("uri", "")
        name = image.get("name") or ("" if uri.startswith("data:") else uri) or f"picture {source}"

        def contents() -> BytesIO:
            held = self.document.bytes_of(image["bufferView"]) if "bufferView" in image else self.document.uri(uri)
            return BytesIO(held)

        filter: Filter = "nearest" if sampler.get("magFilter") == _NEAREST else "linear"
        wrap = _WRAPS.get(across, "repeat")
        return self.pictures.get(source, str(name), contents, wrap=wrap, filter=filter, alpha=alpha)


class _Place(NamedTuple):
    """The set of uv coordinates that a texture takes, and their transform: a scale, a rotation, then an offset."""

    uv_set: int
    offset: tuple[float, ...] = (0.0, 0.0)
    angle: float = 0.0
    scale: tuple[float, ...] = (1.0, 1.0)

    @property
    def is_plain(self) -> bool:
        """Return whether the coordinates stay as they are."""
        return self[1:] == _Place(0)[1:]

    @property
    def turn(self) -> NDArray[np.float64]:
        """The matrix (2, 2) that scales, then rotates counter-clockwise as the picture is seen, where v runs down."""
        cos, sin = math.cos(self.angle), math.sin(self.angle)
        return np.array([[cos, sin], [-sin, cos]]) * self.scale


def _place(texture: dict[str, Any]) -> _Place:
    """Return the place of a textureInfo, of which KHR_texture_transform may name another set of coordinates."""
    uv_set, given = texture.get("texCoord", 0), texture.get("extensions", {}).get("KHR_texture_transform", {})
    offset, scale = (
        tuple(_numbers(given.get(key, default), 2)) for key, default in (("offset", (0, 0)), ("scale", (1, 1)))
    )
    return _Place(int(given.get("texCoord", uv_set)), offset, float(given.get("rotation", 0)), scale)


def _ior(entry: dict[str, Any]) -> float:
    """Return the refractive index of a material (KHR_materials_ior): 0 stands for a surface that mirrors all."""
    found = float(_extension(entry, "ior").get("ior", 1.5))
    if not 0 <= found < math.inf:
        raise SceneError(f"the ior of a material is 0, or 1 and more, not {found}")
    return found


def _absorption(volume: dict[str, Any]) -> Triple:
    """Return the absorption per length: -ln(c) / d for the colour c after the distance d (KHR_materials_volume)."""
    distance = float(volume.get("attenuationDistance", math.inf))
    if not distance > 0:
        return BLACK
    left = (min(max(x, _DARKEST), 1.0) for x in _numbers(volume.get("attenuationColor", (1, 1, 1)), 3))
    r, g, b = (-math.log(x) / distance for x in left)
    return (abs(r), abs(g), abs(b))  # -0.0 is 0.0


def _extension(entry: dict[str, Any], name: str) -> dict[str, Any]:
    """Return an extension of KHR_materials of a material; {} where it is not used."""
    found: dict[str, Any] = entry.get("extensions", {}).get(f"KHR_materials_{name}", {})
    return found


def _numbers(values: Any, count: int) -> list[float]:
    """Return the components of a factor; too few of them are a ValueError."""
    found = [float(x) for x in values]
    if len(found) != count:
        raise ValueError(f"a factor of a material has {count} numbers, not {len(found)}")
    return found
