"""Track the files that a worker reads while it opens a view, so that a change of one of them starts a new version.

Stage: view. Pictures, tables and modules of the user's count, wherever they are, even missing ones: the file is
recorded again once they exist. Files of Python and of packages imported before do not count, nor does a file that is
also written meanwhile, since it would change at each reading.

    with noted(Path("shader.py")):
        ...                        # runs the file
    files_read()                   # (../wood.png, palette.py, shader.py)
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

_read: set[str] = set()
_written: set[str] = set()
_folder: str | None = None
_foreign: tuple[str, ...] = ()
"""The folders whose files the user does not edit: of Python, the system, and packages imported before the file."""
_SYSTEM: Final = ("/dev", "/etc", "/lib", "/lib64", "/proc", "/run", "/sys", "/usr", "/var")


@contextmanager
def noted(path: Path) -> Iterator[None]:
    """Record the file and the files that the block reads, and forget those recorded before."""
    global _folder, _foreign  # an audit hook belongs to the process and cannot be removed
    folder = os.path.realpath(path.parent)
    before = set(sys.modules)
    _hook()
    _read.clear()
    _written.clear()
    _foreign = _foreign_folders()
    _folder = folder
    try:
        yield
    except Exception as error:
        _read.update(_places_of_module(error, folder))
        raise
    finally:
        _folder = None
        _read.add(str(path))
        # Python reads a module's compiled form where there is one.
        files = (getattr(sys.modules[name], "__file__", None) for name in set(sys.modules) - before)
        _read.update(file for file in files if file and _is_of_user(file, folder))


def files_read() -> tuple[Path, ...]:
    """Return the user's files that the last `noted` block has read or failed to read."""
    return tuple(Path(file) for file in sorted(_read - _written) if not os.path.isdir(file))


def _heard(event: str, arguments: tuple[Any, ...]) -> None:
    """Handle an audit event of Python: a file is opened, or renamed to replace another."""
    folder = _folder  # read once, since another thread may end the block meanwhile
    if folder is None:
        return
    if event == "open" and isinstance(arguments[0], str):
        file = os.path.abspath(arguments[0])
        if _is_of_user(file, folder):
            (_written if arguments[2] & (os.O_WRONLY | os.O_RDWR) else _read).add(file)
    elif event == "os.rename" and isinstance(arguments[1], str):
        _written.add(os.path.abspath(arguments[1]))


def _is_of_user(file: str, folder: str) -> bool:
    """Return whether a file is the user's: in or below the folder, or outside packages; hidden files are not."""
    if file.endswith(".pyc"):
        return False
    below = file.startswith(folder + os.sep)
    if not below and file.startswith(_foreign):
        return False
    parts = Path(file).relative_to(folder).parts if below else Path(file).parts
    return "site-packages" not in parts and not any(part.startswith(".") for part in parts)


def _places_of_module(error: Exception, folder: str) -> tuple[str, ...]:
    """Return the files in which Python looks first for a module that an error, or its cause, names as missing."""
    missing = error if isinstance(error, ModuleNotFoundError) else error.__cause__
    if not isinstance(missing, ModuleNotFoundError) or not missing.name:
        return ()
    place = os.path.join(folder, *missing.name.split("."))
    return f"{place}.py", os.path.join(place, "__init__.py")


def _foreign_folders() -> tuple[str, ...]:
    """Return the folders, each ending in a separator, of Python, the system, and all packages imported so far."""
    packages = (getattr(module, "__path__", ()) for name, module in list(sys.modules.items()) if "." not in name)
    roots = {*_SYSTEM, sys.prefix, sys.base_prefix, *(path for paths in packages for path in paths)}
    return tuple(os.path.join(root, "") for root in roots)


_hooked = False


def _hook() -> None:
    """Install the audit hook of this process; it cannot be removed, so that happens only once."""
    global _hooked
    if not _hooked:
        _hooked = True
        sys.addaudithook(_heard)
