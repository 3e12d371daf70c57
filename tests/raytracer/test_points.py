"""Points of Sobol' with Owen's scrambling: their strata, and the noise that they leave in pictures."""

from typing import NamedTuple

import numpy as np
import pytest

import shpy as sh
from raytracer import Path, Renderer, Scene
from raytracer.kernels.points import part_of, reversed_bits, sobol_pair


class Point(NamedTuple):
    across: sh.Attrib1u
    down: sh.Attrib1u


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
