"""Choices of one of n with given probabilities in two look-ups: the alias method (Walker 1977, Vose 1991).

Stage: kernel. The table rounds the requested probabilities, and `probabilities` are exactly those with which 32 hashed
bits choose. So an estimate that is divided by them has only the error of sampling.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import shpy as sh

Floats = NDArray[np.float64]
ONE = 1 << 24
"""A threshold that every number is below."""


class Chances:
    """A table of n choices with these weights, which are not negative and not all 0.

    `probabilities` (n,) are those of the choices. Each has a number and a density of its own, which `choose` gives;
    without `numbers` its place is its number.
    """

    def __init__(self, weights: Floats, numbers: Any = None, per: Any = 1.0, name: str = "chances") -> None:
        self.count = len(weights)
        self.table = sh.Table(self._rows(weights, numbers, per), sh.Attrib4u, name)
        self.number = sh.Param(sh.Attrib1u, self.count, name=f"{name}_count")

    def renew(self, weights: Floats, numbers: Any = None, per: Any = 1.0) -> None:
        """Take other weights, of as many choices."""
        self.table.update(self._rows(weights, numbers, per))

    def _rows(self, weights: Floats, numbers: Any, per: Any) -> NDArray[np.uint32]:
        thresholds, aliases = alias_table(weights)
        self.probabilities = probabilities_of(thresholds, aliases)
        self.densities = (self.probabilities / per).astype(np.float32)
        self.numbers = np.arange(self.count) if numbers is None else np.asarray(numbers)
        rows = np.stack([thresholds, aliases, self.densities.view(np.uint32), self.numbers.astype(np.uint32)], axis=1)
        return rows.astype(np.uint32)

    def choose(self, which: Any, instead: Any) -> tuple[Any, Any, Any]:
        """Return the place, number and density of the choice that two hashed words make."""
        if self.count == 1:
            only = self.table[0]
            return sh.Attrib1i(0), sh.Attrib1i(only.w), sh.float_from_bits(only.z)
        first = which % self.number
        row = self.table[sh.Attrib1i(first)]
        place = sh.Attrib1i(sh.min(sh.cond((instead >> 8) < row.x, first, row.y), self.number - 1))
        chosen = self.table[place]
        return place, sh.Attrib1i(chosen.w), sh.float_from_bits(chosen.z)

    def density_at(self, place: Any) -> Any:
        """Return the density of the choice at a place."""
        return sh.float_from_bits(self.table[place if self.count > 1 else 0].z)


def alias_table(weights: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the thresholds, in parts of `ONE`, below which a choice stands, and the choice that replaces it."""
    count = len(weights)
    shares = weights * (count / weights.sum())
    aliases = np.arange(count)
    rest = shares.tolist()
    small = [k for k, share in enumerate(rest) if share < 1]
    large = [k for k, share in enumerate(rest) if share >= 1]
    kept = [1.0] * count
    while small and large:
        low, high = small.pop(), large[-1]
        kept[low] = rest[low]
        aliases[low] = high
        rest[high] -= 1 - rest[low]
        if rest[high] < 1:
            small.append(large.pop())
    thresholds = np.rint(np.array(kept) * ONE).astype(np.int64)
    return np.maximum(thresholds, weights > 0), aliases


def probabilities_of(thresholds: NDArray[np.int64], aliases: NDArray[np.int64]) -> Floats:
    """Return the probability of each choice, (n,)."""
    count = len(thresholds)
    words = 2**32 // count + (np.arange(count) < 2**32 % count)
    kept = words * (thresholds / ONE)
    return (kept + np.bincount(aliases, words - kept, count)) / 2.0**32
