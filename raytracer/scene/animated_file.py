"""The scenes of a glTF file whose own animation moves its nodes and deforms its meshes.

Stage: scene description. The file is read once; a pose changes the matrices of its parts and the shapes of those with
skins or morph targets, and the floor, the lights and the camera that it lacks suit all frames.

    file = AnimatedFile("walk.glb", "Walk")
    make = file.make(frames=48, fps=24)
    make(0.5)  # a Scene
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raytracer.errors import SceneError
from raytracer.meshes.folder import Folder, Notices, named, shown
from raytracer.meshes.gltf import Document
from raytracer.meshes.gltf_animation import Clip, names_of
from raytracer.meshes.mesh import Instance, Mesh
from raytracer.scene.camera import Camera
from raytracer.scene.framing import bounds_of, outermost
from raytracer.scene.gltf_cameras import NamedCamera, chosen_camera
from raytracer.scene.gltf_scene import GltfScene
from raytracer.scene.lights import Light
from raytracer.scene.loading import Contents, bytes_of, check_microfacets, reading
from raytracer.scene.scene import Scene, furnished

Corner = NDArray[np.float64]
ANIMATED: Final = (".glb", ".gltf")
"""The formats whose animations are read."""
_FRAMED: Final = 2048
"""The most frames for which a scene is framed; a longer animation has this number of them, spread evenly."""
_CURE: Final = "render it still with `raytracer render`, or move its meshes with a Python file that defines scene(time)"


class _Frame(NamedTuple):
    """A scene whose camera, lights and floor suit all frames, and the box round what moves in them."""

    scene: Scene
    floor: tuple[Mesh, ...]
    low: Corner
    high: Corner


class AnimatedFile:
    """A GLB or glTF file with one of its animations: that with the name `clip`, or the first for None.

    `strict`, `variant` and `multiscatter` are those of `Scene.load`.
    `seconds` is the length of the animation. A feature of the file that is ignored gives an sh.ShpyWarning. Raises
    FileNotFoundError, and SceneError for a file that cannot be read, that has no animation of this name, or whose
    animation changes anything but nodes and the weights of morph targets.
    """

    def __init__(
        self,
        path: str | PathLike[str],
        clip: str | None = None,
        *,
        strict: bool = False,
        variant: str | None = None,
        multiscatter: bool = False,
    ) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise FileNotFoundError(f"there is no file {self.path}")
        if self.path.suffix.lower() not in ANIMATED:
            raise SceneError(
                f"{self.path}: animations are read from {' and '.join(ANIMATED)} files, not from "
                f"{self.path.suffix or 'this'}: {_CURE}"
            )
        data, self._notices = bytes_of(self.path), Notices(self.path.name, strict=strict)
        with reading(self.path):
            document = Document(data, Folder(self.path))
            names = names_of(document)
        number = self._number(names, clip)
        with reading(self.path):
            self.clip = Clip(document, number)
        if self.clip.obstacle:
            others = [name for k, name in enumerate(names) if k != number]
            cure = f"choose another one ({named(others)}), or {_CURE}" if others else _CURE
            obstacle = f"its animation {shown(self.clip.name)!r} {self.clip.obstacle}"
            raise SceneError(f"{self.path}: {obstacle}; nodes and morph weights alone can change: {cure}")
        with reading(self.path):
            choices: dict[str, Any] = {"variant": variant, "multiscatter": multiscatter}
            self._scene = GltfScene(document, self.path.stem, self._notices, animated=True, **choices)
        self._multiscatter = multiscatter
        if clip is None:
            self._notices.ignore("animations after the first", len(names) - 1)
        self.seconds = self.clip.seconds
        self._last: list[tuple[Instance, Mesh]] = []

    def _number(self, names: list[str], clip: str | None) -> int:
        """Return the index of the animation `clip`, 0 for None; SceneError if the file has no such animation."""
        if not names:
            raise SceneError(f"{self.path}: the file has no animations: {_CURE}")
        if clip is not None and clip not in names:
            raise SceneError(f"{self.path}: there is no animation {clip!r}: choose one of {named(names)}")
        return 0 if clip is None else names.index(clip)

    def make(
        self,
        frames: int,
        fps: float,
        *,
        camera: Callable[[Camera], Camera] | None = None,
        lights: Sequence[Light] = (),
        which: str | int | None = None,
        **framing: Any,
    ) -> Callable[[float], Scene]:
        """Return the function that gives the scene at a time in seconds, framed once for the times k / fps.

        The first call frames it. A camera and lights of the file's own move with their nodes. The keywords are `up`,
        `floor`, `lights` and, as a function of the camera that there would be, `camera` of `Scene.load`; `which` is the
        name or the number of one of the file's cameras.
        """
        framed: list[_Frame] = []
        framing |= {"camera": camera, "lights": lights, "which": which}

        def scene(time: float) -> Scene:
            if not framed:
                framed.append(self._framed(frames, fps, framing))
                self._notices.warn()
            frame = framed[0]
            posed, meshes = self._posed(time)
            cameras, own = self._seen(posed, frame.low, frame.high)
            eye = chosen_camera(cameras, which, self.path.name)
            return dataclasses.replace(
                frame.scene,
                meshes=(*meshes, *frame.floor),
                camera=frame.scene.camera if eye is None else eye if camera is None else camera(eye),
                lights=(*own, *lights) if own else frame.scene.lights,
            )

        return scene

    def _framed(self, frames: int, fps: float, framing: dict[str, Any]) -> _Frame:
        """Return the first scene with the camera, the lights and the floor for all frames."""
        first, meshes = self._posed(0.0)
        if not meshes:
            raise SceneError(f"{self.path}: the file holds no triangles")
        if self._multiscatter:
            check_microfacets(self.path, meshes)
        corners, before = [outermost(meshes)], meshes
        some = min(frames, _FRAMED) - 1
        for k in range(1, some + 1):
            _, after = self._posed(k * (frames - 1) // some / fps)
            corners.append(outermost([mesh for mesh, last in zip(after, before, strict=True) if mesh is not last]))
            before = after
        places = np.concatenate(corners)
        # Triangles without area: they are in the box and before the camera, and no ray meets them.
        swept = Mesh(places, np.repeat(np.arange(len(places))[:, None], 3, axis=1))
        low, high = bounds_of([swept], np.eye(3))
        contents = Contents([*meshes, swept], *self._seen(first, low, high), self.path.name)
        scene = furnished(contents, self.path.stem, **framing)
        return _Frame(scene, scene.meshes[len(meshes) + 1 :], low, high)

    def _seen(self, posed: GltfScene, low: Corner, high: Corner) -> tuple[Sequence[NamedCamera], Sequence[Light]]:
        """Return the file's own cameras and lights in a pose; the box from `low` to `high` is that of all frames."""
        with reading(self.path):
            return posed.cameras(low, high), posed.lights((low + high) / 2)

    def _posed(self, time: float) -> tuple[GltfScene, list[Mesh]]:
        """Return the scene at a time and its meshes with triangles; those that have not moved are the same objects."""
        with reading(self.path):
            posed = self._scene.posed(self.clip.pose(time))
            parts = [part for part in posed.instances() if len(part.mesh)]
            before = self._last or [(part, part.placed) for part in parts]
            self._last = [
                (part, mesh if _alike(part, old) else part.placed)
                for part, (old, mesh) in zip(parts, before, strict=True)
            ]
        return posed, [mesh for _, mesh in self._last]


def _alike(part: Instance, old: Instance) -> bool:
    """Return whether a part has the shape and the place that it had before."""
    return part.mesh is old.mesh and np.array_equal(part.transform, old.transform)
