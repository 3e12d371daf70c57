"""Programs that are recorded when they are first needed: importing the ray tracer records none.

Stage: accelerate.

    @LateProgram
    def doubled(x: sh.Attrib1f) -> sh.Attrib1f:
        return 2 * x

    doubled.on("opencl")(array)          # compiled once for each backend
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import shpy as sh


class LateProgram:
    """A program of a function, which is recorded on first use."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self._kernels: dict[str, Any] = {}

    @cached_property
    def program(self) -> Any:
        """The recorded program."""
        return sh.program(self.function)

    def on(self, backend: str) -> Any:
        """Return the kernel on a backend."""
        if backend not in self._kernels:
            # No loop limit: each loop visits every triangle, box or sample at most once.
            self._kernels[backend] = self.program.compile(backend, loop_limit=None)
        return self._kernels[backend]
