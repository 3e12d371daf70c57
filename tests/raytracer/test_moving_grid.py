"""Objects that move beside a static grid, and objects that an Intersector moves one by one."""

import dataclasses

import numpy as np
import pytest
from scene_pictures import SIZE, same, turned

import shpy as sh
from raytracer import Camera, Intersector, LayeredCube, Material, PointLight, Renderer, Scene, SceneError, TracedHit
from raytracer.integrators.staged import StagedTracer
from raytracer.meshes.shapes import box, floor, icosahedron, sphere
from raytracer.scene import layout

BACKENDS = ["numpy", "opencl", "glsl"]
MIRROR = Material((0.8, 0.3, 0.2), reflectivity=0.4)


def named(mesh, name):
    return dataclasses.replace(mesh, name=name)


def scene(**placed):
    """Return a ball, a box and a stone over a mirroring floor, some where a matrix takes them."""
    meshes = [
        named(floor(6, Material(reflectivity=0.2)).moved((0, -1, 0)), "ground"),
        named(sphere(0.6, MIRROR, rings=6, segments=10), "ball"),
        named(box((0.7, 0.9, 0.5), MIRROR).moved((1.4, 0, 0)), "box"),
        named(icosahedron(0.5).moved((-1.4, -0.4, 0.5)), "stone"),
    ]
    meshes = [mesh.transformed(placed[mesh.name]) if mesh.name in placed else mesh for mesh in meshes]
    return Scene(meshes, [PointLight((3, 6, 5), (0.8, 0.8, 0.7))], Camera((0, 2, 6), (0, 0, 0), fov=45))


MOVES = [
    {"ball": turned(0.7, (0.3, 0.2, -0.4)), "box": turned(-0.5, (0, 0, 0.3))},
    {"ball": turned(0.1, (0, 0.3, 0), (-1, 1.5, 1)), "box": turned(2, (-0.8, 0, -1), (0.5, 0.5, 0.5))},
    {"ball": turned(0, (0, 0.2, 0), (1, 0, 1)), "box": np.eye(4)},
]


@pytest.fixture
def built(monkeypatch):
    """The grids that are built, as the numbers of their triangles."""
    counts, own = [], layout.build_part

    def counted(corners, numbers, across=None):
        counts.append(len(numbers))
        return own(corners, numbers, across)

    monkeypatch.setattr(layout, "build_part", counted)
    return counts


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tracer", "backend"),
    [
        ("unified", "numpy"),
        ("unified", "opencl"),
        ("staged", "glsl"),
        pytest.param("unified", "glsl", marks=pytest.mark.slow),
        pytest.param("staged", "numpy", marks=pytest.mark.slow),
        pytest.param("staged", "opencl", marks=pytest.mark.slow),
    ],
)
def test_pictures_are_those_of_the_hierarchy_and_the_grid_stays(backend, tracer, built):
    grid = {"accel": "grid", "tracer": tracer, "bounces": 2, "backend": backend}
    renderer = Renderer(scene(), **grid)
    hierarchy = Renderer(scene(), bounces=2, backend="opencl")
    same(renderer.render(SIZE), hierarchy.render(SIZE))
    for move in MOVES:
        for name, matrix in move.items():
            renderer.move(name, matrix)
            hierarchy.move(name, matrix)
        same(renderer.render(SIZE), hierarchy.render(SIZE))
    assert renderer.builds == 2, "at first, and at the first moves"
    assert built == [2 + 20]
    if tracer == "unified" and backend == "numpy":
        same(renderer.render(SIZE), Renderer(scene(**MOVES[-1]), backend="numpy", bounces=2).render(SIZE))


@pytest.mark.slow
def test_paths_and_deformed_objects_beside_a_grid(built):
    options = {"integrator": "path", "samples": 1, "backend": "opencl"}
    renderers = [Renderer(scene(), accel=accel, **options) for accel in ("grid", "bvh")]
    ball = scene().meshes[1]
    for step in (1, 2):
        for renderer in renderers:
            renderer.deform("ball", ball.vertices * (1, 1 + 0.2 * step, 1))
            renderer.move("stone", turned(step, (0.1, 0, 0)))
        same(*(renderer.render(SIZE) for renderer in renderers))
    assert [renderer.builds for renderer in renderers] == [2, 2]
    assert built == [2 + 12]


def test_scenes_that_are_shown_one_after_the_other_keep_the_grid(built):
    renderer = Renderer(scene(), accel="grid", backend="numpy", bounces=1)
    for angle in (0.2, 0.4):
        shown = scene(stone=turned(angle, (0, angle, 0)))
        renderer.show(shown)
        same(renderer.render(SIZE), Renderer(shown, backend="numpy", bounces=1).render(SIZE))
    assert renderer.builds == 2
    assert built == [2 + len(scene().meshes[1]) + 12]


def test_everything_may_move():
    renderer = Renderer(scene(), accel="grid", backend="numpy", bounces=1)
    places = {name: turned(0.2 * k, (0.1 * k, 0, 0)) for k, name in enumerate(("ground", "ball", "box", "stone"))}
    for name, matrix in places.items():
        renderer.move(name, matrix)
    same(renderer.render(SIZE), Renderer(scene(**places), backend="numpy", bounces=1).render(SIZE))


def test_a_staged_scene_in_which_nothing_moves_has_no_stage_for_objects():
    still, moved = (Renderer(scene(), tracer="staged", backend="numpy", bounces=1) for _ in range(2))
    moved.move("ball", turned(0.1))
    for renderer in (still, moved):
        renderer.render((8, 6))
        assert isinstance(renderer.staged, StagedTracer)
    assert "objects" not in still.staged.programs
    assert moved.staged.log.calls["objects"] == moved.staged.log.calls["precalculate"]


def rays(count=900, seed=3):
    rng = np.random.default_rng(seed)
    origins = rng.uniform((-3, 0, -3), (3, 3, 3), (count, 3))
    targets = rng.uniform((-2, -1, -1), (2, 1, 1), (count, 3))
    return origins, targets - origins


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("accel", "backend"),
    [
        ("bvh", "numpy"),
        ("bvh", "opencl"),
        ("grid", "glsl"),
        ("ldc:32:triangle", "opencl"),
        pytest.param("bvh", "glsl", marks=pytest.mark.slow),
        pytest.param("grid", "numpy", marks=pytest.mark.slow),
    ],
)
def test_hits_after_a_move_are_those_of_a_new_scene(accel, backend):
    shoot, (origins, directions) = Intersector(scene(), accel, backend), rays()
    before = shoot.intersect(origins, directions)
    for move in MOVES[:2]:
        for name, matrix in move.items():
            shoot.move(name, matrix)
        fresh = Intersector(scene(**move), backend="numpy")
        hits = shoot.intersect(origins, directions)
        assert (hits.triangle != before.triangle).any()
        for column, expected in zip(hits, fresh.intersect(origins, directions), strict=True):
            np.testing.assert_array_equal(column, expected)
        np.testing.assert_array_equal(shoot.points(hits), fresh.points(hits))
        np.testing.assert_array_equal(shoot.occluded(origins, directions), hits.triangle >= 0)
    shoot.move("ball")
    shoot.move("box", None)
    for column, expected in zip(shoot.intersect(origins, directions), before, strict=True):
        np.testing.assert_array_equal(column, expected)


@pytest.mark.slow
@pytest.mark.parametrize("accel", ["bvh", "grid"])
def test_counts_lists_and_closest_points_after_a_move(accel):
    shoot, (origins, directions) = Intersector(scene(), accel, "numpy"), rays(200)
    shoot.count(origins, directions)
    shoot.closest_point(origins)
    for move in MOVES[:2]:
        for name, matrix in move.items():
            shoot.move(name, matrix)
        fresh = Intersector(scene(**move), backend="numpy")
        np.testing.assert_array_equal(shoot.count(origins, directions), fresh.count(origins, directions))
        for ask in (lambda one: one.all_hits(origins, directions), lambda one: one.closest_point(origins)):
            for answer, expected in zip(ask(shoot), ask(fresh), strict=True):
                np.testing.assert_array_equal(answer, expected)


def test_one_object_moves_among_all_that_are_moved_and_leaves_the_kernels():
    shoot, (origins, directions) = Intersector(scene(), backend="numpy"), rays(200)
    shoot.move("ball", MOVES[0]["ball"])
    first = shoot.intersect(origins, directions)
    kernels = dict(shoot._kernels)
    shoot.move(1, MOVES[1]["ball"])
    assert shoot._kernels == kernels
    shoot.move("ball", MOVES[0]["ball"])
    whole = turned(0.5, (1, 2, 3))
    shoot.move(whole)
    there = origins @ whole[:3, :3].T + whole[:3, 3]
    again = shoot.intersect(there, directions @ whole[:3, :3].T)
    assert (again.triangle == first.triangle).mean() > 0.99
    np.testing.assert_allclose(again.t[again.triangle >= 0], first.t[again.triangle >= 0], rtol=1e-3)
    shoot.move(None)
    np.testing.assert_array_equal(shoot.intersect(origins, directions).t, first.t)


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("accel", "backend"), [("bvh", "opencl"), ("grid", "glsl"), ("ldc:32:triangle", "numpy")])
def test_programs_that_trace_a_scene_see_moves(accel, backend):
    """Also of normals; recorded before the first move of an object, they are refused when they run."""
    shoot, (origins, directions) = Intersector(scene(), accel, backend), rays(300)
    origins, directions = origins.astype(np.float32), directions.astype(np.float32)

    def traced(one):
        @sh.program
        def hit_of(origin: sh.Point3f, direction: sh.Vector3f) -> TracedHit:
            return one.trace(origin, direction, leaving=False)

        return hit_of

    early = traced(shoot).compile(backend)
    before = early(origins, directions)
    shoot.move("ball", None)
    shoot.move("box", None)
    kernel = traced(shoot).compile(backend)
    for move in ({}, *MOVES[:2]):
        for name, matrix in move.items():
            shoot.move(name, matrix)
        hits = kernel(origins, directions)
        expected = traced(Intersector(scene(**move), backend="numpy")).compile("numpy")(origins, directions)
        for name, one in expected._asdict().items() if move else before._asdict().items():
            np.testing.assert_array_equal(getattr(hits, name), one, name)
        if move:
            assert (hits.triangle != before.triangle).any()
    with pytest.raises(SceneError, match=r"test_moving_grid\.py:\d+: the move of 'ball' has given .* program anew"):
        early(origins, directions)


def test_a_mesh_moves_by_its_own_name():
    ball = named(sphere(rings=6, segments=8), "ball")
    shoot = Intersector(ball, backend="numpy")
    shoot.move("ball", turned(0, (0, 2, 0)))
    assert shoot.occluded([[-5, 2, 0], [-5, 0, 0]], [[1, 0, 0]] * 2).tolist() == [True, False]


@pytest.mark.parametrize(
    ("accel", "move", "words"),
    [
        ("bvh", ("wheel", np.eye(4)), "no mesh 'wheel': its meshes are ground, ball, box, stone"),
        ("grid", (4, np.eye(4)), "no mesh 4: its meshes are ground"),
        ("bvh", (0.5, np.eye(4)), r"no mesh 0\.5"),
        ("bvh", ("ball", np.eye(3)), r"a matrix \(4, 4\)"),
        ("brute", ("ball", np.eye(4)), 'this Intersector has accel="brute": choose accel="bvh"'),
    ],
)
def test_moves_that_cannot_be_are_errors_and_change_nothing(accel, move, words):
    shoot, (origins, directions) = Intersector(scene(), accel, "numpy"), rays(50)
    before = shoot.intersect(origins, directions)
    with pytest.raises(SceneError, match=words):
        shoot.move(*move)
    for column, expected in zip(shoot.intersect(origins, directions), before, strict=True):
        np.testing.assert_array_equal(column, expected)


def test_a_cube_that_is_handed_over_gives_its_options_to_those_of_objects():
    cube = LayeredCube.of(scene(), 16, 8, "numpy", "plane", depths="half")
    shoot = Intersector(scene(), cube, "numpy")
    shoot.move("ball", turned(0.4))
    assert shoot._geometry.structure.options == cube.options
    origins, directions = rays(100)
    exact = Intersector(scene(ball=turned(0.4)), backend="numpy").occluded(origins, directions)
    assert (shoot.occluded(origins, directions) == exact).mean() > 0.9


@pytest.mark.slow
@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("accel", "backend"),
    [("bvh", "numpy"), ("grid", "glsl"), ("ldc:32:triangle", "opencl")],
)
def test_streams_of_rays_meet_objects_where_they_have_moved(accel, backend):
    """Queries that were compiled before a move see it; those through cubes of moved objects have one lane on OpenCL."""
    shoot, (origins, directions) = Intersector(scene(), accel, backend), rays(200)
    origins, directions = origins.astype(np.float32), directions.astype(np.float32)
    streams = sh.Stream(origins, sh.Point3f, backend), sh.Stream(directions, sh.Vector3f, backend)
    for move in ({}, *MOVES[:2]):
        for name, matrix in move.items():
            shoot.move(name, matrix)
        hits = shoot.intersect(*streams)
        expected = Intersector(scene(**move), backend="numpy").intersect(origins, directions)
        for field, stream in hits._asdict().items():
            np.testing.assert_array_equal(stream.numpy(), getattr(expected, field), field)
    if backend == "opencl":
        assert {kernel.options.lanes for kernel in shoot._kernels.values()} == {1}
