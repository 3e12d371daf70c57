"""Generated glTF files are read as they were made, whatever the way in which they are stored."""

import re
import warnings

import numpy as np
import pytest
from gltf_generated import Generated

import shpy as sh
from raytracer import Scene, SceneError


def load(path, **options):
    """Return the scene of a file, and what the warnings say."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = Scene.load(path, floor=False, **options)
    assert {w.category for w in caught} <= {sh.ShpyWarning}
    return scene, [str(w.message) for w in caught]


def faults(said):
    """Return how many entries of each kind the warnings call left out."""
    text = next((text for text in said if "left out: " in text), "")
    found = re.findall(r"(?:left out: |\), )([\d,]+) (.*?) \((?=in |the first )", text)
    return {kind: int(count.replace(",", "")) for count, kind in found}


def area(corners):
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2


def check_part(mesh, part):
    np.testing.assert_allclose(mesh.corners, part.corners, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(area(mesh.corners), area(part.corners))
    if part.normals is None:
        assert mesh.normals is None
    else:
        np.testing.assert_allclose(mesh.normals, part.normals, atol=2e-6)
    for name in ("colors", "uv"):
        found, expected = getattr(mesh, name), getattr(part, name)
        assert (found is None) == (expected is None), name
        if expected is not None:
            np.testing.assert_allclose(found, expected, atol=1e-9)
    if part.color is not None:
        np.testing.assert_allclose(mesh.material.base_color, part.color)


def check_view(scene, expected):
    if expected.camera is not None:
        place, ahead, yfov, aspect = expected.camera
        np.testing.assert_allclose(scene.camera.position, place)
        np.testing.assert_allclose(scene.camera.axes[2], ahead, atol=1e-9)
        for width, height in ((64, 64), (80, 20), (20, 80)):
            view = scene.camera.view(width, height)
            shown = np.array([width * np.linalg.norm(view.across), height * np.linalg.norm(view.down)])
            np.testing.assert_allclose((shown / (2 * np.tan(yfov / 2) * np.array([aspect, 1]))).min(), 1)
    if expected.lights:
        np.testing.assert_allclose([light.position for light in scene.lights], expected.lights)


KINDS = {
    "primitive cannot be read": "primitives? cannot be read",
    "end within a triangle": "primitives? ends? within a triangle",
    "corner at no finite place": "triangles? ha(s|ve) a corner at no finite place",
    "vertex that is not there": "triangles? names? a vertex that is not there",
    "normals that cannot be read": "primitives? ha(s|ve) normals that cannot be read",
    "material cannot be read": "materials? cannot be read",
    "node cannot be read": "nodes? cannot be read",
    "camera cannot be read": "cameras? cannot be read",
    "light cannot be read": "lights? cannot be read",
}


def check(seed, folder, *, bad):
    """Compare a generated file with its right reading; return whether it has triangles."""
    folder = folder / f"{seed}"
    folder.mkdir()
    made = Generated(seed, bad=bad)
    expected, path = made.expected, made.write(folder)
    if not expected.parts:
        with pytest.raises(SceneError, match="the file holds no triangles"):
            load(path)
        return False
    scene, said = load(path)
    assert [mesh.name for mesh in scene.meshes] == expected.names
    for mesh, part in zip(scene.meshes, expected.parts, strict=True):
        check_part(mesh, part)
    check_view(scene, expected)
    found = faults(said)
    for kind, pattern in KINDS.items():
        count = sum(number for text, number in found.items() if re.fullmatch(pattern, text))
        assert count == expected.faults.get(kind, 0) or (kind in MAY_BE_UNUSED and count < expected.faults[kind]), (
            kind,
            said,
        )
    if found:
        with pytest.raises(SceneError, match=r"generated\.gl"):
            load(path, strict=True)
    return True


MAY_BE_UNUSED = KINDS.keys() - {"node cannot be read", "camera cannot be read", "light cannot be read"}
"""Bad entries of meshes that no node of the scene shows are not read."""


@pytest.mark.sampled(2)
@pytest.mark.parametrize("bad", [False, True])
def test_generated_files_are_read_as_they_were_made(tmp_path, bad):
    assert sum(check(seed, tmp_path, bad=bad) for seed in range(30)) > 20


@pytest.mark.slow
@pytest.mark.parametrize("bad", [False, True])
def test_many_generated_files_are_read_as_they_were_made(tmp_path, bad):
    assert sum(check(seed, tmp_path, bad=bad) for seed in range(1000, 1600)) > 400
