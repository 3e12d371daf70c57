"""Curvature shading: the mean curvature of a surface, a derivative of second order, tells ridges from hollows.

shpy view examples/curvature.py, or python examples/curvature.py [numpy|opencl|glsl]
"""

import sys

from pictures import save_program

import shpy as sh
from shpy import SH_BREAK, SH_FOR, SH_IF

wear = sh.Param(sh.Attrib1f, 0.3, range=(0, 1), title="Wear", description="How much curvature lightens and darkens")
melt = sh.Param(
    sh.Attrib1f, 0.22, range=(0.02, 0.6), title="Melt", description="How far the balls flow into each other"
)

BALLS = [((-0.75, 0.1, 0.1), 0.72), ((0.35, 0.45, -0.2), 0.62), ((0.75, -0.35, 0.3), 0.6), ((-0.1, -0.55, 0.35), 0.45)]


def shape(p):
    """Return about the distance to balls that flow into each other, with waves on them."""
    near = sum(sh.exp(-(sh.length(p - sh.Point3f(*at)) - size) / melt) for at, size in BALLS)
    waves = sh.sin(11 * p.x) * sh.sin(11 * p.y) * sh.sin(11 * p.z)
    return -melt * sh.log(near) + 0.035 * waves


def normal_at(p):
    return sh.normalize(sh.gradient(shape)(p))


def mean_curvature(p, normal=normal_at):
    """Return half the divergence of the normals: 1 / r on a ball of radius r, below 0 in hollows."""
    change = sh.jacobian(normal)(p)
    return 0.5 * (change[0, 0] + change[1, 1] + change[2, 2])


@sh.program
def curvature(uv: sh.TexCoord2f, resolution: sh.Attrib2f, time: sh.Attrib1f) -> sh.Color3f:
    x, y = (uv - 0.5) * sh.vec2(resolution.x / resolution.y, -1)
    turn = 0.3 * time
    eye, right = sh.Point3f(4 * sh.sin(turn), 0, 4 * sh.cos(turn)), sh.Vector3f(sh.cos(turn), 0, -sh.sin(turn))
    ray = sh.normalize(sh.Vector3f(0, 0, 0) - sh.Vector3f(eye) * 0.38 + right * x + sh.Vector3f(0, 1, 0) * y)
    color, t = sh.Color3f(0.16, 0.18, 0.2) + 0.1 * (1 - uv.y), sh.Attrib1f(1.5)
    with SH_FOR(0, 120):
        step = shape(eye + t * ray)
        t += 0.6 * step
        SH_BREAK((step < 0.0005) | (t > 7))
    with SH_IF(t < 7):
        p = eye + t * ray
        n = normal_at(p)
        bend = sh.tanh(wear * mean_curvature(p))
        own = sh.mix(sh.Color3f(0.32, 0.38, 0.36), sh.Color3f(0.95, 0.75, 0.45), sh.saturate(bend))
        own = sh.mix(own, sh.Color3f(0.05, 0.09, 0.1), sh.saturate(-bend))
        sun = sh.dot(n, sh.normalize(right * 0.5 + sh.Vector3f(0, 0.8, 0) - ray * 0.6))
        color[:] = own * (0.25 + 0.85 * sh.max(sun, 0) + 0.1 * n.y)
    return sh.library.srgb_from_linear(color)


if __name__ == "__main__":
    save_program(curvature, (640, 360), *sys.argv[1:])
