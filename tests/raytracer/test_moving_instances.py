"""Instances that share triangles and change between pictures: each picture is that of a new scene, to the bit."""

import numpy as np
import pytest

from raytracer import (
    Camera,
    Instance,
    Material,
    Path,
    PointLight,
    Renderer,
    Scene,
    Whitted,
)
from raytracer.meshes.shapes import floor, icosahedron, sphere

BACKENDS = ["numpy", "opencl", "glsl"]
SIZE = (32, 24)
GROUND = floor(9, Material((0.5, 0.6, 0.5))).moved((0, -1, 0))
BALL = sphere(0.5, Material((0.9, 0.5, 0.2), reflectivity=0.3), rings=6, segments=9)
STONE = icosahedron(0.4, Material((0.4, 0.5, 0.9)))
CAMERA = Camera((1, 2, 6), (0, 0, 0))
WHITTED, PATH = Whitted(accel="instances", bounces=1), Path(accel="instances", samples=1, bounces=2)


def place(number, shift=0.0):
    random = np.random.default_rng(number)
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3] = turn * random.uniform(0.5, 1, 3) * (-1) ** number  # every other one is mirrored
    matrix[:3, 3] = random.uniform(-1.5, 1.5, 3) + (shift, 0, 0)
    return matrix


def scene_of(shift=0.0, meshes=(BALL, STONE), count=4):
    parts = [Instance(mesh, place(k, shift * (k == 1)), f"{mesh.name} {k}") for k in range(count) for mesh in meshes]
    return Scene([GROUND, *parts], [PointLight((3, 8, 5))], CAMERA)


def assert_same(one, other):
    for name in ("pixels", "depth", "normal", "object_id"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    "integrator", [WHITTED, Path(accel="instances", samples=1, bounces=2)], ids=["whitted", "path"]
)
def test_moved_instances_are_those_of_a_new_scene(backend, integrator, monkeypatch):
    monkeypatch.setattr("raytracer.kernels.walk.MANY", 10)  # scattered rays walk alone
    before, after = scene_of(), scene_of(0.7)
    renderer = Renderer(before, integrator=integrator, backend=backend)
    first = renderer.render(SIZE)
    for number in (3, 4):
        relative = after.meshes[number].transform @ np.linalg.inv(before.meshes[number].transform)
        renderer.move(number, np.round(relative, 12))
    moved = renderer.render(SIZE)
    assert renderer.builds == 1
    assert np.count_nonzero(moved.object_id != first.object_id) > 5
    assert_same(moved, Renderer(renderer.scene, integrator=integrator, backend=backend).render(SIZE))
    renderer.show(after)
    assert_same(renderer.render(SIZE), Renderer(after, integrator=integrator, backend=backend).render(SIZE))
    assert renderer.builds == 1
