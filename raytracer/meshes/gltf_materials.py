"""The materials of a glTF document: factors, pictures, emission, alpha, and what is clear.

Stage: scene description. Section numbers are those of glTF 2.0; the extensions KHR_materials_emissive_strength, _ior,
_specular, _clearcoat, _sheen, _anisotropy, _transmission, _volume, _unlit, _pbrSpecularGlossiness and
KHR_texture_transform are read as well. `appearance` converts a material; `Notices` counts what has no counterpart.

    materials = GltfMaterials(document, notices)
    material = materials.get(0, has_uv=True)
"""

from __future__ import annotations

import math
from dataclasses import replace
from io import BytesIO
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance.metallic_roughness import AnyMaterial
from raytracer.appearance.textures import UNMOVED, Filter, Texture, Transform, Wrap
from raytracer.errors import SceneError
from raytracer.meshes.appearance import BEYOND, METAL, Alpha, GltfMaterial, alpha_of, isotropic, material_of
from raytracer.meshes.folder import BadEntry, Notices
from raytracer.meshes.gltf import BROKEN, Document, count_of, is_data, needed, number_of, numbers_of, reason_of, table
from raytracer.meshes.pictures import Picture, Pictures
from raytracer.meshes.specular_glossiness import glossy

_WRAPS: Final[dict[int, Wrap]] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_NEAREST: Final = 9728
_GLOSSY: Final = "pbrSpecularGlossiness"
_ALPHA_MODES: Final = ("MASK", "BLEND")
_SHARES: Final = (
    *("metallic", "roughness", "transmission", "specular", "clearcoat", "clearcoat_roughness"),
    *("sheen_roughness", "anisotropy"),
)
"""The factors of a material that the specification limits to 0 to 1, beside colours."""


class GltfMaterials:
    """The materials of a document, each read once."""

    def __init__(self, document: Document, notices: Notices) -> None:
        self.document, self.notices = document, notices
        self.pictures = Pictures(notices)
        self._read: dict[tuple[Any, bool], AnyMaterial] = {}

    def uv_set(self, number: Any) -> int:
        """Return the number of the uv coordinates that the pictures of a material are read at."""
        return self._base(number).uv_set

    def placed(self, number: Any, uv: NDArray[Any]) -> NDArray[Any]:
        """Move uv coordinates (N, 2) to where KHR_texture_transform puts those of a material's pictures.

        Pictures with another transform have a `Texture.transform`. Those of normals have none, as tangents follow uv.
        """
        place = self._base(number)
        return uv if place.is_plain else uv @ place.turn.T + place.offset

    def _base(self, number: Any) -> _Place:
        """Return the place of a material's first texture, or that of its normals in the same set of coordinates."""
        used = {} if number is None else self._textures(self.document.one("materials", number))
        first, normals = (_place(texture) for texture in (next(iter(used.values()), {}), used.get("normals", {})))
        return normals if "normals" in used and normals.uv_set == first.uv_set else first

    def uses_alpha(self, number: Any) -> bool:
        """Return whether a material has a mode in which alpha counts."""
        return number is not None and self.document.one("materials", number).get("alphaMode") in _ALPHA_MODES

    def is_cut_out(self, number: Any) -> bool:
        """Return whether a mask removes a material entirely: its alpha is below the cutoff everywhere."""
        entry = self.document.one("materials", number)
        if entry.get("alphaMode") != "MASK":
            return False
        cutoff = number_of(entry, "alphaCutoff", 0.5)
        pictured = "color" in self._textures(entry)
        return cutoff > 1 or (not pictured and self._color(entry)[3] < cutoff)

    def _color(self, entry: dict[str, Any]) -> list[float]:
        """Return the factor of a material's colour, and of its alpha."""
        if gloss := _extension(entry, _GLOSSY):
            return numbers_of(gloss, "diffuseFactor", (1, 1, 1, 1))
        return numbers_of(table(entry, "pbrMetallicRoughness"), "baseColorFactor", (1, 1, 1, 1))

    def get(self, number: Any, has_uv: bool) -> AnyMaterial:
        """Return the material of this number for a mesh, without pictures where the mesh has no uv coordinates."""
        entry = self.document.one("materials", number)
        textures, base = self._textures(entry), self._base(number)
        used = {name: _Use(texture, _place(texture).beside(base)) for name, texture in textures.items()}
        elsewhere = [name for name, use in used.items() if use.transform is None]
        if "gloss" in used and "color" in used and used["gloss"].transform != used["color"].transform:
            elsewhere.append("gloss")  # the two pictures become one
        self.notices.ignore("second uv coordinates or transforms in materials", int(bool(elsewhere)))
        if used and not has_uv:
            self.notices.ignore("pictures of meshes without uv coordinates")
        key = (number, bool(used) and has_uv)
        if key not in self._read:
            used = {name: use for name, use in used.items() if has_uv and name not in elsewhere}
            self._read[key] = self._material(entry, used)
        return isotropic(self._read[key], has_uv, self.notices)

    def _textures(self, entry: dict[str, Any]) -> dict[str, dict[str, Any]]:
        """Return the textures of a material by our names for them."""
        look, clear = table(entry, "pbrMetallicRoughness"), _extension(entry, "transmission")
        textures = {"color": look.get("baseColorTexture"), "roughness": look.get("metallicRoughnessTexture")}
        if gloss := _extension(entry, _GLOSSY):
            textures = {"color": gloss.get("diffuseTexture"), "gloss": gloss.get("specularGlossinessTexture")}
        textures |= {"emission": entry.get("emissiveTexture"), "transmission": clear.get("transmissionTexture")}
        textures["normals"] = entry.get("normalTexture")
        specular, coat = _extension(entry, "specular"), _extension(entry, "clearcoat")
        textures |= {"specular": specular.get("specularTexture"), "tint": specular.get("specularColorTexture")}
        sheen = _extension(entry, "sheen")
        textures |= {"sheen": sheen.get("sheenColorTexture"), "fuzz": sheen.get("sheenRoughnessTexture")}
        textures["brush"] = _extension(entry, "anisotropy").get("anisotropyTexture")
        textures |= {"coat": coat.get("clearcoatTexture"), "coat roughness": coat.get("clearcoatRoughnessTexture")}
        return {name: table(textures, name) for name, texture in textures.items() if texture}

    def _material(self, entry: dict[str, Any], used: dict[str, _Use]) -> AnyMaterial:
        """Make a material with these textures (section 3.9)."""
        look, color = table(entry, "pbrMetallicRoughness"), self._color(entry)
        if "KHR_materials_unlit" in table(entry, "extensions"):
            base = GltfMaterial((color[0], color[1], color[2]), color_picture=self._picture(used.get("color")))
            base = replace(base, unlit=True)
            return material_of(replace(base, **self._alpha(entry, color[3], used.get("color"))._asdict()))
        self.notices.ignore("occlusion maps", int("occlusionTexture" in entry))
        strength = number_of(_extension(entry, "emissive_strength"), "emissiveStrength", 1)
        r, g, b = (strength * x for x in numbers_of(entry, "emissiveFactor", (0, 0, 0)))
        material = GltfMaterial(
            (color[0], color[1], color[2]),
            number_of(look, "metallicFactor", 1),
            number_of(look, "roughnessFactor", 1),
            self._picture(used.get("color")),
            self._picture(used.get("roughness")),
            emission=(r, g, b),
            emission_picture=self._picture(used.get("emission")),
            ior=_ior(entry),
            normal_map=self._normals(used.get("normals")),
            **self._layers(entry, used),
        )
        if gloss := _extension(entry, _GLOSSY):
            specular, gloss_factor = (
                numbers_of(gloss, "specularFactor", (1, 1, 1)),
                number_of(gloss, "glossinessFactor", 1),
            )
            shine, mask = (self._picture(used.get("gloss"), alpha=alpha) for alpha in (False, True))
            material = glossy(material, specular, gloss_factor, shine, mask)
        material = replace(material, **self._alpha(entry, color[3], used.get("color"))._asdict())
        material = self._clear(material, entry, used.get("transmission"))
        shares = (*color, *(getattr(material, name) for name in _SHARES))
        self.notices.ignore(BEYOND, int(not all(0 <= share <= 1 for share in shares)))
        return material_of(material)

    def _layers(self, entry: dict[str, Any], used: dict[str, _Use]) -> dict[str, Any]:
        """Return the fields of a material that KHR_materials_specular, _clearcoat, _sheen and _anisotropy decide."""
        sheen, brush = _extension(entry, "sheen"), _extension(entry, "anisotropy")
        fibres = [min(max(x, 0.0), 1.0) for x in numbers_of(sheen, "sheenColorFactor", (0, 0, 0))]
        specular, coat = _extension(entry, "specular"), _extension(entry, "clearcoat")
        self.notices.ignore("normal maps of coats", int("clearcoatNormalTexture" in coat))
        r, g, b = (max(x, 0.0) for x in numbers_of(specular, "specularColorFactor", (1, 1, 1)))
        return {
            "specular": number_of(specular, "specularFactor", 1),
            "specular_picture": self._picture(used.get("specular"), alpha=True),
            "specular_color": (r, g, b),
            "specular_color_picture": self._picture(used.get("tint")),
            "clearcoat": number_of(coat, "clearcoatFactor", 0),
            "clearcoat_picture": self._picture(used.get("coat")),
            "clearcoat_roughness": number_of(coat, "clearcoatRoughnessFactor", 0),
            "clearcoat_roughness_picture": self._picture(used.get("coat roughness")),
            "sheen_color": (fibres[0], fibres[1], fibres[2]),
            "sheen_color_picture": self._picture(used.get("sheen")),
            "sheen_roughness": number_of(sheen, "sheenRoughnessFactor", 0),
            "sheen_roughness_picture": self._picture(used.get("fuzz"), alpha=True),
            "anisotropy": number_of(brush, "anisotropyStrength", 0),
            "anisotropy_rotation": math.degrees(number_of(brush, "anisotropyRotation", 0)),
            "anisotropy_picture": self._picture(used.get("brush")),
        }

    def _normals(self, use: _Use | None) -> Texture | None:
        """Return the picture of normals (section 3.9.3)."""
        picture = self._picture(use)
        return None if picture is None or use is None else picture.normals(number_of(use.texture, "scale", 1))

    def _alpha(self, entry: dict[str, Any], factor: float, use: _Use | None) -> Alpha:
        """Return the effect of alpha (section 3.9.4): a mask cuts out, blending makes clear."""
        mode, cutoff = entry.get("alphaMode", "OPAQUE"), number_of(entry, "alphaCutoff", 0.5)
        if mode not in _ALPHA_MODES:
            return Alpha()
        picture = self._picture(use, alpha=True)
        return alpha_of(mode, factor, cutoff, picture, self.notices)

    def _clear(self, material: GltfMaterial, entry: dict[str, Any], use: _Use | None) -> GltfMaterial:
        """Return a material with its transmission, and the medium inside the body."""
        factor = number_of(_extension(entry, "transmission"), "transmissionFactor", 0)
        if factor <= 0:
            return material
        material = replace(material, transmission=factor, transmission_picture=self._picture(use))
        volume = _extension(entry, "volume")
        thickness = number_of(volume, "thicknessFactor", 0)
        if thickness <= 0 or material.ior == 0:  # a surface of the index 0 mirrors all
            return material
        material = replace(material, thickness=thickness, **_attenuation(volume))
        layered = material.clearcoat > 0 or material.specular != 1 or material.specular_color != (1, 1, 1)
        lost = {
            "alpha of clear bodies": material.opacity < 1 or material.blend is not None,
            METAL: isinstance(material.metal, Texture),
            "coats and specular factors of clear bodies": layered,
        }
        for text, is_lost in lost.items():
            self.notices.ignore(text, int(is_lost))
        return replace(material, opacity=1.0, blend=None)

    def _picture(self, use: _Use | None, *, alpha: bool = False) -> Picture | None:
        """Return the picture of a texture that a material uses; None, with a notice, where it cannot be read."""
        if use is None:
            return None
        try:
            return self._read_picture(use, alpha)
        except BadEntry:
            raise
        except BROKEN as error:
            self.notices.miss(f"texture {use.texture.get('index')}", reason_of(error))
            return None

    def _read_picture(self, use: _Use, alpha: bool) -> Picture | None:
        texture = self.document.one("textures", needed(use.texture, "index"))
        sampler = self.document.one("samplers", texture["sampler"]) if "sampler" in texture else {}
        across, down = (sampler.get(key, 10497) for key in ("wrapS", "wrapT"))
        if across != down and not alpha:
            self.notices.ignore("wraps of textures that differ across and down")
        source = table({"EXT_texture_webp": texture, **table(texture, "extensions")}, "EXT_texture_webp").get("source")
        if source is None:
            self.notices.miss("a texture", "its picture is of a kind that is not read")
            return None
        image = self.document.one("images", source)
        uri = image.get("uri", "")
        name = image.get("name") or ("" if is_data(uri) else uri) or f"picture {source}"

        def contents() -> BytesIO:
            content = self.document.bytes_of(image["bufferView"]) if "bufferView" in image else self.document.uri(uri)
            return BytesIO(content)

        filter: Filter = "nearest" if sampler.get("magFilter") == _NEAREST else "linear"
        wrap = _WRAPS.get(across, "repeat")
        transform = None if use.transform == UNMOVED else use.transform
        options: dict[str, Any] = {"wrap": wrap, "filter": filter, "alpha": alpha, "transform": transform}
        return self.pictures.get(source, str(name), contents, **options)


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

    def beside(self, base: _Place) -> Transform | None:
        """Return the `Texture.transform` of a picture here where the mesh has the coordinates of `base`.

        None where there is none: for another set of coordinates, and where `base` makes a line or a point of the mesh.
        """
        if self == base:
            return UNMOVED
        if self.uv_set != base.uv_set or np.linalg.det(base.turn) == 0:
            return None
        between, corner = self.turn @ np.linalg.inv(base.turn), np.array([0.0, 1.0])
        flip = np.array([1.0, -1.0])  # v runs down in glTF, up here
        offset = flip * (between @ (corner - base.offset) + self.offset) + corner
        (a, b), (c, d) = (flip[:, None] * between * flip).tolist()
        return (a, b, float(offset[0])), (c, d, float(offset[1]))


class _Use(NamedTuple):
    """A textureInfo of a material, and the transform of its picture; None for a picture that is not read."""

    texture: dict[str, Any]
    transform: Transform | None


def _place(texture: dict[str, Any]) -> _Place:
    """Return the place of a textureInfo, of which KHR_texture_transform may name another set of coordinates."""
    transform = table(table(texture, "extensions"), "KHR_texture_transform")
    uv_set = count_of(transform if "texCoord" in transform else texture, "texCoord", 0)
    offset, scale = (
        tuple(numbers_of(transform, key, default)) for key, default in (("offset", (0, 0)), ("scale", (1, 1)))
    )
    return _Place(uv_set, offset, number_of(transform, "rotation", 0), scale)


def _ior(entry: dict[str, Any]) -> float:
    """Return the refractive index of a material (KHR_materials_ior): 0 stands for a surface that mirrors all."""
    ior = number_of(_extension(entry, "ior"), "ior", 1.5)
    if ior < 0:
        raise SceneError(f"its ior is {ior:g}, not 0, or 1 and more")
    return ior


def _attenuation(volume: dict[str, Any]) -> dict[str, Any]:
    """Return the colour that white light has after a distance in a body (KHR_materials_volume)."""
    distance = number_of(volume, "attenuationDistance", 0) if "attenuationDistance" in volume else math.inf
    r, g, b = (min(max(x, 0.0), 1.0) for x in numbers_of(volume, "attenuationColor", (1, 1, 1)))
    return {"attenuation_color": (r, g, b), "attenuation_distance": distance if distance > 0 else math.inf}


def _extension(entry: dict[str, Any], name: str) -> dict[str, Any]:
    """Return an extension of KHR_materials of a material; {} where it is not used."""
    return table(table(entry, "extensions"), f"KHR_materials_{name}")
