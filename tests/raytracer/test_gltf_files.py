"""glTF and GLB files: shapes, places, names, materials, pictures, cameras and lights, and what is said of the rest."""

import dataclasses
import warnings

import numpy as np
import pytest
from gltf_files import CORNERS, MATT, SQUARE, File, png, textured

import shpy as sh
from raytracer import (
    Camera,
    DirectionalLight,
    Mesh,
    MetallicRoughness,
    Scene,
    SceneError,
    SpotLight,
    Texture,
    render,
)
from raytracer.appearance.textures import decoded
from raytracer.meshes import pictures
from raytracer.meshes.appearance import CLAY, GltfMaterial, material_of

AHEAD = Camera((0, 0, 4), (0, 0, 0), fov=45)


def loaded(path, *ignored):
    """The scene of a file, which warns of just this."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = Scene.load(path)
    assert [str(w.message) for w in caught] == [f"{path.name}: {text}" for text in ignored]
    assert {w.filename for w in caught} <= {__file__}
    return scene


def colors_of(scene, backend="numpy", size=(16, 16)):
    """The picture in ambient light alone: the colours of the surfaces."""
    still = dataclasses.replace(scene, lights=(), ambient=1.0, background=(0, 0, 0), camera=AHEAD)
    return render(still, size, backend=backend, bounces=0)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_a_picture_on_a_square(tmp_path, suffix):
    """Picture times factor times vertex colours, each texel where it belongs."""
    file = File()
    base = file.picture([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [188, 188, 188]]], magFilter=9728)
    look = {"baseColorTexture": {"index": base}, "baseColorFactor": [0.5, 1, 1, 1], "metallicFactor": 0}
    colors = {"COLOR_0": file.array([[1, 1, 0.5]] * 4)}
    square = file.square(attributes=colors, material=file.material(pbrMetallicRoughness=look, extensions=MATT))
    file.node(mesh=file.mesh(square, name="tile"))
    scene = loaded(file.save(tmp_path / f"tile.{suffix}"))
    assert [mesh.name for mesh in scene.meshes] == ["tile", "floor"]
    seen = colors_of(scene).pixels
    grey = 0.5029 * np.array([0.5, 1, 0.5])
    expected = {(4, 4): (0.5, 0, 0), (4, 11): (0, 1, 0), (11, 4): (0, 0, 0.5), (11, 11): grey}
    for place, color in expected.items():
        np.testing.assert_allclose(seen[place], color, atol=1e-3)


def test_backends_agree_about_a_file(tmp_path):
    path = textured().save(tmp_path / "tiles.glb")
    scene = loaded(path)
    first = render(scene, (40, 24), backend="numpy")
    assert set(np.unique(first.object_id)) == {-1, 0, 2} | set(np.unique(first.object_id)) & {1, 3}
    for backend in ("opencl", "glsl"):
        other = render(scene, (40, 24), backend=backend)
        for layer in ("pixels", "depth", "object_id"):
            assert np.array_equal(getattr(first, layer), getattr(other, layer))


def test_nodes_stand_in_each_other(tmp_path):
    scene = loaded(textured().save(tmp_path / "tiles.glb"))
    assert [mesh.name for mesh in scene.meshes] == ["parent", "parent_1", "child", "child_1"]
    x, y = 1 - 2 * 0.36, 2 * 0.6 * 0.8  # a turn about z by twice the angle of the quaternion
    turn = np.array([[x, -y, 0], [y, x, 0], [0, 0, 1]])
    np.testing.assert_allclose(scene.meshes[0].vertices, SQUARE @ turn.T, atol=1e-7)
    np.testing.assert_allclose(scene.meshes[2].vertices, (SQUARE * (-1, 1, 1) + (2, 0, 0)) @ turn.T, atol=1e-7)
    for mesh in scene.meshes:  # the outside is where it was, also of the one that is mirrored
        np.testing.assert_allclose(mesh.face_normals, [[0, 0, 1]] * 2, atol=1e-12)
    np.testing.assert_allclose(scene.meshes[0].uv[0], CORNERS[[0, 1, 2]] * (1, -1) + (0, 1))
    np.testing.assert_allclose(scene.meshes[2].uv[0], CORNERS[[2, 1, 0]] * (1, -1) + (0, 1))
    assert len({id(mesh.material) for mesh in scene.meshes}) == 2


def test_the_camera_and_lights_of_a_file_take_the_place_of_the_floor(tmp_path):
    scene = loaded(textured().save(tmp_path / "tiles.glb"))
    assert scene.camera.position == (0, 0, 6)
    assert scene.camera.fov == pytest.approx(np.degrees(0.8))
    view = scene.camera.view(30, 20)
    np.testing.assert_allclose(view.across / np.linalg.norm(view.across), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose((view.corner + 15 * view.across + 10 * view.down), [0, 0, -1], atol=1e-12)
    point, sun = scene.lights
    assert point.position == (0, 3, 4)
    np.testing.assert_allclose(sun.direction, [0, 0, -1])
    low, high = scene.bounds
    there = 30 / np.sum((np.array([0, 3, 4]) - (low + high) / 2) ** 2)
    assert point.falloff == "square"
    np.testing.assert_allclose(point.color, np.ones(3) * 30 / (1 + there))
    np.testing.assert_allclose(sun.color, np.array([1, 0.5, 0.5]) / (1 + there))


@pytest.mark.parametrize("aspect", [0.5, 1.0, 16 / 9])
@pytest.mark.parametrize("size", [(16, 16), (24, 16), (16, 24)])
def test_the_frame_of_a_files_camera_is_whole_in_any_picture(tmp_path, aspect, size):
    file = File()
    file.node(mesh=file.mesh(file.square()))
    lens = {"yfov": 1.0, "aspectRatio": aspect, "znear": 0.1}
    file.node(camera=file.add("cameras", {"type": "perspective", "perspective": lens}), translation=[0, 0, 9])
    view = loaded(file.save(tmp_path / "frame.glb")).camera.view(*size)
    shown = np.array([size[0] * np.linalg.norm(view.across), size[1] * np.linalg.norm(view.down)])
    frame = 2 * np.tan(0.5) * np.array([aspect, 1])
    np.testing.assert_allclose((shown / frame).min(), 1)


def test_upright_and_turned_cameras(tmp_path):
    """The shorter side of the file's picture has the angle; the node's axes say where it looks."""
    file = File()
    file.node(mesh=file.mesh(file.square()))
    lens = {"yfov": 1.2, "aspectRatio": 0.5, "znear": 0.1}
    turned = [0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 7, 0, 0, 1]  # its z is the scene's x
    file.node(camera=file.add("cameras", {"type": "perspective", "perspective": lens}), matrix=turned)
    scene = loaded(file.save(tmp_path / "side.glb"))
    assert scene.camera.fov == pytest.approx(np.degrees(2 * np.arctan(0.5 * np.tan(0.6))))
    ahead = np.subtract(scene.camera.target, scene.camera.position)
    np.testing.assert_allclose(ahead / np.linalg.norm(ahead), [-1, 0, 0], atol=1e-12)
    assert len(scene.meshes) == 1
    assert len(scene.lights) == 2  # two are added, as it has none


@pytest.mark.parametrize("scale", [(0, 0, 0), (1, 0, 1), (1, 1, 0), (1e-200, 1e-200, 1e-200)])
def test_cameras_and_lights_of_nodes_that_are_scaled_away(tmp_path, scale):
    """A file hides a node by the scale 0, which leaves it no direction."""
    file = File()
    file.node(mesh=file.mesh(file.square()))
    lens = file.add("cameras", {"type": "perspective", "perspective": {"yfov": 1.2, "znear": 0.1}})
    file.light(type="directional", place={"scale": scale, "translation": (0, 0, 5)})
    file.node(camera=lens, scale=scale, translation=(0, 0, 7))
    path = file.save(tmp_path / "hidden.glb")
    if min(scale) > 0:
        scene = loaded(path)
        np.testing.assert_allclose(scene.camera.axes, [[1, 0, 0], [0, 1, 0], [0, 0, -1]], atol=1e-12)
        return
    with pytest.warns(sh.ShpyWarning, match=r"cameras that a scale of 0 leaves without a direction \(1\)"):
        scene = Scene.load(path)
    assert len(scene.meshes) == 1 + (scale[2] == 0)  # a file without camera and lights stands on a floor


def test_what_is_ignored_is_said_in_one_line(tmp_path):
    file = File()
    image = file.picture(np.zeros((2, 2, 3)))
    plain = {"normalTexture": {"index": image}, "occlusionTexture": {"index": image}}
    clear = {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": {"thicknessFactor": 1}}
    plain |= {"alphaMode": "BLEND", "extensions": clear}
    look = {"baseColorTexture": {"index": image, "texCoord": 1}, "baseColorFactor": [1, 0.5, 1, 0.5]}
    material = file.material(**plain, pbrMetallicRoughness=look)
    square = file.square(material=material, targets=[{"COLOR_0": 0}, {}])
    lines = {"attributes": {"POSITION": file.array(SQUARE)}, "mode": 1}
    file.node(mesh=file.mesh(square, lines))
    file.node(camera=file.add("cameras", {"type": "orthographic", "orthographic": {"xmag": 2, "ymag": 1}}))
    file.light(type="spot")
    file.light(type="area")
    file.add("animations", {})
    file.add("scenes", {"nodes": []})
    file.tree["extensionsUsed"] = ["KHR_lights_punctual", "KHR_materials_ior", "KHR_materials_x"]
    expected = (
        "animations (1), scenes but the default one (1), KHR_materials_x (1), morph targets of colours or uv (1), "
        "second uv coordinates or transforms in materials (1), pictures of meshes without uv coordinates (1), "
        "occlusion maps (1), alpha of clear bodies (1), "
        "points and lines (1), lights of the type area (1)"
    )
    scene = loaded(file.save(tmp_path / "much.glb"), f"ignored: {expected}")
    assert scene.lights == (SpotLight((0, 0, 0), (0, 0, -1)),)
    assert scene.camera.projection == "orthographic"
    assert scene.meshes[0].material.textures == {}


@pytest.mark.parametrize(
    ("uri", "reason"),
    [
        ("gone.png", "there is no such file"),
        ("../outside.png", "it lies outside of the file's folder: put it there"),
        ("/etc/hostname", "it lies outside of the file's folder: put it there"),
        ("%2e%2e/outside.png", "it lies outside of the file's folder: put it there"),
        ("C:\\outside.png", "it lies outside of the file's folder: put it there"),
        ("http://localhost/a.png", "it lies outside of the file's folder: put it there"),
        ("link.png", "it lies outside of the file's folder: put it there"),
        ("folder", "there is no such file"),
        ("pipe", "there is no such file"),
        ("text.png", "not a readable picture: none of PNG, JPEG, WEBP, BMP, TGA, GIF, TIFF, PPM"),
        ("cut.png", "image file is truncated"),
    ],
)
def test_a_picture_that_cannot_be_read_is_named_and_the_factor_shows(tmp_path, uri, reason):
    import os

    inner = tmp_path / "inner"
    (inner / "folder").mkdir(parents=True)
    (tmp_path / "outside.png").write_bytes(png(np.zeros((2, 2, 3))))
    (inner / "link.png").symlink_to(tmp_path / "outside.png")
    (inner / "text.png").write_text("no picture")
    (inner / "cut.png").write_bytes(png(np.random.default_rng(1).integers(0, 255, (64, 64, 3)))[:2000])
    os.mkfifo(inner / "pipe")
    file = File()
    texture = file.add("textures", {"source": file.add("images", {"uri": uri})})
    look = {"baseColorTexture": {"index": texture}, "baseColorFactor": [0.5, 0.25, 0, 1]}
    file.node(mesh=file.mesh(file.square(material=file.material(pbrMetallicRoughness=look))))
    with pytest.warns(sh.ShpyWarning, match="materials show their plain colours") as caught:
        scene = Scene.load(file.save(inner / "square.gltf"))
    assert len(caught) == 1
    assert f"{uri} ({reason}" in str(caught[0].message)
    np.testing.assert_allclose(scene.meshes[0].material.base_color, (0.5, 0.25, 0))


def test_a_picture_beside_the_file_and_one_by_its_last_name(tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "red paint.png").write_bytes(png([[[255, 0, 0]]]))
    (tmp_path / "moved.png").write_bytes(png([[[0, 255, 0]]]))
    for uri, color in (("maps/red%20paint.png", (1, 0, 0)), ("C:\\Users\\me\\moved.png", (0, 1, 0))):
        file = File()
        texture = file.add("textures", {"source": file.add("images", {"uri": uri})})
        look = {"baseColorTexture": {"index": texture}}
        file.node(mesh=file.mesh(file.square(material=file.material(pbrMetallicRoughness=look))))
        scene = loaded(file.save(tmp_path / "square.gltf"))
        np.testing.assert_array_equal(scene.meshes[0].material.base_color.image, [[color]])


def test_one_picture_is_one_texture(tmp_path):
    file = File()
    base = file.picture(np.full((2, 2, 3), 200), wrapS=33648, wrapT=33648)
    looks = [{"baseColorTexture": {"index": base}, "roughnessFactor": r} for r in (0.2, 0.9)]
    for look in looks:
        file.node(mesh=file.mesh(file.square(material=file.material(pbrMetallicRoughness=look))))
    first, second = (mesh.material for mesh in loaded(file.save(tmp_path / "two.glb")).meshes[:2])
    assert first is not second
    assert first.base_color is second.base_color
    assert first.base_color.wrap == "mirror"
    assert first.base_color.filter == "linear"


def test_metals_and_roughness():
    plain = material_of(GltfMaterial((0.2, 0.4, 0.6), 0.0, 0.5))
    assert plain == MetallicRoughness((0.2, 0.4, 0.6), 0, 0.5)
    wild = material_of(GltfMaterial((1.5, 0.4, -1), 2.0, -0.5))  # which the specification excludes
    assert wild == MetallicRoughness((1, 0.4, 0), 1, 0)


def test_pictures_of_metal_and_roughness(tmp_path):
    """Green is roughness and blue metallic, linear, each times its factor."""
    file = File()
    maps = file.picture([[[9, 255, 0], [9, 128, 255]]], magFilter=9728)
    look = {"metallicRoughnessTexture": {"index": maps}, "roughnessFactor": 0.5, "baseColorFactor": [0.8, 0.6, 0.9, 1]}
    file.node(mesh=file.mesh(file.square(material=file.material(pbrMetallicRoughness=look))))
    found = loaded(file.save(tmp_path / "metal.glb")).meshes[0].material
    assert isinstance(found.roughness, Texture)
    np.testing.assert_allclose(found.roughness.image[0, :, 0], [0.5, 0.5 * 128 / 255], rtol=1e-5)
    np.testing.assert_allclose(found.metallic.image[0, :, 0], [0, 1], rtol=1e-5)


def test_the_look_of_a_file_without_materials_has_not_changed(tmp_path):
    file = File()
    file.node(mesh=file.mesh(file.square(uv=False)))
    scene = loaded(file.save(tmp_path / "bare.glb"))
    assert scene.meshes[0].material == CLAY
    assert len(scene.meshes) == len(scene.lights) == 2
    np.testing.assert_allclose(scene.lights[0].color, (0.85, 0.82, 0.76))


def test_colours_of_vertices_are_linear(tmp_path):
    for kind, values in (("f4", 0.25), ("u1", 64), ("u2", 16384)):
        file = File()
        colors = {"COLOR_0": file.array(np.full((4, 4), values), kind, normalized=kind != "f4")}
        file.node(mesh=file.mesh(file.square(attributes=colors)))
        scene = loaded(file.save(tmp_path / "colour.glb"))
        np.testing.assert_allclose(scene.meshes[0].colors, 0.25, atol=2e-3)
        assert scene.meshes[0].material.color == (0.8, 0.8, 0.8)


def test_accessors_in_every_shape(tmp_path):
    """Interleaved, normalized integers, sparse, strips and fans: what trimesh passes over."""
    file = File()
    rows = np.zeros(4, [("place", "<f4", 3), ("uv", "<u2", 2)])
    rows["place"], rows["uv"] = SQUARE, CORNERS * 65535
    view = file.view(rows.tobytes(), byteStride=16)
    places = {"bufferView": view, "componentType": 5126, "count": 4, "type": "VEC3"}
    uv = {"bufferView": view, "byteOffset": 12, "componentType": 5123, "count": 4, "type": "VEC2", "normalized": True}
    where, what = file.view(np.array([2], "u1").tobytes()), file.view(np.array([[5, 6, 7]], "<f4").tobytes())
    changed = {"count": 1, "indices": {"bufferView": where, "componentType": 5121}, "values": {"bufferView": what}}
    attributes = {"POSITION": file.add("accessors", places | {"sparse": changed})}
    attributes["TEXCOORD_0"] = file.add("accessors", uv)
    strip = {"attributes": attributes, "mode": 5, "indices": file.array([0, 1, 3, 2], "u1")}
    file.node(mesh=file.mesh(strip, {"attributes": attributes, "mode": 6}))
    strip, fan, _ = loaded(file.save(tmp_path / "shapes.glb")).meshes
    moved = SQUARE.astype(float)
    moved[2] = 5, 6, 7
    np.testing.assert_allclose(strip.corners, moved[[[0, 1, 3], [1, 2, 3]]])
    np.testing.assert_allclose(fan.corners, moved[[[1, 2, 0], [2, 3, 0]]])
    np.testing.assert_allclose(strip.uv[0], CORNERS[[0, 1, 3]] * (1, -1) + (0, 1), atol=1e-5)


def test_trimesh_reads_what_we_read(tmp_path):
    import trimesh

    path = textured().save(tmp_path / "tiles.glb")
    ours, theirs = loaded(path), trimesh.load(path)
    for mesh, node in zip(ours.meshes[:2], ["parent", "child"], strict=True):
        assert mesh.name.startswith("parent")
        assert node in theirs.graph.nodes
    both = theirs.to_geometry()
    known = sorted(map(tuple, np.round(both.triangles.reshape(-1, 9), 5).tolist()))
    mine = np.concatenate([mesh.corners for mesh in ours.meshes]).reshape(-1, 9)
    places = {tuple(sorted(map(tuple, np.reshape(row, (3, 3)).tolist()))) for row in known}
    assert {tuple(sorted(map(tuple, np.round(row, 5).reshape(3, 3).tolist()))) for row in mine} == places


def test_deep_files(tmp_path):
    """Nodes within nodes are followed however deep; lists within lists are refused."""
    file = File()
    mesh = file.mesh(file.square())
    inner = [{"children": [k + 1], "translation": [0, 0, 1]} for k in range(3000)]
    file.tree["nodes"], file.tree["scenes"][0]["nodes"] = [*inner, {"mesh": mesh}], [0]
    scene = loaded(file.save(tmp_path / "deep.glb"))
    np.testing.assert_allclose(scene.meshes[0].vertices[:, 2], 3000)
    (tmp_path / "lists.gltf").write_text('{"asset":' + "[" * 10**5)
    with pytest.raises(SceneError, match="not a readable GLTF file"):
        Scene.load(tmp_path / "lists.gltf")


def test_too_many_instances_are_refused_before_they_are_made(tmp_path, monkeypatch):
    monkeypatch.setattr("raytracer.memory.free_bytes", lambda: 10**8)
    file = File()
    mesh = file.mesh({"attributes": {"POSITION": file.array(np.zeros((3000, 3)))}})
    attributes = {"TRANSLATION": file.array(np.zeros((60_000, 3)))}
    file.node(mesh=mesh, extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
    with pytest.raises(SceneError, match=r"triangles take .* bytes of memory or more"):
        Scene.load(file.save(tmp_path / "many.glb"))


def test_large_pictures_are_made_smaller(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "MOST", 1000)
    file = File()
    for value in (255, 128):
        image = file.picture(np.full((32, 32, 3), value))
        look = {"baseColorTexture": {"index": image}}
        file.node(mesh=file.mesh(file.square(material=file.material(pbrMetallicRoughness=look))))
    said = "ignored: detail of pictures beyond 1,000 pixels (2)"
    scene = loaded(file.save(tmp_path / "large.glb"), said)
    sizes = [mesh.material.base_color.image.shape[:2] for mesh in scene.meshes[:2]]
    assert sizes == [(16, 16), (16, 16)]
    np.testing.assert_allclose(scene.meshes[1].material.base_color.image, decoded(np.array(128 / 255)), rtol=1e-5)


def test_a_mesh_is_joined_and_says_that_it_has_no_materials(tmp_path):
    path = textured().save(tmp_path / "tiles.glb")
    with pytest.warns(sh.ShpyWarning, match=r"tiles.glb: ignored: materials, which Scene.load reads \(2\)"):
        mesh = Mesh.load(path)
    assert (len(mesh), mesh.name) == (8, "tiles")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert Mesh.load(path, material=CLAY).material is CLAY


def test_a_light_of_a_file_lights_as_our_own(tmp_path):
    file = File()
    look = {"metallicFactor": 0}
    file.node(mesh=file.mesh(file.square(material=file.material(pbrMetallicRoughness=look, extensions=MATT))))
    file.light(type="directional", intensity=5000)
    scene = loaded(file.save(tmp_path / "sun.glb"))
    assert isinstance(scene.lights[0], DirectionalLight)
    seen = render(dataclasses.replace(scene, ambient=0.0, camera=AHEAD), (8, 8), backend="numpy").pixels
    np.testing.assert_allclose(seen[4, 4], 1, atol=1e-6)


@pytest.mark.parametrize(
    ("extensions", "words"),
    [
        (
            {"KHR_draco_mesh_compression": {"bufferView": 0}},
            "positions are in KHR_draco_mesh_compression, which is not",
        ),
        ({}, "primitive 0 of mesh 0: its positions have no bytes"),
    ],
)
def test_positions_without_bytes_are_refused(tmp_path, extensions, words):
    """An encoder that names Draco in extensionsUsed alone leaves accessors that hold nothing."""
    file = File()
    square = file.square(uv=False)
    del file.tree["accessors"][square["attributes"]["POSITION"]]["bufferView"]
    file.tree["extensionsUsed"] = list(extensions)
    file.node(mesh=file.mesh(square | {"extensions": extensions}))
    with pytest.raises(SceneError, match=words):
        Scene.load(file.save(tmp_path / "draco.glb"))


def test_a_fallback_beside_draco_is_read(tmp_path):
    file = File()
    file.tree["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    file.node(mesh=file.mesh(file.square() | {"extensions": {"KHR_draco_mesh_compression": {"bufferView": 0}}}))
    scene = loaded(file.save(tmp_path / "both.glb"), "ignored: KHR_draco_mesh_compression (1)")
    assert np.ptp(scene.meshes[0].corners, axis=(0, 1)).tolist() == [2, 2, 0]


def test_meshes_without_area_are_said(tmp_path):
    file = File()
    flat = file.mesh(file.square())
    file.node(mesh=flat)
    file.node(mesh=flat, scale=[0, 1, 1])
    point = {"attributes": {"POSITION": file.array(np.ones((3, 3)))}}
    file.node(mesh=file.mesh(point))
    said = "ignored: meshes without area, which cannot be seen (2)"
    scene = loaded(file.save(tmp_path / "thin.glb"), said)
    assert [mesh.has_area for mesh in scene.meshes[:3]] == [True, False, False]
    (tmp_path / "thin.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    with pytest.warns(sh.ShpyWarning, match=r"thin.obj: ignored: meshes without area, which cannot be seen \(1\)"):
        assert not Mesh.load(tmp_path / "thin.obj").has_area


def test_an_area_is_found_behind_many_triangles_without_one():
    faces = np.zeros((9000, 3), int)
    corners = [[0, 0, 0], [1e-30, 0, 0], [0, 1e-30, 0]]
    assert not Mesh(corners, faces).has_area
    faces[-1] = 0, 1, 2
    assert Mesh(corners, faces).has_area


def test_primitives_that_share_vertices_take_their_own(tmp_path):
    """A copy of all vertices for each primitive took memory by the product of both."""
    file = File()
    count = 50
    corners = np.random.default_rng(1).random((3 * count, 3)).astype(np.float32)
    shared = {"POSITION": file.array(corners), "NORMAL": file.array(corners), "COLOR_0": file.array(corners)}
    shared["TEXCOORD_0"] = file.array(corners[:, :2])
    for k in range(count):
        order = file.array(3 * k + np.array([2, 0, 1]), "u2")
        file.node(mesh=file.mesh({"attributes": shared, "indices": order}))
    scene = loaded(file.save(tmp_path / "shared.glb"))
    meshes = scene.meshes[:count]
    assert [len(mesh.vertices) for mesh in meshes] == [3] * count
    for k, mesh in enumerate(meshes):
        own = corners[[3 * k + 2, 3 * k, 3 * k + 1]].astype(np.float64)
        np.testing.assert_array_equal(mesh.corners[0], own)
        np.testing.assert_array_equal(mesh.colors[0], own)
        np.testing.assert_allclose(mesh.normals[0], own / np.linalg.norm(own, axis=1)[:, None])
        np.testing.assert_array_equal(mesh.uv[0], own[:, :2] * (1, -1) + (0, 1))
    file.node(mesh=file.mesh({"attributes": shared, "indices": file.array([0, 1, 150], "u2")}))
    with pytest.raises(SceneError, match="primitive 0 of mesh 50: a triangle names vertex 150, and there are 150"):
        Scene.load(file.save(tmp_path / "shared.glb"), strict=True)
