"""The loop that calls a function for the lanes of a packet one after the other.

Stage: emit. Varying arguments are stored to arrays, one number per lane. The function of one element is called for each
active lane, and its results are loaded from arrays. Inactive lanes give 0.

    block = each_lane("find_alone", active, [x], [length], [table], 16)
"""

from __future__ import annotations

from collections.abc import Sequence

from shpy.backends.emit import tree
from shpy.backends.emit.tree import (
    BOOL,
    INT,
    Assign,
    Block,
    Cast,
    Construct,
    Declare,
    Do,
    Exit,
    Expr,
    Index,
    Literal,
    Name,
    number,
)
from shpy.backends.opencl.packets.prologue_wide import LONGEST
from shpy.backends.opencl.packets.widen import lanes_of
from shpy.ir.types import Base, Type

_LANE = Name(INT, "k")


def each_lane(
    one: str, active: Name, inputs: Sequence[Name], outputs: Sequence[Name], context: Sequence[Name], lanes: int
) -> Block:
    """Return the statements of a function that calls `one` for each lane of the mask `active`, one of its parameters.

    Names have the types of one element. A single result is returned; several are stored through pointers.
    """
    begin: list[tree.Stmt] = []
    for e in (*inputs, active):
        begin.append(Declare(_held(e.type), _array(e).text, length=lanes))
        begin.append(Do(_memory("vstore", lanes, e.type, e, number(0), _array(e))))
    begin += [Declare(_held(e.type), _array(e).text, number(0), lanes) for e in outputs]
    there = Index(BOOL, _array(active), _LANE)
    step = Assign(_LANE, tree.infix("+", _LANE, number(1)))
    each = tree.Loop(
        (tree.If(there, _one_lane(one, inputs, outputs, context)),),
        (Declare(INT, _LANE.text, number(0)),),
        tree.infix("<", _LANE, number(lanes), BOOL),
        step,
    )
    loaded = [_loaded(e, lanes) for e in outputs]
    if len(outputs) == 1:
        return (*begin, each, Exit("return", loaded[0]))
    stores = [Assign(tree.prefix("*", e), found) for e, found in zip(outputs, loaded, strict=True)]
    return (*begin, each, *stores)


def _one_lane(one: str, inputs: Sequence[Name], outputs: Sequence[Name], context: Sequence[Name]) -> Block:
    """Return the call for lane `k`."""
    given: list[Expr] = []
    for e in inputs:
        element = Index(e.type, _array(e), _LANE)
        given.append(tree.infix("!=", element, number(0)) if e.type is BOOL else element)
    results = [Name(e.type, _one(e)) for e in outputs]
    declared = [Declare(r.type, r.text) for r in results]
    called: tree.Stmt
    if len(results) == 1:
        called = Assign(results[0], tree.call(one, results[0].type, *given, *context))
    else:
        called = Do(tree.call(one, BOOL, *given, *(tree.prefix("&", r) for r in results), *context))
    kept: list[tree.Stmt] = []
    for e, r in zip(outputs, results, strict=True):
        made = tree.prefix("-", Cast(INT, r)) if e.type is BOOL else r
        kept.append(Assign(Index(e.type, _array(e), _LANE), made))
    return (*declared, called, *kept)


def _array(e: Name) -> Name:
    """Return the array that holds one number per lane."""
    return Name(e.type, f"{e.text}_of")


def _one(e: Name) -> str:
    """Name the result of one lane."""
    return f"{e.text}_one"


def _held(type: Type) -> Type:
    """Return the type of a lane's number in an array: bools are stored as masks, which are ints."""
    return type.based(Base.I) if type.is_bool else type


def _memory(way: str, lanes: int, type: Type, *args: Expr) -> Expr:
    """Return the call of OpenCL's function that loads or stores `lanes` numbers (`way`: `vload` or `vstore`)."""
    return tree.call(f"{way}{lanes}", type, *args)


def _loaded(e: Name, lanes: int) -> Expr:
    """Return the expression that loads a result as a packet."""
    type = lanes_of(e.type.base, lanes)
    if lanes <= LONGEST:
        return _memory("vload", lanes, type, number(0), _array(e))
    parts = [_memory("vload", LONGEST, type, Literal(INT, k), _array(e)) for k in range(lanes // LONGEST)]
    return Construct(type, tuple(parts))
