"""Binary PLY files whose faces have several numbers of corners."""

import struct

import numpy as np
import pytest

from raytracer import Mesh, SceneError

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
