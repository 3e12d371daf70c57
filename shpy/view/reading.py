"""The files that a worker reads while it opens a view: the page is drawn anew when one of them changes.

Stage: view. Pictures, tables and the modules of the user's count, as they lie in the folder of the file or below it.
A file that is also written meanwhile does not: it would change with each reading.

    with noted(Path("shader.py")):
        ...                        # runs the file
    files_read()                   # (shader.py, palette.py, textures/wood.png)
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_read: set[str] = set()
_written: set[str] = set()
_folder: str | None = None


@contextmanager
def noted(path: Path) -> Iterator[None]:
    """Record the file and the files of its folder that the block reads, and forget those recorded before."""
    global _folder  # an audit hook is the process's, and stays
    folder = os.path.realpath(path.parent)
    before = set(sys.modules)
    _hook()
    _read.clear()
    _written.clear()
    _folder = folder
    try:
        yield
    finally:
        _folder = None
        _read.add(str(path))
        # Python reads a module's compiled form where there is one.
        files = (getattr(sys.modules[name], "__file__", None) for name in set(sys.modules) - before)
        _read.update(file for file in files if file and _is_below(file, folder))


def files_read() -> tuple[Path, ...]:
    """Return the files of the user's that this process has read last, also where reading one failed."""
    return tuple(Path(file) for file in sorted(_read - _written) if os.path.isfile(file) or file.endswith(".py"))


def _heard(event: str, given: tuple[Any, ...]) -> None:
    """Take an event of Python's audit: a file that is opened, or takes another one's place."""
    folder = _folder  # once: another thread may end the block meanwhile
    if folder is None:
        return
    if event == "open" and isinstance(given[0], str):
        file = os.path.abspath(given[0])
        if _is_below(file, folder):
            (_written if given[2] & (os.O_WRONLY | os.O_RDWR) else _read).add(file)
    elif event == "os.rename" and isinstance(given[1], str):
        _written.add(os.path.abspath(given[1]))


def _is_below(file: str, folder: str) -> bool:
    """Return whether a file lies in the folder or below it, and is not Python's own or hidden."""
    if not file.startswith(folder + os.sep) or file.endswith(".pyc"):
        return False
    parts = Path(file).relative_to(folder).parts
    return "site-packages" not in parts and not any(part.startswith(".") for part in parts)


_hooked = False


def _hook() -> None:
    """Listen to the events of this process; that cannot be undone, so it happens once."""
    global _hooked
    if not _hooked:
        _hooked = True
        sys.addaudithook(_heard)
