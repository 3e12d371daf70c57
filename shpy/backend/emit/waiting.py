"""The values without a name that are still to be used, and the variables that their expressions read.

Stage: emit. A statement that changes a variable binds the values that read it and wait. They are found by the variable,
so the work is in proportion to the values that are bound, and not to those that wait.

    waiting = Waiting(survey.uses)
    waiting.add(3, frozenset({x}))      # %3 = add %1, %2   where %1 is loaded from $x
    waiting.readers([x])                # [3]
    waiting.use([3])                    # its last use: it waits no more
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Final

from shpy.ir.nodes import Let, Store

_NONE: Final[frozenset[int]] = frozenset()


class Waiting:
    """Values by id, in the order in which they were added."""

    def __init__(self, uses: Mapping[int, int]) -> None:
        self.left = Counter(uses)
        """The uses of each value that are still to come."""
        self._reads: dict[int, frozenset[int]] = {}
        self._readers: dict[int, dict[int, int]] = {}
        """By variable, the values that read it, each with the number of its addition."""
        self._added: list[int] = []
        """The values that were added in the regions that are not at their end."""
        self._additions = 0

    def __contains__(self, value: int) -> bool:
        return value in self._reads

    def reads(self, s: Let | Store) -> frozenset[int]:
        """Return the variables that the expression of an operation, or of a stored value, reads: none if a name."""
        if isinstance(s, Store):
            return self._reads.get(s.value, _NONE)
        loaded = frozenset({s.attr}) if s.op == "load" and isinstance(s.attr, int) else _NONE
        return loaded.union(*[self._reads.get(a, _NONE) for a in s.args])

    def readers(self, variables: Iterable[int]) -> list[int]:
        """Return the values that read one of the variables."""
        values: dict[int, int] = {}
        for variable in variables:
            values.update(self._readers.get(variable, {}))
        return sorted(values, key=values.__getitem__)

    def add(self, value: int, variables: frozenset[int]) -> None:
        """Let a value wait whose expression reads these variables."""
        self._additions += 1
        self._reads[value] = variables
        self._added.append(value)
        for variable in variables:
            self._readers.setdefault(variable, {})[value] = self._additions

    def remove(self, value: int) -> None:
        """Note that a value has a name, or that it is not used any more."""
        for variable in self._reads.pop(value, _NONE):
            del self._readers[variable][value]

    def use(self, values: Iterable[int]) -> None:
        """Count a use of each value."""
        for value in values:
            self.left[value] -= 1
            if not self.left[value]:
                self.remove(value)

    @contextmanager
    def region(self) -> Iterator[None]:
        """Remove at the end the values that were added inside: nothing after a region uses them."""
        start = len(self._added)
        yield
        for value in self._added[start:]:
            self.remove(value)
        del self._added[start:]
