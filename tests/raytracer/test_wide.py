"""Eight boxes a node, eight triangles a leaf: everything is there once, and in its box."""

import numpy as np
import pytest
from test_bvh import MESHES

from raytracer.accel.bvh import COUNT_BITS
from raytracer.accel.families import WIDTH
from raytracer.accel.ploc import build_bvh
from raytracer.accel.space import triangle_rows
from raytracer.accel.wide import BLOCK, FIRST, LEAF, NUMBERS, ROWS, TAGS, wide_nodes, widen
from raytracer.kernels.triangle import Triangles


def widened(bvh, corners, backend="numpy"):
    """Return the wide form of a hierarchy over triangles with these corners."""
    return widen(bvh, *Triangles.of(triangle_rows(corners.astype(np.float64)), np.float32).sources, backend)


def boxes_of(wide):
    """(record, low, high, child, whether it is a block) of every box that is there, node by node."""
    nodes = [0]
    for node in nodes:
        rows = wide.records[node]
        low, high = rows[:TAGS].view(np.float32).reshape(2, 3, WIDTH).transpose(0, 2, 1)
        tags, first = rows[TAGS:FIRST].reshape(WIDTH), int(rows[FIRST, 0])
        for k in np.flatnonzero((low <= high).all(axis=1)):
            child, is_block = first + int(tags[k]) % LEAF, bool(tags[k] & LEAF)
            yield node, low[k], high[k], child, is_block
            if not is_block:
                nodes.append(child)


def triangles_of(wide, place):
    """The numbers (n,) and corners (n, 9) of a block's triangles."""
    block = wide.records[place : place + 2].reshape(ROWS, BLOCK)
    numbers = block[NUMBERS].view(np.int32)
    return numbers[numbers >= 0], block[:NUMBERS].view(np.float32).T[numbers >= 0]


def held_by(wide, place, is_block):
    """The corners (n, 3) of the triangles in a block, or of the boxes in a node."""
    if is_block:
        return triangles_of(wide, place)[1].reshape(-1, 3)
    sides = wide.records[place, :TAGS].view(np.float32).reshape(2, 3, WIDTH)
    there = (sides[0] <= sides[1]).all(axis=0)
    return sides[..., there].transpose(0, 2, 1).reshape(-1, 3)


@pytest.mark.parametrize("name", MESHES)
def test_everything_is_there_once_and_in_its_box(name):
    corners = MESHES[name].astype(np.float32)
    wide = widened(build_bvh(corners), corners)
    met, found = [0], []
    for node, low, high, child, is_block in boxes_of(wide):
        inside = held_by(wide, child, is_block)
        assert child > node
        assert np.all((low <= inside) & (inside <= high))
        met += [child, child + 1] if is_block else [child]
        if is_block:
            numbers, inside = triangles_of(wide, child)
            np.testing.assert_array_equal(inside, corners[numbers].reshape(-1, 9))
            found += numbers.tolist()
    assert sorted(met) == list(range(len(wide.records)))
    assert sorted(found) == list(range(len(corners)))


def test_nodes_and_blocks_are_full():
    corners = MESHES["ball"]
    wide = widened(build_bvh(corners), corners)
    boxes = list(boxes_of(wide))
    blocks = [child for *_, child, is_block in boxes if is_block]
    assert len(boxes) > 0.7 * WIDTH * (len(wide.records) - 2 * len(blocks))
    assert len(corners) > 0.7 * BLOCK * len(blocks)
    assert wide.depth < 6


def surface(low, high):
    x, y, z = np.float64(high) - np.float64(low)
    return x * y + y * z + z * x


def children_of(bvh, node):
    first = int(bvh.links[0, node, 0])
    return (first, int(bvh.links[0, first, 1])) if first >= 0 else ()


def held_below(bvh, node):
    """Return the number of triangles in a node of the binary hierarchy."""
    code = -1 - int(bvh.links[0, node, 0])
    children = children_of(bvh, node)
    return sum(held_below(bvh, child) for child in children) if children else code % (1 << COUNT_BITS)


def least_surface(bvh, node, boxes):
    """By trying every way: the least surface of the wide nodes for what a node holds, in at most `boxes` boxes."""
    if held_below(bvh, node) <= BLOCK:
        return 0.0
    left, right = children_of(bvh, node)
    ways = [least_surface(bvh, left, k) + least_surface(bvh, right, boxes - k) for k in range(1, boxes)]
    if boxes < WIDTH:
        ways.append(surface(bvh.low[node], bvh.high[node]) + least_surface(bvh, node, WIDTH))
    return min(ways)


def test_the_nodes_have_the_least_surface():
    corners = np.random.default_rng(5).random((90, 1, 3)) + np.random.default_rng(6).random((90, 3, 3)) / 10
    bvh = build_bvh(corners)
    wide = widened(bvh, corners)
    found = sum(surface(low, high) for *_, low, high, _, is_block in boxes_of(wide) if not is_block)
    assert found == pytest.approx(least_surface(bvh, 0, WIDTH))


@pytest.mark.parametrize("name", MESHES)
def test_nodes_for_packets_have_every_leaf_once(name):
    bvh = build_bvh(MESHES[name])
    nodes = wide_nodes(bvh)
    leaves, boxes, places = [], [], [0]
    for place in places:
        record = nodes.table[place]
        low, high = record[:TAGS].view(np.float32).reshape(2, 3, WIDTH).transpose(0, 2, 1)
        tags, firsts = record[TAGS:FIRST].reshape(WIDTH), record[FIRST].astype(int)
        for k in np.flatnonzero((low <= high).all(axis=1)):
            number = firsts[int(tags[k] >= LEAF)] + int(tags[k]) % LEAF
            if tags[k] < LEAF:
                assert number > place
                places.append(number)
                continue
            leaves.append(number)
            boxes.append([low[k], high[k]])
            leaf = nodes.leaves[number]
            np.testing.assert_array_equal(boxes[-1], [bvh.low[leaf], bvh.high[leaf]])
    assert sorted(leaves) == list(range(len(nodes.leaves)))
    assert sorted(nodes.leaves) == np.flatnonzero(bvh.links[0, :, 0] < 0).tolist()
    assert max(places) <= nodes.last
