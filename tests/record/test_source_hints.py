"""Hints for a line that misuses a value, each word for word."""

from __future__ import annotations

import linecache
import sys
from typing import Any, NoReturn

import pytest
from source_text import made

from shpy.ir.nodes import Loc
from shpy.lang.mistakes.explain import explain
from shpy.lang.recording.location import loc_in


class Asked(Exception):
    """Return the hint for a line: with the frame, and by the line alone."""


class Symbol:
    """A value that has no bool and no number, and asks the text why one is wanted."""

    def _new(self, *_: object) -> Symbol:
        return Symbol()

    __lt__ = __le__ = __gt__ = __add__ = __mul__ = __rmul__ = __neg__ = _new
    __eq__ = __ne__ = _new  # type: ignore[assignment]
    __hash__ = None  # type: ignore[assignment]

    def _ask(self, kind: str) -> NoReturn:
        frame = sys._getframe(2)
        loc = loc_in(frame.f_code, frame.f_lineno)
        raise Asked(explain(loc, kind, frame), explain(loc, kind))

    def __bool__(self) -> bool:
        self._ask("bool")

    def __int__(self) -> int:
        self._ask("int")

    def __float__(self) -> float:
        self._ask("float")

    def __index__(self) -> int:
        self._ask("index")

    def __round__(self) -> int:
        self._ask("round")

    def __floor__(self) -> int:
        self._ask("math")


def asked(line: str, before: str = "", after: str = "") -> tuple[Any, Any]:
    """Return the hint for a line in a function of x, y (symbols), n (3) and xs (a list)."""
    text = f"import math\n\ndef f(x, y, n, xs):\n{before}    {line}\n{after}"
    with pytest.raises(Asked) as caught:
        made(text)(Symbol(), Symbol(), 3, [Symbol(), 1])
    return caught.value.args[0], caught.value.args[1]


def decided(word: str, asked: str) -> str:
    return f"Python's `{word}` is decided while recording, `{asked}` only when the program runs"


def compares(name: str) -> str:
    return f"Python's `{name}` compares while recording, and what it compares is known only when the program runs"


def asks(name: str) -> str:
    return f"Python's `{name}` asks while recording, and what it asks is known only when the program runs"


BOOLS = {
    "if n > 2 and x: n += 1": (decided("and", "n > 2 and x"), "with SH_IF((n > 2) & x):"),
    "if x > 0: n += 1": (decided("if", "x > 0"), "with SH_IF(x > 0):"),
    "if x > 0 and not y > 1: n += 1": (decided("and", "x > 0 and not y > 1"), "with SH_IF((x > 0) & ~(y > 1)):"),
    "while x < 3: n += 1": (decided("while", "x < 3"), "with SH_WHILE(lambda: x < 3):"),
    "n = 1 if x > 0 else 2": (decided("if", "x > 0"), "sh.cond(x > 0, 1, 2)"),
    "n = 1 if x > 0 else 2 if y > 0 else 3": (
        decided("if", "x > 0"),
        "sh.cond(x > 0, 1, sh.cond(y > 0, 2, 3))",
    ),
    "n = 0 < x < 1": ("Python joins the chain `0 < x < 1` with `and`, while recording", "(0 < x) & (x < 1)"),
    "if 0 < x < 1 or y: n += 1": (
        "Python joins the chain `0 < x < 1` with `and`, while recording",
        "with SH_IF((0 < x) & (x < 1) | y):",
    ),
    "n = not x": (decided("not", "x"), "~x"),
    "n = x or y": (decided("or", "x or y"), "x | y"),
    "n = f(lambda: y, y, n, xs) if n is None else (lambda: x and y)()": (decided("and", "x and y"), "x & y"),
    "n = min(x, y, 3)": (compares("min"), "sh.min(x, y, 3)"),
    "n = max([x, y])": (compares("max"), "sh.max(x, y)"),
    "n = max(k * x for k in range(3))": (compares("max"), "sh.max(*(k * x for k in range(3)))"),
    "n = sorted([x, y])": (compares("sorted"), "compare and exchange with sh.min and sh.max"),
    "n = any([x, y])": (
        asks("any"),
        "join the items with `|`; `sh.any(v)` is for the components of a vector",
    ),
    "n = all(v > 0 for v in (x, y))": (
        asks("all"),
        "join the items with `&`; `sh.all(v)` is for the components of a vector",
    ),
    "n = bool(x)": ("`bool(x)` asks for a bool of Python while recording", "sh.Attrib1b(x)"),
    "assert x > 0": (decided("assert", "x > 0"), "give `x > 0` as an output, and check that"),
    "n = [v for v in (x, y) if v > 0]": (decided("if", "v > 0"), "with SH_IF(v > 0):"),
    "n = x in (1, 2)": (decided("in", "x in (1, 2)"), "(x == 1) | (x == 2)"),
    "n = x not in (1, 2)": (decided("not in", "x not in (1, 2)"), "(x != 1) & (x != 2)"),
    "n = x in xs": (decided("in", "x in xs"), "compare with each, as in `(x == a) | (x == b)`"),
    "n = x not in xs": (decided("not in", "x not in xs"), "compare with each, as in `(x != a) & (x != b)`"),
    "if (m := x) > 0: n = m": (decided("if", "(m := x) > 0"), "with SH_IF((m := x) > 0):"),
}


@pytest.mark.parametrize("line", BOOLS)
def test_why_python_wants_a_bool(line: str) -> None:
    with_frame, by_line = asked(line)
    assert with_frame == BOOLS[line]
    assert by_line == BOOLS[line]


def test_an_elif_and_a_test_on_several_lines() -> None:
    assert asked("elif x > 0: n = 2", before="    if n == 1:\n        n = 5\n") == (
        ((decided("if", "x > 0"), "else:, and in it with SH_IF(x > 0):"),) * 2
    )
    with_frame, _ = asked("if (n == 3", after="            and x > 0):\n        n = 2\n")
    assert with_frame[1] == "with SH_IF((n == 3) & (x > 0)):"


def test_with_the_frame_the_right_one_of_several_is_found() -> None:
    with_frame, by_line = asked("n = (n and 1) + (1 if x else 2)")
    assert with_frame == (decided("if", "x"), "sh.cond(x, 1, 2)")
    assert by_line == (decided("and", "n and 1"), "sh.cond(n, 1, n)")
    assert asked("n = [1, 2].index(x)") == (
        (compares("[1, 2].index"), "compare with each, as in `(x == a) | (x == b)`"),
        None,
    )
    assert asked("n = xs[n - 3] * int(n) + math.sin(n) * xs[x]")[0] == (
        "`xs[x]` is looked up while recording, and its index is known only when the program runs",
        "make `xs` a sh.Table (numbers) or a sh.Array (values), and index that",
    )


def computed(code: str) -> str:
    return f"`{code}` is computed while recording, and its argument is known only when the program runs"


NUMBERS = {
    "n = int(x + 1)": (computed("int(x + 1)"), "sh.Attrib1i(x + 1)"),
    "n = float(x)": (computed("float(x)"), "sh.Attrib1f(x)"),
    "n = round(x)": (computed("round(x)"), "sh.round(x)"),
    "n = math.sin(2 * -x)": (computed("math.sin(2 * -x)"), "sh.sin(2 * -x)"),
    "n = math.fabs(x)": (computed("math.fabs(x)"), "sh.abs(x)"),
    "n = math.floor(x)": (computed("math.floor(x)"), "sh.floor(x)"),
    "n = math.hypot(x, y)": (computed("math.hypot(x, y)"), "sh.hypot(x, y)"),
    "n = math.log10(x)": (computed("math.log10(x)"), "sh.log10(x)"),
    "n = math.gamma(x)": (computed("math.gamma(x)"), "a function of shpy, such as `sh.sqrt`"),
    "for k in range(1, x): n += k": (
        "`range(1, x)` counts while recording, and its bound is known only when the program runs",
        "with SH_FOR(1, x) as k:",
    ),
    "n = list(range(x))": (
        "`range(x)` counts while recording, and its bound is known only when the program runs",
        "with SH_FOR(x) as i:",
    ),
    "n = xs[0] + xs[x]": (
        "`xs[x]` is looked up while recording, and its index is known only when the program runs",
        "make `xs` a sh.Table (numbers) or a sh.Array (values), and index that",
    ),
}


@pytest.mark.parametrize("line", NUMBERS)
def test_why_python_wants_a_number(line: str) -> None:
    assert asked(line) == (NUMBERS[line], NUMBERS[line])


def test_hints_spell_names_as_the_module_does() -> None:
    text = "import shpy as lang\nfrom shpy import SH_FOR\n\ndef f(x):\n    return {}\n"
    for count, (line, cure) in enumerate(
        [
            ("1 if 0 < x < 1 else 2", "lang.cond((0 < x) & (x < 1), 1, 2)"),
            ("int(x)", "lang.Attrib1i(x)"),
            ("[0 for _ in range(x)]", "with SH_FOR(x) as i:"),
            ("[0 for v in (x, x) if v]", "with lang.SH_IF(v):"),
        ]
    ):
        file, names = f"<spelled {count}>", dict[str, Any]()
        linecache.cache[file] = (len(text), None, text.format(line).splitlines(keepends=True), file)
        exec(compile(text.format(line), file, "exec"), names)
        with pytest.raises(Asked) as caught:
            names["f"](Symbol())
        assert caught.value.args[0][1] == cure


def test_no_hint_without_text_or_reason() -> None:
    assert explain(None, "bool") is None
    assert explain(None, "int") is None
    assert explain(Loc("no such file", 3), "bool") is None
    code = made("def f(x):\n    y = x\n    return y\n").__code__
    assert explain(loc_in(code, 2), "bool") is None
    assert explain(loc_in(code, 2), "int") is None
