"""Logarithms by way of binary64.

Stage: improve. x is 2**k * (1 + f) with 1 + f between the roots of 1/2 and 2. Binary32 holds f and k exactly. The
logarithm of 1 + f is twice the inverse hyperbolic tangent of s = f / (2 + f).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from shpy.ir.types import Base
from shpy.passes.exact.coefficients import LOG2, LOG10, TWICE_ATANH
from shpy.passes.exact.parts import horner
from shpy.passes.strict.logarithm import INFINITY, Pair, edges, mantissa_and_exponent
from shpy.passes.terms import Term, replaced, where

_LEAST_NORMAL: Final = 2.0**-126

NEIGHBOURS: Final[Mapping[str, Mapping[str, str]]] = {
    "log": {
        "0x1.bacb4ap+25": "0x1.bacb4cp+25",
        "0x1.b121a6p+76": "0x1.b121a8p+76",
        "0x1.6351d8p+95": "0x1.6351dap+95",
    },
    "log10": {
        "0x1.fddcf4p-98": "0x1.fddcf2p-98",
        "0x1.1727b8p-91": "0x1.1727bap-91",
        "0x1.5cf1a6p-88": "0x1.5cf1a8p-88",
    },
}
"""Inputs that are misrounded, and a neighbour of each, whose logarithm rounds to the right result."""


def _parted(x: Term, low: float, high: float, neighbours: Mapping[str, str] | None = None) -> Pair:
    """(s, k) in binary64; x that is not between `low` and `high` takes a branch, as denormals and exceptions do.

    At the edges k is the result, an infinity or NaN, whatever finite number is added to it.
    """

    def others() -> Pair:
        tiny = (x < _LEAST_NORMAL).named("tiny")
        near = where(tiny, x * 2.0**23, x)
        for given, neighbour in (neighbours or {}).items():
            near = where(x.equals(float.fromhex(given)), float.fromhex(neighbour), near)
        return near, edges(x, where(tiny, x.constant(-150), -127))

    ordinary = (x >= low) & (x < high)
    rare = (~ordinary).named("rare")
    near, bias = replaced(rare, {"near": x, "bias": x.constant(-127)}, others)
    mantissa, exponent = mantissa_and_exponent(near)
    k, f = (exponent + bias).based(Base.D), (mantissa - 1).based(Base.D)
    return (f / (f + 2)).named("s"), k.named("k")


def log(x: Term) -> Term:
    """Natural logarithm."""
    s, k = _parted(x, _LEAST_NORMAL, 2.0**25, NEIGHBOURS["log"])
    return s.mul_add(horner((s * s).named("z"), TWICE_ATANH), k * math.log(2))


def log2(x: Term) -> Term:
    """Binary logarithm."""
    s, k = _parted(x, _LEAST_NORMAL, INFINITY)
    return s.mul_add(horner((s * s).named("z"), LOG2), k)


def log10(x: Term) -> Term:
    """Decimal logarithm."""
    s, k = _parted(x, 2.0**-87, INFINITY, NEIGHBOURS["log10"])
    return s.mul_add(horner((s * s).named("z"), LOG10), k * math.log10(2))
