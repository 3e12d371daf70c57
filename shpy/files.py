"""Files that are written whole or not at all, paths that are checked before long work, and folders to import from.

Stage: above all others; `import shpy as sh` brings it as `sh.files`, for commands and for what writes pictures.

    sh.files.check_writable(Path("found.json"))        # before the work
    with sh.files.replacing(Path("found.json")) as path:
        path.write_text("{}")
"""

from __future__ import annotations

import errno
import os
import re
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

_NAME: Final = ".unfinished-"
_UNFINISHED: Final = re.compile(rf"{re.escape(_NAME)}[0-9a-f]{{16}}(\..*)?", re.DOTALL)
_TESTS: Final = 5
"""Number of tests of the permission to write before it is denied."""
_STALE: Final = 24 * 3600.0
"""Seconds after which an unfinished file can only be left of a process that was killed."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a new empty file beside `path`, with its ending, that replaces `path` unless the block raises.

    Where `path` is a link, the file that it leads to is replaced and the link stays. A file that is replaced keeps its
    mode. The name of the new file is no other process's or thread's, and it was no link when it was made. Unfinished
    files that killed processes of this user left in the folder a day ago go. Raises OSError for files that are not
    regular, such as devices, and for files without the permission to write.
    """
    target = _target(path)
    temporary = _new_file(target, path.suffix)
    try:
        yield temporary
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
    with suppress(OSError):
        _remove_stale(target.parent)


def check_writable(path: Path) -> None:
    """Raise OSError, with a sentence, where no file can be made at `path`: call it before long work."""
    _check_name(path)
    if not path.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {path.parent}")
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder")
    try:
        target = _target(path)
        if not target.parent.is_dir():
            raise FileNotFoundError(errno.ENOENT, f"it is a link into {target.parent}, which is no folder")
        _new_file(target, path.suffix).unlink()
    except OSError as error:
        raise type(error)(f"{path} cannot be written: {error.strerror or error}") from error


def _check_name(path: Path) -> None:
    """Raise OSError for a name that no file can have."""
    try:
        impossible = b"\0" in os.fsencode(path)
    except UnicodeEncodeError:
        impossible = True
    if impossible:
        raise OSError(errno.EINVAL, f"no file can have the name {str(path)!r}")


def _target(path: Path) -> Path:
    """Return the path of the file itself, links followed; OSError for a name that no file can have."""
    _check_name(path)
    if not path.is_symlink():
        return path
    # A system may refuse to follow links that others planted in a shared folder. Reading them by hand would not.
    with suppress(FileNotFoundError):
        path.stat()
    return path.resolve()


def _new_file(target: Path, ending: str) -> Path:
    """Make an empty file beside `target`, of the mode that `target` has if it is there."""
    temporary = target.with_name(f"{_NAME}{os.urandom(8).hex()}{ending}")
    mode = _mode_of(target)
    # O_EXCL fails where there is anything, a link included; a new file's mode is what the umask leaves.
    os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666 if mode is None else mode))
    if mode is not None:
        temporary.chmod(mode)  # the umask takes no permission from a file that is replaced
    return temporary


def _mode_of(target: Path) -> int | None:
    """Return the permissions of a file that is to be replaced; None if there is none."""
    try:
        mode = target.stat().st_mode
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "it is no regular file")
        # Another thread may remove the file and write it again between two of these calls: a later test succeeds then.
        if not any(os.access(target, os.W_OK) for _ in range(_TESTS) if target.stat()):
            raise PermissionError(errno.EACCES, "its mode does not allow it")
    except FileNotFoundError:
        return None
    return mode & 0o777


def _remove_stale(folder: Path) -> None:
    for name in filter(_UNFINISHED.fullmatch, os.listdir(folder)):
        with suppress(OSError):
            state = (folder / name).lstat()
            mine = not hasattr(os, "geteuid") or state.st_uid == os.geteuid()
            if stat.S_ISREG(state.st_mode) and mine and time.time() - state.st_mtime > _STALE:
                (folder / name).unlink()


def import_from(folder: Path | str) -> None:
    """Let Python import the modules of a folder before all others, as it does where it runs a file of the folder.

    The folder stays on `sys.path`, because functions of the file may import more of them when they are called.
    """
    if sys.path[0] != str(folder):
        sys.path.insert(0, str(folder))
