"""Questions about a picture: the value of a pixel, and the steps that led to it.

Stage: view. A page asks, the worker answers between two frames.

    answer(session, {"about": "value", "at": [row, column]})    # ({"value": [0.2, 0.4, 1.0]}, b"")
"""

from __future__ import annotations

import linecache
from pathlib import Path
from typing import Any, Final

import numpy as np

_LIBRARY: Final = Path(__file__).parents[1]
"""The folder of shpy, whose own steps, as of noise, are counted and not sent."""
_STEPS: Final = 400
"""The most steps of a trace that are sent: the first and the last ones."""


def answer(session: Any, question: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    """Return the answer, and bytes that belong to it. Raises what the run raises."""
    match question["about"]:
        case "value":
            return value(session, question["at"]), b""
        case "trace":
            return trace(session, question["at"]), b""
        case other:
            return {"problem": f"there is no answer about {other}"}, b""


def value(session: Any, at: list[int]) -> dict[str, Any]:
    """Return the numbers of a pixel, as the last frame has them."""
    if session.output is None:
        return {"at": at, "value": None}
    row, column = _scaled(at, session.size, session.moment.size)
    found = np.atleast_1d(np.asarray(session.output)[row, column])
    return {"at": at, "value": found, "coarse": session.moment.size != session.size}


def _scaled(at: list[int], size: tuple[int, int], there: tuple[int, int]) -> tuple[int, int]:
    """Return the row and column of a pixel in a picture of another size."""
    row, column = (min(max(int(n), 0), most - 1) for n, most in zip(at, (size[1], size[0]), strict=True))
    return row * there[1] // size[1], column * there[0] // size[0]


def trace(session: Any, at: list[int]) -> dict[str, Any]:
    """Return the steps of a pixel, each with its line, name, value and iterations, and the text of the lines."""
    moment = session._moment(session.size)
    row, column = _scaled(at, session.size, session.size)
    program, steps = session.subject.trace(moment, (row, column))
    count = len(steps)
    steps = [step for step in steps if step.loc is None or not Path(step.loc.file).is_relative_to(_LIBRARY)]
    inside, left_out = count - len(steps), max(0, len(steps) - _STEPS)
    kept = steps if not left_out else [*steps[: _STEPS // 2], *steps[-_STEPS // 2 :]]
    sent = [
        {
            "file": step.loc.file if step.loc else None,
            "line": step.loc.line if step.loc else None,
            "source": linecache.getline(step.loc.file, step.loc.line).strip() if step.loc else "",
            "name": step.name,
            "value": np.atleast_1d(step.value),
            "iterations": list(step.iterations),
        }
        for step in kept
    ]
    return {"at": [row, column], "program": program.name, "steps": sent, "left_out": left_out, "inside": inside}
