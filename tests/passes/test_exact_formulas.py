"""The formulas in binary64 give the exact value rounded, with and without fused operations."""

import numpy as np
import pytest

from shpy.ir.types import Base, vec
from shpy.passes import exact
from shpy.passes.terms import define
from shpy.testing.conformance.exact import apply

UNARY = sorted(exact.FUNCTIONS.keys() - {"pow", "atan2"})
NUMPY = {"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "rsqrt": lambda x: 1 / np.sqrt(x),
         "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh}  # fmt: skip
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
