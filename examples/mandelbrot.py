"""The Mandelbrot set: a loop in every element, and colours that are smooth from one iteration to the next.

python examples/mandelbrot.py [numpy|opencl|glsl]
shpy view examples/mandelbrot.py
"""

import sys

import numpy as np
from pictures import save

import shpy as sh
from shpy import SH_DO, SH_IF, SH_UNTIL

ITERATIONS = 400

center = sh.Param(
    sh.Point2f, (-0.6, 0), range=(-2, 2), title="Center", description="of the picture, in the complex plane"
)
zoom = sh.Param(sh.Attrib1f, 0, range=(0, 16), title="Zoom", description="doubles with each 1")


@sh.program
def mandelbrot(c: sh.Point2f) -> sh.Attrib1f:
    """Return the number of iterations, with a fraction, after which c leaves; ITERATIONS if it stays."""
    z = sh.Attrib2f(0, 0)
    n = sh.Attrib1f(0)
    with SH_DO():
        z[:] = sh.Attrib2f(z.x * z.x - z.y * z.y, 2 * z.x * z.y) + c
        n += 1
        SH_UNTIL((sh.dot(z, z) > 256) | (n >= ITERATIONS))
    with SH_IF(n < ITERATIONS):
        n -= sh.log2(0.5 * sh.log2(sh.dot(z, z))) - 2
    return n


@sh.program
def palette(n: sh.Attrib1f) -> sh.Color3f:
    """Blue, white and gold in turn; black for what stays."""
    phase = 0.35 * sh.sqrt(sh.max(n, 0)) + sh.Attrib3f(0.55, 0.45, 0.3)
    color = 0.5 - 0.5 * sh.cos(6.2832 * phase)
    return sh.cond(n >= ITERATIONS, sh.Color3f(0), color)


@sh.program
def picture(pixel: sh.Attrib2i, resolution: sh.Attrib2f) -> sh.Color3f:
    """Return the colour of a pixel as `shpy view` shows it."""
    away = (pixel + 0.5 - 0.5 * resolution) * (2.6 * sh.exp2(-zoom) / resolution.y)
    return palette(mandelbrot(center + sh.Vector2f(away)))


def points(width, height, center=(-0.6, 0.0), size=2.6):
    """Return the middle of each pixel in the complex plane, (height, width, 2)."""
    x = (np.arange(width) + 0.5 - width / 2) * size / height + center[0]
    y = (np.arange(height) + 0.5 - height / 2) * size / height + center[1]
    return np.stack(np.meshgrid(x, y), axis=-1)


def draw(width, height, backend=None):
    """Draw the picture, (height, width, 3): two programs joined into one run once for every pixel."""
    return (palette << mandelbrot).compile(backend)(points(width, height))


if __name__ == "__main__":
    save("mandelbrot", draw(960, 640, *sys.argv[1:]))
