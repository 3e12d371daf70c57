"""Gray and Scott's reaction of two chemicals that diffuse: a chain that reads its own streams by index.

python examples/gray_scott.py [numpy|opencl|glsl]
shpy view examples/gray_scott.py
"""

import sys

import numpy as np
from pictures import save

import shpy as sh

FEED, KILL = 0.037, 0.06


def spread(chemical, here):
    """Return the discrete Laplacian of a concentration, on a board that wraps around."""
    at = lambda down, right: chemical[(here + (down, right)) % sh.grid_shape(2)]  # noqa: E731
    beside = at(-1, 0) + at(1, 0) + at(0, -1) + at(0, 1)
    across = at(-1, -1) + at(-1, 1) + at(1, -1) + at(1, 1)
    return 0.2 * beside + 0.05 * across - chemical[here]


@sh.program
def react(u: sh.Table[sh.Attrib1f, 2], v: sh.Table[sh.Attrib1f, 2]):
    """One step: the Tables hold both chemicals before it, the outputs replace them."""
    here = sh.grid_index(2)
    turned = u[here] * v[here] * v[here]
    return {
        "u": u[here] + spread(u, here) - turned + FEED * (1 - u[here]),
        "v": v[here] + 0.5 * spread(v, here) + turned - (FEED + KILL) * v[here],
    }


def drops(size, count=20):
    """Return a board of the first chemical with some drops of the second one."""
    u, v = np.ones((size, size), np.float32), np.zeros((size, size), np.float32)
    for row, column in np.random.default_rng(4).integers(0, size - 6, (count, 2)):
        u[row : row + 6, column : column + 6] = 0.5
        v[row : row + 6, column : column + 6] = 0.25
    return u, v


def start(height, width):
    """Return the streams that `shpy view` begins with."""
    u, v = drops(max(height, width))
    return {"u": u[:height, :width], "v": v[:height, :width]}


@sh.program
def show(v: sh.Attrib1f) -> sh.Color3f:
    """Return the colour in which `shpy view` shows a cell."""
    shade = sh.saturate(v / 0.35)
    return sh.Color3f(shade * shade, 0.9 * shade, 0.25 + 1.2 * shade * (1 - shade))


def pattern(size, steps, backend=None):
    """Both chemicals (size, size) after some steps."""
    u, v = drops(size)
    streams = sh.repeat(react, steps).run(u=u, v=v, backend=backend).streams
    return streams["u"].numpy(), streams["v"].numpy()


if __name__ == "__main__":
    u, v = pattern(256, 4000, *sys.argv[1:])
    print(f"the second chemical covers {100 * np.mean(v > 0.15):.0f} % of the board after 4000 steps")
    shade = np.clip(v / 0.35, 0, 1)
    colors = np.stack([shade**2, 0.9 * shade, 0.25 + 0.6 * shade * (1 - shade) * 2], axis=-1)
    save("gray_scott", colors.repeat(2, axis=0).repeat(2, axis=1))
