"""The light of an environment in Whitted's tracers: its table against integrals, pictures against closed forms."""

import numpy as np
import pytest

import shpy as sh
from raytracer import (
    Camera,
    EnvironmentLight,
    Material,
    MetallicRoughness,
    Path,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    Staged,
    Texture,
    Whitted,
    render,
)
from raytracer.appearance.prefiltered import LEVELS, ROWS, lobe_of, means, prefiltered
from raytracer.meshes.shapes import floor, sphere

SLOPE = np.array([[0.4, 0.0, 0.1], [0.1, 0.5, -0.2], [0.0, 0.2, 0.3]])
"""Radiance 0.5 + SLOPE @ d in the direction d."""
GOLD = (1.0, 0.77, 0.34)


def gradient(direction: sh.Vector3f) -> sh.Color3f:
    return sh.Color3f(0.5, 0.5, 0.5) + sh.Matrix3f(SLOPE) @ direction


def directions_of(rows):
    """Return the directions of the middles of texels, (rows, 2 rows, 3)."""
    down = (np.arange(rows)[:, None] + 0.5) * np.pi / rows
    turn = (np.arange(2 * rows) + 0.5) * np.pi / rows - np.pi
    return np.stack(
        np.broadcast_arrays(np.sin(down) * np.sin(turn), np.cos(down), -np.sin(down) * np.cos(turn)), axis=-1
    )


def ball(material, x=0.0, z=0.0):
    return sphere(0.5, material, rings=24, segments=48).moved((x, 0, z))


def scene_of(meshes, light, **named):
    return Scene(meshes, [light], Camera((0, 0, 4), (0, 0, 0), fov=30), **named)


METALS = [
    ball(MetallicRoughness(GOLD, 1, 0.3), -1.2),
    ball(MetallicRoughness(GOLD, 1, 0.5, clearcoat=1, clearcoat_roughness=0.1), 0),
    ball(MetallicRoughness((0.2, 0.4, 0.8), 0, 0.1, sheen_color=(0.5, 0.5, 0.5), sheen_roughness=0.5), 1.2),
    ball(Material((0.8, 0.2, 0.2), specular=0.1, reflectivity=(0.2, 0.1, 0.3)), 0, -1.2),
]
CLEAR = [
    ball(MetallicRoughness((0.9, 1, 0.9), 0, 0.3, transmission=0.8), 1.2, 1),
    ball(Material(transmission=0.9, ior=1.5, diffuse=0.5, specular=0.1), -0.4, 1),
]


def test_even_light_is_the_same_at_every_roughness():
    even = np.full((ROWS, 2 * ROWS, 3), (0.1, 1, 1000), np.float32)
    np.testing.assert_array_equal(prefiltered(even), np.broadcast_to(even, (LEVELS, *even.shape)))


def test_levels_of_a_gradient_are_the_integrals_of_the_lobes():
    """By symmetry the mean of a + b d about the direction r is a + s b r, with s the mean of the cosine."""
    shown = directions_of(ROWS)
    levels = prefiltered(0.5 + shown @ SLOPE.T)
    cosines = (np.arange(1 << 16) + 0.5) / (1 << 16)  # a zone's area is that of its height
    for number, level in enumerate(levels, 1):
        s = np.average(cosines, weights=lobe_of(cosines, number / LEVELS))
        np.testing.assert_allclose(level, 0.5 + s * shown @ SLOPE.T, atol=0.002)
    np.testing.assert_allclose(s, 2 / 3, atol=1e-6)


def test_a_level_is_the_sum_over_all_directions():
    """Noise is blurred as a sum over every pair of cells says, on a smaller sphere, where that takes no time."""
    rows, rng = 12, np.random.default_rng(7)
    cells, places = rng.random((rows, 2 * rows, 3)), directions_of(rows).reshape(-1, 3)
    areas = np.repeat(-np.diff(np.cos(np.linspace(0, np.pi, rows + 1))), 2 * rows)
    for number, level in enumerate(prefiltered(cells), 1):
        weights = lobe_of(places @ places.T, number / LEVELS) * areas
        expected = weights @ cells.reshape(-1, 3) / weights.sum(axis=1, keepdims=True)
        np.testing.assert_allclose(level, expected.reshape(cells.shape), rtol=1e-6)


@pytest.mark.parametrize("size", [(5, 10), (64, 100), (100, 260)])
def test_means_over_cells_keep_all_light(size):
    picture = np.random.default_rng(1).random((*size, 3)) ** 8
    areas, cells = (-np.diff(np.cos(np.linspace(0, np.pi, n + 1)))[:, None, None] for n in (size[0], ROWS))
    light = (means(picture, ROWS, 2 * ROWS) * cells).sum(axis=(0, 1)) / (2 * ROWS)
    np.testing.assert_allclose(light, (picture * areas).sum(axis=(0, 1)) / size[1])


def test_a_white_matt_ball_shows_the_mean_above_each_normal():
    meshes = [ball(Material((1, 1, 1), diffuse=1, specular=0))]
    for light, factor in ((EnvironmentLight(gradient), 1), (EnvironmentLight(gradient, strength=2), 2)):
        image = render(scene_of(meshes, light, ambient=0.7), (24, 24), backend="numpy")
        seen = image.object_id == 0
        expected = factor * (0.5 + 2 / 3 * image.normal[seen] @ SLOPE.T)
        np.testing.assert_allclose(image.pixels[seen], expected, atol=0.002 * factor)


@pytest.mark.slow
def test_a_white_furnace_gives_at_most_its_light():
    """A picture of even light is a table, a colour is not: both give the albedo."""
    brushed = MetallicRoughness((1, 1, 1), 1, 0.6, anisotropy=0.7, multiscatter=True, clearcoat=0.5)
    body = MetallicRoughness((1, 1, 1), 0, 0.3, transmission=1, thickness=1)
    meshes = [*METALS, *CLEAR, ball(Material((1, 1, 1), diffuse=1, specular=0), -1.2, 1)]
    sharp = MetallicRoughness((1, 1, 1), 0.75, 0.0, specular=0.1, anisotropy=1)
    meshes += [ball(material, x, 2) for material, x in ((brushed, 0.4), (body, -0.5))]
    meshes += [ball(sharp).moved((0, 0.9, -1))]
    scenes = [scene_of(meshes, EnvironmentLight(light)) for light in ((1, 1, 1), np.ones((4, 8, 3), np.float32))]
    images = [render(scene, (48, 32), backend="numpy") for scene in scenes]
    np.testing.assert_allclose(images[0].pixels, images[1].pixels, rtol=1e-5)
    assert images[0].pixels.max() <= 1 + 1e-6
    np.testing.assert_allclose(images[0].pixels[images[0].object_id == 6], 1)


@pytest.mark.slow
def test_balls_in_the_open_resemble_their_path_traced_pictures():
    """The two differ by the lobe, which is not round in path tracing, and by what the balls hide from each other."""
    meshes = [ball(MetallicRoughness(GOLD, 1, r), 2 * k - 3) for k, r in enumerate((0, 0.3, 0.7, 1))]
    scene = Scene(meshes, [EnvironmentLight(gradient)], Camera((0, 0, 9), (0, 0, 0), fov=10))
    integrators = Whitted(samples=16), Path(samples=64, bounces=4)
    image, traced = (render(scene, (48, 12), integrator=i, backend="numpy") for i in integrators)
    for number, bound in enumerate((0.01, 0.03, 0.03, 0.03)):
        both = (image.object_id == number) & (traced.object_id == number) & (image.normal[..., 2] > 0.5)
        difference = image.pixels[both] - traced.pixels[both]
        assert abs(difference.mean()) < 0.01
        assert np.sqrt((difference**2).mean()) < bound


@pytest.mark.slow
@pytest.mark.parametrize("clear", [False, True])
def test_backends_and_tracers_agree_to_the_bit(clear):
    meshes = [*METALS, *(CLEAR if clear else ()), floor(4, Material((0.5, 0.5, 0.5))).moved((0, -0.5, 0))]
    picture = Texture(np.random.default_rng(3).random((6, 12, 3)).astype(np.float32))
    lights = [EnvironmentLight(picture, rotation=40, strength=1.5), PointLight((2, 4, 3))]
    scene = Scene(meshes, lights, Camera((0, 0, 4), (0, 0, 0), fov=30))
    expected = render(scene, (20, 12), backend="numpy").pixels
    for other in (
        {"backend": "opencl" if clear else "numpy", "integrator": Whitted() if clear else Staged()},
        {"backend": "glsl"},
    )[: 1 + clear]:
        np.testing.assert_array_equal(render(scene, (20, 12), **other).pixels, expected)


@pytest.mark.slow
def test_objects_move_and_precisions_agree_under_an_environment():
    """A move sends places alone; binary64 and binary16 show the light of binary32."""
    light = EnvironmentLight(gradient)
    place = np.eye(4)
    place[:3, 3] = 0.5, 0.25, -1
    renderer = Renderer(scene_of(METALS, light), backend="numpy")
    before = renderer.render((20, 12)).pixels
    renderer.move(0, place)
    moved = scene_of([METALS[0].transformed(place), *METALS[1:]], light)
    expected = render(moved, (20, 12), backend="numpy").pixels
    np.testing.assert_array_equal(renderer.render((20, 12)).pixels, expected)
    assert (before != expected).any()
    assert renderer.builds <= 2
    for precision, bound in (("f64", 2.0**-20), ("f16", 2.0**-9)):  # 8 and 2 units in the last place of 1
        other = render(moved, (20, 12), integrator=Whitted(precision=precision), backend="numpy").pixels
        assert np.quantile(np.abs(other - expected), 0.9) < bound


def test_a_ray_keeps_the_roughness_of_the_mirrors_that_it_has_met():
    """Rays from a smooth mirror to a rough one, back and up miss the sun by some degrees: only a blurred one shows."""
    sun = np.zeros((32, 64, 3), np.float32)
    sun[9, 32] = 100
    rough, smooth = MetallicRoughness((1, 1, 1), 1, 0.25), Material((0, 0, 0), diffuse=0, specular=0, reflectivity=1)
    wall = floor(4, rough).moved((0, 0, -2), tilt=90)
    behind = floor(9, smooth).moved((0, 0, 6), tilt=90)
    scene = Scene([wall, behind], [EnvironmentLight(sun)], Camera((0, 0, 4), (0, 0, 6), fov=40))
    shown = [render(scene, (16, 16), integrator=Whitted(bounces=b), backend="numpy").pixels.max() for b in (2, 3)]
    assert shown[0] < 1e-3 < shown[1] < 20


@pytest.mark.slow
def test_lights_and_meshes_change_under_an_environment():
    scene = scene_of(METALS, EnvironmentLight(gradient))
    renderer = Renderer(scene, backend="numpy")
    first = renderer.render((12, 8)).pixels
    other = Scene(METALS, scene.lights, scene.camera, background=(1, 0, 0), ambient=0.9)
    renderer.show(other)
    np.testing.assert_array_equal(renderer.render((12, 8)).pixels, first)
    assert renderer.builds == 1


def test_programs_that_have_no_mean_and_shades_are_refused():
    def endless(direction: sh.Vector3f) -> sh.Color3f:
        return sh.Color3f(1 / (direction.y - direction.y), 0, 0)

    with pytest.raises(SceneError, match="a number that is not finite for some direction"):
        render(scene_of(METALS, EnvironmentLight(endless)), (4, 3), backend="numpy")

    def shade(surface, light):
        return surface.color

    message = r"shade \(test_light_around.py:\d+\): a shade says how light from one direction looks"
    with pytest.raises(SceneError, match=message):
        render(scene_of([ball(Material(shade=shade))], EnvironmentLight(gradient)), (4, 3), backend="numpy")
