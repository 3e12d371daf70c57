"""The elementary functions of strict mode at binary32: the exact value, rounded once, by way of binary64.

Stage: improve. For devices that have binary64. `FUNCTIONS["exp"]` is a formula whose arguments are binary32 Terms named
like the operation's. Its result is a binary64, or a binary32 where the formula itself has rounded once, because its
edge cases are cheaper to select afterwards. `rounded` adds the parts common to all: the one rounding, and `EXCEPTIONS`.

The relative error of a formula is below 2**-46. So it can misround only inputs whose exact value lies that close to the
middle between two binary32 numbers: at most six inputs of a function. `EXCEPTIONS` lists them; for odd and even
functions it lists positive inputs only. Most formulas have no exceptions, as their coefficients were chosen for that.

    sinh = rounded("sinh")                 # lower makes sinh_strict of it
    z.mul_add(p, c)                        # one fma where the device is quick at that, else z * p + c

A formula has to be right with and without fma: products that must be exact have factors with few enough bits, and
`EXCEPTIONS` lists the inputs that either spelling misrounds.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from shpy.ir.exact import FUNCTIONS as ELEMENTARY
from shpy.ir.types import Base
from shpy.passes.formulas.portable import cube_root
from shpy.passes.formulas.rounding import with_exceptions
from shpy.passes.formulas.strict import circular, error, exponential, hyperbolic, inverse, logarithm, power, root
from shpy.passes.formulas.terms import Term

FUNCTIONS: Final[Mapping[str, Callable[..., Term]]] = {
    **{f.__name__: f for f in (circular.sin, circular.cos, circular.tan)},
    **{f.__name__: f for f in (exponential.exp, exponential.exp2)},
    **{f.__name__: f for f in (inverse.asin, inverse.acos, inverse.atan, inverse.atan2)},
    **{f.__name__: f for f in (hyperbolic.sinh, hyperbolic.cosh, hyperbolic.tanh)},
    **{f.__name__: f for f in (hyperbolic.asinh, hyperbolic.acosh, hyperbolic.atanh)},
    **{f.__name__: f for f in (logarithm.log, logarithm.log2, logarithm.log10)},
    **{f.__name__: f for f in (hyperbolic.expm1, hyperbolic.log1p, exponential.exp10)},
    **{f.__name__: f for f in (error.erf, error.erfc, circular.sinpi, circular.cospi)},
    "cbrt": cube_root.rounded_once,
    "pow": power.pow_,
    **{f.__name__: f for f in (root.rsqrt, root.hypot)},
}

EXCEPTIONS: Final[Mapping[str, tuple[str, ...]]] = {
    "acosh": ("0x1.b121a6p+75", "0x1.6351d8p+94"),
    "asinh": ("0x1.bacb4ap+24", "0x1.b121a6p+75", "0x1.6351d8p+94"),
    "atan": ("0x1.1ad646p-4",),
    "cos": ("0x1.3170fp+63", "0x1.119ae6p+115"),
    "erfc": ("-0x1.d93ec4p-17",),
    "exp2": ("-0x1.e7526ep-6",),
    "expm1": ("0x1.6a09e6p-24", "0x1.94c582p-22", "0x1.645636p-19"),
    "log1p": (
        "-0x1.dfff6ap-17",
        "-0x1.1fffcap-17",
        "-0x1.7ffffap-21",
        "0x1.bdb59cp-18",
        "0x1.0f1fd6p+3",
        "0x1.b121a6p+76",
        "0x1.6351d8p+95",
    ),
    "log": ("0x1.bacb4ap+25", "0x1.b121a6p+76", "0x1.6351d8p+95"),
}
"""Inputs that a formula misrounds in one of its spellings; the positive ones of odd and even functions."""


def rounded(name: str) -> Callable[..., Term]:
    """Return the meaning of a strict function: the formula's result as a binary32, corrected at the exceptions."""
    formula = FUNCTIONS[name]
    inputs = np.array([float.fromhex(text) for text in EXCEPTIONS.get(name, ())], np.float32)
    exceptions = list(zip(inputs.tolist(), ELEMENTARY[name](inputs).tolist(), strict=True)) if len(inputs) else []

    def meaning(*terms: Term) -> Term:
        x, value = terms[0], formula(*terms)
        result = value if value.type.base is Base.F else value.based(Base.F)
        return with_exceptions(name, x, result, exceptions)

    meaning.__signature__ = inspect.signature(formula)  # type: ignore[attr-defined]
    return meaning
