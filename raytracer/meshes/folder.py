"""The folder of a mesh file: the other files that it may read, and the notice of its contents that are ignored.

Stage: scene description. A mesh file may come from a stranger: it may name files in its own folder or below it, and no
others. What a reader ignores, and each bad entry that it leaves out, is counted in `Notices`, which says it in a line.

>>> notices = Notices("chair.glb")
>>> notices.ignore("normal maps", 3)
>>> notices.text()
'chair.glb: ignored: normal maps (3)'
>>> notices.leave_out(Fault("face has two corners", "faces have two corners"), 2, "line 7")
>>> notices.faults()
'chair.glb: left out: 2 faces have two corners (the first in line 7)'
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Final, NamedTuple

from raytracer.errors import SceneError, warn

LARGEST: Final = 1 << 30
"""Bytes of a file that another one names."""
_LISTED = 16
"""Entries of a list in a message."""
_NAMED = 20
"""Names of meshes or animations in a message."""
_LONGEST = 60
"""Characters of a name from a file that are shown."""


class BadEntry(SceneError):
    """A bad entry of a file that is read with `strict`."""


class Fault(NamedTuple):
    """A kind of bad entry, as a sentence for one of them and for several, without the number."""

    one: str
    many: str

    def of(self, count: int) -> str:
        """Return the sentence for a number of entries."""
        return f"{count:,} {self.one if count == 1 else self.many}"


class Notices:
    """The parts of a mesh file that are ignored, its bad entries, and the files that it names and that are not read.

    With `strict` a bad entry raises a BadEntry, which has no file name yet, and so does a file that is not read.
    """

    def __init__(self, file: str, *, strict: bool = False) -> None:
        self.file, self.strict = file, strict
        self.ignored: Counter[str] = Counter()
        self.missing: dict[str, str] = {}
        self.bad: dict[Fault, tuple[int, str]] = {}
        """The number of bad entries of each kind, and the place of the first."""

    def ignore(self, what: str, count: int = 1) -> None:
        """Count something that is not read."""
        if count:
            self.ignored[shown(what)] += count

    def leave_out(self, fault: Fault, count: int, where: str, cause: str = "") -> None:
        """Count bad entries that are left out.

        `where` is the place of the first one, such as "line 7". `cause` says more of that one, for the error that it
        is with `strict`: "a face names normal 8, and there are 6".
        """
        if not count:
            return
        if self.strict:
            raise BadEntry(shown(f"{where}: {cause or fault.of(count)}", 200))
        before, first = self.bad.get(fault, (0, where))
        self.bad[fault] = before + count, first

    def miss(self, name: str, reason: str) -> None:
        """Note a file or picture that cannot be used."""
        if self.strict:
            raise BadEntry(f"{shown(name)}: {shown(reason, 200)}")
        self.missing.setdefault(shown(name), shown(reason, 200))

    def faults(self) -> str:
        """Return the bad entries that are left out, in one line; "" where there is no bad entry."""
        entries = [
            shown(f"{fault.of(count)} ({'the first ' if count > 1 else ''}in {where})", 200)
            for fault, (count, where) in self.bad.items()
        ]
        return f"{self.file}: left out: {_listed(entries)}" if entries else ""

    def text(self) -> str:
        """Return the notices in one line; "" where nothing is."""
        entries = [f"{what} ({count})" for what, count in self.ignored.items()]
        return f"{self.file}: ignored: {_listed(entries)}" if entries else ""

    def warn(self) -> None:
        """Say each kind that there is as an sh.ShpyWarning."""
        if self.bad:
            warn(self.faults())
        if self.ignored:
            warn(self.text())
        if self.missing:
            entries = [f"{name} ({reason})" for name, reason in self.missing.items()]
            warn(f"{self.file}: not read, so materials show their plain colours: {_listed(entries)}")


class Folder:
    """The files that a mesh file at `path` may name: regular ones in its folder or below, of at most 1 GiB."""

    def __init__(self, path: Path) -> None:
        self.root = path.resolve().parent
        self._names: dict[Path, list[str]] = {}

    def find(self, name: str, beside: Path | None = None) -> Path:
        """Return the path of a file by the name that a mesh file has for it.

        It is looked for in the folder `beside`, where that is given, and then in the folder itself. Where there is no
        file of just this name, it may be without the spaces around it, without what follows a ? or # of a URL, and with
        other capitals, if one file alone has these letters. Of a name that leads elsewhere the last part is looked for.
        Raises SceneError where there is no file, and where it is not regular or too large.
        """
        name = name.replace("\\", "/")
        plain = name.strip()
        if not plain or "\0" in name:
            raise SceneError("there is no such file")
        outside = PurePosixPath(plain).is_absolute() or bool(PureWindowsPath(plain).drive) or "://" in plain
        path = None
        for base in dict.fromkeys((beside or self.root, self.root)):
            leads_out = outside or self._inside(base, plain) is None
            path = path or self._first(base, PurePosixPath(plain).name if leads_out else name)
        if path is None:
            cure = "it lies outside of the file's folder: put it there"
            raise SceneError(cure if leads_out else "there is no such file")
        if path.stat().st_size > LARGEST:
            raise SceneError(f"it has {path.stat().st_size:,} bytes, more than {LARGEST:,}")
        return path

    def _first(self, base: Path, name: str) -> Path | None:
        """Return the first regular file by the ways of writing a name; None if there is none."""
        plain = name.strip()
        spelled = [spelling for spelling in dict.fromkeys((name, plain, re.split("[?#]", plain)[0])) if spelling]
        searched = (search(base, spelling) for search in (self._inside, self._in_other_case) for spelling in spelled)
        return next((place for place in searched if place is not None and place.is_file()), None)

    def _in_other_case(self, base: Path, name: str) -> Path | None:
        """Return the one path whose name differs in capitals alone; None if there is none, or several."""
        place = base
        for part in PurePosixPath(name).parts:
            if part == ".." or not place.is_dir():
                return None
            if place not in self._names:
                self._names[place] = os.listdir(place)
            alike = [entry for entry in self._names[place] if entry.casefold() == part.casefold()]
            if len(alike) != 1:
                return None
            place = place / alike[0]
        return self._inside(place, "")

    def read(self, name: str) -> bytes:
        """Read a file; see `find`."""
        return self.find(name).read_bytes()

    def _inside(self, base: Path, name: str) -> Path | None:
        """Return the path of a name, links followed; None if it leads out of the folder."""
        path = (base / name).resolve()
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
    """Return names of meshes or animations in one line, each as it is shown; of many, the first ones."""
    return ", ".join(map(shown, names[:_NAMED])) + _rest(names, _NAMED)


def _rest(entries: Sequence[str], told: int) -> str:
    return f" and {len(entries) - told:,} more" if len(entries) > told else ""
