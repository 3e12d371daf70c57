"""The commands `shpy view` and `shpy draw`.

Stage: above all others. Takes the words of the command line, serves until Ctrl-C, or writes a picture.

    shpy view examples/planet.py
    shpy view shader.py:clouds --size 800x600 --backend glsl --port 8001
    shpy draw shader.py -o picture.png --time 1.5
"""

from __future__ import annotations

import argparse
import re
import sys
from functools import partial
from pathlib import Path
from typing import Any

from shpy.backend.registry import NAMES
from shpy.command import whole
from shpy.errors import ShpyError
from shpy.passes.modes import CONTRACTIONS, MODES, mode_name
from shpy.view.drawing import add_draw, write
from shpy.view.messages import SIDE
from shpy.view.server import LOOPBACK, View, serve


def add_view(commands: Any) -> None:
    """Add `view` and `draw` to the commands of `shpy`."""
    command = commands.add_parser(
        "view",
        help="a live page in the browser: recorded again on save, sliders, the trace of a pixel",
        description="Serve a page on this machine that shows a program's pixels while you change its file.",
    )
    command.add_argument("file", help="path/to/shader.py, or shader.py:program (default: its last program of pixels)")
    add_serving(command)
    _add_choice(command)
    command.set_defaults(run=view)
    add_draw(commands, size, _add_choice).set_defaults(run=_draw)


def _add_choice(command: argparse.ArgumentParser) -> None:
    """Add the options that choose a kernel."""
    command.add_argument("--backend", choices=NAMES, help="(default: the fastest that works here)")
    command.add_argument("--math", choices=tuple(MODES), default="strict", help="(default: strict)")
    command.add_argument("--fuse", action="store_true", help="round a * b + c once, with the same bits everywhere")


def _draw(options: argparse.Namespace) -> int:
    """Write a picture; return 0, or 2 if there is no such file or nothing can be drawn."""
    try:
        return write(options, *_file(options.file))
    except ShpyError as error:
        print(f"shpy draw: {error}", file=sys.stderr)
        return 2


def add_serving(command: argparse.ArgumentParser) -> None:
    """Add the options that every view has."""
    command.add_argument("--port", type=whole(0, 65535), default=8000, help="0 takes a free one (default: 8000)")
    command.add_argument("--size", type=size, default=(512, 512), help="of the picture in pixels (default: 512x512)")
    command.add_argument(
        "--listen",
        default=LOOPBACK,
        metavar="ADDRESS",
        help="serve beyond this machine, to everybody who reaches the address (default: this machine alone)",
    )


def size(text: str) -> tuple[int, int]:
    """Read WIDTHxHEIGHT, for the `type` of an argument."""
    match = re.fullmatch(r"([1-9][0-9]{0,3})x([1-9][0-9]{0,3})", text)
    if match is None or max(int(match[1]), int(match[2])) > SIDE:
        raise argparse.ArgumentTypeError(f"{text!r} is no size such as 640x360, of at most {SIDE}x{SIDE}")
    return int(match[1]), int(match[2])


def view(options: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C; return 0, or 2 if there is no such file or the server cannot start."""
    try:
        path, program = _file(options.file)
        request = {"path": str(path), "given": str(path), "name": path.name, "program": program}
        mode = mode_name(options.math, options.fuse)
        if mode not in CONTRACTIONS:
            raise ShpyError(f"--math {options.math} contracts by itself", cure="--math strict --fuse, or no --fuse")
        state = {"size": list(options.size), "backend": options.backend, "math": mode, "playing": True}
        report = partial(print, f"shpy view {path.name}:", flush=True)
        serve(View("shpy.view.session", request, state), address=options.listen, port=options.port, report=report)
    except ShpyError as error:
        print(f"shpy view: {error}", file=sys.stderr)
        return 2
    return 0


def _file(words: str) -> tuple[Path, str | None]:
    """Return the file and the name of a program in it; ShpyError if there is no such file."""
    path, _, name = words.rpartition(":")
    if not path or not path.endswith(".py"):
        path, name = words, ""
    if not Path(path).is_file():
        raise ShpyError(f"there is no file {path}", cure="shpy view shader.py, or shader.py:program")
    return Path(path), name or None
