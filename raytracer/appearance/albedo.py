"""The albedo of GGX: the share of light that a rough mirror sends out in all, by the angle at which it is seen.

Stage: scene description. With Schlick's approximation (1994) the albedo is linear in the shares F0 and F90 that are
mirrored at normal and at grazing incidence: F0 (a - b) + F90 b. The integrals a, of white, and b, of Schlick's fifth
power, stand in a table by the root of the cosine and by roughness (Karis 2013, Real Shading in Unreal Engine 4; Kulla
and Conty 2017, Revisiting Physically Based Shading at Imageworks).

The table is a file of the package, albedos.npy. To compute it takes 15 s, and last bits would depend on a machine's
library of functions, where the workers of a cluster must agree.

>>> albedo_table().shape
(32, 33, 2)
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

ACROSS: Final = 32
"""The cosines, and the roughnesses, of the table."""
SMOOTHEST: Final = 1 / (ACROSS - 1)
"""The roughness below which a surface is a mirror: that of the second row of the table."""
_DRAWS: Final = 64
"""Visible normals lie on a lattice of this many by as many."""
_STEP: Final = 1 / 65535
"""The numbers of the file are multiples of it."""
FINE: Final = 4
"""Interpolation is compared with the integrals on a grid that is as many times as fine as the table."""
ROUNDS: Final = 8
"""Nodes are raised so often: each time by half of what interpolation lacks beside them."""
Floats = NDArray[np.float64]


@lru_cache(maxsize=1)
def albedo_table() -> NDArray[np.float32]:
    """Return a - b and b, (ACROSS, ACROSS + 1, 2): a row for each roughness; its last element is the cosines' mean."""
    steps = np.load(Path(__file__).with_name("albedos.npy"))
    return np.asarray(steps * _STEP, np.float32)


def compute_table() -> NDArray[np.uint16]:
    """Compute the contents of the file: the numbers of `albedo_table` in steps of 1 / 65535.

    Nodes are raised until interpolation errs upward alone: the matt light below a layer is then a little too weak,
    never too strong. Row 0 is that of a perfect mirror, which everything as smooth as row 1 is (`SMOOTHEST`).
    """
    roots = np.linspace(0, 1, FINE * (ACROSS - 1) + 1)
    exact = np.stack([_row(roots, roughness) for roughness in roots])
    nodes = exact[::FINE, ::FINE].copy()
    grazing = (1 - roots[::FINE] ** 2) ** 5
    nodes[0] = np.stack([1 - grazing, grazing], axis=1)
    for _ in range(ROUNDS):
        nodes[1:] += 0.5 * lack(nodes, exact, FINE)[1:]
    nodes[..., 1] = np.minimum(nodes[..., 1], 1)
    nodes[..., 0] = np.minimum(nodes[..., 0], 1 - nodes[..., 1])
    # The mean over the hemisphere, of the interpolated values: 2 mu d mu = 4 x**3 dx for the root x.
    x = (np.arange(64 * (ACROSS - 1)) + 0.5) / (64 * (ACROSS - 1))
    means = [[np.average(np.interp(x, roots[::FINE], row[:, k]), weights=x**3) for k in range(2)] for row in nodes]
    columns = [np.ceil(nodes / _STEP - 1e-9), np.floor(np.array(means)[:, None] / _STEP)]
    return np.asarray(np.clip(np.concatenate(columns, axis=1), 0, 65535), np.uint16)


def _row(roots: Floats, roughness: float) -> Floats:
    """Return a - b and b, (n, 2), at the squares of these roots."""
    a, b = integrals(np.maximum(roots**2, 1e-6), roughness**2)
    return np.stack([a - b, b], axis=1)


def lack(nodes: Floats, exact: Floats, first: int = 0) -> Floats:
    """Return the largest lack of interpolation in the cells around each node, against numbers on the fine grid.

    The rows of the fine grid before the `first` lack nothing.
    """
    places = np.arange(len(exact)) / FINE
    low = np.minimum(places.astype(int), ACROSS - 2)
    part = places - low
    rows = nodes[low] * (1 - part)[:, None, None] + nodes[low + 1] * part[:, None, None]
    values = rows[:, low] * (1 - part)[None, :, None] + rows[:, low + 1] * part[None, :, None]
    missing = np.maximum(exact - values, 0)
    missing[:first] = 0
    largest = np.zeros_like(nodes)
    for down in (0, 1):
        for across in (0, 1):
            np.maximum.at(largest, np.ix_(low + down, low + across), missing)
    return largest


def integrals(cosines: Any, alpha: float, *, correlated: bool = True) -> tuple[Floats, Floats]:
    """Return a and b for cosines (n,): the means of G2 / G1 over visible normals (Heitz 2018, equation 19).

    Masking is height-correlated, or a product of two factors. Normals are drawn on a spherical cap (Dupuy and Benyoub
    2023).
    """
    cosines = np.atleast_1d(np.asarray(cosines, np.float64))
    lattice = (np.arange(_DRAWS) + 0.5) / _DRAWS
    angle, level = np.meshgrid(2 * np.pi * lattice, lattice)
    a, b = np.zeros(len(cosines)), np.zeros(len(cosines))
    square = alpha * alpha
    for k, cosine in enumerate(cosines):
        sine = np.sqrt(1 - cosine * cosine)
        view = np.array([alpha * sine, 0, cosine]) / np.hypot(alpha * sine, cosine)
        z = (1 - level) * (1 + view[2]) - view[2]
        across = np.sqrt(np.maximum(1 - z * z, 0))
        half = np.stack([across * np.cos(angle) + view[0], across * np.sin(angle), z + view[2]])
        half = half * np.array([alpha, alpha, 1])[:, None, None]
        half /= np.linalg.norm(half, axis=0) + 1e-300
        facing = sine * half[0] + cosine * half[2]
        light = 2 * facing * half[2] - cosine
        out, into = (np.sqrt(square + (1 - square) * c * c) for c in (cosine, light))
        if correlated:
            share = light * (cosine + out) / (light * out + cosine * into + 1e-300)
        else:
            share = 2 * light / (light + into + 1e-300)
        share = np.where(light > 0, share, 0)
        a[k], b[k] = share.mean(), (share * (1 - np.clip(facing, 0, 1)) ** 5).mean()
    return a, b
