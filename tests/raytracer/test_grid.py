"""The grid lists every triangle in every cell it touches, wastes little, and is built fast."""

import numpy as np
import pytest
from effort import calls

from raytracer.accel.grid import build_grid
from raytracer.meshes.shapes import box, floor, knot, sphere


def listed(grid):
    """The set of (cell number, triangle) of a grid."""
    spans = grid.cells.reshape(-1, 2)
    return {(cell, int(k)) for cell, (a, b) in enumerate(spans) for k in grid.items[a:b]}


def cells_of_points(grid, points):
    cell = np.floor((points - grid.low) / grid.cell).astype(int)
    assert np.all((cell >= 0) & (cell < grid.shape))
    return cell[:, 0] + grid.shape[0] * (cell[:, 1] + grid.shape[1] * cell[:, 2])


def random_triangles(count, size, seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(0, size, (count, 3, 3))


@pytest.mark.parametrize("size", [0.003, 0.05, 0.3])
def test_every_point_of_a_triangle_lies_in_a_cell_that_lists_it(size):
    triangles = random_triangles(400, size, 1)
    grid = build_grid(triangles)
    pairs = listed(grid)
    rng = np.random.default_rng(2)
    outside = set(grid.items[: grid.outside].tolist())
    for _ in range(60):
        w = rng.dirichlet([0.4, 0.4, 0.4], len(triangles))  # many near edges and corners
        points = np.einsum("nk,nkd->nd", w, triangles)
        inside = [k for k in range(len(triangles)) if k not in outside]
        for k, cell in zip(inside, cells_of_points(grid, points[inside]), strict=True):
            assert (cell, k) in pairs


def test_few_cells_are_listed_in_vain():
    """A cell that lists a triangle is really touched by it: checked by clipping against the grown cell."""
    triangles = random_triangles(150, 0.25, 3)
    grid = build_grid(triangles)
    for cell, k in listed(grid):
        x, y, z = cell % grid.shape[0], cell // grid.shape[0] % grid.shape[1], cell // (grid.shape[0] * grid.shape[1])
        low = grid.low + np.array([x, y, z]) * grid.cell
        polygon = list(triangles[k])
        for axis in range(3):
            for sign, bound in ((1, low[axis] - 0.01 * grid.cell[axis]), (-1, low[axis] + 1.01 * grid.cell[axis])):
                polygon = clip(polygon, axis, sign, bound)
        assert polygon, f"cell {cell} lists triangle {k} in vain"


def clip(polygon, axis, sign, bound):
    kept = []
    for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        dp, dq = sign * (p[axis] - bound), sign * (q[axis] - bound)
        if dp >= 0:
            kept.append(p)
        if dp * dq < 0:
            kept.append(p + (q - p) * dp / (dp - dq))
    return kept


def test_lists_ascend_and_cover_the_items():
    grid = build_grid(sphere().corners)
    spans = grid.cells.reshape(-1, 2)
    assert spans[0, 0] == grid.outside
    assert spans[-1, 1] == len(grid.items)
    np.testing.assert_array_equal(spans[1:, 0], spans[:-1, 1])
    for a, b in spans:
        assert np.all(np.diff(grid.items[a:b]) > 0)


def test_a_floor_stands_outside_and_leaves_the_cells_fine():
    mesh, ground = knot(segments=100, sides=20), floor(100).moved((0, -2, 0))
    grid = build_grid(np.concatenate([mesh.corners, ground.corners]))
    assert grid.outside == 2
    assert sorted(grid.items[:2].tolist()) == [len(mesh), len(mesh) + 1]
    assert np.all(grid.cell < 0.3)


@pytest.mark.parametrize(
    "corners",
    [
        np.zeros((0, 3, 3)),
        np.zeros((20, 3, 3)),
        np.full((20, 3, 3), 7.0),
        np.repeat(floor(1).corners, 20, axis=0),
        box().corners * [1, 1e-9, 1e9],
        random_triangles(50, 0.1, 4) * 1e-30,
        random_triangles(50, 0.1, 4) + 1e6,
    ],
    ids=["none", "points at the origin", "points", "flat", "needle", "tiny", "far away"],
)
def test_odd_triangles_make_a_grid(corners):
    grid = build_grid(corners)
    assert np.all(grid.cell > 0)
    assert np.all(np.isfinite(grid.cell))
    assert set(grid.items.tolist()) == set(range(len(corners)))


def test_a_grid_of_seventy_thousand_triangles_is_built_with_arrays():
    """Ten times the triangles take as many calls, but for parts of arrays that fit into memory."""
    few, many = (knot(segments=segments, sides=50).corners for segments in (70, 700))
    assert len(many) == 70_000
    assert calls(lambda: build_grid(many)) < 2 * calls(lambda: build_grid(few))
    assert build_grid(many).bytes < 20e6
