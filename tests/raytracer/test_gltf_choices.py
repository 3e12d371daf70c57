"""Cameras of glTF files by name, their spots and ranges, and variants of materials: from Python and the command."""

import math

import numpy as np
import pytest
from gltf_files import File

from raytracer import PointLight, Scene, SceneError, SpotLight, render
from raytracer.cli import main
from raytracer.scene.animated_file import AnimatedFile

UP = {"translation": [0, 0, 6]}
RIGHT = [0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 7, 0, 0, 1]  # its z is the scene's x


def file_of_cameras():
    file = File()
    file.node(mesh=file.mesh(file.square()), name="square")
    lens = file.add("cameras", {"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}, "name": "lens"})
    frame = {"xmag": 3.0, "ymag": 1.5, "zfar": 9, "znear": 0.1}
    flat = file.add("cameras", {"type": "orthographic", "orthographic": frame})
    file.node(camera=lens, name="front", **UP)
    file.node(camera=flat, matrix=RIGHT)
    file.node(camera=lens, **UP)
    return file


def test_a_camera_is_chosen_by_its_name_or_its_number(tmp_path):
    path = file_of_cameras().save(tmp_path / "seen.glb")
    first = Scene.load(path).camera
    assert Scene.load(path, camera="front").camera == Scene.load(path, camera=0).camera == first
    assert Scene.load(path, camera="lens").camera == first  # the third one has the name of its lens
    side = Scene.load(path, camera="camera 1").camera
    assert side == Scene.load(path, camera=1).camera
    assert (side.projection, side.span, side.aspect) == ("orthographic", 3.0, 2.0)
    np.testing.assert_allclose(side.axes[2], (-1, 0, 0), atol=1e-12)
    listed = "its cameras are 0 'front', 1 'camera 1', 2 'lens'"
    for wrong in ("back", 3, -1):
        with pytest.raises(SceneError, match=rf"seen.glb has no camera {wrong!r}: {listed}"):
            Scene.load(path, camera=wrong)
    plain = File()
    plain.node(mesh=plain.mesh(plain.square()))
    with pytest.raises(SceneError, match=r"plain.glb has no camera 0: it has none"):
        Scene.load(plain.save(tmp_path / "plain.glb"), camera=0)


def test_an_orthographic_camera_shows_its_frame(tmp_path):
    """xmag and ymag are half the width and the height that are seen."""
    file = File()
    file.node(mesh=file.mesh(file.square()))  # from 0 to 1
    flat = {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "zfar": 9, "znear": 0}}
    file.node(camera=file.add("cameras", flat), **UP)
    seen = render(Scene.load(file.save(tmp_path / "flat.glb")), (8, 8), backend="numpy").object_id == 0
    corners = np.argwhere(seen)
    width = (corners.max(axis=0) - corners.min(axis=0) + 1) / 8 * 2
    vertices = Scene.load(tmp_path / "flat.glb").meshes[0].vertices
    np.testing.assert_allclose(width, np.ptp(vertices[:, :2], axis=0))


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"type": "orthographic"}, "it has no xmag"),
        ({"type": "orthographic", "orthographic": {"xmag": 0, "ymag": 1}}, "its xmag is 0 and its ymag 1"),
        ({"type": "perspective", "perspective": {"yfov": 4}}, "its yfov is 4 and its aspectRatio 1"),
    ],
)
def test_cameras_that_cannot_be_read_are_left_out(tmp_path, entry, words):
    file = File()
    file.node(mesh=file.mesh(file.square()))
    file.node(camera=file.add("cameras", entry))
    path = file.save(tmp_path / "bad.glb")
    with pytest.warns(Warning, match=f"left out: 1 camera cannot be read .*{words}"):
        Scene.load(path)
    with pytest.raises(SceneError, match=words):
        Scene.load(path, strict=True)


def test_cones_and_ranges_of_lights(tmp_path):
    file = File()
    file.node(mesh=file.mesh(file.square()))
    cone = {"innerConeAngle": 0.3, "outerConeAngle": math.pi / 2}
    file.light(type="spot", spot=cone, color=[1, 0.5, 0], range=9, place={"translation": [0, 0, 2]})
    file.light(type="point", range=3, place={"translation": [0, 0, 2]})
    spot, point = Scene.load(file.save(tmp_path / "lit.glb"), strict=True).lights
    assert isinstance(spot, SpotLight)
    assert (spot.position, spot.direction, spot.outer, spot.range) == ((0, 0, 2), (0, 0, -1), 90, 9)
    assert spot.inner == pytest.approx(math.degrees(0.3))
    assert isinstance(point, PointLight)
    assert point.range == 3
    np.testing.assert_allclose(spot.color, np.multiply(point.color, (1, 0.5, 0)))
    wrong = File()
    wrong.node(mesh=wrong.mesh(wrong.square()))
    wrong.light(type="spot", spot={"innerConeAngle": 1, "outerConeAngle": 0.5})
    with pytest.warns(Warning, match="left out: 1 light cannot be read .* 0 <= inner < outer <= 90"):
        Scene.load(wrong.save(tmp_path / "wrong.glb"))


@pytest.mark.parametrize("angle", [0.4, np.float32(np.pi / 2)])
def test_a_cone_of_two_equal_angles_has_a_sharp_edge(tmp_path, angle):
    file = File()
    file.node(mesh=file.mesh(file.square()))
    cone = {"innerConeAngle": float(angle), "outerConeAngle": float(angle)}
    file.light(type="spot", spot=cone, place={"translation": [0, 0, 2]})
    (spot,) = Scene.load(file.save(tmp_path / "sharp.glb"), strict=True).lights
    assert 0.99 * spot.outer < spot.inner < spot.outer == pytest.approx(min(math.degrees(angle), 90))


def file_of_variants():
    file = File()
    red, green, blue = (
        file.material(pbrMetallicRoughness={"baseColorFactor": [*color, 1]}) for color in np.eye(3).tolist()
    )
    mappings = [{"material": green, "variants": [0, 2]}, {"material": blue, "variants": [1]}]
    painted = file.square(material=red, extensions={"KHR_materials_variants": {"mappings": mappings}})
    file.node(mesh=file.mesh(painted, file.square(material=red)))
    names = [{"name": name} for name in ("beach", "midnight", "street")]
    file.tree.setdefault("extensions", {})["KHR_materials_variants"] = {"variants": names}
    file.tree["extensionsUsed"] = ["KHR_materials_variants"]
    return file


@pytest.mark.parametrize(("variant", "color"), [(None, 0), ("beach", 1), ("midnight", 2), ("street", 1)])
def test_a_variant_is_chosen_by_its_name(tmp_path, variant, color):
    scene = Scene.load(file_of_variants().save(tmp_path / "shoe.glb"), strict=True, variant=variant)
    assert scene.meshes[0].material.base_color == tuple(np.eye(3)[color])
    assert scene.meshes[1].material.base_color == (1, 0, 0)


def test_other_variants_are_refused(tmp_path):
    path = file_of_variants().save(tmp_path / "shoe.glb")
    with pytest.raises(SceneError, match="the file has no variant 'noon': its variants are beach, midnight, street"):
        Scene.load(path, variant="noon")
    with pytest.raises(SceneError, match="the file has no variant 'noon': it has none"):
        Scene.load(file_of_cameras().save(tmp_path / "seen.glb"), variant="noon")
    with pytest.raises(SceneError, match="variants are those of GLB and glTF files: leave variant='noon' out"):
        Scene.load(tmp_path / "a.obj", variant="noon")


def test_rough_metals_of_files_lose_no_light_where_that_is_chosen(tmp_path):
    path = file_of_variants().save(tmp_path / "shoe.glb")
    for chosen in (False, True):
        scene = Scene.load(path, variant="beach", multiscatter=chosen)
        assert [mesh.material.multiscatter for mesh in scene.meshes[:2]] == [chosen] * 2
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl gold\nf 1 2 3\n")
    (tmp_path / "a.mtl").write_text("newmtl gold\nKd 1 .8 .3\nPm 1\nPr .9\n")
    assert Scene.load(tmp_path / "a.obj", multiscatter=True).meshes[0].material.multiscatter
    (tmp_path / "a.mtl").write_text("newmtl gold\nKd 1 .8 .3\n")
    with pytest.raises(
        SceneError, match=r"a.obj: multiscatter is for metallic-roughness materials, of which this file"
    ):
        Scene.load(tmp_path / "a.obj", multiscatter=True)


def test_an_animation_with_a_camera_and_a_variant(tmp_path):
    file = file_of_variants()
    flat = {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "zfar": 9, "znear": 0}}
    lens = file.add("cameras", {"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}})
    file.node(camera=lens, **UP)
    there = file.node(camera=file.add("cameras", flat), name="flat", **UP)
    times, places = file.array([0.0, 1.0]), file.array([[0, 0, 6], [0, 1, 6]])
    sampler = {"input": times, "output": places}
    channel = {"sampler": 0, "target": {"node": there, "path": "translation"}}
    file.add("animations", {"samplers": [sampler], "channels": [channel]})
    make = AnimatedFile(file.save(tmp_path / "a.glb"), variant="midnight", multiscatter=True).make(2, 1, which="flat")
    cameras = [make(time).camera for time in (0.0, 1.0)]
    assert [camera.projection for camera in cameras] == ["orthographic"] * 2
    assert [camera.position for camera in cameras] == [(0, 0, 6), (0, 1, 6)]
    look = make(1.0).meshes[0].material
    assert (look.base_color, look.multiscatter) == ((0, 0, 1), True)


def test_the_command_lists_and_takes_cameras_and_variants(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    file_of_cameras().save(tmp_path / "seen.glb")
    file_of_variants().save(tmp_path / "shoe.glb")
    assert main(["scenes", "seen.glb"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "square  2 triangles",
        "camera 0: front, perspective, 28.6 degrees",
        "camera 1: camera 1, orthographic, 3 across",
        "camera 2: lens, perspective, 28.6 degrees",
    ]
    assert main(["scenes", "shoe.glb"]) == 0
    assert capsys.readouterr().out.splitlines()[-3:] == ["variant: beach", "variant: midnight", "variant: street"]
    command = ["--size", "6x4", "--backend", "numpy", "-o", "p.npy"]
    for which in ("camera 1", "1"):
        assert main(["render", "seen.glb", "--camera", which, *command]) == 0
        expected = render(Scene.load("seen.glb", camera=1), (6, 4), backend="numpy")
        np.testing.assert_array_equal(np.load("p.npy")["pixels"], expected.pixels)
    assert main(["render", "shoe.glb", "--variant", "midnight", "--multiscatter", *command]) == 0
    expected = render(Scene.load("shoe.glb", variant="midnight", multiscatter=True), (6, 4), backend="numpy")
    np.testing.assert_array_equal(np.load("p.npy")["pixels"], expected.pixels)
    capsys.readouterr()
    for words, error in (
        (["seen.glb", "--camera", "back"], "seen.glb has no camera 'back'"),
        (["boxes", "--camera", "front"], "--camera NAME chooses a camera of a GLB or glTF file; --camera X,Y,Z places"),
        (["boxes", "--variant", "beach"], "--variant is for GLB and glTF files: leave it out"),
        (["boxes", "--multiscatter"], "--multiscatter is for the materials of files: leave it out"),
    ):
        assert main(["render", *words, *command]) == 1
        assert error in capsys.readouterr().err
