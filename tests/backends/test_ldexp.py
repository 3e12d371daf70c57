"""`ldexp` and what is made of it round once, also to denormals: every lane width, at f32, f64 and f16."""

from __future__ import annotations

import numpy as np
import pytest

import shpy as sh
from shpy.ir import meaning
from shpy.ir.types import vec
from shpy.testing.conformance.operations import beside_ties

LANES = (1, 4, 8, 16)


@sh.program
def scaled(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    return sh.ldexp(x, n)


@sh.program
def scaled_in_f64(x: sh.Attrib1d, n: sh.Attrib1i) -> sh.Attrib1d:
    return sh.ldexp(x, n)


PROGRAMS = {"f": (scaled, "f32"), "d": (scaled_in_f64, "f32"), "h": (scaled, "f16")}
BITS = {"f": np.uint32, "d": np.uint64, "h": np.uint16}


def given(base: str):
    """Random bits by random exponents, ends of the range of ints, and what is nearly a tie among denormals."""
    rng = np.random.default_rng(5)
    x, n = beside_ties(vec(base), rng, 20_000)
    bits = rng.integers(0, np.iinfo(BITS[base]).max, 20_000, BITS[base], endpoint=True).view(x.dtype)
    most = {"h": 40, "f": 310, "d": 2200}[base]
    by = rng.integers(-most, most, bits.size).astype(np.int32)
    by[::50] = rng.choice([2**31 - 1, -(2**31), 0, 127, 128, -126, -127, 1023, -1023, 3069, -3067], by[::50].size)
    return np.concatenate([x, bits]), np.concatenate([n, by])


@pytest.mark.sampled(12)
@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("base", "fdh")
def test_ldexp_rounds_once(base, lanes):
    program, precision = PROGRAMS[base]
    x, n = given(base)
    with np.errstate(all="ignore"):
        wanted = meaning.ldexp(x, n)
    for math in ("strict", "relaxed"):
        found = program.compile("opencl", lanes=lanes, precision=precision, math=math)(x, n)
        same = (found.view(BITS[base]) == wanted.view(BITS[base])) | (np.isnan(found) & np.isnan(wanted))
        assert same.all(), (x[~same][0], n[~same][0], found[~same][0], wanted[~same][0])
    assert (np.abs(wanted) < np.finfo(x.dtype).tiny).sum() > 10_000


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("name", "ranges"), [("exp", [(-746, -707)]), ("exp2", [(-1076, -1021)]), ("pow", [(0.5, 0.6), (800, 1300)])]
)
def test_strict_functions_of_f64_round_denormals_once(name, ranges):
    function = getattr(sh, name)

    @sh.program
    def of_two(x: sh.Attrib1d, y: sh.Attrib1d) -> sh.Attrib1d:
        return function(x, y) if name == "pow" else function(x)

    rng = np.random.default_rng(6)
    x, y = (rng.uniform(*r, 20_000) for r in (ranges * 2)[:2])
    wanted = of_two.compile("numpy")(x, y)
    for lanes in (1, 8):
        np.testing.assert_array_equal(of_two.compile("opencl", lanes=lanes)(x, y), wanted)
