"""Simplify vectors that are split and constructed again: the rules of `fold` for swizzles and constructs.

Stage: improve.

    (v.zyx).x                         -> v.z
    construct(a, b, c).y              -> b
    construct(v, s).xy, v : f2        -> v
    construct(v, s).xw, v : f3        -> construct(v.x, s)
    construct(construct(a, b), s)     -> construct(a, b, s)
    splat(s).xy                       -> splat(s)
    construct(v.x, v.y), v : f2       -> v
    construct(v.x, v.z, s)            -> construct(v.xz, s)
    construct(s, s, s)                -> splat(s)
    component(v, 1)                   -> v.y
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

from shpy.ir.nodes import Let
from shpy.ir.types import SIZES, WIDEST_PORT
from shpy.passes.identities import Facts, Found


def rearrange(context: Facts, let: Let) -> Found:
    """Return a simpler equivalent of a swizzle, construct or component, or None."""
    if let.op == "swizzle":
        assert isinstance(let.attr, tuple)
        return _swizzle(context, let, let.args[0], let.attr)
    if let.op == "construct":
        return _construct(context, let)
    if let.op == "component":
        vector, index = let.args
        at = context.constant(index)
        if at is not None:
            last = context.types[vector].size - 1
            return Let(let.value, "swizzle", (vector,), (min(max(at[0], 0), last),))
    return None


def _swizzle(context: Facts, let: Let, source: int, picked: tuple[int, ...]) -> Found:
    if picked == tuple(range(context.types[source].size)):
        return source
    inner = context.lets.get(source)
    match inner:
        case Let(_, "const", _, tuple(components)):
            return Let(let.value, "const", (), tuple(components[p] for p in picked))
        case Let(_, "swizzle", args, tuple(earlier)):
            return Let(let.value, "swizzle", args, tuple(earlier[p] for p in picked))
        case Let(_, "splat", (scalar,)):
            return scalar if len(picked) == 1 else Let(let.value, "splat", (scalar,))
        case Let(_, "construct"):
            return _of_construct(context, let, inner, picked)
    return None


def _of_construct(context: Facts, let: Let, construct: Let, picked: tuple[int, ...]) -> Found:
    """Return a swizzle of a construct as a swizzle of one part, or as a construct of swizzles of several parts.

    A construct with a name from the user stays if several parts are picked, since `q.zyx` is easier to read.
    """
    parts = [(arg, k) for arg in construct.args for k in range(context.types[arg].size)]
    chosen = [parts[p] for p in picked]
    values = tuple(arg for arg, _ in chosen)
    if len(set(values)) > 1:
        if construct.value.name is not None:
            return None
        grouped = [(arg, [k for _, k in run]) for arg, run in groupby(chosen, key=lambda part: part[0])]
        return Let(
            let.value, "construct", tuple(_part(context, let, arg, k) for arg, k in _one_by_one(context, grouped))
        )
    if context.types[values[0]].size > 1:
        return Let(let.value, "swizzle", values[:1], tuple(k for _, k in chosen))
    return values[0] if len(picked) == 1 else Let(let.value, "splat", values[:1])


def _one_by_one(context: Facts, runs: list[tuple[int, list[int]]]) -> Iterator[tuple[int, list[int]]]:
    """Yield the runs; a run of a scalar, which has no swizzle, is yielded once for each component picked.

    A run that no vector has room for is divided.
    """
    for arg, picked in runs:
        if context.types[arg].size == 1:
            yield from ((arg, [0]) for _ in picked)
        elif len(picked) in SIZES:
            yield arg, picked
        else:
            yield from ((arg, picked[k : k + WIDEST_PORT]) for k in range(0, len(picked), WIDEST_PORT))


def _construct(context: Facts, let: Let) -> Found:
    inner = [context.lets.get(a) for a in let.args]
    if any(_is_nameless_construct(part) for part in inner):
        nested = [
            part.args if part and _is_nameless_construct(part) else (a,)
            for part, a in zip(inner, let.args, strict=True)
        ]
        return Let(let.value, "construct", tuple(a for args in nested for a in args))
    constants = [context.constant(a) for a in let.args]
    if all(c is not None for c in constants):
        return Let(let.value, "const", (), tuple(k for c in constants if c is not None for k in c))
    if len(set(let.args)) == 1 and context.types[let.args[0]].size == 1:
        return Let(let.value, "splat", let.args[:1])
    runs: list[tuple[int, list[int]]] = []
    for arg in let.args:
        source, picked = _picked(context, arg)
        if runs and runs[-1][0] == source and context.types[source].size > 1:
            runs[-1][1].extend(picked)
        else:
            runs.append((source, list(picked)))
    if len(runs) == 1:
        return Let(let.value, "swizzle", (runs[0][0],), tuple(runs[0][1]))
    runs = list(_one_by_one(context, runs))
    if len(runs) >= len(let.args):
        return None
    return Let(let.value, "construct", tuple(_part(context, let, source, picked) for source, picked in runs))


def _is_nameless_construct(let: Let | None) -> bool:
    return let is not None and let.op == "construct" and let.value.name is None


def _picked(context: Facts, arg: int) -> tuple[int, tuple[int, ...]]:
    """Return the source vector of a part, and the indices of the components picked from it."""
    let = context.lets.get(arg)
    if let is not None and let.op == "swizzle":
        assert isinstance(let.attr, tuple)
        return let.args[0], let.attr
    return arg, tuple(range(context.types[arg].size))


def _part(context: Facts, let: Let, source: int, picked: list[int]) -> int:
    size = context.types[source].size
    if picked == list(range(size)):
        return source
    return context.make("swizzle", source, type=let.value.type.sized(len(picked)), attr=tuple(picked))
