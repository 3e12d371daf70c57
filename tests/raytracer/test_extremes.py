"""Rays at the extremes: edges and corners of closed meshes, slivers, far away, self-hits, long walks through cells."""

import dataclasses
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import pytest
from oracle import closest

import shpy as sh
from raytracer import Camera, Intersector, Material, Mesh, PointLight, Renderer, Scene, SceneError, render
from raytracer.accel.bounds import FAR
from raytracer.accel.space import triangle_rows
from raytracer.kernels.grid_walk import CellBox, CellWalk
from raytracer.kernels.interactions import blank
from raytracer.kernels.surfaces import SurfaceTables
from raytracer.kernels.triangle import AheadBound, RayHit, Triangles, TriangleTest
from raytracer.kernels.walk import walk_with
from raytracer.meshes.shapes import box, icosahedron, sphere
from raytracer.scene.layout import Layout
from shpy import SH_WHILE

BACKENDS = ["numpy", "opencl", "glsl"]
CLOSED = {"ball": sphere(rings=24, segments=48), "icosahedron": icosahedron(), "box": box()}
FAR_AWAY = [(0, 0, 0), (1e4, 0, -1e4), (1e6, 1e6, 1e6), (148376, 1234, -223423)]
UNIT = 2.0**-24
"""The largest relative error of one rounding in f32."""


def f32(values):
    return np.asarray(values, np.float32).astype(float)


def standing_at(mesh, offset):
    """The mesh there, its vertices rounded; a hundred times as large where floats lie too far apart for its size."""
    return Mesh(f32(mesh.vertices * (100 if max(map(abs, offset)) > 1e5 else 1) + np.array(offset)), mesh.faces)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("accel", ["bvh", "grid"])
@pytest.mark.parametrize("name", CLOSED)
def test_no_ray_leaves_a_closed_mesh(name, accel):
    """From inside, at corners, at edges and anywhere: none of 15,000 rays may miss."""
    for offset in FAR_AWAY:
        mesh = standing_at(CLOSED[name], offset)
        origins, directions = at_edges(mesh, 15_000)
        hits = Intersector(mesh, accel=accel, backend="opencl").intersect(origins, directions)
        assert np.count_nonzero(hits.triangle < 0) == 0, offset


def at_edges(mesh, count):
    """Rays from near the middle of a mesh to corners, to points of edges, and to any points of triangles."""
    rng = np.random.default_rng(7)
    weights = rng.random((count, 3))
    weights[::3] = np.eye(3)[rng.integers(0, 3, len(weights[::3]))]
    weights[1::3][np.arange(len(weights[1::3])), rng.integers(0, 3, len(weights[1::3]))] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    corners = mesh.vertices[mesh.faces[rng.integers(0, len(mesh.faces), count)]]
    size = np.ptp(mesh.vertices, axis=0).min()
    origins = f32(mesh.vertices.mean(axis=0) + rng.uniform(-0.15, 0.15, (count, 3)) * size)
    directions = (weights[:, :, None] * corners).sum(axis=1) - origins
    return origins, directions


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_rays_at_the_corners_and_in_the_sides_of_boxes_hit_what_they_hit_without_boxes(backend):
    """Triangles on the sides of a lattice of cubes, so that boxes begin and end where rays run."""
    rng = np.random.default_rng(3)
    corners = rng.integers(0, 4, (120, 3, 3)) / 2.0
    mesh = Mesh(corners.reshape(-1, 3), np.arange(360).reshape(-1, 3))
    targets = rng.integers(0, 4, (3000, 3)) / 2.0
    origins = rng.integers(-2, 6, (3000, 3)) / 2.0
    origins[::2] += rng.normal(size=origins[::2].shape)
    directions = targets - origins
    some = np.any(directions != 0, axis=1)
    origins, directions = f32(origins[some]), directions[some]
    found = {
        accel: Intersector(mesh, accel=accel, backend=backend).intersect(origins, directions)
        for accel in ("bvh", "grid", "brute")
    }
    assert np.count_nonzero(found["brute"].triangle >= 0) > 500
    for accel in ("bvh", "grid"):
        np.testing.assert_array_equal(found[accel].triangle >= 0, found["brute"].triangle >= 0)
    np.testing.assert_array_equal(found["bvh"].t, found["brute"].t)


class _Met(NamedTuple):
    t: sh.Attrib1f
    met: sh.Attrib1b


def triangle_test(triangles):
    """The program that tries ray k against triangle k."""
    rows = Triangles(triangle_rows(triangles))

    @sh.program
    def tried(k: sh.Attrib1i, eye: sh.Point3f, ray: sh.Vector3f) -> _Met:
        hit = RayHit(FAR)
        TriangleTest(ray, eye)(rows, k, 0.0, hit)
        met = sh.Attrib1b(hit.id >= 0)
        return _Met(hit.l, met)

    return tried


def exact(triangle, eye, ray):
    """Return whether and where a ray meets a triangle, in rationals, and how far inside its edges, as a share.

    The last is the least distance of the ray from an edge line, as seen along the ray's largest component, over the
    largest coordinate of a corner as seen from the eye: below a few roundings nobody who computes in f32 can tell.
    """
    axis = int(np.argmax(np.abs(ray)))
    x, y = (axis + 1) % 3, (axis + 2) % 3
    eye, ray = [Fraction(float(c)) for c in eye], [Fraction(float(c)) for c in ray]
    corners = [[Fraction(float(c)) - e for c, e in zip(corner, eye, strict=True)] for corner in triangle]
    seen = [(c[x] - ray[x] / ray[axis] * c[axis], c[y] - ray[y] / ray[axis] * c[axis]) for c in corners]
    w = []
    clear = np.inf
    scale = max(abs(float(v)) for c in corners for v in c)
    for (bx, by), (cx, cy) in ((seen[1], seen[2]), (seen[2], seen[0]), (seen[0], seen[1])):
        w.append(bx * cy - by * cx)
        length = np.hypot(float(bx - cx), float(by - cy))
        clear = min(clear, abs(float(w[-1])) / length / scale if length else 0.0)
    whole = sum(w)
    inside = whole != 0 and (all(v >= 0 for v in w) or all(v <= 0 for v in w))
    t = sum(v * c[axis] for v, c in zip(w, corners, strict=True)) / (whole * ray[axis]) if whole else Fraction(0)
    return inside, t, clear, scale


def slivers(rng, count):
    """Triangles of sizes 1e-6 to 1e6, down to a ten-millionth as thick as long; rays at them, some nearly edge-on."""
    size = 10 ** rng.uniform(-6, 6, (count, 1))
    a = rng.normal(size=(count, 3)) * size
    along = rng.normal(size=(count, 3)) * size
    across = rng.normal(size=(count, 3)) * size * 10 ** rng.uniform(-7, 0, (count, 1))
    triangles = f32(np.stack([a, a + along, a + along * rng.random((count, 1)) + across], axis=1))
    weights = rng.dirichlet([1, 1, 1], count)
    target = (weights[:, :, None] * triangles).sum(axis=1)
    direction = rng.normal(size=(count, 3))
    normal = np.cross(along, across)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    grazing = along / np.linalg.norm(along, axis=1, keepdims=True) + 1e-4 * normal
    direction[::3] = grazing[::3]
    eye = f32(target - direction * size * 10 ** rng.uniform(-1, 1, (count, 1)))
    ray = target - eye
    length = np.linalg.norm(ray, axis=1, keepdims=True)
    return triangles, eye, f32(ray / np.where(length > 0, length, 1))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_slivers_are_met_as_rationals_say(backend):
    """Wrong only for rays within 16 roundings of an edge; the distance to within the same of the largest coordinate."""
    triangles, eye, ray = slivers(np.random.default_rng(11), 600)
    t, met = triangle_test(triangles).compile(backend)(np.arange(len(eye)), eye, ray)
    assert np.all(np.isfinite(t))
    decided = 0
    for k in range(len(eye)):
        inside, distance, clear, _ = exact(triangles[k], eye[k], ray[k])
        if clear > 16 * UNIT and (distance > 0 or not inside):
            assert met[k] == inside, (triangles[k], eye[k], ray[k])
            decided += 1
            if inside:  # along the ray the triangle reaches from its nearest corner to its farthest
                depths = (triangles[k] - eye[k]) @ ray[k]
                slack = 32 * UNIT * np.abs(triangles[k] - eye[k]).max() + 2.0**-11 * abs(float(distance))
                assert depths.min() - slack <= t[k] <= depths.max() + slack
    assert decided > 200


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_what_is_no_triangle_or_no_number_is_missed(backend):
    """Degenerate, duplicate and denormal triangles: a hit or a miss, the same with every accelerator."""
    rng = np.random.default_rng(5)
    good = rng.normal(size=(40, 3, 3))
    point = np.repeat(rng.normal(size=(20, 1, 3)), 3, axis=1)
    line = point + np.array([0, 1, 2])[:, None] * rng.normal(size=(20, 1, 3))
    tiny = rng.normal(size=(20, 3, 3)) * 1e-41
    corners = np.concatenate([good, point, line, tiny, good[:10]])
    mesh = Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    origins = f32(rng.normal(size=(4000, 3)) * 3)
    directions = f32(corners[rng.integers(0, len(corners), 4000)].mean(axis=1) - origins)
    found = {a: Intersector(mesh, accel=a, backend=backend).intersect(origins, directions) for a in ("bvh", "brute")}
    for hits in found.values():
        assert not np.any(np.isnan(hits.t))
        assert not np.any(np.isnan(hits.u) | np.isnan(hits.v))
        assert np.all(np.isinf(hits.t) == (hits.triangle < 0))
        assert np.all((hits.triangle < 40) | (hits.triangle >= 60))  # a duplicate is known by its first number
    np.testing.assert_array_equal(found["bvh"].triangle, found["brute"].triangle)
    np.testing.assert_array_equal(found["bvh"].t, found["brute"].t)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("accel", ["bvh", "grid"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_rays_that_are_no_rays_miss(backend, accel):
    """NaN, infinite and zero directions, NaN and infinite origins, between rays that hit: theirs do not change."""
    scene = Scene([sphere(rings=12, segments=24)])
    layout = Layout.of(scene, accel)
    walk = walk_with(layout.structure, layout.triangles, backend)

    @sh.program
    def nearest(eye: sh.Point3f, ray: sh.Vector3f) -> _Met:
        hit = walk(ray, eye, sh.Attrib1f(0), sh.Attrib1f(FAR), sh.Attrib1b(False))
        met = sh.Attrib1b(hit.id >= 0)
        return _Met(hit.l, met)

    rng = np.random.default_rng(2)
    eye = np.tile([0.0, 0.1, 4.0], (4096, 1))
    ray = rng.normal(size=(4096, 3)) * 0.3 + [0, 0, -4]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    kernel = nearest.compile(backend)
    t, met = kernel(eye, ray)
    assert met.mean() > 0.3
    bad = rng.permutation(4096)[:400]
    kinds = [[np.nan] * 3, [np.nan, 0, -1], [0, 0, 0], [np.inf, 0, -1], [0, 0, -np.inf], [-np.inf] * 3]
    ray[bad] = np.array(kinds)[np.arange(400) % len(kinds)]
    eye[bad[::7]] = np.nan
    eye[bad[3::7]] = np.inf
    t_now, met_now = kernel(eye, ray)
    assert not met_now[bad].any()
    good = np.setdiff1d(np.arange(4096), bad)
    np.testing.assert_array_equal(t_now[good], t[good])
    np.testing.assert_array_equal(met_now[good], met[good])


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_triangle_far_smaller_than_the_scene_is_met_as_it_is_alone(backend):
    """10**20 times smaller: the same triangles, at distances that differ by rounding only."""
    rng = np.random.default_rng(0)
    small = rng.normal(size=(200, 3, 3)) * 1e-20
    target = (rng.dirichlet([1, 1, 1], 200)[:, :, None] * small).sum(axis=1)
    origins = target + rng.normal(size=(200, 3)) * 1e-20
    found = []
    for others in (np.zeros((0, 3, 3)), np.array([[[1.0, 1, 1], [1, -1, 1], [-1, 1, 1]]])):
        corners = np.concatenate([small, others])
        mesh = Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
        found.append(Intersector(mesh, accel="brute", backend=backend).intersect(origins, target - origins))
    alone, beside = found
    np.testing.assert_array_equal(beside.triangle, alone.triangle)
    np.testing.assert_allclose(beside.t, alone.t, rtol=1e-3)


@pytest.mark.parametrize("size", [1e-300, 1e-305, 1e-310])
def test_a_mesh_near_the_end_of_f64_is_met(size):
    cube = box()
    shoot = Intersector(Mesh(cube.vertices * size, cube.faces), backend="numpy")
    hits = shoot.intersect(np.array([[0.1, 0.2, 3]]) * size, [[0, 0, -size]])
    np.testing.assert_allclose(hits.t, 2.5, rtol=1e-5)


@pytest.mark.parametrize(
    ("light", "camera", "said"), [(5, 4e-29, r"light at \(0, 0, 5\)"), (5e-29, 4, r"camera at \(0, 0, 4\)")]
)
def test_what_stands_too_far_away_for_f32_is_named(light, camera, said):
    cube = box()
    lights, seen_from = [PointLight((0, 0, light))], Camera((0, 0, camera), (0, 0, 0))
    tiny = Scene([Mesh(cube.vertices * 1e-29, cube.faces)], lights, seen_from)
    with pytest.raises(SceneError, match=f"the {said} is too far away for a scene of this size, in floats of 32 bits"):
        render(tiny, (4, 4), backend="numpy")


def test_a_scene_too_small_for_lengths_in_f32_is_told():
    cube, seen_from = box(), Camera((0, 0, 4e-30))
    cubes = [Mesh(cube.vertices * 1e-30, cube.faces, material=Material(transmission=x)) for x in (0, 0.5)]
    assert (render(Scene(cubes[0], camera=seen_from), (4, 4), backend="numpy").object_id == 0).any()
    with pytest.raises(SceneError, match="a scene as small as this they are out of the range of binary32: scale"):
        render(Scene(cubes[1], camera=seen_from), (4, 4), backend="numpy")


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_triangle_as_large_as_the_scene_is_met_from_as_far_as_f32_can_tell(backend):
    """From 2**24 times its size, across and aslant."""
    mesh = Mesh(np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0.5]]), np.array([[0, 1, 2]]))
    origins = np.array([[0, 0, 1.0], [0.3, 0.4, 1]]) * 2.0**24
    hits = Intersector(mesh, backend=backend).intersect(origins, -origins)
    np.testing.assert_allclose(hits.t, 1, rtol=1e-6)


class _Bounce(NamedTuple):
    first: sh.Attrib1i
    start: sh.Point3f
    onward: sh.Vector3f
    second: sh.Attrib1i


def bounced(mesh, accel):
    """Rays that hit a mesh and go on to the side that they came from; and places in the kernel's units."""
    layout = Layout.of(Scene([mesh], [PointLight((0, 9, 0))]), accel)
    walk = walk_with(layout.structure, layout.triangles, "opencl", AheadBound(layout.roundoff))
    tables = SurfaceTables(layout, walk.triangles)

    @sh.program
    def bounce(eye: sh.Point3f, ray: sh.Vector3f, to: sh.Vector3f) -> _Bounce:
        nothing, ever = sh.Attrib1b(False), sh.Attrib1f(FAR)
        hit = walk(ray, eye, sh.Attrib1f(0), ever, nothing)
        surface = blank()
        tables.arrive(hit, ray, eye, surface)
        onward = sh.Vector3f(sh.cond(sh.dot(surface.face, to) < 0, -to, to))
        again = walk(onward, sh.Point3f(surface.inter), sh.Attrib1f(0), ever, nothing)
        return _Bounce(hit.id, surface.inter, onward, again.id)

    return bounce.compile("opencl", loop_limit=None), lambda places: f32((places - layout.origin) * layout.scale)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.sampled(16)
@pytest.mark.parametrize(("accel", "distance"), [("bvh", 0), ("bvh", 1e3), ("bvh", 1e6), ("grid", 0), ("grid", 1e4)])
@pytest.mark.parametrize("name", CLOSED)
def test_no_ray_hits_the_triangle_that_it_starts_from(name, distance, accel):
    """No ray of 20,000 from outside a convex body hits it again, and each ray from inside hits another triangle.

    The start is no farther off the triangle's plane than pbrt-v4's, section 6.8.6: 7 roundings of its coordinates, 5
    that the point itself may be off, and 2 of the step to the next float.
    """
    mesh = standing_at(CLOSED[name], (distance,) * 3)
    kernel, placed = bounced(mesh, accel)
    rng = np.random.default_rng(1)
    middle, size = mesh.vertices.mean(axis=0), np.ptp(mesh.vertices, axis=0).max()
    count = 20_000
    to = unit(rng.normal(size=(count, 3)))
    for inside in (False, True):
        eye = middle + unit(rng.normal(size=(count, 3))) * size * (0.1 if inside else 2)
        aim = middle + (rng.normal(size=(count, 3)) if inside else rng.uniform(-0.25, 0.25, (count, 3))) * size
        first, start, onward, second = kernel(placed(eye), f32(unit(aim - eye)), f32(to))
        assert np.all(first >= 0)
        if inside:
            assert np.count_nonzero((second < 0) | (second == first)) == 0
        else:
            # Rounded, a ball is a little hollow here and there: what is hit has to be there for f64 too.
            again = np.flatnonzero(second >= 0)
            truly = closest(placed(mesh.corners), start[again].astype(float), onward[again].astype(float))
            assert np.all(truly[1] >= 0)
            assert len(again) < 10
        corners = placed(mesh.corners)[first]
        normal = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        height = np.abs(np.einsum("ij,ij->i", start - corners[:, 0], normal))
        bound = 14 * UNIT * np.einsum("ij,ij->i", np.abs(normal), np.abs(corners).max(axis=1))
        assert np.all(height <= bound)


def test_large_triangles_do_not_shadow_themselves_near_a_small_corner():
    """Tetrahedra whose corners lie between 0.1 and 10,000 from 0: no ray hits the triangle that it starts from."""
    rng = np.random.default_rng(4)
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    for _ in range(6):
        mesh = Mesh(f32(rng.normal(size=(4, 3)) * 10 ** rng.uniform(-1, 4, (4, 1))), faces)
        kernel, placed = bounced(mesh, "bvh")
        count = 4000
        weights = rng.dirichlet([0.3, 0.3, 0.3], count)[:, :, None]
        aim = (weights * mesh.vertices[faces[rng.integers(0, 4, count)]]).sum(axis=1)
        eye = rng.normal(size=(count, 3)) * np.abs(mesh.vertices).max() * 3
        to = unit(rng.normal(size=(count, 3)))
        first, _, _, second = kernel(placed(eye), f32(unit(aim - eye)), f32(to))
        assert np.count_nonzero(first >= 0) > 3500
        assert np.count_nonzero((second == first) & (first >= 0)) == 0


class _Cell(NamedTuple):
    voxel: sh.Attrib3i
    steps: sh.Attrib1i


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_walk_through_cells_does_not_drift(backend):
    """2048 cells a side: at most 0.005 % of the cells looked into are none that the exact ray goes through.

    And no ray takes more steps than nx + ny + nz + 3, not those along an axis, a side or a diagonal either.
    """
    cells = 2048
    low, size = np.array([-1.3, 0.1, 2.7]), np.full(3, 3.7 / cells)

    @sh.program
    def cell_at(eye: sh.Point3f, ray: sh.Vector3f, k: sh.Attrib1i) -> _Cell:
        walk = CellWalk(CellBox(low, size, (cells,) * 3), ray, eye, sh.Attrib1f(0))
        found = sh.Attrib3i(-1)
        steps = sh.Attrib1i(0)
        with SH_WHILE(lambda: walk.t < walk.far):
            found[:] = sh.cond(steps == k, walk.voxel, found)
            steps += 1
            walk.advance()
        return _Cell(found, steps)

    rng = np.random.default_rng(9)
    count = 4000 if backend == "numpy" else 40_000
    low32, size32 = f32(low), f32(size)
    target = low32 + rng.random((count, 3)) * cells * size32
    eye = low32 + rng.uniform(-0.5, 1.5, (count, 3)) * cells * size32
    ray = unit(target - eye)
    ray[::50] = np.eye(3)[rng.integers(0, 3, len(ray[::50]))]
    eye[::50] = low32 + rng.integers(0, cells, eye[::50].shape) * size32
    ray[7::50] = unit(rng.choice([-1.0, 1.0], (len(ray[7::50]), 3)))
    eye, ray = f32(eye), f32(ray)
    voxel, steps = cell_at.compile(backend)(eye, ray, rng.integers(0, 2500, count))
    assert steps.max() <= 3 * cells + 3
    seen = np.flatnonzero(voxel[:, 0] >= 0)
    assert len(seen) > count / 5
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.stack([low32 + voxel[seen] * size32 - eye[seen], low32 + (voxel[seen] + 1) * size32 - eye[seen]])
        t /= ray[seen]
    # Along an axis that the ray does not move on it has to be between the sides, which are rounded as the eye is.
    still = ray[seen] == 0
    slack = 4 * UNIT * np.abs(eye[seen]) + 4 * UNIT * np.abs(low32 + voxel[seen] * size32)
    between = (low32 + voxel[seen] * size32 - slack <= eye[seen]) & (
        eye[seen] <= low32 + (voxel[seen] + 1) * size32 + slack
    )
    enter = np.where(still, np.where(between, -np.inf, np.inf), t.min(axis=0)).max(axis=1)
    leave = np.where(still, np.inf, t.max(axis=0)).min(axis=1)
    wrong = enter > leave
    assert wrong.mean() <= 5e-5


def moved(scene, scale, offset):
    """The scene, larger and elsewhere."""

    def at(point):
        return tuple(np.array(point) * scale + offset)

    lights = [dataclasses.replace(x, position=at(x.position)) if isinstance(x, PointLight) else x for x in scene.lights]
    camera = dataclasses.replace(scene.camera, position=at(scene.camera.position), target=at(scene.camera.target))
    meshes = [mesh.moved(tuple(offset), scale=scale) for mesh in scene.meshes]
    return dataclasses.replace(scene, meshes=meshes, lights=lights, camera=camera)


def in_255ths(pixels):
    light = np.clip(pixels.astype(float), 0, 1)
    return 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["boxes", pytest.param("mirror-box", marks=pytest.mark.slow), "mixed"])
def test_a_scene_looks_the_same_wherever_it_stands(name):
    """At least 99.5 % of pixels within 2/255 of the picture in f64 of the scene where it was made."""
    scene = Scene.builtin(name)
    reference = render(scene, (128, 128), backend="opencl", precision="f64")
    for scale, offset in ((1e4, 0), (1e-4, 0), (1, 1e4)):
        found = render(moved(scene, scale, np.array([offset, -offset, offset])), (128, 128), backend="opencl")
        off = np.abs(in_255ths(found.pixels) - in_255ths(reference.pixels)).max(axis=-1)
        assert (off <= 2).mean() >= 0.995


@pytest.mark.parametrize("accel", ["bvh", "grid", "brute"])
def test_a_scene_larger_than_f16_holds_is_an_error(accel):
    shape = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1.0]])
    faces = [[0, 1, 2], [1, 3, 2]]
    fits, past = (Mesh(shape * size, faces) for size in (65000, 65520))
    toward = np.array([0.2, 0.2, 0.0]) * 65000
    shoot = Intersector(fits, accel=accel, backend="numpy", precision="f16")
    assert shoot.intersect([toward + (0, 0, 9)], [(0, 0, -1)]).triangle.tolist() == [0]
    with pytest.raises(SceneError, match=r'reaches 65520 from its origin.* choose precision="f32"'):
        Intersector(past, accel=accel, backend="numpy", precision="f16")


def test_an_object_that_moves_out_of_f16_is_an_error():
    renderer = Renderer(Scene([box()]), backend="numpy", precision="f16")
    before = renderer.render((8, 6))
    renderer.move(0, np.diag([1e6, 1e6, 1e6, 1]))
    with pytest.raises(SceneError, match="and f16 holds numbers up to 65504"):
        renderer.render((8, 6))
    renderer.move(0, np.eye(4))
    assert renderer.render((8, 6)).pixels.tobytes() == before.pixels.tobytes()


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_rays_of_extreme_numbers_end_and_meet_what_every_triangle_tells(backend):
    """Many have an origin or a direction whose sizes overflow, which no walk may follow."""
    rng = np.random.default_rng(0)
    numbers = np.array([0, -0.0, 1, -1, 3e38, -3e38, 3.3e38, 2e38, -2e38, 1e-45, -1e-45, 1e-38])
    eye, ray = rng.choice(numbers, (2, 4000, 3))
    eye[::2] = rng.uniform(-2, 2, (2000, 3))
    ray[~ray.any(axis=1)] = 1
    mesh = sphere(1.0, rings=16, segments=32)
    found, expected = (
        Intersector(mesh, backend=backend, accel=accel).intersect(eye, ray) for accel in ("bvh", "brute")
    )
    assert 100 < (expected.triangle >= 0).sum() < 2000
    np.testing.assert_array_equal(found.triangle, expected.triangle)
