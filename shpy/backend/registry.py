"""The list of backends, and the default one.

Stage: compile. Backends are imported when they are asked for, so the core needs numpy and lark alone.

>>> default_backend()
'auto'
"""

from __future__ import annotations

import importlib
import os
import sys
from dataclasses import dataclass
from typing import Any

from shpy.backend.base import Backend, Device
from shpy.errors import BackendUnavailable, raise_interrupt

_MODULES = {
    "numpy": "shpy.backend.numpy.device.run",
    "opencl": "shpy.backend.opencl.device.building",
    "glsl": "shpy.backend.glsl",
}
"""The module that defines each backend."""
NAMES = tuple(_MODULES)
AUTO = "auto"
"""The name of numpy followed by OpenCL: a policy over two backends (`shpy/run/tiers.py`), and no backend itself."""
CHOICES = (AUTO, *NAMES)
"""The names that `Program.compile` and SHPY_BACKEND take."""

_default: str | None = None
_backends: dict[str, Backend] = {}


@dataclass(frozen=True, slots=True)
class BackendInfo:
    """One backend: its devices, or why it is not available and the command that mends it."""

    name: str
    available: bool
    devices: tuple[Device, ...] = ()
    reason: str | None = None
    cure: str | None = None


def backend(name: str) -> Backend:
    """Return the backend of this name; BackendUnavailable where there is no such backend."""
    result = _backends.get(name) if isinstance(name, str) else None
    if result is None:
        if not isinstance(name, str) or name not in NAMES:
            raise BackendUnavailable(f"there is no backend {name!r}", cure=" or ".join(map(repr, CHOICES)))
        before = sys.exception()
        try:
            result = _backends[name] = importlib.import_module(_MODULES[name]).backend
        except RuntimeError as error:
            raise_interrupt(error, before)
            raise
    return result


def backends() -> list[BackendInfo]:
    """Return every backend with its devices and what they can do, or why it is not available."""
    listed = []
    for name in NAMES:
        try:
            listed.append(BackendInfo(name, True, tuple(backend(name).devices())))
        except BackendUnavailable as error:
            listed.append(BackendInfo(name, False, (), error.message, error.cure))
    return listed


class Default(str):
    """The name of the default backend; `why` is the reason for the choice, and `pinned` is True if the user chose."""

    why: str
    pinned: bool

    def __new__(cls, name: str, why: str, *, pinned: bool = False) -> Default:
        """Return the name with its reason."""
        self = super().__new__(cls, name)
        self.why, self.pinned = why, pinned
        return self

    def __reduce__(self) -> tuple[type[str], tuple[str]]:
        """Pickle the name alone: another process has reasons of its own."""
        return str, (str(self),)


_AUTO_DEFAULT = Default(AUTO, "numpy, then OpenCL with the same bits once it pays")


def default_backend(name: str | None = None, *, long: bool = False) -> Default:
    """Return the default backend's name, with `.why`; with `name`, make that the default.

    Without a choice it is what the environment variable SHPY_BACKEND says, else "auto": numpy, then OpenCL with the
    same bits once it pays. With `long`, it is the backend for work that surely pays for a compilation: OpenCL in place
    of "auto" where its device gives numpy's bits, else numpy. Raises BackendUnavailable for a name without a backend,
    and where the chosen backend is not installed.
    """
    global _default
    if name is not None:
        if name != AUTO:
            backend(name).devices()
        _default = name
    chosen = _default or os.environ.get("SHPY_BACKEND")
    if chosen and chosen not in CHOICES:
        raise BackendUnavailable(f"SHPY_BACKEND names no backend: {chosen!r}", cure=" or ".join(map(repr, CHOICES)))
    if chosen and chosen != AUTO:
        return Default(chosen, f"chosen by {'sh.default_backend' if _default else 'SHPY_BACKEND'}", pinned=True)
    if not long:
        return _AUTO_DEFAULT
    fault = _fault_of_opencl()
    return Default("opencl", "the same bits as numpy") if fault is None else Default("numpy", fault)


def default_place() -> str:
    """Return the name of the backend on which streams lie by default: numpy where that is "auto"."""
    name = default_backend()
    return "numpy" if name == AUTO else name


def _fault_of_opencl() -> str | None:
    """Return why OpenCL cannot go on with numpy's work; None where its first device gives the same bits."""
    try:
        opencl: Any = backend("opencl")
        first = opencl.devices()[0]
        faults = opencl.faults(None)
    except BackendUnavailable as error:
        return f"{error.message}; to mend it: {error.cure}" if error.cure else error.message
    if "f64" not in first.features:
        return f"{first.name} has no binary64, which strict mode needs"
    return f"{first.name} gets {' and '.join(sorted(faults))} wrong" if faults else None
