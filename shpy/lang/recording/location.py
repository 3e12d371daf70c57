"""Locations: the nearest frame outside the package is the user's.

Stage: record. Costs well under a microsecond, so every node can carry its line.
"""

from __future__ import annotations

import functools
import linecache
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import CodeType, FrameType
from typing import Any, ParamSpec, TypeVar

import numpy as np

from shpy.errors import ShpyError, is_standard
from shpy.ir.nodes import Loc
from shpy.lang.recording.text import origin

P = ParamSpec("P")
T = TypeVar("T")

_HOUSE = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__)))) + os.sep
_LIBRARIES = (os.path.join(_HOUSE, "lang", "library.py"), os.path.join(_HOUSE, "library", ""))
_LIBRARIES_SHOWN = ("shpy/lang/library.py", "shpy/library/")
"""Their lines are the same wherever shpy is installed, so that the text of a program is."""
_PROGRAMS = (
    os.path.join(_HOUSE, "testing", "conformance", ""),
    os.path.join(_HOUSE, "collectives", "programs.py"),
)
"""Programs of the conformance list and of collectives are programs like those of any user."""
_START = os.path.join(os.path.dirname(os.path.dirname(_HOUSE)), "shpy_start", "")
"""The start of the command line: no line outside of it is the user's."""
_TRACER = os.path.join(os.path.dirname(os.path.dirname(_HOUSE)), "raytracer", "")
"""The ray tracer, whose lines are those of programs; what it compiles and runs, it does for the line that called it."""
_NUMPY = os.path.dirname(os.path.abspath(np.__file__)) + os.sep
"""Frames of numpy count as the user's line that called numpy, and so do those of the standard library."""
_ENGINES = ("dask", "distributed")
"""Frames of the packages that run blocks count so as well: no line of theirs is the user's."""
_skipped: dict[str, bool] = {}


class _RecordingState(threading.local):
    """State of this thread's recording alone: other threads record meanwhile."""

    def __init__(self) -> None:
        self.library = 0
        self.elsewhere: list[Loc | None] = []


_thread = _RecordingState()


@contextmanager
def in_library() -> Iterator[None]:
    """Count library lines as the user's: the part of the language that is written in the language is recorded."""
    _thread.library += 1
    try:
        yield
    finally:
        _thread.library -= 1


def is_library(loc: Loc) -> bool:
    """Return whether a line stands in the part of the language that is written in the language."""
    return loc.file.startswith(_LIBRARIES_SHOWN)


def user_frame(*besides: str) -> FrameType | None:
    """Return the innermost frame whose code is not shpy's, numpy's, Dask's or Python's own, nor in these folders."""
    frame: FrameType | None = sys._getframe(1)
    library = _thread.library > 0
    while frame is not None:
        file = frame.f_code.co_filename
        skipped = _skipped.get(file)
        if skipped is None:
            skipped = _skipped[file] = _look_inside(file) or is_standard(file)
            enter_text(file, frame.f_globals)
        if not (skipped or (besides and file.startswith(besides))) or (library and file.startswith(_LIBRARIES)):
            if file == "<string>" and frame.f_code.co_name == "__init__":  # which `dataclasses` has generated
                frame = frame.f_back
                continue
            return None if file.startswith(_START) else frame
        frame = frame.f_back
    return None


def enter_text(file: str, module: dict[str, Any]) -> None:
    """Let linecache find the text of a module that lies in an archive: the module's loader reads it.

    `module` holds the globals of the code. Code that `exec` compiled in the module has another file's name, and the
    loader does not know its text.
    """
    if module.get("__file__") == file:
        linecache.lazycache(file, module)


@cache
def _look_inside(file: str) -> bool:
    """Return whether a file is shpy's, numpy's or Dask's."""
    path = os.path.abspath(file)
    return path.startswith((_HOUSE, _NUMPY, *_engines())) and not path.startswith(_PROGRAMS)


def _engines() -> list[str]:
    """Return the folders of Dask's packages that are imported, as they are when they run."""
    files = [getattr(sys.modules.get(name), "__file__", None) for name in _ENGINES]
    return [os.path.dirname(os.path.abspath(file)) + os.sep for file in files if file is not None]


def is_users(file: str) -> bool:
    """Return whether the code of a file is neither shpy's nor numpy's nor Dask's."""
    return not _look_inside(file)


IN_PLACE = frozenset({"<listcomp>", "<setcomp>", "<dictcomp>", "<genexpr>"})


def called_frames() -> list[FrameType]:
    """Return the frames of the user's functions, innermost first, up to the call from shpy that led to them.

    Comprehensions count as the functions that they stand in.
    """
    frames: list[FrameType] = []
    frame = user_frame()
    while frame is not None and not _look_inside(frame.f_code.co_filename):
        if frame.f_code.co_name not in IN_PLACE:
            frames.append(frame)
        frame = frame.f_back
    return frames


def loc_in(code: CodeType, line: int) -> Loc:
    """Return a line of a code object as a location, with the text that the code was compiled from."""
    source = origin(code)
    loc = source.locs.get(line)
    if loc is None:
        file = code.co_filename
        shown = "shpy/" + file[len(_HOUSE) :].replace(os.sep, "/") if file.startswith(_LIBRARIES) else file
        loc = source.locs[line] = Loc(shown, line, source.text)
    return loc


@contextmanager
def at(loc: Loc | None) -> Iterator[None]:
    """Give statements recorded in the block the location `loc`, after the user's function has returned."""
    _thread.elsewhere.append(loc)
    try:
        yield
    finally:
        _thread.elsewhere.pop()


def here() -> Loc | None:
    """Return the user's line that is running."""
    elsewhere = _thread.elsewhere
    if elsewhere:
        return elsewhere[-1]
    frame = user_frame()
    if frame is None:
        return None
    places = origin(frame.f_code).places
    loc = places.get(frame.f_lasti)
    if loc is None:  # Python walks through the table of lines for `f_lineno`
        loc = places[frame.f_lasti] = loc_in(frame.f_code, frame.f_lineno)
    return loc


def on_one_line(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function that runs none of the user's code: the user's line is looked up once for all it records.

    An operator records up to six statements, and the look-up goes through the frames between the user and the recorder.
    """

    @functools.wraps(function)
    def run(*args: P.args, **named: P.kwargs) -> T:
        elsewhere = _thread.elsewhere
        if elsewhere:
            return function(*args, **named)
        elsewhere.append(here())
        try:
            return function(*args, **named)
        finally:
            elsewhere.pop()

    return run


def caller() -> Loc | None:
    """Return the user's line that is running; that of the ray tracer's caller where it runs for the user."""
    elsewhere = _thread.elsewhere
    if elsewhere:
        return elsewhere[-1]
    frame = user_frame(_TRACER)
    return None if frame is None else loc_in(frame.f_code, frame.f_lineno)


def located(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function so that errors of a device, which knows no line, name the user's line that is running."""

    @functools.wraps(function)
    def run(*args: P.args, **named: P.kwargs) -> T:
        try:
            return function(*args, **named)
        except ShpyError as error:
            if error.loc is None:
                ShpyError.__init__(error, error.message, loc=caller(), cure=error.cure)
            raise

    return run
