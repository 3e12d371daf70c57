"""Noise: shifted points of Sobol', their strata, what they leave in pictures, and what `clamp` cuts."""

from typing import NamedTuple

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
    Texture,
    render,
)
from raytracer.kernels.emitters import EVERYWHERE, BrightCells, aimed_weights
from raytracer.kernels.points import part_of, reversed_bits, sobol_pair
from raytracer.meshes.shapes import box, floor

GREY = Material((0.8, 0.8, 0.8), diffuse=1, specular=0)
LAMP = box((1, 0.1, 1), Material((0, 0, 0), emission=(9, 9, 9))).moved((0, 2, 0))


class Point(NamedTuple):
    across: sh.Attrib1u
    down: sh.Attrib1u


class Place(NamedTuple):
    down: sh.Attrib1f
    across: sh.Attrib1f
    density: sh.Attrib1f


@sh.program
def point_of(number: sh.Attrib1u, seed: sh.Attrib1u) -> Point:
    return Point(*sobol_pair(reversed_bits(number), seed))


@pytest.mark.parametrize(("first", "bits"), [(0, 10), (1 << 20, 6), (64, 6), (3 << 8, 8)])
def test_every_elementary_interval_has_one_point(first, bits):
    for seed in (0, 1, 0xDEADBEEF):
        numbers = np.arange(first, first + (1 << bits), dtype=np.uint32)
        across, down = (np.asarray(word, np.uint64) for word in point_of.compile("numpy")(numbers, np.uint32(seed)))
        for wide in range(bits + 1):
            cell = (across >> np.uint64(32 - wide)) << np.uint64(bits - wide) | down >> np.uint64(32 - bits + wide)
            assert len(np.unique(cell)) == 1 << bits


def test_pairs_of_different_seeds_are_independent():
    """Points of 120 pairs of seeds, which are hashes in path tracing, correlate as random orders do."""
    numbers, seeds = np.arange(4096, dtype=np.uint32), np.random.default_rng(5).integers(0, 2**32, 16)
    points = [point_of.compile("numpy")(numbers, np.uint32(seed)) for seed in seeds]
    for coordinate in range(2):
        correlations = np.corrcoef([p[coordinate] / 2.0**32 for p in points])[np.triu_indices(16, 1)]
        assert abs(correlations).max() < 5 / np.sqrt(len(numbers))
        assert abs(correlations.mean()) < 5 / np.sqrt(len(numbers) * len(correlations))


def test_a_word_chooses_its_part_of_the_places():
    @sh.program
    def place(word: sh.Attrib1u, count: sh.Attrib1u) -> sh.Attrib1u:
        return part_of(word, count)

    rng = np.random.default_rng(2)
    words = np.concatenate([[0, 1, 2**16, 2**31, 2**32 - 1], rng.integers(0, 2**32, 500)]).astype(np.uint32)
    counts = np.array([1, 2, 3, 65535, 65536, 65537, 1 << 20, 16777213, 2**32 - 1], np.uint32)[:, None]
    expected = (words.astype(object) * counts.astype(object)) >> 32
    np.testing.assert_array_equal(place.compile("numpy")(words, counts), expected.astype(np.uint32))


@pytest.mark.slow
def test_pictures_have_less_noise_than_of_independent_numbers(capsys):
    """Pictures of one sample have independent numbers, as their seeds differ: so has the mean of 64 of them."""
    size, renderer = (24, 24), Renderer(Scene.builtin("cornell"), integrator=Path(samples=64), backend="opencl")

    def picture(seed, samples):
        renderer.params["seed"].value = seed
        object.__setattr__(renderer.integrator, "seed", seed)
        return np.minimum(renderer.render(size, samples=samples).pixels, 4)

    reference = np.mean([picture(seed, 1024) for seed in (1001, 1002)], axis=0)
    mixed = np.mean([picture(seed, 1) for seed in range(64)], axis=0)
    errors = [np.sqrt(np.mean((pixels - reference) ** 2)) for pixels in (picture(7, 64), mixed)]
    with capsys.disabled():
        print(f" error of 64 samples: {errors[0]:.4f} of points, {errors[1]:.4f} of independent numbers ", end="")
    assert errors[0] < 0.5 * errors[1]


@pytest.mark.parametrize("shape", [(5, 7), (1, 1), (4, 1)])
def test_words_choose_cells_in_proportion_to_their_brightness(shape):
    """A lattice of words finds each cell as often as its share says, and beyond dark ones at the end none."""
    weights = np.random.default_rng(1).random(shape) ** 4 + 0.01
    weights[-1] *= 1e-12 if shape[0] > 1 else 1
    cells = BrightCells(weights)

    @sh.program
    def chosen(first: sh.Attrib1u, second: sh.Attrib1u) -> Place:
        return Place(*cells.choose(first, second))

    words = np.arange(256, dtype=np.uint32) << 24
    first, second = (axis.ravel() for axis in np.meshgrid(words, words, indexing="ij"))
    down, across, density = chosen.compile("numpy")(first, second)
    shares = weights / weights.sum()
    np.testing.assert_allclose(
        np.histogram2d(down, across, shape, [(0, shape[0]), (0, shape[1])])[0] / 2**16, shares, atol=0.01
    )
    places = np.minimum(down.astype(int), shape[0] - 1), np.minimum(across.astype(int), shape[1] - 1)
    np.testing.assert_allclose(density, shares[places] * weights.size / (4 * np.pi), rtol=1e-5, atol=1e-9)
    assert np.all(np.diff(down.reshape(256, 256), axis=0) >= 0)


def test_rays_are_aimed_at_what_is_brighter_than_the_mean():
    np.testing.assert_allclose(aimed_weights(np.array([[1.0, 1.0], [2.0, 4.0]])) - 2 * EVERYWHERE, [[0, 0], [0, 2]])
    for even in (0.0, 3.0):
        weights = aimed_weights(np.full((2, 4), even))
        assert weights.min() == weights.max() > 0


@pytest.mark.slow
def test_a_wall_has_the_light_of_the_half_of_a_turned_environment_that_it_faces():
    """In a transparent picture, by parts of it, and by samples that are continued; each texel is an eighth."""
    sky = np.array([[1, 30, 2, 5], [3, 0, 7, 1.0]])
    light = EnvironmentLight(Texture(np.repeat(sky[..., None], 3, axis=2), filter="nearest"), 90, 1.5)
    white = Material((1, 1, 1), diffuse=1, specular=0)
    wall = Scene([box((9, 9, 1), white).moved((0, 0, -0.5))], [light], Camera((0, 0, 4), (0, 0, 0), fov=30))
    size, renderer = (24, 16), Renderer(wall, integrator=Path(samples=8, bounces=1), backend="numpy")
    whole = renderer.render(size, transparent=True)
    assert whole.alpha.min() == 1
    assert whole.pixels.mean() == pytest.approx(1.5 * sky[:, :2].mean(), rel=0.01)
    part = renderer.render(size, samples=3, transparent=True)
    rows = [renderer.rows(size, top, 8, transparent=True)["pixels"] for top in (0, 8)]
    for other in (renderer.render(size, resume=part, transparent=True).pixels, np.concatenate(rows)):
        np.testing.assert_array_equal(other, whole.pixels)


@pytest.mark.slow
@pytest.mark.parametrize("transparent", [False, True])
def test_backends_agree_on_clamped_light_of_a_bright_environment(transparent):
    sky = np.random.default_rng(1).random((5, 10, 3)) ** 3
    sky[1, 2] = 90
    light = EnvironmentLight(Texture(sky), -77, 2.5)
    holes = Material((0.3, 0.7, 0.3), cutout=Texture(np.eye(3)[..., None].repeat(3, axis=2), filter="nearest"))
    veil = MetallicRoughness((0.5, 0.7, 0.9), metallic=0.5, roughness=0.4, alpha=0.6)
    meshes = [
        box((1, 1, 1), veil).moved((0, 0.5, 0), turn=30),
        floor(2, holes).moved((0, 0.2, 1), tilt=60),
        floor(4, GREY),
    ]
    scene = Scene(meshes, [light, PointLight((2, 4, 3))], Camera((1, 1.5, 4), (0, 0.4, 0)))
    path = Path(samples=5, bounces=3, clamp=0.7)
    renderers = [Renderer(scene, integrator=path, backend=name) for name in ("numpy", "opencl", "glsl")]
    images = [renderer.render((16, 12), transparent=transparent) for renderer in renderers]
    images.append(
        renderers[1].render(
            (16, 12), resume=renderers[2].render((16, 12), samples=2, transparent=transparent), transparent=transparent
        )
    )
    for image in images[1:]:
        np.testing.assert_array_equal(image.pixels, images[0].pixels)
        np.testing.assert_array_equal(image.alpha, images[0].alpha)


@pytest.mark.slow
def test_clamp_bounds_what_more_than_one_surface_has_scattered():
    """Direct light is as without it; other light is at most so bright at each surface, and a large bound changes none.

    A path of 8 scatterings finds light in 2 ways at each surface but the first.
    """
    meshes = [floor(4, GREY), LAMP, floor(4, GREY).moved((0, 0.7, -1), tilt=90)]
    scene = Scene(meshes, [], Camera((0, 1, 4), (0, 0.4, 0), fov=40))
    renderer = Renderer(scene, integrator=Path(samples=1, clamp=1e9), backend="numpy")

    def picture(clamp):
        renderer.params["clamp"].value = clamp
        return renderer.render((16, 12)).pixels

    free, bounded = picture(1e9), picture(0.125)
    np.testing.assert_array_equal(free, render(scene, (16, 12), integrator=Path(samples=1), backend="numpy").pixels)
    direct = render(scene, (16, 12), integrator=Path(samples=1, bounces=1), backend="numpy").pixels
    indirect = bounded - direct
    assert (free - direct).max() > 1
    assert 0 < indirect.max() <= 14 * 0.125 + 1e-6
    assert (bounded <= free * (1 + 1e-6)).all()
    np.testing.assert_array_equal(
        render(scene, (16, 12), integrator=Path(samples=1, clamp=0.125), backend="opencl").pixels, bounded
    )


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("ior", "brightest"), [(1.0, 9.0), (1.5, 0.5)])
def test_clamp_counts_what_refracts_light_and_nothing_that_it_goes_straight_through(ior, brightest):
    """A lamp is as bright as it is behind a pane of index 1, and bounded behind one of glass, which scatters twice."""
    pane = box((3, 3, 0.5), Material(transmission=1, ior=ior))
    scene = Scene([pane, LAMP.moved((0, -2, -2))], [], Camera((0, 0, 4), (0, 0, 0), fov=0.5), (0, 0, 0))
    image = render(scene, (4, 4), integrator=Path(samples=1, clamp=0.5), backend="numpy")
    assert image.pixels.max() == pytest.approx(brightest)


@pytest.mark.parametrize("clamp", [0, -1.0, float("inf"), float("nan"), "1", True])
def test_what_is_no_clamp_is_refused(clamp):
    with pytest.raises(SceneError, match="clamp is a brightness above 0, or None for no bound, not"):
        Path(clamp=clamp)


def test_clamp_is_for_path_tracing():
    with pytest.raises(
        SceneError, match='clamp bounds the samples of integrator="path": choose it, or leave clamp out'
    ):
        render(Scene([floor(1, GREY)]), (2, 2), backend="numpy", clamp=1.0)
