"""The modes of arithmetic and its precisions. This module imports no other of shpy, so that importing it is fast."""

from typing import Final, Literal, get_args

Math = Literal["strict", "portable", "relaxed", "fast"]
"""The exactness of functions.

strict: the same bits on every target. portable: the same, by formulas in binary32 alone. relaxed: within OpenCL's error
bounds. fast: as fast as possible.
"""

Precision = Literal["f16", "f32", "f64"]
"""The format of the working float."""

PRECISIONS: Final[tuple[str, ...]] = get_args(Precision)
"""The names of the precisions, the narrowest one first."""

MODES: Final[tuple[str, ...]] = get_args(Math)
"""The names of the modes, the most exact one first."""

REPRODUCIBLE: Final = frozenset({"strict", "portable"})
"""The modes that give the same bits on every target: each operation is rounded by itself, without contraction."""

CONTRACTIONS: Final[dict[str, tuple[str, bool]]] = {
    **{mode: (mode, False) for mode in MODES},
    **{f"{mode} fused": (mode, True) for mode in MODES if mode in REPRODUCIBLE},
}
"""By the name that tables and pages show: a mode, and whether a * b + c is rounded once (`fuse`)."""


def mode_name(math: str, fuse: bool) -> str:
    """Return the name of a mode in tables and on pages.

    >>> mode_name("strict", True)
    'strict fused'
    """
    return f"{math} fused" if fuse else math


Formulas = Literal["fused", "doubles", "none", "portable", "fast"]
"""The formulas of the elementary functions of binary32.

fused, doubles: strict mode's, in binary64, with or without fused operations. none: strict mode has none on a device
without binary64. portable: in binary32 alone. fast: portable's, or the target's other functions where a compiler may
reassociate sums.
"""


def formulas_of(math: Math, doubles: bool, fuses: bool = False) -> Formulas:
    """Return the formulas of a mode on a target; `doubles`: it has binary64, `fuses`: its fma of binary64 is fast."""
    if math != "strict":
        return "fast" if math == "fast" else "portable"
    if not doubles:
        return "none"
    return "fused" if fuses else "doubles"
