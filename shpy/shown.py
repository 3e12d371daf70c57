"""Objects that a notebook shows as pictures.

Stage: above all others. What makes the pictures runs programs and stands above; it is bound when it is imported.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

_picture: Final[list[Callable[[Any], bytes | None]]] = []


def show_by(picture: Callable[[Any], bytes | None]) -> None:
    """Have pictures made by this function: the PNG file of an object, or None for one that has no picture."""
    _picture[:] = [picture]


class Shown:
    """An object that a notebook shows as a picture, where it has one, and else by its text."""

    def _repr_png_(self) -> bytes | None:
        return _picture[0](self) if _picture else None
