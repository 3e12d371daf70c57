"""Uniformity, the same value for all lanes: the rule for operations, and the facts about a loop.

Stage: improve. Part of `vectorize`, which asks `varies` for every operation and keeps `LoopFacts` with every loop.

A value is uniform at a point if all lanes that are active there hold the same. Constants, params and what is computed
from uniform values are; the program's inputs and the element's index are not. A loop's lanes enter it together and
iterate together, so a counter that each of them counts is one counter, whenever they leave.

>>> varies("add", [False, False]), varies("table", [True]), varies("lane_any", [True])
(False, True, False)
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

_UNIFORM = frozenset({"any_lane", "all_lanes", "lane_any", "table_size", "grid_shape"})
_VARYING = frozenset({"grid_index", "lane_mask", "neighbour"})


def varies(op: str, args: Iterable[bool]) -> bool:
    """Return whether the result of `op` differs from lane to lane, when its arguments do as `args` says."""
    return op in _VARYING or (op not in _UNIFORM and any(args))


@dataclass(slots=True)
class LoopFacts:
    """The facts about a loop so far. They only grow, so that the analysis ends."""

    varying: bool = False
    """Lanes leave it in different iterations."""
    continues: bool = False
    """Lanes skip the rest of an iteration while others go on."""
    jumps: bool = False
    """A real Continue stands in what was made of it."""
    copied: set[int] = field(default_factory=set)
    """Variables whose values must be saved for the lanes that leave."""
    head: set[int] = field(default_factory=set)
    """Variables that vary where an iteration begins, ..."""
    step: set[int] = field(default_factory=set)
    """... where `continuing` begins, ..."""
    exit: set[int] = field(default_factory=set)
    """... and where all lanes leave together."""

    def size(self) -> int:
        """Count the facts: the analysis repeats until their number stops growing."""
        sets = (self.copied, self.head, self.step, self.exit)
        return self.varying + self.continues + self.jumps + sum(map(len, sets))
