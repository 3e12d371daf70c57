"""Sine, cosine and tangent of every finite angle: within the bounds, and in strict mode the same bits everywhere.

The angles are random ones, powers of two and their neighbours, the largest, and for every exponent those that are
closest to a multiple of pi / 2: there nearly all leading digits of the reduced angle cancel. References are mpmath's,
in more bits than the largest angle has in front of the point.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from backends.running import covering

import shpy as sh
from shpy.backend.base import Array
from shpy.ir.ops import OPS
from shpy.ir.types import Base
from shpy.passes.formulas.coefficients import TWO_BY_PI_DIGITS
from shpy.passes.formulas.portable.payne_hanek import FAR

NAMES = ("sin", "cos", "tan")
DTYPES: dict[str, Any] = {"f32": np.float32, "f64": np.float64}
KNOWN = {"f32": 16367173 * 2.0**72, "f64": 6381956970095103 * 2.0**797}
"""The numbers of their width that are closest to a multiple of pi / 2."""
BITS = 1400


@functools.cache
def program(name: str) -> sh.Program:
    function: Callable[..., Any] = getattr(sh, name)

    def of_one(x: sh.Attrib1f) -> sh.Attrib1f:
        return function(x)

    return sh.program(of_one)


def close_to_multiples(precision: str) -> Iterator[float]:
    """For each exponent the mantissas m for which m * 2**e / (pi / 2) is nearly whole: denominators of convergents."""
    limits = np.finfo(DTYPES[precision])
    most = limits.nmant + 1
    for e in range(-limits.nmant, limits.maxexp - limits.nmant):
        left = mp.ldexp(2 / mp.pi, e)
        before, m = 0, 1
        while m < 2**most:
            if m >= 2 ** (most - 10):
                yield float(mp.ldexp(m * (2**most // m), e))
            left = 1 / (left - mp.floor(left))
            before, m = m, int(mp.floor(left)) * m + before


@functools.cache
def angles(precision: str) -> Array:
    """Angles of every exponent from 0 on, and of both signs."""
    dtype, rng = DTYPES[precision], np.random.default_rng(8)
    top = np.finfo(dtype).maxexp
    powers = 2.0 ** np.arange(20, top)
    with mp.workprec(BITS):
        close = np.array([x for x in close_to_multiples(precision) if x <= np.finfo(dtype).max])
    random = rng.uniform(1, 2, 1000) * 2.0 ** rng.integers(20, top - 1, 1000)
    near, far = close[close <= FAR], close[close > FAR]
    if len(far) > 1000:
        far = rng.choice(far, 1000, replace=False)
    found = np.concatenate([near, far, random, powers, [KNOWN[precision], np.finfo(dtype).max]]).astype(dtype)
    beside = [np.nextafter(powers.astype(dtype), dtype(end)) for end in (0, np.inf)]
    found = np.concatenate([found, *beside])
    return np.concatenate([found, -found])


@functools.cache
def exact(name: str, precision: str) -> list[Any]:
    with mp.workprec(BITS):
        return [getattr(mp, name)(mp.mpf(float(x))) for x in angles(precision)]


@functools.cache
def places(name: str, precision: str) -> list[int]:
    """The exponent of the last place of each exact result."""
    return [mp.frexp(wanted)[1] - 1 - np.finfo(DTYPES[precision]).nmant for wanted in exact(name, precision)]


def check_bound(found: Array, name: str, precision: str, bound: float) -> None:
    expected = zip(exact(name, precision), places(name, precision), strict=True)
    with mp.workprec(200):
        for given, result, (wanted, place) in zip(angles(precision), found.tolist(), expected, strict=True):
            off = float(mp.ldexp(abs(mp.mpf(result) - wanted), -place))
            assert off <= bound, f"{name} of {float(given).hex()} is {result.hex()}: {off} ULP off"


@pytest.mark.sampled(6)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_strict_keeps_its_bound_at_every_angle_with_the_same_bits(name: str, precision: Any) -> None:
    x = angles(precision)
    found = program(name).compile("numpy", precision=precision)(x)
    check_bound(found, name, precision, OPS[name].distance("strict") if precision == "f32" else OPS[name].double.ulp)
    for lanes in (1, {"sin": 4, "cos": 8, "tan": 16}[name]):
        packets = program(name).compile("opencl", precision=precision, lanes=lanes)(x)  # type: ignore[arg-type]
        assert packets.tobytes() == found.tobytes(), lanes
    if precision == "f32":
        assert program(name).compile("glsl")(x).tobytes() == found.tobytes()


@pytest.mark.sampled(20)
@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
@pytest.mark.parametrize("name", NAMES)
def test_relaxed_keeps_the_bound_of_opencl_at_every_angle(name: str, backend: str, precision: Any) -> None:
    if (backend, precision) == ("glsl", "f64"):
        with pytest.raises(sh.CompileError):
            program(name).compile(backend, precision=precision, math="relaxed")
        return
    found = program(name).compile(backend, precision=precision, math="relaxed")(angles(precision))
    check_bound(found, name, precision, OPS[name].bound("relaxed").ulp)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
@pytest.mark.parametrize("name", NAMES)
def test_what_is_no_angle_gives_nan_beside_near_and_far_ones(name: str, backend: str) -> None:
    x = np.float32([np.inf, 0.5, -np.inf, 1e30, np.nan, -0.0, 2.0**20, -3e38])
    found = program(name).compile(backend)(x)
    assert np.isnan(found[[0, 2, 4]]).all()
    kept = [1, 3, 5, 6, 7]
    np.testing.assert_allclose(found[kept], getattr(np, name)(x[kept].astype(np.float64)), rtol=2e-7)
    half = program(name).compile(backend, precision="f16")(np.float16([np.inf, 65504, -np.inf]))
    assert np.isnan(half).tolist() == [True, False, True]


def in_a_program(v: sh.Attrib3f, turn: sh.Attrib1f) -> sh.Attrib3f:
    with sh.SH_IF(v.x > 0):
        v.yz = sh.sin(v.yz) + sh.tan(turn)
    with sh.SH_ELSE():
        v[:] = sh.cos(v)
    return v


def test_components_and_branches_are_reduced_each_by_itself() -> None:
    rng = np.random.default_rng(4)
    v = np.where(rng.random((500, 3)) < 0.1, 10.0 ** rng.uniform(6, 38, (500, 3)), 10.0 ** rng.uniform(-3, 6, (500, 3)))
    v = (v * rng.choice([-1, 1], v.shape)).astype(np.float32)
    turn = np.float32(7e20)  # the same for all lanes
    tested = sh.program(in_a_program)
    sh.testing.assert_equivalent(tested, v, turn, backends=covering(0))
    angles = tested.compile("opencl", lanes=1)(v, turn)
    wide = v.astype(np.float64)
    left = np.column_stack([v[:, 0], np.sin(wide[:, 1:]) + np.tan(np.float64(turn))])
    np.testing.assert_allclose(angles, np.where(v[:, :1] > 0, left, np.cos(wide)), rtol=1e-5, atol=1e-6)


def test_columns_of_digits_are_exact() -> None:
    for base, radix, most in ((Base.F, 2.0**12, 2.0**24), (Base.D, 2.0**26, 2.0**53)):
        sizes = np.abs(TWO_BY_PI_DIGITS[base])
        assert sizes.max() <= radix / 2
        # The first digit of an angle is at most the radix, the others and the carry at most half of it.
        columns = radix * sizes[2:] + radix / 2 * (sizes[1:-1] + sizes[:-2]) + radix / 2
        assert columns.max() <= most
