"""Objects that move in scenes whose secondary rays go through layered depth cubes."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from scene_pictures import SIZE, same, turned

from raytracer import Camera, LayeredCube, Material, PointLight, Renderer, Scene
from raytracer.integrators import motion
from raytracer.meshes.shapes import box, floor, sphere

MIRROR = Material((0.8, 0.3, 0.2), reflectivity=0.4)


def scene(*placed):
    """Return a ball and a box over a mirroring floor, each where a matrix takes it."""
    ball, brick = sphere(0.6, MIRROR, rings=6, segments=10), box((0.7, 0.9, 0.5), MIRROR).moved((1.4, 0, 0))
    meshes = [floor(6, Material(reflectivity=0.2)).moved((0, -1, 0)), ball, brick]
    for number, matrix in enumerate(placed, 1):
        meshes[number] = meshes[number].transformed(matrix)
    return Scene(meshes, [PointLight((3, 6, 5), (0.8, 0.8, 0.7))], Camera((0, 2, 6), (0, 0, 0), fov=45))


MOVES = [
    (np.eye(4), turned(0.4)),
    (turned(0.7, (0.3, 0.2, -0.4)), turned(-0.5, (0, 0, 0.3))),
    (turned(0.1, (0, 0.3, 0), (-1, 1.5, 1)), turned(2, (-0.8, 0, -1), (0.5, 0.5, 0.5))),
]


@pytest.fixture(scope="module")
def exact():
    """Return the picture after a move with exact secondary rays, rendered once."""
    return cache(lambda move, **options: Renderer(scene(*MOVES[move]), **options).render(SIZE))


@pytest.fixture
def made(monkeypatch):
    """The cubes that are made, as the numbers of their triangles."""
    counts, own = [], motion._build_cube

    def counted(*given):
        found = own(*given)
        counts.append(len(found.triangles) // 3)
        return found

    monkeypatch.setattr(motion, "_build_cube", counted)
    return counts


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
@pytest.mark.parametrize("options", [{"bounces": 2}, {"integrator": "path", "samples": 1}], ids=["whitted", "path"])
def test_rigid_objects_keep_their_cubes_and_the_pictures_are_exact(backend, options, made, exact):
    renderer = Renderer(scene(), accel="ldc:64:triangle", backend=backend, **options)
    ball = len(scene().meshes[1])
    for number, move in enumerate(MOVES):
        renderer.move(1, move[0])
        renderer.move(2, move[1])
        same(renderer.render(SIZE), exact(number, backend=backend, **options))
    assert made == [14 + ball, 2, ball, 12]
    assert renderer.builds == 2


@pytest.mark.slow
def test_a_deformed_object_has_a_new_cube_and_the_others_keep_theirs(made):
    renderer = Renderer(scene(), accel="ldc:64:triangle", backend="numpy", bounces=2)
    ball = scene().meshes[1]
    renderer.move(1, np.eye(4))
    renderer.move(2, turned(0.4))
    renderer.render(SIZE)
    flat = turned(0, (0, 0.2, 0), (1, 0, 1))
    for k, matrix in enumerate([turned(0.5, (0.3, 0, 0)), flat, turned(0.2)]):
        vertices = ball.vertices * (1, 1 + 0.3 * min(k, 1), 1)
        renderer.deform(1, vertices)
        renderer.move(1, matrix)
        wanted = scene(np.eye(4), turned(0.4))
        meshes = list(wanted.meshes)
        meshes[1] = ball.with_vertices(vertices, None).smoothed().transformed(matrix)
        same(
            renderer.render(SIZE),
            Renderer(dataclasses.replace(wanted, meshes=meshes), backend="numpy", bounces=2).render(SIZE),
        )
    assert made == [14 + len(ball), 2, len(ball), 12, *[len(ball)] * 3]


@pytest.mark.slow
def test_objects_take_the_options_of_a_cube_that_is_handed_over(made):
    cube = LayeredCube.of(scene(), 32, block=8, hit="plane", backend="numpy")
    renderer = Renderer(scene(), secondary=cube, backend="numpy")
    renderer.render(SIZE)
    assert not made
    renderer.move(1, turned(0.5))
    renderer.render(SIZE)
    assert renderer.layout.secondary.options == cube.options
    assert len(made) == 2


@pytest.mark.slow
@pytest.mark.parametrize(("hit", "most"), [("16:plane", 1.0), ("64:sample", 1.0)])
def test_the_errors_of_moved_cubes_are_small(hit, most, exact):
    """Root mean squares, in 255ths, against the exact picture; planes of 64 and more texels have none here."""
    renderer, errors = Renderer(scene(), accel=f"ldc:{hit}", backend="numpy", bounces=2), []
    for number, move in enumerate(MOVES):
        renderer.move(1, move[0])
        renderer.move(2, move[1])
        expected = exact(number, backend="numpy", bounces=2)
        errors.append(np.sqrt(np.mean((renderer.render(SIZE).srgb.astype(float) - expected.srgb) ** 2)))
    assert 0 < max(errors) < most, errors
