"""Mesh files that somebody broke: each gives a scene or one clear error, in bounds of time and memory."""

import copy
import json
import math
import os
import re
import resource
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from gltf_files import png, shining, textured
from ply_files import PLY

from raytracer import Scene, SceneError, render
from raytracer.meshes.shapes import icosahedron
from raytracer.scene.loading import FORMATS
from shpy import ShpyWarning

SELF = "SELF"
"""In the name of a file: its number."""

OBJ = """mtllib none.mtl
v 0 0 0 1 0 0
v 1 0 0 0 1 0
v 1 1 0 0 0 1
v 0 1 0.5 1 1 1
vt 0 0
vn 0 0 1
g part
usemtl red
f 1/1/1 2/1/1 3/1/1
f 1//1 3//1 4//1
f -4 -2 -1
"""
TEXTURED = """mtllib paint.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0.5
vt 0 0
vt 1 0
vt 1 1
o part
usemtl red
f 1/1 2/2 3/3
f 1/1 3/2 4/3
"""
MTL = """newmtl red
Kd 1 0.5 0.5
Ks 0.1 0.2 0.3
Ns 20
illum 3
d 0.5
Ke 1 0 0
map_Kd -s 1 1 1 -clamp on paint.png
map_d paint.png
"""
WORDS = [
    *(b"0", b"-1", b"nan", b"inf", b"1e38", b"3e38", b"1e-40", b"999999999", b"-9999999999999999999"),
    *(b"\xe9", b"\t", b" ", b"\n", b"\xff\xfe", b"\x00", b"f 1 1 1\n", b"v 1 2\n", b"list"),
    *(b"element face 1000000000\n", b'"count":99999999,', b"null", b"[]", b'"matrix":[' + b"0," * 15 + b"0],"),
    *(b"map_Kd ../x.png\n", b"map_Kd -s", b"newmtl red\n", b"Kd -1", b"Ns 1e40\n", b'"uri":"../x",', b'"index":9'),
    *(b'"children":[0],', b'"mesh":0,', b'"sparse":{},', b'"normalized":true,', b'"byteStride":1,', b'"scene":5,'),
    *(
        b"illum 7\nNi 0\n",
        b"map_Ke paint.png\n",
        b"Tf 1 0.5\n",
        b"d -halo",
        b'"alphaCutoff":0,',
        b'"ior":-1,',
        b"1e400",
    ),
    *(b"TextureFile /dev/zero\n", b"\xff\xff\xff\xff", b"IHDR\x00\x00\xff\xff\x00\x00\xff\xff", b"true", b'"\\ud800"'),
]


def originals():
    """(contents by name, the name of the file to load) of files that can be read, the first of a name as SELF."""
    import trimesh

    mesh = icosahedron()
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    made.vertex_normals = mesh.vertices
    found = [("obj", OBJ.encode()), ("stl", made.export(file_type="stl_ascii").encode())]
    found += [("ply", made.export(file_type="ply", encoding=encoding)) for encoding in ("ascii", "binary")]
    found += [(kind, made.export(file_type=kind)) for kind in ("stl", "glb", "off")]
    alone = [{f"{SELF}.{kind}": data.encode() if isinstance(data, str) else bytes(data)} for kind, data in found]
    rng = np.random.default_rng(0)
    pixels = np.kron(rng.integers(0, 256, (3, 4, 3)), np.ones((4, 4, 1)))
    alone += [{f"{SELF}.glb": file.glb()} for file in (textured(), shining())]
    alone += [{f"{SELF}.gltf": file.gltf()} for file in (textured(), shining())]
    painted = [
        {f"{SELF}.obj": TEXTURED.encode(), "paint.mtl": MTL.encode(), "paint.png": png(pixels, format)}
        for format in ("PNG", "JPEG", "GIF", "TIFF", "TGA", "WEBP", "BMP")
    ]
    return [*alone, *painted, {f"{SELF}.ply": PLY.encode(), "paint.png": png(pixels)}]


def mutated(data, rng):
    """The bytes with one or two changes: cut, bits turned, parts doubled, dropped or put in, words put in."""
    for _ in range(rng.integers(1, 3)):
        at = int(rng.integers(0, len(data) + 1))
        length = int(rng.integers(1, 3 + len(data) // rng.choice([8, 100])))
        kind = rng.integers(6)
        if kind == 0:
            data = data[:at]
        elif kind == 1 and at < len(data):
            data = data[:at] + bytes([data[at] ^ 1 << int(rng.integers(8))]) + data[at + 1 :]
        elif kind == 2:
            data = data[:at] + data[at : at + length] * 2 + data[at + length :]
        elif kind == 3:
            data = data[:at] + data[at + length :]
        elif kind == 4:
            data = data[:at] + rng.bytes(min(length, 8)) + data[at + 8 :]
        else:
            data = data[:at] + WORDS[rng.integers(len(WORDS))] + data[at + int(rng.integers(0, 8)) :]
    return data


VALUES = [
    *(0, -1, 1, 2, 7, 2**31, 2**63, 10**30, 0.5, -0.5, 1e-40, 1e38, 1e308, math.nan, math.inf, None, True, False),
    *("", "x", "MASK", "BLEND", "../x.png", "data:;base64,AAAA", [], {}, [0], [1] * 16, [0, 0, 0, 1], {"index": 0}),
]


def regrown(data, rng):
    """A GLB or glTF file whose JSON has one or two other values, or values in other places."""
    binary = data.startswith(b"glTF")
    length = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20 : 20 + length] if binary else data)
    for _ in range(rng.integers(1, 3)):
        places = list(places_of(tree))
        parent, key = places[rng.integers(len(places))]
        other, from_there = places[rng.integers(len(places))]
        kind = rng.integers(4)
        if kind == 0:
            parent[key] = VALUES[rng.integers(len(VALUES))]
        elif kind == 1:
            parent[key] = copy.deepcopy(other[from_there])
        elif kind == 2:
            del parent[key]
        elif isinstance(parent, list):
            parent.append(copy.deepcopy(parent[key]))
        else:
            parent[key] = [parent[key]]
    text = json.dumps(tree).encode()
    if not binary:
        return text
    chunks = len(text).to_bytes(4, "little") + b"JSON" + text + data[20 + length :]
    return data[:8] + (12 + len(chunks)).to_bytes(4, "little") + chunks


def places_of(value):
    """The parent and the key of each value in a tree."""
    for key in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield value, key
        yield from places_of(value[key])


RAW = re.compile(
    "NoneType|not supported|has no attribute|object is|unhashable|reshape|broadcast|stride|subscript|argument"
    "|could not convert|unpack|unexpected|local variable|invalid literal|out of bounds|recursion|codec|mapping"
    "|iterable|operand"
)
"""Words of Python and numpy that are no cause of a fault in a file."""


MOST_SAID = 240
"""Characters of an error beside the path of its file: 200 of what the file or a reader says, and a sentence of ours."""


def survive(folder, first, count, renders=0):
    """Load files number `first` to `first + count`; gives how many were scenes, of which every `renders`th is rendered.

    Raises for any other error, and for warnings that are not ours. A file that takes 10 s of processor time ends the
    process.
    """
    kinds, scenes = originals(), 0
    for number in range(first, first + count):
        rng = np.random.default_rng(number)
        files = dict(kinds[number % len(kinds)])
        names = list(files)
        broken = names[rng.integers(len(names))]
        has_tree = Path(broken).suffix in (".glb", ".gltf") and rng.integers(2)
        files[broken] = (regrown if has_tree else mutated)(files[broken], rng)
        for name, data in files.items():
            (Path(folder) / name.replace(SELF, f"file{number}")).write_bytes(data)
        path = Path(folder) / names[0].replace(SELF, f"file{number}")
        signal.setitimer(signal.ITIMER_PROF, 10)
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                scene = Scene.load(path)
        except SceneError as error:
            said = [str(error)]
        else:
            said = [path.stem]
            assert np.all(np.isfinite(scene.bounds))
            scenes += 1
            if renders and scenes % renders == 0:
                assert np.all(np.isfinite(render(scene, (6, 4), backend="numpy", bounces=1).pixels))
        signal.setitimer(signal.ITIMER_PROF, 0)
        assert {w.category for w in caught} <= {ShpyWarning}, caught[0]
        if path.suffix in (".glb", ".gltf"):
            assert not RAW.search(" ".join([*said, *(str(w.message) for w in caught)])), said
        for text in [*said, *(str(w.message) for w in caught)]:
            assert path.stem in text, text
            assert text.isprintable(), repr(text)
        assert len(said[0].replace(str(path), "")) < MOST_SAID
        path.unlink()
    return scenes


def test_a_broken_file_gives_a_scene_or_one_error(tmp_path):
    assert 20 < survive(tmp_path, 0, 170) < 160


LONG = b"x" * 300
FAULTY = {
    "obj": [
        *(b"%s%d 1 2\n" % (LONG, k) for k in range(30)),
        *(b"f 1 2 3\nv nan 0 0\nvt nan\nvn 0 0 x\nf 1 2\n", b"f 1 2 %s\n" % LONG, b"l 1 2\np 1\ncurv 0 1 1 2\n"),
        *(b"mtllib %s.mtl\no %s\nusemtl %s\n" % (LONG, LONG, LONG), b"f -9 -9 -9/7\n"),
    ],
    "ply": [
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n",
        *(b"property float %s%d\n" % (LONG, k) for k in range(30)),
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 nan" + b" 0" * 30 + b"\n3 0 0 9\n",
    ],
    "off": [b"OFF\n1 3 0\n0 nan 0\n3 0 0 0\n2 0 0\n", b"3 0 0 %s\n" % LONG],
    "stl": [b"solid %s\n" % LONG, b"facet normal 0 0 1\nouter loop\nvertex 0 0 %s\nendloop\nendfacet\n" % LONG],
}
"""Parts of files without a triangle, most of whose words are long."""


@pytest.mark.parametrize("kind", FAULTY)
@pytest.mark.parametrize("strict", [False, True])
def test_an_error_is_short_whatever_a_file_says(tmp_path, kind, strict):
    """Files of any choice of faulty parts: their causes are many, and their words are long."""
    parts, rng = FAULTY[kind], np.random.default_rng(len(kind))
    for number in range(20):
        kept = rng.random(len(parts)) < (0.8 if number else 2)
        path = tmp_path / f"file{number}.{kind}"
        path.write_bytes(b"".join(part for part, keep in zip(parts, kept, strict=True) if keep))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ShpyWarning)
            with pytest.raises(SceneError) as error:
                Scene.load(path, strict=strict)
        said = str(error.value).replace(str(path), "")
        assert len(said) < MOST_SAID, said
        assert said.isprintable(), said


@pytest.mark.slow
def test_ten_thousand_broken_files_in_bounds_of_time_and_memory(tmp_path):
    """In a process of its own that may take 2 GiB of memory: each file takes less than 10 s."""
    code = f"from test_mesh_mutations import survive; print(survive({str(tmp_path)!r}, 1000, 10_000, renders=100))"

    def bounded():
        resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))

    places = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": places},
        preexec_fn=bounded,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout) > 1000


def test_every_format_is_mutated():
    assert {Path(name).suffix for files in originals() for name in files} == set(FORMATS) | {".mtl", ".png"}
