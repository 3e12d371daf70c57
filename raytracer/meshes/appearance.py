"""Materials of mesh files as materials of scenes.

Stage: scene description. Takes a `GltfMaterial`, the material of glTF 2.0 (section 3.9 and appendix B), which becomes a
`MetallicRoughness`, or the words of an MTL file, which `read_mtl` reads. No other file knows how they are translated.

>>> material_of(GltfMaterial(roughness=0.5)).roughness
0.5
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from raytracer.appearance.materials import CUTOFF, Material, Triple
from raytracer.appearance.metallic_roughness import AnyMaterial, MetallicRoughness
from raytracer.appearance.textures import Texture, Transform
from raytracer.appearance.unlit import Unlit
from raytracer.arrays import real
from raytracer.meshes.folder import Notices, shown
from raytracer.meshes.lines import name_of, plain, without_comment
from raytracer.meshes.pictures import Picture

CLAY = Material(color=(0.66, 0.40, 0.23), diffuse=0.9, specular=0.2, shininess=25)
"""The material of a mesh whose file has neither material nor colours: friendlier than white."""
METAL: Final = "pictures of the metal of clear bodies"
BEYOND: Final = "factors of materials outside of 0 to 1"
CLOTH: Final = 0.5
"""The roughness of a sheen for which a file has none."""
WHITE: Triple = (1.0, 1.0, 1.0)
BLACK: Triple = (0.0, 0.0, 0.0)
_SOFT = (0.05, 0.95)
"""The alpha between which a pixel is neither there nor not."""
_EDGES = 0.1
"""The largest share of such pixels that still counts as edges."""
_FAINTEST = 32
"""An alpha below 1 / _FAINTEST is taken for 0."""
_MTL_READ = {
    *("newmtl", "kd", "ks", "ns", "illum", "ka", "d", "tr", "ke", "ni", "tf", "sharpness"),
    *("map_kd", "map_d", "map_ke", "norm"),
}
_LAYERED = {"pr", "pm", "pc", "map_pr", "map_pm"}
"""The statements that make a material a `MetallicRoughness`."""
_MTL_LAYERS = {*_LAYERED, "pcr", "ps", "aniso", "anisor"}
_MTL_ZEROS = _MTL_LAYERS - {"map_pr", "map_pm"}
"""Statements that say nothing where their number is 0; exporters write them for every material."""
_MTL_PICTURES = {"bump": "bump maps", "map_bump": "bump maps"}
_TRANSPARENT = 4
"""The first model of illumination with transparency."""
_REFRACTING = (6, 7)
"""The models of illumination with refraction."""
Words = dict[str, list[str]]
"""The statements of a material, by their names in lower case: what follows the name."""
_PICTURES: Final = ("map_", "bump", "norm", "disp", "decal", "refl")
"""The beginnings of statements that name pictures."""
_OPTIONS: Final = {"-s": 3, "-o": 3, "-t": 3, "-mm": 2}
"""Options of a picture that take numbers, with the most that they take; the others take one word."""


class Alpha(NamedTuple):
    """The alpha of a surface: `opacity`, the share that it covers, a cutout picture, and a picture of the opacity."""

    opacity: float = 1.0
    cutout: Texture | None = None
    blend: Texture | None = None


@dataclass(frozen=True)
class GltfMaterial:
    """A material of glTF as its file has it: `color` is linear; `color_picture` multiplies it, as the others do theirs.

    `roughness_picture` multiplies `roughness` by its green channel and `metallic` by its blue one; those of numbers
    multiply by the red channel, but that of `clearcoat_roughness` by the green one. `specular_picture` and
    `sheen_roughness_picture` are alphas. `anisotropy_picture` multiplies the strength by its blue channel, and has the
    direction in the others, which `anisotropy_rotation` turns by degrees.
    A `thickness` above 0 makes what is clear a body. `emission` may exceed 1; an `unlit` material shows its
    colour alone. `opacity` is the share of the surface that is there, and `cutout` where it is; `blend`, in place of
    `opacity`, is a picture of it.
    """

    color: Triple = WHITE
    metallic: float = 0.0
    roughness: float = 1.0
    color_picture: Picture | None = None
    roughness_picture: Picture | None = None
    emission: Triple = BLACK
    emission_picture: Picture | None = None
    transmission: float = 0.0
    transmission_picture: Picture | None = None
    ior: float = 1.5
    thickness: float = 0.0
    attenuation_color: Triple = WHITE
    attenuation_distance: float = math.inf
    opacity: float = 1.0
    cutout: Texture | None = None
    blend: Texture | None = None
    normal_map: Texture | None = None
    specular: float = 1.0
    specular_picture: Picture | None = None
    specular_color: Triple = WHITE
    specular_color_picture: Picture | None = None
    clearcoat: float = 0.0
    clearcoat_picture: Picture | None = None
    clearcoat_roughness: float = 0.0
    clearcoat_roughness_picture: Picture | None = None
    sheen_color: Triple = BLACK
    sheen_color_picture: Picture | None = None
    sheen_roughness: float = 0.0
    sheen_roughness_picture: Picture | None = None
    anisotropy: float = 0.0
    anisotropy_rotation: float = 0.0
    anisotropy_picture: Picture | None = None
    unlit: bool = False

    @property
    def metal(self) -> float | Texture:
        """The share that is a metal."""
        return _number_of(self.metallic, self.roughness_picture, 2)


def material_of(look: GltfMaterial) -> AnyMaterial:
    """Return a material of glTF in its own model; of a body's metal it takes the mean."""
    if look.unlit:
        alpha = look.opacity if look.blend is None else look.blend
        return Unlit(_color(look.color, look.color_picture), alpha, look.cutout)
    red, green, blue = (min(max(x, 0.0), 1.0) for x in look.color)
    metallic = look.metal
    if look.thickness and isinstance(metallic, Texture):
        metallic = mean_number(metallic)
    return MetallicRoughness(
        base_color=_color((red, green, blue), look.color_picture),
        metallic=metallic,
        roughness=_number_of(look.roughness, look.roughness_picture, 1),
        ior=look.ior,
        specular=_number_of(look.specular, look.specular_picture, 0),
        specular_color=_color(look.specular_color, look.specular_color_picture),
        clearcoat=_number_of(look.clearcoat, look.clearcoat_picture, 0),
        clearcoat_roughness=_number_of(look.clearcoat_roughness, look.clearcoat_roughness_picture, 1),
        sheen_color=_color(look.sheen_color, look.sheen_color_picture) if any(look.sheen_color) else BLACK,
        sheen_roughness=_number_of(look.sheen_roughness, look.sheen_roughness_picture, 0),
        anisotropy=_direction(look.anisotropy, look.anisotropy_picture),
        anisotropy_rotation=look.anisotropy_rotation,
        transmission=_number_of(look.transmission, look.transmission_picture, 0),
        thickness=look.thickness,
        attenuation_color=look.attenuation_color,
        attenuation_distance=look.attenuation_distance,
        emission=_color(look.emission, look.emission_picture) if any(look.emission) else BLACK,
        alpha=look.opacity if look.blend is None else look.blend,
        normal=look.normal_map,
        cutout=look.cutout,
    )


def _direction(strength: float, picture: Picture | None) -> float | Texture:
    """Return an anisotropy: its strength, or a picture of directions, whose strength is multiplied."""
    strength = min(max(strength, 0.0), 1.0)
    return strength if picture is None or strength == 0 else picture.directions(strength)


def isotropic(material: AnyMaterial, has_uv: bool, notices: Notices) -> AnyMaterial:
    """Return a material without its anisotropy, and with a notice, for a mesh without uv coordinates."""
    if has_uv or not isinstance(material, MetallicRoughness) or not material.brush[0]:
        return material
    notices.ignore("anisotropy of meshes without uv coordinates")
    return replace(material, anisotropy=0.0)


def restored(material: AnyMaterial) -> AnyMaterial:
    """Return a material whose microfacets lose no light, where it is a `MetallicRoughness`."""
    return replace(material, multiscatter=True) if isinstance(material, MetallicRoughness) else material


def mean_number(picture: Texture) -> float:
    """Return the mean of a picture of a number."""
    return float(picture.image.mean(dtype=np.float64))


def _number_of(factor: float, picture: Picture | None, place: int) -> float | Texture:
    """Return a factor times a channel of its picture, in [0, 1]."""
    factor = min(max(factor, 0.0), 1.0)
    return factor if picture is None or factor == 0 else picture.number(factor, place)


def resized(pixels: Any, height: int, width: int, part: slice = slice(None)) -> Any:
    """Repeat or leave out pixels (h, w, ...), so that there are (height, width, ...); return a part of the rows."""
    rows, columns = (np.arange(n) * old // n for n, old in zip((height, width), pixels.shape, strict=False))
    return pixels[rows[part]][:, columns]


def alpha_of(mode: str, factor: float, cutoff: float, picture: Picture | None, notices: Notices) -> Alpha:
    """Return the effect of alpha, a factor times a picture, in the modes "MASK" and "BLEND".

    In the mode "BLEND" a picture's alpha is kept, and alpha below 1/32 becomes a cutout, which costs no
    scattered ray. Where only the edges of shapes have partial alpha, to smooth the steps of pixels, alpha below 0.5 is
    cut out instead: through many leaves, each edge would cost one more scattered ray.
    """
    if mode == "MASK":
        if picture is None:
            return Alpha(1.0 if factor >= cutoff else 0.0)
        return Alpha(cutout=picture.cutout(factor * CUTOFF / cutoff) if cutoff > 0 else None)
    opacity = min(max(factor, 0.0), 1.0)
    if picture is None or not picture.is_partly_clear():
        return Alpha(opacity, None if picture is None else picture.cutout(1.0))
    if picture.share_between(*_SOFT) <= _EDGES:
        notices.ignore("partial transparency at the edges of pictures")
        return Alpha(opacity, picture.cutout(1.0))
    return Alpha(1.0, picture.cutout(CUTOFF * _FAINTEST), picture.alpha(opacity))


@dataclass(frozen=True)
class MtlPictures:
    """The pictures of map_Kd, map_Ke, map_Pr, map_Pm and norm, and the alpha or grey numbers of map_d."""

    color: Picture | None = None
    emission: Picture | None = None
    opacity: Picture | None = None
    roughness: Picture | None = None
    metallic: Picture | None = None
    normals: Picture | None = None


def mtl(words: Mapping[str, list[str]], pictures: MtlPictures, notices: Notices) -> AnyMaterial:
    """Return the material that the statements of an MTL file describe, by their names in lower case.

    The statements are those of Wavefront's Advanced Visualizer (appendix B1.2), and those that Exocortex added in 2015.
    With Pr, Pm or Pc a material is a `MetallicRoughness`; without them it has Phong's model.
    Kd times map_Kd is the colour, Ke times map_Ke the emission; numbers are linear. Ka is not read: a scene has one
    ambient light. map_d cuts out what is below 0.5. Raises ValueError for a word that is not a number.
    """
    clear = _clear(words)
    layered = bool(_LAYERED & words.keys())
    read = _MTL_READ | _MTL_LAYERS if layered else _MTL_READ
    for name in words:
        if name not in read and not (name in _MTL_ZEROS and _number(words, name, 0) == 0):
            notices.ignore(_MTL_PICTURES.get(name, f"{name} of materials"))
    notices.ignore("Tr 1 of materials without d, which are opaque", int(_is_opaque(words)))
    notices.ignore("tints of clear materials", int(clear > 0 and len(set(_rgb(words, "tf", 1.0))) > 1))
    notices.ignore("halos of materials", int("-halo" in words.get("d", [])))
    if pictures.opacity is not None and pictures.opacity.is_partly_clear():
        notices.ignore("partial transparency of pictures")
    material = _layers(words, pictures, clear, notices) if layered else _phong(words, pictures, clear, notices)
    if pictures.normals is not None:
        field: dict[str, Any] = {"normal" if layered else "normal_map": pictures.normals.normals(1.0)}
        material = replace(material, **field)
    return replace(
        material,
        emission=_color(_rgb(words, "ke", 0.0 if pictures.emission is None else 1.0), pictures.emission),
        cutout=None if pictures.opacity is None else pictures.opacity.cutout(1.0),
    )


def _model(words: Mapping[str, list[str]]) -> int:
    """Return the model of illumination."""
    return int(_number(words, "illum", 2))


def _is_opaque(words: Mapping[str, list[str]]) -> bool:
    """Return whether Tr 1 means opaque: without d, in the models below 4, which have no transparency.

    MeshLab and photogrammetry write it so.
    """
    return not words.get("d") and _number(words, "tr", 0) >= 1 and _model(words) < _TRANSPARENT


def _clear(words: Mapping[str, list[str]]) -> float:
    """Return the share of a surface through which light goes: 1 - d, or Tr.

    With illum 6 and 7, where d says nothing, it is the least channel of Tf, or 1.
    """
    clear = 0.0 if _is_opaque(words) else 1 - _number(words, "d", 1 - _number(words, "tr", 0))
    if _model(words) in _REFRACTING and clear <= 0:
        clear = min(_rgb(words, "tf", 1.0))
    return min(max(clear, 0.0), 1.0)


def _layers(words: Mapping[str, list[str]], pictures: MtlPictures, clear: float, notices: Notices) -> MetallicRoughness:
    """Return a material with Pr, Pm, Ps, Pc and Pcr: map_Pr and map_Pm multiply them, and are their numbers alone.

    Ps is a sheen without colour, whose roughness the format does not have: it is that of `CLOTH`.

    aniso divides the width of microfacets along the surface, Pr**2, by (1 - 0.9 aniso)**0.5, and multiplies that across
    it by as much (Burley 2012, Physically Based Shading at Disney, appendix B); anisor is its angle in turns. Beside
    map_Pr aniso is not read.

    Ks, Ns and illum say the same of a surface in Phong's model, and are not read beside them. Ni is the refractive
    index, 1 - d the share that is not there; with illum 6 and 7 it is that of a body, which refracts.
    """
    color = _rgb(words, "kd", 0.8)
    shares = (_number(words, name, 0.0) for name in ("pr", "pm", "pc", "pcr", "ps", "aniso"))
    notices.ignore(BEYOND, int(not all(0 <= share <= 1 for share in (*color, *shares))))
    red, green, blue = (min(x, 1.0) for x in color)
    fibres = min(max(_number(words, "ps", 0.0), 0.0), 1.0)
    stretched = min(max(_number(words, "aniso", 0.0), 0.0), 1.0)
    roughness = min(max(_number(words, "pr", 0.5 if pictures.roughness is None else 1.0), 0.0), 1.0)
    if stretched and pictures.roughness is not None:
        notices.ignore("aniso of materials with map_Pr")
        stretched = 0.0
    aspect = math.sqrt(1 - 0.9 * stretched)
    along, across = roughness**2 / aspect, roughness**2 * aspect
    strength = math.sqrt(min((along - across) / (1 - across), 1.0)) if stretched else 0.0
    metallic = _number_of(_number(words, "pm", 0.0 if pictures.metallic is None else 1.0), pictures.metallic, 0)
    is_body = clear > 0 and _model(words) in _REFRACTING
    if is_body and isinstance(metallic, Texture):
        notices.ignore(METAL)
        metallic = mean_number(metallic)
    return MetallicRoughness(
        base_color=_color((red, green, blue), pictures.color),
        metallic=metallic,
        roughness=_number_of(math.sqrt(across) if stretched else roughness, pictures.roughness, 0),
        ior=_number(words, "ni", 1.5),
        sheen_color=(fibres, fibres, fibres),
        sheen_roughness=CLOTH if fibres else 0.0,
        clearcoat=_number_of(_number(words, "pc", 0.0), None, 0),
        clearcoat_roughness=_number_of(_number(words, "pcr", 0.0), None, 0),
        anisotropy=strength,
        anisotropy_rotation=360 * _number(words, "anisor", 0.0) if stretched else 0.0,
        transmission=clear if is_body else 0.0,
        thickness=float(is_body),
        alpha=1.0 if is_body else 1 - clear,
    )


def _phong(words: Mapping[str, list[str]], pictures: MtlPictures, clear: float, notices: Notices) -> Material:
    """Return a material in Phong's model: Ks is the height and Ns the exponent of the highlight.

    Of Ks, the mean is taken. Surfaces of illum 3 to 9 mirror as much as Ks says; those of illum 0 and 1 have no
    highlight, and those of Ns 0 have none: it would cover the surface. Where the largest channel of the colour and Ks
    make more than 1, both are divided by their sum: no surface sends out more than it receives. With illum 6 and 7 the
    clear share refracts by Ni and mirrors by Fresnel's equations. With the others light goes straight on.
    """
    color, shiny = _color(_rgb(words, "kd", 0.8), pictures.color), float(np.mean(_rgb(words, "ks", 0.0)))
    model = _model(words)
    exponent = max(_number(words, "ns", 40.0), 0.0)  # old versions of Blender wrote negative ones
    diffuse, specular = bounded(color, height_of(shiny, exponent, notices) if model >= 2 else 0.0, notices)
    reflectivity = min(shiny, 1.0) if 3 <= model <= 9 else 0.0
    material = Material(color, diffuse, specular, exponent, reflectivity)
    if not clear:
        return material
    return replace(material, transmission=clear, ior=_number(words, "ni", 1.5) if model in _REFRACTING else 1.0)


def height_of(specular: float, exponent: float, notices: Notices) -> float:
    """Return the height of a highlight: 0 at the exponent 0, whose highlight would cover the surface."""
    if exponent > 0:
        return specular
    notices.ignore("highlights of exponent 0", int(specular > 0))
    return 0.0


def bounded(color: Triple | Texture, specular: float, notices: Notices) -> tuple[float, float]:
    """Return the factors of matt light and highlight, divided by the most that both send out where this exceeds 1."""
    total = float(np.max(color.image if isinstance(color, Texture) else color)) + specular
    if total <= 1:
        return 1.0, specular
    notices.ignore("light beyond what surfaces receive")
    return 1 / total, specular / total


def _color(factor: Triple, picture: Picture | None) -> Triple | Texture:
    return factor if picture is None else picture.color(factor)


def _number(words: Mapping[str, list[str]], name: str, default: float) -> float:
    """Return the last number of a statement; the default where it is missing."""
    arguments = words.get(name, [])
    return _real(name, arguments[-1]) if arguments else default


def _real(name: str, word: str) -> float:
    """Return the number of a statement's word; a ValueError names both where it is none, or not finite."""
    try:
        number = real(word)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{name.capitalize()} has {shown(word)}, which is not a finite number")
    return number


def _rgb(words: Mapping[str, list[str]], name: str, default: float) -> Triple:
    """Return the colour of a statement; one number stands for three."""
    channels = [_real(name, word) for word in words[name]] if name in words else [default]
    if len(channels) == 1:
        channels *= 3
    if len(channels) != 3 or not all(0 <= x < np.inf for x in channels):
        raise ValueError(f"{name.capitalize()} is three numbers, each 0 or more, not {' '.join(words[name])}")
    return (channels[0], channels[1], channels[2])


def read_mtl(data: bytes) -> dict[str, Words]:
    """Read the materials of a library by name; of a statement that comes twice, the last one counts."""
    materials: dict[str, Words] = {}
    current: Words = {}
    for line in plain(data).split(b"\n"):
        line = without_comment(line).strip()
        words = line.split()
        if words[:1] == [b"newmtl"]:
            current = materials.setdefault(name_of(line[len("newmtl") :].strip()), {})
        elif words:
            key = name_of(words[0]).lower()
            after = name_of(line[len(words[0]) + 1 :])  # spaces inside a name count
            current[key] = [after] if key.startswith(_PICTURES) and after else [name_of(word) for word in words[1:]]
    return materials


class PictureWords(NamedTuple):
    """The file of a picture in a statement of an MTL file, and its options by name."""

    file: str
    options: dict[str, list[str]]

    @property
    def transform(self) -> Transform | None:
        """The `Texture.transform`: -s multiplies uv coordinates, -o is added to them."""
        if not {"-s", "-o"} & self.options.keys():
            return None
        (s, t), (u, v) = (
            [*map(real, self.options.get(name, [])), start, start][:2] for name, start in (("-s", 1.0), ("-o", 0.0))
        )
        return (s, 0.0, u), (0.0, t, v)


def picture_words(words: list[str]) -> PictureWords:
    """Split a statement such as map_Kd into options and a file, whose name may have spaces, and begin with some."""
    text = " ".join(words)
    spans = [match.span() for match in re.finditer(r"\S+", text)]
    words = [text[begin:end] for begin, end in spans]
    options: dict[str, list[str]] = {}
    at = 0
    while at < len(words) - 1 and words[at].startswith("-"):
        option = words[at]
        end = at + 2
        while end - at <= _OPTIONS.get(option, 1) and end < len(words) - 1 and _is_number(words[end]):
            end += 1
        options[option] = words[at + 1 : end]
        at = end
    return PictureWords(text[spans[at - 1][1] + 1 if at else 0 :] if words else "", options)


def _is_number(word: str) -> bool:
    try:
        real(word)
    except ValueError:
        return False
    return True
