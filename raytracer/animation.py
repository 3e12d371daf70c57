"""Animations: render the scenes that a function of time returns to a GIF, WebP or MP4 file or a folder of PNGs.

Stage: picture. Frame k shows the scene at the time k / fps, in seconds. `sh.videos` writes the frames. All arguments
are checked before the first frame is rendered.

    for done in animate(lambda time: scene_at(time), "wave.gif", frames=48, fps=24):
        print(done)
"""

from __future__ import annotations

import math
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import Any, Final, Unpack

import numpy as np
from numpy.typing import NDArray

import shpy as sh
from raytracer.appearance.materials import Material
from raytracer.backends import chosen_backend
from raytracer.cluster import tasks
from raytracer.cluster.connection import connected
from raytracer.cluster.job import check_alike, probed
from raytracer.cluster.tasks import kept
from raytracer.errors import SceneError
from raytracer.image import srgb_bytes
from raytracer.integrators.integrator import Choice, Integrator, Options, chosen
from raytracer.integrators.layers import checked_size
from raytracer.integrators.renderer import Renderer
from raytracer.meshes.shapes import box, floor, sphere
from raytracer.scene.camera import Camera
from raytracer.scene.lights import PointLight
from raytracer.scene.scene import Scene
from raytracer.tone_mapping import Tonemap, checked_curve

Make = Callable[[float], Scene]


def animate(
    make: Make,
    output: str | PathLike[str],
    frames: int,
    *,
    fps: float = sh.videos.FPS,
    size: tuple[int, int] = (512, 512),
    integrator: Choice = "whitted",
    backend: str | None = None,
    resume: bool = False,
    cluster: Any = None,
    exposure: float | None = None,
    tonemap: Tonemap = "none",
    **options: Unpack[Options],
) -> Iterator[int]:
    """Render `frames` frames to `output`: .gif, .webp, .mp4, or else a folder; yield how many are done after each.

    `make(time)` gives the scene at a time in seconds. Where frames differ only in their cameras and in places, normals
    and colours at the vertices of meshes, accelerators of what stays and the kernel are kept; see `Renderer.show`.
    `resume` keeps the frames that a folder has. With a `cluster`, as in `render`, frames are rendered by its workers,
    to which `make` travels. `exposure` and `tonemap` are those of `Image.save`, the other arguments those of `render`.
    The file is written when the iterator ends. Raises SceneError for numbers and outputs that make no animation, where
    ffmpeg is missing for an .mp4 file, and as `render` does.
    """
    size = checked_size(size)
    look = exposure or 0.0, checked_curve(tonemap)
    drawing = _Drawing(make, size, fps, chosen(integrator, options), chosen_backend(backend), look)
    mapping = map if cluster is None else _by_workers(drawing, cluster)
    with _as_scene_errors():
        steps = sh.videos.writing(Path(output), frames, fps, size, drawing.frame, resume=resume, mapping=mapping)
    return _checked(steps)


def _checked(steps: Iterator[int]) -> Iterator[int]:
    with _as_scene_errors():
        yield from steps


@contextmanager
def _as_scene_errors() -> Iterator[None]:
    """Say what cannot be written as the ray tracer says everything that is wrong with what it is given."""
    try:
        yield
    except sh.videos.VideoError as error:
        raise SceneError(str(error)) from error


class _Drawing:
    """The frames, drawn by one Renderer that is made with the first of them."""

    def __init__(
        self,
        make: Make,
        size: tuple[int, int],
        fps: float,
        integrator: Integrator,
        backend: str,
        look: tuple[float, str],
    ) -> None:
        self.make, self.size, self.fps, self.integrator, self.backend = make, size, fps, integrator, backend
        self.look = look
        self.renderer: Renderer | None = None

    def frame(self, number: int) -> NDArray[np.uint8]:
        """Return the pixels of a frame in sRGB."""
        time = number / self.fps
        scene = _checked_scene(self.make(time), time)
        if self.renderer is None:
            self.renderer = Renderer(scene, integrator=self.integrator, backend=self.backend)
        else:
            self.renderer.show(scene)
        return srgb_bytes(self.renderer.render(self.size).pixels, *self.look)


def _by_workers(drawing: _Drawing, cluster: Any) -> Callable[..., Iterator[Any]]:
    """Return the function that draws frames by the workers of a cluster, to the same bits; it takes what `map` does."""

    def mapping(_: Any, numbers: Sequence[int]) -> Iterator[Any]:
        if not numbers:
            return
        before = None
        with connected(cluster) as client, tasks.scattered(client, drawing) as sent:
            for digest, pixels in tasks.in_order(client, _frame, numbers, sent, tasks.key_of(drawing)):
                before = check_alike(before, digest, drawing.integrator, drawing.backend)
                yield pixels

    return mapping


def _frame(drawing: _Drawing, key: str, number: int) -> tuple[str, Any]:
    """Return the `probed` of a worker and the pixels of a frame, which it draws with the first drawing of this key."""
    with kept(key, lambda: (drawing, probed(drawing.backend, drawing.integrator))) as (here, digest):
        return digest, here.frame(number)


def spread(seconds: float, frames: int | None, fps: float | None) -> tuple[int, float]:
    """Return the number of frames of an animation and its frames per second; one that is None follows from the other.

    Raises SceneError where a second has 0 frames, or more than 1000.
    """
    if fps is None:
        fps = frames / seconds if frames and seconds > 0 else sh.videos.FPS
    with _as_scene_errors():
        sh.videos.check_pace(fps)
    return frames or max(1, round(seconds * fps)), fps


def made_by(path: Path) -> Make:
    """Return the function `scene` that a Python file defines; SceneError for a file without one, or with mistakes."""
    if not path.is_file():
        raise SceneError(f"there is no file {path}")
    return SceneFunction(path, path.read_bytes())


class SceneFunction:
    """The function `scene` of a Python file, which may import modules of its folder; pickled as the file's text."""

    def __init__(self, path: Path, text: bytes, folder: str | None = None) -> None:
        self.path, self.text, self.folder = path, text, folder or str(path.resolve().parent)
        sh.files.import_from(self.folder)
        module = ModuleType(str(path.resolve()))  # no importable module has this name
        module.__file__ = str(path)
        sys.modules[module.__name__] = module  # where dataclasses look for the names in annotations
        try:
            exec(compile(text, str(path), "exec"), vars(module))  # the user's own file
        except Exception as error:
            raise _mistake(path, error) from error
        self.make = getattr(module, "scene", None)
        if not callable(self.make):
            raise SceneError(f"{path} defines no function scene: def scene(time): return raytracer.Scene(...)")

    def __reduce__(self) -> Any:
        return SceneFunction, (self.path, self.text, self.folder)

    def __call__(self, time: float) -> Scene:
        """Return the scene of a time; SceneError where the function fails or gives something else."""
        assert callable(self.make)  # else it would not have been made
        try:
            scene: Scene = self.make(time)
        except Exception as error:
            raise _mistake(self.path, error) from error
        return _checked_scene(scene, time, f"{self.path}: ")


def _checked_scene(scene: Any, time: float, where: str = "") -> Scene:
    if not isinstance(scene, Scene):
        raise SceneError(f"{where}scene({time:g}) returns {type(scene).__name__}, not a raytracer.Scene")
    return scene


@contextmanager
def mistakes_in(path: Path) -> Iterator[None]:
    """Make a SceneError, with the line, of an exception in a user's file; errors of shpy name the line already."""
    try:
        yield
    except (SceneError, sh.ShpyError):
        raise
    except Exception as error:
        if _line_in(path, error) is None:
            raise
        raise _mistake(path, error) from error


def _mistake(path: Path, error: Exception) -> SceneError:
    """Return the error of a user's file with the last line of it that took part, if there is one."""
    line = _line_in(path, error)
    place = path if line is None else f"{path}:{line}"
    text = traceback.TracebackException(type(error), error, None)  # safe if its __str__ raises
    return SceneError(f"{place}: {type(error).__name__}: {text}")


def _line_in(path: Path, error: Exception) -> int | None:
    """Return the last line of a file that took part in an error; None if there is none."""
    line, trace = getattr(error, "lineno", None), error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = trace.tb_lineno
        trace = trace.tb_next
    return line


def animated(time: float) -> Scene:
    """Return a box that turns and a ball that bounces and is squeezed."""
    height = abs(math.sin(math.pi * time))
    squeezed = 1 - 0.35 * max(0.0, 1 - 5 * height)
    ball = sphere(0.7, Material((0.8, 0.3, 0.15), specular=0.5), rings=24, segments=48)
    ball = ball.transformed(np.diag([squeezed**-0.5, squeezed, squeezed**-0.5, 1.0]))
    meshes: Sequence[Any] = (
        box((1.2, 1.2, 1.2), Material((0.15, 0.35, 0.7), reflectivity=0.2)).moved((1.3, 0.6, 0), turn=45 * time),
        ball.moved((-1.1, 0.7 * squeezed + 1.6 * height, 0.3)),
        floor(14, Material((0.5, 0.49, 0.46), specular=0.0, reflectivity=0.15)),
    )
    lights = (PointLight((-5, 8, 5), (0.85, 0.8, 0.72)), PointLight((7, 5, 2), (0.26, 0.3, 0.38)))
    return Scene(meshes, lights, Camera((1.5, 2.6, 7), (0, 1, 0), fov=42), name="animated")


ANIMATIONS: Final[dict[str, Make]] = {"animated": animated}
"""The built-in animations."""
