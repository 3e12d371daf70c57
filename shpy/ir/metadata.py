"""Metadata of params for pages and viewers: range, step, title and description.

Stage: represent. `range` also bounds the value. None of it changes what a program computes, so it does not count when
modules are compared.

>>> About(range=(0, 4)).outside((1.0, 5.0))
5.0
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from shpy.ir.types import Type


@dataclass(frozen=True, slots=True)
class About:
    """Metadata of a param. Numbers are ints or floats of Python; None stands for metadata that the param lacks."""

    range: tuple[float, float] | None = None
    step: float | None = None
    title: str | None = None
    description: str | None = None

    def fault(self, type: Type | None) -> str | None:
        """Return the mistake in a range or step for params of `type` (None: no single number or vector), or None."""
        if self.range is None and self.step is None:
            return None
        if type is None or type.is_bool:
            return "a range or step is for numbers and vectors of numbers"
        if self.range is not None and not self.range[0] <= self.range[1]:
            return f"range={self.range!r} is no pair of numbers, the lower first"
        if self.step is not None and not 0 < self.step < math.inf:
            return f"step={self.step!r} is no positive number"
        return None

    def outside(self, components: Iterable[float]) -> float | None:
        """Return the first component of a value that is not in range, or None."""
        if self.range is None:
            return None
        low, high = self.range
        return next((c for c in components if not low <= c <= high), None)


NOTHING = About()
