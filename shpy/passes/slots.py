"""Slots: the storage of variables in vectorised code, in one slot while uniform and in other slots while varying.

Stage: improve. Part of `vectorize`. A variable has one uniform slot and one lanes slot for the whole function, and one
more lanes slot for each loop that must not overwrite the outer one.

A slot has the name of its variable. If there are several, the lanes slot beside a uniform slot is `name_out`, and the
slot of a loop is `name_in`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from shpy.ir.constants import Base, vec
from shpy.ir.nodes import Variable

_FUNCTION = -1


class Slots:
    """The slots of a function, each created at its first use."""

    def __init__(self, variables: Iterable[Variable]) -> None:
        self._variables = {v.id: v for v in variables}
        self._slots: dict[tuple[str, int, int], Variable] = {}
        self.varying: set[int] = set()
        """Ids of the slots that hold a separate value for each lane."""

    def uniform(self, variable: int) -> Variable:
        """Return the slot of the variable while it is uniform."""
        return self._slot("uniform", variable)

    def lanes(self, variable: int, loop: int | None = None) -> Variable:
        """Return the slot of the variable while it varies, in the function or in a loop with a slot of its own."""
        slot = self._slot("lanes", variable, _FUNCTION if loop is None else loop)
        self.varying.add(slot.id)
        return slot

    def array(self, variable: int, varies: bool) -> Variable:
        """Return the slot of an array: the same one in the whole function, whether the array varies or not."""
        slot = self._slot("array", variable)
        if varies:
            self.varying.add(slot.id)
        return slot

    def mask(self, name: str, loop: int) -> Variable:
        """Return the slot of a mask of a loop or of the function."""
        key = (name, loop, _FUNCTION)
        if key not in self._slots:
            self._slots[key] = Variable(len(self._slots), vec(Base.B), None, name)
            self.varying.add(self._slots[key].id)
        return self._slots[key]

    def live(self) -> frozenset[int]:
        """Return the slots of the masks of lanes that are still in their loop."""
        return frozenset(slot.id for (name, _, _), slot in self._slots.items() if name == "live")

    def _slot(self, kind: str, variable: int, loop: int = _FUNCTION) -> Variable:
        key = (kind, variable, loop)
        if key not in self._slots:
            self._slots[key] = replace(self._variables[variable], id=len(self._slots))
        return self._slots[key]

    def named(self, used: Iterable[int]) -> dict[int, Variable]:
        """Return the slots that are used, with their names, by id."""
        ids = set(used)
        kept = {key: slot for key, slot in self._slots.items() if slot.id in ids}
        of: dict[int, set[tuple[str, bool]]] = {}
        for kind, variable, loop in kept:
            if kind in ("uniform", "lanes"):
                of.setdefault(variable, set()).add((kind, loop != _FUNCTION))
        named = {}
        for (kind, variable, loop), slot in kept.items():
            kinds = of.get(variable, set())
            if kind == "lanes" and len(kinds) > 1 and slot.name is not None:
                suffix = "_in" if loop != _FUNCTION else "_out" if ("uniform", False) in kinds else ""
                slot = replace(slot, name=slot.name + suffix)
            named[slot.id] = slot
        return named
