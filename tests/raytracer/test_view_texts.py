"""The texts of a live scene: the command and the code give the picture of the page, to the bit."""

import re
import shlex

import numpy as np
import pytest
from gltf_files import File
from PIL import Image as pillow
from test_view_session import MOVING, last, opened

from raytracer.cli import main

SIZE = [20, 14]
TURNED = {"position": [1.25, 2.1, 7.5], "target": [0.1, 0.2, 0.3], "up": [0, 1, 0], "fov": 37.5, "span": 2.0}


@pytest.fixture
def files(tmp_path):
    """Return the paths of scenes: a file, one with an animation, a Python file; and of a picture of a sky."""
    (tmp_path / "wedge.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n")
    (tmp_path / "moving.py").write_text(MOVING)
    sky = np.random.default_rng(3).integers(0, 255, (4, 8, 3), np.uint8)
    pillow.fromarray(sky).save(tmp_path / "sky.png")
    file = File()
    gold = file.material(pbrMetallicRoughness={"baseColorFactor": [1, 0.8, 0.3, 1]})
    node = file.node(mesh=file.mesh(file.square(material=gold)), translation=[0, 0, 0])
    channel = {"sampler": 0, "target": {"node": node, "path": "translation"}}
    steps = {"input": file.array([0, 2]), "output": file.array([[0, 0, 0], [1, 0, 0]]), "interpolation": "LINEAR"}
    file.add("animations", {"name": "go", "channels": [channel], "samplers": [steps]})
    (tmp_path / "slide.glb").write_bytes(file.glb())
    return tmp_path


CASES = {
    "glass --bounces 8 --samples 4": {},
    "boxes --samples 9": {"scene": {"camera": TURNED}, "params": {"exposure": [0.7]}},
    "mixed --samples 1 --bounces 1 --camera 1,2,8 --background 0.1,0.2,0.4 --exposure -1": {},
    "boxes --samples 4 --fov 33 --integrator path --bounces 3 --environment sky.png": {"scene": {"camera": TURNED}},
    "boxes --samples 1 --environment sky.png --integrator path": {"params": {"light.0.color": [0.25, 0.5, 1.0]}},
    "boxes --samples 1 --environment sky.png --rotation 30": {"scene": {"camera": TURNED}},
    "boxes --samples 1": {"scene": {"integrator": "path"}, "edit": "color", "stop": 2},
    "wedge.obj --samples 1 --no-floor --strict": {"scene": {"camera": TURNED}, "edit": "color"},
    "wedge.obj --samples 4 --up z --target 0.3,0.1,0.2": {"params": {"exposure": [0.3]}},
    "slide.glb --samples 1 --clip go --multiscatter": {"time": 0.75},
    "slide.glb --samples 1 --no-floor": {"time": 1.3, "scene": {"camera": TURNED}},
    "moving.py --samples 4 --seconds 3": {"time": 0.125, "edit": "color"},
    "boxes --samples 1 --background sky.png --accel ldc:16": {},
    "boxes --samples 1 --tracer staged --accel brute": {"scene": {"camera": TURNED}},
    "animated --samples 1 --bounces 2": {"time": 0.5, "scene": {"camera": TURNED}},
}


@pytest.mark.sampled(18)
@pytest.mark.parametrize("words", CASES)
def test_the_command_and_the_code_give_the_picture_of_the_page(files, monkeypatch, words):
    monkeypatch.chdir(files)
    changes = dict(CASES[words])
    changes.pop("stop", None)
    session = opened(*shlex.split(words), "--backend", "numpy")
    edited = changes.pop("edit", None)
    if edited:
        label = session.edits.labels[0]
        changes["params"] = {**changes.get("params", {}), f"material.{label}.{edited}": [0.2, 0.9, 0.1]}
    if "integrator" in changes.get("scene", {}):
        session._integrators["path"] = session._integrators["path"].__class__(samples=2)
    assert session.set({"size": SIZE, **changes}) == []
    shown = last(session)[1][..., :3]
    texts = session.answer({"about": "camera"})[0]
    exec(texts["picture"], {})
    assert np.array_equal(np.asarray(pillow.open("picture.png"))[..., :3], shown), texts["picture"]
    changed = edited or any(name.startswith("light") for name in changes.get("params", {}))
    assert ("the code has them" in texts["note"]) == bool(changed)
    if not changed:
        assert main(shlex.split(texts["command"])[1:] + ["-o", "page.png"]) == 0
        assert np.array_equal(np.asarray(pillow.open("page.png"))[..., :3], shown), texts["command"]


def test_a_scene_that_stands_still_has_no_time(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main(["render", "boxes", "--time", "1", "--backend", "numpy", "--size", "4x3"]) == 1
    assert "--time is for scenes that move, and boxes stands still: leave it out" in capsys.readouterr().err
    assert main(["render", "animated", "--backend", "numpy", "--size", "4x3"]) == 1
    assert "animated is a function of the time: --time 0, say, chooses a moment" in capsys.readouterr().err


def test_numbers_are_written_with_all_their_digits(files, monkeypatch):
    monkeypatch.chdir(files)
    session = opened("boxes", "--backend", "numpy")
    place = [1 / 3, 0.1 + 0.2, 7.0]
    session.set({"size": SIZE, "scene": {"camera": {**TURNED, "position": place}}})
    found = re.search(r"--camera (\S+)", session.answer({"about": "camera"})[0]["command"])[1]
    assert [float(number) for number in found.split(",")] == place
