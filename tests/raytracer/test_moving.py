"""Objects that move and change their shape: pictures are those of scenes made so, and what stays is not touched."""

import dataclasses
from unittest.mock import Mock

import numpy as np
import pytest
from scene_pictures import SIZE, same

import shpy as sh
from raytracer import Camera, DirectionalLight, Instance, Material, Mesh, PointLight, Renderer, Scene, SceneError
from raytracer.accel import forest
from raytracer.accel.forest import Forest
from raytracer.accel.ploc import build_bvh
from raytracer.accel.shape import Shape, plane_kernel, plane_program
from raytracer.integrators.motion import Motion
from raytracer.meshes.shapes import box, floor, icosahedron, sphere, torus

BACKENDS = ["numpy", "opencl", "glsl"]


def named(mesh, name):
    return dataclasses.replace(mesh, name=name)


def scene(**changes):
    cube = box((1, 1, 1))
    coloured = Mesh(cube.vertices, cube.faces, colors=np.eye(3)[np.arange(len(cube.vertices)) % 3])
    meshes = [
        named(sphere(1.0, Material((0.7, 0.7, 0.8), reflectivity=0.4), rings=6, segments=10).moved((0, 1, 0)), "ball"),
        named(coloured.moved((1.4, 0.5, 0.8), turn=30), "box"),
        named(icosahedron(0.6, Material((0.2, 0.6, 0.3))).moved((-1.3, 0.5, 0.9)), "stone"),
        named(floor(12, Material((0.5, 0.5, 0.5), specular=0.0, reflectivity=0.2)), "ground"),
    ]
    lights = [PointLight((3, 5, 4), (0.8, 0.7, 0.6)), DirectionalLight((1, -2, -1), (0.3, 0.3, 0.5))]
    given = {"meshes": meshes, "lights": lights, "camera": Camera((1, 2.5, 6), (0, 0.7, 0), fov=45)}
    return Scene(**(given | changes))


def turned(angle, offset=(0, 0, 0), scale=(1, 1, 1)):
    a = np.radians(angle)
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]) * scale
    matrix[:3, 3] = offset
    return matrix


MOVES = {
    "turned": turned(40),
    "far": turned(70, (0.5, 0.3, -2)),
    "mirrored": turned(10, (0, 0.1, 0), (-1, 1, 1)),
    "flat": turned(0, (0, 0.5, 0), (1, 0, 1)),
    "nothing": turned(0, (0, 0.5, 0), (0, 0, 0)),
}


def from_scratch(made, changes):
    return dataclasses.replace(made, meshes=[changes.get(mesh.name, mesh) for mesh in made.meshes])


WHITTED, PATH = {"bounces": 2}, {"integrator": "path", "samples": 1}
PATH_MOVES = {"numpy": ("turned", "nothing"), "opencl": ("far", "mirrored"), "glsl": ("turned", "flat")}
"""Every backend takes all moves with one integrator, and the other integrator takes all of them on some backend."""


@pytest.mark.sampled(6)
@pytest.mark.parametrize(
    ("backend", "options", "moves"),
    [pytest.param(backend, WHITTED, tuple(MOVES), id=f"{backend}-whitted") for backend in BACKENDS]
    + [pytest.param(backend, PATH, moves, id=f"{backend}-path") for backend, moves in PATH_MOVES.items()]
    + [
        pytest.param(backend, PATH, tuple(MOVES), id=f"{backend}-path-all", marks=pytest.mark.slow)
        for backend in BACKENDS
    ],
)
def test_moved_objects_are_where_a_new_scene_has_them(backend, options, moves):
    made = scene()
    renderer = Renderer(made, backend=backend, **options)
    same(renderer.render(SIZE), Renderer(made, backend=backend, **options).render(SIZE))
    ball, cube = made.meshes[:2]
    for number, matrix in enumerate(map(MOVES.get, moves)):
        renderer.move("ball", matrix)
        if number:
            renderer.move("box", matrix @ turned(15))
        there = {"ball": ball.transformed(matrix)} | ({"box": cube.transformed(matrix @ turned(15))} if number else {})
        expected = Renderer(from_scratch(made, there), backend=backend, **options).render(SIZE)
        same(renderer.render(SIZE), expected)
    assert renderer.builds == 3, "at first, and at the first move of each object"


@pytest.mark.sampled(4)
@pytest.mark.parametrize("backend", BACKENDS)
def test_deformed_objects_look_as_a_new_scene_has_them(backend):
    made = scene()
    renderer = Renderer(made, backend=backend, bounces=1)
    ball, stone = made.meshes[0], made.meshes[2]
    for step in range(1, 4):
        wavy = ball.vertices + 0.1 * step * np.sin(4 * ball.vertices[:, [1, 2, 0]])
        spiky = stone.vertices * (1 + 0.3 * step * (np.arange(len(stone.vertices)) % 2))[:, None]
        renderer.deform("ball", wavy)
        renderer.deform(2, spiky)
        renderer.move("ball", MOVES["turned"])
        there = {
            "ball": dataclasses.replace(ball, vertices=wavy).smoothed().transformed(MOVES["turned"]),
            "stone": dataclasses.replace(stone, vertices=spiky),
        }
        same(renderer.render(SIZE), Renderer(from_scratch(made, there), backend=backend, bounces=1).render(SIZE))
    assert renderer.builds == 2


def test_what_stays_is_neither_built_nor_sent_again(monkeypatch):
    made = scene(
        meshes=[
            *scene().meshes,
            *(named(torus(0.2, 0.1, segments=12, sides=8).moved((k, 2, -1)), "ring") for k in range(9)),
        ]
    )
    renderer = Renderer(made, backend="numpy", bounces=1)
    renderer.move("ball", turned(10))
    renderer.render(SIZE)
    built, sent = [], []
    monkeypatch.setattr(
        forest, "build_bvh", lambda corners, *rest: built.append(len(corners)) or build_bvh(corners, *rest)
    )
    update = sh.Table.update

    def counted(table, array, *, start=None):
        assert start is not None
        sent.append((table.name, len(array)))
        update(table, array, start=start)

    monkeypatch.setattr(sh.Table, "update", counted)
    renderer.move("ball", turned(25, (0.2, 0, 0)))
    renderer.render(SIZE)
    count = len(made.meshes[0])
    assert not built or built == [count]
    totals = {name: sum(n for other, n in sent if other == name) for name, _ in sent}
    assert totals["triangles"] == totals["leaves"] == totals["normals"] == 3 * count
    assert totals["items"] == count
    assert totals["boxes"] <= 2 * 2 * count
    assert renderer.builds == 2
    sent.clear()
    renderer.render(SIZE)
    assert not sent, "nothing has moved since"


def test_the_scene_is_the_one_that_is_shown():
    renderer = Renderer(scene(), backend="numpy", bounces=1)
    before = renderer.scene.meshes[0].vertices
    renderer.move("ball", turned(90, (0, 1, 0)))
    renderer.render((4, 4))
    assert not np.array_equal(renderer.scene.meshes[0].vertices, before)
    assert renderer.scene.camera == scene().camera
    renderer.move("ball", np.eye(4))
    renderer.render((4, 4))
    assert np.array_equal(renderer.scene.meshes[0].vertices, before)


@pytest.mark.sampled(6)
@pytest.mark.parametrize(
    ("backend", "options"),
    [(b, o) for k, b in enumerate(BACKENDS) for o in ((PATH, {}) if k % 2 else ({}, PATH))],
)
def test_lights_that_move_are_sent_and_nothing_is_built(backend, options):
    made = scene()
    renderer = Renderer(made, backend=backend, **options)
    renderer.render(SIZE)
    for step in range(1, 3):
        lights = [PointLight((3 - step, 5, 4), (0.8, 0.7, 0.1 * step)), DirectionalLight((step, -2, -1))]
        other = dataclasses.replace(made, lights=lights, background=(0.1 * step, 0.2, 0.3), ambient=0.05 * step)
        renderer.show(other)
        same(renderer.render(SIZE), Renderer(other, backend=backend, **options).render(SIZE))
    assert renderer.builds == 1
    renderer.show(dataclasses.replace(made, lights=[PointLight((3, 5, 4), falloff="square"), *made.lights[1:]]))
    assert renderer.builds == 2, "a light of another kind is another kernel"


def test_a_mesh_of_other_faces_is_shown_without_building_all():
    made = scene()
    renderer = Renderer(made, backend="numpy", bounces=1)
    cube = made.meshes[1]
    for turns in (1, 2):
        other = dataclasses.replace(cube, faces=np.roll(cube.faces, turns, axis=0))
        shown = from_scratch(made, {"box": other.moved((0, 0.1 * turns, 0))})
        renderer.show(shown)
        same(renderer.render(SIZE), Renderer(shown, backend="numpy", bounces=1).render(SIZE))
    assert renderer.builds == 2  # the first time, the box gets a hierarchy of its own


def test_arrays_that_are_changed_in_place_are_shown_as_they_are_now():
    made = scene()
    stone = made.meshes[2]
    places, transform = stone.vertices.copy(), np.eye(4)
    first = from_scratch(made, {"stone": dataclasses.replace(stone, vertices=places)})
    renderer = Renderer(first, backend="numpy", bounces=1)
    renderer.render(SIZE)
    places += (0.2, 0.4, 0)
    shown = from_scratch(made, {"stone": dataclasses.replace(stone, vertices=places)})
    renderer.show(shown)
    same(renderer.render(SIZE), Renderer(shown, backend="numpy", bounces=1).render(SIZE))
    renderer.move("stone", transform)
    transform[1, 3] = 3  # the next move may be made ready in the same array
    renderer.deform("stone", places)
    same(renderer.render(SIZE), Renderer(shown, backend="numpy", bounces=1).render(SIZE))


def test_a_scene_that_cannot_be_built_leaves_the_one_before():
    renderer = Renderer(scene(), backend="numpy", tracer="staged")
    before = renderer.render((8, 6))
    glass = named(sphere(1.0, Material(transmission=1.0, ior=1.5)), "ball")
    with pytest.raises(SceneError, match="glass"):
        renderer.show(scene(meshes=[glass]))
    assert renderer.scene.names == scene().names
    same(renderer.render((8, 6)), before)


def test_a_picture_that_fails_on_the_way_is_drawn_the_next_time(monkeypatch):
    made = scene()
    renderer = Renderer(made, backend="numpy", bounces=1)
    renderer.render((8, 6))
    renderer.move("ball", turned(30))

    def fail(*_):
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(forest, "build_bvh", fail)
        with pytest.raises(MemoryError):
            renderer.render((8, 6))
    there = {"ball": made.meshes[0].transformed(turned(30))}
    same(renderer.render(SIZE), Renderer(from_scratch(made, there), backend="numpy", bounces=1).render(SIZE))


@pytest.mark.slow
def test_a_scene_that_grows_beyond_its_scale_is_built_anew():
    made = scene()
    renderer = Renderer(made, backend="numpy", bounces=1)
    renderer.move("ball", turned(10))
    renderer.render((8, 6))
    for offset, builds in [((30, 0, 0), 3), ((1e6, 1e6, 0), 4), ((0, 0, 0), 5)]:
        renderer.move("ball", turned(0, offset))
        there = {"ball": made.meshes[0].transformed(turned(0, offset))}
        same(renderer.render(SIZE), Renderer(from_scratch(made, there), backend="numpy", bounces=1).render(SIZE))
        assert renderer.builds == builds


@pytest.mark.slow
@pytest.mark.parametrize(
    ("backend", "first"),
    [
        ("opencl", 2),
        ("glsl", 0),
        pytest.param("numpy", 2, marks=pytest.mark.slow),
        pytest.param("numpy", 0, marks=pytest.mark.slow),
        pytest.param("opencl", 0, marks=pytest.mark.slow),
    ],
)
def test_a_lamp_moves_and_vanishes(backend, first):
    lamp = named(box((0.5, 0.1, 0.5), Material((0.5, 0.5, 0.5), emission=(4, 3, 2))), "lamp")
    made = scene(meshes=[*scene().meshes, lamp], lights=[PointLight((3, 5, 4), falloff="square")])
    options = {"integrator": "path", "samples": 1, "backend": backend}
    renderer = Renderer(made, **options)
    moves = [turned(0, (0, 4, 0)), turned(20, (1, 3, 0), (2, 1, 1)), MOVES["flat"], turned(3, (0, 4, 0))]
    for matrix in moves[first:]:
        renderer.move("lamp", matrix)
        expected = Renderer(from_scratch(made, {"lamp": lamp.transformed(matrix)}), **options).render(SIZE)
        same(renderer.render(SIZE), expected)


def test_all_objects_may_move_and_any_number_of_them():
    many = [named(box((0.3, 0.3, 0.3)), f"box {k}") for k in range(13)]
    made = scene(meshes=many)
    renderer = Renderer(made, backend="numpy", bounces=1)
    for step in range(3):
        matrices = [turned(10 * step + k, (k % 4 - 2, (k * step) % 5 / 2, k % 3 - 1)) for k in range(13)]
        for k, matrix in enumerate(matrices):
            renderer.move(k, matrix)
        there = [Instance(mesh, matrix) for mesh, matrix in zip(many, matrices, strict=True)]
        same(renderer.render(SIZE), Renderer(scene(meshes=there), backend="numpy", bounces=1).render(SIZE))


def test_meshes_of_one_name_move_together():
    made = scene(meshes=[*scene().meshes, named(box((0.3, 0.3, 0.3)).moved((0, 2, 0)), "stone")])
    renderer = Renderer(made, backend="numpy", bounces=1)
    renderer.move("stone", turned(20, (0.2, 0.2, 0)))
    there = [mesh.transformed(turned(20, (0.2, 0.2, 0))) if mesh.name == "stone" else mesh for mesh in made.meshes]
    expected = Renderer(dataclasses.replace(made, meshes=there), backend="numpy", bounces=1)
    same(renderer.render(SIZE), expected.render(SIZE))
    with pytest.raises(SceneError, match=r"2 meshes 'stone'.*number, 2, 4"):
        renderer.deform("stone", made.meshes[2].vertices)


def test_a_mesh_that_is_missing_is_told_with_the_first_of_many_names():
    motion = Motion([named(box((1, 1, 1)), f"m{k}") for k in range(23)])
    with pytest.raises(SceneError, match=r"its meshes are m0, .*, m19 and 3 more$"):
        motion.numbers("m23")
    with pytest.raises(SceneError, match=r"its meshes are m0, m1$"):
        Motion(motion.meshes[:2]).numbers("m2")


def test_mistakes_are_refused_and_change_nothing():
    renderer = Renderer(scene(), backend="numpy", bounces=1)
    before = renderer.render((8, 6))
    vertices = renderer.scene.meshes[0].vertices
    for call, what in [
        (lambda: renderer.move("bal", np.eye(4)), "no mesh 'bal': its meshes are ball, box, stone, ground"),
        (lambda: renderer.move(4, np.eye(4)), "no mesh 4"),
        (lambda: renderer.move(0.5, np.eye(4)), r"no mesh 0\.5: its meshes are ball"),
        (lambda: renderer.move(None, np.eye(4)), "no mesh None"),
        (lambda: renderer.move([0], np.eye(4)), r"no mesh \[0\]"),
        (lambda: renderer.deform(False, vertices), "no mesh False"),
        (lambda: renderer.move("ball", np.eye(3)), r"a matrix \(4, 4\)"),
        (lambda: renderer.move("ball", np.full((4, 4), np.nan)), "finite"),
        (lambda: renderer.move("ball", turned(0, (1e37, 0, 0))), "scale the mesh"),
        (lambda: renderer.deform("ball", vertices[1:]), "as before"),
        (lambda: renderer.deform("ball", vertices * np.nan), "NaN"),
        (lambda: renderer.deform("stone", renderer.scene.meshes[2].vertices, np.ones((12, 3))), "flat"),
    ]:
        with pytest.raises(SceneError, match=what):
            call()
    same(renderer.render((8, 6)), before)


def test_the_accelerator_of_all_triangles_says_that_nothing_moves_there():
    renderer = Renderer(scene(), backend="numpy", accel="brute")
    with pytest.raises(SceneError, match="has accel='brute': choose accel=\"bvh\""):
        renderer.move("ball", np.eye(4))


def take(found, corners):
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    found.shapes[0].take(corners.reshape(-1, 3), faces, np.empty((3 * len(faces), 4)))
    found.change(0)


def test_a_refitted_hierarchy_is_built_anew_when_it_has_degraded():
    rng = np.random.default_rng(3)
    corners = rng.random((400, 1, 3)) * 10 + rng.random((400, 3, 3)) * 0.3
    found = Forest(corners, [(100, 300)])
    take(found, corners[100:300] * 1.5 + 3)
    assert found.rebuilt == 0, "another size and place make no other hierarchy"
    shuffled = rng.permutation(corners[100:300])
    take(found, shuffled)
    assert found.rebuilt == 1
    take(found, shuffled)
    assert found.rebuilt == 1


def hard_triangles():
    """Return vertices (V, 3) and faces: tiny and huge triangles, some without area, some with corners at 0."""
    rng = np.random.default_rng(5)
    vertices = rng.normal(size=(600, 3)) * 2.0 ** rng.integers(-60, 28, (600, 1))
    vertices[100:120] = 0
    vertices[200:260, 1] = 0
    return vertices.astype(np.float32).astype(np.float64), rng.integers(0, 600, (2000, 3))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["numpy", "opencl"])
def test_the_kernel_computes_the_tables_that_numpy_does(backend):
    vertices, faces = hard_triangles()
    shapes = [Shape(len(faces), np.dtype(np.float32)) for _ in range(2)]
    assert shapes[0].kernel is None
    shapes[1].kernel = plane_program().compile(backend, precision="f64")
    for step in range(2):
        for shape in shapes:
            shape.take(vertices + step, faces, np.empty((3 * len(faces), 4), np.float32))
        for name in ("rows", "levels", "sides"):
            one, other = (getattr(shape, name) for shape in shapes)
            assert np.array_equal(one, other), name


def test_only_a_device_without_f64_leaves_the_tables_to_numpy(monkeypatch):
    assert plane_kernel.__wrapped__("glsl") is None
    broken = Mock(**{"compile.side_effect": sh.CompileError("the driver refused the kernel")})
    monkeypatch.setattr("raytracer.accel.shape.plane_program", lambda: broken)
    with pytest.raises(sh.CompileError, match="refused the kernel"):
        plane_kernel.__wrapped__("opencl")


def test_pictures_of_objects_whose_tables_a_kernel_computes(monkeypatch):
    monkeypatch.setattr("raytracer.accel.shape.MANY", 1)
    made = scene()
    renderer = Renderer(made, backend="opencl")
    ball = made.meshes[0]
    for angle in (20, 50):
        renderer.move("ball", turned(angle))
        there = {"ball": ball.transformed(turned(angle))}
        same(renderer.render(SIZE), Renderer(from_scratch(made, there), backend="opencl").render(SIZE))
    assert renderer.layout.forest.shapes[0].kernel is not None
