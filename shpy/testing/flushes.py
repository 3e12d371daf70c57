"""The effect of flushed denormals on elements: the results that become other numbers, and the denormal that did it.

Stage: test. Takes two runs of a program and the elements in which flushed denormals alone make them differ; gives a
`Flush`.

    glsl: 1 of these 3 change by more than a denormal that becomes zero; output 0 of element 4:
    1.2e+32 on numpy, inf on glsl
      the first denormal on its way: d = 2e-39 at shading.py:7: d = p * q
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from shpy.testing.arrays import Array
from shpy.testing.denormals import Denormal, find_denormals
from shpy.testing.observers import Setting
from shpy.testing.runs import Run


@dataclass(frozen=True)
class Flush:
    """The effect of flushing on a run: `count` elements differ from `reference`, `altered` of them beyond the denormal.

    An altered result is no denormal that became zero but another number, as a quotient is whose divisor was flushed.
    `element` is the index of the one that is altered most, or of the first one that differs; `first` and `second` are
    the values of its `output` on `reference` and on `target`. `denormal` is the first denormal on its way.
    """

    target: str
    reference: str
    count: int
    altered: int
    element: tuple[int, ...]
    output: str
    first: Any
    second: Any
    denormal: Denormal | None

    def __str__(self) -> str:
        place = ", ".join(map(str, self.element)) or "the only one"
        values = f"{_spoken(self.first)} on {self.reference}, {_spoken(self.second)} on {self.target}"
        text = f"{self.target}: {self.altered} of these {self.count} change by more than a denormal that becomes zero"
        text += f"; output {self.output} of element {place}: {values}"
        return f"{text}\n  the first denormal on its way: {self.denormal}" if self.denormal else text


@dataclass(frozen=True)
class Excuse:
    """The elements `(n,)` bool of a run that differ from the reference by flushed denormals alone."""

    setting: Setting
    reference: Run
    run: Run
    elements: Array

    def explain(self) -> Flush:
        """Find the element that is altered most, and its first denormal, by one more run on numpy."""
        distances = [_distance(*pair) for pair in zip(self.reference.outputs, self.run.outputs, strict=True)]
        furthest = np.max(distances, axis=0)
        furthest[self.reference.written != self.run.written] = np.inf
        furthest[~self.elements] = -1
        element = int(np.argmax(furthest))
        leaf = int(np.argmax([d[element] for d in distances]))
        return Flush(
            target=self.run.target,
            reference=self.reference.target,
            count=int(np.count_nonzero(self.elements)),
            altered=int(np.count_nonzero(furthest > 0)),
            element=self.setting.index(element),
            output=list(self.setting.program.outputs)[leaf],
            first=_value(self.reference, leaf, element),
            second=_value(self.run, leaf, element),
            denormal=find_denormals(self.setting).first(element),
        )


def _distance(a: Array, b: Array) -> Array:
    """Return the distance of two arrays' rows, (n,): 0 to 2 relative to the larger, inf beside NaN and infinities.

    Denormals and the least normal number count as zero.
    """
    if a.dtype.kind != "f":
        return np.asarray(np.where((a != b).any(axis=1), np.inf, 0.0))
    least = np.finfo(a.dtype).tiny
    one, two = (np.where(np.abs(x) <= least, 0, x).astype(np.float64) for x in (a, b))
    same = (one == two) | (np.isnan(one) & np.isnan(two))
    with np.errstate(all="ignore"):
        apart = np.abs(one - two) / np.maximum(np.abs(one), np.abs(two))
    apart[~np.isfinite(apart)] = np.inf
    return np.asarray(np.where(same, 0.0, apart).max(axis=1))


def _value(run: Run, leaf: int, element: int) -> Any:
    """Return the output of an element: a number, or a list for a vector; None where nothing was written."""
    value = run.outputs[leaf][element].tolist()
    return None if not run.written[element] else value[0] if len(value) == 1 else value


def _spoken(value: Any) -> str:
    if value is None:
        return "not written"
    if isinstance(value, list):
        return f"({', '.join(map(_spoken, value))})"
    return f"{value:.8g}" if isinstance(value, float) else str(value)
