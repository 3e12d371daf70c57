"""The source check knows every public function of the language: none is kept in a list that can forget it."""

from __future__ import annotations

import builtins
import inspect

import numpy as np
import pytest
from source_text import blame, check

import shpy as sh
from shpy.lang.mistakes.kinds import functions, gives_value

LANGUAGE = ("shpy.lang.", "shpy.library.")
OTHERS = {"cubemap", "struct", "subroutine", "swap"}
"""Functions of the language and its library that do not give one value."""

MODULES = {"sh": sh, "sh.library": sh.library}
PUBLIC = [
    (f"{prefix}.{name}", thing)
    for prefix, module in MODULES.items()
    for name, thing in vars(module).items()
    if inspect.isfunction(thing) and (name in module.__all__ or hasattr(builtins, name)) and not name.startswith("SH_")
]
VALUES = [
    (written, function)
    for written, function in PUBLIC
    if function.__module__.startswith(LANGUAGE) and function.__name__ not in OTHERS
]


def test_the_list_of_the_test_is_whole():
    """A function gives one value if and only if it is of the language or its library, and not among OTHERS."""
    assert len(VALUES) > 95
    assert {name for name, _ in PUBLIC} >= {"sh.abs", "sh.log10", "sh.hash", "sh.dFdx", "sh.inverse", "sh.library.fbm"}
    assert [written for written, f in PUBLIC if gives_value(f)] == [written for written, _ in VALUES]
    assert {f.__name__ for _, f in PUBLIC} >= OTHERS


@pytest.mark.parametrize("written", [written for written, _ in VALUES])
def test_an_alias_of_its_result_is_found(written):
    text = f"""
        def f(x: sh.Attrib1f):
            y = {written}(x)
            z = y
            z += 1
            return y
        """
    assert blame(text).startswith("3: `z = y` gives one value two names: `z += 1` (line 4) changes both")


def test_an_alias_of_what_a_texture_gives_is_found():
    image = np.zeros((4, 4, 3))
    sky, levels = sh.Texture2D(image), sh.library.Mipmap(image)
    for written in ("sky(uv)", "levels(uv, 1)", "levels.level(uv, uv)"):
        text = f"""
            def f(uv: sh.TexCoord2f):
                y = {written}
                z = y
                z += 1
                return y
            """
        assert "`z = y` gives one value two names" in blame(text, sky=sky, levels=levels)


def test_functions_that_give_several_values_or_none_are_innocent():
    check(
        """
        def f(x: sh.Vector3f):
            both = sh.library.cubemap(x)
            same = both
            face, uv = same
            face += 1
            return face, both[1]
        """
    )


def test_a_value_names_every_function():
    assert {"log10", "dFdx", "hash"} <= set(functions())
    with pytest.raises(AttributeError) as caught:
        sh.Attrib1f(2).log10  # noqa: B018
    assert caught.value.cure == "sh.log10(v)"


@pytest.mark.parametrize("name", sorted(set(sh.library.__all__) - set(sh.__all__) - {"lerp", "outer"}))
def test_a_name_of_the_library_that_is_looked_for_in_shpy_is_found(name):
    with pytest.raises(AttributeError) as caught:
        getattr(sh, name)
    assert caught.value.cure == f"sh.library.{name}"
