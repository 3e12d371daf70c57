"""Binary PLY files whose faces have several numbers of corners."""

import struct

import numpy as np
import pytest
from PIL import Image as pillow

import shpy as sh
from raytracer import Mesh, Scene, SceneError
from raytracer.appearance.textures import decoded

POINTS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 2, 1)]
FACES = [(0, 1, 2, 3), (0, 1, 4), (0, 1, 2, 3, 4), (2, 3, 4)]
FANS = [(0, 1, 2), (0, 2, 3), (0, 1, 4), (0, 1, 2), (0, 2, 3), (0, 3, 4), (2, 3, 4)]


def written(order, faces, count="uchar", corner="int", after=b""):
    name = "big" if order == ">" else "little"
    head = (
        f"ply\nformat binary_{name}_endian 1.0\ncomment made by hand\nelement vertex {len(POINTS)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list {count} {corner} vertex_indices\n"
        + ("element extra 2\nproperty uchar n\n" if after else "")
        + "end_header\n"
    )
    codes = {"uchar": "B", "uint": "I", "int": "i", "ushort": "H"}
    body = b"".join(struct.pack(f"{order}3f", *p) for p in POINTS)
    for face in faces:
        body += struct.pack(f"{order}{codes[count]}{len(face)}{codes[corner]}", len(face), *face)
    return head.encode() + body + after


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("kinds", [("uchar", "int"), ("uint", "ushort")])
@pytest.mark.parametrize("after", [b"", b"\x01\x02"])
def test_faces_of_several_sizes_are_fans(tmp_path, order, kinds, after):
    path = tmp_path / "mixed.ply"
    path.write_bytes(written(order, FACES, *kinds, after=after))
    mesh = Mesh.load(path)
    found = np.sort(mesh.corners.reshape(len(mesh), -1), axis=0)
    wanted = np.sort(np.array([[POINTS[k] for k in fan] for fan in FANS], float).reshape(len(FANS), -1), axis=0)
    np.testing.assert_array_equal(found, wanted)


def test_a_file_that_ends_within_its_faces_is_refused(tmp_path):
    path = tmp_path / "short.ply"
    path.write_bytes(written("<", FACES)[:-6])
    with pytest.raises(SceneError, match=r"short\.ply"):
        Mesh.load(path)


BESIDE = ["uchar red", "uchar green", "uchar blue"]
SKY = {(0, 1, 2, 3): (255, 0, 0), (0, 1, 4): (0, 255, 0), (0, 1, 2, 3, 4): (0, 0, 255), (2, 3, 4): (255, 255, 0)}


def with_properties(form, faces, before, after, values, extra=""):
    """A file whose faces have properties beside their corners; `values` gives those of a face, a tuple for a list."""
    head = f"ply\nformat {form} 1.0\n{extra}element vertex {len(POINTS)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + f"element face {len(faces)}\n"
    kinds = [*before, "list uchar int vertex_indices", *after]
    head += "".join(f"property {kind}\n" for kind in kinds) + "end_header\n"
    rows = [[*values(face)[: len(before)], face, *values(face)[len(before) :]] for face in faces]
    if form == "ascii":
        flat = [[x for v in row for x in ((len(v), *v) if isinstance(v, tuple) else (v,))] for row in rows]
        return head.encode() + "".join(" ".join(map(str, line)) + "\n" for line in [*POINTS, *flat]).encode()
    order = ">" if "big" in form else "<"
    codes = {"uchar": "B", "int": "i", "float": "f"}
    body = b"".join(struct.pack(f"{order}3f", *p) for p in POINTS)
    for row in rows:
        for kind, value in zip(kinds, row, strict=True):
            *_, number, _ = kind.split()
            many = value if isinstance(value, tuple) else (value,)
            body += struct.pack("B", len(many)) if kind.startswith("list") else b""
            body += struct.pack(f"{order}{len(many)}{codes[number]}", *many)
    return head.encode() + body


FORMS = ["ascii", "binary_little_endian", "binary_big_endian"]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("faces", [FACES, FACES[:1] * 2], ids=["several sizes", "squares"])
@pytest.mark.parametrize("flags", [[], ["int texnumber"]])
def test_each_triangle_of_a_face_has_its_colour(tmp_path, form, faces, flags):
    path = tmp_path / "one.ply"
    path.write_bytes(with_properties(form, faces, flags, BESIDE, lambda face: (*[7] * len(flags), *SKY[face])))
    mesh = Mesh.load(path)
    wanted = [
        (np.array([POINTS[c] for c in (f[0], f[k], f[k + 1])]), SKY[f]) for f in faces for k in range(1, len(f) - 1)
    ]
    assert len(mesh) == len(wanted)
    for corners, colors, (places, color) in zip(mesh.corners, mesh.colors, wanted, strict=True):
        np.testing.assert_array_equal(corners, places)
        np.testing.assert_allclose(colors, np.broadcast_to(np.array(color) / 255, (3, 3)), atol=1e-6)


@pytest.mark.parametrize("form", FORMS)
def test_uv_coordinates_in_lists_of_faces_go_with_the_corners(tmp_path, form):
    path = tmp_path / "one.ply"
    pairs = lambda face: (tuple(float(x) / 2 for c in face for x in POINTS[c][:2]),)  # noqa: E731
    path.write_bytes(with_properties(form, FACES, [], ["list uchar float texcoord"], pairs))
    mesh = Mesh.load(path)
    assert len(mesh) == len(FANS)
    np.testing.assert_allclose(mesh.uv, mesh.corners[..., :2] / 2, atol=1e-6)


def with_corners(form, on_corners, normals):
    """A file with colours of vertices, and uv coordinates of vertices or, where pictures end at an edge, of corners."""
    rng = np.random.default_rng(5)
    faces = np.array([(4, 1, 3), (0, 2, 4), (3, 2, 1)])
    uv = rng.random((3, 3, 2)) if on_corners else rng.random((5, 2))[faces]
    kinds = [(name, "<f4") for name in ["x", "y", "z", *(["nx", "ny", "nz"] if normals else [])]]
    kinds += [(name, "u1") for name in ("red", "green", "blue")] + ([] if on_corners else [("s", "<f4"), ("t", "<f4")])
    vertices = np.zeros(5, kinds)
    for name, kind in kinds:
        vertices[name] = rng.integers(0, 255, 5) if kind == "u1" else rng.normal(size=5)
    if not on_corners:
        vertices["s"][faces], vertices["t"][faces] = uv[..., 0], uv[..., 1]
    rows = np.zeros(3, [("n", "u1"), ("v", "<i4", 3), *([("m", "u1"), ("uv", "<f4", 6)] if on_corners else [])])
    rows["n"], rows["v"] = 3, faces
    if on_corners:
        rows["m"], rows["uv"] = 6, uv.reshape(3, 6)
    head = f"ply\nformat {form} 1.0\nelement vertex 5\n"
    head += "".join(f"property {'uchar' if kind == 'u1' else 'float'} {name}\n" for name, kind in kinds)
    head += "element face 3\nproperty list uchar int vertex_indices\n"
    head += ("property list uchar float texcoord\n" if on_corners else "") + "end_header\n"
    if form == "ascii":
        flat = [
            " ".join(str(x) for part in row for x in np.ravel(part)) for row in [*vertices.tolist(), *rows.tolist()]
        ]
        return vertices, faces, uv, head.encode() + "\n".join(flat).encode() + b"\n"
    return vertices, faces, uv, head.encode() + vertices.tobytes() + rows.tobytes()


@pytest.mark.parametrize("form", FORMS[:2])
@pytest.mark.parametrize("on_corners", [False, True])
@pytest.mark.parametrize("normals", [False, True])
def test_colours_and_normals_are_kept_beside_uv_coordinates(tmp_path, form, on_corners, normals):
    path = tmp_path / "one.ply"
    vertices, faces, uv, content = with_corners(form, on_corners, normals)
    path.write_bytes(content)
    mesh = Mesh.load(path)
    np.testing.assert_allclose(mesh.corners, np.stack([vertices[a] for a in "xyz"], axis=-1)[faces], rtol=1e-6)
    np.testing.assert_allclose(mesh.uv, uv, rtol=1e-6)
    colors = decoded(np.stack([vertices[c] for c in ("red", "green", "blue")], axis=-1) / 255)
    np.testing.assert_allclose(mesh.colors, colors[faces], rtol=1e-6)
    if normals:
        across = np.stack([vertices[n] for n in ("nx", "ny", "nz")], axis=-1)[faces]
        np.testing.assert_allclose(mesh.normals, across / np.linalg.norm(across, axis=-1, keepdims=True), atol=1e-6)


def test_a_picture_takes_the_place_of_the_colours_of_vertices(tmp_path):
    """MeshLab shows the picture alone; the colours are mostly those of the same photographs."""
    content = with_corners("ascii", True, False)[3]
    (tmp_path / "one.ply").write_bytes(content.replace(b"\nelement", b"\ncomment TextureFile a.png\nelement", 1))
    pillow.new("RGB", (1, 1), (255, 0, 0)).save(tmp_path / "a.png")
    with pytest.warns(sh.ShpyWarning, match=r"one.ply: ignored: colours of meshes with a picture \(1\)"):
        mesh = Scene.load(tmp_path / "one.ply").meshes[0]
    assert mesh.colors is None
    assert mesh.material.color.image.tolist() == [[[1, 0, 0]]]
