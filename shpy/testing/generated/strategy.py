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

from shpy.ir.types import Base, Type
from shpy.testing.generated.expressions import CORE, FEW, OTHERS
from shpy.testing.generated.inputs import INPUTS
from shpy.testing.generated.source import UNIFORMS, Generated, record
from shpy.testing.generated.statements import Statements, flat
from shpy.testing.generated.syntax import (
    F2,
    F3,
    Apply,
    Assign,
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
    Read,
    Splat,
    Stmt,
    Swizzle,
    Tree,
    U,
    Variable,
)

OUTPUTS = 7
"""The most outputs of a program: GL guarantees eight attachments, and the status takes one of them."""
_A, _V, _N, _H = Name(F, "a"), Name(F3, "v"), Name(I, "n"), Name(U, "h")
_PARTS: dict[Base, tuple[Expr, ...]] = {
    Base.F: (Apply(F, "mul", (_A, Const(F, (0.5,)))), _V, _A),
    Base.I: (Apply(I, "sub", (_N, Const(I, (1,)))), Convert(I, _H), _N, Convert(I, _A)),
    Base.U: (Apply(U, "xor", (_H, Const(U, (5,)))), Convert(U, _N), _H, Convert(U, _A)),
}


def _start(type: Type) -> Expr:
    """Draw the initial value of a variable: numbers that differ from element to element."""
    size = type.size
    match type.base, size:
        case Base.B, _:
            limit: Expr = _A if size == 1 else Splat(type.based(Base.F), _A)
            return Apply(type, "lt", (Swizzle(type.based(Base.F), _V, (1, 0, 2, 1)[:size]), limit))
        case Base.F, 2:
            return Swizzle(F2, _V, (2, 0))
        case Base.F, 3:
            return Apply(F3, "add", (_V, Splat(F3, _A)))
        case Base.F, 4:
            return Construct(type, (_A, _V))
        case base, 1:
            return _PARTS[base][0]
        case base, _:
            return Construct(type, _PARTS[base][:size])


def _parameters(draw: Any) -> tuple[Variable, ...]:
    """Draw parameters, mostly of the types that programs use most; the last one is an array."""
    other = draw(st.sampled_from(OTHERS)), draw(st.sampled_from(OTHERS))
    types = (F, F3, I, *other)
    return (*(Variable(n, t) for n, t in zip("pqmst", types, strict=True)), Variable("own", F, 3))


def _function(draw: Any, name: str, earlier: list[Function]) -> Function:
    """Return a subroutine, which may call those before it."""
    params = _parameters(draw)
    params = params[: draw(st.integers(1, 5))] + params[-1:] * draw(st.booleans())
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
    # A parameter that is declared as stored into must be, or the language passes it by value.
    for n, t in w.names.items():
        if n in stored:
            op = "xor" if t.is_bool else "add"
            body += (Assign(n, Apply(t, op, (Name(t, n), Const(t, (1.0,) * t.size)))),)
    return Function(name, params, stored, body, (Name(F, "r"),))


def _last(array: Variable, types: list[Type]) -> Stmt:
    """Have a result tell what an array holds in the end."""
    type = F3 if array.struct else array.type
    element = Read(type, array.name, (Name(I, "n"),), "p" if array.struct else "")
    return Assign(f"x{types.index(type)}", element, None, "xor" if type.is_bool else "add")


@st.composite
def trees(draw: Any, endless: bool = False, derives: bool = False) -> Tree:
    """Return the syntax of a program over INPUTS; with `endless` its loops may go beyond its `loop_limit`.

    With `derives` it computes with numbers that a driver's compiler can derive, and with denormals. One program of five
    computes with many elementary functions, whose formulas are long.
    """
    functions_chance = 70 if draw(st.integers(0, 4)) == 4 else 2
    shallow = draw(st.integers(0, 9)) > 6
    functions: list[Function] = []
    for k in range(0 if shallow else draw(st.integers(0, 2))):
        functions.append(_function(draw, f"sub{k}", functions))
    types_by_name = {v.name: v.type for v in (*INPUTS, *UNIFORMS)}
    # An input that is never stored into is passed on unchanged.
    stored = [i.name for i in INPUTS if draw(st.booleans())]
    w = Statements(draw, types_by_name, stored, functions=functions, endless=endless, derives=derives)
    w.functions_chance = functions_chance
    w.uniforms = tuple(v.name for v in UNIFORMS)
    types = list(CORE)
    while len(types) < OUTPUTS:
        types.append(w.pick([t for t in OTHERS if t not in types]))
    w.arrays = [Variable("own", F, 3)]
    if w.chance(60):
        w.arrays.append(Variable("many", w.pick(types), 2))
    if w.chance(20):
        w.arrays.append(Variable("pairs", F, 2, struct=True))
    start: list[Stmt] = []
    for n, type in enumerate(types):
        # Seldom a constant: elements with equal values all take the same branch.
        start.append(Declare(f"x{n}", w.const(type) if w.chance(15) else _start(type)))
        w.names[f"x{n}"] = type
        w.stored.append(f"x{n}")
    start.append(Declare(FEW, Apply(I, "clamp", (_N, Const(I, (0,)), Const(I, (2,))))))
    w.names[FEW] = I
    if shallow:  # faults of expressions show in programs that compile quickly, too
        w.deepest = 1
    body = flat(w.block(8, most=14) if shallow else w.block(3))
    body += tuple(_last(array, types) for array in w.arrays)
    results = tuple(Name(type, f"x{n}") for n, type in enumerate(types))
    tables: tuple[tuple[str, Type, int], ...] = (("line", F, 1), ("points", F3, 1), ("grid", F2, 2), ("counts", I, 1))
    limit = 6 if endless else None
    return Tree(INPUTS, tuple(w.arrays), tables, tuple(functions), (*start, *body), results, limit)


def programs(endless: bool = False, derives: bool = False) -> SearchStrategy[Generated]:
    """Draw recorded programs over INPUTS; `endless` and `derives` as for `trees`."""
    return trees(endless=endless, derives=derives).map(record)
