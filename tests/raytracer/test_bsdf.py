"""The lobes of path tracing: densities that integrate to 1, and directions that are drawn with them."""

import math

import numpy as np
import pytest

import shpy as sh
from raytracer.kernels.bsdf import Bsdf, highlight
from raytracer.kernels.interactions import blank

COUNT = 100_000


def seen(specular, shininess):
    """A surface with the normal z that is seen at about 60 degrees."""
    surface = blank()
    surface.coefficients[:] = sh.Attrib3f(0.5, specular, shininess)
    surface.color[:] = sh.Color3f(0.5)
    surface.view[:] = sh.normalize(sh.Vector3f(0.8, 0.3, 0.5))
    surface.normal[:] = sh.Vector3f(0, 0, 1)
    surface.face[:] = sh.Vector3f(0, 0, 1)
    return surface


def sphere_of_directions():
    """Unit vectors (COUNT, 3) that are spread evenly over the sphere: a Fibonacci lattice."""
    k = np.arange(COUNT) + 0.5
    z, angle = 1 - 2 * k / COUNT, math.pi * (1 + math.sqrt(5)) * k
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("shininess", [0, 0.5, 1, 40])
@pytest.mark.parametrize("specular", [1.0, 0.25])
def test_densities_integrate_to_1_and_are_those_of_the_directions_drawn(specular, shininess):
    bsdf = Bsdf(highlights=True)

    @sh.program
    def density(light: sh.Vector3f) -> sh.Attrib1f:
        return bsdf.evaluate(seen(specular, shininess), light)[1]

    @sh.program
    def drawn() -> sh.Vector3f:
        k = sh.grid_index(1)
        return bsdf.sample(seen(specular, shininess), *(sh.unit_float(sh.hash(k, n)) for n in range(3)))

    around = sphere_of_directions()
    weights = density.compile("numpy")(around.astype(np.float32)).astype(np.float64) * (4 * math.pi / COUNT)
    assert weights.sum() == pytest.approx(1, abs=2e-3)
    found = drawn.compile("numpy")(shape=COUNT).astype(np.float64)
    for moment in (lambda d: d, lambda d: d * d):
        error = moment(found).std(axis=0) / math.sqrt(COUNT)
        np.testing.assert_array_less(np.abs(moment(found).mean(axis=0) - weights @ moment(around)), 4 * error + 2e-3)


def test_highlights_end_across_the_mirrored_ray():
    """Lobes of exponent 0 integrate to 1 as well: pow(0, 0) is 1."""

    @sh.program
    def shine(light: sh.Vector3f) -> sh.Attrib1f:
        return highlight(sh.normalize(sh.Vector3f(1, 0, 1)), sh.Vector3f(0, 0, 1), light, 0)

    lights = [[-1, 0, 1], [0, 0, 1], [1, 0, 0.9], [1, 0, 1.1], [-1, 0, -1]]
    np.testing.assert_array_equal(shine.compile("numpy")(np.array(lights, np.float32)), [1, 1, 0, 1, 0])
