"""Compiled kernels on disk, so that the next process need not compile them again.

Stage: compile. An entry holds a driver's binary: data that a driver loads and that nothing here executes. Its name is
the hash of everything that the binary depends on (text, options, device, driver and version). Its content is a magic,
a checksum of key and binary, and the binary: an entry that was cut, or copied to another key, counts as absent.

The folder is SHPY_CACHE_DIR, in which `~` is the home folder, or `shpy` in the user's cache folder; if the variable is
empty, nothing is kept. A driver runs what it is given, so folders and entries count only if they belong to this user
and nobody else can write them. The folder may hold other files: only files that carry our name and our magic are ever
removed. Where the folder cannot be used, or the system lacks the functions of POSIX that this takes, a ShpyWarning says
why, once, and kernels are compiled anew.

    key = store.key(text, options, device, driver)
    binary = store.load(key)               # None where there is none
    store.save(key, binary)
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import stat
import time
from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import Final

from shpy.errors import warn

_MAGIC: Final = b"shpy kernel 2\n"
_HEAD: Final = len(_MAGIC) + hashlib.sha256().digest_size
_SUFFIX: Final = ".shpy-kernel"
_ENTRY: Final = re.compile(rf"[0-9a-f]{{64}}{re.escape(_SUFFIX)}")
_TEMPORARY: Final = re.compile(rf"\.new-[0-9a-f]{{16}}{re.escape(_SUFFIX)}")
_MOST: Final = 512
"""Entries kept: those that were not used for longest go first."""
_LARGEST: Final = 1 << 28
"""The most bytes that an entry may have: many times a large kernel's binary."""
_STALE: Final = 3600.0
"""Seconds after which a temporary file can only be left of a writer that was killed."""
_SKEW: Final = 60.0
"""Seconds by which the clock of a network's disk may be ahead."""
_NEEDED: Final = ("O_DIRECTORY", "O_CLOEXEC", "O_NOFOLLOW", "O_NONBLOCK", "geteuid")
"""Names of `os` by which a folder is opened once, and judged by what was opened."""
_told: set[str] = set()


def key(*parts: str) -> str:
    """Return the hash of all that a binary depends on: its key, 64 hexadecimal digits."""
    digest = hashlib.sha256()
    for part in parts:
        encoded = part.encode("utf-8", "surrogatepass")
        digest.update(len(encoded).to_bytes(8, "little") + encoded)
    return digest.hexdigest()


def load(name: str) -> bytes | None:
    """Return the binary kept under this key; None if it is missing, damaged or owned by another user."""
    with _opened_folder() as folder:
        if folder is None:
            return None
        data = _read(folder, name + _SUFFIX, _LARGEST)
        if data is None or data[:_HEAD] != _head(name, data[_HEAD:]):
            return None
        with suppress(OSError):
            os.utime(name + _SUFFIX, dir_fd=folder, follow_symlinks=False)
        return data[_HEAD:]


def is_open() -> bool:
    """Return whether `save` would keep a binary. Ask before requesting one: some drivers compile again to make it."""
    with _opened_folder() as folder:
        return folder is not None


def save(name: str, binary: bytes) -> None:
    """Keep a binary; whoever reads meanwhile sees the old entry or the whole new one. A failure is a ShpyWarning."""
    with _opened_folder() as folder:
        if folder is None or len(binary) > _LARGEST - _HEAD:
            return
        temporary = f".new-{os.urandom(8).hex()}{_SUFFIX}"
        try:
            # O_EXCL follows no link, and fails rather than write to a file that is there.
            file = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600, dir_fd=folder)
            try:
                with open(file, "wb") as stream:
                    stream.write(_head(name, binary) + binary)
                os.replace(temporary, name + _SUFFIX, src_dir_fd=folder, dst_dir_fd=folder)
            except BaseException:
                with suppress(OSError):
                    os.unlink(temporary, dir_fd=folder)
                raise
            _prune(folder)
        except OSError as error:
            tell(f"a kernel could not be written to {_place()} ({error.strerror})")


def known_names(name: str, possible: Container[str], ask: Callable[[], Iterable[str]]) -> frozenset[str]:
    """Return the names kept under this key.

    If no names are kept, or not all of them are `possible`, the names that `ask` returns are kept and returned.
    """
    kept = load(name)
    if kept is not None:
        names = frozenset(kept.decode(errors="replace").split())
        if all(n in possible for n in names):
            return names
    names = frozenset(ask())
    save(name, " ".join(sorted(names)).encode())
    return names


def _head(name: str, binary: bytes) -> bytes:
    return _MAGIC + hashlib.sha256(name.encode() + binary).digest()


def _place() -> Path | None:
    """Return the folder that the environment names; None where nothing is to be kept."""
    chosen = os.environ.get("SHPY_CACHE_DIR")
    if chosen is not None:
        return Path(chosen).expanduser() if chosen else None
    home = os.environ.get("XDG_CACHE_HOME", "")
    # The XDG base directory specification has relative paths ignored.
    return (Path(home) if os.path.isabs(home) else Path.home() / ".cache") / "shpy"


@contextmanager
def _opened_folder() -> Iterator[int | None]:
    """Yield a descriptor of the folder, made with mode 0700 if it is missing; None where no folder can be used.

    All work goes through the descriptor that was checked, so that nobody can put another folder in its place.
    """
    descriptor = None
    try:
        path = _place()
        missing = None if path is None else _missing()
        if missing is not None:
            tell(f"they can only be kept safely with {missing}, which Python lacks on this system", "")
        elif path is not None:
            path.mkdir(mode=0o700, parents=True, exist_ok=True)
            descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            fault = _fault(path, os.fstat(descriptor))
            if fault:
                tell(f"the folder {path} {fault}")
                os.close(descriptor)
                descriptor = None
    except (OSError, RuntimeError) as error:
        tell(f"the folder {_place_named()} cannot be used ({getattr(error, 'strerror', None) or error})")
    try:
        yield descriptor
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _missing() -> str | None:
    """Return a name of `os` that the store needs and this system lacks, as Windows does; None if all are there."""
    for name in _NEEDED:
        if not hasattr(os, name):
            return f"os.{name}"
    for function in (os.open, os.stat, os.unlink, os.rename, os.utime):
        if function not in os.supports_dir_fd:
            return f"dir_fd of os.{function.__name__}"
    return None if os.listdir in os.supports_fd else "os.listdir of a descriptor"


def _place_named() -> str:
    try:
        return str(_place())
    except RuntimeError:
        return os.environ.get("SHPY_CACHE_DIR", "~/.cache/shpy")


def _fault(path: Path, state: os.stat_result) -> str | None:
    """Return the reason why binaries of a folder are not safe to load; None if they are."""
    if state.st_uid != os.geteuid() or path.lstat().st_uid != os.geteuid():
        return "belongs to another user"
    return "can be written by other users" if state.st_mode & 0o022 else None


def tell(reason: str, cure: str = "to a folder that only you can write, or ") -> None:
    """Warn, once for each reason, that kernels are not kept for other processes: each compiles them anew.

    `cure`: the value of SHPY_CACHE_DIR with which they are kept, or nothing where there is none.
    """
    if reason not in _told:
        _told.add(reason)
        warn(
            f"compiled kernels are not kept for the next process: {reason}; set SHPY_CACHE_DIR {cure}to nothing "
            "if none are to be kept"
        )


def _read(folder: int, name: str, most: int) -> bytes | None:
    """Return the first `most` bytes of a regular file of this user; None where there is none.

    Opening neither follows a link nor waits for a pipe's writer, and the state is asked of what was opened.
    """
    try:
        descriptor = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
    except FileNotFoundError:
        return None
    except OSError as error:
        tell(f"the entry {name} cannot be opened ({error.strerror})")
        return None
    try:
        state = os.fstat(descriptor)
        if not stat.S_ISREG(state.st_mode) or state.st_uid != os.geteuid() or state.st_mode & 0o022:
            tell(f"the entry {name} is no file that only this user can write")
            return None
        with open(descriptor, "rb", closefd=False) as file:
            return file.read(most)
    except OSError as error:
        tell(f"the entry {name} cannot be read ({error.strerror})")
        return None
    finally:
        os.close(descriptor)


def _prune(folder: int) -> None:
    """Remove the entries used longest ago beyond the most that are kept, and what killed writers left."""
    names = os.listdir(folder)
    for name in filter(_TEMPORARY.fullmatch, names):
        if _age(folder, name) > _STALE and _is_ours(folder, name):
            _remove(folder, name)
    entries = list(filter(_ENTRY.fullmatch, names))
    excess = len(entries) - _MOST
    if excess > 0:
        entries.sort(key=lambda name: _age(folder, name), reverse=True)
        # Only those that may go are read, so that a full folder is not read at each compilation.
        for name in islice((e for e in entries if _is_ours(folder, e)), excess):
            _remove(folder, name)


def _age(folder: int, name: str) -> float:
    """Return the seconds since a file was used; infinity for a date in the future, which cannot be true."""
    try:
        age = time.time() - os.stat(name, dir_fd=folder, follow_symlinks=False).st_mtime
    except OSError:
        return 0.0
    return age if age > -_SKEW else math.inf


def _is_ours(folder: int, name: str) -> bool:
    """Return whether a file begins as we write it; that of a killed writer may end within the magic."""
    start = _read(folder, name, len(_MAGIC))
    return start is not None and (start == _MAGIC or (name.startswith(".") and _MAGIC.startswith(start)))


def _remove(folder: int, name: str) -> None:
    with suppress(OSError):
        os.unlink(name, dir_fd=folder)
