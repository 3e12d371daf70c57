"""The answers of drivers, on disk, so that the next process need not ask them again: words, which nothing executes.

Stage: compile. An entry holds the names of a device's faults or abilities. Its own name is the hash of everything that
they depend on: the texts that ask, options, device, driver and version. It begins with a checksum of its name and
words, so that an entry that was cut, or copied to another name, counts as absent.

The folder is SHPY_CACHE_DIR, in which `~` is the home folder, or `shpy` in the user's cache folder; if the variable is
empty, nothing is kept. Where the folder cannot be used a ShpyWarning says why, once, and drivers are asked again.
Compiled kernels are kept by drivers themselves: PoCL in POCL_CACHE_DIR, others in folders of their own.

    key = store.key(text, options, device, driver)
    faults = store.known_names(key, FAULTS, ask)
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Container, Iterable
from pathlib import Path
from typing import Final

from shpy.errors import warn
from shpy.files import replacing

_SUFFIX: Final = ".shpy-answers"
_REMEMBERED: Final = 1024
"""The most words of a list."""
_told: set[str] = set()


def key(*parts: str) -> str:
    """Return the hash of all that an answer depends on: its key, 64 hexadecimal digits."""
    digest = hashlib.sha256()
    for part in parts:
        encoded = part.encode("utf-8", "surrogatepass")
        digest.update(len(encoded).to_bytes(8, "little") + encoded)
    return digest.hexdigest()


def known_names(name: str, possible: Container[str], ask: Callable[[], Iterable[str]]) -> frozenset[str]:
    """Return the names kept under this key.

    If no names are kept, or not all of them are `possible`, the names that `ask` returns are kept and returned.
    """
    entry = _entry(name)
    words = None if entry is None else _read(entry, name)
    if words is not None and all(word in possible for word in words):
        return frozenset(words)
    names = frozenset(ask())
    if entry is not None:
        _write(entry, name, " ".join(sorted(names)))
    return names


def is_remembered(list_name: str, word: str) -> bool:
    """Return whether an earlier process remembered a word in a list."""
    name = key(list_name)
    entry = _entry(name)
    return entry is not None and word in (_read(entry, name) or ())


def remember(list_name: str, word: str) -> None:
    """Add a word to a list of at most `_REMEMBERED`; if two processes add at once, one word may be lost."""
    name = key(list_name)
    entry = _entry(name)
    if entry is not None:
        words = [other for other in _read(entry, name) or () if other != word]
        _write(entry, name, " ".join([*words, word][-_REMEMBERED:]))


def _entry(name: str) -> Path | None:
    """Return the file of a key; None where nothing is to be kept or no folder can be made."""
    folder = os.environ.get("SHPY_CACHE_DIR")
    if folder == "":
        return None
    try:
        home = os.environ.get("XDG_CACHE_HOME", "")
        # The XDG base directory specification has relative paths ignored.
        cache = Path(home) if os.path.isabs(home) else Path("~/.cache")
        place = (Path(folder) if folder else cache / "shpy").expanduser()
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
    except (OSError, RuntimeError) as error:  # RuntimeError where there is no home
        _tell(f"the folder {folder or 'of the cache'} cannot be used", error)
        return None
    return place / f"{name}{_SUFFIX}"


def _read(entry: Path, name: str) -> list[str] | None:
    """Return the words of an entry; None where there is none, or not with their checksum."""
    try:
        checksum, _, words = entry.read_text(errors="replace").partition("\n")
    except FileNotFoundError:
        return None
    except OSError as error:
        _tell(f"an entry of {entry.parent} cannot be read", error)
        return None
    return words.split() if checksum == key(name, words) else None


def _write(entry: Path, name: str, words: str) -> None:
    """Keep words; who reads meanwhile sees the old entry or the whole new one."""
    try:
        with replacing(entry) as path:
            path.write_text(f"{key(name, words)}\n{words}")
    except OSError as error:
        _tell(f"{entry.parent} cannot be written", error)


def _tell(reason: str, error: Exception) -> None:
    """Warn, once for each reason, that each process asks drivers anew."""
    if reason not in _told:
        _told.add(reason)
        cause = getattr(error, "strerror", None) or error
        warn(
            f"what drivers can do is not kept for the next process: {reason} ({cause}); set SHPY_CACHE_DIR to a folder "
            "that you can write, or to nothing if nothing is to be kept"
        )
