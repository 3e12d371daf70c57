"""Patterns: against sums and searches in numpy, and the same bits on every backend."""

import numpy as np
import pytest
from backends.running import covering

import shpy as sh
from shpy import library

RNG = np.random.default_rng(5)
ODD = np.float32([0, -0.0, 1, -1, 0.5, -7.25, 1e-30, 16777217, -1e9, 3e9, -3e30, np.inf, -np.inf, np.nan])
POINTS = {
    n: np.concatenate([RNG.uniform(-20, 20, (120, n)), RNG.choice(ODD, (60, n))]).astype(np.float32) for n in (1, 2, 3)
}
TYPES = {1: sh.Attrib1f, 2: sh.Point2f, 3: sh.Point3f}
METRICS = ["euclidean", "manhattan", "chebyshev"]
NEAR = {n: points[:120] for n, points in POINTS.items()}
on_every_backend = pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
in_each_dimension = pytest.mark.parametrize("size", [1, 2, 3])


def pattern(function, size, *args, **named):
    def of_point(p):
        return function(p, *args, **named)

    of_point.__annotations__["p"] = TYPES[size]
    return sh.program(of_point)


def given(size, points):
    return points[:, 0] if size == 1 else points


@pytest.mark.sampled(3)
@in_each_dimension
def test_all_backends_give_the_same_bits(size):
    points = given(size, POINTS[size])
    programs = (
        pattern(library.fbm, size),
        pattern(library.turbulence, size, 3, 1.9, 0.6),
        pattern(library.cellnoise, size, 4),
        pattern(library.worley, size, METRICS[size - 1], 3),
    )
    for turn, program in enumerate(programs, size):  # each program takes another width for each size
        sh.testing.assert_equivalent(program, points, backends=covering(turn))


@pytest.mark.sampled(9)
@on_every_backend
@in_each_dimension
def test_octaves_add_up(size, backend):
    points = given(size, NEAR[size])
    noise = pattern(sh.noise, size).compile("numpy")
    smooth, creased, place = 0, 0, points.astype(np.float32)
    for octave in range(4):
        height = noise(place).astype(np.float64)
        smooth, creased = smooth + 0.6**octave * height, creased + 0.6**octave * abs(height)
        place = np.float32(2.1) * place + np.float32(0.37)
    np.testing.assert_allclose(pattern(library.fbm, size, 4, 2.1, 0.6).compile(backend)(points), smooth, atol=1e-6)
    np.testing.assert_allclose(
        pattern(library.turbulence, size, 4, 2.1, 0.6).compile(backend)(points), creased, atol=1e-6
    )


@pytest.mark.sampled(3)
@on_every_backend
def test_the_number_of_octaves_may_be_known_at_run_time_only(backend):
    @sh.program
    def rough(p: sh.Point2f, octaves: sh.Attrib1i) -> sh.Attrib1f:
        return library.fbm(p, octaves)

    for octaves in (0, 1, np.int64(5)):
        expected = pattern(library.fbm, 2, octaves).compile("numpy")(NEAR[2])
        np.testing.assert_array_equal(rough.compile(backend)(NEAR[2], octaves), expected)
    assert expected.std() > 0.1
    assert np.all(rough.compile(backend)(NEAR[2], 0) == 0)


@pytest.mark.sampled(4)
@on_every_backend
@in_each_dimension
def test_cellnoise_is_constant_in_each_cell_and_differs_between_cells(size, backend):
    kernel = pattern(lambda p: (library.cellnoise(p, 3), library.cellnoise(p)), size).compile(backend)
    cells = RNG.integers(-1000, 1000, (200, size)).astype(np.float32)
    first, single = kernel(given(size, cells))
    for inside in (0.25, 0.999):
        np.testing.assert_array_equal(kernel(given(size, cells + np.float32(inside)))[0], first)
    assert first.min() >= 0
    assert first.max() < 1
    np.testing.assert_allclose(first.mean(axis=0), 0.5, atol=0.1)
    assert len(np.unique(first[:, 0])) > 0.9 * len(np.unique(cells, axis=0))
    assert np.abs(np.corrcoef(first.T) - np.eye(3)).max() < 0.25
    np.testing.assert_array_equal(single, first[:, 0])


def nearest(points, size, metric):
    """Return the sorted distances, in binary64, from each point to the feature points of all cells up to 4 away."""
    base = np.floor(points)
    offsets = np.stack(np.meshgrid(*[np.arange(-4, 5)] * size), axis=-1).reshape(-1, size)
    cells = (base[:, None] + offsets[None]).astype(np.float32)
    numbers = pattern(library.cellnoise, size, size).compile("numpy")(given(size, cells.reshape(-1, size)))
    away = cells + numbers.reshape(cells.shape).astype(np.float64) - points[:, None]
    norm = {"euclidean": 2, "manhattan": 1, "chebyshev": np.inf}[metric]
    return np.sort(np.linalg.norm(away, norm, axis=-1), axis=1)


@pytest.mark.sampled(16)
@pytest.mark.parametrize(
    ("metric", "size", "backend"),
    [(metric, size, "numpy") for metric in METRICS for size in (1, 2, 3)]
    + [(metric, size, backend) for backend in ("opencl", "glsl") for size, metric in enumerate(METRICS[::-1], 1)],
)
def test_worley_finds_the_nearest_of_all(metric, size, backend):
    kernel = pattern(lambda p: (library.worley(p, metric, 4), library.worley(p, metric)), size).compile(backend)
    found, one = kernel(given(size, NEAR[size]))
    np.testing.assert_allclose(found, nearest(NEAR[size], size, metric)[:, :4], rtol=1e-5, atol=4e-6)
    np.testing.assert_array_equal(one, found[:, 0])


def test_worley_of_a_point_that_is_not_finite_is_nan():
    found = pattern(library.worley, 2, count=2).compile("numpy")([(np.nan, 1), (0, np.inf), (1, 1)])
    assert np.isnan(found).tolist() == [[True, True], [True, True], [False, False]]


def test_mistakes_name_the_users_line():
    for wrong, said in (
        (lambda p: library.worley(p, "taxicab"), "no metric 'taxicab'"),
        (lambda p: library.worley(p, count=5), "1 to 4 distances, not 5"),
        (lambda p: library.cellnoise(p, 0), "1 to 4 components, not 0"),
        (lambda p: library.fbm(p, 2.5), "an int or an i of octaves, not 2.5"),
        (lambda p: library.fbm(p, True), "an int or an i of octaves, not True"),
        (lambda p: library.fbm(p, 1 << 31), "an int or an i of octaves, not 2147483648"),
        (lambda p: library.fbm(p, sh.Attrib1u(p.x)), "an int or an i of octaves, not <Attrib1u"),
        (lambda p: library.turbulence(sh.Attrib4f(p, p)), "1 or 2 or 3 components, not 4"),
    ):
        with pytest.raises(sh.ShpyTypeError, match=said) as error:
            pattern(wrong, 2)
        assert error.value.loc.file == __file__
        assert error.value.cure
