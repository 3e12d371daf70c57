"""The names that source lines give."""

from __future__ import annotations

import linecache
import os
import py_compile
from pathlib import Path

import pytest
from source_text import made

from shpy.ir.nodes import Loc
from shpy.lang.recording import text as texts
from shpy.lang.recording.location import loc_in
from shpy.lang.recording.names import for_name, name_for
from shpy.lang.recording.text import text_of


def named(text: str) -> tuple[list[str | None], list[str | None]]:
    """Return the names of each line's assignment and `with`."""
    function = made(text)
    count = len(linecache.getlines(function.__code__.co_filename))
    locs = [loc_in(function.__code__, line) for line in range(1, count + 1)]
    return [name_for(loc) for loc in locs], [for_name(loc) for loc in locs]


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
    assert name_for(None) is None
    assert for_name(Loc("<string>", 1)) is None
    code = made("def f():\n    x = 1\n").__code__
    assert name_for(loc_in(code, 2)) == "x"
    assert name_for(loc_in(code, 99)) is None
    linecache.cache[code.co_filename] = (1, None, ["def f(:\n"], code.co_filename)
    other = code.replace(co_firstlineno=2)  # neither text has it
    assert text_of(other) is None
    assert name_for(loc_in(other, 2)) is None
    assert name_for(loc_in(code, 2)) == "x"


@pytest.mark.parametrize("change", ["none", "length", "time", "bytecode", "user's"])
def test_bytecode_that_python_keeps_stands_for_the_text_of_the_product(
    change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "kernel.py"
    path.write_text("def f(x):\n    y = x + 1\n    return y\n")
    bytecode = Path(str(py_compile.compile(str(path), doraise=True)))
    module: dict[str, object] = {}
    exec(compile(path.read_text(), str(path), "exec", dont_inherit=True), module)
    code = module["f"].__code__  # type: ignore[attr-defined]
    if change == "length":
        path.write_text(path.read_text() + "\n")
    elif change == "time":
        os.utime(path, (1, 1))
    elif change == "bytecode":
        bytecode.write_bytes(bytecode.read_bytes()[:40])
    if change != "user's":
        monkeypatch.setattr(texts, "_PRODUCT", (str(tmp_path),))
    compiled: list[int] = []
    own = texts.Text._compiled

    def counted(text: texts.Text, flags: int) -> texts.Codes:
        compiled.append(flags)
        return own(text, flags)

    monkeypatch.setattr(texts.Text, "_compiled", counted)
    text = text_of(code)
    assert text is not None
    assert text.line(2).strip() == "y = x + 1"
    assert bool(compiled) == (change != "none")
    assert name_for(loc_in(code, 2)) == "y"
    assert text_of(code.replace(co_consts=(None, 2))) is None
