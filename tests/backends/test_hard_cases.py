"""The inputs that are hardest to round, on every backend: a strict function gives the exact value, rounded.

Every input whose exact value lies within 2**-45 of a midpoint between two binary32 is among them. A formula of
binary64 that is closer than that, and right for these, is right for all 2**32 numbers.
"""

from __future__ import annotations

import numpy as np
import pytest

from shpy.ir.exact import FUNCTIONS, hard_cases
from shpy.testing.arrays import differing, flat_leaves
from shpy.testing.certify.functions import function
from shpy.testing.reference import flushes_denormals, kernel

UNARY = sorted(FUNCTIONS)
TINY = 2.0**-126


@pytest.mark.sampled(24)
@pytest.mark.parametrize("target", ["numpy", "opencl-1", "opencl-16", "glsl", "interpreter"])
@pytest.mark.parametrize("name", UNARY)
def test_hard_cases_are_rounded_correctly(name: str, target: str) -> None:
    x, answers = hard_cases(name)
    compiled = kernel(function(name), target)
    [found] = flat_leaves(compiled(x))
    wrong = differing(found, answers)
    if flushes_denormals(compiled.notes):
        wrong &= (np.abs(x) >= TINY) & (np.abs(answers) > TINY)
    first = int(np.argmax(wrong))
    assert not wrong.any(), f"{wrong.sum()} of {x.size}, {x[first]!r}: {found[first]!r}, not {answers[first]!r}"
