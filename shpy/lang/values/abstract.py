"""Values as operators see them: a type, and where the value is held. The class of each type is registered here.

Stage: record. Inside a recording a value is a slot, which each use loads. Outside it is a constant, or the expression
of a uniform that follows others.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple, NoReturn, Self

from shpy.errors import RecordError
from shpy.ir.nodes import Loc
from shpy.ir.types import Base, Type
from shpy.lang.mistakes.frames import refuse_closed
from shpy.lang.recording.emit import DEFERRED, HOST, Constant, Emitter, Handle, constant_of, embed
from shpy.lang.recording.location import here
from shpy.lang.recording.names import assigned_name
from shpy.lang.recording.recorder import Frame, current_frame
from shpy.lang.values.dependent import Expression

CLASSES: dict[tuple[str, int, Base], type[Any]] = {}
"""The class of each kind, size and base; `types` fills it in."""


class Part(NamedTuple):
    """The source that a value is a copy of, in the user's spelling."""

    name: str
    owner: str = "vector"
    """Its holder: a "vector", "matrix" or "array", or a "constant", as a Table is one, which takes no stores."""


class AbstractValue:
    """A scalar or vector of a type, without its operators."""

    __slots__ = ("_const", "_frame", "_loc", "_part", "_variable")

    kind: ClassVar[str]
    size: ClassVar[int]
    base: ClassVar[Base]
    type: ClassVar[Type]

    _uniform: ClassVar[bool] = False
    _frame: Frame | None
    _variable: int
    _const: tuple[int, ...]
    _part: Part | None
    _loc: Loc | None

    def _become(
        self,
        frame: Frame | None,
        emitter: Emitter | None = None,
        handle: Handle = None,
        const: tuple[int, ...] | None = None,
    ) -> None:
        """Become a new slot that holds the handle or constant; outside a recording, the constant or the expression."""
        set_ = object.__setattr__
        set_(self, "_frame", frame)
        set_(self, "_part", None)
        set_(self, "_loc", None)
        if frame is None:
            set_(self, "_variable", -1)
            if emitter is DEFERRED:
                set_(self, "_const", Expression(handle, assigned_name()))
            else:
                set_(self, "_const", const if const is not None else constant_of(self.type, handle))
            return
        if emitter is HOST:
            const = constant_of(self.type, handle)
        loc = here()
        if isinstance(const, Constant):
            value = embed(frame, self.type, const)
        else:
            value = frame.let("const", (), self.type, const, loc) if const is not None else handle
        variable = frame.variable(self.type, loc=loc)
        set_(self, "_loc", loc)
        set_(self, "_variable", variable)
        set_(self, "_const", ())
        frame.store(variable, value)

    def _read(self, emitter: Emitter) -> Handle:
        """Return the value as a handle of the emitter: loads the slot, or embeds the constant."""
        if self._frame is None:
            return embed(emitter, self.type, self._const)
        self._check(current_frame())
        return emitter.let("load", (), self.type, self._variable)

    def _check(self, frame: Frame | None) -> None:
        """Raise the error for a value that is not this recording's, or of a block that is closed."""
        own = self._frame
        assert own is not None
        if own is not frame:
            within = frame is not None and own.recording is frame.recording
            where = f"the subroutine {frame.name!r}" if within and frame else "this program"
            raise RecordError(
                f"{self._called()} was made outside of {where}, in {own.name!r} at {self._loc}",
                loc=here(),
                cure="pass it as an argument, by itself or in a @sh.struct; what all runs share is a sh.Param, "
                "or a constant made outside programs",
            )
        home = own.homes[self._variable]
        if home.closed:
            self._refuse_closed()

    def _refuse_closed(self) -> NoReturn:
        """Raise the error for a value that is used after the block which made it."""
        own = self._frame
        assert own is not None
        home, loc = own.homes[self._variable], here()
        refuse_closed(self, own.names[self._variable], loc)
        name = own.names[self._variable] or "x"
        cure = f"make it before the block, {name} = sh.{type(self).__name__}(), and store inside it, {name}[:] = …"
        if self._variable in own.spelled:
            cure = "make the whole matrix or struct before the block, and store inside it, as in x[:] = …"
        raise RecordError(
            f"{self._called()} was made inside the {home.what} block at {home.loc} and is used after it",
            loc=loc,
            cure=cure,
        )

    def _read_from(self, name: str, owner: str = "vector") -> Self:
        """Remember what this value is a copy of, for the error of a store into it."""
        if self._frame is not None:
            object.__setattr__(self, "_part", Part(name, owner))
        return self

    def _called(self) -> str:
        if self._frame is None:
            return "this constant"
        name = self._frame.spelled.get(self._variable) or self._frame.names[self._variable]
        return name or (self._part.name if self._part else "this value")
