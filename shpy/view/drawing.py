"""One picture of a file, as `shpy view` shows it, to the bit: `shpy draw` writes it, `sh.view.draw` returns it.

Stage: view, in any process. The page of `shpy view` gives both as text for the picture that it shows (`recipes`).

    shpy draw shader.py -o rings.png --size 640x360 --time 1.5 --set rings=12
    sh.view.draw("shader.py", size=(640, 360), time=1.5, params={"rings": 12})      # (360, 640, 4) bytes
"""

from __future__ import annotations

import argparse
import runpy
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.command import whole
from shpy.display.screen import Moment, pixels
from shpy.errors import ShpyError
from shpy.files import check_writable, import_from, replacing
from shpy.passes.modes import Math
from shpy.view.controls import Controls
from shpy.view.kernels import Form, preferred
from shpy.view.ongoing import Ongoing
from shpy.view.questions import png_of
from shpy.view.source import OpenedFile
from shpy.view.subject import subject_of

Mouse = tuple[float, float, float, float]


def draw(
    file: str | Path,
    program: str | None = None,
    *,
    size: tuple[int, int] = (512, 512),
    backend: str | None = None,
    math: Math = "strict",
    fuse: bool = False,
    time: float = 0.0,
    frame: int = 0,
    mouse: Mouse = (0.0, 0.0, 0.0, 0.0),
    steps: int = 1,
    params: Mapping[str, Any] | None = None,
    encode: bool = False,
) -> NDArray[np.uint8]:
    """Return the picture that `shpy view` shows of a file: (height, width, 4) bytes, red, green, blue and alpha.

    `program` is the name of a program or chain in the file, by default the one that the page shows. `size` is (width,
    height); `time` in seconds, `frame` and `mouse` fill the inputs of these names. A chain runs `frame` times `steps`
    steps before it is drawn. `params` are values of Params by name. With `encode`, numbers are linear light, which
    becomes sRGB. `backend` is the fastest of this machine by default; `math` and `fuse` are those of `Program.compile`.
    Raises ShpyError for a file without such a program and for a Param that it lacks or that refuses its value; errors
    of the file's code pass through.
    """
    path = Path(file)
    import_from(path.parent)
    opened = OpenedFile(path, runpy.run_path(str(path)))
    subject = subject_of(opened.pick(program)[1], opened, lambda: None)
    _assign(Controls(subject.params), params or {})
    form, extent = Form(backend or preferred(), math, fuse), subject.extent(size)
    if isinstance(subject, Ongoing):
        needed = 1 if subject.lacks_picture(size) else 0
        for number in range(max(frame, needed)):
            subject.run_on(Moment(extent, 0.0, number, mouse), form, steps)
    return pixels(subject.exactly(Moment(extent, time, frame, mouse), form), encode=encode)


def _assign(controls: Controls, params: Mapping[str, Any]) -> None:
    values = controls.values()
    for name, value in params.items():
        if name not in values:
            raise ShpyError(f"there is no Param {name}", cure=f"one of {', '.join(values)}" if values else None)
        refused = controls.assign({name: np.atleast_1d(value).tolist()})
        if refused:
            raise ShpyError(refused[0])


def add_draw(commands: Any, size: Any, add_choice: Any) -> argparse.ArgumentParser:
    """Add `draw` to the commands of `shpy` and return its parser.

    `size` reads a size, and `add_choice` adds the choice of a kernel.
    """
    command: argparse.ArgumentParser = commands.add_parser(
        "draw",
        help="write the picture that `shpy view` shows of a file",
        description="Write a PNG file of what `shpy view` shows of a file at a moment, with the same bits.",
    )
    command.add_argument("file", help="path/to/shader.py, or shader.py:program (default: its last program of pixels)")
    command.add_argument("-o", "--output", type=Path, help="a .png file (default: FILE.png)")
    command.add_argument("--size", type=size, default=(512, 512), help="of the picture in pixels (default: 512x512)")
    add_choice(command)
    command.add_argument("--time", type=float, default=0.0, help="in seconds, for the input `time` (default: 0)")
    command.add_argument(
        "--frame", type=whole(0), default=0, help="the number of the frame; a chain runs as many times (default: 0)"
    )
    command.add_argument("--steps", type=whole(1), default=1, help="of a chain for each frame (default: 1)")
    command.add_argument("--mouse", type=_mouse, default=(0.0, 0.0, 0.0, 0.0), metavar="X,Y,X,Y", help="in pixels")
    command.add_argument(
        "--set", dest="params", type=_param, action="append", default=[], metavar="NAME=NUMBERS", help="a Param's value"
    )
    command.add_argument("--encode", action="store_true", help="colours are linear light: write them as sRGB")
    return command


def write(options: argparse.Namespace, path: Path, program: str | None) -> int:
    """Write the picture that the options of `shpy draw` describe; return 0, or 2 where that is impossible."""
    output = options.output or Path(f"{path.stem}.png")
    named = ("size", "backend", "math", "fuse", "time", "frame", "mouse", "steps", "encode")
    try:
        check_writable(output)
        picture = draw(path, program, params=dict(options.params), **{name: getattr(options, name) for name in named})
        file = png_of(picture)
        with replacing(output) as unfinished:
            unfinished.write_bytes(file)
    except (ShpyError, OSError) as error:
        print(f"shpy draw: {error}", file=sys.stderr)
        return 2
    print(f"{output}: {picture.shape[1]} x {picture.shape[0]} pixels")
    return 0


def _mouse(text: str) -> Mouse:
    """Read four numbers with commas between them, for the `type` of an argument."""
    try:
        x, y, press_x, press_y = map(float, text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no place such as 12.5,40,12.5,40") from None
    return x, y, press_x, press_y


def _param(text: str) -> tuple[str, Sequence[float]]:
    """Read NAME=NUMBERS, for the `type` of an argument."""
    name, equals, numbers = text.partition("=")
    try:
        return name, [float(number) for number in numbers.split(",")]
    except ValueError:
        kind = "has no numbers" if equals else "has no ="
        raise argparse.ArgumentTypeError(f"{text!r} {kind}: write gain=0.5, or tint=1,0.5,0") from None
