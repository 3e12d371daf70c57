"""A picture or a program as the background: rays that meet nothing see it, from mirrors and through glass, too."""

import dataclasses

import numpy as np
import pytest
from PIL import Image as pillow
from scene_pictures import same

import shpy as sh
from raytracer import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Material,
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
from raytracer.cli import main
from raytracer.layered.cube import LayeredCube
from raytracer.meshes.shapes import box, floor, sphere

MIRROR = Material((0, 0, 0), diffuse=0, specular=0, reflectivity=1)
PANE = Material((0, 0, 0), diffuse=0, specular=0, transmission=1, ior=1)
GROUND = floor(9, Material((0.4, 0.3, 0.2), reflectivity=0.3)).moved((0, -1, 0))
PIXELS = np.random.default_rng(5).random((6, 12, 3)).astype(np.float32)
AROUND = Camera((0, 0, 0), (0, 0, -1), projection="panorama")


def shown_direction(direction: sh.Vector3f) -> sh.Color3f:
    return sh.Color3f(0.5 + 0.5 * direction.x, 0.5 + 0.5 * direction.y, 0.5 + 0.5 * direction.z)


def far_box():
    """Return something small, far from all rays, since a sky alone is no scene."""
    return box((0.01, 0.01, 0.01)).moved((0, -40, 40))


def seen_directions(size, camera):
    """Return the unit directions (H, W, 3) of the eye rays of a camera that looks along -z."""
    width, height = size
    half = np.tan(np.radians(camera.fov) / 2) / min(size)
    y, x = np.mgrid[:height, :width] + 0.5
    directions = np.stack([(2 * x - width) * half, (height - 2 * y) * half, np.full((height, width), -1.0)], axis=-1)
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("integrator", [Whitted(), Staged(), Path(samples=1)], ids=lambda i: type(i).__name__)
def test_the_eye_sees_each_direction_of_a_program(integrator):
    camera = Camera((0, 0, 5), (0, 0, 0), fov=70)
    scene = Scene([far_box()], camera=camera, background=shown_direction)
    image = render(scene, (12, 8), integrator=integrator, backend="numpy")
    expected = 0.5 + 0.5 * seen_directions((12, 8), camera)
    # A path's ray goes anywhere in its pixel.
    np.testing.assert_allclose(image.pixels, expected, atol=0.06 if isinstance(integrator, Path) else 1e-6)
    assert (image.object_id == -1).all()
    assert image.stats.features["sky"]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("integrator", [Whitted(), Staged(), Path(samples=1)], ids=lambda i: type(i).__name__)
def test_a_mirror_shows_the_mirrored_direction(integrator):
    camera = Camera((0, 0, 3), (0, 0, 0), fov=20)
    wall = floor(40, MIRROR).moved(tilt=90)  # in the plane z = 0, so that a mirrored ray goes to +z
    scene = Scene([wall], camera=camera, background=shown_direction)
    image = render(scene, (12, 8), integrator=integrator, backend="numpy")
    assert (image.object_id == 0).all()
    expected = 0.5 + 0.5 * seen_directions((12, 8), camera) * (1, 1, -1)
    np.testing.assert_allclose(image.pixels, expected, atol=0.03 if isinstance(integrator, Path) else 1e-6)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("integrator", [Whitted(), Path(samples=1)], ids=lambda i: type(i).__name__)
def test_a_pane_shows_what_is_behind_it(integrator):
    camera = Camera((0, 0, 3), (0, 0, 0), fov=20)
    scene = Scene([floor(40, PANE).moved(tilt=90)], camera=camera, background=shown_direction)
    image = render(scene, (12, 8), integrator=integrator, backend="numpy")
    assert (image.object_id == 0).all()
    expected = 0.5 + 0.5 * seen_directions((12, 8), camera)
    np.testing.assert_allclose(image.pixels, expected, atol=0.03 if isinstance(integrator, Path) else 1e-6)


def test_a_picture_lies_as_that_of_an_environment_light_does():
    texture = Texture(PIXELS, filter="nearest")
    parts = {"meshes": [far_box()], "camera": AROUND}
    seen = render(Scene(**parts, background=texture), (12, 6), backend="numpy")
    np.testing.assert_array_equal(seen.pixels, PIXELS)
    lit = render(
        Scene(**parts, lights=[EnvironmentLight(texture)]), (12, 6), integrator=Path(samples=1), backend="numpy"
    )
    np.testing.assert_array_equal(lit.pixels, PIXELS)


def test_a_background_lights_nothing_and_an_environment_is_seen_instead():
    texture, matt = Texture(PIXELS), Material((1, 1, 1), diffuse=1, specular=0)
    ground = floor(40, matt).moved((0, -1, 0))
    scene = Scene([ground], camera=Camera((0, 1, 0), (0, -1, -0.1)), background=texture)
    for integrator in (Whitted(), Path(samples=2)):
        dark = render(dataclasses.replace(scene, ambient=0), (6, 4), integrator=integrator, backend="numpy")
        assert (dark.object_id == 0).all()
        np.testing.assert_array_equal(dark.pixels, 0)
    sky = EnvironmentLight((0.5, 0.25, 1))
    pictures = [
        render(
            Scene([ground], [sky], camera=Camera((0, 1, 0), (0, 1, -1)), background=shown),
            (6, 4),
            integrator=Path(samples=2),
            backend="numpy",
        )
        for shown in (texture, (0, 0, 0))
    ]
    same(*pictures)
    assert (pictures[0].pixels[pictures[0].object_id == -1] == sky.color).all()


def mirrors(**changes):
    """Return a scene with mirrors, a light and a picture around."""
    ball = sphere(1.0, Material((0.2, 0.2, 0.2), reflectivity=0.8), rings=6, segments=10)
    parts = {
        "meshes": [ball, GROUND],
        "lights": [DirectionalLight((1, -2, -1))],
        "camera": Camera((0, 1, 5), (0, 0, 0)),
    }
    return Scene(**(parts | {"background": Texture(PIXELS)} | changes))


@pytest.mark.slow
def test_backends_and_accelerators_agree_to_the_last_bit():
    expected = render(mirrors(), (16, 12), backend="numpy")
    assert len(np.unique(expected.pixels)) > 300
    for backend in ("opencl", "glsl"):
        same(render(mirrors(), (16, 12), backend=backend), expected)
    for integrator in (Staged(), Whitted(accel="grid"), Whitted(accel="ldc:64:triangle")):
        same(render(mirrors(), (16, 12), integrator=integrator, backend="numpy"), expected)


@pytest.mark.slow
def test_glass_before_a_picture_is_the_same_on_each_backend():
    ball = sphere(1.0, Material((0, 0, 0), specular=0, transmission=1, ior=1.5, absorption=(0.1, 0.2, 0.3)), rings=8)
    scene = mirrors(meshes=[ball, GROUND], lights=())
    expected = render(scene, (12, 9), backend="numpy")
    for backend in ("opencl", "glsl"):
        same(render(scene, (12, 9), backend=backend), expected)
    through = expected.pixels[expected.object_id == 0]
    assert len(np.unique(through, axis=0)) > 10, "the picture is seen through the ball"


@pytest.mark.slow
def test_cubes_with_deferred_shading_show_it_in_mirrors():
    wall = floor(40, MIRROR).moved(tilt=90)
    scene = Scene([wall], camera=Camera((0, 0, 3), (0, 0, 0), fov=20), background=shown_direction)
    cube = LayeredCube.of(scene, 16, backend="numpy", shading="deferred")
    image = render(scene, (12, 8), integrator=Whitted(secondary=cube), backend="numpy")
    same(image, render(scene, (12, 8), backend="numpy"))


def test_another_colour_is_data_and_another_kind_of_background_is_another_kernel():
    texture = Texture(PIXELS)
    renderer = Renderer(mirrors(background=(0.1, 0.2, 0.3)), backend="numpy")
    builds = []
    for shown in ((0.3, 0.2, 0.1), texture, texture, shown_direction):
        scene = mirrors(background=shown, lights=[DirectionalLight((1, -2, len(builds)))])
        renderer.show(scene)
        builds.append(renderer.builds)
        image = renderer.render((8, 6))
        if len(builds) in (1, 3):  # where numbers and tables changed, and no kernel
            same(image, render(scene, (8, 6), backend="numpy"))
    assert builds == [1, 2, 2, 3]


def test_a_program_reads_params():
    gain = sh.Param(sh.Attrib1f, 1.0, name="gain")
    scene = mirrors(background=lambda direction: gain * sh.Color3f(0.5, 0.25, 1))
    renderer = Renderer(scene, backend="numpy")
    one = renderer.render((8, 6))
    gain.value = 2.0
    two = renderer.render((8, 6))
    nothing = one.object_id == -1
    np.testing.assert_array_equal(two.pixels[nothing], 2 * one.pixels[nothing])
    assert nothing.any()


def discarding(direction):
    sh.SH_DISCARD(direction.y < 0)
    return sh.Color3f(1, 1, 1)


@pytest.mark.parametrize(
    ("background", "message"),
    [
        ("sky.png", r"a background is a colour .* not 'sky.png': Texture\('sky.png'\) reads a picture"),
        (PIXELS, r"a Texture or a program, not an array: Texture\(array\)"),
        (EnvironmentLight((1, 1, 1)), "an EnvironmentLight is one of the lights"),
        ((1, 2), r"a background is three finite numbers, not \(1, 2\)"),
        ((1, 2, np.nan), "a background is three finite numbers"),
        (None, "a background is three finite numbers, not None"),
    ],
)
def test_what_is_no_background(background, message):
    with pytest.raises(SceneError, match=message):
        Scene([box()], background=background)


@pytest.mark.parametrize(
    ("program", "message"),
    [
        (lambda: sh.Color3f(1, 1, 1), r"test_skies.py:\d+\): the program of a background takes one input"),
        (lambda direction: sh.Attrib2f(1, 2), "what the program of a background gives is an sh.Color3f"),
        (discarding, r"test_skies.py:\d+\): SH_DISCARD would end the whole pixel: give black"),
    ],
)
def test_mistakes_in_a_program(program, message):
    for integrator in (Whitted(), Path()):
        with pytest.raises(SceneError, match=message):
            Renderer(mirrors(background=program), integrator=integrator, backend="numpy")


def test_a_scene_without_triangles_shows_a_colour():
    for shown in (Texture(PIXELS), shown_direction):
        with pytest.raises(SceneError, match="a scene without triangles shows a colour: a Texture or program"):
            render(Scene(background=shown), (4, 3), backend="numpy")


@pytest.mark.sampled(2)
@pytest.mark.parametrize("glass", [False, True])
def test_rays_of_a_smaller_share_than_the_least_contribution_are_not_followed(glass):
    """Between two mirrors of one half the share of a ray is 1/2, 1/4, 1/8."""
    half = Material((1, 1, 1), diffuse=0.5, specular=0, reflectivity=0.5)
    meshes = [floor(40, half).moved((0, -1, 0)), floor(40, half).moved((0, 1, 0))]
    if glass:
        meshes.append(box((0.01, 0.01, 0.01), PANE).moved((0, -40, 40)))
    scene = Scene(meshes, [PointLight((0, 0, 0))], Camera((0, 0, 0), (0, -1, 0.2), fov=30), ambient=0.5)
    for least, bounces in ((0.6, 0), (0.5, 0), (0.3, 1), (0.2, 2), (0, 4)):
        image = render(scene, (6, 4), integrator=Whitted(bounces=4, min_contribution=least), backend="numpy")
        same(image, render(scene, (6, 4), bounces=bounces, backend="numpy"))


@pytest.mark.parametrize("least", [-0.1, 1.5, float("nan"), "0.1", True])
def test_least_contributions_that_are_none(least):
    with pytest.raises(SceneError, match="min_contribution is a share from 0 to 1, not"):
        Whitted(min_contribution=least)


def test_a_search_for_the_fastest_variant_does_not_forget_the_least_contribution():
    with pytest.raises(SceneError, match="max_error chooses among the variants"):
        render(mirrors(), (4, 3), integrator=Whitted(min_contribution=0.1), max_error=1, backend="numpy")


def test_the_command_shows_a_picture(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    pillow.fromarray(np.uint8(255 * PIXELS)).save("sky.png")
    words = ["render", "boxes", "--backend", "numpy", "--size", "8x6", "--bounces", "1"]
    assert main([*words, "--background", "sky.png", "-o", "seen.npy"]) == 0
    scene = dataclasses.replace(Scene.builtin("boxes"), background=Texture("sky.png"))
    expected = render(scene, (8, 6), bounces=1, backend="numpy")
    np.testing.assert_array_equal(np.load("seen.npy", allow_pickle=False)["pixels"], expected.pixels)
    assert main([*words, "--background", "gone.png", "-o", "seen.npy"]) == 1
    assert "there is no picture gone.png" in capsys.readouterr().err


@pytest.mark.slow
def test_a_picture_of_one_colour_is_that_colour_to_path_tracing():
    """Also where a mirror shows it to a matt surface."""
    ball = sphere(0.5, MIRROR, rings=6, segments=10).moved((0, 0.5, 0))
    pictures = [
        render(
            Scene([ball, floor(4)], camera=Camera((0, 2, 3), (0, 0.3, 0)), background=shown),
            (12, 8),
            integrator=Path(samples=8),
            backend="numpy",
        )
        for shown in ((0.5, 0.25, 1), Texture(np.full((2, 4, 3), (0.5, 0.25, 1))))
    ]
    np.testing.assert_allclose(pictures[1].pixels, pictures[0].pixels, atol=1e-6)
    matt = pictures[0].pixels[pictures[0].object_id == 1]
    assert matt.max() > 0
    assert np.median(matt) == 0
