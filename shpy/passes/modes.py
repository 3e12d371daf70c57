"""The modes of arithmetic, in a module of their own: importing it costs nothing."""

from typing import Final, Literal, get_args

Math = Literal["strict", "portable", "relaxed", "fast"]
"""How exact functions are.

The same bits on every target; the same by formulas of binary32 alone; within OpenCL's bounds; or as fast as can be.
"""

MODES: Final[tuple[str, ...]] = get_args(Math)
"""Their names, the most exact one first."""

REPRODUCIBLE: Final = frozenset({"strict", "portable"})
"""The modes that give the same bits everywhere: each operation is rounded by itself, and nothing is contracted."""

Formulas = Literal["doubles", "pairs", "portable"]
"""The formulas of transcendentals of binary32 (`strict`): by binary64, by pairs of binary32, or by binary32 alone."""


def formulas_of(math: Math, doubles: bool) -> Formulas:
    """Return the formulas of a mode on a target that has binary64 or has not."""
    if math != "strict":
        return "portable"
    return "doubles" if doubles else "pairs"
