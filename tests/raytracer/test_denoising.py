"""Denoising: what the network gets and gives, and errors. A stand-in takes the place of the package."""

import sys
import types

import numpy as np
import pytest

from raytracer import Camera, Material, MetallicRoughness, Path, PointLight, Scene, SceneError, Whitted, cli, render
from raytracer.meshes.shapes import floor, sphere

RED = (0.8, 0.1, 0.05)


@pytest.fixture
def calls(monkeypatch):
    """The calls of a network that halves the pixels."""
    calls = []

    def denoise(color, albedo, normal, *, hdr, clean_aux):
        calls.append((color, albedo, normal))
        assert hdr
        assert clean_aux
        return color / 2

    monkeypatch.setitem(sys.modules, "pyoidn", types.SimpleNamespace(denoise=denoise))
    return calls


def scene():
    meshes = [
        floor(4, Material(RED)).moved((0, -0.5, 0)),
        sphere(0.5, MetallicRoughness((1, 0.77, 0.34), 1, 0), rings=8, segments=12),
    ]
    return Scene(meshes, [PointLight((2, 4, 3), (9, 9, 9))], Camera((0, 1, 4), (0, 0, 0), fov=30))


def test_the_network_gets_the_pixels_the_colours_and_the_normals(calls):
    options = {"integrator": Path(samples=2), "backend": "numpy"}
    noisy = render(scene(), (16, 12), **options)
    image = render(scene(), (16, 12), denoise=True, **options)
    [(color, albedo, normal)] = calls
    np.testing.assert_array_equal(color, noisy.pixels)
    np.testing.assert_array_equal(image.pixels, noisy.pixels / 2)
    ground = (noisy.object_id == 0) & (np.arange(12) > 9)[:, None]
    np.testing.assert_allclose(albedo[ground], np.broadcast_to(RED, (ground.sum(), 3)), rtol=1e-5)
    ball = albedo[noisy.object_id == 1]
    assert (ball[:, 0] > 1.2 * ball[:, 2]).mean() > 0.8  # a mirror of gold before white and red
    np.testing.assert_allclose(normal[ground], np.broadcast_to((0, 1, 0), (ground.sum(), 3)), atol=1e-6)
    assert 0 <= albedo.min() <= albedo.max() <= 1
    assert {a.dtype for a in calls[0]} == {np.dtype(np.float32)}


def test_a_denoised_picture_has_no_samples_to_add_to(calls):
    image = render(scene(), (8, 6), integrator=Path(samples=1), backend="numpy", denoise=True)
    with pytest.raises(SceneError, match="was not path traced by raytracer, so it has no samples to add to"):
        render(scene(), (8, 6), integrator=Path(samples=2), backend="numpy", resume=image)


def test_a_transparent_picture_stays_black_where_no_surface_is(monkeypatch):
    smooth = types.SimpleNamespace(denoise=lambda color, *guides, **options: color + 0.25)
    monkeypatch.setitem(sys.modules, "pyoidn", smooth)
    options = {"integrator": Path(samples=1), "backend": "numpy", "transparent": True}
    noisy, image = (render(scene(), (16, 12), denoise=denoise, **options) for denoise in (False, True))
    empty = image.alpha == 0
    assert empty.any()
    assert not image.pixels[empty].any()
    np.testing.assert_array_equal(image.pixels[~empty], noisy.pixels[~empty] + 0.25)


def test_an_empty_scene_is_denoised(calls):
    image = render(Scene(background=(0.5, 1, 2)), (4, 3), integrator=Path(samples=1), backend="numpy", denoise=True)
    np.testing.assert_array_equal(image.pixels, np.broadcast_to(np.float32([0.25, 0.5, 1]), (3, 4, 3)))


def test_the_command_denoises_what_it_writes(calls, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["render", "cornell", "--integrator", "path", "--samples", "1", "--size", "8x6", "--backend", "numpy"]
    assert cli.main([*words, "-o", "noisy.npy"]) == 0
    assert cli.main([*words, "--denoise", "-o", "smooth.npy"]) == 0
    noisy, smooth = (np.load(name)["pixels"] for name in ("noisy.npy", "smooth.npy"))
    np.testing.assert_array_equal(smooth, noisy / 2)


def test_errors_say_what_to_do(calls, monkeypatch, capsys):
    with pytest.raises(SceneError, match='denoise is for integrator="path": other pictures have no noise'):
        render(scene(), (4, 3), integrator=Whitted(), denoise=True)
    assert cli.main(["render", "cornell", "--integrator", "path", "--denoise", "--resume", "-o", "a.npy"]) == 1
    message = "--resume adds samples to the output, and --denoise changes its pixels: leave one out"
    assert message in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    with pytest.raises(SceneError, match=r"denoise needs Open Image Denoise: .* install '?pyoidn"):
        render(scene(), (4, 3), integrator=Path(), denoise=True)
