"""The folder of a mesh file: the other files that it may read, and the notice of its contents that are ignored.

Stage: scene description. A mesh file may come from a stranger: it may name files in its own folder or below it, and no
others. What a reader leaves out is counted in `Notices`, which says it in one line.

>>> notices = Notices("chair.glb")
>>> notices.ignore("normal maps", 3)
>>> notices.text()
'chair.glb: ignored: normal maps (3)'
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Final

from raytracer.errors import SceneError, warn

LARGEST: Final = 1 << 30
"""Bytes of a file that another one names."""
_LISTED = 16
"""Entries of a list in a message."""
_NAMED = 20
"""Names of meshes in a message."""
_LONGEST = 60
"""Characters of a name from a file that are shown."""


class Notices:
    """The parts of a mesh file that are ignored, and the files that it names and that could not be read."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.ignored: Counter[str] = Counter()
        self.missing: dict[str, str] = {}

    def ignore(self, what: str, count: int = 1) -> None:
        """Count something that is not read."""
        if count:
            self.ignored[shown(what)] += count

    def miss(self, name: str, reason: str) -> None:
        """Note a file or picture that cannot be used."""
        self.missing.setdefault(shown(name), shown(reason, 200))

    def text(self) -> str:
        """Return what is ignored, in one line; "" where nothing is."""
        entries = [f"{what} ({count})" for what, count in self.ignored.items()]
        return f"{self.file}: ignored: {_listed(entries)}" if entries else ""

    def warn(self) -> None:
        """Say both as an sh.ShpyWarning each."""
        if self.ignored:
            warn(self.text())
        if self.missing:
            entries = [f"{name} ({reason})" for name, reason in self.missing.items()]
            warn(f"{self.file}: not read, so materials show their plain colours: {_listed(entries)}")


class Folder:
    """The files that a mesh file at `path` may name: regular ones in its folder or below, of at most 1 GiB."""

    def __init__(self, path: Path) -> None:
        self.root = path.resolve().parent

    def find(self, name: str) -> Path:
        """Return the path of a file by the name that a mesh file has for it.

        Of a name that leads elsewhere the last part is looked for in the folder itself. Raises SceneError where there
        is no file, and where it is not regular or too large.
        """
        name = name.strip().replace("\\", "/")
        if not name or "\0" in name:
            raise SceneError("there is no such file")
        elsewhere = PurePosixPath(name).is_absolute() or bool(PureWindowsPath(name).drive) or "://" in name
        found = None if elsewhere else self._inside(name)
        if found is None:
            found = self._inside(PurePosixPath(name).name)
            if found is None or not found.is_file():
                raise SceneError("it lies outside of the file's folder: put it there")
        if not found.is_file():
            raise SceneError("there is no such file")
        if found.stat().st_size > LARGEST:
            raise SceneError(f"it has {found.stat().st_size:,} bytes, more than {LARGEST:,}")
        return found

    def read(self, name: str) -> bytes:
        """Read a file; see `find`."""
        return self.find(name).read_bytes()

    def _inside(self, name: str) -> Path | None:
        """Return the path of a name, links followed; None if it leads out of the folder."""
        path = (self.root / name).resolve()
        return path if path.is_relative_to(self.root) else None


def shown(text: str, longest: int = _LONGEST) -> str:
    """Return a text from a file as it is shown: one line of printable characters, and not too long."""
    line = " ".join(text.split())
    line = "".join(c if c.isprintable() else "?" for c in line)
    cut = (longest - 3) // 2
    return line if len(line) <= longest else f"{line[:cut]}...{line[-cut:]}"


def _listed(entries: Sequence[str]) -> str:
    """Return entries in one line; of many, the first ones."""
    return ", ".join(entries[:_LISTED]) + _rest(entries, _LISTED)


def named(names: Sequence[str]) -> str:
    """Return names of meshes in one line, each as it is shown; of many, the first ones."""
    return ", ".join(map(shown, names[:_NAMED])) + _rest(names, _NAMED)


def _rest(entries: Sequence[str], told: int) -> str:
    return f" and {len(entries) - told:,} more" if len(entries) > told else ""
