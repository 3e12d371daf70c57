"""Coefficients and constants of the formulas in binary64, lowest power first; in parts, largest first.

Stage: improve. Printed by `scripts/coefficients exact`, which says what each is fitted to; not to be edited.
"""

from __future__ import annotations

from typing import Final

EXP: Final = (
    1.0,
    1.0,
    0.5000000000000001,
    0.1666666666664812,
    0.041666666666622894,
    0.008333333353869527,
    0.001388888891766018,
    0.00019841208453230655,
    2.4801520715593872e-05,
    2.762527024442844e-06,
    2.762033445266811e-07,
)
"""exp r; its rest has a relative error of 2**-45.9."""
LOG: Final = (
    0.666666666666667,
    0.3999999999989935,
    0.2857142862619172,
    0.22222211090935115,
    0.1818289260179483,
    0.15331601402887865,
    0.1461796478030114,
)
"""2 atanh s = 2 s + s z LOG(z); with a relative error of 2**-50.9."""
SIN: Final = (
    3.141592653589793,
    -5.167712780049945,
    2.5501640398760044,
    -0.5992645292865307,
    0.08214588614421396,
    -0.007370427288701782,
    0.0004662860726569745,
    -2.187234610985848e-05,
    7.407082011743356e-07,
)
"""sin(pi f) = f SIN(f f); with a relative error of 2**-54.6."""
TAN_ABOVE: Final = (1.5707963267948966, -0.49720126218132654, 0.026833914218161597, -0.00017659834146612223)
"""tan(pi f / 2) = f TAN_ABOVE(f f) / TAN_BELOW(f f), with a relative error of 2**-53.9."""
TAN_BELOW: Final = (1.0, -1.138995187774858, 0.14212656825105077, -0.0031313793548062335)
LN2: Final = (0.6931471805598903, 5.497923018708371e-14)
INVERSE_PI: Final = (0.3183098854497075, 7.340831623126043e-10, 1.138005036539198e-18)
"""Positive numbers, so that their sum with -0.0 keeps its sign."""
FAR_DIGITS: Final = (
    (1.2841276625374931e-08, 8.076898927812296e-18, 1.2634130177915748e-26),
    (1.468547768767099e-16, 1.4188110080591198e-25, 8.341433834304119e-35),
    (3.037013239734091e-24, 5.090832185799798e-33, 7.95005651784451e-42),
)
"""Later digits of 1 / pi, for angles from 2**50, 2**76 and 2**102 on."""
