"""Cutouts: rays of all kinds go on where a picture says that there is no surface, with the same bits everywhere."""

import dataclasses

import numpy as np
import pytest
from scene_pictures import same

from raytracer import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Material,
    Mesh,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    Texture,
    render,
)
from raytracer.meshes.shapes import box, floor, icosahedron

HOLES = Texture(np.kron([[1.0, 0.0], [0.0, 1.0]], np.ones((4, 4))), filter="nearest")
SQUARE = Mesh(
    [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]],
    [[0, 1, 2], [0, 2, 3]],
    uv=[[0, 0], [1, 0], [1, 1], [0, 1]],
    name="square",
)
AHEAD = Camera((0, 0, 4), (0, 0, 0), projection="orthographic", span=2)
RED = Material((1, 0, 0), 1.0, 0.0, cutout=HOLES)


def shade_of(*meshes, light, **changes):
    """Render a white floor under a screen with holes from above: 1 in the light, 0 in its shadow."""
    ground = floor(40, Material((1, 1, 1), 1.0, 0.0))
    camera = Camera((0, 9, 0), (0, 0, 0), up=(0, 0, -1), projection="orthographic", span=2)
    return render(Scene([ground, *meshes], [light], camera, ambient=0.0), (16, 16), bounces=1, **changes)


def everything(**changes):
    """Screens with holes before each other, glass, a mirror, and materials without holes."""
    soft = Texture(np.random.default_rng(3).random((8, 8)))
    meshes = [
        SQUARE.with_material(RED).moved((-0.5, 1, 1)),
        SQUARE.with_material(Material((0, 0.5, 1), cutout=soft, reflectivity=0.3)).moved((0.5, 1, 0.5), turn=20),
        box((1, 1, 1), Material((0.2, 0.9, 0.3), cutout=soft)).moved((1.2, 0.5, 1.4)),
        icosahedron(0.7, Material((0.8, 0.7, 0.3), reflectivity=0.5)).moved((0, 0.7, -1)),
        floor(12),
    ]
    lights = [PointLight((-3, 6, 5), (0.8, 0.8, 0.8)), DirectionalLight((1, -2, -1), (0.3, 0.3, 0.3))]
    return Scene(meshes, lights, Camera((0, 2, 6), (0, 0.8, 0), fov=45), **changes)


def test_one_sees_through_holes():
    wall = SQUARE.with_material(Material((0, 1, 0))).moved((0, 0, -1), scale=3)
    scene = Scene([SQUARE.with_material(RED), wall], (), AHEAD, ambient=1.0)
    found = render(scene, (16, 16), backend="numpy", bounces=0)
    there = np.kron([[True, False], [False, True]], np.ones((8, 8), bool))
    np.testing.assert_array_equal(found.object_id, np.where(there, 0, 1))
    np.testing.assert_allclose(found.depth, np.where(there, 4, 5), rtol=1e-6)
    np.testing.assert_array_equal(found.pixels[..., 0], there)
    assert found.stats.features["cutouts"]


@pytest.mark.parametrize("light", [DirectionalLight((0, -1, 0)), PointLight((0, 1e4, 0))])
def test_light_falls_through_holes(light):
    screen = SQUARE.with_material(RED).moved((0, 20, 0), tilt=-90)
    found = shade_of(screen, light=light, backend="numpy").pixels[..., 0]
    np.testing.assert_allclose(found, np.kron([[0.0, 1.0], [1.0, 0.0]], np.ones((8, 8))), rtol=1e-3)


def test_light_falls_through_holes_and_glass():
    """Shadow rays that go on behind glass meet the screen as others do."""
    screen = SQUARE.with_material(RED).moved((0, 20, 0), tilt=-90)
    pane = box((9, 0.1, 9), Material((0, 0, 0), specular=0, transmission=0.5, ior=1.0)).moved((0, 30, 0))
    found = shade_of(screen, pane, light=DirectionalLight((0, -1, 0)), backend="numpy").pixels[..., 0]
    np.testing.assert_allclose(found, 0.25 * np.kron([[0.0, 1.0], [1.0, 0.0]], np.ones((8, 8))), rtol=1e-5)


@pytest.mark.parametrize("others", [[], pytest.param(["opencl", "glsl"], marks=pytest.mark.slow)])
def test_shadows_of_glass_are_as_clear_as_its_picture(others):
    clear = Texture(np.kron([[0.5, 0.0], [2.0, 0.25]], np.ones((4, 4))), filter="nearest")
    pane = SQUARE.with_material(Material((0, 0, 0), specular=0, transmission=clear, ior=1.0))
    light = DirectionalLight((0, -1, 0))
    found = [shade_of(pane.moved((0, 20, 0), tilt=-90), light=light, backend=name) for name in ("numpy", *others)]
    expected = np.kron([[0.5, 0.0], [1.0, 0.25]], np.ones((8, 8)))
    np.testing.assert_allclose(found[0].pixels[..., 0], expected, rtol=1e-5)
    for other in found[1:]:
        same(found[0], other)


def test_the_border_lies_where_the_number_is_one_half():
    """Between texels of 0 and 1 the interpolated value is 1/2, the border, in the middle of the picture."""
    ramp = Texture([[0.0, 1.0]], wrap="clamp")
    scene = Scene([SQUARE.with_material(Material(cutout=ramp))], (), AHEAD)
    found = render(scene, (16, 16), backend="numpy", bounces=0)
    np.testing.assert_array_equal(found.object_id, np.broadcast_to(np.arange(16) >= 8, (16, 16)) - 1)


@pytest.mark.slow
def test_backends_and_accelerators_agree_to_the_last_bit():
    scene = everything()
    size = 30, 20
    first = render(scene, size, backend="numpy", bounces=2)
    assert len(np.unique(first.object_id)) == 6
    for backend in ("opencl", "glsl"):
        same(first, render(scene, size, backend=backend, bounces=2))
    for accel in ("grid", "brute"):
        same(first, render(scene, size, backend="numpy", bounces=2, accel=accel))


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [1, 4, 8, 16])
def test_every_width_agrees(lanes):
    scene = everything()
    renderer = Renderer(scene, backend="opencl", bounces=2)
    renderer.kernel = renderer.program.compile("opencl", lanes=lanes, loop_limit=None)
    same(renderer.render((48, 32)), render(scene, (48, 32), backend="numpy", bounces=2))


@pytest.mark.slow
@pytest.mark.parametrize(
    "backend", ["numpy", *(pytest.param(name, marks=pytest.mark.slow) for name in ("opencl", "glsl"))]
)
def test_the_staged_tracer_agrees(backend):
    screen, *_, ground = everything().meshes
    scene = Scene([screen, ground], [DirectionalLight((1, -2, -1))], Camera((0, 2, 6), (0, 0.8, 0), fov=45))
    staged = render(scene, (24, 16), backend=backend, bounces=0, tracer="staged")
    assert set(np.unique(staged.object_id)) == {-1, 0, 1}
    same(staged, render(scene, (24, 16), backend=backend, bounces=0, accel="grid"))


@pytest.mark.slow
def test_path_tracing_agrees_on_every_backend():
    meshes = everything().meshes
    scene = Scene([meshes[1], meshes[-1]], (EnvironmentLight((1, 1, 1)),), Camera((0, 2, 6), (0, 0.8, 0), fov=45))
    given = {"integrator": "path", "samples": 2, "bounces": 2}
    first = render(scene, (16, 12), backend="numpy", **given)
    for backend in ("opencl", "glsl"):
        same(first, render(scene, (16, 12), backend=backend, **given))


def test_a_lamp_with_holes_gives_half_the_light():
    """Only the opaque parts of the square light shine, in every way of sampling them."""
    lamp = Material((0, 0, 0), specular=0, emission=(1, 1, 1))
    ground = floor(4, Material((1, 1, 1), 1.0, 0.0))
    camera = Camera((0, 0.5, 0), (0, 0, 0), up=(0, 0, -1), fov=1)
    means = []
    for material in (lamp, dataclasses.replace(lamp, cutout=HOLES)):
        hung = SQUARE.with_material(material).moved((0, 8, 0), tilt=90)
        scene = Scene([ground, hung], (), camera, background=(0, 0, 0))
        image = render(scene, (40, 40), backend="numpy", integrator="path", samples=2, bounces=1)
        means.append(float(image.pixels.mean()))
    assert means[0] == pytest.approx(4 / (np.pi * 64), rel=0.04)  # 2 % less, as its corners are farther
    assert means[1] == pytest.approx(means[0] / 2, rel=0.06)


def test_emission_of_a_picture():
    """A picture is as bright as its numbers say, and lights as its mean does from far away."""
    picture = Texture(np.array([[[2.0, 0, 0], [0, 0, 0]]]), filter="nearest")
    lamp = Material((0, 0, 0), specular=0, emission=picture)
    seen = render(Scene([SQUARE.with_material(lamp)], (), AHEAD), (4, 4), backend="numpy", bounces=0).pixels
    np.testing.assert_allclose(seen[0], [[2, 0, 0]] * 2 + [[0, 0, 0]] * 2)
    ground = floor(4, Material((1, 1, 1), 1.0, 0.0))
    camera = Camera((0, 0.5, 0), (0, 0, 0), up=(0, 0, -1), fov=1)
    scene = Scene([ground, SQUARE.with_material(lamp).moved((0, 8, 0), tilt=90)], (), camera, background=(0, 0, 0))
    image = render(scene, (40, 40), backend="numpy", integrator="path", samples=2, bounces=1)
    assert float(image.pixels[..., 0].mean()) == pytest.approx(4 / (np.pi * 64), rel=0.06)
    assert not image.pixels[..., 1:].any()


def test_a_scene_without_cutouts_has_no_filter():
    plain = Renderer(Scene.builtin("boxes"), backend="numpy")
    assert plain._tracer.intersector.accept is None
    assert "cutouts" not in plain.features


def test_alpha_is_read_on_demand(tmp_path):
    from PIL import Image as pillow

    pixels = np.array([[[255, 0, 0, 0], [0, 255, 0, 128]]], np.uint8)
    pillow.fromarray(pixels).save(tmp_path / "leaf.png")
    for source in (tmp_path / "leaf.png", pixels):
        np.testing.assert_allclose(Texture(source, alpha=True).image[..., 0], [[0, 128 / 255]], rtol=1e-6)
    pillow.fromarray(pixels[..., :3]).save(tmp_path / "bare.png")
    pillow.new("LAB", (2, 1), (128, 40, 40)).save(tmp_path / "lab.tiff")  # its A is no alpha
    for source in (tmp_path / "bare.png", tmp_path / "lab.tiff", pixels[..., :3], pixels[..., 0]):
        assert (Texture(source, alpha=True).image == 1).all()


@pytest.mark.parametrize(("mode", "clear"), [("RGB", (255, 0, 0)), ("L", 200), ("1", 1)])
def test_one_colour_of_a_png_file_may_be_clear(tmp_path, mode, clear):
    from PIL import Image as pillow

    picture = pillow.new(mode, (2, 1))
    picture.putpixel((0, 0), clear)
    picture.save(tmp_path / "keyed.png", transparency=clear)
    assert Texture(tmp_path / "keyed.png", alpha=True).image[..., 0].tolist() == [[0, 1]]


def test_wrong_cutouts():
    with pytest.raises(SceneError, match=r"cutout is a Texture or None, not 0.5; .* transmission=..., ior=1"):
        Material(cutout=0.5)
    bare = Mesh([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]], name="bare", material=RED)
    with pytest.raises(SceneError, match="bare: a Texture needs uv coordinates"):
        render(Scene(bare), (4, 4), backend="numpy")
