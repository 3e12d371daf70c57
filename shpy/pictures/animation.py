"""Animations of programs and chains: frames computed on a device, written to one file or a folder.

Stage: picture. `screen` fills inputs by name and makes pixels of outputs, `videos` writes them.

    sh.animate(waves, "waves.gif", frames=48, size=(256, 256))
    sh.animate(sh.repeat(react, 20), "spots.webp", frames=100, show=colors, u=u, v=v)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shpy.chains.chain import Chain
from shpy.command import progress_lines
from shpy.display.screen import Moment, check_pictures, pixels, run_at
from shpy.errors import ShpyTypeError
from shpy.lang.data.params import Param
from shpy.lang.recording.location import here
from shpy.passes.modes import Math
from shpy.pictures.evolution import Evolution
from shpy.pictures.videos import FPS, writing
from shpy.programs import Program
from shpy.streams.stream import Stream

Frame = NDArray[np.uint8]


def animate(
    shown: Program | Chain,
    path: str | PathLike[str],
    *,
    frames: int,
    fps: float = FPS,
    size: tuple[int, int] | None = None,
    show: Program | None = None,
    encode: bool = False,
    backend: str | None = None,
    math: Math = "strict",
    fuse: bool = False,
    resume: bool = False,
    progress: Callable[[int, int], None] | None = None,
    **values: Any,
) -> Path:
    """Write `frames` frames to a .gif, .webp or .mp4 file, or else to a folder of PNG files; return its path.

    A program of pixels is run over `size` (width, height), (512, 512) by default, for each frame: frame k
    shows the time k / fps, in seconds. Its inputs `uv`, `pixel`, `resolution`, `time`, `frame` and `mouse` are filled
    by their names. `values` are other inputs and Params, by name: a number, an array, or a function of the time.

    A chain is run once for each frame; `values` are the streams that it begins with. `show` is the program that makes
    colours of its streams, which it takes by their names; without it the last stream that the chain writes is shown.

    One component is a grey, three a colour; an alpha is left out. Numbers from 0 to 1 are shown as they are; with
    `encode` they are linear light, which becomes sRGB. `progress` is called with how many frames are done and how many
    there are; None prints a line every five seconds. `resume` keeps the frames that a folder has.
    Raises ShpyTypeError unless it is a program of pixels, VideoError for numbers and paths that make no animation and
    where Pillow or ffmpeg is missing, OSError for a path that cannot be written.
    """
    tell = progress or progress_lines("frames")
    if isinstance(shown, Chain):
        _check_defaults(math, fuse)
        ongoing = _Ongoing(Evolution(shown, show, values, size=size, backend=backend), fps)
        extent, draw = ongoing.size(), ongoing.draw
    elif isinstance(shown, Program):
        if show is not None:
            raise ShpyTypeError("show= makes colours of the streams of a chain", loc=here(), cure="show << program")
        still = _Still(shown, values, fps, size or (512, 512), dict(backend=backend, math=math, fuse=fuse))
        extent, draw = still.size, still.draw
    else:
        raise ShpyTypeError(
            f"{shown!r} is neither a program nor a chain", loc=here(), cure='sh.animate(program, "x.gif", frames=48)'
        )
    steps = writing(Path(path), frames, fps, extent, lambda k: pixels(draw(k), encode=encode)[..., :3], resume=resume)
    with _kept(shown.params if isinstance(shown, Program) else {}):
        for done in steps:
            tell(done, frames)
    return Path(path)


def _check_defaults(math: Math, fuse: bool) -> None:
    """Raise ShpyTypeError for a mode of arithmetic beside a chain."""
    if math != "strict" or fuse:
        cure = f"step.compile({'fuse=True' if fuse else f'math={math!r}'}) in the chain"
        raise ShpyTypeError("math= and fuse= are for programs; a chain has kernels of its own", loc=here(), cure=cure)


@contextmanager
def _kept(params: Mapping[str, Any]) -> Iterator[None]:
    """Give Params the values from before once the frames are drawn."""
    before = {name: params[name].value for name in params if isinstance(params[name], Param)}
    try:
        yield
    finally:
        for name, value in before.items():
            params[name].value = value


class _Still:
    """A program of pixels at the times of its frames."""

    def __init__(
        self,
        program: Program,
        values: Mapping[str, Any],
        fps: float,
        size: tuple[int, int],
        options: dict[str, Any],
    ) -> None:
        check_pictures(program, size, values)
        self.size, self._program, self._fps = size, program, fps
        self._params = {n: p for n, p in program.params.items() if n in values and n not in program.inputs}
        self._values = values
        self._kernel = program.compile(**options)

    def draw(self, number: int) -> Any:
        """Return the output of a frame."""
        moment = Moment(self.size, number / self._fps, number)
        for name, param in self._params.items():
            param.value = _now(self._values[name], moment)
        values = {n: _now(v, moment) for n, v in self._values.items() if n not in self._params}
        return run_at(self._kernel, self._program.inputs, moment, values)


def _now(value: Any, moment: Moment) -> Any:
    return value(moment.time) if callable(value) and not isinstance(value, Stream) else value


class _Ongoing:
    """A chain that runs once for each frame."""

    def __init__(self, evolution: Evolution, fps: float) -> None:
        self._evolution, self._fps = evolution, fps
        self._drawn = 0
        self._picture: Any = None

    def size(self) -> tuple[int, int]:
        """Return (width, height) of its pictures, as the first one has it."""
        height, width = np.shape(self.draw(0))[:2]
        return width, height

    def draw(self, number: int) -> Any:
        """Return the output of a frame: of the one drawn last, or of a later one."""
        while self._drawn <= number:
            moment = Moment(self._evolution.size, self._drawn / self._fps, self._drawn)
            self._evolution.step(moment)
            self._picture = self._evolution.picture(moment)
            self._drawn += 1
        return self._picture
