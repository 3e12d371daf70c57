"""The output tree: the content of a target's text, before it is spelled.

Stage: emit. `structure` makes it from prepared IR, a speller prints it. Nodes never change and compare by value, so a
decision looks at nodes, never at text.

>>> from shpy.ir.types import vec
>>> x, one = Name(vec("i"), "x"), Literal(vec("i"), 1)
>>> infix("-", x, infix("+", x, one)).args[1].symbol
'+'
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

from shpy.ir.frozen import dataclass
from shpy.ir.nodes import Loc
from shpy.ir.types import Base, Type, vec

BOOL: Final = vec(Base.B)
INT: Final = vec(Base.I)
UINT: Final = vec(Base.U)
COMPONENTS: Final = "xyzw"


@dataclass(frozen=True, slots=True)
class Own:
    """A type that only the target has, such as `size_t`."""

    name: str


@dataclass(frozen=True, slots=True)
class Pointer:
    """A pointer to values of a type; `space` stands before the type, as `__global const`."""

    to: Type | Own
    space: str = ""


AnyType = Type | Own | Pointer


@dataclass(frozen=True, slots=True)
class Expr:
    """An expression; `type` is what the target computes, for instance a uint where the IR has an int."""

    type: Type

    @property
    def parts(self) -> tuple[Expr, ...]:
        """The expressions directly inside: all fields that hold some."""
        if isinstance(self, _APPLIED):
            return self.args
        parts: list[Expr] = []
        for name in self.__match_args__:
            content = getattr(self, name)
            if isinstance(content, Expr):
                parts.append(content)
            elif isinstance(content, tuple):
                parts += [e for e in content if isinstance(e, Expr)]
        return tuple(parts)

    @property
    def splat(self) -> Expr | None:
        """The scalar that a vector repeats."""
        return None


@dataclass(frozen=True, slots=True)
class Name(Expr):
    """A variable, parameter, temporary or uniform."""

    text: str


@dataclass(frozen=True, slots=True)
class Literal(Expr):
    """A number of a scalar type."""

    value: float | int | bool


_LEAVES = (Name, Literal)
"""The expressions without parts that are most frequent."""


@dataclass(frozen=True, slots=True)
class Operator(Expr):
    """A prefix operator, an infix one, or the choice "?", by the number of arguments."""

    symbol: str
    args: tuple[Expr, ...]


@dataclass(frozen=True, slots=True)
class Call(Expr):
    """A function applied to arguments."""

    function: str
    args: tuple[Expr, ...]


@dataclass(frozen=True, slots=True)
class Construct(Expr):
    """A vector from scalars and vectors, or from one scalar that is repeated."""

    args: tuple[Expr, ...]

    @property
    def splat(self) -> Expr | None:
        """The only argument, unless that is a vector of the same size."""
        return self.args[0] if len(self.args) == 1 else None


_APPLIED = (Operator, Call, Construct)
"""The expressions all of whose parts are arguments."""


@dataclass(frozen=True, slots=True)
class Cast(Expr):
    """Conversion by the language's own cast; `to` is a type that only the target has."""

    of: Expr
    to: Own | None = None


@dataclass(frozen=True, slots=True)
class Member(Expr):
    """Components of a vector, or a field of a struct."""

    of: Expr
    field: str


@dataclass(frozen=True, slots=True)
class Index(Expr):
    """An element of an array or a component of a vector."""

    of: Expr
    at: Expr


@dataclass(frozen=True, slots=True)
class Method(Expr):
    """A method of an object, applied to arguments."""

    of: Expr
    name: str
    args: tuple[Expr, ...] = ()


@dataclass(frozen=True, slots=True)
class Tuple(Expr):
    """Several values side by side, as Python returns and assigns them."""

    args: tuple[Expr, ...]


@dataclass(frozen=True, slots=True)
class Slice(Expr):
    """An index of several components in a row, up to `stop`; `start` None is the first."""

    start: int | None
    stop: int


@dataclass(frozen=True, slots=True)
class ListDisplay(Tuple):
    """A list, which as an index gives a copy."""


@dataclass(frozen=True, slots=True)
class NamedArgument(Expr):
    """An argument by its name, as Python has them."""

    name: str
    value: Expr


# Statements


@dataclass(frozen=True, slots=True)
class Declare:
    """A new variable, with its first value or without; `length` makes an array whose elements are all `value`."""

    type: AnyType
    name: str
    value: Expr | None = None
    length: int | None = None
    loc: Loc | None = None


@dataclass(frozen=True, slots=True)
class Assign:
    """`target = value`; a speller writes an update, such as `x += 1`, where the value begins with the target."""

    target: Expr
    value: Expr
    loc: Loc | None = None


@dataclass(frozen=True, slots=True)
class Do:
    """An expression as a statement."""

    value: Expr
    loc: Loc | None = None


@dataclass(frozen=True, slots=True)
class If:
    """A choice. An `orelse` of one `If` alone is spelled `else if`."""

    condition: Expr
    then: Block
    orelse: Block = ()
    loc: Loc | None = None


@dataclass(frozen=True, slots=True)
class Loop:
    """A loop: `test` is tried before each iteration, `again` after it; with neither it goes on for ever.

    With a `step` it is a `for`, whose `starts` begin it. `note` is a remark behind its head.
    """

    body: Block
    starts: tuple[Declare, ...] = ()
    test: Expr | None = None
    step: Assign | None = None
    again: Expr | None = None
    loc: Loc | None = None
    again_loc: Loc | None = None
    note: str = ""


@dataclass(frozen=True, slots=True)
class Update:
    """`target += value`: the array that the target names changes. Only where arrays are objects, as in Python."""

    target: Name
    symbol: str
    value: Expr
    loc: Loc | None = None


@dataclass(frozen=True, slots=True)
class Each:
    """A loop over the values of a sequence: `for name in over`."""

    name: Name
    over: Expr
    body: Block
    loc: Loc | None = None


@dataclass(frozen=True, slots=True)
class Exit:
    """`break`, `continue` or `return`."""

    word: str
    value: Expr | None = None
    loc: Loc | None = None


Stmt = Declare | Assign | Update | Do | If | Loop | Each | Exit
Block = tuple[Stmt, ...]


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter; `passed` is a word such as `inout`, `length` that of an array."""

    type: AnyType
    name: str
    passed: str = ""
    length: int | None = None


@dataclass(frozen=True, slots=True)
class Function:
    """A function; `result` None gives nothing, `qualifiers` stand before the result's type."""

    name: str
    result: AnyType | None
    parameters: tuple[Parameter, ...]
    body: Block
    loc: Loc | None = None
    qualifiers: tuple[str, ...] = ()


# Makers


def infix(symbol: str, a: Expr, b: Expr, type: Type | None = None) -> Operator:
    """Return `a symbol b`, of a's type if no other is given."""
    return Operator(type or a.type, symbol, (a, b))


def prefix(symbol: str, e: Expr, type: Type | None = None) -> Operator:
    """Return `symbol e`."""
    return Operator(type or e.type, symbol, (e,))


def choice(c: Expr, a: Expr, b: Expr) -> Operator:
    """Return `c ? a : b`."""
    return Operator(a.type, "?", (c, a, b))


def call(function: str, type: Type, *args: Expr) -> Call:
    """Return `function(args)`."""
    return Call(type, function, args)


def picked(e: Expr, components: Sequence[int], type: Type) -> Member:
    """Return `e.xy`, or `e.s06` of a vector of eight, which OpenCL alone has."""
    if isinstance(e.type, Type) and e.type.size > len(COMPONENTS):
        return Member(type, e, f"s{''.join(map(str, components))}")
    return Member(type, e, "".join([COMPONENTS[c] for c in components]))


def several(values: Sequence[Expr]) -> Expr:
    """Return the value if there is one, else a Tuple of the values."""
    return values[0] if len(values) == 1 else Tuple(BOOL, tuple(values))


def number(value: int, type: Type = INT) -> Literal:
    """Return a whole number."""
    return Literal(type, value)


_OPPOSITE: Final = {"==": "!=", "!=": "==", "<": ">=", "<=": ">", ">": "<=", ">=": "<"}


def negation(e: Expr) -> Expr:
    """Return the opposite of a scalar bool; `!(a < b)` is `a >= b` where no operand can be a NaN."""
    if isinstance(e, Operator):
        if e.symbol == "!":
            return e.args[0]
        if e.symbol in _OPPOSITE and (e.symbol in ("==", "!=") or not e.args[0].type.is_float):
            return replace(e, symbol=_OPPOSITE[e.symbol])
    return prefix("!", e)


def walk(e: Expr) -> Iterator[Expr]:
    """Yield the expression and all expressions inside it."""
    pending = [e]
    while pending:
        e = pending.pop()
        yield e
        if not isinstance(e, _LEAVES):
            pending += e.parts[::-1]


def statements_of(block: Block) -> Iterator[Stmt]:
    """Yield the statements of a block and all inside them."""
    for s in block:
        yield s
        match s:
            case If():
                yield from statements_of((*s.then, *s.orelse))
            case Loop():
                yield from statements_of((*s.starts, *(() if s.step is None else (s.step,)), *s.body))
            case Each():
                yield from statements_of(s.body)


def expressions_of(s: Stmt) -> list[Expr]:
    """Return the expressions of a statement itself, not those of the statements inside it."""
    match s:
        case Assign() | Update():
            return [s.target, s.value]
        case If():
            return [s.condition]
        case Each():
            return [s.name, s.over]
        case Loop():
            return [e for e in (s.test, s.again) if e is not None]
    return [] if s.value is None else [s.value]


def measure(e: Expr) -> tuple[int, int]:
    """Return how deep an expression nests and, nearly, how many letters it has."""
    if isinstance(e, Name):
        return 0, len(e.text)
    if isinstance(e, Literal):
        return 0, _letters_of(e)
    inner = [measure(part) for part in e.parts]
    depth, letters = max([d for d, _ in inner], default=-1), sum([w for _, w in inner])
    match e:
        case Member():
            return depth, letters + 1 + len(e.field)
        case Operator(_, "?", _):
            return depth + 1, letters + 6
        case Operator():
            return depth + 1, letters + (1 if len(inner) == 1 else 3)
        case Call():
            return depth + 1, letters + len(e.function) + 2 * len(inner)
        case Construct() if all(isinstance(part, Literal) for part in e.args):
            return depth + 1, letters + 8 + 2 * len(inner)
    return depth + 1, letters + 6 + 2 * len(inner)


def _letters_of(number: Literal) -> int:
    """Return how many letters a number has, nearly."""
    if number.type.base is not Base.F:
        return len(repr(number.value))
    text = f"{number.value:.8g}"
    return len(text) + (1 if "." in text or "e" in text or number.value != number.value else 3)
