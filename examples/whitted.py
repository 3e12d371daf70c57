"""The tracer of "Unified Stream Processing Raytracer" (Moreno-Fortuny and McCool), written by a user.

The paper's loop with the names of its listing; `trace` and `blocked` of an `Intersector` stand for its intersector. The
picture is that of `raytracer.render(scene)` to the bit, for scenes of plain materials under point lights.

    python examples/whitted.py [numpy|opencl|glsl]
"""

import sys

import numpy as np
from pictures import save

import shpy as sh
from raytracer import Intersector, Scene
from shpy import SH_DO, SH_ELSE, SH_FOR, SH_IF, SH_UNTIL


def shader(V, N, L, C, phong):
    """Return the colour under white light from direction L, by Phong's model: diffuse, specular, shininess."""
    along = sh.dot(sh.reflect(-L, N), V)
    shine = sh.cond(along > 0, sh.pow(sh.saturate(along), phong.z), 0.0)
    return phong.x * sh.max(sh.dot(N, L), 0.0) * C + phong.y * shine


def tracer_of(scene, size, reflections=3, backend=None):
    """Return the program of a picture (height, width) of a scene."""
    near = Intersector(scene, backend=backend)
    eye_at, corner, across, down = (sh.Param(sh.Vector3f, v) for v in scene.camera.view(*size))
    materials = [mesh.material for mesh in scene.meshes]
    colors = sh.Table([(*m.color, m.reflectivity) for m in materials], sh.Color4f)
    phong = sh.Table([(m.diffuse, m.specular, m.shininess) for m in materials], sh.Attrib3f)
    lights = sh.Table([light.position for light in scene.lights], sh.Point3f)
    shine = sh.Table([light.color for light in scene.lights], sh.Color3f)

    @sh.program
    def tracer() -> sh.Color3f:
        row, column = sh.grid_index(2)
        ray = sh.normalize(corner + (column + 0.5) * across + (row + 0.5) * down)
        eye = sh.Point3f(eye_at)
        color, scolor = sh.Color3f(0, 0, 0), sh.Color3f(0, 0, 0)
        rn, r = sh.Attrib2f(1, 0), sh.Attrib1i(reflections)
        with SH_DO():
            hit = near.trace(eye, ray)
            with SH_IF(hit.hit):
                C, P, V, N = colors[hit.object].rgb, phong[hit.object], -ray, hit.normal
                rn.y = colors[hit.object].a
                scolor[:] = scene.ambient * C
                with SH_FOR(0, len(lights)) as k:
                    shadow = len(lights) - 1 - k
                    way = lights[shadow] - hit.position
                    L = sh.normalize(way)
                    with SH_IF((sh.dot(N, L) > 0) & ~near.blocked(hit.position, L, sh.length(way))):
                        scolor += shader(V, N, L, C, P) * shine[shadow]
            with SH_ELSE():
                rn.y = 0
                scolor[:] = scene.background
            color += rn.x * scolor
            rn.x *= rn.y
            color -= rn.x * scolor
            finished = (r == 0) | (rn.y == 0)
            r -= 1
            ray[:] = sh.reflect(ray, hit.normal)
            eye[:] = hit.position
            SH_UNTIL(finished)
        return color

    return tracer


if __name__ == "__main__":
    backend = sys.argv[1] if len(sys.argv) > 1 else None
    pixels = tracer_of(Scene.builtin("boxes"), (480, 360), backend=backend).compile(backend)(shape=(360, 480))
    save("whitted", sh.screen.srgb(pixels.astype(np.float64)))
