"""Answers that formulas give, to 1e-5: silhouette, depth, mirror image, slab, critical angle, furnace, blur circle.

Lambert's law under a light that fades with the square of the distance is in test_cameras.py, Fresnel's share at normal
incidence in test_glass.py. Where the formula is that of a sphere, rays go to vertices of the mesh: these lie on it.
"""

import dataclasses

import numpy as np
import pytest
from scene_pictures import BACKENDS
from test_cameras import places, wall
from test_glass import CLEAR, fresnel, rays_of

from raytracer import Camera, EnvironmentLight, Material, Renderer, Scene, Surface, render
from raytracer.meshes.shapes import box, floor, icosahedron, sphere

SHOWN = Material(surface=lambda hit: Surface(color=hit.position), specular=0)
NARROW, ROWS = 8e-5, 41
"""Radians that a narrow picture sees, and its pixels along each side: they are 2e-6 apart."""


def narrow(position, target, up=(0, 1, 0)):
    return Camera(position, target, up, fov=np.degrees(NARROW))


def edge(values):
    """The angle from the middle of a narrow picture, upwards, at which its middle column ends to be true."""
    column = values[:, ROWS // 2]
    assert column[-1]
    assert not column[0]
    first = int(column.argmax())
    assert column[first:].all()
    return (ROWS / 2 - first) * NARROW / ROWS


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_the_silhouette_of_a_sphere(backend):
    """From the distance 2 R it is seen under 60 degrees; the ring where rays touch it is one of the mesh's."""
    ball = sphere(1.5, rings=24, segments=48).moved(tilt=90)
    renderer = Renderer(Scene([ball]), backend=backend)
    for angle in np.radians([0, 90, 180, 270, 52.5]):
        across, up = np.cos(angle), np.sin(angle)
        touched = 1.5 * np.array([np.sqrt(0.75) * across, np.sqrt(0.75) * up, 0.5])
        assert np.abs(ball.vertices - touched).max(axis=1).min() < 1e-12
        image = renderer.render((ROWS, ROWS), camera=narrow((0, 0, 3), tuple(touched), (across, up, 0)))
        assert abs(edge(image.object_id == 0)) < 1e-5


def test_depth_and_normals_of_a_sphere():
    middle, radius, eye = np.array([0.3, -0.2, 0.5]), 1.5, np.array([2.0, 3, 4])
    ball = sphere(radius, rings=24, segments=48).moved(tuple(middle))
    renderer = Renderer(Scene([ball]), backend="numpy")
    seen = (ball.vertices - middle) @ (eye - middle) > 1.2 * radius**2
    for vertex in ball.vertices[seen][::17]:
        image = renderer.render((1, 1), camera=Camera(tuple(eye), tuple(vertex), fov=1))
        ray = (vertex - eye) / np.linalg.norm(vertex - eye)
        along = (middle - eye) @ ray
        depth = along - np.sqrt(along**2 - np.sum((middle - eye) ** 2) + radius**2)
        np.testing.assert_allclose(image.depth, depth, rtol=1e-5)
        np.testing.assert_allclose(image.normal[0, 0], (eye + depth * ray - middle) / radius, atol=1e-5)


def test_the_image_in_a_plane_mirror():
    """In a slanted mirror a wall is seen where the mirrored camera sees it through the mirror."""
    mirror = floor(40, Material((1, 1, 1), diffuse=0, specular=0, reflectivity=1)).moved((0, -1, 0), tilt=20)
    camera = Camera((0.5, 2, 5), (0.2, -1, 0), fov=20)
    far = floor(400, SHOWN).moved((0, 0, -30), tilt=90)
    scene = Scene([mirror, far], (), camera, background=(9, 9, 9), ambient=1)
    image = render(scene, (32, 24), backend="numpy", bounces=1)
    assert (image.object_id == 0).all()
    normal, point = mirror.face_normals[0], np.array([0, -1.0, 0])
    eye = np.array(camera.position) - 2 * ((camera.position - point) @ normal) * normal
    ray = rays_of(camera, 32, 24)
    ray = ray - 2 * (ray @ normal)[..., None] * normal
    expected = eye + ray * ((-30 - eye[2]) / ray[..., 2:])
    np.testing.assert_allclose(image.pixels, expected, atol=1e-5 * 30)


def test_displacement_through_a_slab():
    """Rays leave it as steep as before, moved by Snell's law."""
    camera, thick = Camera((0, 0, 5), (1.5, 0.5, 0), fov=40), 1.0
    found = []
    for material in (CLEAR, dataclasses.replace(CLEAR, ior=1.0)):
        meshes = [box((100, 100, thick), material), floor(200, SHOWN).moved((0, 0, -8), tilt=90)]
        scene = Scene(meshes, (), camera, background=(0, 0, 0), ambient=1.0)
        found.append(render(scene, (32, 24), backend="numpy", bounces=2).pixels.astype(np.float64))
    ray = rays_of(camera, 32, 24)
    sine = np.linalg.norm(ray[..., :2], axis=-1, keepdims=True)
    inside = sine / 1.5 / np.sqrt(1 - (sine / 1.5) ** 2)
    moved = (inside + sine / ray[..., 2:]) * thick * ray[..., :2] / sine
    shares = (1 - fresnel(-ray[..., 2:], 1.5)) ** 2
    np.testing.assert_allclose(found[0][..., :2] / shares - found[1][..., :2], moved, atol=1e-5 * 13)


def test_the_critical_angle():
    """In glass of 1.5, light leaves below asin(1 / 1.5) = 41.8 degrees and is wholly mirrored above."""
    meshes = [box((100, 100, 1), CLEAR), floor(1e5, Material((0, 1, 0), specular=0)).moved((0, 0, 8), tilt=90)]
    angle = np.arcsin(1 / 1.5)
    camera = narrow((0, 0, 0.2), (0, np.sin(angle), 0.2 + np.cos(angle)), (0, 1, 0))
    scene = Scene(meshes, (), camera, background=(0, 0, 0), ambient=1.0)
    image = render(scene, (ROWS, ROWS), backend="numpy", bounces=1)
    assert abs(edge(image.pixels[..., 1] > 0)) < 1e-5


@pytest.mark.slow
def test_the_white_furnace():
    """A surface that scatters all light has the colour of the light around it, in every pixel."""
    white = Material((1, 1, 1), diffuse=1, specular=0)
    scene = Scene([icosahedron(1, white)], [EnvironmentLight((1, 1, 1))], Camera((0, 0, 4)))
    image = render(scene, (16, 16), backend="numpy", integrator="path", samples=4, bounces=1)
    assert (image.object_id == 0).sum() > 50
    np.testing.assert_allclose(image.pixels, 1, atol=1e-5)


def test_the_circle_of_confusion_grows_as_it_should():
    """From a point p of the lens, an object at a distance d is shifted by the angle p (focus - d) / (focus d)."""
    near, far, focus, aperture = 2.0, 8.0, 4.0, 0.5
    pinhole = Camera((0, 0, 0), (0, 0, -1), fov=40)
    lens = dataclasses.replace(pinhole, aperture=aperture, focus=focus)
    size = (32, 32)
    before, behind = (
        (places(lens, [wall(-d)], size) - places(pinhole, [wall(-d)], size))[..., :2].astype(np.float64) / d
        for d in (near, far)
    )
    radius = aperture * (focus - near) / focus / 2 / near
    assert 0.99 * radius < np.linalg.norm(before, axis=-1).max() < radius + 1e-5
    expected = before * near / (focus - near) * (focus - far) / far
    np.testing.assert_allclose(behind, expected, atol=1e-5)
