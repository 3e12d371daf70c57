"""Compute the tables of albedos of raytracer/appearance by integrals over lobes; tests compare the files with them.

python -m tests.raytracer.albedo_integrals       # write both files anew
"""

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from raytracer.appearance import albedo
from raytracer.appearance.albedo import ACROSS, FINEST, SHEEN_STEP, STEP

DRAWS: Final = 64
"""Visible normals lie on a lattice of this many by as many."""
DIRECTIONS: Final = 128
"""Directions to the light, of a sheen, lie on a lattice of this many heights by as many angles."""
FINE: Final = 4
"""Interpolation is compared with the integrals on a grid that is as many times as fine as the table."""
ROUNDS: Final = 8
"""Nodes are raised so often: each time by half of what interpolation lacks beside them."""
Floats = NDArray[np.float64]


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
    columns = [np.ceil(nodes / STEP - 1e-9), np.floor(np.array(means)[:, None] / STEP)]
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
    lattice = (np.arange(DRAWS) + 0.5) / DRAWS
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


def compute_sheen_table() -> NDArray[np.uint16]:
    """Compute the contents of the file: the numbers of `sheen_table` in steps of 2**-12.

    Nodes are raised until interpolation errs upward alone: the base below is then a little too dark, never too bright.
    """
    roots = np.linspace(0, 1, FINE * (ACROSS - 1) + 1)
    exact = np.stack([albedos(roots**2, roughness) for roughness in roots])[..., None]
    nodes = exact[::FINE, ::FINE].copy()
    for _ in range(ROUNDS):
        nodes += 0.5 * lack(nodes, exact)
    return np.asarray(np.clip(np.ceil(nodes[..., 0] / SHEEN_STEP - 1e-9), 0, 65535), np.uint16)


def albedos(cosines: Any, roughness: float) -> Floats:
    """Return the integral of `charlie` over all lights, for cosines (n,) of the view.

    Heights of the light are the squares of numbers that are spread evenly, as the lobe is narrow near the horizon.
    """
    cosines = np.maximum(np.atleast_1d(np.asarray(cosines, np.float64)), 1e-6)[:, None, None]
    part = (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    light, angle = np.meshgrid(part**2, np.pi * part, indexing="ij")
    across = np.sqrt(1 - cosines**2) * np.sqrt(1 - light**2) * np.cos(angle)
    both = np.maximum(2 + 2 * (across + cosines * light), 1e-300)  # the square of the sum of the two directions
    sine = np.sqrt(np.clip(1 - (cosines + light) ** 2 / both, 0, 1))
    values = charlie(sine, cosines, light, max(roughness, FINEST)) * light
    measure = 2 * np.pi * 2 * part[:, None]  # d light = 2 part d part; the other half of the circle is the same
    result: Floats = (values * measure).mean(axis=(1, 2))
    return result


def charlie(sine: Any, view: Any, light: Any, roughness: float) -> Any:
    """Return the lobe for white fibres, by the sine of the half vector and the cosines of view and light."""
    inverse = 1 / roughness**2
    fibres = (2 + inverse) * sine**inverse / (2 * np.pi)
    return fibres / (4 * np.maximum(view + light - view * light, 1e-12))


if __name__ == "__main__":
    for name, compute in (("albedos", compute_table), ("sheen_albedos", compute_sheen_table)):
        np.save(Path(albedo.__file__).with_name(f"{name}.npy"), compute())
