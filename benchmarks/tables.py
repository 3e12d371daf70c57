"""Tables of text: `Table("bounces", note, head, rows).markdown()`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from shpy.command import markdown


@dataclass(frozen=True)
class Table:
    """A table of text under a heading; `note` explains its numbers."""

    name: str
    note: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def markdown(self) -> str:
        """Return the table as Markdown, which a terminal shows well too."""
        return "\n".join([f"### {self.name}", "", self.note, "", markdown([self.head, *self.rows]), ""])
