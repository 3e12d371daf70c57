"""The hierarchy holds every triangle once, its links lead through it in order, and it is cut well and fast."""

import numpy as np
import pytest

from raytracer.accel import ploc
from raytracer.accel.bvh import COUNT_BITS, END, MAX_LEAF
from raytracer.accel.ploc import build_bvh
from raytracer.meshes.shapes import box, floor, sphere


def random_triangles(count, size, seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(0, size, (count, 3, 3))


ODD = {
    "one": random_triangles(1, 1, 1),
    "two": random_triangles(2, 1, 1),
    "points at the origin": np.zeros((20, 3, 3)),
    "points": np.full((20, 3, 3), 7.0),
    "flat": np.repeat(floor(1).corners, 20, axis=0),
    "needle": box().corners * [1, 1e-9, 1e9],
    "tiny": random_triangles(50, 0.1, 4) * 1e-30,
    "huge": random_triangles(50, 0.1, 4) * 1e30,
    "far away": random_triangles(50, 0.1, 4) + 1e6,
    "far apart": np.repeat(np.outer(2.0 ** np.linspace(-80, 60, 500), [1, 0, 0])[:, None], 3, axis=1),
    "one far larger": np.concatenate([random_triangles(50, 0.01, 5), floor(1e6).corners]),
}
MESHES = {"soup": random_triangles(400, 0.1, 2), "ball": sphere().corners, "box": box().corners} | ODD


@pytest.fixture(params=[0, ploc.FEW], ids=["merged", "cut"])
def build(request, monkeypatch):
    """Return the builder, which merges few triangles, too, or splits all of them from the top down."""
    monkeypatch.setattr(ploc, "FEW", request.param)
    return build_bvh


def leaves_of(bvh):
    """(node, first item, end) of each leaf."""
    codes = bvh.links[0, :, 0]
    for node in np.flatnonzero(codes < 0):
        code = -1 - int(codes[node])
        first, count = code >> COUNT_BITS, code & ((1 << COUNT_BITS) - 1)
        yield int(node), first, first + count


def children_of(bvh, octant=0):
    """(node, nearer child, other child) of each inner node."""
    first, past = bvh.links[octant].T
    inner = np.flatnonzero(first >= 0)
    return inner, first[inner], past[first[inner]]


@pytest.mark.parametrize("name", MESHES)
def test_every_triangle_is_in_one_leaf_and_in_its_box(name, build):
    corners = MESHES[name].astype(np.float32)
    bvh = build(corners)
    assert sorted(bvh.items.tolist()) == list(range(len(corners)))
    spans = sorted((first, end) for _, first, end in leaves_of(bvh))
    assert [a for a, _ in spans] == [0, *(b for _, b in spans[:-1])]
    assert spans[-1][1] == len(corners)
    for node, first, end in leaves_of(bvh):
        assert 0 < end - first <= MAX_LEAF
        held = corners[bvh.items[first:end]].reshape(-1, 3)
        assert np.all((held > bvh.low[node]) & (held < bvh.high[node]))  # not even in a face


@pytest.mark.parametrize("name", MESHES)
def test_links_lead_through_all_nodes_the_nearer_child_first(name, build):
    bvh = build(MESHES[name])
    for octant, (first, past) in enumerate(bvh.links.transpose(0, 2, 1)):
        seen, node = [], 0
        while node != END:
            seen.append(node)
            node = first[node] if first[node] >= 0 else past[node]
        assert sorted(seen) == list(range(len(first)))
        inner, near, other = children_of(bvh, octant)
        for child in (near, other):
            assert np.all(bvh.low[inner] <= bvh.low[child])
            assert np.all(bvh.high[inner] >= bvh.high[child])
        np.testing.assert_array_equal(past[other], past[inner])
        assert {frozenset(pair) for pair in zip(near, other, strict=True)} == {
            frozenset(pair) for pair in zip(*children_of(bvh)[1:], strict=True)
        }
    assert np.all(children_of(bvh)[1] == children_of(bvh)[0] + 1)


def test_opposite_octants_take_the_children_in_opposite_order():
    bvh = build_bvh(MESHES["soup"])
    for octant in range(8):
        inner, near, other = children_of(bvh, octant)
        _, near_back, other_back = children_of(bvh, 7 - octant)
        np.testing.assert_array_equal(near, other_back)
        np.testing.assert_array_equal(other, near_back)
        toward = np.where(octant >> np.arange(3) & 1, -1, 1)
        middle = bvh.low + bvh.high
        ahead = ((middle[other] - middle[near]) * toward).max(axis=1)
        assert np.all(ahead > 0)
    assert len(inner) > 50


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_boxes_hold_the_triangles_as_they_are_rounded(dtype, build):
    corners = random_triangles(200, 0.1, 3)
    bvh = build(corners, dtype)
    assert bvh.low.dtype == dtype
    for node, first, end in leaves_of(bvh):
        held = corners[bvh.items[first:end]].astype(dtype).reshape(-1, 3)
        assert np.all((held > bvh.low[node]) & (held < bvh.high[node]))


def area(bvh, node):
    x, y, z = (bvh.high[node] - bvh.low[node]).astype(float)
    return x * y + y * z + z * x


def cost(bvh):
    """Return the surface area heuristic's cost of a ray through the root: visited nodes, and triangles."""
    nodes = sum(area(bvh, node) for node in range(len(bvh.low)))
    tried = sum(area(bvh, node) * (end - first) for node, first, end in leaves_of(bvh))
    return nodes / area(bvh, 0), tried / area(bvh, 0)


def test_cuts_are_good():
    """A curved surface of 4,000 triangles takes few visits of nodes; two balls far apart are parted first."""
    nodes, tried = cost(build_bvh(sphere(rings=32, segments=64).corners))
    assert nodes < 40
    assert tried < 14
    two = np.concatenate([sphere(rings=8, segments=9).corners, sphere(rings=8, segments=9).corners + [9, 0, 0]])
    bvh = build_bvh(two)
    parted = [bvh.high[1, 0], bvh.low[bvh.links[0, 1, 1], 0]]
    np.testing.assert_allclose(parted, [1, 8], atol=0.05)


def test_a_floor_and_walls_stand_apart_from_a_ball(build):
    """Only the root and the node of the walls are as large as the room."""
    walls = [floor(8).moved((0, -1, 0)), floor(8).moved((0, 0, -4), tilt=90), floor(8).moved((0, 4, 0))]
    bvh = build(np.concatenate([mesh.corners for mesh in (*walls, sphere(0.5, rings=12, segments=24))]))
    large = [node for node in children_of(bvh)[0] if area(bvh, node) > area(bvh, 0) / 4]
    assert len(large) == 2


def test_a_far_larger_triangle_does_not_spoil_the_rest():
    balls = sphere(rings=16, segments=24).corners
    alone = cost(build_bvh(balls))
    ground = build_bvh(np.concatenate([balls, floor(1e3).corners - [0, 2, 0]]))
    second = [ground.links[0, 0, 0], ground.links[0, ground.links[0, 0, 0], 1]]
    small = min(area(ground, node) for node in second)
    root = area(build_bvh(balls), 0)
    assert small < 1.2 * root
    assert sum(alone) < 60


@pytest.mark.parametrize("name", ODD)
def test_odd_triangles_make_finite_boxes(name, build):
    bvh = build(ODD[name])
    assert np.all(np.isfinite(bvh.low) & np.isfinite(bvh.high))
    assert np.all(bvh.low < bvh.high)
