"""Check the claims of a module that comes as text before anything relies on them.

Stage: record, for modules that were not recorded. Takes a verified module of any origin; returns one that can be run,
or raises VerifyError. The verifier checks the rules of every module, also between passes. This file checks those of a
whole program: ports have the types that their kinds name, names form structures, and only passes add a status.

A loop's `turns` is a promise that no target checks. If the loop does not provably keep it, the promise is dropped, and
the loop limit applies to the loop.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby, takewhile

from shpy.errors import VerifyError
from shpy.ir.nodes import Call, Discard, Function, If, Let, Loop, Module, Param, Port, Region, Stmt, Store
from shpy.ir.ops import MADE_BY_PASSES
from shpy.ir.text import quote
from shpy.ir.traverse import rewrite, test_length, walk
from shpy.ir.types import Type
from shpy.lang.values.matrix import MATRICES
from shpy.lang.values.value import CLASSES

_ROW = re.compile(r"(?P<head>[^.\[\]]*)\[(?P<row>\d)\]")
_KINDS = {cls.__name__: cls.type for cls in CLASSES.values()}


_RECORDED = {
    "lane_mask": "const true",
    "lane_any": "any_lane",
    "lane_min": "min_lane",
    "lane_max": "max_lane",
    "neighbour": "grid_index, add and table",
    "grid_line": "grid_index and swizzle",
}
"""Replacements that messages name for operations that only passes make."""


def checked(module: Module) -> Module:
    """Return the module with the promises that it provably keeps; raises VerifyError for false claims."""
    entry = module.entry
    if len(entry.outputs) != len(module.outputs):
        raise VerifyError(
            "the entry has a status, which is made by the passes", loc=entry.loc, cure="as many slots as outputs"
        )
    for s in (s for f in module.functions for s in walk(f.body)):
        if isinstance(s, Discard) and s.status:
            raise VerifyError(f"discard {s.status} is made by the passes", loc=s.loc, cure="discard")
        if isinstance(s, Let) and s.op in MADE_BY_PASSES:
            raise VerifyError(f"{s.op} is made by the passes", loc=s.value.loc, cure=_RECORDED[s.op])
    for what, ports, slots in (("input", module.inputs, entry.inputs), ("output", module.outputs, entry.outputs)):
        _check_names(what, ports)
        for port, slot in zip(ports, slots, strict=True):
            _check_kind(what, port, slot.type)
    for param in module.params:
        _check_kind("param", param, param.type)
    return replace(module, functions=tuple(map(_honest, module.functions)))


def _check_kind(what: str, port: Port | Param, type: Type) -> None:
    """Check that a kind names a type: that of the port, or of a matrix whose row it is."""
    kind, _, row = port.kind.partition("[")
    claimed = _KINDS.get(kind)
    if row and kind in MATRICES:
        claimed = MATRICES[kind]._row_type().type
    if claimed is None:
        raise VerifyError(
            f"{what} {quote(port.name)} is of {quote(port.kind)}, which is no type of the language",
            cure=f"Attrib{_spoken(type)}",
        )
    if claimed is not type:
        raise VerifyError(
            f"{what} {quote(port.name)} is an {port.kind}, whose type is {claimed!r}, and holds an {type!r}",
            cure=f"Attrib{_spoken(type)}",
        )


def _spoken(type: Type) -> str:
    return f"{type.size}{type.base.value}"


def _check_names(what: str, ports: Sequence[Port], inside: str = "") -> None:
    """Check the names of ports whose dots and brackets form structs and matrices; raise VerifyError.

    The parts of a structure must stand together, and a matrix must have all its rows in order.
    """
    heads: set[str] = set()
    only = what == "output" and not inside and all(port.name.startswith("[") for port in ports)
    for head, group in groupby(ports, key=lambda port: re.split(r"[.\[]", port.name)[0]):
        members = list(group)
        if head in heads:
            raise VerifyError(
                f"the parts of {what} {quote(inside + head)} do not stand together", cure="one after the other"
            )
        heads.add(head)
        _check_group(what, head, members, inside, nameless=only)


def _check_group(what: str, head: str, members: list[Port], inside: str, *, nameless: bool) -> None:
    """Check the names that begin with one head; `nameless`: of the rows of a matrix that is the only output."""
    names = [port.name for port in members]
    if names == [head] and head and not re.search(r"[.\[\]]", head):
        return
    rows = [_ROW.fullmatch(name) for name in names]
    if all(rows) and (head or nameless):
        kinds = {port.kind.partition("[")[0] for port in members}
        size = MATRICES[next(iter(kinds))].size if kinds <= MATRICES.keys() and len(kinds) == 1 else -1
        if names == [f"{head}[{r}]" for r in range(size)]:
            return
    if head and all(name.startswith(f"{head}.") for name in names):
        parts = [Port(port.name.partition(".")[2], port.kind) for port in members]
        _check_names(what, parts, f"{inside}{head}.")
        return
    raise VerifyError(
        f"{what} {quote(inside + names[0])} is part of no structure",
        cure="a plain name; a.x, a.y for the parts of a structure; m[0], m[1] for the rows of a Matrix2f",
    )


def _honest(function: Function) -> Function:
    """Return the function without the promised iterations that its loops do not provably keep."""
    constants = {
        s.value.id: s.attr[0]
        for s in walk(function.body)
        if isinstance(s, Let) and s.op == "const" and isinstance(s.attr, tuple) and s.value.type.is_int
    }

    def believed(region: Region) -> Iterator[Stmt]:
        for n, s in enumerate(region):
            if isinstance(s, Loop) and s.turns is not None and not _kept(s, region[:n], constants):
                s = replace(s, turns=None)
            yield s

    def change(s: Stmt) -> Stmt:
        match s:
            case If(_, then, orelse):
                return replace(s, then=tuple(believed(then)), orelse=tuple(believed(orelse)))
            case Loop(body, continuing):
                return replace(s, body=tuple(believed(body)), continuing=tuple(believed(continuing)))
        return s

    return replace(function, body=tuple(believed(rewrite(function.body, change))))


def _kept(loop: Loop, before: Region, constants: dict[int, int]) -> bool:
    """Return whether the loop counts a variable between constants and so has at most its promised iterations."""
    head = loop.body[: test_length(loop.body)]
    lets = {s.value.id: s for s in (*head, *loop.continuing) if isinstance(s, Let)}
    test = lets.get(head[-1].condition) if head and isinstance(head[-1], If) else None
    more = lets.get(test.args[0]) if test is not None and test.op == "not" else None
    now = lets.get(more.args[0]) if more is not None and more.op in ("lt", "gt") else None
    if more is None or now is None or now.op != "load" or now.args:
        return False
    counter = now.attr
    first = constants.get(_stored_last(before, counter))
    last = constants.get(more.args[1])
    steps = [s for s in walk((*loop.body, *loop.continuing)) if _stores(s, counter)]
    added = lets.get(steps[0].value) if len(steps) == 1 and isinstance(steps[0], Store) else None
    if first is None or last is None or added is None or added.op != "add" or steps[0] not in loop.continuing:
        return False
    old, by = lets.get(added.args[0]), constants.get(added.args[1])
    if old is None or (old.op, old.attr) != ("load", counter) or not by or (by > 0) != (more.op == "lt"):
        return False
    low, high = (0, 2**32) if now.value.type.base == "u" else (-(2**31), 2**31)
    return low <= last + by < high and loop.turns is not None and len(range(first, last, by)) <= loop.turns


def _stored_last(before: Region, variable: object) -> int:
    """Return the value last stored into a variable before a loop, with only plain statements between; else -1."""
    for s in takewhile(lambda s: isinstance(s, Let | Store), reversed(before)):
        if isinstance(s, Store) and s.variable == variable:
            return s.value
    return -1


def _stores(s: Stmt, variable: object) -> bool:
    """Return whether a statement may store into a variable: a call may, into any."""
    return isinstance(s, Call) or (isinstance(s, Store) and s.variable == variable)
