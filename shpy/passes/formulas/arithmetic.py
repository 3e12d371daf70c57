"""Correctly rounded operations of binary32, in integers, for devices that round them wrong or lack them.

Stage: improve. Division and square root start from the device's own result, which may be off by 64 units in the last
place (a root by 16). The formulas need 25 bits of it: the remainder, exact modulo 2**32, gives the correction. Zeros,
denormals, NaN and roots of infinity are left to the device. `fma` computes with integers alone where all operands are
finite, so that denormals are exact even on a device that flushes them to zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from shpy.ir.types import Base
from shpy.passes.formulas.terms import Term, where


def _mantissa(bits: Term) -> Term:
    """Return the mantissa with its hidden bit, in [2**23, 2**24)."""
    return (bits & 0x7FFFFF) | 0x800000


def _exponent(bits: Term) -> Term:
    """Return the biased exponent, as an int."""
    return ((bits >> 23) & 255).based(Base.I)


def _step(rest: Term, by: Term) -> Term:
    """Return the estimated correction of a quotient: the remainder divided by the divisor, rounded down."""
    estimate = rest.based(Base.F) / by.based(Base.F)
    return estimate.op("floor").based(Base.I).named("off")


def _rounded(q: Term, exact: Term, n: Term) -> Term:
    """Return q / 2 * 2**(n - 23), rounded from 25 to 24 bits, half to even; `exact`: no bits of the result follow q."""
    sticky = where(exact, q.constant(0), 1)
    up = q & 1 & (sticky | (q >> 1))
    mantissa = ((q >> 1) + up).based(Base.F) * 2.0**-23
    return mantissa.op("ldexp", n)


def div(a: Term, b: Term) -> Term:
    """Return a / b."""
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
    # A device may multiply by 1 / b, which underflows to 0 for a large b, and infinity times 0 is NaN.
    unchanged = a_exponent.equals(255) & (b_exponent >= 1) & (b_exponent < 255)
    special = where(unchanged, where(b < 0, -a, a), a / b)
    return where(plain, special, where(negative, -size, size))


def sqrt(x: Term) -> Term:
    """Return the square root, from the root of the mantissa and half an even exponent."""
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
        # The root is the greatest integer whose square is not above the mantissa; each step corrects q by one.
        whole = q.based(Base.I)
        off = where(rest < 0, rest.constant(-1), where(rest > whole + whole, rest.constant(1), 0)).named("off")
        rest = (rest - off * (whole + whole + off)).named("rest")
        q = (q + off.based(Base.U)).named("q")
    root = _rounded(q, rest.equals(0), ((e - 152 + odd) >> 1) + 12)
    return where((e.equals(0)) | (e >= 255) | (x < 0), x.op("sqrt"), root)


def _leading(x: Term) -> Term:
    """Return the position of the highest bit of a uint other than 0, as an int, read from the exponent of a float."""
    # The bit below the highest one is cleared, so that the conversion cannot round up to the next power of two.
    return _exponent((x & ~(x >> 1)).based(Base.F).op("bits_from_float")) - 127


def _normalised(bits: Term) -> tuple[Term, Term]:
    """Return the mantissa m, 2**23 up to 2**24, and the exponent n of a number m * 2**n; zero is 0 * 2**-649."""
    field, low = _exponent(bits), bits & 0x7FFFFF
    up = where(low.equals(0), field.constant(500), 23 - _leading(low | 1)).named("up")
    denormal = field.equals(0)
    return where(denormal, low.op("shl", up), low | 0x800000), where(denormal, -149 - up, field - 150)


def _assembled(sign: Term, m: Term, e: Term) -> Term:
    """Return the float with this sign bit nearest to m * 2**(e - 158), half to even; m has its highest bit set."""
    less = (1 - e).op("max", 0).op("min", 31).named("less")
    kept = m.op("shr", less)
    m = (kept | where(kept.op("shl", less).equals(m), m.constant(0), 1)).named("m")
    up = where((m & 255) > 128 - ((m >> 8) & 1), m.constant(1), 0)
    field = e.op("max", 1).op("min", 255) - 1
    size = (m >> 8) + up + (field << 23).based(Base.U)
    return (sign | where(e >= 255, size.constant(0x7F800000), size)).op("float_from_bits")


_Wide = tuple[Term, Term]
"""A whole number of 64 bits: its higher and its lower half, as uints."""


def _shifted(x: _Wide, n: Term) -> _Wide:
    """Return x shifted right by 0 to 63 bits; its lowest bit is also set if any bit that was shifted out was set."""
    high, low = x
    by = (n & 31).named("by")
    # Two shifts, since a single shift by 32 would be a shift by 0.
    out_of_high, out_of_low = ((half << 1).op("shl", 31 - by) for half in x)
    near = high.op("shr", by), low.op("shr", by) | out_of_high
    far = (n >= 32).named("far")
    lost = where(far, out_of_high | low, out_of_low)
    jam = where(lost.equals(0), low.constant(0), 1)
    return where(far, high.constant(0), near[0]), where(far, near[0], near[1]) | jam


def _negated(x: _Wide, condition: Term) -> _Wide:
    """Return -x modulo 2**64 where the condition holds, else x."""
    high, low = x
    carry = where(low.equals(0), low.constant(1), 0)
    return where(condition, ~high + carry, high), where(condition, low.constant(0) - low, low)


def _product(a: Term, b: Term) -> _Wide:
    """Return a * b * 2**14 for mantissas of 24 bits, from halves of 12 bits."""
    a_high, a_low, b_high, b_low = a >> 12, a & 4095, b >> 12, b & 4095
    middle = (a_high * b_low + a_low * b_high).named("middle")
    low = (a_low * b_low + ((middle & 4095) << 12)).named("low")
    high = a_high * b_high + (middle >> 12) + (low >> 24)
    return (high << 6) | ((low & 0xFFFFFF) >> 18), low << 14


def fma(a: Term, b: Term, c: Term) -> Term:
    """Return a * b + c, rounded once, from a sum of 64 bits whose lowest bit is set if bits were shifted out."""
    bits = [x.op("bits_from_float").named(f"{name}_bits") for x, name in ((a, "a"), (b, "b"), (c, "c"))]
    (a_m, a_e), (b_m, b_e), (c_m, c_e) = map(_normalised, bits)
    product, term = _product(a_m, b_m), (c_m << 6, c_m.constant(0))  # times 2**14 and 2**38
    apart = (c_e - a_e - b_e - 24).named("apart")
    c_first = (apart >= 0).named("c_first")
    first, second = ([where(c_first, x, y) for x, y in zip(*pair, strict=True)]
                     for pair in ((term, product), (product, term)))  # fmt: skip
    product_sign = ((bits[0] ^ bits[1]) & 0x80000000).named("product_sign")
    c_sign = (bits[2] & 0x80000000).named("c_sign")
    distance = abs(apart).op("min", 63).named("distance")
    high, low = _negated(_shifted((second[0], second[1]), distance), product_sign.differs(c_sign))
    sum_low = (first[1] + low).named("sum_low")
    sum_high = first[0] + high + where(sum_low < low, low.constant(1), 0)
    below = (sum_high >= 0x80000000).named("below")
    high, low = _negated((sum_high, sum_low), below)
    sign = where(c_first, c_sign, product_sign) ^ where(below, c_sign.constant(0x80000000), 0)
    # Shift the highest bit to the top of its half.
    short, nothing = high.equals(0).named("short"), (high | low).equals(0).named("nothing")
    top, rest = where(short, low, high), where(short, low.constant(0), low)
    up = (31 - _leading(top | 1)).named("up")
    jam = where(rest.op("shl", up).equals(0), top.constant(0), 1)
    m = top.op("shl", up) | (rest >> 1).op("shr", 31 - up) | jam
    e = where(c_first, c_e - 38, a_e + b_e - 14) - up + where(short, up.constant(158), 190)
    finite = _assembled(where(nothing, product_sign & c_sign, sign), m, where(nothing, e.constant(0), e))
    factors = _exponent(bits[0]).op("max", _exponent(bits[1]))
    special = where(factors < 255, c, a * b + c)
    return where(factors.op("max", _exponent(bits[2])).equals(255), special, finite)


CORRECTED: Final[Mapping[str, Callable[..., Term]]] = {"div": div, "sqrt": sqrt, "fma": fma}
"""Replacements of operations of binary32 for a device that rounds them wrong."""
