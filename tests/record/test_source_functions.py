"""Functions of the language whose results get two names, and the names that values and `shpy` suggest."""

from __future__ import annotations

import numpy as np
import pytest
from source_text import blame, check

import shpy as sh


@pytest.mark.parametrize("written", ["sh.abs", "sh.hash", "sh.library.fbm", "helper"])
def test_an_alias_of_its_result_is_found(written):
    text = f"""
        def helper(x):
            return x * 2

        def f(x: sh.Attrib{"1u" if "hash" in written else "1f"}):
            y = {written}(x)
            z = y
            z += 1
            return y
        """
    assert blame(text).startswith("6: `z = y` gives one value two names: `z += 1` (line 7) changes both")


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
    for name in ("log10", "dFdx", "hash"):
        with pytest.raises(AttributeError) as caught:
            getattr(sh.Attrib1f(2), name)
        assert caught.value.cure == f"sh.{name}(v)"


@pytest.mark.parametrize("name", sorted(set(sh.library.__all__) - set(sh.__all__) - {"lerp", "outer"}))
def test_a_name_of_the_library_that_is_looked_for_in_shpy_is_found(name):
    with pytest.raises(AttributeError) as caught:
        getattr(sh, name)
    assert caught.value.cure == f"sh.library.{name}"
