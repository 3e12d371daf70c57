"""Records of rays that travel between the parts of a scene, and the choice of the part that a ray enters next.

Stage: cluster. A record holds all that its pixel needs: the ray, its nearest hit so far, the light and the layers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytracer.kernels.triangle import REACH

SLACK = 2 * REACH
"""The part of a distance by which a part's box is taken to begin earlier and to end later."""
AT_ONCE = 1 << 20
"""Pairs of a ray and a box that are computed at once."""
GROWTH = 2.0**-16
"""The part of the largest coordinate by which boxes are grown, which is many roundings of f32, but of f16 one."""


class Records:
    """Arrays of the same length by name; those of a struct are named `struct.field`."""

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        self.columns = dict(columns)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def __getitem__(self, which: Any) -> Records:
        """Return the records of a mask or of indices."""
        return Records({name: column[which] for name, column in self.columns.items()})

    @property
    def nbytes(self) -> int:
        """The bytes of all arrays."""
        return sum(column.nbytes for column in self.columns.values())

    def argument(self, name: str) -> Any:
        """Return an array, or the arrays of a struct by field, as kernels take them."""
        if name in self.columns:
            return self.columns[name]
        return {key.partition(".")[2]: c for key, c in self.columns.items() if key.startswith(f"{name}.")}

    def take(self, name: str, value: Any) -> None:
        """Replace an array, or those of a struct, by the result of a kernel."""
        if hasattr(value, "_fields"):
            for field in value._fields:
                self.columns[f"{name}.{field}"] = np.asarray(getattr(value, field))
        else:
            self.columns[name] = np.asarray(value)


def joined(parts: Iterable[Records]) -> Records:
    """Return the records of several batches, in their order."""
    batches = [part for part in parts if len(part)]
    if len(batches) <= 1:
        return batches[0] if batches else Records({})
    return Records({name: np.concatenate([part.columns[name] for part in batches]) for name in batches[0].columns})


def next_part(records: Records, low: NDArray[Any], high: NDArray[Any]) -> NDArray[np.int64]:
    """Return for each ray the part, of boxes from `low` to `high` (k, 3), that it enters next; -1 for none.

    A ray visits parts in the order of the distances at which it enters them, and at equal distances in that of their
    numbers. So those after its `last` one in this order are left, and `last` = -1 is before all. Parts that begin
    behind the nearest hit are left out. Boxes are met with a margin, so that no triangle is missed that its part would
    find; a visit too many finds nothing.
    """
    rays = max(1, AT_ONCE // len(low))
    blocks = [records[slice(first, first + rays)] for first in range(0, len(records), rays)]
    return np.concatenate([np.empty(0, np.int64), *(_next_part(block, low, high) for block in blocks)])


def _next_part(records: Records, low: NDArray[Any], high: NDArray[Any]) -> NDArray[np.int64]:
    eye, ray = (records.columns[name].astype(np.float64)[:, None] for name in ("ray.eye", "ray.direction"))
    reach = records.columns["nearest.l"].astype(np.float64)[:, None]
    grown = GROWTH * np.maximum(np.abs(low).max(initial=0), np.abs(high).max(initial=0))
    grown = grown + GROWTH * np.abs(eye).max(axis=2, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        first, last = (low - grown - eye) / ray, (high + grown - eye) / ray
        inside = (low - grown <= eye) & (eye <= high + grown)
    still = ray == 0  # along such an axis a ray stays where it is
    enter = np.where(still, np.where(inside, -np.inf, np.inf), np.minimum(first, last)).max(axis=2)
    leave = np.where(still, np.where(inside, np.inf, -np.inf), np.maximum(first, last)).min(axis=2)
    enter = np.maximum(enter, 0)
    met = (enter * (1 - SLACK) <= leave * (1 + SLACK)) & (enter * (1 - SLACK) <= reach)
    last, numbers = records.columns["last"][:, None], np.arange(len(low))
    before = np.take_along_axis(enter, last, axis=1)
    met &= (last < 0) | (enter > before) | ((enter == before) & (numbers > last))
    enter = np.where(met, enter, np.inf)
    return np.where(met.any(axis=1), enter.argmin(axis=1), -1)
