"""Sine, cosine, tangent and their inverses, from operations that every target rounds alike.

Stage: improve. Angles are reduced to at most pi / 4 in size with pi / 2 in three parts (Cody and Waite 1980). The
reduced angle is the sum of two parts, so that cancellation near a multiple of pi / 2 loses no digits. Angles beyond
2**20, which are rare, are reduced by `payne_hanek`.
"""

from __future__ import annotations

from typing import Final

from shpy.ir.types import Base
from shpy.passes.formulas.coefficients import ASIN, ATAN, COS, HALF_PI, PI, SIN, TWO_BY_PI
from shpy.passes.formulas.parts import (
    MAGIC,
    TINY,
    constants,
    exact_quotient_rest,
    fast_two_sum,
    halves_of,
    polynomial,
    sign_bit,
    two_product,
    two_sum,
    whole_and_shifted,
)
from shpy.passes.formulas.portable.payne_hanek import FAR
from shpy.passes.formulas.terms import Term, joined, replaced, where

Pair = tuple[Term, Term]
Triple = tuple[Term, Term, Term]

INFINITY: Final = float("inf")


def _times_part(k: Term, part: float) -> Pair:
    """Return the whole number k < 2**20 times a constant, exactly: one product in binary64, two parts in binary32."""
    factor = k.constant(part)
    if k.type.base is Base.D:
        return k * factor, k.constant(0)
    product = (k * factor).named("product")
    coarse = 512 * MAGIC[Base.F]
    k_high = (k + coarse - coarse).named("k_high")
    k_low = (k - k_high).named("k_low")
    high, low = halves_of(part)
    rest = (k_high * high - product) + k_high * low
    return product, (rest.named("rest") + k_low * high + k_low * low).named("product_low")


def _reduced(x: Term) -> Triple:
    """Return (high, low, k): x is k * pi / 2 + high + low plus a multiple of 2 * pi; |high| is at most pi / 4."""

    def far() -> list[Term]:
        reductions = [x[n].op("payne_hanek", type=x.type.sized(3)) for n in range(x.type.size)]
        return [joined(*(triple[n] for triple in reductions)) for n in range(3)]

    near = dict(zip(("high", "low", "k"), _near_reduced(x), strict=True))
    high, low, k = replaced((abs(x) > FAR).named("far"), near, far)
    return high, low, k


def _near_reduced(x: Term) -> Triple:
    """Return (high, low, k) for |x| up to FAR; the result for larger x is arbitrary."""
    first, second, third, *fourth = constants(x, HALF_PI)
    k = whole_and_shifted(x * constants(x, TWO_BY_PI)[0])[0].named("near_k")
    product, rest = _times_part(k, first)
    left = (x - product).named("left")
    if x.type.base is Base.F:
        left, lost = two_sum(left, -rest)
    product, rest = _times_part(k, second)
    left, more = two_sum(left, -product)
    if x.type.base is Base.F:
        tail = (lost + more - rest).named("lost") - k * third
    else:
        left, last = two_sum(left, -(k * third))
        tail = more + last - k * fourth[0]
    high, low = fast_two_sum(left, tail.named("tail"))
    return high.named("near_high"), low.named("near_low"), k


def quadrant(k: Term) -> Pair:
    """Return whether k is odd, and whether k mod 4 is 2 or 3."""
    by_2 = (k * 0.5).named("k_by_2")
    pairs = by_2.op("floor").named("pairs")
    by_4 = (pairs * 0.5).named("k_by_4")
    return by_2.differs(pairs).named("odd"), by_4.differs(by_4.op("floor")).named("opposite")


def _sine_rest(high: Term, low: Term, z: Term) -> Term:
    """Return sin(high + low) - high."""
    return (high * (z * polynomial(z, SIN)) + low).named("sine_rest")


def _cosine(high: Term, low: Term, z: Term) -> Pair:
    """Return the cosine of high + low as the sum of two parts whose bits may overlap."""
    by_2 = (z * 0.5).named("z_by_2")
    whole = (1 - by_2).named("whole")
    rest = (z * z * polynomial(z, COS) - high * low).named("rest")
    return whole, (((1 - whole) - by_2) + rest).named("cosine_rest")


def sin(x: Term) -> Term:
    """Return the sine of x."""
    high, low, k = _reduced(x)
    odd, opposite = quadrant(k)
    z = (high * high).named("z")
    whole, rest = _cosine(high, low, z)
    size = where(odd, whole + rest, high + _sine_rest(high, low, z)).named("size")
    return where(abs(x) < TINY[x.type.base], x, where(opposite, -size, size))


def cos(x: Term) -> Term:
    """Return the cosine of x."""
    high, low, k = _reduced(x)
    odd, opposite = quadrant(k)
    z = (high * high).named("z")
    whole, rest = _cosine(high, low, z)
    size = where(odd, high + _sine_rest(high, low, z), whole + rest).named("size")
    return where(odd ^ opposite, -size, size)


def tan(x: Term) -> Term:
    """Return the tangent of x: sine and cosine, each in two parts, divided with a correction from the remainder."""
    high, low, k = _reduced(x)
    odd, _ = quadrant(k)
    z = (high * high).named("z")
    sine, sine_low = fast_two_sum(high, _sine_rest(high, low, z))
    cosine, cosine_low = fast_two_sum(*_cosine(high, low, z))
    n, n_low = where(odd, -cosine, sine).named("n"), where(odd, -cosine_low, sine_low)
    d, d_low = where(odd, sine, cosine).named("d"), where(odd, sine_low, cosine_low)
    q = (n / d).named("q")
    rest = exact_quotient_rest(n, d, q) + (n_low - q * d_low)
    return where(abs(x) < TINY[x.type.base], x, q + rest / d)


def _of_half_turns(x: Term) -> tuple[Term, Term, Term, Term]:
    """Return (f, odd, sine, cosine): f is x less the nearest whole number, which is odd or not; those of pi f."""
    k = x.op("round").named("k")
    half = (k * 0.5).named("half")
    f = (x - k).named("f")
    a = abs(f).named("a")
    steep = (a > 0.25).named("steep")
    g = where(steep, 0.5 - a, a).named("g")
    pi, pi_low = constants(x, PI)
    high, low = two_product(g, g.constant(pi))
    low = (low + g * pi_low).named("low")
    z = (high * high).named("z")
    whole, rest = _cosine(high, low, z)
    sine = where(g < 2.0**-64, high, high + _sine_rest(high, low, z)).named("sine")  # the low part may be denormal
    cosine = (whole + rest).named("cosine")
    size = where(steep, cosine, sine)
    return f, half.differs(half.op("floor")), where(f < 0, -size, size), where(steep, sine, cosine)


def sinpi(x: Term) -> Term:
    """Return the sine of pi x; a zero has the sign of x (IEEE 754-2019 section 9.2.1)."""
    f, odd, sine, _ = _of_half_turns(x)
    return where(f.equals(0), where(sign_bit(x), x.constant(-0.0), 0.0), where(odd, -sine, sine))


def cospi(x: Term) -> Term:
    """Return the cosine of pi x; all zeros are positive."""
    _, odd, _, cosine = _of_half_turns(x)
    return where(odd & cosine.differs(0), -cosine, cosine)


def _asin_rest(a: Term) -> Term:
    """Return (asin(a) - a) / a for 0 <= a <= 1/2."""
    z = (a * a).named("z")
    return z * polynomial(z, ASIN)


def _far_root(a: Term) -> Pair:
    """Return the root of (1 - a) / 2 in two parts, for 1/2 <= a <= 1."""
    part = ((1 - a) * 0.5).named("part")
    root = part.op("sqrt").named("root")
    square, lost = two_product(root, root)
    return root, where(root > 0, ((part - square) - lost) / (root + root), 0.0).named("root_low")


def asin(x: Term) -> Term:
    """Return the arc sine of x; from 1/2 on it is pi/2 minus two arc sines of sqrt((1 - x) / 2)."""
    a = abs(x).named("a")
    near = (a < 0.5).named("near")
    root, root_low = _far_root(a)
    rest = (root * _asin_rest(root)).named("rest")
    half_pi, half_pi_low = constants(x, HALF_PI)[0], constants(x, PI)[1] * 0.5
    if x.type.base is Base.D:
        half_pi = constants(x, PI)[0] * 0.5
    # pi/2 - 2 root - 2 rest: the first difference is computed in two parts.
    twice = root + root
    first, lost = fast_two_sum(x.constant(half_pi), -twice)
    far = (first + (lost - (2 * (rest + root_low) - half_pi_low))).named("far")
    return where(near, x + x * _asin_rest(x), where(x < 0, -far, far))


def acos(x: Term) -> Term:
    """Return the arc cosine of x."""
    a = abs(x).named("a")
    near = (a < 0.5).named("near")
    root, root_low = _far_root(a)
    t = where(near, x, root).named("t")
    rest = (t * _asin_rest(t)).named("rest")
    pi, pi_low = constants(x, PI)
    first, lost = fast_two_sum(x.constant(pi * 0.5), -t)
    middle = first + (lost - (rest - pi_low * 0.5))
    small = (rest + root_low).named("small")
    twice = root + root
    first, lost = fast_two_sum(x.constant(pi), -twice)
    left = first + (lost - (2 * small - pi_low))
    return where(near, middle.named("middle"), where(x < 0, left.named("left"), 2 * (root + small)))


def _atan_of_quotient(smaller: Term, larger: Term) -> Pair:
    """Return the arc tangent of smaller / larger, both positive, as the sum of two numbers.

    From a quotient of 1/2 on, it is pi/4 plus the arc tangent of a smaller quotient.
    """
    wide = (smaller + smaller > larger).named("wide")
    total, total_low = fast_two_sum(larger, smaller)
    n = where(wide, smaller - larger, smaller).named("n")
    d, d_low = where(wide, total, larger).named("d"), where(wide, total_low, 0.0)
    q = (n / d).named("q")
    q_low = (exact_quotient_rest(n, d, q) - q * d_low) / d
    z = (q * q).named("z")
    pi, pi_low = constants(smaller, PI)
    # The derivative of atan at q, 1 / (1 + z), is near enough to 1 - z for the low part.
    rest = (q * z * polynomial(z, ATAN) + q_low * (1 - z)).named("rest")
    base = where(wide, smaller.constant(pi * 0.25), 0.0).named("base")
    high, low = two_sum(base, q)
    return high, low + rest + where(wide, smaller.constant(pi_low * 0.25), 0.0)


def atan(x: Term) -> Term:
    """Return the arc tangent of x; above 1 it is pi/2 minus the arc tangent of 1 / x."""
    a = abs(x).named("a")
    far = (a > 1).named("far")
    one = x.constant(1)
    # Past 2**25 (2**55) the quotient no longer changes the result. Without the bound, 1 / x would become denormal.
    most = {Base.F: 2.0**26, Base.D: 2.0**56}[x.type.base]
    bounded = where(a > most, most, a).named("bounded")
    high, low = _atan_of_quotient(where(far, one, bounded), where(far, bounded, one))
    pi, pi_low = constants(x, PI)
    turned, lost = fast_two_sum(x.constant(pi * 0.5), -high)
    size = where(far, turned + (lost - (low - pi_low * 0.5)), high + low).named("size")
    return where(a < TINY[x.type.base], x, where(x < 0, -size, size))


def atan2(y: Term, x: Term) -> Term:
    """Return the angle of (x, y), as C99 7.12.4.4 and F.9.1.4 define it."""
    base = x.type.base
    ax, ay = abs(x).named("ax"), abs(y).named("ay")
    steep = (ay > ax).named("steep")
    larger, smaller = where(steep, ay, ax).named("larger"), where(steep, ax, ay).named("smaller")
    huge, up, down = {Base.F: (2.0**60, 2.0**80, 2.0**-60), Base.D: (2.0**500, 2.0**600, 2.0**-500)}[base]
    scale = where(larger > huge, x.constant(down), where(larger < 2.0**-20, up, x.constant(1))).named("scale")
    endless, none = larger.equals(INFINITY), larger.equals(0)
    n = where(endless, where(smaller.equals(INFINITY), x.constant(1), 0.0), smaller * scale).named("n")
    d = where(endless | none, x.constant(1), larger * scale).named("d")
    # Such a small quotient equals its arc tangent to the last bit, and its two parts could be denormal.
    thin = (n < d * {Base.F: 2.0**-26, Base.D: 2.0**-55}[base]).named("thin")
    high, low = _atan_of_quotient(where(thin, x.constant(0), n), d)
    pi, pi_low = constants(x, PI)
    turned, lost = fast_two_sum(x.constant(pi * 0.5), -high)
    high = where(steep, turned, high).named("high")
    low = where(steep, lost - (low - pi_low * 0.5), low).named("low")
    left = sign_bit(x).named("left")
    turned, lost = fast_two_sum(x.constant(pi), -high)
    angle = where(left, turned + (lost - (low - pi_low)), high + low).named("angle")
    angle = where(thin & ~(steep | left), n / d, angle).named("angle")
    return where(x.equals(x) & y.equals(y), where(sign_bit(y), -angle, angle), float("nan"))
