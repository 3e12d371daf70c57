"""The scene that a command shows, and the options of the command line for its camera.

raytracer render chair.glb --camera 2,1,3 --target 0,0.5,0 --fov 30 --no-floor --background "#ffffff"

Stage: the command line. Every command that renders adds `add_arguments`, checks with `check`, and opens its scene with
`scene_of`; one that animates takes scenes from `scenes_of` or `scenes_of_file`.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from raytracer.accel.choice import INSTANCES, check as check_structure
from raytracer.appearance.materials import Triple
from raytracer.appearance.textures import Texture, decoded
from raytracer.arrays import real
from raytracer.errors import SceneError
from raytracer.image import MOST_STOPS, READING
from raytracer.integrators.integrator import TRACERS
from raytracer.layered.cube import is_layered
from raytracer.scene.animated_file import AnimatedFile
from raytracer.scene.camera import Camera
from raytracer.scene.lights import EnvironmentLight
from raytracer.scene.loading import load_contents
from raytracer.scene.scene import Background, Scene, furnished
from raytracer.scenes import SCENES
from raytracer.tone_mapping import CURVES

EXAMPLES = """examples:
  raytracer render chair.glb --camera 2,1,3 --target 0,0.5,0 --fov 30     from another side
  raytracer render part.stl --up z --no-floor --background "#ffffff"      z is up in the file; white all around
  raytracer render chair.glb --integrator path --environment sky.png --exposure 1
"""
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_NEGATIVE = ("--camera", "--target", "--up", "--background", "--exposure", "--rotation")
"""The options whose values may begin with a minus, which argparse takes for another option's."""
PICTURES = frozenset(
    (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga", ".gif", ".tif", ".tiff", ".ppm", ".hdr", ".exr")
)
"""The endings of file names: a background with one of them is a picture, even if the file is missing."""


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the options of the camera, the floor, the background and the exposure to a command."""
    group = command.add_argument_group("how the scene is seen")
    group.add_argument(
        "--camera", type=_sight, metavar="X,Y,Z", help="the camera's position; or NAME or NUMBER of one of a file"
    )
    group.add_argument("--target", type=_triple, metavar="X,Y,Z", help="the point at which it is aimed")
    group.add_argument(
        "--up", type=_up, metavar="X,Y,Z", help="the direction that is up in the picture: three numbers, or x, y or z"
    )
    group.add_argument("--fov", type=_fov, metavar="DEG", help="the angle across the picture's shorter side")
    group.add_argument("--variant", metavar="NAME", help="GLB and glTF files: which of their variants of materials")
    group.add_argument(
        "--multiscatter", action="store_true", help="files: rough metals lose no light between their microfacets"
    )
    group.add_argument("--no-floor", action="store_true", help="files: no floor under what is framed")
    group.add_argument(
        "--strict", action="store_true", help="files: a bad entry or a missing picture is an error, not a warning"
    )
    group.add_argument(
        "--background",
        type=_background,
        metavar="COLOR",
        help="the colour behind the scene: #RRGGBB, linear R,G,B, or the file of a 360 degree picture",
    )
    group.add_argument(
        "--exposure", type=_stops, metavar="EV", help="pictures for the eye: brighter by 2 to this power; -1 is half"
    )
    group.add_argument(
        "--tonemap", choices=CURVES, default="none", help="pictures for the eye: how light beyond 1 is shown (none)"
    )
    group.add_argument("--environment", type=Path, metavar="FILE", help="a 360 degree picture that lights the scene")
    group.add_argument(
        "--rotation",
        type=_degrees,
        metavar="DEG",
        help="with --environment: turn it, counter-clockwise seen from above",
    )


def add_tracing(command: argparse.ArgumentParser) -> None:
    """Add the options that say how rays find triangles, and in how many kernels."""
    command.add_argument(
        "--accel",
        type=_accel,
        help="how rays find triangles: bvh, grid, brute, instances, or ldc:1024 (bvh; grid if staged)",
    )
    command.add_argument(
        "--tracer",
        choices=TRACERS,
        default="unified",
        help="one kernel, or stages over streams of rays (unified)",
    )


def joined(arguments: Sequence[str]) -> list[str]:
    """Return arguments in which a value that begins with a minus is one word with its option: --camera=-1,2,3."""
    words: list[str] = []
    for word in arguments:
        if words and words[-1] in _NEGATIVE and re.match(r"-[\d.]", word):
            words[-1] += f"={word}"
        else:
            words.append(word)
    return words


def check(options: argparse.Namespace, output: Path, *, framed: bool) -> None:
    """Raise SceneError for options that do not go together; `framed` says whether the scene is put on a floor."""
    for name in ("exposure", "tonemap"):
        if getattr(options, name) not in (None, "none") and output.suffix.lower() in READING:
            raise SceneError(f"{output}: --{name} is for .png; {' and '.join(READING)} hold the light as it is")
    if options.rotation is not None and options.environment is None:
        raise SceneError("--rotation turns the picture of --environment: name one, or leave it out")
    if options.no_floor and not framed:
        kind = "scene of a Python file" if Path(options.scene).suffix else "built-in scene"
        raise SceneError(f"--no-floor is for files, which are put on one; a {kind} is as it is made")
    if isinstance(options.camera, str | int) and not framed:
        raise SceneError("--camera NAME chooses a camera of a GLB or glTF file; --camera X,Y,Z places one")
    if options.variant is not None and not framed:
        raise SceneError("--variant is for GLB and glTF files: leave it out")
    if options.multiscatter and not framed:
        raise SceneError("--multiscatter is for the materials of files: leave it out")
    if options.strict and not framed:
        raise SceneError("--strict is for mesh files, whose entries are checked as they are read: leave it out")


def choices(options: argparse.Namespace) -> dict[str, Any]:
    """Return the keywords of `Scene.load` that say how a file is read."""
    return {name: getattr(options, name) for name in ("strict", "variant", "multiscatter")}


def scene_of(options: argparse.Namespace) -> Scene:
    """Open the scene of a command and apply its options; SceneError, or OSError for files, where that is impossible."""
    sky, shown = _skies(options), _shown(options)
    if options.scene in SCENES:
        return _altered(Scene.builtin(options.scene), options, sky, shown)
    path, framing = Path(options.scene), _framing(options, sky)
    if not is_file(path):
        return find_scene(options.scene)  # which says what there is
    contents = load_contents(path, **choices(options))
    return _painted(furnished(contents, path.stem, **framing), shown)


def scenes_of(options: argparse.Namespace, make: Callable[[float], Any]) -> Callable[[float], Any]:
    """Return the function of time whose scenes are those of `make` with the options of a command."""
    sky, shown = _skies(options), _shown(options)

    def scene(time: float) -> Any:
        value = make(time)
        return (
            _altered(value, options, sky, shown) if isinstance(value, Scene) else value
        )  # `animate` refuses anything else

    return scene


def scenes_of_file(
    options: argparse.Namespace, file: AnimatedFile, frames: int, fps: float
) -> Callable[[float], Scene]:
    """Return the function of time that gives the scenes of a file with the options of a command."""
    make, shown = file.make(frames, fps, **_framing(options, _skies(options))), _shown(options)
    return lambda time: _painted(make(time), shown)


def _altered(
    scene: Scene, options: argparse.Namespace, sky: Sequence[EnvironmentLight], shown: Background | None
) -> Scene:
    """Return a scene that is as it is made, seen as the options say and lit by a sky if there is one."""
    assert scene.camera is not None  # a Scene sets its own camera by default
    lights = [*(scene.placed_lights if sky else scene.lights), *sky]
    return _painted(dataclasses.replace(scene, lights=lights, camera=_turned(scene.camera, options)), shown)


def _framing(options: argparse.Namespace, sky: Sequence[EnvironmentLight]) -> dict[str, Any]:
    """Return the keywords of `Scene.load` for the options."""
    up = _AXES["y"] if options.up is None else options.up
    which = options.camera if isinstance(options.camera, str | int) else None
    framing = {"up": up, "camera": lambda camera: _turned(camera, options), "which": which}
    return framing | {"floor": not options.no_floor, "lights": sky}


def _shown(options: argparse.Namespace) -> Background | None:
    """Return the background of the options, if there is one; a picture is read."""
    background: Background | None = options.background
    return Texture(background) if isinstance(background, Path) else background


def _painted(scene: Scene, shown: Background | None) -> Scene:
    return scene if shown is None else dataclasses.replace(scene, background=shown)


def is_file(path: Path) -> bool:
    """Return whether the name of a scene is that of a file, which may be missing."""
    return bool(path.suffix) or path.exists()


def find_scene(name: str) -> Scene:
    """Return the built-in scene of this name, else read the file; SceneError if it is neither."""
    if name in SCENES:
        return Scene.builtin(name)
    if is_file(Path(name)):
        return Scene.load(name)
    raise SceneError(f"{name!r} is neither a file nor a built-in scene; the scenes are {', '.join(SCENES)}")


def _turned(camera: Camera, options: argparse.Namespace) -> Camera:
    """Return the camera with the options that are given: of a calibrated one, without its fixed directions."""
    changes: dict[str, Any] = {
        "position": options.camera if isinstance(options.camera, tuple) else None,
        "target": options.target,
        "up": options.up,
        "fov": options.fov,
    }
    changes = {name: value for name, value in changes.items() if value is not None}
    if not changes:
        return camera
    if camera.projection != "perspective" and options.fov is not None:
        raise SceneError(f"--fov is for a perspective camera, and this scene has an {camera.projection} one")
    try:
        return dataclasses.replace(camera, **changes, intrinsics=None)
    except SceneError as error:
        sight = {"camera": camera.position, "target": camera.target, "up": camera.up}
        sight |= {
            name: changes[key] for name, key in zip(sight, ("position", "target", "up"), strict=True) if key in changes
        }
        here = ", ".join(f"--{name} is {','.join(f'{x:g}' for x in at)}" for name, at in sight.items())
        raise SceneError(f"{error}: {here}; choose another of them") from None


def _skies(options: argparse.Namespace) -> tuple[EnvironmentLight, ...]:
    """Return the environment light of the options, if there is one."""
    path = options.environment
    if path is None:
        return ()
    if not path.is_file():
        raise FileNotFoundError(f"there is no picture {path}: --environment is the path of one")
    return (EnvironmentLight(path, rotation=options.rotation or 0.0),)


def _accel(text: str) -> str:
    try:
        if not is_layered(text):
            check_structure(text, INSTANCES)
    except SceneError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return text


def _numbers(text: str, count: int) -> list[float] | None:
    """Return finite numbers with commas between them; None for another text."""
    words = text.split(",")
    try:
        numbers = [real(word) for word in words]
    except ValueError:
        return None
    return numbers if len(numbers) == len(words) == count and all(map(math.isfinite, numbers)) else None


def _triple(text: str) -> Triple:
    numbers = _numbers(text, 3)
    if numbers is None:
        raise argparse.ArgumentTypeError(f"three numbers with commas between them, such as 1,0.5,-2, not {text!r}")
    return numbers[0], numbers[1], numbers[2]


def _sight(text: str) -> Triple | str | int:
    """Return a position, or the name or the number of a camera."""
    if text.isascii() and text.isdigit() and len(text) < 9:
        return int(text)
    return _triple(text) if "," in text or not text else text


def _up(text: str) -> Triple:
    if text.lower() in _AXES:
        return _AXES[text.lower()]
    direction = _triple(text)
    if not any(direction):
        raise argparse.ArgumentTypeError("a direction that is not zero, such as 0,0,1, or z")
    return direction


def _degrees(text: str) -> float:
    numbers = _numbers(text, 1)
    if numbers is None:
        raise argparse.ArgumentTypeError(f"an angle in degrees, such as 90, not {text!r}")
    return numbers[0]


def _fov(text: str) -> float:
    numbers = _numbers(text, 1)
    if numbers is None or not 0 < numbers[0] < 180:
        raise argparse.ArgumentTypeError(f"an angle between 0 and 180 degrees, such as 40, not {text!r}")
    return numbers[0]


def _stops(text: str) -> float:
    numbers = _numbers(text, 1)
    if numbers is None or abs(numbers[0]) > MOST_STOPS:
        raise argparse.ArgumentTypeError(f"a number from -{MOST_STOPS:g} to {MOST_STOPS:g}, such as 1.5, not {text!r}")
    return numbers[0]


def _background(text: str) -> Triple | Path:
    """Return a linear colour, or the path of a picture."""
    path = Path(text)
    return path if path.is_file() or path.suffix.lower() in PICTURES else _color(text)


def _color(text: str) -> Triple:
    """Return a linear colour."""
    if re.fullmatch("#[0-9a-fA-F]{6}", text):
        r, g, b = decoded(np.array([int(text[k : k + 2], 16) / 255 for k in (1, 3, 5)])).tolist()
        return r, g, b
    numbers = _numbers(text, 3)
    if numbers is None or min(numbers) < 0:
        raise argparse.ArgumentTypeError(
            f'"#RRGGBB" of sRGB, three linear numbers R,G,B from 0 on, or a picture such as sky.hdr, not {text!r}'
        )
    return numbers[0], numbers[1], numbers[2]
