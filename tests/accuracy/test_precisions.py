"""Every operation and every function of the library at every precision, against their exact values.

A comparison of backends cannot find an error that all of them make, so what numpy computes is compared with mpmath's
numbers of 240 bits (binary64 where those have no such number), over random and special inputs. The bounds are those of
docs/numerics.md. That the other backends give numpy's bits is tested elsewhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from test_reference import FLOATS, exact, one_operation

import shpy as sh
from shpy.accuracy.domain import special_values
from shpy.ir.ops import OPS, TRANSCENDENTALS
from shpy.units import ulps

PRECISIONS = {"f16": np.float16, "f32": np.float32, "f64": np.float64}
MODES = ("strict", "portable", "relaxed")
RANGES: dict[str, tuple[float, float]] = {
    "exp": (-9, 9), "exp2": (-12, 12), "sinh": (-9, 9), "cosh": (-9, 9), "pow": (0.01, 5), "acosh": (1, 50),
    "atanh": (-1, 1), "asin": (-1, 1), "acos": (-1, 1), "log": (0, 50), "log2": (0, 50), "log10": (0, 50),
    "rsqrt": (0, 50), "sqrt": (0, 50),
}  # fmt: skip
"""The domains of random inputs; special ones are anywhere."""
TERMS = 64
"""The most roundings of a composite operation, each of which is small beside the largest of its terms."""


def bound(name: str, precision: str, math: str) -> float:
    """Return how many units in the last place docs/numerics.md allows."""
    row = OPS[name]
    if name not in TRANSCENDENTALS:
        return 0.5 + 2.0**-20
    if precision == "f16":
        return 0.5001 if math == "strict" else 0.51
    if precision == "f64":
        return row.double.ulp if math != "relaxed" else max(row.double.ulp, row.relaxed.ulp)
    return row.distance(math)


def inputs_of(program: sh.Program, name: str, precision: str, count: int, special: bool) -> list[Any]:
    """Draw random numbers and, beside random ones, each special one."""
    rng, given = np.random.default_rng(len(name) + count), []
    low, high = RANGES.get(name, (-4, 4))
    types = [cls.type for cls in program.inputs.values()]
    places = np.cumsum([0, *(len(special_values(t, precision)) for t in types)]) if special else [0] * (len(types) + 1)
    for n, type_ in enumerate(types):
        shape = (count + places[-1], type_.size)
        if type_.is_float:
            drawn = rng.uniform(low, high, shape).astype(PRECISIONS[precision])
        else:
            drawn = rng.integers(0, 2, shape) != 0 if type_.is_bool else rng.integers(-5, 5, shape).astype(np.int32)
        if special:
            drawn[count + places[n] : count + places[n + 1]] = special_values(type_, precision)[:, None]
        given.append(drawn if type_.size > 1 else drawn[:, 0])
    return given


def check(name: str, precision: str, modes: tuple[str, ...], count: int) -> int:
    """Compare an operation in each mode; return the number of results."""
    program, _ = one_operation(name)
    composite = OPS[name].definition is not None
    with np.errstate(all="ignore"):
        given = inputs_of(program, name, precision, count, special=not composite)
    right = exact(program, *given, precision=precision).outputs[0]
    compared = 0
    for math in modes:
        found = np.asarray(program.compile("numpy", precision=precision, math=math)(*given)).reshape(right.high.shape)
        if found.dtype.kind != "f":
            assert np.array_equal(found, right.high), (name, precision, math)
        elif composite:
            away = np.abs(found.astype(np.float64) - right.high - right.low)
            info = np.finfo(found.dtype)
            once = np.finfo(np.float32).eps if precision == "f16" and name != "mad" else info.eps
            largest = 64.0 if name not in ("mod", "normalize") else 8.0
            unit = np.spacing(np.maximum(np.abs(right.high), float(info.tiny)).astype(found.dtype)).astype(np.float64)
            over = away > 0.5 * unit + TERMS * once * largest
            assert not over.any(), (name, precision, math, [g[over.any(axis=1)][:3] for g in given])
        else:
            away = ulps(found, right.high, rest=right.low)
            over = (away > bound(name, precision, math)).any(axis=1)
            assert not over.any(), (name, precision, math, away.max(), [g[over][:3] for g in given])
        compared += found.size
    return compared


WHOLE = [name for name in FLOATS if name not in ("float_from_bits",)]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("precision", PRECISIONS)
def test_operations_keep_their_bounds(precision: str) -> None:
    for name in WHOLE:
        check(name, precision, ("strict",) if precision == "f64" else MODES, 8)


@pytest.mark.slow
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", WHOLE)
def test_operations_keep_their_bounds_at_length(name: str, precision: str) -> None:
    check(name, precision, MODES, 4000)


# The library

L = sh.library
LIBRARY: dict[str, Any] = {
    "noise1": lambda p: sh.noise(p.x),
    "noise2": lambda p: sh.noise(p.xy),
    "noise3": lambda p: sh.noise(p),
    "fbm": lambda p: L.fbm(p.xy, 3),
    "turbulence": lambda p: L.turbulence(p, 3),
    "cellnoise": lambda p: L.cellnoise(p, 3),
    "worley": lambda p: L.worley(p.xy, count=2),
    "worley1": lambda p: L.worley(p.x, "manhattan"),
    "worley3": lambda p: L.worley(p, "chebyshev"),
    "unit_float": lambda p: sh.unit_float(sh.hash(sh.Attrib1i(p.x * 4), sh.Attrib1i(p.y * 4))),
    "lerp": lambda p: L.lerp(p.x, p.y, p.z),
    "srgb_from_linear": lambda p: L.srgb_from_linear(sh.abs(p) * 0.1),
    "linear_from_srgb": lambda p: L.linear_from_srgb(sh.abs(p) * 0.1),
    "luminance": lambda p: L.luminance(sh.abs(p) * 0.1),
    "hsl": lambda p: L.rgb_from_hsl(L.hsl_from_rgb(sh.abs(p) * 0.1)),
    "xyz back": lambda p: L.linear_from_xyz(L.xyz_from_lab(L.lab_from_xyz(sh.abs(p) * 0.1 + 0.01))),
    "hsv": lambda p: L.rgb_from_hsv(L.hsv_from_rgb(sh.abs(p) * 0.1)),
    "xyz": lambda p: L.xyz_from_linear(sh.abs(p) * 0.1),
    "lab": lambda p: L.lab_from_xyz(sh.abs(p) * 0.1 + 0.01),
    "outer": lambda p: L.outer(p, p) @ p,
    "rotate": lambda p: L.rotate((0, 0, 1), p.x) @ sh.Vector3f(p),
    "translate": lambda p: L.translate(p) @ sh.Point3f(p),
    "scale": lambda p: L.scale(p) @ sh.Point3f(p),
    "inverse": lambda p: sh.inverse(sh.Matrix2f((4 + p.x * 0.1, p.y), (-p.y, 4 + p.z * 0.1))) @ p.xy,
    "determinant": lambda p: sh.determinant(sh.Matrix3f(p, (1, 0, 2), (0, 1, 3))),
    "radians": lambda p: sh.radians(p),
    "degrees": lambda p: sh.degrees(p * 0.1),
    "saturate": lambda p: sh.saturate(p),
}
UNIT = ("cellnoise", "unit_float")
"""Functions whose results are in [0, 1)."""


def check_library(name: str, precision: str, count: int, modes: tuple[str, ...]) -> None:
    """Compare a function of the library with the same program without rounding."""
    function = LIBRARY[name]

    def picture(p: sh.Point3f) -> Any:
        return function(p)

    program = sh.program(picture)
    given = np.random.default_rng(3).uniform(-4, 4, (count, 3)).astype(PRECISIONS[precision])
    right = exact(program, given, precision=precision).outputs[0]
    eps = float(np.finfo(PRECISIONS[precision]).eps)
    for math in modes:
        found = np.asarray(program.compile("numpy", precision=precision, math=math)(given)).reshape(right.high.shape)
        assert np.isfinite(found).all(), (name, precision, math)
        if name in UNIT:
            assert found.min() >= 0
            assert found.max() < 1
        away = np.abs(found.astype(np.float64) - right.high - right.low)
        scale = TERMS * max(1.0, float(np.abs(right.high).max()))
        assert away.max() <= scale * eps, (name, precision, math, away.max(), given[away.max(axis=1).argmax()])


@pytest.mark.sampled(3)
@pytest.mark.parametrize("precision", PRECISIONS)
def test_functions_of_the_library_keep_their_contracts(precision: str) -> None:
    for name in LIBRARY:
        check_library(name, precision, 4, ("strict",))


@pytest.mark.slow
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", LIBRARY)
def test_functions_of_the_library_keep_their_contracts_at_length(name: str, precision: str) -> None:
    check_library(name, precision, 400, MODES)


def test_every_function_of_the_library_is_here() -> None:
    pictures = {"Mipmap", "Texture3D", "TextureCube", "cubemap"}  # compared with arrays in tests/library
    cameras = {"look_at", "perspective"}
    same = {"hypot", "log10", "isfinite"}  # operations
    known = {
        *LIBRARY,
        *pictures,
        *cameras,
        *same,
        "hsv_from_rgb",
        "rgb_from_hsv",
        "hsl_from_rgb",
        "rgb_from_hsl",
        "xyz_from_linear",
        "linear_from_xyz",
        "lab_from_xyz",
        "xyz_from_lab",
    }
    assert set(L.__all__) <= known
