"""Explain errors of Python constructs that need a number or bool while recording: an `if`, a `min`, a list's index.

Stage: record. The value's `__bool__` cannot know which construct called it. The text of the running line shows the
construct, and so the cure. Takes that line; returns a sentence and the cure, or None.

    if 0 < x < 1:       # explain(loc, "bool") → ("Python's `0 < x < 1` …", "with SH_IF((0 < x) & (x < 1)):")
    n = int(x)          # explain(loc, "int") → ("`int(x)` …", "sh.Attrib1i(x)")
"""

from __future__ import annotations

import ast
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from types import FrameType
from typing import Any, NoReturn, TypeAlias, TypeGuard

import numpy as np

from shpy.errors import RecordError
from shpy.ir.nodes import Loc
from shpy.ir.ops import OPS
from shpy.lang.mistakes.expressions import ends_of, is_vector, named, prefix_of, rewritten, size_of
from shpy.lang.mistakes.foreign import OTHER_NAMES, is_in_library, module_cure
from shpy.lang.recording.location import here, user_frame
from shpy.lang.recording.text import Text
from shpy.lang.recording.tree import quoted

Hint: TypeAlias = tuple[str, str]  # the sentence, the cure
_Span: TypeAlias = tuple[int, int, int, int]

_TESTING = frozenset({"bool", "min", "max", "any", "all", "sorted"})
_SAME = {row.name for row in OPS.values() if row.says and (hasattr(np, row.name) or hasattr(math, row.name))} | {
    "radians",
    "degrees",
    "transpose",
}
"""The functions that numpy or math has by the same name."""
_JOINING = frozenset({"array", "asarray", "stack", "concatenate", "hstack", "vstack", "column_stack"})
_NUMBERS = ("a_min", "a_max", "min", "max", "decimals", "ndigits")
"""Arguments by name of numpy and Python that the cure takes by position, as it does numbers."""
_OF_COUNTS = {
    ("round", 2): "{prefix}round({0} * 10**{1}) / 10**{1}",
    ("around", 2): "{prefix}round({0} * 10**{1}) / 10**{1}",
    ("log", 2): "{prefix}log({0}) / {prefix}log({1})",
    ("fmod", 2): "{0} - {1} * {prefix}trunc({0} / {1})",
    ("copysign", 2): "{prefix}cond({prefix}bits_from_float({1}) >= 2**31, -abs({0}), abs({0}))",
    ("logical_and", 2): "{0} & {1}",
    ("logical_or", 2): "{0} | {1}",
    ("logical_not", 1): "~{0}",
    ("complex", 1): "a vector of two, {prefix}vec2({0}, 0)",
    ("complex", 2): "a vector of two, {prefix}vec2({0}, {1})",
    ("square", 1): "{0} * {0}",
    ("uniform", 2): "{0} + ({1} - {0}) * {prefix}unit_float({prefix}hash(i))",
    ("randint", 2): "the bits of {prefix}hash(i), the same in every run",
}
"""Cures for functions of Python and numpy, by their number of arguments."""
_NUMERIC = ("math", "cmath", "np", "numpy")
_CASTING = {
    "float32": "Attrib1f", "float64": "Attrib1d", "float16": "Attrib1h", "int32": "Attrib1i", "int64": "Attrib1i",
    "uint32": "Attrib1u", "bool_": "Attrib1b",
}  # fmt: skip


_NUMBER = "{} needs a number, and this value has none while the program is recorded"
_UNSEEN: dict[str, Hint] = {
    "bool": (
        "Python needs to know here whether a value holds, and it has none while the program is recorded",
        "with SH_IF(c): for a branch, & | ~ for and, or, not, sh.cond(c, a, b) for a choice",
    ),
    "array": (
        "{} has no value while the program is recorded, so numpy cannot take it",
        "the function of the same name in shpy, sh.sin(x) for np.sin(x); sh.Table(array, type)[i] for array[i]",
    ),
    "int": (_NUMBER.format("int()"), "sh.Attrib1i(x)"),
    "float": (
        _NUMBER.format("float(), or a function of math,"),
        "sh.Attrib1f(x) for float(x), sh.sin(x) for math.sin(x)",
    ),
    "index": (
        _NUMBER.format("an index of a Python object, or range(),"),
        "sh.Table(list, sh.Attrib1f)[x] for list[x], with SH_FOR(n) as i: for range(n)",
    ),
    "round": (_NUMBER.format("round()"), "sh.round(x)"),
    "trunc": (_NUMBER.format("math.trunc()"), "sh.trunc(x)"),
}
"""The sentence and the cure where the text does not tell which construct asks."""


@dataclass(frozen=True, slots=True)
class _Site:
    """A place where Python needs a bool or number: the construct, the tested expression, and the node to rewrite."""

    node: ast.AST
    tested: ast.expr
    whole: ast.AST


def refuse(value: Any, asked: str) -> NoReturn:
    """Raise RecordError for a symbolic value that Python or numpy asked for a bool, a number or an array."""
    loc = here()
    sentence, unseen = _UNSEEN[asked]
    hint = explain(loc, asked)
    message, cure = hint or (sentence.format(value._called()), unseen)
    raise RecordError(message, loc=loc, cure=cure)


def explain(loc: Loc | None, asked: str, frame: FrameType | None = None) -> Hint | None:
    """Return why Python needed a bool or a number on this line; `frame` is the user's, if known. None without a text.

    `asked` is the kind of the request: bool, int, float, index, array, round or math.
    """
    if loc is None or loc.text is None:
        return None
    try:
        roots, frame = _statements(loc), frame or user_frame()
        spelling = _Spelling(loc.text, frame if frame and frame.f_code.co_filename == loc.file else None)
        if asked == "bool":
            tests = [s for root in roots for s in _tests(root) if not _of_the_host(s.tested)]
            site = _chosen(tests, loc, frame) or _in_a_call(roots, loc, frame)
            return None if site is None else _bool_hint(site, spelling)
        asking = [_Site(n, n, root) for root in roots for n in _in_order(root) if _asks(n, asked, spelling.frame)]
        asking.sort(key=lambda site: isinstance(site.node, ast.Call) and isinstance(site.node.func, ast.Attribute))
        site = _chosen(asking, loc, frame) or _in_a_call(roots, loc, frame)
        if site is None:
            return None
        if isinstance(site.node, ast.Subscript) and _is_stored(site.node, asked):
            array, element = spelling.quoted(site.node.value), spelling.quoted(site.node)
            why = "stores a number while recording, and this value is known only when the program runs"
            cure = f"make `{array}` a list, or with an index of the language a {spelling.prefix}Array"
            return f"`{element} = …` {why}", cure
        index = site.whole.target if isinstance(site.whole, ast.For) and site.whole.iter is site.node else None
        return _conversion_hint(site.tested, spelling, index.id if isinstance(index, ast.Name) else "i")
    except RecursionError:  # the expression is deeper than Python's stack, so the error has no hint
        return None


@dataclass(frozen=True, slots=True)
class _Spelling:
    """The way in which a file writes shpy's names; `frame` knows the types of its own names."""

    text: Text
    frame: FrameType | None

    @property
    def prefix(self) -> str:
        """The text that stands before the names of shpy, `sh.`."""
        return prefix_of(self.frame)

    def test(self, node: ast.expr) -> str:
        """Return an expression as a bool of the language."""
        return rewritten(node, self.prefix, self.frame, test=True)

    def counted(self, node: ast.expr) -> str:
        """Return an expression as an int of the language."""
        value, text = named(node, self.frame), ast.unparse(node)
        return f"{self.prefix}Attrib1i({text})" if is_vector(value) and not value.type.is_int else text

    def quoted(self, node: ast.AST) -> str:
        """Return the code as it stands in the text."""
        return quoted(self.text, node)

    def control(self, name: str) -> str:
        """Return `SH_IF`, or `sh.SH_IF` where the module imports other names of blocks, and not this one."""
        imported = [n for n in self.frame.f_globals if n.startswith("SH_")] if self.frame is not None else []
        return name if name in imported or not imported else f"{self.prefix}{name}"


# Finding the place.


def _statements(loc: Loc) -> list[ast.stmt]:
    """Return the statements on the line; of a compound one, the line must be in its head."""
    tree = loc.text.tree if loc.text is not None else None
    statements: list[ast.stmt] = []
    for node in ast.walk(tree) if tree is not None else ():
        if isinstance(node, ast.stmt) and node.lineno <= loc.line:
            head = [part for part in _parts(node) if isinstance(part, ast.expr)]
            if loc.line <= max((part.end_lineno or part.lineno for part in head), default=node.lineno):
                statements.append(node)
    return statements


def _parts(root: ast.AST) -> Iterator[ast.AST]:
    """Yield the children that belong to the line itself, not to the statements under it."""
    for child in ast.iter_child_nodes(root):
        if not isinstance(child, ast.stmt | ast.ExceptHandler | ast.match_case):
            yield child


def _in_order(root: ast.AST) -> Iterator[ast.AST]:
    """Yield inner nodes before outer ones, left to right: about the order of evaluation."""
    for child in _parts(root):
        yield from _in_order(child)
    yield root


def _tests(root: ast.AST, whole: ast.AST | None = None) -> Iterator[_Site]:
    """Yield the places where Python tests an expression for truth, in the order of evaluation."""
    match root:
        case ast.If() | ast.While() | ast.Assert():
            yield from _tests(root.test, root)
            yield _Site(root, root.test, root)
        case ast.IfExp():
            outer = whole if isinstance(whole, ast.expr) else root
            yield from _tests(root.test, outer)
            yield _Site(root, root.test, outer)
            yield from _tests(root.body)
            yield from _tests(root.orelse)
        case ast.BoolOp():
            for count, value in enumerate(root.values):
                yield from _tests(value, whole or root)
                if count + 1 < len(root.values):
                    yield _Site(root, value, whole or root)
        case ast.UnaryOp(op=ast.Not()):
            yield from _tests(root.operand, whole or root)
            yield _Site(root, root.operand, whole or root)
        case ast.Compare():
            for operand in (root.left, *root.comparators):
                yield from _tests(operand)
            if len(root.ops) > 1 or isinstance(root.ops[0], ast.In | ast.NotIn):
                yield _Site(root, root, whole or root)
        case ast.comprehension():
            yield from _tests(root.iter)
            for test in root.ifs:
                yield from _tests(test, whole)
                yield _Site(root, test, root)
        case _:
            for part in _parts(root):
                yield from _tests(part)
            if isinstance(root, ast.Call) and isinstance(root.func, ast.Name) and root.func.id in _TESTING:
                yield _Site(root, root, root)


def _of_the_host(node: ast.expr) -> bool:
    """Return whether the test is certainly Python's own."""
    if isinstance(node, ast.Compare):
        if all(isinstance(o, ast.Is | ast.IsNot) for o in node.ops):
            return True
        return all(_of_the_host(e) for e in (node.left, *node.comparators))
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Name) and node.func.id in ("len", "isinstance", "hasattr", "callable")
    return isinstance(node, ast.Constant)


def _asks(node: ast.AST, kind: str, frame: FrameType | None) -> TypeGuard[ast.expr]:
    """Return whether the expression may ask a value for this kind of number."""
    match node:
        case ast.Call(func=function, args=[_, *_]) if getattr(named(function, frame), "__module__", "") in _NUMERIC:
            return True
        case ast.Call(func=ast.Name(id=name)):
            return {"array": "index"}.get(kind, kind) == {"range": "index", "complex": "float"}.get(name, name)
        case ast.Call(func=ast.Attribute(value=ast.Name(id=module))):
            return module in _NUMERIC and bool(node.args)
        case ast.Call(func=ast.Attribute(value=ast.Attribute(value=ast.Name(id=module)))):
            return module in _NUMERIC and bool(node.args)
        case ast.Subscript():
            return _is_stored(node, kind) or (kind in ("index", "array") and not isinstance(node.slice, ast.Constant))
    return False


def _is_stored(node: ast.Subscript, kind: str) -> bool:
    """Return whether the expression is an element of an array of numpy that is given a value."""
    stands = not any(isinstance(part, ast.Name) for part in ast.walk(node.slice))
    return isinstance(node.ctx, ast.Store) and (stands or kind not in ("index", "array"))


def _span(node: ast.AST) -> _Span | None:
    if not isinstance(node, ast.expr | ast.stmt) or node.end_lineno is None or node.end_col_offset is None:
        return None
    return node.lineno, node.end_lineno, node.col_offset, node.end_col_offset


def _running(loc: Loc, frame: FrameType | None) -> _Span | None:
    """Return the span of the expression that the frame is computing."""
    if frame is None or frame.f_code.co_filename != loc.file or frame.f_lineno != loc.line:
        return None
    span = next(itertools.islice(frame.f_code.co_positions(), frame.f_lasti // 2, None), None)
    if span is None or any(s is None for s in span):
        return None
    return span  # type: ignore[return-value]


def _chosen(sites: list[_Site], loc: Loc, frame: FrameType | None) -> _Site | None:
    """Return the place whose text the frame is computing, else the first on the line."""
    running = _running(loc, frame)
    if running is not None:
        for site in sites:
            if running in (_span(site.node), _span(site.tested)):
                return site
        for site in sites:
            if running == _span(site.whole):
                return site
    near = [s for s in sites if (span := _span(s.tested)) is None or span[0] <= loc.line <= span[1]]
    return next(iter(near or sites), None)


def _in_a_call(roots: list[ast.stmt], loc: Loc, frame: FrameType | None) -> _Site | None:
    """Return the call, of `list.index` say, from which Python's own code asks."""
    running = _running(loc, frame)
    for node in (n for root in roots for n in _in_order(root)):
        if isinstance(node, ast.Call) and _span(node) == running:
            return _Site(node, node, node)
    return None


# Saying it.


def _bool_hint(site: _Site, spelling: _Spelling) -> Hint:
    word = _word(site.node)
    if word is None:
        return _builtin_hint(site.node, spelling)
    # Which operand of `and` asked is not certain: CPython's positions are those of the first for all.
    asked = spelling.quoted(site.node if isinstance(site.node, ast.BoolOp) else site.tested)
    message = f"Python's `{word}` is decided while recording, `{asked}` only when the program runs"
    if isinstance(site.node, ast.Compare) and word == "and":
        message = f"Python joins the chain `{asked}` with `and`, while recording"
    return message, _test_cure(site, spelling)


def _word(node: ast.AST) -> str | None:
    """Return the word of Python that asks; None for a call."""
    match node:
        case ast.While():
            return "while"
        case ast.Assert():
            return "assert"
        case ast.BoolOp(op=ast.Or()):
            return "or"
        case ast.UnaryOp():
            return "not"
        case ast.Compare(ops=[operator]):
            return "in" if isinstance(operator, ast.In) else "not in"
        case ast.BoolOp() | ast.Compare():
            return "and"
        case ast.Call():
            return None
    return "if"


def _test_cure(site: _Site, spelling: _Spelling) -> str:
    """Return the whole construct as it should be written."""
    whole = site.whole
    match whole:
        case ast.If(test=test):
            # The test of an `elif` starts five characters after it, that of an `if` three. Python has decided the `if`
            # above an `elif`, so no SH_IF is there to continue.
            is_elif = test.lineno == whole.lineno and test.col_offset - whole.col_offset >= 5
            inside = "else:, and in it " if is_elif else ""
            return f"{inside}with {spelling.control('SH_IF')}({spelling.test(test)}):"
        case ast.While(test=test):
            return f"with {spelling.control('SH_WHILE')}(lambda: {spelling.test(test)}):"
        case ast.Assert(test=test):
            return f"give `{spelling.test(test)}` as an output, and check that"
        case ast.Compare(ops=[ast.In() | ast.NotIn()], comparators=[items]) if (
            not isinstance(items, ast.Tuple | ast.List | ast.Set) and ends_of(items) is None
        ):
            left, (sign, join) = (
                spelling.quoted(whole.left),
                ("==", "|") if isinstance(whole.ops[0], ast.In) else ("!=", "&"),
            )
            return f"compare with each, as in `({left} {sign} a) {join} ({left} {sign} b)`"
        case ast.comprehension():
            return f"with {spelling.control('SH_IF')}({spelling.test(site.tested)}):"
        case ast.expr():
            return rewritten(whole, spelling.prefix, spelling.frame)
    return spelling.quoted(whole)


def _builtin_hint(node: ast.AST, spelling: _Spelling) -> Hint:
    """Return the hint for `min`, `max` and the like, which compare while recording."""
    assert isinstance(node, ast.Call)
    name, arguments = spelling.quoted(node.func), [ast.unparse(a) for a in node.args]
    message = f"Python's `{name}` compares while recording, and what it compares is known only when the program runs"
    if name == "bool":
        return (
            f"`{spelling.quoted(node)}` asks for a bool of Python while recording",
            f"{spelling.prefix}Attrib1b({', '.join(arguments)})",
        )
    if name == "sorted":
        return message, f"compare and exchange with {spelling.prefix}min and {spelling.prefix}max"
    asks = f"Python's `{name}` asks while recording, and what it asks is known only when the program runs"
    if name in ("any", "all"):
        message = asks
        sign = "|" if name == "any" else "&"
        return message, f"join the items with `{sign}`; `{spelling.prefix}{name}(v)` is for the components of a vector"
    if name not in ("min", "max"):
        compares = isinstance(node.func, ast.Attribute) and node.func.attr in ("index", "count", "remove")
        each = "compare with each, as in `(x == a) | (x == b)`"
        return (message, each) if compares else (asks, _UNSEEN["bool"][1])
    return message, f"{spelling.prefix}{name}({_items(node.args)})"


def _items(arguments: list[ast.expr]) -> str:
    """Return the items of which `max` or `min` is asked, as `sh.max` takes them: each by itself."""
    match arguments:
        case [ast.Tuple(elts=items) | ast.List(elts=items)]:
            arguments = items
        case [ast.expr() as whole] if not isinstance(whole, ast.Starred):
            return f"*{ast.unparse(whole)}"
    return ", ".join(ast.unparse(a) for a in arguments)


def conversion_of(node: ast.expr, text: Text, frame: FrameType) -> Hint:
    """Return the sentence and the cure for an expression that needs a number of Python."""
    return _conversion_hint(node, _Spelling(text, frame))


def _conversion_hint(node: ast.expr, spelling: _Spelling, index: str = "i") -> Hint:
    prefix, asked = spelling.prefix, spelling.quoted(node)
    match node:
        case ast.Subscript(value=base):
            return (
                f"`{asked}` is looked up while recording, and its index is known only when the program runs",
                f"make `{spelling.quoted(base)}` a {prefix}Table (numbers) or a {prefix}Array (values), and index that",
            )
        case ast.Call(func=ast.Name(id="range")):
            return (
                f"`{asked}` counts while recording, and its bound is known only when the program runs",
                f"with {spelling.control('SH_FOR')}({', '.join(map(spelling.counted, node.args))}) as {index}:",
            )
        case ast.Call(func=function, args=positional, keywords=keywords):
            arguments = [*positional, *(k.value for k in keywords if k.arg in _NUMBERS)]
            message = f"`{asked}` is computed while recording, and its argument is known only when the program runs"
            name = function.attr if isinstance(function, ast.Attribute) else ast.unparse(function)
            if OTHER_NAMES.get(name, name) in _JOINING:
                return message, _joined(arguments, spelling)
            return message, _function_cure(function, arguments, spelling)
    return f"`{asked}` needs a number while recording", "a value of the language cannot stand here"


def _joined(arguments: list[ast.expr], spelling: _Spelling) -> str:
    """Return the cure for numpy's functions that make one array of what they are given."""
    inside = ", ".join(ast.unparse(a) for a in arguments[:1])
    if not arguments or not isinstance(arguments[0], ast.List | ast.Tuple):
        return f"{inside or 'the value'}, which needs no array"
    parts: list[ast.expr] = []
    for part in arguments[0].elts:
        parts += part.elts if isinstance(part, ast.List | ast.Tuple) else [part]
    size = sum(size_of(part, spelling.frame) for part in parts)
    return f"{spelling.prefix}vec{min(max(size, 2), 4)}({', '.join(ast.unparse(part) for part in parts)})"


def _function_cure(function: ast.expr, arguments: list[ast.expr], spelling: _Spelling) -> str:
    """Return what to write in place of a call of a function of numbers."""
    prefix, inside = spelling.prefix, ", ".join(ast.unparse(a) for a in arguments)
    name = function.attr if isinstance(function, ast.Attribute) else ast.unparse(function)
    callee = named(function, spelling.frame)
    if callee is not None and not isinstance(callee, type):  # from math import sin as s
        name = getattr(callee, "__name__", name)
    if (name, len(arguments)) in _OF_COUNTS:
        return _OF_COUNTS[name, len(arguments)].format(*map(_operand, arguments), prefix=prefix)
    if name in ("max", "min", "amax", "amin"):
        return f"{prefix}{name.removeprefix('a')}({_items(arguments)})"
    name = {"int": "int32", "float": "float32"}.get(name, OTHER_NAMES.get(name, name))
    if name in _CASTING:
        return f"{prefix}{_CASTING[name]}({inside})"
    if name == "length":
        return f"{prefix}length({prefix}Attrib2f({inside}))" if "," in inside else f"{prefix}length({inside})"
    if name in _SAME or name in OTHER_NAMES.values():
        return f"{prefix}{name}({inside})"
    if is_in_library(name):
        return f"{prefix}library.{name}({inside})"
    return module_cure(name, ()) or f"a function of shpy, such as `{prefix}sqrt`"


def _operand(node: ast.expr) -> str:
    """Return an argument as an operand of any operator."""
    text = ast.unparse(node)
    return text if isinstance(node, ast.Name | ast.Attribute | ast.Constant | ast.Subscript | ast.Call) else f"({text})"
