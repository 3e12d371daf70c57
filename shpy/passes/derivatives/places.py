"""Places of the backward part of a reverse function: its regions, and the values that each may use.

Stage: improve; for `reverse`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from shpy.passes.derivatives.linear import Tangent


@dataclass
class Place:
    """A region of the backward part: the values that it may use, and the bars of the values of its own region."""

    parent: Place | None
    visible: set[int] = field(default_factory=set)
    bars: dict[int, Tangent] = field(default_factory=dict)
    loads: dict[int, int] = field(default_factory=dict)
    own: set[int] = field(default_factory=set)

    def sees(self, value: int) -> bool:
        """Return whether a value of the new function is visible here."""
        return value in self.visible or (self.parent is not None and self.parent.sees(value))

    def load_of(self, value: int) -> int | None:
        """Return the load of a kept value that is visible here."""
        return self.loads.get(value) or (self.parent.load_of(value) if self.parent is not None else None)
