"""The pictures of a widget: of a program of pixels, or of a chain that runs on.

Stage: view. A request names a frame by its moment; a chain advances when the frame's number differs from the last.

    Pixels(program, (640, 360), Form("opencl", "strict")).draw(Moment((640, 360), time=1.5))
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shpy.chains.chain import Chain
from shpy.display.screen import Moment, moves, run_at
from shpy.pictures.evolution import Evolution
from shpy.programs import Program
from shpy.view.kernels import Form, Kernels


class Pixels:
    """A program of pixels; numpy draws it while the driver of another backend compiles."""

    evolves = False
    steps = 1

    def __init__(
        self, program: Program, size: tuple[int, int], form: Form, values: Mapping[str, Any] | None = None
    ) -> None:
        self._kernels, self._form, self._values = Kernels(program, lambda: None), form, values
        self.size, self.title, self.params = size, program.name, program.params
        self.moves = moves(program)

    def draw(self, moment: Moment) -> Any:
        """Return the output at a moment; raise the error with which the backend refuses the program."""
        kernel, form = self._kernels.best(self._form)
        if form != self._form and (refused := self._kernels.refused(self._form)):
            raise refused
        return run_at(kernel, self._kernels.program.inputs, moment, self._values)


class Running:
    """A chain that runs `steps` times per frame; frame 0, and any frame before the last one drawn, restarts it."""

    evolves = moves = True

    def __init__(
        self,
        chain: Chain,
        show: Program | None,
        streams: Mapping[str, Any],
        *,
        size: tuple[int, int] | None,
        steps: int,
        backend: str | None,
    ) -> None:
        self._evolution = Evolution(chain, show, streams, size=size, backend=backend)
        self.size, self.title, self.steps = self._evolution.size, str(chain), steps
        self.params = dict(show.params) if show else {}
        for kernel in chain.kernels:
            self.params |= kernel.recorded.params
        self._last = -1

    def draw(self, moment: Moment) -> Any:
        """Return the output of a frame. The chain runs up to this frame; for an earlier frame it restarts first."""
        if moment.frame < self._last:
            self._evolution.reset()
            self._last = -1
        if moment.frame > self._last:
            for _ in range(self.steps):
                self._evolution.step(moment)
            self._last = moment.frame
        return self._evolution.picture(moment)
