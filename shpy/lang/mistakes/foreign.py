"""Names that other languages and libraries have for functions of shpy, each with the name to write instead.

Stage: record, where an attribute is missing. Takes the name that the user wrote; gives the cure.

    sh.lerp(a, b, t)    # sh.mix(a, b, t)
    v.length()          # sh.length(v)
    m.T                 # sh.transpose(m)
"""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterable
from types import FunctionType

from shpy.ir.ops import OPS

OTHER_NAMES = {
    "fabs": "abs", "absolute": "abs", "power": "pow", "arcsin": "asin", "arccos": "acos", "arctan": "atan",
    "arctan2": "atan2", "arcsinh": "asinh", "arccosh": "acosh", "arctanh": "atanh", "minimum": "min", "maximum": "max",
    "where": "cond", "clip": "clamp", "norm": "length", "rint": "round",
    "dist": "distance", "deg2rad": "radians", "rad2deg": "degrees", "matmul": "dot", "vdot": "dot",
}  # fmt: skip
"""A function of numpy or math, and the function of shpy that does the same."""
_SHADING = {
    "lerp": "mix(a, b, t)", "frac": "fract(x)", "roundEven": "round(x)", "magnitude": "length(v)", "mag": "length(v)",
    "normalized": "normalize(v)", "unit": "normalize(v)", "invert": "inverse(m)", "inv": "inverse(m)",
    "det": "determinant(m)", "select": "cond(c, a, b), a where c holds", "ifelse": "cond(c, a, b)",
    "asuint": "bits_from_float(x)", "asfloat": "float_from_bits(u)", "bitCount": "popcount(x)",
    "clz": "count_leading_zeros(x)", "fmin": "min(a, b)", "fmax": "max(a, b)", "SH_ELSEIF": "SH_ELIF(c)",
    "as_uint": "bits_from_float(x)", "as_float": "float_from_bits(u)",
    "float": "Attrib1f(x)", "int": "Attrib1i(x)", "uint": "Attrib1u(x)", "bool": "Attrib1b(x)", "double": "Attrib1d(x)",
    "half": "Attrib1h(x)", "vec1": "Attrib1f(x)", "mat2": "Matrix2f(row0, row1), which takes rows",
    "mat3": "Matrix3f(row0, row1, row2), which takes rows", "mat4": "Matrix4f(row0, …, row3), which takes rows",
    "eye": "Matrix3f(), the identity", "identity": "Matrix3f(), the identity",
    "texture": "Texture2D(array)(uv)", "texture2D": "Texture2D(array)(uv)", "tex2D": "Texture2D(array)(uv)",
    "sample": "Texture2D(array)(uv)", "texelFetch": "Table(array, sh.Color3f)[row, column]",
    "array": "vec3(x, y, z) for a vector, sh.Array(sh.Attrib1f, values) or sh.Table(array, sh.Attrib1f) for more",
    "zeros": "vec3(0) for a vector, sh.Array(sh.Attrib1f, n) for an array",
    "ones": "vec3(1) for a vector", "linspace": "Table(np.linspace(a, b, n), sh.Attrib1f)",
    "arange": "Table(np.arange(n), sh.Attrib1i)", "discard": "SH_DISCARD()",
    "random": "unit_float(sh.hash(i))", "rand": "unit_float(sh.hash(i))",
    **dict.fromkeys(("ln1p", "ln_1p"), "log1p(x)"), "pow10": "exp10(x)",
    "tanpi": "sinpi(x) / sh.cospi(x)", "modf": "trunc(x) and x - sh.trunc(x)",
    "kernel": "program", "func": "program", "function": "subroutine",
    **dict.fromkeys(("grad", "autodiff", "backward", "bwd_diff"), "gradient(f)(x), or program.gradient(\"x\")"),
    **dict.fromkeys(("fwd_diff", "forward_diff", "pushforward"), "jvp(f, [x], [dx]), or program.jvp(\"x\")"),
    **dict.fromkeys(("custom_jvp", "custom_vjp"), "subroutine above f, and @f.tangent above its rule"),
    **dict.fromkeys(("vjp", "pullback"), "gradient(f, mode=\"reverse\", value=True)(x)"),
    "value_and_grad": "gradient(f, value=True)(x), or sh.value_and_gradient(program, params)",
    **dict.fromkeys(("jacfwd", "jacrev"), "jacobian(f)(x)"),
    "hessian": "jacobian(sh.gradient(f))(x)", "derivative": "gradient(f)(x)",
    "uniform": "Param(type, value)", "buffer": "Table(array, type)", "Uniform": "Param(type, value)",
}  # fmt: skip
_PLAIN = {
    "pi": "math.pi", "PI": "math.pi", "tau": "math.tau", "e": "math.e", "inf": "math.inf", "nan": "math.nan",
    "fmod": "x - y * sh.trunc(x / y), or sh.mod(x, y) with the sign of y",
    "square": "x * x", "rcp": "1 / x", "reciprocal": "1 / x", "sum": "sum(v), Python's", "lessThan": "a < b",
    "greaterThan": "a > b", "lessThanEqual": "a <= b", "greaterThanEqual": "a >= b", "equal": "a == b",
    "notEqual": "a != b", "mul": "a * b, or m @ v for matrices", "outer": "sh.library.outer(a, b)",
    "outerProduct": "sh.library.outer(a, b)", "logical_and": "a & b", "logical_or": "a | b",
    "logical_not": "~a", "sqr": "x * x", "cot": "1 / sh.tan(x)", "mul24": "a * b", "mad24": "a * b + c",
    "intBitsToFloat": "sh.float_from_bits(sh.Attrib1u(i))", "floatBitsToInt": "sh.Attrib1i(sh.bits_from_float(x))",
    "as_int": "sh.Attrib1i(sh.bits_from_float(x))", "asint": "sh.Attrib1i(sh.bits_from_float(x))",
    "frexp": "e = sh.Attrib1i(sh.bits_from_float(x) >> 23 & 255) - 126, and sh.ldexp(x, -e)",
    "ilogb": "sh.Attrib1i(sh.bits_from_float(x) >> 23 & 255) - 127",
    "ddx": "sh.dFdx(x)", "ddy": "sh.dFdy(x)", "fwidth": "abs(sh.dFdx(x)) + abs(sh.dFdy(x))",
    **dict.fromkeys(("stop_gradient", "detach", "no_diff", "no_grad"), "x computed outside of f, where it stays"),
    **dict.fromkeys(("requires_grad", "set_grad_enabled", "enable_grad"), "sh.gradient(f, wrt=(0, \"light\"))(x, …)"),
    "lookAt": "sh.library.look_at", "textureCube": "sh.library.TextureCube", "texture3D": "sh.library.Texture3D",
}  # fmt: skip
_VECTORS = {
    spelled.format(n): f"sh.Attrib{n}{base}"
    for base, word in {"f": "float", "i": "int", "u": "uint", "b": "bool", "d": "double", "h": "half"}.items()
    for n in (2, 3, 4)
    for spelled in (word + "{}", "vec{}" + base, base + "vec{}")
}
"""The vectors of OpenCL, of WGSL and of GLSL; shpy has most of the last itself."""
_OF_VALUES = {
    "sum": "sum({0}), Python's", "mean": "sum({0}) / len({0})", "prod": "the product of its components",
    "max": "sh.max(*{0})", "min": "sh.min(*{0})", "item": "the program's output, or program.trace(…), for its value",
    "tolist": "the program's output, or program.trace(…), for its value", "astype": "sh.Attrib1i({0}), a constructor",
    "shape": "len({0}) for the number of components", "ndim": "len({0}) for the number of components",
    "reshape": "a swizzle, {0}.xy, or a constructor", "dtype": "type({0})", "real": "{0}", "at": "{0}[i]",
    "clone": "{0}.copy()", "set": "{0}[:] = …", "assign": "{0}[:] = …", "data": "{0}[:]", "squared": "{0} * {0}",
    "T": "{0}: a vector needs no transpose, m @ v and v @ m know", "length_squared": "sh.dot({0}, {0})",
}  # fmt: skip

_TWO = frozenset(row.name for row in OPS.values() if len(row.takes) > 1)


def is_in_library(name: str) -> bool:
    """Return whether `sh.library` has the name."""
    return name in sys.modules["shpy"].library.__all__


def module_cure(name: str, names: Iterable[str]) -> str | None:
    """Return the cure for `sh.name`; `names` are those of shpy."""
    if name in _PLAIN:
        return _PLAIN[name]
    if name in OTHER_NAMES:
        return f"sh.{OTHER_NAMES[name]}"
    if name in _SHADING:
        return f"sh.{_SHADING[name]}"
    if is_in_library(name):
        return f"sh.library.{name}"
    if name in _VECTORS:
        return _VECTORS[name]
    lower = {k.lower(): k for k in names}
    for whole in (name.lower(), f"{name.lower()}f", f"{name.lower()}3f"):  # Point3 and Color lack what says the type
        if whole in lower:
            return f"sh.{lower[whole]}"
    near = difflib.get_close_matches(name, list(names), n=1, cutoff=0.75)
    return f"sh.{near[0]}" if near else None


def value_cure(name: str, called: str) -> str | None:
    """Return the cure for `v.name`, where the value is `called`: a function of shpy says by `Any` that it gives one."""
    if name in _OF_VALUES:
        return _OF_VALUES[name].format(called)
    function = OTHER_NAMES.get(name) or _SHADING.get(name, name).partition("(")[0]
    thing = vars(sys.modules["shpy"]).get(function)
    if not isinstance(thing, FunctionType) or thing.__annotations__.get("return") != "Any":
        return None
    return f"sh.{function}({called}, …)" if function in _TWO else f"sh.{function}({called})"
