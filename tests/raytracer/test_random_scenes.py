"""Scenes made up at random: all ways through them hit the same, to the bit, and what f64 says, within the bound."""

import os

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from random_scenes import known, rays, sketches

from raytracer import Intersector, Mesh
from raytracer import intersector as queries
from raytracer.intersector import Hits
SLOW = int(os.environ.get("SHPY_RANDOM_SCENES", "2000"))


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
    for accel in ("bvh", "wide", "grid"):
        for name, ours, expected in zip(Hits._fields, found[accel], brute, strict=True):
            if (ours != expected).any():
                k = int(np.flatnonzero(ours != expected)[0])
                raise AssertionError(f"{accel} {name} of ray {k}: {ours[k]} for {expected[k]}; {(ours!=expected).sum()}")
    agree_with_f64(shoot["brute"], mesh, origins, directions, brute)


def by_wide(intersector, origins, directions, backend):
    """The hits of the wide walk, on any backend."""
    walk = intersector._wide()
    eye, ray, near, limit, length = queries._checked(origins, directions, 0.0, np.inf)
    eye, near, limit = intersector._moved(eye, near, limit)
    kernel = queries._intersect(walk).compile(backend, loop_limit=None)
    return intersector._hits(kernel(eye, ray, near, limit), length)


def agree_with_f64(intersector, mesh, origins, directions, hits):
    eye, ray, near, limit, length = queries._checked(origins, directions, 0.0, np.inf)
    eye, near, limit = intersector._moved(eye, near, limit)
    eye, ray = (np.asarray(a, np.float32).astype(float) for a in (eye, ray))
    of = known(intersector._corners, eye, ray)
    t = hits.t * length * intersector._scale
    n = np.arange(len(t))
    hit = hits.triangle >= 0
    assert not of.never[n, hits.triangle][hit].any(), (n[hit][of.never[n, hits.triangle][hit]], "met beside")
    off = np.abs(t - of.t[n, hits.triangle]) - of.doubt[n, hits.triangle]
    assert np.all(off[hit] <= 0), (n[hit][off[hit] > 0], "t")
    before = of.sure & (of.t - of.doubt > 0) & (of.t + of.doubt < np.where(hit, t, np.inf)[:, None])
    before[n[hit], hits.triangle[hit]] = False
    assert not before.any(), (np.argwhere(before)[:5], "nearer")


@given(sketches())
@settings(max_examples=24, derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck))
def test_all_ways_through_a_random_scene_hit_the_same(sketch):
    check(sketch, "numpy")
