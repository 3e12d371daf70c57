"""Small programs as data: the syntax of generated programs.

Stage: test. `source.py` writes a tree in the language and records it.

    Tree(inputs=(Variable("a", F),), body=(Assign("x", Apply(F, "add", (Name(F, "a"), Const(F, (1.0,))))),), ...)
"""

from __future__ import annotations

from dataclasses import dataclass

from shpy.ir.types import Type, vec

F, F2, F3, I, I2, U, B, B3 = (  # noqa: E741 - the language's names
    vec("f"), vec("f", 2), vec("f", 3), vec("i"), vec("i", 2), vec("u"), vec("b"), vec("b", 3),
)  # fmt: skip

FIELDS: dict[str, Type] = {"p": F3, "k": I2}
"""The fields of `Pair`, the struct of generated programs."""

# Expressions, each with its type.


@dataclass(frozen=True)
class Const:
    """A constant, component by component."""

    type: Type
    values: tuple[float, ...]


@dataclass(frozen=True)
class Name:
    """A variable, input, param or loop index; a field of a struct (`s.p`), or a row of a matrix (`m[0]`)."""

    type: Type
    name: str


@dataclass(frozen=True)
class Apply:
    """A row of the op table; `floordiv` and `floormod` of floats too. A scalar among vectors is a Splat."""

    type: Type
    op: str
    args: tuple[Expr, ...]


@dataclass(frozen=True)
class Splat:
    """A scalar where a vector is wanted: the language broadcasts it, so it is not written."""

    type: Type
    scalar: Expr


@dataclass(frozen=True)
class Convert:
    """`sh.Attrib1i(value)` and the like."""

    type: Type
    value: Expr


@dataclass(frozen=True)
class Construct:
    """A vector of parts."""

    type: Type
    parts: tuple[Expr, ...]


@dataclass(frozen=True)
class Swizzle:
    """Components that are picked: `v.zx`."""

    type: Type
    value: Expr
    picked: tuple[int, ...]


@dataclass(frozen=True)
class Component:
    """`v[i]` with an i that is known at run time: clamped."""

    type: Type
    value: Expr
    index: Expr


@dataclass(frozen=True)
class Read:
    """An element of an Array or a Table, the nearest one where the index is out of range; of structs one `field`."""

    type: Type
    name: str
    index: tuple[Expr, ...]
    field: str = ""


@dataclass(frozen=True)
class LaneIndex:
    """An index beyond every table's end, which `any_lane` or `all_lanes` chooses: the same element either way."""

    type: Type
    how: str
    condition: Expr


@dataclass(frozen=True)
class Product:
    """`m @ v`, or `v @ m` if `left`."""

    type: Type
    matrix: str
    vector: Expr
    left: bool


Expr = Const | Name | Apply | Splat | Convert | Construct | Swizzle | Component | Read | LaneIndex | Product

# Statements


@dataclass(frozen=True)
class Declare:
    """A variable of the block: `x = sh.Attrib1f(value)`."""

    name: str
    value: Expr


@dataclass(frozen=True)
class Assign:
    """`x[:] = value`, `x.xy = value`, or with `op` `x += value`."""

    name: str
    value: Expr
    picked: tuple[int, ...] | None = None
    op: str | None = None


@dataclass(frozen=True)
class StoreAt:
    """`x[index] = value`: one component of a vector, at run time; dropped where the index is out of range."""

    name: str
    index: Expr
    value: Expr


@dataclass(frozen=True)
class Write:
    """`array[index] = value`, or with `op` `+=`, dropped where the index is out of range."""

    name: str
    index: Expr
    value: Expr
    op: str | None = None


@dataclass(frozen=True)
class WriteStruct:
    """`array[index] = Pair(value, value)`, dropped where the index is out of range."""

    name: str
    index: Expr
    values: tuple[Expr, ...]


@dataclass(frozen=True)
class DeclareMatrix:
    """`m = sh.Matrix2f(row, row)`."""

    name: str
    rows: tuple[Expr, ...]


@dataclass(frozen=True)
class Multiply:
    """`m[:] = m @ other`."""

    name: str
    other: str


@dataclass(frozen=True)
class DeclareStruct:
    """`s = Pair(value, value)`."""

    name: str
    values: tuple[Expr, ...]


@dataclass(frozen=True)
class Call:
    """`x[:] = f(a, b)`, or a call alone; `args` are Names for the parameters that f stores into."""

    function: str
    args: tuple[Expr, ...]
    result: str | None = None


@dataclass(frozen=True)
class Lanes:
    """`x[:] = value` where `condition`, chosen by any_lane or all_lanes."""

    how: str
    condition: Expr
    name: str
    value: Expr


@dataclass(frozen=True)
class If:
    """Branches (condition, block), then the block of SH_ELSE or None."""

    branches: tuple[tuple[Expr, Block], ...]
    orelse: Block | None = None


@dataclass(frozen=True)
class While:
    """`with SH_WHILE(lambda: condition)`."""

    condition: Expr
    body: Block


@dataclass(frozen=True)
class Do:
    """`late`: the condition is a lambda, evaluated at the test."""

    body: Block
    until: Expr
    late: bool = False


@dataclass(frozen=True)
class For:
    """`bounds`: one to three, as for range; the last may be a negative constant."""

    index: str
    bounds: tuple[Expr, ...]
    body: Block


@dataclass(frozen=True)
class Exit:
    """A break, continue, return or discard, with or without a condition."""

    kind: str
    condition: Expr | None = None


Plain = Declare | DeclareMatrix | DeclareStruct | Assign | StoreAt | Write | WriteStruct | Multiply
Stmt = Plain | Call | Lanes | If | While | Do | For | Exit
Block = tuple[Stmt, ...]


@dataclass(frozen=True)
class Variable:
    """An input, or an array of `length` elements, whose elements are Pairs if `struct`."""

    name: str
    type: Type
    length: int | None = None
    struct: bool = False


@dataclass(frozen=True)
class Function:
    """A subroutine: `stored` names the parameters that it stores into. It returns `results` (none or one)."""

    name: str
    params: tuple[Variable, ...]
    stored: frozenset[str]
    body: Block
    results: tuple[Expr, ...]


@dataclass(frozen=True)
class Tree:
    """A program. `arrays` are local to an element, `tables` are data; every return returns the values of `results`."""

    inputs: tuple[Variable, ...]
    arrays: tuple[Variable, ...]
    tables: tuple[tuple[str, Type, int], ...]
    functions: tuple[Function, ...]
    body: Block
    results: tuple[Expr, ...]
    loop_limit: int | None = None
