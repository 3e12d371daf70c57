"""A session: one version of a file in a worker, and the frames of it.

Stage: view. `child` calls it from one thread; `wake` is called from others when a kernel is ready.

    session = Session({"path": "shader.py"}, wake)
    session.set({"size": [640, 360], "params": {"gain": [2]}})
    header, pixels = session.next()          # None where the picture on the page is the right one
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shpy.display.screen import Moment, pixels
from shpy.passes.modes import CONTRACTIONS
from shpy.view import oddities, questions
from shpy.view.controls import Controls
from shpy.view.frames import Frame, History
from shpy.view.kernels import Form, available, preferred, warm as warm_backends
from shpy.view.live import Live
from shpy.view.ongoing import Ongoing
from shpy.view.reading import files_read
from shpy.view.searches import Searches
from shpy.view.source import explain, open_file
from shpy.view.subject import subject_of

_QUICK: Final = 0.15
"""Seconds above which a frame is preceded by a coarse one."""
_COARSE: Final = 0.03
"""The intended seconds of a coarse frame."""
_FIRST: Final = 96
"""Pixels along the longer side of the first picture, when the time per pixel is unknown."""
_KEPT: Final = 4
"""The frames about which a page may ask: those on their way to it, and the one that it shows."""
_REST: Final = 3.0
"""The pause after a quick frame, in durations of the frame, while the wanted kernel compiles on the same processor."""


class Session(Live):
    """The frames of one program or chain for the state of the view."""

    def __init__(
        self, request: dict[str, Any], wake: Callable[[], None], tell: Callable[[dict[str, Any]], None]
    ) -> None:
        """Record the file; errors of its code pass through. `tell` sends a header to the server."""
        super().__init__(request, wake, preferred())
        self.searches = Searches(tell)
        begun = time.monotonic()
        self.opened = open_file(Path(request["path"]))
        self.name, value = self.opened.pick(request.get("program"))
        self.subject = subject_of(value, self.opened, wake)
        self._rest = 0.0
        self.controls = Controls(self.opened.in_order(self.subject.params))
        self.recording = time.monotonic() - begun
        self._extent = self.size
        self.form = Form(self.backend, "strict")
        self.playing, self.encode, self.steps = True, False, 1
        self.mouse = (0.0, 0.0, 0.0, 0.0)
        """In pixels of the full picture."""
        self._drawn: Form | None = None
        """The form that computed the last frame."""
        self.sent: dict[int, Frame] = {}
        """The last frames by their numbers: a page asks about the one that it shows."""
        self._number = 0
        self._stepped: dict[str, list[Any]] = {}
        """The values of the Params in the last step."""
        self._history = History()
        self._refine = False
        self._cost: dict[Form, float] = {}

    def describe(self) -> dict[str, Any]:
        """Return the description of this version for the page: its names, controls and choices."""
        return {
            "program": self.name,
            "programs": list(self.opened.shown),
            "controls": self.controls.describe(),
            "mouse": self.subject.takes_mouse,
            "moves": self.subject.moves,
            "evolves": self.subject.evolves,
            "backends": available(),
            "maths": list(CONTRACTIONS),
            "recording": self.recording,
            "form": [self.form.backend, self.form.mode],
        }

    def files(self) -> list[str]:
        """Return the files whose changes require a new recording."""
        return [str(path) for path in files_read()]

    def set(self, changes: dict[str, Any]) -> list[str]:
        """Change the state of the view; return a message for each Param that refuses its value."""
        super().set(changes)
        self.form = Form.named(self.backend, changes.get("math") or self.form.mode)
        self.encode, self.steps = changes.get("encode", self.encode), changes.get("steps", self.steps)
        if "mouse" in changes:
            x, y, press_x, press_y = map(float, changes["mouse"])
            self.mouse = x, y, press_x, press_y
        self._changed, self._rest = True, 0.0  # a moved slider ends the pause
        return self.controls.assign(changes.get("params", {}))

    def reset(self) -> None:
        """Restart at the time 0, with the first streams of a chain."""
        super().reset()
        self.subject.reset()

    def next(self) -> tuple[dict[str, Any], NDArray[np.uint8]] | None:
        """Return the header and the pixels (height, width, 4) of the next frame; None if nothing has changed."""
        kernels = self.subject.kernels
        if self._rests():
            if kernels is not None:
                kernels.begin(self.form)
            return None
        extent = self._extent = self.subject.extent(self.size)
        if not self._go_on(extent):
            return None
        moment = self._moment(self._coarse_size(extent) if self._changed else extent)
        if kernels is not None:
            kernels.wait_for_any(self.form)  # not part of the frame's time
        begun = time.monotonic()
        output, form = self.subject.draw(moment, self.form)
        seconds = time.monotonic() - begun
        self._cost[form] = seconds / (moment.size[0] * moment.size[1])
        self._changed, self._single = False, False
        self._refine = moment.size != extent
        self._drawn = form
        state = (self.controls.values(), self._stepped, self.subject.state(), form, self._history)
        self._keep(Frame(output, moment, self._moment(extent), *state))
        header = self._header(output, moment, form, seconds)
        shown = pixels(output, encode=self.encode)
        return header, oddities.marked(shown, output) if self.mark else shown

    def _header(self, output: Any, moment: Moment, form: Form, seconds: float) -> dict[str, Any]:
        """Return the header of a frame; begin a pause where the wanted kernel is still compiled."""
        awaited, refused = self.subject.is_awaited(self.form), self.subject.refused(self.form)
        if form != self.form and awaited:
            self._pause(_REST * seconds)
        return {
            "width": moment.size[0],
            "height": moment.size[1],
            "extent": self._extent,
            "time": self.time,
            "frame": self.frame,
            "milliseconds": 1000 * seconds,
            "form": str(form),
            "coarse": moment.size != self._extent,
            "odd": oddities.counts(output),
            "waiting": str(self.form) if awaited else None,
            "meanwhile": form != self.form,
            **({} if refused is None else {"refused": self.explain(refused)}),
        }

    def _keep(self, frame: Frame) -> None:
        """Keep what a frame was made of, and forget that of a frame that no page shows any more."""
        self._number += 1
        self.sent[self._number] = frame
        self.sent.pop(self._number - _KEPT, None)

    def _determining(self) -> Any:
        """Return the Params and the mouse that a step of a chain reads."""
        if not isinstance(self.subject, Ongoing):
            return None
        params = {name: value for name, value in self._stepped.items() if name in self.subject.stepping}
        return params, self.mouse if "mouse" in self.subject.read else None

    def woken(self) -> None:
        """Compute the picture again if the wanted kernel has become ready; at the end of a pause do nothing."""
        self._changed |= self._drawn != self.form and not self.subject.is_awaited(self.form)

    def _pause(self, seconds: float) -> None:
        """Compute no frame for these seconds, or until the wanted kernel is ready."""
        self._rest = time.monotonic() + seconds
        self.wake_after(seconds + 0.001)  # just after the end of the pause, since the timer fires once

    def _rests(self) -> bool:
        """Return whether a pause lasts; it ends early if the wanted kernel is ready."""
        return time.monotonic() < self._rest and self.subject.is_awaited(self.form)

    def _go_on(self, extent: tuple[int, int]) -> bool:
        """Advance if that is due; return whether there is another frame to draw."""
        if self.subject.fresh:
            self.time, self.frame, self._history = 0.0, 0, History()
        lacking = self.subject.lacks_picture(self.size)
        if self.subject.moves and (self.playing or self._single or lacking):
            self._advance(extent)
        return (self._changed or self._refine) and not (lacking and self.subject.lacks_picture(self.size))

    def _advance(self, extent: tuple[int, int]) -> None:
        passed = self.passed(1 / 60)
        if self.subject.advance(self._moment(extent), self.form, self.steps):
            self._stepped = self.controls.values()
            self._history = self._history.after(self.steps, self._determining())
            self.time += passed
            self.frame += 1
            self._changed = True

    def _moment(self, size: tuple[int, int]) -> Moment:
        """Return the moment at a size; the mouse is in pixels of that size."""
        ratio = size[0] / self._extent[0], size[1] / self._extent[1]
        x, y, press_x, press_y = (m * r for m, r in zip(self.mouse, 2 * ratio, strict=True))
        return Moment(size, self.time, self.frame, (x, y, press_x, press_y))

    def _coarse_size(self, full: tuple[int, int]) -> tuple[int, int]:
        """Return the size of the next frame: smaller than the full one if that would take long."""
        count = full[0] * full[1]
        if not self.subject.coarse:
            return full
        costs = [self._cost[form] for form in (self.form, *self._cost) if form in self._cost]
        scale = least = min(1.0, _FIRST / max(full))
        if costs:
            cost = costs[0] * count
            quick = 2 * _QUICK if self.playing and self.subject.moves else _QUICK
            # A few pixels take as long as the call itself, so fewer would not be faster.
            scale = 1.0 if cost < quick else min(1.0, max(least, (_COARSE / cost) ** 0.5))
        return max(1, round(scale * full[0])), max(1, round(scale * full[1]))

    def answer(self, question: dict[str, Any]) -> tuple[dict[str, Any], Any]:
        """Return the answer to a question about the picture, and its bytes."""
        return questions.answer(self, question)

    def cancel(self, page: int | None) -> None:
        """Cancel the search that a comparison of this page began; None cancels them for all pages."""
        self.searches.cancel(page)

    def explain(self, error: BaseException) -> dict[str, Any]:
        """Return an error for the page."""
        return explain(error, self.opened.path)


def explain_opening(error: BaseException, request: dict[str, Any]) -> dict[str, Any]:
    """Return, for the page, the error of a file that could not be recorded, and the files to watch for changes."""
    return {**explain(error, Path(request["path"])), "files": [str(path) for path in files_read()]}


def warm() -> None:
    """Load the modules and devices that a session will need."""
    warm_backends()
