"""The compiled forms of one program: the wanted form, and numpy's until that is compiled.

Stage: view. Each form compiles in a thread. numpy's compiles fast, since it needs no driver. OpenCL's driver takes a
second or more, and GLSL's postpones most of its work to the first frame. The wanted form begins to compile when numpy's
first frame is done, so that the two do not compete for the interpreter's lock.

    kernels = Kernels(program, wake)
    kernels.best(Form("opencl", "strict"))       # its kernel and form once it is compiled, numpy's before
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Final

from shpy.backend.registry import backends
from shpy.errors import ShpyError
from shpy.passes.modes import CONTRACTIONS, mode_name
from shpy.programs import Program
from shpy.run.background import Background

QUICK: Final = "numpy"
"""The backend that draws while another one's driver compiles."""
_HEAD_START: Final = 0.25
"""Seconds after which the wanted form begins to compile even if the quick one has not drawn its first frame."""


@dataclass(frozen=True, slots=True)
class Form:
    """A backend and a mode of floats, as `Program.compile` takes them."""

    backend: str
    math: str
    fuse: bool = False

    @classmethod
    def named(cls, backend: str, mode: str) -> Form:
        """Return the form of a mode by its name on the page, such as "strict fused"."""
        return cls(backend, *CONTRACTIONS[mode])

    @property
    def mode(self) -> str:
        """The name of the mode on the page."""
        return mode_name(self.math, self.fuse)

    @property
    def options(self) -> dict[str, Any]:
        """The keywords of `Program.compile` besides the backend."""
        return {"math": self.math, "fuse": self.fuse}

    def quick(self) -> Form:
        """Return the form with the same bits, or nearly so, that is compiled at once."""
        return replace(self, backend=QUICK)

    def __str__(self) -> str:
        return self.backend if self.mode == "strict" else f"{self.backend}, {self.mode}"


class Kernels:
    """The kernels of one program by their form; a form that a target refuses keeps its error."""

    def __init__(self, program: Program, wake: Callable[[], None]) -> None:
        self.program = program
        self._compiled: Background[Form, Any] = Background(wake)

    def best(self, choice: Form) -> tuple[Any, Form]:
        """Return the wanted kernel if compiled, else wait for the quick one; raise if both are refused."""
        if not self._compiled.is_done(choice):
            quick = choice.quick()
            self.wait_for_any(choice)
            if self._compiled.is_done(quick):
                self._compiled.begin_after(_HEAD_START, choice, partial(self._compile, choice))
                return self.exactly(quick), quick
        return self.exactly(choice), choice

    def wait_for_any(self, choice: Form) -> None:
        """Wait until the wanted form or the quick one is compiled, or is refused."""
        if not self._compiled.is_done(choice):
            quick = choice.quick()
            self.begin(quick)
            self._compiled.wait(quick)

    def exactly(self, form: Form) -> Any:
        """Return the kernel of a form, after compiling it if need be; raise the error if it is refused."""
        self.begin(form)
        return self._compiled.result(form)

    def refused(self, form: Form) -> Exception | None:
        """Return the error with which the target refused a form, else None."""
        return self._compiled.error(form)

    def is_awaited(self, form: Form) -> bool:
        """Return whether a form is compiling, or about to."""
        return self._compiled.is_awaited(form)

    def begin(self, form: Form) -> None:
        """Begin to compile a form, if that has not begun."""
        self._compiled.begin(form, partial(self._compile, form))

    def _compile(self, form: Form) -> Any:
        return self.program.compile(form.backend, **form.options)


@cache
def available() -> tuple[str, ...]:
    """Return the names of the backends that are available here."""
    return tuple(info.name for info in backends() if info.available)


def preferred() -> str:
    """Return the fastest backend that is available here."""
    return next(name for name in ("opencl", "glsl", "numpy") if name in available())


def warm() -> None:
    """Compile a small program on each backend, which loads modules and opens devices.

    A larger one, of noise and powers, took .15 s more of each process and left its first kernel no sooner.
    """
    import numpy as np

    import shpy as sh

    @sh.program
    def small(uv: sh.TexCoord2f) -> sh.Color3f:
        color = sh.Color3f(uv.x, sh.sin(uv.x), 0)
        with sh.SH_FOR(0, 3) as k, sh.SH_IF(uv.x > 0.2 * k):
            color *= uv.y
        return color

    for name in available():
        try:
            small.compile(name)(np.zeros((4, 4, 2), np.float32))
        except ShpyError:
            continue  # the error appears when the user chooses that backend
