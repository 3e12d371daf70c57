"""Heat in a plate, by Jacobi's iteration: a loop that ends when no cell changes any more.

python examples/heat.py [numpy|opencl|glsl]
"""

import sys

import numpy as np
from pictures import save

import shpy as sh

TOLERANCE = 2e-5


@sh.program
def relax(heat: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    """Return the mean of the cells around: an element that would hardly change writes nothing."""
    here = sh.grid_index(2)
    around = heat[here + (0, 1)] + heat[here - (0, 1)] + heat[here + (1, 0)] + heat[here - (1, 0)]
    mean = 0.25 * around
    sh.SH_DISCARD(sh.abs(mean - heat[here]) < TOLERANCE)
    return mean


def plate(height, width):
    """Return the first heat and the free cells: a hot disc, two cold bars and the edge keep their heat."""
    y, x = np.mgrid[:height, :width] / height
    disc = (x - 0.45) ** 2 + (y - 0.5) ** 2 < 0.02
    bars = (abs(x - 1.05) < 0.02) & (abs(y - 0.5) > 0.12)
    edge = np.ones((height, width), bool)
    edge[1:-1, 1:-1] = False
    return np.where(disc, 1, np.where(edge, x / 3, 0)), ~(disc | bars | edge)


def steady(heat, free, backend=None):
    """Return the steady heat and the number of rounds: `where` holds the cells that are not free."""
    result = sh.loop(relax, where="free").run(heat=heat, free=free, backend=backend)
    return result.streams["heat"].numpy(), result.executions["relax"]


def zoomed(field, times):
    """Return a field (H, W) as (times * H, W), with the mean of neighbours by their distance between them."""
    at = (np.arange(times * len(field)) + 0.5) / times - 0.5
    low = np.clip(np.floor(at).astype(int), 0, len(field) - 2)
    share = np.clip(at - low, 0, 1)[:, None]
    return (1 - share) * field[low] + share * field[low + 1]


if __name__ == "__main__":
    heat, rounds = steady(*plate(160, 240), *sys.argv[1:])
    print(f"no cell changes by {TOLERANCE} after {rounds} rounds")
    heat = zoomed(zoomed(heat, 4).T, 4).T
    slope = np.hypot(*np.gradient(12 * heat))
    lines = np.clip(np.abs(12 * heat % 1 - 0.5) / np.maximum(slope, 1e-6), 0, 1)  # isotherms, a pixel wide
    colors = np.stack([heat**0.5, 0.08 + 0.9 * heat**1.4, 0.3 + 0.3 * np.exp(-8 * (heat - 0.3) ** 2) - 0.4 * heat], -1)
    save("heat", colors * (0.6 + 0.4 * lines[..., None]))
