"""Types of the IR: a base and a size, nothing else.

Stage: represent. `lang` splits matrices, structs and kinds (Point, Normal, ...) into the types that every target has:
scalars, and vectors of two to four scalars; inside functions, vectors of eight too. `Type` objects are unique, so `is`
compares them.

>>> vec(Base.F, 3)
f3
>>> vec(Base.B).base
<Base.B: 'b'>
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final


class Base(StrEnum):
    """The type of one component. `F` is the working float: binary32 unless compiled at another precision."""

    F = "f"
    D = "d"
    H = "h"
    I = "i"  # noqa: E741 - the language's own name for it
    U = "u"
    B = "b"


FLOATS: Final = frozenset({Base.F, Base.D, Base.H})
INTS: Final = frozenset({Base.I, Base.U})


class Type:
    """A scalar (size 1) or vector (size 2 to 4, or 8) of one base. `vec` returns the only object of each type."""

    __slots__ = ("_text", "base", "size")
    base: Base
    size: int

    def __init__(self, base: Base, size: int) -> None:
        self.base = base
        self.size = size
        self._text = base.value if size == 1 else f"{base.value}{size}"

    def __repr__(self) -> str:
        return self._text

    def __reduce__(self) -> tuple[object, ...]:
        return vec, (self.base, self.size)

    def __copy__(self) -> Type:
        return self

    def __deepcopy__(self, memo: object) -> Type:
        return self

    @property
    def scalar(self) -> Type:
        """The type of one component."""
        return vec(self.base, 1)

    @property
    def is_float(self) -> bool:
        """Return whether components are f, d or h."""
        return self.base in FLOATS

    @property
    def is_int(self) -> bool:
        """Return whether components are i or u."""
        return self.base in INTS

    @property
    def is_bool(self) -> bool:
        """Return whether components are b."""
        return self.base is Base.B

    def sized(self, size: int) -> Type:
        """Return the type of this base with another number of components."""
        return vec(self.base, size)

    def based(self, base: Base) -> Type:
        """Return the type of another base with as many components."""
        return vec(base, self.size)


WIDEST_PORT: Final = 4
"""The most components of an input, output, param or element of a table."""
SIZES: Final = (1, 2, 3, 4, 8)
"""The numbers of components of types."""
_TYPES: Final = {(base, size): Type(base, size) for base in Base for size in SIZES}
_NAMES: Final = {repr(t): t for t in _TYPES.values()}


def vec(base: Base | str, size: int = 1) -> Type:
    """Return the type of `size` components (1 to 4, or 8) of `base`; KeyError for any other size."""
    try:
        return _TYPES[base, size]  # type: ignore[index]  # a Base is a str, and making one costs most
    except KeyError:
        return _TYPES[Base(base), size]


def type_named(name: str) -> Type | None:
    """Return the type that prints as `name` (`f`, `i3`, ...), or None."""
    return _NAMES.get(name)
