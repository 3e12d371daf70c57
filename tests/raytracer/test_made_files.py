"""Files whose right reading is known by construction are read so, and broken ones give a mesh or one SceneError."""

import re
import warnings

import numpy as np
import pytest
import trimesh
from made_files import MAKERS, made_file
from test_mesh_mutations import mutated

import shpy as sh
from raytracer import Scene, SceneError
from raytracer.appearance.textures import decoded

QUICK, MANY, BROKEN = 120, 2400, 3000


def said_of(caught):
    """The sentences of all notices on what is left out, without the places of the first."""
    texts = [str(w.message).partition(": left out: ")[2] for w in caught]
    return [re.sub(r" \((the first )?in [^)]*\)", "", part) for text in texts if text for part in text.split(", ")]


def most_turned(corners):
    """Return how far below 0 the area of a triangle may be, along its face's normal n, by rounding to binary32.

    The corners a, b, c before rounding lie in the plane of the face, and (b - a) x (c - a) . n >= 0. Rounding moves
    each component by half the spacing of binary32 at most, and so a corner by a length e. Where corner a moves, twice
    the area along n changes by e_a . ((b - c) x n), which is |e_a| |b - c| at most; likewise for b and c. What remains
    is the product (e_b - e_a) x (e_c - e_a) . n, at most 4 |e|^2; it also exceeds the rounding in binary64 here. The
    edges between rounded corners differ from the others by 2 |e|, which adds 2 |e| (|e_a| + |e_b| + |e_c|) <= 6 |e|^2.
    """
    moved = np.linalg.norm(np.spacing(np.abs(corners).astype(np.float32)).astype(float) / 2, axis=1)
    opposite = np.linalg.norm(np.roll(corners, 1, axis=0) - np.roll(corners, -1, axis=0), axis=1)
    return (moved @ opposite + 10 * moved.max() ** 2) / 2


def check(seed, folder):
    """Load the file of a seed, and compare it with what it was made from."""
    made = made_file(seed)
    path = folder / f"file{seed}.{made.ending}"
    path.write_bytes(made.data)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        meshes = Scene.load(path, floor=False).meshes
    assert sorted(said_of(caught)) == sorted(made.said), made.said
    if made.said:
        with pytest.raises(SceneError, match=rf"file{seed}\.{made.ending}: "):
            Scene.load(path, strict=True)
    at = made.at()
    areas = dict.fromkeys(range(len(made.faces)), 0.0)
    numbers = {id(face): k for k, face in enumerate(made.faces)}
    for mesh in meshes:
        assert {name for name in ("colors", "uv") if getattr(mesh, name) is not None} == made.has - {"normals"}
        for t, corners in enumerate(mesh.corners):
            across = np.cross(corners[1] - corners[0], corners[2] - corners[0]) / 2
            found = [at[tuple(place)] for place in corners.tolist()]
            (face,) = {id(face): face for face, _ in found}.values()
            assert across @ face.normal >= -most_turned(corners)
            areas[numbers[id(face)]] += float(np.linalg.norm(across))
            for c, (_, k) in enumerate(found):
                if "colors" in made.has:
                    np.testing.assert_allclose(mesh.colors[t, c], decoded(face.colors[k] / 255), atol=3e-3)
                if "uv" in made.has:
                    np.testing.assert_allclose(mesh.uv[t, c], face.uv[k], atol=1e-6)
                if "normals" in made.has:
                    flat = tuple(corners[c].tolist()) in made.flat
                    wanted = mesh.face_normals[t] if flat else face.normals[k]
                    np.testing.assert_allclose(mesh.normals[t, c], wanted, atol=1e-5)
    np.testing.assert_allclose(list(areas.values()), [face.area for face in made.faces], rtol=1e-4)
    if all(face.convex for face in made.faces):
        assert sum(map(len, meshes)) == sum(len(face.places) - 2 for face in made.faces)
        compare_with_trimesh(path, made)
    path.unlink()


def compare_with_trimesh(path, made):
    """trimesh finds the same area where it reads a file rightly: it takes no bad entries and few forms."""
    if made.said or b"\r" in made.data or b"\\" in made.data or made.ending == "ply" or b"\t" in made.data:
        return
    if made.ending == "stl" and not made.data.startswith(b"solid") and made.data[80:84] in (bytes(4), b"\xff" * 4):
        return
    try:
        found = trimesh.load(path, process=False, force="mesh")
    except Exception:  # such as spaces before a keyword
        return
    if len(found.faces) == sum(len(face.places) - 2 for face in made.faces):
        assert found.area == pytest.approx(made.area, rel=1e-4)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("part", range(4))
def test_files_made_by_chance_are_read_rightly(tmp_path, part):
    for seed in range(part, QUICK, len(MAKERS)):
        check(seed, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
def test_many_files_made_by_chance_are_read_rightly(tmp_path, part):
    for seed in range(10_000 + part, 10_000 + MANY, len(MAKERS)):
        check(seed, tmp_path)


def error_of(path, strict):
    """Load a file; give its SceneError, None for a scene."""
    try:
        assert np.isfinite(Scene.load(path, strict=strict).bounds).all()
    except SceneError as error:
        return error
    return None


def survive(seed, folder):
    """Load the file of a seed with changed bytes: no error comes from another library, or says what one said."""
    made, rng = made_file(seed), np.random.default_rng([seed, 1])
    path = folder / f"file{seed}.{made.ending}"
    path.write_bytes(mutated(made.data, rng))
    for strict in (False, True):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            error = error_of(path, strict)
        assert error is None or (path.stem in str(error) and isinstance(error.__cause__, SceneError | None)), error
        assert {w.category for w in caught} <= {sh.ShpyWarning}, caught[0]
    path.unlink()


def test_changed_bytes_give_a_mesh_or_one_error(tmp_path):
    for seed in range(100_000, 100_120):
        survive(seed, tmp_path)


@pytest.mark.slow
def test_many_changed_bytes_give_a_mesh_or_one_error(tmp_path):
    for seed in range(200_000, 200_000 + BROKEN):
        survive(seed, tmp_path)
