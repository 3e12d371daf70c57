"""Bad entries of glTF files: each costs itself alone, and its error names it, with the cause."""

import math

import numpy as np
import pytest
from gltf_files import File, png
from test_gltf_files import loaded

import shpy as sh
from raytracer import Scene, SceneError, Texture
from raytracer.meshes import pictures


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda tree: tree["nodes"][0].update(children=[0]), "node 0: it has more than one parent"),
        (lambda tree: tree["nodes"][0].update(mesh=7), "node 0: it names number 7 of its meshes, and there are 1"),
        (lambda tree: tree["nodes"][0].update(mesh=-1), "number -1 of its meshes"),
        (
            lambda tree: tree["nodes"][0].update(matrix=[0] * 16),
            "node 0: the last row of its matrix is 0 0 0 0, not 0 0 0 1",
        ),
        (
            lambda tree: tree["accessors"][0].update(count=10**9),
            "accessor 0: its 1,000,000,000 elements end at byte 12,000,000,000",
        ),
        (
            lambda tree: tree["accessors"][0].update(count=-4),
            "accessor 0: its count is -4, not a whole number from 0 on",
        ),
        (lambda tree: tree["accessors"][0].update(count=10**9, bufferView=None), "names number None"),
        (
            lambda tree: tree["bufferViews"][0].update(byteStride=1),
            "accessor 0: its elements of 12 bytes lie only 1 apart",
        ),
        (lambda tree: tree["bufferViews"][0].update(byteLength=10**9), "accessor 0: buffer view 0 ends at byte"),
        (lambda tree: tree["accessors"][2].update(componentType=5126), "accessor 2: its 6 elements end at byte 24 of"),
        (lambda tree: tree.update(extensionsRequired=["KHR_draco_mesh_compression"]), "export it without"),
        (lambda tree: tree.update(extensionsRequired=["KHR_materials_unlit"]), "KHR_materials_unlit, which is not"),
        (lambda tree: tree.update(extensionsRequired=["MSFT_lod", "A_b"]), "needs A_b, MSFT_lod, which are not read"),
        (lambda tree: tree.update(asset={"version": "1.0"}), "version of glTF is 1.0"),
        (lambda tree: tree.update(nodes=[{"mesh": 0, "children": "x"}]), "node 0: its children is x, not a list"),
        (lambda tree: tree["accessors"][0].pop("type"), "accessor 0: its type is None, none of SCALAR"),
        (
            lambda tree: tree["meshes"][0].update(primitives=[7]),
            "primitive 0 of mesh 0: its primitive is 7, not an object",
        ),
        (
            lambda tree: tree["nodes"][0].update(scale=[math.nan] * 3),
            "node 0: its scale has nan, which is not a finite number",
        ),
    ],
)
def test_what_is_wrong_is_said(tmp_path, change, words):
    file = File()
    file.node(mesh=file.mesh(file.square()))
    change(file.tree)
    path = file.save(tmp_path / "wrong.glb")
    with pytest.raises(SceneError, match=words):
        Scene.load(path, strict=True)


def test_an_accessor_of_zeros_may_not_fill_the_memory(tmp_path):
    file = File()
    zeros = file.add("accessors", {"componentType": 5126, "count": 10**9, "type": "VEC3"})
    file.node(mesh=file.mesh(file.square(attributes={"COLOR_0": zeros})))
    said = "left out: 1 primitive has colours that cannot be read (in primitive 0 of mesh 0: accessor 0: it has "
    scene = loaded(file.save(tmp_path / "zeros.glb"), f"{said}1,000,000,000 elements without bytes)")
    assert scene.meshes[0].colors is None


def test_what_costs_few_bytes_is_bounded(tmp_path, monkeypatch):
    """Zeros, pixels of one colour, and scans of a picture: all of a file together."""
    monkeypatch.setattr("raytracer.meshes.gltf._MOST_ZEROS", 200)
    file = File()
    zeros = [file.add("accessors", {"componentType": 5126, "count": 9, "type": "VEC3"}) for _ in range(2)]
    corners = file.array(np.random.default_rng(0).random((9, 3)))
    file.node(mesh=file.mesh(*({"attributes": {"POSITION": corners, "COLOR_0": k}} for k in zeros)))
    with pytest.raises(SceneError, match="primitive 1 of mesh 0: accessor 1: it has 9 elements without bytes"):
        Scene.load(file.save(tmp_path / "zeros.glb"), strict=True)
    monkeypatch.setattr(pictures, "MOST_DECODED", 1500)
    file = File()
    for value in (255, 128):
        look = {"baseColorTexture": {"index": file.picture(np.full((32, 32, 3), value))}}
        file.node(mesh=file.mesh(file.square(material=file.material(pbrMetallicRoughness=look))))
    with pytest.warns(sh.ShpyWarning, match=r"picture 1 \(all pictures have more than 1,500 pixels\)"):
        scene = Scene.load(file.save(tmp_path / "pictures.glb"))
    assert [len(mesh.material.textures) for mesh in scene.meshes[:2]] == [1, 0]
    held = png(np.full((8, 8, 3), 50), "JPEG")
    at = held.index(b"\xff\xda")
    (tmp_path / "scans.jpg").write_bytes(held[:at] + held[at:] * 101)
    with pytest.raises(SceneError, match=r"scans.jpg: it goes over its pixels more than 100 times"):
        Texture(tmp_path / "scans.jpg")
