"""Coefficients and constants of the formulas in pairs of binary32, lowest power first; in parts, largest first.

Stage: improve. Printed by `scripts/coefficients pairs`, which says what each is fitted to; not to be edited.
"""

from __future__ import annotations

from typing import Final

EXP: Final = (
    (0.5, 1.02499146e-16),
    (0.16666667, -4.9672377e-09),
    (0.041666668, -1.2418061e-09),
    (0.008333334, -4.1419693e-10),
    (0.0013888889, -3.0792376e-11),
    0.00019841209,
    2.480152e-05,
    2.7624862e-06,
    2.7620897e-07,
)
"""exp r = 1 + r + r r EXP(r); the fit has a relative error of 2**-45.7."""
LOG: Final = (
    (0.6666667, -1.9868214e-08),
    (0.4, -5.962315e-09),
    (0.2857143, -1.1995609e-08),
    0.22222209,
    0.18182969,
    0.15330748,
    0.1461467,
)
"""2 atanh s = 2 s + s z LOG(z); the fit has a relative error of 2**-49.1."""
SIN: Final = (
    (-0.16666667, 4.967054e-09),
    (0.008333334, -4.3462373e-10),
    (-0.0001984127, 2.808319e-12),
    (2.7557314e-06, 4.1062812e-14),
    -2.5050905e-08,
    1.5904744e-10,
)
"""sin r = r + r z SIN(z); the fit has a relative error of 2**-50.0."""
COS: Final = (
    (-0.5, 3.0792967e-16),
    (0.041666668, -1.2417993e-09),
    (-0.0013888889, 3.4309625e-11),
    (2.4801582e-05, 4.2508802e-13),
    -2.7555853e-07,
    2.0665416e-09,
)
"""cos r = 1 + z COS(z); the fit has a relative error of 2**-50.3."""
LN2: Final = (0.69314575, 1.4286197e-06, -1.290532e-11)
HALF_PI: Final = (1.5707964, -4.371139e-08, -1.7151245e-15, 1.0562999e-23)
TWO_BY_PI_DIGITS: Final = (
    0.0,
    163.0,
    -104.0,
    878.0,
    1252.0,
    1045.0,
    672.0,
    -985.0,
    1405.0,
    501.0,
    846.0,
    -575.0,
    -586.0,
    662.0,
    -1644.0,
    -956.0,
    -1788.0,
    510.0,
    1302.0,
    940.0,
)
