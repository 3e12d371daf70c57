"""The walk through the hierarchy hits what every triangle, tried one after the other, hits: to the bit."""

import numpy as np
import pytest
from scene_pictures import BACKENDS, same_arrays

from raytracer import Camera, DirectionalLight, Intersector, Material, Mesh, PointLight, Scene, cli, render
from raytracer.accel.ploc import build_bvh
from raytracer.accel.space import triangle_rows
from raytracer.kernels import queries
from raytracer.kernels.bvh_walk import BvhIntersector
from raytracer.kernels.wide_walk import WideIntersector
from raytracer.meshes.mesh import joined
from raytracer.meshes.shapes import box, floor, knot, sphere
from raytracer.rays import alike


def bricks():
    """Boxes that share faces, edges and corners, on whole numbers: most rays below meet several things at once."""
    cells = [(x, y, z) for x in range(3) for y in range(3) for z in range(3) if (x + y + z) % 2 == 0]
    return joined([box((1, 1, 1)).moved(cell) for cell in cells])


MESHES = {
    "one": Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]),
    "bricks": bricks(),
    "ball on a floor": joined([sphere(rings=12, segments=24), floor(50).moved((0, -1, 0))]),
    "knot": knot(segments=60, sides=10),
    "soup": Mesh(np.random.default_rng(5).normal(size=(600, 3)), np.arange(600).reshape(-1, 3)),
}


def rays(mesh, count=2000, seed=1):
    """Rays from around and inside the mesh: toward it, along the axes, at vertices and edges, in the faces of boxes."""
    rng = np.random.default_rng(seed)
    low, high = mesh.vertices.min(axis=0) - 0.5, mesh.vertices.max(axis=0) + 0.5
    origins = rng.uniform(low - (high - low) / 2, high + (high - low) / 2, (count, 3))
    targets = rng.uniform(low, high, (count, 3))
    corners = mesh.corners[rng.integers(0, len(mesh), count)]
    targets[::5] = corners[::5, 0]
    targets[1::5] = (corners[1::5, 0] + corners[1::5, 1]) / 2
    directions = targets - origins
    directions[::4] *= np.eye(3)[rng.integers(0, 3, len(directions[::4]))]
    directions[1::9] *= 1 - np.eye(3)[rng.integers(0, 3, len(directions[1::9]))]
    origins[::4] = np.where(directions[::4] == 0, corners[::4, 1], origins[::4])  # in the faces of boxes
    directions[~directions.any(axis=1)] = 1
    return origins.astype(np.float32), directions.astype(np.float32)


@pytest.mark.sampled(24)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", MESHES)
def test_hits_are_those_of_every_triangle(name, backend):
    mesh = MESHES[name]
    origins, directions = rays(mesh)
    bvh, brute = (Intersector(mesh, accel=accel, backend=backend) for accel in ("bvh", "brute"))
    hits = bvh.intersect(origins, directions)
    assert (hits.triangle >= 0).sum() > 100
    same_arrays(hits, brute.intersect(origins, directions))
    limit = np.random.default_rng(3).uniform(0, 2, len(origins))
    found = bvh.occluded(origins, directions, limit)
    np.testing.assert_array_equal(found, brute.occluded(origins, directions, limit))
    assert found.any()
    assert not found.all()


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", MESHES)
def test_hits_are_those_of_the_grid(name):
    mesh = MESHES[name]
    origins, directions = rays(mesh, seed=2)
    bvh, grid = (Intersector(mesh, accel=accel, backend="numpy") for accel in ("bvh", "grid"))
    np.testing.assert_array_equal(bvh.intersect(origins, directions).t, grid.intersect(origins, directions).t)
    np.testing.assert_array_equal(bvh.occluded(origins, directions), grid.occluded(origins, directions))


WIDTHS = (1, 4, 8, 16), (1, 16)
"""The lanes of packets that walk through boxes with two children, and with four."""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bricks", "soup"])
@pytest.mark.parametrize(
    ("query", "widths"),
    [
        (queries.intersect, WIDTHS),
        (queries.occluded, ((4, 16), (1,))),
        pytest.param(queries.occluded, WIDTHS, marks=pytest.mark.slow),
    ],
    ids=["nearest", "any", "any at all widths"],
)
def test_rays_may_walk_together_or_alone(name, query, widths):
    """One ray, packets of any width, or thousands that share every node: the same hits."""
    mesh = MESHES[name]
    origins, directions = rays(mesh, 1500)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    limit = np.random.default_rng(4).uniform(0, 6, len(origins)).astype(np.float32)
    structure, rows = build_bvh(mesh.corners), triangle_rows(mesh.corners)
    alone, together = (query(BvhIntersector(structure, rows, together=t), exact=True) for t in (False, True))
    kernels = [alone.compile("numpy", loop_limit=None), together.compile("numpy", loop_limit=None)]
    kernels += [together.compile("opencl", lanes=lanes, loop_limit=None) for lanes in widths[0]]
    wide = query(WideIntersector(structure, rows), exact=True)
    kernels += [wide.compile("opencl", lanes=lanes, loop_limit=None) for lanes in widths[1]]
    kernels += [wide.compile(backend, loop_limit=None) for backend in ("numpy", "glsl")]
    first, *others = (kernel(origins, directions, 0.0, limit, (0, 0, 0), 1.0) for kernel in kernels)
    for other in others:
        same_arrays(first, other)


@pytest.mark.slow
def test_rays_that_have_nothing_in_common_walk_alone():
    mesh = MESHES["knot"]
    origins, directions = rays(mesh, 1600)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    fan = [5, 0, 0] - np.linspace([0, -1, -1], [0, 1, 1], 1600) * 0.1
    assert not alike(origins, directions, low, high)
    assert alike(np.tile([5.0, 0, 0], (1600, 1)), -fan / np.linalg.norm(fan, axis=1)[:, None], low, high)
    bvh = Intersector(mesh, accel="bvh", backend="opencl")
    same_arrays(
        bvh.intersect(origins, directions),
        Intersector(mesh, accel="brute", backend="numpy").intersect(origins, directions),
    )
    assert [key[:2] for key in bvh._kernels] == [("intersect", "alone")]
    behind = bvh.intersect(origins, directions, -3.0)
    assert [key[:2] for key in bvh._kernels] == [("intersect", "alone"), ("intersect", "any")]
    assert (behind.t < 0).any()


def test_of_two_triangles_in_one_place_the_first_is_hit():
    mesh = joined([knot(segments=20, sides=6)] * 3)
    origins, directions = rays(mesh, 500)
    for accel in ("grid", "bvh", "brute"):
        hits = Intersector(mesh, accel=accel, backend="numpy").intersect(origins, directions)
        assert (hits.triangle >= 0).sum() > 100
        assert hits.triangle.max() < len(mesh) // 3


def test_the_range_is_kept_before_and_behind_the_origin():
    mesh = MESHES["ball on a floor"]
    origins, directions = rays(mesh, 1500, seed=7)
    rng = np.random.default_rng(8)
    t_min = rng.uniform(-8, 2, len(origins))
    t_max = t_min + rng.uniform(-0.5, 8, len(origins))
    bvh, brute = (Intersector(mesh, accel=accel, backend="numpy") for accel in ("bvh", "brute"))
    hits, expected = (accel.intersect(origins, directions, t_min, t_max) for accel in (bvh, brute))
    np.testing.assert_array_equal(hits.triangle, expected.triangle)
    np.testing.assert_allclose(hits.t, expected.t, atol=1e-6)  # rounding may put t = 0 before its box
    assert (hits.t == expected.t).mean() > 0.999
    hit = hits.triangle >= 0
    assert (hits.t[hit] < 0).sum() > 10
    assert np.all(hits.triangle[t_max <= t_min] == -1)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1e6, 1e12])
def test_scenes_of_all_sizes(scale):
    mesh = sphere(rings=10, segments=20)
    origins, directions = rays(mesh, 600)
    mesh = mesh.moved(scale=scale)
    bvh, brute = (Intersector(mesh, accel=accel, backend="numpy") for accel in ("bvh", "brute"))
    hits = bvh.intersect(origins * scale, directions * scale)
    assert (hits.triangle >= 0).sum() > 100
    same_arrays(hits, brute.intersect(origins * scale, directions * scale))


def test_a_scene_far_away():
    """Coordinates are whole multiples of 1/1024 there: distances have errors, the walk must not add any of its own."""
    mesh = sphere(rings=10, segments=20)
    origins, directions = rays(mesh, 600)
    away = np.array([1e4, 0, -1e4])
    shoot = [Intersector(mesh.moved(tuple(away)), accel=accel, backend="numpy") for accel in ("bvh", "brute")]
    hits, expected = (intersector.intersect(origins + away, directions) for intersector in shoot)
    np.testing.assert_array_equal(np.isinf(hits.t), np.isinf(expected.t))
    np.testing.assert_allclose(hits.t, expected.t, atol=0.02)
    assert (hits.t == expected.t).mean() > 0.97


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", ["f16", "f64"])
def test_other_precisions(precision):
    mesh = sphere(rings=10, segments=20)
    origins, directions = rays(mesh, 600, seed=9)
    bvh, brute = (Intersector(mesh, accel=accel, backend="numpy", precision=precision) for accel in ("bvh", "brute"))
    hits = bvh.intersect(origins, directions)
    assert hits.t.dtype == {"f16": np.float16, "f64": np.float64}[precision]
    assert (hits.triangle >= 0).sum() > 100
    same_arrays(hits, brute.intersect(origins, directions))


def test_no_ray_leaks_through_the_edges_and_corners_of_a_closed_mesh():
    for mesh in (sphere(rings=12, segments=24), box()):
        corners = mesh.corners
        targets = [mesh.vertices]
        for w in (0.5, 0.3, 0.01):
            targets += [corners[:, i] * w + corners[:, (i + 1) % 3] * (1 - w) for i in range(3)]
        directions = np.concatenate(targets)
        directions = directions[np.linalg.norm(directions, axis=1) > 0]
        for origin in ([0, 0, 0], [0.03, 0.011, -0.02]):
            origins = np.tile(origin, (len(directions), 1))
            hits = Intersector(mesh, accel="bvh", backend="numpy").intersect(origins, directions - origins)
            assert np.all(hits.triangle >= 0)


def test_nothing_to_hit():
    empty = Intersector(Scene(), accel="bvh", backend="numpy")
    assert empty.intersect([[0, 0, 0]], [[1, 0, 0]]).triangle[0] == -1
    assert not empty.occluded([[0, 0, 0]], [[1, 0, 0]])[0]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_pictures_are_the_same(backend):
    mirror = Material((0.7, 0.7, 0.8), reflectivity=0.4)
    meshes = [sphere(1.0, mirror, rings=10, segments=16), box((1, 1, 1)).moved((2, 0, 0)), floor(12).moved((0, -1, 0))]
    lights = (PointLight((3, 5, 4), (0.8, 0.7, 0.6)), DirectionalLight((1, -2, -1), (0.3, 0.3, 0.5)))
    scene = Scene(meshes, lights, Camera((1, 2, 7), (0.5, 0, 0), fov=45))
    one, other = (render(scene, (48, 32), backend=backend, bounces=2, accel=accel) for accel in ("grid", "bvh"))
    for layer in ("pixels", "depth", "normal", "object_id", "rays"):
        np.testing.assert_array_equal(getattr(one, layer), getattr(other, layer))
    assert len(np.unique(other.object_id)) == 4


def test_the_command_takes_an_accelerator(tmp_path, capsys):
    paths = [tmp_path / f"{accel}.npy" for accel in ("grid", "bvh")]
    for path in paths:
        size = ["--size", "24x16", "--backend", "numpy", "--bounces", "1"]
        assert cli.main(["render", "boxes", "-o", str(path), *size, "--accel", path.stem]) == 0
    one, other = (np.load(path) for path in paths)
    np.testing.assert_array_equal(one["pixels"], other["pixels"])
    with pytest.raises(SystemExit):
        cli.main(["render", "boxes", "--accel", "octree"])
    names = "'bvh', 'grid', 'brute', 'instances', 'ldc:1024'"
    assert f"the accelerator is one of {names}, not 'octree'" in capsys.readouterr().err
