"""Instances that share triangles: hits and pictures are those of scenes in which each has triangles of its own."""

import copy
import dataclasses
import pickle
from functools import cache

import numpy as np
import pytest

import shpy as sh
from raytracer import (
    Camera,
    DirectionalLight,
    Hit,
    Instance,
    Material,
    Mesh,
    MetallicRoughness,
    Path,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    Staged,
    Surface,
    Texture,
    Whitted,
    render,
)
from raytracer.accel.ploc import build_bvh
from raytracer.accel.space import triangle_rows
from raytracer.kernels import walk
from raytracer.kernels.walk import walk_with
from raytracer.meshes.mesh import PlacedMesh
from raytracer.meshes.shapes import box, floor, icosahedron, sphere
from raytracer.scene import instanced
from raytracer.scene.layout import Layout

BACKENDS = ["numpy", "opencl", "glsl"]
SIZE = (64, 48)
INTEGRATORS = {"whitted": Whitted, "path": lambda **options: Path(samples=1, bounces=2, **options)}


def numbered(hit: Hit) -> Surface:
    share = sh.Attrib1f((hit.triangle + 5 * hit.object) % 7) / 7
    return Surface(color=sh.Color3f(share, 1 - share, 0.5))


def place(random, scale=(1, 1, 1), spread=3.0):
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3] = turn * random.uniform(0.5, 1.0, 3) * scale
    matrix[:3, 3] = random.uniform(-spread, spread, 3)
    return matrix


@pytest.fixture(scope="module")
def scene():
    """Mirrored, sheared and nested instances of smooth, flat, coloured, pictured and shining meshes, and a floor."""
    random = np.random.default_rng(7)
    holes = Texture((random.random((4, 4, 3)) > 0.3).astype(np.float32), filter="nearest")
    bumps = Texture(random.uniform(0.3, 0.7, (4, 4, 3)).astype(np.float32), srgb=False)
    ball = sphere(0.8, Material((0.9, 0.5, 0.2), reflectivity=0.3, normal_map=bumps), rings=8, segments=12)
    leaf = floor(2, Material((0.2, 0.7, 0.2), cutout=holes))
    stone = icosahedron(0.7, Material(surface=numbered))
    gem = icosahedron(0.6, MetallicRoughness((0.9, 0.8, 0.4), metallic=1.0, roughness=0.4))
    painted = dataclasses.replace(box(), colors=random.random((8, 3)))
    lamp = icosahedron(0.2, Material(emission=(4, 4, 3)))
    parts = [floor(12, Material((0.6, 0.6, 0.6))).moved((0, -3, 0))]
    for mesh in (ball, leaf, stone, gem, painted, lamp):
        parts += [Instance(mesh, place(random, scale)) for scale in ((1, 1, 1), (-1, 1, 1), (0.4, 1, 1.5))]
    shear = np.eye(4)
    shear[0, 1] = 0.6
    parts.append(Instance(Instance(stone, place(random)).placed, shear))
    parts.append(Instance(ball.with_material(Material((0.1, 0.2, 0.9))), place(random), "blue"))
    camera = Camera((4, 3, 7), (0, -0.5, 0))
    return Scene(parts, [PointLight((3, 8, 5), (1, 1, 1))], camera, background=(0.3, 0.4, 0.5))


@pytest.fixture(scope="module", params=["whitted", pytest.param("path", marks=pytest.mark.slow)])
def pictures(request, scene):
    """An integrator's pictures by the name of an accelerator and a backend, each of which is rendered once.

    They are transparent: the eye sees nothing behind holes of instances.
    """
    integrator = INTEGRATORS[request.param]
    return cache(
        lambda accel, backend: render(
            scene, SIZE, integrator=integrator(accel=accel), backend=backend, transparent=True
        )
    )


@pytest.mark.slow
def test_pictures_have_the_same_bits_on_all_backends(pictures):
    picture = pictures("instances", "numpy")
    for backend in BACKENDS[1:]:
        other = pictures("instances", backend)
        for name in ("pixels", "alpha", "depth", "normal", "object_id", "rays"):
            np.testing.assert_array_equal(getattr(other, name), getattr(picture, name), name)


def test_pictures_are_those_of_triangles_of_their_own(pictures):
    plain, picture = pictures("bvh", "numpy"), pictures("instances", "numpy")
    seen = plain.object_id >= 0
    assert len(np.unique(plain.object_id)) > 18
    assert np.count_nonzero(plain.object_id != picture.object_id) <= 1
    assert np.count_nonzero(plain.alpha != picture.alpha) <= 1
    assert set(np.unique(picture.alpha)) == {0, 1}
    assert np.count_nonzero(np.abs(plain.pixels - picture.pixels).max(axis=-1) > 1e-3) <= 1  # edges of shadows
    same = seen & (plain.object_id == picture.object_id)
    np.testing.assert_allclose(picture.depth[same], plain.depth[same], rtol=1e-6)
    assert np.median(np.abs(picture.normal - plain.normal)[same]) < 1e-6


def nearest_of(way):
    @sh.program
    def nearest(eye: sh.Point3f, ray: sh.Vector3f):
        hit = way(ray, eye, 0.0, sh.Attrib1f(1e38), False)
        return {"t": hit.l, "triangle": sh.Attrib1i(hit.id if hit.instance is None else hit.order), "uv": hit.uv}

    return nearest


@pytest.mark.sampled(2)
@pytest.mark.parametrize("changes", [{"aperture": 0.3}, {"projection": "orthographic", "span": 9.0}])
def test_lenses_parallel_rays_and_compensated_metals_see_instances(scene, changes):
    gem = icosahedron(0.6, MetallicRoughness((0.9, 0.8, 0.4), metallic=1.0, roughness=0.8, multiscatter=True))
    gems = [Instance(gem, place(np.random.default_rng(seed))) for seed in range(4)]
    camera = dataclasses.replace(scene.camera, **changes)
    seen = dataclasses.replace(scene, meshes=[*scene.meshes, *gems], camera=camera)
    plain, shared = (
        render(seen, (32, 24), integrator=Whitted(accel=accel, bounces=1, samples=4), backend="numpy")
        for accel in ("bvh", "instances")
    )
    near = np.abs(plain.pixels - shared.pixels).max(axis=-1) < 1e-3
    assert near.mean() > 0.99
    assert (plain.object_id == shared.object_id).mean() > 0.995
    assert plain.object_id.max() >= len(scene.meshes)


def test_hits_are_to_the_bit_those_of_corners_that_the_matrices_place():
    random = np.random.default_rng(2)
    ball = sphere(1.0, rings=8, segments=12)
    scene = Scene([Instance(ball, place(random, (1, 1, -1) if k % 2 else (1, 0.3, 1))) for k in range(40)])
    layout = Layout.of(scene, "instances")
    matrices = layout.instanced.levels.rows.reshape(-1, 10, 4)[:, :3]
    local = layout.triangles[:, :3].astype(np.float32)
    x, y, z = (local[:, None, axis] * matrices[:, None, :, axis] for axis in range(3))
    corners = (((x + y) + z) + matrices[:, None, :, 3]).reshape(-1, 3, 3).astype(np.float64)
    tree = build_bvh(corners)
    walks = walk_with(tree, triangle_rows(corners), "numpy"), walk_with(layout.structure, layout.triangles, "numpy")
    eyes, rays = (random.normal(size=(3000, 3)).astype(np.float32) for _ in range(2))
    one, other = (nearest_of(walk).compile("numpy")(eyes * np.float32(layout.scale), rays) for walk in walks)
    assert np.count_nonzero(one["triangle"] >= 0) > 1000
    for name in ("triangle", "t", "uv"):
        np.testing.assert_array_equal(one[name], other[name], name)


def parts_of(way):
    @sh.program
    def nearest(eye: sh.Point3f, ray: sh.Vector3f):
        parts = way(ray, eye, 0.0, sh.Attrib1f(1e38), False).parts
        return dict(zip(("t", "id", "uv", "instance"), parts, strict=False))

    return nearest


@pytest.mark.parametrize("accel", ["bvh", "instances"])
def test_rays_that_all_walk_alone_hit_what_they_hit_together(accel, monkeypatch):
    """As the eye rays of path traced scenes of more than `ROOMY` triangles do."""
    monkeypatch.setattr(walk, "MANY", 1)
    monkeypatch.setattr(walk, "ROOMY", 0)
    random = np.random.default_rng(3)
    ball = sphere(1.0, rings=6, segments=8)
    scene = Scene([Instance(ball, place(random, (1, 1, -1) if k % 2 else (1, 0.3, 1))) for k in range(12)])
    eyes, rays = (random.normal(size=(2000, 3)).astype(np.float32) for _ in range(2))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    results = []
    for backend, scattered in (("numpy", None), ("opencl", "all")):
        layout = Layout.of(scene, accel)
        way = walk.scene_walk(layout, backend, scattered)
        results.append(parts_of(way).compile(backend)(eyes * np.float32(layout.scale), rays))
    assert type(way) is walk.AloneWalk
    assert np.count_nonzero(results[0]["id"] >= 0) > 400
    for one, other in zip(*(result.values() for result in results), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seeds", [(0, 4, 8), (1, 5, 6), (2, 3, 7)])
def test_random_scenes_have_the_same_bits_and_the_objects_of_triangles_of_their_own(seeds):
    """Parts are flat, tiny or far away, and overlap: packets enter instances that some of their rays miss."""
    spreads, scales = (0.3, 3, 300), ((1, 1, 1), (1, 1e-3, 1), (1e-4, -1e-4, 1e-4))
    different = []
    for seed in seeds:
        random = np.random.default_rng(seed)
        mesh, middle = sphere(1.0, rings=4, segments=6), random.uniform(-1, 1, 3) * 10.0 ** random.uniform(-1, 3)
        spread, scale = spreads[seed % 3], scales[seed // 3]
        parts = [
            Instance(dataclasses.replace(mesh, normals=None, uv=None), place(random, scale, spread)) for _ in (0, 0)
        ]
        parts += [Instance(parts[0].mesh, place(random, scale, spread)) for _ in range(30)]
        away = np.eye(4)
        away[:3, 3] = middle
        scene = Scene([Instance(part.placed, away) for part in parts], [DirectionalLight((-1, -2, -1))])
        one, *others = (render(scene, (32, 24), accel="instances", backend=backend) for backend in BACKENDS)
        for other in others:
            for name in ("pixels", "depth", "normal", "object_id"):
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name), f"{seed}: {name}")
        plain = render(scene, (32, 24), accel="bvh", backend="numpy")
        different.append(np.count_nonzero(plain.object_id != one.object_id))
    assert not any(different)


def test_a_scene_without_instances_has_the_bits_of_its_hierarchy():
    scene = Scene.builtin("boxes")
    one, other = (
        render(scene, (32, 24), integrator=Whitted(accel=accel, bounces=1), backend="numpy")
        for accel in ("bvh", "instances")
    )
    for name in ("pixels", "depth", "normal", "object_id"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


def test_instances_alone_of_empty_meshes_and_without_an_inverse_are_settled():
    empty, away, flat = Mesh(np.zeros((0, 3)), []), np.eye(4), np.diag([1.0, 0.0, 1.0, 1.0])
    away[0, 3] = 5
    scene = Scene([Instance(mesh, at) for mesh in (empty, box(), icosahedron()) for at in (np.eye(4), away)][:-1])
    layout = Layout.of(scene, "instances")
    assert (layout.settled, len(layout.triangles) // 3, len(layout.instanced.meshes)) == (20, 32, 3)
    flattened = Scene([Instance(box(), flat), Instance(box(), flat)])
    assert not any(isinstance(mesh, PlacedMesh) for mesh in flattened.meshes)
    assert Layout.of(flattened, "instances").settled == 24
    assert Layout.of(Scene([Instance(icosahedron(), away)]), "instances").settled == 20


def test_many_instances_share_triangles_by_default(monkeypatch):
    monkeypatch.setattr(instanced, "MANY", 40)
    monkeypatch.setattr(instanced, "BEGINNING", 10)
    ball = icosahedron()
    ways = [np.eye(4) + np.diag([0, 0, 0], 1) for _ in range(3)]
    for k, way in enumerate(ways):
        way[0, 3] = 3 * k
    scene = Scene.framed([Instance(ball, way) for way in ways])
    kinds = [Renderer(scene, integrator=kind, backend="numpy") for kind in (Whitted(), Whitted(accel="bvh"))]
    assert [renderer.layout.settled for renderer in kinds] == [2, 62]
    assert kinds[0].layout.instanced.meshes[:, 0].tolist() == [0, 0, 1, 2]


def test_what_cannot_share_triangles_says_so():
    with pytest.raises(SceneError, match='accel="instances" works at precision="f32", not \'f64\''):
        Whitted(accel="instances", precision="f64")
    with pytest.raises(SceneError, match="the staged tracer goes through cells of a grid"):
        Staged(accel="instances")


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["numpy", *(pytest.param(name, marks=pytest.mark.slow) for name in BACKENDS[1:])])
def test_glass_stands_on_instances_and_holds_them(backend, monkeypatch):
    """Each body of glass has triangles of its own; the ray in it meets instances inside, and the one below it."""
    monkeypatch.setattr("raytracer.kernels.walk.MANY", 10)  # refracted rays walk alone
    glass = Material((0.9, 1, 0.95), transmission=0.9, ior=1.4, absorption=(0.3, 0.1, 0.2))
    plate, gem, drop = (
        box((2, 0.2, 2), Material((0.8, 0.3, 0.2))),
        icosahedron(0.3),
        sphere(0.4, glass, rings=8, segments=12),
    )
    places = [np.eye(4) for _ in range(4)]
    for at, (x, y, z) in zip(places, [(0, 0, 0), (1.4, 0.3, 0.2), (-1.2, 0.5, 0.3), (0.1, 0.6, 0)], strict=True):
        at[:3, 3] = x, y, z
    parts = [Instance(plate, at) for at in places[:2]] + [Instance(gem, at) for at in places[2:]]
    parts += [Instance(drop, at) for at in places[1:3]] + [box((1, 1, 1), glass).moved((0, 0.6, 0))]
    scene = Scene(parts, [PointLight((2, 5, 3))], Camera((1, 2, 4), (0.1, 0.3, 0)))
    shared = Renderer(scene, accel="instances", backend=backend)
    assert shared.layout.settled == 2 * len(drop) + 12
    assert shared._tracer.surfaces.media.touches
    one, other = (render(scene, SIZE, accel=accel, backend="numpy") for accel in ("bvh", "instances"))
    np.testing.assert_array_equal(shared.render(SIZE).pixels, other.pixels)
    assert np.count_nonzero(one.object_id != other.object_id) == 0
    assert np.count_nonzero(np.abs(one.pixels - other.pixels).max(axis=-1) > 1e-3) <= 2


def test_a_placed_mesh_is_the_transformed_one():
    random = np.random.default_rng(4)
    ball, matrix = sphere(rings=4, segments=5), place(random, (1, -1, 1))
    mesh, whole = Instance(ball, matrix, "ball").placed, ball.transformed(matrix)
    assert isinstance(mesh, PlacedMesh)
    for each in (mesh, pickle.loads(pickle.dumps(mesh)), copy.deepcopy(mesh), dataclasses.replace(mesh, name="other")):
        for name in ("vertices", "faces", "normals", "uv", "corners", "used_vertices"):
            np.testing.assert_array_equal(getattr(each, name), getattr(whole, name), name)
    red = mesh.with_material(Material((1, 0, 0)), "red")
    assert (type(red), red.name, red.source) == (PlacedMesh, "red", ball)
    assert type(mesh.moved((1, 0, 0))) is type(mesh.with_vertices(mesh.vertices, None)) is Mesh
    assert (mesh.with_vertices(mesh.vertices, None).name, len(mesh), mesh.has_area) == ("ball", 30, True)
