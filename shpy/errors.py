"""The errors of shpy. Each names the mistake, the line of the user's code, and the text to write instead."""

from __future__ import annotations

import os
import re
import sys
import sysconfig
import traceback
import warnings
from dataclasses import dataclass, field
from types import FrameType
from typing import Any

_LONG_WORD = re.compile(r"[^\s^]{241,}")  # not the marks under a line
_WORD, _LINE = 80, 1000
_HOUSE = os.path.dirname(os.path.abspath(__file__)) + os.sep
_STANDARD = os.path.join(sysconfig.get_path("stdlib"), "")
"""The standard library's folder; other packages may be installed in a folder of it."""


def shorten(text: str) -> str:
    """Shorten a text for a message: words above 240 characters are cut to 80, lines to 1,000."""
    text = _LONG_WORD.sub(lambda word: f"{word[0][: _WORD - 20]}…{word[0][-20:]}", text)
    if len(text) <= _LINE:
        return text
    half = _LINE // 2
    lines = text.split("\n")
    return "\n".join(line if len(line) <= _LINE else f"{line[:half]} … {line[-half:]}" for line in lines)


@dataclass(frozen=True, slots=True)
class Loc:
    """A line of the user's code.

    `text` is the source text that the line was recorded from (`lang/recording/text.py`), None where it is not known. It
    takes no part in comparisons, and does not go to other processes.
    """

    file: str
    line: int
    text: Any = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"

    def __reduce__(self) -> tuple[type[Loc], tuple[str, int]]:
        return Loc, (self.file, self.line)


class ShpyError(Exception):
    """Base of every error that shpy raises.

    `message` is the sentence, `loc` the user's `file:line` where one is known, `cure` what to write instead. Words and
    lines of any length, which a name may bring, are cut.
    """

    _cure_follows = "write instead"

    def __init__(self, message: str, *, loc: Loc | None = None, cure: str | None = None) -> None:
        self.message = shorten(message)
        self.loc = loc
        self.cure = cure
        text = f"{loc}: {self.message}" if loc is not None else self.message
        super().__init__(shorten(f"{text}\n  {self._cure_follows}: {cure}" if cure else text))
        hide_frames()

    def _render_traceback_(self) -> list[str]:
        """Return the lines that IPython prints in place of its own traceback: the user's lines, then the error."""
        steps = traceback.extract_tb(self.__traceback__)
        users = [s for s in steps if not (_is_passed(s.filename) or s.filename.startswith(_shells()))]
        lines = traceback.format_exception_only(type(self), self)
        return "".join(
            ["Traceback of your lines (most recent call last):\n", *traceback.format_list(users), *lines]
        ).splitlines()


class ShpyWarning(UserWarning):
    """A way is slower or less exact than the way that was asked for; the text names the cause."""


def hide_frames() -> None:
    """Hide the frames of shpy that are running from the tracebacks that pytest prints: `--full-trace` shows them.

    pytest asks the globals of each frame. Frames are hidden where shpy refuses something, or where the user's own
    function, which shpy calls, ends in an error.
    """
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if frame.f_code.co_filename.startswith(_HOUSE):
            frame.f_globals.setdefault("__tracebackhide__", _is_hidden)
        frame = frame.f_back


def _is_hidden(raised: Any) -> bool:
    """Return whether pytest hides the frames of shpy for an error: `raised` is its ExceptionInfo."""
    error = getattr(raised, "value", None)
    if isinstance(error, ShpyError):
        return True
    last = error.__traceback__ if isinstance(error, BaseException) else None
    while last is not None and last.tb_next is not None:
        last = last.tb_next
    return last is not None and not _is_passed(last.tb_frame.f_code.co_filename)


def _shells() -> tuple[str, ...]:
    """Return the folders of the shells that run the user's cells."""
    modules = (sys.modules.get(name) for name in ("IPython", "ipykernel"))
    return tuple(os.path.dirname(m.__file__ or "") + os.sep for m in modules if m is not None)


def is_standard(file: str) -> bool:
    """Return whether a file is one of the standard library, or of the modules that Python holds frozen."""
    if file.startswith("<frozen "):
        return True
    return file.startswith(_STANDARD) and f"-packages{os.sep}" not in file


def warn(message: str) -> None:
    """Give a ShpyWarning at the line outside of shpy and of the standard library that is running."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and _is_passed(frame.f_code.co_filename):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, ShpyWarning, stacklevel=level)


def raise_interrupt(error: BaseException, before: BaseException | None) -> None:
    """Raise the KeyboardInterrupt that `error` replaced, if there is one.

    `before` is `sys.exception()` of the time before the work that raised `error`: a caller may be handling an earlier
    interrupt, which is no cause of this error. An interrupt becomes another error where Python calls `__set_name__`
    (RuntimeError before Python 3.12), or where a cleanup fails, as that of a lock that was not yet taken again.
    """
    cause: BaseException | None = error
    while cause is not None and cause is not before:
        if isinstance(cause, KeyboardInterrupt):
            raise cause
        cause = cause.__cause__ or cause.__context__


def _is_passed(file: str) -> bool:
    return file.startswith(_HOUSE) or is_standard(file)


class RecordError(ShpyError):
    """A program cannot be recorded as it is written."""


class ShpyIndexError(RecordError, IndexError):
    """A constant index is out of range."""


class ShpyAttributeError(ShpyError, AttributeError):
    """A name that shpy, or one of its values, does not have."""


class ShpyTypeError(ShpyError, TypeError):
    """A value has the wrong type, shape or range."""


class VerifyError(ShpyError):
    """A module breaks a rule of the IR; the text shows the finding inside the listing."""


class ParseError(ShpyError):
    """IR text is malformed."""


class CompileError(ShpyError):
    """A target cannot run the program, or its driver refused the text.

    `lacks` is "f64" or "f16" where the device has no such numbers, which the program needs, and None otherwise.
    """

    def __init__(
        self, message: str, *, loc: Loc | None = None, cure: str | None = None, lacks: str | None = None
    ) -> None:
        super().__init__(message, loc=loc, cure=cure)
        self.lacks = lacks


class BackendUnavailable(ShpyError):
    """The backend that was asked for is not there; `cure` is the command that mends it."""

    _cure_follows = "to mend it"


class LoopLimitExceeded(ShpyError):
    """A loop ran out of its budget of iterations.

    `result` holds the computed values, `count` the number of elements that stopped: of a reduction or scan, those of
    the first dispatch with any, so it differs between devices.
    """

    def __init__(
        self, message: str, *, loc: Loc | None = None, cure: str | None = None, result: Any = None, count: int = 0
    ) -> None:
        super().__init__(message, loc=loc, cure=cure)
        self.result = result
        self.count = count
