"""A ray-marched scene: shapes given by their distance, which flow into each other, soft shadows and haze.

shpy view examples/raymarch.py, or python examples/raymarch.py [numpy|opencl|glsl]
"""

import sys

from pictures import save_program

import shpy as sh
from shpy import SH_BREAK, SH_FOR, SH_IF

light = sh.Param(sh.Vector3f, (0.7, 0.6, 0.45), range=(-1, 1), title="Light", description="The direction it comes from")
blur = sh.Param(sh.Attrib1f, 0.1, range=(0.01, 0.5), title="Shadows", description="How soft their edges are")
melt = sh.Param(sh.Attrib1f, 0.35, range=(0.01, 1), title="Melt", description="How far shapes flow into each other")
clay = sh.Param(sh.Color3f, (0.58, 0.17, 0.08), range=(0, 1), title="Clay")


def melted(a, b):
    """Return the smaller of two distances, rounded off where they are nearly the same (a cubic polynomial)."""
    return sh.min(a, b) - (sh.max(melt - abs(a - b), 0) / melt) ** 3 * melt / 6


@sh.subroutine
def scene_at(p: sh.Point3f, time: sh.Attrib1f) -> sh.Attrib1f:
    """Return the distance to the floor, or to the clay: a ball that bobs, a ring and a box with round edges."""
    ball = sh.length(p - sh.Point3f(-0.55, 0.75 + 0.35 * sh.sin(1.7 * time), 0.1)) - 0.5
    ring = sh.length(sh.vec2(sh.length(p.xz - (0.25, -0.1)) - 0.95, p.y - 0.22)) - 0.2
    out = abs(p - sh.Point3f(0.85, 0.6, -0.25)) - sh.vec3(0.28, 0.55, 0.28)
    box = sh.length(sh.max(out, 0)) + sh.min(sh.max(out.x, out.y, out.z), 0) - 0.09
    return sh.min(melted(melted(ball, ring), box), p.y)


def march(eye, ray, time):
    """Return how far a ray goes until it meets something; more than 20 where it meets nothing."""
    t = sh.Attrib1f(0.01)
    with SH_FOR(0, 110):
        step = scene_at(eye + t * ray, time)
        t += step
        SH_BREAK((step < 0.0005 * t) | (t > 20))
    return t


def lit(p, to_light, time):
    """Return the part of a light that reaches p: a shadow is softer the farther it lies from what throws it."""
    seen, t = sh.Attrib1f(1), sh.Attrib1f(0.03)
    with SH_FOR(0, 60):
        gap = scene_at(p + t * to_light, time)
        seen[:] = sh.min(seen, gap / (blur * t))
        t += sh.clamp(gap, 0.02, 0.25)
        SH_BREAK((seen < 0.002) | (t > 6))
    return sh.smoothstep(0, 1, seen)


@sh.program
def raymarch(uv: sh.TexCoord2f, resolution: sh.Attrib2f, time: sh.Attrib1f, mouse: sh.Attrib2f = (0, 0)) -> sh.Color3f:
    turn = 0.25 * time + 6.2832 * mouse.x / resolution.x + 0.6
    eye, right = sh.Point3f(4.2 * sh.sin(turn), 2.1, 4.2 * sh.cos(turn)), sh.vec3(sh.cos(turn), 0, -sh.sin(turn))
    ahead = sh.normalize((0, 0.45, 0) - eye)
    x, y = (uv - 0.5) * sh.vec2(resolution.x / resolution.y, -1)
    ray = sh.normalize(ahead * 1.7 + right * x + sh.cross(right, ahead) * y)
    sky = sh.mix(sh.Color3f(0.8, 0.82, 0.84), sh.Color3f(0.32, 0.5, 0.75), sh.saturate(2.5 * ray.y))
    color, t, sun = sky.copy(), march(eye, ray, time), sh.normalize(light)
    p = eye + t * ray
    with SH_IF(t < 20):
        normal = sh.normalize(sh.gradient(scene_at)(p, time))
        tile = sh.Color3f(0.24 + 0.22 * sh.fract(0.5 * (sh.floor(p.x) + sh.floor(p.z))))
        closed = sh.saturate(0.25 + 3 * scene_at(p + 0.25 * normal, time))  # 1 where nothing is near
        direct = sh.max(sh.dot(normal, sun), 0) * lit(p + 0.004 * normal, sun, time)
        shine = 0.3 * sh.pow(sh.max(sh.dot(sh.reflect(ray, normal), sun), 0), 30)
        own = sh.cond(p.y > 0.005 + 0.001 * t, clay, tile)
        color[:] = direct * (own * sh.Color3f(1.15, 1.05, 0.9) + shine) + closed * own * sh.Color3f(0.2, 0.24, 0.3)
        color[:] = sh.mix(sky, color, sh.exp(-0.004 * t * t))
    return sh.library.srgb_from_linear(color)


if __name__ == "__main__":
    save_program(raymarch, (640, 360), *sys.argv[1:])
