"""The roundings of operations: which values are rounded, and by how much that changes the result.

Stage: improve; for `reverse`, which sums these errors by lines. A rounding changes a value by half a unit in the last
place at most. These operations are exact, so they add nothing:

- differences of numbers within a factor of 2 of each other (Sterbenz, Floating-Point Computation, 1974);
- products and quotients by a constant power of 2, but for denormals.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from math import frexp
from typing import Any

import numpy as np

from shpy.ir.constants import decode
from shpy.ir.nodes import Let, Loc, Variable
from shpy.ir.ops import OPS
from shpy.ir.types import Base
from shpy.passes.derivatives.linear import Live, Tangent, TangentBuilder

_HALF_UNITS = {Base.H: 2.0**-11, Base.F: 2.0**-24, Base.D: 2.0**-53}
"""The largest relative error of a rounding to a float."""


def is_rounded(let: Let) -> bool:
    """Return whether the value may differ at f32 from that at f64 with the same operands."""
    if isinstance(let.attr, tuple) and let.op == "const" and let.value.type.base is Base.F:
        numbers = np.array(decode(let.value.type, let.attr))
        with np.errstate(over="ignore"):
            return bool((numbers.astype(np.float32) != numbers).any())
    row = OPS.get(let.op)
    return let.value.type.is_float and (let.op in ("param", "convert") if row is None else not row.exact)


def is_scale(let: Let) -> bool:
    """Return whether the value is a constant power of 2."""
    if let.op != "const" or not isinstance(let.attr, tuple):
        return False
    return all(abs(frexp(x)[0]) == 0.5 for x in decode(let.value.type, let.attr))


def rounding_error(
    let: Let, bar: Tangent, value: Live, operand: Callable[[int], Live], scales: Collection[int]
) -> Live | None:
    """Return the most that the rounding of a value changes the result by, given its bar; None for an exact operation.

    `operand` returns an operand by its id in the function; `scales` are those that are constant powers of 2.
    """
    if let.op in ("mul", "div") and any(a in scales for a in let.args[let.op == "div" :]):
        return None
    share: Any = abs(bar * value) * _HALF_UNITS[value.type.base]
    if let.op in ("add", "sub"):
        a, b = (abs(operand(x)) for x in let.args)
        share = (abs(value) * 2.01 <= a.op("max", b)).choose(share.constant(0), share)
    total: Live = share[0]
    for k in range(1, share.size):
        total = total + share[k]
    return total


class LineErrors:
    """The errors of lines, which are outputs of the function that `b` builds: `slots` by line."""

    def __init__(self, b: TangentBuilder) -> None:
        self.b = b
        self.slots: dict[Loc | None, Variable] = {}

    def add(self, loc: Loc | None, share: Live) -> None:
        """Append statements that add to the error of a line."""
        b = self.b
        if loc not in self.slots:
            self.slots[loc] = b.variable(share.type, None, f"error_{len(self.slots)}", loc)
            b.variables.pop()  # it becomes an output
        b.store(self.slots[loc], (Live(b, b.load(self.slots[loc])) + share).value)
