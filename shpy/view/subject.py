"""The subject of a view: a program of pixels, or a chain (`ongoing`), which is drawn after each of its steps.

Stage: view. A subject returns the output of its run at a moment, as floats: (height, width) or (height, width, n).

    subject = Still(program, wake)
    subject.draw(Moment((640, 360)), Form("opencl", "strict"))     # (output, the form that was there)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from shpy.chains.chain import Chain
from shpy.display.screen import Moment, filled, moves, run_at
from shpy.programs import Program
from shpy.view.kernels import Form, Kernels
from shpy.view.ongoing import Ongoing
from shpy.view.source import OpenedFile


class Subject(Protocol):
    """The interface by which a session draws a program or a chain."""

    moves: bool
    """The picture changes by itself as time goes on."""
    evolves: bool
    """Each frame follows from the one before: there are steps, and a reset."""
    coarse: bool
    """It can be drawn at fewer pixels first."""
    takes_mouse: bool
    """True if the mouse fills an input."""
    params: Mapping[str, Any]

    @property
    def fresh(self) -> bool:
        """True if the next step is the first one, at the time 0."""

    def extent(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return the width and height of the full picture where the page has chosen `size`."""

    def lacks_picture(self, size: tuple[int, int]) -> bool:
        """Return whether only a step gives what the picture shows."""

    @property
    def kernels(self) -> Kernels | None:
        """The kernels that compute the colours; None if the numbers of a stream are shown directly."""

    def draw(self, moment: Moment, choice: Form) -> tuple[Any, Form]:
        """Return the output for a moment and the form that computed it: the wanted one, or a quick one before."""

    def exactly(self, moment: Moment, form: Form) -> Any:
        """Return the output at a moment in a form; compile the form first if it is new."""

    def advance(self, moment: Moment, choice: Form, steps: int) -> bool:
        """Run some steps and return True; return False while neither the wanted form nor a quick one is compiled."""

    def reset(self) -> None:
        """Restart from the first streams."""

    def is_awaited(self, choice: Form) -> bool:
        """Return whether something is compiled for the wanted form."""

    def refused(self, choice: Form) -> Exception | None:
        """Return the error with which a target refuses the wanted form, which a quick form replaces."""

    def state(self) -> Any:
        """Return the inputs of the present picture besides its moment and Params, for its trace."""

    def stepped(self, state: Any, at: tuple[int, int]) -> tuple[Program, list[Any]] | None:
        """Return the program that wrote the element `at` of what is shown, and its steps; None for no such program."""

    def drawn(self, state: Any, moment: Moment, at: tuple[int, int]) -> tuple[Program, list[Any]] | None:
        """Return the program that computed a pixel and its steps; None where a stream is shown as it is."""

    def sources(self, form: Form) -> list[tuple[str, str]]:
        """Return the name of each program and the text that is emitted for it in a form."""


class Still:
    """A program of pixels."""

    params: Mapping[str, Any]
    evolves: bool = False
    coarse: bool = True
    fresh: bool = False

    def __init__(self, program: Program, wake: Callable[[], None]) -> None:
        self.program = program
        self.kernels = Kernels(program, wake)
        self.takes_mouse = "mouse" in program.inputs
        self.moves = moves(program)
        self.params = program.params

    def draw(self, moment: Moment, choice: Form) -> tuple[Any, Form]:
        """Return the output for a moment and the form that computed it: the wanted one, or a quick one before."""
        kernel, form = self.kernels.best(choice)
        return run_at(kernel, self.program.inputs, moment), form

    def exactly(self, moment: Moment, form: Form) -> Any:
        """Return the output at a moment in a form; compile the form first if it is new."""
        return run_at(self.kernels.exactly(form), self.program.inputs, moment)

    def advance(self, moment: Moment, choice: Form, steps: int) -> bool:
        """Return True: time alone goes on, and no stream is kept."""
        return True

    def reset(self) -> None:
        """Do nothing: a program of pixels keeps no streams."""

    def extent(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return the size that the page has chosen."""
        return size

    def lacks_picture(self, size: tuple[int, int]) -> bool:
        """Return False: a program of pixels needs no step."""
        return False

    def is_awaited(self, choice: Form) -> bool:
        """Return whether something is compiled for the wanted form."""
        return self.kernels.is_awaited(choice)

    def refused(self, choice: Form) -> Exception | None:
        """Return the error with which the target refuses the wanted form."""
        return self.kernels.refused(choice)

    def state(self) -> None:
        """Return None: the moment and the Params tell all."""

    def stepped(self, state: None, at: tuple[int, int]) -> None:
        """Return None: no step precedes a picture."""

    def drawn(self, state: None, moment: Moment, at: tuple[int, int]) -> tuple[Program, list[Any]]:
        """Return the program and the steps of one pixel."""
        return self.program, self.program.trace(**filled(self.program.inputs, moment), shape=moment.shape, at=at)

    def sources(self, form: Form) -> list[tuple[str, str]]:
        """Return the name of the program and the text that is emitted for it in a form."""
        return [(self.program.name, self.kernels.exactly(form).source)]


def subject_of(value: Program | Chain, opened: OpenedFile, wake: Callable[[], None]) -> Subject:
    """Return the subject of a program or chain."""
    return Ongoing(value, opened, wake) if isinstance(value, Chain) else Still(value, wake)
