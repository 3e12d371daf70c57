"""The values without a name in a language like Python, whose names need no declaration and last to the function's end.

Stage: emit. Part of the numpy printer. A value gets its name before its second use is written, not where it is
computed. So a value that only one side of an If uses is computed there, and a value that is stored first gets the
variable's name. Users' names stay.

    %3 = mul %1, %2            t = a * b                 if %c { ... %4 ... }       if c:
    %4 = add %3, 1        ->   x = t + 1            %4 is used there alone    ->        t = f(a)
    store $x = %4              y = x * t                                                ... t ... t
    store $y = mul %4, %3
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Final

from shpy.backend.emit.waiting import Waiting
from shpy.backend.numpy.text.operations import INFIX, UPDATES
from shpy.ir.nodes import Function, If, Let, Loop, Value
from shpy.ir.traverse import continues, defined, regions_of, uses, walk
from shpy.passes.calls import LaneFacts

_NONE: Final[frozenset[int]] = frozenset()
_READERS = frozenset(INFIX) | UPDATES.keys() | {"sqrt", "neg"}
"""Operations that make a new array of those that they read."""


class Naming(Waiting):
    """Tells which values get a name, and when. Atoms, such as names and numbers, get none: each use writes them."""

    def __init__(self, count: Mapping[int, int]) -> None:
        super().__init__(count)
        self.forced: set[int] = set()
        """Values that every way to the end of an iteration needs."""
        self._nameable: set[int] = set()
        """Values that are still to be written, and no atoms."""
        self._named_here: list[set[int]] = [set()]
        """The values that were named in each of the regions around."""
        self._roots: dict[int, int] = {}
        """The first of the values that one array stands for, one after the other."""
        self._mentions: dict[int, frozenset[int]] = {}
        """The named values in the expressions of others, by their roots."""
        self._mentioned: Counter[int] = Counter()
        """By root, the number of nameable values that mention it."""

    def compute(self, s: Let, *, atom: bool) -> None:
        """Count the uses of the operands, and let the result wait."""
        value, reads = s.value.id, self.reads(s)
        mentions = _NONE.union(*[self._mentioned_by(a) for a in s.args])
        self.use(s.args)
        self.add(value, reads)
        self._mentions[value] = mentions
        if not atom:
            self._nameable.add(value)
            self._mentioned.update(mentions)

    def name(self, value: int, *, root: int | None = None) -> None:
        """Note that a value has a name, which stands for the array of `root` if that changes in place."""
        self.remove(value)
        self._named_here[-1].add(value)
        self._roots[value] = value if root is None else self._roots[root]

    def remove(self, value: int) -> None:
        """Note that a value has a name, or that it is not used any more."""
        super().remove(value)
        mentions = self._mentions.pop(value, _NONE)
        if value in self._nameable:
            self._nameable.remove(value)
            self._mentioned.subtract(mentions)

    @contextmanager
    def region(self) -> Iterator[None]:
        """Remove at the end the values that were added inside: nothing after a region uses them."""
        self._named_here.append(set())
        with super().region():
            yield
        self._named_here.pop()

    # Questions

    def needed_again(self, values: Iterable[int]) -> list[int]:
        """Return the values to name before a statement that uses them, since they are used again."""
        return [v for v in dict.fromkeys(values) if self.left[v] > 1 and v in self._nameable]

    def needed_inside(self, s: If | Loop) -> list[int]:
        """Return the values to name before an If or Loop, since each iteration or both sides or later ones use them."""
        counts = [Counter(v for n in walk(r) for v in uses(n)) for r in regions_of(s)]
        if isinstance(s, Loop) and s.until is not None:
            counts.append(Counter((s.until,)))
        inside = sorted(self._nameable & set().union(*counts))
        return [v for v in inside if isinstance(s, Loop) or self.left[v] > max([count[v] for count in counts])]

    def force(self, s: Loop) -> None:
        """Name the values of the body that the step or test needs which a `continue` goes to."""
        if continues(s):
            body = {t.value.id for t in walk(s.body) if isinstance(t, Let)}
            self.forced |= body & {s.until, *(v for t in walk(s.continuing) for v in uses(t))}

    def may_adopt(self, value: int) -> bool:
        """Return whether the name of a variable may stand for a value that is stored there and used again."""
        return value in self._nameable and self.left[value] > 1

    def may_change(self, first: int, rest: Iterable[int]) -> bool:
        """Return whether an operation may change the array of its first operand.

        It was named in this region, this is its last use, and no expression that waits reads the array.
        """
        if first not in self._named_here[-1] or self.left[first] != 1 or first in rest:
            return False
        return not self._mentioned[self._roots[first]]

    def _mentioned_by(self, value: int) -> frozenset[int]:
        root = self._roots.get(value)
        return self._mentions.get(value, _NONE) if root is None else frozenset({root})


class Updates:
    """The values of an entry whose arrays an operation may overwrite when it reads them for the last time.

    So the text has `total += w * x` instead of `total_2 = total + w * x`: numpy allocates no array, and less of the
    cache is used. The conditions: the text itself has made the operand's array, which is as large as the result; only
    operators read it, so no view and no slot shares it; this is its last use; and operand and result are values of one
    variable, or neither has a name.
    """

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
