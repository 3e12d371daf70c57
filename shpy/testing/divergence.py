"""The first statement at which two backends part.

Stage: test. Takes a program, its inputs and backends; runs the program that watches itself (`watch.py`) on two of them
and searches by halves for the first event of which they hold different views. Gives a `Divergence`, or None. Where a
distance is allowed, it goes on from there event by event to the first one that is beyond it.

    found = first_divergence(program, x, backends=("numpy", "opencl-16"))
    print(found)          # line, variable, both values, the iterations of the loops, the statements before it

Times: about log2(events) + 12 runs of the program on each of the two backends, and two for each event gone on by.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from shpy.errors import ShpyIndexError, ShpyTypeError
from shpy.ir.constants import is_int
from shpy.ir.nodes import Loc
from shpy.lang.recording.location import here
from shpy.lang.recording.text import written
from shpy.programs import Program
from shpy.testing.arrays import EXACT, Bound, is_denormal
from shpy.testing.denormals import Denormal, find_denormals
from shpy.testing.observers import Observation, Observer, Setting, observer, sites_of
from shpy.testing.reference import INTERPRETER, split_options, targets
from shpy.testing.runs import Run, parted, run
from shpy.units import steps

Sides = tuple[Observer, Observer]

_BEFORE, _AFTER = 6, 2
"""Events that are shown before and after the one at which the two part."""

_AHEAD = 16
"""Events whose sites are looked at together, at first: each time a program is compiled, and the number doubles."""


@dataclass(frozen=True)
class Row:
    """One event in both traces, with the value that each computed; None where one was elsewhere, or had ended."""

    loc: Loc | None
    name: str | None
    text: str
    turns: tuple[int, ...]
    first: Any
    second: Any
    same: bool

    def __str__(self) -> str:
        iteration = f" [iteration {', '.join(map(str, reversed(self.turns)))}]" if self.turns else ""
        what = f"{self.name} = {self.text}" if self.name and not self.text.startswith("store ") else self.text
        values = (_spoken(self.first), _spoken(self.second))
        return f"{_place(self.loc)}{iteration}  {what:<34}  {values[0]:<24} {values[1]}"


@dataclass(frozen=True)
class Divergence:
    """The first divergence of two backends: `loc`, the variable's `name`, the statement as `text`, and `turns`.

    `turns` are the numbers of the iterations, counted from 1, the innermost loop first. `first` and `second` are the
    values that the backends named in `backends` computed there; where the backends are at different statements, `rows`
    shows the statement of each, and `path` is true.
    `operands` are the first backend's, by name, which agree on both. `denormal`: one of these numbers is a denormal
    and the two differ by flushing it to zero, or there is one `within` the statement: a step of an operation such as
    `reflect` that one of the devices flushes. `rows` are both traces side by side around the place.
    """

    program: str
    backends: tuple[str, str]
    element: tuple[int, ...]
    inputs: dict[str, Any]
    loc: Loc | None
    name: str | None
    text: str
    turns: tuple[int, ...]
    first: Any
    second: Any
    ulp: float | None
    path: bool
    denormal: bool
    operands: dict[str, Any]
    rows: tuple[Row, ...]
    loops: tuple[Loc | None, ...] = ()
    within: Denormal | None = None

    @property
    def source(self) -> str:
        """The user's line, as it was recorded; empty where its text is not known."""
        return written(self.loc)

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        one, two = self.backends
        yield f"{self.program}: {one} and {two} part at {_place(self.loc)}, element {_index(self.element)}"
        if self.source:
            yield f"    {self.source}"
        for iteration, loop in zip(self.turns, self.loops, strict=False):
            yield f"  in iteration {iteration} of the loop at {_place(loop)}"
        if self.path:
            yield f"  {one} goes on with {self.text}, {two} elsewhere: a condition before it, or an exit, differs"
        else:
            yield f"  {f'{self.name} = ' if self.name else ''}{self.text}"
            yield f"    {one:<12} {_exactly(self.first)}"
            yield f"    {two:<12} {_exactly(self.second)}{_apart(self.ulp)}"
        for name, value in self.operands.items():
            yield f"    with {name} = {_exactly(value)}"
        if self.within:
            step = f"{self.within.name} = {self.within.value:g}"
            yield f"  on the way to it {step}, a denormal: one of the two flushes it to zero"
        elif self.denormal:
            yield "  a denormal: one of the two flushes it to zero, as its device does"
        yield f"  inputs: {', '.join(f'{n} = {_spoken(v)}' for n, v in self.inputs.items()) or 'none'}"
        yield f"  the two traces ({one}, {two}):"
        for row in self.rows:
            yield f"   {'  ' if row.same else '→ '}{row}"


def _place(loc: Loc | None) -> str:
    return "an unknown line" if loc is None else str(loc)


def _index(element: tuple[int, ...]) -> str:
    return ", ".join(map(str, element)) or "the only one"


def _spoken(value: Any) -> str:
    return "·" if value is None else str(value.tolist() if isinstance(value, np.ndarray | np.generic) else value)


def _exactly(value: Any) -> str:
    """Return the number, and for floats its exact form."""
    array = np.asarray(value)
    if array.dtype.kind != "f":
        return _spoken(value)
    return f"{_spoken(value)}  ({', '.join(float(v).hex() for v in array.ravel())})"


def _apart(ulp: float | None) -> str:
    return "" if ulp is None else f"   {ulp:.0f} ULP apart" if np.isfinite(ulp) else "   one of them no number"


def first_divergence(
    program: Program,
    *inputs: Any,
    backends: Iterable[str] | None = None,
    ulp: float = 0,
    atol: float = 0,
    rtol: float = 0,
    element: int | None = None,
    shape: Any = None,
    **named: Any,
) -> Divergence | None:
    """Return the first event at which two backends differ in a bit; None where their outputs are equal.

    With a tolerance, `ulp` or atol + rtol * |value on the first backend| as in `assert_equivalent`, outputs and values
    of events within it are equal. Up to the event found, both backends take the same branches.

    `backends` are names as in `testing.targets` ("numpy", "opencl-4", "interpreter"), by default all that are
    available, with all lane widths. Each is compared with the first, until one differs. `element` is the index in C
    order of the element to follow, by default the first that differs. `inputs` come by position or by name; other names
    are options of `Program.compile`. All NaNs are equal.

    A backend whose results are those of the reference interpreter is represented by the interpreter. Watching a
    statement may change its result (without a contraction, or at another lane width): then the difference cannot be
    found, and None is returned although the outputs differ.

    `math` may be a pair, the mode of the first backend and that of the others: `math=("strict", "fast")`.
    """
    inputs_by_name, options = split_options(named, program)
    modes = _pair_of_modes(options)
    names = targets(backends)
    if modes and len(names) == 1:
        names *= 2  # one backend in two modes
    if len(names) < 2:
        raise ShpyTypeError("two backends at least are compared", loc=here(), cure='backends=("numpy", "glsl")')
    settings = [Setting(program, inputs, inputs_by_name, shape, {**options, "math": m}) for m in modes or ()]
    setting, other = settings or [Setting(program, inputs, inputs_by_name, shape, options)] * 2
    bound = Bound(ulp, atol, rtol)
    first = run(setting, names[0])
    check_element(element, math.prod(setting.element_shape))
    for name in names[1:]:
        second = run(other, name)
        places = np.flatnonzero(parted(first, second, bound))
        if element is not None:
            places = places[places == element]
        if places.size:
            runs = None if modes else (first, second)  # the interpreter has one mode, and judges no other
            divergence = search(setting, (names[0], name), int(places[0]), runs, bound, other)
            if divergence is not None:
                return divergence
    return None


def check_element(element: Any, count: int) -> None:
    """Raise ShpyIndexError for anything but None or the number of an element, in C order, of a run over `count`."""
    if element is not None and not (is_int(element) and 0 <= element < count):
        raise ShpyIndexError(
            f"element {element!r} of a run over {count}", loc=here(), cure=f"0 to {count - 1}, or None"
        )


def _pair_of_modes(named: dict[str, Any]) -> tuple[Any, Any] | None:
    """Take `math` from the options if it is a pair; raise ShpyTypeError for a longer or shorter tuple."""
    if not isinstance(named.get("math"), tuple):
        return None
    modes: tuple[Any, ...] = named.pop("math")
    if len(modes) != 2:
        raise ShpyTypeError(f"math={modes!r} is no pair of modes", loc=here(), cure='math=("strict", "fast")')
    return modes


def search(
    setting: Setting,
    names: tuple[str, str],
    element: int,
    runs: tuple[Run, Run] | None = None,
    bound: Bound = EXACT,
    other: Setting | None = None,
) -> Divergence | None:
    """Return the first event of an element at which two backends diverge, by bisection; None if they agree.

    `other` is the setting of the second backend, where it is not that of the first.
    """
    if runs is not None:
        names = _judged(setting, names, element, runs, bound)
    one, two = observer(setting, names[0], element), observer(other or setting, names[1], element)
    if other is not None and other.math != setting.math:
        names = f"{names[0]} {setting.math}", f"{names[1]} {other.math}"
    sides = one, two
    count = max(side.count for side in sides)
    low = _parting(sides, count)
    if not bound.exact:
        low = _beyond(sides, low, count, bound)
    if low >= count:
        return None
    events = range(max(0, low - _BEFORE), min(count, low + _AFTER + 1))
    looking = [side.look(sites_of(sides, events)) for side in sides]
    seen = {event: (looking[0].seen(event), looking[1].seen(event)) for event in events}
    rows = tuple(row for pair in seen.values() for row in _rows(*pair, bound))
    divergence = _divergence(setting, names, element, seen[low], rows)
    if (
        divergence.ulp is None
        or divergence.denormal
        or divergence.loc is None
        or not any(side.flushes for side in sides)
    ):
        return divergence
    within = find_denormals(setting, {divergence.loc}).first(element)
    return replace(divergence, denormal=within is not None, within=within)


def _parting(sides: Sides, count: int) -> int:
    """Return the first event that differs in any bit, by halves; `count` if there is none."""
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        one, two = (side.trail(middle) for side in sides)
        low, high = (low, middle) if one != two else (middle + 1, high)
    return low


def _beyond(sides: Sides, low: int, count: int, bound: Bound) -> int:
    """Return the first event from `low` on that is further apart, or that only one side reaches; `count` if none."""
    width = _AHEAD
    while low < count:
        events = range(low, min(count, low + width))
        looking = [side.look(sites_of(sides, events)) for side in sides]
        for event in events:
            one, two = (side.seen(event) for side in looking)
            if _elsewhere(one, two) or bound.parts(one.value, two.value):
                return event
        low, width = low + width, 2 * width
    return count


def _elsewhere(one: Observation, two: Observation) -> bool:
    """Return whether the two are at different statements, or one has ended."""
    return one.site is None or two.site is None or one.site.number != two.site.number


def _judged(
    setting: Setting, names: tuple[str, str], element: int, runs: tuple[Run, Run], bound: Bound
) -> tuple[str, str]:
    """Return the pair with the interpreter for the one that is right, if exactly one is."""
    if INTERPRETER in names:
        return names
    truth = run(setting, INTERPRETER, only={element})
    wrong = [bool(parted(truth, one, bound)[element]) for one in runs]
    return names if wrong[0] == wrong[1] else (INTERPRETER, names[wrong[1]])


def _rows(one: Observation, two: Observation, bound: Bound) -> Iterator[Row]:
    if one.site is not None and two.site is not None and one.site.number == two.site.number:
        same = not bound.parts(one.value, two.value)
        yield Row(one.site.loc, one.site.name, one.site.text, one.turns, one.value, two.value, same)
        return
    if one.site is not None:
        yield Row(one.site.loc, one.site.name, one.site.text, one.turns, one.value, None, False)
    if two.site is not None:
        yield Row(two.site.loc, two.site.name, two.site.text, two.turns, None, two.value, False)


def _divergence(
    setting: Setting, names: tuple[str, str], element: int, seen: tuple[Observation, Observation], rows: tuple[Row, ...]
) -> Divergence:
    one, two = seen
    path = _elsewhere(one, two)
    there = one if one.site is not None else two
    site = there.site
    assert site is not None
    operands = {name: value for (name, _, _), value in zip(site.operands, there.operands, strict=True)}
    ulp, flushed = None, False
    if not path and np.asarray(one.value).dtype.kind == "f":
        ulp = float(np.max(steps(np.atleast_1d(one.value), np.atleast_1d(two.value))))
        flushed = any(map(is_denormal, (one.value, two.value, *operands.values())))
    return Divergence(
        program=setting.program.name,
        backends=names,
        element=setting.index(element),
        inputs=setting.element(element),
        loc=site.loc,
        name=site.name,
        text=site.text,
        turns=there.turns,
        loops=site.loops,
        first=one.value,
        second=two.value,
        ulp=ulp,
        path=path,
        denormal=flushed,
        operands=operands,
        rows=rows,
    )
