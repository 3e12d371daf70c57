"""The hierarchy from the bottom up: as deep as it may be, and the same on every backend."""

import numpy as np
import pytest
from effort import calls
from test_bvh import random_triangles
from test_wide import widened

import raytracer.accel.bvh as bvh
from raytracer.accel import ploc
from raytracer.accel.ploc import build_bvh, morton_order
from raytracer.meshes.shapes import knot


@pytest.fixture(autouse=True)
def merging(monkeypatch):
    """Let few triangles be merged, too."""
    monkeypatch.setattr(ploc, "FEW", 0)


def depth_of(bvh):
    """Return the number of levels below the root."""
    first, past = bvh.links[0].T
    depth = np.zeros(len(first), int)
    for node in np.flatnonzero(first >= 0):  # parents come before their children
        depth[[first[node], past[first[node]]]] = depth[node] + 1
    return depth.max()


def points(places):
    """Triangles (N, 3, 3) without extent at places along a line."""
    return np.repeat(np.outer(places, [1, 0, 0])[:, None], 3, axis=1)


def test_morton_order_goes_through_octants_one_after_the_other():
    places = np.array([[x, y, z] for x in (0.2, 1.8) for y in (0.2, 1.8) for z in (0.2, 1.8)], np.float32)
    assert morton_order(places).tolist() == [0, 4, 2, 6, 1, 5, 3, 7]
    assert morton_order(np.repeat(places[:1], 5, axis=0)).tolist() == [0, 1, 2, 3, 4]
    near = np.random.default_rng(3).uniform(0, 2, (5000, 3)).astype(np.float32)
    step = np.linalg.norm(np.diff(near[morton_order(near)], axis=0), axis=1)
    assert step.mean() < 0.15 * np.linalg.norm(np.diff(near, axis=0), axis=1).mean()


def test_morton_order_is_that_of_interleaved_bits():
    """For 2,000 points a key has 17 bits for each axis, of which the oracle interleaves the digits as text."""
    near = np.random.default_rng(5).uniform(0, 2, (2000, 3)).astype(np.float32)
    near[1000:] /= 2**8  # these differ in their last digits only
    digits = [[f"{int(c):017b}" for c in place] for place in near * np.float32(2**16)]
    keys = ["".join(z + y + x for x, y, z in zip(*place, strict=True)) for place in digits]
    assert morton_order(near).tolist() == sorted(range(len(near)), key=keys.__getitem__)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "corners",
    [
        np.full((5000, 3, 3), 7.0),
        points(np.cumsum(np.arange(5000.0))),  # each is nearer to the one before it
        points(2.0 ** np.linspace(-60, 60, 5000)),
        np.repeat(random_triangles(50, 0.1, 4), 100, axis=0),
    ],
)
def test_levels_are_few_whatever_the_triangles(corners):
    bvh = build_bvh(corners)
    assert depth_of(bvh) < 4 * np.log2(len(corners))
    assert widened(bvh, corners).depth <= depth_of(bvh)  # levels that the walk has a stack for


def test_equal_boxes_are_joined_in_pairs():
    """Each round joins all of 2**12 equal triangles in pairs, so that all leaves are full and equally deep."""
    bvh = build_bvh(np.full((4096, 3, 3), 7.0))
    assert len(bvh.low) == 2 * 4096 // 4 - 1
    assert depth_of(bvh) == 10


ON_BACKENDS = {
    "soup and equal ones": np.concatenate([random_triangles(3000, 0.05, 8), np.full((200, 3, 3), 0.5)]),
    "one point": np.full((300, 3, 3), 7.0),
    "one": random_triangles(1, 1, 1),
    "far apart": points(2.0 ** np.linspace(-80, 60, 500)),
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("corners", ON_BACKENDS.values(), ids=ON_BACKENDS)
@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_trees_are_the_same_on_every_backend(backend, corners, monkeypatch):
    monkeypatch.setattr(bvh, "MANY", 0)
    expected, hierarchy = (build_bvh(corners, backend=name) for name in ("numpy", backend))
    for table in ("low", "high", "links", "items"):
        np.testing.assert_array_equal(getattr(expected, table), getattr(hierarchy, table))
    wide = [widened(expected, corners, name) for name in ("numpy", backend)]
    np.testing.assert_array_equal(*(one.table for one in wide))
    assert wide[0].depth == wide[1].depth


def test_a_hierarchy_is_built_in_rounds():
    """Ten times the triangles take more chunks, but no loop over nodes."""
    few, many = (knot(segments=segments, sides=50).corners for segments in (70, 700))
    build_bvh(few)  # records its kernels
    assert calls(lambda: build_bvh(many)) < 3 * calls(lambda: build_bvh(few))
    assert build_bvh(many).bytes < 10e6
