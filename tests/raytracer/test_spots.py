"""Spot lights, ranges of lights, and environments that are turned or stronger, by their known light."""

import dataclasses

import numpy as np
import pytest
from scene_pictures import same, same_everywhere

import shpy as sh
from raytracer import (
    Camera,
    EnvironmentLight,
    Material,
    Path,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    SpotLight,
    Staged,
    Texture,
    Whitted,
    render,
)
from raytracer.cli import main
from raytracer.meshes.shapes import floor, sphere

WHITE = Material((1, 1, 1), diffuse=1, specular=0)
ABOVE = Camera((0, 8, 0), (0, 0, 0), up=(0, 0, -1), projection="orthographic", span=8)
SIZE = 16, 16
SPOT = SpotLight((0, 2, 0), (0, -3, 0), inner=15, outer=40, color=(4, 3, 2))


def places(count=16, span=8):
    """Return the distances (H, W) of the pixels' centres from the middle of the floor."""
    x = (np.arange(count) + 0.5) * span / count - span / 2
    return np.hypot(x[:, None], x[None])


def expected_light(light, aside=0.0):
    """Return the light on a white floor by the formulas of KHR_lights_punctual."""
    at, height = places() + aside, light.position[1]
    way = np.hypot(at, height)
    cosine = height / way
    level = np.ones_like(at)
    if isinstance(light, SpotLight):
        inner, outer = (np.cos(np.radians(a)) for a in (light.inner, light.outer))
        level = np.clip((cosine - outer) / (inner - outer), 0, 1) ** 2
    level = level / (way**2 if light.falloff == "square" else 1)
    if light.range is not None:
        level = level * np.clip(1 - (way / light.range) ** 4, 0, 1)
    return (level * cosine)[..., None] * light.color


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    "light",
    [
        SPOT,
        dataclasses.replace(SPOT, falloff="none", range=2.5),
        PointLight((0, 2, 0), (1, 2, 3), range=4.0),
        PointLight((0, 2, 0), (5, 4, 3), "square", 3.0),
    ],
    ids=["spot", "spot with a range", "range", "square and range"],
)
def test_the_light_on_a_floor_is_that_of_the_formulas(light):
    scene = Scene(floor(9, WHITE), [light], ABOVE, ambient=0.0)
    seen = render(scene, SIZE, backend="numpy", bounces=0).pixels
    np.testing.assert_allclose(seen, expected_light(light), rtol=1e-4, atol=2e-6)
    assert (seen == 0).any()
    traced = render(scene, SIZE, integrator=Path(samples=1, bounces=1), backend="numpy").pixels
    # One sample lies anywhere in its pixel: the light there is within that at the corners.
    near = [expected_light(light, d) for d in (-0.36, 0.36)]
    assert (traced <= np.maximum(*near) + 1e-5).all()
    assert (traced >= np.minimum(*near) - 1e-5).all()


def several():
    """Return spots and points among shapes, with shadows."""
    lights = [
        dataclasses.replace(SPOT, position=(1, 3, 1), direction=(-1, -3, -1)), PointLight((-2, 3, 2), (0.4, 0.4, 0.5)),
        PointLight((2, 2, 2), (2, 2, 2), "square", 4.0),
    ]  # fmt: skip
    return Scene([sphere(0.5).moved((0, 0.5, 0)), floor(6)], lights, Camera((0, 2, 5), (0, 0.3, 0)))


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [Path(samples=2, bounces=2), Whitted(bounces=1)], ids=["Path", "Whitted"])
def test_every_backend_has_the_same_bits(integrator):
    image = same_everywhere(several(), (24, 16), integrator=integrator)
    assert image.stats.features["lights"] == 3


@pytest.mark.slow
def test_spots_in_the_staged_tracer_and_after_changes():
    scene = several()
    whole = render(scene, (24, 16), accel="grid", backend="numpy")
    same(render(scene, (24, 16), integrator=Staged(), backend="numpy"), whole)
    assert whole.stats.features["cones and ranges"]
    renderer = Renderer(scene, backend="numpy")
    turned = dataclasses.replace(scene.lights[0], direction=(-1, -3, 0), inner=5, outer=60, range=9.0)
    other = dataclasses.replace(scene, lights=[turned, *scene.lights[1:]])
    renderer.render((4, 4))
    renderer.show(other)
    same(renderer.render((24, 16)), render(other, (24, 16), backend="numpy"))
    assert renderer.builds == 1  # numbers are data
    renderer.show(dataclasses.replace(scene, lights=[PointLight((0, 3, 0))] * 3))
    assert renderer.builds == 2  # no cone, no code for it


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: SpotLight((0, 1, 0), (0, 0, 0)), "a spot light needs a direction that is not zero"),
        (lambda: SpotLight((0, 1, 0), (0, -1, 0), 50, 40), r"0 <= inner < outer <= 90, not inner=50 and outer=40"),
        (lambda: SpotLight((0, 1, 0), (0, -1, 0), 0, 100), "not inner=0 and outer=100"),
        (lambda: SpotLight((0, 1, 0), None), "a light's direction is three finite numbers, not None"),
        (lambda: SpotLight((0, 1, 0), (0, -1, 0), falloff="linear"), "falloff is one of none, square, not 'linear'"),
        (lambda: PointLight((0, 1, 0), range=0), "a light's range is a distance above 0, or None for no end, not 0"),
        (lambda: PointLight((0, 1, 0), range="far"), "range is a distance above 0, .*, not 'far'"),
        (lambda: EnvironmentLight((1, 1, 1), rotation="left"), "rotation of an .* an angle in degrees, not 'left'"),
        (lambda: EnvironmentLight((1, 1, 1), strength=-1), "strength of an .* is a number, 0 or more, not -1"),
    ],
)
def test_numbers_that_no_light_has_are_refused(make, words):
    with pytest.raises(SceneError, match=words):
        make()


PIXELS = np.random.default_rng(6).random((8, 16, 3)).astype(np.float32)


def lit(light, size=(16, 8), samples=4, backend="numpy"):
    """Render a ball under an environment, all around."""
    panorama = Camera((0, 0, 0), (0, 0, -1), projection="panorama")
    scene = Scene([sphere(0.5, WHITE).moved((0, 0, -3))], [light], panorama)
    return render(scene, size, integrator=Path(samples=samples, bounces=2), backend=backend)


@pytest.mark.slow
def test_a_picture_turned_by_whole_columns_is_a_picture_that_was_rolled():
    """A quarter turn moves the picture's middle from -z to -x: four of 16 columns to the left."""
    turned = lit(EnvironmentLight(Texture(PIXELS, srgb=False), rotation=90, strength=2.0), samples=1)
    rolled = lit(EnvironmentLight(Texture(2 * np.roll(PIXELS, -4, axis=1), srgb=False)), samples=1)
    around = turned.object_id < 0  # on the ball, other random numbers choose the directions
    np.testing.assert_allclose(turned.pixels[around], rolled.pixels[around], rtol=1e-3, atol=1e-4)
    assert around.sum() > 100
    assert repr(EnvironmentLight((1, 1, 1), 450, 2)) == "EnvironmentLight((1.0, 1.0, 1.0), rotation=90, strength=2)"


@pytest.mark.slow
def test_a_program_is_turned_and_a_colour_is_stronger():
    def sky(direction: sh.Vector3f) -> sh.Color3f:
        return sh.Color3f(0.5 + 0.5 * direction.x, 0.5 + 0.5 * direction.y, 0.5 + 0.5 * direction.z)

    seen = lit(EnvironmentLight(sky, rotation=-90, strength=3.0), samples=1).pixels[4, 8:]
    there = lit(EnvironmentLight(sky), samples=1).pixels[4, 8:]
    # What was at -z is at +x now: x of the program is z of the scene, and z of the program is -x.
    background = np.abs(there - there[-1]).max(axis=1) < 9
    np.testing.assert_allclose(seen[background][-3:, 1], 3 * there[background][-3:, 1], rtol=1e-5)
    assert (seen[-1] > 0).all()
    double, single = (lit(EnvironmentLight((0.2, 0.4, 0.6), strength=s)).pixels for s in (2.0, 1.0))
    np.testing.assert_allclose(double, 2 * single, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_a_turned_environment_has_the_same_bits_everywhere(backend):
    light = EnvironmentLight(Texture(PIXELS, srgb=False), rotation=33, strength=1.5)
    same(lit(light), lit(light, backend=backend))


@pytest.mark.slow
def test_aiming_at_a_turned_environment_changes_no_mean():
    """A furnace cannot see a wrong density, but a bright spot beside the ball can: both ways find the same light."""
    spot = np.zeros((32, 64, 3), np.float32)
    spot[8:12, 20:26] = 200.0
    means = []
    for degrees in (0.0, 200.0):
        light = EnvironmentLight(Texture(spot, srgb=False), rotation=degrees)
        camera = Camera((0, 6, 0), (0, 0, 0), up=(0, 0, -1), fov=20)
        scene = Scene([floor(9, WHITE)], [light], camera)
        means.append(render(scene, (16, 16), integrator=Path(samples=32, bounces=1), backend="opencl").pixels.mean())
    np.testing.assert_allclose(means, means[0], rtol=0.03)  # the floor is the same from all sides


def test_the_command_turns_the_environment(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    from PIL import Image as pillow

    pillow.fromarray((255 * PIXELS).astype(np.uint8)).save("sky.png")
    command = ["render", "boxes", "--size", "8x6", "--backend", "numpy", "--samples", "1", "--integrator", "path"]
    assert main([*command, "--environment", "sky.png", "--rotation", "-90", "-o", "a.npy"]) == 0
    boxes = Scene.builtin("boxes")
    scene = dataclasses.replace(boxes, lights=[*boxes.lights, EnvironmentLight("sky.png", rotation=270)])
    expected = render(scene, (8, 6), integrator=Path(samples=1), backend="numpy")
    np.testing.assert_array_equal(np.load("a.npy")["pixels"], expected.pixels)
    assert main([*command, "--rotation", "90", "-o", "a.npy"]) == 1
    assert "--rotation turns the picture of --environment: name one, or leave it out" in capsys.readouterr().err
