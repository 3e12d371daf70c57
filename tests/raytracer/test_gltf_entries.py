"""Bad entries of glTF files: each costs itself alone, and its error names it, with the cause."""

import math
import warnings

import numpy as np
import pytest
from gltf_files import File, png
from test_gltf_animation import animated
from test_gltf_files import loaded

import shpy as sh
from raytracer import Mesh, Scene, SceneError, Texture
from raytracer.meshes import pictures
from raytracer.scene.animated_file import AnimatedFile


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
        (
            lambda tree: tree.update(extensionsRequired=["KHR_materials_iridescence"]),
            "KHR_materials_iridescence, which is not",
        ),
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


def test_the_scenes_that_are_not_shown_are_told(tmp_path):
    file = File()
    file.node(mesh=file.mesh(file.square(uv=False)))
    other = file.node(False, mesh=0, translation=[9, 0, 0])
    file.add("scenes", {"nodes": [other]})
    for default, place, said in ((0, 0, "scenes but the default one (1)"), (1, 9, "scenes but the default one (1)")):
        file.tree["scene"] = default
        scene = loaded(file.save(tmp_path / "two.glb"), f"ignored: {said}")
        assert scene.meshes[0].vertices[:, 0].mean() == place
    del file.tree["scene"]
    scene = loaded(file.save(tmp_path / "two.glb"), "ignored: scenes after the first (1)")
    assert scene.meshes[0].vertices[:, 0].mean() == 0
    file.tree["scene"] = 7
    said = "left out: 1 scene cannot be shown (in scene 7: it names number 7 of its scenes, and there are 2)"
    assert loaded(file.save(tmp_path / "two.glb"), said, "ignored: scenes but the default one (1)").triangles


@pytest.mark.parametrize("name", ["KHR_materials_dispersion", "KHR_materials_iridescence"])
def test_extensions_of_the_look_of_materials_refuse_no_file(tmp_path, name):
    file = File()
    material = file.material(extensions={name: {}}, pbrMetallicRoughness={"baseColorFactor": [1, 0.5, 0, 1]})
    file.node(mesh=file.mesh(file.square(uv=False, material=material, extensions={name: {"mappings": []}})))
    file.tree["extensionsUsed"] = file.tree["extensionsRequired"] = [name]
    path = file.save(tmp_path / "look.glb")
    assert loaded(path, f"ignored: {name} (1)").meshes[0].material.base_color == (1, 0.5, 0)
    with pytest.raises(SceneError, match=f"it needs {name}, which is not read: export it without"):
        Scene.load(path, strict=True)


def test_positions_without_bytes_have_no_false_cause(tmp_path):
    file = File()
    square = file.square(uv=False)
    del file.tree["accessors"][square["attributes"]["POSITION"]]["bufferView"]
    file.node(mesh=file.mesh(square | {"extensions": {"KHR_materials_variants": {"mappings": []}}}))
    file.node(mesh=file.mesh(file.square(uv=False)))
    said = "left out: 1 primitive cannot be read (in primitive 0 of mesh 0: its positions have no bytes)"
    assert len(loaded(file.save(tmp_path / "bare.glb"), said).meshes) == 2


@pytest.mark.parametrize("place", ["primitive", "view"])
def test_compressed_positions_name_their_extension(tmp_path, place):
    """KHR_draco_mesh_compression stands in the primitive, EXT_meshopt_compression in the view of a buffer."""
    file = File()
    square = file.square(uv=False)
    accessor = file.tree["accessors"][square["attributes"]["POSITION"]]
    name = "KHR_draco_mesh_compression" if place == "primitive" else "EXT_meshopt_compression"
    if place == "primitive":
        del accessor["bufferView"]
        square["extensions"] = {name: {}}
    else:
        file.tree["bufferViews"][accessor["bufferView"]] |= {"buffer": 7, "extensions": {name: {}}}
    file.node(mesh=file.mesh(square))
    with pytest.raises(SceneError, match=f"its positions are in {name}, which is not read: export it without"):
        Scene.load(file.save(tmp_path / "small.glb"))


def test_meshes_without_normals_are_flat(tmp_path):
    """Section 3.7.2.1. A roof whose two sides meet at a small angle was smoothed."""
    file = File()
    roof = file.array([[-1, 0, 0], [0, 0.1, 0], [1, 0, 0], [-1, 0, 1], [0, 0.1, 1], [1, 0, 1]])
    sides = file.array([0, 3, 1, 1, 3, 4, 1, 4, 2, 2, 4, 5], "u2")
    file.node(mesh=file.mesh({"attributes": {"POSITION": roof}, "indices": sides}))
    path = file.save(tmp_path / "roof.glb")
    (mesh, _) = loaded(path).meshes
    assert mesh.normals is None
    assert Mesh.load(path).normals is None
    np.testing.assert_allclose(mesh.face_normals[0], np.array([-0.1, 1, 0]) / np.hypot(0.1, 1), atol=1e-9)


def test_bad_entries_of_an_animated_file_are_counted_once(tmp_path):
    file = File()
    node = file.node(mesh=file.mesh(file.square(uv=False), {"attributes": {}}))
    file.node(mesh=99)
    animated(file, (node, "translation", [0, 1], [[0, 0, 0], [0, 1, 0]], "LINEAR"))
    make = AnimatedFile(file.save(tmp_path / "some.glb")).make(4, 4)
    said = (
        "left out: 1 primitive cannot be read .in primitive 1 of mesh 0: .*, 1 node cannot be read .in node 1: it names"
    )
    with pytest.warns(sh.ShpyWarning, match=said):
        make(0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert make(0.5).triangles == make(0.0).triangles
    with pytest.raises(SceneError, match=r"some\.glb: primitive 1 of mesh 0: it has no POSITION"):
        AnimatedFile(tmp_path / "some.glb", strict=True).make(4, 4)(0.0)
