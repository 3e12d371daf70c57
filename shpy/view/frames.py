"""Frames that were sent, with their inputs: a page asks about the frame that it shows, which has passed by then.

Stage: view.

    frame = session.sent[number]
    frame.output[row, column]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from shpy.display.screen import Moment
from shpy.view.kernels import Form


@dataclass(frozen=True)
class History:
    """The way of a chain to its picture: the steps of each frame, and whether these and its inputs stayed the same."""

    steps: int = 1
    steady: bool = True
    read: Any = None

    def after(self, steps: int, read: Any) -> History:
        """Return the history with one more frame."""
        same = self.read is None or (self.steps, self.read) == (steps, read)
        return History(steps, self.steady and same, read)


@dataclass(frozen=True)
class Frame:
    """A frame that was sent: its output, and all that made it."""

    output: Any
    moment: Moment
    whole: Moment
    """The moment of the full picture, of which a coarse frame has fewer pixels."""
    params: dict[str, list[Any]]
    stepped: dict[str, list[Any]]
    """The values of the Params in the step before the picture."""
    state: Any
    form: Form
    history: History
