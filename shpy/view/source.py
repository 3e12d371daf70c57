"""The user's file in a worker: its programs and chains, and its errors.

Stage: view. A file is run as by `python file.py`, but without the code under `if __name__ == "__main__"`.

    opened = open_file(Path("shader.py"))
    opened.pick(None)            # the last program or chain of the file that can be shown
"""

from __future__ import annotations

import os
import runpy
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from shpy.chains.chain import Chain, sequence
from shpy.display.screen import check_pictures, unfilled
from shpy.errors import CompileError, Loc, ShpyError
from shpy.files import import_from
from shpy.lang.recording.text import latest, text_of
from shpy.programs import Program
from shpy.view.reading import files_read, noted

START, SHOW = "start", "show"
"""The names of the function that returns a chain's first streams, and of the program that converts them to colours."""


@dataclass(frozen=True)
class OpenedFile:
    """The names that a file defines, in their order."""

    path: Path
    names: dict[str, Any]

    @property
    def start(self) -> Any:
        """The function of (height, width) that returns a chain's first streams; None if the file has none."""
        function = self.names.get(START)
        return function if callable(function) and not isinstance(function, Program) else None

    @property
    def shown(self) -> dict[str, Program | Chain]:
        """All programs and chains in the file that can be shown, by name."""
        entries: dict[str, Program | Chain] = {}
        for name, value in self.names.items():
            if name.startswith("_") or value in entries.values():
                continue
            if isinstance(value, Chain) or (isinstance(value, Program) and name != SHOW and self._evolves(value)):
                entries[name] = value if isinstance(value, Chain) else sequence(value)
            elif isinstance(value, Program) and not unfilled(value):
                entries[name] = value
        return entries

    def in_order(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return Params in the order in which the file names them; programs of other files follow."""
        places = {name: k for k, name in enumerate(self.names)}
        return dict(sorted(params.items(), key=lambda item: places.get(item[0], len(places))))

    def _evolves(self, program: Program) -> bool:
        """Return whether the program is a step of a chain: it has inputs that only streams can fill."""
        return self.start is not None and bool(unfilled(program))

    def pick(self, name: str | None) -> tuple[str, Program | Chain]:
        """Return the name and the program or chain to show; raise ShpyError if there is none."""
        shown = self.shown
        if name is None:
            if shown:
                # The programs in a file with a chain are usually its parts.
                chains = [n for n, v in shown.items() if isinstance(v, Chain)]
                last = (chains or list(shown))[-1]
                return last, shown[last]
            _refuse_all(self)
        if name in shown:
            return name, shown[name]
        value = self.names.get(name)
        if isinstance(value, Program):
            check_pictures(value, (1, 1))
        cure = ", ".join(f"{self.path.name}:{n}" for n in shown) or None
        raise ShpyError(f"{self.path.name} has no program or chain {name!r}", cure=cure)


def _refuse_all(opened: OpenedFile) -> NoReturn:
    """Raise an error with the reason why nothing in the file can be shown."""
    programs = [v for v in opened.names.values() if isinstance(v, Program)]
    if programs:
        check_pictures(programs[-1], (1, 1))
    raise ShpyError(
        f"{opened.path.name} has no program",
        cure="@sh.program above a function such as def picture(uv: sh.TexCoord2f) -> sh.Color3f",
    )


def open_file(path: Path) -> OpenedFile:
    """Run the file and return its names. Errors of its code pass through."""
    import_from(path.parent)
    with noted(path):
        names = runpy.run_path(str(path))
    return OpenedFile(path, names)


def explain(error: BaseException, path: Path) -> dict[str, Any]:
    """Return an error for the page: message, cure, file and line, and the lines around it."""
    place, cure = _place(error, path), None
    if isinstance(error, ShpyError):
        message, cure = error.message, error.cure
        if cure is None and isinstance(error, CompileError):
            cure = "another backend, at the top of the page"  # an error of a driver has no cure of its own
    elif isinstance(error, SyntaxError):
        message = error.msg
    else:
        message = str(traceback.TracebackException(type(error), error, None))  # safe if its __str__ raises
    return {
        "type": type(error).__name__,
        "message": message or type(error).__name__,
        "cure": cure,
        "file": place.file if place else None,
        "line": place.line if place else None,
        "source": lines_around(place) if place else [],
    }


def _place(error: BaseException, path: Path) -> Loc | None:
    """Return the file and line of an error: its own, or the innermost line of the user's files in its traceback."""
    if isinstance(error, ShpyError) and error.loc is not None:
        return error.loc
    if isinstance(error, SyntaxError) and error.filename and error.lineno:
        return Loc(error.filename, error.lineno, latest(error.filename))
    frames = list(traceback.walk_tb(error.__traceback__))
    files = {os.path.realpath(p) for p in (path, *files_read())}
    # The file name in a traceback may be relative, or that of a link.
    passed = ((os.path.realpath(f.f_code.co_filename), line, text_of(f.f_code)) for f, line in reversed(frames))
    return next((Loc(file, line, text) for file, line, text in passed if file in files and line), None)


def lines_around(place: Loc, count: int = 2) -> list[tuple[int, str]]:
    """Return the numbers and texts of the lines around a line, as they were when Python compiled it."""
    if place.text is None:
        return []
    first = max(1, place.line - count)
    lines = [(n, place.text.line(n).rstrip("\n")) for n in range(first, place.line + count + 1)]
    return lines[: max((k + 1 for k, (n, text) in enumerate(lines) if text or n <= place.line), default=0)]
