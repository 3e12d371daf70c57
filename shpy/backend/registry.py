"""The list of backends, and the default one.

Stage: compile. Backends are imported when they are asked for, so the core needs numpy and lark alone.

>>> default_backend()
'numpy'
"""

from __future__ import annotations

import importlib
import os
from dataclasses import dataclass

from shpy.backend.base import Backend, Device
from shpy.errors import BackendUnavailable

_MODULES = {
    "numpy": "shpy.backend.numpy.device.run",
    "opencl": "shpy.backend.opencl.device.building",
    "glsl": "shpy.backend.glsl",
}
"""The module that defines each backend."""
NAMES = tuple(_MODULES)

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
            raise BackendUnavailable(f"there is no backend {name!r}", cure=" or ".join(map(repr, NAMES)))
        result = _backends[name] = importlib.import_module(_MODULES[name]).backend
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


def default_backend(name: str | None = None) -> str:
    """Return the default backend's name; with `name`, make that the default.

    Without a choice it is what the environment variable SHPY_BACKEND says, else numpy. Raises BackendUnavailable for a
    name without a backend, and where the chosen backend is not installed.
    """
    global _default
    if name is not None:
        backend(name).devices()
        _default = name
    chosen = _default or os.environ.get("SHPY_BACKEND") or "numpy"
    if chosen not in NAMES:
        raise BackendUnavailable(f"SHPY_BACKEND names no backend: {chosen!r}", cure=" or ".join(map(repr, NAMES)))
    return chosen
