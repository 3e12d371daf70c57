"""A benchmark: inputs, several versions of one computation, and the rule by which their answers agree.

    MANDELBROT = Work("mandelbrot", "Mandelbrot set …", inputs=points, size=1024, quick=64, within=0, share=0.01)

    @MANDELBROT.ours
    def ours(compiled, c):                  # once for each target; `compiled(program)` gives a kernel
        kernel = compiled(mandelbrot)
        return lambda: kernel(c)

    @MANDELBROT.version("numba")
    def numba(c): …                         # gives what is timed: a function without arguments that gives the answer

A version may do beforehand what is done once in a program's life: import, compile, build a table. What it is timed for
begins with arrays in host memory and ends with an array in host memory, unless its docstring says otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

import shpy as sh

Run = Callable[[], Any]
Version = Callable[..., Run]

TARGETS: dict[str, dict[str, Any]] = {
    "opencl": {"backend": "opencl"},
    "plain": {},
    "opencl-fused": {"backend": "opencl", "fuse": True},
    "opencl-relaxed": {"backend": "opencl", "math": "relaxed"},
    "opencl-1": {"backend": "opencl", "lanes": 1},
    "glsl": {"backend": "glsl"},
    "numpy": {"backend": "numpy"},
}
"""The options with which our programs are compiled, by the name of the contender; "plain" does not compile them."""
OURS = (*TARGETS, "masks")
"""Contenders whose threads slow down no others: they share a process."""


def plain(program: sh.Program, **_: Any) -> sh.Program:
    """Return the program, whose call takes the default backend."""
    return program


@dataclass
class Work:
    """One computation in several versions.

    `size` and `quick` are what `inputs` is called with. Answers agree if all but the `share` of their elements differ
    from the reference by at most `within`, times the larger of 1 and the reference's magnitude. The reference is what
    the version `masks` gives, or else the first that ran.
    `seen`: what of an answer is compared, which is not timed. `exact`: for sums, whose order is left to each version,
    what they round, in binary64: an answer that differs from the reference agrees too if it is as near to this.
    """

    name: str
    title: str
    inputs: Callable[[int], tuple[Any, ...]]
    size: int
    quick: int
    within: float
    share: float = 0.0
    note: str = ""
    seen: Callable[[Any], Any] = np.asarray
    exact: Callable[..., Any] | None = None
    versions: dict[str, Version] = field(default_factory=dict)

    def version(self, name: str) -> Callable[[Version], Version]:
        """Decorate a peer's version."""

        def keep(function: Version) -> Version:
            self.versions[name] = function
            return function

        return keep

    def ours(self, function: Version) -> Version:
        """Decorate our version, which serves all targets: its first argument compiles a program."""
        return self.ours_on(*TARGETS)(function)

    def ours_on(self, *targets: str) -> Callable[[Version], Version]:
        """Decorate our version for some targets."""

        def keep(function: Version) -> Version:
            for name in targets:
                compiled = partial(sh.Program.compile, **TARGETS[name]) if TARGETS[name] else partial(plain)
                self.versions[name] = partial(function, compiled)
            return function

        return keep


@dataclass(frozen=True)
class Agreement:
    """The comparison of an answer with the reference: the largest difference, and the share beyond the tolerance.

    `other_order`: it agrees with what both round, so that the difference comes of the order of sums.
    """

    largest: float
    share: float
    same: bool
    other_order: bool = False

    @property
    def text(self) -> str:
        """For a table."""
        beyond = f", {self.share:.2%} beyond" if self.share else ""
        remark = ", other order" if self.other_order else "" if self.same else " WRONG"
        return f"{self.largest:.1e}{beyond}{remark}"


def compare(work: Work, answer: Any, reference: Any) -> Agreement:
    """Judge an answer by the reference alone."""
    values, expected = (np.atleast_1d(np.asarray(work.seen(a), dtype=np.float64)) for a in (answer, reference))
    if values.shape != expected.shape:
        return Agreement(np.inf, 1.0, False)
    with np.errstate(invalid="ignore"):
        off = np.abs(values - expected) / np.maximum(1.0, np.abs(expected))
    off[(values == expected) | (np.isnan(values) & np.isnan(expected))] = 0.0
    off[np.isnan(off)] = np.inf
    share = float(np.mean(off > work.within)) if off.size else 0.0
    return Agreement(float(off.max(initial=0.0)), share, share <= work.share)


def judge(work: Work, answer: Any, reference: Any, inputs: tuple[Any, ...]) -> Agreement:
    """Judge an answer by the reference, and by what is exact if they part."""
    agreement = compare(work, answer, reference)
    if agreement.same or work.exact is None or not compare(work, answer, work.exact(*inputs)).same:
        return agreement
    return replace(agreement, same=True, other_order=True)
