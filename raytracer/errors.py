"""The errors of the ray tracer that are not the language's: each says what is wrong and what would be right."""

from __future__ import annotations

import inspect
import os
import sys
from types import FrameType
from typing import Any

_HOUSE = os.path.dirname(os.path.abspath(__file__)) + os.sep


class SceneError(ValueError):
    """A scene, mesh, picture size or ray cannot be used as it is given."""


def users_line() -> str:
    """The line outside of the ray tracer that is running, as `file.py:12`."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None and os.path.abspath(frame.f_code.co_filename).startswith(_HOUSE):
        frame = frame.f_back
    return "?" if frame is None else f"{os.path.basename(frame.f_code.co_filename)}:{frame.f_lineno}"


def place_of(program: Any) -> str:
    """A function or program by name, with its line where that is known: `toon (file.py:12)`."""
    name = getattr(program, "__name__", None) or getattr(program, "name", None) or type(program).__name__
    code = getattr(inspect.unwrap(program), "__code__", None)
    return f"{name} ({os.path.basename(code.co_filename)}:{code.co_firstlineno})" if code else str(name)
