"""Compiled kernels on disk, so that the next process need not compile them again.

Stage: compile. An entry is a driver's binary under the hash of everything that it depends on (text, options, device,
driver and version): data only, which a driver loads and nothing executes here. It is written to a temporary name and
then renamed; one that is broken counts as none. The folder is SHPY_CACHE_DIR, or `shpy` in the user's cache folder;
SHPY_CACHE_DIR set to nothing keeps nothing.

    key = store.key(text, options, device, driver)
    binary = store.load(key)               # None where there is none
    store.save(key, binary)
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final

_MAGIC: Final = b"shpy kernel 1\n"
_MOST: Final = 512
"""Entries kept: the ones used longest ago go first."""


def folder() -> Path | None:
    """Where kernels are kept, made with mode 0700 if it is not there; None where nothing is to be kept or can be."""
    chosen = os.environ.get("SHPY_CACHE_DIR")
    if chosen == "":
        return None
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        path = Path(chosen) if chosen else home / "shpy"
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        # Whoever can write here can hand a driver a binary: it has to be the user alone.
        state = path.stat()
        if hasattr(os, "getuid") and state.st_uid != os.getuid():
            return None
        if state.st_mode & 0o077:
            path.chmod(0o700)
    except (OSError, RuntimeError):
        return None
    return path


def key(*parts: str) -> str:
    """The name of an entry: a hash of all that the binary depends on."""
    digest = hashlib.sha256()
    for part in parts:
        encoded = part.encode("utf-8", "surrogatepass")
        digest.update(len(encoded).to_bytes(8, "little") + encoded)
    return digest.hexdigest()


def load(name: str) -> bytes | None:
    """The binary kept under this name; None where there is none, or a broken one, which is removed."""
    path = folder()
    if path is None:
        return None
    entry = path / name
    try:
        data = entry.read_bytes()
    except OSError:
        return None
    head, binary = data[: len(_MAGIC) + 32], data[len(_MAGIC) + 32 :]
    if head != _MAGIC + hashlib.sha256(binary).digest():
        remove(name)
        return None
    with suppress(OSError):
        os.utime(entry)
    return binary


def save(name: str, binary: bytes) -> None:
    """Keep a binary; whoever reads meanwhile sees the old entry or the whole new one. A full disk is no error."""
    path = folder()
    if path is None:
        return
    temporary = None
    try:
        with tempfile.NamedTemporaryFile(dir=path, prefix=".new-", delete=False) as file:
            temporary = file.name
            file.write(_MAGIC + hashlib.sha256(binary).digest() + binary)
        os.replace(temporary, path / name)
        _prune(path)
    except OSError:
        if temporary is not None:
            with suppress(OSError):
                os.unlink(temporary)


def remove(name: str) -> None:
    """Forget an entry."""
    path = folder()
    if path is not None:
        with suppress(OSError):
            (path / name).unlink()


def _prune(path: Path) -> None:
    entries = [e for e in path.iterdir() if not e.name.startswith(".")]
    if len(entries) > _MOST:
        for entry in sorted(entries, key=lambda e: e.stat().st_mtime)[: len(entries) - _MOST]:
            with suppress(OSError):
                entry.unlink()
