"""Curves for light beyond 1, by their known values, and the pictures that are written with them."""

import numpy as np
import pytest
from PIL import Image as pillow

from raytracer import Image, Scene, SceneError, render
from raytracer.cli import main
from raytracer.image import srgb_bytes
from raytracer.tone_mapping import CURVES, mapped

GREYS = np.geomspace(1e-4, 1e4, 200)[:, None] * np.ones(3)


@pytest.fixture(scope="module")
def image():
    return render(Scene.builtin("boxes"), (16, 12), backend="numpy")


@pytest.mark.parametrize(
    ("tonemap", "light", "expected"),
    [
        ("reinhard", 4.0, 0.8),
        ("agx", 0.18, 0.5**2.2),  # middle grey is at the pivot of the sigmoid
        ("agx", 2.0**-12.47393, 0.0),
        ("agx", 2.0**4.02607, 1.0),
        ("neutral", 0.5, 0.46),
        ("neutral", 0.04, 0.04**2 / 0.16),
        ("aces", 0.18, 0.1056),
    ],
)
def test_greys_have_the_values_of_the_formulas(tonemap, light, expected):
    np.testing.assert_allclose(mapped(np.full((1, 3), light), tonemap), np.full((1, 3), expected), atol=2e-5)


@pytest.mark.parametrize("tonemap", [name for name in CURVES if name != "none"])
def test_curves_rise_and_stay_within_what_a_screen_shows(tonemap):
    shown = mapped(GREYS, tonemap)
    assert (np.diff(shown, axis=0) >= -1e-12).all()
    assert shown.min() > -1e-3
    assert shown.max() < 1.02  # the fit of ACES ends at 1.016
    assert shown[-1, 0] > 0.99
    np.testing.assert_allclose(shown, shown[:, :1] * np.ones(3), atol=2e-5)  # greys stay grey
    np.testing.assert_array_equal(mapped(np.array([-1.0, -2, -3]), tonemap), mapped(np.zeros(3), tonemap))


@pytest.mark.parametrize("tonemap", CURVES)
def test_infinite_light_is_shown_as_very_bright_light(tonemap):
    light = np.array([[[np.inf, np.inf, np.inf], [np.inf, 0, 0], [0, np.inf, 0.5]]], np.float32)
    finite = np.where(np.isinf(light), np.float32(1e38), light)
    np.testing.assert_array_equal(srgb_bytes(light, 0.0, tonemap), srgb_bytes(finite, 0.0, tonemap))


def test_bright_colours_fade_to_white_but_with_none():
    red = np.array([[400.0, 0.5, 0.2]])
    assert mapped(red, "none")[0, 1] == 0.5
    assert all(mapped(red, name)[0, 1] > 0.3 for name in ("aces", "agx", "neutral"))


def test_a_picture_is_written_with_an_exposure_and_a_curve(image, tmp_path):
    path = image.save(tmp_path / "p.png", exposure=1.0, tonemap="agx")
    expected = srgb_bytes(image.pixels, 1.0, "agx")
    np.testing.assert_array_equal(np.asarray(pillow.open(path)), expected)
    np.testing.assert_array_equal(expected, srgb_bytes(mapped(image.pixels, "agx", 1.0)))
    assert (expected != image.srgb).any()
    np.testing.assert_array_equal(image.srgb, srgb_bytes(image.pixels, 0.0, "none"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tonemap": "filmic"}, "tonemap is one of 'none', 'reinhard', 'aces', 'agx', 'neutral', not 'filmic'"),
        ({"tonemap": None}, "tonemap is one of .*, not None"),
        ({"exposure": "bright"}, "an exposure is a number of stops from -64 to 64, not 'bright'"),
        ({"exposure": 65}, "an exposure is a number of stops from -64 to 64, not 65"),
        ({"exposure": float("nan")}, "not nan"),
    ],
)
def test_other_curves_and_exposures_are_refused(image, tmp_path, options, words):
    with pytest.raises(SceneError, match=words):
        image.save(tmp_path / "p.png", **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("options", [{"tonemap": "agx"}, {"exposure": 1}])
@pytest.mark.parametrize("ending", [".exr", ".npy"])
def test_files_of_numbers_hold_the_light_as_it_is(image, tmp_path, ending, options):
    with pytest.raises(SceneError, match=r"exposure and tonemap are for pictures for the eye.*\.exr and \.npy hold"):
        image.save(tmp_path / f"p{ending}", **options)
    path = image.save(tmp_path / f"p{ending}", exposure=0.0, tonemap="none")
    np.testing.assert_array_equal(Image.load(path).pixels, image.pixels)


def test_the_command_takes_a_curve(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command = ["render", "boxes", "--size", "16x12", "--backend", "numpy", "--tonemap", "neutral"]
    assert main([*command, "-o", "n.png"]) == 0
    assert main([*command, "-o", "n.npy"]) == 1
    assert "n.npy: --tonemap is for .png; .exr and .npy hold the light as it is" in capsys.readouterr().err
    plain = render(Scene.builtin("boxes"), (16, 12), backend="numpy")
    np.testing.assert_array_equal(np.asarray(pillow.open("n.png")), srgb_bytes(plain.pixels, 0.0, "neutral"))
