"""Tables of text, and the one writer of Markdown tables: `Table("bounces", note, head, rows).markdown()`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


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


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as a Markdown table; the first one is the head, and all columns but the first are numbers."""
    head, *body = rows
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *body]
    widths = [max(len(row[i]) for row in lines) for i in range(len(head))]
    sides = "<" + ">" * (len(head) - 1)
    return "\n".join(
        "| " + " | ".join(f"{c:{s}{w}}" for c, s, w in zip(row, sides, widths, strict=True)) + " |" for row in lines
    )
