"""Objects that a notebook shows as pictures.

Stage: above all others. Making a picture runs programs, which stand above these objects, so `show_by` sets the function
that makes it when that module is imported.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

_picture: Final[list[Callable[[Any], bytes | None]]] = []


def show_by(picture: Callable[[Any], bytes | None]) -> None:
    """Set what makes pictures, `shpy.pictures.png.picture`: it returns the PNG file of an object, None without one."""
    _picture[:] = [picture]


class Shown:
    """An object that a notebook shows as a picture, where it has one, and else by its text."""

    def _repr_png_(self) -> bytes | None:
        return _picture[0](self) if _picture else None
