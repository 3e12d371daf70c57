"""Logarithms, powers and the inverse hyperbolic functions, from operations that every target rounds alike.

Stage: improve. x = 2**k * (1 + f) with 1 + f between sqrt(1/2) and sqrt(2), and log(1 + f) = 2 atanh(s) with
s = f / (2 + f), as in Sun's fdlibm (1993). pow(x, y) = 2**(y * log2(x)), where the logarithm is the sum of two numbers.
"""

from __future__ import annotations

from typing import Final

from shpy.ir.types import Base
from shpy.passes.formulas.coefficients import (
    ASINH,
    ATANH,
    INVERSE_LN2,
    INVERSE_LN10,
    LN2,
    LOG,
    LOG2_ABOVE,
    LOG2_BELOW,
    LOG2_NEAR_ABOVE,
    LOG2_NEAR_BELOW,
    LOG10_2,
    POWER_LOG,
    POWER_LOG_TAIL,
    TWO_BY_3_LN2,
    TWO_BY_LN2,
)
from shpy.passes.formulas.parts import (
    TINY,
    Numbers,
    constants,
    exact_quotient_rest,
    fast_two_sum,
    polynomial,
    scaled_by,
    sign_bit,
    square_root,
    two_product,
    two_sum,
    whole_and_shifted,
)
from shpy.passes.formulas.portable.exponential import two_to_the
from shpy.passes.formulas.terms import Term, where

Pair = tuple[Term, Term]
INFINITY: Final = float("inf")
NAN: Final = float("nan")

_ROOT_HALF: Final = 0x3F3504F3
"""The bits of the root of 1/2."""

_LARGE: Final = {Base.F: 2.0**13, Base.D: 2.0**28}
"""The bound above which asinh x and acosh x are log(2 x)."""


def parted(x: Term) -> Pair:
    """Return (f, k) with x = 2**k * (1 + f), for a positive finite x, which may be denormal."""
    if x.type.base is Base.D:
        return _parted_double(x)
    mantissa, k = mantissa_and_exponent(x)
    return (mantissa - 1).named("f"), k.named("k")


def mantissa_and_exponent(x: Term) -> Pair:
    """Return (m, k) with x = 2**k * m and m in [sqrt(1/2), sqrt(2)], for positive finite binary32, denormals too."""
    tiny = (x < 2.0**-126).named("tiny")
    moved = (where(tiny, x * 2.0**23, x).op("bits_from_float") + (0x3F800000 - _ROOT_HALF)).named("moved")
    mantissa = ((moved & 0x7FFFFF) + _ROOT_HALF).op("float_from_bits")
    return mantissa, (moved >> 23).based(Base.F) - where(tiny, x.constant(150), 127.0)


def _parted_double(x: Term) -> Pair:
    """Return (f, k) for a binary64; powers of two first scale x until a binary32 can hold its exponent."""
    k = x.constant(0)
    for step in (512, 512, 256, 128):
        small, large = x < 2.0 ** (-step // 2), x > 2.0 ** (step // 2)
        k = where(small, k - step, where(large, k + step, k))
        x = where(small, x * 2.0**step, where(large, x * 2.0**-step, x)).named("x")
    moved = x.op("bits_from_float") + (0x3F800000 - _ROOT_HALF)
    n = ((moved >> 23).based(Base.I) - 127).named("n")
    return (x.op("ldexp", -n) - 1).named("f"), (k + n.based(Base.D)).named("k")


def edges(x: Term, inside: Term) -> Term:
    """Return a logarithm of x: `inside` for positive finite x, -inf for 0, NaN below 0, and x for infinity and NaN."""
    outside = where(x.equals(0), x.constant(-INFINITY), where(x < 0, x.constant(NAN), x))
    return where((x > 0) & (x < INFINITY), inside.named("inside"), outside.named("outside"))


def _series(f: Term) -> tuple[Term, Term]:
    """Return (half, rest) with log(1 + f) = f - (half - rest)."""
    half = (0.5 * f * f).named("square")
    s = (f / (2 + f)).named("s")
    z = (s * s).named("z")
    return half, (s * (half + z * polynomial(z, LOG))).named("rest")


def _log_of(u: Term, low: Term | None = None) -> Term:
    """Return the logarithm of u + low, for a positive finite u and a `low` that is far smaller."""
    f, k = parted(u)
    half, rest = _series(f)
    ln2, ln2_low = constants(u, LN2)
    small = k * ln2_low if low is None else k * ln2_low + low / u
    return k * ln2 + (f - (half - (rest + small.named("small"))))


def log(x: Term) -> Term:
    """Return the natural logarithm of x."""
    return edges(x, _log_of(x))


def log1p(x: Term) -> Term:
    """Return the logarithm of 1 + x, the sum in two parts."""
    u, low = two_sum(x.constant(1), x)
    return where(x.equals(0), x, edges(u, _log_of(u, low)))


def log2(x: Term) -> Term:
    """Return the binary logarithm of x."""
    f, k = parted(x)
    product, rest = _mantissa_log(f, INVERSE_LN2)
    high, low = two_sum(k, product)
    return edges(x, high + (low + rest))


def log10(x: Term) -> Term:
    """Return the decimal logarithm of x; it is a whole number for powers of ten."""
    f, k = parted(x)
    product, rest = _mantissa_log(f, INVERSE_LN10)
    step, step_low = constants(x, LOG10_2)
    high, low = two_sum((k * step).named("whole"), product)
    return edges(x, high + (low + (rest + k * step_low)))


def _mantissa_log(f: Term, inverse_ln: Numbers) -> Pair:
    """Return log(1 + f) * inverse_ln, in two parts; `inverse_ln` is 1 / ln of the base, also in two parts."""
    half, rest = _series(f)
    inverse, inverse_low = constants(f, inverse_ln)
    main, lost = fast_two_sum(f, -half)
    product, product_low = two_product(main.named("main"), f.constant(inverse))
    return product, product_low + ((lost + rest) * inverse + main * inverse_low)


def asinh(x: Term) -> Term:
    """Return the inverse hyperbolic sine of x: log(a + sqrt(a * a + 1)) with a = |x|, each term in two parts."""
    a = abs(x).named("a")
    large = (a > _LARGE[x.type.base]).named("large")
    b = where(large, x.constant(1), a).named("b")
    square, square_low = two_product(b, b)
    t, t_low = two_sum(square, x.constant(1))
    root, root_low = square_root(t, t_low + square_low)
    u, u_low = two_sum(root, b)
    far = _log_sum(large, a, u, u_low + root_low).named("size")
    z = (x * x).named("z")
    near = where(a < TINY[x.type.base], x, x + x * (z * polynomial(z, ASINH)))
    return where(a < 0.5, near, where(x < 0, -far, far))


def acosh(x: Term) -> Term:
    """Return the inverse hyperbolic cosine of x: log(1 + t + sqrt(2 t + t * t)) with t = x - 1."""
    large = (x > _LARGE[x.type.base]).named("large")
    t = (where(large, x.constant(2), x) - 1).named("t")
    square, square_low = two_product(t, t)
    v, v_low = two_sum(t + t, square)
    root, root_low = square_root(v, v_low + square_low)
    p, p_low = fast_two_sum(root, t)
    u, u_low = two_sum(x.constant(1), p)
    return where(x < 1, x.constant(NAN), _log_sum(large, x, u, u_low + (p_low + root_low)))


def _log_sum(large: Term, x: Term, u: Term, low: Term) -> Term:
    """Return the logarithm of u + low, or of 2 x in the lanes where `large` holds."""
    whole, part = where(large, x, u).named("u"), where(large, x.constant(0), low)
    ln2 = where(large, x.constant(0.6931471805599453), 0.0).named("ln2")
    inside = (_log_of(whole, part) + ln2).named("inside")
    return where(whole < INFINITY, inside, whole)


def atanh(x: Term) -> Term:
    """Return the inverse hyperbolic tangent of x; from a = |x| = 1/2 on it is log(1 + 2 a / (1 - a)) / 2."""
    a = abs(x).named("a")
    t = (a + a) / (1 - a)
    u, low = two_sum(x.constant(1), t.named("t"))
    far = (0.5 * _log_of(u.named("u"), low)).named("far")
    far = where(a < 1, far, where(a.equals(1), x.constant(INFINITY), NAN)).named("far")
    z = (x * x).named("z")
    return where(a < 0.5, x + x * (z * polynomial(z, ATANH)), where(x < 0, -far, far))


_Centre = tuple[float, float, Numbers]
_CENTRES: Final[dict[Base, tuple[tuple[_Centre, ...], tuple[_Centre, ...]]]] = {
    Base.F: (
        ((0.84375, 0.796875, LOG2_BELOW), (0.9453125, 0.890625, LOG2_NEAR_BELOW)),
        ((1.1875, 1.25, LOG2_ABOVE), (1.0625, 1.125, LOG2_NEAR_ABOVE)),
    ),
    Base.D: (((0.890625, 0.796875, LOG2_BELOW),), ((1.125, 1.25, LOG2_ABOVE),)),
}
"""(edge, centre, log2 of the centre): a mantissa below (first row) or above (second) an edge is divided by that centre.

In binary32 the s of `log2_in_two` has to be below 1/30 where the logarithm is small, since its cube is rounded once.
"""


def log2_in_two(f: Term, k: Term) -> Pair:
    """Return the binary logarithm of 2**k * (1 + f), for the (f, k) of `parted`, in two parts.

    The mantissa is m = 1 + f and c is 1 or a centre of `_CENTRES`: log2(m / c) is 2 / ln 2 times atanh(s) with
    s = (m - c) / (m + c). s has two parts; it is so small that the higher powers of its series need only one.
    """
    m = (f + 1).named("m")
    c, whole, fraction = m.constant(1.0), k.constant(0.0), k.constant(0.0)
    below, above = _CENTRES[f.type.base]
    near = [((m < edge).named("below"), centre, logarithm) for edge, centre, logarithm in below]
    near += [((m > edge).named("above"), centre, logarithm) for edge, centre, logarithm in above]
    for holds, centre, logarithm in reversed(near):
        of_centre, rest_of_it = constants(f, logarithm)
        c = where(holds, m.constant(centre), c)
        whole = where(holds, k.constant(of_centre), whole)
        fraction = where(holds, k.constant(rest_of_it), fraction)
    c, whole = c.named("c"), (k + whole).named("whole")
    n = (m - c).named("n")
    d, d_low = two_sum(m, c)
    s = (n / d).named("s")
    s_low = ((exact_quotient_rest(n, d, s) - s * d_low) / d).named("s_low")
    if f.type.base is Base.D:
        return _log2_of_double(whole, fraction, s, s_low)
    z = (s * s).named("z")
    scale, scale_low = constants(f, TWO_BY_LN2)
    main, lost = two_product(s, s.constant(scale))
    rest = ((s_low + s * (z * polynomial(z, POWER_LOG))) * scale).named("rest")
    high, low = two_sum(whole, main)
    return fast_two_sum(high, low + (lost + (s * scale_low + fraction) + rest))


def _log2_of_double(whole: Term, fraction: Term, s: Term, s_low: Term) -> Pair:
    """Return whole + fraction + 2 / ln 2 times atanh(s + s_low), in two parts.

    A power multiplies it by up to 1100 / log2(x), so its relative error has to be below 2**-64. Near x = 1 the cube of
    s makes up a thousandth of it, too much for one rounding. So the cube has two parts too; higher powers have one.
    """
    (scale, scale_low), (third, third_low) = constants(s, TWO_BY_LN2), constants(s, TWO_BY_3_LN2)
    z, z_low = two_product(s, s)
    cube, cube_low = two_product(s, z)
    main, main_lost = two_product(s, s.constant(scale))
    minor, minor_lost = two_product(cube, s.constant(third))
    tail = (s_low + z * s_low + cube * z * polynomial(z, POWER_LOG_TAIL)) * scale
    minor_rest = cube * third_low + (cube_low + s * z_low) * third
    rest = (s * scale_low + fraction) + (minor_rest + tail.named("tail"))
    high, low = two_sum(whole, main)
    high, lost = fast_two_sum(high, minor)
    return fast_two_sum(high, (low + lost) + (main_lost + (minor_lost + rest.named("rest"))))


def pow_(x: Term, y: Term) -> Term:
    """Return x to the power of y, as C99 7.12.7.4 and F.9.4.4 define it."""
    base = x.type.base
    a = abs(x).named("a")
    most, end = {Base.F: (1.0e10, 200.0), Base.D: (1.0e20, 1100.0)}[base]
    exponent = where(y > most, most, where(y < -most, -most, y)).named("exponent")
    logarithm, logarithm_low = log2_in_two(*parted(a))
    product, lost = two_product(exponent, logarithm.named("logarithm"))
    high = where(product > end, end, where(product < -end, -end, product)).named("high")
    low = where(high.equals(product), lost + exponent * logarithm_low, 0.0).named("low")
    k, shifted = whole_and_shifted(high)
    size = scaled_by(two_to_the((high - k).named("r"), low), shifted)
    return power_edges(x, y, a, size.named("size"))


def power_edges(x: Term, y: Term, a: Term, size: Term) -> Term:
    """Return x to the power of y, from the `size` of the finite case: special cases are replaced, the sign is set."""
    end = (a.equals(0) | a.equals(INFINITY)).named("end")
    size = where(end, where((y > 0).equals(a > 1), x.constant(INFINITY), 0.0), size).named("size")
    whole = y.op("floor").equals(y).named("whole")
    half = (y * 0.5).named("y_by_2")
    odd = (whole & half.op("floor").differs(half)).named("odd")
    lost = (x.differs(x) | y.differs(y) | ((x < 0) & ~whole & a.differs(INFINITY))).named("lost")
    one = (y.equals(0) | x.equals(1) | (a.equals(1) & abs(y).equals(INFINITY))).named("one")
    return where(one, 1.0, where(lost, NAN, where(sign_bit(x) & odd, -size, size)))
