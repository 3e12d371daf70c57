"""Blurs a picture through a texture: the same one-dimensional program twice, once along and once across.

python examples/blur.py [numpy|opencl|glsl]
"""

import sys

import numpy as np
from pictures import save

import shpy as sh

step = sh.Param(sh.Attrib2f, (0, 0), name="step")


def gaussian(radius):
    """Record a program that weighs 2 * radius + 1 texels along `step` in a loop of Python, with constant weights."""
    offsets = np.arange(-radius, radius + 1)
    weights = np.exp(-0.5 * (2 * offsets / radius) ** 2)
    weights /= weights.sum()

    @sh.program
    def blur(picture: sh.Texture2D[sh.Color3f]) -> sh.Color3f:
        row, column = sh.grid_index(2)
        height, width = sh.grid_shape(2)
        size = sh.vec2(width, height)
        uv = (sh.vec2(column, row) + 0.5) / size
        total = sh.Color3f(0)
        for offset, weight in zip(offsets, weights, strict=True):
            total += weight * picture(uv + int(offset) * step / size)
        return total

    return blur


def blurred(picture, radius, backend=None):
    """Return the picture (H, W, 3) with every point spread over `radius` pixels; edges are continued."""
    kernel = gaussian(radius).compile(backend)
    for direction in ((1, 0), (0, 1)):
        step.value = direction
        picture = kernel(sh.Texture2D(picture, filter="linear", wrap="clamp"), shape=picture.shape[:2])
    return picture


def sample(size):
    """Draw a picture with edges, points and soft colours: (size, size, 3)."""
    y, x = np.mgrid[0:size, 0:size] * 6 / size
    hue = 0.25 * (x + y)[..., None] + (0.0, 0.12, 0.3)
    tiles = np.where((np.floor(x) + np.floor(y)) % 2 == 0, 1.0, 0.25)[..., None] * (0.55 + 0.4 * np.cos(2.1 * hue))
    lamps = (x % 1 - 0.5) ** 2 + (y % 1 - 0.5) ** 2 < 0.015
    return np.where(lamps[..., None], 1, tiles).astype(np.float32)


if __name__ == "__main__":
    picture = sample(400)
    save("blur", np.hstack([picture, blurred(picture, 4, *sys.argv[1:]), blurred(picture, 16, *sys.argv[1:])]))
