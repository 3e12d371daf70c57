"""Rebinding found without source: programs that `exec` makes, of which Python keeps no text."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import textwrap
import types
from typing import Any

import numpy as np
import pytest
from source_text import BLOCKS
from test_source_innocent import INNOCENT
from test_source_rebinding import REBOUND

import shpy as sh

_count = itertools.count()


def record(text: str) -> sh.Program:
    """The last function of a text that cannot be read back, recorded; what is not annotated is an Attrib1f."""
    namespace: dict[str, Any] = {
        "sh": sh,
        "np": np,
        "math": __import__("math"),
        "os": os,
        "contextlib": contextlib,
        "DATA": [1, 2, 3],
        "WIDE": True,
        "counter": types.SimpleNamespace(made=0, label=""),
        "types": types,
        **BLOCKS,
    }
    file = f"<no text {next(_count)}>"
    exec(compile(textwrap.dedent(text).lstrip("\n"), file, "exec", dont_inherit=True), namespace)
    made = [v for v in namespace.values() if isinstance(v, types.FunctionType) and v.__code__.co_filename == file][-1]
    for name in made.__code__.co_varnames[: made.__code__.co_argcount]:
        made.__annotations__.setdefault(name, sh.Attrib1f)
    return sh.program(made)


@pytest.mark.parametrize("case", INNOCENT)
def test_programs_that_are_right_without_text_too(case: str) -> None:
    if case == "the test of a loop":  # right for a reader of the text, and wrong for another reason
        with pytest.raises(sh.RecordError, match="Python needs to know here whether a value holds"):
            record(INNOCENT[case])
    else:
        assert record(INNOCENT[case]).ir.functions


@pytest.mark.parametrize("case", REBOUND)
def test_a_name_that_a_block_rebinds_is_found_without_text(case: str) -> None:
    text, known = REBOUND[case]
    with pytest.raises(sh.RecordError) as caught:
        record(text)
    assert caught.value.loc is not None
    assert caught.value.loc.line == int(known.partition(":")[0])
    said = r"is rebound inside `with .*?` and used (after it|in its next iteration)"
    found, wanted = re.search(said, caught.value.message), re.search(said, known)
    assert found is not None
    assert wanted is not None
    assert found[0] == wanted[0]
    assert re.search(r"\[:\] = …", caught.value.cure or "")


MORE_INNOCENT = {
    "a temporary with a condition of Python's": """
        def f(x: sh.Attrib1f):
            t = x * 2
            x += t
            with SH_DO():
                if WIDE:
                    t = x * 3
                if WIDE:
                    x += t
                SH_UNTIL(x > 8)
            if WIDE:
                t = x * 5
            if WIDE:
                x += t
            return x
        """,
    "a list that Python fills and empties": """
        def f(x: sh.Attrib1f):
            waiting = [x + 1, x + 2]
            while waiting:
                with SH_IF(x > 0):
                    x += waiting.pop(0)
            return x
        """,
    "an attribute that is not read again": """
        def f(x: sh.Attrib1f):
            counter.latest = x * 1
            here = counter
            with SH_IF(x > 0):
                here.latest = x * 2
                x += here.latest
            return x + here.made
        """,
    "loops one after the other with one index": """
        def f(x: sh.Attrib1f):
            i = 3
            with SH_FOR(i) as i:
                x += i
            with SH_FOR(4) as i:
                x += i
            for i in range(3):
                with SH_FOR(2) as j:
                    x += i * j
            return x
        """,
}


@pytest.mark.parametrize("case", MORE_INNOCENT)
def test_what_only_looks_like_a_mistake(case: str) -> None:
    assert record(MORE_INNOCENT[case]).ir.functions


MORE_MISTAKES = {
    "in the next iteration of Python's loop alone": (
        """
        def f(x: sh.Attrib1f):
            y = x * 1
            for k in range(3):
                x += y
                with SH_IF(x > k):
                    y = x * 2
            return x
        """,
        "6: `y` is rebound inside `with SH_IF(…)` and used after it (line 4)",
    ),
    "by a generator that opens a block": (
        """
        @contextlib.contextmanager
        def positive(a):
            with SH_IF(a > 0):
                yield a

        def f(x: sh.Attrib1f):
            y = x * 1
            with positive(x) as p:
                y = p * 2
            return y
        """,
        "9: `y` is rebound inside `with SH_IF(…)` and used after it (line 10)",
    ),
    "an attribute of an object": (
        """
        def f(x: sh.Attrib1f):
            here = counter
            here.scale = x * 1
            with SH_IF(x > 0):
                here.scale = x * 2
            return x * here.scale
        """,
        "5: `here.scale` is rebound inside `with SH_IF(…)` and used after it (line 6)",
    ),
    "a matrix": (
        """
        def f(x: sh.Attrib1f):
            m = sh.Matrix2f()
            with SH_IF(x > 0):
                m = m * 2
            return m[0, 0]
        """,
        "4: `m` is rebound inside `with SH_IF(…)` and used after it (line 5)",
    ),
    "by Python's return": (
        """
        def f(x: sh.Attrib1f):
            y = x * 2
            with SH_DO():
                x += 1
                with SH_IF(x > 3):
                    return y
            return x
        """,
        "5: Python's `return` inside `with SH_IF(…)` happens while recording",
    ),
}


@pytest.mark.parametrize("case", MORE_MISTAKES)
def test_more_mistakes_that_are_found_without_text(case: str) -> None:
    text, said = MORE_MISTAKES[case]
    with pytest.raises(sh.RecordError) as caught:
        record(text)
    assert caught.value.loc is not None
    assert str(caught.value).removeprefix(f"{caught.value.loc.file}:").startswith(said)


@pytest.mark.parametrize(
    ("wrong", "cure", "right"),
    [
        ("x = math.sqrt(x)", "sh.sin(x) for math.sin(x)", "x = sh.sqrt(x)"),
        ("x = float(x)", "sh.Attrib1f(x) for float(x)", "x = sh.Attrib1f(x)"),
        ("x = math.trunc(x)", "sh.trunc(x)", "x = sh.trunc(x)"),
        (
            "for i in range(sh.Attrib1i(x)): x += i",
            "with SH_FOR(n) as i: for range(n)",
            "with SH_FOR(sh.Attrib1i(x)) as i: x += i",
        ),
    ],
)
def test_a_number_that_python_needs_has_a_cure_that_works(wrong, cure, right) -> None:
    """Without text the error knows only which method of the value Python called."""
    with pytest.raises(sh.RecordError, match="needs a number") as raised:
        record(f"def f(x):\n    {wrong}\n    return x\n")
    assert cure in raised.value.cure
    record(f"def f(x):\n    {right}\n    return x\n")
