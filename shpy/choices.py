"""Choices: alternatives that a user writes for one thing, among which `sh.accuracy.tradeoff` searches.

Stage: above programs. A choice is called like any of its alternatives; it records the first, unless another is picked.

    intersect = sh.choice("method", {"moller_trumbore": f, "watertight": g})

    @sh.program
    def nearest(ray: Ray) -> sh.Attrib1f:
        return intersect(ray)

    combinations(nearest)       # ({"method": "moller_trumbore"}, nearest with f), then the same with g
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

from shpy.errors import ShpyTypeError
from shpy.lang.recording.location import here
from shpy.programs import Program, program as record_program


@dataclass
class _Picking:
    """The picks of a recording, and the choices that it met."""

    picks: Mapping[str, str]
    met: dict[str, Choice] = field(default_factory=dict)


_picking: ContextVar[_Picking | None] = ContextVar("picking", default=None)


class Choice:
    """Alternatives under a name. Calling it calls the one that is picked, the first if none is."""

    def __init__(self, name: str, alternatives: Mapping[str, Callable[..., Any]]) -> None:
        self.name = name
        self.alternatives = dict(alternatives)

    def __call__(self, *args: Any, **named: Any) -> Any:
        """Call the alternative that is picked. Raises ShpyTypeError if it does not take these arguments."""
        picked = self.picked()
        try:
            return picked(*args, **named)
        except TypeError as error:
            if error.__traceback__ and error.__traceback__.tb_next:  # raised inside the alternative
                raise
            raise ShpyTypeError(
                f"an alternative of the choice {self.name!r} is called with other arguments than it takes: {error}",
                loc=here(),
                cure="alternatives that take the same arguments",
            ) from None

    def picked(self) -> Callable[..., Any]:
        """Return the alternative that a recording takes now."""
        picking = _picking.get()
        if picking is None:
            return next(iter(self.alternatives.values()))
        if picking.met.setdefault(self.name, self).alternatives.keys() != self.alternatives.keys():
            raise ShpyTypeError(
                f"two choices of the program are called {self.name!r}, and their alternatives are others",
                loc=here(),
                cure="a name of its own for each",
            )
        return self.alternatives[picking.picks.get(self.name, next(iter(self.alternatives)))]

    def __repr__(self) -> str:
        return f"choice({self.name!r}, {', '.join(self.alternatives)})"


def choice(name: str, alternatives: Mapping[str, Callable[..., Any]]) -> Choice:
    """Alternatives, functions or programs, that take and give the same; see the module.

    A program may call it, and `tradeoff` then records that program with each alternative; or it may be given to
    `tradeoff` itself. Raises ShpyTypeError for no alternatives, or for one that cannot be called.
    """
    named = isinstance(alternatives, Mapping) and len(alternatives) > 0
    if not (named and all(isinstance(n, str) and callable(f) for n, f in alternatives.items())):
        raise ShpyTypeError(
            f"the choice {name} needs functions to choose from",
            loc=here(),
            cure='sh.choice("method", {"fast": f, "exact": g})',
        )
    return Choice(name, alternatives)


def _recorded(program: Program | Choice, picks: Mapping[str, str]) -> tuple[Program, dict[str, Choice]]:
    """Return the program with these picks, and every choice that it meets."""
    picking = _Picking(picks)
    before = _picking.get()
    try:
        _picking.set(picking)
        if isinstance(program, Choice):
            result: Any = program.picked()
            result = result if isinstance(result, Program) else record_program(result)
        else:
            # Joined and specialised programs have no function: what they were made of is fixed.
            function = getattr(program, "__wrapped__", None)
            result = program if function is None else record_program(function)
        return result, picking.met
    finally:
        _picking.set(before)


def combinations(program: Program | Choice) -> Iterator[tuple[dict[str, str], Program]]:
    """Yield every combination of alternatives with its program; one without picks where there is no choice."""

    def inner(picks: dict[str, str]) -> Iterator[tuple[dict[str, str], Program]]:
        candidate, met = _recorded(program, picks)
        open_ = next((c for name, c in met.items() if name not in picks), None)
        if open_ is None:
            yield picks, candidate
            return
        for alternative in open_.alternatives:
            yield from inner({**picks, open_.name: alternative})

    yield from inner({})
