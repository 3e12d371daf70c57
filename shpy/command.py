"""The common part of all commands: their end, and their reading of numbers.

Stage: above all others; `import shpy as sh` brings it as `sh.command`. A command that ends by Ctrl-C, by a closed pipe,
by SIGTERM, by a full disk or for want of memory says so in at most one line.

    parser.add_argument("--count", type=sh.command.whole(1, 1000))
    sys.exit(sh.command.run("shpy", lambda: work(parser.parse_args())))
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from shpy import packages

INTERRUPTED = 130
"""The exit status after Ctrl-C, as shells have it: 128 and the number of the signal."""
MOST = 100_000_000
"""The most elements that a command takes: more are a mistake, or more than memory holds."""


def run(name: str, work: Callable[[], int], *, stopped: str = "stopped") -> int:
    """Run a command's work; return its exit status, or 130 after Ctrl-C, 1 where its output or the memory ends.

    SIGTERM ends the work as Ctrl-C does, by a KeyboardInterrupt: it is a `Terminated`, and the status 143. `stopped` is
    said after both, or the exception's own text. Characters that the terminal cannot show are printed as escapes.
    SystemExit passes.
    """
    _prepare_streams()
    try:
        with _termination_raised():
            try:
                return work()
            finally:
                sys.stdout.flush()  # a full disk is found here, and not when Python ends
    except BrokenPipeError:
        _abandon_output()  # the reader of the output has ended, as `head` does
        return 1
    except OSError as error:
        _abandon_output()
        return _say(name, str(error), 1)
    except KeyboardInterrupt as error:
        return _say(name, str(error) or stopped, status_of(error))
    except MemoryError as error:
        return _say(name, f"there is not enough memory{f': {error}' if str(error) else ''}", 1)


def processor() -> str:
    """Return the name of the processor, as Linux tells it; elsewhere what Python knows, or the architecture."""
    listed = Path("/proc/cpuinfo")
    match = re.search(r"^model name\s*: (.*)$", listed.read_text(), re.MULTILINE) if listed.is_file() else None
    return match[1] if match else platform.processor() or platform.machine()


def status_of(error: KeyboardInterrupt) -> int:
    """Return the exit status of a command that ends by this: 130 after Ctrl-C, 143 after SIGTERM."""
    return 128 + signal.SIGTERM if isinstance(error, Terminated) else INTERRUPTED


class Terminated(KeyboardInterrupt):
    """Raised when SIGTERM arrives, so that a command ends as after Ctrl-C and keeps the work that it has finished."""


@contextmanager
def _termination_raised() -> Iterator[None]:
    """Make SIGTERM raise `Terminated`, unless the process has a way of its own to take it."""
    ours = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if not ours:
        yield
        return

    def terminate(number: int, frame: object) -> None:
        raise Terminated

    signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def add_completion(parser: argparse.ArgumentParser) -> None:
    """Add the option `--completion SHELL`, which prints a script that completes the command's words in that shell."""
    parser.add_argument(
        "--completion",
        action=_Completion,
        choices=("bash", "zsh", "tcsh"),
        help="print a script that completes words in this shell, and end (package shtab)",
    )


class _Completion(argparse.Action):
    """Print shtab's completion script for the whole parser; arguments without fixed choices complete to file names."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: Any, values: Any, option: str | None = None) -> None:
        """Print the script, and end the command."""
        try:
            import shtab
        except ImportError:
            parser.error(f"completion needs shtab: {packages.install('shtab')}")
        _complete_files(parser, shtab.FILE)
        print(shtab.complete(parser, values))
        parser.exit()


def _complete_files(parser: argparse.ArgumentParser, files: object) -> None:
    """Mark the arguments whose values may be paths, in all commands of a parser."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                _complete_files(command, files)
        elif action.nargs != 0 and action.choices is None and action.type in (None, Path):
            action.complete = files  # type: ignore[attr-defined]  # which shtab reads


def progress_lines(title: str, every: float = 5.0, *, percent: bool = False) -> Callable[[int, int], None]:
    """Return a function of how much is done and of how much: it prints a line to standard error every few seconds.

    Work that takes less than `every` seconds prints nothing. With `percent` the line has no numbers of units.
    """
    last = time.monotonic()

    def progress(done: int, total: int) -> None:
        nonlocal last
        if done < total and time.monotonic() - last >= every:
            last = time.monotonic()
            print(f"{title}: {f'{done / total:.1%}' if percent else f'{done} of {total}'}", file=sys.stderr, flush=True)

    return progress


def markdown(rows: Sequence[Sequence[object]], *, left: int = 1) -> str:
    """Return rows as a Markdown table; the first row is the head, and all columns but the first `left` are numbers."""
    head, *body = ([str(cell) for cell in row] for row in rows)
    lines = [head, [*["---"] * left, *["---:"] * (len(head) - left)], *body]
    widths = [max(len(row[i]) for row in lines) for i in range(len(head))]
    sides = "<" * left + ">" * (len(head) - left)
    return "\n".join(
        "| " + " | ".join(f"{c:{s}{w}}" for c, s, w in zip(row, sides, widths, strict=True)) + " |" for row in lines
    )


def _say(name: str, text: str, status: int) -> int:
    with suppress(OSError):
        print(f"{name}: {text}", file=sys.stderr)
    return status


def _prepare_streams() -> None:
    """Open the null device for closed streams, so that no file gets their descriptors; escape unknown characters."""
    for stream, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, stream) is None:
            setattr(sys, stream, open(os.devnull, mode))
    for opened in (sys.stdout, sys.stderr):
        if hasattr(opened, "reconfigure"):
            opened.reconfigure(errors="backslashreplace")


def _abandon_output() -> None:
    """Discard the rest of the output: Python would report the closed pipe again when it ends."""
    with suppress(OSError, ValueError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, sys.stdout.fileno())
        os.close(null)


def whole(lowest: int, highest: int | None = None) -> Callable[[str], int]:
    """Return a function that reads a whole number from `lowest` to `highest`, for the `type` of an argument."""
    span = f"from {lowest} to {highest}" if highest is not None else f"from {lowest} on"

    def read(text: str) -> int:
        # The digits of other scripts are numbers to Python; the length is what keeps `int` from failing.
        if re.fullmatch(r"[+-]?[0-9]{1,30}", text):
            number = int(text)
            if lowest <= number and (highest is None or number <= highest):
                return number
        raise argparse.ArgumentTypeError(f"a whole number {span}, not {text!r}")

    return read


def real(lowest: float) -> Callable[[str], float]:
    """Read a finite number from `lowest` on, for the `type` of an argument."""

    def read(text: str) -> float:
        with suppress(ValueError):
            number = float(text)
            if text.isascii() and "_" not in text and math.isfinite(number) and number >= lowest:
                return number
        raise argparse.ArgumentTypeError(f"a finite number from {lowest:g} on, not {text!r}")

    return read
