"""Instances that share triangles and change between pictures: each picture is that of a new scene, to the bit."""

import dataclasses
import itertools
import sys
import types

import numpy as np
import pytest
from gltf_files import File
from test_gltf_animation import animated
from test_view_session import last, opened

from raytracer import (
    Camera,
    Instance,
    Material,
    Path,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    Texture,
    Whitted,
    render,
)
from raytracer.meshes.shapes import floor, icosahedron, sphere
from raytracer.scene import instanced
from raytracer.scene.animated_file import AnimatedFile

SIZE = (32, 24)
GROUND = floor(9, Material((0.5, 0.6, 0.5))).moved((0, -1, 0))
BALL = sphere(0.5, Material((0.9, 0.5, 0.2), reflectivity=0.3), rings=6, segments=9)
STONE = icosahedron(0.4, Material((0.4, 0.5, 0.9)))
HOLES = Texture((np.random.default_rng(5).random((3, 3, 3)) > 0.3).astype(np.float32), filter="nearest")
LEAF = floor(1.2, Material((0.2, 0.7, 0.2), cutout=HOLES))
CAMERA = Camera((1, 2, 6), (0, 0, 0), fov=30)
ROW = """
import numpy as np
import raytracer as rt
from raytracer.meshes.shapes import icosahedron

def scene(time):
    places = [np.eye(4) for _ in range(3)]
    for k, place in enumerate(places):
        place[0, 3] = k - 1 + time * (k == 1)
    gem = icosahedron(0.4, rt.Material((0.9, 0.1, 0.1)))
    gems = [rt.Instance(gem, place) for place in places]
    return rt.Scene(gems, [rt.PointLight((0, 5, 5))], rt.Camera((0, 1, 5), (0, 0, 0)))
"""
WHITTED, PATH = Whitted(accel="instances", bounces=1), Path(accel="instances", samples=1, bounces=2)
INTEGRATORS = {"whitted": WHITTED, "path": PATH}


def place(number, shift=0.0, scale=(1, 1, 1)):
    random = np.random.default_rng(number)
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3] = turn * random.uniform(0.5, 1, 3) * scale * (-1) ** number  # every other one is mirrored
    matrix[:3, 3] = random.uniform(-1.5, 1.5, 3) + (shift, 0, 0)
    return matrix


def scene_of(shift=0.0, meshes=(BALL, STONE, LEAF), count=4):
    parts = [
        Instance(mesh, place(len(meshes) * k + j, shift * (k == 1)), f"{mesh.name} {k}")
        for k in range(count)
        for j, mesh in enumerate(meshes)
    ]
    return Scene([GROUND, *parts], [PointLight((3, 8, 5))], CAMERA)


def assert_same(one, other):
    for name in ("pixels", "depth", "normal", "object_id"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("name", "backend"),
    [
        ("whitted", "glsl"),
        ("path", "opencl"),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in itertools.product(INTEGRATORS, ("numpy", "opencl", "glsl"))
            if case not in {("whitted", "glsl"), ("path", "opencl")}
        ),
    ],
)
def test_moved_instances_are_those_of_a_new_scene(name, backend, monkeypatch):
    integrator = INTEGRATORS[name]
    monkeypatch.setattr("raytracer.kernels.walk.MANY", 10)  # scattered rays walk alone
    before, after = scene_of(), scene_of(0.7)
    renderer = Renderer(before, integrator=integrator, backend=backend)
    first = renderer.render(SIZE)
    for number in (4, 5, 6):
        relative = after.meshes[number].transform @ np.linalg.inv(before.meshes[number].transform)
        renderer.move(number, np.round(relative, 12))
    moved = renderer.render(SIZE)
    assert renderer.builds == 1
    assert np.count_nonzero(moved.object_id != first.object_id) > 5
    assert_same(moved, Renderer(renderer.scene, integrator=integrator, backend=backend).render(SIZE))
    renderer.show(after)
    assert_same(renderer.render(SIZE), Renderer(after, integrator=integrator, backend=backend).render(SIZE))
    assert renderer.builds == 1


def check_changes(change, builds, scene=None, integrator=WHITTED):
    """Assert that the picture after a change of a Renderer is that of a new one, and how often all of it was built."""
    renderer = Renderer(scene or scene_of(), integrator=integrator, backend="numpy")
    before = renderer.render(SIZE)
    change(renderer)
    after = renderer.render(SIZE)
    assert renderer.builds == builds
    assert np.any(after.pixels != before.pixels)
    assert_same(after, Renderer(renderer.scene, integrator=integrator, backend="numpy").render(SIZE))
    return renderer


def test_numbers_of_materials_and_lights_change_without_a_new_layout():
    pink = dataclasses.replace(STONE.material, color=(0.9, 0.4, 0.5))

    def painted(material, number=2):
        scene = scene_of()
        meshes = [
            mesh.with_material(material) if mesh.material == scene.meshes[number].material else mesh
            for mesh in scene.meshes
        ]
        return dataclasses.replace(scene, meshes=meshes, lights=[PointLight((3, 8, 5), (0.7, 1, 0.9))])

    renderer = check_changes(lambda renderer: renderer.show(painted(pink)), builds=1)
    renderer.show(painted(dataclasses.replace(pink, emission=(0.5, 0, 0))))
    renderer.render(SIZE)
    assert (renderer.builds, renderer.layout.settled) == (2, 2 + 4 * len(STONE))  # what shines stands alone


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "change",
    [
        lambda renderer: renderer.move(0, np.diag([1.0, 1.2, 1.0, 1.0])),
        lambda renderer: renderer.deform(2, 1.5 * renderer.scene.meshes[2].vertices),
        lambda renderer: renderer.move(3, np.eye(4) + np.diag([40.0], 3)),
    ],
    ids=["a mesh at one place", "a deformed instance", "beyond the coordinates"],
)
def test_other_changes_lay_the_scene_out_anew_in_two_levels(change):
    renderer = check_changes(change, builds=2)
    assert renderer.layout.instanced is not None


@pytest.mark.slow
def test_instances_move_into_glass_and_out_of_it():
    glass = sphere(0.7, Material((0.9, 1, 0.95), transmission=0.9, ior=1.4), rings=6, segments=9)
    scene = scene_of(meshes=(STONE,))
    scene = dataclasses.replace(scene, meshes=[*scene.meshes, glass.moved((3, 3, 0))])

    def change(renderer):
        for k, (x, y) in enumerate([(3, 3), (3.6, 3)]):
            to = np.eye(4)
            to[:3, 3] = np.array((x, y, 0)) - scene.meshes[1 + k].transform[:3, 3]
            renderer.move(1 + k, to)

    renderer = check_changes(change, builds=2, scene=scene)  # rays now look for surfaces that touch
    moved = renderer.render(SIZE)
    renderer.move(1, np.eye(4))
    renderer.move(2, np.eye(4))
    away = renderer.render(SIZE)
    assert renderer.builds == 2
    assert np.any(away.pixels != moved.pixels)
    assert_same(away, Renderer(renderer.scene, integrator=WHITTED, backend="numpy").render(SIZE))


def test_a_path_traced_picture_goes_on_after_a_move():
    renderer = Renderer(scene_of(), integrator=PATH, backend="numpy")
    before = renderer.render(SIZE)
    renderer.move(4, np.diag([1.0, 1.0, -1.0, 1.0]))
    half, whole = (renderer.render(SIZE, samples=samples) for samples in (1, 2))
    np.testing.assert_array_equal(renderer.render(SIZE, samples=2, resume=half).pixels, whole.pixels)
    with pytest.raises(SceneError, match="they differ in: instances"):
        renderer.render(SIZE, samples=2, resume=before)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", ["f16", "f64"])
def test_other_precisions_give_every_instance_triangles_of_its_own(precision, monkeypatch):
    monkeypatch.setattr(instanced, "MANY", 40)
    monkeypatch.setattr(instanced, "BEGINNING", 10)
    scene = scene_of(meshes=(STONE,))
    plain, other = (Renderer(scene, precision=name, backend="numpy", bounces=0) for name in ("f32", precision))
    assert [renderer.layout.instanced is None for renderer in (plain, other)] == [False, True]
    ids = [renderer.render(SIZE).object_id for renderer in (plain, other)]
    assert np.count_nonzero(ids[0] != ids[1]) <= (12 if precision == "f16" else 1)


@pytest.mark.slow
def test_the_network_that_removes_noise_gets_the_colours_and_normals_of_instances(monkeypatch):
    guides = []
    network = types.SimpleNamespace(denoise=lambda color, *layers, **_: guides.append(layers) or color)
    monkeypatch.setitem(sys.modules, "pyoidn", network)
    for accel in ("bvh", "instances"):
        render(scene_of(), SIZE, integrator=Path(accel=accel, samples=1, bounces=2), backend="numpy", denoise=True)
    for own, shared in zip(*guides, strict=True):
        assert (np.abs(own - shared).max(axis=-1) < 1e-4).mean() > 0.99
        assert len(np.unique(shared.reshape(-1, 3).round(2), axis=0)) > 10


def test_an_animated_file_moves_its_instances(tmp_path):
    file = File()
    mesh = file.mesh(file.square(), name="tile")
    nodes = [file.node(mesh=mesh, translation=[1.5 * k, 0, 0]) for k in range(3)]
    animated(file, (nodes[1], "translation", [0, 1], [[1.5, 0, 0], [1.5, 2, 0]], "LINEAR"))
    path = tmp_path / "tiles.glb"
    path.write_bytes(file.glb())
    make = AnimatedFile(path).make(3, 2)
    renderer = Renderer(make(0), integrator=WHITTED, backend="numpy")
    pictures = []
    for time in (0, 0.5, 1):
        renderer.show(make(time))
        pictures.append(renderer.render(SIZE))
        assert_same(pictures[-1], render(make(time), SIZE, integrator=WHITTED, backend="numpy"))
    assert (renderer.builds, len(renderer.layout.instanced.meshes)) == (1, 4)
    assert np.any(pictures[0].object_id != pictures[2].object_id)


@pytest.mark.slow
def test_a_view_of_instances_shows_edits_and_moves(tmp_path):
    path = tmp_path / "row.py"
    path.write_text(ROW)
    options = ["--accel", "instances", "--backend", "numpy", "--size", "32x24", "--samples", "4"]
    session = opened(str(path), *options)
    session.set({"size": list(SIZE)})
    last(session)
    session.set({"params": {"material.icosahedron.color": [0.1, 0.9, 0.2]}})
    _, green = last(session)
    space = {}
    exec(ROW, space)
    scene = space["scene"](0)
    meshes = [mesh.with_material(Material((0.1, 0.9, 0.2))) for mesh in scene.meshes]
    seen = dataclasses.replace(scene, meshes=meshes)
    expected = render(seen, SIZE, accel="instances", backend="numpy", samples=4)
    assert green[..., :3].tolist() == np.asarray(expected.to_pil()).tolist()
    assert session._drawer.renderer.builds == 1
