"""Checks, the targets they run on, and their findings.

Stage: test. A section is a list of checks; a check takes a `DeviceChoice` and gives a `Finding`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from shpy.programs import Program
from shpy.run.kernel import Kernel
from shpy.testing.reference import flushes

Verdict = Literal["same", "denormals", "refused", "absent", "differs", "failed"]
"""`denormals`: the same bits but where a denormal arises; `absent`: it cannot be checked here."""
SHOWN = 3
"""Inputs that are named where results differ."""


@dataclass(frozen=True)
class DeviceChoice:
    """One device of a backend, and the lanes that run together on it; None: its first device, and "auto"."""

    backend: str
    device: int | None = None
    lanes: int | None = None

    @property
    def options(self) -> dict[str, Any]:
        """The options of compiling for it."""
        chosen = {"device": self.device, "lanes": self.lanes}
        return {name: value for name, value in chosen.items() if value is not None}

    def compile(self, program: Program, **more: Any) -> Kernel:
        """Compile a program for it."""
        return program.compile(self.backend, **self.options, **more)

    @property
    def flushes(self) -> bool:
        """Return whether it turns denormals into zeros."""
        return flushes(self.backend, self.device)


@dataclass(frozen=True)
class Finding:
    """The finding of a check: `detail` in a few lines, `hash` of the results, `ulp` the largest error, and warnings."""

    verdict: Verdict
    detail: str = ""
    hash: str | None = None
    ulp: float | None = None
    warnings: tuple[str, ...] = ()

    @property
    def wrong(self) -> bool:
        """Return whether it speaks against the device."""
        return self.verdict in ("differs", "failed")


@dataclass(frozen=True)
class Check:
    """One check by its name."""

    name: str
    run: Callable[[DeviceChoice], Finding]


@dataclass(frozen=True)
class Section:
    """Checks of a kind. By default they end after `seconds` on a target, unless None; those left over are counted."""

    name: str
    title: str
    seconds: float | None
    checks: Sequence[Check]
