"""Find the object that a name or a path of the text means in a running frame, without running anything.

Stage: record. Takes an expression's tree and the frame; returns the object, None if it is unknown or None itself.

    x → the local or global x      self.k → the instance's k      math.sin → the function
"""

from __future__ import annotations

import ast
import inspect
from types import FrameType
from typing import Any

from shpy.lang.recording.symbolic import Symbolic


def is_vector(thing: object) -> bool:
    """Return whether this is a scalar or vector of the language, or the class of one."""
    cls = thing if isinstance(thing, type) else type(thing)
    return issubclass(cls, Symbolic) and hasattr(cls, "base")


def named(node: ast.expr, frame: FrameType | None) -> Any:
    """Return the object that a name, or a path of attributes, means in `frame`; None without a frame."""
    if frame is None:
        return None
    if isinstance(node, ast.Name):
        for names in (frame.f_locals, frame.f_globals, frame.f_builtins):
            if node.id in names:
                return names[node.id]
        return None
    if isinstance(node, ast.Attribute):
        owner = named(node.value, frame)
        return None if owner is None or is_vector(owner) else _attribute(owner, node.attr)
    return None


def _attribute(owner: object, name: str) -> Any:
    """Return an attribute that is stored, not computed."""
    value = inspect.getattr_static(owner, name, None)
    if isinstance(value, staticmethod):
        return value.__func__
    return None if inspect.isdatadescriptor(value) else value
