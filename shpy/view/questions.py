"""Questions about a picture: the value of a pixel, and the steps that led to it.

Stage: view. A page asks, the worker answers between two frames.

    answer(session, {"about": "value", "at": [row, column]})    # ({"value": [0.2, 0.4, 1.0]}, b"")

A comparison is answered twice: at once with the pixels of both forms, and with the statement at which they diverge once
that is found (`searches`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from shpy.errors import ShpyError
from shpy.lang.recording.text import written
from shpy.screen import Moment, pixels
from shpy.units import steps
from shpy.view.kernels import Form
from shpy.view.searches import Searches
from shpy.view.subject import Still, Subject

_LIBRARY: Final = Path(__file__).parents[1]
"""The folder of shpy, whose own steps, as of noise, are counted and not sent."""
_STEPS: Final = 400
"""The most steps of a trace that are sent: the first and the last ones."""
_ALONE: Final = "a program of pixels; or shpy.testing.first_divergence for a step of the chain"


class Asked(Protocol):
    """The part of a session's interface that questions use."""

    subject: Subject
    output: Any
    moment: Moment
    size: tuple[int, int]
    form: Form
    encode: bool
    searches: Searches

    def wanted_moment(self) -> Moment:
        """Return the moment of the full picture."""


def answer(session: Asked, question: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    """Return the answer and its bytes. Errors of a run pass through."""
    match question:
        case {"about": "value", "at": at}:
            return value(session, at), b""
        case {"about": "trace", "at": at}:
            return trace(session, at), b""
        case {"about": "compare", "with": {"backend": backend, "math": math}}:
            return compare(session, Form(backend, math), question["page"])
        case _:
            return {"problem": f"there is no answer about {question['about']}"}, b""


def value(session: Asked, at: list[int]) -> dict[str, Any]:
    """Return the numbers of a pixel in the last frame."""
    if session.output is None:
        return {"at": at, "value": None}
    row, column = _scaled(at, session.size, session.moment.size)
    found = np.atleast_1d(np.asarray(session.output)[row, column])
    return {"at": at, "value": found, "coarse": session.moment.size != session.size}


def _scaled(at: list[int], size: tuple[int, int], there: tuple[int, int]) -> tuple[int, int]:
    """Return the row and column of a pixel in a picture of another size."""
    row, column = (min(max(int(n), 0), most - 1) for n, most in zip(at, (size[1], size[0]), strict=True))
    return row * there[1] // size[1], column * there[0] // size[0]


def trace(session: Asked, at: list[int]) -> dict[str, Any]:
    """Return the steps of a pixel, each with its line, name, value and iterations, and the text of the lines."""
    moment = session.wanted_moment()
    row, column = _scaled(at, session.size, session.size)
    program, found = session.subject.trace(moment, (row, column))
    shown = [step for step in found if step.loc is None or not Path(step.loc.file).is_relative_to(_LIBRARY)]
    inside, left_out = len(found) - len(shown), max(0, len(shown) - _STEPS)
    kept = shown if not left_out else [*shown[: _STEPS // 2], *shown[-_STEPS // 2 :]]
    sent = [
        {
            "file": step.loc.file if step.loc else None,
            "line": step.loc.line if step.loc else None,
            "source": written(step.loc),
            "name": step.name,
            "value": np.atleast_1d(step.value),
            "iterations": list(step.iterations),
        }
        for step in kept
    ]
    return {"at": [row, column], "program": program.name, "steps": sent, "left_out": left_out, "inside": inside}


def compare(session: Asked, other: Form, page: int) -> tuple[dict[str, Any], bytes]:
    """Return the differences between the picture in the wanted form and in another one, and three pictures in a row.

    These are both pictures and their difference, which is white where it is largest.
    """
    moment, subject = session.wanted_moment(), session.subject
    if not isinstance(subject, Still):
        raise ShpyError("the frames of a chain are not compared: each follows from those before", cure=_ALONE)
    forms = session.form, other
    outputs = [np.atleast_3d(np.asarray(subject.exactly(moment, form))) for form in forms]
    one, two = (output.astype(np.float64) for output in outputs)
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.abs(one - two)
    differs = (one != two) & ~(np.isnan(one) & np.isnan(two))
    places = differs.any(axis=-1)
    apart = np.where(differs, apart, 0).max(axis=-1)
    largest = float(np.nanmax(apart, initial=0))
    header = {
        "names": [str(form) for form in forms],
        "width": moment.size[0],
        "height": moment.size[1],
        "count": places.size,
        "differing": int(places.sum()),
        "largest": largest,
        "ulp": float(np.max(steps(*outputs), initial=0)) if outputs[0].dtype.kind == "f" else None,
        "searching": bool(places.any()),
    }
    # Even the smallest difference has to be visible.
    shade = np.where(places, 0.35 + 0.65 * np.nan_to_num(apart / (largest or 1), nan=1.0), 0)
    pictures = [pixels(output, encode=session.encode) for output in outputs] + [pixels(shade)]
    if header["searching"]:
        session.searches.begin(page, subject.program, moment, forms, int(np.flatnonzero(places)[0]))
    return header, b"".join(picture.tobytes() for picture in pictures)
