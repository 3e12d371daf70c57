"""Operations as numpy has them.

Stage: emit. An operation is numpy's own function where this has exactly the meaning of the table, and else the function
of `shpy.ir.meaning`. Every vector operation works component by component on (size, lanes), so a
splat beside a true vector is left to numpy's broadcasting. A literal takes its type from the other operand, or is given
one (`own`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from shpy.backend.emit import tree
from shpy.backend.emit.entry import Needs, Unit, needed_by, needs_of
from shpy.backend.emit.names import Names
from shpy.backend.emit.operations import OPERATORS, Operations
from shpy.backend.emit.spell_python import PythonSpeller, dtype
from shpy.backend.emit.tree import BOOL, INT, Construct, Expr, Index, Literal, Member, Method, Name, Operator, Tuple
from shpy.backend.numpy import lanes as lane_functions
from shpy.backend.numpy.text.iterations import lanes_alone
from shpy.ir import meaning
from shpy.ir.nodes import Function, Let, Module
from shpy.ir.ops import COMPOSITES, OPS
from shpy.ir.types import Base, Type

INFIX: Final = {op: symbol for op, symbol in OPERATORS.items() if op not in ("shl", "shr", "quot", "rem")}
"""Operations that are operators of Python."""
UPDATES: Final = {"add": ("+",), "sub": ("-",), "mul": ("*",), "mad": ("*", "+")}
"""By operation, the operators that update its first operand with each of the others in turn."""
_NUMPY: Final = {"abs": "abs"} | {
    row.name: row.function.__name__ for row in OPS.values() if isinstance(row.function, np.ufunc) and row.name != "abs"
}
"""The function of numpy that is the table's meaning of an operation."""
_MEANING: Final = {
    row.name: row.function.__name__
    for row in OPS.values()
    if getattr(row.function, "__module__", "") == meaning.__name__
}
"""The function of `shpy.ir.meaning` that is."""
MEANINGS: Final = frozenset(_MEANING.values()) | {"convert"}
"""The functions of `shpy.ir.meaning` that text may import."""
LANES: Final = "lanes", ""
"""The argument of a function that needs the number of lanes."""
EXACT: Final = frozenset({"exact"})
_RESERVED: Final = ("np", *EXACT, "lanes", "grid_index", "grid_shape", *MEANINGS, *lane_functions.__all__)
_GEOMETRY: Final = frozenset(name for name in COMPOSITES if not OPS[name].componentwise)
_SYMBOLS: Final = {"shl": "<<", "shr": ">>", "floordiv": "//", "floormod": "%"}
"""Python's operators do these too, but for some operands on the right."""
_LITERALS_WELCOME: Final = frozenset({"min", "max", "clamp", "mod", "atan2"})
"""Functions that give a literal the type of the other operand."""


def own(e: Expr) -> Expr:
    """Return the expression with an explicit dtype if it is a literal, whose type numpy would choose."""
    return tree.call(dtype(e.type), e.type, e) if isinstance(e, Literal) else e


def word(text: str) -> Name:
    """Return a name of numpy's or of the text's: a dtype, a function."""
    return Name(BOOL, text)


def zeros(type: Type, lanes: Expr | None, length: int | None = None) -> Expr:
    """Return an array of zeros for a variable; `lanes` is None for a uniform one."""
    extents: list[Expr] = [tree.number(length)] if length is not None else []
    if type.size > 1:
        extents.append(tree.number(type.size))
    if extents or lanes is not None:
        extents.append(tree.number(1) if lanes is None else lanes)
        shape = extents[0] if len(extents) == 1 else Tuple(INT, tuple(extents))
        return tree.call("np.zeros", type, shape, word(dtype(type)))
    return tree.call(dtype(type), type, Literal(INT, False if type.is_bool else 0))


def is_shared(e: Expr) -> bool:
    """Return whether an expression may be a view of what a name holds, and not a new array."""
    match e:
        case Name() | Member() | Method(_, _, "neighbour", _):
            return True
        case Operator(_, "?", _):
            return True
        case Index(_, _, at):
            return not isinstance(at, tree.ListDisplay)
    return False


def is_atom(e: Expr) -> bool:
    """Return whether an expression is a name, a number, or a part of one that costs nothing: each use writes it."""
    match e:
        case Name() | Literal():
            return True
        case Member(_, of) | Construct(_, (of,)):
            return is_atom(of)
        case Index(_, of, at):
            return is_atom(of) and not isinstance(at, tree.ListDisplay)
    return False


def is_row(components: Sequence[int]) -> bool:
    """Return whether components follow each other: numpy gives a view of these."""
    return tuple(components) == tuple(range(components[0], components[-1] + 1))


def components_of(components: Sequence[int], *, from_start: bool = False) -> Expr:
    """Return the index of some components: a number, a slice of several in a row, or a list, which makes a copy."""
    first, last = components[0], components[-1]
    if len(components) == 1:
        return tree.number(first)
    if is_row(components):
        return tree.Slice(INT, None if from_start and not first else first, last + 1)
    return tree.ListDisplay(INT, tuple([tree.number(c) for c in components]))


def handed_on(module: Module) -> dict[str, list[tuple[str, str]]]:
    """Return the arguments that each function needs besides its inputs, also for the functions that it calls."""

    def needed(let: Let) -> Needs:
        return needed_by(let) | ({("place", "")} if let.op == "neighbour" else frozenset())

    named = [*(("param", p.name) for p in module.params), *(("table", t.name) for t in module.tables)]
    every = [*named, ("place", ""), ("grid_index", ""), ("grid_shape", "")]
    needs = needs_of(module, needed)
    at_places = {("place", ""), ("grid_index", "")}
    # The arguments of other pure functions tell the number of lanes.
    lanes = {f.name: [] if f.pure and at_places.isdisjoint(needs[f.name]) else [LANES] for f in module.functions}
    return {f.name: [key for key in every if key in needs[f.name]] + lanes[f.name] for f in module.functions}


class PythonUnit(Unit):
    """The state of one module: the names of functions, and the arguments that each is handed."""

    target = "python"

    def __init__(self, module: Module, exact: frozenset[str]) -> None:
        super().__init__(module)
        self.exact = exact
        self.handed = handed_on(module)
        entry = module.entry.name
        self.globals = Names("python", (*_RESERVED, *(kind for kind, what in self.handed[entry] if not what)))
        self.functions = {f.name: self.globals.take(f.name, "f") for f in module.functions}
        self.alone = lanes_alone(module.functions)
        self.ruler = PythonSpeller()
        """The speller that tells how long a text is."""


class NumpyOperations(Operations):
    """Makes the expressions of one function. `varying` are the values that differ from lane to lane."""

    unit: PythonUnit

    def __init__(self, unit: PythonUnit, function: Function, varying: frozenset[int]) -> None:
        super().__init__(unit, function)
        self.varying = varying
        self.extra_arguments: dict[tuple[str, str], Name] = {}
        """The values that the function is handed besides its arguments."""
        self.lanes: Expr = Name(INT, "lanes")
        """The number of lanes."""

    def context(self, function: str) -> tuple[Expr, ...]:
        """Return the names that a call passes on besides the arguments."""
        return tuple([self.lanes if key == LANES else self.extra_arguments[key] for key in self.unit.handed[function]])

    def operation(self, let: Let) -> Expr:
        """Return the expression of one Let."""
        args, types, type = self.args(let), [self.types[a] for a in let.args], let.value.type
        match let.op:
            case "const":
                return self.op_const(let)
            case "load" | "swizzle" | "param" | "grid_index" | "grid_shape" | "table" | "table_size" | "neighbour":
                return self.named(let, args)
            case "call":
                return self.called(str(let.attr), type, map(own, args))
            case "construct":
                function = "vector" if all(t.size == 1 for t in types) else "joined"
                return tree.call(function, type, *map(own, args))
            case "splat":
                return Construct(type, (args[0],))
            case "component" | "half":
                return tree.call(let.op, type, *map(own, args))
            case "any" | "all":
                axis = tree.NamedArgument(INT, "axis", tree.number(0))
                return tree.call(f"np.{let.op}", type, args[0], axis) if types[0].size > 1 else args[0]
            case "convert":
                return self.converted(own(args[0]), types[0], type)
            case "fold":
                return tree.call("fold", type, word(str(let.attr)), args[0], own(args[1]))
            case "lane_any":
                compound = isinstance(args[0], Operator)
                return tree.call("np.any", BOOL, args[0]) if compound else Method(BOOL, args[0], "any")
            case "lane_min" | "lane_max":
                return tree.call(f"np.{let.op.removeprefix('lane_')}", type, args[0])
            case "lane_mask":
                return tree.call("np.ones", BOOL, self.lanes, word("np.bool_"))
            case op if op in _GEOMETRY:
                return geometry(op, args, types, type)
        repeated = [a.splat for a in args if a.splat is not None]
        if type.size > 1 and len(repeated) == len(args):
            return Construct(type, (self.elementwise(let, repeated, [t.scalar for t in types], type.scalar),))
        return self.elementwise(let, [a if a.splat is None else a.splat for a in args], types, type)

    def named(self, let: Let, args: list[Expr]) -> Expr:
        """Return an operation on values that already have a name."""
        type, what = let.value.type, let.attr
        match let.op:
            case "load":
                return self.loaded(let, args)
            case "swizzle":
                assert isinstance(what, tuple)
                return Index(type, args[0], components_of(what, from_start=True))
            case "table_size":
                return Member(type, self.extra_arguments["table", str(what)], "size")
            case "table":
                way = "gather" if let.args[0] in self.varying else "at"
                return Method(type, self.extra_arguments["table", str(what)], way, (own(args[0]),))
            case "neighbour":
                return Method(
                    type,
                    self.extra_arguments["table", str(what)],
                    "neighbour",
                    (self.extra_arguments["place", ""], *args),
                )
        return self.extra_arguments[let.op, str(what or "")]

    def loaded(self, let: Let, args: list[Expr]) -> Expr:
        """Return a variable, or an element of an array."""
        assert isinstance(let.attr, int)
        whole = self.slots[let.attr]
        match args:
            case []:
                return whole
            case [Literal(_, at)]:
                last = (self.variables[let.attr].length or 1) - 1
                return Index(let.value.type, whole, tree.number(min(max(int(at), 0), last)))
        return tree.call("pick", let.value.type, whole, args[0])

    def elementwise(self, let: Let, args: list[Expr], types: Sequence[Type], type: Type) -> Expr:
        """Return an operation on each component and lane."""
        op, varies = let.op, let.value.id in self.varying
        if all(isinstance(a, Literal) for a in args):
            args = list(map(own, args))
        if op in INFIX:
            return tree.infix(INFIX[op], args[0], args[1], type)
        match op:
            case "neg":
                return tree.prefix("-", args[0], type)
            case "not" if type is BOOL and not varies:
                return tree.negation(args[0])
            case "not":
                return tree.prefix("~", args[0], type)
            case "cond" if not varies and types[0].size == 1:
                return tree.choice(args[0], own(args[1]), own(args[2]))
            case "cond":  # two literals would choose their own type, 64 bits wide
                both = isinstance(args[1], Literal) and isinstance(args[2], Literal)
                return tree.call("select", type, args[0], own(args[1]) if both else args[1], args[2])
            case "mad":
                return tree.infix("+", tree.infix("*", own(args[0]), args[1], type), args[2], type)
            case "min" | "max":
                return tree.call(f"np.{op}imum", type, *args) if type.is_int else extremum(op, args, type)
            case "clamp":
                return extremum("min", [extremum("max", args[:2], type), args[2]], type)
            case "float_from_bits":
                whole = Method(type, args[0], "view", (word("np.float32"),))
                return whole if type.base is Base.F else Method(type, whole, "astype", (word(dtype(type)),))
            case "shl" | "shr" | "floordiv" | "floormod" if self.is_operator(let, args[1]):
                return tree.infix(_SYMBOLS[op], args[0], args[1], type)
        if op in self.unit.exact:
            return tree.call(f"exact.{op}", type, own(args[0]))
        args = args if op in _LITERALS_WELCOME else list(map(own, args))
        return tree.call(f"np.{_NUMPY[op]}" if op in _NUMPY else _MEANING[op], type, *args)

    def is_operator(self, let: Let, right: Expr) -> bool:
        """Return whether Python's operator has no edge that the right operand can reach."""
        shifts = let.op in ("shl", "shr")
        if shifts and self.types[let.args[0]] is self.types[let.args[1]] and self.ranges.within(let.args[1], 0, 31):
            return True
        return isinstance(right, Literal) and (0 <= right.value < 32 if shifts else right.value not in (0, -1))

    def converted(self, e: Expr, source: Type, target: Type) -> Expr:
        """Return the conversion to another base."""
        if target.is_bool:
            return tree.infix("!=", e, tree.number(0), target)
        if source.is_bool:
            return tree.call(dtype(target), target, e)
        if source.is_float and target.is_int:
            return tree.call("convert", target, e, word(dtype(target)))
        return Method(target, e, "astype", (word(dtype(target)),))

    def spread(self, type: Type, e: Expr) -> Expr:
        """Return a uniform expression given to every lane."""
        number = e if e.splat is None else e.splat
        if not isinstance(number, Literal):
            return tree.call("spread", type, e, self.lanes)
        if number.value == 0 and not np.signbit(number.value):
            return zeros(type, self.lanes)
        extents = self.lanes if type.size == 1 else Tuple(INT, (tree.number(type.size), self.lanes))
        return tree.call("np.full", type, extents, number, word(dtype(type)))


def geometry(op: str, args: list[Expr], types: Sequence[Type], type: Type) -> Expr:
    """Return an operation on the components of a vector together."""
    if types[0].size > 1:
        return tree.call(op, type, *map(own, args))
    return tree.call("on_components", type, word(op), *map(own, args))


def extremum(op: str, args: list[Expr], type: Type) -> Expr:
    """Return the min or max of floats: numpy's own but for NaN, and where both may be zeros of two signs."""
    literals = [a.value for a in args if isinstance(a, Literal)]
    if len(literals) == 1 and isinstance(args[0], Literal) and literals[0] == literals[0] != 0:
        args = args[::-1]  # these operations are commutative
    return tree.call(f"{op}imum", type, *(args if len(literals) < 2 else [own(args[0]), args[1]]))
