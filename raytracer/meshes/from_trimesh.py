"""Meshes and scenes of trimesh as ours, with their names, colours, uv coordinates and materials.

Stage: scene description. Takes trimesh.Trimesh and trimesh.Scene objects. STL and OFF files come in here too.

    mesh = Mesh.from_trimesh(trimesh.creation.icosphere())
    Scene([trimesh.load("chair.glb"), floor(4)])
"""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance.materials import PLAIN, Material
from raytracer.appearance.metallic_roughness import AnyMaterial
from raytracer.appearance.textures import decoded
from raytracer.errors import SceneError
from raytracer.meshes.appearance import GltfMaterial, alpha_of, bounded, height_of, material_of
from raytracer.meshes.folder import Notices
from raytracer.meshes.mesh import LOADERS, Instance, Mesh
from raytracer.meshes.pictures import Picture, Pictures

_GREY = (102, 102, 102)
"""The default colour of trimesh."""


def mesh_of(part: Any, *, material: AnyMaterial | None = None, name: str | None = None) -> Mesh:
    """Convert a trimesh.Trimesh to a Mesh, of its own material unless another is given.

    Normals are those that `part` has computed or was given; without any, corners are smoothed. Colours of vertices and
    faces are taken for sRGB. Raises SceneError unless it is a Trimesh.
    """
    notices = Notices(name or _name(part))
    mesh = _mesh(part, material, name or _name(part), Pictures(notices), notices)
    notices.warn()
    return mesh


LOADERS["trimesh"] = mesh_of


def parts_of(thing: Any, notices: Notices) -> Iterator[Instance]:
    """Yield the meshes of a trimesh.Trimesh or trimesh.Scene in their places, named by the graph's nodes."""
    pictures = Pictures(notices)
    if not hasattr(thing, "graph"):
        yield Instance(_mesh(thing, None, _name(thing), pictures, notices), np.eye(4))
        return
    meshes: dict[str, Mesh] = {}
    for node in thing.graph.nodes_geometry:
        matrix, key = thing.graph[node]
        geometry = thing.geometry[key]
        if not hasattr(geometry, "faces"):
            notices.ignore("points and lines")
            continue
        if key not in meshes:
            meshes[key] = _mesh(geometry, None, key, pictures, notices)
        yield Instance(meshes[key], matrix, str(node))


def _name(part: Any) -> str:
    name = getattr(part, "metadata", {}).get("name")
    return name if isinstance(name, str) and name else "mesh"


def _mesh(part: Any, material: AnyMaterial | None, name: str, pictures: Pictures, notices: Notices) -> Mesh:
    if not (hasattr(part, "faces") and hasattr(part, "visual")):
        raise SceneError(f"a mesh is made from a trimesh.Trimesh, not from {type(part).__name__}")
    colors, uv = _colors(part.visual, notices), np.asarray(getattr(part.visual, "uv", None))
    has_uv = uv.shape == (len(part.vertices), 2)
    if material is None:
        material = _material(getattr(part.visual, "material", None), pictures, notices)
        if not has_uv and material.textures:
            notices.ignore("pictures of meshes without uv coordinates")
            material = PLAIN
    # trimesh makes up normals when asked; only those that it was given or has used are in its cache before that.
    normals = np.asarray(part.vertex_normals) if "vertex_normals" in part._cache.cache else None
    mesh = Mesh(
        np.asarray(part.vertices), np.asarray(part.faces), normals, colors, material, name, uv if has_uv else None
    )
    return mesh if normals is not None else mesh.smoothed()


def _colors(visual: Any, notices: Notices) -> NDArray[np.float64] | None:
    """Return linear colours, (V, 3) or (F, 3, 3)."""
    if visual.kind in ("vertex", "face"):
        if visual.transparency:
            notices.ignore(f"alpha of {visual.kind} colours")
        if visual.kind == "vertex":
            return _linear(visual.vertex_colors)
        return np.repeat(_linear(visual.face_colors)[:, None], 3, axis=1)
    colors = getattr(visual, "vertex_attributes", {}).get("color") if visual.kind == "texture" else None
    return None if colors is None else _linear(colors)


def _linear(colors: Any) -> NDArray[np.float64]:
    """Convert sRGB bytes or numbers (V, 3 or 4) to linear RGB (V, 3)."""
    colors = np.asarray(colors)[:, :3]
    return decoded(colors.astype(np.float64) / (255 if colors.dtype.kind in "iu" else 1))


def _material(material: Any, pictures: Pictures, notices: Notices) -> AnyMaterial:
    """Convert a PBRMaterial or SimpleMaterial, whose numbers are linear."""
    if material is None:
        return PLAIN
    if hasattr(material, "materials"):
        notices.ignore("several materials in one mesh")
        return PLAIN
    pbr = hasattr(material, "metallicFactor")
    image = material.baseColorTexture if pbr else getattr(material, "image", None)
    picture = _picture(image, pictures)
    if not pbr:
        return _simple(material, picture, notices)
    notices.ignore("normal maps", int(material.normalTexture is not None))
    base = (
        np.ones(4) if material.baseColorFactor is None else np.append(np.asarray(material.baseColorFactor) / 255, 1)[:4]
    )
    r, g, b, opacity = base.tolist()
    look = GltfMaterial(
        (r, g, b),
        1.0 if material.metallicFactor is None else material.metallicFactor,
        1.0 if material.roughnessFactor is None else material.roughnessFactor,
        picture,
        _picture(material.metallicRoughnessTexture, pictures),
    )
    if material.emissiveFactor is not None:
        r, g, b = np.asarray(material.emissiveFactor, dtype=np.float64).tolist()
        look = replace(look, emission=(r, g, b), emission_picture=_picture(material.emissiveTexture, pictures))
    if material.alphaMode in ("MASK", "BLEND"):
        cutoff = 0.5 if material.alphaCutoff is None else material.alphaCutoff
        alpha = alpha_of(material.alphaMode, opacity, cutoff, _picture(image, pictures, alpha=True), notices)
        look = replace(look, **alpha._asdict())
    return material_of(look)


def _picture(image: Any, pictures: Pictures, *, alpha: bool = False) -> Picture | None:
    """Return the picture of a material or its alpha. Its contents are the key, as scenes of trimesh hold copies."""
    if image is None:
        return None
    try:
        colours = str(image.getpalette()), repr(image.info.get("transparency"))
        key: Hashable = (image.size, image.mode, hashlib.sha256(image.tobytes()).digest(), *colours)
    except Exception:  # the picture cannot be decoded; `get` reports it
        key = object()  # equals no other key
    return pictures.get(key, "a picture", lambda: image, alpha=alpha)


def _simple(material: Any, picture: Any, notices: Notices) -> AnyMaterial:
    """Convert a SimpleMaterial; its grey default is no colour, and no factor of an image."""
    diffuse = np.asarray(getattr(material, "diffuse", _GREY))[:3]
    plain = tuple(diffuse.tolist()) == _GREY
    if picture is None and plain:
        return PLAIN
    r, g, b = (1.0, 1.0, 1.0) if plain else (diffuse / 255).tolist()
    shiny = np.asarray(getattr(material, "specular", _GREY))[:3]
    specular = 0.0 if tuple(shiny.tolist()) == _GREY else float(shiny.mean()) / 255
    color = (r, g, b) if picture is None else picture.color((r, g, b))
    exponent = max(float(getattr(material, "glossiness", 1.0)), 0.0)
    return Material(color, *bounded(color, height_of(specular, exponent, notices), notices), exponent)
