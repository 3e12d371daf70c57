"""The compiled forms of one program: the wanted form, and numpy's until that is compiled.

Stage: view. Each form compiles in a thread. numpy's compiles fast, since it needs no driver. OpenCL's driver takes a
second or more, and GLSL's postpones most of its work to the first frame. The wanted form begins to compile when numpy's
first frame is done, so that the two do not compete for the interpreter's lock.

    kernels = Kernels(program, wake)
    kernels.best(Form("opencl", "strict"))       # its kernel and form once it is compiled, numpy's before
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from shpy.backend.registry import backends
from shpy.errors import ShpyError
from shpy.programs import Program

QUICK: Final = "numpy"
"""The backend that draws while another one's driver compiles."""
_HEAD_START: Final = 0.25
"""Seconds after which the wanted form begins to compile even if the quick one has not drawn its first frame."""


@dataclass(frozen=True, slots=True)
class Form:
    """A backend and a mode of floats, as `Program.compile` takes them."""

    backend: str
    math: str

    def __str__(self) -> str:
        return self.backend if self.math == "strict" else f"{self.backend}, {self.math}"


class Kernels:
    """The kernels of one program by their form; a form that a target refuses keeps its error."""

    def __init__(self, program: Program, wake: Callable[[], None]) -> None:
        self.program = program
        self._wake = wake
        self._done = threading.Condition()
        self._results: dict[Form, Any] = {}
        self._begun: set[Form] = set()
        self._later: dict[Form, threading.Timer] = {}

    def best(self, choice: Form) -> tuple[Any, Form]:
        """Return the wanted kernel if compiled, else wait for the quick one; raise if both are refused."""
        there, quick = self._results.get(choice), Form(QUICK, choice.math)
        if there is None or isinstance(there, Exception):
            meanwhile = self._wait(quick)
            if not isinstance(meanwhile, Exception):
                self._begin_later(choice)
                return meanwhile, quick
        return self.exactly(choice), choice

    def wait_for_any(self, choice: Form) -> None:
        """Wait until the wanted form or the quick one is compiled, or is refused."""
        if choice not in self._results:
            self._wait(Form(QUICK, choice.math))

    def exactly(self, form: Form) -> Any:
        """Return the kernel of a form, after compiling it if need be; raise the error if it is refused."""
        kernel = self._wait(form)
        if isinstance(kernel, Exception):
            raise kernel
        return kernel

    def refused(self, form: Form) -> Exception | None:
        """Return the error with which the target refused a form, else None."""
        result = self._results.get(form)
        return result if isinstance(result, Exception) else None

    def is_awaited(self, form: Form) -> bool:
        """Return whether a form is compiling, or about to."""
        return form not in self._results and (form in self._begun or form in self._later)

    def _wait(self, form: Form) -> Any:
        """Wait for a form; return its kernel or the error with which it was refused."""
        self.begin(form)
        with self._done:
            self._done.wait_for(lambda: form in self._results)
        return self._results[form]

    def _begin_later(self, form: Form) -> None:
        """Begin to compile a form at the second call, after a frame of the quick one, or `_HEAD_START` later."""
        if form in self._later or form in self._begun:
            self.begin(form)
            return
        timer = self._later[form] = threading.Timer(_HEAD_START, self.begin, (form,))
        timer.daemon = True
        timer.start()

    def begin(self, form: Form) -> None:
        """Begin to compile a form, if that has not begun."""
        with self._done:
            if form in self._begun:
                return
            self._begun.add(form)
        threading.Thread(target=self._compile, args=(form,), daemon=True).start()

    def _compile(self, form: Form) -> None:
        try:
            result: Any = self.program.compile(form.backend, math=form.math)  # type: ignore[arg-type]
        except Exception as error:  # also from a driver: the page shows it, and other forms continue
            result = error
        with self._done:
            self._results[form] = result
            self._done.notify_all()
        self._wake()


@cache
def available() -> tuple[str, ...]:
    """Return the names of the backends that are available here."""
    return tuple(info.name for info in backends() if info.available)


def preferred() -> str:
    """Return the fastest backend that is available here."""
    return next(name for name in ("opencl", "glsl", "numpy") if name in available())


def warm() -> None:
    """Compile a small program on each backend, which loads modules and opens devices."""
    import numpy as np

    import shpy as sh

    @sh.program
    def small(uv: sh.TexCoord2f) -> sh.Color3f:
        color = sh.Color3f(sh.noise(4 * uv), sh.sin(uv.x), 0)
        with sh.SH_FOR(0, 3) as k, sh.SH_IF(uv.x > 0.2 * k):
            color *= sh.pow(uv.y, 0.5)
        return color

    for name in available():
        try:
            small.compile(name)(np.zeros((4, 4, 2), np.float32))
        except ShpyError:
            continue  # it is said when somebody asks for that backend
