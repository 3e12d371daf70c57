"""The texts that give a picture of the page again: a command, and Python code.

Stage: view. Both draw the picture of `shpy.view.drawing` with the options that the page has.

    recipe(session, frame)      # {"command": "shpy draw shader.py --time 1.5", "code": "sh.view.draw(…)", "note": ""}
"""

from __future__ import annotations

import shlex
from typing import Any

from shpy.view.ongoing import Ongoing

_SAME = ("strict", "portable")
"""The modes in which a picture is the same on every device."""


def recipe(session: Any, frame: Any) -> dict[str, Any]:
    """Return the command and the code that draw the full picture of a frame, and a note on the parts that they omit."""
    subject, moment = session.subject, frame.whole
    inputs = _inputs(subject)
    named: dict[str, Any] = {"size": session.size, "backend": frame.form.backend}
    named |= {"math": frame.form.math} if frame.form.math != "strict" else {}
    named |= {"fuse": True} if frame.form.fuse else {}
    named |= {"time": moment.time} if moment.time and "time" in inputs else {}
    named |= {"frame": moment.frame} if moment.frame and ("frame" in inputs or subject.evolves) else {}
    named |= {"steps": frame.history.steps} if subject.evolves and frame.history.steps != 1 else {}
    named |= {"mouse": moment.mouse} if any(moment.mouse) and "mouse" in inputs else {}
    moved = {name: value for name, value in frame.params.items() if value != session.controls.first[name]}
    return {
        "command": shlex.join(_command(session, named, moved)),
        "code": _code(session, named, moved),
        "note": _note(subject, frame),
    }


def _inputs(subject: Any) -> set[str]:
    """Return the names of the inputs of all programs of a subject."""
    if not isinstance(subject, Ongoing):
        return set(subject.program.inputs)
    return {name for step in subject.chain.steps for name in step.inputs} | set(subject.show_inputs)


def _target(session: Any) -> tuple[str, str | None]:
    """Return the file as the command line named it, and the program where it is not the one that is shown by itself."""
    shown = session.opened.pick(None)[0]
    return session.request.get("given", session.request["path"]), None if session.name == shown else session.name


def _command(session: Any, named: dict[str, Any], moved: dict[str, Any]) -> list[str]:
    file, program = _target(session)
    words = ["shpy", "draw", f"{file}:{program}" if program else file]
    for name, value in named.items():
        match name:
            case "size":
                words += ["--size", f"{value[0]}x{value[1]}"]
            case "mouse":
                words += [f"--mouse={','.join(map(repr, value))}"]
            case "fuse":
                words.append("--fuse")
            case _:
                words += [f"--{name}", value if isinstance(value, str) else repr(value)]
    for name, value in moved.items():
        words += ["--set", f"{name}={','.join(repr(float(part)) for part in value)}"]
    return [*words, "--encode"] if session.encode else words


def _code(session: Any, named: dict[str, Any], moved: dict[str, Any]) -> str:
    file, program = _target(session)
    parts = [repr(file), *([repr(program)] if program else [])]
    parts += [f"{name}={value!r}" for name, value in named.items()]
    if moved:
        parts.append(f"params={ {name: value if len(value) > 1 else value[0] for name, value in moved.items()}!r}")
    parts += ["encode=True"] if session.encode else []
    return f"sh.view.draw({', '.join(parts)})"


def _note(subject: Any, frame: Any) -> str:
    """Return what the texts cannot repeat; empty where they give the picture to the bit."""
    notes = []
    if isinstance(subject, Ongoing) and not frame.history.steady:
        notes.append("Params, the mouse or the steps of a frame changed on the way; the texts have the last ones.")
    if isinstance(subject, Ongoing) and "time" in subject.read:
        notes.append("The chain reads the time, which is 0 in each step of the texts.")
    if frame.form.math not in _SAME and frame.form.backend == "opencl":
        notes.append(f"In {frame.form.math} mode the last digits may differ with the number of lanes.")
    return " ".join(notes)
