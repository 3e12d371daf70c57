"""Curves f(p) = 0 as lines of one width with smooth edges: |f| / |grad f| is nearly the distance to the curve.

shpy view examples/contours.py, or python examples/contours.py [numpy|opencl|glsl]
"""

import sys

from pictures import save_program

import shpy as sh

width = sh.Param(sh.Attrib1f, 1.6, range=(0.5, 8), title="Width", description="Half the width of a line, in pixels")
size = sh.Param(sh.Attrib1f, 0.4, range=(0.1, 1.2), title="Oval", description="The product of the two distances")


def oval(p):
    """Cassini's oval: the product of the distances to two places is constant."""
    return sh.length(p - sh.vec2(0.6, 0)) * sh.length(p + sh.vec2(0.6, 0)) - size


def waves(p):
    return sh.sin(p.x * p.x + 3 * p.y) + sh.cos(3 * p.x - p.y * p.y)


def clover(p):
    """Return x² + y² - 0.6 - 0.9 Re(z³ (1 - |z|²))."""
    square = sh.dot(p, p)
    return square - 0.6 - 0.9 * p.x * (p.x * p.x - 3 * p.y * p.y) * (1 - square)


def drawn(color, f, p, pixel, ink):
    """Return the colour with the curve f(p) = 0 over it."""
    value, slope = sh.gradient(f, value=True)(p)
    away = abs(value) / sh.max(sh.length(slope), 1e-6) / pixel
    return sh.mix(color, ink, 1 - sh.smoothstep(width - 0.7, width + 0.7, away))


@sh.program
def contours(uv: sh.TexCoord2f, resolution: sh.Attrib2f, time: sh.Attrib1f) -> sh.Color3f:
    pixel = 3 / resolution.y
    p = (uv - 0.5) * sh.vec2(resolution.x, -resolution.y) * pixel
    color = sh.Color3f(0.97, 0.95, 0.9)
    color = drawn(color, lambda q: waves(2 * q + sh.vec2(time, 0)), p, pixel, sh.Color3f(0.75, 0.78, 0.82))
    color = drawn(color, clover, p + sh.vec2(1.2, 0), pixel, sh.Color3f(0.1, 0.35, 0.6))
    return drawn(color, oval, p - sh.vec2(1.2, 0), pixel, sh.Color3f(0.75, 0.1, 0.2))


if __name__ == "__main__":
    save_program(contours, (640, 360), *sys.argv[1:])
