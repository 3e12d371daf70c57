"""Patterns of the shader library: a sheet of nine materials, each a few lines over noise, cells and distances.

python examples/patterns.py [numpy|opencl|glsl]; one alone, live: shpy view examples/patterns.py:marbled
"""

import sys

import numpy as np
from pictures import save

import shpy as sh
from shpy.library import cellnoise, fbm, lerp, rgb_from_hsv, srgb_from_linear, turbulence, worley


def clouds(p):
    return lerp(sh.Color3f(0.04, 0.18, 0.55), sh.Color3f(0.9), sh.smoothstep(-0.1, 0.6, fbm(p)))


def marble(p):
    vein = 0.5 + 0.5 * sh.sin(4 * p.x + 9 * turbulence(0.8 * p))
    return lerp(sh.Color3f(0.07, 0.05, 0.09), sh.Color3f(0.82, 0.78, 0.7), vein)


def fire(p):
    heat = sh.saturate(1.3 * turbulence(p * (1.5, 0.8) + 3, 5))
    return sh.Color3f(1.6 * heat, 1.4 * heat * heat, 0.9 * heat * heat * heat)


def mosaic(p):
    hue, saturation, value = cellnoise(1.5 * p, 3)
    grout = sh.min(*sh.smoothstep(0, 0.06, 0.5 - abs(sh.fract(1.5 * p) - 0.5)))
    return grout * rgb_from_hsv((hue, 0.4 + 0.4 * saturation, 0.3 + 0.5 * value))


def pebbles(p):
    near, second = worley(1.5 * p, count=2)
    return sh.Color3f(0.55, 0.5, 0.42) * sh.smoothstep(0.03, 0.25, second - near) * (1 - 0.5 * near)


def water(p):
    net = worley(1.2 * p + 0.3 * fbm(p, 2), count=1) ** 3
    return sh.Color3f(0.02, 0.16, 0.22) + net * sh.Color3f(0.7, 1, 0.9)


def knots(p):
    place = sh.vec2(sh.cond(cellnoise(p) < 0.5, 1.0, -1.0), 1) * (sh.fract(p) - 0.5)
    ring = sh.min(sh.length(place - 0.5), sh.length(place + 0.5)) - 0.5
    return lerp(sh.Color3f(0.01, 0.07, 0.05), sh.Color3f(0.9, 0.55, 0.12), sh.saturate(1 - (ring / 0.17) ** 2) ** 0.7)


def crystal(p):
    near, second = worley(1.2 * p, "chebyshev", 2)
    return lerp(sh.Color3f(0.02, 0.03, 0.12), sh.Color3f(0.5, 0.85, 1), (second - near) ** 0.7) * (1 - 0.6 * near)


def wood(p):
    rings = sh.fract(3 * sh.length((p - 3) * (0.3, 1) + 0.25 * fbm(p * (0.5, 1), 3)))
    return lerp(sh.Color3f(0.3, 0.13, 0.04), sh.Color3f(0.55, 0.3, 0.12), rings) * (1 - 0.15 * sh.noise(p * (3, 60)))


def painted(pattern):
    @sh.program
    def paint() -> sh.Color3f:
        return srgb_from_linear(sh.saturate(pattern(6 * (sh.vec2(*sh.grid_index(2).yx) + 0.5) / sh.grid_shape(2).y)))

    return paint


marbled = painted(marble)


def draw(size, backend=None):
    """Draw the sheet, (3 * size, 3 * size, 3)."""
    sheet = (clouds, marble, fire), (mosaic, pebbles, water), (knots, crystal, wood)
    return np.block([[[painted(p).compile(backend)(shape=(size, size))] for p in row] for row in sheet])


if __name__ == "__main__":
    save("patterns", draw(256, *sys.argv[1:]))
