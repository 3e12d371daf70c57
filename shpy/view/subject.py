"""The subject of a view: a program that is drawn, or a chain that is drawn after each of its steps.

Stage: view. A subject returns the output of its run at a moment, as floats: (height, width) or (height, width, n).

    subject = Still(program, wake)
    subject.draw(Moment((640, 360)), Form("opencl", "strict"))     # (output, the form that was there)
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from shpy.chains.chain import Chain
from shpy.errors import ShpyError
from shpy.programs import Program
from shpy.screen import Moment, filled, first_output, moves, run_at, values_of
from shpy.streams.stream import Stream
from shpy.view.kernels import QUICK, Form, Kernels
from shpy.view.source import SHOW, START, Opened


class Subject(Protocol):
    """The interface by which a session draws a program or a chain."""

    moves: bool
    """The picture changes by itself as time goes on."""
    evolves: bool
    """Each frame follows from the one before: there are steps, and a reset."""
    coarse: bool
    """It can be drawn at fewer pixels first."""
    takes_mouse: bool
    """It has an input that the mouse fills."""
    params: Mapping[str, Any]

    @property
    def kernels(self) -> Kernels | None:
        """The kernels that compute the colours; None if the numbers of a stream are shown directly."""

    def draw(self, moment: Moment, wanted: Form) -> tuple[Any, Form]:
        """Return the output for a moment and the form that computed it: the wanted one, or a quick one before."""

    def advance(self, moment: Moment, wanted: Form, steps: int) -> bool:
        """Run some steps and return True; return False while neither the wanted form nor a quick one is compiled."""

    def reset(self) -> None:
        """Restart from the first streams."""

    def waiting(self, wanted: Form) -> float | None:
        """Return the seconds for which the wanted form has been compiling; None where it is not."""

    def refused(self, wanted: Form) -> Exception | None:
        """Return the error with which a target refuses the wanted form; a quick form draws in its place."""

    def trace(self, moment: Moment, at: tuple[int, int]) -> tuple[Program, list[Any]]:
        """Return the program and the steps of one pixel."""


class Still:
    """A program of pixels."""

    params: Mapping[str, Any]
    evolves: bool = False
    coarse: bool = True

    def __init__(self, program: Program, wake: Callable[[], None]) -> None:
        self.program = program
        self.kernels = Kernels(program, wake)
        self.takes_mouse = "mouse" in program.inputs
        self.moves = moves(program)
        self.params = program.params

    def draw(self, moment: Moment, wanted: Form) -> tuple[Any, Form]:
        """Return the output for a moment and the form that computed it: the wanted one, or a quick one before."""
        kernel, form = self.kernels.best(wanted)
        return run_at(kernel, self.program.inputs, moment), form

    def exactly(self, moment: Moment, form: Form) -> Any:
        """Return the output at a moment in a form; compile the form first if it is new."""
        return run_at(self.kernels.exactly(form), self.program.inputs, moment)

    def advance(self, moment: Moment, wanted: Form, steps: int) -> bool:
        """Return True: time alone goes on, and no stream is kept."""
        return True

    def reset(self) -> None:
        """Do nothing: a program of pixels keeps no streams."""

    def waiting(self, wanted: Form) -> float | None:
        """Return the seconds for which the wanted form has been compiling; None where it is not."""
        return self.kernels.waiting(wanted)

    def refused(self, wanted: Form) -> Exception | None:
        """Return the error with which a target refuses the wanted form."""
        return self.kernels.refused(wanted)

    def trace(self, moment: Moment, at: tuple[int, int]) -> tuple[Program, list[Any]]:
        """Return the program and the steps of one pixel."""
        return self.program, self.program.trace(**filled(self.program.inputs, moment), shape=moment.shape, at=at)


class Ongoing:
    """A chain that continues its streams from frame to frame; `show` draws them, or the last stream is the picture."""

    params: Mapping[str, Any]
    moves: bool = True
    evolves: bool = True
    coarse: bool = False

    def __init__(self, chain: Chain, opened: Opened, wake: Callable[[], None]) -> None:
        self.chain = chain
        self.start = opened.start
        show = opened.names.get(SHOW)
        self.kernels = Kernels(show, wake) if isinstance(show, Program) else None
        self.shown = list(chain.outputs)[-1]
        programs = [kernel.recorded for kernel in chain.kernels]
        self.takes_mouse = any("mouse" in recorded.inputs for recorded in programs)
        params = {name: p for recorded in programs for name, p in recorded.params.items()}
        self.params = params | (self.kernels.program.params if self.kernels else {})
        self._wake = wake
        self._streams: dict[str, Any] | None = None
        self._size: tuple[int, int] | None = None
        self._ready: dict[tuple[Form, tuple[int, int]], Exception | bool] = {}

    def draw(self, moment: Moment, wanted: Form) -> tuple[Any, Form]:
        """Return the colours of the current streams."""
        streams = self._present(moment)
        if self.kernels is None:
            return np.asarray(streams[self.shown]), wanted
        kernel, form = self.kernels.best(wanted)
        given = values_of(self.kernels.program.inputs, moment, streams)
        if form.backend != wanted.backend:
            given = {n: v.numpy() if isinstance(v, Stream) else v for n, v in given.items()}
        return np.asarray(first_output(kernel(**given))), form

    def advance(self, moment: Moment, wanted: Form, steps: int) -> bool:
        """Run some steps and return True; return False while neither the wanted form nor a quick one is compiled."""
        streams = self._present(moment)
        forms = tuple(dict.fromkeys((wanted, Form(QUICK, wanted.math))))
        for form in reversed(forms):
            self._prepare((form, moment.size), moment, streams)
        ready = [form for form in forms if self._is_ready(form, moment.size)]
        for _ in range(steps if ready else 0):
            streams |= self._run(moment, ready[0], streams)
        return bool(ready)

    def _is_ready(self, form: Form, size: tuple[int, int]) -> bool:
        """Return whether the kernels of a form are compiled; raise the error if the target refuses them."""
        found = self._ready[form, size]
        if isinstance(found, Exception):
            raise found
        return found

    def _prepare(self, key: tuple[Form, tuple[int, int]], moment: Moment, streams: Mapping[str, Any]) -> None:
        """Begin to compile a form, if that has not begun."""
        if key not in self._ready:
            self._ready[key] = False
            threading.Thread(target=self._compile, args=(key, moment, dict(streams)), daemon=True).start()

    def _compile(self, key: tuple[Form, tuple[int, int]], moment: Moment, streams: dict[str, Any]) -> None:
        """Compile the kernels by one run, whose results are discarded."""
        try:
            self._run(moment, key[0], streams)
            self._ready[key] = True
        except Exception as error:  # also from a driver: the page shows it
            self._ready[key] = error
        self._wake()

    def _run(self, moment: Moment, form: Form, streams: Mapping[str, Any]) -> dict[str, Any]:
        given = values_of(self.chain.inputs, moment, streams)
        placed: dict[str, Any] = {n: v.to(form.backend) if isinstance(v, Stream) else v for n, v in given.items()}
        return self.chain.run(backend=form.backend, **placed).streams

    def _present(self, moment: Moment) -> dict[str, Any]:
        """Return the streams; restart from the first ones if the size has changed."""
        if self._streams is None or self._size != moment.size:
            self._streams, self._size = self._begin(moment), moment.size
        return self._streams

    def _begin(self, moment: Moment) -> dict[str, Any]:
        if self.start is None:
            names = ", ".join(f'"{name}": …' for name in self.chain.inputs)
            raise ShpyError(
                f"{self.chain} needs streams to begin with", cure=f"def {START}(height, width): return {{{names}}}"
            )
        made = self.start(*moment.shape)
        if not isinstance(made, dict):
            raise ShpyError(f"{START}(height, width) gives {type(made).__name__}", cure="a dict of arrays by name")
        return dict(made)

    def reset(self) -> None:
        """Restart from the first streams."""
        self._streams = None

    def waiting(self, wanted: Form) -> float | None:
        """Return 0 while the wanted form compiles, else None."""
        return 0.0 if self._ready.get((wanted, self._size or (0, 0)), True) is False else None

    def refused(self, wanted: Form) -> Exception | None:
        """Return the error with which a target refuses `show`; `advance` raises the error of a kernel of the chain."""
        return self.kernels.refused(wanted) if self.kernels else None

    def trace(self, moment: Moment, at: tuple[int, int]) -> tuple[Program, list[Any]]:
        """Return the last program of the chain and the steps of one pixel in it."""
        member = self.chain.kernels[-1]
        program = Program(member.recorded)
        given = values_of(program.inputs, moment, self._present(moment))
        return program, program.trace(**given, shape=moment.shape, at=at)


def subject_of(value: Program | Chain, opened: Opened, wake: Callable[[], None]) -> Subject:
    """Return the subject of a program or chain."""
    return Ongoing(value, opened, wake) if isinstance(value, Chain) else Still(value, wake)
