"""Division and square root rounded correctly, for devices that do not: from an estimate and its integer remainder.

Stage: improve. A quotient of mantissas is wanted to 25 bits; the device's own gives it to within 64 units in the last
place (a root 16), and the remainder, exact modulo 2**32, tells how far off it is. Zeros, infinities, denormals and NaN
are the device's affair.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from shpy.ir.types import Base
from shpy.passes.terms import Term, where

__all__ = ["CORRECTED"]


def _mantissa(bits: Term) -> Term:
    """The mantissa with its hidden bit: 2**23 up to 2**24."""
    return (bits & 0x7FFFFF) | 0x800000


def _exponent(bits: Term) -> Term:
    """The biased exponent, as an int."""
    return ((bits >> 23) & 255).based(Base.I)


def _step(rest: Term, by: Term) -> Term:
    """By how many the quotient must grow, by and large: the remainder divided by the divisor."""
    estimate = rest.based(Base.F) / by.based(Base.F)
    return estimate.op("floor").based(Base.I).named("off")


def _rounded(q: Term, exact: Term, n: Term) -> Term:
    """Q, of 25 bits, to the nearest 24, half to even; nothing follows it where it is exact. Times 2**(n - 23)."""
    sticky = where(exact, q.constant(0), 1)
    up = q & 1 & (sticky | (q >> 1))
    mantissa = ((q >> 1) + up).based(Base.F) * 2.0**-23
    return mantissa.op("ldexp", n)


def div(a: Term, b: Term) -> Term:
    """A / b."""
    a_bits, b_bits = a.op("bits_from_float").named("a_bits"), b.op("bits_from_float").named("b_bits")
    m, d = _mantissa(a_bits).named("m"), _mantissa(b_bits).named("d")
    less = (m < d).named("less")
    shift = where(less, m.constant(25), 24)
    by = d.based(Base.I).named("by")
    estimate = m.based(Base.F) / by.based(Base.F) * where(less, a.constant(2.0**25), 2.0**24)
    q = estimate.based(Base.U).named("q")
    rest = (m.op("shl", shift) - q * d).based(Base.I).named("rest")
    for _ in range(2):
        off = _step(rest, by)
        q, rest = (q + off.based(Base.U)).named("q"), (rest - off * by).named("rest")
    off = where(rest < 0, rest.constant(-1), where(rest >= by, rest.constant(1), 0)).named("off")
    q, rest = (q + off.based(Base.U)).named("q"), (rest - off * by).named("rest")
    a_exponent, b_exponent = _exponent(a_bits).named("a_exponent"), _exponent(b_bits).named("b_exponent")
    n = a_exponent - b_exponent - where(less, a_exponent.constant(1), 0)
    size = _rounded(q, rest.equals(0), n).named("size")
    small = n < -126  # a denormal result would be rounded twice
    plain = small | a_exponent.op("min", b_exponent).equals(0) | a_exponent.op("max", b_exponent).equals(255)
    negative = (a_bits ^ b_bits) >= a_bits.constant(2**31)
    return where(plain, a / b, where(negative, -size, size))


def sqrt(x: Term) -> Term:
    """The square root: that of the mantissa times an even power of two."""
    bits = x.op("bits_from_float").named("bits")
    e = _exponent(bits).named("e")
    odd = (e & 1).named("odd")
    m = _mantissa(bits).op("shl", 2 - odd).named("m")
    q = (m.based(Base.F).op("sqrt") * 4096).based(Base.U).named("q")
    rest = ((m << 24) - q * q).based(Base.I).named("rest")
    for _ in range(2):
        whole = q.based(Base.I)
        off = _step(rest, whole + whole)
        rest = (rest - off * (whole + whole + off)).named("rest")
        q = (q + off.based(Base.U)).named("q")
    for _ in range(2):
        # The root is the greatest number whose square is no greater: one up or down may be left.
        whole = q.based(Base.I)
        off = where(rest < 0, rest.constant(-1), where(rest > whole + whole, rest.constant(1), 0)).named("off")
        rest = (rest - off * (whole + whole + off)).named("rest")
        q = (q + off.based(Base.U)).named("q")
    root = _rounded(q, rest.equals(0), ((e - 152 + odd) >> 1) + 12)
    return where((e.equals(0)) | (e >= 255) | (x < 0), x.op("sqrt"), root)


CORRECTED: Final[Mapping[str, Callable[..., Term]]] = {"div": div, "sqrt": sqrt}
"""What an operation of binary32 is lowered to on a device that gets it wrong."""
