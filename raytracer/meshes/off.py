"""OFF files as meshes: their shapes alone.

Stage: scene description. Vertices and faces are numbered from 0, as faces number vertices.

    mesh = read_off(data, "cube", notices)
"""

from __future__ import annotations

import re

import numpy as np

from raytracer.errors import SceneError
from raytracer.meshes.folder import Notices, shown
from raytracer.meshes.lines import line_begins, name_of, numbers_in, plain, word_begins
from raytracer.meshes.mesh import Mesh
from raytracer.meshes.ply_elements import Element, Property, of_lines
from raytracer.meshes.polygons import leave_out_broken, triangles_of

_FACE = Property("corners", "i4", "u4")


def read_off(data: bytes, name: str, notices: Notices) -> Mesh:
    """Return the triangles of a file; SceneError without a header, and for fewer lines than it declares."""
    text = re.sub(rb"#[^\n]*", b"", plain(data)) + b"\n"
    head = re.match(rb"\s*((?:ST)?C?N?)OFF\b[ \t]*\n?\s*([^\n]*)\n", text)
    words = head[2].split() if head else []
    if head is None or len(words) < 2 or not all(word.isdigit() and len(word) < 19 for word in words[:2]):
        ending = f", not {shown(name_of(head[2]))!r}" if head and words else ""
        raise SceneError(f"it has no header: OFF, and then the numbers of its vertices and faces{ending}")
    vertices, faces = int(words[0]), int(words[1])
    body = np.frombuffer(text[head.end() :] + b"\n", np.uint8)
    begins = line_begins(body)
    begins = begins[np.add.reduceat(word_begins(body), begins, dtype=np.int64) > 0]
    if len(begins) < vertices + faces:
        raise SceneError(f"it declares {vertices:,} vertices and {faces:,} faces, and {len(begins):,} lines follow")
    for letter, what in ((b"C", "colours"), (b"N", "normals"), (b"ST", "uv coordinates")):
        if letter in head[1]:
            notices.ignore(f"{what} of vertices", vertices)
    middle, end = (int(begins[k]) if k < len(begins) else len(body) for k in (vertices, vertices + faces))
    if not vertices or not faces:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64), name=name)
    places = numbers_in(body[begins[0] : middle], begins[:vertices] - begins[0]).rows(3)
    numbers = numbers_in(body[middle:end], begins[vertices : vertices + faces] - middle)
    ends = np.cumsum(numbers.counts)
    columns, short = of_lines(Element("face", faces, [_FACE]), numbers.values, ends - numbers.counts, ends)
    corners = columns["corners"]
    notices.ignore("colours of faces", int((numbers.counts > 1 + corners.sizes).sum() - len(short)))
    broken = leave_out_broken(places, notices)
    triangulation = triangles_of(places, broken, corners.values, corners.sizes, short, notices)
    used, triangles = np.unique(triangulation.vertices, return_inverse=True)
    return Mesh(places[used], triangles.reshape(-1, 3), name=name)
