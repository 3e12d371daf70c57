"""The formulas in binary64 give the exact value rounded, with and without fused operations."""

import re
from pathlib import Path

import numpy as np
import pytest

from shpy.ir.exact import EVEN, ODD, hard_cases, hypot
from shpy.ir.ops import OPS
from shpy.ir.types import Base, vec
from shpy.passes.formulas import strict as exact
from shpy.passes.formulas.terms import define
from shpy.testing.conformance.exact import apply

UNARY = sorted(name for name in exact.FUNCTIONS if len(OPS[name].takes) == 1)
NUMPY = {"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "rsqrt": lambda x: 1 / np.sqrt(x),
         "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh,
         **{n: OPS[n].meaning for n in ("exp10", "erf", "erfc", "sinpi", "cospi")}}  # fmt: skip
SPECIAL = np.float32([0.0, -0.0, np.inf, -np.inf, np.nan, 1.0, -1.0, 1e-45, -1e-45, 1e-38, 3.4e38, -3.4e38])


def inputs() -> np.ndarray:
    """Return numbers of every size, many near 1, and the special ones."""
    rng = np.random.default_rng(5)
    bits = rng.integers(0, 1 << 32, 20_000, dtype=np.uint32)
    return np.concatenate([bits.view(np.float32), rng.uniform(-8, 8, 20_000).astype(np.float32), SPECIAL])


@pytest.mark.parametrize("fused", [False, True])
@pytest.mark.parametrize("name", UNARY)
def test_every_result_is_the_exact_value_rounded(name, fused):
    """numpy's binary64 function decides wherever it is far enough from the middle between two numbers."""
    x = inputs()[:: 20 if fused else 1]
    made = apply(define(name, exact.rounded(name), (vec(Base.F),), fused=fused), x)
    with np.errstate(all="ignore"):
        near = NUMPY.get(name, getattr(np, name, None))(x.astype(np.float64))
        below, above = ((near * (1 + e)).astype(np.float32) for e in (-(2.0**-46), 2.0**-46))
    decided = (below == above) | np.isnan(near)
    assert decided.mean() > 0.999
    wrong = decided & ~((made == below) & (np.signbit(made) == np.signbit(below)) | np.isnan(made) & np.isnan(near))
    assert not wrong.any(), (x[wrong][:5], made[wrong][:5], near[wrong][:5])


def pairs(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of numbers, among them powers that are midpoints between two binary32, and denormal quotients."""
    rng = np.random.default_rng(11)
    x, y = np.exp(rng.uniform(-9, 9, (2, 10_000))).astype(np.float32)
    if name == "pow":
        whole = rng.integers(2049, 4096, 5_000).astype(np.float32)
        near = (1 + rng.normal(size=5_000) * 2.0**-12).astype(np.float32)
        return np.concatenate([x, whole, whole, near]), np.concatenate(
            [np.log(y), whole * 0 + 2, whole * 0 + 3, near * 9999]
        )
    small = rng.integers(1, 4096, 5_000) * np.float32(2.0**-149)
    signs = rng.choice([-1, 1], (2, 15_000)).astype(np.float32)
    return signs[0] * np.concatenate([x, small]), signs[1] * np.concatenate([y, y[:5_000]])


@pytest.mark.parametrize("fused", [False, True])
@pytest.mark.parametrize("name", ["pow", "atan2"])
def test_functions_of_two_are_the_exact_value_rounded(name, fused):
    a, b = (v[:: 10 if fused else 1].astype(np.float32) for v in pairs(name))
    made = apply(define(name, exact.rounded(name), (vec(Base.F),) * 2, fused=fused), a, b)
    near = {"pow": np.power, "atan2": np.arctan2}[name](a.astype(np.float64), b.astype(np.float64))
    below, above = ((near * (1 + e)).astype(np.float32) for e in (-(2.0**-50), 2.0**-50))
    decided = below == above
    assert (made[decided] == below[decided]).all()
    assert ((made == below) | (made == above)).all()
    # Powers that binary64 holds exactly are rounded half to even.
    held = (name == "pow") & np.isin(b, [2, 3])
    assert held.sum() == (name == "pow") * len(a) * 2 // 5
    assert (made[held] == near[held].astype(np.float32)).all()


HYPOTENUSES = [
    (14784729, 7946000, 16784728),  # that of 16784729, an odd number of 25 bits, is the middle itself
    (14784729 * 2.0**-140, 7946000 * 2.0**-140, 16784728 * 2.0**-140),
    (12525682, 3539.1640625, 12525683),  # a little beyond the middle, by less than binary64 can tell
    (8481962, 2912.380859375, 8481963),
    (8408513, 2899.74365234375, 8408513),  # a little below it
    (14430761, 3798.7841796875, 14430761),
    (3.4028235e38, 2.0**115, 3.4028235e38),
    (3.4028235e38, 1.7e35, np.inf),
]


@pytest.mark.parametrize("fused", [False, True])
def test_a_hypotenuse_next_to_the_middle_is_rounded_to_its_own_side(fused):
    x, y, wanted = np.float32(HYPOTENUSES).T
    formula = define("hypot", exact.rounded("hypot"), (vec(Base.F),) * 2, fused=fused)
    for a, b in ((x, y), (-y, x)):
        np.testing.assert_array_equal(apply(formula, a, b), wanted)
        with np.errstate(over="ignore"):
            np.testing.assert_array_equal(hypot(a, b), wanted)
    with np.errstate(over="ignore"):
        rounded_twice = np.sqrt(np.float64(x) ** 2 + np.float64(y) ** 2).astype(np.float32)
    assert (rounded_twice != wanted).sum() == 4


@pytest.mark.parametrize("fused", [False, True])
def test_hypotenuses_of_random_sides_are_the_exact_value_rounded(fused):
    # The lengths differ by up to 2**14, and the squares are often beyond binary32.
    rng = np.random.default_rng(12)
    x = rng.uniform(1, 2, 20_000) * 2.0 ** rng.integers(-126, 127, 20_000)
    y = (np.minimum(x * 2.0 ** rng.uniform(-14, 14, 20_000), 3e38)).astype(np.float32)
    x = x.astype(np.float32)
    made = apply(define("hypot", exact.rounded("hypot"), (vec(Base.F),) * 2, fused=fused), x, y)
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(made, np.hypot(x.astype(np.longdouble), y.astype(np.longdouble)).astype("f"))


def test_a_quotient_between_two_denormal_numbers_is_rounded_down():
    """The arc tangent of 1.5 units is a little less than 1.5 units, which binary64 cannot tell."""
    tiny = np.float32(2.0**-149)
    found = apply(
        define("atan2", exact.rounded("atan2"), (vec(Base.F),) * 2),
        tiny * np.float32([1, 3, 5, 7]),
        np.float32([2] * 4),
    )
    assert (found == tiny * np.float32([0, 1, 2, 3])).all()


def test_the_page_has_the_numbers_of_hard_cases_and_exceptions() -> None:
    text = (Path(__file__).parents[2] / "docs" / "numerics.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \| ([\d,]+) \| (\d+) \| 0 \|$", text, re.M)
    told = {name: (cases, wrong) for name, cases, wrong in rows}
    assert told.keys() == set(UNARY)
    for name, (cases, wrong) in told.items():
        listed = len(exact.EXCEPTIONS.get(name, ())) * (1 + (name in ODD | EVEN))
        assert (cases, wrong) == (f"{len(hard_cases(name)[0]):,}", str(listed)), name
