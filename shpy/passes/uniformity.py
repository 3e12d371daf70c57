"""Uniformity, the same value for all lanes: the rule for operations, and the facts about a loop.

Stage: improve. Part of `vectorize`, which asks `varies` for every operation and keeps `LoopFacts` with every loop.

A value is uniform at a point if all lanes that are active there hold the same value. Constants, params and results of
uniform values are uniform; the program's inputs and the element's index vary. The lanes of a loop enter it together and
iterate together, so a loop counter is uniform even if lanes leave in different iterations.

>>> varies("add", [False, False]), varies("table", [True]), varies("lane_any", [True])
(False, True, False)
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from shpy.ir.ops import LANE_OPS

_UNIFORM = LANE_OPS | {"lane_any", "lane_min", "lane_max", "table_size", "grid_line", "grid_shape"}
_VARYING = frozenset({"grid_index", "lane_mask", "neighbour"})


def varies(op: str, args: Iterable[bool]) -> bool:
    """Return whether the result of `op` varies, given for each argument whether it varies."""
    return op in _VARYING or (op not in _UNIFORM and any(args))


@dataclass(slots=True)
class LoopFacts:
    """The facts found about a loop. They only grow, so that the analysis terminates."""

    varying: bool = False
    """Lanes leave it in different iterations."""
    continues: bool = False
    """Lanes skip the rest of an iteration while others go on."""
    jumps: bool = False
    """The translated loop contains a real Continue."""
    copied: set[int] = field(default_factory=set)
    """Variables whose values must be saved for the lanes that leave."""
    head: set[int] = field(default_factory=set)
    """Variables that vary where an iteration begins, ..."""
    step: set[int] = field(default_factory=set)
    """... where `continuing` begins, ..."""
    exit: set[int] = field(default_factory=set)
    """... and where all lanes leave together."""

    def size(self) -> int:
        """Return the number of facts that the translation of an iteration uses; it is repeated if they have grown."""
        sets = (self.copied, self.head, self.step)
        return self.varying + self.continues + self.jumps + sum(map(len, sets))
