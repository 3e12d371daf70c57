"""Spells GLSL: types, numbers, vectors and conversions.

Stage: emit, last.

    Literal(float, 0.1)  ->  0.1        Construct(ivec2, (a, b))  ->  ivec2(a, b)        Cast(uint, i)  ->  uint(i)
"""

from __future__ import annotations

from typing import Final

import numpy as np

from shpy.backend.emit.spell_c import Level, Speller, is_negative
from shpy.backend.emit.tree import AnyType, Cast, Construct, Declare
from shpy.backend.glsl.text.prologue import spelled
from shpy.ir.types import Base, Type

_SHORT: Final = 256
"""Whole multiples of its reciprocal are read right by every compiler: their decimal digits are exact."""
_WRITTEN_OUT: Final = 16
"""Elements of an array whose zeros are listed; more are stored by a loop."""


class GlslSpeller(Speller):
    """GLSL; `exact`: floats and bools are `precise`; `reads`: the compiler rounds decimal numbers correctly."""

    def __init__(self, *, exact: bool, reads: bool = True) -> None:
        super().__init__()
        self.exact, self.reads = exact, reads

    def base_name(self, type: Type) -> str:
        """Spell `vec3`."""
        return spelled(type)

    def declaration(self, type: AnyType, name: str, passed: str = "") -> str:
        """Spell `precise inout float x`: how a parameter is passed comes last, as it must before GLSL 4.20."""
        precise = "precise " if self.exact and isinstance(type, Type) and (type.is_float or type.is_bool) else ""
        how = f"{passed} " if passed else ""
        return f"{precise}{how}{super().declaration(type, name)}"

    def float_number(self, value: float, base: Base) -> tuple[str, Level]:
        """Spell `0.1`; by their bits floats that drivers do not read, or flush."""
        level = Level.UNARY if is_negative(value) else Level.ATOM
        if base is Base.D and np.isfinite(value):
            if self.reads or (value * _SHORT).is_integer():
                return f"{value!r}lf", level
            low, high = np.array([value]).view(np.uint32)
            return f"packDouble2x32(uvec2(0x{low:08x}u, 0x{high:08x}u))", Level.POSTFIX
        rounded, text = np.float32(value), str(np.float32(value))
        tiny = 0 < abs(rounded) < np.finfo(np.float32).tiny
        if not np.isfinite(rounded) or tiny or ("e" in text and not self.reads):
            by_bits = f"uintBitsToFloat(0x{rounded.view(np.uint32):08x}u)"
            return by_bits if base is Base.F else f"double({by_bits})", Level.POSTFIX
        return text, level

    def construct(self, e: Construct) -> tuple[str, Level]:
        """Spell `vec3(a, b)`."""
        return f"{spelled(e.type)}({self.listed(e.args)})", Level.POSTFIX

    def cast(self, e: Cast) -> tuple[str, Level]:
        """Spell `float(i)`."""
        return f"{spelled(e.type)}({self.text(e.of)})", Level.POSTFIX

    def array(self, s: Declare) -> str:
        """Spell the declaration of an array of zeros: written out where it is short."""
        declared, length = f"{self.declaration(s.type, s.name)}[{s.length}]", s.length or 0
        zero = "" if s.value is None else self.text(s.value)
        if length <= _WRITTEN_OUT:
            return f"{declared} = {self.type_name(s.type)}[{length}]({', '.join([zero] * length)});"
        return f"{declared}; for (int sh_i = 0; sh_i < {length}; sh_i++) {{ {s.name}[sh_i] = {zero}; }}"
