"""Whole frames: a mesh on a mirror under a point light, one bounce, shadows, against Mitsuba.

    for work in works(mesh):
        ...

All draw the same picture, which is why the mesh is matt, flat and grey, the floor a perfect mirror without a colour of
its own, the background black, and the light so far away that its falloff cannot be seen. Mitsuba's `path` integrator
does more than that: it also follows light from one part of the mesh to another, which it cannot be told not to. A
tracer of its own, written with its Python interface, does exactly what ours does. One ray a pixel: ours through the
middle, Mitsuba's `path` anywhere in it, so pictures are compared by the means of squares of 8 pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from benchmarks.rays import mitsuba_eye_rays, mitsuba_scene, mitsuba_sensor
from benchmarks.work import Work
from raytracer import Camera, Image, Material, Mesh, PointLight, Scene
from raytracer.integrators.renderer import Renderer
from raytracer.meshes.shapes import floor
from shpy.backend.opencl.device.run import HURRIED

NAMES = ("frame-256", "frame-1024")
MATT = Material(color=(0.5, 0.5, 0.5), diffuse=1.0, specular=0.0)
MIRROR = Material(color=(0.0, 0.0, 0.0), diffuse=0.0, specular=0.0, reflectivity=1.0)
SQUARE = 8


def works(mesh: Mesh) -> list[Work]:
    """Return the two works of a mesh."""
    return [_work(mesh, size) for size in (256, 1024)]


def _work(mesh: Mesh, size: int) -> Work:
    work = Work(
        f"frame-{size}",
        f"{mesh.name}, {len(mesh):,} triangles, on a mirror, one light, {{size}} x {{size}} pixels",
        inputs=lambda size: (size,),
        size=size,
        quick=32 if size == 256 else 64,
        within=0.06,
        share=0.03,
        note="`path` also follows light between the mesh's own parts; the tracer of its own does what ours does.",
    )
    work.seen = squares
    slow = ("numpy",) if size == 256 else ()
    work.ours_on("opencl", "plain", "glsl", *slow)(partial(_ours, mesh=mesh))
    work.version("mitsuba")(partial(_mitsuba_path, mesh=mesh))
    work.version("whitted")(partial(mitsuba_whitted, mesh=mesh))
    return work


@cache
def scene_of(mesh: Mesh, lights: int = 1) -> Scene:
    """Return the mesh on its mirror, as ours."""
    low, high = mesh.corners.min(axis=(0, 1)), mesh.corners.max(axis=(0, 1))
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    ground = floor(40 * radius, MIRROR).moved((float(middle[0]), float(low[1]) - 1e-3 * radius, float(middle[2])))
    directions = [(math.sin(1 - 0.7 * k), 1.2, math.cos(1 - 0.7 * k)) for k in range(lights)]
    places = [middle + 300 * radius * np.asarray(d) for d in directions]
    point_lights = [PointLight((p[0], p[1], p[2]), (1.0 / lights,) * 3) for p in np.array(places).tolist()]
    plain = replace(mesh, normals=None, colors=None, material=MATT)
    camera = Camera.framing(low, high)
    return Scene((plain, ground), point_lights, camera, background=(0, 0, 0), ambient=0.0)


def squares(pixels: np.ndarray) -> np.ndarray:
    """Return the means (h, w, 3) of squares of pixels."""
    n = len(pixels) // SQUARE
    return pixels.reshape(n, SQUARE, n, SQUARE, 3).mean(axis=(1, 3))


def settled(renderer: Renderer, size: int, samples: int | None = None) -> Callable[[], Image]:
    """Return the call that draws a square picture, after calls until the driver has optimized the kernel.

    A large kernel is built without optimization first. A picture of the features would take up to four times as long.
    """
    run = partial(renderer.render, (size, size), samples=samples)
    run()
    while HURRIED in getattr(renderer.kernel, "notes", ()):
        run()
    return run


def _ours(compiled: Any, size: int, mesh: Mesh) -> Any:
    run = settled(Renderer(scene_of(mesh), backend=compiled.keywords.get("backend"), bounces=1), size)
    return lambda: run().pixels


def _mitsuba_path(size: int, mesh: Mesh) -> Any:
    import mitsuba as mi

    scene, camera = mitsuba_scene(scene_of(mesh)), scene_of(mesh).camera
    assert camera is not None
    sensor = mitsuba_sensor(camera, size)
    integrator = mi.load_dict({"type": "path", "max_depth": 3, "rr_depth": 100})
    return lambda: np.asarray(mi.render(scene, sensor=sensor, integrator=integrator, spp=1))[..., :3]


def mitsuba_whitted(size: int, mesh: Mesh) -> Any:
    """Render with a tracer in Mitsuba that computes the same as ours; the picture is (size, size, 3).

    Its rays start a millionth of the mesh's size off a surface. Those of Mitsuba's own `spawn_ray` start 9e-5 off, and
    farther where coordinates are large, which moves shadows and mirror images of small meshes by more than a pixel.
    """
    import drjit as dr
    import mitsuba as mi

    scene = mitsuba_scene(scene_of(mesh))
    light = scene_of(mesh).lights[0]
    assert isinstance(light, PointLight)
    mirror = scene.shapes()[1]
    place = mi.Point3f(*light.position)
    off = 1e-6 * float(np.linalg.norm(np.ptp(mesh.corners, axis=(0, 1)))) / 2

    def run() -> np.ndarray:
        eye = mitsuba_eye_rays(mesh, size)
        seen = scene.ray_intersect(eye, mi.RayFlags.Minimal, coherent=True)
        mirrored = seen.is_valid() & (seen.shape == mi.ShapePtr(mirror))
        ray = mi.Ray3f(seen.p + off * seen.n, mi.reflect(-eye.d, seen.n))
        again = scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=True, active=mirrored)
        seen = dr.select(mirrored, again, seen)
        normal = dr.select(dr.dot(seen.n, dr.select(mirrored, ray.d, eye.d)) > 0, -seen.n, seen.n)
        toward = place - seen.p
        cosine = dr.dot(normal, dr.normalize(toward))
        lit = seen.is_valid() & (seen.shape != mi.ShapePtr(mirror)) & (cosine > 0)
        lit &= ~scene.ray_test(mi.Ray3f(seen.p + off * normal, toward, 1.0, 0.0, []), coherent=True, active=lit)
        value = dr.select(lit, 0.5 * cosine, 0)
        return np.asarray(value).reshape(size, size, 1).repeat(3, axis=2)

    return run
