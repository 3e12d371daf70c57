"""Reports of commands while they compute a picture: a line before its first rows, then a bar or lines.

Stage: run. All go to standard error.

    first_rows = announced("mixed")
    with progress_bar("mixed, 61,562 triangles", first_rows) as progress:
        renderer.render((512, 512), progress=progress)
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec

import shpy as sh
from raytracer.integrators.layers import Progress

_PATIENCE = 2.0
"""Seconds until a progress bar appears."""
_SILENCE = 1.0
"""Seconds after which a command says what it does before the first rows are there."""


def announced(scene: str) -> Callable[[], None]:
    """Say what happens before the first rows are there, if that takes long; call the result once they are there."""
    line = f"raytracer: reads {scene}, builds its accelerator and compiles its kernel before the first rows"
    timer = threading.Timer(_SILENCE, lambda: print(f"{line} (SHPY_QUIET=1 omits this line)", file=sys.stderr))
    timer.daemon = True
    if not os.environ.get("SHPY_QUIET"):
        timer.start()
    return timer.cancel


@contextmanager
def progress_bar(title: str, first: Callable[[], None] = lambda: None) -> Iterator[Progress]:
    """Show progress: a bar on a terminal once the work takes long; without a terminal, a line every few seconds.

    `first` is called before each report, since the first rows are there.
    """
    if not sys.stderr.isatty() or find_spec("rich") is None:
        report = sh.command.progress_lines(title, percent=True)

        def report_lines(done: int, total: int) -> None:
            first()
            report(done, total)

        yield report_lines
        return
    from rich.console import Console
    from rich.progress import Progress as Bar

    started = time.monotonic()
    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, visible=False)

        def progress(done: int, total: int) -> None:
            first()
            late = time.monotonic() - started > _PATIENCE
            bar.update(task, completed=done, total=total, visible=late and done < total)

        yield progress
