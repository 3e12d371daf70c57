"""Find the statements behind a mistake in the user's text, and write their correction.

Stage: record, once a check of the frame has fired (`frames`, `aliases`, a value of a closed block), and once a function
for the jumps that only the text shows. Takes a frame, and a place or line of it; gives the error to raise.

    with SH_IF(x > 1):
        x = x - 1           # rebound(…): `x` is rebound … write instead: x[:] = x - 1
"""

from __future__ import annotations

import ast
import functools
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from types import FrameType
from typing import Any

import numpy as np

from shpy.errors import RecordError
from shpy.ir.nodes import Loc
from shpy.lang.mistakes.expressions import named, prefix_of
from shpy.lang.mistakes.listing import Listing, Place
from shpy.lang.recording.location import loc_in
from shpy.lang.recording.symbolic import Symbolic
from shpy.lang.recording.tree import FunctionNode, quoted

_LOOPS = ("SH_WHILE", "SH_DO", "SH_FOR")
_OPENERS = frozenset({"SH_IF", "SH_ELIF", "SH_ELSE", *_LOOPS})
_EXITS = frozenset({"SH_BREAK", "SH_CONTINUE", "SH_RETURN", "SH_DISCARD", "SH_UNTIL"})
NUMBERS = (int, float, complex, np.number, np.bool_)
DISPLAYS = (tuple, list, dict)
_INNER = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda)
_PARTS = ("body", "orelse", "finalbody", "handlers", "cases")


@dataclass(frozen=True, slots=True)
class Binding:
    """A target that a statement binds, and the expression that it gets, where one stands for it alone."""

    statement: Any
    target: Any
    value: ast.expr | None
    shares: bool = False
    """Several targets of one statement get the object: `a = b = x + 1`."""

    @property
    def grows(self) -> bool:
        """Return whether the statement is as `x += 1`."""
        return isinstance(self.statement, ast.AugAssign)


@dataclass(frozen=True, slots=True)
class BlockStatement:
    """A `with` that opens a block: its construct, as `SH_IF`, and as the user wrote it."""

    node: ast.With
    what: str
    written: str


@dataclass(frozen=True)
class Definition:
    """A `def` of the user's text, and the frame that runs it, None where it has returned; empty without a text."""

    node: FunctionNode | None
    text: Any
    frame: FrameType | None

    @classmethod
    def around(cls, loc: Loc | None, frame: FrameType | None) -> Definition:
        """Return the innermost `def` around a line."""
        text = loc.text if loc is not None else None
        functions = [n for n in text.statements if isinstance(n, FunctionNode)] if text is not None else []
        functions = [n for n in functions if loc is not None and n.lineno <= loc.line <= (n.end_lineno or 0)]
        return cls(max(functions, key=lambda n: n.lineno, default=None), text, frame)

    @functools.cached_property
    def statements(self) -> list[ast.stmt]:
        """The function's own statements, in the order of the text."""
        return list(_statements(self.node))

    @functools.cached_property
    def nodes(self) -> list[ast.AST]:
        """All nodes of the function in the order of the text, without those of functions and classes inside it."""
        return list(_own(self.node)) if self.node is not None else []

    @functools.cached_property
    def bindings(self) -> list[Binding]:
        """The targets that the function binds, in the order of the text."""
        return [binding for node in self.nodes for binding in _bindings(node)]

    @functools.cached_property
    def blocks(self) -> list[BlockStatement]:
        """The blocks of the language, in the order of the text."""
        blocks: list[BlockStatement] = []
        for node in self.statements:
            for item in node.items if isinstance(node, ast.With) else ():
                call = item.context_expr
                what = control_of(call.func, self.frame) if isinstance(call, ast.Call) else None
                if isinstance(node, ast.With) and isinstance(call, ast.Call) and what in _OPENERS:
                    written = f"{quoted(self.text, call.func)}({'…' if call.args or call.keywords else ''})"
                    blocks.append(BlockStatement(node, what or "", written))
        return blocks

    def before(self, place: Place, node: ast.AST) -> list[Binding]:
        """Return the bindings of a place before a node, without those in blocks that end before it."""
        stands = [b for b in self.bindings if position_of(b.target) < position_of(node) and binds(b.target, place)]
        return [b for b in stands if all(is_inside(node, k.node) for k in self.blocks if is_inside(b.target, k.node))]

    def at(self, node: Any) -> Loc:
        """Return the line of a node."""
        return Loc(self.text.file, node.lineno, self.text)


def _statements(node: Any) -> Iterator[ast.stmt]:
    """Yield the statements in a node, in the order of the text, without those of functions and classes inside it."""
    for part in _PARTS:
        for child in getattr(node, part, ()):
            if isinstance(child, ast.stmt):
                yield child
            if not isinstance(child, _INNER):
                yield from _statements(child)


def _own(node: ast.AST) -> Iterator[ast.AST]:
    pending = list(ast.iter_child_nodes(node))[::-1]
    while pending:  # without recursion, since expressions may be deep
        child = pending.pop()
        yield child
        if not isinstance(child, _INNER):
            pending += list(ast.iter_child_nodes(child))[::-1]


def _bindings(node: ast.AST) -> Iterator[Binding]:
    """Yield what a statement or an expression binds; targets of tuples one by one."""
    match node:
        case ast.Assign(targets=targets, value=value):
            for target in targets:
                yield from _pairs(node, target, value, len(targets) > 1)
        case ast.AnnAssign(value=None):
            pass
        case ast.AnnAssign(target=target, value=value) | ast.AugAssign(target=target, value=value):
            yield Binding(node, target, value)
        case ast.NamedExpr(target=target, value=value):
            yield Binding(node, target, value)
        case ast.For(target=target) | ast.comprehension(target=target):
            yield from _pairs(node, target, None, False)
        case ast.With(items=items):
            for item in items:
                if item.optional_vars is not None:
                    yield from _pairs(node, item.optional_vars, None, False)
        case ast.arguments():
            for argument in (*node.posonlyargs, *node.args, *node.kwonlyargs):
                yield Binding(argument, argument, None)


def _pairs(statement: ast.AST, target: ast.expr, value: ast.expr | None, shares: bool) -> Iterator[Binding]:
    if not isinstance(target, ast.Tuple | ast.List):
        yield Binding(statement, target, value, shares)
        return
    parts: list[Any] = [None] * len(target.elts)
    if isinstance(value, ast.Tuple | ast.List) and len(value.elts) == len(parts):
        parts = value.elts
    for element, part in zip(target.elts, parts, strict=True):
        yield from _pairs(statement, element, part, shares)


def position_of(node: ast.AST) -> tuple[int, int]:
    """Return the line and column of a node."""
    return getattr(node, "lineno", 0), getattr(node, "col_offset", 0)


def is_inside(node: ast.AST, outer: Any) -> bool:
    """Return whether a node lies inside another node."""
    return node is not outer and position_of(outer) <= position_of(node) < (outer.end_lineno, outer.end_col_offset)


def path_of(node: ast.AST | None) -> tuple[str, ...]:
    """Return the names of a dotted path, ("ray", "o"); () for any other expression."""
    match node:
        case ast.Name(id=name) | ast.arg(arg=name):
            return (name,)
        case ast.Attribute(value=value, attr=attribute):
            base = path_of(value)
            return (*base, attribute) if base else ()
    return ()


def binds(target: ast.AST, place: Place) -> bool:
    """Return whether a target is a place: any item of an object for a place that is an item."""
    if isinstance(target, ast.Subscript):
        return place.key is not None and path_of(target.value) == (place.name,)
    path = (place.name, place.attribute) if place.attribute is not None else (place.name,)
    return place.key is None and path_of(target) == path


def control_of(node: ast.expr, frame: FrameType | None) -> str | None:
    """Return the name of the block or exit that an expression means, `SH_IF` under any alias; None for others."""
    path = path_of(node)
    for name in (getattr(named(node, frame), "__name__", None), *path[-1:]) if path else ():
        if isinstance(name, str) and name.startswith("SH_"):
            return name
    return None


def constructor_of(value: ast.expr | None, frame: FrameType | None) -> str | None:
    """Return the type of a value as the user writes it, where an expression is a call of its constructor."""
    if not isinstance(value, ast.Call):
        return None
    cls = named(value.func, frame) or vars(sys.modules["shpy"]).get("".join(path_of(value.func)[-1:]))
    return ast.unparse(value.func) if isinstance(cls, type) and hasattr(cls, "kind") else None


def spelled(what: str) -> str:
    """Return a block's construct as messages quote it, where no text tells more."""
    return f"{what}()" if what in ("SH_DO", "SH_ELSE") else f"{what}(…)"


# What only the text shows


def check_block(listing: Listing, frame: FrameType) -> None:
    """Raise RecordError, once a function, for Python's jumps out of its blocks, and for an exit that is not called."""
    if listing.checked:
        return
    definition = Definition.around(loc_in(frame.f_code, frame.f_lineno), frame)
    for node in definition.statements:
        match node:
            case ast.Return() | ast.Break() | ast.Continue():
                _check_jump(definition, node)
            case ast.Expr(value=ast.Name() | ast.Attribute() as value):
                what, name = control_of(value, frame), quoted(definition.text, value)
                if what in _EXITS | _OPENERS:
                    cure = f"with {name}():" if what in _OPENERS else f"{name}()"
                    raise RecordError(f"`{name}` is not called", loc=definition.at(value), cure=cure)
    listing.checked = True


def left(loc: Loc | None, word: str, written: str, cure: str) -> RecordError:
    """Return the error for one of Python's own jumps inside a block: it happens while recording."""
    text = f"Python's `{word}` inside `with {written}` happens while recording, whatever the block's condition is"
    return RecordError(text, loc=loc, cure=cure)


def _check_jump(definition: Definition, node: ast.Return | ast.Break | ast.Continue) -> None:
    """Raise RecordError for a jump out of a block; a `break` or `continue` may stay inside the innermost one."""
    around = [b for b in definition.blocks if is_inside(node, b.node)]
    loops = [n for n in definition.statements if isinstance(n, ast.For | ast.While) and is_inside(node, n)]
    if not around:
        return
    word = type(node).__name__.lower()
    if isinstance(node, ast.Return):
        cure = f"SH_RETURN({ast.unparse(node.value) if node.value else ''})"
        raise left(definition.at(node), word, around[-1].written, cure)
    cure, ours = f"SH_{word.upper()}()", [b.node for b in around if b.what in _LOOPS]
    if not ours or (loops and is_inside(loops[-1], ours[-1])):
        cure = f"make the loop a `with SH_FOR(…) as i:`, and write `{cure}`"
    if not (loops and is_inside(loops[-1], around[-1].node)):
        raise left(definition.at(node), word, around[-1].written, cure)


def check_none(loc: Loc | None) -> None:
    """Raise RecordError if a line compares with None by `==` or `!=`, which compares the components of a value."""
    definition = Definition.around(loc, None)
    for node in definition.nodes:
        match node:
            case (
                ast.Compare(ops=[ast.Eq() | ast.NotEq() as sign], left=value, comparators=[ast.Constant(value=None)])
                | ast.Compare(ops=[ast.Eq() | ast.NotEq() as sign], left=ast.Constant(value=None), comparators=[value])
            ) if loc is not None and node.lineno == loc.line:
                text = f"`{quoted(definition.text, node)}` compares a value with None, component by component"
                cure = f"{ast.unparse(value)} {'is' if isinstance(sign, ast.Eq) else 'is not'} None"
                raise RecordError(text, loc=loc, cure=cure)


def alone(what: str, loc: Loc | None) -> RecordError:
    """Return the error for a block that is made on a line and never opened."""
    definition = Definition.around(loc, None)
    for node in definition.statements:
        if isinstance(node, ast.Expr) and loc is not None and node.lineno == loc.line:
            call = quoted(definition.text, node.value)
            return RecordError(f"`{call}` alone does nothing: {what} opens a block", loc=loc, cure=f"with {call}:")
    return RecordError(f"this {what} alone does nothing: it opens a block", loc=loc, cure=f"with {what}(…):")


# Names that a block rebinds, or makes


def rebound(
    what: str, opened: Loc | None, frame: FrameType, where: Loc, place: Place, change: tuple[Any, Any], used: str
) -> RecordError:
    """Return the error for a place that a block has rebound on a line; `used` says when and where it is read.

    The block is `what`, opened on another line; `change` holds the previous and the present object of the place.
    """
    definition, line = Definition.around(opened, frame), opened.line if opened is not None else 0
    blocks = [b for b in definition.blocks if b.what == what and b.node.items[0].context_expr.lineno <= line]
    block = next((b for b in blocks if line <= (b.node.items[-1].context_expr.end_lineno or 0)), None)
    stands = [b for b in definition.bindings if binds(b.target, place) and position_of(b.target)[0] >= line]
    binding = next((b for b in stands if b.target.lineno <= where.line <= (b.target.end_lineno or 0)), None)
    name = str(place) if binding is None else quoted(definition.text, binding.target)
    written = block.written if block is not None else spelled(what)
    if binding is not None and isinstance(binding.target, ast.Subscript):
        if isinstance(binding.target.slice, ast.Slice):
            return _rebound(where, place.name, written, used, _each_by_itself(place.name))
    cure = _declaration(definition, block, _opened(what), binding, name, place, *change)
    return _rebound(where, name, written, used, cure)


def _rebound(loc: Loc, place: str, written: str, used: str, cure: str, *, is_new: bool = False) -> RecordError:
    verb, why = "rebound", "Python rebinds the name once, while recording, whatever happens at run time"
    if is_new:
        verb, why = "made", "what a block makes ends with it"
    return RecordError(f"`{place}` is {verb} inside `with {written}` and used {used}: {why}", loc=loc, cure=cure)


def _stored(start: str, inside: str, opened: str) -> str:
    """Return the cure for a name that a block rebinds: a declaration before it, or before its chain, and a store."""
    return f"{start} before {opened}, `{inside}` inside {'it' if opened == 'the block' else 'the block'}"


def _each_by_itself(place: str) -> str:
    """Return the cure for a tuple, list or dict of values that a block rebinds."""
    return f"a name before the block for each value that `{place}` holds, and `x[:] = …` inside it"


def used_after(place: Place, used: Loc | None, frame: FrameType | None) -> RecordError | None:
    """Return the error for a place whose value a block has made that is closed; None where no text tells which.

    `used` is the line that uses the value; `frame` is the user's, None where the function has returned.
    """
    definition, line = Definition.around(used, frame), used.line if used is not None else 0
    for binding in reversed([b for b in definition.bindings if binds(b.target, place) and b.target.lineno <= line]):
        around = [b for b in definition.blocks if is_inside(binding.target, b.node)]
        around = [b for b in around if not b.node.lineno <= line <= (b.node.end_lineno or 0)]
        if not around:
            continue
        block, name = around[-1], quoted(definition.text, binding.target)
        loc = definition.at(binding.target)
        if binding.statement is block.node:
            return RecordError(
                f"`{place.name}` counts the iterations of `with {block.written}`, and is used after it (line {line})",
                loc=loc,
                cure=f"`last = {prefix_of(frame)}Attrib1i()` before the loop, `last[:] = {place.name}` inside, "
                "`last` after it",
            )
        before = definition.before(place, block.node)
        value = before[-1].value if before else None
        old = None if not before else value.value if isinstance(value, ast.Constant) else Symbolic()
        cure = _declaration(definition, block, _opened(block.what), binding, name, place, old)
        return _rebound(loc, name, block.written, f"after it (line {line})", cure, is_new=not before)
    return None


def _declaration(
    definition: Definition,
    block: BlockStatement | None,
    opened: str,
    binding: Binding | None,
    name: str,
    place: Place,
    old: Any,
    new: Any = None,
) -> str:
    """Return the store that the user meant, with a declaration before the block if the place held no value."""
    if isinstance(old, DISPLAYS) or (isinstance(new, DISPLAYS) and not isinstance(old, Symbolic)):
        return _each_by_itself(name)
    inside, type_ = f"{name}[:] = …", None
    if binding is not None and binding.value is not None:
        type_ = constructor_of(binding.value, definition.frame)
        inside = f"{name}[:] = {quoted(definition.text, binding.value)}"
        if binding.grows:
            inside = quoted(definition.text, binding.statement)
    if isinstance(old, Symbolic):
        return inside
    if not isinstance(old, NUMBERS):
        return _stored(f"`{name} = {type_}()`" if type_ else f"make `{name}` a value", inside, opened)
    before = definition.before(place, block.node) if block is not None else []
    begin = before[-1].value if before and not before[-1].grows else None
    local, start = name, quoted(definition.text, begin) if begin is not None else f"{old!r}"
    if place.attribute is not None and begin is None:  # a store into an object would outlive the recording
        local, start, inside = place.attribute, name, inside.replace(name, place.attribute)
    type_ = type_ or f"{prefix_of(definition.frame)}{_class_for(old, new)}"
    return _stored(f"`{local} = {type_}({start})`", inside, opened)


def _opened(what: str) -> str:
    """Return what a declaration has to stand before: of a branch, the whole chain."""
    return "the SH_IF" if what in ("SH_ELIF", "SH_ELSE") else "the block"


def _class_for(old: Any, new: Any) -> str:
    """Return the class that a host number must become, to be a variable of the program."""
    if isinstance(new, Symbolic):
        return type(new).__name__
    if isinstance(old, bool | np.bool_):
        return "Attrib1b"
    whole = isinstance(old, int | np.integer) and isinstance(new, int | np.integer)
    return "Attrib1i" if whole else "Attrib1f"
