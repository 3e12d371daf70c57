"""Examples that draw by derivatives: lines of one width, distances, curvatures and normals."""

import importlib

import numpy as np
import pytest

import shpy as sh
from tests.test_examples import EXAMPLES


@pytest.fixture
def example(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return importlib.import_module


def test_contours_have_one_width(example):
    """Whatever the slope of f, a line is as wide, and its edge is where the distance says."""
    m = example("contours")
    ink, paper = sh.Color3f(0, 0, 0), sh.Color3f(1, 1, 1)

    @sh.program
    def lines(x: sh.Attrib1f):
        p = sh.vec2(x, 0.3)
        curves = (lambda t: t, lambda t: 50 * t, sh.sin)
        return [m.drawn(paper, lambda q, f=f: f(q.x - 0.5), p, 0.01, ink).x for f in curves]

    x = np.float32([0.5, 0.505, 0.516, 0.525, 0.6, 0.4])
    for shade in lines(x):
        np.testing.assert_allclose(shade, [0, 0, 0.5, 1, 1, 1], atol=0.01)


def test_the_curvature_of_a_ball_is_one_over_its_radius(example):
    m = example("curvature")

    @sh.program
    def bend(p: sh.Point3f) -> sh.Attrib1f:
        normal = lambda q: sh.normalize(sh.gradient(sh.length)(q))  # noqa: E731
        return m.mean_curvature(p, normal)

    p = np.float32([[2, 0, 0], [0.3, 0.4, 0], [1, 1, 1]])
    np.testing.assert_allclose(bend(p), 1 / np.linalg.norm(p, axis=-1), rtol=1e-5)


def test_filaments_are_as_far_as_the_set(example):
    """West of -2, where the set ends, the distance is known; the estimate holds within a factor of 2."""
    m = example("filaments")
    away = np.float32([0.5, 0.1, 0.01, 0.001])

    @sh.program
    def distance(away: sh.Attrib1f) -> sh.Attrib1f:
        return m.distance(sh.vec2(-2 - away, 0))[0]

    ratio = distance(away) / away
    assert ((ratio > 0.5) & (ratio < 2)).all()


def test_bumps_tilt_normals(example):
    """By the slope of the height across the normal, and not by that along it."""
    m = example("bumps")

    @sh.program
    def tilted(slope: sh.Attrib3f) -> sh.Normal3f:
        return m.bumpy(lambda p: sh.dot(slope, p), sh.Point3f(0, 0, 1), sh.Normal3f(0, 0, 1))

    slopes = np.float32([[0, 0, 0.7], [1, 0, 0], [0, -2, 3]])
    np.testing.assert_allclose(tilted(slopes)[:, :2] / tilted(slopes)[:, 2:], -slopes[:, :2], atol=1e-6)
