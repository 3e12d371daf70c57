"""A small scene that several files render, and comparisons: of all layers of pictures, of hits, of frames."""

import dataclasses

import numpy as np

from raytracer import Camera, DirectionalLight, Material, MetallicRoughness, PointLight, Renderer, Scene, render
from raytracer.meshes.shapes import box, floor, icosahedron, sphere

BACKENDS = ["numpy", "opencl", "glsl"]
SIZE = (24, 18)
CAMERA = Camera((0, 2, 5), (0, 0.3, 0), fov=30)
"""The eye before a ball or two on a floor."""
LIGHTS = (PointLight((3, 5, 4), (0.8, 0.7, 0.6)), DirectionalLight((1, -2, -1), (0.3, 0.3, 0.5)))


def small(ground=12, **changes):
    """Return a smooth mirror, flat bodies and a floor of this size under two lights; `changes` replace parts."""
    meshes = [
        sphere(1.0, Material((0.7, 0.7, 0.8), reflectivity=0.4), rings=6, segments=10).moved((0, 1, 0)),
        box((1, 1, 1), Material((0.9, 0.3, 0.2))).moved((1.4, 0.5, 0.8), turn=30),
        icosahedron(0.6, Material((0.2, 0.6, 0.3), specular=0.6)).moved((-1.3, 0.5, 0.9)),
        floor(ground, Material((0.5, 0.5, 0.5), specular=0.0, reflectivity=0.2)),
    ]
    parts = {"meshes": meshes, "lights": LIGHTS, "camera": Camera((1, 2.5, 6), (0, 0.7, 0), fov=45)}
    return Scene(**(parts | changes))


def two_balls(left, right, **changes):
    """Return balls of two materials on a floor under a point light; `changes` replace parts."""
    balls = [sphere(0.5, material, rings=8, segments=12) for material in (left, right)]
    meshes = [balls[0].moved((-0.6, 0.5, 0)), floor(4, MetallicRoughness()), balls[1].moved((0.6, 0.5, 0))]
    return Scene(meshes, **{"lights": [PointLight((2, 4, 3))], "camera": CAMERA, **changes})


def same(found, wanted):
    """Assert that all layers of two pictures have the same bits."""
    for name, layer in wanted.layers.items():
        assert found.layers[name].dtype == layer.dtype, name
        np.testing.assert_array_equal(found.layers[name].view(np.uint32), layer.view(np.uint32), err_msg=name)


def same_everywhere(scene, size, backends=BACKENDS, **options):
    """Render a scene on backends, assert that all layers have the same bits, and return the picture."""
    first, *others = (render(scene, size, backend=backend, **options) for backend in backends)
    for other in others:
        same(other, first)
    return first


def same_arrays(found, expected):
    """Assert that each array, such as the fields of hits, equals the other one."""
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def frames(scenes):
    """Yield a picture of each scene, by one Renderer that is shown them and seldom builds everything anew."""
    first, *others = scenes
    renderer = Renderer(first, backend="numpy")
    yield renderer.render(SIZE)
    for scene in others:
        renderer.show(scene)
        yield renderer.render(SIZE)
    assert renderer.builds <= 3


def check_other_numbers(scene, size, **numbers):
    """Assert that a Renderer shows the first mesh with other numbers of its material, and builds nothing for it."""
    first, *others = scene.meshes
    material = dataclasses.replace(first.material, **numbers)
    changed = dataclasses.replace(scene, meshes=[first.with_material(material), *others])
    renderer = Renderer(scene, backend="numpy")
    renderer.show(changed)
    same(renderer.render(size), render(changed, size, backend="numpy"))
    assert renderer.builds == 1


def turned(angle, offset=(0, 0, 0), scale=(1, 1, 1)):
    """Return the matrix (4, 4) that scales along the axes, turns about y by an angle in radians, and moves."""
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) * scale, offset])
    return matrix
