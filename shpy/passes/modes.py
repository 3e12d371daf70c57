"""The modes of arithmetic, in a module of their own: importing it costs nothing."""

from typing import Final, Literal, get_args

Math = Literal["strict", "portable", "relaxed", "fast"]
"""The exactness of functions.

The same bits on every target; the same by formulas of binary32 alone; within OpenCL's bounds; or as fast as can be.
"""

MODES: Final[tuple[str, ...]] = get_args(Math)
"""Their names, the most exact one first."""

REPRODUCIBLE: Final = frozenset({"strict", "portable"})
"""The modes that give the same bits everywhere: each operation is rounded by itself, and nothing is contracted."""

Formulas = Literal["fused", "doubles", "pairs", "portable"]
"""The formulas of the elementary functions of binary32.

By binary64, with or without fused operations (`exact`); by pairs of binary32, or by binary32 alone (`strict`).
"""


def formulas_of(math: Math, doubles: bool, fuses: bool = False) -> Formulas:
    """Return the formulas of a mode on a target that has binary64 or has not, and is quick at fma in it or is not."""
    if math != "strict":
        return "portable"
    if not doubles:
        return "pairs"
    return "fused" if fuses else "doubles"
