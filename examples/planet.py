"""A procedural shader: a planet made of noise, lit from one side. No mesh, no texture, one program.

python examples/planet.py [numpy|opencl|glsl]
"""

import sys

from pictures import save

import shpy as sh
from shpy import SH_ELSE, SH_IF

light = sh.Param(sh.Vector3f, (-0.62, 0.45, 0.64), name="light")
sea_level = sh.Param(sh.Attrib1f, 0.02, name="sea_level")


def turbulence(p, octaves):
    """Noise over noise: a Python loop, so every octave stands in the program."""
    total = sh.Attrib1f(0)
    for octave in range(octaves):
        total += sh.noise(p * 2.0**octave + 7.3 * octave) / 2**octave
    return total


def ground(p):
    """Return the colour of the planet at p on the unit sphere, and how much it shines like water."""
    height = turbulence(1.6 * p + 11.4, 8)
    color = sh.Color3f(0)
    water = sh.Attrib1f(0)
    with SH_IF(height < sea_level):
        color[:] = sh.mix(
            sh.Color3f(0.06, 0.25, 0.36), sh.Color3f(0.01, 0.05, 0.16), sh.saturate(4 * (sea_level - height))
        )
        water[:] = 1
    with SH_ELSE():
        up = 2.2 * (height - sea_level)
        color[:] = sh.mix(sh.Color3f(0.10, 0.20, 0.05), sh.Color3f(0.40, 0.30, 0.16), sh.smoothstep(0.05, 0.6, up))
        color[:] = sh.mix(color, sh.Color3f(0.85), sh.smoothstep(0.55, 0.9, up + 0.5 * abs(p.y) ** 2))
    ice = sh.smoothstep(0.80, 0.86, abs(p.y) + 0.12 * turbulence(5 * p, 4))
    return sh.mix(color, sh.Color3f(0.9), ice), water * (1 - ice)


@sh.program
def planet() -> sh.Color3f:
    row, column = sh.grid_index(2)
    height, width = sh.grid_shape(2)
    x = 2.3 * (column + 0.5 - 0.5 * width) / height
    y = -2.3 * (row + 0.5 - 0.5 * height) / height
    inside = 1 - x * x - y * y
    n = sh.Normal3f(x, y, sh.sqrt(sh.max(inside, 0)))
    tilted = sh.Matrix3f((0.92, 0.39, 0), (-0.39, 0.92, 0), (0, 0, 1)) @ sh.Vector3f(n)
    color, water = ground(tilted)
    clouds = sh.smoothstep(0.08, 0.55, turbulence(2.2 * tilted + turbulence(3 * tilted, 3) + 3.1, 6))
    color[:] = sh.mix(color, sh.Color3f(0.95), 0.9 * clouds)
    sun = sh.normalize(light)
    lit = sh.smoothstep(-0.12, 1, sh.dot(n, sun))
    shine = sh.pow(sh.saturate(sh.reflect(-sun, n).z), 40)
    rim = sh.Color3f(0.25, 0.5, 1) * (1 - n.z) ** 3
    seen = 1.35 * lit * (color + rim) + 0.5 * water * (1 - clouds) * shine
    halo = (
        sh.Color3f(0.12, 0.3, 0.75)
        * sh.exp(14 * sh.min(inside, 0))
        * sh.smoothstep(-0.7, 0.9, sh.dot(sh.vec2(x, y), sun.xy))
    )
    edge = sh.smoothstep(-0.004, 0.004, inside)
    return sh.sqrt(sh.mix(halo, seen, edge))


def draw(width, height, backend=None):
    """Draw the picture, (height, width, 3)."""
    return planet.compile(backend)(shape=(height, width))


if __name__ == "__main__":
    save("planet", draw(640, 640, *sys.argv[1:]))
