"""Reading files of meshes: OBJ, PLY, STL, OFF, glTF and GLB.

Stage: scene description. Takes a path, gives a `Mesh` or the `Contents` of the file, or a SceneError that says what is
wrong with it.

    bunny = load_mesh("bunny.ply", material=Material(reflectivity=0.1))
    chair = load_contents("chair.glb")
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from raytracer.appearance.materials import PLAIN, Material
from raytracer.appearance.metallic_roughness import AnyMaterial, MetallicRoughness
from raytracer.appearance.textures import Wrap
from raytracer.errors import SceneError
from raytracer.meshes.appearance import (
    CLAY,
    WHITE,
    MtlPictures,
    Words,
    isotropic,
    mtl,
    picture_words,
    read_mtl,
    restored,
)
from raytracer.meshes.folder import BadEntry, Folder, Notices, shown
from raytracer.meshes.gltf import Document
from raytracer.meshes.mesh import LOADERS, Mesh, check_expansion, joined, placed_all, smoothed
from raytracer.meshes.obj import read_obj
from raytracer.meshes.off import read_off
from raytracer.meshes.pictures import Picture, Pictures
from raytracer.meshes.ply import read_ply
from raytracer.meshes.stl import read_stl
from raytracer.scene.framing import bounds_of
from raytracer.scene.gltf_cameras import NamedCamera
from raytracer.scene.gltf_scene import GltfScene
from raytracer.scene.lights import Light

FORMATS = (".obj", ".ply", ".stl", ".glb", ".gltf", ".off")
_FLAT = (".glb", ".gltf")
"""The formats whose meshes are flat where they have no normals: glTF 2.0, section 3.7.2.1."""
_PICTURES = ("map_kd", "map_ke", "map_d", "map_pr", "map_pm", "norm")
"""The statements of an MTL file whose pictures are read."""
_LONGEST = 200
"""Characters of a reader's own message that are shown."""


@dataclass(frozen=True)
class Contents:
    """The meshes of a file in their places, and its cameras and lights if it has any; `file` is its name.

    `variants` are the names by which materials may be chosen.
    """

    meshes: Sequence[Mesh]
    cameras: Sequence[NamedCamera] = ()
    lights: Sequence[Light] = ()
    file: str = "the file"
    variants: Sequence[str] = ()
    materials: int = 0
    """The number of materials in the file that were not read."""


def load_mesh(path: str | PathLike[str], *, material: AnyMaterial | None = None, strict: bool = False) -> Mesh:
    """Read the triangles of a file, all parts in their places, as one mesh.

    The file's normals are kept; without any, meshes of glTF are flat, and corners of others are smoothed where faces
    meet at a small angle. Vertex colours and uv coordinates are kept; materials are not, as a mesh has one, so they are
    for `Scene.load`. An sh.ShpyWarning says so, unless a `material` is given. A bad entry, such as a face that names a
    normal that the file lacks, is left out, and a warning counts them; with `strict` it is an error. Raises
    FileNotFoundError, or SceneError for a format that is not known, a file that cannot be read, and one without
    triangles.
    """
    path = Path(path)
    notices = Notices(path.name, strict=strict)
    contents = _load(path, notices, materials=False)
    if material is None:
        notices.ignore("materials, which Scene.load reads", contents.materials)
    notices.warn()
    meshes = contents.meshes
    check_expansion(path.name, meshes)
    one = meshes[0] if len(meshes) == 1 else joined(meshes, path.stem)
    return one.with_material(material or PLAIN, path.stem)


LOADERS["file"] = load_mesh


def load_contents(
    path: str | PathLike[str], *, strict: bool = False, variant: str | None = None, multiscatter: bool = False
) -> Contents:
    """Read the meshes of a file with names and materials, cameras and lights; an sh.ShpyWarning lists what is left out.

    Errors and `strict` are those of `load_mesh`; with `strict` a file that the path's file names must be readable, too.
    `variant` and `multiscatter` are those of `Scene.load`; SceneError for a variant that the file has not, and for
    `multiscatter` where no material has microfacets.
    """
    path = Path(path)
    if variant is not None and path.suffix.lower() not in _FLAT:
        raise SceneError(f"{path}: variants are those of GLB and glTF files: leave variant={variant!r} out")
    notices = Notices(path.name, strict=strict)
    contents = _load(path, notices, materials=True, variant=variant, multiscatter=multiscatter)
    notices.warn()
    if multiscatter:
        check_microfacets(path, contents.meshes)
    return contents


def check_microfacets(path: Path, meshes: Sequence[Mesh]) -> None:
    """Raise SceneError for a file to whose materials `multiscatter` makes no difference."""
    if not any(isinstance(mesh.material, MetallicRoughness) for mesh in meshes):
        raise SceneError(f"{path}: multiscatter is for metallic-roughness materials, of which this file has none")


def _load(
    path: Path, notices: Notices, *, materials: bool, variant: str | None = None, multiscatter: bool = False
) -> Contents:
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder: name a file in it")
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise SceneError(f"{path}: meshes are read from {', '.join(FORMATS)}, not from {path.suffix or 'this'}")
    data = bytes_of(path)
    with reading(path):
        read = partial(_gltf, variant=variant) if kind in _FLAT else _READERS[kind]
        contents: Contents = read(path, data, notices, materials, multiscatter)
        meshes = [mesh for mesh in contents.meshes if len(mesh)]
        contents = replace(contents, meshes=meshes if kind in _FLAT else _smoothed(meshes))
    if not contents.meshes:
        causes = "; ".join(text.partition(": ")[2] for text in (notices.faults(), notices.text()) if text)
        raise SceneError(f"{path}: the file holds no triangles{causes and '; '}{shown(causes, _LONGEST)}")
    notices.ignore("meshes without area, which cannot be seen", sum(not mesh.has_area for mesh in contents.meshes))
    return contents


def bytes_of(path: Path) -> bytes:
    """Return the contents of a file; SceneError where that exceeds the memory, OSError where it cannot be opened."""
    try:
        return path.read_bytes()
    except MemoryError as error:
        size = path.stat().st_size / 2**30
        raise SceneError(f"{path}: {size:.1f} GiB are more than the memory holds") from error


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Make one SceneError of whatever the reader of a file raises, as its faults have no common type."""
    try:
        with np.errstate(all="ignore"):
            yield
    except BadEntry as error:
        raise SceneError(f"{path}: {error}") from error
    except Exception as error:
        reason = shown(_reason(error), _LONGEST)
        raise SceneError(f"{path}: not a readable {path.suffix[1:].upper()} file ({reason})") from error


def _reason(error: Exception) -> str:
    """Return what is wrong with a file, by the exception of its reader: mostly a part that is missing or wrong."""
    if isinstance(error, KeyError):
        return f"it lacks {error}"
    if isinstance(error, TypeError | AttributeError):
        return f"a part of it is of the wrong kind: {error}"
    return str(error) or type(error).__name__


def _smoothed(meshes: Sequence[Mesh]) -> Sequence[Mesh]:
    """Compute normals for the meshes without them, together, because materials may divide one smooth surface."""
    smooth_meshes = iter(smoothed([mesh for mesh in meshes if mesh.normals is None]))
    return [next(smooth_meshes) if mesh.normals is None else mesh for mesh in meshes]


def _gltf(
    path: Path, data: bytes, notices: Notices, materials: bool, multiscatter: bool, variant: str | None
) -> Contents:
    document = Document(data, Folder(path))
    choices: dict[str, Any] = {"variant": variant, "multiscatter": multiscatter}
    scene = GltfScene(document, path.stem, notices, materials=materials, **choices)
    meshes = placed_all(scene.instances())
    if not materials or not any(map(len, meshes)):
        return Contents(meshes, materials=len(scene.document.all("materials")))
    low, high = bounds_of(meshes, np.eye(3))
    lights = scene.lights((low + high) / 2)
    return Contents(meshes, scene.cameras(low, high), lights, path.name, variants=scene.variants)


def _obj(path: Path, data: bytes, notices: Notices, materials: bool, multiscatter: bool) -> Contents:
    parts, libraries = read_obj(data, path.stem, notices)
    library = Library(libraries, Folder(path), notices) if materials else None
    meshes: list[Mesh] = []
    names: dict[str, int] = {}
    for part, mesh in parts:
        number = names[mesh.name] = names.get(mesh.name, -1) + 1
        look = (library and library.material(part.material, mesh)) or (CLAY if mesh.colors is None else PLAIN)
        look = restored(look) if multiscatter else look
        meshes.append(mesh.with_material(look, f"{mesh.name}_{number}" if number else mesh.name))
    described = {part.material for part, _ in parts} - {None}
    return Contents(meshes, materials=0 if materials else len(described))


class Library:
    """The materials that the MTL files of an OBJ file describe."""

    def __init__(self, files: Sequence[str], folder: Folder, notices: Notices) -> None:
        self.files, self.folder, self.notices = files, folder, notices
        self.pictures = Pictures(notices)
        self.words: dict[str, Words] = {}
        self.beside: dict[str, Path] = {}
        """By name of a material: the folder of its library, beside which its pictures are."""
        for name in [name for names in files for name in self._names(names)]:
            try:
                path = folder.find(name)
                materials = read_mtl(path.read_bytes())
            except (OSError, SceneError) as error:
                notices.miss(name, str(error))
                continue
            self.words |= materials
            self.beside |= dict.fromkeys(materials, path.parent)
        self._materials: dict[tuple[str, bool], AnyMaterial | None] = {}

    def material(self, name: str | None, mesh: Mesh) -> AnyMaterial | None:
        """Return the material of this name for a mesh; None if no library has it."""
        if name is None or name not in self.words:
            if name is not None and (self.words or not self.files):
                self.notices.ignore("names of materials that are not described")
            return None
        words = self.words[name]
        pictured = any(words.get(statement) for statement in _PICTURES)
        if pictured and mesh.uv is None:
            self.notices.ignore("pictures of meshes without uv coordinates")
        key = (name, pictured and mesh.uv is not None)
        if key not in self._materials:
            self._materials[key] = self._read(name, words, key[1])
        material = self._materials[key]
        return None if material is None else isotropic(material, mesh.uv is not None, self.notices)

    def _read(self, name: str, words: Words, pictured: bool) -> AnyMaterial | None:
        pictures = (
            self._picture(words.get(statement, []) if pictured else [], self.beside[name], mask=statement == "map_d")
            for statement in _PICTURES
        )
        try:
            return mtl(words, MtlPictures(*pictures), self.notices)
        except (ValueError, SceneError) as error:
            self.notices.miss(f"material {name}", str(error))
            return None

    def _names(self, line: str) -> list[str]:
        """Return the file names in a line: the whole line if a file of this name exists, else its words."""
        try:
            self.folder.find(line)
        except (OSError, SceneError):
            return line.split()
        return [line]

    def _picture(self, words: list[str], beside: Path, *, mask: bool = False) -> Picture | None:
        """Return the picture of a statement; with `mask` its alpha, where it has some."""
        if not words:
            return None
        statement = picture_words(words)
        for option in statement.options:
            if option not in ("-clamp", "-s", "-o"):
                self.notices.ignore(f"{option} of pictures")
        wrap: Wrap = "clamp" if statement.options.get("-clamp") == ["on"] else "repeat"
        find = partial(self.folder.find, statement.file, beside)
        read = partial(self.pictures.get, (beside, statement.file), statement.file, find, wrap=wrap)
        read = partial(read, transform=statement.transform)
        picture = read(alpha=mask)
        return read(alpha=False) if mask and picture is None else picture


def _plain(path: Path, data: bytes, notices: Notices, materials: bool, multiscatter: bool) -> Contents:
    """Return the meshes of an STL or OFF file, which has no materials."""
    is_stl = path.suffix.lower() == ".stl"
    meshes = read_stl(data, path.stem, notices) if is_stl else [read_off(data, path.stem, notices)]
    return Contents([mesh.with_material(CLAY) for mesh in meshes] if materials else meshes)


def _ply(path: Path, data: bytes, notices: Notices, materials: bool, multiscatter: bool) -> Contents:
    folder, pictures = Folder(path), Pictures(notices)
    meshes: list[Mesh] = []
    for mesh, picture in read_ply(data, path.stem, notices):
        painted = _painted(mesh, picture, folder, pictures) if materials else mesh
        meshes.append(replace(painted, name=f"{path.stem}_{len(meshes)}") if meshes else painted)
    return Contents(meshes)


def _painted(mesh: Mesh, name: str | None, folder: Folder, pictures: Pictures) -> Mesh:
    """Return the mesh with the picture of this name, or with a material that suits it without one."""
    notices = pictures.notices
    if name is not None and mesh.uv is None:
        notices.ignore("pictures of meshes without uv coordinates")
    picture = None
    if name is not None and mesh.uv is not None:
        picture = pictures.get(name, name, lambda: folder.find(name))
    if picture is None:
        return mesh.with_material(CLAY if mesh.colors is None else PLAIN)
    notices.ignore("colours of meshes with a picture", int(mesh.colors is not None))
    return replace(mesh, colors=None, material=Material(picture.color(WHITE), specular=0.0))


_READERS: dict[str, Any] = {".obj": _obj, ".ply": _ply, ".stl": _plain, ".off": _plain}
