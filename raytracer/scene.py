"""A scene: meshes, lights, a camera, and what is seen where nothing is.

Stage: scene description. Everything that `render` needs but the size of the picture.

>>> scene = Scene.builtin("boxes")
>>> scene.triangles, len(scene.lights)
(36, 2)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike

import numpy as np
from numpy.typing import NDArray

from raytracer.camera import Camera, radius_of
from raytracer.errors import SceneError
from raytracer.lights import EnvironmentLight, Light, PlacedLight, PointLight
from raytracer.materials import Material, Triple
from raytracer.meshes import Mesh
from raytracer.meshes.shapes import floor

BACKGROUND: Triple = (0.42, 0.52, 0.66)
MIRROR_FLOOR = Material(color=(0.40, 0.39, 0.38), specular=0.0, reflectivity=0.22)
_LARGEST = 1e33
"""Radius of a mesh that can be framed: its floor is 400 times as large."""
CLAY = Material(color=(0.66, 0.40, 0.23), diffuse=0.9, specular=0.2, shininess=25)


@dataclass(frozen=True, eq=False)
class Scene:
    """Meshes under lights before a background, all colours linear RGB.

    `ambient` is the share of a surface's colour that is seen without any light. A scene may be empty: its picture is
    the background. Without a camera one is framed that sees every mesh.

    With `integrator="path"` there is no ambient light, and the background is seen, directly and in mirrors, but lights
    nothing: that is for an `EnvironmentLight`, which is then seen instead.
    """

    meshes: Sequence[Mesh] = ()
    lights: Sequence[Light] = ()
    camera: Camera | None = None
    background: Triple = BACKGROUND
    ambient: float = 0.12
    name: str = "scene"

    def __post_init__(self) -> None:
        object.__setattr__(self, "meshes", (self.meshes,) if isinstance(self.meshes, Mesh) else tuple(self.meshes))
        object.__setattr__(self, "lights", tuple(self.lights))
        if len(self.background) != 3 or not np.all(np.isfinite(self.background)):
            raise SceneError(f"a background is three finite numbers, not {self.background!r}")
        if not 0 <= self.ambient <= 1:
            raise SceneError(f"ambient lies in [0, 1], not {self.ambient}")
        if sum(isinstance(light, EnvironmentLight) for light in self.lights) > 1:
            raise SceneError("a scene has at most one EnvironmentLight")
        if self.camera is None:
            object.__setattr__(self, "camera", Camera.framing(*self.bounds))

    @property
    def triangles(self) -> int:
        """The number of triangles."""
        return sum(len(mesh) for mesh in self.meshes)

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
        used = [mesh.corners.reshape(-1, 3) for mesh in self.meshes if len(mesh)]
        if not used:
            return np.full(3, -0.5), np.full(3, 0.5)
        return np.min([u.min(axis=0) for u in used], axis=0), np.max([u.max(axis=0) for u in used], axis=0)

    @classmethod
    def framed(cls, mesh: Mesh, name: str | None = None) -> Scene:
        """A mesh on a mirroring floor under two lights, with a camera that sees all of it."""
        if not len(mesh):
            raise SceneError(f"{mesh.name}: a mesh without triangles cannot be framed")
        low, high = mesh.corners.min(axis=(0, 1)), mesh.corners.max(axis=(0, 1))
        middle, radius = (low + high) / 2, radius_of(low, high)
        if radius > _LARGEST:
            raise SceneError(f"{mesh.name}: a mesh of {2 * radius:.3g} across is too large to be framed; scale it")
        x, y, z = middle.tolist()
        ground = floor(400 * radius, MIRROR_FLOOR).moved((x, float(low[1]) - 1e-4 * radius, z))
        lights = (
            PointLight((x - 3 * radius, y + 5 * radius, z + 4 * radius), (0.85, 0.82, 0.76)),
            PointLight((x + 5 * radius, y + 3 * radius, z + 2.5 * radius), (0.30, 0.34, 0.42)),
        )
        camera = Camera.framing(low, high)
        return cls((mesh, ground), lights, camera, name=name or mesh.name)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Scene:
        """The mesh of an OBJ, PLY, STL or GLB file, framed (see `framed`).

        Raises FileNotFoundError, and SceneError for a file that holds no mesh.
        """
        mesh = Mesh.load(path)
        # A file without colours shows the default material; clay is friendlier than white.
        return cls.framed(mesh if mesh.colors is not None else mesh.with_material(CLAY))

    @classmethod
    def builtin(cls, name: str) -> Scene:
        """One of the scenes that the package makes itself; SceneError names them all when `name` is none of them."""
        from raytracer.scenes import SCENES

        if name not in SCENES:
            raise SceneError(f"there is no scene {name!r}; the known ones are {', '.join(SCENES)}")
        return SCENES[name]()
