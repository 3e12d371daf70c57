"""Layered depth cubes with depths of binary16: their numbers, the same bits everywhere, and how far hits may be off."""

from types import SimpleNamespace

import numpy as np
import pytest
from scene_pictures import SIZE

import shpy as sh
from raytracer import Intersector, LayeredCube, Mesh, Renderer, Scene, SceneError, cli, render
from raytracer.kernels.layered_samples import HalfSamples
from raytracer.layered import halves
from raytracer.layered.raster import HIGH, LOW, SIZE as TEXEL
from raytracer.meshes.mesh import joined
from raytracer.meshes.shapes import box, floor, knot, sphere

BACKENDS = ["numpy", "opencl", "glsl"]
KNOT = knot(segments=40, sides=8)


def rays(count, seed=1):
    rng = np.random.default_rng(seed)
    origins, targets = rng.normal(size=(2, count, 3))
    return origins.astype(np.float32), (targets - origins).astype(np.float32)


def cube_of(mesh, resolution, hit="plane", backend="numpy", **options):
    return LayeredCube.of(mesh, resolution, 8, backend, hit, depths="half", **options)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_kernel_decodes_every_number_of_binary16(backend):
    """Every normal number that is finite: no others are stored."""
    every = np.arange(1 << 16, dtype=np.uint16)
    values = every.view(np.float16)
    codes = every[np.isfinite(values) & (np.abs(values) >= halves.SMALLEST)]
    tables = SimpleNamespace(depths=sh.Table(halves.pairs(codes), sh.Attrib1u))

    @sh.program
    def decode(item: sh.Attrib1i) -> sh.Attrib1f:
        return HalfSamples.depth(tables, item, SimpleNamespace(unit=1.0, middle=0.0))

    decoded = decode.compile(backend)(np.arange(len(codes), dtype=np.int32))
    np.testing.assert_array_equal(decoded, codes.view(np.float16).astype(np.float32))


def test_numbers_in_groups_are_read_back():
    rng = np.random.default_rng(2)
    for most, shift in ((3, 6), (3000, 5), (100_000, 0)):
        numbers = np.cumsum(rng.integers(0, most, 1001)).astype(np.int32)
        groups = halves.grouped(numbers)
        assert groups.shift == shift
        words = np.stack([groups.starts & 0xFFFF, groups.starts >> 16], axis=1).reshape(-1)[: len(numbers)]
        np.testing.assert_array_equal(groups.bases[np.arange(1001) >> shift] + words.astype(np.int32), numbers)


@pytest.mark.slow
@pytest.mark.parametrize("hit", ["plane", "sample"])
def test_every_backend_gives_the_same_samples_and_hits(hit):
    origins, directions = rays(150)
    one, *others = (cube_of(KNOT, 24, hit, backend) for backend in BACKENDS)
    hits = Intersector(KNOT, one, "numpy").intersect(origins, directions)
    assert (hits.triangle >= 0).sum() > 40
    for backend, cube in zip(BACKENDS[1:], others, strict=True):
        np.testing.assert_array_equal(cube.images.halves, one.images.halves)
        np.testing.assert_array_equal(cube.images.ranges, one.images.ranges)
        for column, expected in zip(Intersector(KNOT, cube, backend).intersect(origins, directions), hits, strict=True):
            np.testing.assert_array_equal(column, expected)


@pytest.mark.parametrize("mesh", [KNOT, KNOT.moved((1e5, -3e5, 2e5)), joined([KNOT, floor(900)])], ids=str)
def test_depths_and_slopes_are_rounded_and_stay_in_order(mesh):
    half, single = cube_of(mesh, 48), LayeredCube.of(mesh, 48, 8, "numpy")
    np.testing.assert_array_equal(half.images.offsets, single.images.offsets)
    image = halves.images_of(half.images.offsets)
    side = (half.frame[HIGH] - half.frame[LOW])[image]
    assert np.all(abs(half.images.depths - single.images.depths) <= 2.0**-13 * 1.01 * side)
    assert (half.images.depths != single.images.depths).mean() > 0.9
    within = np.diff(half.images.depths)[np.diff(np.repeat(np.arange(3 * 48**2), np.diff(half.images.offsets))) == 0]
    assert np.all(within >= 0)
    _, codes = half.codes
    sides = np.stack([np.roll(half.frame[TEXEL, :3], -1), np.roll(half.frame[TEXEL, :3], -2)], axis=1)[image]
    slopes = (np.stack([codes & 0xFF, codes >> 8], axis=1).astype(float) - 127) / 127 * sides
    assert np.all(abs(slopes - half.images.slopes) <= 0.51 / 127 * sides)


def test_tables_take_half_the_memory():
    for hit, share in (("plane", 0.55), ("sample", 0.7)):
        half, single = cube_of(KNOT, 128, hit), LayeredCube.of(KNOT, 128, 8, "numpy", hit)
        assert 0.45 * single.nbytes < half.nbytes < share * single.nbytes
        assert "half depths" in repr(half)
        assert half.samples == single.samples


@pytest.mark.sampled(3)
@pytest.mark.parametrize("resolution", [1, 2, 33])
def test_many_samples_in_few_texels(resolution):
    """Groups of texels become smaller; the hits are those of binary32 but for roundings of depths."""
    ball = sphere(rings=150, segments=250)
    origins, directions = rays(300)
    half, exact = (
        Intersector(ball, LayeredCube.of(ball, resolution, 8, "opencl", conservative=True, depths=depths), "opencl")
        for depths in ("half", "single")
    )
    t, expected = (shoot.intersect(origins, directions).t for shoot in (half, exact))
    assert (np.isfinite(t) == np.isfinite(expected)).mean() > 0.97
    both = np.isfinite(t) & np.isfinite(expected)
    assert np.median(abs(t[both] - expected[both])) < 2e-3


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("hit", "most"), [("plane", 0.01), ("sample", 0.2)])
def test_hits_are_nearly_as_exact_as_with_binary32(hit, most):
    origins, directions = rays(20_000)
    exact = Intersector(KNOT, backend="opencl").intersect(origins, directions)
    wrong = {}
    for depths in ("single", "half"):
        cube = LayeredCube.of(KNOT, 256, backend="opencl", hit=hit, depths=depths)
        hits = Intersector(KNOT, cube, "opencl").intersect(origins, directions)
        with np.errstate(invalid="ignore"):
            wrong[depths] = (~((hits.t == exact.t) | (abs(hits.t - exact.t) < 0.01))).mean()
    assert wrong["single"] < most
    assert wrong["half"] < wrong["single"] + 0.005


@pytest.mark.slow
def test_a_ray_that_leaves_a_surface_does_not_hit_it():
    ball = sphere(rings=24, segments=48)
    rng = np.random.default_rng(6)
    number = rng.integers(0, len(ball), 4000)
    places = np.einsum("nk,nkd->nd", rng.dirichlet((1, 1, 1), 4000), ball.corners[number])
    outward = ball.face_normals[number] * np.sign(np.einsum("nk,nk->n", ball.face_normals[number], places))[:, None]
    shoot = Intersector(ball, "ldc:1024:half", "opencl")
    assert shoot.occluded(places, outward + places, leaving=True).mean() < 0.001
    assert shoot.occluded(places, outward).mean() > 0.2


@pytest.mark.slow
def test_pictures_moves_and_the_command(tmp_path):
    scene = Scene.builtin("boxes")
    path = tmp_path / "boxes.npy"
    command = ["render", "boxes", "--size", "40x30", "--backend", "numpy", "--accel", "ldc:64:half"]
    assert cli.main([*command, "-o", str(path)]) == 0
    exact, image = (
        render(scene, (40, 30), backend="numpy", accel=accel).srgb.astype(int) for accel in ("bvh", "ldc:64:half")
    )
    assert 0 < np.sqrt(((image - exact) ** 2).mean()) < 6
    cube = LayeredCube.of(scene, 64, backend="numpy", depths="half")
    again = render(scene, (40, 30), backend="numpy", secondary=cube)
    np.testing.assert_array_equal(np.load(path)["pixels"], again.pixels)
    renderer = Renderer(scene, secondary=cube, backend="numpy")
    renderer.move(1, np.eye(4))
    moved = renderer.render((40, 30)).srgb.astype(int)
    assert renderer.layout.secondary.options == cube.options
    assert np.sqrt(((moved - exact) ** 2).mean()) < 6


@pytest.mark.slow
def test_samples_with_half_depths_are_shaded():
    scene = Scene.builtin("boxes")
    single, half = (
        render(scene, SIZE, backend="numpy", accel=f"ldc:64:plane:deferred{more}").srgb.astype(int)
        for more in ("", ":half")
    )
    assert np.sqrt(((half - single) ** 2).mean()) < 3


def test_nothing_has_no_samples():
    for mesh in (Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)), Mesh(np.eye(3), [[0, 1, 1]])):
        cube = cube_of(mesh, 8)
        assert cube.samples == 0 < cube.nbytes
        assert Intersector(mesh, cube, "numpy").intersect([[0, 0, 0]], [[1, 1, 1]]).triangle.tolist() == [-1]


def test_words_are_read_in_pairs():
    assert halves.pairs(np.array([7, 1, 2], np.uint16)).tolist() == [7 | 1 << 16, 2]
    assert halves.pairs(np.zeros(0, np.uint16)).tolist() == [0]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: LayeredCube.of(box(), 8, hit="triangle", depths="half"), 'write "ldc:1024:triangle" for exact hits'),
        (lambda: LayeredCube.of(box(), 8, depths="f16"), "depths is one of 'single', 'half', not 'f16'"),
        (lambda: Intersector(box(), "ldc:64:triangle:half", "numpy"), 'write "ldc:64:triangle" .* or "ldc:64:half"'),
        (lambda: Renderer(Scene(box()), accel="ldc:64:triangle:half"), 'is exact: write "ldc:64:triangle"'),
        (lambda: Intersector(box(), "ldc:64:half:triangle", "numpy"), "'half' in 'ldc:64:half:triangle' is none of"),
        (
            lambda: Renderer(Scene(box()), accel="ldc:64:haf"),
            "'haf' .* 'sample', 'plane', 'triangle'; \"half\" stands last",
        ),
        (lambda: Intersector(box(), "ldc:64:plane:defer"), "'defer' .* none of 'exact', 'deferred'"),
        (lambda: Intersector(box(), "ldc:half", "numpy"), '"ldc:1024:half" or "ldc:1024:triangle", not \'ldc:half\''),
    ],
)
def test_half_depths_where_they_cannot_be_are_errors(make, words):
    with pytest.raises(SceneError, match=words):
        make()
