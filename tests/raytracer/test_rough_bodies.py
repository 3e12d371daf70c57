"""Bodies of a MetallicRoughness: rough refraction, tints, Beer's law, the limit of smooth glass, and files."""

import dataclasses
import math

import numpy as np
import pytest
from scene_pictures import CAMERA, check_other_numbers, same_everywhere, two_balls
from test_file_materials import gltf
from test_microfacets import check_gains_nothing, error_of, furnace

from raytracer import (
    Camera,
    EnvironmentLight,
    LayeredCube,
    Material,
    MetallicRoughness,
    Path,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    Staged,
    Texture,
    Whitted,
    render,
)
from raytracer.meshes.shapes import box, floor, sphere

GLASS = MetallicRoughness((1, 1, 1), roughness=0.0, transmission=1, thickness=1)
FROSTED = dataclasses.replace(GLASS, base_color=(0.9, 1, 0.8), roughness=0.4, transmission=0.9, clearcoat=0.3)
BALL = sphere(0.5, rings=8, segments=12)


def bodies(**changes):
    amber = MetallicRoughness(
        (1, 1, 1), roughness=0.2, transmission=1, thickness=1, ior=1.3, attenuation_color=(0.9, 0.5, 0.1),
        attenuation_distance=0.5, anisotropy=0.6,
    )  # fmt: skip
    return two_balls(FROSTED, amber, **{"lights": [PointLight((2, 4, 3)), EnvironmentLight((0.3,) * 3)], **changes})


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [Path(samples=2, bounces=4), Whitted(bounces=3)], ids=["Path", "Whitted"])
def test_every_backend_has_the_same_bits(integrator):
    lights = {} if isinstance(integrator, Path) else {"lights": [PointLight((2, 4, 3))]}
    same_everywhere(bodies(**lights), (12, 8), integrator=integrator)


@pytest.mark.slow
@pytest.mark.parametrize(
    "integrator",
    [Whitted(bounces=4, min_contribution=2.0**-16), Path(samples=4, bounces=5)],  # by default least shares differ
    ids=["Whitted", "Path"],
)
@pytest.mark.parametrize("ior", [1.5, 1.0])
def test_a_smooth_body_is_glass_of_phongs_model(integrator, ior):
    color = (0.5, 0.25, 0.75)
    body = dataclasses.replace(GLASS, ior=ior, attenuation_color=color, attenuation_distance=0.7)
    absorption = tuple(-math.log(x) / 0.7 for x in color)
    glass = Material(diffuse=0, specular=0, transmission=1, ior=ior, absorption=absorption)
    lights = [PointLight((2, 4, 3))] + [EnvironmentLight((0.3, 0.3, 0.3))] * isinstance(integrator, Path)
    ground = floor(4, Material((0.5, 0.6, 0.7), diffuse=1, specular=0)).moved((0, -0.6, 0))
    scenes = [Scene([BALL.with_material(look), ground], lights, CAMERA) for look in (body, glass)]
    images = [render(scene, (16, 12), integrator=integrator, backend="numpy") for scene in scenes]
    np.testing.assert_allclose(images[0].pixels, images[1].pixels, rtol=2e-4, atol=2e-5)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("integrator", [Whitted(bounces=4), Path(samples=4, bounces=5)], ids=["Whitted", "Path"])
@pytest.mark.parametrize("roughness", [0.0, 0.5])
def test_a_slab_of_index_1_absorbs_and_tints_by_the_closed_form(integrator, roughness):
    """White light crosses two surfaces of the base colour, and 2 units of the medium."""
    color, base = np.array((0.9, 0.5, 0.25)), np.array((0.8, 1.0, 0.5))
    slab = dataclasses.replace(
        GLASS, ior=1, base_color=base, roughness=roughness, attenuation_color=color, attenuation_distance=4.0
    )
    scene = Scene([box((9, 9, 2), slab)], [], Camera((0, 0, 5), fov=1), background=(1, 1, 1), ambient=0)
    pixels = render(scene, (4, 4), integrator=integrator, backend="numpy").pixels
    np.testing.assert_allclose(pixels, np.broadcast_to(base**2 * color**0.5, pixels.shape), rtol=2e-4)


def test_metal_and_opaque_shares_are_left_out():
    half = dataclasses.replace(GLASS, ior=1, metallic=0.5, transmission=0.5, base_color=(1, 1, 1), specular=0)
    scene = Scene([box((9, 9, 2), half)], [], Camera((0, 0, 5), fov=1), background=(1, 1, 1), ambient=0)
    assert half.numbers["transmission"] == 0.25
    clear = render(scene, (2, 2), backend="numpy").pixels
    black = render(dataclasses.replace(scene, background=(0, 0, 0)), (2, 2), backend="numpy").pixels
    assert (clear - black).min() >= 0.25**2 - 1e-4


@pytest.mark.slow
def test_rough_glass_gains_nothing():
    """Light that goes from facet to facet is lost: the rougher the glass, the more."""
    means = []
    for roughness in (0.1, 0.5, 1.0):
        colors = furnace(dataclasses.replace(GLASS, roughness=roughness), backend="opencl")
        check_gains_nothing(colors)
        means.append(colors.mean())
    assert 1 > means[0] > 0.98 > means[1] > 0.8 > means[2] > 0.4
    check_gains_nothing(furnace(dataclasses.replace(GLASS, roughness=0.1, anisotropy=0.7, ior=2.0), backend="opencl"))


@pytest.mark.slow
def test_smooth_glass_loses_nothing():
    colors = furnace(GLASS, backend="opencl")
    assert abs(colors.mean() - 1) < 4 * error_of(colors)[0] + 2e-3


@pytest.mark.slow
def test_roughness_blurs_what_is_behind():
    """Stripes behind a plate lose their contrast."""
    stripes = np.tile(np.repeat([[0.0, 1.0]], 2, axis=1), 8)[..., None].repeat(3, axis=2).astype(np.float32)
    wall = floor(6, MetallicRoughness((0, 0, 0), specular=0, emission=Texture(stripes, srgb=False)))
    contrast = []
    for roughness in (0.0, 0.4, 0.6):
        plate = box((6, 0.2, 6), dataclasses.replace(GLASS, roughness=roughness)).moved((0, 1.5, 0))
        scene = Scene([wall, plate], [], Camera((0, 3, 0), (0, 0, 0), up=(0, 0, -1), fov=30))
        pixels = render(scene, (16, 8), integrator=Path(samples=64), backend="opencl").pixels[..., 0]
        contrast.append(pixels.mean(axis=0).std())
    assert contrast[0] > 2 * contrast[1] > 4 * contrast[2]


@pytest.mark.parametrize(
    ("integrator", "ior"),
    [(Whitted(), 1.5), pytest.param(Path(samples=16, bounces=1), 1.0, marks=pytest.mark.slow)],
    ids=["whitted", "path"],
)
def test_lights_shine_through_bodies_by_the_documented_rules(integrator, ior):
    """Shadows go straight on and are tinted twice: in Whitted's tracer always, in path tracing with the index 1."""
    ground = floor(20, Material((1, 1, 1), diffuse=1, specular=0))
    base = np.array((0.5, 0.25, 1.0))
    pane = box((4, 0.5, 4), dataclasses.replace(GLASS, base_color=tuple(base), ior=ior)).moved((0, 1, 0))
    views = []
    for meshes in ([ground], [ground, pane]):
        scene = Scene(meshes, [PointLight((0, 3, 0))], Camera((4, 0.5, 0), (0, 0, 0), fov=5), ambient=0)
        views.append(render(scene, (4, 4), integrator=integrator, backend="numpy").pixels.mean(axis=(0, 1)))
    np.testing.assert_allclose(views[1] / views[0], base**2, rtol=0.02)


@pytest.mark.slow
def test_other_tracers_cubes_and_changes():
    scene = bodies(lights=[PointLight((2, 4, 3))])
    with pytest.raises(SceneError, match="the staged tracer follows mirrored rays alone, and this scene has glass"):
        Renderer(scene, integrator=Staged(), backend="numpy")
    cube = LayeredCube.of(scene, resolution=32, shading="deferred", backend="numpy")
    assert np.isfinite(render(scene, (12, 8), integrator=Whitted(secondary=cube), backend="numpy").pixels).all()
    check_other_numbers(scene, (12, 8), base_color=(0.2, 0.9, 0.5), ior=1.4, attenuation_distance=3.0)


@pytest.mark.slow
def test_a_picture_of_one_number_is_a_number():
    pixels = np.full((2, 2, 3), 0.25, np.float32)
    images = []
    for share in (0.25, Texture(pixels, srgb=False)):
        look = dataclasses.replace(FROSTED, transmission=share)
        scene = Scene([BALL.with_material(look)], [EnvironmentLight((1, 1, 1))], CAMERA)
        images.append(render(scene, (6, 6), integrator=Path(samples=4), backend="numpy").pixels)
    np.testing.assert_allclose(*images, atol=1e-6)


def test_files_have_bodies(tmp_path):
    volume = {"thicknessFactor": 1, "attenuationColor": [0.5, 0.25, 1], "attenuationDistance": 2}
    look = {"baseColorFactor": [1, 0.25, 0.5, 1], "roughnessFactor": 0.5}
    extensions = {"transmission": {"transmissionFactor": 1}, "volume": volume, "ior": {"ior": 1.4}}
    body = gltf(tmp_path, pbrMetallicRoughness=look, extensions=extensions)
    assert (body.is_body, body.ior, body.roughness, body.base_color) == (True, 1.4, 0.5, (1, 0.25, 0.5))
    np.testing.assert_allclose(body.absorption, [math.log(2) / 2, math.log(4) / 2, 0])
    mirror = gltf(tmp_path, pbrMetallicRoughness=look, extensions=extensions | {"ior": {"ior": 0}})
    assert not mirror.is_body


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"thickness": -1}, "the thickness of a material is a number, 0 or more, not -1"),
        ({"attenuation_distance": 0}, "an attenuation_distance is a number above 0, or inf, not 0"),
        ({"attenuation_color": (2, 0, 0)}, r"an attenuation_color is \(r, g, b\), each from 0 to 1"),
        ({"transmission": 1, "thickness": 1, "alpha": 0.5}, "a body, of a thickness above 0, has an alpha of 1"),
        ({"transmission": 1, "thickness": 1, "ior": 0}, "the metallic and the ior of a body, .*, are numbers"),
    ],
)
def test_other_numbers_are_refused(wrong, message):
    with pytest.raises(SceneError, match=message):
        MetallicRoughness(**wrong)
