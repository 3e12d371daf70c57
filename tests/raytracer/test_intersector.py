"""Hits of rays given as arrays, against brute force in f64."""

import numpy as np
import pytest
from oracle import closest

from raytracer import Intersector, Mesh, Scene, SceneError
from raytracer.meshes.shapes import box, floor, icosahedron, knot, sphere

BACKENDS = ["numpy", "opencl", "glsl"]
MESHES = {
    "one": Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]),
    "box": box((1, 2, 3)),
    "ball": sphere(rings=10, segments=20),
    "knot": knot(segments=60, sides=10),
    "soup": Mesh(np.random.default_rng(5).normal(size=(600, 3)), np.arange(600).reshape(-1, 3)),
}


def rays(mesh, count, seed):
    """Rays from around and inside the mesh toward it, some along an axis."""
    rng = np.random.default_rng(seed)
    low, high = mesh.vertices.min(axis=0) - 0.5, mesh.vertices.max(axis=0) + 0.5
    origins = rng.uniform(low - (high - low) / 2, high + (high - low) / 2, (count, 3))
    directions = rng.uniform(low, high, (count, 3)) - origins
    directions[::10] *= np.eye(3)[rng.integers(0, 3, len(directions[::10]))]
    return origins.astype(np.float32).astype(float), directions.astype(np.float32).astype(float)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", MESHES)
def test_hits_are_those_of_brute_force(name, backend):
    mesh = MESHES[name]
    origins, directions = rays(mesh, 4000, 1)
    corners = mesh.corners.astype(np.float32).astype(float)
    t, triangle, _, _ = closest(corners, origins, directions)
    hits = Intersector(mesh, accel="grid", backend=backend).intersect(origins, directions)
    assert (triangle >= 0).sum() > 100
    same = hits.triangle == triangle
    near = np.isclose(hits.t, t, rtol=1e-4, atol=1e-4)  # a neighbour across a shared edge is as good
    assert (same | near).mean() >= 0.999
    hit = same & (triangle >= 0)
    np.testing.assert_allclose(hits.t[hit], t[hit], rtol=2e-4, atol=2e-5)
    weights = np.stack([1 - hits.u - hits.v, hits.u, hits.v], axis=1)[hit]
    points = np.einsum("nk,nkd->nd", weights, corners[hits.triangle[hit]])
    np.testing.assert_allclose(points, origins[hit] + t[hit, None] * directions[hit], atol=2e-4)
    assert np.all(np.isinf(hits.t) == (hits.triangle < 0))


def test_the_grid_loses_no_hit():
    """The same kernel over a single cell tries every triangle: every distance must be the same, to the bit."""
    mesh = knot(segments=90, sides=12)
    origins, directions = rays(mesh, 6000, 4)
    directions[3::5] = mesh.vertices[np.arange(len(directions[3::5])) % len(mesh.vertices)] - origins[3::5]
    grid = Intersector(mesh, accel="grid", backend="opencl")
    brute = Intersector(mesh, accel="brute", backend="opencl")
    assert brute._geometry.structure.shape == (1, 1, 1) != grid._geometry.structure.shape
    np.testing.assert_array_equal(grid.intersect(origins, directions).t, brute.intersect(origins, directions).t)
    np.testing.assert_array_equal(grid.occluded(origins, directions), brute.occluded(origins, directions))


def test_double_precision_is_that_of_the_oracle():
    mesh = MESHES["ball"]
    origins, directions = rays(mesh, 500, 6)
    t = closest(mesh.corners, origins, directions)[0]
    hits = Intersector(mesh, backend="numpy", precision="f64").intersect(origins, directions)
    assert hits.t.dtype == np.float64
    hit = np.isfinite(t) & np.isfinite(hits.t)
    assert hit.sum() > 100
    np.testing.assert_allclose(hits.t[hit], t[hit], rtol=1e-12)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_occluded_is_whether_anything_is_nearer(backend):
    mesh = MESHES["soup"]
    origins, directions = rays(mesh, 3000, 2)
    limit = np.random.default_rng(3).uniform(0, 1.5, 3000)
    t = closest(mesh.corners, origins, directions)[0]
    found = Intersector(mesh, backend=backend).occluded(origins, directions, limit)
    assert found.dtype == bool
    clear = np.abs(t - limit) > 1e-3
    assert (found == (t < limit))[clear].mean() >= 0.999
    assert 0.05 < found.mean() < 0.95


def test_the_range_is_kept():
    mesh = MESHES["ball"]
    shoot = Intersector(mesh, backend="numpy")
    origins, directions = np.array([[0.05, 0.03, 5.0]]), np.array([[0, 0, -2.0]])
    first = shoot.intersect(origins, directions).t[0]
    assert first == pytest.approx(2.0, abs=0.05)
    second = shoot.intersect(origins, directions, t_min=first + 0.1).t[0]
    assert second == pytest.approx(3.0, abs=0.05)
    assert shoot.intersect(origins, directions, t_max=[first - 0.1]).triangle[0] == -1
    assert shoot.intersect(origins, directions, t_min=second + 0.1).triangle[0] == -1
    assert not shoot.occluded(origins, directions, t_max=first - 0.1)[0]
    assert shoot.occluded(origins, directions, t_max=first + 0.1)[0]


@pytest.mark.parametrize("length", [1e-30, 1e-3, 1e6, 1e30])
def test_t_is_in_lengths_of_the_direction(length):
    hits = Intersector(box(), backend="numpy").intersect([[0.1, 0.2, 3.0]], [[0, 0, -length]])
    assert hits.t[0] == pytest.approx(2.5 / length, rel=1e-5)


def test_no_ray_leaks_through_the_edges_and_corners_of_a_closed_mesh():
    for mesh in (icosahedron(), sphere(rings=12, segments=24), box()):
        corners = mesh.corners
        targets = [mesh.vertices]
        for w in (0.5, 0.3, 0.01):
            targets += [corners[:, i] * w + corners[:, (i + 1) % 3] * (1 - w) for i in range(3)]
        directions = np.concatenate(targets)
        directions = directions[np.linalg.norm(directions, axis=1) > 0]
        for origin in ([0, 0, 0], [0.03, 0.011, -0.02]):
            origins = np.tile(origin, (len(directions), 1))
            hits = Intersector(mesh, backend="numpy").intersect(origins, directions - origins)
            assert np.all(hits.triangle >= 0)


def test_rays_in_the_planes_of_the_grid():
    """Rays along an axis, in the faces of a box and on the borders of cells, neither hang nor miss what is inside."""
    mesh = MESHES["ball"]
    shoot = Intersector(mesh, accel="grid", backend="numpy")
    grid = shoot._geometry.structure
    numbers = np.stack(np.meshgrid(*(np.arange(n + 1) for n in grid.shape[:2])), axis=-1)
    lines = grid.low[:2] + numbers.reshape(-1, 2) * grid.cell[:2]
    origins = np.concatenate([lines, np.full((len(lines), 1), 4.0)], axis=1)
    directions = np.tile([0.0, 0.0, -1.0], (len(lines), 1))
    t = closest(mesh.corners, origins, directions)[0]
    hits = shoot.intersect(origins, directions)
    clear = np.abs(np.linalg.norm(lines, axis=1) - 1) > 0.03
    np.testing.assert_array_equal(np.isinf(hits.t)[clear], np.isinf(t)[clear])


def test_a_scene_numbers_its_triangles_through():
    scene = Scene([box(), Mesh(np.zeros((0, 3)), []), floor(9).moved((0, -2, 0))])
    hits = Intersector(scene, backend="numpy").intersect([[0.1, 5, 0.2], [3, 5, 0.2]], [[0, -1, 0], [0, -1, 0]])
    assert hits.triangle[0] < 12 <= hits.triangle[1] < 14
    np.testing.assert_allclose(hits.t, [4.5, 7], rtol=1e-6)


def test_nothing_to_hit_and_no_rays():
    empty = Intersector(Scene(), backend="numpy")
    hits = empty.intersect([[0, 0, 0]], [[1, 0, 0]])
    assert hits.t[0] == np.inf
    assert hits.triangle[0] == -1
    assert not empty.occluded([[0, 0, 0]], [[1, 0, 0]])[0]
    assert Intersector(box(), backend="numpy").intersect(np.zeros((0, 3)), np.zeros((0, 3))).t.shape == (0,)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("origins", "directions", "more", "words"),
    [
        ([0, 0, 0], [[1, 0, 0]], {}, r"origins have the shape \(3,\), but directions \(1, 3\)"),
        ([[0, 0]], [[1, 0, 0]], {}, "origins"),
        ([[0, 0, 0]], [[1, 0, 0]] * 2, {}, "1 origins but 2 directions"),
        ([[0, np.nan, 0]], [[1, 0, 0]], {}, "origins contain NaN or infinity, first in ray 0"),
        ([[0, 0, 0]] * 2, [[1, 0, 0], [0, np.inf, 0]], {}, "directions contain NaN or infinity, first in ray 1"),
        ([[0, 0, 0]] * 2, [[1, 0, 0], [0, 0, 0]], {}, "length zero, first that of ray 1"),
        ([[0, 0, 0]], [[1, 0, 0]], {"t_max": [1, 2]}, "t_max"),
        ([[0, 0, 0]], [[1, 0, 0]], {"t_min": np.nan}, "t_min contains NaN"),
    ],
)
def test_rays_that_cannot_be(origins, directions, more, words):
    for method in ("intersect", "occluded"):
        with pytest.raises(SceneError, match=words):
            getattr(Intersector(box(), backend="numpy"), method)(origins, directions, **more)


def test_arguments_that_cannot_be():
    with pytest.raises(SceneError, match="one of 'bvh', 'grid', 'brute', 'instances', 'ldc:1024', not 'octree'"):
        Intersector(box(), accel="octree")
    with pytest.raises(SceneError, match="the precision is one of 'f16', 'f32', 'f64', not 'f8'"):
        Intersector(box(), precision="f8")
    with pytest.raises(SceneError, match="Mesh or a Scene, not ndarray"):
        Intersector(np.zeros((3, 3)))


@pytest.mark.parametrize(("tilt", "farthest"), [(0, 250_000), (30, 3000)])
def test_distance_along_a_huge_floor_at_grazing_angles_is_that_of_the_plane(tilt, farthest):
    """A floor of a million seen from a height of 0.1 to 30: slopes down to 1e-6.

    The error of the distance is a few roundings of what the height is a sum of, divided by the slope. Where the plane
    is tilted, and much farther off, these are as many as those of the corners.
    """
    rng = np.random.default_rng(3)
    mesh = floor(1e6).moved(tilt=tilt)
    mesh = Mesh(mesh.vertices.astype(np.float32), mesh.faces)
    up = mesh.face_normals[0]
    across = np.cross(up, [1.0, 0, 0])
    plane = np.array([across, np.cross(up, across)])
    angle, far = rng.uniform(0, 2 * np.pi, 2000), 10 ** rng.uniform(2, np.log10(farthest), (2000, 1))
    height = 10 ** rng.uniform(-1, 1.5, (2000, 1))
    origins = (rng.normal(size=(2000, 2)) @ plane + height * up).astype(np.float32).astype(float)
    directions = far * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ plane - height * up
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions = directions.astype(np.float32).astype(float)
    hits = Intersector(mesh, accel="bvh", backend="numpy").intersect(origins, directions)
    assert (hits.triangle >= 0).sum() > 1900
    met = np.flatnonzero(hits.triangle >= 0)
    origins, directions, normals = origins[met], directions[met], mesh.face_normals[hits.triangle[met]]
    slope = np.abs(np.sum(directions * normals, axis=1))
    exact = np.abs(np.sum((origins - mesh.corners[hits.triangle[met], 0]) * normals, axis=1)) / slope
    size = np.sum((2 * np.abs(origins) + exact[:, None] * np.abs(directions)) * np.abs(normals), axis=1)
    assert np.all(np.abs(hits.t[met] - exact) <= 8 * 2.0**-24 * (size / slope + exact))
