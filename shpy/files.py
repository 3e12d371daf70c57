"""Files that are written whole or not at all, and paths that are checked before the work that they are to hold.

Stage: above all others; `import shpy as sh` brings it as `sh.files`, for commands and for what writes pictures.

    sh.files.check_writable(Path("found.json"))        # before the work
    with sh.files.replacing(Path("found.json")) as path:
        path.write_text("{}")
"""

from __future__ import annotations

import os
import re
import secrets
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

__all__ = ["check_writable", "replacing"]

_NAME: Final = ".unfinished-"
_UNFINISHED: Final = re.compile(rf"{re.escape(_NAME)}[0-9a-f]{{16}}(\..*)?", re.DOTALL)
_STALE: Final = 24 * 3600.0
"""Seconds after which an unfinished file can only be left of a process that was killed."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new empty file beside `path`, with its ending, which takes the place of `path` unless the block raises.

    Its name is no other process's or thread's, and it was no link when it was made. Unfinished files that killed
    processes of this user left in the folder a day ago go.
    """
    temporary = _new_file(path)
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    with suppress(OSError):
        _remove_stale(path.parent)


def check_writable(path: Path) -> None:
    """Raise OSError, with a sentence, where no file can be made at `path`: call it before what takes long."""
    if not path.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {path.parent}")
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder")
    try:
        _new_file(path).unlink()
    except OSError as error:
        raise type(error)(f"{path} cannot be written: {error.strerror or error}") from error


def _new_file(path: Path) -> Path:
    temporary = path.with_name(f"{_NAME}{secrets.token_hex(8)}{path.suffix}")
    # O_EXCL fails where there is anything, a link included; the mode is what the umask leaves, as for any new file.
    os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    return temporary


def _remove_stale(folder: Path) -> None:
    for name in filter(_UNFINISHED.fullmatch, os.listdir(folder)):
        with suppress(OSError):
            state = (folder / name).lstat()
            mine = not hasattr(os, "geteuid") or state.st_uid == os.geteuid()
            if stat.S_ISREG(state.st_mode) and mine and time.time() - state.st_mtime > _STALE:
                (folder / name).unlink()
