"""The names by which mesh files name other files: URIs with bytes, and spellings of files in their folder."""

import base64
import json

import numpy as np
import pytest
from gltf_files import File, png

from raytracer import Scene, SceneError
from raytracer.meshes.folder import Folder

RED = png([[[255, 0, 0]]])


def painted(tmp_path, uri):
    """Load a square whose picture has this URI; return its picture."""
    file = File()
    texture = file.add("textures", {"source": file.add("images", {"uri": uri})})
    look = {"baseColorTexture": {"index": texture}}
    file.node(mesh=file.mesh(file.square(material=file.material(pbrMetallicRoughness=look))))
    return Scene.load(file.save(tmp_path / "square.glb"), strict=True).meshes[0].material.base_color


@pytest.mark.parametrize("head", ["data:image/png;base64,", "DATA:image/png;base64,", "Data:image/png;BASE64,"])
@pytest.mark.parametrize("pad", [True, False])
def test_bytes_in_a_uri(tmp_path, head, pad):
    for extra in range(3):  # as many bytes as leave every kind of padding
        text = base64.b64encode(RED + bytes(extra)).decode()
        assert painted(tmp_path, head + (text if pad else text.rstrip("="))).image[0, 0].tolist() == [1, 0, 0]


def test_bytes_in_a_uri_of_other_forms(tmp_path):
    text = base64.b64encode(RED).decode()
    split = "\n ".join(text[k : k + 20] for k in range(0, len(text), 20))
    for uri in (
        f"data:;base64,{text.replace('+', '%2B').replace('/', '%2F').replace('=', '%3D')}",
        f"data:image/png;base64,{split}",
        "data:image/png," + "".join(f"%{byte:02X}" for byte in RED),
    ):
        assert painted(tmp_path, uri).image[0, 0].tolist() == [1, 0, 0]


@pytest.mark.parametrize(
    ("uri", "words"),
    [
        ("data:image/png;base64", r"its data URI has no comma before the bytes$"),
        ("data:;base64,abcde", r"the base64 of its data URI is wrong: "),
        ("data:;base64,ab*d", r"the base64 of its data URI is wrong: "),
        (7, r"its uri is 7, not a text$"),
    ],
)
def test_uris_that_hold_no_bytes(tmp_path, uri, words):
    with pytest.raises(SceneError, match=rf"square\.glb: .*: {words}"):
        painted(tmp_path, uri)


def test_a_buffer_of_a_gltf_file_without_padding(tmp_path):
    file = File()
    file.node(mesh=file.mesh(file.square()))
    tree = json.loads(file.gltf())
    tree["buffers"][0]["uri"] = "DATA:application/octet-stream;base64," + base64.b64encode(file.binary).decode().strip(
        "="
    )
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    np.testing.assert_allclose(np.ptp(Scene.load(tmp_path / "a.gltf").meshes[0].corners, axis=(0, 1)), [2, 2, 0])
    tree["buffers"][0]["uri"] = "data:;base64,###"
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    with pytest.raises(
        SceneError, match=r"primitive 0 of mesh 0: accessor 0: buffer 0: the base64 of its data URI is wr"
    ):
        Scene.load(tmp_path / "a.gltf", strict=True)


@pytest.mark.parametrize(
    ("there", "named"),
    [
        ("red.png", "red.png"),
        (" red.png", " red.png"),
        (" red.png", "%20red.png"),
        ("red.png", " red.png "),
        ("red.png", "red.png?v=3"),
        ("red.png", "red.png#main"),
        ("red.png?v=3", "red.png?v=3"),
        ("Red.PNG", "red.png"),
        ("Maps/Red.PNG", "maps\\red.png"),
        ("red%20one.png", "red%20one.png"),
        ("red one.png", "red%20one.png"),
        ("rouge\u0301.png", "rouge%CC%81.png"),
        ("red.png", "C:\\work\\Red.png"),
        ("red.png", "https://somewhere.org/maps/red.png?v=3"),
    ],
)
def test_spellings_of_a_name(tmp_path, there, named):
    path = tmp_path / there
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(RED)
    assert painted(tmp_path, named).image[0, 0].tolist() == [1, 0, 0]


def test_a_name_is_that_of_one_file(tmp_path):
    for name, pixels in (("red.png", (255, 0, 0)), ("RED.png", (0, 0, 255)), ("red.png?v=3", (0, 255, 0))):
        (tmp_path / name).write_bytes(png([[pixels]]))
    assert painted(tmp_path, "red.png").image[0, 0].tolist() == [1, 0, 0]
    assert painted(tmp_path, "RED.png").image[0, 0].tolist() == [0, 0, 1]
    assert painted(tmp_path, "red.png?v=3").image[0, 0].tolist() == [0, 1, 0]
    with pytest.raises(SceneError, match=r"Red\.png: there is no such file"):
        painted(tmp_path, "Red.png")


def test_other_capitals_lead_nowhere_else(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "Red.png").write_bytes(RED)
    (inner / "Link").symlink_to(tmp_path)
    folder = Folder(inner / "a.glb")
    for name in ("../red.png", "link/Red.png", "link/red.png", "inner/../red.png"):
        with pytest.raises(SceneError, match=r"no such file|outside"):
            folder.find(name)
