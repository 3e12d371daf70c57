"""Zeros that compilers know too much about: they lose signs, and take 0 * inf for 0."""

import numpy as np
import pytest
from backends.running import covering, differs

import shpy as sh
from shpy.testing.conformance import edges


@sh.program
def chosen(m: sh.Attrib1f):
    return (
        sh.cond(m > 0, -0.0, m),
        sh.cond(m < 0, -0.0, m),
        sh.cond(m >= 0, m, -0.0),
        sh.cond(m <= 0, m, -0.0),
        sh.cond(0.0 < m, -0.0, m),
        sh.cond(m > -0.0, 0.0, m),
        sh.cond(m <= -0.0, m, 0.0),
        sh.cond(m == 0, -0.0, m),
        sh.cond(m < 0, m, 0.0),
        sh.cond(m > 0, m, -0.0),
    )


@sh.program
def least(m: sh.Attrib1f, z: sh.Attrib1f):
    signs = (0.0, -0.0)
    chosen = [f(*pair) for f in (sh.min, sh.max) for s in signs for pair in ((m, s), (s, m))]
    ranges = [sh.clamp(m, low, high) for low, high in ((-0.0, 1.0), (0.0, 1.0), (-1.0, -0.0), (-1.0, 0.0))]
    return (*chosen, *ranges, sh.min(m, z), sh.max(m, z), sh.step(-0.0, m), sh.sign(m), sh.abs(m))


@sh.program
def vectors(m: sh.Attrib3f):
    zeros = sh.Attrib3f(-0.0, 0.0, -0.0)
    return sh.min(m, zeros), sh.max(m, -0.0), sh.cond(m > 0, zeros, m), sh.clamp(m, zeros, 1.0)


@sh.program
def products(m: sh.Attrib1f, a: sh.Attrib1f, v: sh.Attrib3f):
    b, bs = m > 0, v > 0
    numbers = (
        sh.Attrib1f(b),
        sh.cond(b, 1.0, 0.0),
        sh.cond(b, 0.0, 1.0),
        sh.cond(b, -1.0, 0.0),
        sh.cond(b, 0.0, -1.0),
        sh.Attrib1f(b) * sh.Attrib1f(~b),
        1 - sh.Attrib1f(b),
        sh.step(0.0, m),
        sh.sign(m),
        sh.clamp(m, 0.0, 1.0),
        sh.Attrib1f(sh.Attrib1i(b)),
    )
    vectors = sh.Attrib3f(bs), sh.cond(bs, 1.0, 0.0), sh.cond(b, sh.Attrib3f(1, 0, -1), 0.0)
    return (*(n * a for n in numbers), *(w * v for w in vectors), sh.mad(sh.Attrib1f(b), a, m), a / sh.Attrib1f(b))


M = np.float32([0.0, -0.0, 1.0, -1.0, np.nan, 0.0, -0.0, *[0.0, -0.0] * 16])
Z = np.float32([0.0, 0.0, -0.0, np.nan, -0.0, -0.0, 0.0, *[-0.0, 0.0] * 16])


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_every_backend_chooses_the_same_zero(precision):
    programs = (chosen, (M,)), (least, (M, Z)), (vectors, (np.stack([M, Z, -M], axis=-1),))
    for turn, (program, given) in enumerate(programs, precision == "f64"):
        able = ["interpreter", *(name for name in covering(turn) if (name, precision) != ("glsl", "f64"))]
        sh.testing.assert_equivalent(program, *given, backends=able, precision=precision)


def test_a_product_with_nothing_is_not_always_nothing():
    m = np.float32([1, -1, 0, -0.0, np.nan] * 5)
    a = np.repeat(np.float32([np.inf, -np.inf, np.nan, -2, 0]), 5)
    given = m, a, np.stack([m, a, -m], axis=-1)
    sh.testing.assert_equivalent(products, *given, backends=["interpreter", "numpy", "opencl", "glsl"])


@sh.program
def counted(a: sh.Attrib1f) -> sh.Attrib1f:
    count = sh.Attrib1f(0)
    with sh.SH_FOR(0, 3):
        sh.SH_BREAK(sh.isnan(a - a))
        count += 1
        a += 1
    return count


def test_a_difference_with_itself_is_not_always_nothing():
    """Mesa once took -0 for 0 as the argument of a function in an unrolled loop."""
    a = np.float32([np.inf, 1, np.nan, -np.inf, 0.7, 3e38])
    sh.testing.assert_equivalent(counted, a, backends=["interpreter", "numpy", "opencl", "glsl"])
    assert "precise" not in counted.compile("glsl", math="fast").source.split("bool sh_isnan(")[1].split(")")[0]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["interpreter", "numpy", "opencl", "opencl-4", "glsl"])
@pytest.mark.parametrize("name", ["quotients_that_are_flushed_have_a_sign", "fma_keeps_the_sign_of_what_is_flushed"])
def test_what_is_flushed_changes_no_other_result(name, backend):
    """The conformance list excuses elements that meet a denormal; here none is excused."""
    case = next(c for c in edges.CASES if c.name == name)
    expected = case.expected if isinstance(case.expected, tuple) else (case.expected,)
    for found, wanted in zip(case.run(backend).outputs, expected, strict=True):
        assert not differs(found, wanted).any(), (found, wanted)
