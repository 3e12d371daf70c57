"""Tangents: the rule by which each operation is differentiated, as a formula of other operations.

Stage: represent. A rule takes the result y, the operands, and the tangent of each operand of floats; it gives the
tangent of y, and is linear in the tangents. It is written once, on formulas (`formula.py`): forward mode emits it, so
all targets compute it with the same bits, and reverse mode transposes it. A tangent may be a `Zero`, which vanishes.
A row of the op table has the rule of its name.

The rules follow these conventions where there is no derivative:

- `min`, `max`, `clamp`, `cond`: the tangent of the operand that is returned; of equal ones the first.
- `abs` at 0: 0. `floor`, `ceil`, `round`, `trunc`, `sign`, `step`, comparisons, ints, bits: 0 everywhere.
- A finite value with an infinite slope (`sqrt(0)`, `asin(1)`, `acosh(1)`, `pow(0, 0.5)`, `cbrt(0)`): 0.
- `length`, `normalize`, `distance`, `hypot`, `atan2` at the origin: 0.
- An infinite value or NaN (`log(0)`, `1 / 0`): the result of the formula in IEEE arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from shpy.ir.formula import Values, named, number, where
from shpy.ir.meaning import cross, dot

Rule = Callable[..., Values]


def flat(y: Values, *operands: Values) -> Values:
    """Return the tangent of an operation that is constant between its steps: 0."""
    return number(0, y)


def _inverse(holds: Values, x: Values) -> Values:
    """Return 1 / x, and 0 where `holds` is false.

    There the derivatives of all orders are 0 too: the quotient is 0 / 1, so no infinity or NaN takes part.
    """
    return where(holds, number(1, x), number(0, x)) / where(holds, x, number(1, x))


def _over(x: Values) -> Values:
    """Return 1 / x, and 0 where x is 0."""
    return _inverse(np.not_equal(x, 0), x)


def _product(y: Values, a: Values, b: Values, c: Values, da: Values, db: Values, dc: Values) -> Values:
    return da * b + db * a + dc


def _extreme(y: Values, a: Values, b: Values, da: Values, db: Values) -> Values:
    return where(np.equal(y, a), da, db)


def _step(a: Values, b: Values, x: Values, da: Values, db: Values, dx: Values, rise: Rule) -> Values:
    """Return the tangent of a smooth step of t = (x - a) / (b - a), whose derivative by t is `rise(t)`."""
    scale = named("scale", _over(b - a))
    t = named("t", (x - a) * scale)
    return where((t > 0) & (t < 1), (dx - da * (1 - t) - db * t) * (rise(t) * scale), number(0, x))


def _pow(y: Values, x: Values, p: Values, dx: Values, dp: Values) -> Values:
    steep = np.equal(x, 0) & (p >= 0) & (p < 1)
    slope = p * where(steep, number(1, x), x).op("pow", p - 1)
    return dx * where(steep, number(0, x), slope) + dp * (y * where(x > 0, x, number(1, x)).op("log"))


def _hypot(y: Values, a: Values, b: Values, da: Values, db: Values) -> Values:
    scale = _over(y)
    return da * (a * scale) + db * (b * scale)


def _asin(y: Values, x: Values, dx: Values) -> Values:
    return dx * _inverse(np.not_equal(abs(x), 1), np.sqrt((1 - x) * (1 + x)))


def _atan2(y: Values, a: Values, b: Values, da: Values, db: Values) -> Values:
    scale = named("scale", _over(a.op("hypot", b)))
    return (da * (b * scale) - db * (a * scale)) * scale


def _normalize(y: Values, v: Values, dv: Values) -> Values:
    return (dv - y * dot(dv, y)) * _over(named("size", v.op("length")))


def _refract(y: Values, i: Values, n: Values, eta: Values, di: Values, dn: Values, deta: Values) -> Values:
    cosine = named("cosine", dot(n, i))
    k = named("k", 1 - eta * eta * (1 - cosine * cosine))
    root = named("root", np.sqrt(where(k > 0, k, number(1, k))))
    dcosine = dot(di, n) + dot(dn, i)
    droot = (dcosine * (eta * eta * cosine) - deta * (eta * (1 - cosine * cosine))) * _inverse(k > 0, root)
    bent = di * eta + i * deta - dn * (eta * cosine + root) - n * (dcosine * eta + deta * cosine + droot)
    return where(~(k < 0), bent, number(0, bent))


_LN2, _LN10 = math.log(2), math.log(10)
_SLOPE_OF_ERF = 2 / math.sqrt(math.pi)

TANGENTS: Final[dict[str, Rule]] = {
    **dict.fromkeys("sign floor ceil round trunc step bits_from_float float_from_bits unit_float".split(), flat),
    # Arithmetic
    "neg": lambda y, x, dx: -dx,
    "add": lambda y, a, b, da, db: da + db,
    "sub": lambda y, a, b, da, db: da - db,
    "mul": lambda y, a, b, da, db: da * b + db * a,
    "div": lambda y, a, b, da, db: (da - db * y) / b,
    "fma": _product,
    "mad": _product,
    "ldexp": lambda y, x, n, dx: dx.op("ldexp", n),
    # Common functions
    "cond": lambda y, c, a, b, da, db: where(c, da, db),
    "min": _extreme,
    "max": _extreme,
    "clamp": lambda y, x, low, high, dx, dlow, dhigh: where(np.equal(y, x), dx, where(np.equal(y, low), dlow, dhigh)),
    "abs": lambda y, x, dx: dx * x.op("sign"),
    "fract": lambda y, x, dx: dx,
    "mod": lambda y, a, b, da, db: da - db * np.floor(a / b),
    "mix": lambda y, a, b, t, da, db, dt: da * (1 - t) + db * t + dt * (b - a),
    "smoothstep": lambda y, a, b, x, da, db, dx: _step(a, b, x, da, db, dx, lambda t: 6 * (t * (1 - t))),
    "smootherstep": lambda y, a, b, x, da, db, dx: _step(
        a, b, x, da, db, dx, lambda t: 30 * ((t * (1 - t)) * (t * (1 - t)))
    ),
    # Roots, powers and elementary functions
    "sqrt": lambda y, x, dx: dx * _over(2 * y),
    "rsqrt": lambda y, x, dx: dx * (-0.5 * y / x),
    "pow": _pow,
    "hypot": _hypot,
    "exp": lambda y, x, dx: dx * y,
    "exp2": lambda y, x, dx: dx * (y * _LN2),
    "log": lambda y, x, dx: dx / x,
    "log2": lambda y, x, dx: dx / (x * _LN2),
    "log10": lambda y, x, dx: dx / (x * _LN10),
    "sin": lambda y, x, dx: dx * x.op("cos"),
    "cos": lambda y, x, dx: -(dx * x.op("sin")),
    "tan": lambda y, x, dx: dx * (1 + y * y),
    "asin": _asin,
    "acos": lambda y, x, dx: -_asin(y, x, dx),
    "atan": lambda y, x, dx: dx / (1 + x * x),
    "atan2": _atan2,
    "sinh": lambda y, x, dx: dx * x.op("cosh"),
    "cosh": lambda y, x, dx: dx * x.op("sinh"),
    "tanh": lambda y, x, dx: dx * ((1 - y) * (1 + y)),
    "asinh": lambda y, x, dx: dx / x.op("hypot", number(1, x)),
    "acosh": lambda y, x, dx: dx * _inverse(np.not_equal(x, 1), np.sqrt(x - 1) * np.sqrt(x + 1)),
    "atanh": lambda y, x, dx: dx / ((1 - x) * (1 + x)),
    "expm1": lambda y, x, dx: dx * x.op("exp"),
    "log1p": lambda y, x, dx: dx / (1 + x),
    "exp10": lambda y, x, dx: dx * (y * _LN10),
    "cbrt": lambda y, x, dx: dx * _over(3 * (y * y)),
    "erf": lambda y, x, dx: dx * ((-(x * x)).op("exp") * _SLOPE_OF_ERF),
    "erfc": lambda y, x, dx: -(dx * ((-(x * x)).op("exp") * _SLOPE_OF_ERF)),
    "sinpi": lambda y, x, dx: dx * (x.op("cospi") * math.pi),
    "cospi": lambda y, x, dx: -(dx * (x.op("sinpi") * math.pi)),
    # Geometry
    "dot": lambda y, a, b, da, db: dot(da, b) + dot(db, a),
    "cross": lambda y, a, b, da, db: cross(da, b) + cross(a, db),
    "length": lambda y, v, dv: dot(dv, v * _over(y)),
    "distance": lambda y, a, b, da, db: dot(da - db, (a - b) * _over(y)),
    "normalize": _normalize,
    "reflect": lambda y, i, n, di, dn: di - (dn * dot(n, i) + n * (dot(di, n) + dot(dn, i))) * 2,
    "refract": _refract,
    "faceforward": lambda y, n, i, reference, dn, di, dreference: where(dot(reference, i) < 0, dn, -dn),
}
"""The rule of each operation, by name."""
