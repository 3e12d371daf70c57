"""`RayMeshIntersector` against trimesh's own methods, in its place."""

import copy
import itertools
import pickle
from functools import cache

import numpy as np
import pytest
import trimesh
from trimesh.ray.ray_triangle import RayMeshIntersector as Theirs

from raytracer import Mesh, SceneError
from raytracer.compat import RayMeshIntersector

SHAPES = {
    "ball": trimesh.creation.icosphere(2),
    "ring": trimesh.creation.annulus(0.5, 1.0, 0.7),
    "two boxes": trimesh.util.concatenate(
        [trimesh.creation.box((1, 2, 3)), trimesh.creation.box((0.5, 0.5, 0.5)).apply_translation((2, 0, 0))]
    ),
}


class EveryTriangle:
    """In place of the tree of rtree, which may not be installed: all triangles are candidates."""

    def __init__(self, mesh):
        self.bounds, self.all = mesh.bounds.reshape(-1), range(len(mesh.faces))

    def intersection(self, _):
        return self.all


def theirs(mesh):
    mesh = mesh.copy()
    mesh._cache["triangles_tree"] = EveryTriangle(mesh)
    return Theirs(mesh)


def rays(count=300):
    rng = np.random.default_rng(1)
    origins = rng.normal(size=(count, 3)) * 2
    return origins, rng.normal(size=(count, 3)) * 0.7 - origins


def by_ray(triangle, ray, *more):
    order = np.lexsort((triangle, ray))
    return [part[order] for part in (triangle, ray, *more)]


@cache
def answers(name):
    """Return trimesh's own answers: of a method, and the points inside."""
    expected, points = theirs(SHAPES[name]), np.random.default_rng(2).uniform(*SHAPES[name].bounds, (500, 3))
    method = cache(lambda method, **more: getattr(expected, method)(*rays(), **more))
    return method, points, expected.contains_points(points)


@pytest.mark.sampled(12)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
@pytest.mark.parametrize("name", SHAPES)
def test_answers_are_trimeshs(name, backend):
    mesh = SHAPES[name].copy()
    mesh.ray = RayMeshIntersector(mesh, backend=backend)
    expected, points, points_inside = answers(name)
    origins, directions = rays()
    ours, other = mesh.ray.intersects_id(origins, directions), expected("intersects_id")
    for one, two in zip(by_ray(*ours), by_ray(*other), strict=True):
        assert one.dtype == two.dtype
        np.testing.assert_array_equal(one, two)
    assert len(ours[0]) > 300
    for more in ({}, {"multiple_hits": False}):
        at, ray, triangle = mesh.ray.intersects_location(origins, directions, **more)
        at_2, ray_2, triangle_2 = expected("intersects_location", **more)
        for one, two in zip(by_ray(triangle, ray, at), by_ray(triangle_2, ray_2, at_2), strict=True):
            np.testing.assert_allclose(one, two, atol=1e-9)
    for method in ("intersects_first", "intersects_any"):
        one, two = getattr(mesh.ray, method)(origins, directions), expected(method)
        assert one.dtype == two.dtype
        np.testing.assert_array_equal(one, two)
    inside = mesh.contains(points)
    np.testing.assert_array_equal(inside, points_inside)
    assert 10 < inside.sum() < 490


def test_hits_come_in_order_and_no_more_than_asked_for():
    mesh = SHAPES["ring"]
    shoot = RayMeshIntersector(mesh, "numpy")
    origins, directions = (
        np.array([[3.0, 0.1, 0], [9, 9, 9], [-3, 0.05, 0.1]]),
        np.array([[-1.0, 0, 0]] * 2 + [[1, 0, 0]]),
    )
    at, ray, _ = shoot.intersects_location(origins, directions)
    assert ray.tolist() == [0] * 4 + [2] * 4
    assert np.all(np.diff(at[:4, 0]) < 0)
    assert np.all(np.diff(at[4:, 0]) > 0)
    for locations in (False, True):
        _, few, *_ = shoot.intersects_id(origins, directions, locations, max_hits=3)
        assert few.tolist() == [0] * 3 + [2] * 3


def test_a_hit_on_an_edge_is_one_location_and_two_triangles():
    shoot = RayMeshIntersector(trimesh.creation.box(), "numpy")
    ray = [[0.0, 0, 3]], [[0.0, 0, -1]]
    assert len(shoot.intersects_id(*ray)[0]) == 4
    np.testing.assert_allclose(shoot.intersects_location(*ray)[0], [[0, 0, 0.5], [0, 0, -0.5]])


def cube_without_an_octant(size):
    """Return the cube [-size, size]^3 without the octant of positive coordinates."""
    cells = set(itertools.product((0, 1), repeat=3)) - {(1, 1, 1)}
    triangles = []
    for cell, axis, side in itertools.product(sorted(cells), range(3), (0, 1)):
        neighbour = tuple(np.add(cell, np.eye(3, dtype=int)[axis] * (2 * side - 1)))
        if neighbour not in cells:
            u, v = (np.eye(3)[(axis + turn) % 3] for turn in ((1, 2) if side else (2, 1)))
            corner = cell + np.eye(3)[axis] * side
            triangles += [[corner, corner + u, corner + u + v], [corner, corner + u + v, corner + v]]
    return trimesh.Trimesh(**trimesh.triangles.to_kwargs((np.array(triangles) - 1) * size))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_points_in_the_planes_of_faces_and_edges_are_inside_or_outside(backend):
    """Points in the planes of faces, and rays through edges, where a parity of hits would go wrong."""
    mesh = cube_without_an_octant(20.0)
    assert mesh.is_watertight
    points = np.array(list(itertools.product(np.arange(-30, 31, 5.0), repeat=3)))
    inside = (abs(points) < 20).all(1) & (points < 0).any(1)
    outside = (abs(points) > 20).any(1) | (points > 0).all(1)
    not_on_the_surface = inside | outside
    contained = RayMeshIntersector(mesh, backend).contains_points(points[not_on_the_surface])
    np.testing.assert_array_equal(contained, inside[not_on_the_surface])


def test_primitives_that_trimesh_constructs_have_our_queries(monkeypatch):
    """trimesh makes the intersector of a primitive before the primitive can compute its vertices."""
    made = []

    def ours(mesh):
        made.append(RayMeshIntersector(mesh, "numpy"))
        return made[-1]

    monkeypatch.setattr("trimesh.ray.has_embree", False)
    monkeypatch.setattr("trimesh.ray.ray_triangle.RayMeshIntersector", ours)
    ray = [[0.1, 0.2, 9]], [[0.0, 0, -1]]
    box = trimesh.primitives.Box(extents=(2, 2, 2))
    shapes = [box, trimesh.primitives.Sphere(), trimesh.primitives.Cylinder(radius=1, height=2)]
    shapes += [trimesh.primitives.Capsule(), trimesh.creation.icosphere().bounding_box]
    assert len(made) >= len(shapes)
    for shape in shapes:
        assert shape.ray in made
        assert shape.ray.intersects_any(*ray).all()
        assert shape.contains([[0, 0, 0.3], [0, 0, 8]]).tolist() == [True, False]
    assert box.ray.intersects_location(*ray)[0][0] == pytest.approx([0.1, 0.2, 1])
    box.primitive.extents = (2, 2, 6)
    assert box.ray.intersects_location(*ray)[0][0] == pytest.approx([0.1, 0.2, 3])


def test_a_changed_mesh_is_seen():
    mesh = trimesh.creation.box()
    mesh.ray = RayMeshIntersector(mesh, "numpy")
    ray = [[0.1, 0.2, 9]], [[0.0, 0, -1]]
    assert mesh.ray.intersects_location(*ray, multiple_hits=False)[0][0, 2] == pytest.approx(0.5)
    mesh.apply_scale(3)
    assert mesh.ray.intersects_location(*ray, multiple_hits=False)[0][0, 2] == pytest.approx(1.5)


def test_copies_answer_for_their_own_mesh():
    mesh = trimesh.creation.box()
    mesh.ray = RayMeshIntersector(mesh, "numpy")
    ray = [[0.1, 0.2, 9]], [[0.0, 0, -1]]
    assert mesh.ray.intersects_any(*ray)[0]
    for other in (pickle.loads(pickle.dumps(mesh)), copy.deepcopy(mesh)):
        other.apply_translation((5, 0, 0))
        assert isinstance(copy.copy(mesh.ray), RayMeshIntersector)
        if isinstance(other.ray, RayMeshIntersector):
            assert not other.ray.intersects_any(*ray)[0]
    assert mesh.ray.intersects_any(*ray)[0]


def test_no_rays_no_hits_and_no_mesh():
    shoot = RayMeshIntersector(trimesh.creation.box(), "numpy")
    nothing = np.zeros((0, 3))
    assert [part.shape for part in shoot.intersects_location(nothing, nothing)] == [(0, 3), (0,), (0,)]
    assert [part.shape for part in shoot.intersects_location([[9.0, 9, 9]], [[1.0, 0, 0]])] == [(0, 3), (0,), (0,)]
    assert shoot.intersects_first([[9.0, 9, 9]], [[1.0, 0, 0]]).tolist() == [-1]
    empty = RayMeshIntersector(Mesh(np.zeros((0, 3)), []), "numpy")
    assert len(empty.intersects_location([[0.0, 0, 0]], [[1.0, 0, 0]])[0]) == 0
    with pytest.raises(SceneError, match=r"takes a trimesh\.Trimesh, not ndarray"):
        RayMeshIntersector(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="length zero"):
        shoot.intersects_first([[0.0, 0, 0]], [[0.0, 0, 0]])


@pytest.mark.parametrize("shape", [(3,), (2, 4, 3)])
def test_rays_in_other_shapes_are_refused_and_the_cure_works(shape):
    queries = RayMeshIntersector(SHAPES["ball"], backend="numpy")
    origins, directions = np.full(shape, 2.0), np.full(shape, -1.0)
    for name in ("intersects_location", "intersects_id", "intersects_first", "intersects_any"):
        ask = getattr(queries, name)
        with pytest.raises(SceneError) as error:
            ask(origins, directions)
        assert str(error.value) == (f"origins have the shape (N, 3), not {shape}: give np.reshape(origins, (-1, 3))")
        with pytest.raises(SceneError, match=r"directions have the shape \(N, 3\)"):
            ask(np.reshape(origins, (-1, 3)), directions)
        assert len(ask(np.reshape(origins, (-1, 3)), np.reshape(directions, (-1, 3)))[0:1]) == 1
