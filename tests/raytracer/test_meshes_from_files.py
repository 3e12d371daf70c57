"""Real meshes, where they are at hand: the same picture everywhere, hits as brute force has them, fast to prepare."""

from pathlib import Path

import numpy as np
import pytest
from effort import calls
from oracle import closest

from raytracer import Intersector, Mesh, Renderer, Scene, SceneError
from raytracer.accel.bounds import FAR
from raytracer.accel.grid import build_grid
from raytracer.accel.ploc import build_bvh
from raytracer.accel.space import triangle_rows
from raytracer.kernels import queries
from raytracer.kernels.bvh_walk import BvhIntersector
from raytracer.kernels.grid_walk import GridIntersector
from raytracer.kernels.wide_walk import WideIntersector
from raytracer.meshes.shapes import knot
from raytracer.scene.layout import Layout

MODELS = Path(__file__).resolve().parents[3] / "shared" / "models"
TRIANGLES = {"stanford-bunny": 69_451, "teapot": 6_320, "spot": 5_856}


@pytest.fixture(params=TRIANGLES)
def scene(request):
    path = MODELS / f"{request.param}.obj"
    if not path.exists():
        pytest.skip(f"needs the mesh {path}")
    return Scene.load(path)


@pytest.mark.slow
def test_a_real_mesh_is_the_same_picture_on_every_backend(scene):
    assert len(scene.meshes[0]) == TRIANGLES[scene.name]
    images = [Renderer(scene, backend=b, bounces=2).render((96, 96)) for b in ("numpy", "opencl", "glsl")]
    assert 0.1 < (images[0].object_id == 0).mean() < 0.6
    for image in images[1:]:
        difference = np.abs(image.pixels - images[0].pixels).max(axis=-1)
        assert (difference <= 1 / 255).mean() >= 0.999
        assert (image.object_id == images[0].object_id).mean() >= 0.999


@pytest.mark.sampled(3)
def test_hits_on_a_real_mesh_are_those_of_brute_force(scene):
    mesh = scene.meshes[0]
    rng = np.random.default_rng(7)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    origins = rng.normal(size=(100, 3))
    origins = (low + high) / 2 + np.linalg.norm(high - low) * origins / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = rng.uniform(low, high, (100, 3)) - origins
    corners = mesh.corners.astype(np.float32).astype(float)
    t, triangle, _, _ = closest(corners, origins, directions)
    hits = Intersector(mesh, backend="opencl").intersect(origins, directions)
    assert (triangle >= 0).mean() > 0.1
    agree = (hits.triangle == triangle) | np.isclose(hits.t, t, rtol=1e-5)
    assert agree.mean() >= 0.99


def test_triangles_cost_no_calls():
    """From the scene to the kernel, ten times the triangles take a few calls more, for levels of the hierarchy."""
    few, many = (Scene.framed(knot(segments=segments, sides=50)) for segments in (70, 700))
    for scene in (few, many):  # compiles their kernel, and those that build a large hierarchy
        Renderer(scene, backend="numpy", bounces=2)
    found = [calls(lambda scene=scene: Renderer(scene, backend="numpy", bounces=2)) for scene in (few, many)]
    assert found[1] < 1.5 * found[0]
    assert Layout.of(many).triangles.shape == (3 * 70_002, 4)


@pytest.mark.slow
def test_every_walk_through_a_real_mesh_hits_the_same(scene):
    """From the eye, and on from what was hit, to the bit."""
    mesh = scene.meshes[0]
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    rng = np.random.default_rng(6)
    eye = np.tile((low + high) / 2 + np.multiply([0.3, 0.4, 1.5], (high - low).max()), (3000, 1))
    ray = rng.uniform(low, high, (3000, 3)) - eye
    structure, rows = build_bvh(mesh.corners), triangle_rows(mesh.corners)
    walks = [BvhIntersector(structure, rows, together=True), WideIntersector(structure, rows)]
    walks.append(GridIntersector(build_grid(mesh.corners.astype(np.float32)), rows))
    together, alone, grid = (queries.intersect(walk, exact=True) for walk in walks)
    kernels = [together.compile("opencl", lanes=16, loop_limit=None), grid.compile("opencl", loop_limit=None)]
    kernels += [alone.compile("opencl", lanes=1, loop_limit=None)]
    if scene.name == "teapot":
        kernels += [together.compile("opencl", lanes=lanes, loop_limit=None) for lanes in (1, 4, 8)]
        kernels += [together.compile(backend, loop_limit=None) for backend in ("numpy", "glsl")]
    for _ in range(2):
        ray = (ray / np.linalg.norm(ray, axis=1, keepdims=True)).astype(np.float32)
        first, *others = (kernel(eye, ray, 0.0, FAR, (0, 0, 0), 1.0) for kernel in kernels)
        assert (first.triangle >= 0).sum() > 400
        for other in others:
            for ours, theirs in zip(first, other, strict=True):
                np.testing.assert_array_equal(ours, theirs)
        hit = first.triangle >= 0
        normal = mesh.face_normals[first.triangle[hit]]
        normal *= -np.sign(np.sum(normal * ray[hit], axis=1, keepdims=True))
        eye = eye[hit] + first.t[hit, None] * ray[hit] + 1e-4 * (high - low).max() * normal
        ray = rng.normal(size=eye.shape)


@pytest.mark.slow
def test_a_million_hits_through_cubes_are_those_of_the_hierarchy(scene):
    mesh, rng = scene.meshes[0], np.random.default_rng(4)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    origins = rng.uniform(low - (high - low) / 5, high + (high - low) / 5, (1_000_000, 3))
    directions = mesh.corners[rng.integers(0, len(mesh), 1_000_000)].mean(axis=1) - origins
    exact = Intersector(mesh, backend="opencl").intersect(origins, directions)
    assert (exact.triangle >= 0).mean() > 0.9
    for resolution in (64, 512):
        found = Intersector(mesh, f"ldc:{resolution}:triangle", "opencl").intersect(origins, directions)
        for ours, theirs in zip(found, exact, strict=True):
            np.testing.assert_array_equal(ours, theirs)


STRIPS = """ply
format ascii 1.0
element vertex 5
property float x
property float y
property float z
element tristrips {count}
property list int int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
1 1 0
2 0 0
{strips}
"""


@pytest.mark.parametrize(
    ("count", "strips"),
    [
        (1, "9 0 1 2 3 -1 1 4 3 -1"),
        (1, "8 0 1 2 3 -1 1 4 3"),
        (2, "4 0 1 2 3\n3 1 4 3"),
        (1, "10 0 1 2 3 -1 0 -1 1 4 3"),
    ],
)
def test_strips_of_a_ply_file(tmp_path, count, strips):
    """All triangles face z; a strip begins after a negative number."""
    path = tmp_path / "strips.ply"
    path.write_text(STRIPS.format(count=count, strips=strips))
    mesh = Mesh.load(path)
    sides = np.diff(mesh.corners, axis=1)
    np.testing.assert_allclose(np.cross(sides[:, 0], sides[:, 1]), [[0, 0, 1]] * 3)


def test_a_strip_that_names_a_vertex_that_is_not_there(tmp_path):
    path = tmp_path / "strips.ply"
    path.write_text(STRIPS.format(count=1, strips="3 0 1 7"))
    with pytest.raises(SceneError, match="a strip names vertex 7, and there are 5"):
        Mesh.load(path, strict=True)
