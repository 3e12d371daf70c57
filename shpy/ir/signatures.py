"""The type rules of the structural operations, which the op table cannot state in a line.

Stage: represent. Each rule takes a `Let`, the types of its operands, and the scope of its function. It returns the type
that the value must have, or raises TypeError with a sentence that describes the fault. The verifier applies them.

>>> from shpy.ir.nodes import Value
>>> let = Let(Value(1, vec("f", 3)), "splat", (0,))
>>> structural_type(let, (vec("f"),), Declarations())
f3
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

from shpy.ir.constants import bits_to_float, float_to_bits
from shpy.ir.nodes import Function, Let, Param, Table, Variable
from shpy.ir.text import quote
from shpy.ir.types import SIZES, Base, Type, vec

Types = tuple[Type, ...]


@dataclass(slots=True)
class Declarations:
    """The declarations that an operation can refer to: slots by id; params, tables and earlier functions by name."""

    variables: dict[int, Variable] = field(default_factory=dict)
    params: dict[str, Param] = field(default_factory=dict)
    tables: dict[str, Table] = field(default_factory=dict)
    functions: dict[str, Function] = field(default_factory=dict)


def structural_type(let: Let, args: Types, scope: Declarations) -> Type:
    """Return the type that the value of a structural operation must have; TypeError if the operation is wrong."""
    if let.attr is not None and let.op not in _WITH_ATTR:
        raise TypeError(f"{let.op} takes no attribute, not {let.attr!r}")
    return _RULES[let.op](let, args, scope)


def spoken_types(types: Types) -> str:
    """Return types as text: `(f, i3)`."""
    return f"({', '.join(map(repr, types))})"


def counted(number: int, thing: str) -> str:
    """Return a number with its noun: `1 input`, `2 inputs`."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def _need(let: Let, args: Types, holds: bool, expected: str) -> None:
    if not holds:
        raise TypeError(f"{let.op} takes {expected}, not {spoken_types(args)}")


def check_index(what: str, index: Type) -> None:
    """Raise TypeError unless `index` is a type that can index an array."""
    if index is not vec(Base.I):
        raise TypeError(f"the index of {what} is an i, not {index!r}")


def check_constant(type: Type, attr: object) -> None:
    """Raise TypeError unless each component of `attr` is a constant of the base of `type`."""
    if not isinstance(attr, tuple) or any(c.__class__ is not int for c in attr):
        raise TypeError(f"a constant holds a tuple of whole numbers, not {attr!r}")
    if len(attr) != type.size:
        raise TypeError(f"a constant of {type!r} holds {counted(type.size, 'component')}, not {len(attr)}")
    low, high = _LIMITS.get(type.base, (0, 2**64 - 1))
    for component in attr:
        if not low <= component <= high:
            raise TypeError(f"a component of {type!r} lies between {low} and {high}, {component} does not")
        if type.is_float and float_to_bits(bits_to_float(component)) != component:
            raise TypeError(f"every NaN is held as {float_to_bits(float('nan')):#x}, not {component:#x}")


_LIMITS: Final[Mapping[Base, tuple[int, int]]] = {
    Base.I: (-(2**31), 2**31 - 1),
    Base.U: (0, 2**32 - 1),
    Base.B: (0, 1),
}


def _const(let: Let, args: Types, scope: Declarations) -> Type:
    _need(let, args, not args, "no operands")
    check_constant(let.value.type, let.attr)
    return let.value.type


def _load(let: Let, args: Types, scope: Declarations) -> Type:
    if not isinstance(let.attr, int):
        raise TypeError(f"load names a variable by its id, not {let.attr!r}")
    slot = scope.variables.get(let.attr)
    if slot is None:
        raise TypeError(f"there is no variable ${let.attr}")
    if slot.length is None:
        _need(let, args, not args, "no index: the variable is no array")
    else:
        _need(let, args, len(args) == 1, "one index: the variable is an array")
        check_index(f"${slot.id}", args[0])
    return slot.type


def _construct(let: Let, args: Types, scope: Declarations) -> Type:
    type = let.value.type
    expected = f"{counted(type.size, 'component')} of {type.base.value} in all"
    holds = type.size > 1 and sum(a.size for a in args) == type.size and all(a.base is type.base for a in args)
    _need(let, args, holds, expected if type.size > 1 else "scalars and vectors to make a vector")
    return type


def _splat(let: Let, args: Types, scope: Declarations) -> Type:
    _need(let, args, len(args) == 1 and args[0].size == 1, "one scalar")
    return args[0].sized(max(let.value.type.size, 2))


def _swizzle(let: Let, args: Types, scope: Declarations) -> Type:
    _need(let, args, len(args) == 1 and args[0].size > 1, "one vector (splat repeats a scalar)")
    picked = let.attr
    if not isinstance(picked, tuple) or len(picked) not in SIZES:
        raise TypeError(f"swizzle picks one to four components, or eight, not {picked!r}")
    for component in picked:
        if not 0 <= component < args[0].size:
            raise TypeError(f"{args[0]!r} has components 0 to {args[0].size - 1}, not {component}")
    return args[0].sized(len(picked))


def _component(let: Let, args: Types, scope: Declarations) -> Type:
    _need(let, args, len(args) == 2 and args[0].size > 1 and args[1] is vec(Base.I), "a vector and an i")
    return args[0].scalar


def _convert(let: Let, args: Types, scope: Declarations) -> Type:
    type = let.value.type
    holds = len(args) == 1 and args[0].size == type.size and args[0].base is not type.base
    _need(let, args, holds, f"one operand of another base and as many components as {type!r}")
    return type


def _param(let: Let, args: Types, scope: Declarations) -> Type:
    _need(let, args, not args, "no operands")
    param = scope.params.get(str(let.attr))
    if param is None:
        raise TypeError(f"there is no param {_quoted(let.attr)}")
    return param.type


def _find_table(let: Let, scope: Declarations) -> Table:
    table = scope.tables.get(str(let.attr))
    if table is None:
        raise TypeError(f"there is no table {_quoted(let.attr)}")
    return table


def _table(let: Let, args: Types, scope: Declarations) -> Type:
    table = _find_table(let, scope)
    index = vec(Base.I, table.rank)
    _need(let, args, args == (index,), f"an index of {index!r}, because the table's rank is {table.rank}")
    return table.type


def _neighbour(let: Let, args: Types, scope: Declarations) -> Type:
    table = _find_table(let, scope)
    types = (vec(Base.I),) * table.rank
    told = f"an i for each of the table's axes, {table.rank}, and a modulus for each or none"
    _need(let, args, args in (types, types * 2), told)
    return table.type


def _table_size(let: Let, args: Types, scope: Declarations) -> Type:
    _need(let, args, not args, "no operands")
    return vec(Base.I, _find_table(let, scope).rank)


def _grid(let: Let, args: Types, scope: Declarations) -> Type:
    _need(let, args, not args, "no operands")
    return let.value.type.based(Base.I)


def _lanes(let: Let, args: Types, scope: Declarations) -> Type:
    _need(let, args, args == (vec(Base.B),), "one b")
    return vec(Base.B)


def _lane_number(let: Let, args: Types, scope: Declarations) -> Type:
    _need(let, args, len(args) == 1 and args[0].size == 1 and not args[0].is_bool, "one number")
    return args[0]


def _mask(let: Let, args: Types, scope: Declarations) -> Type:
    _need(let, args, not args, "no operands")
    return vec(Base.B)


def _call(let: Let, args: Types, scope: Declarations) -> Type:
    callee = scope.functions.get(str(let.attr))
    if callee is None:
        raise TypeError(f"no function {_quoted(let.attr)} is declared before this one")
    if not callee.pure:
        raise TypeError(f"{quote(callee.name)} is not pure: it is called by a statement")
    types = tuple(i.type for i in callee.inputs)
    if args != types:
        raise TypeError(f"{quote(callee.name)} takes {spoken_types(types)}, not {spoken_types(args)}")
    return callee.outputs[0].type


def _half(let: Let, args: Types, scope: Declarations) -> Type:
    _need(let, args, len(args) == 1 and args[0].base is Base.F, "one operand of f")
    return args[0]


def _quoted(attr: object) -> str:
    return quote(attr) if isinstance(attr, str) else repr(attr)


_WITH_ATTR: Final = frozenset({"const", "load", "swizzle", "param", "table", "table_size", "neighbour", "call"})
_RULES: Final[Mapping[str, Callable[[Let, Types, Declarations], Type]]] = {
    "const": _const,
    "load": _load,
    "construct": _construct,
    "splat": _splat,
    "swizzle": _swizzle,
    "component": _component,
    "convert": _convert,
    "param": _param,
    "table": _table,
    "table_size": _table_size,
    "neighbour": _neighbour,
    "grid_index": _grid,
    "grid_line": _grid,
    "grid_shape": _grid,
    "any_lane": _lanes,
    "all_lanes": _lanes,
    "lane_mask": _mask,
    "lane_any": _lanes,
    "min_lane": _lane_number,
    "max_lane": _lane_number,
    "lane_min": _lane_number,
    "lane_max": _lane_number,
    "call": _call,
    "half": _half,
}
