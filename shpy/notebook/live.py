"""`sh.widget`: show a program of pixels or a running chain in a notebook, with a slider for each Param.

Stage: view.

    sh.widget(planet, size=(640, 360))
    sh.widget(sh.repeat(react, 1), show=colors, steps=20, u=u, v=v)
"""

from __future__ import annotations

from typing import Any

from shpy.backend.registry import NAMES, default_backend
from shpy.chains.chain import Chain
from shpy.display.screen import check_pictures
from shpy.errors import ShpyError, ShpyTypeError
from shpy.lang.recording.location import here
from shpy.notebook.drawn import Pixels, Running
from shpy.packages import install
from shpy.passes.modes import Math
from shpy.programs import Program
from shpy.view.kernels import Form


def widget(
    shown: Program | Chain,
    *,
    size: tuple[int, int] | None = None,
    show: Program | None = None,
    steps: int = 1,
    backend: str | None = None,
    math: Math = "strict",
    fuse: bool = False,
    encode: bool = False,
    **values: Any,
) -> Any:
    """Return a notebook widget that shows a program of pixels or a running chain, with controls for its Params.

    This process computes the frames, on any backend, and sets the Params' values: `gain.value` follows the slider, and
    the slider follows a value set in another cell. Inputs are filled by name as `sh.animate` does; `mouse` follows the
    pointer while it is pressed. numpy draws while the driver of another backend compiles. `values` are the other
    inputs. With `encode`, numbers are linear light, which becomes sRGB. `size` is (width, height) of a program's
    picture, (512, 512) by default.

    A chain is run `steps` times for each frame, which a field of the widget changes; `values` are its first streams,
    and `show` is the program that makes colours of its streams, as in `sh.animate`.

    Raises ShpyTypeError for anything but a program of pixels or a chain with its streams; ShpyError, with the command
    that installs it, where anywidget is missing.
    """
    if backend not in (None, *NAMES):
        cure = " or ".join(f'backend="{name}"' for name in NAMES)
        raise ShpyTypeError(f"backend={backend!r} names no backend", loc=here(), cure=cure)
    drawn: Pixels | Running
    if isinstance(shown, Chain):
        if math != "strict" or fuse:
            cure = f"sh.repeat(step.compile({'fuse=True' if fuse else f'math={math!r}'}), 8)"
            raise ShpyTypeError("math= is for programs; the kernels of a chain have their own", loc=here(), cure=cure)
        drawn = Running(shown, show, values, size=size, steps=steps, backend=backend)
    elif isinstance(shown, Program):
        if show is not None:
            raise ShpyTypeError("show= makes colours of the streams of a chain", loc=here(), cure="show << program")
        check_pictures(shown, size or (512, 512), values)
        for name in values.keys() - shown.inputs.keys():
            message = f"{name} is a Param of {shown.name}, for which the widget has a control"
            raise ShpyTypeError(message, loc=here(), cure=f"{name}.value = …")
        drawn = Pixels(shown, size or (512, 512), Form(backend or default_backend(), math, fuse), values)
    else:
        raise ShpyTypeError(f"{shown!r} is neither a program nor a chain", loc=here(), cure="sh.widget(program)")
    try:
        from shpy.notebook.canvas import Canvas
    except ImportError as error:
        raise ShpyError(f"widgets need anywidget: {install('anywidget')}", loc=here()) from error
    return Canvas(drawn, encode)
