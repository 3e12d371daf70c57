"""Compare a program on every backend; where two differ, say where and why.

Stage: test. Takes a program and its inputs, runs it on every backend and lane width, gives an `Agreement` or raises
AssertionError with the element, its inputs, the results of each backend, and the first statement at which they diverge.

    assert_equivalent(program, x)                          # every bit, but for NaNs
    assert_equivalent(program, x, ulp=4, math="relaxed")
    assert_equivalent(program, x, reference=np.sin, ulp=1)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here
from shpy.programs import Program
from shpy.testing import defaults
from shpy.testing.arrays import EXACT, Array, Bound
from shpy.testing.denormals import meets_denormals
from shpy.testing.divergence import search
from shpy.testing.expectation import reference_run
from shpy.testing.flushes import Excuse, Flush
from shpy.testing.observers import Setting
from shpy.testing.reference import INTERPRETER, split_options, targets
from shpy.testing.runs import Run, parted, run
from shpy.units import steps


@dataclass(frozen=True)
class Agreement:
    """The agreement: the `backends`, the number of `elements`, and how many differ by flushed denormals alone."""

    backends: tuple[str, ...]
    elements: int
    flushed: dict[str, int]
    _excused: tuple[Excuse, ...] = field(default=(), repr=False, compare=False)

    @cached_property
    def flushes(self) -> tuple[Flush, ...]:
        """Return, for each backend whose elements differ by flushed denormals, the distance and the denormal.

        Computed on first use, by one more run of the program on numpy for each such backend.
        """
        return tuple(excused.explain() for excused in self._excused)

    def __str__(self) -> str:
        noted = [f"; {n} on {name} by flushed denormals alone" for name, n in self.flushed.items() if n]
        told = "".join(f"\n{flush}" for flush in self.flushes)
        return f"{', '.join(self.backends)} agree on {self.elements} elements{''.join(noted)}{told}"


def assert_equivalent(
    program: Program,
    *inputs: Any,
    backends: Iterable[str] | None = None,
    reference: Any = None,
    ulp: float = 0,
    atol: float = 0,
    rtol: float = 0,
    shape: Any = None,
    **named: Any,
) -> Agreement:
    """Run on every available backend and lane width, and compare each with the first, element by element.

    With a `reference`, each is compared with that: an array (with a part for each output where there are several), or
    a function of the arrays of inputs that returns one, in numpy's binary64 or in numbers of mpmath. It is rounded to
    the type of the output. Elements that the program discards are masked in it (`numpy.ma`).

    `backends` are names as in `testing.targets`: "numpy", "opencl" (each width), "opencl-4", "glsl", "interpreter".
    Results may differ by `ulp` ULP, or by atol + rtol * |first result|; with all 0 they must have the same bits, except
    that every NaN equals every other one. Elements must end alike: written, discarded, or stopped by a loop's limit.

    A device may report that it flushes denormals. Elements that meet a denormal there are counted, not compared: the
    result's `flushes` names the first denormal of one of them, and its text says whether a result changed.

    `inputs` come by position or by name; other names (`precision`, `loop_limit`, …) are options of `Program.compile`.
    Raises AssertionError, which names the element, its inputs, each backend's value and distance, and the first
    statement at which the two diverge.
    """
    inputs_by_name, options = split_options(named, program)
    names = targets(backends if backends is not None else defaults.backends)
    if len(names) < 2 and reference is None:
        raise ShpyTypeError("two backends at least are compared", loc=here(), cure='backends=["numpy", "interpreter"]')
    bound = Bound(ulp, atol, rtol)
    bound = replace(bound, ulp=max(bound.ulp, defaults.ulp))
    setting = Setting(program, inputs, inputs_by_name, shape, options)
    if reference is None:
        return Comparison(setting, [run(setting, name) for name in names], bound).check()
    runs = [run(setting, name) for name in names]
    first = reference_run(setting, reference, runs[0])
    return Comparison(setting, [first, *runs], bound, lambda other, element: ()).check()


Explanation = Callable[[Run, int], Iterable[str]]
"""The last lines of a failure, for the run and the element that differ."""


class Comparison:
    """The runs of one program on all targets, of which the first, or an expectation in its place, is right.

    `explain` gives the last lines of a failure; by default, the first statement at which the two runs diverge.
    """

    def __init__(
        self, setting: Setting, runs: list[Run], bound: Bound = EXACT, explain: Explanation | None = None
    ) -> None:
        self.setting = setting
        self.names = [one.target for one in runs]
        self.bound = bound
        self.runs = runs
        self.explain = explain or self.divergence

    def check(self) -> Agreement:
        """Raise AssertionError at the first run that differs from the first one."""
        flushed: dict[str, int] = {}
        excused = []
        for other in self.runs[1:]:
            wrong = parted(self.runs[0], other, self.bound)
            if wrong.any() and (other.flushes or self.runs[0].flushes):
                flushed[other.target] = int(np.count_nonzero(wrong & self.denormal))
                if flushed[other.target]:
                    excused.append(Excuse(self.setting, self.runs[0], other, wrong & self.denormal))
                wrong &= ~self.denormal
            if wrong.any():
                raise AssertionError("\n".join(self.told(other, wrong)))
            if other.stopped != self.runs[0].stopped and not flushed.get(other.target):
                raise AssertionError(
                    f"{self.setting.program.name}: a loop's limit stopped {self.runs[0].stopped} elements on "
                    f"{self.names[0]}, {other.stopped} on {other.target}"
                )
        return Agreement(tuple(self.names), self.runs[0].written.size, flushed, tuple(excused))

    @cached_property
    def denormal(self) -> Array:
        """The elements, (n,), that meet a denormal on their way."""
        return meets_denormals(self.setting)

    def told(self, other: Run, wrong: Array) -> Iterator[str]:
        """Yield the lines of the message for elements that differ, with the first statement at which they do."""
        element, s = int(np.flatnonzero(wrong)[0]), self.setting
        place = ", ".join(map(str, s.index(element))) or "the only one"
        yield (
            f"{s.program.name}: {self.names[0]} and {other.target} differ in {np.count_nonzero(wrong)} of {wrong.size} "
            f"elements, first in element {place}"
        )
        for name, value in s.element(element).items():
            yield f"  {name} = {_exact(value)}"
        yield from self.values(element)
        yield from self.explain(other, element)

    def divergence(self, other: Run, element: int) -> Iterator[str]:
        """Yield the first statement at which a run and the first one diverge."""
        names = (self.names[0], other.target)
        divergence = search(self.setting, names, element, (self.runs[0], other), self.bound)
        if divergence is None:
            yield "  watched statement by statement they agree: what parts them is how the text as a whole is compiled"
        else:
            yield f"the first statement at which they part:\n{divergence}"

    def values(self, element: int) -> Iterator[str]:
        """Yield each target's values of the outputs that differ, and how far they are from the first's."""
        truth = run(self.setting, INTERPRETER, only={element}) if INTERPRETER not in self.names else None
        for leaf, name in enumerate(self.setting.program.outputs):
            if not any(self.differs(one, leaf, element) for one in self.runs):
                continue
            yield f"  output {name}:"
            for one in [*self.runs, *([truth] if truth else [])]:
                value = one.outputs[leaf][element]
                text = _exact(value) if one.written[element] else "not written"
                yield f"    {one.target:<12} {text}{self.distance(one, leaf, element)}"

    def differs(self, one: Run, leaf: int, element: int) -> bool:
        """Return whether a run's output differs from the first run's in an element, or one of both did not write it."""
        first = self.runs[0]
        ends_alike = one.written[element] == first.written[element]
        return not ends_alike or self.bound.parts(first.outputs[leaf][element], one.outputs[leaf][element])

    def distance(self, one: Run, leaf: int, element: int) -> str:
        """Return how far a float is from the first run's, as the end of a line."""
        first = self.runs[0]
        a, b = first.outputs[leaf][element], one.outputs[leaf][element]
        if one is first or a.dtype.kind != "f" or not (first.written[element] and one.written[element]):
            return ""
        return f"   {np.max(steps(a, b)):.0f} ULP from {first.target}"


def _exact(value: Any) -> str:
    array = np.asarray(value).ravel()
    decimal = ", ".join(map(str, array.tolist()))
    exact = f"  ({', '.join(float(v).hex() for v in array)})" if array.dtype.kind == "f" else ""
    return f"{decimal}{exact}"
