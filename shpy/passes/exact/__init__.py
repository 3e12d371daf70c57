"""The elementary functions of strict mode at binary32: the exact value, rounded once, by way of binary64.

Stage: improve. For devices that have binary64. `FUNCTIONS["exp"]` is a formula whose arguments are binary32 Terms named
like the operation's. Its result is a binary64, or a binary32 where the formula has rounded once itself, because its
edge cases are cheaper to select afterwards. `rounded` adds what is common to all: the one rounding, and `EXCEPTIONS`.

The relative error of a formula is near 2**-47. So only inputs whose exact value lies that close to the middle between
two binary32 numbers can be misrounded: none to six of all inputs of a function. `EXCEPTIONS` lists them; those of odd
and even functions for positive inputs only.

    sinh = rounded("sinh")                 # lower makes sinh_strict of it
    z.mul_add(p, c)                        # one fma where the device is quick at that, else z * p + c

A formula has to be right in both spellings: products that must be exact have factors with few enough bits, and the
exceptions are those of either spelling.
"""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable, Mapping
from functools import reduce
from typing import Final

import numpy as np

from shpy.ir.exact import EVEN, FUNCTIONS as ELEMENTARY, ODD
from shpy.ir.types import Base
from shpy.passes.exact import circular, exponential, hyperbolic, inverse, logarithm, power, root
from shpy.passes.rounding import with_exceptions
from shpy.passes.terms import Term, replaced

__all__ = ["EXCEPTIONS", "FUNCTIONS", "rounded"]


FUNCTIONS: Final[Mapping[str, Callable[..., Term]]] = {
    **{f.__name__: f for f in (circular.sin, circular.cos, circular.tan)},
    **{f.__name__: f for f in (exponential.exp, exponential.exp2)},
    **{f.__name__: f for f in (inverse.asin, inverse.acos, inverse.atan, inverse.atan2)},
    **{f.__name__: f for f in (hyperbolic.sinh, hyperbolic.cosh, hyperbolic.tanh)},
    **{f.__name__: f for f in (hyperbolic.asinh, hyperbolic.acosh, hyperbolic.atanh)},
    **{f.__name__: f for f in (logarithm.log, logarithm.log2, logarithm.log10)},
    "pow": power.pow_,
    **{f.__name__: f for f in (root.rsqrt, root.hypot)},
}

_SELECTED: Final[Mapping[str, tuple[str, ...]]] = {
    "acos": ("0x1.110b46p-26", "0x1.04c444p-12"),
    "acosh": ("0x1.b121a6p+75", "0x1.6351d8p+94"),
    "asin": ("0x1.107434p-1",),
    "asinh": ("0x1.bacb4ap+24", "0x1.b121a6p+75", "0x1.6351d8p+94"),
    "atan": ("0x1.4f7476p-11", "0x1.ac6ff4p-10", "0x1.f83792p-9"),
    "atanh": ("0x1.ac6fd6p-10", "0x1.d5fa86p-10"),
    "cos": ("0x1.3170fp+63", "0x1.119ae6p+115"),
    "exp2": ("-0x1.e7526ep-6", "0x1.853a6ep-9"),
    "sinh": ("0x1.250bfep-11",),
    "tan": ("0x1.b0e75cp+59",),
}
EXCEPTIONS: Final[Mapping[str, tuple[str, ...]]] = {
    **_SELECTED,
    **{name: tuple(neighbours) for name, neighbours in logarithm.NEIGHBOURS.items()},
}
"""Inputs that a formula misrounds in one of its spellings; the positive ones of odd and even functions.

`rounded` selects the right results. A logarithm takes a neighbour of the input instead.
"""


def rounded(name: str) -> Callable[..., Term]:
    """Return the meaning of a strict function: the formula's result as a binary32, corrected at the exceptions."""
    formula = FUNCTIONS[name]
    inputs = np.array([float.fromhex(text) for text in _SELECTED.get(name, ())], np.float32)
    exceptions = list(zip(inputs.tolist(), ELEMENTARY[name](inputs).tolist(), strict=True)) if len(inputs) else []

    def meaning(*given: Term) -> Term:
        x, found = given[0], formula(*given)
        result = found if found.type.base is Base.F else found.based(Base.F)
        if len(exceptions) < 2:
            return with_exceptions(name, x, result, exceptions)
        size = abs(x) if name in ODD | EVEN else x
        rare = reduce(operator.or_, [size.equals(exception) for exception, _ in exceptions]).named("rare")
        return replaced(rare, {"result": result}, lambda: [with_exceptions(name, x, result, exceptions)])[0]

    meaning.__signature__ = inspect.signature(formula)  # type: ignore[attr-defined]
    return meaning
