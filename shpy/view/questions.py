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
from numpy.typing import NDArray

from shpy.display.png import png
from shpy.display.screen import pixels
from shpy.errors import ShpyError
from shpy.lang.recording.text import written
from shpy.packages import install
from shpy.tracing import Step
from shpy.units import steps
from shpy.view import oddities
from shpy.view.controls import Controls
from shpy.view.kernels import Form
from shpy.view.recipes import recipe
from shpy.view.searches import Searches
from shpy.view.subject import Still, Subject

_LIBRARY: Final = Path(__file__).parents[1]
"""The folder of shpy, whose own steps, as of noise, are counted and not sent."""
_STEPS: Final = 400
"""The most steps of a trace that are sent: the first and the last ones."""
_SHOW: Final = "one step of the view, or a program show, which is traced in any case"
_ALONE: Final = "a program of pixels; or shpy.testing.first_divergence for a step of the chain"


class QuestionSession(Protocol):
    """The part of a session's interface that questions use."""

    subject: Subject
    controls: Controls
    sent: dict[int, Any]
    form: Form
    encode: bool
    searches: Searches


def answer(session: QuestionSession, question: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    """Return the answer and its bytes. Errors of a run pass through."""
    frame = shown(session, question)
    if frame is None:
        return {"problem": "that frame has gone; pause the view first", "at": question.get("at")}, b""
    match question:
        case {"about": "value", "at": at}:
            return value(frame, at), b""
        case {"about": "trace", "at": at}:
            return trace(session, frame, at), b""
        case {"about": "odd"}:
            at = oddities.first(frame.output)
            if at is None:
                return {"problem": "all pixels of this frame are finite"}, b""
            return trace(session, frame, _whole(at, frame)), b""
        case {"about": "picture"}:
            return picture(session, frame)
        case {"about": "recipe"}:
            return recipe(session, frame), b""
        case {"about": "text"}:
            texts = session.subject.sources(frame.form)
            return {"form": str(frame.form), "texts": [{"name": name, "text": text} for name, text in texts]}, b""
        case {"about": "compare", "with": {"backend": backend, "math": math}}:
            return compare(session, frame, Form.named(backend, math), question["page"])
        case _:
            return {"problem": f"there is no answer about {question['about']}"}, b""


def shown(session: QuestionSession, question: dict[str, Any]) -> Any:
    """Return the frame that the page shows, by its number; without a number the last one; None if it has gone."""
    number = question.get("number", max(session.sent, default=0))
    return session.sent.get(number)


def value(frame: Any, at: list[int]) -> dict[str, Any]:
    """Return the numbers of a pixel in a frame."""
    row, column = _scaled(at, frame)
    numbers = np.atleast_1d(np.asarray(frame.output)[row, column])
    return {"at": at, "value": numbers, "coarse": frame.moment.size != frame.whole.size, "frame": frame.moment.frame}


def _scaled(at: list[int], frame: Any) -> tuple[int, int]:
    """Return the row and column in a frame of a pixel of the full picture."""
    (width, height), there = frame.whole.size, frame.moment.size
    row, column = (min(max(int(n), 0), most - 1) for n, most in zip(at, (height, width), strict=True))
    return row * there[1] // height, column * there[0] // width


def _whole(place: tuple[int, int], frame: Any) -> list[int]:
    """Return the row and column in the full picture of a pixel of a frame, in its middle."""
    (width, height), there = frame.whole.size, frame.moment.size
    return [(2 * place[0] + 1) * height // (2 * there[1]), (2 * place[1] + 1) * width // (2 * there[0])]


def picture(session: QuestionSession, frame: Any) -> tuple[dict[str, Any], bytes]:
    """Return the PNG file of a frame, with no marks; of a coarse frame that of the full picture."""
    output = frame.output
    if frame.moment.size != frame.whole.size:
        with session.controls.at(frame.params):
            output = session.subject.exactly(frame.whole, frame.form)
    return {"frame": frame.moment.frame}, png_of(pixels(output, encode=session.encode))


def png_of(levels: NDArray[np.uint8]) -> bytes:
    """Return the PNG file of (height, width, 4) bytes; raise ShpyError where Pillow is missing."""
    file = png(levels)
    if file is None:
        raise ShpyError("a PNG file needs Pillow", cure=install("pillow"))
    return file


def trace(session: QuestionSession, frame: Any, at: list[int]) -> dict[str, Any]:
    """Return the steps of a pixel of a frame, each with its line, name, value and iterations, and the lines' texts.

    They are those of the chain's last kernel, and of the program that made the colours. Params have the values that
    they had.
    """
    place, subject = _scaled(at, frame), session.subject
    with session.controls.at(frame.stepped):
        stepped = subject.stepped(frame.state, place)
    with session.controls.at(frame.params):
        drawn = subject.drawn(frame.state, frame.moment, place)
    parts = [part for part in (stepped, drawn) if part is not None]
    if not parts:
        raise ShpyError("no kernel has written this picture yet", cure=_SHOW)
    all_steps = [step for _, steps in parts for step in steps]
    own = [step for step in all_steps if step.loc is None or not Path(step.loc.file).is_relative_to(_LIBRARY)]
    odd = _first_odd(own, np.asarray(frame.output)[place])
    kept, cut = _kept(len(own), odd)
    return {
        "at": at,
        "program": ", ".join(program.name for program, _ in parts),
        "frame": frame.moment.frame,
        "time": frame.moment.time,
        "coarse": frame.moment.size != frame.whole.size,
        "steps": [_spoken(own[k]) for k in kept],
        "cut": cut,
        "left_out": len(own) - len(kept),
        "inside": len(all_steps) - len(own),
        "odd": kept.index(odd) if odd is not None else None,
    }


def _kept(count: int, odd: int | None) -> tuple[list[int], int]:
    """Return the numbers of the steps that are sent, the first and last ones, and where others are left out.

    With an odd step, those around it are sent.
    """
    half = _STEPS // 2
    if count <= _STEPS:
        return list(range(count)), count
    begin = max(0, min(odd - half, count - _STEPS)) if odd is not None and half <= odd < count - half else None
    if begin is not None:
        return list(range(begin, begin + _STEPS)), 0
    return [*range(half), *range(count - half, count)], half


def _first_odd(steps: list[Step], colour: Any) -> int | None:
    """Return the first step whose value is NaN where the pixel is NaN, else the first that is not finite; None if none.

    An infinity before it need not be the cause: 1 / infinity is 0. `sh.testing.first_nan` decides in the same way.
    """
    values = [value if value.dtype.kind == "f" else np.zeros(1) for value in (np.asarray(s.value) for s in steps)]
    first_nan = next((k for k, value in enumerate(values) if np.isnan(value).any()), None)
    if np.asarray(colour).dtype.kind == "f" and np.isnan(colour).any() and first_nan is not None:
        return first_nan
    return next((k for k, value in enumerate(values) if not np.isfinite(value).all()), None)


def _spoken(step: Step) -> dict[str, Any]:
    place = step.loc
    return {
        "file": place.file if place else None,
        "line": place.line if place else None,
        "source": written(place),
        "name": step.name,
        "value": np.atleast_1d(step.value),
        "iterations": list(step.iterations),
    }


def compare(session: QuestionSession, frame: Any, other: Form, page: int) -> tuple[dict[str, Any], bytes]:
    """Return the differences between the picture in the wanted form and in another one, and three pictures in a row.

    These are both pictures and their difference, which is white where it is largest.
    """
    moment, subject = frame.whole, session.subject
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
