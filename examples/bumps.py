"""Bump mapping: the normal of a smooth ball, tilted by the gradient of a height that is a function of the place.

shpy view examples/bumps.py, or python examples/bumps.py [numpy|opencl|glsl]
"""

import sys

from pictures import save_program

import shpy as sh
from shpy import SH_IF

strength = sh.Param(sh.Attrib1f, 1.0, range=(-2, 2), title="Strength", description="of the bumps; dents below 0")
light = sh.Param(sh.Vector3f, (-0.5, 0.7, 0.6), range=(-1, 1), title="Light", description="The direction it comes from")


def peel(p):
    """Return the height of an orange's peel, which has small dents."""
    return -0.012 * sh.smoothstep(0.1, 0.6, sh.noise(21 * p))


def stone(p):
    """Return the height of rough stone: five octaves of noise."""
    return sum(0.09 * 0.5**k * sh.noise(3.2 * 2.03**k * p) for k in range(5))


def clay(p):
    """Return the height of turned clay: grooves around the axis, which noise bends."""
    return 0.012 * sh.sin(40 * p.y + 3 * sh.noise(2 * p))


BALLS = [
    (-1.15, peel, (0.9, 0.36, 0.05), 0.5),
    (0.0, stone, (0.36, 0.34, 0.31), 0.1),
    (1.15, clay, (0.55, 0.2, 0.1), 0.25),
]


def bumpy(height, p, normal):
    """Return the normal of the surface that lies `height(p)` above a smooth one."""
    slope = strength * sh.gradient(height)(p)
    return sh.normalize(normal - (slope - sh.dot(slope, normal) * normal))


@sh.program
def bumps(uv: sh.TexCoord2f, resolution: sh.Attrib2f, time: sh.Attrib1f) -> sh.Color3f:
    at = (uv - 0.5) * sh.vec2(resolution.x, -resolution.y) * (2 / resolution.y)
    color, sun = sh.Color3f(0.83, 0.85, 0.86) - 0.25 * uv.y, sh.normalize(light)
    turn = sh.vec2(sh.cos(0.4 * time), sh.sin(0.4 * time))
    for x, height, paint, gloss in BALLS:
        q = sh.vec2(at.x - x, at.y) / 0.52
        with SH_IF(sh.dot(q, q) < 1):
            n = sh.Normal3f(q, sh.sqrt(1 - sh.dot(q, q)))
            turned = sh.Normal3f(n.x * turn.x - n.z * turn.y, n.y, n.x * turn.y + n.z * turn.x)
            m = bumpy(height, sh.Point3f(turned), turned)
            m = sh.Normal3f(m.x * turn.x + m.z * turn.y, m.y, m.z * turn.x - m.x * turn.y)
            middle = sh.normalize(sun + sh.Vector3f(0, 0, 1))
            shine = gloss * sh.pow(sh.max(sh.dot(m, middle), 0), 40)
            color[:] = sh.Color3f(*paint) * (1.1 * sh.max(sh.dot(m, sun), 0) + 0.16 + 0.12 * m.y) + shine
    return sh.library.srgb_from_linear(color)


if __name__ == "__main__":
    save_program(bumps, (640, 360), *sys.argv[1:])
