"""STL and OFF files that others write: streamed, in one line, with spaces, and with bad entries."""

import struct

import numpy as np
import pytest

import shpy as sh
from raytracer import Mesh, Scene, SceneError

CORNERS = np.array([[(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(1, 0, 0), (1, 1, 0), (0, 1, 0)]], np.float32)
NAN = float("nan")


def stl(corners, count=None, rest=b""):
    rows = b"".join(struct.pack("<12fH", 0, 0, 1, *map(float, row.reshape(-1)), 0) for row in corners)
    return bytes(80) + struct.pack("<I", len(corners) if count is None else count) + rows + rest


def facet(corners):
    lines = [f"vertex {x} {y} {z}" for x, y, z in corners]
    return "\n".join(
        ["facet normal 0 0 1", "  outer loop", *(f"    {line}" for line in lines), "  endloop", "endfacet"]
    )


def text(*facets, name=" part"):
    return "\n".join([f"solid{name}", *map(facet, facets), f"endsolid{name}", ""])


@pytest.mark.parametrize("count", [None, 0, 0xFFFFFFFF])
def test_programs_that_stream_do_not_know_the_number_of_triangles(tmp_path, count):
    path = tmp_path / "one.stl"
    path.write_bytes(stl(CORNERS, count))
    np.testing.assert_array_equal(Mesh.load(path, strict=True).corners, CORNERS)


def test_a_stream_that_ends_within_a_triangle(tmp_path):
    path = tmp_path / "one.stl"
    path.write_bytes(stl(CORNERS, 0, b"\0" * 20))
    with pytest.warns(sh.ShpyWarning, match="left out: 1 triangle"):
        assert len(Mesh.load(path)) == 2
    with pytest.raises(SceneError, match="triangle 2: it ends within triangle 2"):
        Mesh.load(path, strict=True)


@pytest.mark.parametrize("form", ["binary", "text"])
def test_a_triangle_that_is_not_finite_costs_itself(tmp_path, form):
    bad = np.array([CORNERS[0], CORNERS[1]])
    bad[0, 2, 1] = NAN
    path = tmp_path / "one.stl"
    path.write_bytes(stl(bad) if form == "binary" else text(*bad).encode())
    where = "triangle 0" if form == "binary" else "line 2"
    said = f"left out: 1 triangle has a corner that is not finite .in {where}."
    with pytest.warns(sh.ShpyWarning, match=said):
        np.testing.assert_array_equal(Mesh.load(path).corners, CORNERS[1:])
    with pytest.raises(SceneError, match=rf"one\.stl: {where}: "):
        Mesh.load(path, strict=True)


@pytest.mark.parametrize("change", [str.upper, lambda t: t.replace("\n", " "), lambda t: t.replace("\n", "\r"), str])
@pytest.mark.parametrize("name", [" part", "", " 表 x"])
def test_texts_in_many_forms(tmp_path, change, name):
    path = tmp_path / "one.stl"
    path.write_bytes(change(text(*CORNERS, name=name)).encode("shift-jis"))
    np.testing.assert_array_equal(Mesh.load(path, strict=True).corners, CORNERS)


def test_a_facet_of_four_corners_costs_itself(tmp_path):
    path = tmp_path / "one.stl"
    path.write_text(text(CORNERS[0], [*CORNERS[0], (0, 0, 1)], CORNERS[1], CORNERS[1][:2]))
    with pytest.warns(sh.ShpyWarning, match="left out: 2 facets have not three corners .the first in line 9."):
        np.testing.assert_array_equal(Mesh.load(path).corners, CORNERS)


def test_solids_of_one_name(tmp_path):
    path = tmp_path / "many.stl"
    path.write_text(text(CORNERS[0]) + text(CORNERS[1], name="") + text(*CORNERS) + text(name=" empty"))
    meshes = Scene.load(path, floor=False).meshes
    assert [(mesh.name, len(mesh)) for mesh in meshes] == [("part", 1), ("many", 1), ("part_1", 2)]


OFF = "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n"


@pytest.mark.parametrize(
    "change",
    [
        str, lambda t: "  " + t, lambda t: "\n# made by hand\n\n" + t, lambda t: t.replace("\n", "\r\n"),
        lambda t: t.replace("\n", "\r"), lambda t: t.replace("OFF\n", "OFF "), lambda t: t.replace("\n", "  # x\n"),
        lambda t: t.replace("\n", "\n\n \t"), lambda t: "\ufeff" + t,
    ],
)  # fmt: skip
def test_headers_of_off_files(tmp_path, change):
    path = tmp_path / "one.off"
    path.write_bytes(change(OFF).encode())
    mesh = Mesh.load(path, strict=True)
    np.testing.assert_allclose(mesh.corners, [[(0, 0, 0), (1, 0, 0), (1, 1, 0)], [(0, 0, 0), (1, 1, 0), (0, 1, 0)]])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("3 0 2 3", "3 0 2 9"), "1 face names a vertex that the file lacks (in face 1)"),
        (("3 0 2 3", "3 0 2"), "1 face ends before its last number (in face 1)"),
        (("3 0 2 3", "2 0 2"), "1 face has fewer than three corners (in face 1)"),
        (("3 0 2 3", "3 0 2 x"), "1 face has a word that is not an index (in face 1)"),
        (("0 1 0", "0 nan 0"), "1 vertex is not three finite numbers (in vertex 3), 1 face has a corner at such"),
    ],
)
def test_a_bad_entry_of_an_off_file_costs_itself(tmp_path, change, said):
    path = tmp_path / "one.off"
    path.write_text(OFF.replace(*change))
    with pytest.warns(sh.ShpyWarning) as caught:
        assert len(Mesh.load(path)) == 1
    assert said in str(caught[0].message)
    with pytest.raises(SceneError, match=r"one\.off: (face 1|vertex 3): "):
        Mesh.load(path, strict=True)
