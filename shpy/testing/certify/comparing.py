"""Compare a run with its golden hash; find inputs whose results differ, with numpy on this machine.

Stage: test. Takes a program and its arrays, returns a `Finding`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from shpy.passes.modes import Math
from shpy.programs import Program
from shpy.testing.arrays import Array, differing, flat_leaves
from shpy.testing.certify.findings import SHOWN, DeviceChoice, Finding
from shpy.testing.certify.golden import digest
from shpy.testing.denormals import meets_denormals
from shpy.testing.observers import Setting


@dataclass(frozen=True)
class Work:
    """A program, what it runs on, and in which mode."""

    program: Program
    arrays: tuple[Array, ...] = ()
    named: Mapping[str, Any] = field(default_factory=dict)
    shape: tuple[int, ...] | None = None
    math: Math = "strict"

    def run(self, target: DeviceChoice) -> list[Array]:
        """Run the program on a target; return the leaves of its outputs."""
        return flat_leaves(target.compile(self.program, math=self.math)(*self.arrays, **self.named, shape=self.shape))

    def denormal(self) -> Array:
        """Return, as bools (n,), the elements whose evaluation meets a denormal."""
        return meets_denormals(Setting(self.program, self.arrays, self.named, self.shape, {}))

    def inputs_of(self, element: int) -> str:
        """Return the inputs of an element, in words."""
        if not self.arrays:
            return f"element {element}"
        return ", ".join(repr(a[element].tolist()) for a in self.arrays)

    @property
    def count(self) -> int:
        """The number of elements: `arrays` are (n, ...) where there is no shape."""
        return int(np.prod(self.shape)) if self.shape else len(self.arrays[0])


def compare(work: Work, target: DeviceChoice, expected: str | None) -> tuple[Finding, list[Array]]:
    """Run the work on a target and compare its bits with the golden hash `expected`.

    If the hashes differ, the finding names inputs whose results differ from numpy's on this machine.
    """
    outputs = work.run(target)
    checksum = digest(outputs)
    if checksum == expected:
        return Finding("same", hash=checksum), outputs
    if target.backend == "numpy":
        return Finding("differs", _strange(checksum, expected), checksum), outputs
    here = work.run(DeviceChoice("numpy"))
    if digest(here) != expected:
        return Finding(
            "differs", f"numpy on this machine differs too: {_strange(digest(here), expected)}", checksum
        ), outputs
    return compare_arrays(work, target, outputs, here), outputs


def _strange(checksum: str, expected: str | None) -> str:
    return f"the hash is {checksum}, and the package ships {expected or 'none'}"


def compare_arrays(work: Work, target: DeviceChoice, outputs: list[Array], expected: list[Array]) -> Finding:
    """Compare results with numpy's: the same bits, the same except for denormals, or the first inputs that differ."""
    rows = [[leaf.reshape(work.count, -1) for leaf in leaves] for leaves in (outputs, expected)]
    wrong = np.zeros(work.count, np.bool_)
    for a, b in zip(*rows, strict=True):
        wrong |= differing(a, b).any(axis=1)
    if wrong.any() and target.flushes:
        wrong &= ~work.denormal()
        if not wrong.any():
            return Finding("denormals", hash=digest(outputs))
    elements = np.flatnonzero(wrong)
    if not len(elements):
        return Finding("same", hash=digest(outputs))
    shown = [f"{len(elements):,} of {work.count:,} elements differ"]
    for k in map(int, elements[:SHOWN]):
        a, b = ([leaf[k].tolist() for leaf in leaves] for leaves in rows)
        shown.append(f"for {work.inputs_of(k)}: {_plain(a)}, not {_plain(b)}")
    return Finding("differs", "\n".join(shown), digest(outputs))


def _plain(leaves: list[Any]) -> str:
    flat = [number for leaf in leaves for number in leaf]
    return repr(flat[0]) if len(flat) == 1 else repr(flat)
