"""OBJ with MTL, and PLY with a picture: names, parts, materials, and what is said of the rest."""

import warnings

import numpy as np
import pytest
from gltf_files import png
from ply_files import PLY

import shpy as sh
from raytracer import Material, Mesh, Scene, SceneError, Texture
from raytracer.cli import main
from raytracer.meshes.appearance import CLAY, picture_words, read_mtl

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
map_Kd -s 1 1 1 -mm 0 1 -clamp on brown paint.png
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
    ignored = "-mm of pictures (1), light beyond what surfaces receive (2), bump maps (1)"
    assert [str(w.message) for w in caught] == [f"chair.obj: ignored: {ignored}"]
    wood, steel, again, _, _ = (mesh.material for mesh in scene.meshes)
    assert isinstance(wood.color, Texture)
    assert wood.color.wrap == "clamp"
    np.testing.assert_allclose(wood.color.image[0, 0], np.array([1, 0.5, 0.25]) * (1, 0.21586, 0), atol=1e-4)
    assert (wood.specular, wood.shininess, wood.reflectivity) == (pytest.approx(0.3 / 1.3), 60, 0)
    assert scene.meshes[3].material is wood
    expected = Material((0.5, 0.5, 0.5), 1 / 1.4, 0.9 / 1.4, 40.0, 0.9, transmission=0.5, ior=1.0, emission=(1, 0, 0))
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
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0\nf 1 2 3\n", "line 4: a normal is not three finite numbers: 'vn 0 0'"),
        ("v 0 0 0\nv 1 0 0\nf -3 -2 -1\n", "line 3: a face names vertex -3, and there are 2"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/0 2/1 3/1\n", "line 4: a face names texture vertex 0; numbers begin at 1"),
    ],
)
def test_wrong_lines_are_named(tmp_path, text, words):
    path = tmp_path / "wrong.obj"
    path.write_text(text)
    with pytest.raises(SceneError, match=words):
        Scene.load(path, strict=True)


def test_materials_that_make_no_sense_leave_the_shape(chair):
    (chair.parent / "chair parts.mtl").write_text(MTL.replace("Kd 1 0.5 0.25", "Kd spectral wood.rfl"))
    with (
        pytest.warns(sh.ShpyWarning, match=r"material wood \(Kd has spectral, which is not a finite number\)"),
        pytest.warns(sh.ShpyWarning, match="ignored: "),
    ):
        assert Scene.load(chair).meshes[0].material == CLAY


@pytest.mark.parametrize(
    ("statement", "cause"),
    [
        ("Pr nan", "Pr has nan, which is not a finite number"),
        ("Pm 1e999", "Pm has 1e999, which is not a finite number"),
        ("Kd 1 2", "Kd is three numbers, each 0 or more, not 1 2"),
        ("Ke 1 -1 1", "Ke is three numbers, each 0 or more, not 1 -1 1"),
    ],
)
def test_numbers_of_materials_that_are_none_are_named(tmp_path, statement, cause):
    (tmp_path / "one.mtl").write_text(f"newmtl a\nKd 1 1 1\n{statement}\n")
    path = tmp_path / "one.obj"
    path.write_text("mtllib one.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
    with pytest.raises(SceneError, match=cause):
        Scene.load(path, strict=True)


def test_names_of_materials_without_a_library(tmp_path):
    path = tmp_path / "alone.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n")
    with pytest.warns(sh.ShpyWarning, match=r"ignored: names of materials that are not described \(1\)"):
        Scene.load(path)


def test_words_of_libraries():
    found = read_mtl(b"newmtl a b\nKd 1 1 1 # white\n\tmap_Kd x.png\nnewmtl c\n")
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
        "raytracer: warning: chair.obj: ignored: -mm of pictures (1), light beyond what surfaces receive (2), "
        "bump maps (1)"
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


def ring(count, statement):
    """The faces of a prism of `count` sides, which share their vertices, after a statement."""
    angle = 2 * np.pi * np.arange(count) / count
    lines = [f"v {np.cos(a):.9f} {y} {np.sin(a):.9f}" for y in (0, 1) for a in angle]
    sides = [(k, count + k, count + (k + 1) % count, (k + 1) % count) for k in range(count)]
    return "\n".join([*lines, statement, *("f " + " ".join(str(c + 1) for c in side) for side in sides), ""])


@pytest.mark.parametrize("count", [6, 24])
@pytest.mark.parametrize(
    ("statement", "smooth"), [("s 1", True), ("s 7", True), ("s off", False), ("s 0", False), ("", None)]
)
def test_smoothing_groups(tmp_path, count, statement, smooth):
    """A ring of 6 sides is smooth where its group says so, one of 24 flat; without groups the angles decide."""
    path = tmp_path / "ring.obj"
    path.write_text(ring(count, statement))
    mesh = Mesh.load(path)
    outward = mesh.corners * (1, 0, 1)
    flat = np.repeat(mesh.face_normals[:, None], 3, axis=1)
    wanted = outward if smooth or (smooth is None and count == 24) else flat
    if statement:
        np.testing.assert_allclose(mesh.normals, wanted, atol=1e-6)
    else:  # triangles are weighed by their areas, of which a corner of a quadrilateral has one or two
        assert np.einsum("ijk,ijk->ij", mesh.normals, wanted).min() > 0.995


def test_smoothing_ends_between_groups_and_where_they_are_off(tmp_path):
    path = tmp_path / "roof.obj"
    path.write_text(
        "v 0 0 0\nv 0 0 1\nv 1 -1 0\nv -1 -1 0\nv -1 -1 1\nvn 0 1 0\n"
        "f 1 2 3\ns 1\nf 1 4 2\nf 2 4 5\ns 2\nf 1 2 3\ns off\nf 1 2 3\ns 1\nf 1//1 2 3\n"
    )
    mesh = Mesh.load(path)
    flat = mesh.face_normals
    np.testing.assert_allclose(mesh.normals[[0, 3, 4]], np.repeat(flat[[0, 3, 4], None], 3, axis=1), atol=1e-12)
    np.testing.assert_allclose(mesh.normals[5, 0], (0, 1, 0))  # a normal of the file counts more than a group
    shared = np.pi / 2 * flat[1] + np.arctan(np.sqrt(2)) * flat[5]
    np.testing.assert_allclose(mesh.normals[5, 1], shared / np.linalg.norm(shared), atol=1e-12)


SQUARE = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


@pytest.mark.parametrize("key", [b"g", b"o", b"usemtl"])
@pytest.mark.parametrize("name", ["表".encode("shift-jis"), b"one\x85two", "a\u2028b".encode(), b"name\\"])
@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
def test_names_in_other_encodings_end_with_their_line(tmp_path, key, name, end):
    path = tmp_path / "name.obj"
    path.write_bytes((SQUARE + key + b" " + name + b"\nf 1 2 3\nf 1 3 4\nusemtl x\nf 1 2 4\n").replace(b"\n", end))
    with pytest.warns(sh.ShpyWarning, match="names of materials"):
        meshes = Scene.load(path, floor=False).meshes
    assert [len(mesh) for mesh in meshes] == [2, 1]


def test_two_materials_whose_names_begin_alike(tmp_path):
    """The byte 85 is a letter of Latin-1's and of Shift-JIS's, and a line's end for Python's strings alone."""
    path = tmp_path / "name.obj"
    (tmp_path / "name.mtl").write_bytes(b"newmtl a\x85b\nKd 1 0 0\nnewmtl a\x85c\nKd 0 1 0\n")
    path.write_bytes(b"mtllib name.mtl\n" + SQUARE + b"usemtl a\x85b\nf 1 2 3\nusemtl a\x85c\nf 1 3 4\n")
    assert [mesh.material.color for mesh in Scene.load(path, floor=False).meshes] == [(1, 0, 0), (0, 1, 0)]


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\n"


@pytest.mark.parametrize(
    ("text", "said", "count"),
    [
        ("f 1//7 2//1 3//1\n", "1 face names a normal that the file lacks (in line 6)", 1),
        ("f 1/7 2/1 3/1\nf 1/9 2 3/1\n", "2 faces name a texture vertex that the file lacks (the first in line 6)", 2),
        ("f 1 2 3\nf 1 2 4\n", "1 face names a vertex that the file lacks (in line 7)", 1),
        ("f 1 2 3\nf 1 0 3\nf -4 1 2\n", "2 faces name a vertex that the file lacks (the first in line 7)", 1),
        ("vn nan nan nan\nf 1//2 2//1 3//1\n", "1 normal is not three finite numbers (in line 6)", 1),
        ("vn -1.#IND00 0 0\nf 1//2 2//1 3//1\n", "1 normal is not three finite numbers (in line 6)", 1),
        ("vt 1.#QNAN 0\nf 1/2 2/1 3/1\n", "1 texture vertex is not finite numbers (in line 6)", 1),
        ("v 0 1 0 nan 0 0\nf 1 2 4\n", "1 colour of a vertex is not finite (in line 6)", 1),
        ("f 1 2\nf 1 2 3\n", "1 face has fewer than three corners (in line 6)", 1),
        ("f 1 2 x\nf 1/x 2 3\nf 1 2 3\n", "2 faces have a word that is not an index (the first in line 6)", 1),
        ("v nan 0 0\nf 1 2 3\n", "1 vertex is not three finite numbers (in line 6)", 1),
        (
            "v 1 2\nf 1 2 3\nf 1 2 4\n",
            "1 vertex is not three finite numbers (in line 6), 1 face has a corner at such a vertex (in line 8)",
            1,
        ),
    ],
)
def test_a_bad_entry_costs_that_entry(tmp_path, text, said, count):
    path = tmp_path / "bad.obj"
    path.write_text(TRIANGLE + text)
    with pytest.warns(sh.ShpyWarning) as caught:
        mesh = Mesh.load(path)
    assert [str(w.message) for w in caught] == [f"bad.obj: left out: {said}"]
    assert len(mesh) == count
    np.testing.assert_allclose(np.abs(mesh.face_normals[:, 2]).max(), 1)
    if mesh.normals is not None and "vn" in text:
        np.testing.assert_array_equal(mesh.normals, np.broadcast_to([0, 0, 1], (1, 3, 3)))
    with pytest.raises(SceneError, match=r"bad\.obj: line \d: "):
        Mesh.load(path, strict=True)


def test_a_file_whose_entries_are_all_bad_says_so(tmp_path):
    path = tmp_path / "bad.obj"
    path.write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(SceneError, match="holds no triangles; left out: 1 vertex is not three finite numbers"):
        Mesh.load(path)


PICTURED = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl red\nf 1/1 2/2 3/3\n"


@pytest.mark.parametrize(
    ("library", "picture", "said"),
    [
        ("mats/a.mtl", "mats/a.png", ("mats/a.mtl", "a.png")),
        ("mats/a.mtl", "pics/a.png", ("mats/a.mtl", "../pics/a.png")),
        ("mats/a.mtl", "a.png", ("mats\\a.mtl", "a.png")),
        (" a.mtl", "a  b .png", (" a.mtl", "a  b .png")),
        ("a.mtl", " a.png", ("  a.mtl", " a.png")),
        ("a.mtl", "a.png", ("  a.mtl", "  a.png  ")),
        ("a.mtl", "a.png", ("A.mtl", "A.PNG")),
        ("Mats/A.MTL", "Mats/Tex/a.Png", ("mats/a.mtl", "tex/A.png")),
        ("a.mtl", "a.png", ("a.mtl", "a.png?v=3")),
        ("a.mtl", "a.png?v=3", ("a.mtl", "a.png?v=3")),
        ("a.mtl", "a.png", ("a.mtl", "-s 1 1 1 -clamp on C:\\\\work\\\\a.png")),
        ("a.mtl", "a b.png", ("a.mtl", "-blendu off\ta b.png")),
    ],
)
def test_pictures_are_looked_for_beside_their_library(tmp_path, library, picture, said):
    for name in (library, picture):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / library).write_text(f"newmtl red\nKd 1 1 1\nmap_Kd {said[1]}\n")
    (tmp_path / picture).write_bytes(png([[[255, 0, 0]]]))
    path = tmp_path / "one.obj"
    path.write_text(f"mtllib {said[0]}\n{PICTURED}")
    with warnings.catch_warnings():
        warnings.simplefilter("error" if "-" not in said[1] else "ignore")
        mesh = Scene.load(path, strict=True).meshes[0]
    np.testing.assert_array_equal(mesh.material.color.image, [[[1, 0, 0]]])


def test_pictures_of_one_name_beside_two_libraries_are_two(tmp_path):
    for name, color in (("a", (255, 0, 0)), ("b", (0, 255, 0))):
        (tmp_path / name).mkdir()
        (tmp_path / name / "all.mtl").write_text(f"newmtl {name}\nKd 1 1 1\nmap_Kd skin.png\n")
        (tmp_path / name / "skin.png").write_bytes(png([[color]]))
    path = tmp_path / "two.obj"
    path.write_text("mtllib a/all.mtl b/all.mtl\n" + PICTURED.replace("red", "a") + "usemtl b\nf 1/1 2/2 3/3\n")
    one, other, _ = Scene.load(path).meshes
    assert [mesh.material.color.image.tolist() for mesh in (one, other)] == [[[[1, 0, 0]]], [[[0, 1, 0]]]]


def test_a_link_in_other_capitals_leads_nowhere_else(tmp_path):
    (tmp_path / "secret.png").write_bytes(png([[[255, 0, 0]]]))
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "A.png").symlink_to(tmp_path / "secret.png")
    (inner / "one.mtl").write_text("newmtl red\nKd 1 1 1\nmap_Kd a.png\n")
    (inner / "one.obj").write_text("mtllib one.mtl\n" + PICTURED)
    with pytest.raises(SceneError, match=r"a\.png: there is no such file"):
        Scene.load(inner / "one.obj", strict=True)
