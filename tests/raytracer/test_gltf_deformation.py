"""Skins and morph targets of glTF files: vertices and normals in every pose, and refusals."""

import math

import numpy as np
import pytest
from gltf_files import File
from scene_pictures import SIZE, frames, same
from test_gltf_animation import animated

import shpy as sh
from raytracer import Scene, SceneError, render
from raytracer.scene.animated_file import AnimatedFile

HALF = math.sqrt(0.5)
ARM = np.array([[x, y, 0] for y in (0, 1, 2) for x in (-0.5, 0.5)])
FACES = [0, 1, 3, 0, 3, 2, 2, 3, 5, 2, 5, 4]
LOWER, UPPER = [1, 0], [0, 1]
SHARES = np.array([LOWER, LOWER, [0.5, 0.5], [0.25, 0.75], UPPER, UPPER])
"""The shares of the joint below and of the joint above in each vertex of the arm."""


def arm(*, kind="f4", pairs=1, **attributes):
    """A file with an arm on a joint at (0, 0, 0) and a joint at (0, 1, 0), and the numbers of these nodes."""
    file = File()
    upper = file.node(False, name="upper", translation=[0, 1, 0])
    lower = file.node(name="lower", children=[upper])
    bind = [np.eye(4), np.array([[1, 0, 0, 0], [0, 1, 0, -1], [0, 0, 1, 0], [0, 0, 0, 1]])]
    inverse = file.array(np.stack([matrix.T.reshape(-1) for matrix in bind]))
    skin = file.add("skins", {"joints": [lower, upper], "inverseBindMatrices": inverse})
    joints, weights = np.zeros((6, 4 * pairs), int), np.zeros((6, 4 * pairs))
    joints[:, -1], weights[:, 0], weights[:, -1] = 1, *SHARES.T
    if kind == "u1":
        weights = np.round(255 * weights)
    given = {}
    for k in range(pairs):
        part = slice(4 * k, 4 * k + 4)
        given[f"JOINTS_{k}"] = file.array(joints[:, part], "u2" if k else "u1")
        given[f"WEIGHTS_{k}"] = file.array(weights[:, part], kind, normalized=kind != "f4")
    primitive = {"attributes": {"POSITION": file.array(ARM)} | given | attributes, "indices": file.array(FACES, "u2")}
    # The place of the node itself is nothing to a skinned mesh.
    file.node(mesh=file.mesh(primitive, name="arm"), skin=skin, translation=[9, 9, 9])
    return file, lower, upper


def bent(degrees, shift=(0, 0)):
    """Return where the arm is when its upper joint has turned about z, by complex numbers."""
    turn, root = np.exp(1j * np.radians(degrees)), complex(*shift)
    stays = ARM[:, 0] + 1j * ARM[:, 1]
    moves = (stays - 1j) * turn + 1j
    places = SHARES[:, 0] * stays + SHARES[:, 1] * moves + root
    return np.stack([places.real, places.imag, np.zeros(6)], axis=1)


@pytest.mark.parametrize(("kind", "pairs", "error"), [("f4", 1, 1e-6), ("u1", 1, 0.01), ("f4", 2, 1e-6)])
def test_a_skin_follows_its_joints(tmp_path, kind, pairs, error):
    file, lower, upper = arm(kind=kind, pairs=pairs)
    turn = [[0, 0, 0, 1], [0, 0, HALF, HALF]]
    tracks = [
        (upper, "rotation", [0, 1], turn, "LINEAR"),
        (lower, "translation", [0, 1], [[0, 0, 0], [3, 1, 0]], "LINEAR"),
    ]
    animated(file, *tracks)
    make = AnimatedFile(file.save(tmp_path / "arm.glb")).make(5, 4)
    for k in range(5):
        found = make(k / 4).meshes[0]
        np.testing.assert_allclose(found.vertices, bent(22.5 * k, (0.75 * k, 0.25 * k)), atol=error)


def test_a_still_picture_shows_the_pose_of_the_nodes(tmp_path):
    file, _, upper = arm()
    file.tree["nodes"][upper]["rotation"] = [0, 0, HALF, HALF]
    found = Scene.load(file.save(tmp_path / "arm.gltf")).meshes[0]
    np.testing.assert_allclose(found.vertices, bent(90), atol=1e-6)


def test_normals_stay_across_a_surface_that_a_joint_stretches(tmp_path):
    file, lower, _ = arm()
    slanted = [[0.6, 0, 0.8]] * 6
    file.tree["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = file.array(slanted)
    file.tree["nodes"][lower]["scale"] = [2, 1, 1]
    found = Scene.load(file.save(tmp_path / "arm.glb")).meshes[0]
    expected = np.array([0.3, 0, 0.8]) / np.hypot(0.3, 0.8)
    np.testing.assert_allclose(found.normals, np.broadcast_to(expected, found.normals.shape), atol=1e-6)


def test_frames_of_a_skin_are_the_pictures_of_meshes_made_so(tmp_path):
    file, _, upper = arm()
    animated(file, (upper, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, HALF, HALF]], "LINEAR"))
    make = AnimatedFile(file.save(tmp_path / "arm.glb")).make(4, 3)
    scenes = [make(k / 3) for k in range(4)]
    for scene, found in zip(scenes, frames(scenes), strict=True):
        same(found, render(scene, SIZE, backend="numpy"))
        assert 0 in found.object_id


SHAPES = np.array([[[1, 0, 0]] * 6, [[0, 0.5 * k, 0] for k in range(6)]])
"""Displacements by which two morph targets move the arm's vertices."""


def morphing(times, amounts, kind):
    file, _, _ = arm()
    primitive = file.tree["meshes"][0]["primitives"][0]
    primitive["targets"] = [{"POSITION": file.array(shape)} for shape in SHAPES]
    del file.tree["nodes"][2]["skin"]
    animated(file, (2, "weights", times, np.reshape(amounts, -1), kind))
    return file


@pytest.mark.parametrize(
    ("kind", "amounts", "expected"),
    [
        ("LINEAR", [[0, 1], [1, 0]], lambda t: (t / 2, 1 - t / 2)),
        ("STEP", [[0, 1], [1, 0]], lambda t: (t >= 2, t < 2)),
        # In each key: the tangents in, the values, the tangents out. t**3 - t**2 and 1 - t are their own splines.
        ("CUBICSPLINE", [[[0, -1], [0, 1], [0, -1]], [[8, -1], [4, -1], [8, -1]]], lambda t: (t**3 - t**2, 1 - t)),
    ],
)
def test_morph_targets_are_added_by_their_weights(tmp_path, kind, amounts, expected):
    make = AnimatedFile(morphing([0, 2], amounts, kind).save(tmp_path / "face.glb")).make(5, 2)
    for k in range(5):
        first, second = expected(k / 2)
        places = ARM + (9, 9, 9) + first * SHAPES[0] + second * SHAPES[1]
        np.testing.assert_allclose(make(k / 2).meshes[0].vertices, places, atol=2e-6)


def test_weights_of_the_mesh_and_of_its_nodes(tmp_path):
    file = morphing([0, 1], [[0, 0], [0, 0]], "LINEAR")
    file.tree["meshes"][0]["weights"] = [0.5, 0.25]
    file.node(mesh=0, weights=[0, 2])
    for primitive in file.tree["meshes"][0]["primitives"]:
        for name in ("JOINTS_0", "WEIGHTS_0"):
            del primitive["attributes"][name]
    del file.tree["animations"]
    first, second = Scene.load(file.save(tmp_path / "face.glb")).meshes[:2]
    np.testing.assert_allclose(first.vertices, ARM + (9, 9, 9) + 0.5 * SHAPES[0] + 0.25 * SHAPES[1], atol=1e-6)
    np.testing.assert_allclose(second.vertices, ARM + 2 * SHAPES[1], atol=1e-6)


def test_targets_come_before_the_skin(tmp_path):
    file, _, upper = arm()
    file.tree["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": file.array([[0, 0, 1]] * 6)}]
    file.tree["meshes"][0]["weights"] = [2]
    file.tree["nodes"][upper]["rotation"] = [0, 0, HALF, HALF]
    found = Scene.load(file.save(tmp_path / "arm.glb")).meshes[0]
    np.testing.assert_allclose(found.vertices, bent(90) + (0, 0, 2), atol=1e-6)


def few_matrices(file):
    file.tree["skins"][0]["inverseBindMatrices"] = file.array(np.eye(4).reshape(1, 16))


def outside(file):
    file.tree["skins"][0]["joints"][1] = file.node(False)


def one_joint(file):
    del file.tree["skins"][0]["joints"][1:]


def floating(file):
    file.tree["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = file.array(np.zeros((6, 4)))


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (few_matrices, r"2 joints has inverse bind matrices \(1, 16\)"),
        (outside, "joints of its skin are no nodes of the scene"),
        (one_joint, "names joint 1, and its skin has 1"),
        (floating, "joints"),
    ],
)
def test_skins_that_contradict_themselves(tmp_path, change, what):
    file, _, _ = arm()
    change(file)
    path = file.save(tmp_path / "bad.glb")
    with pytest.raises(SceneError, match=what):
        Scene.load(path, strict=True)
    with pytest.warns(sh.ShpyWarning, match=f"left out: 1 .*{what}"):
        assert Scene.load(path).triangles


def test_weights_without_targets(tmp_path):
    file, _, _ = arm()
    animated(file, (2, "weights", [0, 1], [0, 1], "LINEAR"))
    with pytest.raises(SceneError, match="weights of node 2, whose mesh has no morph targets"):
        AnimatedFile(file.save(tmp_path / "bad.glb"))
