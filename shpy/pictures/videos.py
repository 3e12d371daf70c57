"""Frames on their way into a file: a GIF, WebP or MP4, or a folder of PNG files.

Stage: picture; `import shpy as sh` brings it as `sh.videos`, for whatever draws frames. Everything is checked before a
frame is drawn; a file is written under a temporary name and renamed.

    for done in sh.videos.writing(Path("wave.gif"), 48, 24.0, (64, 64), draw):
        print(done)
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shpy.errors import ShpyError, warn
from shpy.files import check_writable, replacing
from shpy.ir.constants import is_int
from shpy.packages import install

Draw = Callable[[int], NDArray[np.uint8]]
"""Gives the pixels of a frame by its number: (height, width, 3) bytes in sRGB."""
Mapping = Callable[[Draw, Sequence[int]], Iterator[NDArray[np.uint8]]]
"""Gives the pixels of the frames of these numbers, in order, as the function `map` does."""
_Drawn = Callable[[Sequence[int]], Iterator[NDArray[np.uint8]]]

VIDEOS: Final = (".gif", ".webp", ".mp4")
FPS: Final = 24.0
"""Frames of a second, where nobody asks for others."""
_MOST: Final = 1_000_000
"""Frames of an animation."""
_LASTING: Final = {"GIF": 655_350, "WEBP": 16_777_215}
"""The most milliseconds for which these formats can show a frame."""


class VideoError(ShpyError):
    """Frames cannot be written as they are asked for."""


def writing(
    path: Path,
    frames: int,
    fps: float,
    size: tuple[int, int],
    draw: Draw,
    *,
    resume: bool = False,
    mapping: Mapping = map,
) -> Iterator[int]:
    """Write `frames` frames of `size` (width, height) to a file or folder; yield how many are done after each.

    `resume` keeps the frames of this size that a folder has. `mapping` runs `draw` for all frames that are to be drawn.
    A file is written when the iterator ends. Raises VideoError at once for numbers and outputs that make no animation,
    and where Pillow, or ffmpeg for an .mp4 file, is missing; OSError for a path that cannot be written.
    """
    if not (is_int(frames) and frames > 0):
        raise VideoError(f"an animation has one frame or more, not {frames!r}")
    if frames > _MOST:
        raise VideoError(f"an animation has at most {_MOST:,} frames, not {frames:,}: choose fewer, or fewer a second")
    check_pace(fps)
    if path.suffix.lower() not in VIDEOS and path.suffix:
        raise VideoError(
            f"{path}: animations are written as {', '.join(VIDEOS)} or into a folder, not as {path.suffix}"
        )

    def drawn(numbers: Sequence[int]) -> Iterator[NDArray[np.uint8]]:
        return mapping(draw, numbers)

    if not path.suffix:
        return _into_folder(path, frames, size if resume else None, drawn)
    if resume:
        raise VideoError(f"{path}: frames are resumed in a folder of PNG files alone")
    check_writable(path)
    if path.suffix.lower() == ".mp4":
        return _as_mp4(path, frames, fps, size, drawn, _ffmpeg(path, size))
    return _as_picture(path, frames, fps, drawn)


def check_pace(fps: float) -> None:
    """Raise VideoError for a number of frames that no second has."""
    if not (isinstance(fps, float | int | np.number) and 0 < fps <= 1000):
        raise VideoError(f"an animation has more than 0 and at most 1000 frames a second, not {fps!r}")


def _pillow(ending: str) -> Any:
    try:
        from PIL import Image
    except ImportError as error:
        raise VideoError(f"writing {ending} needs Pillow: {install('pillow')}") from error
    return Image


def _into_folder(folder: Path, frames: int, kept: tuple[int, int] | None, drawn: _Drawn) -> Iterator[int]:
    """Write frames into a folder; those of the size `kept` that it has stay."""
    digits = max(4, len(str(frames - 1)))
    if folder.exists() and not folder.is_dir():
        raise VideoError(f"{folder} is a file: name a folder, or a .gif, .webp or .mp4 file")
    pillow = _pillow(".png")
    folder.mkdir(exist_ok=True)
    paths = [folder / f"{number:0{digits}}.png" for number in range(frames)]
    check_writable(paths[0])
    others = {path for path in folder.glob("*.png") if path.stem.isdecimal()} - set(paths)
    if others:
        warn(f"{folder} holds {len(others)} frames of another animation that have other numbers: they stay")

    def run() -> Iterator[int]:
        missing = [number for number, path in enumerate(paths) if kept is None or _size_of(pillow, path) != kept]
        pictures = drawn(missing)
        left = set(missing)
        for number, path in enumerate(paths):
            if number in left:
                pixels = next(pictures)
                picture = pillow.fromarray(np.ascontiguousarray(pixels))
                with replacing(path) as temporary:
                    picture.save(str(temporary), "PNG", optimize=True)
            yield number + 1

    return run()


def _size_of(pillow: Any, path: Path) -> tuple[int, int] | None:
    """Return the size of a picture, None if there is no file, or no whole picture in it."""
    try:
        with pillow.open(path) as picture:
            picture.verify()
            size: tuple[int, int] = picture.size
            return size
    except (OSError, SyntaxError):
        return None


def _as_picture(path: Path, frames: int, fps: float, drawn: _Drawn) -> Iterator[int]:
    """Write a GIF or WebP file by Pillow, once all frames are drawn; it repeats for ever."""
    pillow = _pillow(path.suffix)
    kind = path.suffix[1:].upper()
    unit = 10 if kind == "GIF" else 1  # milliseconds
    if 1000 / fps > _LASTING[kind]:
        most = f"at most {_LASTING[kind] / 1000:g} s"
        raise VideoError(f"{path}: {path.suffix} files show a frame for {most}, not {1 / fps:g} s: write a folder")
    ends = [round(number * 1000 / fps / unit) * unit for number in range(frames + 1)]
    lasting = [max(end - start, unit) for start, end in pairwise(ends)]

    def run() -> Iterator[int]:
        pictures = []
        for number, pixels in enumerate(drawn(range(frames))):
            picture = pillow.fromarray(np.ascontiguousarray(pixels))
            pictures.append(_in_256_colors(pillow, picture) if kind == "GIF" else picture)
            if number + 1 < frames:
                yield number + 1
        with replacing(path) as temporary:
            pictures[0].save(str(temporary), kind, save_all=True, append_images=pictures[1:], duration=lasting, loop=0)
        yield frames

    return run()


def _in_256_colors(pillow: Any, picture: Any) -> Any:
    """Return the picture in its own 256 colours, dithered: without it, smooth shades show steps."""
    palette = picture.quantize(256, method=pillow.Quantize.MAXCOVERAGE)
    return picture.quantize(palette=palette, dither=pillow.Dither.FLOYDSTEINBERG)


def _ffmpeg(path: Path, size: tuple[int, int]) -> str:
    """Return the program that writes MP4; VideoError where there is none, or it cannot write this size."""
    program = shutil.which("ffmpeg")
    if program is None:
        raise VideoError(
            f"{path}: .mp4 files are written by ffmpeg, which is not installed: write a .webp or .gif file"
        )
    if size[0] % 2 or size[1] % 2:
        raise VideoError(f"an .mp4 file has an even width and height, not {size[0]} x {size[1]}")
    return program


def _as_mp4(path: Path, frames: int, fps: float, size: tuple[int, int], drawn: _Drawn, ffmpeg: str) -> Iterator[int]:
    """Write an MP4 file: frames go to ffmpeg as they are drawn."""
    width, height = size
    input_options = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:g}", "-i", "-"]
    output_options = ["-an", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4"]
    with replacing(path) as temporary:
        words = [ffmpeg, "-y", "-loglevel", "error", *input_options, *output_options, str(temporary)]
        with subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            assert process.stdin is not None
            assert process.stderr is not None
            try:
                for number, pixels in enumerate(drawn(range(frames))):
                    process.stdin.write(np.ascontiguousarray(pixels).tobytes())
                    if number + 1 < frames:
                        yield number + 1
                process.stdin.close()
            except BrokenPipeError:
                pass  # ffmpeg has ended; its message follows below
            except BaseException:
                process.kill()
                raise
            message = process.stderr.read().decode(errors="replace").strip()
        if process.returncode:
            raise VideoError(f"{path}: ffmpeg failed: {message or process.returncode}")
    yield frames
