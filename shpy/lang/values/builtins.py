"""The functions of the language, with GLSL's names, order of arguments and meaning.

Stage: record. Each types its operands and records one operation of the table (or a few); outside a recording they
evaluate at once. Meaning at the edges: docs/numerics.md. All raise ShpyTypeError for operands that do not fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from shpy.errors import ShpyTypeError
from shpy.ir.types import Base, Type, vec
from shpy.lang.recording.emit import FrameEmitter
from shpy.lang.recording.location import here
from shpy.lang.recording.recorder import need_frame
from shpy.lang.values import arithmetic
from shpy.lang.values.arithmetic import base_of, elementwise, emit, emitter_of, made, operand, read, select
from shpy.lang.values.coerce import common_kind, common_size

_INTS = (Base.I, Base.U)


def _unary(op: str, doc: str, *, ints: bool = False) -> Callable[[Any], Any]:
    def function(x: Any) -> Any:
        return elementwise(op, (x,), f"sh.{op}", floats=not ints)

    function.__name__ = function.__qualname__ = op
    function.__doc__ = doc
    return function


abs = _unary("abs", "|x|, component-wise; ints too.", ints=True)
sign = _unary("sign", "-1, 0 or 1, component-wise; 0 for NaN and both zeros; ints too.", ints=True)
floor = _unary("floor", "The largest whole number that is not above x.")
ceil = _unary("ceil", "The smallest whole number that is not below x.")
round = _unary("round", "The nearest whole number, halves to even.")
trunc = _unary("trunc", "x without its fraction.")
fract = _unary("fract", "x - floor(x).")
sqrt = _unary("sqrt", "The square root, correctly rounded.")
rsqrt = _unary("rsqrt", "1 / sqrt(x).")
exp = _unary("exp", "e to the power of x.")
exp2 = _unary("exp2", "2 to the power of x.")
log = _unary("log", "The natural logarithm.")
log2 = _unary("log2", "The logarithm to base 2.")
log10 = _unary("log10", "The logarithm to base 10: a whole number for each power of ten.")
sin = _unary("sin", "The sine of x radians.")
cos = _unary("cos", "The cosine of x radians.")
tan = _unary("tan", "The tangent of x radians.")
asin = _unary("asin", "The arc sine, in radians.")
acos = _unary("acos", "The arc cosine, in radians.")
sinh = _unary("sinh", "The hyperbolic sine.")
cosh = _unary("cosh", "The hyperbolic cosine.")
tanh = _unary("tanh", "The hyperbolic tangent.")
asinh = _unary("asinh", "The inverse hyperbolic sine.")
acosh = _unary("acosh", "The inverse hyperbolic cosine.")
atanh = _unary("atanh", "The inverse hyperbolic tangent.")
isnan = _unary("isnan", "Whether x is NaN, component-wise.")
isinf = _unary("isinf", "Whether x is infinite, component-wise.")
inversesqrt = rsqrt


def atan(y: Any, x: Any = None) -> Any:
    """Return the arc tangent of y in radians; with two arguments, atan2(y, x)."""
    return elementwise("atan", (y,), "sh.atan", floats=True) if x is None else atan2(y, x)


def atan2(y: Any, x: Any) -> Any:
    """Return the angle of the point (x, y) in radians, -pi to pi, quadrants and signed zeros as in C99."""
    return elementwise("atan2", (y, x), "sh.atan2", floats=True)


def pow(x: Any, y: Any) -> Any:
    """Raise x to the power of y; 1 for two zeros; a negative x takes a whole y (C99)."""
    return elementwise("pow", (x, y), "sh.pow", floats=True)


def mod(x: Any, y: Any) -> Any:
    """Modulo, x - y * floor(x / y): the sign of the divisor; ints too."""
    return arithmetic.binary("floormod", x, y, "sh.mod")


def _several(op: str, args: Sequence[Any]) -> Any:
    if len(args) < 2:
        raise ShpyTypeError(
            f"sh.{op} takes two or more operands",
            loc=here(),
            cure=f"sh.{op}(a, b); sh.{op}(*v) for one vector's components",
        )
    result = args[0]
    for other in args[1:]:
        result = elementwise(op, (result, other), f"sh.{op}")
    return result


def min(*args: Any) -> Any:
    """Return the smallest of two or more, component-wise; a NaN gives way to a number; ints too."""
    return _several("min", args)


def max(*args: Any) -> Any:
    """Return the largest of two or more, component-wise; a NaN gives way to a number; ints too."""
    return _several("max", args)


def clamp(x: Any, low: Any, high: Any) -> Any:
    """Limit x: min(max(x, low), high); ints too."""
    return elementwise("clamp", (x, low, high), "sh.clamp")


def saturate(x: Any) -> Any:
    """Limit x to 0 … 1: clamp(x, 0, 1)."""
    return elementwise("clamp", (x, 0, 1), "sh.saturate", floats=True)


def mix(a: Any, b: Any, t: Any) -> Any:
    """Return a * (1 - t) + b * t; with a bool t, b where t holds, else a."""
    chooser = operand(t, "sh.mix")
    if base_of((chooser,), "sh.mix") is Base.B:
        return select(t, b, a)
    return elementwise("mix", (a, b, t), "sh.mix", floats=True)


def step(edge: Any, x: Any) -> Any:
    """0 where x < edge, else 1."""
    return elementwise("step", (edge, x), "sh.step", floats=True)


def smoothstep(a: Any, b: Any, x: Any) -> Any:
    """Return the cubic Hermite step from 0 at a to 1 at b; step(a, x) where a = b."""
    return elementwise("smoothstep", (a, b, x), "sh.smoothstep", floats=True)


def fma(a: Any, b: Any, c: Any) -> Any:
    """Return a * b + c, rounded once."""
    return elementwise("fma", (a, b, c), "sh.fma", floats=True)


def mad(a: Any, b: Any, c: Any) -> Any:
    """Return a * b + c, rounded twice."""
    return elementwise("mad", (a, b, c), "sh.mad", floats=True)


def radians(degrees: Any) -> Any:
    """Degrees to radians."""
    return elementwise("mul", (degrees, math.pi / 180), "sh.radians", floats=True)


def degrees(radians: Any) -> Any:
    """Radians to degrees."""
    return elementwise("mul", (radians, 180 / math.pi), "sh.degrees", floats=True)


def cond(c: Any, a: Any, b: Any) -> Any:
    """Return a where c holds, else b, component by component over a bool c; both are evaluated."""
    return select(c, a, b)


def ldexp(x: Any, n: Any) -> Any:
    """X * 2**n, rounded once; n of type i."""
    value, exponent = operand(x, "sh.ldexp"), operand(n, "sh.ldexp")
    base = base_of((value,), "sh.ldexp")
    type = vec(Base.F if base in _INTS else base, common_size((value.size, exponent.size), "sh.ldexp"))
    if base_of((exponent,), "sh.ldexp") is not Base.I:
        raise ShpyTypeError("the exponent of sh.ldexp is of type i", loc=here(), cure="sh.ldexp(x, sh.Attrib1i(n))")
    count = type.based(Base.I)
    emitter = emitter_of(value, exponent)
    handles = ((read(emitter, value, type), type), (read(emitter, exponent, count), count))
    return emit(emitter, "ldexp", handles, common_kind([getattr(value, "kind", "Attrib")]), "sh.ldexp")


# Geometry


def _vectors(op: str, args: Sequence[Any], *, kind: str | None = None) -> Any:
    """Apply an operation to vectors of one type."""
    what = f"sh.{op}"
    operands = [operand(a, what) for a in args]
    type = _float_type(operands, what)
    emitter = emitter_of(*operands)
    handles = tuple((read(emitter, o, type), type) for o in operands)
    return emit(emitter, op, handles, kind or common_kind([getattr(o, "kind", "Attrib") for o in operands]), what)


def _float_type(operands: Sequence[Any], what: str) -> Type:
    base = base_of(operands, what)
    return vec(Base.F if base in _INTS else base, common_size([o.size for o in operands], what))


def dot(a: Any, b: Any) -> Any:
    """Return the scalar product, summed from the first component on."""
    return _vectors("dot", (a, b), kind="Attrib")


def cross(a: Any, b: Any) -> Any:
    """Return the vector product of two vectors of three components."""
    return _vectors("cross", (a, b))


def length(v: Any) -> Any:
    """sqrt(dot(v, v))."""
    return _vectors("length", (v,), kind="Attrib")


def distance(a: Any, b: Any) -> Any:
    """length(a - b)."""
    return _vectors("distance", (a, b), kind="Attrib")


def normalize(v: Any) -> Any:
    """v / length(v); zero for the zero vector. Keeps the kind."""
    return _vectors("normalize", (v,))


def reflect(i: Any, n: Any) -> Any:
    """Return the incident vector i mirrored at the unit normal n: i - 2 * dot(n, i) * n (GLSL 4.60 section 8.5)."""
    return _vectors("reflect", (i, n))


def refract(i: Any, n: Any, eta: Any) -> Any:
    """Return the incident vector refracted at ratio eta (GLSL 4.60 section 8.5); zero at total reflection."""
    operands = [operand(i, "sh.refract"), operand(n, "sh.refract")]
    ratio = operand(eta, "sh.refract")
    type = vec(
        _float_type([*operands, ratio], "sh.refract").base, common_size([o.size for o in operands], "sh.refract")
    )
    emitter = emitter_of(*operands, ratio)
    handles = (*((read(emitter, o, type), type) for o in operands), (read(emitter, ratio, type.scalar), type.scalar))
    return emit(
        emitter, "refract", handles, common_kind([getattr(o, "kind", "Attrib") for o in operands]), "sh.refract"
    )


def faceforward(n: Any, i: Any, reference: Any) -> Any:
    """N where dot(reference, i) < 0, else -n."""
    return _vectors("faceforward", (n, i, reference))


# Bools, bits, lanes


def any(c: Any) -> Any:
    """Return whether one component of a bool holds."""
    return elementwise("any", (c,), "sh.any")


def all(c: Any) -> Any:
    """Return whether every component of a bool holds."""
    return elementwise("all", (c,), "sh.all")


def bits_from_float(x: Any) -> Any:
    """Return the bits of the binary32 as u; 0x7fc00000 for every NaN."""
    return elementwise("bits_from_float", (x,), "sh.bits_from_float", floats=True)


def float_from_bits(u: Any) -> Any:
    """Return the binary32 with these bits of a u."""
    return elementwise("float_from_bits", (u,), "sh.float_from_bits")


def popcount(x: Any) -> Any:
    """Return the number of one bits, component-wise."""
    return elementwise("popcount", (x,), "sh.popcount")


floatBitsToUint = bits_from_float
uintBitsToFloat = float_from_bits


def _lanes(op: str, c: Any) -> Any:
    frame = need_frame(f"sh.{op}")
    value = arithmetic.condition(c, f"sh.{op}")
    emitter = FrameEmitter(frame)
    return made("Attrib", vec(Base.B), emitter, emitter.let(op, (value,), vec(Base.B)))


def any_lane(c: Any) -> Any:
    """Return whether c holds for any active element that executes this together with this one."""
    return _lanes("any_lane", c)


def all_lanes(c: Any) -> Any:
    """Return whether c holds for all active elements that execute this together with this one."""
    return _lanes("all_lanes", c)


def _grid(op: str, n: int) -> Any:
    if n not in (1, 2, 3, 4):
        raise ShpyTypeError(f"sh.{op} takes the rank of the elements' shape, 1 to 4", loc=here(), cure=f"sh.{op}(2)")
    frame = need_frame(f"sh.{op}")
    frame.recording.ranks[n] = here()
    emitter = FrameEmitter(frame)
    return made("Attrib", vec(Base.I, n), emitter, emitter.let(op, (), vec(Base.I, n)))


def grid_index(n: int) -> Any:
    """Return this element's index along numpy's axes, Attrib{n}i; n is the rank of the elements' shape."""
    return _grid("grid_index", n)


def grid_shape(n: int) -> Any:
    """Return the number of elements along numpy's axes, Attrib{n}i; n is the rank of the elements' shape."""
    return _grid("grid_shape", n)


FUNCTIONS = {
    name: thing
    for name, thing in globals().items()
    if not name.startswith("_") and getattr(thing, "__module__", None) == __name__
}
"""The functions of this module by their public names."""
