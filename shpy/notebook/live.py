"""`sh.widget`: a program of pixels in a notebook, with a slider for each of its Params.

Stage: view.

    sh.widget(planet, size=(640, 360))
"""

from __future__ import annotations

from typing import Any

from shpy.errors import ShpyError, ShpyTypeError
from shpy.lang.recording.location import here
from shpy.packages import install
from shpy.passes.modes import Math
from shpy.program import Program
from shpy.screen import check_pictures


def widget(
    program: Program,
    *,
    size: tuple[int, int] = (512, 512),
    backend: str | None = None,
    math: Math = "strict",
    encode: bool = False,
    **values: Any,
) -> Any:
    """Return a widget that shows a program of pixels of `size` (width, height), with controls for its Params.

    This process computes the frames, on any backend, and sets the Params' values: `gain.value` is what the slider says,
    and what is set in another cell shows. Inputs are filled by name as `sh.animate` does; `mouse` follows the pointer
    while it is pressed. `values` are the other inputs. With `encode`, numbers are linear light, which becomes sRGB.
    Raises ShpyTypeError for what is no program of pixels; ShpyError, with the command that brings it, where anywidget
    is missing.
    """
    if not isinstance(program, Program):
        raise ShpyTypeError(f"{program!r} is no program", loc=here(), cure="sh.widget(program); sh.animate for chains")
    check_pictures(program, size, values)
    try:
        from shpy.notebook.canvas import Canvas
    except ImportError as error:
        raise ShpyError(f"widgets need anywidget: {install('anywidget')}", loc=here()) from error
    return Canvas(program, size, backend, math, encode, values)
