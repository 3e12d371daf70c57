"""The functions of the language, with GLSL's names, order of arguments and meaning.

Stage: record. Each types its operands and records one operation of the table (or a few); outside a recording they
evaluate at once. Meaning at the edges: docs/numerics.md. All raise ShpyTypeError for operands that do not fit.

A row of the table that has a docstring becomes a function here, with the row's parameters:

    clamp(x, low, high)    # "Limit x: min(max(x, low), high); ints too."
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from shpy.errors import ShpyTypeError
from shpy.ir.constants import is_int
from shpy.ir.ops import COMPOSITES, OPS, Op
from shpy.ir.types import FLOATS, INTS, Base, vec
from shpy.lang.recording.location import here, on_one_line
from shpy.lang.recording.recorder import need_frame
from shpy.lang.values import arithmetic
from shpy.lang.values.abstract import CLASSES
from shpy.lang.values.arithmetic import base_of, elementwise, emit, emitter_of, make_value, operand, read, select
from shpy.lang.values.coerce import Literal, common_kind, common_size

__all__ = ["FUNCTIONS"]

if TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """Return a function of the table."""


# What rows record


def _components(row: Op, *args: Any) -> Any:
    """Record an operation on operands that meet in one type; for a row of floats, ints become f."""
    return elementwise(row.name, args, f"sh.{row.name}", floats=row.bases == FLOATS)


@on_one_line
def _vectors(row: Op, *args: Any) -> Any:
    """Record an operation on whole vectors of one type; some operations take scalars beside them."""
    what = f"sh.{row.name}"
    operands = [operand(a, what) for a in args]
    whole = [o for o, letter in zip(operands, row.takes, strict=True) if letter != "S"]
    for o, letter, name in zip(operands, row.takes, row.parameters, strict=True):
        if letter == "S" and o.size > 1:
            text = f"{name} of {what} is one number, not a vector of {o.size}"
            raise ShpyTypeError(text, loc=here(), cure=f"{name}.x, or another component")
    type = vec(_float_base(operands, what), common_size([o.size for o in whole], what))
    types = [type.scalar if letter == "S" else type for letter in row.takes]
    emitter = emitter_of(*operands)
    handles = tuple((read(emitter, o, t), t) for o, t in zip(operands, types, strict=True))
    kind = "Attrib" if row.gives == "S" else common_kind([getattr(o, "kind", "Attrib") for o in whole])
    return emit(emitter, row.name, handles, kind, what)


def _float_base(operands: list[Any], what: str) -> Base:
    base = base_of(operands, what)
    return Base.F if base in INTS else base


def _several(row: Op, *args: Any) -> Any:
    what = f"sh.{row.name}"
    if len(args) < 2:
        raise ShpyTypeError(
            f"{what} takes two or more operands",
            loc=here(),
            cure=f"{what}(a, b); {what}(*v) for one vector's components",
        )
    result = args[0]
    for other in args[1:]:
        result = elementwise(row.name, (result, other), what)
    return result


def _modulo(row: Op, x: Any, y: Any) -> Any:
    return arithmetic.binary("floormod", x, y, "sh.mod")


def _rotated(row: Op, x: Any, n: Any) -> Any:
    return arithmetic.binary(row.name, x, n, f"sh.{row.name}")


def _choice(row: Op, c: Any, a: Any, b: Any) -> Any:
    return select(c, a, b)


def _mixed(row: Op, a: Any, b: Any, t: Any) -> Any:
    chooser = operand(t, "sh.mix")
    if base_of((chooser,), "sh.mix") is Base.B:
        return select(t, b, a)
    return _components(row, a, b, t)


def _scaled(row: Op, x: Any, n: Any) -> Any:
    value, exponent = operand(x, "sh.ldexp"), operand(n, "sh.ldexp")
    type = vec(_float_base([value], "sh.ldexp"), common_size((value.size, exponent.size), "sh.ldexp"))
    if base_of((exponent,), "sh.ldexp") is not Base.I:
        raise ShpyTypeError("the exponent of sh.ldexp is of type i", loc=here(), cure="sh.ldexp(x, sh.Attrib1i(n))")
    count = type.based(Base.I)
    emitter = emitter_of(value, exponent)
    handles = ((read(emitter, value, type), type), (read(emitter, exponent, count), count))
    return emit(emitter, "ldexp", handles, common_kind([getattr(value, "kind", "Attrib")]), "sh.ldexp")


def _of_bits(row: Op, u: Any) -> Any:
    bits = operand(u, "sh.float_from_bits")
    word = isinstance(bits, Literal) and bits.weak == "int"  # an int of Python: bits, not a number of type i
    return _components(row, CLASSES["Attrib", bits.size, Base.U](u) if word else u)


def _unit(row: Op, u: Any) -> Any:
    word = operand(u, "sh.unit_float")
    constant = isinstance(word, Literal)
    if word.weak != "int" if isinstance(word, Literal) else word.base is not Base.U:
        raise ShpyTypeError("sh.unit_float takes u", loc=here(), cure="sh.unit_float(sh.hash(u))")
    return _components(row, CLASSES["Attrib", word.size, Base.U](u) if constant else u)


_OWN: Final[Mapping[str, Callable[..., Any]]] = {
    "cond": _choice,
    "float_from_bits": _of_bits,
    "ldexp": _scaled,
    "max": _several,
    "min": _several,
    "mix": _mixed,
    "mod": _modulo,
    "rotl": _rotated,
    "rotr": _rotated,
    "unit_float": _unit,
}
"""Rows whose functions take more than the row does, or operands that do not meet in one type."""


def _function(row: Op) -> Callable[..., Any]:
    """Return the function that records a row, with the row's parameters and docstring.

    It is compiled from a line of text, so that Python itself checks the arguments and names them in its errors.
    """
    whole = row.name in COMPOSITES and not row.componentwise
    record = partial(_OWN.get(row.name) or (_vectors if whole else _components), row)
    parameters = ", ".join(row.parameters)
    line = compile(f"lambda {parameters}: record({parameters})", __file__, "eval")
    function: Callable[..., Any] = eval(line, {"record": record, "__name__": __name__})
    function.__name__ = function.__qualname__ = row.name
    function.__doc__ = row.says
    function.__annotations__ = {**dict.fromkeys((p.lstrip("*") for p in row.parameters), "Any"), "return": "Any"}
    return function


_ROWS: Final = {row.name: _function(row) for row in OPS.values() if row.says}
globals().update(_ROWS)
inversesqrt = _ROWS["rsqrt"]
floatBitsToUint = _ROWS["bits_from_float"]
uintBitsToFloat = _ROWS["float_from_bits"]


def atan(y: Any, x: Any = None) -> Any:
    """Return the arc tangent of y in radians; with two arguments, atan2(y, x)."""
    return _ROWS["atan"](y) if x is None else _ROWS["atan2"](y, x)


def saturate(x: Any) -> Any:
    """Limit x to 0 … 1: clamp(x, 0, 1)."""
    return elementwise("clamp", (x, 0, 1), "sh.saturate", floats=True)


def radians(degrees: Any) -> Any:
    """Convert degrees to radians."""
    return elementwise("mul", (degrees, math.pi / 180), "sh.radians", floats=True)


def degrees(radians: Any) -> Any:
    """Convert radians to degrees."""
    return elementwise("mul", (radians, 180 / math.pi), "sh.degrees", floats=True)


# Lanes and the grid


def _lanes(op: str, c: Any) -> Any:
    frame = need_frame(f"sh.{op}")
    value = arithmetic.condition(c, f"sh.{op}")
    return make_value("Attrib", vec(Base.B), frame, frame.let(op, (value,), vec(Base.B)))


def any_lane(c: Any) -> Any:
    """Return whether c holds for any active element that executes this together with this one."""
    return _lanes("any_lane", c)


def all_lanes(c: Any) -> Any:
    """Return whether c holds for all active elements that execute this together with this one."""
    return _lanes("all_lanes", c)


def _lane_number(op: str, x: Any) -> Any:
    frame = need_frame(f"sh.{op}")
    number = operand(x, f"sh.{op}")
    if number.size > 1 or base_of((number,), f"sh.{op}") is Base.B:
        raise ShpyTypeError(f"sh.{op} takes one number", loc=here(), cure=f"sh.{op}(v.x), for one component")
    type = vec(base_of((number,), f"sh.{op}"))
    return make_value("Attrib", type, frame, frame.let(op, (read(frame, number, type),), type))


def min_lane(x: Any) -> Any:
    """Return the least x of all active elements that execute this together with this one; of NaNs, any number."""
    return _lane_number("min_lane", x)


def max_lane(x: Any) -> Any:
    """Return the greatest x of all active elements that execute this together with this one; of NaNs, any number."""
    return _lane_number("max_lane", x)


def _grid(op: str, n: int) -> Any:
    if not is_int(n) or n not in (1, 2, 3, 4):
        raise ShpyTypeError(f"sh.{op} takes the rank of the elements' shape, 1 to 4", loc=here(), cure=f"sh.{op}(2)")
    frame = need_frame(f"sh.{op}")
    if (other := frame.recording.other_rank(n, here())) is not None:
        raise ShpyTypeError(
            f"sh.{op}({n}) takes elements of {n} axes, and {other.loc} takes {other.axes}",
            loc=here(),
            cure=f"sh.{op}({other.axes})",
        )
    return make_value("Attrib", vec(Base.I, n), frame, frame.let(op, (), vec(Base.I, n)))


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
