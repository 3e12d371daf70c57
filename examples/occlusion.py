"""Ambient occlusion: how much of the sky each point of a mesh sees, by rays that a program of a few lines sends out.

`Intersector.trace` and `blocked` record the scene's walk into the program, with its tables as arguments.

    python examples/occlusion.py [numpy|opencl|glsl] [mesh.ply]
"""

import sys

from pictures import save

import shpy as sh
from raytracer import Intersector, Scene
from raytracer.meshes.shapes import knot
from shpy import SH_FOR


def around(row, column, k):
    """Return the k-th random point of the unit sphere for a pixel."""
    u, v = (sh.unit_float(sh.hash(row, column, 2 * k + i)) for i in range(2))
    angle, z = 6.2831853 * u, 2 * v - 1
    return sh.Vector3f(sh.sqrt(1 - z * z) * sh.vec2(sh.cos(angle), sh.sin(angle)), z)


def sky_of(scene, size, rays=64, backend=None):
    """Return the program of a picture: 1 where all of `rays` cosine-distributed rays leave the scene."""
    near = Intersector(scene, backend=backend)
    eye, corner, across, down = (sh.Param(sh.Vector3f, v) for v in scene.camera.view(*size))

    @sh.program
    def sky() -> sh.Attrib1f:
        row, column = sh.grid_index(2)
        hit = near.trace(eye, corner + (column + 0.5) * across + (row + 0.5) * down)
        free = sh.Attrib1i(0)
        with SH_FOR(0, rays) as k:
            free += sh.cond(near.blocked(hit.position, hit.normal + around(row, column, k)), 0, 1)
        return sh.cond(hit.hit, sh.Attrib1f(free) / rays, 1.0)

    return sky


def occlusion(scene, size, rays=64, backend=None):
    """Return the picture (height, width)."""
    return sky_of(scene, size, rays, backend).compile(backend)(shape=size[::-1])


if __name__ == "__main__":
    backend = sys.argv[1] if len(sys.argv) > 1 else None
    scene = Scene.load(sys.argv[2]) if len(sys.argv) > 2 else Scene.framed(knot(segments=200, sides=40))
    save("occlusion", occlusion(scene, (480, 480), backend=backend))
