"""An Intersector of instances that share their triangles: its answers are those of triangles of their own."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import shpy as sh
from raytracer import Instance, Intersector, Mesh, Scene, SceneError
from raytracer.meshes.shapes import floor, icosahedron, sphere
from raytracer.rays import Rays
from raytracer.scene import instanced
from tests.raytracer.test_moving_instances import place, scene_of

BACKENDS = ["numpy", "opencl", "glsl"]
RANDOM = np.random.default_rng(1)
ORIGINS = RANDOM.normal(size=(1500, 3))
ORIGINS = (4 * ORIGINS / np.linalg.norm(ORIGINS, axis=1)[:, None]).astype(np.float32)
DIRECTIONS = (RANDOM.uniform(-1.5, 1.5, ORIGINS.shape) - ORIGINS).astype(np.float32)


def assert_alike(one, other):
    """Compare hits of corners that lie within roundings of each other, 3e-7, on triangles down to 0.02 across."""
    np.testing.assert_array_equal(one.triangle, other.triangle)
    met = np.asarray(one.triangle) >= 0
    for name, most in (("t", 2e-6), ("u", 1e-4), ("v", 1e-4)):
        np.testing.assert_allclose(getattr(one, name)[met], getattr(other, name)[met], atol=most)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_all_queries_answer_as_among_triangles_of_their_own(backend):
    """Some instances are mirrored: their triangles have the corners of `mesh.corners`, in the other order."""
    one, other = (Intersector(scene_of(), accel, backend) for accel in ("bvh", "instances"))
    assert any(np.linalg.det(mesh.transform[:3, :3]) < 0 for mesh in scene_of().meshes[1:])
    for move in (False, True):
        if move:
            kernels = dict(other._kernels)
            for shoot in (one, other):
                shoot.move(3, place(9))
        hits = one.intersect(ORIGINS, DIRECTIONS)
        shared = other.intersect(ORIGINS, DIRECTIONS)
        assert_alike(hits, shared)
        np.testing.assert_allclose(other.points(shared), one.points(hits), atol=1e-5)
        count = one.count(ORIGINS, DIRECTIONS)
        np.testing.assert_array_equal(count, other.count(ORIGINS, DIRECTIONS))
        few = ORIGINS[count <= 4], DIRECTIONS[count <= 4]  # more would need another kernel
        assert_alike(one.all_hits(*few), other.all_hits(*few))
        np.testing.assert_array_equal(one.occluded(ORIGINS, DIRECTIONS), other.occluded(ORIGINS, DIRECTIONS))
    assert other._kernels == kernels  # the move changed places alone
    assert_alike(hits, pickle.loads(pickle.dumps(copy.deepcopy(other))).intersect(ORIGINS, DIRECTIONS))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_programs_and_streams_meet_instances(backend):
    def answers(accel):
        shoot = Intersector(scene_of(), accel, backend)
        if accel == "bvh":
            shoot.move(3, np.eye(4))  # gives it an accelerator of its own, with other tables

        @sh.program
        def seen(origin: sh.Point3f, direction: sh.Vector3f):
            hit = shoot.trace(origin, direction)
            onward = shoot.blocked(hit.position, sh.Vector3f(3, 8, 5))
            names = ("t", "triangle", "u", "v", "object", "normal", "face", "uv", "position")
            return {name: getattr(hit, name) for name in names} | {"onward": onward}

        kernel = seen.compile(backend)
        before = kernel(ORIGINS, DIRECTIONS)
        shoot.move(3, place(9))
        return before, kernel(ORIGINS, DIRECTIONS)

    for one, other in zip(answers("bvh"), answers("instances"), strict=True):
        met = one["triangle"] >= 0
        assert met.sum() > 900
        for name in ("triangle", "object"):
            np.testing.assert_array_equal(other[name], one[name])
        lit = met & (one["face"] @ np.float32([3, 8, 5]) > 0)  # other rays go on through the triangle itself
        np.testing.assert_array_equal(other["onward"][lit], one["onward"][lit])
        for name in ("t", "u", "v", "normal", "face", "uv", "position"):
            np.testing.assert_allclose(other[name][met], one[name][met], atol=3e-5, err_msg=name)
    shoot = Intersector(scene_of(), "instances", backend)
    rays = sh.Stream(ORIGINS, sh.Point3f, backend=backend), sh.Stream(DIRECTIONS, sh.Vector3f, backend=backend)
    np.testing.assert_array_equal(
        shoot.intersect(*rays).triangle.numpy(), shoot.intersect(ORIGINS, DIRECTIONS).triangle
    )


def test_many_instances_share_triangles_by_default_and_a_mesh_beside_them_moves(monkeypatch):
    monkeypatch.setattr(instanced, "MANY", 40)
    monkeypatch.setattr(instanced, "BEGINNING", 10)
    ball, ground = icosahedron(), floor(9).moved((0, -2, 0))
    scene = Scene([ground, *(Instance(ball, place(k)) for k in range(4))])
    shoot, own = Intersector(scene, backend="numpy"), Intersector(scene, "bvh", "numpy")
    assert len(shoot._geometry.layout.triangles) == 3 * (20 + 2)
    lower = np.eye(4)
    lower[1, 3] = -0.5
    for each in (shoot, own):
        each.move(0, lower)
    assert_alike(own.intersect(ORIGINS, DIRECTIONS), shoot.intersect(ORIGINS, DIRECTIONS))
    with pytest.raises(SceneError, match="there is nothing to move"):
        Intersector(Scene([*scene.meshes, Mesh(np.zeros((0, 3)), [])]), "instances", "numpy").move(5, lower)
    with pytest.raises(SceneError, match='accel="instances" works at precision="f32", not \'f64\''):
        Intersector(scene, "instances", precision="f64")
    assert Intersector(scene, precision="f64", backend="numpy").count(ORIGINS[:3], DIRECTIONS[:3]).shape == (3,)


def test_closest_points_and_poses_of_instances():
    shoot, own = (Intersector(scene_of(meshes=(sphere(0.5),)), accel, "numpy") for accel in ("instances", "bvh"))
    turn = np.diag([1.0, -1.0, 1.0, 1.0])
    for each in (shoot, own):
        each.move(turn)
        each.move(2, place(5))
    one, other = own.closest_point(ORIGINS[:40]), shoot.closest_point(ORIGINS[:40])
    np.testing.assert_array_equal(one.triangles, other.triangles)
    np.testing.assert_array_equal(one.points, other.points)
    assert_alike(own.intersect(ORIGINS, DIRECTIONS), shoot.intersect(ORIGINS, DIRECTIONS))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(36))
def test_a_ray_alone_meets_what_packets_meet(seed):
    """Rays start and aim close to vertices of parts that are flat, tiny or far away: roundings of their way decide."""
    random, scales = np.random.default_rng(seed), ((1, 1, 1), (1, 1e-3, 1), (1e-4, -1e-4, 1e-4), (1, 1e-5, 3))
    mesh = dataclasses.replace(sphere(1.0, rings=4, segments=6), normals=None, uv=None)
    away = np.eye(4)
    away[:3, 3] = random.uniform(-1, 1, 3) * 10.0 ** random.uniform(-1, 3)
    scene = Scene([Instance(mesh, away @ place(k, scale=scales[seed % 4])) for k in range(30)])
    corners, (low, high), count = np.concatenate([mesh.vertices for mesh in scene.meshes]), scene.bounds, (6000, 1)
    size = float((high - low).max())
    far = (low + high) / 2 + random.normal(size=(6000, 3)) * size * 10.0 ** random.uniform(-1, 2, count)
    origins = np.where(random.random(count) < 0.5, random.choice(corners, 6000), far)
    beside = random.normal(size=(6000, 3)) * size * 10.0 ** random.uniform(-7, -1, count)
    rays = origins.astype(np.float32), (random.choice(corners, 6000) + beside - origins).astype(np.float32)
    one, other = (Intersector(scene, "instances", backend) for backend in ("numpy", "opencl"))
    assert other._way(Rays.of(*rays, 0.0, np.inf)) == "alone"
    hits = one.intersect(*rays)
    assert np.count_nonzero(hits.triangle >= 0) > 1000
    for name, array in zip(hits._fields, other.intersect(*rays), strict=True):
        np.testing.assert_array_equal(getattr(hits, name), array, name)
