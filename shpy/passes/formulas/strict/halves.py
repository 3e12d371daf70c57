"""Functions of binary16 in strict mode: all 65,536 results are the exact value rounded once.

Stage: improve. `half` computes them in binary32 and rounds to binary16. This second rounding is wrong where the result
in binary32 is the middle between two binary16 numbers but the exact value is not. A test of all inputs found these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from shpy.passes.formulas.parts import two_product, two_sum
from shpy.passes.formulas.rounding import to_odd, with_exceptions
from shpy.passes.formulas.terms import Term

EXCEPTIONS: Final[Mapping[str, tuple[tuple[float, float], ...]]] = {
    "acos": (
        (-4.470348358154297e-06, 1.5712890625),
        (-0.07318115234375, 1.6435546875),
        (-0.556640625, 2.162109375),
    ),
    "acosh": ((1.22265625, 0.65576171875), (54848.0, 11.6015625)),
    "asinh": ((0.2105712890625, 0.2091064453125), (14.2421875, 3.349609375), (54848.0, 11.6015625)),
    "atan": (
        (0.0283966064453125, 0.0283966064453125),
        (0.2095947265625, 0.2066650390625),
        (6.4296875, 1.4169921875),
    ),
    "cbrt": (
        (8.112192153930664e-05, 0.043304443359375),
        (0.0006489753723144531, 0.08660888671875),
        (0.005191802978515625, 0.1732177734375),
        (0.041534423828125, 0.346435546875),
        (0.332275390625, 0.69287109375),
        (2.658203125, 1.3857421875),
        (21.265625, 2.771484375),
        (170.125, 5.54296875),
        (1361.0, 11.0859375),
        (10888.0, 22.171875),
    ),
    "cos": ((0.0584716796875, 0.99853515625),),
    "cosh": ((0.03125, 1.0009765625),),
    "erf": ((0.0014820098876953125, 0.0016717910766601562),),
    "erfc": ((-0.00043272972106933594, 1.0009765625), (0.00021636486053466797, 0.99951171875)),
    "exp": ((0.007297515869140625, 1.0068359375), (0.0226898193359375, 1.0224609375)),
    "exp2": ((0.0007042884826660156, 1.0009765625),),
    "expm1": ((0.000690460205078125, 0.0006909370422363281),),
    "log": ((0.005340576171875, -5.23046875),),
    "log1p": (
        (-0.005847930908203125, -0.005863189697265625),
        (0.005870819091796875, 0.005855560302734375),
    ),
    "log10": (
        (0.2362060546875, -0.62646484375),
        (0.2490234375, -0.60400390625),
        (126.0625, 2.099609375),
        (2976.0, 3.474609375),
        (11496.0, 4.05859375),
    ),
    "sin": ((0.2093505859375, 0.2078857421875), (300.0, -0.99951171875)),
    "sinh": ((2.47265625, 5.88671875),),
    "tan": (
        (0.0357666015625, 0.035797119140625),
        (94.8125, 0.63330078125),
        (29856.0, 7.91015625),
    ),
}
"""Inputs, and the exact values rounded to binary16. Odd and even functions list positive inputs only."""

CORRECTED: Final = frozenset({*EXCEPTIONS, "hypot"})
"""Functions whose results in binary32 need more than a rounding to binary16: `correction` returns the formula."""


def _hypot(x: Term, y: Term, result: Term) -> Term:
    """Return sqrt(x * x + y * y) in binary16; the binary32 result is first rounded to odd, from its square's error."""
    total, rest = two_sum((x * x).named("square"), y * y)
    product, lost = two_product(result, result)
    return to_odd(result, ((total - product) - lost) + rest).op("half", type=x.type)


def correction(name: str) -> Callable[..., Term]:
    """Return a function that rounds to binary16 without a double rounding: (inputs, result in binary32) -> result."""
    if name == "hypot":
        return _hypot

    def meaning(x: Term, result: Term) -> Term:
        return with_exceptions(name, x, result, EXCEPTIONS[name]).op("half", type=x.type)

    return meaning
