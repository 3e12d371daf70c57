"""Conversions of colours: against colorsys and the formulas in binary64, and the same bits on every backend."""

import colorsys

import numpy as np
import pytest
from backends.running import covering

import shpy as sh
from shpy import library

RNG = np.random.default_rng(4)
CORNERS = np.stack(np.meshgrid(*[[0, 0.5, 1]] * 3), axis=-1).reshape(-1, 3)
COLORS = np.concatenate([CORNERS, RNG.random((60, 3))]).astype(np.float32)
ODD = np.float32([[-0.0, 2, -1], [np.nan, 0, 1], [np.inf, 1, 0], [-np.inf, 0.5, 3e38], [1e-40, 1e-30, 5]])
on_every_backend = pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
CONVERSIONS = [name for name in library.__all__ if "_from_" in name]


def conversion(*names):
    def convert(c: sh.Color3f) -> sh.Color3f:
        for name in names:
            c = getattr(library, name)(c)
        return c

    return sh.program(convert)


@pytest.mark.sampled(12)
@pytest.mark.parametrize("name", CONVERSIONS)
def test_all_backends_give_the_same_bits(name):
    turn = CONVERSIONS.index(name)
    sh.testing.assert_equivalent(conversion(name), np.concatenate([COLORS, ODD]), backends=covering(turn))


@pytest.mark.sampled(12)
@on_every_backend
@pytest.mark.parametrize("name", ["hsv", "hsl", "srgb", "xyz", "lab"])
def test_there_and_back_again(name, backend):
    there = {"srgb": ["srgb_from_linear"], "xyz": ["xyz_from_linear"], "lab": ["xyz_from_linear", "lab_from_xyz"]}
    back = {"srgb": ["linear_from_srgb"], "xyz": ["linear_from_xyz"], "lab": ["xyz_from_lab", "linear_from_xyz"]}
    whole = [*there.get(name, [f"{name}_from_rgb"]), *back.get(name, [f"rgb_from_{name}"])]
    np.testing.assert_allclose(
        conversion(*whole).compile(backend)(COLORS), COLORS, atol=1e-5 if name == "lab" else 2e-6
    )


@pytest.mark.sampled(3)
@on_every_backend
def test_hues_are_those_of_colorsys(backend):
    hsv = conversion("hsv_from_rgb").compile(backend)(COLORS)
    hsl = conversion("hsl_from_rgb").compile(backend)(COLORS)
    for color, found, light in zip(COLORS.astype(float), hsv, hsl, strict=True):
        np.testing.assert_allclose(found, colorsys.rgb_to_hsv(*color), atol=2e-6)
        h, lightness, s = colorsys.rgb_to_hls(*color)
        np.testing.assert_allclose(light, (h, s, lightness), atol=2e-6)
    np.testing.assert_array_equal(hsv[CORNERS.tolist().index([1, 0, 0])], [0, 1, 1])
    turned = conversion("rgb_from_hsv").compile(backend)([(-1 / 3, 1, 1), (5 / 3, 1, 1)])
    np.testing.assert_allclose(turned, [(0, 0, 1), (0, 0, 1)], atol=1e-6)


@pytest.mark.sampled(6)
@on_every_backend
@pytest.mark.parametrize("precision", ["f32", "f16"])
def test_srgb_is_exact_at_its_ends_and_near_the_standard_between(backend, precision):
    x = np.linspace(0, 1, 258).reshape(-1, 3)
    decoded = conversion("linear_from_srgb").compile(backend, precision=precision)(x)
    encoded = conversion("srgb_from_linear").compile(backend, precision=precision)(x)
    atol = 2e-7 if precision == "f32" else 2e-3
    np.testing.assert_allclose(decoded, np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4), atol=atol)
    np.testing.assert_allclose(encoded, np.where(x <= 0.0031308, x * 12.92, 1.055 * x ** (1 / 2.4) - 0.055), atol=atol)
    for found in (decoded, encoded):
        assert (found[0, 0], found[-1, -1]) == (0, 1)
        assert np.all(np.diff(found.astype(np.float64).ravel()) >= 0)


def test_alpha_stays_and_negative_numbers_mirror():
    color = sh.Color4f(0.5, -0.5, 0.25, 0.125)
    for convert in (library.linear_from_srgb, library.srgb_from_linear):
        found = np.asarray(convert(color))
        assert found[0] == -found[1] != 0.5
        assert found[3] == 0.125
        assert type(convert(color)) is sh.Color4f
        assert np.asarray(convert(0.5)) == found[0]


@pytest.mark.slow
@on_every_backend
def test_white_has_luminance_one_and_no_hue(backend):
    xyz = conversion("xyz_from_linear").compile(backend)((1, 1, 1))
    np.testing.assert_allclose(xyz, [0.3127 / 0.3290, 1, (1 - 0.3127 - 0.3290) / 0.3290], rtol=1e-6)
    np.testing.assert_allclose(conversion("lab_from_xyz").compile(backend)(xyz), [100, 0, 0], atol=1e-4)

    @sh.program
    def light(c: sh.Color3f) -> sh.Attrib1f:
        return library.luminance(c)

    np.testing.assert_allclose(light.compile(backend)(np.eye(3)), [0.2126, 0.7152, 0.0722], rtol=1e-6)
    assert light.compile(backend)((1, 1, 1)) == pytest.approx(1, abs=1e-6)
    lab = conversion("xyz_from_linear", "lab_from_xyz").compile(backend)((1, 0, 0))
    np.testing.assert_allclose(lab, [53.24, 80.09, 67.20], atol=0.02)  # the red of sRGB, as tables have it


def test_a_conversion_wants_three_components():
    with pytest.raises(sh.ShpyTypeError, match="3 components, not 2"):
        library.hsv_from_rgb((1, 2))
