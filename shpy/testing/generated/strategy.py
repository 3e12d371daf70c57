"""A hypothesis strategy of well-typed programs that end: nested loops and branches with every exit, reads and calls.

Stage: test. Gives trees, and programs recorded from them.

    @given(sh.testing.programs())
    def test_it_agrees(program):
        sh.testing.assert_equivalent(program, *sh.testing.inputs(program, 16))
"""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from shpy.ir.types import Type
from shpy.testing.generated.expressions import TYPES
from shpy.testing.generated.inputs import INPUTS
from shpy.testing.generated.source import Generated, record
from shpy.testing.generated.statements import Statements, flat
from shpy.testing.generated.syntax import (
    F2,
    F3,
    I2,
    Apply,
    Assign,
    B,
    Block,
    Const,
    Construct,
    Convert,
    Declare,
    Expr,
    F,
    Function,
    I,
    Name,
    Splat,
    Stmt,
    Swizzle,
    Tree,
    U,
    Variable,
)

__all__ = ["programs", "trees"]

PARAMS = (Variable("p", F), Variable("q", F3), Variable("m", I), Variable("own", F, 3))
_A, _V, _N, _H = Name(F, "a"), Name(F3, "v"), Name(I, "n"), Name(U, "h")
STARTS: dict[Type, Expr] = {
    F: Apply(F, "mul", (_A, Const(F, (0.5,)))),
    I: Apply(I, "sub", (_N, Const(I, (1,)))),
    F3: Apply(F3, "add", (_V, Splat(F3, _A))),
    U: Apply(U, "xor", (_H, Const(U, (5,)))),
    B: Apply(B, "lt", (_A, Swizzle(F, _V, (1,)))),
    F2: Swizzle(F2, _V, (2, 0)),
    I2: Construct(I2, (_N, Convert(I, _H))),
}


def _function(draw: Any, name: str, earlier: list[Function]) -> Function:
    """A subroutine, which may call those before it."""
    params = PARAMS[: draw(st.integers(1, 4))]
    stored = frozenset(p.name for p in params if p.length is not None or draw(st.booleans()))
    w = Statements(draw, {p.name: p.type for p in params if p.length is None}, budget=8, functions=earlier)
    w.arrays = [p for p in params if p.length is not None]
    if not w.arrays:
        w.functions = [f for f in earlier if not any(p.length for p in f.params)]
    w.names["r"], w.names["c"] = F, I
    w.stored = ["r", "c", *(p.name for p in params if p.length is None and p.name in stored)]
    w.depth = 1
    start: Block = (Declare("r", w.const(F)), Declare("c", w.const(I)))
    body = start + flat(w.block(goes_on=True))
    # What is said to be stored into must be, or the language passes it by value.
    body += tuple(Assign(n, Const(t, (1.0,) * t.size), None, "add") for n, t in w.names.items() if n in stored)
    return Function(name, params, stored, body, (Name(F, "r"),))


@st.composite
def trees(draw: Any, endless: bool = False) -> Tree:
    """The syntax of a program over INPUTS; with `endless` its loops may go beyond its `loop_limit`."""
    functions: list[Function] = []
    for k in range(draw(st.integers(0, 2))):
        functions.append(_function(draw, f"sub{k}", functions))
    w = Statements(
        draw, {i.name: i.type for i in INPUTS}, [i.name for i in INPUTS], functions=functions, endless=endless
    )
    w.arrays = [Variable("own", F, 3)]
    start: list[Stmt] = []
    for n, type in enumerate(TYPES):
        # Seldom a constant: where all elements agree, they all take one way.
        start.append(Declare(f"x{n}", w.const(type) if w.chance(15) else STARTS[type]))
        w.names[f"x{n}"] = type
        w.stored.append(f"x{n}")
    body = flat(w.block(3))
    results = tuple(Name(type, f"x{n}") for n, type in enumerate(TYPES))
    tables: tuple[tuple[str, Type, int], ...] = (("line", F, 1), ("grid", F2, 2), ("counts", I, 1))
    limit = 6 if endless else None
    return Tree(INPUTS, tuple(w.arrays), tables, tuple(functions), (*start, *body), results, limit)


def programs(endless: bool = False) -> SearchStrategy[Generated]:
    """Recorded programs over INPUTS; with `endless` their loops may go beyond the `loop_limit` of their tree."""
    return trees(endless=endless).map(record)
