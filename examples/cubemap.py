"""Reflections from a cube map, beside those of rays through a layered depth cube and of exact rays.

The comparison of figures 1, 2 and 10 of "GPU Rendering of Secondary Effects" (Bürger, Hertel, Krüger and Westermann
2007). A cube map is six pictures of the surroundings from one point, the middle of the teapot, and a mirrored direction
reads it wherever the ray begins. So it is right for what is far away: things nearby are mirrored at other places and in
other sizes, and the teapot sees nothing of itself, neither spout nor handle.

    python examples/cubemap.py [numpy|opencl|glsl]
"""

import sys

import numpy as np
from pictures import save

import shpy as sh
from raytracer import Camera, Hit, Material, PointLight, Renderer, Scene, Surface, render
from raytracer.meshes.shapes import box, floor, sphere
from raytracer.meshes.teapot import teapot
from raytracer.shaders import checker
from shpy.library import TextureCube

MIDDLE = np.array([0.0, 1.4, 0.0])
SHARE = 0.85
"""The share of the light that the teapot mirrors."""
DARK = {"color": (0, 0, 0), "diffuse": 0.0, "specular": 0.0}


def surroundings():
    """Return what the teapot mirrors: a checked floor, boxes and balls."""
    things = [
        floor(60, Material(surface=checker((0.7, 0.66, 0.6), (0.16, 0.17, 0.2), 40), specular=0.0)).moved(
            (0, -0.01, 0)
        ),
        box((1.2, 2.4, 1.2), Material((0.75, 0.2, 0.12))).moved((-2.6, 1.2, 2.6), turn=30),
        box((1.0, 1.0, 1.0), Material((0.2, 0.45, 0.75))).moved((1.9, 0.5, 3.4), turn=15),
        sphere(0.8, Material((0.9, 0.7, 0.15))).moved((3.6, 0.8, 1.8)),
        sphere(1.2, Material((0.2, 0.55, 0.25))).moved((-4.4, 1.2, -2.0)),
    ]
    lights = [PointLight((-5, 9, 7), (0.95, 0.9, 0.8)), PointLight((6, 8, -3), (0.3, 0.35, 0.45))]
    return Scene(things, lights, Camera((1.6, 4.4, 9.4), (0, 1.2, 0.4), fov=38), background=(0.45, 0.6, 0.85))


def cube_map(scene, eye, size, backend=None):
    """Return a `TextureCube` of what is seen from a point, six pictures of `size` x `size` pixels."""
    renderer, faces = Renderer(scene, backend=backend), []
    for corners in TextureCube.directions(2):
        above, below = corners.sum(axis=1)
        camera = Camera(eye, eye + above + below, above - below, fov=90)
        faces.append(renderer.render((size, size), camera=camera).pixels[:, ::-1])  # cubes are seen from outside
    return TextureCube(np.stack(faces))


def shown(material, size, divisions=15, **options):
    """Return the picture of a teapot of a material among its surroundings; `divisions` says how fine it is."""
    scene = surroundings()
    meshes = [*scene.meshes, teapot(material, divisions=divisions)]
    return render(Scene(meshes, scene.lights, scene.camera, scene.background), size, **options)


def by_cube_map(size, faces=256, divisions=15, **options):
    """Return the picture of the teapot that mirrors a cube map of `faces` x `faces` pixels on each side."""
    sky = cube_map(surroundings(), MIDDLE, faces, **options)

    def mapped(hit: Hit) -> Surface:
        return Surface(emission=SHARE * sky(sh.reflect(-hit.view, hit.normal)))

    return shown(Material(**DARK, surface=mapped), size, divisions, **options)


def by_rays(size, accel, divisions=15, **options):
    """Return the picture of the teapot whose mirrored rays go through an accelerator."""
    return shown(Material(**DARK, reflectivity=SHARE), size, divisions, accel=accel, **options)


if __name__ == "__main__":
    size, options = (400, 360), {"backend": sys.argv[1] if len(sys.argv) > 1 else None}
    images = [by_cube_map(size, **options), *(by_rays(size, accel, **options) for accel in ("ldc:512", "bvh"))]
    save("cubemap", np.hstack([image.srgb / 255 for image in images]))
