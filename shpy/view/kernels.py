"""The compiled forms of one program: the one that was asked for, and a quick one until it is there.

Stage: view. Each form compiles in a thread. The quick one is GLSL's, whose text is short and whose driver compiles
fast, or numpy's, whichever is there first; OpenCL's driver takes a second, or more.

    kernels = Kernels(program, wake)
    kernels.best(Form("opencl", "strict"))       # its kernel and form once it is compiled, a quick one's before
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from shpy.backends.registry import backends
from shpy.errors import ShpyError
from shpy.program import Program

_HEAD_START: Final = 0.12
"""Seconds after which numpy compiles too, where GLSL's driver has not finished."""


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
        self._lock = threading.Lock()
        self._found: dict[Form, Any] = {}
        self._begun: dict[Form, float] = {}

    def best(self, wanted: Form) -> tuple[Any, Form]:
        """Return the wanted kernel, else a quick one that is there; waits for the first, raises where it is refused."""
        deadline = time.monotonic() + _HEAD_START
        quick = [Form(name, wanted.math) for name in quick_backends() if name != wanted.backend]
        self._begin(*quick[:1] or [wanted])
        while True:
            for form in (wanted, *quick):
                kernel = self._found.get(form)
                if kernel is not None and not isinstance(kernel, Exception):
                    self._begin(wanted)  # once the processor is free of the quick one
                    return kernel, form
            self._raise_refused(wanted)
            if time.monotonic() > deadline or any(isinstance(self._found.get(f), Exception) for f in quick):
                self._begin(*quick, wanted)
            time.sleep(0.002)

    def exactly(self, form: Form) -> Any:
        """Return the kernel of a form, compiled now where it is not there; raises where it is refused."""
        self._begin(form)
        while form not in self._found:
            time.sleep(0.002)
        self._raise_refused(form)
        return self._found[form]

    def refused(self, form: Form) -> Exception | None:
        """Return the error with which the target refused a form; None where it did not."""
        found = self._found.get(form)
        return found if isinstance(found, Exception) else None

    def waiting(self, form: Form) -> float | None:
        """Return the seconds for which a form has been compiling; None where it is not."""
        begun = self._begun.get(form)
        return None if begun is None or form in self._found else time.monotonic() - begun

    def _raise_refused(self, form: Form) -> None:
        error = self.refused(form)
        if error is not None:
            raise error

    def _begin(self, *forms: Form) -> None:
        for form in forms:
            with self._lock:
                if form in self._begun:
                    continue
                self._begun[form] = time.monotonic()
            threading.Thread(target=self._compile, args=(form,), daemon=True).start()

    def _compile(self, form: Form) -> None:
        try:
            made: Any = self.program.compile(form.backend, math=form.math)  # type: ignore[arg-type]
        except Exception as error:  # of a driver too: the page shows it, and other forms go on
            made = error
        self._found[form] = made
        self._wake()


def quick_backends() -> tuple[str, ...]:
    """Return the backends that compile fast, the fastest first."""
    return ("glsl", "numpy") if "glsl" in available() else ("numpy",)


@cache
def available() -> tuple[str, ...]:
    """Return the names of the backends that there are here."""
    return tuple(info.name for info in backends() if info.available)


def preferred() -> str:
    """Return the fastest backend that there is here."""
    return next(name for name in ("opencl", "glsl", "numpy") if name in available())


def warm() -> None:
    """Load what compiling loads, and open the devices, by a small program on each backend."""
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
