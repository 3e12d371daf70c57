"""Parts of a scene: meshes, instances, and meshes and scenes of trimesh, with names, ids and materials."""

import dataclasses
import warnings

import numpy as np
import pytest
import trimesh
from PIL import Image as pillow

import shpy as sh
from raytracer import (
    Camera,
    DirectionalLight,
    Instance,
    Intersector,
    Material,
    Mesh,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    Texture,
    render,
)
from raytracer.meshes import mesh as meshing
from raytracer.meshes.shapes import box, floor, icosahedron, sphere
from raytracer.scene.layout import Layout

TRIANGLE = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name="sail")


def matrix(*scale, at=(0, 0, 0)):
    found = np.diag([*scale, 1.0])
    found[:3, 3] = at
    return found


def painted(color=(255, 0, 0)):
    made = trimesh.creation.box()
    uv = np.linspace(0, 1, 2 * len(made.vertices)).reshape(-1, 2)
    image = pillow.new("RGB", (2, 2), color)
    made.visual = trimesh.visual.TextureVisuals(uv=uv, image=image)
    return made


@pytest.mark.parametrize(
    "transform",
    [matrix(2, 1, 0.5), matrix(-1, 1, 1), matrix(-1, -2, -3, at=(5, 0, 0)), np.array(
        [[0, 1, 0.5, 1], [1, 0, 0, 2], [0, 0.2, 1, 3], [0, 0, 0, 1]])],
    ids=["scaled", "mirrored", "inverted", "sheared"],
)  # fmt: skip
def test_normals_stay_across_what_is_transformed(transform):
    ball = sphere(1, rings=16, segments=24)
    placed = Instance(ball, transform).placed
    np.testing.assert_allclose(
        np.sort(placed.corners.reshape(-1, 3), axis=0),
        np.sort(ball.corners.reshape(-1, 3) @ transform[:3, :3].T + transform[:3, 3], axis=0),
        atol=1e-9,
    )
    assert np.einsum("ij,ikj->ik", placed.face_normals, placed.normals).min() > 0.5  # both still point outside
    outward = placed.corners.mean(axis=1) - transform[:3, 3]
    assert np.einsum("ij,ij->i", placed.face_normals, outward).min() > 0
    across = np.einsum("ikj,ikj->ik", placed.normals, placed.corners - np.roll(placed.corners, 1, axis=1))
    flat = np.einsum("ikj,ikj->ik", ball.normals, ball.corners - np.roll(ball.corners, 1, axis=1))
    assert np.abs(across).max() < 4 * np.abs(flat).max()  # as tangential as they were


def test_a_mirrored_instance_looks_as_a_mirrored_mesh():
    corner = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], colors=np.eye(3), uv=[[0, 0], [1, 0], [0, 1]])
    placed = Instance(corner, matrix(-1, 1, 1)).placed
    by_place = {tuple(p): (tuple(c), tuple(u)) for p, c, u in zip(
        placed.corners[0].tolist(), placed.colors[0].tolist(), placed.uv[0].tolist(), strict=True)}  # fmt: skip
    assert by_place[(-1, 0, 0)] == ((0, 1, 0), (1, 0))
    assert by_place[(0, 1, 0)] == ((0, 0, 1), (0, 1))
    np.testing.assert_array_equal(placed.face_normals, [[0, 0, 1]])


def test_names_and_ids_of_instances():
    ball = icosahedron(0.5)
    parts = [floor(8), *(Instance(ball, matrix(1, 1, 1, at=(k, 0.5, 0)), f"ball {k}") for k in (-1, 1)), box()]
    scene = Scene(parts, (PointLight((0, 5, 5)),), Camera((0, 3, 6), (0, 0.5, 0)))
    assert [mesh.name for mesh in scene.meshes] == ["floor", "ball -1", "ball 1", "box"]
    seen = render(scene, (64, 48), backend="numpy", bounces=0)
    columns = [np.argwhere(seen.object_id == k)[:, 1].mean() for k in (1, 2)]
    assert columns[0] < 32 < columns[1]
    moved = Scene([floor(8), ball.moved((-1, 0.5, 0)), ball.moved((1, 0.5, 0)), box()], scene.lights, scene.camera)
    np.testing.assert_array_equal(render(moved, (64, 48), backend="numpy", bounces=0).pixels, seen.pixels)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Instance(TRIANGLE, np.eye(3)), r"matrix \(4, 4\)"),
        (lambda: Instance(TRIANGLE, np.full((4, 4), np.nan)), "finite"),
        (lambda: Instance(TRIANGLE, np.eye(4)[::-1]), "last row is 0 0 0 1"),
        (lambda: Instance(TRIANGLE, "none"), r"matrix \(4, 4\)"),
        (lambda: Instance("mesh", np.eye(4)), "one of a Mesh, not of a str"),
        (lambda: Instance(TRIANGLE, matrix(1e300, 1, 1)), "scale the mesh"),
    ],
)
def test_wrong_instances(make, words):
    with pytest.raises(SceneError, match=words):
        Scene(make())


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ("chair.obj", "not of str 'chair.obj'; Scene.load reads a file"),
        (7, "not of int '7'"),
        ([TRIANGLE, None], "not of NoneType"),
        ([[TRIANGLE]], "not of list"),
        (trimesh.PointCloud([[0, 0, 0]]), "a Mesh, Instance, trimesh.Trimesh or trimesh.Scene"),
    ],
)
def test_what_is_no_part_of_a_scene(wrong, words):
    with pytest.raises(SceneError, match=words):
        Scene(wrong)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Scene(TRIANGLE, PointLight((0, 0, 1))), "are a list of lights.*, not PointLight"),
        (lambda: Scene(TRIANGLE, [(0, 0, 1)]), r"each a PointLight, .*, not \[\(0, 0, 1\)\]"),
        (lambda: Scene(TRIANGLE, None), "are a list of lights.*, not None"),
        (lambda: Scene(TRIANGLE, camera=(0, 0, 5)), r"is a Camera, such as .*, not \(0, 0, 5\)"),
        (
            lambda: Renderer(Scene(TRIANGLE), backend="numpy").render(camera=(0, 0, 5)),
            r"is a Camera, .*, not \(0, 0, 5\)",
        ),
        (lambda: Scene.framed(TRIANGLE, camera=(0, 0, 5)), r"is a Camera, such as .*, not \(0, 0, 5\)"),
        (lambda: Scene.framed(TRIANGLE, camera=lambda camera: None), "is a Camera, such as .*, not None"),
        (lambda: Scene.framed(TRIANGLE, up="z"), "up is a direction of three finite numbers .*, not 'z'"),
        (lambda: Scene(TRIANGLE, ambient=(1, 1, 1)), r"ambient lies in \[0, 1\], not \(1, 1, 1\)"),
        (lambda: Mesh([[0, 0, 0]], [], material=(1, 0, 0)), r"is a Material, such as .*, not \(1, 0, 0\)"),
        (lambda: Scene(TRIANGLE).with_material("sail", "red"), "is a Material, such as .*, not 'red'"),
        (lambda: render(TRIANGLE, (4, 4)), r"show a Scene, such as Scene.framed\(mesh\), not <Mesh sail"),
        (lambda: render("boxes", (4, 4)), "show a Scene, .*, not 'boxes'"),
        (lambda: render(Scene(), (np.inf, 4)), r"\(width, height\) in whole pixels, not \(inf, 4\)"),
    ],
)
def test_things_of_another_kind_are_told(make, words):
    with pytest.raises(SceneError, match=words):
        make()


def test_bare_parts():
    for part in (
        TRIANGLE,
        Instance(TRIANGLE, np.eye(4)),
        trimesh.creation.box(),
        trimesh.Scene(trimesh.creation.box()),
    ):
        assert len(Scene(part).meshes) == 1
    assert Scene().meshes == ()
    assert Scene(iter([TRIANGLE])).meshes == (TRIANGLE,)


def test_a_mesh_of_trimesh():
    made = trimesh.creation.icosphere(2)
    made.metadata["name"] = "ball"
    mesh = Mesh.from_trimesh(made)
    assert (mesh.name, len(mesh), mesh.material) == ("ball", 320, Material())
    np.testing.assert_allclose(mesh.normals, mesh.corners, atol=0.05)
    assert Mesh.from_trimesh(made, name="earth", material=Material((0, 0, 1))).material.color == (0, 0, 1)
    np.testing.assert_allclose(np.abs(Mesh.from_trimesh(trimesh.creation.box()).normals).max(axis=2), 1)  # has edges


def test_colours_of_trimesh():
    made = trimesh.creation.box()
    made.visual.vertex_colors = np.tile([128, 0, 255, 255], (8, 1)).astype(np.uint8)
    np.testing.assert_allclose(Mesh.from_trimesh(made).colors[0, 0], [0.21586, 0, 1], atol=1e-4)
    made = trimesh.creation.box()
    made.visual.face_colors = np.tile([0, 128, 255, 255], (12, 1)).astype(np.uint8)
    np.testing.assert_allclose(Mesh.from_trimesh(made).colors[3, 1], [0, 0.21586, 1], atol=1e-4)


def test_materials_of_trimesh():
    mesh = Mesh.from_trimesh(painted())
    np.testing.assert_array_equal(mesh.material.color.image, np.broadcast_to([1, 0, 0], (2, 2, 3)))
    made = painted()
    made.visual.material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[255, 0, 51, 255],
        metallicFactor=0.0,
        roughnessFactor=0.5,
        normalTexture=pillow.new("RGB", (2, 2)),
    )
    with pytest.warns(sh.ShpyWarning, match=r"mesh: ignored: normal maps \(1\)") as caught:
        look = Mesh.from_trimesh(made).material
    assert caught[0].filename == __file__
    assert look.base_color == pytest.approx((1, 0, 0.2))
    assert look.roughness == 0.5
    made.visual.material = trimesh.visual.material.SimpleMaterial(diffuse=[0, 255, 0, 255], glossiness=20.0)
    assert Mesh.from_trimesh(made).material == Material((0, 1, 0), 1.0, 0.0, 20.0)


def test_a_scene_of_trimesh_keeps_names_places_and_pictures():
    group = trimesh.Scene()
    red = painted()
    group.add_geometry(red, node_name="left", transform=matrix(1, 1, 1, at=(-1, 0, 0)))
    group.add_geometry(red, node_name="right", transform=matrix(1, 2, 1, at=(1, 0, 0)))
    group.add_geometry(trimesh.PointCloud([[0, 0, 0]]))
    with pytest.warns(sh.ShpyWarning, match=r"ignored: points and lines \(1\)") as caught:
        scene = Scene([group, TRIANGLE, trimesh.creation.box()])
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert sorted(mesh.name for mesh in scene.meshes[:2]) == ["left", "right"]
    assert [mesh.name for mesh in scene.meshes[2:]] == ["sail", "mesh"]
    right = next(mesh for mesh in scene.meshes if mesh.name == "right")
    np.testing.assert_allclose(
        [right.vertices.min(axis=0), right.vertices.max(axis=0)], [[0.5, -1, -0.5], [1.5, 1, 0.5]]
    )
    assert scene.meshes[0].material == scene.meshes[1].material  # of one Texture
    assert isinstance(scene.meshes[0].material.color, Texture)


def test_a_part_of_trimesh_is_seen_in_its_colours():
    scene = Scene([painted((0, 255, 0))], (DirectionalLight((0, 0, -1)),), Camera((0, 0, 4)), ambient=0.0)
    seen = render(dataclasses.replace(scene, background=(0, 0, 0)), (16, 16), backend="numpy", bounces=0)
    np.testing.assert_allclose(seen.pixels[8, 8], [0, 0.9, 0], atol=0.11)


def test_materials_are_replaced_by_the_names_of_meshes():
    ball = icosahedron(0.5)
    parts = [Instance(ball, matrix(1, 1, 1, at=(k, 0, 0)), name) for k, name in enumerate(("a", "b\n", "a"))]
    scene = Scene(parts, (PointLight((0, 5, 5)),), name="three")
    assert scene.names == ["a", "b\n", "a"]
    assert repr(scene) == "<Scene three: a, b, a; 60 triangles, 1 light>"
    assert repr(scene.meshes[0]) == "<Mesh a: 20 triangles, uv>"
    red = scene.with_material("a", Material((1, 0, 0)))
    assert [mesh.material.color for mesh in red.meshes] == [(1, 0, 0), (0.8, 0.8, 0.8), (1, 0, 0)]
    assert (red.camera, red.lights) == (scene.camera, scene.lights)
    with pytest.raises(SceneError, match="three has no mesh 'c': its meshes are a, b, a"):
        scene.with_material("c", Material())
    many = Scene([TRIANGLE] * 30)
    assert repr(many).endswith("sail and 10 more; 30 triangles, 0 lights>")


def test_many_instances_are_announced_where_they_get_triangles_of_their_own(monkeypatch):
    leaf = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name="leaf")
    leaves = [Instance(leaf, np.eye(4), f"leaf {k}") for k in range(8)]
    monkeypatch.setattr(meshing, "MANY", 8)
    expected = "scene: each of 8 instances of 1 mesh gets triangles of its own, 8 where 1 are different"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = Scene(leaves)
        assert scene.triangles == 8
        Layout.of(scene, "instances")
        Layout.of(Scene(leaves[:7]))
        Layout.of(Scene([Instance(Mesh(leaf.vertices, leaf.faces), np.eye(4)) for _ in range(8)]))
    for expand in (Layout.of, Intersector):
        with pytest.warns(sh.ShpyWarning, match=expected):
            expand(scene)
