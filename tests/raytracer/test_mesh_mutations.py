"""Mesh files that somebody broke: each gives a scene or one clear error, in bounds of time and memory."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from raytracer import Scene, SceneError
from raytracer.meshes.loading import FORMATS
from raytracer.meshes.shapes import icosahedron

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
WORDS = [
    *(b"0", b"-1", b"nan", b"inf", b"1e38", b"3e38", b"1e-40", b"999999999", b"-9999999999999999999"),
    *(b"\xe9", b"\t", b" ", b"\n", b"\xff\xfe", b"\x00", b"f 1 1 1\n", b"v 1 2\n", b"list"),
    *(b"element face 1000000000\n", b'"count":99999999,', b"null", b"[]", b'"matrix":[' + b"0," * 15 + b"0],"),
]


def originals():
    """(ending, contents) of files that can be read."""
    import trimesh

    mesh = icosahedron()
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    made.vertex_normals = mesh.vertices
    found = [("obj", OBJ.encode()), ("stl", made.export(file_type="stl_ascii").encode())]
    found += [("ply", made.export(file_type="ply", encoding=encoding)) for encoding in ("ascii", "binary")]
    found += [(kind, made.export(file_type=kind)) for kind in ("stl", "glb", "off")]
    return [(kind, data.encode() if isinstance(data, str) else bytes(data)) for kind, data in found]


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


def survive(folder, first, count):
    """Load files number `first` to `first + count`; gives how many were scenes. Raises for any other error."""
    kinds, scenes = originals(), 0
    for number in range(first, first + count):
        rng = np.random.default_rng(number)
        kind, data = kinds[number % len(kinds)]
        path = Path(folder) / f"file{number}.{kind}"
        path.write_bytes(mutated(data, rng))
        try:
            scene = Scene.load(path)
        except SceneError as error:
            said = str(error)
        else:
            said = path.stem
            assert np.all(np.isfinite(scene.bounds))
            scenes += 1
        assert path.stem in said
        assert "\n" not in said
        assert len(said) < 400
        path.unlink()
    return scenes


def test_a_broken_file_gives_a_scene_or_one_error(tmp_path):
    assert 10 < survive(tmp_path, 0, 105) < 95


@pytest.mark.slow
def test_two_thousand_broken_files_in_bounds_of_time_and_memory(tmp_path):
    """In a process of its own that may take 3 GiB and 600 s of processor time."""
    code = f"from test_mesh_mutations import survive; print(survive({str(tmp_path)!r}, 1000, 2000))"

    def bounded():
        resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
        resource.setrlimit(resource.RLIMIT_CPU, (600, 600))

    places = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": places},
        preexec_fn=bounded,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout) > 100


def test_every_format_is_mutated():
    assert {f".{kind}" for kind, _ in originals()} == set(FORMATS) - {".gltf"}
