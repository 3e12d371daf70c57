"""Strict functions without binary64: the exact values rounded, by sums of two binary32."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from shpy.ir.exact import EVEN, FUNCTIONS, ODD, hard_cases
from shpy.ir.types import vec
from shpy.passes import pairs
from shpy.passes.terms import define
from shpy.testing.conformance.exact import apply

MEANINGS: dict[str, Any] = {**FUNCTIONS, "rsqrt": lambda x: (1 / np.sqrt(x.astype(np.longdouble))).astype(np.float32)}

EDGES = np.array([
    0, -0.0, np.inf, -np.inf, np.nan, 1e-45, -1e-45, 1e-40, 1.1754944e-38, 2.0**-13, 2.0**-12, 1, -1, 3.4028235e38,
    88.72283, 88.72284, -87.33654, -87.33655, -88, -103.2789, -103.9720, -103.9721, -104, 2.0**20, 2.0**20 + 1,
], np.float32)  # fmt: skip
"""Ends of the ranges of formulas and of denormal results, zeros, infinities and a NaN."""


def misrounded(name: str, x: Any, wanted: Any) -> Any:
    found = apply(define(name, pairs.FUNCTIONS[name], (vec("f"),)), x)
    same = (found.view(np.uint32) == wanted.view(np.uint32)) | np.isnan(found) & np.isnan(wanted)
    return x[~same]


@pytest.mark.parametrize("name", pairs.FUNCTIONS)
def test_hard_cases_are_rounded_correctly(name: str) -> None:
    x, wanted = hard_cases(name)
    assert len(x) > 300
    assert not len(misrounded(name, x, wanted))


@pytest.mark.parametrize("name", pairs.FUNCTIONS)
def test_numbers_of_every_kind_are_rounded_correctly(name: str) -> None:
    """The meaning in the table of operations is exact (`ir/exact.py`), and knows nothing of these formulas."""
    rng = np.random.default_rng(7)
    bits = rng.integers(0, 1 << 32, 1 << 17, dtype=np.uint64).astype(np.uint32)
    x = np.concatenate([EDGES, bits.view(np.float32), rng.uniform(-104.5, 89, 1 << 16).astype(np.float32)])
    with np.errstate(all="ignore"):
        wanted = MEANINGS[name](x)
    assert not len(misrounded(name, x, wanted))


def test_exceptions_are_needed() -> None:
    for name, formula in (("sin", pairs.circular.sin), ("cos", pairs.circular.cos)):
        x, values = np.array(pairs.EXCEPTIONS[name], np.float32).T
        found = apply(define(name, formula, (vec("f"),)), x)
        assert (found != values).all(), name
        assert name in ODD | EVEN
