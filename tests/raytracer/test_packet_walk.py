"""The walk of a packet as one interval hits what the other walks hit: to the bit, for any rays."""

import numpy as np
import pytest
from scene_pictures import same_arrays
from test_bvh_walk import MESHES, rays

from raytracer import Intersector, Mesh
from raytracer.accel.ploc import build_bvh
from raytracer.accel.space import triangle_rows
from raytracer.kernels import queries
from raytracer.kernels.bvh_walk import BvhIntersector
from raytracer.kernels.packet_walk import PacketIntersector
from raytracer.kernels.triangle import AheadBound
from raytracer.kernels.wide_walk import WideIntersector

RNG = np.random.default_rng(41)


def needles(count=300):
    """Long thin triangles, some of them without area, and some edge-on to the axes."""
    corners = RNG.normal(size=(count, 3, 3))
    corners[:, 2] = corners[:, 1] + RNG.normal(size=(count, 3)) * 1e-6
    corners[::7, 2] = corners[::7, 1]
    corners[1::7, :, 0] = corners[1::7, :1, 0]
    return Mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


SCENES = {**MESHES, "needles": needles()}


def odd_rays(mesh, count=640):
    """Rays of all kinds: alike ones in groups, along axes with zeros of both signs, infinite and NaN ones."""
    origins, directions = rays(mesh, count, seed=3)
    groups = np.repeat(np.arange(0, count, 16), 16)[:count]
    alike = np.arange(count) // 16 % 2 == 0
    origins[alike] = origins[groups][alike]
    directions[alike] = directions[groups][alike] + RNG.normal(size=(count, 3)).astype(np.float32)[alike] * 0.02
    directions[5::17] *= np.float32([1, 0, -0.0])
    directions[6::17] *= np.float32([-0.0, 0, 1])
    directions[7::97], directions[8::97] = np.nan, np.inf
    origins[9::97], origins[10::97] = np.nan, -np.inf
    directions[11::97] = 0
    return origins, directions


@pytest.mark.sampled(30)
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("query", [queries.intersect, queries.occluded, queries.count], ids=lambda q: q.__name__)
def test_the_same_hits_as_in_other_walks(name, query):
    mesh = SCENES[name]
    origins, directions = odd_rays(mesh)
    rng = np.random.default_rng(4)
    near = np.where(rng.random(len(origins)) < 0.5, 0, rng.uniform(0, 2, len(origins))).astype(np.float32)
    limit = np.where(rng.random(len(origins)) < 0.5, np.inf, rng.uniform(0, 6, len(origins))).astype(np.float32)
    structure, rows = build_bvh(mesh.corners), triangle_rows(mesh.corners)
    packets = query(PacketIntersector(structure, rows), exact=False)
    kernels = [packets.compile("opencl", lanes=lanes, loop_limit=None) for lanes in (16, 1)]
    kernels += [packets.compile(backend, loop_limit=None) for backend in ("numpy", "glsl")]
    for other, lanes in ((BvhIntersector(structure, rows, together=True), 16), (WideIntersector(structure, rows), 1)):
        kernels.append(query(other, exact=False).compile("opencl", lanes=lanes, loop_limit=None))
    first, *others = (kernel(origins, directions, near, limit, (0, 0, 0), 1.0) for kernel in kernels)
    assert np.asarray(first[-1]).any()
    for other in others:
        same_arrays(first, other)


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [4, 8, 16])
def test_packets_of_every_width(lanes):
    mesh = SCENES["soup"]
    origins, directions = odd_rays(mesh)
    structure, rows = build_bvh(mesh.corners), triangle_rows(mesh.corners)
    bound = AheadBound(2.0**-24)
    found, right = (
        queries.intersect(walk, exact=False).compile("opencl", lanes=lanes, loop_limit=None)
        for walk in (PacketIntersector(structure, rows, bound), BvhIntersector(structure, rows, True, bound))
    )
    arguments = origins, directions, np.float32(0), np.float32(np.inf), (0, 0, 0), 1.0
    assert "float8" in found.source
    same_arrays(found(*arguments), right(*arguments))


def test_boxes_that_are_not_there_are_not_met():
    """A node of two children has room for six more, and of rays with all signs nothing is known along any axis."""
    mesh = SCENES["one"]
    directions = np.float32([[1, 1, 1], [-1, -1, -1]] * 8)
    origins = np.float32([0.2, 0.2, 0]) - directions
    structure, rows = build_bvh(mesh.corners), triangle_rows(mesh.corners)
    kernel = queries.intersect(PacketIntersector(structure, rows), exact=False).compile("opencl", lanes=16)
    hits = kernel(origins, directions, 0.0, np.inf, (0, 0, 0), 1.0)
    np.testing.assert_array_equal(hits.t, np.ones(16))


@pytest.mark.slow
def test_queries_of_alike_rays_walk_so():
    mesh = SCENES["knot"]
    across, down = np.meshgrid(np.linspace(-0.25, 0.25, 200), np.linspace(-0.25, 0.25, 8))
    fan = np.stack([np.full(1600, -1.0), across.ravel(), down.ravel()], axis=-1)
    origins = np.tile([5.0, 0, 0], (1600, 1))
    shoot, brute = (Intersector(mesh, accel=a, backend=b) for a, b in (("bvh", "opencl"), ("brute", "numpy")))
    hits = shoot.intersect(origins, fan)
    assert (hits.triangle >= 0).sum() > 100
    same_arrays(hits, brute.intersect(origins, fan))
    np.testing.assert_array_equal(shoot.occluded(origins, fan, 4), brute.occluded(origins, fan, 4))
    np.testing.assert_array_equal(shoot.count(origins, fan), brute.count(origins, fan))
    same_arrays(shoot.all_hits(origins, fan), brute.all_hits(origins, fan))
    assert {key[1] for key in shoot._kernels} == {"packets"}
    same_arrays(shoot.intersect(origins, fan, -9.0), brute.intersect(origins, fan, -9.0))
    assert {key[1] for key in shoot._kernels} == {"packets", "any"}
