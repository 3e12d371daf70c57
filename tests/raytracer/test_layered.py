"""Layered depth cubes: samples against their definition, hits against the hierarchy's, the same bits everywhere."""

import hashlib

import numpy as np
import pytest
from scene_pictures import BACKENDS, same_arrays

import shpy as sh
from raytracer import Intersector, LayeredCube, Mesh, Renderer, Scene, SceneError, cli, render
from raytracer.kernels import queries
from raytracer.kernels.triangle import AheadBound
from raytracer.kernels.walk import walk_with
from raytracer.layered.raster import INVERSE, LOW, SLACK
from raytracer.meshes.mesh import joined
from raytracer.meshes.shapes import box, floor, icosahedron, knot, sphere

SOUP = Mesh(np.random.default_rng(5).normal(size=(240, 3)), np.arange(240).reshape(-1, 3))
KNOT = knot(segments=40, sides=8)
THIN = Mesh([[0, 0, 0], [1, 1e-6, 0.3], [1, 0, 0.3], [0, 0, 1], [1e-7, 1, 1]], [[0, 1, 2], [0, 3, 4], [0, 2, 2]])
COPLANAR = joined([box(), box((0.5, 1, 0.5)), box().moved((1, 0, 0)), floor(3)])
MESHES = {
    "soup": SOUP,
    "knot": KNOT,
    "thin and without area": joined([THIN, sphere(rings=8, segments=12).moved((2, 0, 0))]),
    "coplanar": COPLANAR,
    "far away": KNOT.moved((1e5, -3e5, 2e5)),
    "one plane": floor(2),
}
HITS_ALONG_BORDERS = 39172, "0ea6d63d2cb7efe9"
CLOSED = {"ball": sphere(rings=12, segments=24), "icosahedron": icosahedron(), "box": box()}


def rays(mesh, count, seed=1):
    """Rays from the box round a mesh, a third of them from its surface, to the box; some along the axes."""
    rng = np.random.default_rng(seed)
    corners = mesh.corners
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    grown = 0.2 * (high - low).max()
    origins, targets = rng.uniform(low - grown, high + grown, (2, count, 3))
    some = corners[rng.integers(0, len(mesh), count)]
    origins[::3] = np.einsum("nk,nkd->nd", rng.dirichlet((1, 1, 1), count), some)[::3]
    targets[1::4] = some[1::4, 0]
    directions = (targets - origins).astype(np.float32)
    directions[::7] *= np.eye(3, dtype=np.float32)[rng.integers(0, 3, len(directions[::7]))]
    directions[~directions.any(axis=1)] = 1
    return origins.astype(np.float32), directions


@pytest.mark.slow
@pytest.mark.parametrize("conservative", [False, True])
def test_every_backend_gives_the_same_samples(conservative):
    numpy, *others = (LayeredCube.of(KNOT, 24, 8, backend, conservative=conservative) for backend in BACKENDS)
    assert numpy.samples == len(numpy.images.triangles) > 1000
    for cube in others:
        assert (cube.layers, cube.samples, cube.nbytes) == (numpy.layers, numpy.samples, numpy.nbytes)
        for name in ("offsets", "depths", "triangles", "slopes", "ranges", "slices"):
            bits, expected = (np.asarray(getattr(c.images, name)).view(np.uint32) for c in (cube, numpy))
            np.testing.assert_array_equal(bits, expected, name)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("conservative", [False, True])
def test_peeling_gives_the_same_samples(conservative):
    """Also of surfaces that lie in each other, and in every image."""
    mesh = joined([KNOT, COPLANAR, COPLANAR, SOUP])
    one, other = (
        LayeredCube.of(mesh, 20, 8, "glsl", conservative=conservative, builder=builder) for builder in ("sort", "peel")
    )
    assert min(one.layers) > 4
    for name in ("offsets", "depths", "triangles", "slopes", "ranges", "slices"):
        bits, expected = (np.asarray(getattr(c.images, name)).view(np.uint32) for c in (other, one))
        np.testing.assert_array_equal(bits, expected, name)


def texels_of(cube):
    """The image, row, column, depth and triangle of each sample."""
    n = cube.resolution
    texel = np.repeat(np.arange(3 * n * n), np.diff(cube.images.offsets))
    return texel // n**2, texel // n % n, texel % n, cube.images.depths.astype(float), cube.images.triangles


def image_corners(cube):
    """The image of each triangle and its corners (column, row, depth) there, in f64."""
    corners, normals = (cube.triangles.reshape(-1, 3, 4)[..., k] for k in (slice(0, 3), 3))
    image = np.abs(normals.astype(np.float32)).argmax(axis=1)
    place = (corners - cube.frame[LOW, :3].astype(float)) * cube.frame[INVERSE, :3].astype(float)
    axes = (image[:, None] + [1, 2]) % 3
    rows = np.take_along_axis(place, axes[:, None, :].repeat(3, 1), 2)
    depths = np.take_along_axis(corners, image[:, None, None].repeat(3, 1), 2)
    return image, np.concatenate([rows, depths], axis=2)


def test_samples_are_the_centres_that_triangles_cover():
    cube = LayeredCube.of(SOUP, 40, backend="numpy", conservative=False)
    found = {(i, r, c, t): depth for i, r, c, depth, t in zip(*texels_of(cube), strict=True)}
    middle = np.stack(np.meshgrid(np.arange(40) + 0.5, np.arange(40) + 0.5, indexing="xy"), axis=-1)
    expected = {}
    for number, (image, corners) in enumerate(zip(*image_corners(cube), strict=True)):
        edges = corners[:, :2] - np.roll(corners[:, :2], -1, axis=0)
        sides = [
            e[0] * (middle[..., 1] - p[1]) - e[1] * (middle[..., 0] - p[0]) for e, p in zip(edges, corners, strict=True)
        ]
        inside = (np.sign(sides) == np.sign(sides[0])).all(axis=0)
        plane = np.linalg.solve(np.c_[corners[:, :2], np.ones(3)], corners[:, 2])
        for row, column in np.argwhere(inside):
            expected[image, row, column, number] = plane @ (column + 0.5, row + 0.5, 1)
    assert len(expected) > 3000
    assert found.keys() == expected.keys()
    scale = np.abs(cube.triangles[:, :3]).max()
    np.testing.assert_allclose([found[k] for k in expected], list(expected.values()), atol=1e-6 * scale, rtol=0)


def test_samples_of_a_texel_are_sorted():
    cube = LayeredCube.of(joined([COPLANAR, COPLANAR]), 16, backend="numpy")
    image, row, column, depth, triangle = texels_of(cube)
    order = np.lexsort((triangle, depth, column, row, image))
    np.testing.assert_array_equal(order, np.arange(cube.samples))
    assert max(cube.layers) >= 4


def test_a_conservative_triangle_has_samples_wherever_it_lies():
    cube = LayeredCube.of(SOUP, 24, backend="numpy", hit="triangle")
    known = set(zip(*(part.tolist() for part in texels_of(cube)[:3]), cube.images.triangles.tolist(), strict=True))
    image, corners = image_corners(cube)
    weights = np.random.default_rng(2).dirichlet((0.4, 0.4, 0.4), (len(corners), 400))
    points = np.einsum("npk,nkd->npd", weights, corners)
    column, row = (np.clip(points[..., k].astype(int), 0, 23) for k in (0, 1))
    for k, places in enumerate(zip(row, column, strict=True)):
        assert {(image[k], r, c, k) for r, c in zip(*places, strict=True)} <= known
    centres = LayeredCube.of(SOUP, 24, backend="numpy", hit="triangle", conservative=False)
    assert centres.samples < cube.samples


def test_surfaces_stay_close_to_their_samples_within_a_texel():
    cube = LayeredCube.of(SOUP, 24, backend="numpy", hit="triangle")
    image, row, column, depth, triangle = texels_of(cube)
    slopes, slack = cube.images.slopes.astype(float), cube.frame[SLACK, :3].astype(float)
    corners = image_corners(cube)[1][triangle]
    plane = depth + np.einsum("nk,nk->n", corners[:, 0, :2] - np.stack([column + 0.5, row + 0.5], 1), slopes)
    np.testing.assert_allclose(plane, corners[:, 0, 2], atol=1e-5 * np.abs(cube.triangles).max())
    assert np.all(np.abs(slopes).sum(axis=1) / 2 <= slack[image])


@pytest.mark.sampled(6)
@pytest.mark.parametrize("name", MESHES)
def test_hits_of_triangles_are_those_of_the_hierarchy(name):
    """With conservative rasterisation none is missed, at any resolution, to the bit."""
    mesh = MESHES[name]
    origins, directions = rays(mesh, 3000)
    exact = Intersector(mesh, backend="opencl")
    hits = exact.intersect(origins, directions)
    assert (hits.triangle >= 0).sum() > 100
    cube = LayeredCube.of(mesh, 50, 16, "opencl", "triangle")
    same_arrays(Intersector(mesh, cube, "opencl").intersect(origins, directions), hits)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("hit", ["sample", "plane", "triangle"])
def test_every_backend_gives_the_same_hits(hit):
    origins, directions = rays(KNOT, 150)
    cube = LayeredCube.of(KNOT, 24, 8, "numpy", hit)
    one, *others = (Intersector(KNOT, cube, backend) for backend in BACKENDS)
    hits = one.intersect(origins, directions)
    assert (hits.triangle >= 0).sum() > 50
    for other in others:
        same_arrays(other.intersect(origins, directions), hits)
    if hit == "plane":
        left, *same_rays = (shoot.intersect(origins, directions, leaving=True) for shoot in (one, *others))
        for found in same_rays:
            same_arrays(found, left)


@pytest.mark.slow
def test_hits_of_centres_are_true_and_misses_fall_with_the_resolution():
    origins, directions = rays(KNOT, 8000)
    exact = Intersector(KNOT, backend="opencl")
    hits, every = exact.intersect(origins, directions), exact.all_hits(origins, directions)
    true = set(zip(every.ray.tolist(), every.triangle.tolist(), every.t.tolist(), strict=True))
    misses = []
    for resolution in (16, 64, 256):
        cube = LayeredCube.of(KNOT, resolution, backend="opencl", hit="triangle", conservative=False)
        found = Intersector(KNOT, cube, "opencl").intersect(origins, directions)
        met = np.flatnonzero(found.triangle >= 0)
        assert set(zip(met.tolist(), found.triangle[met].tolist(), found.t[met].tolist(), strict=True)) <= true
        misses.append(np.count_nonzero(found.t != hits.t))
    assert 0 < misses[2] < misses[1] / 2 < misses[0] / 4


def test_hits_of_rays_along_the_borders_of_cells_stay_as_they_are():
    """From and to points of a grid, so that rays begin, run and end in borders of cells and on samples' depths."""
    mesh = Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 1]], [[0, 1, 2], [0, 2, 3]])
    rng, count = np.random.default_rng(3), 60_000
    origins, targets = rng.choice(np.linspace(0, 1, 17), (2, count, 3))
    outside = np.arange(count), rng.integers(0, 3, count)
    origins[outside] = np.where(rng.random(count) < 0.5, -1, 2)
    directions = targets - origins
    straight = rng.random(count) < 0.4
    longest = np.abs(directions).max(axis=1, keepdims=True)
    directions[straight] = np.where(np.abs(directions) == longest, np.sign(directions), 0)[straight]
    origins, directions = origins.astype(np.float32), directions.astype(np.float32)
    shoot = Intersector(mesh, LayeredCube.of(mesh, 24, 8, "opencl", "sample"), "opencl")
    hits = shoot.intersect(origins, directions)
    found = int((hits.triangle >= 0).sum()), hashlib.sha256(hits.t.tobytes()).hexdigest()[:16]
    assert found == HITS_ALONG_BORDERS


@pytest.mark.parametrize("height", [0.5, 0.5 - 2**-21])
def test_a_ray_beside_a_surface_hits_its_samples_up_to_the_tolerance(height):
    """The surface lies at a border of the slices in which a block notes the depths of its samples."""
    square = Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    mesh, tolerance = joined([square.moved((0, 0, z)) for z in (0, height, 1)]), 2.0**-6
    inside = tolerance * (1 - np.array([0, 1e-6, 2e-6, 4e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1])[height < 0.5 :])
    outside = tolerance * (1 + np.array([4e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1]))
    heights = height + np.concatenate([inside, -inside, outside, -outside])
    origins = np.stack(np.broadcast_arrays(-1, 0.31, heights), axis=-1).astype(np.float32)
    cube = LayeredCube.of(mesh, 32, 8, "numpy", "sample", tolerance=tolerance)
    along = np.broadcast_to(np.float32([1, 0, 0]), origins.shape)
    hits = Intersector(mesh, cube, "numpy").intersect(origins, along)
    assert np.isin(hits.triangle[: 2 * len(inside)], [2, 3]).all()
    assert (hits.triangle[2 * len(inside) :] == -1).all()


@pytest.mark.slow
@pytest.mark.parametrize("hit", ["sample", "plane"])
def test_approximate_hits_come_nearer_with_the_resolution(hit):
    origins, directions = (part[1::3] for part in rays(CLOSED["ball"], 9000))
    exact = Intersector(CLOSED["ball"], backend="opencl").intersect(origins, directions)
    wrong = []
    for resolution in (32, 128, 512):
        found = Intersector(CLOSED["ball"], f"ldc:{resolution}:{hit}", "opencl").intersect(origins, directions)
        with np.errstate(invalid="ignore"):
            off = ~((found.t == exact.t) | (np.abs(found.t - exact.t) < 0.02))
        wrong.append(off.mean())
        weights = np.stack([found.u, found.v, 1 - found.u - found.v])
        assert weights.min() > -1e-6  # points to shade lie in their triangles
    assert wrong[2] < wrong[1] < wrong[0]
    assert wrong[2] < wrong[0] / 3


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", CLOSED)
def test_no_ray_leaves_a_closed_convex_mesh(name):
    mesh = CLOSED[name]
    rng = np.random.default_rng(3)
    weights = rng.random((4000, 3))
    weights[::3] = np.eye(3)[rng.integers(0, 3, len(weights[::3]))]
    weights[1::3, 0] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    targets = np.einsum("nk,nkd->nd", weights, mesh.corners[rng.integers(0, len(mesh), 4000)])
    size = np.ptp(mesh.vertices, axis=0)
    origins = (mesh.vertices.mean(axis=0) + rng.uniform(-0.15, 0.15, (4000, 3)) * size).astype(np.float32)
    directions = 3 * (targets - origins)
    for resolution in (1, 5, 33):
        cube = LayeredCube.of(mesh, resolution, 4, "opencl", "triangle")
        assert Intersector(mesh, cube, "opencl").occluded(origins, directions).all(), resolution


@pytest.mark.sampled(3)
@pytest.mark.parametrize("hit", ["triangle", "sample", "plane"])
def test_a_ray_that_misses_the_box_of_a_cube_hits_nothing(hit):
    rng = np.random.default_rng(8)
    origins, targets = rng.normal(size=(2, 4000, 3))
    origins *= 3 / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = targets - origins
    ends = (np.array([[-0.65], [0.65]])[:, None] - origins) / directions
    missing = ends.min(axis=0).max(axis=1) > ends.max(axis=0).min(axis=1)
    shoot = Intersector(box(), LayeredCube.of(box(), 16, backend="numpy", hit=hit), "numpy")
    found = shoot.intersect(origins.astype(np.float32), directions.astype(np.float32)).triangle
    assert (found[missing] == -1).all()
    assert (found[~missing] >= 0).sum() > 500 < missing.sum()


def test_rays_from_far_away_hit_what_they_hit_in_the_hierarchy():
    origins, directions = rays(KNOT, 2000)
    origins = origins - 1e4 * directions / np.linalg.norm(directions, axis=1)[:, None]
    exact = Intersector(KNOT, backend="opencl").intersect(origins, directions)
    assert (exact.triangle >= 0).sum() > 200
    same_arrays(Intersector(KNOT, "ldc:128:triangle", "opencl").intersect(origins, directions), exact)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("hit", ["sample", "plane", "triangle"])
def test_a_ray_that_leaves_a_surface_does_not_hit_it(hit):
    ball = sphere(rings=24, segments=48)
    rng = np.random.default_rng(6)
    number = rng.integers(0, len(ball), 4000)
    places = np.einsum("nk,nkd->nd", rng.dirichlet((1, 1, 1), 4000), ball.corners[number])
    outward = ball.face_normals[number] * np.sign(np.einsum("nk,nk->n", ball.face_normals[number], places))[:, None]
    found = Intersector(ball, f"ldc:128:{hit}", "opencl")
    assert found.occluded(places, outward + places, leaving=True).mean() < 0.001
    assert found.occluded(places, outward).mean() > 0.2


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("hit", "conservative"), [("plane", False), ("plane", True), ("sample", False)])
def test_how_near_a_ray_that_leaves_a_surface_hits_another_one(hit, conservative):
    """It takes `CLOSER` texels for planes of triangles that cover the centre of one, and `CLOSE` for other samples."""
    near = 2.0 if hit == "plane" and not conservative else 4.0
    texel = 4 / 64
    places = np.random.default_rng(2).uniform(-1.5, 1.5, (200, 3)) * (1, 0, 1)
    for factor, seen in ((0.9, False), (1.1, True)):
        lower, upper = floor(4), floor(4).moved((0, factor * near * texel, 0))
        mesh = Mesh(np.concatenate([lower.vertices, upper.vertices]), np.concatenate([lower.faces, upper.faces + 4]))
        cube = LayeredCube.of(mesh, 64, hit=hit, conservative=conservative, backend="numpy")
        found = Intersector(mesh, cube, "numpy").occluded(places, np.full((200, 3), (0.0, 1.0, 0.0)), leaving=True)
        assert (found == seen).all()


def test_pictures_and_the_command(tmp_path):
    """Exact where hits are, by the command and by a cube; the features say so."""
    scene = Scene.builtin("boxes")
    path = tmp_path / "boxes.npy"
    command = ["render", "boxes", "--size", "24x18", "--backend", "numpy", "--accel", "ldc:16:triangle"]
    assert cli.main([*command, "-o", str(path)]) == 0
    exact = render(scene, (24, 18), backend="numpy")
    np.testing.assert_array_equal(np.load(path)["pixels"], exact.pixels)
    cube = LayeredCube.of(scene, 16, backend="numpy", hit="triangle")
    image = render(scene, (24, 18), backend="numpy", accel="ldc", secondary=cube)
    np.testing.assert_array_equal(image.pixels, exact.pixels)
    np.testing.assert_array_equal(image.depth, exact.depth)
    assert image.stats.features["layered cube"] == 16


@pytest.mark.slow
def test_secondary_rays_of_path_tracing():
    check_secondary("cornell", "numpy", integrator="path", samples=2)


def test_rays_in_a_cube_walk_alone_and_others_in_packets(monkeypatch):
    scene = Scene.builtin("cornell")
    cube = LayeredCube.of(scene, 8, backend="numpy", hit="triangle")
    compiled = []
    monkeypatch.setattr(sh.Program, "compile", lambda *given, **options: compiled.append(options))
    for secondary in (None, cube):
        Renderer(scene, backend="opencl", secondary=secondary)
    assert [options.get("lanes", "auto") for options in compiled] == ["auto", 1]


def check_secondary(name, backend, **options):
    scene = Scene.builtin(name)
    cube = LayeredCube.of(scene, 64, backend=backend, hit="triangle")
    exact, image = (
        render(scene, (16, 12), backend=backend, secondary=secondary, **options) for secondary in (None, cube)
    )
    np.testing.assert_array_equal(image.pixels, exact.pixels)


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
def test_secondary_rays_on_every_backend(backend):
    check_secondary("glass", backend, bounces=2)
    check_secondary("mirror-box", backend)
    check_secondary("cornell", backend, integrator="path", samples=2)


def test_nothing_and_triangles_without_area():
    for mesh in (Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)), Mesh(np.eye(3), [[0, 1, 1]]), Scene()):
        cube = LayeredCube.of(mesh, 8, backend="numpy")
        assert (cube.samples, cube.layers) == (0, (0, 0, 0))
        hits = Intersector(mesh, cube, "numpy").intersect([[0, 0, 0]], [[1, 1, 1]])
        assert hits.triangle.tolist() == [-1]
    empty = Scene(background=(0.25, 0.5, 0.75))
    assert np.all(render(empty, (4, 3), accel="ldc:8", backend="numpy").pixels == (0.25, 0.5, 0.75))


def test_a_cube_says_what_it_is():
    cube = LayeredCube.of(box(), 16, 5, "numpy", "sample", tolerance=0.25)
    assert cube.samples == 6 * 16**2  # one at the border of two triangles
    assert (cube.resolution, cube.block, cube.hit, cube.tolerance) == (16, 5, "sample", 0.25)
    assert cube.build_seconds > 0
    assert cube.layers == (2, 2, 2)
    assert cube.nbytes == 4 * (3 * 16**2 + 1) + 16 * 3 * 4**2 + 8 * cube.samples
    assert "16^2 of 12 triangles, hit='sample'" in repr(cube)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"resolution": 0}, "resolution is a whole number from 1 to 8192, not 0"),
        ({"resolution": 9000}, "from 1 to 8192"),
        ({"block": True}, "block is a whole number"),
        ({"hit": "exact"}, "'sample', 'plane', 'triangle', not 'exact'"),
        ({"tolerance": 0.1}, 'tolerance is for hit="sample"'),
        ({"hit": "sample", "tolerance": -1}, "a length of 0 or more"),
        ({"mesh_or_scene": "bunny.obj"}, "not of str"),
        ({"builder": "draw"}, "'sort', 'peel', not 'draw'"),
        ({"builder": "peel"}, "backend=\"glsl\", not 'numpy'"),
    ],
)
def test_numbers_out_of_range_are_errors(arguments, words):
    with pytest.raises(SceneError, match=words):
        LayeredCube.of(**({"mesh_or_scene": box(), "backend": "numpy"} | arguments))


def test_cubes_where_they_cannot_be_used_are_errors():
    cube, scene = LayeredCube.of(box(), 4, backend="numpy"), Scene(meshes=box())
    with pytest.raises(SceneError, match="another mesh or scene"):
        Intersector(icosahedron(), cube, "numpy")
    with pytest.raises(SceneError, match='count hits with accel="bvh"'):
        Intersector(box(), cube, "numpy").count([[0, 0, 0]], [[1, 1, 1]])
    with pytest.raises(SceneError, match="precision=\"f32\", not 'f64'"):
        Intersector(box(), cube, "numpy", precision="f64")
    with pytest.raises(SceneError, match="precision=\"f32\", not 'f64'"):
        render(scene, (4, 3), accel="ldc", precision="f64")
    with pytest.raises(SceneError, match='tracer="unified" alone'):
        render(scene, (4, 3), secondary=cube, tracer="staged")
    with pytest.raises(SceneError, match="secondary is a LayeredCube, not str"):
        render(scene, (4, 3), secondary="ldc")
    with pytest.raises(SceneError, match="\"ldc:1024:triangle\", not 'ldc:big'"):
        render(scene, (4, 3), accel="ldc:big")
    with pytest.raises(SceneError, match="leave the choice to it"):
        render(scene, (4, 3), secondary=cube, max_error=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("hit", ["sample", "plane", "triangle"])
def test_every_width_of_packets_gives_the_same_hits(hit):
    origins, directions = rays(KNOT, 5000)
    shoot = Intersector(KNOT, f"ldc:100:{hit}", "opencl")
    program = queries.intersect(
        walk_with(shoot._geometry.structure, shoot._geometry.rows, "opencl", AheadBound(2.0**-24)), exact=True
    )
    inputs = origins * shoot._geometry.frame.scale, directions / 32, 0.0, 1e30, (0, 0, 0), 1.0
    one, *others = (program.compile("opencl", lanes=lanes, loop_limit=None)(*inputs) for lanes in (1, 4, 8, 16))
    assert (one.triangle >= 0).sum() > 1000
    for found in others:
        same_arrays(found, one)


@pytest.mark.slow
@pytest.mark.parametrize("name", MESHES)
def test_a_million_hits_are_those_of_the_hierarchy(name):
    mesh = MESHES[name]
    origins, directions = rays(mesh, 1_000_000, seed=4)
    exact = Intersector(mesh, backend="opencl").intersect(origins, directions)
    for resolution in (64, 512):
        same_arrays(Intersector(mesh, f"ldc:{resolution}:triangle", "opencl").intersect(origins, directions), exact)


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_floor_that_is_far_larger_takes_no_texels(backend):
    """The floor's hits are exact, those of the mesh are found as without it, and either hides the other."""
    mesh = joined([KNOT.moved((0, 3, 0)), floor(900)])
    alone, cube = (LayeredCube.of(m, 64, backend=backend) for m in (KNOT.moved((0, 3, 0)), mesh))
    assert cube.outside.tolist() == [len(KNOT), len(KNOT) + 1]
    assert (cube.samples, len(alone.outside)) == (alone.samples, 0)
    origins = KNOT.corners.mean(axis=(0, 1)) + [0, 3, 0] + np.random.default_rng(2).normal(size=(900, 3)) * 4
    origins[:, 1] = abs(origins[:, 1]) + 0.1
    targets, directions = rays(KNOT, 900)
    directions[::2] = (targets + [0, 3, 0] - origins)[::2]
    found, exact = (Intersector(mesh, accel, backend).intersect(origins, directions) for accel in (cube, "bvh"))
    of_floor = exact.triangle >= len(KNOT)
    assert of_floor.sum() > 100
    assert (found.triangle == exact.triangle)[of_floor].mean() > 0.97
    both = of_floor & (found.triangle == exact.triangle)
    same_arrays([part[both] for part in found], [part[both] for part in exact])
    bare = Intersector(KNOT.moved((0, 3, 0)), alone, backend).intersect(origins, directions)
    knot_first = (found.triangle >= 0) & (found.triangle < len(KNOT))
    assert knot_first.sum() > 100
    np.testing.assert_array_equal(found.triangle[knot_first], bare.triangle[knot_first])
    dark = Intersector(mesh, cube, backend).occluded(origins, directions)
    np.testing.assert_array_equal(dark, found.triangle >= 0)


@pytest.mark.slow
def test_a_framed_mesh_has_nearly_its_exact_picture():
    scene = Scene.framed(KNOT)
    exact, through = (
        render(scene, (40, 30), backend="numpy", bounces=1, accel=accel).srgb.astype(int)
        for accel in ("bvh", "ldc:256")
    )
    assert np.sqrt(((through - exact) ** 2).mean()) < 4
