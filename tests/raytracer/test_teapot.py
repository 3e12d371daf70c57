"""Newell's teapot: on its patches, without cracks, turned outside, with the patches' normals."""

import numpy as np
import pytest

from raytracer import SceneError
from raytracer.meshes.teapot import teapot


@pytest.fixture(scope="module")
def coarse():
    return teapot(divisions=6)


def border(mesh):
    """The edges that one triangle uses, as closed chains of vertex numbers."""
    edges = [(a, b) for face in mesh.faces.tolist() for a, b in zip(face, face[1:] + face[:1], strict=True)]
    assert len(set(edges)) == len(edges), "two triangles on the same side of an edge"
    follows = dict(set(edges) - {(b, a) for a, b in edges})
    while follows:
        start, here = follows.popitem()
        chain = [start]
        while here != start:
            chain.append(here)
            here = follows.pop(here)
        yield chain


def pieces(mesh):
    """The number of parts of a mesh that are not connected."""
    group = np.arange(len(mesh.vertices))
    while True:
        least = group[mesh.faces].min(axis=1)
        lower = group.copy()
        np.minimum.at(lower, mesh.faces, least[:, None])
        if np.array_equal(lower, group):
            return len(np.unique(group[mesh.faces]))
        group = lower


def test_the_triangles_are_about_60000():
    mesh = teapot()
    assert len(mesh) == 61_256
    assert (mesh.uv.min(), mesh.uv.max()) == (0, 1)
    np.testing.assert_allclose(mesh.vertices.min(axis=0), [-3, 0, -2], atol=1e-12)
    np.testing.assert_allclose(mesh.vertices[:, 1:].max(axis=0), [3.15, 2], atol=1e-12)


@pytest.mark.parametrize("divisions", [2, 6])
def test_it_is_open_at_six_places_alone(divisions):
    mesh = teapot(divisions=divisions)
    assert len(mesh) == 64 * divisions**2 - 8 * divisions
    assert pieces(mesh) == 4
    found = [mesh.vertices[chain] for chain in border(mesh)]
    assert sorted(map(len, found)) == sorted([4 * divisions] * 2 + [2 * divisions] * 4)
    rings = {round(float(p[:, 0].max()), 9) for p in found if len(p) == 4 * divisions}
    assert rings == {1.3, 1.4}  # the lid's edge, the pot's mouth
    ends = sorted(float(p[:, 0].mean()) for p in found if len(p) == 2 * divisions)
    assert -2 < ends[0] < ends[1] < -1.5 < 1.7 <= ends[2] < 2.8 < ends[3] < 3.2


def test_no_vertex_is_there_twice_and_no_triangle_is_empty(coarse):
    assert len(np.unique(coarse.faces)) == len(coarse.vertices)
    # The handle begins at a vertex of the pot, (-2, 0.9, 0).
    assert len(np.unique(coarse.vertices.round(9), axis=0)) == len(coarse.vertices) - 1
    np.testing.assert_allclose(np.linalg.norm(coarse.face_normals, axis=1), 1)


def test_the_outside_is_outside(coarse):
    centres = coarse.corners.mean(axis=1)
    pot = (np.hypot(centres[:, 0], centres[:, 2]) > 1.45) & (np.abs(centres[:, 0]) < 1.4)
    assert pot.sum() > 100
    assert np.all(np.sum(coarse.face_normals[pot] * centres[pot] * [1, 0, 1], axis=1) > 0)
    # A tube's triangles look away from its axis: from the middle of its section at the same height or distance.
    handle = (centres[:, 0] < -2.1) & (np.abs(centres[:, 2]) > 0.15)
    spout = (centres[:, 0] > 2.3) & (np.abs(centres[:, 2]) > 0.15)
    assert min(handle.sum(), spout.sum()) > 10
    for tube in (handle, spout):
        assert np.all(coarse.face_normals[tube, 2] * centres[tube, 2] > 0)


def test_normals_are_the_patches(coarse):
    """Faces of a finer mesh turn to the coarse mesh's normals at the vertices that both have."""
    fine = teapot(divisions=36).smoothed(60)
    places, where = np.unique(fine.corners.reshape(-1, 3).round(6) + 0.0, axis=0, return_index=True)
    known = dict(zip(map(tuple, places), fine.normals.reshape(-1, 3)[where], strict=True))
    inner = np.ones(len(coarse.vertices), bool)
    inner[[k for chain in border(coarse) for k in chain]] = False  # there faces of one side alone meet
    of_fine = np.array([known[tuple(place)] for place in coarse.vertices.round(6) + 0.0])[coarse.faces]
    along = np.sum(coarse.normals * of_fine, axis=-1)[inner[coarse.faces]]
    assert len(along) > 6000
    assert along.min() > 0.99  # where patches of other curvature meet, the mean of the faces is a little off
    assert along.mean() > 0.9995


def test_normals_at_the_poles_are_along_the_axis(coarse):
    poles = (np.hypot(coarse.corners[..., 0], coarse.corners[..., 2]) < 1e-12).nonzero()
    np.testing.assert_allclose(
        coarse.normals[poles], np.where(coarse.corners[poles][:, 1:2] > 1, [[0, 1, 0]], [[0, -1, 0]]), atol=1e-12
    )
    assert len(poles[0]) == 2 * 4 * 6


def test_points_of_newells_data():
    """Corners of patches are points of the surface, whatever the divisions."""
    expected = [
        (0, 0, 0), (0, 3.15, 0), (0, 2.7, 0.2), (1.4, 2.4, 0), (2, 0.9, 0), (0, 0.15, -1.5), (-3, 1.8, 0),
        (-2.7, 1.8, 0), (3.3, 2.4, 0), (2.7, 2.4, 0), (3.2, 2.4, 0), (2.8, 2.4, 0), (-1.9, 0.6, 0),
    ]  # fmt: skip
    for divisions in (2, 3):
        vertices = teapot(divisions=divisions).vertices
        for point in expected:
            assert np.abs(vertices - point).max(axis=1).min() < 1e-12


def test_too_few_divisions():
    with pytest.raises(SceneError, match="2 by 2 cells or more, not 1"):
        teapot(divisions=1)
