"""Exponentials and hyperbolic functions, from operations that every target rounds alike.

Stage: improve. e to the x is 2**k times e to the r with |r| at most half of ln 2. e to the r is 1 + r + a small rest,
which are added last. The scheme is Tang's (1989), with a longer polynomial in place of his table.
"""

from __future__ import annotations

import math
from typing import Final

from shpy.ir.types import Base
from shpy.passes.formulas.coefficients import (
    EXP,
    EXP2,
    INVERSE_LN2,
    LN2,
    LN2_HALVES,
    LN2_ROUNDED,
    LOG2_10,
    LOG10_2,
    SINH,
    TANH,
)
from shpy.passes.formulas.parts import (
    MAGIC,
    TINY,
    constants,
    fast_two_sum,
    polynomial,
    scaled_by,
    split,
    two_product,
    two_sum,
    whole_and_shifted,
)
from shpy.passes.formulas.terms import Term, where

# Outside these ends e to the x, or 2 to the x, is 0 or infinite.
_EXP_ENDS: Final = {Base.F: (-105.0, 90.0), Base.D: (-747.0, 711.0)}
_EXP2_ENDS: Final = {Base.F: (-152.0, 130.0), Base.D: (-1077.0, 1026.0)}
_EXP10_ENDS: Final = {Base.F: (-46.0, 39.0), Base.D: (-324.5, 309.0)}
_LINEAR: Final = 0.34
"""The size of a number below which expm1 is the polynomial of `exp` less 1, for which nothing has to be reduced."""
_TANH_END: Final = {Base.F: 32.0, Base.D: 64.0}


def _between(x: Term, ends: tuple[float, float]) -> Term:
    """Return x clamped to the two ends; NaN stays."""
    low, high = ends
    return where(x > high, high, where(x < low, low, x))


def exp_parts(x: Term) -> tuple[Term, Term, Term, Term]:
    """Return (high, low, k, shifted): e to the x is (high + low) * 2**k, and shifted is k + MAGIC."""
    ln2, ln2_low = constants(x, LN2)
    k, shifted = whole_and_shifted(x * constants(x, INVERSE_LN2)[0])
    above, below = x - k.named("k") * ln2, k * ln2_low
    r = (above - below).named("r")
    lost = (above - r) - below
    high, low = fast_two_sum(r.constant(1), r)
    low = (low + (r * r * polynomial(r, EXP) + lost)).named("low")
    return high.named("high"), low, k, shifted.named("shifted")


def exp(x: Term) -> Term:
    """Return e to the x."""
    high, low, _, shifted = exp_parts(_between(x, _EXP_ENDS[x.type.base]).named("near"))
    return scaled_by(high + low, shifted)


def exp2(x: Term) -> Term:
    """Return 2 to the x."""
    near = _between(x, _EXP2_ENDS[x.type.base]).named("near")
    k, shifted = whole_and_shifted(near)
    return scaled_by(two_to_the((near - k).named("r"), None), shifted.named("shifted"))


def exp10(x: Term) -> Term:
    """Return 10 to the x: 2 to the k + r, with r = (x - k log10(2)) log2(10) in two parts."""
    near = _between(x, _EXP10_ENDS[x.type.base]).named("near")
    (scale, scale_low), (step, step_low) = constants(x, LOG2_10), constants(x, LOG10_2)
    k, shifted = whole_and_shifted(near * scale)
    above, below = near - k.named("k") * step, k * step_low
    rest = (above - below).named("rest")
    lost = (above - rest) - below
    r, low = two_product(rest, rest.constant(scale))
    return scaled_by(two_to_the(r, low + (rest * scale_low + lost * scale)), shifted.named("shifted"))


def expm1(x: Term) -> Term:
    """Return e to the x, less 1."""
    low_end, high_end = _EXP_ENDS[x.type.base]
    near = _between(x, (0.5 * low_end, high_end)).named("near")
    high, low, _, shifted = exp_parts(near)
    total, lost = two_sum(scaled_by(high, shifted), -x.constant(1))
    far = (total + (lost + scaled_by(low, shifted))).named("far")
    far = where(total < math.inf, far, total)
    linear = where(x.equals(0), x, x + x * x * polynomial(near, EXP))
    return where(abs(x) < _LINEAR, linear, far)


def two_to_the(r: Term, low: Term | None) -> Term:
    """Return 2 to the r + low, for |r| up to 1/2 and a `low` that is far smaller.

    In binary32 the rounding of r * ln 2 costs a quarter of a unit in the last place. A power needs that quarter for the
    roundings of its logarithm, so the product is in two parts where `low` is given.
    """
    ln2, ln2_low = constants(r, LN2_ROUNDED)
    if low is not None and r.type.base is Base.F:
        ln2_upper, ln2_lower = constants(r, LN2_HALVES)
        upper, lower = split(r)
        linear, linear_low = (upper * ln2_upper).named("linear"), upper * ln2_lower + lower * ln2
    else:
        linear, linear_low = (r * ln2).named("linear"), r * ln2_low
    high, lost = fast_two_sum(linear.constant(1), linear)
    rest = (lost + (r * r * polynomial(r, EXP2) + linear_low)).named("rest")
    if low is not None:
        rest = rest + low * ln2 * (high + rest)
    return high + rest


def _halves(x: Term) -> tuple[Term, Term, Term, Term]:
    """Return (high, low, inverse, shifted), from which hyperbolic functions of x are computed.

    exp(|x|) / 2 is (high + low) * 2**k, exp(-|x|) / 2 is inverse * 2**k, and `shifted` is k + MAGIC.
    """
    a = _between(abs(x), _EXP_ENDS[x.type.base]).named("a")
    high, low, k, shifted = exp_parts(a)
    magic = x.constant(MAGIC[x.type.base])
    enough = where(k > 60, 60, k)
    inverse = scaled_by(1 / (high + low), magic - (enough + enough)).named("inverse")
    return high, low, inverse, shifted - 1


def sinh(x: Term) -> Term:
    """Return the hyperbolic sine of x."""
    z = (x * x).named("z")
    high, low, inverse, shifted = _halves(x)
    total, lost = two_sum(high, -inverse)
    far = scaled_by(total + (lost + low), shifted).named("far")
    near = (x + x * (z * polynomial(z, SINH))).named("near")
    return where(abs(x) < 1, near, where(x < 0, -far, far))


def cosh(x: Term) -> Term:
    """Return the hyperbolic cosine of x."""
    high, low, inverse, shifted = _halves(x)
    total, lost = two_sum(high, inverse)
    return scaled_by(total + (lost + low), shifted)


def tanh(x: Term) -> Term:
    """Return the hyperbolic tangent of x."""
    a = _between(abs(x), (0.0, _TANH_END[x.type.base])).named("a")
    z = (x * x).named("z")
    high, low, _, shifted = exp_parts(a + a)
    far = (1 - 2 / (scaled_by(high + low, shifted) + 1)).named("far")
    near = where(a < TINY[x.type.base], x, x + x * (z * polynomial(z, TANH)))
    return where(a < 0.625, near, where(x < 0, -far, far))


def rsqrt(x: Term) -> Term:
    """Return 1 / sqrt(x), rounded twice: after the root and after the division."""
    return 1 / x.op("sqrt")
