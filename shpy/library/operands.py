"""Convert the operands of the library's functions, numbers, tuples and values, to values of floats.

Stage: record.

    vector(p, (2, 3), "sh.library.translate")     # p, if it has two or three components
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from shpy.errors import ShpyTypeError
from shpy.ir.types import INTS, Base
from shpy.lang.recording.location import here
from shpy.lang.values import arithmetic
from shpy.lang.values.value import CLASSES, Value


def float_base(operands: Sequence[Any], what: str) -> Base:
    """Return the base in which operands meet; ints widen to f."""
    base = arithmetic.base_of(operands, what)
    return Base.F if base in INTS else base


def vector(x: Any, sizes: Sequence[int], what: str) -> Any:
    """Return `x` as a value of floats. Raises ShpyTypeError for bools and for other numbers of components."""
    operand = arithmetic.operand(x, what)
    if operand.size not in sizes:
        spoken = " or ".join(map(str, sizes))
        lacking = sizes[-1] - operand.size
        example = {1: "p.x", 2: "p.xy", 3: "p.xyz", 4: "p"}[sizes[-1]]
        if lacking > 0:
            example = f"sh.Attrib{sizes[-1]}f(p{', 0' * lacking if operand.size > 1 else ''})"
        raise ShpyTypeError(
            f"{what} takes {spoken} component{'s' if sizes != (1,) else ''}, not {operand.size}",
            loc=here(),
            cure=f"{what}({example})" if what.startswith("sh.") else example,
        )
    base = float_base((operand,), what)
    if base is Base.B:
        raise ShpyTypeError(f"{what} takes floats, not bools", loc=here(), cure="sh.cond(c, 1.0, 0.0)")
    if isinstance(operand, Value) and operand.base is base:
        return operand
    return CLASSES[getattr(operand, "kind", "Attrib"), operand.size, base](x)
