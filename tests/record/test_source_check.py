"""The source check: the forms that it reads, and those about which it stays silent."""

from __future__ import annotations

import functools
import importlib
import linecache
import types
import zipfile
from typing import Any

import pytest
from source_text import check, made, sh

from shpy.errors import RecordError, ShpyWarning
from shpy.lang.programs import control


def test_an_attribute_of_a_python_object() -> None:
    class Walk:
        scale = 1

    walk = Walk()
    text = """
        class Walk:
            def step(self, x: sh.Attrib1f):
                with SH_IF(x > 0):
                    self.scale = x * 2
                return x * self.scale

            def count(self, x: sh.Attrib1f):
                with SH_DO():
                    self.scale += 1
                    SH_UNTIL(x > self.scale)
                return x

            def nested(self, x: sh.Attrib1f):
                return self.step(x)

            def __call__(self, x):
                with SH_IF(x > 1):
                    x = 1
                return x

        walker = Walk()

        def calls(x: sh.Attrib1f):
            return walker(x)

        def last(): ...
        """
    methods = made(text).__globals__["Walk"]
    with pytest.raises(RecordError) as caught:
        sh.program(types.MethodType(methods.step, walk))
    assert caught.value.message == (
        "`self.scale` is rebound inside `with SH_IF(…)` and used after it (line 5): Python rebinds the name once, "
        "while recording, whatever happens at run time"
    )
    assert caught.value.cure == "`scale = sh.Attrib1f(self.scale)` before the block, `scale[:] = x * 2` inside it"
    with pytest.raises(RecordError) as caught:
        sh.program(types.MethodType(methods.count, Walk()))
    assert caught.value.loc is not None
    assert caught.value.loc.line == 9
    assert caught.value.cure == "`scale = sh.Attrib1i(self.scale)` before the block, `scale += 1` inside it"
    with pytest.raises(RecordError, match="`x` is rebound"):
        sh.program(methods.step.__globals__["calls"])
    with pytest.raises(RecordError) as caught:
        sh.program(methods().nested)
    assert caught.value.loc is not None
    assert caught.value.loc.line == 4


def test_what_is_looked_through() -> None:
    text = """
        def f(n: sh.Attrib1f, x: sh.Attrib1f):
            with SH_IF(x > 1):
                x = x - 1
            return x
        """
    plain = made(text)

    @functools.wraps(plain)
    def wrapper(*args: Any, **named: Any) -> Any:
        return plain(*args, **named)

    class Callable:
        __call__ = plain

    for function in (plain, functools.partial(plain, 3), types.MethodType(plain, 3), wrapper, Callable()):
        with pytest.raises(RecordError, match="`x` is rebound"):
            sh.program(function)


def test_what_a_partial_fixes_is_known() -> None:
    text = """
        def f(n: sh.Attrib1f, x: sh.Attrib1f, *, k: sh.Attrib1f):
            with SH_IF(x > n):
                n += 1
                k += 1
            return x * n * k
        """
    plain = made(text)
    sh.program(plain)  # n and k are values, which += changes in place
    with pytest.raises(RecordError, match="`n` is rebound"):
        sh.program(functools.partial(plain, 3))
    with pytest.raises(RecordError, match="`k` is rebound"):
        sh.program(functools.partial(plain, k=3))


ARCHIVED = """import shpy as sh
first = sh.Param(sh.Attrib1f, 1)
second = sh.Param(sh.Attrib1f, 2)
@sh.program
def sum_of_both(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * first + second
"""
HELPER = """def aliased(x: sh.Attrib1f):
    y = x
    y += 1
    return x * y
"""


def test_modules_in_an_archive_have_their_text(tmp_path, monkeypatch) -> None:
    """Text gives Params their names, and shows mistakes: here in a module of which nothing has run yet."""
    with zipfile.ZipFile(tmp_path / "modules.zip", "w") as archive:
        archive.writestr("archived_program.py", ARCHIVED)
        archive.writestr("archived_helper.py", "import shpy as sh\n" + HELPER)
    monkeypatch.syspath_prepend(str(tmp_path / "modules.zip"))
    program = importlib.import_module("archived_program").sum_of_both
    assert list(program.params) == ["first", "second"]
    helper = importlib.import_module("archived_helper").aliased
    with pytest.raises(RecordError, match=r"archived_helper\.py:3: `y = x` gives one value two names") as raised:
        sh.program(helper)
    assert raised.value.cure == "y = x.copy()"


def test_code_that_was_compiled_in_a_module_is_not_read_from_the_file_of_the_module(monkeypatch, tmp_path) -> None:
    (tmp_path / "module_of_exec.py").write_text("import shpy as sh\n" + HELPER)
    monkeypatch.syspath_prepend(str(tmp_path))
    module = importlib.import_module("module_of_exec")
    exec(compile("\n" + HELPER, "some cell", "exec"), vars(module))
    sh.program(module.aliased)


def test_text_that_has_changed_since_is_not_trusted() -> None:
    function = made("def f(x: sh.Attrib1f):\n    with SH_IF(x > 1):\n        x = x - 1\n    return x\n")
    file = function.__code__.co_filename
    text = "def f(x, y):\n    with SH_IF(x > 1):\n        x = x - 1\n    return x\n"
    for lines in (text.splitlines(keepends=True), ["def f(:\n"]):
        linecache.cache[file] = (len(text), None, lines, file)
        with (
            pytest.warns(ShpyWarning, match="another f than the file's text has there"),
            pytest.raises(RecordError, match="`x` is rebound") as raised,
        ):
            sh.program(function)
        assert raised.value.cure == "x[:] = …"


def test_blocks_are_known_under_any_name() -> None:
    text = "def f(x: sh.Attrib1f):\n    pass\n    {}\n        x = x - 1\n    return x\n"
    with pytest.raises(RecordError, match=r"`x` is rebound inside `with when\(…\)`"):
        check(text.format("with when(x > 1):"), when=control.SH_IF)
    with pytest.raises(RecordError, match="`x` is rebound"):
        check(text.format("with sh.SH_IF(x > 1):"))
    with pytest.raises(RecordError, match="`x` is rebound"):
        check(text.format("with open('/dev/null') as file, sh.SH_IF(x > 1):"))
    check(text.format("with open('/dev/null') as file:"))


@pytest.mark.parametrize(
    "body", ["y = x\n    y += 1\n    return x", "with SH_IF(x > 0):\n        return x\n    return x"]
)
def test_a_mistake_is_found_each_time_that_the_function_is_recorded(body: str) -> None:
    function = made(f"def f(x: sh.Attrib1f):\n    {body}\n")
    for _ in range(2):
        with pytest.raises(RecordError, match=r"gives one value two names|Python's `return` inside"):
            sh.program(function)


def test_a_mistake_beside_a_deep_expression_is_told() -> None:
    """Expressions may nest deeper than the functions of Python, which call each other a thousand times at most."""
    body = f"y = sh.Attrib1f(0)\n    with SH_IF(x > 0):\n        y = {'-' * 1500}x\n    return y"
    with pytest.raises(RecordError, match="`y` is rebound inside"):
        sh.program(made(f"def f(x: sh.Attrib1f):\n    {body}\n"))
