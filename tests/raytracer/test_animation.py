"""Animations: their frames are the pictures of the scenes, and mistakes are found before a frame is made."""

import dataclasses
import os
import pickle
import stat
import sys

import numpy as np
import pytest
from PIL import Image as pillow

from raytracer import Camera, Material, PointLight, Renderer, Scene, SceneError, animation, cli, render
from raytracer.animation import ANIMATIONS, animate, animated, made_by
from raytracer.meshes.shapes import box

FILE = """
import numpy as np
from raytracer import Camera, Mesh, PointLight, Scene

def scene(time):
    triangle = Mesh([[0, time, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    return Scene(triangle, [PointLight((0, 0, 5))], Camera((0, 0, 4), (0, 0, 0)))
"""
SMALL = ["--size", "24x16", "--backend", "numpy"]


def test_frames_are_the_pictures_of_their_scenes(tmp_path):
    folder = tmp_path / "frames"
    assert list(animate(animated, folder, 3, fps=5, size=(32, 24), backend="numpy")) == [1, 2, 3]
    assert sorted(os.listdir(folder)) == ["0000.png", "0001.png", "0002.png"]
    for number in range(3):
        expected = render(animated(number / 5), (32, 24), backend="numpy").srgb
        assert np.array_equal(np.asarray(pillow.open(folder / f"{number:04}.png")), expected)


@pytest.mark.slow
def test_another_scene_is_followed_or_built_anew():
    renderer = Renderer(animated(0), backend="numpy")
    scenes = [animated(0.1), animated(0.2)]
    lit = dataclasses.replace(scenes[1], lights=[PointLight(np.array([1, 9, 3]))], background=np.zeros(3))
    red = dataclasses.replace(lit, meshes=[lit.meshes[0].with_material(Material((1, 0, 0))), *lit.meshes[1:]])
    shown = [*scenes, lit, red, animated(0.3), dataclasses.replace(red, meshes=red.meshes[:2]), animated(0)]
    for scene, builds in zip(shown, [2, 2, 3, 4, 5, 6, 7], strict=True):
        renderer.show(scene)
        image, expected = renderer.render((32, 24)), render(scene, (32, 24), backend="numpy")
        assert np.array_equal(image.pixels, expected.pixels)
        assert np.array_equal(image.object_id, expected.object_id)
        assert renderer.builds == builds


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("ending", "duration"), [("gif", 330), ("webp", 333)])
def test_files_play_at_their_pace(tmp_path, ending, duration):
    source, path = tmp_path / "wave.py", tmp_path / f"wave.{ending}"
    source.write_text(FILE)
    assert cli.main(["animate", str(source), "-o", str(path), "--frames", "4", "--fps", "3", *SMALL]) == 0
    with pillow.open(path) as found:
        assert (found.n_frames, found.size, found.info["loop"]) == (4, (24, 16), 0)
        found.load()
        assert found.info["duration"] == duration
    assert sorted(os.listdir(tmp_path)) == sorted([path.name, "wave.py"])


def test_a_folder_is_resumed(tmp_path, monkeypatch):
    folder = tmp_path / "frames"
    assert cli.main(["animate", "animated", "-o", str(folder), "--frames", "3", *SMALL]) == 0
    before = [(folder / f"000{k}.png").read_bytes() for k in range(3)]
    (folder / "0001.png").unlink()
    times = []
    monkeypatch.setitem(animation.ANIMATIONS, "animated", lambda time: times.append(time) or animated(time))
    assert cli.main(["animate", "animated", "-o", str(folder), "--frames", "3", "--resume", *SMALL]) == 0
    assert times == [1 / 24]
    assert [(folder / f"000{k}.png").read_bytes() for k in range(3)] == before


def test_a_frame_that_ends_too_early_is_drawn_again(tmp_path):
    folder = tmp_path / "frames"
    given = {"size": (16, 12), "backend": "numpy"}
    assert list(animate(animated, folder, 2, **given)) == [1, 2]
    whole = (folder / "0001.png").read_bytes()
    (folder / "0001.png").write_bytes(whole[: len(whole) // 2])
    assert list(animate(animated, folder, 2, resume=True, **given)) == [1, 2]
    assert (folder / "0001.png").read_bytes() == whole


def test_ffmpeg_is_given_every_frame(tmp_path, monkeypatch):
    tool = tmp_path / "ffmpeg"
    tool.write_text('#!/bin/sh\nfor last; do :; done\ncat > "$last"\n')
    tool.chmod(tool.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setattr("shutil.which", lambda name: str(tool))
    path = tmp_path / "wave.mp4"
    assert list(animate(animated, path, 2, size=(16, 12), backend="numpy")) == [1, 2]
    assert path.stat().st_size == 2 * 16 * 12 * 3
    with pytest.raises(SceneError, match="even width"):
        animate(animated, path, 2, size=(15, 12))
    tool.write_text("#!/bin/sh\ncat > /dev/null\necho no such codec >&2\nexit 3\n")
    with pytest.raises(SceneError, match="ffmpeg failed: no such codec"):
        list(animate(animated, tmp_path / "other.mp4", 2, size=(16, 12), backend="numpy"))
    assert not (tmp_path / "other.mp4").exists()


def test_mistakes_are_found_before_a_frame_is_made(tmp_path, monkeypatch):
    def never(time):
        raise AssertionError("a scene was made")

    monkeypatch.setattr("shutil.which", lambda name: None)
    for output, changes, what in [
        ("a.mp4", {}, "ffmpeg, which is not installed"),
        ("a.avi", {}, "not as .avi"),
        ("a.gif", {"frames": 0}, "one frame or more"),
        ("a.gif", {"fps": 0}, "more than 0"),
        ("a.gif", {"size": (0, 4)}, "from 1 to"),
        ("a.gif", {"resume": True}, "in a folder"),
    ]:
        with pytest.raises(SceneError, match=what):
            animate(never, tmp_path / output, **({"frames": 2} | changes))
    with pytest.raises(OSError, match=r"folder|directory"):
        animate(never, tmp_path / "none" / "a.gif", 2)
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("x = 1", "defines no function scene"),
        ("import numpy\n1 / 0", "wave.py:2: ZeroDivisionError"),
        ("def scene(time)\n", "wave.py:1: SyntaxError"),
        ("def scene(time):\n    return 1 / time", "wave.py:2: ZeroDivisionError"),
        ("def scene():\n    return 3", "wave.py: TypeError: scene() takes 0 positional arguments but 1 was given"),
        ("def scene(time, more):\n    return 1", "wave.py: TypeError: scene() missing 1 required"),
        (
            "from raytracer import *\nfrom raytracer.meshes.shapes import box\n"
            "red = Material(surface=lambda hit: hit.colour)\ndef scene(time):\n    return Scene(box(material=red))",
            "wave.py:3: AttributeError: this Hit has no colour",
        ),
        ("def scene(time):\n    return 3", "returns int, not a raytracer.Scene"),
    ],
)
def test_mistakes_in_a_file_are_named_with_their_line(tmp_path, capsys, text, what):
    source = tmp_path / "wave.py"
    source.write_text(text)
    assert cli.main(["animate", str(source), "-o", str(tmp_path / "wave.gif"), *SMALL]) == 1
    assert what in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["wave.py"]


def test_a_file_imports_the_modules_of_its_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "module_beside_a_scene.py").write_text("from raytracer.animation import animated as scene\n")
    (tmp_path / "beside.py").write_text("from module_beside_a_scene import scene\n")
    make = made_by(tmp_path / "beside.py")
    assert make(0.5).triangles == animated(0.5).triangles
    sys.path.remove(str(tmp_path))
    pickle.loads(pickle.dumps(make))
    assert sys.path[0] == str(tmp_path)


def test_a_file_may_define_dataclasses(tmp_path, monkeypatch):
    """They evaluate annotations that are texts in the module that `sys.modules` holds."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "wave.py").write_text(
        "from __future__ import annotations\nimport dataclasses\nfrom raytracer.animation import animated\n"
        "@dataclasses.dataclass\nclass Start:\n    time: float = 0.5\n"
        "def scene(time):\n    return animated(dataclasses.make_dataclass('Late', [], bases=(Start,))().time)\n"
    )
    make = pickle.loads(pickle.dumps(made_by(tmp_path / "wave.py")))
    assert make(0.0).meshes[0].vertices.tolist() == animated(0.5).meshes[0].vertices.tolist()


def test_a_file_that_is_not_there(tmp_path, capsys):
    with pytest.raises(SceneError, match="there is no file"):
        made_by(tmp_path / "none.py")
    assert cli.main(["animate", "boxes", "-o", str(tmp_path / "frames")]) == 1
    assert "the scene boxes stands still: `raytracer render boxes` draws it" in capsys.readouterr().err


def test_the_command_animates_what_its_camera_options_say(tmp_path):
    seen = ["--camera", "3,2,4", "--target", "0,0.5,0", "--fov", "40", "--background", "0.1,0.2,0.3", "--exposure", "1"]
    output = tmp_path / "frames"
    assert cli.main(["animate", "animated", "--frames", "2", "-o", str(output), *SMALL, *seen]) == 0
    scene = animated(1 / 24)
    camera = dataclasses.replace(scene.camera, position=(3, 2, 4), target=(0, 0.5, 0), fov=40)
    scene = dataclasses.replace(scene, camera=camera, background=(0.1, 0.2, 0.3))
    picture = render(scene, (24, 16), backend="numpy")
    expected = dataclasses.replace(picture, pixels=2 * picture.pixels).srgb
    assert np.array_equal(np.asarray(pillow.open(output / "0001.png")), expected)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("words", ["--accel ldc:16:triangle --bounces 0", "--tracer staged --accel brute --bounces 0"])
def test_the_command_animates_with_an_accelerator_and_a_tracer(tmp_path, monkeypatch, words):
    moving = lambda time: Scene([box().moved((time, 0, 0))], [PointLight((3, 5, 4))], Camera((2, 2, 4)))  # noqa: E731
    monkeypatch.setitem(ANIMATIONS, "animated", moving)
    output = tmp_path / "frames"
    assert cli.main(["animate", "animated", "--frames", "2", "-o", str(output), *SMALL, *words.split()]) == 0
    wanted = render(moving(1 / 24), (24, 16), bounces=0, backend="numpy").srgb
    assert np.array_equal(np.asarray(pillow.open(output / "0001.png")), wanted)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--tracer staged --accel bvh", 'goes through cells of a grid: --accel grid or "brute", not "bvh"'),
        (
            "--tracer staged --accel ldc:64",
            "secondary rays go through a layered depth cube with --tracer unified alone",
        ),
        ("--tracer staged --integrator path", "--tracer staged is for --integrator whitted: leave it out"),
    ],
)
@pytest.mark.parametrize("command", ["animate", "view"])
def test_tracers_and_accelerators_that_do_not_go_together(command, words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main([command, "animated", *words.split()]) == 1
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_frames_of_a_python_file_have_the_floor_that_it_makes(tmp_path, capsys):
    source = tmp_path / "wave.py"
    source.write_text(FILE)
    assert cli.main(["animate", str(source), "-o", str(tmp_path / "wave.gif"), "--no-floor", *SMALL]) == 1
    assert (
        "--no-floor is for files, which are put on one; a scene of a Python file is as it is made"
        in capsys.readouterr().err
    )
