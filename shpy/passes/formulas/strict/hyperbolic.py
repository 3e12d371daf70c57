"""Hyperbolic functions and their inverses by way of binary64.

Stage: improve. x is k ln 2 + r with |r| at most half of ln 2. The sine and the cosine are sums of those of r with
halves of 2**k + 2**-k and 2**k - 2**-k, the tangent is (e**2x - 1) / (e**2x + 1): where k is 0, nothing cancels, and
small numbers need no formula of their own. The inverses are logarithms of a quotient or sum u, 2 atanh(s) + k ln 2 for
s = (u - 2**k) / (u + 2**k), where u - 1 is written without cancellation.
"""

from __future__ import annotations

import math
from typing import Final

from shpy.ir.types import Base
from shpy.passes.formulas.parts import MAGIC, horner, sign_bit
from shpy.passes.formulas.strict.coefficients import (
    STRICT_ATANH,
    STRICT_COSH,
    STRICT_EXPM1,
    STRICT_LN2,
    STRICT_SINH,
    STRICT_TWICE_ATANH,
)
from shpy.passes.formulas.strict.exponential import clamped
from shpy.passes.formulas.terms import Term, where

_END: Final = 89.5
"""The |x| beyond which the sine and the cosine are infinite in binary32."""

_TANH_END: Final = 10.0
"""The |x| beyond which the tangent rounds to 1 in size."""

_MAGIC_BITS: Final = 0x4B400000
"""The bits of MAGIC in binary32."""

_ROOT_HALF: Final = 0x3F3504F3
"""The bits of the root of 1/2."""

_ONE: Final = 0x3F800000
"""The bits of 1."""


def _power(n: Term) -> Term:
    """Return 2**n in binary64 for an int n; 0 where n is -127 or less."""
    return ((n + 127).op("max", 0) << 23).based(Base.U).op("float_from_bits").based(Base.D)


def _whole(x: Term, scale: float) -> tuple[Term, Term]:
    """Return the whole number nearest to x * scale, as a binary64 and as an int."""
    shifted = (x * scale + MAGIC[Base.F]).named("shifted")
    k = (shifted - MAGIC[Base.F]).based(Base.D).named("k")
    return k, (shifted.op("bits_from_float").based(Base.I) - _MAGIC_BITS).named("n")


def _parts_of(x: Term) -> tuple[Term, Term, Term, Term]:
    """Return 4 sinh r, 4 cosh r, (2**k + 2**-k) / 8 and (2**k - 2**-k) / 8; see SINH and COSH."""
    near = clamped(x, -_END, _END).named("near")
    k, n = _whole(near, 1.442695)
    ln2, ln2_low = STRICT_LN2
    r = k.mul_add(-ln2_low, k.mul_add(-ln2, near.based(Base.D))).named("r")
    z = (r * r).named("z")
    up, down = _power(n - 3).named("up"), _power(-3 - n).named("down")
    return r * horner(z, STRICT_SINH), horner(z, STRICT_COSH), (up + down).named("total"), (up - down).named("rest")


def sinh(x: Term) -> Term:
    """Return the hyperbolic sine of x."""
    sine, cosine, total, rest = _parts_of(x)
    return where(x.equals(0), x, rest.mul_add(cosine, total * sine).based(Base.F))


def cosh(x: Term) -> Term:
    """Return the hyperbolic cosine of x."""
    sine, cosine, total, rest = _parts_of(x)
    return total.mul_add(cosine, rest * sine)


def tanh(x: Term) -> Term:
    """Return the hyperbolic tangent of x."""
    near = clamped(x, -_TANH_END, _TANH_END).named("near")
    k, n = _whole(near, 2.88539)
    d = near.based(Base.D)
    r = k.mul_add(-math.log(2), d + d).named("r")
    power, less_one = _power(n).named("power"), (r * horner(r, STRICT_EXPM1)).named("less_one")
    quotient = power.mul_add(less_one, power - 1) / power.mul_add(less_one, power + 1)
    return where(x.equals(0), x, quotient.based(Base.F))


def expm1(x: Term) -> Term:
    """Return e to the x, less 1; the last factor 2 keeps 2**k within binary32."""
    near = clamped(x, -20.0, 89.0).named("near")
    k, n = _whole(near, 1.442695)
    ln2, ln2_low = STRICT_LN2
    r = k.mul_add(-ln2_low, k.mul_add(-ln2, near.based(Base.D))).named("r")
    half = _power(n - 1).named("half")
    inside = half.mul_add(r * horner(r, STRICT_EXPM1), half - 0.5)
    return where(x.equals(0), x, (inside + inside).based(Base.F))


def log1p(x: Term) -> Term:
    """Return the logarithm of 1 + x, which is 2**k (1 + f); where k is 0, f is x."""
    moved = (1 + x).op("bits_from_float") + (_ONE - _ROOT_HALF)
    n = ((moved >> 23).based(Base.I) - 127).named("n")
    scale = (_power(3 - n) * 0.125).named("scale")
    f = x.based(Base.D).mul_add(scale, scale - 1).named("f")
    inside = _logarithm((f / (f + 2)).named("s"), n.based(Base.F).based(Base.D)).based(Base.F).named("inside")
    outside = where(x.equals(-1), x.constant(-math.inf), where(x < -1, math.nan, x))
    return where((x > -1) & (x < math.inf) & x.differs(0), inside, outside.named("outside"))


def _logarithm(s: Term, k: Term) -> Term:
    """Return 2 atanh s + k ln 2."""
    return k.mul_add(math.log(2), s * horner((s * s).named("z"), STRICT_TWICE_ATANH))


def _scale_of(u: Term) -> tuple[Term, Term]:
    """Return k and 2**-k, where 2**k is the power of two nearest to u, for u in [1, 2**129]."""
    moved = (u * 0.125).based(Base.F).op("bits_from_float") + (_ONE - _ROOT_HALF)
    n = ((moved >> 23).based(Base.I) - 127).named("n")
    return (n + 3).based(Base.F).based(Base.D).named("k"), (_power(-n) * 0.125).named("scale")


def asinh(x: Term) -> Term:
    """Return the inverse hyperbolic sine: log(a + sqrt(a * a + 1)), a = |x|; near 0 s = a / (1 + sqrt(a * a + 1))."""
    a = abs(x).named("a")
    d = a.based(Base.D)
    root = d.mul_add(d, 1.0).op("sqrt").named("root")
    u = (d + root).named("u")
    k, scale = _scale_of(u)
    m = u.mul_add(scale, -1.0).named("m")
    small = (a < 0.35).named("small")
    s = where(small, d, m) / where(small, root + 1, m + 2)
    size = _logarithm(s.named("s"), k).based(Base.F).named("size")
    return where(a < math.inf, where(sign_bit(x), -size, size), x)


def acosh(x: Term) -> Term:
    """Return the inverse hyperbolic cosine of x: log(x + sqrt(x * x - 1))."""
    d = x.based(Base.D)
    root = d.mul_add(d, -1.0).op("sqrt").named("root")
    k, scale = _scale_of(d + root)
    m = root.mul_add(scale, d.mul_add(scale, -1.0)).named("m")
    inside = _logarithm((m / (m + 2)).named("s"), k).based(Base.F).named("inside")
    return where(x < 1, math.nan, where(x < math.inf, inside, x))


def atanh(x: Term) -> Term:
    """Return the inverse hyperbolic tangent: log((1 + x) / (1 - x)) / 2; k is nearly the difference of exponents."""
    apart = (1 + x).op("bits_from_float").based(Base.I) - (1 - x).op("bits_from_float").based(Base.I)
    n = ((apart + (1 << 22)) >> 23).named("n")
    d, power = x.based(Base.D), _power(n).named("power")
    more, less = (1 + power).named("more"), (1 - power).named("less")
    s = (d.mul_add(more, less) / d.mul_add(less, more)).named("s")
    k = n.based(Base.F).based(Base.D).named("k")
    inside = k.mul_add(0.5 * math.log(2), s * horner((s * s).named("z"), STRICT_ATANH)).based(Base.F)
    a = abs(x).named("a")
    outside = where(a.equals(1), x * math.inf, math.nan)
    return where(a < 1, where(x.equals(0), x, inside), outside)
