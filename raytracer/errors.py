"""The errors of the ray tracer that are not the language's: each names the mistake and the cure."""

from __future__ import annotations

import inspect
import os
import sys
import warnings
from types import CodeType, FrameType
from typing import Any

import shpy as sh

_HOUSE = os.path.dirname(os.path.abspath(__file__)) + os.sep


class SceneError(ValueError):
    """A scene, mesh, picture size or ray cannot be used as it is given."""


class ClusterError(RuntimeError):
    """A Dask cluster cannot be reached, or cannot do the requested work; the message says why."""


def users_line() -> str:
    """Return the line outside of the ray tracer that is running, as `file.py:12`."""
    frame, _ = _users_frame()
    return "?" if frame is None else f"{os.path.basename(frame.f_code.co_filename)}:{frame.f_lineno}"


def warn(message: str) -> None:
    """Give an sh.ShpyWarning that names the line outside of the ray tracer that is running."""
    _, depth = _users_frame()
    warnings.warn(message, sh.ShpyWarning, stacklevel=depth)


def _users_frame() -> tuple[FrameType | None, int]:
    """Return the innermost frame outside of the ray tracer, and its distance from the caller of this function."""
    frame: FrameType | None = sys._getframe(1)
    depth = 1
    while frame is not None and _is_ours(frame.f_code):
        frame, depth = frame.f_back, depth + 1
    return frame, depth


def _is_ours(code: CodeType) -> bool:
    """Return True for the ray tracer's code, and for a constructor that dataclasses wrote, which has no file."""
    written = code.co_filename == "<string>" and code.co_name == "__init__"
    return written or os.path.abspath(code.co_filename).startswith(_HOUSE)


def place_of(program: Any) -> str:
    """Return the name of a function or program, with its line where that is known: `toon (file.py:12)`."""
    name = getattr(program, "__name__", None) or getattr(program, "name", None) or type(program).__name__
    code = getattr(inspect.unwrap(program), "__code__", None)
    return f"{name} ({os.path.basename(code.co_filename)}:{code.co_firstlineno})" if code else str(name)
