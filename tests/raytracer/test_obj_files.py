"""OBJ with MTL, and PLY with a picture: names, parts, materials, and what is said of the rest."""

import warnings

import numpy as np
import pytest
from gltf_files import png
from ply_files import PLY

import shpy as sh
from raytracer import Material, Mesh, Scene, SceneError, Texture
from raytracer.cli import main
from raytracer.meshes.appearance import CLAY
from raytracer.meshes.obj import picture_words, read_mtl

CHAIR = """\
mtllib chair parts.mtl
o chair # of four legs
v -1 0 0
v 1 0 0
v 1 1 0
v -1 1 0
vt 0 0
vt 1 0
vt 1 1
vn 0 0 1
usemtl wood
f 1/1/1 2/2/1 3/3/1
usemtl Steel #2
f 1/1/1 3/3/1 4/2/1
o table
v 5 0 0
v 6 0 0
v 6 1 0
f -3 -2 -1
usemtl wood
f 5/1 6/2 7/3
g ignored while there is an o
f 5/1 6/2 7/3 6/2
"""
MTL = """\
# two materials
newmtl wood
Kd 1 0.5 0.25
Ks 0.2 0.3 0.4
Ns 60
map_Kd -s 1 1 1 -clamp on brown paint.png
newmtl Steel #2
Kd .5 .5 .5
Ks 0.9
illum 3
d 0.5
Ke 1 0 0
map_Bump bumps.png
"""


@pytest.fixture
def chair(tmp_path):
    (tmp_path / "chair parts.mtl").write_text(MTL)
    (tmp_path / "brown paint.png").write_bytes(png([[[255, 128, 0], [0, 0, 0]]]))
    path = tmp_path / "chair.obj"
    path.write_text(CHAIR)
    return path


def test_parts_have_names_and_materials(chair):
    with pytest.warns(sh.ShpyWarning) as caught:
        scene = Scene.load(chair)
    assert [mesh.name for mesh in scene.meshes] == ["chair", "chair_1", "table", "table_1", "floor"]
    assert [len(mesh) for mesh in scene.meshes] == [1, 1, 1, 3, 2]
    ignored = "-s of pictures (1), normal maps (1)"
    assert [str(w.message) for w in caught] == [f"chair.obj: ignored: {ignored}"]
    wood, steel, again, _, _ = (mesh.material for mesh in scene.meshes)
    assert isinstance(wood.color, Texture)
    assert wood.color.wrap == "clamp"
    np.testing.assert_allclose(wood.color.image[0, 0], np.array([1, 0.5, 0.25]) * (1, 0.21586, 0), atol=1e-4)
    assert (wood.specular, wood.shininess, wood.reflectivity) == (pytest.approx(0.3), 60, 0)
    assert scene.meshes[3].material is wood
    expected = Material((0.5, 0.5, 0.5), 1.0, 0.9, 40.0, 0.9, transmission=0.5, ior=1.0, emission=(1, 0, 0))
    assert steel == expected
    assert again is steel  # a material stays until the next one is named
    np.testing.assert_array_equal(scene.meshes[2].corners, [[[5, 0, 0], [6, 0, 0], [6, 1, 0]]])
    np.testing.assert_array_equal(scene.meshes[0].uv, [[[0, 0], [1, 0], [1, 1]]])


def test_files_that_are_not_there(chair):
    (chair.parent / "brown paint.png").unlink()
    with (
        pytest.warns(sh.ShpyWarning, match=r"plain colours: brown paint.png \(there is no such file\)"),
        pytest.warns(sh.ShpyWarning, match="ignored: "),
    ):
        scene = Scene.load(chair)
    assert scene.meshes[0].material.color == (1, 0.5, 0.25)
    (chair.parent / "chair parts.mtl").unlink()
    with pytest.warns(sh.ShpyWarning, match=r"chair \(there is no such file\), parts.mtl \(there is no such file\)"):
        scene = Scene.load(chair)
    assert scene.meshes[0].material == CLAY


def test_libraries_and_pictures_outside_of_the_folder(chair):
    inner = chair.parent / "inner"
    inner.mkdir()
    path = inner / "chair.obj"
    path.write_text(CHAIR.replace("chair parts.mtl", "../chair parts.mtl"))
    with pytest.warns(sh.ShpyWarning, match=r"lies outside of the file's folder: put it there"):
        assert Scene.load(path).meshes[0].material == CLAY
    (inner / "chair parts.mtl").write_text(MTL.replace("brown paint.png", str(chair.parent / "brown paint.png")))
    with (
        pytest.warns(sh.ShpyWarning, match=r"brown paint.png \(it lies outside of the file's folder: put it there\)"),
        pytest.warns(sh.ShpyWarning, match="ignored: "),
    ):
        assert Scene.load(path).meshes[0].material.color == (1, 0.5, 0.25)


def test_faces_count_back_from_where_they_stand(tmp_path):
    path = tmp_path / "back.obj"
    triangle = "v {0} 0 0\nv {0} 1 0\nv {0} 0 1\nf -3 -2 -1\n"
    path.write_text("".join(triangle.format(k) for k in range(3)))
    np.testing.assert_array_equal(Mesh.load(path).corners[:, :, 0], [[0] * 3, [1] * 3, [2] * 3])


@pytest.mark.parametrize("white", ["1", "255"])
def test_colours_of_vertices_are_shares_or_bytes(tmp_path, white):
    path = tmp_path / "colour.obj"
    path.write_text(f"v 0 0 0 {white} 0 0\nv 1 0 0\nv 0 1 0 0 {int(white) / 5:g} {white}\nf 1 2 3\n")
    np.testing.assert_allclose(Mesh.load(path).colors, [[[1, 0, 0], [1, 1, 1], [0, 0.033105, 1]]], atol=1e-6)


def test_colours_of_vertices_beside_texture_vertices(tmp_path):
    path = tmp_path / "colour.obj"
    path.write_text("v 0 0 0 1 0.5 0\nv 1 0 0 1 0.5 0\nv 0 1 0 1 0.5 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    mesh = Mesh.load(path)
    np.testing.assert_allclose(mesh.colors, np.broadcast_to([1, 0.21404, 0], (1, 3, 3)), atol=1e-4)
    np.testing.assert_array_equal(mesh.uv, [[[0, 0], [1, 0], [0, 1]]])


def test_corners_without_normals_have_that_of_the_face(tmp_path):
    path = tmp_path / "mixed.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0.6 0 0.8\nf 1//1 2 3\n")
    np.testing.assert_allclose(Mesh.load(path).normals, [[[0.6, 0, 0.8], [0, 0, 1], [0, 0, 1]]])


def test_a_border_of_materials_stays_smooth(tmp_path):
    """Faces that meet at a small angle, of two materials: one normal at the corners that they share."""
    path = tmp_path / "bent.obj"
    path.write_text(
        "v 0 0 0\nv 0 1 0\nv 1 0 0.2\nv -1 0 0.2\nusemtl a\nf 1 3 2\nusemtl b\nf 1 2 4\nl 1 2\nmtllib none.mtl\n"
    )
    with pytest.warns(sh.ShpyWarning):
        one, other, _ = Scene.load(path).meshes
    np.testing.assert_allclose(one.normals[0, 0], other.normals[0, 0])
    assert not np.allclose(one.normals[0, 0], one.face_normals[0])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/2 3/1\n",
            "line 5: a face names texture vertex 2, and there are 1",
        ),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0\nf 1 2 3\n", "line 4: a normal has three coordinates, not 2"),
        ("v 0 0 0\nv 1 0 0\nf -3 -2 -1\n", "line 3: a face names vertex -3, and there are 2"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/0 2/1 3/1\n", "line 4: a face names texture vertex 0; numbers begin at 1"),
    ],
)
def test_wrong_lines_are_named(tmp_path, text, words):
    path = tmp_path / "wrong.obj"
    path.write_text(text)
    with pytest.raises(SceneError, match=words):
        Scene.load(path)


def test_materials_that_make_no_sense_leave_the_shape(chair):
    (chair.parent / "chair parts.mtl").write_text(MTL.replace("Kd 1 0.5 0.25", "Kd spectral wood.rfl"))
    with (
        pytest.warns(sh.ShpyWarning, match=r"material wood \(could not convert string to float: 'spectral'\)"),
        pytest.warns(sh.ShpyWarning, match="ignored: "),
    ):
        assert Scene.load(chair).meshes[0].material == CLAY


def test_names_of_materials_without_a_library(tmp_path):
    path = tmp_path / "alone.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n")
    with pytest.warns(sh.ShpyWarning, match=r"ignored: names of materials that are not described \(1\)"):
        Scene.load(path)


def test_words_of_libraries():
    found = read_mtl("newmtl a b\nKd 1 1 1 # white\n\tmap_Kd x.png\nnewmtl c\n")
    assert found == {"a b": {"kd": ["1", "1", "1"], "map_kd": ["x.png"]}, "c": {}}
    assert picture_words(["-s", "2", "2", "-clamp", "on", "a", "b.png"]) == (
        "a b.png",
        {"-s": ["2", "2"], "-clamp": ["on"]},
    )
    assert picture_words(["-mm", "0", "1", "7.png"]) == ("7.png", {"-mm": ["0", "1"]})
    assert picture_words(["7"]) == ("7", {})


def test_a_ply_file_with_a_picture(tmp_path):
    (tmp_path / "paint.png").write_bytes(png([[[255, 0, 0]]]))
    path = tmp_path / "sail.ply"
    path.write_text(PLY)
    mesh = Scene.load(path).meshes[0]
    np.testing.assert_array_equal(mesh.material.color.image, [[[1, 0, 0]]])
    np.testing.assert_array_equal(mesh.uv, [[[0, 0], [1, 0], [0, 1]]])
    assert mesh.name == "sail"
    path.write_text(PLY.replace("paint.png", "../paint.png"))
    (tmp_path / "paint.png").unlink()
    with pytest.warns(sh.ShpyWarning, match="outside of the file's folder"):
        assert Scene.load(path).meshes[0].material == CLAY


def test_the_command_renders_a_file_and_warns_in_lines(chair, capsys):
    picture = chair.parent / "chair.png"
    assert main(["render", str(chair), "--backend", "numpy", "--size", "24x24", "-o", str(picture)]) == 0
    said = capsys.readouterr().err.splitlines()
    assert [line for line in said if "warning" in line] == [
        "raytracer: warning: chair.obj: ignored: -s of pictures (1), normal maps (1)"
    ]
    assert picture.exists()


def test_warnings_name_the_line_of_the_caller(chair):
    for load in (Scene.load, Mesh.load):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            load(chair)
        assert [w.filename for w in caught] == [__file__]


def test_statements_that_are_not_known_are_counted(tmp_path):
    path = tmp_path / "odd.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\ns off\nface 1 2 3\nF 1 2 3\nface 1 2 3\nf 1 2 3\n")
    with pytest.warns(sh.ShpyWarning, match=r"ignored: unknown statements face \(2\), unknown statements F \(1\)$"):
        assert len(Scene.load(path).meshes[0].corners) == 1
