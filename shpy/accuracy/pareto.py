"""Time against error of many variants: the Pareto frontier, the choice, the table and the plot of a trade-off.

Stage: measure. `tradeoff` of programs and of pictures bring their candidates, fastest first.

    front = frontier(candidates, lambda c: c.error)
    comparison = Comparison("sqrt: time against error", points, ...)
    print(comparison.table())
    draw(comparison, figure)             # of pareto_plot

Times of a loaded machine vary. Two variants are separable in time where the middle halves of their rounds, from the
lower to the upper quartile, do not overlap: nearly the test of two medians at 5 % by the notches of box plots (McGill,
Tukey and Larsen, Variations of Box Plots, The American Statistician 32, 1978).
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol, TypeVar

from shpy.accuracy.report import columns

__all__ = ["Comparison", "Point", "choose", "frontier", "names_of", "rivals", "separable"]

PICK, FRONT, LIKE = "→", "*", "≈"
"""The marks of a table."""
_NAMES: Final = {
    "strict": "the same bits on every backend",
    "relaxed": "the target's own functions",
    "fast": "whatever is fastest; NaN and infinity may vanish",
    "f16": "16-bit floats",
    "f32": "32-bit floats",
    "f64": "64-bit floats",
}
_WIDTH = 118
"""Columns of the lines under a table."""

Spread = tuple[float, float]
"""The lower and the upper quartile of the rounds."""


def names_of(words: Iterable[str]) -> dict[str, str]:
    """Return what the modes and precisions among these words mean.

    >>> names_of(["numpy", "f32"])
    {'f32': '32-bit floats'}
    """
    used = set(words)
    return {name: meaning for name, meaning in _NAMES.items() if name in used}


class Timed(Protocol):
    """A candidate of a trade-off: whatever has quartiles of its times."""

    @property
    def spread(self) -> Spread:
        """The quartiles of the rounds."""


Measured = TypeVar("Measured")
Candidate = TypeVar("Candidate", bound=Timed)


def frontier(candidates: Iterable[Measured], error: Callable[[Measured], float]) -> tuple[Measured, ...]:
    """Of candidates in order of time, fastest first, those whose error is less than that of all before (Pareto).

    >>> frontier([(1, 0.5), (2, 0.7), (3, 0.1)], lambda c: c[1])
    ((1, 0.5), (3, 0.1))
    """
    found: list[Measured] = []
    for candidate in candidates:
        if not found or error(candidate) < error(found[-1]):
            found.append(candidate)
    return tuple(found)


def separable(one: Spread, two: Spread) -> bool:
    """Return whether two times can be told apart: their quartiles do not overlap.

    >>> separable((1.0, 1.2), (1.3, 1.4)), separable((1.0, 1.2), (1.1, 1.4))
    (True, False)
    """
    return one[1] < two[0] or two[1] < one[0]


def rivals(kept: Iterable[Candidate], error: Callable[[Candidate], float]) -> tuple[Candidate, ...]:
    """Return the fastest candidate, and those of the frontier whose times are not separable from its time.

    `kept` are in order of time. All of them are as good as the fastest as far as was measured; errors fall from each to
    the next.
    """
    front = frontier(kept, error)
    return tuple(c for c in front if not separable(c.spread, front[0].spread))


def choose(kept: Iterable[Candidate], error: Callable[[Candidate], float]) -> Candidate | None:
    """Return the closest of the `rivals`: where times do not decide, errors do. None where nothing is kept."""
    found = rivals(kept, error)
    return found[-1] if found else None


@dataclass(frozen=True)
class Point:
    """One variant as the table and the plot of a trade-off show it.

    `name` is for the table, `label` for the plot; `series` has a colour, `mode` a marker. `time` is the median
    of the rounds. `cells` are the rest of the row.
    """

    name: str
    label: str
    series: str
    mode: str
    time: float
    spread: Spread
    error: float
    cells: tuple[str, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """Points, fastest first, and how to show them.

    `front`, `kept` and `picked` are places in `points`: the frontier, the fastest that keeps the `limit`, and the
    choice, the latter None where there is none. `headings` are those of the columns: name, time, spread, error, and the
    cells; `meanings` tells what is under a heading or behind a short name. `time` and `error` are what the axes show,
    with units, `series` and `mode` what colours and markers stand for.
    """

    title: str
    points: tuple[Point, ...]
    front: Sequence[int]
    kept: int | None
    picked: int | None
    limit: float
    budget: str
    headings: tuple[str, ...]
    meanings: Mapping[str, str]
    time: str
    error: str
    series: str
    mode: str
    skipped: tuple[tuple[str, str], ...] = field(default=())

    @property
    def like(self) -> frozenset[int]:
        """The points whose times are not separable from that of the fastest that keeps the limit, without itself."""
        if self.kept is None:
            return frozenset()
        spread = self.points[self.kept].spread
        return frozenset(n for n, p in enumerate(self.points) if n != self.kept and not separable(p.spread, spread))

    def table(self) -> str:
        """The points as text, what was not run, and a legend of the marks, columns and short names."""
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
        said = {}
        if self.picked is not None:
            said[PICK] = f"the pick: of the variants {self.budget} that are as fast as the fastest of them, the closest"
        said[FRONT] = "the frontier: no other variant is both faster and closer"
        if self.kept is not None and self.like:
            fastest = self.points[self.kept].name
            said[LIKE] = f"not separable in time from {fastest}, the fastest {self.budget}: their quartiles overlap"
        said |= self.meanings
        width = max(map(len, said))
        for name, meaning in said.items():
            yield from textwrap.wrap(
                meaning, _WIDTH, initial_indent=f"  {name:{width}}  ", subsequent_indent=" " * (width + 4)
            )


def _number(value: float) -> str:
    """Three digits, and no exponent for what a person reads as a time."""
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"
