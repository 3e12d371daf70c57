"""Functions of strict mode at binary32 for devices that have no binary64: the exact value, rounded once.

Stage: improve. `FUNCTIONS["exp"]` computes with sums of two binary32; the last sum is rounded to odd before it is
rounded to nearest. The relative error is near 2**-49, so only inputs whose exact value lies that close to the middle
between two binary32 numbers can be misrounded. `EXCEPTIONS` lists these inputs with their results; for odd and even
functions it lists positive inputs only. The other functions of strict mode need binary64; without it they are an error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from shpy.passes.pairs import circular, exponential
from shpy.passes.rounding import with_exceptions
from shpy.passes.terms import Term

EXCEPTIONS: Final[Mapping[str, tuple[tuple[float, float], ...]]] = {
    "sin": (
        (9830.398, -0.34761325),
        (1.2787518e08, -0.73914737),
        (3.3195732e09, 0.7079142),
        (2.07408e16, 0.87133265),
        (1.1569046e19, 0.67368364),
        (7.9946536e27, 0.7537518),
        (3.8378958e35, 0.75169474),
    ),
    "cos": (
        (49.89141, 0.9308472),
        (31789.066, -0.75858647),
        (4.6778227e11, -0.86756104),
        (3.4521943e15, 0.7592679),
        (1.978357e16, 0.86976737),
        (2.2465249e18, 0.71824545),
        (1.7269983e20, 0.969058),
        (9.030997e22, -0.7400778),
    ),
}
"""Inputs that a formula misrounds, and the correctly rounded results."""


def _sin(x: Term) -> Term:
    """Return the sine of x, corrected at its exceptions."""
    return with_exceptions("sin", x, circular.sin(x), EXCEPTIONS["sin"])


def _cos(x: Term) -> Term:
    """Return the cosine of x, corrected at its exceptions."""
    return with_exceptions("cos", x, circular.cos(x), EXCEPTIONS["cos"])


FUNCTIONS: Final[Mapping[str, Callable[..., Term]]] = {
    "exp": exponential.exp,
    "log": exponential.log,
    "rsqrt": exponential.rsqrt,
    "sin": _sin,
    "cos": _cos,
}
