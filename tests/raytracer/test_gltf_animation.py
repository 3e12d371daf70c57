"""Animations of glTF files: interpolation, poses, frames that are the pictures of still files, and refusals."""

import dataclasses
import math
import os
import warnings
from pathlib import Path

import numpy as np
import pytest
from gltf_files import File
from PIL import Image as pillow
from scene_pictures import SIZE, frames, same

from raytracer import Scene, SceneError, cli, render
from raytracer.animation import animate, spread
from raytracer.meshes.folder import Folder
from raytracer.meshes.gltf import Document
from raytracer.meshes.gltf_animation import Clip, slerp
from raytracer.scene.animated_file import AnimatedFile

HALF = math.sqrt(0.5)
SMALL = ["--size", "24x16", "--backend", "numpy"]


def animated(file, *tracks, **entry):
    """Add an animation of tracks (node, path, times, values, kind)."""
    channels, samplers = [], []
    for node, path, times, values, kind in tracks:
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
        samplers.append({"input": file.array(times), "output": file.array(values), "interpolation": kind})
    return file.add("animations", {"channels": channels, "samplers": samplers} | entry)


def pose(times, values, kind, at, path="translation", **accessor):
    file = File()
    node = file.node()
    number = animated(file, (node, path, times, values, kind))
    file.tree["accessors"][-1].update(accessor)
    return Clip(Document(file.glb(), Folder(Path("a.glb"))), number).pose(at)[node][path]


def moving(pose=None, *, own=False, smooth=True):
    """Two squares on a turning and growing parent and one that stays; with a pose {node: entry} it is a still file."""
    file = File()
    shape = file.square(attributes={} if not smooth else {"NORMAL": file.array([[0, 0.6, 0.8]] * 4)})
    mesh = file.mesh(shape, name="tile")
    inner = file.node(False, mesh=mesh, translation=[3, 0, 0])
    outer = file.node(mesh=mesh, children=[inner], translation=[0, 2, 0])
    file.node(mesh=mesh, translation=[0, 0, -2], scale=[2, 2, 1])
    if own:
        camera = file.add("cameras", {"type": "perspective", "perspective": {"yfov": 1.2, "znear": 1}})
        eye = file.node(camera=camera, translation=[0, 1, 9])
        file.light(type="directional")
    if pose is not None:
        for number, entry in pose.items():
            file.tree["nodes"][number].update(entry)
        return file
    quarter = [[0, 0, 0, 1], [0, 0, HALF, HALF], [0, 0, 1, 0]]
    tracks = [
        (outer, "rotation", [0, 1, 2], quarter, "LINEAR"),
        (inner, "scale", [0, 2], [[1, 1, 1], [0.5, -2, 1]], "LINEAR"),
        (inner, "translation", [0, 1], [[3, 0, 0], [3, 1, 0.5]], "STEP"),
    ]
    if own:
        tracks.append((eye, "translation", [0, 2], [[0, 1, 9], [4, 1, 9]], "LINEAR"))
    animated(file, *tracks, name="Turn")
    return file


def test_linear_and_step():
    rows = [[0, 0, 0], [2, 4, 8]]
    assert pose([0, 2], rows, "LINEAR", 0.5) == [0.5, 1, 2]
    assert pose([0, 2], rows, "STEP", 1.9) == [0, 0, 0]
    assert pose([0, 2], rows, "STEP", 2) == [2, 4, 8]
    assert pose([3, 5], rows, "LINEAR", 1) == [1, 2, 4]  # times count from the first key


@pytest.mark.parametrize("kind", ["LINEAR", "STEP"])
def test_the_ends_are_kept(kind):
    rows = [[1, 2, 3], [2, 4, 8]]
    assert pose([0, 2], rows, kind, -1) == [1, 2, 3]
    assert pose([0, 2], rows, kind, 9) == [2, 4, 8]
    assert pose([1], rows[:1], kind, 9) == [1, 2, 3]


def test_a_cubic_is_reproduced():
    """A cubic polynomial is its own Hermite interpolation; tangents are per second."""

    def cubic(t):
        return t**3 - 2 * t**2 + t / 2 + 1

    def slope(t):
        return 3 * t**2 - 4 * t + 0.5

    rows = [[v] * 3 for t in (0.0, 2.0, 4.0) for v in (slope(t), cubic(t), slope(t))]
    for t in (0.25, 1.0, 2.0, 3.5):
        np.testing.assert_allclose(pose([0, 2, 4], rows, "CUBICSPLINE", t), [cubic(t)] * 3, rtol=1e-14)
    assert pose([0, 2, 4], rows, "CUBICSPLINE", 7) == [cubic(4)] * 3


def test_rotations_turn_at_a_constant_speed_on_the_shorter_way():
    def about_z(degrees):
        return np.array([0, 0, math.sin(math.radians(degrees / 2)), math.cos(math.radians(degrees / 2))])

    for sign in (1, -1):
        np.testing.assert_allclose(slerp(about_z(10), sign * about_z(110), 0.3), about_z(40), atol=1e-15)
        np.testing.assert_allclose(
            pose([0, 1], [about_z(10), sign * about_z(110)], "LINEAR", 0.3, "rotation"), about_z(40), atol=1e-7
        )
    assert np.array_equal(slerp(about_z(20), about_z(20), 0.5), about_z(20))


def test_normalised_integers_are_rotations():
    file = File()
    node = file.node()
    number = animated(file, (node, "rotation", [0, 1], [[0, 0, 0, 1]] * 2, "LINEAR"))
    turned = file.array([[0, 0, 0, 32767], [0, 0, 32767, 0]], "i2", normalized=True)
    file.tree["animations"][0]["samplers"][0]["output"] = turned
    document = Document(file.glb(), Folder(Path("a.glb")))
    np.testing.assert_allclose(Clip(document, number).pose(0.5)[node]["rotation"], [0, 0, HALF, HALF])


@pytest.mark.sampled(4)
@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize("smooth", [False, True])
def test_frames_are_the_pictures_of_still_files(tmp_path, own, smooth):
    path = moving(own=own, smooth=smooth).save(tmp_path / "turn.glb")
    file = AnimatedFile(path)
    assert file.seconds == 2
    make = file.make(5, 2.5)
    scenes = [make(k / 2.5) for k in range(5)]
    for k, (shown, found) in enumerate(zip(scenes, frames(scenes), strict=True)):
        still = moving(file.clip.pose(k / 2.5), own=own, smooth=smooth).save(tmp_path / "still.glb")
        alone = Scene.load(still)
        expected = dataclasses.replace(
            alone,
            meshes=(*alone.meshes[:3], *shown.meshes[3:]),
            camera=shown.camera,
            lights=alone.lights if own else shown.lights,
        )
        assert len(shown.meshes) == len(alone.meshes)
        if own:
            assert shown.camera.position == alone.camera.position
        same(found, render(expected, SIZE, backend="numpy"))
        assert {0, 1, 2} <= set(np.unique(found.object_id))


def test_all_frames_are_in_the_picture(tmp_path):
    file = File()
    node = file.node(mesh=file.mesh(file.square(), name="tile"))
    animated(file, (node, "translation", [0, 1], [[0, 0, 0], [20, 10, 0]], "LINEAR"))
    make = AnimatedFile(file.save(tmp_path / "far.glb")).make(5, 4)
    scenes = [make(k / 4) for k in range(5)]
    for scene in scenes:
        seen = render(scene, (96, 96), backend="numpy").object_id == 0
        assert seen.any()
        assert not np.concatenate([seen[0], seen[-1], seen[:, 0], seen[:, -1]]).any()
    both = Scene.framed([scene.meshes[0] for scene in scenes])
    assert all(scene.camera.position == pytest.approx(both.camera.position) for scene in scenes)
    np.testing.assert_allclose(scenes[0].meshes[1].vertices, both.meshes[-1].vertices)
    assert [len(scene.meshes) for scene in scenes] == [2] * 5


@pytest.mark.sampled(2)
@pytest.mark.parametrize("last", [600, 1e30])
def test_an_animation_of_any_length_is_framed_soon(tmp_path, last):
    """As a stranger's file may write milliseconds; each of its frames was looked at."""
    file = File()
    node = file.node(mesh=file.mesh(file.square(), name="tile"))
    animated(file, (node, "translation", [0, last], [[0, 0, 0], [20, 10, 0]], "LINEAR"))
    long = AnimatedFile(file.save(tmp_path / "long.glb"))
    scene = long.make(*spread(long.seconds, None, None))(0.0)
    both = Scene.framed([scene.meshes[0], scene.meshes[0].moved((20, 10, 0))])
    assert scene.camera.position == pytest.approx(both.camera.position, rel=1e-3)


def test_parts_that_stay_are_the_same_meshes(tmp_path):
    make = AnimatedFile(moving().save(tmp_path / "turn.glb")).make(3, 1)
    first, second = make(0), make(1)
    assert [a is b for a, b in zip(first.meshes, second.meshes, strict=True)] == [False, False, True, True]


def test_how_many_frames():
    assert spread(2.0, None, None) == (48, 24)
    assert spread(2.0, None, 5.0) == (10, 5)
    assert spread(2.0, 10, None) == (10, 5)
    assert spread(2.0, 7, 5.0) == (7, 5)
    assert spread(0.0, None, None) == (1, 24)
    assert spread(0.0, 3, None) == (3, 24)
    for given in [(2.0, None, 0.0), (0.001, 48, None), (2.0, 3, 1e9)]:
        with pytest.raises(SceneError, match="at most 1000"):
            spread(*given)


def test_the_command(tmp_path, capsys):
    path, folder = moving().save(tmp_path / "turn.glb"), tmp_path / "frames"
    given = ["animate", str(path), "-o", str(folder), "--frames", "3", *SMALL]
    assert cli.main([*given, "--clip", "Turn"]) == 0
    said = capsys.readouterr()
    assert "3 frames, 24 x 16, 1.5 a second" in said.out
    assert "ignored" not in said.err
    make = AnimatedFile(path).make(3, 1.5)
    for k in range(3):
        expected = render(make(k / 1.5), (24, 16), backend="numpy").srgb
        assert np.array_equal(np.asarray(pillow.open(folder / f"000{k}.png")), expected)
    assert cli.main(["animate", str(path), "-o", str(tmp_path / "turn.gif"), "--fps", "2", *SMALL]) == 0
    with pillow.open(tmp_path / "turn.gif") as found:
        assert found.n_frames == 4


def test_another_clip(tmp_path):
    file = moving()
    animated(file, (2, "translation", [0, 4], [[0, 0, 0], [1, 0, 0]], "LINEAR"))
    path = file.save(tmp_path / "two.glb")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert [AnimatedFile(path, name).seconds for name in ("Turn", "1")] == [2, 4]
        AnimatedFile(path, "1").make(2, 1)(0)
        assert not caught
        list(animate(AnimatedFile(path).make(1, 1), tmp_path / "a", 1, size=(4, 4), backend="numpy"))
    assert [str(w.message) for w in caught] == ["two.glb: ignored: animations after the first (1)"]


def matrix(file):
    node = file.node(matrix=np.eye(4).reshape(-1).tolist())
    animated(file, (node, "scale", [0, 1], [[1, 1, 1], [1, 0, 0]], "STEP"))


def pointing(file):
    target = {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": "/materials/0"}}}
    sampler = {"input": file.array([0, 1]), "output": file.array([0, 1])}
    file.add("animations", {"channels": [{"sampler": 0, "target": target}], "samplers": [sampler]})


def track(*given):
    return lambda file: animated(file, (0, *given))


REFUSED = [
    (lambda file: None, "no animations: render it still with `raytracer render`, or move its meshes"),
    (pointing, "its animation '0' changes the property pointer; nodes and morph weights alone can change: render it"),
    (lambda file: file.add("animations", {"channels": [], "samplers": []}), "moves no nodes"),
    (matrix, "node 1 has a matrix"),
    (track("translation", [0, 1], [[0, 0, 0]], "LINEAR"), r"keys \(2, 1\) and values \(1, 3\)"),
    (track("rotation", [0, 1], [[0, 0, 0]] * 2, "LINEAR"), r"keys \(2, 1\) and values \(2, 3\)"),
    (track("translation", [0, 1], [[0, 0, 0]] * 2, "CUBICSPLINE"), r"values \(2, 3\)"),
    (track("translation", [1, 1], [[0, 0, 0]] * 2, "LINEAR"), "do not increase"),
    (track("translation", [0, math.nan], [[0, 0, 0]] * 2, "LINEAR"), "are not finite"),
    (track("translation", [0], [[0, 0, 0]], "BEZIER"), "interpolation BEZIER"),
    (lambda file: file.add("animations", {"channels": [{}]}), "lacks 'target'"),
]


@pytest.mark.parametrize(("change", "what"), REFUSED)
def test_refusals(tmp_path, change, what):
    file = File()
    file.node(mesh=file.mesh(file.square()))
    change(file)
    with pytest.raises(SceneError, match=what):
        AnimatedFile(file.save(tmp_path / "bad.glb"))


def test_a_clip_that_is_shown_beside_one_that_is_not(tmp_path):
    file = moving()
    pointing(file)
    path = file.save(tmp_path / "both.glb")
    assert AnimatedFile(path, "Turn").seconds == 2
    with pytest.raises(SceneError, match=r"'1' changes the property pointer; .*: choose another one \(Turn\), or"):
        AnimatedFile(path, "1")
    with pytest.raises(SceneError, match="no animation 'Run': choose one of Turn, 1"):
        AnimatedFile(path, "Run")


def test_commands_that_are_refused(tmp_path, capsys):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    path = moving().save(tmp_path / "turn.glb")
    output = ["-o", str(tmp_path / "a.gif")]
    for given, what in [
        ([str(tmp_path / "a.obj")], "animations are read from .glb and .gltf files, not from .obj"),
        ([str(tmp_path / "none.glb")], "there is no file"),
        (["animated", "--clip", "Turn"], "--clip is for GLB and glTF files"),
        ([str(path), "--clip", "Run"], "there is no animation 'Run'"),
        ([str(path), "--fps", "0"], "more than 0"),
        (["animated", "--fps", "0"], "more than 0"),
    ]:
        assert cli.main(["animate", *given, *output, *SMALL]) == 1
        assert what in capsys.readouterr().err
    assert sorted(os.listdir(tmp_path)) == ["a.obj", "turn.glb"]


def test_an_animation_far_from_the_origin_is_framed_by_itself(tmp_path):
    """A square at x = 100 that rises by 1 is seen from near by; the origin is no part of it."""
    file = File()
    node = file.node(mesh=file.mesh(file.square()), translation=[100, 0, 0])
    animated(file, (node, "translation", [0, 1], [[100, 0, 0], [100, 1, 0]], "LINEAR"))
    scene = AnimatedFile(file.save(tmp_path / "far.glb")).make(3, 2)(0.0)
    assert math.dist(scene.camera.position, (100, 0.5, 0)) < 12
