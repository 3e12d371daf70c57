"""Other widths of a kernel, compiled in another process while the kernel runs: see `widths`.

Stage: compile. The process gets what the kernel was printed from, and answers with the text for the other width and the
driver's binary, which this process loads: that takes a hundredth of the time of compiling.

    builder = Beside(machine, compile_elsewhere, load)
    pending = builder.begin(16)
    executable, seconds = pending.result()                 # once pending.done()
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final, Protocol

from shpy.backend.base import Executable
from shpy.backend.device.answer import Answer
from shpy.backend.opencl.device.background import Refused, background
from shpy.errors import CompileError

if TYPE_CHECKING:
    from shpy.backend.opencl.device.driver import Machine
    from shpy.backend.opencl.text.kernel import Kernel


class Sized(Executable, Protocol):
    """An executable whose packets have one width."""

    @property
    def lanes(self) -> int:
        """Elements of a packet."""


Facts = dict[str, frozenset[str]]
"""The results of trials of the device so far; keys are names of attributes of `Machine`."""
_FACTS: Final = ("wrong", "binary64", "_succeeded", "most_private")


@dataclass(frozen=True, slots=True)
class Compiled:
    """A kernel, the driver's binary, and the seconds of CPU time that they took."""

    kernel: Kernel
    binary: bytes
    seconds: float


@dataclass(frozen=True, slots=True)
class Beside:
    """Compiles for other widths: another process runs `task(facts, lanes)`, and `load` loads its result."""

    machine: Machine
    task: Callable[[Facts, int], Compiled]
    load: Callable[[Compiled], Sized]

    @property
    def busy(self) -> bool:
        """Return whether anything is being compiled, which may slow a run."""
        return background().busy

    def begin(self, lanes: int) -> Waiting:
        """Begin to compile for a width."""
        properties = vars(self.machine)
        facts: Facts = {name: properties[name] for name in _FACTS if name in properties}
        return Waiting(self, background().submit(partial(self.task, facts, lanes)))


@dataclass(frozen=True, slots=True)
class Waiting:
    """A width that is being compiled."""

    beside: Beside
    answer: Answer[Compiled]

    def done(self) -> bool:
        """Return whether the process has answered."""
        return self.answer.ended

    def result(self) -> tuple[Sized, float]:
        """Return the kernel and the seconds of its compilation; CompileError where there is none that can be loaded."""
        try:
            compiled = self.answer.result()
            return self.beside.load(compiled), compiled.seconds
        except (Refused, self.beside.machine.cl.Error) as error:
            raise CompileError(str(error)) from error
