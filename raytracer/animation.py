"""Animations: the pictures of scenes that a function of time gives, as a GIF, WebP or MP4 file or a folder of PNGs.

Stage: picture. Frame k shows the scene at the time k / fps, in seconds. Everything is checked before a frame is made;
a file is written under a temporary name and renamed.

    for done in animate(lambda time: scene_at(time), "wave.gif", frames=48, fps=24):
        print(done)
"""

from __future__ import annotations

import math
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any, Final, Unpack

import numpy as np

import shpy as sh
from raytracer.appearance.materials import Material
from raytracer.errors import SceneError
from raytracer.image import Image, writer
from raytracer.integrators.integrator import Given, Options
from raytracer.integrators.renderer import Renderer, checked_size
from raytracer.meshes.shapes import box, floor, sphere
from raytracer.scene.camera import Camera
from raytracer.scene.lights import PointLight
from raytracer.scene.scene import Scene

Make = Callable[[float], Scene]

VIDEOS: Final = (".gif", ".webp", ".mp4")
FPS: Final = 24.0
"""Frames of a second, where nobody asks for others."""


def animate(
    make: Make,
    output: str | PathLike[str],
    frames: int,
    *,
    fps: float = FPS,
    size: tuple[int, int] = (512, 512),
    integrator: Given = "whitted",
    backend: str | None = None,
    resume: bool = False,
    **options: Unpack[Options],
) -> Iterator[int]:
    """Render `frames` frames to `output`: .gif, .webp, .mp4, or else a folder; yield how many are done after each.

    `make(time)` gives the scene at a time in seconds. Where frames differ only in their cameras and in places, normals
    and colours at the vertices of meshes, accelerators of what stays and the kernel are kept; see `Renderer.show`.
    `resume` keeps the frames that a folder has. The other arguments are those of `render`. The file is written when
    the iterator ends. Raises SceneError for numbers and outputs that make no animation, where ffmpeg is missing for an
    .mp4 file, and as `render` does.
    """
    path, size = Path(output), checked_size(size)
    if not (isinstance(frames, int) and frames > 0):
        raise SceneError(f"an animation has one frame or more, not {frames}")
    _check_pace(fps)
    if path.suffix.lower() not in VIDEOS and path.suffix:
        raise SceneError(
            f"{path}: animations are written as {', '.join(VIDEOS)} or into a folder, not as {path.suffix}"
        )
    drawn = _Drawing(make, size, fps, {"integrator": integrator, "backend": backend, **options})
    if not path.suffix:
        return _into_folder(drawn, path, frames, resume)
    if resume:
        raise SceneError(f"{path}: frames are resumed in a folder of PNG files alone")
    sh.files.check_writable(path)
    if path.suffix.lower() == ".mp4":
        return _as_mp4(drawn, path, frames, _ffmpeg(path, size))
    return _as_picture(drawn, path, frames)


def _check_pace(fps: float) -> None:
    if not 0 < fps <= 1000:
        raise SceneError(f"an animation has more than 0 and at most 1000 frames a second, not {fps}")


class _Drawing:
    """The frames, drawn by one Renderer that is made with the first of them."""

    def __init__(self, make: Make, size: tuple[int, int], fps: float, options: dict[str, Any]) -> None:
        self.make, self.size, self.fps, self.options = make, size, fps, options
        self.renderer: Renderer | None = None

    def frame(self, number: int) -> Image:
        """Return the picture of a frame."""
        scene = self.make(number / self.fps)
        if not isinstance(scene, Scene):
            raise SceneError(f"scene({number / self.fps:g}) gives a {type(scene).__name__}, not a raytracer.Scene")
        if self.renderer is None:
            self.renderer = Renderer(scene, **self.options)
        else:
            self.renderer.show(scene)
        return self.renderer.render(self.size)


def _into_folder(drawn: _Drawing, folder: Path, frames: int, resume: bool) -> Iterator[int]:
    digits = max(4, len(str(frames - 1)))
    if folder.exists() and not folder.is_dir():
        raise SceneError(f"{folder} is a file: name a folder, or a .gif, .webp or .mp4 file")
    folder.mkdir(exist_ok=True)
    paths = [folder / f"{number:0{digits}}.png" for number in range(frames)]
    writer(paths[0], drawn.size)

    def run() -> Iterator[int]:
        for number, path in enumerate(paths):
            if not (resume and path.exists()):
                drawn.frame(number).save(path)
            yield number + 1

    return run()


def _as_picture(drawn: _Drawing, path: Path, frames: int) -> Iterator[int]:
    """Write a GIF or WebP file by Pillow, once all frames are drawn; it repeats for ever."""
    try:
        from PIL import Image as pillow
    except ImportError as error:
        raise SceneError(f"writing {path.suffix} needs Pillow: {sh.packages.install('pillow')}") from error
    kind = path.suffix[1:].upper()
    unit = 10 if kind == "GIF" else 1  # milliseconds
    ends = [round(number * 1000 / drawn.fps / unit) * unit for number in range(frames + 1)]
    lasting = [max(end - start, unit) for start, end in pairwise(ends)]

    def run() -> Iterator[int]:
        held = []
        for number in range(frames):
            held.append(pillow.fromarray(drawn.frame(number).srgb))
            if number + 1 < frames:
                yield number + 1
        with sh.files.replacing(path) as temporary:
            held[0].save(str(temporary), kind, save_all=True, append_images=held[1:], duration=lasting, loop=0)
        yield frames

    return run()


def _ffmpeg(path: Path, size: tuple[int, int]) -> str:
    """Return the program that writes MP4; SceneError where there is none, or it cannot write this size."""
    found = shutil.which("ffmpeg")
    if found is None:
        raise SceneError(
            f"{path}: .mp4 files are written by ffmpeg, which is not installed: write a .webp or .gif file"
        )
    if size[0] % 2 or size[1] % 2:
        raise SceneError(f"an .mp4 file has an even width and height, not {size[0]} x {size[1]}")
    return found


def _as_mp4(drawn: _Drawing, path: Path, frames: int, ffmpeg: str) -> Iterator[int]:
    """Write an MP4 file: frames go to ffmpeg as they are drawn."""
    width, height = drawn.size
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{drawn.fps:g}", "-i", "-"]
    made = ["-an", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4"]
    with sh.files.replacing(path) as temporary:
        words = [ffmpeg, "-y", "-loglevel", "error", *given, *made, str(temporary)]
        with subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            assert process.stdin is not None
            assert process.stderr is not None
            try:
                for number in range(frames):
                    process.stdin.write(np.ascontiguousarray(drawn.frame(number).srgb).tobytes())
                    if number + 1 < frames:
                        yield number + 1
                process.stdin.close()
            except BrokenPipeError:
                pass  # it says why
            except BaseException:
                process.kill()
                raise
            said = process.stderr.read().decode(errors="replace").strip()
        if process.returncode:
            raise SceneError(f"{path}: ffmpeg failed: {said or process.returncode}")
    yield frames


def spread(seconds: float, frames: int | None, fps: float | None) -> tuple[int, float]:
    """Return how many frames show so many seconds, and the frames of a second; one that is None suits the other.

    Raises SceneError where a second has 0 frames, or more than 1000.
    """
    if fps is None:
        fps = frames / seconds if frames and seconds > 0 else FPS
    _check_pace(fps)
    return frames or max(1, round(seconds * fps)), fps


def made_by(path: Path) -> Make:
    """Return the function `scene` that a Python file defines; SceneError for a file without one, or with mistakes."""
    if not path.is_file():
        raise SceneError(f"there is no file {path}")
    names: dict[str, Any] = {"__name__": "scene", "__file__": str(path)}
    try:
        exec(compile(path.read_bytes(), str(path), "exec"), names)  # the user's own file
    except Exception as error:
        raise _mistake(path, error) from error
    make = names.get("scene")
    if not callable(make):
        raise SceneError(f"{path} defines no function scene: def scene(time): return raytracer.Scene(...)")

    def checked(time: float) -> Scene:
        try:
            found: Scene = make(time)
            return found
        except Exception as error:
            raise _mistake(path, error) from error

    return checked


def _mistake(path: Path, error: Exception) -> SceneError:
    """Return the error of a user's file with the last line of it that took part."""
    line, trace = getattr(error, "lineno", None), error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = trace.tb_lineno
        trace = trace.tb_next
    return SceneError(f"{path}:{line}: {type(error).__name__}: {error}")


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
