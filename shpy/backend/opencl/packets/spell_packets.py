"""Spells the types of packets: `float16`, and `float16x3` for vectors of them.

Stage: emit, last.

    Construct(Rows, (x, y))  ->  (float16x2){x, y}
"""

from __future__ import annotations

from collections.abc import Callable

from shpy.backend.emit.spell_c import Level
from shpy.backend.emit.tree import Call, Construct
from shpy.backend.opencl.packets.prologue_wide import Words
from shpy.backend.opencl.packets.widen import Rows
from shpy.backend.opencl.text.spell_cl import ClSpeller
from shpy.ir.types import Type


class PacketSpeller(ClSpeller):
    """The speller of OpenCL C with structs of packets.

    `struct` declares the struct of a type and returns its name; `words` are the names that texts use.
    """

    def __init__(self, struct: Callable[[Type], str], words: Words) -> None:
        super().__init__()
        self.struct, self.words = struct, words

    def base_name(self, type: Type) -> str:
        """Spell a type."""
        name = self.struct(type) if isinstance(type, Rows) else super().base_name(type)
        self.words.types.add(name)
        return name

    def called(self, e: Call) -> str:
        """Spell a call."""
        self.words.add_function(e.function)
        return super().called(e)

    def construct(self, e: Construct) -> tuple[str, Level]:
        """Spell a vector, or a struct of packets."""
        if isinstance(e.type, Rows):
            return f"({self.type_name(e.type)}){{{self.listed(e.args)}}}", Level.POSTFIX
        return super().construct(e)
