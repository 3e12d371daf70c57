"""A scene: meshes, lights, a camera, and what is seen where nothing is.

Stage: scene description. Everything that `render` needs but the size of the picture.

>>> scene = Scene.builtin("boxes")
>>> scene.triangles, len(scene.lights)
(36, 2)
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance.materials import Triple
from raytracer.appearance.metallic_roughness import AnyMaterial
from raytracer.appearance.textures import Texture
from raytracer.arrays import finite_triple
from raytracer.errors import SceneError
from raytracer.meshes.folder import Notices, named
from raytracer.meshes.from_trimesh import parts_of
from raytracer.meshes.mesh import Instance, Mesh, placed_all
from raytracer.scene.camera import Camera, checked_camera
from raytracer.scene.framing import bounds_of, fitted, ground, lights_for, upright
from raytracer.scene.gltf_cameras import chosen_camera
from raytracer.scene.lights import EnvironmentLight, Light, PlacedLight
from raytracer.scene.loading import Contents, load_contents

Background = Triple | Texture | Callable[..., Any]
"""The light that rays see where they meet nothing: a colour, a picture of all directions, or a program of them."""
BACKGROUND: Triple = (0.42, 0.52, 0.66)


@dataclass(frozen=True, eq=False)
class Scene:
    """Meshes under lights before a background, all colours linear RGB.

    `meshes` is a Mesh, an `Instance`, a trimesh.Trimesh or trimesh.Scene, or several of them; a Scene keeps a tuple of
    meshes, in order, whose places are the object ids of pictures. Of a trimesh.Scene it takes the shapes with their
    materials, and neither lights nor camera. `ambient` is the share of a surface's colour that is seen without any
    light. Without a camera one is framed that sees every mesh.

    `background` is what rays see that meet nothing, also those from mirrors and through glass: a colour (r, g, b); a
    `Texture`, which is an equirectangular picture (a latitude-longitude map); or a program from a unit `direction`, an
    sh.Vector3f, to an sh.Color3f. The middle of a picture lies in the direction (0, 0, -1), its right half in that of
    x, and its top row in that of y, as in an `EnvironmentLight`; its `wrap` has no effect, since columns wrap around. A
    background is no light: no shadow ray is sent to it. A scene may be empty: its picture is the background, which is a
    colour then.

    With `integrator="path"` there is no ambient light, and rays that matt surfaces scatter see the background by way of
    mirrors and glass alone. An `EnvironmentLight` takes the place of the background and of the ambient light, so that
    no light counts twice.

    Raises SceneError for meshes of another kind, backgrounds and ambients that make no sense. Source of the picture as
    a background: Bürger and others 2007, section 2.1.
    """

    meshes: Any = ()
    lights: Sequence[Light] = ()
    camera: Camera | None = None
    background: Background = BACKGROUND
    ambient: float = 0.12
    name: str = "scene"

    def __post_init__(self) -> None:
        object.__setattr__(self, "meshes", placed(self.meshes))
        object.__setattr__(self, "lights", _lights(self.lights))
        object.__setattr__(self, "background", _background(self.background))
        if not (isinstance(self.ambient, float | int | np.number) and 0 <= self.ambient <= 1):
            raise SceneError(f"ambient lies in [0, 1], not {self.ambient!r}")
        if sum(isinstance(light, EnvironmentLight) for light in self.lights) > 1:
            raise SceneError("a scene has at most one EnvironmentLight")
        if self.camera is None:
            object.__setattr__(self, "camera", fitted(self.meshes, np.eye(3)))
        checked_camera(self.camera)

    @property
    def triangles(self) -> int:
        """The number of triangles."""
        return sum(len(mesh) for mesh in self.meshes)

    @property
    def names(self) -> list[str]:
        """The names of the meshes, in the order of the object ids."""
        return [mesh.name for mesh in self.meshes]

    def __repr__(self) -> str:
        lights = f"{len(self.lights)} light{'' if len(self.lights) == 1 else 's'}"
        return f"<Scene {self.name}: {named(self.names) or 'no meshes'}; {self.triangles:,} triangles, {lights}>"

    def with_material(self, name: str, material: AnyMaterial) -> Scene:
        """Return the scene with another material for all meshes of this name; SceneError if there are none."""
        if name not in self.names:
            raise SceneError(f"{self.name} has no mesh {name!r}: its meshes are {named(self.names) or 'no meshes'}")
        meshes = [mesh.with_material(material) if mesh.name == name else mesh for mesh in self.meshes]
        return dataclasses.replace(self, meshes=meshes)

    @property
    def placed_lights(self) -> list[PlacedLight]:
        """The lights but the environment's."""
        return [light for light in self.lights if not isinstance(light, EnvironmentLight)]

    @property
    def environment(self) -> EnvironmentLight | None:
        """The light from around the scene, if there is one."""
        return next((light for light in self.lights if isinstance(light, EnvironmentLight)), None)

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The corners of the box round all triangles; the unit cube about the origin for an empty scene."""
        return bounds_of(self.meshes, np.eye(3))

    @classmethod
    def framed(
        cls,
        meshes: Any,
        name: str | None = None,
        *,
        up: Triple = (0, 1, 0),
        floor: bool = True,
        lights: Sequence[Light] = (),
        camera: Camera | Callable[[Camera], Camera] | None = None,
    ) -> Scene:
        """Put one mesh or several on a mirroring floor under two lights, with a camera that sees all of them.

        The floor is the last mesh of the scene; without `floor` there is none. `up` is the direction in the meshes'
        coordinates from the floor to them. `lights` take the place of the two. `camera` is another camera, or a
        function of the default camera; where meshes enclose it, the two lights are inside. Raises SceneError for meshes
        without triangles, for too large ones, and for an `up` that is no direction.
        """
        parts = placed(meshes)
        name = name or next((mesh.name for mesh in parts), "scene")
        if not any(map(len, parts)):
            raise SceneError(f"{name}: a mesh without triangles cannot be framed")
        turn = upright(up)
        low, high = bounds_of(parts, turn)
        eye = _camera(camera, fitted(parts, turn))
        shining = lights or lights_for(name, parts, eye, turn)
        under = [ground(low, high, turn)] if floor else []
        return cls((*parts, *under), shining, eye, name=name)

    @classmethod
    def load(
        cls,
        path: str | PathLike[str],
        *,
        up: Triple = (0, 1, 0),
        floor: bool = True,
        lights: Sequence[Light] = (),
        camera: Camera | Callable[[Camera], Camera] | str | int | None = None,
        strict: bool = False,
        variant: str | None = None,
        multiscatter: bool = False,
    ) -> Scene:
        """Read the parts of an OBJ, GLB, glTF, PLY, STL or OFF file, with their names and materials.

        A file with a camera or lights is shown as it says; two lights are added to a file without lights, and a camera
        that sees everything to a file without cameras. Other files are framed: `up`, `floor` and `camera` are those of
        `framed`; a name or a number chooses one of the file's cameras, of which the first is taken otherwise. `lights`
        are added to those of the file, and take the place of the two. `variant` is the name of one of a glTF file's
        variants of materials. With `multiscatter` each `MetallicRoughness` of the file has it. docs/raytracer-files.md
        lists what is read; other contents of a file, and missing pictures, cause an sh.ShpyWarning each. A bad
        entry, such as a face that names a normal that the file lacks, is left out; a warning counts them. With `strict`
        bad entries and pictures that are not there are errors. Raises FileNotFoundError, and SceneError for a file that
        cannot be read or holds no triangles, for a camera or a variant that it does not have, and for `multiscatter`
        where it has no such material.
        """
        contents = load_contents(path, strict=strict, variant=variant, multiscatter=multiscatter)
        which = camera if isinstance(camera, str | int) else None
        eye = None if isinstance(camera, str | int) else camera
        return furnished(contents, Path(path).stem, up=up, floor=floor, lights=lights, camera=eye, which=which)

    @classmethod
    def builtin(cls, name: str) -> Scene:
        """Return one of the scenes that the package makes itself.

        Raises SceneError for an unknown name; the message lists the known ones.
        """
        if name not in BUILTIN:
            raise SceneError(f"there is no scene {name!r}; the known ones are {', '.join(BUILTIN)}")
        return BUILTIN[name]()


def furnished(
    contents: Contents,
    name: str,
    *,
    up: Triple = (0, 1, 0),
    floor: bool = True,
    lights: Sequence[Light] = (),
    camera: Camera | Callable[[Camera], Camera] | None = None,
    which: str | int | None = None,
) -> Scene:
    """Return the scene of a file's contents, with what they lack; see `Scene.load`.

    `which` is the name or the number of one of its cameras, None for the first.
    """
    own = chosen_camera(contents.cameras, which, contents.file)
    if own is None and not contents.lights:
        return Scene.framed(contents.meshes, name, up=up, floor=floor, lights=lights, camera=camera)
    turn = upright(up)
    eye = _camera(camera, own or fitted(contents.meshes, turn))
    shining = (*contents.lights, *lights) or lights_for(name, contents.meshes, eye, turn)
    return Scene(contents.meshes, shining, eye, name=name)


def _background(value: Any) -> Background:
    """Return the background of a scene, a colour as three floats; SceneError for anything but the three kinds."""
    if isinstance(value, Texture) and value.transform is not None:
        raise SceneError("a background fills the picture or surrounds the scene: its Texture has no transform")
    if isinstance(value, Texture) or callable(value):
        background: Background = value
        return background
    if isinstance(value, str | PathLike):
        raise SceneError(
            f"a background is a colour (r, g, b), a Texture or a program, not {str(value)!r}: "
            f"Texture({str(value)!r}) reads a picture"
        )
    if isinstance(value, np.ndarray) and value.ndim > 1:
        raise SceneError("a background is a colour (r, g, b), a Texture or a program, not an array: Texture(array)")
    if isinstance(value, EnvironmentLight):
        raise SceneError(
            "a background is a colour (r, g, b), a Texture or a program: an EnvironmentLight is one of the lights"
        )
    return finite_triple("a background", value)


def _lights(value: Any) -> tuple[Light, ...]:
    """Return the lights of a scene; SceneError for anything but lights in a list or another iterable."""
    lights = tuple(value) if isinstance(value, Iterable) else (None,)
    if not all(isinstance(light, Light) for light in lights):
        kinds = "PointLight, SpotLight, DirectionalLight or EnvironmentLight"
        raise SceneError(f"the lights of a scene are a list of lights, each a {kinds}, not {value!r}")
    return lights


def _camera(camera: Camera | Callable[[Camera], Camera] | None, default: Camera) -> Camera:
    """Return `camera`, or what it makes of `default` where it is a function; `default` where it is None."""
    return checked_camera(camera(default) if callable(camera) else default if camera is None else camera)


def placed(things: Any) -> tuple[Mesh, ...]:
    """Return the meshes of a Mesh, Instance, trimesh.Trimesh or trimesh.Scene, or of several of them, in order.

    Raises SceneError for anything else, and where the triangles exceed the memory.
    """
    single = isinstance(things, Mesh | Instance) or _of_trimesh(things)
    if not single and (isinstance(things, str | bytes) or not isinstance(things, Iterable)):
        raise _stranger(things)
    parts = [part for thing in ([things] if single else things) for part in _parts(thing)]
    return tuple(placed_all(parts))


def _parts(thing: Any) -> Iterator[Mesh | Instance]:
    if isinstance(thing, Mesh | Instance):
        yield thing
    elif _of_trimesh(thing):
        notices = Notices(f"trimesh.{type(thing).__name__}")
        yield from parts_of(thing, notices)
        notices.warn()
    else:
        raise _stranger(thing)


def _of_trimesh(thing: Any) -> bool:
    """Return True for a mesh or scene of trimesh. Who has one has imported trimesh, so this imports nothing."""
    trimesh = sys.modules.get("trimesh")
    return trimesh is not None and isinstance(thing, trimesh.Trimesh | trimesh.Scene)


def _stranger(thing: Any) -> SceneError:
    cure = "; Scene.load reads a file" if isinstance(thing, str) or hasattr(thing, "__fspath__") else ""
    kinds = "a Mesh, Instance, trimesh.Trimesh or trimesh.Scene, or several of them"
    return SceneError(f"a scene is made of {kinds}, not of {type(thing).__name__} {str(thing)[:60]!r}{cure}")


BUILTIN: dict[str, Callable[[], Scene]] = {}
"""The built-in scenes by name. They need Scene, so `raytracer` enters them."""
