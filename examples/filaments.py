"""The filaments of the Mandelbrot set: the distance to a fractal, by the derivative of its iterations.

shpy view examples/filaments.py, or python examples/filaments.py [numpy|opencl|glsl]
"""

import sys

from pictures import save_program

import shpy as sh
from shpy import SH_BREAK, SH_FOR

center = sh.Param(sh.Attrib2f, (-0.158, 1.0335), range=(-2, 2), title="Center", description="of the picture")
zoom = sh.Param(sh.Attrib1f, 5.6, range=(0, 14), title="Zoom", description="doubles with each 1")
ink = sh.Param(sh.Attrib1f, 1.5, range=(0.3, 8), title="Ink", description="Half the width of a line, in pixels")


def product(a, b):
    return sh.vec2(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x)


def iterated(c):
    """Return z after the iterations z² + c; any formula of complex numbers may stand here."""
    z = sh.Attrib2f(0, 0)
    with SH_FOR(0, 400):
        z[:] = product(z, z) + c
        SH_BREAK(sh.dot(z, z) > 1e6)
    return z


def distance(c):
    """Return about how far the set is from c, within a factor of 2, and whether c lies outside of it."""
    z, dz = sh.jvp(iterated, [c], [sh.vec2(1, 0)])  # of a complex function, one direction is the whole derivative
    size = sh.length(z)
    return size * sh.log(size) / sh.max(sh.length(dz), 1e-20), size > 1000


@sh.program
def filaments(uv: sh.TexCoord2f, resolution: sh.Attrib2f) -> sh.Color3f:
    pixel = 2.6 * sh.exp2(-zoom) / resolution.y
    c = center + (uv - 0.5) * sh.vec2(resolution.x, -resolution.y) * pixel
    away, outside = distance(c)
    away /= pixel
    paper = sh.mix(sh.Color3f(0.93, 0.78, 0.5), sh.Color3f(0.98, 0.96, 0.9), sh.saturate(0.17 * sh.log2(away + 1)))
    return sh.cond(outside, paper * sh.smoothstep(0, ink, away), sh.Color3f(0.05, 0.06, 0.1))


if __name__ == "__main__":
    save_program(filaments, (640, 360), *sys.argv[1:])
