"""The names that source lines give."""

from __future__ import annotations

import linecache

from source_text import made

from shpy.lang.recording.names import for_name, name_for


def named(text: str) -> tuple[list[str | None], list[str | None]]:
    """Return the names of each line's assignment and `with`."""
    function = made(text)
    file = function.__code__.co_filename
    lines = range(1, len(linecache.getlines(file)) + 1)
    return [name_for(file, line) for line in lines], [for_name(file, line) for line in lines]


def test_the_name_that_a_line_assigns() -> None:
    text = """
        def f(x):
            y = x + 1
            z: float = (
                x
                + y
            )
            x[:] = y
            x.xy = y
            a, b = x, y
            p = q = x
            x += 1
            u = 1; v = 2
            for k in range(3): w = k
            return f(x,
                     y)
        """
    assert named(text)[0] == [
        None, "y", "z", "z", "z", "z", None, None, None, "p", None, None, "w", None, None
    ]  # fmt: skip


def test_the_name_that_a_with_binds() -> None:
    text = """
        def f(x):
            with SH_FOR(8) as i, SH_FOR(
                    9) as j:
                y = i
            with SH_FOR(3):
                y = x
            with SH_FOR(
                x,
            ) as k:
                pass
        """
    assert named(text)[1] == [None, None, "j", None, None, None, "k", "k", "k", None]


def test_no_name_without_text() -> None:
    assert name_for("no such file", 1) is None
    assert for_name("<string>", 1) is None
    file = made("def f():\n    x = 1\n").__code__.co_filename
    assert name_for(file, 2) == "x"
    assert name_for(file, 99) is None
    linecache.cache[file] = (1, None, ["def f(:\n"], file)
    assert name_for(file, 2) is None
