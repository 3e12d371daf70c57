"""The rows of the table that generated programs draw: chosen by what they take and give, so that a new row is drawn.

Stage: test. Transcendentals stand apart: their formulas are long, so programs have few of them.

>>> pool(Base.I, "T X")
('shl', 'shr', 'rotl', 'rotr')
"""

from __future__ import annotations

from typing import Final

from shpy.ir.ops import OPS, TRANSCENDENTALS
from shpy.ir.types import Base


def pool(base: Base, takes: str, gives: str = "T", *, componentwise: bool = True) -> tuple[str, ...]:
    """Return the operations for a base that take these letters and give this one (see `ir/ops.py`)."""
    return tuple(
        name
        for name, row in OPS.items()
        if base in row.bases and (" ".join(row.takes), row.gives, row.componentwise) == (takes, gives, componentwise)
        if name not in TRANSCENDENTALS
    )


FLOAT_UNARY: Final = pool(Base.F, "T")
FLOAT_BINARY: Final = pool(Base.F, "T T")
FLOAT_TERNARY: Final = pool(Base.F, "T T T")
INT_UNARY: Final = pool(Base.I, "T")
SHIFTS: Final = pool(Base.I, "T X")
INT_TERNARY: Final = pool(Base.I, "T T T")
INT_BINARY: Final = (*pool(Base.I, "T T"), *SHIFTS)
COMPARE: Final = pool(Base.F, "T T", "B")
TESTS: Final = pool(Base.F, "T", "B")
LOGIC: Final = (*pool(Base.B, "T T"), *pool(Base.B, "T T", "B"))
REDUCING: Final = pool(Base.B, "T", "b", componentwise=False)
GEOMETRY: Final = tuple(name for name, row in OPS.items() if not row.componentwise and name not in REDUCING)
FUNCTIONS: Final = tuple(sorted(TRANSCENDENTALS))

_ALONE: Final = frozenset({"not", "cond", "ldexp", "bits_from_float", "float_from_bits", "unit_float"})
"""Operations that generators draw by their names."""


def drawn() -> frozenset[str]:
    """Return the operations that generators draw: all of the table, so that a test finds a forgotten one."""
    floats = FLOAT_UNARY, FLOAT_BINARY, FLOAT_TERNARY, COMPARE, TESTS, GEOMETRY, FUNCTIONS
    return frozenset().union(*floats, INT_UNARY, INT_BINARY, INT_TERNARY, LOGIC, REDUCING, _ALONE)
