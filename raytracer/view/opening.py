"""The scene of a view: a static one, or a function of the time.

Stage: the command line, in the worker.

    opened = open_scene(options)
    opened.make(0.5)            # the Scene half a second after the start
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import shpy as sh
from raytracer import viewing
from raytracer.animation import ANIMATIONS, made_by, spread
from raytracer.errors import SceneError
from raytracer.meshes.folder import Folder
from raytracer.meshes.gltf import Document
from raytracer.meshes.gltf_animation import names_of
from raytracer.scene.animated_file import ANIMATED, AnimatedFile
from raytracer.scene.loading import bytes_of, reading
from raytracer.scene.scene import Scene


@dataclass(frozen=True)
class TimedScene:
    """A scene as a function of the time in seconds, its length, and the warnings that reading it gave.

    `seconds` is the length after which it starts again, 0 for a static scene.
    """

    make: Callable[[float], Scene]
    seconds: float
    notices: tuple[str, ...] = ()


def open_scene(options: argparse.Namespace) -> TimedScene:
    """Open the scene of a command, with its options. Raises SceneError, and OSError for files."""
    with _heard() as notices:
        make, seconds = _function_of_time(options, notices)
        make(0.0)  # reads what is read on the first call
    return TimedScene(make, seconds, tuple(notices))


def scene_at(options: argparse.Namespace, time: float) -> Scene:
    """Return the scene of a command, with its options, at a time in seconds; SceneError for one that does not move."""
    opened = open_scene(argparse.Namespace(**{"seconds": 1.0, **vars(options)}))
    for notice in opened.notices:
        warnings.warn(notice, sh.ShpyWarning, stacklevel=2)
    if not opened.seconds:
        raise SceneError(f"--time is for scenes that move, and {options.scene} stands still: leave it out")
    return opened.make(time)


def _function_of_time(options: argparse.Namespace, notices: list[str]) -> tuple[Callable[[float], Scene], float]:
    """Return the function that gives the scene at a time, and its length in seconds."""
    path = Path(options.scene)
    if options.scene in ANIMATIONS:
        return viewing.scenes_of(options, ANIMATIONS[options.scene]), options.seconds
    if path.suffix.lower() == ".py":
        return viewing.scenes_of(options, made_by(path)), options.seconds
    file = _animation_of(path, options, notices)
    if file is not None:
        frames, fps = spread(file.seconds, None, None)
        return viewing.scenes_of_file(options, file, frames, fps), file.seconds
    scene = viewing.scene_of(options)
    return lambda time: scene, 0.0


def _animation_of(path: Path, options: argparse.Namespace, notices: list[str]) -> AnimatedFile | None:
    """Return the file with its animation; None for a file without animations.

    Without `clip`, an animation that cannot be shown gives a notice and None, and the scene is shown still.
    """
    clip = options.clip
    if clip is None:
        if path.suffix.lower() not in ANIMATED or not path.is_file():
            return None
        with reading(path):
            if not names_of(Document(bytes_of(path), Folder(path))):
                return None
    try:
        return AnimatedFile(path, clip, **viewing.choices(options))
    except SceneError as error:
        if clip is not None:
            raise
        notices.append(f"{error}; it is shown still")
        return None


@contextmanager
def _heard() -> Iterator[list[str]]:
    """Yield a list that collects the warnings of the block."""
    messages: list[str] = []
    with warnings.catch_warnings(record=True) as records:
        warnings.simplefilter("always", sh.ShpyWarning)
        yield messages
    messages += [str(one.message) for one in records]
