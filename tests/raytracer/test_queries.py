"""All hits, counts, closest points, rays that leave surfaces, and arrays of all shapes and kinds."""

import numpy as np
import pytest
from oracle import crossings, distances
from scene_pictures import BACKENDS, same_arrays

from raytracer import Intersector, Mesh, Scene, SceneError
from raytracer.accel.ploc import build_bvh
from raytracer.accel.space import triangle_rows
from raytracer.kernels import nearby
from raytracer.kernels.queries import FEW, MANY, intersect, list_hits, occluded
from raytracer.kernels.triangle import AheadBound
from raytracer.kernels.walk import walk_with
from raytracer.kernels.wide_walk import WideIntersector
from raytracer.meshes.mesh import joined
from raytracer.meshes.shapes import box, floor, knot, sphere

SOUP = Mesh(np.random.default_rng(5).normal(size=(600, 3)), np.arange(600).reshape(-1, 3))
SLABS = joined([box((1, 1, 0.01)).moved((0, 0, 0.1 * k)) for k in range(30)])
MESHES = {"soup": SOUP, "five in one place": joined([knot(segments=20, sides=6)] * 5), "slabs": SLABS}


def rays(count, seed=1):
    rng = np.random.default_rng(seed)
    origins = rng.normal(size=(count, 3)) * 2
    return origins.astype(np.float32), (rng.normal(size=(count, 3)) - origins / 2).astype(np.float32)


@pytest.mark.sampled(12)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", MESHES)
def test_all_hits_are_those_of_brute_force_in_order(name, backend):
    mesh = MESHES[name]
    origins, directions = rays(800)
    t = crossings(mesh.corners, origins.astype(float), directions.astype(float))
    shoot = Intersector(mesh, backend=backend)
    every, count = shoot.all_hits(origins, directions), shoot.count(origins, directions)
    np.testing.assert_array_equal(np.diff(every.offsets), count)
    assert count.max() > FEW + MANY  # three walks
    np.testing.assert_array_equal(count, np.isfinite(t).sum(axis=1))
    np.testing.assert_allclose(every.t, t[every.ray, every.triangle], rtol=1e-3, atol=1e-5)
    same_ray = every.ray[1:] == every.ray[:-1]
    follows = (every.t[1:] > every.t[:-1]) | (
        (every.t[1:] == every.t[:-1]) & (every.triangle[1:] > every.triangle[:-1])
    )
    assert np.all(follows | ~same_ray)
    first, hits = every.offsets[:-1][count > 0], shoot.intersect(origins, directions)
    same_arrays((part[first] for part in every[1:]), (part[count > 0] for part in hits))
    np.testing.assert_array_equal(hits.triangle >= 0, count > 0)


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("backend", "accelerators"),
    [
        ("numpy", ("bvh", "brute")),
        ("opencl", ("grid",)),
        ("glsl", ("bvh", "grid")),
        pytest.param("opencl", ("bvh", "brute"), marks=pytest.mark.slow),
        pytest.param("glsl", ("brute",), marks=pytest.mark.slow),
    ],
)
def test_all_accelerators_and_backends_find_the_same(backend, accelerators):
    """A list of hits by the hierarchy on OpenCL is that of brute force in the test before."""
    origins, directions = rays(300)
    expected = Intersector(SOUP, accel="brute", backend="numpy").all_hits(origins, directions)
    for accel in accelerators:
        shoot = Intersector(SOUP, accel=accel, backend=backend)
        same_arrays(shoot.all_hits(origins, directions), expected)
        np.testing.assert_array_equal(shoot.count(origins, directions), np.diff(expected.offsets))


@pytest.mark.slow
@pytest.mark.parametrize(
    "widths", [((16,), (1, 8)), pytest.param(((4, 16), (1, 4, 8, 16)), marks=pytest.mark.slow)], ids=["some", "all"]
)
def test_every_width_and_walk_lists_the_same_hits(widths):
    """Packets of 1 and of 8 lanes that walk through boxes with two children are those of an Intersector on OpenCL."""
    origins, directions = rays(300)
    structure, rows = build_bvh(SOUP.corners), triangle_rows(SOUP.corners)
    walks = [walk_with(structure, rows, "opencl"), WideIntersector(structure, rows)]
    inputs = (origins, directions, 0.0, np.inf, (0, 0, 0), 1.0, -np.inf, -1)
    kernels = [list_hits(walk, exact=False).compile("numpy", loop_limit=None) for walk in walks]
    for walk, lanes in zip(walks, widths, strict=True):
        kernels += [list_hits(walk, exact=False).compile("opencl", lanes=n, loop_limit=None) for n in lanes]
    (first, *_), *others = (kernel(*inputs) for kernel in kernels)
    assert (first.triangle[:, -1] >= 0).any()
    for other, *_ in others:
        same_arrays(other, first)


def test_a_ray_through_edges_and_corners_hits_every_triangle_there():
    cube = box()
    shoot = Intersector(cube, backend="numpy")
    through_corners = shoot.all_hits([[2.0, 2, 2]], [[-1.0, -1, -1]])
    at = np.isclose(cube.corners, 0.5).all(axis=2).any(axis=1).sum(), np.isclose(cube.corners, -0.5).all(2).any(1).sum()
    assert through_corners.offsets.tolist() == [0, sum(at)]
    np.testing.assert_allclose(through_corners.t, [1.5] * at[0] + [2.5] * at[1])
    along_diagonals = shoot.count([[0.1, 0.1, 3.0]], [[0.0, 0, -1]])
    assert along_diagonals[0] in (3, 4)  # the diagonal of one face or of both


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["numpy", "opencl"])
def test_the_range_is_that_of_the_hits(backend):
    origins, directions = rays(500)
    shoot = Intersector(SOUP, backend=backend)
    rng = np.random.default_rng(2)
    low = rng.uniform(-1, 0.5, 500).astype(np.float32)
    high = low + rng.uniform(-0.1, 1.5, 500).astype(np.float32)
    every, some = shoot.all_hits(origins, directions, -100), shoot.all_hits(origins, directions, low, high)
    inside = (every.t >= low[every.ray]) & (every.t < high[every.ray])
    assert (every.t < 0).any()
    same_arrays((some.ray, *some[1:]), (every.ray[inside], *(part[inside] for part in every[1:])))


def test_distances_too_small_for_f32_do_not_repeat_a_hit():
    flat = Mesh([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]] * 7)
    for length in (1.0, 1e18, 1e30):
        every = Intersector(flat, backend="numpy").all_hits([[0, 0, 1e-37]], [[0, 0, -length]])
        assert every.triangle.tolist() == list(range(7))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["numpy", *(pytest.param(b, marks=pytest.mark.slow) for b in BACKENDS[1:])])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_results_have_the_rays_shape(backend, dtype):
    mesh = MESHES["five in one place"]
    origins, directions = (a[:120].reshape(10, 12, 3).astype(dtype) for a in rays(200))
    shoot = Intersector(mesh, backend=backend)
    flat = [a.reshape(-1, 3) for a in (origins, directions)]
    limit = np.linspace(0, 3, 120).reshape(10, 12)
    for name in ("intersect", "occluded", "count"):
        whole, expected = getattr(shoot, name)(origins, directions), getattr(shoot, name)(*flat)
        pairs = zip(whole, expected, strict=True) if name == "intersect" else [(whole, expected)]
        for one, other in pairs:
            np.testing.assert_array_equal(one.reshape(-1), other)
        assert np.shape(whole)[-2:] == (10, 12)
        within = getattr(shoot, name)(origins, directions, t_max=limit)
        assert np.shape(within)[-2:] == (10, 12)
    assert shoot.all_hits(origins, directions).offsets.shape == (121,)
    one = shoot.intersect(origins[0, 0], directions[0, 0])
    assert one.t.shape == ()
    assert shoot.closest_point(origins).points.shape == (10, 12, 3)


def test_arrays_of_all_kinds_are_the_same_rays():
    origins, directions = (np.round(a * 4).astype(np.int64) for a in rays(1000))
    directions[~directions.any(axis=1)] = 1
    shoot = Intersector(SOUP, backend="numpy")
    expected = shoot.intersect(origins, directions)
    assert (expected.triangle >= 0).sum() > 50
    backwards = [np.ascontiguousarray(a[::-1])[::-1].astype(np.float32) for a in (origins, directions)]
    wide = [np.asfortranarray(np.repeat(a, 2, axis=1).astype(float))[:, ::2] for a in (origins, directions)]
    swapped = [a.astype(">f8") for a in (origins, directions)]
    narrow = [a.astype(np.float16) for a in (origins, directions)]
    for given in ([a.tolist() for a in (origins, directions)], backwards, wide, swapped, narrow):
        same_arrays(shoot.intersect(*given), expected)
    for array in backwards:
        array.setflags(write=False)
    same_arrays(shoot.intersect(*backwards), expected)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_numbers_that_f32_does_not_hold_are_converted_in_f64(backend):
    """The kernel refuses them; converted beforehand they give what rays of moderate size give."""
    origins, directions = (a.astype(float) for a in rays(100))
    shoot = Intersector(SOUP, backend=backend)
    expected = shoot.intersect(origins, directions)
    for exponent in (-900, -130, 200, 900):
        hits = shoot.intersect(origins, directions * 2.0**exponent)
        same_arrays(hits[1:], expected[1:])
    mixed = directions * np.where(np.arange(100) == 50, 2.0**-100, 1)[:, None]
    hits = shoot.intersect(origins, mixed)
    np.testing.assert_array_equal(hits.triangle, expected.triangle)
    np.testing.assert_array_equal(hits.t[:50], expected.t[:50])
    far = shoot.intersect(np.array([[1e300, 0, 0], [3.0, 0.01, 0.02]]), np.array([[-1.0, 0, 0]] * 2))
    assert far.triangle[0] == -1
    assert far.triangle[1] >= 0


@pytest.mark.parametrize(
    ("origins", "words"),
    [
        (["a", "b", "c"], "real numbers, not <U1"),
        ([[1j, 0, 0]], "real numbers, not complex128"),
        ([[0, 0], [0, 0, 0]], "rows of different lengths"),
        ([[None, 0, 0]], "origins contain NaN or infinity, first in ray 0"),
        ([["x", object(), 0]], "real numbers, not object"),
        (np.ma.masked_array([[0.0, 0, 0]], [[True, False, False]]), "real numbers, not a masked array"),
        (np.zeros((1, 4)), r"shape \(\.\.\., 3\), not \(1, 4\)"),
        (3.0, r"shape \(\.\.\., 3\), not \(\)"),
        (np.zeros((2, 2, 3)), r"origins have the shape \(2, 2, 3\), but directions \(1, 3\)"),
    ],
)
def test_arrays_that_are_no_rays(origins, words):
    shoot = Intersector(box(), backend="numpy")
    for name in ("intersect", "occluded", "count", "all_hits"):
        with pytest.raises(SceneError, match=words):
            getattr(shoot, name)(origins, [[1.0, 0, 0]])
    if "directions" not in words:
        with pytest.raises(SceneError, match=words.replace("origins", "points").replace("ray 0", "point .0.")):
            shoot.closest_point(origins)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_wrong_ray_among_many_is_named(backend, dtype):
    origins, directions = (a[:60].reshape(6, 10, 3).astype(dtype) for a in rays(60))
    shoot = Intersector(box(), backend=backend)
    for array, value, words in (
        (0, np.nan, "origins contain NaN"),
        (1, -np.inf, "directions contain NaN"),
        (1, 0, "zero"),
    ):
        given = [origins.copy(), directions.copy()]
        given[array][4, 7] = value
        with pytest.raises(SceneError, match=f"{words}.* ray 4, 7"):
            shoot.intersect(*given)
    limit = np.full((6, 10), 2.0)
    limit[2, 3] = np.nan
    with pytest.raises(SceneError, match="t_max contains NaN, first for ray 2, 3"):
        shoot.count(origins, directions, t_max=limit)
    given[0][4, 7, 1] = np.inf
    with pytest.raises(SceneError, match=r"points contain NaN or infinity, first in point \[4, 7\]"):
        shoot.closest_point(given[0])


def test_nothing_to_meet_and_nobody_who_asks():
    empty, some = Intersector(Scene(), backend="numpy"), Intersector(box(), backend="numpy")
    none, one = np.zeros((0, 4, 3)), np.ones((1, 3))
    for shoot, given in ((empty, one), (some, none), (empty, none)):
        every = shoot.all_hits(given, given)
        assert len(every.t) == len(every.ray) == 0
        assert every.offsets.tolist() == [0] * (len(given) + 1)
        assert shoot.count(given, given).shape == given.shape[:-1]
        assert shoot.points(shoot.intersect(given, given)).shape == given.shape
        closest = shoot.closest_point(given)
        assert closest.points.shape == given.shape
        assert np.all(closest.triangles == -1)
        assert np.all(np.isinf(closest.distances))
    with pytest.raises(SceneError, match="origins contain NaN"):
        empty.intersect([[np.nan, 0, 0]], one)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("way", "backend"),
    [
        ("any", "numpy"),
        pytest.param("alone", "opencl", marks=pytest.mark.slow),
        ("packets", "opencl"),
        ("any", "glsl"),
        pytest.param("any", "opencl", marks=pytest.mark.slow),
    ],
)
def test_rays_that_leave_a_surface_do_not_meet_it(backend, way, monkeypatch):
    """From points of a ball, and of a floor far larger than it, computed in f32 by a user."""
    mesh = joined([sphere(rings=30, segments=60), floor(1e4).moved((0, -1.5, 0), tilt=20)]).moved((3, 2, 1))
    monkeypatch.setattr(Intersector, "_way", lambda self, rays: way)
    shoot = Intersector(mesh, backend=backend)
    rng = np.random.default_rng(3)
    origins = (rng.normal(size=(2000, 3)) * 2 + [3, 8, 1]).astype(np.float32)
    hits = shoot.intersect(origins, (rng.normal(size=(2000, 3)) + [3, 2, 1] - origins).astype(np.float32))
    met = hits.triangle >= 0
    assert met.sum() > 1000
    from_below = origins[met] - shoot.points(hits)[met]
    start = shoot.points(hits)[met].astype(np.float32)
    normal = mesh.face_normals[hits.triangle[met]]
    normal *= np.sign(np.sum(normal * from_below, axis=1))[:, None]
    away = rng.normal(size=normal.shape)
    away *= np.sign(np.sum(away * normal, axis=1))[:, None]
    away[np.abs(np.sum(away * normal, axis=1)) < 0.05] = normal[np.abs(np.sum(away * normal, axis=1)) < 0.05]
    again, leaving = (shoot.intersect(start, away, leaving=leaves) for leaves in (False, True))
    own = hits.triangle[met]
    assert (again.triangle == own).sum() > 50
    assert not (leaving.triangle == own).any()
    depth = (
        14 * 2.0**-24 * np.abs(start.astype(np.float64))
    )  # an origin may be 16 roundings off, and it is rounded here
    below = (start - np.sign(normal) * depth).astype(np.float32)
    assert not (shoot.intersect(below, away, leaving=True).triangle == own).any()
    ahead = again.t > 1e-2  # what lies farther ahead is met all the same
    same_arrays((part[ahead] for part in leaving), (part[ahead] for part in again))
    far = shoot.count(start, away, 1e-3)
    np.testing.assert_array_equal(shoot.count(start, away, leaving=True), far)
    np.testing.assert_array_equal(shoot.occluded(start, away, leaving=True), far > 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "widths"),
    [
        pytest.param(0.0, ((1,), (16,)), marks=pytest.mark.slow),
        (16.0, ((16,), (1,))),
        pytest.param(16.0, ((1, 16), (1, 16)), marks=pytest.mark.slow),
    ],
)
def test_every_walk_keeps_rays_from_their_own_surface_in_the_same_way(start, widths):
    """The wide walk too, to the bit, for origins on triangles; without the bound some meet their own.

    Without it, test_bvh_walk.py compares all walks at all widths.
    """
    mesh = MESHES["five in one place"]
    structure, rows = build_bvh(mesh.corners), triangle_rows(mesh.corners)
    origins = mesh.corners.mean(axis=1).astype(np.float32)
    directions = np.random.default_rng(4).normal(size=origins.shape).astype(np.float32)
    bound = AheadBound(2.0**-24, start)
    walks = [walk_with(structure, rows, "opencl", bound), WideIntersector(structure, rows, bound)]
    programs = [intersect(walk, exact=False) for walk in (*walks, WideIntersector(structure, rows))]
    kernels = [programs[1].compile(backend, loop_limit=None) for backend in ("numpy", "glsl")]
    kernels += [
        p.compile("opencl", lanes=n, loop_limit=None) for p, lanes in zip(programs, widths, strict=False) for n in lanes
    ]
    kernels.append(programs[2].compile("numpy", loop_limit=None))
    first, *others, unbound = (kernel(origins, directions, 0.0, np.inf, (0, 0, 0), 1.0) for kernel in kernels)
    for other in others:
        same_arrays(other, first)
    found = [unbound, first]
    at_once = [np.sum(hits.t < 1e-5) for hits in found]
    assert at_once[1] < at_once[0]
    assert at_once[1] == 0 or not start


POINTS = np.concatenate(
    [
        np.random.default_rng(6).normal(size=(400, 3)),
        np.random.default_rng(7).normal(size=(50, 3)) * 1e5,
        SOUP.vertices[:60],
        SOUP.corners.mean(axis=1)[:60],
        SOUP.corners[:60, :2].mean(axis=1),
    ]
)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_closest_points_are_those_of_brute_force(backend):
    found = Intersector(SOUP, backend=backend).closest_point(POINTS)
    expected = distances(SOUP.corners, POINTS)
    least = expected.min(axis=1)
    np.testing.assert_allclose(found.distances, least, rtol=2e-6, atol=2e-6)
    np.testing.assert_allclose(expected[np.arange(len(POINTS)), found.triangles], least, rtol=2e-6, atol=2e-6)
    np.testing.assert_allclose(found.distances, np.linalg.norm(found.points - POINTS, axis=1))
    on = distances(SOUP.corners, found.points)[np.arange(len(POINTS)), found.triangles]
    near = np.linalg.norm(POINTS, axis=1) < 10
    assert on[near].max() < 2e-6
    same_arrays(found, Intersector(SOUP, backend="numpy").closest_point(POINTS))


@pytest.mark.slow
@pytest.mark.parametrize("widths", [(1, 16), pytest.param((4, 8), marks=pytest.mark.slow)])
def test_closest_points_have_the_same_bits_at_every_width(widths):
    program = nearby.closest_point(WideIntersector(build_bvh(SOUP.corners), triangle_rows(SOUP.corners)))
    expected = program.compile("numpy", loop_limit=None)(POINTS)
    for lanes in widths:
        same_arrays(program.compile("opencl", lanes=lanes, loop_limit=None)(POINTS), expected)


def test_closest_points_of_triangles_without_area():
    """Points and lines among triangles: the closest is found on them too."""
    corners = np.array(
        [
            [[0.0, 0, 0]] * 3,
            [[5.0, 0, 0], [5, 1, 0], [5, 3, 0]],
            [[0.0, 9, 0], [1, 9, 0], [0, 9, 0]],
            [[0.0, 0, 7], [1, 0, 7], [0, 1, 7]],
        ]
    )
    mesh = Mesh(corners.reshape(-1, 3), np.arange(12).reshape(-1, 3))
    points = [[0.1, 0.2, 0.3], [6, 2, 0], [0.5, 8.5, 0], [0.2, 0.2, 7.5]]
    found = Intersector(mesh, backend="numpy").closest_point(points)
    assert found.triangles.tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(found.points, [[0, 0, 0], [5, 2, 0], [0.5, 9, 0], [0.2, 0.2, 7]], atol=1e-6)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("scale", [1e-30, 1e-5, 1e5, 1e30])
def test_closest_points_in_scenes_of_all_sizes_and_places(scale):
    place = np.array([3.0, -2, 1]) * 1e3
    ball = sphere(rings=20, segments=40)
    mesh = Mesh((ball.vertices + place) * scale, ball.faces)
    points = (POINTS[:100] * 2 + place) * scale
    found = Intersector(mesh, backend="numpy").closest_point(points)
    np.testing.assert_allclose(
        found.distances / scale, distances(ball.corners, POINTS[:100] * 2).min(axis=1), atol=3e-6
    )


def test_points_far_away_have_a_closest_point():
    """Their distance is exact in f32; which point of the ball is closest is not known any more."""
    found = Intersector(sphere(), backend="numpy").closest_point([[1e12, 0, 0], [0, -1e30, 0], [0, 0, 1e200]])
    np.testing.assert_allclose(found.distances, [1e12, 1e30, 1e200], rtol=1e-6)
    assert np.abs(found.points).max() < 1.01
    assert np.all(found.triangles >= 0)


def test_of_triangles_in_one_place_the_first_is_closest():
    found = Intersector(joined([SOUP] * 3), backend="numpy").closest_point(POINTS)
    assert found.triangles.max() < len(SOUP)


def test_another_precision_has_no_closest_point():
    with pytest.raises(SceneError, match="closest_point works at precision=\"f32\", not 'f64'"):
        Intersector(box(), backend="numpy", precision="f64").closest_point([[0, 0, 0]])


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", ["f16", "f64"])
def test_all_hits_at_other_precisions(precision):
    origins, directions = rays(200)
    shoot = Intersector(MESHES["slabs"], backend="numpy", precision=precision)
    every = shoot.all_hits(origins, directions)
    np.testing.assert_array_equal(np.diff(every.offsets), shoot.count(origins, directions))
    assert every.t.dtype == {"f16": np.float16, "f64": np.float64}[precision]
    t = crossings(MESHES["slabs"].corners, origins.astype(float), directions.astype(float))
    if precision == "f64":
        np.testing.assert_allclose(every.t, t[every.ray, every.triangle], rtol=1e-11)
        assert len(every.t) == np.isfinite(t).sum()
    assert len(every.t) > 100


def turned(angle, offset, scale=1.0):
    """A turn about (1, 2, 3) by an angle in radians, then a move."""
    x, y, z = np.array([1, 2, 3]) / np.sqrt(14)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] = scale * (np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)
    matrix[:3, 3] = offset
    return matrix


@pytest.mark.slow
@pytest.mark.parametrize("accel", ["bvh", "grid", "ldc:64:triangle"])
def test_a_moved_mesh_is_hit_where_it_stands(accel):
    mesh, rng = knot(segments=60, sides=10), np.random.default_rng(3)
    shoot = Intersector(mesh, accel, backend="numpy")
    for transform in (turned(0.7, (3, -1, 2)), turned(2.5, (0, 0, 0), 4.0), np.diag([1.0, -1, 1, 1]), None):
        shoot.move(transform)
        matrix = np.eye(4) if transform is None else transform
        there = mesh.transformed(matrix)
        origins = there.corners.mean(axis=(0, 1)) + 5 * rng.normal(size=(400, 3))
        directions = there.corners[rng.integers(0, len(there), 400)].mean(axis=1) - origins
        hits, expected = (i.intersect(origins, directions) for i in (shoot, Intersector(there, backend="numpy")))
        met = hits.triangle >= 0
        assert met.sum() > 200
        alike = (hits.triangle == expected.triangle) & met
        assert (hits.triangle == expected.triangle).mean() > 0.98  # at edges either is right
        np.testing.assert_allclose(hits.t[alike], expected.t[alike], rtol=2e-5)
        seen = origins[alike] + hits.t[alike, None] * directions[alike]
        np.testing.assert_allclose(shoot.points(hits)[alike], seen, atol=1e-4)
        if accel == "bvh":
            near, wanted = (i.closest_point(origins) for i in (shoot, Intersector(there, backend="numpy")))
            np.testing.assert_allclose(near.distances, wanted.distances, rtol=1e-5)
            np.testing.assert_allclose(near.points, wanted.points, atol=1e-4)


def test_a_transform_that_is_changed_later_moves_nothing():
    shoot, transform = Intersector(box(), backend="numpy"), np.eye(4)
    shoot.move(transform)
    transform[:3, 3] = 5
    assert shoot.intersect([(0.1, 0.2, 3)], [(0, 0, -1)]).t == 2.5


def test_a_move_that_is_not_rigid_is_refused():
    shoot = Intersector(box(), backend="numpy")
    for transform in (
        np.diag([1.0, 2, 1, 1]),
        np.diag([0.0, 0, 0, 1]),
        np.eye(4) + 0.1 * np.eye(4, k=1) * [1, 1, 1, 0],
    ):
        with pytest.raises(SceneError, match="rotations, moves and one scale"):
            shoot.move(transform)
    with pytest.raises(SceneError, match=r"a matrix \(4, 4\)"):
        shoot.move(np.eye(3))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("accel", ["bvh", "grid", "brute", "ldc:64"])
def test_a_query_for_any_hit_ends_at_the_first_one(accel):
    shoot = Intersector(SOUP, accel=accel, backend="numpy")
    ray = shoot._geometry.frame.inputs(shoot._rays([(0, 0, 5)], [(0.05, 0.02, -1)], 0.0, np.inf), False)
    nearest, any_hit = (
        record(shoot._walks.walk, False).trace(*(np.asarray(part, np.float32) for part in ray), at=0)
        for record in (intersect, occluded)
    )
    assert len(any_hit) < len(nearest) / 2
    # The images of a cube along the other axes are left out.
    assert accel != "ldc:64" or {s.iterations[0] for s in any_hit if s.name == "axis" and s.iterations} == {1}
