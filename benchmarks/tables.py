"""The `Setup` that a study takes, and the `Table` of text that it gives: `print(lights(Setup(mesh)).markdown())`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

from benchmarks import peers
from raytracer import Mesh
from raytracer.meshes.shapes import knot
from shpy.command import markdown


@dataclass(frozen=True)
class Setup:
    """The mesh of a study, whether it is to be quick, and the names of the peers that it may use."""

    mesh: Mesh = field(default_factory=partial(knot, segments=60, sides=12))
    quick: bool = False
    peers: Sequence[str] = ()

    def installed(self, *names: str) -> list[str]:
        """Return those of these peers that it may use and that are installed."""
        return peers.available([name for name in names if name in self.peers])[0]


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
