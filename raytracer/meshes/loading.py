"""Reading meshes from files: OBJ, PLY, STL, GLB, through trimesh.

Stage: scene description. Takes a path, gives a `Mesh`, or a SceneError that says what is wrong with the file.

    bunny = load_mesh("bunny.ply", material=Material(reflectivity=0.1))
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.errors import SceneError
from raytracer.materials import Material
from raytracer.meshes.mesh import Mesh, joined

FORMATS = (".obj", ".ply", ".stl", ".glb", ".gltf", ".off")


def load_mesh(path: str | PathLike[str], *, material: Material | None = None) -> Mesh:
    """The triangles of a file, all parts in their places.

    The file's normals are kept; without any, corners are smoothed where faces meet at a small angle. Vertex colours
    are kept (taken for sRGB); textures are not read. Raises FileNotFoundError, or SceneError for a format that is not
    known, a file that cannot be read, and one without triangles.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    if path.suffix.lower() not in FORMATS:
        raise SceneError(f"{path}: meshes are read from {', '.join(FORMATS)}, not from {path.suffix or 'this'}")
    parts = [_mesh(part, matrix, path.stem) for part, matrix in _parts(path)]
    parts = [part for part in parts if len(part)]
    if not parts:
        raise SceneError(f"{path}: the file holds no triangles")
    mesh = parts[0] if len(parts) == 1 else joined(parts, path.stem)
    if mesh.normals is None:
        mesh = mesh.smoothed()
    return mesh if material is None else mesh.with_material(material)


def _parts(path: Path) -> list[tuple[Any, NDArray[np.float64]]]:
    """The meshes in a file, each with the matrix (4, 4) that puts it into its place."""
    try:
        import trimesh
    except ImportError as error:
        raise SceneError("reading meshes needs trimesh: pip install 'shpy-dsl[raytracer]'") from error
    try:
        scene = trimesh.load(path, process=False, force="scene")
        # A reader's faults have no common type: whatever it raises, the file is what the user can mend.
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise SceneError(f"{path}: not a readable {path.suffix[1:].upper()} file ({reason})") from error
    found = []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        geometry = scene.geometry[name]
        if isinstance(geometry, trimesh.Trimesh):
            found.append((geometry, np.asarray(matrix)))
    return found


def _mesh(part: Any, matrix: NDArray[np.float64], name: str) -> Mesh:
    """One part of the file, moved to its place."""
    # trimesh makes up normals when asked; only those that the file holds are in its cache before that.
    given = "vertex_normals" in part._cache.cache
    normals = np.asarray(part.vertex_normals) @ np.linalg.inv(matrix[:3, :3]) if given else None
    coloured = part.visual.kind in ("vertex", "face")
    colors = _linear(np.asarray(part.visual.vertex_colors)) if coloured else None
    vertices = np.asarray(part.vertices) @ matrix[:3, :3].T + matrix[:3, 3]
    return Mesh(vertices, np.asarray(part.faces), normals, colors, name=name)


def _linear(bytes_: NDArray[Any]) -> NDArray[np.float64]:
    """sRGB bytes (V, 4) as linear RGB (V, 3) (IEC 61966-2-1)."""
    s = bytes_[:, :3].astype(np.float64) / 255
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
