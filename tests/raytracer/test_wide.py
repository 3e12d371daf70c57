"""Four boxes a node, four triangles a leaf: everything is there once, and in its box."""

import numpy as np
import pytest
from test_bvh import MESHES

from raytracer.accel.bvh import build_bvh
from raytracer.accel.wide import BASES, BLOCKS_FROM, LEAF, NUMBERS, TAGS, WIDTH, widen


def boxes_of(wide):
    """(node, low, high, code) of every box that is there."""
    for node, rows in enumerate(wide.nodes):
        low, high = rows[:3].view(np.float32).T, rows[3:6].view(np.float32).T
        inner, leaves, *_ = rows[BASES].view(np.int32).tolist()
        for k in np.flatnonzero((low <= high).all(axis=1)):
            tag = int(rows[TAGS, k])
            yield node, low[k], high[k], (leaves if tag & LEAF else inner) + tag % WIDTH


def held_by(wide, code):
    """The corners (n, 3) of the triangles in a leaf, or of the boxes in a node."""
    if code < 0:
        rows = wide.blocks[code - BLOCKS_FROM]
        there = rows[NUMBERS].view(np.int32) >= 0
        return rows[:NUMBERS].view(np.float32).reshape(3, 3, WIDTH)[..., there].transpose(0, 2, 1).reshape(-1, 3)
    sides = wide.nodes[code, :TAGS].view(np.float32).reshape(2, 3, WIDTH)
    there = (sides[0] <= sides[1]).all(axis=0)
    return sides[..., there].transpose(0, 2, 1).reshape(-1, 3)


@pytest.mark.parametrize("name", MESHES)
def test_everything_is_there_once_and_in_its_box(name):
    corners = MESHES[name].astype(np.float32)
    wide = widen(build_bvh(corners), corners)
    numbers = wide.blocks[:, NUMBERS].view(np.int32)
    assert sorted(numbers[numbers >= 0].tolist()) == list(range(len(corners)))
    for block, items in zip(wide.blocks, numbers, strict=True):
        held = block[:NUMBERS].view(np.float32).reshape(9, WIDTH).T
        np.testing.assert_array_equal(held[items >= 0], corners[items[items >= 0]].reshape(-1, 9))
    met = [0]
    for node, low, high, code in boxes_of(wide):
        assert code < 0 or code > node
        assert np.all((low <= held_by(wide, code)) & (held_by(wide, code) <= high))
        met.append(code)
    assert sorted(code for code in met if code >= 0) == list(range(len(wide.nodes)))
    assert sorted(code - BLOCKS_FROM for code in met if code < 0) == list(range(len(wide.blocks)))


def test_nodes_and_blocks_are_full():
    corners = MESHES["ball"]
    wide = widen(build_bvh(corners), corners)
    assert len(list(boxes_of(wide))) > 0.7 * WIDTH * len(wide.nodes)
    assert (wide.blocks[:, NUMBERS].view(np.int32) >= 0).mean() > 0.7
    assert wide.depth < 8
