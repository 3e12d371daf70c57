"""Tables of text: `Table("bounces", note, head, rows).markdown()`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from shpy.command import markdown


@dataclass(frozen=True)
class Table:
    """A table of text under a heading; `note` explains its numbers, `rounds` are the seconds that some rows come of."""

    name: str
    note: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    rounds: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def markdown(self) -> str:
        """Return the table as Markdown, which a terminal shows well too."""
        return "\n".join([f"### {self.name}", "", self.note, "", markdown([self.head, *self.rows]), ""])
