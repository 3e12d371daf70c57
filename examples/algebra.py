"""Shader algebra: surfaces and lights are programs, and programs are values that can be joined.

A sphere gives each pixel's point, normal and view; a surface colours it; a light shades it. Programs join by
the names of outputs and inputs, or by position; each of the four balls is one kernel in the end.

    python examples/algebra.py [numpy|opencl|glsl]
"""

import sys
from typing import NamedTuple

import numpy as np
from pictures import save

import shpy as sh

SUN = sh.normalize(sh.Vector3f(-0.5, 0.6, 0.62))


class Geometry(NamedTuple):
    position: sh.Point3f
    normal: sh.Normal3f


@sh.program
def sphere(at: sh.Attrib2f) -> Geometry:
    point = sh.Point3f(at, sh.sqrt(sh.max(1 - sh.dot(at, at), 0)))
    return Geometry(point, sh.Normal3f(point))


@sh.program
def dents(position: sh.Point3f, normal: sh.Normal3f) -> Geometry:
    bump = sh.Vector3f(*(sh.noise(5.5 * position + 17 * axis) for axis in range(3)))
    return Geometry(position, sh.normalize(normal + 0.55 * bump))


@sh.program
def plain(position: sh.Point3f, normal: sh.Normal3f, color: sh.Color3f) -> tuple[sh.Normal3f, sh.Color3f]:
    return normal, color


@sh.program
def marble(position: sh.Point3f, normal: sh.Normal3f, color: sh.Color3f) -> tuple[sh.Normal3f, sh.Color3f]:
    waves = sum(sh.noise(2.5 * 2.0**k * position) / 2**k for k in range(5))
    vein = 0.5 + 0.5 * sh.sin(7 * position.x + 3 * position.y + 5 * waves)
    return normal, sh.mix(color, sh.Color3f(0.97, 0.95, 0.9), sh.smoothstep(0.0, 0.75, vein))


@sh.program
def matte(normal: sh.Normal3f, color: sh.Color3f) -> sh.Color3f:
    return color * (0.08 + 0.92 * sh.max(sh.dot(normal, SUN), 0))


@sh.program
def glossy(normal: sh.Normal3f, color: sh.Color3f, gloss: sh.Attrib1f) -> sh.Color3f:
    mirrored = sh.reflect(sh.Vector3f(0, 0, -1), normal)
    return matte(normal, color) + 0.6 * sh.pow(sh.max(sh.dot(mirrored, SUN), 0), gloss)


blue = sh.Param(sh.Color3f, (0.05, 0.16, 0.42), name="blue")
BALLS = [
    matte << plain.bind(color=blue) << sphere,
    glossy.specialize(gloss=60.0) << plain.specialize(color=(0.7, 0.12, 0.06)) << sphere,
    glossy.specialize(gloss=90.0) << marble.bind(color=blue) << sphere,
    glossy.specialize(gloss=25.0) << plain.specialize(color=(0.75, 0.5, 0.12)) << dents << sphere,
]


def draw(size, backend=None):
    """Four balls side by side, (size, 4 * size, 3)."""
    x = (np.arange(size) + 0.5) * 2.2 / size - 1.1
    at = np.stack(np.meshgrid(x, -x), axis=-1)
    inside = np.clip((1 - np.hypot(at[..., 0], at[..., 1])) * size / 2.2 + 0.5, 0, 1)[..., None]
    return np.hstack([inside * np.sqrt(np.maximum(ball.compile(backend)(at), 0)) for ball in BALLS])


if __name__ == "__main__":
    save("algebra", draw(300, *sys.argv[1:]))
