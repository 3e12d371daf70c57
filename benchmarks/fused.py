"""The error of strict mode with and without `fuse`, for six small programs: `python -m benchmarks --only fused`.

    print(fused(Setup(quick=True)).markdown())

Errors are those of binary32 on numpy, in units in the last place, against mpmath; both columns have the same inputs.
"""

from __future__ import annotations

import math

import numpy as np

import shpy as sh
from benchmarks.kernels.polynomial import polynomial
from benchmarks.tables import Setup, Table

SAMPLES = 4_000


@sh.program
def sine_series(x: sh.Attrib1f) -> sh.Attrib1f:
    square, total = x * x, sh.Attrib1f(0)
    for power in range(11, -1, -2):
        total[:] = total * square + (-1) ** (power // 2) / math.factorial(power)
    return x * total


@sh.program
def discriminant(a: sh.Attrib1f, b: sh.Attrib1f, c: sh.Attrib1f) -> sh.Attrib1f:
    return b * b - 4 * a * c


@sh.program
def complex_product(a: sh.Attrib2f, b: sh.Attrib2f) -> sh.Attrib2f:
    return sh.Attrib2f(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x)


@sh.program
def dot_product(v: sh.Attrib4f, w: sh.Attrib4f) -> sh.Attrib1f:
    return sh.dot(v, w)


@sh.program
def attraction(place: sh.Attrib3f, other: sh.Attrib3f, mass: sh.Attrib1f) -> sh.Attrib3f:
    way = other - place
    near = sh.rsqrt(sh.dot(way, way) + 1e-4)
    return way * (mass * near * near * near) + place


POSITIVE, ANY = (0.1, 10.0), (-1.0, 1.0)
PROGRAMS = {
    "polynomial of degree 31": (polynomial, {"x": ANY}),
    "series of the sine": (sine_series, {"x": ANY}),
    "discriminant": (discriminant, {"a": POSITIVE, "b": POSITIVE, "c": POSITIVE}),
    "complex product": (complex_product, {"a": ANY, "b": ANY}),
    "dot product of 4": (dot_product, {"v": ANY, "w": ANY}),
    "attraction of two bodies": (attraction, {"place": ANY, "other": ANY, "mass": POSITIVE}),
}


def fused(setup: Setup) -> Table:
    """Return the largest and the mean error of each program, strict and fused."""
    rows = []
    for name, (program, domain) in PROGRAMS.items():
        samples = 200 if setup.quick else SAMPLES
        report = sh.accuracy.measure(program, domain, "numpy", "strict", samples=samples, fuse=(False, True))
        cells = [f"{value:.3g}" for row in report.rows for value in (row.ulp[0], np.nanmean(row.errors))]
        plain, contracted = (row.errors[~np.isnan(row.errors)] for row in report.rows)  # those in the domain
        closer = np.mean(contracted <= plain)
        rows.append([name, *cells, f"{closer:.1%}"])
    head = ("", "strict, largest", "mean", "fused, largest", "mean", "as close or closer")
    note = (
        "Errors in ULP of binary32 against mpmath, and the share of elements that `fuse=True` brings no further away."
    )
    return Table("fused", note, head, rows)
