"""Spells OpenCL C: types, numbers, vectors and conversions.

Stage: emit, last.

    Literal(float, 0.1)  ->  0.1f        Construct(int2, (a, b))  ->  (int2)(a, b)        Cast(uint, i)  ->  (uint)i
"""

from __future__ import annotations

import numpy as np

from shpy.backend.emit.spell_c import Level, Speller, is_negative
from shpy.backend.emit.tree import BOOL, Cast, Construct, Declare, Expr, Literal, Own
from shpy.backend.opencl.text.prologue import spelled
from shpy.ir.types import Base, Type


class ClSpeller(Speller):
    """The speller of OpenCL C. A vector of bools is one of ints, -1 for true; its components are spelled as ints."""

    def base_name(self, type: Type) -> str:
        """Spell a type, such as `float3`."""
        return spelled(type)

    def float_number(self, value: float, base: Base) -> tuple[str, Level]:
        """Spell `0.1f`; a double without a suffix."""
        return _float_text(value, base), Level.UNARY if is_negative(value) or value != value else Level.ATOM

    def construct(self, e: Construct) -> tuple[str, Level]:
        """Spell `(float3)(a, b)`."""
        return f"({self.type_name(e.type)})({', '.join([self._component(a) for a in e.args])})", Level.UNARY

    def _component(self, e: Expr) -> str:
        if e.type is not BOOL:
            return self.text(e)
        return str(-int(e.value)) if isinstance(e, Literal) else f"-{self.at(e, Level.UNARY)}"

    def cast(self, e: Cast) -> tuple[str, Level]:
        """Spell `(uint)i`."""
        return f"({self.type_name(e.to or e.type)}){self.at(e.of, Level.UNARY)}", Level.UNARY

    def array(self, s: Declare) -> str:
        """Spell `float a[8] = {0.0f};`."""
        declared = self.declaration(s.type, f"{s.name}[{s.length}]")
        return f"{declared};" if s.value is None else f"{declared} = {{{self.text(s.value)}}};"


def element_type(type: Type) -> Type | Own:
    """Return the type of an array's elements in memory: scalars for vectors of three, bytes for bools."""
    if type.is_bool:
        return Own("uchar" if type.size in (1, 3) else f"uchar{type.size}")
    return type.scalar if type.size == 3 else type


def _float_text(x: float, base: Base) -> str:
    """Return the shortest text that reads back as the same number."""
    if x != x:
        return "NAN" if base is Base.F else "(double)NAN"
    if x in (float("inf"), float("-inf")):
        sign = "-" if x < 0 else ""
        return f"{sign}INFINITY" if base is Base.F else f"({sign}(double)INFINITY)"
    return f"{np.float32(x)!s}f" if base is Base.F else repr(x)
