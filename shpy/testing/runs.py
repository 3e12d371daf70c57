"""One run of a program on one target, kept as flat arrays, so that runs can be compared element by element.

Stage: test. Takes a `Setting` and a target's name; gives the outputs leaf by leaf and how each element ended.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from shpy.errors import LoopLimitExceeded
from shpy.lang.values.structure import flatten
from shpy.testing.arrays import EXACT, Array, Bound
from shpy.testing.observers import Setting
from shpy.testing.reference import flushes_denormals, kernel


@dataclass(frozen=True)
class Run:
    """`outputs` are (n, size) arrays; `written` (n,) tells the elements that wrote them, `notes` are the kernel's."""

    target: str
    outputs: tuple[Array, ...]
    written: Array
    stopped: int
    notes: tuple[str, ...]

    @property
    def flushes(self) -> bool:
        """Return whether the device says that it turns denormals into zeros."""
        return flushes_denormals(self.notes)


def run(setting: Setting, target: str, only: Collection[int] | None = None) -> Run:
    """Run it; loops beyond their limit end their elements unwritten, and are counted."""
    compiled = kernel(setting.program, target, only, **setting.options)
    stopped = 0
    try:
        result = compiled.run(*setting.inputs, shape=setting.shape, **setting.named)
    except LoopLimitExceeded as error:
        result, stopped = error.result, error.count
    written = np.asarray(result.written).reshape(-1)
    flat = flatten(setting.program.recorded.output, result.outputs, "the output")  # a matrix has a leaf for each row
    parts = tuple(np.asarray(leaf).reshape(written.size, -1 if written.size else 1) for leaf in flat)
    return Run(target, parts, written, stopped, tuple(compiled.notes))


def parted(a: Run, b: Run, bound: Bound = EXACT) -> Array:
    """Return the elements, (n,), whose outputs are further apart, or that one of the two did not write."""
    wrong = np.asarray(a.written != b.written)
    for one, two in zip(a.outputs, b.outputs, strict=True):
        wrong |= bound.exceeded(one, two).any(axis=1)
    return wrong
