"""The lobes of a MetallicRoughness: reciprocal, never brighter than their light, with densities that integrate to 1."""

import dataclasses
import math

import numpy as np
import pytest
from albedo_integrals import compute_table, integrals

import shpy as sh
from raytracer import Camera, EnvironmentLight, MetallicRoughness, Path, Scene, render
from raytracer.appearance.albedo import ACROSS, albedo_table
from raytracer.kernels.interactions import DetailedInteraction, LayeredInteraction, SheenInteraction, blank
from raytracer.kernels.kinds import MaterialKinds
from raytracer.kernels.microfacets import Microfacets
from raytracer.meshes.shapes import box, floor, sphere

COUNT = 100_000
LOOKS = {
    "metal": {"metallic": 1.0, "roughness": 0.4},
    "plastic": {"roughness": 0.3},
    "between": {"metallic": 0.4, "roughness": 0.6},
    "chalk": {"roughness": 1.0},
    "coated": {"roughness": 0.7, "clearcoat": 1.0, "clearcoat_roughness": 0.2},
    "thin": {"roughness": 0.4, "transmission": 0.5},
    "neither metal nor mirror": {"specular": 0.0},
    "tinted": {"roughness": 0.3, "specular_color": (3.0, 1.0, 0.2)},
    "velvet": {"roughness": 0.8, "sheen_color": (1.0, 0.6, 0.2), "sheen_roughness": 0.4},
    "brushed": {"metallic": 1.0, "roughness": 0.3, "anisotropy": 0.7, "anisotropy_rotation": 30},
    "brushed wood": {
        **{"roughness": 0.2, "anisotropy": 0.9, "clearcoat": 0.5, "clearcoat_roughness": 0.3},
        "sheen_color": (0.2, 0.2, 0.2),
    },
    "satin": {
        **{"metallic": 0.5, "clearcoat": 0.5, "clearcoat_roughness": 0.2, "sheen_color": (0.4, 0.9, 1.0)},
        "sheen_roughness": 0.15,
    },
}


def surface_of(lobes, look, view):
    """Return the interaction with a surface of this look, seen from `view`; its normal is z."""
    material = MetallicRoughness((1.0, 0.6, 0.2), **look)
    (red, green, blue, index), (coat, blur, thin, _) = material.layers
    struct = SheenInteraction if any(material.sheen_color) else LayeredInteraction
    surface = blank(DetailedInteraction if lobes.brushed or lobes.multiscatter else struct)
    surface.normal[:] = sh.Normal3f(0, 0, 1)
    if lobes.brushed:
        angle = math.radians(material.anisotropy_rotation)
        surface.tangent[:] = sh.Vector3f(math.cos(angle), math.sin(angle), 0)
        surface.anisotropy[:] = material.anisotropy**2
    if lobes.multiscatter:
        surface.gain[:] = sh.Color3f(1, 1, 1)
    if any(material.sheen_color):
        surface.sheen[:] = sh.Color3f(*material.sheen_color)
        surface.fuzz.x = material.sheen_roughness
    surface.color[:] = sh.Color3f(*material.tint)
    surface.coefficients[:] = sh.Attrib3f(material.metallic, material.specular, material.roughness)
    surface.tint[:] = sh.Color3f(red, green, blue)
    surface.index[:] = index
    surface.coat[:] = sh.Attrib3f(coat, blur, thin)
    surface.view[:] = view
    surface.face[:] = sh.Normal3f(0, 0, 1)
    lobes.prepare(surface)
    return surface


def kernels(look):
    """Return the value and the density of a direction, and a sampled direction, as kernels."""
    plain = MaterialKinds(*[False] * len(MaterialKinds._fields))
    features = {"coats": "clearcoat", "thin": "transmission", "sheen": "sheen_color", "brushed": "anisotropy"}
    features["multiscatter"] = "multiscatter"
    lobes = Microfacets(plain._replace(**{name: field in look for name, field in features.items()}))

    @sh.program
    def value(view: sh.Vector3f, light: sh.Vector3f) -> sh.Color3f:
        return lobes.evaluate(surface_of(lobes, look, view), light)[0]

    @sh.program
    def density(view: sh.Vector3f, light: sh.Vector3f) -> sh.Attrib1f:
        return lobes.evaluate(surface_of(lobes, look, view), light)[1]

    @sh.program
    def sample(view: sh.Vector3f) -> sh.Vector3f:
        k = sh.grid_index(1)
        numbers = [sh.unit_float(sh.hash(k, n)) for n in range(3)]
        return lobes.scatter(surface_of(lobes, look, view), numbers, sh.Vector3f(0, 0, 1)).ray

    return (program.compile("numpy") for program in (value, density, sample))


def lattice():
    """Return unit vectors that are spread evenly over the sphere (a spherical Fibonacci lattice)."""
    k = np.arange(COUNT) + 0.5
    z, angle = 1 - 2 * k / COUNT, math.pi * (1 + math.sqrt(5)) * k
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1).astype(np.float32)


RESTORED = {
    "restored metal": {"metallic": 1.0, "roughness": 0.9, "multiscatter": True},
    "restored plastic": {"metallic": 0.3, "roughness": 0.6, "anisotropy": 0.5, "multiscatter": True},
}
"""Looks that are not reciprocal."""


@pytest.mark.sampled(45)
@pytest.mark.parametrize("name", [*LOOKS, *RESTORED])
@pytest.mark.parametrize("height", [1.0, 0.4, 0.05])
def test_densities_integrate_to_1_and_nothing_is_gained(name, height):
    look = {**LOOKS, **RESTORED}[name]
    value, density, sample = kernels(look)
    across = math.sqrt(1 - height**2)
    view = np.array([0.8 * across, 0.6 * across, height], np.float32)
    lights, solid_angle = lattice(), 4 * math.pi / COUNT
    views = np.broadcast_to(view, lights.shape).copy()
    albedo = value(views, lights).astype(np.float64).sum(axis=0) * solid_angle
    assert (albedo <= 1 + 2e-3).all(), albedo
    if "transmission" in look:  # of which the density leaves out what goes through
        return
    chances = density(views, lights).astype(np.float64) * solid_angle
    assert chances.sum() == pytest.approx(1, abs=5e-3)
    rays = sample(views).astype(np.float64)
    for moment in (lambda d: d, lambda d: d * d):
        error = moment(rays).std(axis=0) / math.sqrt(COUNT)
        difference = np.abs(moment(rays).mean(axis=0) - chances @ moment(lights.astype(np.float64)))
        np.testing.assert_array_less(difference, 4 * error + 3e-3)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("name", LOOKS)
def test_lobes_are_reciprocal(name):
    value, *_ = kernels(LOOKS[name])
    views, lights = np.random.default_rng(3).normal(size=(2, 4096, 3))
    views, lights = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in (views, lights))
    for directions in (views, lights):
        directions[:, 2] = np.abs(directions[:, 2])
    seen = (views[:, 2] > 0.02) & (lights[:, 2] > 0.02)
    views, lights = (directions[seen].astype(np.float32) for directions in (views, lights))
    there, back = value(views, lights) / lights[:, 2:], value(lights, views) / views[:, 2:]
    np.testing.assert_allclose(there, back, rtol=2e-4, atol=1e-6)


def test_the_table_of_albedos_bounds_the_integrals():
    table, roots = albedo_table().astype(np.float64), np.linspace(0, 1, ACROSS)
    rng = np.random.default_rng(2)
    for _ in range(20):
        roughness, cosines = rng.uniform(1 / (ACROSS - 1), 1), rng.random(8) ** 2
        a, b = integrals(cosines, roughness**2)
        row = min(int(roughness * (ACROSS - 1)), ACROSS - 2)
        part = roughness * (ACROSS - 1) - row
        values = (1 - part) * table[row] + part * table[row + 1]
        scale, edge = (np.interp(np.sqrt(cosines), roots, values[:-1, k]) for k in range(2))
        for f0 in (0.0, 0.04, 1.0):
            excess = f0 * scale + edge - (f0 * (a - b) + b)
            assert -0.004 < excess.min(), (roughness, f0)
            assert excess.max() < (0.02 if roughness > 0.1 else 0.06), (roughness, f0)


@pytest.mark.slow
def test_the_table_is_the_file():
    steps = np.rint(albedo_table().astype(np.float64) * 65535)
    apart = np.abs(compute_table().astype(np.float64) - steps)
    assert apart.max() <= 1  # one step of the file: another libm may round an integral to the other side


BALL = sphere(1, rings=24, segments=48)


def furnace(material, samples=64, size=(16, 16), **options):
    """Return the colours of a ball's pixels in light of 1 from everywhere, (n, 3)."""
    scene = Scene([BALL.with_material(material)], [EnvironmentLight((1, 1, 1))], Camera((0, 0, 6), fov=20))
    image = render(scene, size=size, integrator=Path(samples=samples, bounces=8), **options)
    assert np.isfinite(image.pixels).all()
    return image.pixels[image.object_id == 0].astype(np.float64)


def error_of(colors):
    """Return the standard error of the mean of colours (n, 3)."""
    return colors.std(axis=0) / math.sqrt(len(colors))


def check_gains_nothing(colors):
    assert (colors.mean(axis=0) <= 1 + 3 * error_of(colors) + 1e-6).all(), colors.mean(axis=0)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("roughness", "albedo"), [(0.2, 0.996), (0.5, 0.882), (0.7, 0.707), (1.0, 0.409)])
def test_a_white_metal_has_the_albedo_of_ggx(roughness, albedo):
    x = (np.arange(256) + 0.5) / 256  # the mean over the ball's disc: 2 mu d mu
    assert np.average(integrals(x, roughness**2)[0], weights=x) == pytest.approx(albedo, abs=5e-4)
    colors = furnace(MetallicRoughness((1, 1, 1), metallic=1, roughness=roughness), backend="opencl", size=(32, 32))
    assert abs(colors[:, 0].mean() - albedo) < 4 * error_of(colors)[0] + 0.006  # the ball is made of triangles
    check_gains_nothing(colors)


@pytest.mark.slow
@pytest.mark.parametrize("roughness", [0.5, 1.0])
def test_compensation_restores_a_white_metal_and_gains_nothing(roughness):
    """Colours lose what they absorb from facet to facet; plastic with it gains nothing, either."""
    white = MetallicRoughness((1, 1, 1), metallic=1, roughness=roughness, multiscatter=True)
    colors = furnace(white, backend="opencl", size=(32, 32))
    check_gains_nothing(colors)
    assert abs(colors.mean() - 1) < 3 * error_of(colors)[0] + 2e-3  # the table errs upward by as much
    for look in ({"metallic": 1, "base_color": (1, 0.5, 0.1)}, {"metallic": 0.5}, {"metallic": 0, "clearcoat": 0.5}):
        others = furnace(dataclasses.replace(white, **look), backend="opencl")
        check_gains_nothing(others)
    scene = Scene([BALL.with_material(white)], [], Camera((0, 0, 6)), background=(1, 1, 1), ambient=1)
    assert render(scene, (8, 8), backend="numpy").pixels.max() <= 1 + 1e-4


@pytest.mark.slow
def test_black_plastic_has_the_albedo_of_its_upper_layer():
    x = (np.arange(256) + 0.5) / 256
    a, b = integrals(x, 0.2**2)
    expected = np.average(0.04 * (a - b) + b, weights=x)
    assert expected == pytest.approx(0.0812, abs=2e-4)
    colors = furnace(MetallicRoughness((0, 0, 0), roughness=0.2), backend="opencl", size=(32, 32), samples=256)
    assert abs(colors[:, 0].mean() - expected) < 4 * error_of(colors)[0] + 0.004


@pytest.mark.slow
@pytest.mark.parametrize("roughness", [0.0, 0.1, 0.5, 1.0])
def test_white_plastic_loses_nothing_below_its_upper_layer(roughness):
    colors = furnace(MetallicRoughness((1, 1, 1), roughness=roughness))
    assert abs(colors.mean() - 1) < 0.02 + 4 * error_of(colors)[0]
    check_gains_nothing(colors)


@pytest.mark.slow
@pytest.mark.parametrize("coarse", [True, False])
@pytest.mark.parametrize(
    "roughness", [0, 1e-8, 1e-4, pytest.param(0.02, marks=pytest.mark.slow), 1 / 31 - 1e-6, 1 / 31, 0.1, 1]
)
def test_extremes_are_numbers(coarse, roughness):
    """Show a ball of few triangles, whose normals differ by 30 degrees from theirs; or a floor at a cosine of 0.002."""
    looks = [(0, 1.5, 0), (0.5, 1.0, 0.5), (1, 1.5, 0), (0.5, 0, 1)]
    for metallic, ior, coat in looks:
        material = MetallicRoughness((1, 0.5, 0), metallic, roughness, ior, clearcoat=coat)
        mesh, camera = (
            (sphere(1, material, rings=4, segments=6), Camera((0, 0.3, 3), fov=40))
            if coarse
            else (floor(100, material), Camera((0, 0.04, 20), (0, 0, 0), fov=4))
        )
        scene = Scene([mesh], [EnvironmentLight((1, 1, 1))], camera)
        image = render(scene, size=(12, 8), integrator=Path(samples=64, bounces=4), backend="opencl")
        assert np.isfinite(image.pixels).all()
        check_gains_nothing(image.pixels[image.object_id == 0].astype(np.float64))


def test_a_smooth_metal_is_a_coloured_mirror():
    gold = (1.0, 0.75, 0.25)
    mirror = floor(9, MetallicRoughness(gold, metallic=1, roughness=0))
    scene = Scene([mirror], [EnvironmentLight((1, 1, 1))], Camera((0, 4, 0.001), (0, 0, 0)))
    image = render(scene, size=(4, 4), integrator=Path(samples=16), backend="numpy")
    np.testing.assert_allclose(image.pixels, np.broadcast_to(gold, (4, 4, 3)), atol=2e-3)


@pytest.mark.slow
def test_a_closed_room_is_a_geometric_series():
    """Walls that send out 1 and scatter 0.8 show the sum of the powers of 0.8, of which 32 bounces are followed."""
    chalk = MetallicRoughness((0.8, 0.8, 0.8), specular=0, roughness=1, emission=(1, 1, 1))
    scene = Scene([box((2, 2, 2), chalk, inward=True)], [], Camera((0, 0, 0), (0, 0, -1), fov=60))
    image = render(scene, size=(8, 8), integrator=Path(samples=64, bounces=32), backend="opencl")
    colors = image.pixels.reshape(-1, 3).astype(np.float64)
    expected = (1 - 0.8**33) / (1 - 0.8)
    assert abs(colors[:, 0].mean() - expected) < 4 * error_of(colors)[0] + 1e-3
