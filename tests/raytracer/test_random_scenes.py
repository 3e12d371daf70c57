"""Scenes made up at random: all ways through them hit the same, to the bit, and what f64 says, within the bound."""

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from random_scenes import Part, Sketch, known, rays, sketches

from raytracer import Intersector, Mesh
from raytracer.kernels import queries
from raytracer.kernels.wide_walk import WideIntersector
from raytracer.rays import Hits, Rays

CELLS = 2**12
"""Cells from the grid's middle within which a ray must begin for the grid to give the hits of the others.

Farther off a rounding of its place is a part of a cell: hits that f64 cannot tell from misses may differ.
"""
ALIKE = settings(derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck))


def mesh_of(corners):
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def check(sketch, backend, count=300):
    corners = sketch.corners()
    mesh = mesh_of(corners)
    origins, directions = rays(sketch, corners, count)
    shoot = {accel: Intersector(mesh, accel=accel, backend=backend) for accel in ("brute", "bvh", "grid")}
    found = {accel: one.intersect(origins, directions) for accel, one in shoot.items()}
    found["wide"] = by_wide(shoot["bvh"], origins, directions, backend)
    brute = found["brute"]
    near = (
        np.abs(intersector_eye(shoot["grid"], origins)).max(axis=1)
        < CELLS * shoot["grid"]._geometry.structure.cell.min()
    )
    for accel in ("bvh", "wide", "grid"):
        for name, ours, expected in zip(Hits._fields, found[accel], brute, strict=True):
            other = np.flatnonzero((ours != expected) & (near | (accel != "grid")))
            assert not len(other), f"{accel} {name}: rays {other[:5]}: {ours[other[:5]]} for {expected[other[:5]]}"
    for accel in ("brute", "grid"):
        agree_with_f64(shoot[accel], origins, directions, found[accel])


def intersector_eye(intersector, origins):
    """The origins as the kernels see them, from the middle of the grid."""
    grid, frame = intersector._geometry.structure, intersector._geometry.frame
    return (origins - frame.origin) * frame.scale - (grid.low + grid.cell * grid.shape / 2)


def by_wide(intersector, origins, directions, backend):
    """The hits of the wide walk, on any backend."""
    walk = WideIntersector(intersector._geometry.structure, intersector._geometry.rows)
    frame, rays = intersector._geometry.frame, Rays.of(origins, directions, 0.0, np.inf)
    kernel = queries.intersect(walk, exact=True).compile(backend, loop_limit=None)
    t, triangle, uv, _ = kernel(*frame.inputs(rays, exact=True))
    return Hits(frame.distances(t, triangle, rays), triangle, uv[:, 0], uv[:, 1])


def agree_with_f64(intersector, origins, directions, hits):
    eye, ray, *_ = intersector._geometry.frame.inputs(Rays.of(origins, directions, 0.0, np.inf), exact=True)
    eye, ray = (np.asarray(a, np.float32).astype(float) for a in (eye, ray))
    of = known(intersector._geometry.corners, eye, ray / np.linalg.norm(ray, axis=1, keepdims=True))
    t = hits.t * np.linalg.norm(directions, axis=1) * intersector._geometry.frame.scale
    n = np.arange(len(t))
    hit = hits.triangle >= 0
    assert not of.never[n, hits.triangle][hit].any(), (n[hit][of.never[n, hits.triangle][hit]], "met beside")
    off = np.abs(t - of.t[n, hits.triangle]) - of.doubt[n, hits.triangle]
    assert np.all(off[hit] <= 0), (n[hit][off[hit] > 0], "t")
    before = of.sure & (of.t - of.doubt > 0) & (of.t + of.doubt < np.where(hit, t, np.inf)[:, None])
    before[n[hit], hits.triangle[hit]] = False
    assert not before.any(), (np.argwhere(before)[:5], "nearer")


RUN = 10
"""Scenes of one run of Hypothesis: from the eleventh on it repeats parts of earlier ones."""


def run_scenes(group, backend, count=300, phases=(Phase.generate, Phase.shrink)):
    """RUN scenes of their own for each group."""

    @seed(group)
    @settings(ALIKE, derandomize=False, max_examples=RUN, phases=phases)
    @given(sketches())
    def scenes(sketch):
        check(sketch, backend, count)

    scenes()


@pytest.mark.sampled(2)
@pytest.mark.parametrize("group", range(2))
def test_all_ways_through_a_random_scene_hit_the_same(group):
    run_scenes(group, "numpy", phases=[Phase.generate])


@pytest.mark.slow
@pytest.mark.parametrize("group", range(1000, 1200))
def test_all_ways_through_many_random_scenes_hit_the_same(group):
    run_scenes(group, "numpy", 600)


@pytest.mark.slow
@pytest.mark.parametrize("group", range(1000, 1006))
def test_backends_agree_on_random_scenes(group):
    run_scenes(group, "opencl")


@pytest.mark.sampled(6)
@pytest.mark.parametrize(
    "sketch",
    [
        Sketch((Part("ball", 1e-5, 0.0, 3), Part("slab", 1.0, 0.0, 700)), 1.0, 0.0, 5),
        Sketch((Part("slab", 1e9, 0.0, 2), Part("ball", 1.0, 1.0, 4)), 1.0, 0.0, 1),
        Sketch((Part("ball", 1.0, 0.0, 4),), 1e-18, 0.0, 0),
        Sketch((Part("ball", 1.0, 0.0, 4), Part("soup", 1.0, 1.0, 6)), 1e18, 1e3, 0),
        Sketch((Part("soup", 0.001, 1.0, 3), Part("ball", 1e10, 1.0, 7)), 1e-18, 0.0, 6),
        Sketch((Part("soup", 1e-6, 1.0, 3), Part("ball", 1e12, 1.0, 7)), 1e-12, 0.0, 6),
        Sketch((Part("degenerate", 1e7, 0.0, 13917), Part("slab", 1e12, 0.0, 233)), 1e-18, 0.0, 680850),
        Sketch((Part("ball", 1e4, 0.0, 2**20), Part("ball", 1.0, 0.0, 84), Part("slab", 1e12, 0.0, 1921)), 1, 1e3, 1),
        Sketch((Part("slivers", 1.0, 1.0, 1), Part("slab", 1e10, 0.0, 45), Part("slab", 1e12, 0.0, 2)), 1, 1e3, 108),
        Sketch((Part("slab", 1e10, 0.0, 101866), Part("slivers", 1e-6, 1.0, 2**20 - 1)), 1.0, 0.0, 5424),
        Sketch((Part("ball", 1e-6, 0.0, 0), Part("ball", 1e12, 100.0, 0)), 1e-18, 0.0, 0),
        Sketch((Part("ball", 1e-5, 0.0, 0), Part("ball", 1e12, 100.0, 2)), 1e-18, 0.0, 0),
        Sketch((Part("slivers", 1e-6, 0.0, 0), Part("ball", 1e12, 100.0, 0)), 1e-18, 0.0, 0),
    ],
    ids=[
        "tiny",
        "huge",
        "small scale",
        "large scale, far away",
        "small scale, tiny",
        "tinier",
        "grazing a huge slab",
        "cells below a rounding",
        "met at once, inside the grid and outside",
        "tiny beside huge",
        "10**20 times smaller than the scene",
        "10**19 times smaller than the scene",
        "slivers 10**20 times smaller than the scene",
    ],
)
def test_known_hard_scenes(sketch):
    check(sketch, "numpy")


def test_a_triangle_that_is_a_line_is_met_between_its_corners():
    corners = np.array([[[0.0, 0, 4], [1, 1, 5], [2, 2, 6]]])
    of = known(corners, np.zeros((1, 3)), np.array([[1.0, 1, 5]]) / 27**0.5)
    assert not of.sure.any()
    assert not of.never.any()
    assert 4 <= of.t[0, 0] <= 7
    assert 2 <= of.doubt[0, 0] <= 3


def test_a_triangle_that_rounding_makes_nearly_a_line_is_met_between_its_corners():
    """The weights of the mean are nothing but roundings in f64, and of both signs."""
    step = np.array([64.0, 64, -320])
    corners = np.array([-558212992.0, -452372704, -302762976]) - np.arange(3)[:, None] * step
    eye = np.array([[-3416477952.0, -239333200, 1909535744]])
    ray = np.array([[0.7894275188446045, -0.05883965641260147, -0.6110172271728516]])
    of = known(corners[None], eye, ray)
    along = (corners[:, 0] - eye[0, 0]) / ray[0, 0]
    assert along.min() <= of.t[0, 0] <= along.max()
