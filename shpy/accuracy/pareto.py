"""Time against error of many variants: the Pareto frontier, the choice, the table and the plot of a trade-off.

Stage: measure. `tradeoff` of programs and of pictures bring their candidates, fastest first.

    front = frontier(candidates, lambda c: c.error)
    comparison = Comparison("sqrt: time against error", points, ...)
    points[comparison.picked]
    print(comparison.table())
    draw(comparison, figure)             # of pareto_plot

Times of a loaded machine vary. Two variants are separable in time where the middle halves of their rounds, from the
lower to the upper quartile, do not overlap: nearly the test of two medians at 5 % by the notches of box plots (McGill,
Tukey and Larsen, Variations of Box Plots, The American Statistician 32, 1978).
"""

from __future__ import annotations

import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, Protocol, TypeVar

import numpy as np

from shpy.accuracy.report import columns

PICK, FRONT, LIKE = "→", "*", "≈"
"""The marks of a table."""
_NAMES: Final = {
    "strict": "the same bits on every backend",
    "portable": "strict, by formulas of 32-bit floats alone",
    "relaxed": "the target's own functions",
    "fast": "whatever is fastest; NaN and infinity may vanish",
    "fused": "a * b + c rounded once, with the same bits on every backend",
    "f16": "16-bit floats",
    "f32": "32-bit floats",
    "f64": "64-bit floats",
}
_WIDTH = 118
"""Columns of the lines under a table."""

Spread = tuple[float, float]
"""The lower and the upper quartile of the rounds."""


def names_of(words: Iterable[str]) -> dict[str, str]:
    """Return the meanings of the modes and precisions among these words.

    >>> names_of(["numpy", "f32"])
    {'f32': '32-bit floats'}
    """
    used = set(words)
    return {name: meaning for name, meaning in _NAMES.items() if name in used}


class TimedCandidate(Protocol):
    """A candidate of a trade-off, which has quartiles of its times."""

    @property
    def spread(self) -> Spread:
        """The quartiles of the rounds."""


Measured = TypeVar("Measured")
Candidate = TypeVar("Candidate", bound=TimedCandidate)


def frontier(candidates: Iterable[Measured], error: Callable[[Measured], float]) -> tuple[Measured, ...]:
    """Return the candidates, fastest first, whose error is less than that of every faster one (Pareto).

    >>> frontier([(1, 0.5), (2, 0.7), (3, 0.1)], lambda c: c[1])
    ((1, 0.5), (3, 0.1))
    """
    front: list[Measured] = []
    for candidate in candidates:
        if not front or error(candidate) < error(front[-1]):
            front.append(candidate)
    return tuple(front)


def separable(one: Spread, two: Spread) -> bool:
    """Return whether two times can be told apart: their quartiles do not overlap.

    >>> separable((1.0, 1.2), (1.3, 1.4)), separable((1.0, 1.2), (1.1, 1.4))
    (True, False)
    """
    return one[1] < two[0] or two[1] < one[0]


def rivals(kept: Iterable[Candidate], error: Callable[[Candidate], float]) -> tuple[Candidate, ...]:
    """Return the fastest candidate, and those of the frontier whose times are not separable from its time.

    `kept` are in order of time. The measured times do not separate the rivals; the error falls from each to the next.
    """
    front = frontier(kept, error)
    return tuple(c for c in front if not separable(c.spread, front[0].spread))


def choose(kept: Iterable[Candidate], error: Callable[[Candidate], float]) -> Candidate | None:
    """Return the most exact of the `rivals`, since their times do not decide; None if no candidate is kept."""
    choices = rivals(kept, error)
    return choices[-1] if choices else None


def timed(
    calls: Sequence[Callable[[], object]], rounds: int, enough: float, tell: Callable[[int], None] | None = None
) -> list[tuple[float, Spread]]:
    """Measure calls, all in turn in each round: return the median seconds of each and the quartiles of the rounds.

    In each round a call runs once more than it is timed: its first run finds the caches and the threads as another
    call has left them. Runs that take less than `enough` seconds are timed several at once. `tell` is called with
    the number of finished rounds.
    """
    times: list[list[float]] = [[] for _ in calls]
    for done in range(rounds):
        if tell is not None:
            tell(done)
        for call, seconds in zip(calls, times, strict=True):
            count = max(1, int(enough / _seconds(call, 1)))
            seconds.append(_seconds(call, count) / count)
    if tell is not None:
        tell(rounds)
    quartiles = (np.quantile(seconds, (0.25, 0.5, 0.75)).tolist() for seconds in times)
    return [(middle, (low, high)) for low, middle, high in quartiles]


def _seconds(call: Callable[[], object], count: int) -> float:
    started = time.perf_counter()
    for _ in range(count):
        call()
    return time.perf_counter() - started


@dataclass(frozen=True)
class Point:
    """One variant as the table and the plot of a trade-off show it.

    `name` is for the table, `label` for the plot; `series` has a colour, `mode` a marker. `time` is the median
    of the rounds. `kept` says if it may be chosen. `cells` are the rest of the row.
    """

    name: str
    label: str
    series: str
    mode: str
    time: float
    spread: Spread
    error: float
    kept: bool
    cells: tuple[str, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """Points, fastest first, how to show them, and the choice among them.

    `headings` are those of the columns: name, time, spread, error, and the cells; `meanings` tells what is under a
    heading or behind a short name. `time` and `error` are the labels of the axes, with units; `series` and `mode` are
    the meanings of colours and markers.
    """

    title: str
    points: tuple[Point, ...]
    limit: float
    budget: str
    headings: tuple[str, ...]
    meanings: Mapping[str, str]
    time: str
    error: str
    series: str
    mode: str
    skipped: tuple[tuple[str, str], ...] = field(default=())

    @cached_property
    def front(self) -> tuple[int, ...]:
        """The indices of the points on the Pareto front, fastest first: no other point is faster and more exact."""
        return self._places(frontier(self.points, _error))

    @cached_property
    def kept(self) -> int | None:
        """The place of the fastest point that may be chosen, None where none may."""
        return next((n for n, p in enumerate(self.points) if p.kept), None)

    @cached_property
    def picked(self) -> int | None:
        """The place of the choice: of the points that may be chosen and are as fast as `kept`, the closest."""
        choice = choose((p for p in self.points if p.kept), _error)
        return None if choice is None else self._places([choice])[0]

    @cached_property
    def like(self) -> frozenset[int]:
        """The points whose times are not separable from that of the fastest that keeps the limit, without itself."""
        if self.kept is None:
            return frozenset()
        spread = self.points[self.kept].spread
        return frozenset(n for n, p in enumerate(self.points) if n != self.kept and not separable(p.spread, spread))

    def _places(self, points: Iterable[Point]) -> tuple[int, ...]:
        place = {id(p): n for n, p in enumerate(self.points)}
        return tuple(place[id(p)] for p in points)

    def marks(self, place: int) -> dict[str, bool]:
        """Return the marks of a point for JSON."""
        return {"frontier": place in self.front, "like_fastest": place in self.like, "best": place == self.picked}

    def table(self) -> str:
        """Return the points as text, what was not run, and a legend of the marks, columns and short names."""
        rows = [("", "", *self.headings)]
        for n, p in enumerate(self.points):
            mark = PICK if n == self.picked else FRONT if n in self.front else ""
            spread = f"{_number(p.spread[0])} to {_number(p.spread[1])}"
            numbers = _number(p.time), spread, f"{p.error:.3g}"
            rows.append((mark, LIKE if n in self.like else "", p.name, *numbers, *p.cells))
        missing = [f"  not run: {what}: {why}" for what, why in self.skipped]
        return "\n".join([self.title, *columns(rows, left=(0, 1, 2)), *missing, "", *self._legend()])

    def _legend(self) -> Iterator[str]:
        """Explain the marks, the columns and the short names."""
        meanings = {}
        if self.picked is not None:
            meanings[PICK] = (
                f"the pick: of the variants {self.budget} that are as fast as the fastest of them, the closest"
            )
        meanings[FRONT] = "the frontier: no other variant is both faster and closer"
        if self.kept is not None and self.like:
            fastest = self.points[self.kept].name
            meanings[LIKE] = f"not separable in time from {fastest}, the fastest {self.budget}: their quartiles overlap"
        meanings |= self.meanings
        width = max(map(len, meanings))
        for name, meaning in meanings.items():
            yield from textwrap.wrap(
                meaning, _WIDTH, initial_indent=f"  {name:{width}}  ", subsequent_indent=" " * (width + 4)
            )


def _error(point: Point) -> float:
    return point.error


def _number(value: float) -> str:
    """Format a time with three digits, and without an exponent in the range that people read."""
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"
