"""Pictures with alpha: coverage of the eye rays, premultiplied light, and files that hold both."""

import dataclasses

import numpy as np
import pytest
from PIL import Image as pillow
from scene_pictures import same

from raytracer import (
    Camera,
    EnvironmentLight,
    Image,
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
from raytracer.cli import main
from raytracer.meshes.shapes import floor, sphere
from shpy import Program

SIZE = 24, 16
BALL = sphere(0.5, Material((0.8, 0.3, 0.2))).moved((0, 0.5, 0))
CAMERA = Camera((0, 1.2, 4), (0, 0.5, 0))
SCENE = Scene([BALL, floor(1.5)], [PointLight((2, 4, 3))], CAMERA)
SKY = Texture(np.random.default_rng(3).random((6, 12, 3)).astype(np.float32), srgb=False)
INTEGRATORS = [Whitted(), Whitted(samples=9), Staged(samples=4), Path(samples=9, bounces=2)]


def named(integrator):
    return f"{type(integrator).__name__} {integrator.samples}"


@pytest.mark.sampled(4)
@pytest.mark.parametrize("integrator", INTEGRATORS, ids=named)
def test_light_over_a_background_is_the_opaque_picture(integrator):
    """Premultiplied colours plus the background times (1 - alpha) are the picture with the background."""
    seen = render(SCENE, SIZE, integrator=integrator, backend="numpy", transparent=True)
    opaque = render(SCENE, SIZE, integrator=integrator, backend="numpy")
    over = seen.pixels + (1 - seen.alpha[..., None]) * np.float32(SCENE.background)
    np.testing.assert_allclose(over, opaque.pixels, atol=2e-6)
    assert opaque.alpha is None
    assert set(np.unique(seen.alpha)) >= {0.0, 1.0}
    levels = seen.alpha * integrator.samples  # each eye ray counts alike
    np.testing.assert_allclose(levels, np.rint(levels), atol=1e-5)
    assert (integrator.samples == 1) == (len(np.unique(seen.alpha)) == 2)
    for name in ("depth", "normal", "object_id", "rays"):
        np.testing.assert_array_equal(getattr(seen, name), getattr(opaque, name))


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [Whitted(samples=4), Path(samples=3, bounces=2)], ids=named)
def test_every_backend_has_the_same_bits(integrator):
    images = [render(SCENE, SIZE, integrator=integrator, backend=b, transparent=True) for b in ("numpy", "opencl")]
    same(*images)
    np.testing.assert_array_equal(images[0].alpha, images[1].alpha)


def test_an_environment_lights_what_is_seen_and_is_not_seen_itself():
    scene = dataclasses.replace(SCENE, lights=[EnvironmentLight(SKY)])
    seen = render(scene, SIZE, integrator=Path(samples=4), backend="numpy", transparent=True)
    opaque = render(scene, SIZE, integrator=Path(samples=4), backend="numpy")
    assert (seen.pixels[seen.alpha == 0] == 0).all()
    covered = seen.alpha == 1
    np.testing.assert_array_equal(seen.pixels[covered], opaque.pixels[covered])


def test_mirrors_show_the_background_and_holes_do_not():
    mirror = sphere(1, Material((0, 0, 0), diffuse=0, specular=0, reflectivity=1))
    scene = Scene([mirror], [], Camera((0, 0, 4), (0, 0, 0)), background=(0.2, 0.3, 0.4))
    for integrator in (Whitted(), Path(samples=1)):
        seen = render(scene, SIZE, integrator=integrator, backend="numpy", transparent=True)
        np.testing.assert_allclose(seen.pixels[8, 12], (0.2, 0.3, 0.4), rtol=1e-6)
    veil = sphere(1, MetallicRoughness((1, 1, 1), alpha=0.25))
    scene = Scene([veil], [], Camera((0, 0, 4), (0, 0, 0), fov=20), background=(1, 1, 1))
    seen = render(scene, (8, 8), integrator=Path(samples=512, bounces=1), backend="opencl", transparent=True)
    # Both sides of the ball are passed by chance: 1 - 0.75**2 of the paths are scattered.
    assert abs(seen.alpha[2:6, 2:6].mean() - (1 - 0.75**2)) < 0.02


def test_files_hold_straight_and_premultiplied_alpha(tmp_path):
    image = render(SCENE, SIZE, integrator=Whitted(samples=9), backend="numpy", transparent=True)
    for ending in (".exr", ".npy"):
        read = Image.load(image.save(tmp_path / f"p{ending}"))
        np.testing.assert_array_equal(read.alpha, image.alpha)
        np.testing.assert_array_equal(read.pixels, image.pixels)
        assert list(read.layers) == list(image.layers)
    for ending in (".png", ".webp"):
        pixels = np.asarray(pillow.open(image.save(tmp_path / f"p{ending}")))
        assert pixels.shape == (16, 24, 4)
        np.testing.assert_array_equal(pixels[..., 3], np.rint(image.alpha * 255))
    pixels = np.asarray(pillow.open(image.save(tmp_path / "p.png", tonemap="neutral")))
    part = (image.alpha > 0) & (image.alpha < 1)
    assert part.any()
    # A pixel on the edge has the colour of the surface, not one mixed with black.
    straight = dataclasses.replace(image, pixels=image.straight, alpha=None).to_pil(tonemap="neutral")
    np.testing.assert_array_equal(pixels[part, :3], np.asarray(straight)[part])
    with pytest.raises(SceneError, match=r"jpg holds no alpha: write a transparent picture as \.png, \.webp or \.exr"):
        image.save(tmp_path / "p.jpg")


def test_a_transparent_picture_goes_on_bit_for_bit(tmp_path):
    renderer = Renderer(SCENE, integrator=Path(samples=6, bounces=2), backend="numpy")
    whole = renderer.render(SIZE, transparent=True)
    part = renderer.render(SIZE, samples=2, transparent=True).save(tmp_path / "p.exr")
    resumed = renderer.render(SIZE, resume=part, transparent=True)
    np.testing.assert_array_equal(resumed.pixels, whole.pixels)
    np.testing.assert_array_equal(resumed.alpha, whole.alpha)
    with pytest.raises(SceneError, match=r"differ in: transparent \(True in the picture, not noted here\)"):
        renderer.render(SIZE, resume=part)
    opaque = renderer.render(SIZE, samples=2)
    with pytest.raises(SceneError, match=r"differ in: transparent \(not noted in the picture, True here\)"):
        renderer.render(SIZE, resume=opaque, transparent=True)


def test_a_scene_without_triangles_is_clear():
    for integrator in (Whitted(), Path(samples=2)):
        image = render(Scene([]), (4, 3), integrator=integrator, backend="numpy", transparent=True)
        assert not image.alpha.any()
        assert not image.pixels.any()


@pytest.mark.parametrize("options", [{"cluster": "local:2"}, {"max_error": 1.0}])
def test_clusters_and_trade_offs_refuse_alpha(options):
    with pytest.raises(SceneError, match="a transparent picture is rendered by this process as it is"):
        render(SCENE, SIZE, transparent=True, **options)


def test_the_command_writes_alpha(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command = ["render", "boxes", "--size", "16x12", "--backend", "numpy", "--transparent"]
    assert main([*command, "-o", "p.png"]) == 0
    assert pillow.open("p.png").mode == "RGBA"
    assert main([*command, "-o", "p.jpg"]) == 1
    assert "jpg holds no alpha" in capsys.readouterr().err


def test_the_first_picture_needs_one_kernel(monkeypatch):
    compiled = []
    compile_program = Program.compile

    def counted(program, *args, **named):
        compiled.append(program)
        return compile_program(program, *args, **named)

    monkeypatch.setattr(Program, "compile", counted)
    render(SCENE, (4, 4), integrator=Path(samples=1), backend="numpy", transparent=True)
    assert len(compiled) == 1
