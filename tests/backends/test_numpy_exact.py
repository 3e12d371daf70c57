"""Strict functions of numpy: those of its own binary64, where this version of numpy is close enough."""

from __future__ import annotations

import numpy as np
import pytest

import shpy as sh
from shpy.ir import exact
from shpy.testing.arrays import differing


def decay(x: sh.Attrib1f):
    return sh.exp(-x)


def test_text_calls_the_function_that_rounds():
    source = sh.program(decay).compile("numpy").source
    assert "from shpy.ir import exact\n" in source
    assert "    return exact.exp(-x)" in source


def test_other_modes_and_precisions_have_other_functions():
    assert "np.exp(" in sh.program(decay).compile("numpy", math="relaxed").source
    for options in ({"math": "portable"}, {"precision": "f64"}):
        assert "import exact" not in sh.program(decay).compile("numpy", **options).source


def test_a_name_of_the_user_gives_way():
    @sh.program
    def named(exact: sh.Attrib1f):
        return sh.log(exact) + exact

    kernel = named.compile("numpy")
    assert "exact.log(exact_2)" in kernel.source
    assert kernel(np.float32([1])).tolist() == [1]


def test_a_function_that_numpy_gets_wrong_is_a_formula_and_the_notes_say_so(monkeypatch):
    x, answers = exact.hard_cases("exp")

    @sh.program
    def distrusting(x: sh.Attrib1f):
        return sh.exp(x)

    monkeypatch.setattr(exact, "trusted", lambda name: False)
    kernel = distrusting.compile("numpy")
    assert "exp_strict(" in kernel.source
    wrong = f"numpy {np.__version__} gets exp of binary64 wrong: strict mode has formulas in their place"
    assert kernel.notes == (wrong,)
    assert not differing(kernel(x), answers).any()


def test_vectors_uniforms_and_blocks_of_a_grid_are_taken():
    rate = sh.Param(sh.Attrib1f, 0.5, name="rate")

    @sh.program
    def waves(x: sh.Attrib3f):
        i = sh.grid_index(2)
        return sh.tanh(x) + sh.exp(rate), sh.atan(sh.Attrib1f(i[0]) - 1), sh.log(sh.Attrib1f(i[1]))

    x = np.linspace(-2, 2, 18, dtype=np.float32).reshape(2, 3, 3)
    with np.errstate(all="ignore"):
        wanted = exact.tanh(x) + exact.exp(np.float32(0.5))
        logarithms = exact.log(np.float32([[0, 1, 2]] * 2))
    vectors, angles, logs = waves.compile("numpy")(x)
    assert not differing(vectors, wanted).any()
    assert not differing(angles, exact.atan(np.float32([[-1] * 3, [0] * 3]))).any()
    assert not differing(logs, logarithms).any()


@pytest.mark.parametrize("name", ["log", "acos", "atanh"])
def test_nan_and_infinity_among_hard_inputs(name):
    x, answers = exact.hard_cases(name)
    mixed = np.stack([x, np.full_like(x, np.nan), np.full_like(x, -np.inf)], axis=1)

    @sh.program
    def of(x: sh.Attrib3f):
        return getattr(sh, name)(x)

    found = of.compile("numpy")(mixed)
    assert not differing(found[:, 0], answers).any()
    assert np.isnan(found[:, 1:]).all()
