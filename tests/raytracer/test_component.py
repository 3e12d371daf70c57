"""A scene's walk inside programs of users: what it finds, how often a kernel has it, what moves, what is refused."""

import pickle
import re

import numpy as np
import pytest

import shpy as sh
from raytracer import Intersector, LayeredCube, Mesh, Scene, SceneError, TracedHit
from raytracer.meshes.shapes import box, floor, sphere
from shpy import SH_FOR, SH_IF
from shpy.view.controls import Controls

BACKENDS = ["numpy", "opencl", "glsl"]
BALL = sphere(1.0, rings=8, segments=12)
SCENE = Scene(
    [
        Mesh(np.zeros((0, 3)), []),
        box((1.5, 1, 1)).moved((-1.5, 0, 0), turn=20),
        BALL.moved((1, 0.2, 0)),
        floor(6).moved((0, -1, 0)),
    ]
)


def rays(count=400, seed=3):
    rng = np.random.default_rng(seed)
    origins = rng.uniform(-4, 4, (count, 3)).astype(np.float32)
    directions = (rng.uniform(-1.5, 1.5, (count, 3)) - origins).astype(np.float32)
    directions[::9] /= np.linalg.norm(directions[::9], axis=1, keepdims=True)  # of unit length within rounding
    return origins, directions


def traced(near, **options):
    @sh.program
    def trace_ray(origin: sh.Point3f, direction: sh.Vector3f) -> TracedHit:
        return near.trace(origin, direction, **options)

    return trace_ray


@pytest.mark.sampled(9)
@pytest.mark.parametrize(
    ("backend", "accel"),
    [("numpy", accel) for accel in ("bvh", "grid", "brute", "ldc:64", "ldc:64:triangle")]
    + [("opencl", "bvh"), ("glsl", "grid")],
)
def test_a_program_finds_what_the_host_finds(backend, accel):
    near, (origins, directions) = Intersector(SCENE, accel=accel, backend=backend), rays()
    result = traced(near, leaving=False).compile(backend)(origins, directions)
    hits = near.intersect(origins, directions)
    for name in ("t", "triangle", "u", "v"):
        np.testing.assert_array_equal(getattr(result, name), getattr(hits, name), name)
    np.testing.assert_array_equal(result.hit, hits.triangle >= 0)
    assert 0.2 < result.hit.mean() < 0.9


@pytest.fixture(scope="module")
def near():
    return Intersector(SCENE, backend="numpy")


@pytest.fixture(scope="module")
def kernel(near):
    return traced(near).compile("numpy")


def test_the_surface_is_that_of_the_scene(kernel):
    origins, directions = rays(2000)
    result = kernel(origins, directions)
    met = result.hit
    meshes = SCENE.meshes
    object_of = np.repeat(range(4), list(map(len, meshes)))
    np.testing.assert_array_equal(result.object, np.where(met, object_of[result.triangle], -1))
    assert set(result.object[met]) == {1, 2, 3}
    corners = np.concatenate([mesh.corners for mesh in meshes])
    weights = np.stack([1 - result.u - result.v, result.u, result.v], axis=1)[met].astype(np.float64)
    points = np.einsum("nk,nkd->nd", weights, corners[result.triangle[met]])
    np.testing.assert_allclose(result.position[met], points, atol=0.1)  # a ball of 8 rings is round to that
    flat = met & (result.object != 2)
    straight = origins.astype(np.float64)[flat] + result.t[flat, None] * directions[flat]
    np.testing.assert_allclose(result.position[flat], straight, atol=5e-6)
    # The point is on the side that the ray comes from, beyond the rounding errors of its triangle.
    face = np.concatenate([mesh.face_normals for mesh in meshes])[result.triangle[met]]
    face *= -np.sign(np.sum(face * directions[met], axis=1, keepdims=True))
    np.testing.assert_allclose(result.face[met], face, atol=1e-6)
    above = np.sum((result.position[met] - corners[result.triangle[met], 0]) * face, axis=1)
    assert np.all(above > 0)
    assert np.all(above[result.object[met] != 2] < 1e-5)


def test_normals_and_uv_are_interpolated(kernel):
    origins, directions = rays(2000)
    result = kernel(origins, directions)
    ball = result.object == 2
    numbers = result.triangle[ball] - len(SCENE.meshes[1])
    weights = np.stack([1 - result.u - result.v, result.u, result.v], axis=1)[ball].astype(np.float64)
    normal = np.einsum("nk,nkd->nd", weights, SCENE.meshes[2].normals[numbers])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal *= np.sign(np.sum(normal * result.face[ball], axis=1, keepdims=True))
    np.testing.assert_allclose(result.normal[ball], normal, atol=1e-6)
    uv = np.einsum("nk,nkd->nd", weights, SCENE.meshes[2].uv[numbers])
    np.testing.assert_allclose(result.uv[ball], uv, atol=1e-6)
    np.testing.assert_allclose(result.normal[result.object == 1], result.face[result.object == 1], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_rays_without_a_limit_meet_what_there_is_in_fast_mode(backend, near):
    origins, directions = rays(64)
    met = traced(near).compile(backend, math="fast")(origins, directions).hit
    assert (met == (near.intersect(origins, directions).triangle >= 0)).mean() > 0.9


def test_where_nothing_is_met(kernel):
    result = kernel([[0, 9, 0], [0, 9, 0], [np.nan, 0, 0]], [[0, 1, 0], [0, 0, 0], [0, 1, 0]])
    assert np.all(np.isinf(result.t))
    for name, value in {
        "triangle": -1,
        "object": -1,
        "u": 0,
        "v": 0,
        "hit": False,
        "normal": 0,
        "uv": 0,
        "position": 0,
    }.items():
        assert np.all(getattr(result, name) == value), name


def test_rays_that_go_on_from_a_hit_leave_its_triangle(near):
    @sh.program
    def onward(origin: sh.Point3f, direction: sh.Vector3f, way: sh.Vector3f) -> tuple[sh.Attrib1i, sh.Attrib1i]:
        first = near.trace(origin, direction)
        away = sh.cond(sh.dot(way, first.face) < 0, -way, way)
        second = near.trace(first.position, away)
        return first.triangle, sh.cond(first.hit, second.triangle, -2)

    origins, directions = rays(4000)
    way = np.random.default_rng(8).normal(size=(4000, 3))
    first, second = onward.compile("numpy")(origins, directions, way)
    assert np.all(first[second >= -1] != second[second >= -1])
    assert (second >= 0).mean() > 0.1


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["numpy", pytest.param("opencl", marks=pytest.mark.slow), "glsl"])
def test_the_walk_stands_once_in_a_kernel(backend):
    near = Intersector(SCENE, backend=backend)

    @sh.subroutine
    def lamp(place: sh.Point3f) -> sh.Attrib1f:
        return sh.cond(near.blocked(place, sh.Point3f(0, 5, 0) - place, t_max=1), 0.0, 1.0)

    @sh.program
    def several(origin: sh.Point3f, direction: sh.Vector3f) -> sh.Attrib1f:
        hit = near.trace(origin, direction)
        light = lamp(hit.position)
        with SH_FOR(0, 2) as k:
            light += lamp(hit.position + 0.1 * hit.face)
            with SH_IF(near.blocked(hit.position, (k + 1) * hit.face, t_min=0.1)):
                light += 1
        return light + near.trace(hit.position, hit.normal, t_min=0.5).u

    names = [function.name for function in several.ir.functions]
    assert [name for name in names if name.startswith("find_hit")] == ["find_hit"]
    kernel = several.compile(backend)
    if backend != "numpy":  # which has no functions
        assert len(re.findall(r"^.*\bvoid find_hit\w*\(", kernel.source, re.MULTILINE)) == 1
    origins, directions = rays(64)
    np.testing.assert_array_equal(kernel(origins, directions), several.compile("numpy")(origins, directions))


def test_two_scenes_in_one_program(near):
    other = Intersector(box((30, 1, 30)), accel="grid", backend="numpy")
    third = Intersector(BALL, accel="grid", backend="numpy")

    @sh.program
    def both(origin: sh.Point3f, boxes: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f, sh.Attrib1f]:
        down = np.array([0, -1, 0])
        return near.trace(origin, down).t, other.trace(origin, down).t, third.trace(origin, down).t * boxes

    result = both.compile("numpy")([[1, 9, 0], [0.1, 9, 0.1], [8, 9, 8]], 1)
    ray = [[1, 9, 0], [0.1, 9, 0.1], [8, 9, 8]], [[0, -1, 0]] * 3
    for t, intersector in zip(result, (near, other, third), strict=True):
        np.testing.assert_array_equal(t, intersector.intersect(*ray).t)


def test_blocked_is_occluded(near):
    @sh.program
    def dark(origin: sh.Point3f, direction: sh.Vector3f, t_max: sh.Attrib1f) -> sh.Attrib1b:
        return near.blocked(origin, direction, t_max, leaving=False)

    origins, directions = rays()
    ends = np.random.default_rng(2).uniform(0, 1.2, len(origins)).astype(np.float32)
    result = dark.compile("numpy")(origins, directions, ends)
    np.testing.assert_array_equal(result, near.occluded(origins, directions, ends))
    assert 0.2 < result.mean() < 0.8


def test_what_moves_reaches_programs_that_were_compiled():
    near = Intersector(SCENE, backend="numpy")
    kernel, (origins, directions) = traced(near).compile("numpy"), rays()
    before = kernel(origins, directions)
    turn = np.array([[0.6, 0, 0.8, 1], [0, 1, 0, 0.5], [-0.8, 0, 0.6, -2], [0, 0, 0, 1]])
    turn[:3, :3] *= 2
    near.move(turn)
    result, there = kernel(origins, directions), Scene([mesh.transformed(turn) for mesh in SCENE.meshes])
    expected = traced(Intersector(there, backend="numpy")).compile("numpy")(origins, directions)
    same = result.triangle == expected.triangle
    assert same.mean() > 0.99
    assert 0.2 < result.hit.mean() < 0.99
    met = same & result.hit
    for name in ("t", "normal", "face", "position", "uv"):
        np.testing.assert_allclose(getattr(result, name)[met], getattr(expected, name)[met], atol=2e-5, err_msg=name)
    start = result.position[met], result.face[met] + result.normal[met]
    assert np.all(kernel(*start).triangle != result.triangle[met])
    near.move(None)
    for name in TracedHit._fields if hasattr(TracedHit, "_fields") else ("t", "triangle", "position", "normal"):
        np.testing.assert_array_equal(getattr(kernel(origins, directions), name), getattr(before, name))


def test_an_intersector_and_its_programs_can_be_pickled():
    near, (origins, directions) = Intersector(SCENE, backend="numpy"), rays(40)
    program = traced(near)
    hits, result = near.intersect(origins, directions), program(origins, directions)
    copy, program_copy = pickle.loads(pickle.dumps((near, program)))
    assert copy.intersect(origins, directions).t.tobytes() == hits.t.tobytes()
    for other in (program_copy, traced(copy)):
        assert other(origins, directions).position.tobytes() == result.position.tobytes()


@pytest.mark.parametrize("accel", ["bvh", "grid", "ldc:16:half"])
def test_pages_show_no_sliders_of_the_scene(accel):
    height = sh.Param(sh.Attrib1f, 2.0)
    near = Intersector(SCENE, accel=accel, backend="numpy")

    @sh.program
    def trace_ray(direction: sh.Vector3f) -> sh.Attrib1f:
        return near.trace(sh.Point3f(0, height, 5), direction).t

    assert len(trace_ray.params) > 5
    assert [control["name"] for control in Controls(trace_ray.params).describe()] == ["height"]


def test_a_scene_far_from_0():
    near = Intersector(sphere(1.0, rings=6, segments=9).moved((5000, 0, 0)), backend="numpy")
    kernel = traced(near).compile("numpy")
    result = kernel([[5000, 0, 3]], [[0.1, 0.05, -1]])
    assert result.hit[0]
    np.testing.assert_allclose(
        result.position[0], [5000 + 0.1 * result.t[0], 0.05 * result.t[0], 3 - result.t[0]], atol=0.15
    )
    outward = np.random.default_rng(1).normal(size=(500, 3))
    outward *= np.sign(outward @ result.face[0])[:, None]
    assert not np.any(kernel(np.repeat(result.position, 500, axis=0), outward).hit)


# Streams


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_streams_of_rays_give_streams_of_hits(backend):
    near, (origins, directions) = Intersector(SCENE, backend=backend), rays()
    streams = sh.Stream(origins, sh.Point3f, backend), sh.Stream(directions, sh.Vector3f, backend)
    for leaving in (False, True):
        hits, expected = near.intersect(*streams, leaving=leaving), near.intersect(origins, directions, leaving=leaving)
        for name, stream in hits._asdict().items():
            assert isinstance(stream, sh.Stream)
            assert stream.shape == (len(origins),)
            np.testing.assert_array_equal(stream.numpy(), getattr(expected, name), name)
    ends = sh.Stream(np.linspace(0, 1, len(origins)), sh.Attrib1f, backend)
    dark = near.occluded(*streams, t_max=ends)
    assert isinstance(dark, sh.Stream)
    np.testing.assert_array_equal(dark.numpy(), near.occluded(origins, directions, ends.numpy()))


def test_streams_that_do_not_fit_are_refused(near):
    origins, directions = rays(6)
    here, there = sh.Stream(origins, sh.Point3f, "numpy"), sh.Stream(directions, sh.Vector3f, "opencl")
    with pytest.raises(SceneError, match=r"directions are not: sh.Stream\(directions, sh.Vector3f, backend='numpy'\)"):
        near.intersect(here, directions)
    with pytest.raises(SceneError, match=r"directions lie on opencl, and this Intersector works on numpy"):
        near.intersect(here, there)
    with pytest.raises(SceneError, match=r"origins have the shape \(6,\), but directions \(4,\)"):
        near.occluded(here, sh.Stream(directions[:4], sh.Vector3f, "numpy"))
    with pytest.raises(SceneError, match=r"directions are a stream of sh\.Vector3f, not of Attrib1f"):
        near.intersect(here, sh.Stream(directions[:, 0], sh.Attrib1f, "numpy"))
    with pytest.raises(SceneError, match="beside streams of rays t_max is a number, or a stream"):
        near.intersect(here, here, t_max=np.ones(6))


def test_streams_of_rays_through_nothing():
    empty = Intersector(Scene(), backend="numpy")
    ways = sh.Stream(np.ones((3, 3)), sh.Vector3f, "numpy")
    hits = empty.intersect(ways, ways)
    np.testing.assert_array_equal(hits.triangle.numpy(), [-1, -1, -1])
    assert not empty.occluded(ways, ways).any()


# Errors


def test_errors_name_the_line_and_what_to_write(near):
    with pytest.raises(
        SceneError, match=r"test_component.py:\d+: trace works while a program is recorded: call it in a"
    ):
        near.trace((0, 0, 0), (0, 0, 1))
    with pytest.raises(SceneError, match=r"test_component.py:\d+: blocked works .*occluded\(origins, directions\)"):
        near.blocked((0, 0, 0), (0, 0, 1))
    with pytest.raises(SceneError, match=r"test_component.py:\d+: trace needs triangles, and this scene has none"):
        traced(Intersector(Scene(), backend="numpy"))
    with pytest.raises(SceneError, match=r"the direction of trace is sh.Vector3f\(x, y, z\), not Attrib2f"):

        @sh.program
        def flat(origin: sh.Point3f, direction: sh.Attrib2f) -> sh.Attrib1f:
            return near.trace(origin, direction).t

    with pytest.raises(SceneError, match=r"the origin of trace is sh.Point3f\(p\), not Point3d"):

        @sh.program
        def exact(origin: sh.Point3d) -> sh.Attrib1f:
            return near.trace(origin, (0, 0, 1)).t

    with pytest.raises(SceneError, match="the t_max of blocked is a number, not 'far'"):

        @sh.program
        def word(origin: sh.Point3f) -> sh.Attrib1b:
            return near.blocked(origin, (0, 0, 1), "far")


def test_methods_for_arrays_say_what_programs_call(near):
    with pytest.raises(SceneError, match=r"test_component.py:\d+: origins are values of a program, .* call trace"):

        @sh.program
        def nearest(origin: sh.Point3f) -> sh.Attrib1f:
            return near.intersect(origin, origin).t


def test_another_precision_is_refused_before_anything_runs(kernel, near):
    program, ray = traced(near), ([[0, 0, 5]], [[0, 0, -1]])
    with pytest.raises(
        SceneError,
        match=r"test_component.py:\d+: this traces .* in f32, and .* runs in f64: .*precision=\"f32\"",
    ):
        program.compile("numpy", precision="f64")(*ray)
    exact = traced(Intersector(SCENE, backend="numpy", precision="f64"))
    assert exact.compile("numpy", precision="f64")(*ray).t.dtype == np.float64
    with pytest.raises(SceneError, match="a scene in f64, and its program runs in f32"):
        exact.compile("numpy")(*ray)
    with pytest.raises(SceneError, match="in f16"):
        traced(Intersector(BALL, backend="numpy", precision="f16"))


def test_a_cube_given_by_hand():
    cube = LayeredCube.of(BALL, resolution=32, backend="numpy")
    result = traced(Intersector(BALL, accel=cube, backend="numpy")).compile("numpy")([[0, 0, 5]], [[0.01, 0.02, -1]])
    np.testing.assert_allclose(result.t, 4, atol=0.05)
