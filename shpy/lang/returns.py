"""What a function gives back: the slots of its outputs, stored wherever it ends.

Stage: record. One `Returns` per function being recorded; SH_RETURN and the function's own return both end here.
"""

from __future__ import annotations

from typing import Any

from shpy.errors import RecordError
from shpy.ir.nodes import EXITS, Break, If, Loop, Region, Return
from shpy.lang import arithmetic
from shpy.lang.location import here
from shpy.lang.recorder import Frame, Scope
from shpy.lang.structure import Layout, flatten, layout_from, leaves


class Returns:
    """The outputs of `frame`. `layout` is what the annotation says, or None until the first value says it."""

    def __init__(self, frame: Frame, layout: Layout | None, what: str) -> None:
        self.frame = frame
        self.layout = layout
        self.what = what
        self.slots: list[int] = []
        self.ports: list[tuple[str, str]] = []

    def at_exit(self, value: Any, condition: int | None, exit: Return) -> None:
        """Record `SH_RETURN(value)`, under a condition if there is one."""
        if condition is None:
            self.store(value)
            self.frame.append(exit)
            return
        scope = Scope("SH_RETURN", exit.loc, self.frame.scope)
        self.frame.scopes.append(scope)
        self.store(value)
        self.frame.append(exit)
        self.frame.scopes.pop()
        scope.closed = True
        self.frame.append(If(condition, tuple(scope.statements), (), exit.loc))

    def store(self, value: Any) -> None:
        """Store the value's leaves into the outputs; the first decides what they are, if no annotation did."""
        if value is None:
            if self.layout is not None:
                raise RecordError(
                    f"{self.what} gives back a value, and SH_RETURN here has none", loc=here(), cure="SH_RETURN(value)"
                )
            return
        if self.layout is None:
            self.layout = layout_from(value, self.what)
        entries = flatten(self.layout, value, f"what {self.what} gives back")
        classes = [cls for _, _, cls in leaves(self.layout, "")]
        # All values are read before the first is stored.
        handles = [
            arithmetic.convert(self.frame, entry, cls.type, f"what {self.what} gives back")
            for entry, cls in zip(entries, classes, strict=True)
        ]
        if not self.slots:
            self._declare()
        for slot, handle in zip(self.slots, handles, strict=True):
            self.frame.store(slot, handle)

    def _declare(self) -> None:
        assert self.layout is not None
        for name, kind, cls in leaves(self.layout, ""):
            slot = self.frame.variable(cls.type, name="", loc=self.frame.loc)
            self.frame.homes[slot] = self.frame.scopes[0]
            # The user's own variable keeps its name; what is copied out of it is the result.
            self.frame.names[slot] = name if name and not name.isdigit() else f"result{name}"
            self.slots.append(slot)
            self.ports.append((name or "0", kind))

    def finish(self, value: Any) -> None:
        """The function's own return; an error where it can fall off the end without a value."""
        body = tuple(self.frame.scopes[0].statements)
        if value is not None:
            self.store(value)
        elif (self.slots or self.layout is not None) and not ends(body):
            raise RecordError(
                f"{self.what} can end here without a value",
                loc=self.frame.loc,
                cure="return a value after the last block, or SH_RETURN in every branch",
            )


def ends(region: Region) -> bool:
    """Whether nothing runs on past the region's end."""
    if not region:
        return False
    last = region[-1]
    match last:
        case If(_, then, orelse):
            return ends(then) and ends(orelse)
        case Loop(body, _, until):
            return until is None and not _breaks(body)
    return isinstance(last, EXITS)


def _breaks(region: Region) -> bool:
    """Whether a Break of the loop with this body stands in it."""
    return any(isinstance(s, Break) or (isinstance(s, If) and (_breaks(s.then) or _breaks(s.orelse))) for s in region)
