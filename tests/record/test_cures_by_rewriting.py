"""Cures that the tests of the source check expect, carried out by rewriting the program: it then does what Python does.

A message names a line, quotes what stands there, and says what to write instead. The rewritten program passes the check
and is recorded. Where its inputs are numbers, its results are those of the first text in Python, with Python's `if`,
`while` and `for` in place of the blocks: that is what the user meant.
"""

from __future__ import annotations

import itertools
import math
import re
import textwrap
from types import SimpleNamespace

import numpy as np
import pytest
from source_text import check, made
from test_source_aliases import ALIASES, MISPLACED
from test_source_rebinding import MADE_INSIDE, REBOUND

import shpy as sh

CASES = {**ALIASES, **REBOUND, **MADE_INSIDE, **MISPLACED}

BY_HAND = {
    "more than a swap": """
        def step(a, b):
            old = a.copy()
            a[:], b[:] = a + b, old

        def f(x: sh.Attrib1f, y: sh.Attrib1f):
            step(x, y)
            return x
        """,
    "in a tuple": """
        def f(x: sh.Attrib1f, y: sh.Attrib1f):
            with SH_IF(x > y):
                old = x.copy()
                x[:] = y
                y[:] = old
            return x - y
        """,
    "by walrus": """
        def f(x: sh.Attrib1f):
            y = x + 1
            with SH_IF(x > 1):
                y[:] = x * 3
                x[:] = y + 1
            return x + y
        """,
    "an item of a list that Python's loop goes through": """
        def f(a: sh.Attrib1f, b: sh.Attrib1f, c: sh.Attrib1f):
            v = [x for x in (a, b, c)]
            for i, j in ((0, 1), (1, 2), (0, 1)):
                with SH_IF(v[i] > v[j]):
                    old = v[i].copy()
                    v[i][:] = v[j]
                    v[j][:] = old
            return v[0]
        """,
    "the items of a list, by a slice": """
        def f(x: sh.Attrib1f, y: sh.Attrib1f):
            first, second = x.copy(), y.copy()
            with SH_IF(x > y):
                first[:] = y
                second[:] = x
            return first
        """,
    "a tuple of values in the next iteration": """
        def f(x: sh.Attrib1f):
            first, second = x.copy(), x.copy()
            with SH_FOR(3):
                old = first.copy()
                first[:] = second
                second[:] = old + 1
            return first
        """,
    "a tuple of a helper, whose parameters may be values": """
        def ordered(a, b):
            first, second = a + 0, b.copy()
            with SH_IF(a > b):
                old = first.copy()
                first[:] = second
                second[:] = old
            return first
        """,
    "a dict that gets values": """
        def f(x: sh.Attrib1f):
            found = sh.Attrib1f(1)
            with SH_IF(x > 0):
                found[:] = x * 2
            return x * found
        """,
    "in both branches": """
        def f(x: sh.Attrib1f):
            t = sh.Color3f()
            with SH_IF(x > 0):
                t[:] = sh.Color3f(1, 0, 0)
            with SH_ELSE():
                t[:] = sh.Color3f(0, 0, 0)
            return t
        """,
    "the index of a loop": """
        def f(x: sh.Attrib1f):
            last = sh.Attrib1i()
            with SH_FOR(8) as i:
                x += i
                last[:] = i
            return x + last
        """,
    "break out of a block": """
        def f(x: sh.Attrib1f):
            with SH_FOR(3) as k:
                with SH_IF(x > k):
                    SH_BREAK()
            return x
        """,
    "yield": """
        def f(x: sh.Attrib1f):
            with SH_IF(x > 0):
                SH_RETURN(x)
            return -x
        """,
    "a block without with": """
        def f(x: sh.Attrib1f):
            with SH_IF(x > 0):
                x += 1
            return x
        """,
    "a test that is not last": """
        def f(x: sh.Attrib1f):
            with SH_DO():
                x += 1
                SH_UNTIL(x > 1)
            return x
        """,
}
"""Programs whose message asks for changes in several lines, or for names of the user's."""

WHOLE = re.compile(r"is rebound inside|is made inside|is not called|^Python's `(return|yield|continue)`")
"""The messages whose cure is a statement in place of one; that of the others replaces what the message quotes."""
OTHERWISE_IN_PYTHON = {
    "a block without with": "its text is no program of Python",
    "a block without a call": "its text is no program of Python",
    "an exit without a call": "its text leaves the loop nowhere",
    "a test that is not last": "the test is moved",
    "continue in a loop of both kinds": "its loop has no end in either",
    "return under Python's if": "its loop has no end where x is below 3",
    "yield": "a generator",
    "a dict that gets values": "it holds a number, or a list",
    "in both branches": "a colour",
    "more than a swap": "a helper of Python changes nothing in its caller",
    "None": "a number is not None in both",
    "an array": "Python has no sh.Array",
}
"""Cases that are recorded, and whose first text does in Python something else; each with the reason."""


def rewritten(text, error):
    """Return the program with the cure of its message carried out."""
    place, _, cure = error.partition("\n  write instead: ")
    number, _, said = place.partition(": ")
    lines, line = textwrap.dedent(text).strip("\n").splitlines(), int(number) - 1
    quoted = re.search(r"`(.*?)`", said)[1]
    pieces = re.findall(r"`(.*?)`", cure) or [cure]
    if "before the" in cure:  # a value before the block, and a store inside it
        store = pieces[1]
        value = pieces[0] if "=" in pieces[0] else f"{quoted} = 0 * ({store.partition('= ')[2]})"
        lines[line] = indented(lines[line], store)
        earlier = [k for k in range(line) if lines[k].strip().startswith(f"{quoted} = ")]
        if earlier:
            lines[earlier[-1]] = indented(lines[earlier[-1]], value)
        else:
            block = next(k for k in range(line) if lines[k].strip().startswith("with "))
            lines.insert(block, indented(lines[block], value))
    elif WHOLE.search(said):
        lines[line] = indented(lines[line], cure)
    else:
        assert quoted in lines[line]
        lines[line] = lines[line].replace(quoted, pieces[-1])
    return "\n".join(lines) + "\n"


def indented(line, statement):
    """Return a statement with the indentation of a line."""
    return line[: len(line) - len(line.lstrip())] + statement


BLOCKS = [
    (r"with SH_IF\((.*)\):", r"if \1:"),
    (r"with SH_ELIF\((.*)\):", r"elif \1:"),
    (r"with SH_ELSE\(\):", "else:"),
    (r"with SH_WHILE\(lambda: (.*)\):", r"while \1:"),
    (r"with SH_FOR\((.*)\) as (\w+):", r"for \2 in range(\1):"),
    (r"with SH_FOR\((.*)\):", r"for _ in range(\1):"),
    (r"with SH_DO\(\):", "while True:"),
    (r"SH_(UNTIL|BREAK)\((.*)\)", r"if \2: break"),
    (r"\[:\]", ""),
]
PYTHON = SimpleNamespace(Attrib1f=float, Attrib1i=int, abs=abs, sqrt=math.sqrt, min=min, asin=math.asin)
GIVEN = {"DATA": [1, 2, 3], "DEBUG": False}


def in_python(text):
    """Return the function of a text in which Python's statements stand for the blocks."""
    for block, statement in BLOCKS:
        text = re.sub(block, statement, text)
    names = {"sh": PYTHON, "np": np, "math": math, **GIVEN}
    exec(textwrap.dedent(text), names)
    return names["f"]


@pytest.mark.parametrize("case", CASES)
def test_a_rewritten_program_does_what_python_does(case):
    text, error = CASES[case]
    cured = BY_HAND.get(case) or rewritten(text, error)
    check(cured, **GIVEN)  # no error
    if "def ordered(" in text:
        return  # a helper, which is not recorded by itself
    kernel = sh.program(made(cured, **GIVEN)).compile("numpy")
    inputs = re.search(r"def f\((.*)\):", text)[1]
    count = len(re.findall(r": sh\.Attrib1f", inputs))
    if count < inputs.count(":") or case in OTHERWISE_IN_PYTHON:
        return
    meant = in_python(text)
    numbers = [0.25, 0.4375, 1.5, 3.0] if "SH_DO" in text else [-1.5, 0.25, 0.4375, 3.0]  # where loops end
    for given in itertools.product(numbers, repeat=count):
        try:
            with np.errstate(invalid="ignore"):
                expected = meant(*given)
        except (ValueError, UnboundLocalError):  # the square root of a negative number; a name that no branch has bound
            continue
        assert np.asarray(kernel(*given)) == pytest.approx(np.asarray(expected, np.float64), rel=1e-6, nan_ok=True), (
            given
        )
