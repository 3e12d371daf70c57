"""Conformance cases of control flow: every form inside every other, with every exit in the inner one.

Each case is a small program as syntax (shpy/testing/generated/syntax.py), so that tests know what it must give without
recording it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from shpy.testing.conformance.cases import Case
from shpy.testing.generated.source import record
from shpy.testing.generated.syntax import (
    Apply,
    Assign,
    B,
    Block,
    Call,
    Const,
    Declare,
    Do,
    Exit,
    Expr,
    F,
    For,
    Function,
    I,
    If,
    Lanes,
    Name,
    Read,
    Stmt,
    Tree,
    Variable,
    While,
    Write,
)

A, N, X = Name(F, "a"), Name(I, "n"), Name(F, "x")
INPUTS = (Variable("a", F), Variable("n", I))


def number(value: float) -> Const:
    """Return a constant: an int for an int, else a float."""
    return Const(I, (value,)) if isinstance(value, int) else Const(F, (value,))


def compare(op: str, left: Expr, right: float) -> Apply:
    """Return `left op right`, a bool."""
    return Apply(B, op, (left, Const(left.type, (right,))))


def plus(name: str, value: float) -> Assign:
    """Add 1.0 to x: what was executed can be read off the sum."""
    return Assign(name, Const(F, (value,)), None, "add")


def bit(n: int) -> Apply:
    """Return whether the n-th bit of the input is set: elements take all combinations of ways."""
    return compare("ne", Apply(I, "and", (N, number(1 << n))), 0)


def when(condition: Expr, *body: Stmt) -> If:
    """`if condition: body`."""
    return If(((condition, body),))


# Forms: each wraps a block; `depth` names what it declares, `bits` are conditions that elements disagree on.


def form_if(body: Block, depth: int) -> Block:
    """Return the block under an `if`."""
    return (when(bit(depth), *body), plus("x", 0.5))


def form_elif(body: Block, depth: int) -> Block:
    """Return the block under an `elif`."""
    return (If(((bit(depth), (plus("x", 3.0),)), (bit(depth + 1), body)), (plus("x", 5.0),)),)


def form_else(body: Block, depth: int) -> Block:
    """Return the block under an `else`."""
    return (If(((bit(depth), (plus("x", 3.0),)),), body), plus("x", 0.25))


def _counter(depth: int, most: int) -> tuple[Stmt, Stmt, Expr]:
    name = f"k{depth}"
    return Declare(name, number(0)), Assign(name, number(1), None, "add"), compare("lt", Name(I, name), most)


def form_while(body: Block, depth: int) -> Block:
    """Return the block in a `while` of three iterations."""
    start, step, room = _counter(depth, 3)
    more = Apply(B, "and", (room, compare("lt", X, 300.0)))
    return (start, While(more, (step, *body, plus("x", 0.125))), plus("x", 0.5))


def form_do(body: Block, depth: int) -> Block:
    """Return the block in a `do` whose condition is a value, computed before SH_UNTIL.

    Such a condition may not read a value that an SH_CONTINUE skips: it reads the counter alone.
    """
    start, step, room = _counter(depth, 3)
    return (start, Do((step, *body, plus("x", 0.125)), Apply(B, "not", (room,)), late=False), plus("x", 0.5))


def form_do_late(body: Block, depth: int) -> Block:
    """Return the block in a `do`, its condition evaluated at the end of each iteration."""
    start, step, room = _counter(depth, 2)
    full = Apply(B, "or", (Apply(B, "not", (room,)), compare("gt", X, 300.0)))
    return (start, Do((step, *body, plus("x", 0.125)), full, late=True), plus("x", 0.5))


def _for(bounds: tuple[Expr, ...], body: Block, depth: int) -> Block:
    index = f"i{depth}"
    seen = Assign("s", Apply(I, "add", (Apply(I, "mul", (Name(I, "s"), number(3))), Name(I, index))))
    return (For(index, bounds, (seen, *body, plus("x", 0.125))), plus("x", 0.5))


def form_for(body: Block, depth: int) -> Block:
    """Return the block in `for i in range(3)`."""
    return _for((number(3),), body, depth)


def form_for_two(body: Block, depth: int) -> Block:
    """Return the block in `for i in range(-1, 2)`."""
    return _for((number(-1), number(2)), body, depth)


def form_for_step(body: Block, depth: int) -> Block:
    """Return the block in `for i in range(1, 8, 3)`."""
    return _for((number(1), number(8), number(3)), body, depth)


def form_for_down(body: Block, depth: int) -> Block:
    """Return the block in `for i in range(4, -3, -2)`."""
    return _for((number(4), number(-3), number(-2)), body, depth)


def form_for_symbolic(body: Block, depth: int) -> Block:
    """Return the block in a `for` with bounds of each element's own: some elements take no iteration."""
    return _for((Apply(I, "and", (N, number(1))), Apply(I, "and", (N, number(3)))), body, depth)


def form_for_symbolic_step(body: Block, depth: int) -> Block:
    """Return the block in a `for` whose end and step are computed."""
    step = Apply(I, "sub", (Apply(I, "mul", (Apply(I, "and", (N, number(1))), number(5))), number(2)))  # 3 or -2
    return _for((number(2), Apply(I, "sub", (Apply(I, "and", (N, number(7))), number(2))), step), body, depth)


BRANCHES = {"if": form_if, "elif": form_elif, "else": form_else}
LOOPS = {
    "while": form_while, "do": form_do, "do_late": form_do_late, "for": form_for, "for_two": form_for_two,
    "for_step": form_for_step, "for_down": form_for_down, "for_symbolic": form_for_symbolic,
    "for_symbolic_step": form_for_symbolic_step,
}  # fmt: skip
FORMS = {**BRANCHES, **LOOPS}
FORS = [name for name in LOOPS if name.startswith("for")]


def case(
    name: str, body: Block, *, functions: tuple[Function, ...] = (), limit: int | None = None, **more: Any
) -> Case:
    """Return the case of a body over `a` and `n` that computes x, s and an array."""
    start = (Declare("x", A), Declare("s", number(0)))
    results = (X, Name(I, "s"), Read(F, "own", (number(1),)))
    program = Tree(INPUTS, (Variable("own", F, 3),), (), functions, (*start, *body), results, limit)
    n = np.arange(64, dtype=np.int32)
    inputs = {"a": np.where(n % 3 == 0, np.float32(7.5), np.float32(0)), "n": n}
    options = {} if limit is None else {"loop_limit": limit}
    return Case(name, lambda: record(program), inputs, expected=program, options=options, **more)


def pairs() -> Iterator[tuple[str, str]]:
    """Yield every form of control flow nested in every form, as (outer, inner).

    The spellings of SH_FOR take turns among the pairs, and each is also nested in itself.
    """
    count = 0
    general = [*BRANCHES, "while", "do", "do_late", "for"]
    for outer in general:
        for inner in general:
            count += 1
            yield (
                (FORS[count % len(FORS)] if outer == "for" else outer),
                (FORS[count % len(FORS)] if inner == "for" else inner),
            )
    for name in FORS:
        yield name, name


def nested(outer: str, inner: str, *body: Stmt) -> Block:
    """Return the body inside one form inside another."""
    return FORMS[outer]((plus("x", 1.0), *FORMS[inner](body, 2)), 0)


def exit_cases(outer: str, inner: str) -> Iterator[Case]:
    """Yield break, continue, return and discard in the inner form: with and without conditions of their own."""
    looped = outer in LOOPS or inner in LOOPS
    kinds = (["break", "continue"] if looped else []) + ["return", "discard"]
    if (inner if inner in LOOPS else outer) == "do":
        # A condition that is made before the SH_UNTIL may not stand behind an SH_CONTINUE.
        kinds = [k for k in kinds if k != "continue"]
    conditional: list[Stmt] = []
    plain: list[Stmt] = []
    for n, kind in enumerate(kinds):
        conditional += [plus("x", 10.0 * (n + 1))]
        conditional += [Exit(kind, Apply(B, "and", (bit(n + 1), compare("gt", X, 20.0 * n))))]
        chosen = compare("eq", Apply(I, "shr", (N, number(3))), n + 1)
        plain.append(when(Apply(B, "and", (chosen, compare("ge", X, 2.0 * n))), plus("x", 16.0), Exit(kind)))
    yield case(f"{inner}_in_{outer}-conditional-exits", nested(outer, inner, *conditional, plus("x", 100.0)))
    yield case(f"{inner}_in_{outer}-exits", nested(outer, inner, *plain, plus("x", 32.0)))


def straight_cases() -> Iterator[Case]:
    """Yield an exit that ends a block for good."""
    for loop in LOOPS:
        if not loop.startswith("do"):
            for kind in ("break", "continue", "return", "discard"):
                body = (plus("x", 1.0), Exit(kind))
                inner = FORMS[loop](body, 0)
                # `_for` and the while add a statement behind; an exit must be last.
                yield case(f"{loop}-ends-in-{kind}", cut(inner))
    leaves = If(((bit(0), (Exit("return"),)), (bit(1), (Exit("discard"),)), (bit(2), (plus("x", 2.0), Exit("return")))))
    yield case("branches-that-leave", (leaves, plus("x", 1.0)))


def cut(block: Block) -> Block:
    """Return the block, and the bodies of loops in it, up to the first exit without a condition."""
    statements: list[Stmt] = []
    for s in block:
        match s:
            case While(condition, body):
                statements.append(While(condition, cut(body)))
            case For(index, bounds, body):
                statements.append(For(index, bounds, cut(body)))
            case _:
                statements.append(s)
        if isinstance(s, Exit) and s.condition is None:
            break
    return tuple(statements)


def long_chain(length: int) -> Case:
    """SH_IF with many SH_ELIFs: GLSL compilers allow few nested branches."""
    branches = tuple((compare("eq", N, n), (plus("x", float(n)),)) for n in range(length))
    return case(f"elif-chain-of-{length}", (If(branches, (plus("x", 1000.0),)), plus("x", 0.5)))


def deep(name: str, depth: int) -> Case:
    """Return one form nested in itself."""
    body: Block = (plus("x", 1.0), Exit("break", compare("gt", X, 40.0))) if name in LOOPS else (plus("x", 1.0),)
    for n in range(depth):
        body = FORMS[name](body, 2 * n if name in LOOPS else n % 5)
    return case(f"{depth}-deep-{name}", body)


def subroutine_cases() -> Iterator[Case]:
    """Subroutines: by reference, early return, inside loops, exits within, calling each other."""
    p, m = Variable("p", F), Variable("m", I)
    early = Function(
        "early", (p, m), frozenset({"p"}),
        (Declare("r", number(1.0)), plus("p", 2.0), Exit("return", compare("gt", Name(I, "m"), 40)), plus("p", 8.0),
         Assign("r", Name(F, "p"))),
        (Name(F, "r"),),
    )  # fmt: skip
    odd = Apply(B, "eq", (Apply(I, "and", (Name(I, "m"), number(5))), number(5)))
    drops = Function("drops", (p, m), frozenset({"p"}), (plus("p", 1.0), Exit("discard", odd), plus("p", 2.0)), ())
    inner_loop = Function(
        "counts", (p, m), frozenset({"p"}),
        (Declare("r", number(0.0)),
         For("j", (Apply(I, "and", (Name(I, "m"), number(7))),),
             (plus("p", 1.0), Exit("continue", compare("eq", Name(I, "j"), 1)), plus("r", 4.0),
              Exit("return", compare("eq", Name(I, "j"), 4)), Exit("break", compare("gt", Name(F, "p"), 12.0)),
              plus("r", 0.5))),
         plus("r", 64.0)),
        (Name(F, "r"),),
    )  # fmt: skip
    own = Variable("own", F, 3)
    fills = Function("fills", (own, m), frozenset({"own"}), (Write("own", Name(I, "m"), number(9.0)),), ())
    outer = Function(
        "outer", (p, m), frozenset({"p"}),
        (Call("drops", (Name(F, "p"), Name(I, "m"))), Declare("r", number(2.0)), plus("p", 16.0)),
        (Name(F, "r"),),
    )  # fmt: skip
    late = Apply(I, "add", (N, number(0)))
    call_early = Call("early", (X, late), "x2")
    begin = (Declare("x2", number(0.0)),)
    end = (Assign("x", Name(F, "x2"), None, "add"),)
    yield case("subroutine-by-reference", (*begin, call_early, *end), functions=(early,))
    yield case("subroutine-without-its-result", (Call("early", (X, late)),), functions=(early,))
    looped = (*begin, *FORMS["for_symbolic"]((call_early, Exit("break", compare("gt", X, 30.0))), 0), *end)
    yield case("subroutine-in-a-loop", looped, functions=(early,))
    yield case("subroutine-that-discards", (Call("drops", (X, late)), plus("x", 4.0)), functions=(drops,))
    dropped = FORMS["for"]((Call("drops", (X, Apply(I, "add", (N, Name(I, "s"))))),), 0)
    yield case("subroutine-that-discards-in-a-loop", dropped, functions=(drops,))
    at_the_end = (*FORMS["while"]((Call("drops", (X, late)),), 0), Call("drops", (X, Name(I, "s"))))
    yield case("subroutine-that-discards-in-a-loop-and-at-the-end", at_the_end, functions=(drops,))
    yield case("subroutine-with-a-loop", (*begin, Call("counts", (X, late), "x2"), *end), functions=(inner_loop,))
    both = (*begin, *FORMS["while"]((Call("counts", (X, late), "x2"), Call("early", (X, late))), 0), *end)
    yield case("subroutines-with-loops-in-a-loop", both, functions=(early, inner_loop))
    index = Apply(I, "sub", (N, number(1)))
    yield case("subroutine-that-stores-into-an-array", (Call("fills", (Name(F, "own"), index)),), functions=(fills,))
    yield case("subroutine-in-a-subroutine", (*begin, Call("outer", (X, late), "x2"), *end), functions=(drops, outer))


def array_cases() -> Iterator[Case]:
    """Yield an element's own array, indexed in range and out of it, from inside loops and branches."""
    index = Apply(I, "sub", (Apply(I, "and", (N, number(7))), number(2)))
    write = Write("own", index, Apply(F, "add", (X, number(3.0))))
    read = Assign("x", Read(F, "own", (index,)), None, "add")
    yield case("array-read-and-write", (write, read))
    yield case("array-in-a-branch", (when(bit(4), write), read))
    yield case("array-in-a-loop", (*FORMS["for_symbolic"]((write, read, Write("own", Name(I, "i0"), X)), 0), read))
    leave = Exit("break", compare("gt", X, 9.0))
    yield case("array-written-before-a-break", (*FORMS["while"]((write, leave, read), 0),))
    again = (*FORMS["for"]((Declare("t", X), read, Assign("x", Name(F, "t"), None, "add"), write), 0),)
    yield case("array-and-a-variable-of-the-iteration", again)


def lane_cases() -> Iterator[Case]:
    """Yield any_lane and all_lanes where some elements have left."""
    for how in ("any_lane", "all_lanes"):
        choice = Lanes(how, bit(1), "x", Apply(F, "add", (X, number(5.0))))
        yield case(f"{how}-in-a-loop", FORMS["for_symbolic"]((choice, Exit("continue", bit(2)), plus("x", 2.0)), 0))
        yield case(
            f"{how}-in-branches", (when(bit(0), choice, when(bit(3), choice, Exit("return")), plus("x", 2.0)), choice)
        )


def survivor_cases() -> Iterator[Case]:
    """Few elements are left when a loop begins, and fewer in the loop inside it: targets may go on with those alone."""
    few = compare("ge", Apply(I, "and", (N, number(15))), 13)
    inner = FORMS["for_symbolic"]((plus("x", 1.0), Exit("return", compare("gt", X, 14.0))), 2)
    for kind in ("discard", "return"):
        away = Exit(kind, Apply(B, "not", (few,)))
        yield case(
            f"survivors-of-{kind}", (away, *FORMS["for"]((plus("x", 1.0), *inner), 0), *FORMS["while"](inner, 4))
        )
        late = (plus("x", 1.0), Exit(kind, compare("lt", N, 50)), *inner, Exit("continue", bit(1)), *cut(inner))
        yield case(f"survivors-of-{kind}-in-a-loop", FORMS["for"](late, 0))
        stored = (Write("own", number(1), X), away, *FORMS["do_late"]((Write("own", Name(I, "s"), X), *inner), 0))
        yield case(f"survivors-of-{kind}-with-an-array", stored)
        unread = (plus("x", 4.0), Write("own", number(1), X), Exit("discard"))
        none = For("i2", (Apply(I, "and", (N, number(1))),), (away, *unread))
        yield case(f"survivors-that-take-no-iteration-before-{kind}", FORMS["for"]((plus("x", 1.0), none), 0))


def stepped_cases() -> Iterator[Case]:
    """Yield loops with an exit behind the step of what it compares: the first value alone fulfils five of six."""
    v, room = Name(I, "v"), compare("lt", X, 9.0)
    for op, step, limit in (("lt", 1, 1), ("le", 1, 0), ("eq", 1, 0), ("ne", 1, 1), ("gt", -1, -1), ("ge", -1, 0)):
        begin, test = Declare("v", number(0)), compare(op, v, limit)
        body = (plus("x", 1.0), Assign("v", number(step), None, "add"))
        yield case(f"stepped-{op}-before-break", (begin, While(room, (*body, Exit("break", test))), plus("x", 0.5)))
        yield case(f"stepped-{op}-before-return", (begin, While(room, (*body, Exit("return", test))), plus("x", 0.5)))
        once = Do((*body, Exit("break", compare("ge", X, 9.0))), test, late=True)
        yield case(f"stepped-{op}-before-until", (begin, once, plus("x", 0.5)))


def limit_cases() -> Iterator[Case]:
    """Yield cases of loops that reach their limit in some elements: these elements stop, the others have results."""
    forever = compare("lt", X, 1e9)
    grows = Assign("x", number(2.0), None, "mul")
    yield case("limit-of-while", (While(forever, (plus("x", 1.0), Exit("break", bit(0)))), plus("x", 0.5)), limit=5)
    yield case("limit-of-do", (Do((grows,), bit(2), late=False), plus("x", 0.5)), limit=3)
    yield case("limit-of-for", (For("i", (Apply(I, "and", (N, number(15))),), (plus("x", 1.0),)),), limit=8)
    inner = While(Apply(B, "and", (forever, bit(1))), (plus("x", 1.0), Exit("discard", bit(3))))
    yield case("limit-of-a-loop-in-a-loop", (For("i", (number(3),), (plus("x", 1.0), inner)), plus("x", 0.5)), limit=4)
    p = Variable("p", F)
    body = (While(compare("lt", Name(F, "p"), 20.0), (plus("p", 1.0),)),)
    deep_loop = Function("climbs", (p,), frozenset({"p"}), body, ())
    yield case("limit-in-a-subroutine", (Call("climbs", (X,)), inner), functions=(deep_loop,), limit=15)
    exact = (For("i", (number(0), Apply(I, "and", (N, number(7)))), (plus("x", 1.0),)),)
    yield case("limit-just-enough", exact, limit=8)
    yield case("known-bounds-have-no-limit", (For("i", (number(20),), (plus("x", 1.0),)),), limit=2)


def cases() -> list[Case]:
    """Return every nesting, then the special cases."""
    all_cases = [c for outer, inner in pairs() for c in exit_cases(outer, inner)]
    all_cases += straight_cases()
    all_cases += [
        long_chain(100),
        *(deep(name, 8) for name in ("if", "elif", "else")),
        *(deep(n, 4) for n in ("while", "for")),
    ]
    for more in (subroutine_cases, array_cases, lane_cases, survivor_cases, stepped_cases, limit_cases):
        all_cases += more()
    unique = {c.name: c for c in all_cases}
    return list(unique.values())
