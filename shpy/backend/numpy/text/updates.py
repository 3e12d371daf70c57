"""Updates: write a result into the array of an operand, `total += w * x` instead of `total_2 = total + w * x`.

Stage: emit. Part of the numpy printer. Takes the entry of a vectorised module; tells for each operation whether it may
overwrite its first operand. Then numpy allocates no array, and less of the cache is used.

The conditions: the text itself has made the operand's array, which is as large as the result; only operators read it,
so no view and no slot shares it; this is its last use; and operand and result are values of one variable, or neither
has a name.
"""

from __future__ import annotations

from collections import defaultdict

from shpy.backend.numpy.text.operations import INFIX, UPDATES
from shpy.ir.nodes import Function, Let, Value
from shpy.ir.traverse import defined, uses, walk
from shpy.passes.calls import LaneFacts

_READERS = frozenset(INFIX) | UPDATES.keys() | {"sqrt", "neg"}
"""Operations that make a new array of those that they read."""


class Updates:
    """The values of an entry whose arrays an operation may overwrite when it reads them for the last time."""

    def __init__(self, entry: Function, facts: LaneFacts) -> None:
        readers: dict[int, set[str]] = defaultdict(set)
        self.lets: dict[int, Let] = {}
        for s in walk(entry.body):
            if isinstance(s, Let):
                self.lets[s.value.id] = s
            for value in uses(s):
                readers[value].add(s.op if isinstance(s, Let) else "")
        own = {v for v, s in self.lets.items() if s.op in UPDATES.keys() | {"div"}}
        large = _large(entry, facts)
        self.changing = {v for v in own & large if readers[v] <= _READERS}
        self.large = large

    def allows(self, s: Let) -> bool:
        """Return whether the operation may write its result into the array of its first operand."""
        if s.op not in UPDATES:
            return False
        before = self.lets.get(s.args[0])
        return s.args[0] in self.changing and before is not None and _alike(before.value, s.value)


def _alike(before: Value, after: Value) -> bool:
    return before.type is after.type and before.type.size == 1 and before.name == after.name


def _large(entry: Function, facts: LaneFacts) -> set[int]:
    """Return the values with a number for each lane, not only for each row or column of a grid."""
    lets = [s for s in walk(entry.body) if isinstance(s, Let)]
    if not any(s.op == "grid_index" for s in lets):
        return {v.id for v in defined(entry)} & facts.varying
    values = {i.id for i in entry.inputs}
    for s in lets:
        if s.op == "neighbour" or (s.op in _READERS and any(a in values for a in s.args)):
            values.add(s.value.id)
    return values
