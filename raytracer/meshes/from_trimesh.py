"""Meshes and scenes of trimesh as ours, with their names, colours, uv coordinates and materials.

Stage: scene description. Takes trimesh.Trimesh and trimesh.Scene objects. PLY, STL and OFF files come in here too.

    mesh = Mesh.from_trimesh(trimesh.creation.icosphere())
    Scene([trimesh.load("chair.glb"), floor(4)])
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Hashable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance.materials import PLAIN, Material
from raytracer.appearance.textures import decoded
from raytracer.errors import SceneError
from raytracer.meshes.appearance import MetallicRoughness, alpha_of, height_of, metallic_roughness
from raytracer.meshes.folder import Notices
from raytracer.meshes.instance import Instance
from raytracer.meshes.mesh import LOADERS, Mesh
from raytracer.meshes.pictures import Picture, Pictures

_GREY = (102, 102, 102)
"""The colour of trimesh for what has none."""


_NO_FACES = np.zeros((0, 3), np.int64)


def mesh_of(part: Any, *, material: Material | None = None, name: str | None = None) -> Mesh:
    """Convert a trimesh.Trimesh to a Mesh, of its own material unless another is given.

    Normals are those that `part` has computed or was given; without any, corners are smoothed. Colours of vertices and
    faces are taken for sRGB. Raises SceneError for what is no Trimesh.
    """
    notices = Notices(name or _name(part))
    found = _mesh(part, material, name or _name(part), Pictures(notices), notices)
    notices.warn()
    return found


LOADERS["trimesh"] = mesh_of


def parts_of(thing: Any, notices: Notices) -> Iterator[Instance]:
    """Yield the meshes of a trimesh.Trimesh or trimesh.Scene in their places, named by the graph's nodes."""
    pictures = Pictures(notices)
    if not hasattr(thing, "graph"):
        yield Instance(_mesh(thing, None, _name(thing), pictures, notices), np.eye(4))
        return
    made: dict[str, Mesh] = {}
    for node in thing.graph.nodes_geometry:
        matrix, key = thing.graph[node]
        geometry = thing.geometry[key]
        if not hasattr(geometry, "faces"):
            notices.ignore("points and lines")
            continue
        if key not in made:
            made[key] = _mesh(geometry, None, key, pictures, notices)
        yield Instance(made[key], matrix, str(node))


def join_strips(scene: Any) -> None:
    """Give a trimesh.Scene of a PLY file the triangles of its `tristrips`, which trimesh takes for points alone."""
    import trimesh

    for key, part in list(scene.geometry.items()):
        raw = part.metadata.get("_ply_raw", {})
        if "tristrips" not in raw or hasattr(part, "faces"):
            continue
        (rows,) = raw["tristrips"]["data"].values()
        faces = np.concatenate([_strip(np.asarray(row).reshape(-1)) for row in rows])
        if faces.size and not 0 <= faces.min() <= faces.max() < len(part.vertices):
            raise SceneError(f"a strip names vertex {faces.max()}, and there are {len(part.vertices)}")
        held = raw["vertex"]["data"]
        normals = [held[name].reshape(-1) for name in ("nx", "ny", "nz") if name in held]
        scene.geometry[key] = trimesh.Trimesh(
            part.vertices,
            faces,
            vertex_normals=np.stack(normals, axis=1) if len(normals) == 3 else None,
            vertex_colors=part.colors if len(part.colors) else None,
            process=False,
        )


def completed(mesh: Mesh, part: Any) -> Mesh:
    """Return the mesh of a PLY file with what trimesh leaves out beside uv coordinates.

    That is colours, and the uv coordinates of corners in lists, of which `part` has those of one corner of each vertex.
    """
    raw = part.metadata.get("_ply_raw", {})
    found = {}
    lists = _column(raw, "face", "texcoord")
    if np.shape(lists) == (len(mesh), 6):
        found["uv"] = lists.reshape(-1, 3, 2)
    for element in ("vertex", "face") if mesh.colors is None else ():
        columns = [_column(raw, element, name) for name in ("red", "green", "blue")]
        if "colors" not in found and all(column is not None for column in columns):
            colors = _linear(np.column_stack(columns))
            found["colors"] = colors if element == "vertex" else np.repeat(colors[:, None], 3, axis=1)
    return replace(mesh, **found) if found else mesh


def _column(raw: Any, element: str, name: str) -> Any:
    """Return the numbers of a property of a PLY file, (N,) or of lists (N, L); None where the file has none."""
    held = raw.get(element, {})
    if name not in held.get("properties", ()) or not held.get("length"):
        return None
    numbers = held["data"][name]
    return numbers["f1"] if numbers.dtype.names else numbers  # a binary list has its length before it


def _strip(order: NDArray[Any]) -> NDArray[np.int64]:
    """Return the triangles (F, 3) of vertices in strips, between which a negative number stands.

    Each vertex after two others makes a triangle with them; of every second one in a strip two corners change places,
    so that all face one way.
    """
    order = order.astype(np.int64)
    ends = np.flatnonzero(order < 0)
    place = np.arange(len(order))
    first = np.concatenate([[0], ends + 1])[np.searchsorted(ends, place)]  # where the strip of each place begins
    last = place[2:][(place[2:] - first[2:] >= 2) & (order[2:] >= 0)]
    odd = (last - first[last]) % 2
    return np.stack([order[last - 2], order[last - 1 + odd], order[last - odd]], axis=1) if last.size else _NO_FACES


def _name(part: Any) -> str:
    name = getattr(part, "metadata", {}).get("name")
    return name if isinstance(name, str) and name else "mesh"


def _mesh(part: Any, material: Material | None, name: str, pictures: Pictures, notices: Notices) -> Mesh:
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
    given = getattr(visual, "vertex_attributes", {}).get("color") if visual.kind == "texture" else None
    return None if given is None else _linear(given)


def _linear(colors: Any) -> NDArray[np.float64]:
    """Convert sRGB bytes or numbers (V, 3 or 4) to linear RGB (V, 3)."""
    colors = np.asarray(colors)[:, :3]
    return decoded(colors.astype(np.float64) / (255 if colors.dtype.kind in "iu" else 1))


def _material(given: Any, pictures: Pictures, notices: Notices) -> Material:
    """Convert a PBRMaterial or SimpleMaterial, whose numbers are linear."""
    if given is None:
        return PLAIN
    if hasattr(given, "materials"):
        notices.ignore("several materials in one mesh")
        return PLAIN
    pbr = hasattr(given, "metallicFactor")
    image = given.baseColorTexture if pbr else getattr(given, "image", None)
    picture = _picture(image, pictures)
    if not pbr:
        return _simple(given, picture, notices)
    notices.ignore("normal maps", int(given.normalTexture is not None))
    base = np.ones(4) if given.baseColorFactor is None else np.append(np.asarray(given.baseColorFactor) / 255, 1)[:4]
    r, g, b, opacity = base.tolist()
    found = MetallicRoughness(
        (r, g, b),
        1.0 if given.metallicFactor is None else given.metallicFactor,
        1.0 if given.roughnessFactor is None else given.roughnessFactor,
        picture,
        _picture(given.metallicRoughnessTexture, pictures),
    )
    if given.emissiveFactor is not None:
        r, g, b = np.asarray(given.emissiveFactor, dtype=np.float64).tolist()
        found = replace(found, emission=(r, g, b), emission_picture=_picture(given.emissiveTexture, pictures))
    if given.alphaMode in ("MASK", "BLEND"):
        cutoff = 0.5 if given.alphaCutoff is None else given.alphaCutoff
        alpha = alpha_of(given.alphaMode, opacity, cutoff, _picture(image, pictures, alpha=True), notices)
        found = replace(found, **alpha._asdict())
    return metallic_roughness(found)


def _picture(image: Any, pictures: Pictures, *, alpha: bool = False) -> Picture | None:
    """Return the picture of a material or its alpha. Its contents are the key, as scenes of trimesh hold copies."""
    if image is None:
        return None
    try:
        colours = str(image.getpalette()), repr(image.info.get("transparency"))
        key: Hashable = (image.size, image.mode, hashlib.sha256(image.tobytes()).digest(), *colours)
    except Exception:  # of a picture that cannot be decoded, which `get` reports
        key = object()  # equals no other key
    return pictures.get(key, "a picture", lambda: image, alpha=alpha)


def _simple(given: Any, picture: Any, notices: Notices) -> Material:
    """Convert a SimpleMaterial; its grey default is no colour, and no factor of an image."""
    diffuse = np.asarray(getattr(given, "diffuse", _GREY))[:3]
    plain = tuple(diffuse.tolist()) == _GREY
    if picture is None and plain:
        return PLAIN
    r, g, b = (1.0, 1.0, 1.0) if plain else (diffuse / 255).tolist()
    shiny = np.asarray(getattr(given, "specular", _GREY))[:3]
    specular = 0.0 if tuple(shiny.tolist()) == _GREY else float(shiny.mean()) / 255
    color = (r, g, b) if picture is None else picture.color((r, g, b))
    exponent = max(float(getattr(given, "glossiness", 1.0)), 0.0)
    return Material(color, 1.0, height_of(specular, exponent, notices), exponent)


def texture_file(header: str) -> str | None:
    """Return the name of the picture in the header of a PLY file, where MeshLab writes it as a comment."""
    found = re.search(r"^comment\s+TextureFile\s+(\S.*?)\s*$", header, re.MULTILINE | re.IGNORECASE)
    return found[1] if found else None
