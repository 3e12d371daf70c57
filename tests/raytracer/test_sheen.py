"""The sheen of a MetallicRoughness: its albedo, that it never gains light, its bits, and where files say it."""

import dataclasses

import numpy as np
import pytest
from albedo_integrals import albedos, compute_sheen_table
from scene_pictures import CAMERA, check_other_numbers, same, same_everywhere, two_balls
from test_file_materials import gltf
from test_microfacets import check_gains_nothing, error_of, furnace

import shpy as sh
from raytracer import (
    Camera,
    EnvironmentLight,
    LayeredCube,
    MetallicRoughness,
    Path,
    PointLight,
    Scene,
    SceneError,
    Staged,
    Surface,
    Texture,
    Whitted,
    render,
)
from raytracer.appearance.albedo import ACROSS, FINEST, sheen_table
from raytracer.meshes.shapes import floor, sphere

VELVET = MetallicRoughness((0.3, 0.02, 0.05), roughness=0.9, sheen_color=(0.9, 0.4, 0.5), sheen_roughness=0.4)
SATIN = MetallicRoughness(
    (0.8, 0.7, 0.9), metallic=0.5, roughness=0.02, clearcoat=0.5, sheen_color=(1, 1, 1), sheen_roughness=0.2
)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("roughness", [0.5, 0.8, 1.0])
@pytest.mark.parametrize("degrees", [20, 75])
def test_fibres_over_black_have_the_albedo_of_their_integral(roughness, degrees):
    black = MetallicRoughness((0, 0, 0), specular=0, sheen_color=(1, 0.5, 0), sheen_roughness=roughness)
    eye = (0, float(np.cos(np.radians(degrees))), float(np.sin(np.radians(degrees))))
    camera = Camera(eye, (0, 0, 0), projection="orthographic", span=0.1)
    scene = Scene([floor(4, black)], [EnvironmentLight((1, 1, 1))], camera)
    pixels = render(scene, (16, 16), integrator=Path(samples=64, bounces=1), backend="numpy").pixels.reshape(-1, 3)
    expected = albedos(eye[1], roughness) * (1, 0.5, 0)
    np.testing.assert_array_less(np.abs(pixels.mean(axis=0) - expected), 4 * error_of(pixels) + 0.002)


def rough(hit):
    return Surface(sheen_roughness=0.5)


@pytest.mark.slow
@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "alone", [{"sheen_roughness": Texture([[[0.5] * 3]])}, {"surface": rough}], ids=["picture", "program"]
)
def test_a_roughness_without_a_color_changes_nothing(alone):
    materials = MetallicRoughness((0.3, 0.02, 0.05)), MetallicRoughness((0.3, 0.02, 0.05), **alone)
    scenes = [Scene([floor(4, m)], [PointLight((0, 3, 0))], CAMERA) for m in materials]
    same(*(render(scene, (8, 6), integrator=Path(samples=1), backend="numpy") for scene in scenes))


def test_the_table_bounds_the_integrals():
    table, roots = sheen_table().astype(np.float64), np.linspace(0, 1, ACROSS)
    rng = np.random.default_rng(2)
    for roughness in rng.uniform(FINEST, 1, 12):
        cosines = rng.random(8) ** 2
        row = min(int(roughness * (ACROSS - 1)), ACROSS - 2)
        part = roughness * (ACROSS - 1) - row
        values = (1 - part) * table[row] + part * table[row + 1]
        excess = np.interp(np.sqrt(cosines), roots, values) - albedos(cosines, roughness)
        assert -0.004 < excess.min(), roughness
        assert excess.max() < 0.12, roughness


@pytest.mark.slow
def test_the_table_is_the_file():
    steps = np.rint(sheen_table().astype(np.float64) * 4096)
    assert np.abs(compute_sheen_table().astype(np.float64) - steps).max() <= 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "look",
    [
        {"base_color": (1, 1, 1), "roughness": 0.5, "sheen_roughness": 0.0},
        {"base_color": (1, 1, 1), "roughness": 0.0, "sheen_roughness": 0.3},
        {"base_color": (1, 1, 1), "metallic": 1, "roughness": 0.3, "sheen_roughness": 1.0, "clearcoat": 1},
        {"base_color": (1, 1, 1), "transmission": 0.7, "roughness": 0.2, "sheen_roughness": 0.6},
    ],
    ids=["smooth fibres", "over a mirror", "under a coat", "over a thin wall"],
)
def test_white_fibres_gain_nothing_in_a_furnace(look):
    colors = furnace(MetallicRoughness(**look, sheen_color=(1, 1, 1)), backend="opencl")
    check_gains_nothing(colors)
    assert colors.mean() > 0.6
    whitted = Scene(
        [sphere(1, MetallicRoughness(**look, sheen_color=(1, 1, 1)))], [], Camera((0, 0, 6)), (1, 1, 1), 1.0
    )
    assert render(whitted, (8, 8), backend="numpy").pixels.max() <= 1.001


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [Path(samples=2, bounces=3), Whitted(bounces=2)], ids=["Path", "Whitted"])
def test_every_backend_has_the_same_bits(integrator):
    same_everywhere(two_balls(VELVET, SATIN), (12, 8), integrator=integrator)


def test_edges_shine():
    """Lit from the eye, velvet is bright where it turns away; without its sheen it is dark there."""
    ball = sphere(0.5, VELVET).moved((0, 0.5, 0))
    plain = ball.with_material(dataclasses.replace(VELVET, sheen_color=(0, 0, 0)))
    edges, middles = [], []
    for mesh in (ball, plain):
        camera = Camera((0, 0.5, 4), (0, 0.5, 0), fov=18)
        image = render(Scene([mesh], [PointLight((0, 0.6, 4))], camera, (0, 0, 0), 0.0), (32, 32), backend="numpy")
        turned = (image.object_id == 0) & (image.normal[..., 2] < 0.35)
        edges.append(image.pixels[turned].mean())
        middles.append(image.pixels[15, 15].mean())
    assert edges[0] > 3 * edges[1] > 0
    assert abs(middles[0] - middles[1]) < 0.2 * middles[1]


@pytest.mark.slow
def test_other_tracers_pictures_and_changes():
    scene = two_balls(VELVET, SATIN)
    whole = render(scene, (12, 8), backend="numpy", accel="grid")
    same(render(scene, (12, 8), integrator=Staged(), backend="numpy"), whole)
    cube = LayeredCube.of(scene, resolution=32, shading="deferred", backend="numpy")
    assert render(scene, (12, 8), integrator=Whitted(secondary=cube), backend="numpy").pixels.max() > 0
    check_other_numbers(scene, (12, 8), sheen_color=(0.1, 0.9, 0.2), sheen_roughness=0.7)

    def fibres(hit):
        return Surface(sheen_color=0.5 * sh.Color3f(1, 1, 1), sheen_roughness=0.4)

    square = floor(1, dataclasses.replace(VELVET, sheen_color=Texture(np.full((2, 2, 3), 0.5), srgb=False)))
    numbers = floor(1, dataclasses.replace(VELVET, sheen_color=(0.5, 0.5, 0.5)))
    above = Camera((0, 1, 2), (0, 0, 0), fov=20)
    described = floor(1, dataclasses.replace(VELVET, sheen_color=(0, 0, 0), surface=fibres))
    meshes = square, numbers, described
    seen = [render(Scene([m], [PointLight((0, 2, -2))], above), (6, 6), backend="numpy").pixels for m in meshes]
    for pixels in seen[1:]:
        np.testing.assert_allclose(pixels, seen[0], rtol=1e-5)


def test_files_have_a_sheen(tmp_path):
    sheen = {"sheenColorFactor": [0.9, 0.5, 0.1], "sheenRoughnessFactor": 0.3}
    material = gltf(tmp_path, extensions={"sheen": sheen})
    assert (material.sheen_color, material.sheen_roughness) == ((0.9, 0.5, 0.1), 0.3)
    assert gltf(tmp_path, extensions={"sheen": {}}).sheen_color == (0, 0, 0)


@pytest.mark.parametrize("wrong", [{"sheen_color": (2, 0, 0)}, {"sheen_roughness": -1}, {"sheen_color": 0.5}])
def test_other_numbers_are_refused(wrong):
    with pytest.raises(SceneError, match=f"the {next(iter(wrong))} of a material is"):
        MetallicRoughness(**wrong)
