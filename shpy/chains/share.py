"""Shares: how many of the live elements of a chain have to be ready before a kernel of a loop runs.

Stage: run. The device counts the elements; the host reads the two numbers, and compares them. The counts are ints, so
every backend decides alike.

    sh.loop(traverse, intersect, when={"intersect": sh.share("waiting", 0.2, of="moving")})
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from shpy.algebra import alike, with_article
from shpy.chains.member import element_layout, is_condition, is_gathered, no_condition
from shpy.errors import ShpyTypeError
from shpy.lang.programs.joined import MASK
from shpy.lang.recording.location import here
from shpy.lang.values.structure import Layout, Leaf
from shpy.programs import Program
from shpy.streams.stream import Place, Stream

Condition = str | Program
"""The name of a stream of bools, or a program of the element that gives one Attrib1b."""


@dataclass(frozen=True, eq=False)
class Share:
    """A share of the elements of streams: see `sh.share`."""

    condition: Condition
    least: float
    of: Condition | None

    def count(self, place: Place, streams: Mapping[Any, Stream]) -> tuple[int, bool]:
        """Return the number of ready elements, and whether it reaches the share at which the member runs."""
        ready = _marks(self.condition, place, streams)
        if ready is None:
            return 0, False
        count = int(ready.count())
        if not count:
            return 0, False
        live = None if self.of is None else _marks(self.of, place, streams)
        total = ready.size if self.of is None else 0 if live is None else int(live.count())
        return count, count >= self.least * total

    def check(self, layouts: Mapping[str, Layout], spoken: str) -> None:
        """Raise ShpyTypeError for a stream that the kernels of a loop do not have, or have with another type."""
        for condition in (self.condition, self.of):
            if condition is None:
                continue
            needed: Mapping[str, Any] = (
                {condition: Leaf(MASK)} if isinstance(condition, str) else condition.recorded.inputs
            )
            for name, needs in needed.items():
                if name not in layouts:
                    raise ShpyTypeError(
                        f"{name} of {self} is no stream of {spoken}", loc=here(), cure=f"one of {', '.join(layouts)}"
                    )
                type_ = element_layout(needs)
                if not alike(layouts[name], type_):
                    raise ShpyTypeError(
                        f"the stream {name} is {with_article(layouts[name])} in {spoken} and {with_article(type_)} in "
                        f"{self}",
                        loc=here(),
                        cure="one type in both",
                    )

    def __str__(self) -> str:
        of = "" if self.of is None else f", of={_spoken(self.of)}"
        return f"share({_spoken(self.condition)}, {self.least:g}{of})"


def share(condition: Condition, least: float, of: Condition | None = None) -> Share:
    """Return the condition that at least one element, and the share `least` of the live ones, is ready.

    `condition` tells which elements are ready: the name of a stream of bools of the loop, or a program of the element
    that returns one Attrib1b and reads streams of the loop by name. `of` tells in the same way which elements are
    live; without it all are. `least` is a number above 0 and at most 1. A stream that no kernel has written yet has no
    ready elements. Used in `when=` of `sh.loop`. Raises ShpyTypeError for other conditions and numbers.
    Source: Christen 2005, section 5.6, which balances the load of two kernels in this way.
    """
    is_number = isinstance(least, int | float | np.integer | np.floating) and not isinstance(least, bool)
    if not is_number or not 0 < least <= 1:
        raise ShpyTypeError(
            f"a share of {least!r}", loc=here(), cure="a number above 0 and at most 1, such as sh.share(name, 0.2)"
        )
    for entry in (condition, of):
        if entry is not None:
            _check_condition(entry)
    return Share(condition, float(least), of)


def _check_condition(condition: Any) -> None:
    """Raise ShpyTypeError for a condition that is not one of single elements."""
    if isinstance(condition, str):
        return
    types = condition.recorded.inputs.values() if is_condition(condition) else ()
    if not types or any(map(is_gathered, types)):
        raise no_condition(condition, "", "program of the element", 'sh.share("waiting", 0.2)')


def _marks(condition: Condition, place: Place, streams: Mapping[Any, Stream]) -> Stream | None:
    """Return the bools of a condition; None if a stream is missing."""
    if isinstance(condition, str):
        return streams.get(condition)
    names: Iterable[str] = condition.recorded.inputs
    if any(name not in streams for name in names):
        return None
    stream: Stream = condition.compile_at(place)(**{name: streams[name] for name in names})
    return stream


def _spoken(condition: Condition) -> str:
    return repr(condition) if isinstance(condition, str) else condition.recorded.module.name
