"""The widget of a program or chain. The page asks for a frame after it has drawn the last, so frames do not queue.

Stage: view. `widget.js` draws, and has the controls of `shpy view`; this module computes the frames.

    page  ──{"time", "frame", "mouse", "steps", "params"}──▶  Canvas
    page  ◀──{"params", "milliseconds"} + pixels────────────   Canvas
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from contextlib import suppress
from importlib.resources import files
from typing import Any

import anywidget
import numpy as np
import traitlets
from numpy.typing import NDArray

from shpy.display.png import png
from shpy.display.screen import Moment, pixels
from shpy.notebook.drawn import Pixels, Running
from shpy.view.controls import Controls


def _script() -> str:
    """Return the widget's JavaScript module: the elements and controls of `shpy view`, then the widget's own code."""
    page, own = files("shpy.view") / "page", files("shpy.notebook")
    parts = [page / "elements.js", page / "controls.js", own / "widget.js"]
    text = "\n".join(re.sub(r"^import .*$", "", part.read_text(), flags=re.MULTILINE) for part in parts)
    return re.sub(r"^export (?!default)", "", text, flags=re.MULTILINE)


class Canvas(anywidget.AnyWidget):  # type: ignore[misc, no-any-unimported, unused-ignore]
    """A picture with its controls: see `sh.widget`."""

    _esm = _script()
    _css = (files("shpy.notebook") / "widget.css").read_text()
    title = traitlets.Unicode().tag(sync=True)
    extent = traitlets.List(traitlets.Int()).tag(sync=True)
    controls: Any = traitlets.List().tag(sync=True)
    moves = traitlets.Bool().tag(sync=True)
    evolves = traitlets.Bool().tag(sync=True)
    steps = traitlets.Int().tag(sync=True)

    def __init__(self, shown: Pixels | Running, encode: bool) -> None:
        self._shown, self._encode = shown, encode
        self._controls = Controls(shown.params)
        kind = {"moves": shown.moves, "evolves": shown.evolves, "steps": shown.steps}
        extent = [int(n) for n in shown.size]
        super().__init__(title=shown.title, extent=extent, controls=self._controls.describe(), **kind)
        self.on_msg(self._answer)

    def frame(self, time: float = 0.0, frame: int = 0, mouse: Any = (0, 0, 0, 0)) -> NDArray[np.uint8]:
        """Return the pixels (height, width, 4) in sRGB; `time` in seconds, `mouse` as in `sh.animate`."""
        x, y, press_x, press_y = map(float, mouse)
        moment = Moment(self._shown.size, float(time), int(frame), (x, y, press_x, press_y))
        return pixels(self._shown.draw(moment), encode=self._encode)

    def _answer(self, _widget: Any, asked: Mapping[str, Any], _buffers: Any) -> None:
        """Set the Params, and send the frame that was asked for, or the message of what went wrong."""
        refused = self._controls.assign(asked.get("params", {}))
        self._shown.steps = int(asked.get("steps", self._shown.steps))
        begun = time.monotonic()
        try:
            levels = self.frame(asked.get("time", 0), asked.get("frame", 0), asked.get("mouse", (0, 0, 0, 0)))
        except Exception as error:  # drivers raise errors of any type; the widget shows them and continues
            self.send({"error": str(error)})
            return
        spent = 1000 * (time.monotonic() - begun)
        told = {"params": self._controls.values(), "error": "\n".join(refused), "milliseconds": spent}
        self.send(told, buffers=[levels.tobytes()])

    def _repr_mimebundle_(self, **options: Any) -> Any:
        """Return the widget, and its first picture for what shows no widgets.

        A frame that fails has no picture: the page asks for it, too, and is sent the error.
        """
        bundle = super()._repr_mimebundle_(**options)
        data = bundle[0] if isinstance(bundle, tuple) else bundle
        if data is not None:
            with suppress(Exception):
                picture = png(self.frame())
                data.update({"image/png": picture} if picture else {})
        return bundle
