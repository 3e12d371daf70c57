"""Reading meshes from files: OBJ, PLY, STL, GLB, through trimesh.

Stage: scene description. Takes a path, gives a `Mesh`, or a SceneError that says what is wrong with the file.

    bunny = load_mesh("bunny.ply", material=Material(reflectivity=0.1))
"""

from __future__ import annotations

from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.errors import SceneError
from raytracer.materials import Material
from raytracer.meshes.contents import READABLE
from raytracer.meshes.mesh import Mesh, joined
from raytracer.textures import decoded

FORMATS = (".obj", ".ply", ".stl", ".glb", ".gltf", ".off")
_OPTIONS: dict[str, dict[str, Any]] = {".obj": {"skip_materials": True}}
_LONGEST = 200
"""Characters of a reader's own message that are shown."""


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
    try:
        import trimesh  # noqa: F401 - used below
    except ImportError as error:
        raise SceneError("reading meshes needs trimesh: pip install 'shpy-dsl[raytracer]'") from error
    with path.open("rb") as file:  # a file that cannot be opened is an OSError
        data = file.read()
    try:
        mesh = _read(path, data)
        # A reader's faults have no common type: whatever it raises, the file is what the user can mend.
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        kind = path.suffix[1:].upper()
        raise SceneError(f"{path}: not a readable {kind} file ({reason[:_LONGEST]})") from error
    if not len(mesh):
        raise SceneError(f"{path}: the file holds no triangles")
    return mesh if material is None else mesh.with_material(material)


def _read(path: Path, data: bytes) -> Mesh:
    """All parts of a file as one mesh with normals; it raises whatever a reader raises."""
    with np.errstate(all="ignore"):
        parts = [_mesh(part, matrix, path.stem) for part, matrix in _parts(path, data)]
    parts = [part for part in parts if len(part)]
    mesh = parts[0] if len(parts) == 1 else joined(parts, path.stem) if parts else Mesh([], [])
    return mesh if mesh.normals is not None else mesh.smoothed()


def _parts(path: Path, data: bytes) -> list[tuple[Any, NDArray[np.float64]]]:
    """The meshes in a file, each with the matrix (4, 4) that puts it into its place."""
    import trimesh

    kind = path.suffix.lower()
    if kind in READABLE:
        held = BytesIO(READABLE[kind](data))
        scene = trimesh.load(held, file_type=kind[1:], process=False, force="scene", **_OPTIONS.get(kind, {}))
    else:
        scene = trimesh.load(path, process=False, force="scene")
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
    turn, faces = matrix[:3, :3], np.asarray(part.faces)
    mirrors = bool(np.linalg.det(turn) < 0)
    if mirrors:
        faces = faces[:, ::-1]
    normals = np.asarray(part.vertex_normals) @ _for_normals(turn, mirrors) if given else None
    colors = uv = None
    if part.visual.kind == "vertex":
        colors = _linear(np.asarray(part.visual.vertex_colors))
    elif part.visual.kind == "face":
        colors = np.repeat(_linear(np.asarray(part.visual.face_colors))[:, None], 3, axis=1)
    elif part.visual.kind == "texture" and np.shape(part.visual.uv) == (len(part.vertices), 2):
        uv = part.visual.uv
    vertices = np.asarray(part.vertices) @ turn.T + matrix[:3, 3]
    return Mesh(vertices, faces, normals, colors, name=name, uv=uv)


def _for_normals(matrix: NDArray[np.float64], mirrors: bool) -> NDArray[np.float64]:
    """Return the matrix for rows of normals where `matrix` transforms the places: its cofactors, transposed.

    They are the inverse but for a factor, and there are cofactors where there is no inverse: of a scale (1, 1, 0).
    """
    matrix = matrix / (np.abs(matrix).max() or 1)
    x, y, z = matrix.T
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)])
    return np.asarray(-cofactors if mirrors else cofactors)


def _linear(bytes_: NDArray[Any]) -> NDArray[np.float64]:
    """SRGB bytes (V, 4) as linear RGB (V, 3)."""
    return decoded(bytes_[:, :3].astype(np.float64) / 255)
