"""PLY files that others write: lists anywhere, colours of every type, line ends, pictures by number, bad entries."""

import struct

import numpy as np
import pytest
from gltf_files import png

import shpy as sh
from raytracer import Mesh, Scene, SceneError
from raytracer.appearance.textures import decoded

FORMS = ("ascii", "binary_little_endian", "binary_big_endian")
CODES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}
SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def ply(form, *elements, comments=(), end="\n"):
    """A file: each element is (name, its properties, its rows); a list stands in a row as a tuple."""
    head = ["ply", f"format {form} 1.0", *(f"comment {text}" for text in comments)]
    body = b""
    for name, properties, rows in elements:
        head += [f"element {name} {len(rows)}", *(f"property {text}" for text in properties)]
        for row in rows:
            words = []
            for text, value in zip(properties, row, strict=True):
                kinds, values = text.split()[:-1], [value]
                if kinds[0] == "list":
                    kinds, values = [kinds[1], *[kinds[2]] * len(value)], [len(value), *value]
                if form == "ascii":
                    words += map(str, values)
                else:
                    order = ">" if "big" in form else "<"
                    body += b"".join(struct.pack(order + CODES[k], v) for k, v in zip(kinds, values, strict=True))
            body += (" ".join(words) + end).encode() if form == "ascii" else b""
    return (end.join(head) + end + "end_header" + end).encode() + body


XYZ = tuple(f"float {axis}" for axis in "xyz")
CORNERS = "list uchar int vertex_indices"
FACES = ("face", (CORNERS,), [((0, 1, 2, 3),)])


def loaded(tmp_path, data, **options):
    path = tmp_path / "one.ply"
    path.write_bytes(data)
    return Mesh.load(path, **options)


def area(mesh):
    sides = np.diff(mesh.corners, axis=1)
    return np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("sizes", [(2, 2, 2, 2), (0, 3, 1, 2)])
def test_lists_in_vertices_and_in_elements_before_the_faces(tmp_path, form, sizes):
    vertices = [(*place, tuple(range(n))) for place, n in zip(SQUARE, sizes, strict=True)]
    before = ("strands", ("list ushort double weights", "uchar n"), [((0.5,) * n, n) for n in sizes])
    data = ply(form, ("vertex", (*XYZ, "list uchar short bones"), vertices), before, FACES)
    with pytest.warns(sh.ShpyWarning, match="ignored: bones of each vertex .4., elements strands .4."):
        assert area(loaded(tmp_path, data)) == 1


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_line_ends(tmp_path, form, end):
    data = ply(form, ("vertex", XYZ, [(10, 0, 0), *SQUARE[1:]]), ("face", (CORNERS,), [((1, 2, 3),)]), end=end)
    assert area(loaded(tmp_path, data)) == 0.5


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("kind", "white"),
    [
        *(("uchar", 255), ("ushort", 65535), ("uint", 255), ("uint", 65535), ("uint", 2**32 - 1), ("int", 255)),
        *(("short", 255), ("short", 2**15 - 1), ("int", 2**31 - 1), ("char", 127)),
        *(("float", 1), ("float", 255), ("double", 1), ("double", 255)),
    ],
)
@pytest.mark.parametrize("element", ["vertex", "face"])
def test_colours_of_every_type(tmp_path, form, kind, white, element):
    """The number of full intensity is white; a half of it is 0.2140 by sRGB."""
    color = (white, white / 2 if kind in ("float", "double") else white // 2, 0)
    properties = tuple(f"{kind} {name}" for name in ("red", "green", "blue"))
    if element == "vertex":
        data = ply(form, ("vertex", XYZ + properties, [(*place, *color) for place in SQUARE]), FACES)
    else:
        data = ply(form, ("vertex", XYZ, SQUARE), ("face", (*properties, CORNERS), [(*color, (0, 1, 2, 3))]))
    wanted = decoded(np.array(color) / white)
    np.testing.assert_allclose(loaded(tmp_path, data).colors, np.broadcast_to(wanted, (2, 3, 3)), atol=1e-6)


@pytest.mark.parametrize("form", FORMS)
def test_faces_name_their_pictures_by_number(tmp_path, form):
    for name, color in (("a.png", (255, 0, 0)), ("b c.png", (0, 255, 0))):
        (tmp_path / name).write_bytes(png([[color]]))
    faces = [((0, 1, 2), (0, 0, 1, 0, 1, 1), 1), ((0, 2, 3), (0, 0, 1, 1, 0, 1), 0), ((0, 1, 3), (), -1)]
    face = ("face", (CORNERS, "list uchar float texcoord", "int texnumber"), faces)
    comments = ("TextureFile a.png", "TextureFile b c.png")
    path = tmp_path / "two.ply"
    path.write_bytes(ply(form, ("vertex", XYZ, SQUARE), face, comments=comments))
    meshes = Scene.load(path, floor=False, strict=True).meshes
    found = {mesh.name: getattr(mesh.material.color, "image", np.array(mesh.material.color)) for mesh in meshes}
    assert [len(mesh) for mesh in meshes] == [1, 1, 1]
    assert found["two_1"].tolist() == [[[1, 0, 0]]]
    assert found["two_2"].tolist() == [[[0, 1, 0]]]
    np.testing.assert_array_equal(meshes[2].uv, [[[0, 0], [1, 0], [1, 1]]])


NAN = float("nan")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("vertices", "faces", "said"),
    [
        ([(NAN, 0, 0), *SQUARE], [(1, 2, 3, 4)], "1 vertex is not three finite numbers (in vertex 0)"),
        (
            [*SQUARE, (0, NAN, 0)],
            [(0, 1, 4), (0, 1, 2, 3)],
            "1 vertex is not three finite numbers (in vertex 4), 1 face has a corner at such a vertex (in face 0)",
        ),
        (
            SQUARE,
            [(0, 1, 2, 3), (0, 1, 7), (0, 9, 2)],
            "2 faces name a vertex that the file lacks (the first in face 1)",
        ),
        (SQUARE, [(0, 1), (0, 1, 2, 3), ()], "2 faces have fewer than three corners (the first in face 0)"),
    ],
)
def test_a_bad_entry_costs_that_entry(tmp_path, form, vertices, faces, said):
    data = ply(form, ("vertex", XYZ, vertices), ("face", (CORNERS,), [(face,) for face in faces]))
    with pytest.warns(sh.ShpyWarning) as caught:
        assert area(loaded(tmp_path, data)) == 1
    assert [str(w.message) for w in caught] == [f"one.ply: left out: {said}"]
    with pytest.raises(SceneError, match=r"one\.ply: (vertex|face) \d: "):
        loaded(tmp_path, data, strict=True)


@pytest.mark.parametrize("form", FORMS)
def test_one_bad_normal_costs_that_normal(tmp_path, form):
    normals = [(0, 0, 1), (NAN, 0, 0), (0, 0.6, 0.8), (0, 0, 1)]
    rows = [(*place, *normal) for place, normal in zip(SQUARE, normals, strict=True)]
    with pytest.warns(sh.ShpyWarning, match="left out: 1 normal is not three finite numbers .in vertex 1."):
        mesh = loaded(tmp_path, ply(form, ("vertex", (*XYZ, *(f"float n{a}" for a in "xyz")), rows), FACES))
    np.testing.assert_allclose(mesh.normals[0], [(0, 0, 1), (0, 0, 1), (0, 0.6, 0.8)], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ((b"1 1 0\n", b"1 1\n"), "1 vertex is not three finite numbers (in vertex 2), 1 face has a corner at such"),
        ((b"4 0 1 2 3\n", b"4 0 1 2\n"), "1 face ends before its last number (in face 0)"),
        ((b"4 0 1 2 3\n", b"4 0 1 2 x\n"), "1 face has a word that is not an index (in face 0)"),
    ],
)
def test_lines_that_end_early(tmp_path, change, said):
    face = ("face", (CORNERS,), [((0, 1, 2, 3),), ((0, 1, 3),)])
    data = ply("ascii", ("vertex", XYZ, SQUARE), face).replace(*change)
    with pytest.warns(sh.ShpyWarning) as caught:
        assert area(loaded(tmp_path, data)) == 0.5
    assert said in str(caught[0].message)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ((b"float x", b"flaot x"), "line 4: 'property flaot x' is not a property of an element"),
        ((b"list uchar int", b"list float int"), "line 8: the length of a list is a whole number, not a float"),
        ((b"float z", b"float w"), "its vertices lack x, y or z"),
        ((b"ascii", b"binary_little_endian"), "at least 49 bytes, not 34"),
        ((b"ascii", b"text"), "its format is text: ascii, binary_little_endian and binary_big_endian are read"),
        ((b"end_header\n", b""), "it has no PLY header that ends"),
        ((b"vertex 4", b"vertex four"), "line 3: an element in its header is 'vertex four'"),
    ],
)
def test_headers_that_make_no_sense(tmp_path, change, words):
    with pytest.raises(SceneError, match=words):
        loaded(tmp_path, ply("ascii", ("vertex", XYZ, SQUARE), FACES).replace(*change))
