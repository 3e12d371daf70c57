"""Results of a function: the slots of its outputs, stored wherever it ends.

Stage: record. One `Returns` per function being recorded; SH_RETURN and the function's own return both end here.
"""

from __future__ import annotations

from types import CodeType, FrameType
from typing import Any

from shpy.errors import RecordError, ShpyTypeError
from shpy.ir.nodes import EXITS, Break, If, Let, Loc, Loop, Region, Return
from shpy.ir.traverse import has_exit, walk
from shpy.lang.recording.location import called_frames, here, loc_in
from shpy.lang.recording.recorder import Frame, OpenRegion
from shpy.lang.values import arithmetic
from shpy.lang.values.structure import Group, Layout, Leaf, Rows, annotation_of, flatten, layout_from, leaves
from shpy.lang.values.value import Value


class Returns:
    """The outputs of `frame`. `layout` is that of the annotation, else None until the first value determines it.

    `bodies` is the code of the recorded function, in which SH_RETURN may be used.
    """

    def __init__(
        self, frame: Frame, layout: Layout | None, what: str, bodies: frozenset[CodeType] = frozenset()
    ) -> None:
        self.frame = frame
        self.layout = layout
        self.source = "is annotated with ->" if layout is not None else "its first return gives"
        self.what = what
        self.bodies = bodies
        self._without_value: Loc | None = None
        self._wrapped_at = 0
        self._wrappers: set[Loc] = set()
        self.slots: list[int] = []
        self.ports: list[tuple[str, str]] = []

    def check_place(self, *, through: bool = False) -> None:
        """Raise RecordError for an SH_RETURN in a function which the recorded one calls: it would end the caller.

        With `through` it may: what matters then is the body from which the function was called.
        """
        frames = called_frames()
        inside = [k for k, frame in enumerate(frames) if frame.f_code in self.bodies]
        inner, *outer = frames[inside[0] :] if through and inside else frames
        called = [frame.f_code for frame in outer]
        if inner.f_code not in self.bodies or inner.f_code in called:
            name, cure = _spoken(inner)
            raise RecordError(
                f"this SH_RETURN stands in {name}, a plain function, and would end {self.what}, which calls it",
                loc=here(),
                cure=cure,
            )
        if called and not self._wrappers:
            self._wrapped_at = len(self.frame.scopes[0].statements)
            self._wrappers = {
                loc_in(code, line) for code in called for _, _, line in code.co_lines() if line is not None
            }

    def _check_wrappers(self) -> None:
        """Raise RecordError for a decorator that computes after the function that it wraps, which SH_RETURN skips."""
        for statement in walk(tuple(self.frame.scopes[0].statements[self._wrapped_at :])) if self._wrappers else ():
            loc = statement.value.loc if isinstance(statement, Let) else getattr(statement, "loc", None)
            if loc in self._wrappers:
                raise RecordError(
                    f"a decorator of {self.what} goes on computing here, and the SH_RETURN in {self.what} skips that",
                    loc=loc,
                    cure=f"decorate {self.what} with @sh.subroutine first, below the other decorators",
                )

    def at_exit(self, value: Any, condition: int | None, exit: Return) -> None:
        """Record `SH_RETURN(value)`, under a condition if there is one."""
        if condition is None:
            self.store(value)
            self.frame.append(exit)
            return
        scope = OpenRegion("SH_RETURN", exit.loc, self.frame.scope)
        self.frame.scopes.append(scope)
        self.store(value)
        self.frame.append(exit)
        self.frame.scopes.pop()
        scope.closed = True
        self.frame.append(If(condition, tuple(scope.statements), (), exit.loc))

    def store(self, value: Any) -> None:
        """Store the value's leaves into the outputs; without an annotation the first value determines their types."""
        if value is None:
            self._without_value = self._without_value or here()
        if self._without_value is not None and (self.layout is not None or value is not None):
            text = f"{self.what} gives back a value, and SH_RETURN here has none"
            raise RecordError(text, loc=self._without_value, cure="SH_RETURN(value)")
        if value is None:
            return
        if self.layout is None:
            self.layout = layout_from(value, self.what)
        _check_count(self.what, self.layout, value, self.source)
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
            port = name or "0"
            if any(port == earlier for earlier, _ in self.ports):
                raise RecordError(f'{self.what} gives back two outputs called "{port}"', loc=here(), cure="another key")
            slot = self.frame.variable(cls.type, name="", loc=self.frame.loc)
            self.frame.homes[slot] = self.frame.scopes[0]
            # The user's own variable keeps its name, so its copy in the output is named `result`.
            self.frame.names[slot] = name if name and not name.isdigit() else f"result{name}"
            self.slots.append(slot)
            self.ports.append((port, kind))

    def finish(self, value: Any) -> None:
        """Record the function's own return; raise RecordError if it can reach its end without a value."""
        self._check_wrappers()
        body = tuple(self.frame.scopes[0].statements)
        if value is not None:
            self.store(value)
        elif (self.slots or self.layout is not None) and not ends(body):
            raise RecordError(
                f"{self.what} can end here without a value",
                loc=self.frame.loc,
                cure="return a value after the last block, or SH_RETURN in every branch",
            )


def _check_count(what: str, layout: Layout, value: Any, source: str) -> None:
    """Raise ShpyTypeError if the number of values differs from that of the annotation, or of the first return."""
    several = isinstance(value, tuple | list)
    match layout:
        case Leaf(cls):
            fits = not several or len(value) == cls.size
        case Rows(cls):
            fits = not several or (len(value) == cls.size and not any(isinstance(v, Value) for v in value))
        case Group(form="tuple", parts=parts):
            fits = len(value) == len(parts) if several else isinstance(value, dict)
        case _:
            fits = True
    if not fits:
        amount = f"a {type(value).__name__} of {len(value)}" if several else f"one {type(value).__name__}"
        raise ShpyTypeError(
            f"{what} returns {amount}, and {source} {annotation_of(layout)}",
            loc=here(),
            cure=f"-> {annotation_of(layout_from(value, what))}, or a value of the type that the annotation names"
            if "->" in source
            else "values of one type at every return",
        )


def _spoken(frame: FrameType) -> tuple[str, str]:
    """Return the name of the function that runs in `frame`, and the cure that lets SH_RETURN end it."""
    code = frame.f_code
    if code.co_name == "<lambda>":
        return f"the lambda of line {code.co_firstlineno}", "a def decorated with @sh.subroutine"
    return f"`{code.co_name}`", f"decorate `{code.co_name}` with @sh.subroutine: SH_RETURN then ends it alone"


def ends(region: Region) -> bool:
    """Return whether control never reaches the region's end."""
    if not region:
        return False
    last = region[-1]
    match last:
        case If(_, then, orelse):
            return ends(then) and ends(orelse)
        case Loop(body, _, until):
            return until is None and not has_exit(body, Break)
    return isinstance(last, EXITS)
