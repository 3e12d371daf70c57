"""Find the statements behind a mistake in the user's text, and write what should stand there instead.

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
from types import FrameType, ModuleType
from typing import Any

import numpy as np

from shpy.errors import RecordError
from shpy.ir.nodes import Loc
from shpy.lang.mistakes import findings
from shpy.lang.mistakes.listing import Listing, Place
from shpy.lang.mistakes.objects import named
from shpy.lang.recording.symbolic import Symbolic
from shpy.lang.recording.text import Text
from shpy.lang.recording.tree import FunctionNode, definition_of, quoted

_LOOPS = ("SH_WHILE", "SH_DO", "SH_FOR")
_OPENERS = frozenset({"SH_IF", "SH_ELIF", "SH_ELSE", *_LOOPS})
_EXITS = frozenset({"SH_BREAK", "SH_CONTINUE", "SH_RETURN", "SH_DISCARD", "SH_UNTIL"})
_NUMBERS = (int, float, complex, np.number, np.bool_)
_DISPLAYS = (tuple, list, dict)
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
    """A `def` of the user's text, and the frame that runs it, None where it has returned."""

    node: FunctionNode
    text: Text
    frame: FrameType | None

    @classmethod
    def around(cls, loc: Loc | None, frame: FrameType | None) -> Definition | None:
        """Return the innermost `def` around a line; None without a text."""
        text = loc.text if loc is not None else None
        if loc is None or text is None:
            return None
        functions = [n for n in text.statements if isinstance(n, FunctionNode)]
        functions = [n for n in functions if n.lineno <= loc.line <= (n.end_lineno or 0)]
        return cls(max(functions, key=lambda n: n.lineno), text, frame) if functions else None

    @functools.cached_property
    def statements(self) -> list[ast.stmt]:
        """The function's own statements, in the order of the text."""
        return list(_statements(self.node))

    @functools.cached_property
    def nodes(self) -> list[ast.AST]:
        """All nodes of the function in the order of the text, without those of functions and classes inside it."""
        return list(_own(self.node))

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

    def leaves(self, node: ast.stmt, word: str, cure: str, block: BlockStatement) -> RecordError:
        """Return the error for a jump of Python's out of a block."""
        return findings.leaves(findings.at(self.text, node), word, block.written, cure)


def _statements(node: Any) -> Iterator[ast.stmt]:
    """Yield the statements in a node, in the order of the text, without those of functions and classes inside it."""
    for part in _PARTS:
        for child in getattr(node, part, ()):
            if isinstance(child, ast.stmt):
                yield child
            if not isinstance(child, _INNER):
                yield from _statements(child)


def _own(node: ast.AST) -> Iterator[ast.AST]:
    for child in ast.iter_child_nodes(node):
        yield child
        if not isinstance(child, _INNER):
            yield from _own(child)


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
    """Return whether a node stands in another one."""
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


def prefix_of(frame: FrameType | None) -> str:
    """Return what the user writes before shpy's names: `sh.` after `import shpy as sh`."""
    for name, thing in frame.f_globals.items() if frame is not None else ():
        if isinstance(thing, ModuleType) and thing.__name__ == "shpy":
            return f"{name}."
    return "sh."


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
    found = None if listing.checked or listing.text is None else definition_of(listing.code)
    listing.checked = True
    if found is None:
        return
    definition = Definition(*found, frame)
    for node in definition.statements:
        match node:
            case ast.Return(value=value):
                around = [b for b in definition.blocks if is_inside(node, b.node)]
                if around:
                    cure = f"SH_RETURN({ast.unparse(value) if value else ''})"
                    raise definition.leaves(node, "return", cure, around[-1])
            case ast.Break() | ast.Continue():
                _check_jump(definition, node)
            case ast.Expr(value=ast.Name() | ast.Attribute() as value):
                what = control_of(value, frame)
                if what in _EXITS | _OPENERS:
                    raise findings.without_call(definition.text, value, block=what in _OPENERS)


def _check_jump(definition: Definition, node: ast.Break | ast.Continue) -> None:
    """Raise RecordError for a `break` or `continue` whose loop is not inside the innermost block."""
    around = [b for b in definition.blocks if is_inside(node, b.node)]
    loops = [n for n in definition.statements if isinstance(n, ast.For | ast.While) and is_inside(node, n)]
    if not around or (loops and is_inside(loops[-1], around[-1].node)):
        return
    word = type(node).__name__.lower()
    cure, ours = f"SH_{word.upper()}()", [b.node for b in around if b.what in _LOOPS]
    if not ours or (loops and is_inside(loops[-1], ours[-1])):
        cure = f"make the loop a `with SH_FOR(…) as i:`, and write `{cure}`"
    raise definition.leaves(node, word, cure, around[-1])


def check_none(loc: Loc | None) -> None:
    """Raise RecordError if a line compares with None by `==` or `!=`, which compares the components of a value."""
    definition = Definition.around(loc, None)
    for node in definition.nodes if definition is not None else ():
        if isinstance(node, ast.Compare) and loc is not None and node.lineno == loc.line:
            sides = (node.left, node.comparators[0])
            for none, value in (sides, sides[::-1]):
                against_none = isinstance(none, ast.Constant) and none.value is None
                if definition is not None and against_none and isinstance(node.ops[0], ast.Eq | ast.NotEq):
                    raise findings.none_compared(definition.text, node, value)


def alone(what: str, loc: Loc | None) -> RecordError:
    """Return the error for a block that is made on a line and never opened."""
    definition = Definition.around(loc, None)
    for node in definition.statements if definition is not None else ():
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call) and loc is not None:
            if definition is not None and node.lineno == loc.line:
                return findings.without_with(definition.text, node.value, what)
    return RecordError(f"this {what} alone does nothing: it opens a block", loc=loc, cure=f"with {what}(…):")


# Names that a block rebinds, or makes


def rebound(
    what: str, opened: Loc | None, frame: FrameType, where: Loc, place: Place, change: tuple[Any, Any], used: str
) -> RecordError:
    """Return the error for a place that a block has rebound on a line; `used` says when and where it is read.

    The block is `what`, opened on another line; `change` is what the place held before, and what it holds now.
    """
    definition, line = Definition.around(opened, frame), opened.line if opened is not None else 0
    if definition is None:
        return findings.rebound(where, str(place), spelled(what), used, _declaration(what, str(place), place, *change))
    blocks = [b for b in definition.blocks if b.what == what and _is_on(b.node.items[0].context_expr, line, b.node)]
    block = blocks[0] if blocks else None
    stands = [b for b in definition.bindings if binds(b.target, place) and position_of(b.target)[0] >= line]
    binding = next((b for b in stands if b.target.lineno <= where.line <= (b.target.end_lineno or 0)), None)
    name = str(place) if binding is None else quoted(definition.text, binding.target)
    written = block.written if block is not None else spelled(what)
    if binding is not None and isinstance(binding.target, ast.Subscript):
        if isinstance(binding.target.slice, ast.Slice):
            return findings.rebound(where, place.name, written, used, findings.stored_each(place.name))
    cure = _declaration(what, name, place, *change, definition, binding, block)
    return findings.rebound(where, name, written, used, cure)


def _is_on(first: ast.expr, line: int, node: ast.With) -> bool:
    """Return whether a line is one of the items of a `with`."""
    return first.lineno <= line <= (node.items[-1].context_expr.end_lineno or 0)


def used_after(place: Place, used: Loc | None, frame: FrameType | None) -> RecordError | None:
    """Return the error for a place whose value a block has made that is closed; None where no text tells which.

    `used` is the line that uses the value; `frame` is the user's, None where the function has returned.
    """
    definition, line = Definition.around(used, frame), used.line if used is not None else 0
    if definition is None:
        return None
    for binding in reversed([b for b in definition.bindings if binds(b.target, place) and b.target.lineno <= line]):
        around = [b for b in definition.blocks if is_inside(binding.target, b.node)]
        around = [b for b in around if not b.node.lineno <= line <= (b.node.end_lineno or 0)]
        if not around:
            continue
        block, name = around[-1], quoted(definition.text, binding.target)
        loc = findings.at(definition.text, binding.target)
        if binding.statement is block.node:
            return findings.index_used(loc, place.name, block.written, line, prefix_of(frame))
        before = definition.before(place, block.node)
        value = before[-1].value if before else None
        old = None if not before else value.value if isinstance(value, ast.Constant) else Symbolic()
        cure = _declaration(block.what, name, place, old, None, definition, binding, block)
        return findings.rebound(loc, name, block.written, f"after it (line {line})", cure, is_new=not before)
    return None


def _declaration(
    what: str,
    name: str,
    place: Place,
    old: Any,
    new: Any,
    definition: Definition | None = None,
    binding: Binding | None = None,
    block: BlockStatement | None = None,
) -> str:
    """Return the store that the user meant, with a declaration before the block if the place held no value."""
    if isinstance(old, _DISPLAYS) or (isinstance(new, _DISPLAYS) and not isinstance(old, Symbolic)):
        return findings.stored_each(name)
    frame = definition.frame if definition is not None else None
    inside, begin, type_ = f"{name}[:] = …", None, None
    if definition is not None and binding is not None:
        type_ = constructor_of(binding.value, frame)
        if binding.grows:
            inside = quoted(definition.text, binding.statement)
        elif binding.value is not None:
            inside = f"{name}[:] = {quoted(definition.text, binding.value)}"
    if isinstance(old, Symbolic):
        return inside
    opened = "the SH_IF" if what in ("SH_ELIF", "SH_ELSE") else "the block"
    if not isinstance(old, _NUMBERS):
        return findings.stored(f"`{name} = {type_}()`" if type_ else f"make `{name}` a value", inside, opened)
    if definition is not None and block is not None:
        before = definition.before(place, block.node)
        begin = before[-1].value if before and not before[-1].grows else None
    local, start = name, f"{old!r}" if begin is None or definition is None else quoted(definition.text, begin)
    if place.attribute is not None and begin is None:  # what is stored into an object would outlive the recording
        local, start, inside = place.attribute, name, inside.replace(name, place.attribute)
    type_ = type_ or f"{prefix_of(frame)}{_class_for(old, new)}"
    return findings.stored(f"`{local} = {type_}({start})`", inside, opened)


def _class_for(old: Any, new: Any) -> str:
    """Return the class that a host number must become, to be a variable of the program."""
    if isinstance(new, Symbolic):
        return type(new).__name__
    if isinstance(old, bool | np.bool_):
        return "Attrib1b"
    whole = isinstance(old, int | np.integer) and isinstance(new, int | np.integer)
    return "Attrib1i" if whole else "Attrib1f"
