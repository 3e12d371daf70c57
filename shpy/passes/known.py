"""Range analysis: find bounds of ints at compile time.

Stage: improve; it changes nothing. A printer uses the bounds to omit the clamp of an index that is always in range. A
value without known bounds gets the range of its type. Sums that cannot wrap need no arithmetic that wraps.

    %3: i = min %2, %n        (%2 is at least 0 and %n is 9)
    %5: i = and %4, 7
    %6: i = add %3, %5        span(%6) == (0, 16)
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable

from shpy.ir.nodes import Call, Function, Let, Store, Variable
from shpy.ir.traverse import results, walk
from shpy.ir.types import Base

Span = tuple[int, int]

_SPANS = {Base.I: (-(2**31), 2**31 - 1), Base.U: (0, 2**32 - 1), Base.B: (0, 1)}
_SAME = frozenset({"splat", "construct", "swizzle"})
_DEEPEST = 50
"""The largest depth of operands that are followed; deeper ones get the range of their type."""


class Ranges:
    """The ranges of the values of a function."""

    def __init__(self, function: Function) -> None:
        self._lets: dict[int, Let] = {}
        self._stored: dict[int, list[int]] = defaultdict(list)
        self._types = {i.id: i.type for i in function.inputs if not isinstance(i, Variable)}
        own = {v.id for v in function.variables}
        self._hidden = {v.id for v in (*function.inputs, *function.outputs)} - own
        self._spans: dict[tuple[str, int], Span] = {}
        self._depth = 0
        for s in walk(function.body):
            for value in results(s):
                self._types[value.id] = value.type
            match s:
                case Let():
                    self._lets[s.value.id] = s
                case Store():
                    self._stored[s.variable].append(s.value)
                case Call():
                    self._hidden |= set(s.args)  # the callee may store into arguments by reference

    def within(self, value: int, low: int, high: int) -> bool:
        """Return whether all components of an int, uint or bool lie between `low` and `high`, inclusive."""
        least, greatest = self.span(value)
        return low <= least and greatest <= high

    def span(self, value: int) -> Span:
        """Return the least and the greatest possible value of the components of an int, uint or bool."""
        anything = _SPANS[self._types[value].base]
        let = self._lets.get(value)
        if let is None or self._depth > _DEEPEST:
            return anything
        key = "value", value
        if key not in self._spans:
            self._spans[key] = anything  # ends the recursion for a value that depends on itself through a loop
            self._depth += 1
            unwrapped = self._span(let)
            self._depth -= 1
            self._spans[key] = unwrapped if _fits(unwrapped, anything) else anything
        return self._spans[key]

    def may_wrap(self, let: Let) -> bool:
        """Return whether a sum, difference or product of ints or uints may exceed the range of its type."""
        return not _fits(self._span(let), _SPANS[let.value.type.base])

    def _span(self, let: Let) -> Span:
        """Return the span of a value before it wraps."""
        anything = _SPANS[let.value.type.base]
        if let.op == "const":
            assert isinstance(let.attr, tuple)
            return min(let.attr), max(let.attr)
        if let.op == "load":
            assert isinstance(let.attr, int)
            return self._slot(let.attr, anything)
        args = let.args[1:] if let.op == "cond" else let.args
        if let.op not in _SPANNED or any(self._types[a].is_float for a in args):
            return anything
        return _SPANNED[let.op]([self.span(a) for a in args], anything)

    def _slot(self, variable: int, anything: Span) -> Span:
        """Return the span of a variable: of its initial zero and of all stored values."""
        if variable in self._hidden:
            return anything
        key = "slot", variable
        if key not in self._spans:
            self._spans[key] = anything
            self._spans[key] = _hull([(0, 0), *(self.span(v) for v in self._stored[variable])])
        return self._spans[key]


def _fits(span: Span, range: Span) -> bool:
    return range[0] <= span[0] and span[1] <= range[1]


def _hull(spans: list[Span]) -> Span:
    return min(low for low, _ in spans), max(high for _, high in spans)


def _products(spans: list[Span], _: Span) -> Span:
    (a, b), (c, d) = spans
    ends = a * c, a * d, b * c, b * d
    return min(ends), max(ends)


def _bits_of_both(spans: list[Span], anything: Span) -> Span:
    """Return the span of `a & b`, which is at most as large as an operand that is not negative."""
    limits = [high for low, high in spans if low >= 0]
    return (0, min(limits)) if limits else anything


def _shifted_right(spans: list[Span], anything: Span) -> Span:
    (low, high), (least, most) = spans
    if not 0 <= least <= most < 32:
        return anything
    ends = low >> least, low >> most, high >> least, high >> most
    return min(ends), max(ends)


_SPANNED: dict[str, Callable[[list[Span], Span], Span]] = {
    "add": lambda spans, _: (spans[0][0] + spans[1][0], spans[0][1] + spans[1][1]),
    "sub": lambda spans, _: (spans[0][0] - spans[1][1], spans[0][1] - spans[1][0]),
    "mul": _products,
    "min": lambda spans, _: (min(low for low, _ in spans), min(high for _, high in spans)),
    "max": lambda spans, _: (max(low for low, _ in spans), max(high for _, high in spans)),
    "clamp": lambda spans, _: (
        min(max(spans[0][0], spans[1][0]), spans[2][0]),
        min(max(spans[0][1], spans[1][1]), spans[2][1]),
    ),
    "and": _bits_of_both,
    "shr": _shifted_right,
    "convert": lambda spans, _: spans[0],
} | dict.fromkeys(["cond", *_SAME], lambda spans, _: _hull(spans))
"""Functions from the spans of the operands, and the span of the type, to the span of the result before it wraps."""
