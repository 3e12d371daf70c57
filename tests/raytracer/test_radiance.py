"""Pictures of more than 8 bits: files of Radiance and OpenEXR as textures and skies, deep PNG and TIFF files."""

from __future__ import annotations

import numpy as np
import OpenEXR
import pytest
from PIL import Image as pillow

from raytracer import Camera, EnvironmentLight, Path, Scene, Texture, render
from raytracer.appearance.materials import Material
from raytracer.errors import SceneError
from raytracer.meshes.shapes import icosahedron

HEAD = b"#?RADIANCE\n# a comment\nFORMAT=32-bit_rle_rgbe\n"
PIXELS = np.random.default_rng(5).integers(0, 256, (6, 20, 4), np.uint8)
PIXELS[2, :, 3] = 0  # black, whatever the mantissas are
PIXELS[3] = (10, 20, 30, 129)  # one colour in a whole row
PIXELS[..., 0] |= 2  # no pixel looks like a run


def colors(pixels):
    """Return the colours of mantissas and exponents as Radiance's manual says, a number at a time."""
    found = np.zeros((*pixels.shape[:2], 3), np.float32)
    for at in np.ndindex(*pixels.shape[:2]):
        *mantissas, exponent = (int(x) for x in pixels[at])
        found[at] = [(m + 0.5) / 256 * 2.0 ** (exponent - 128) if exponent else 0 for m in mantissas]
    return found


def in_runs(pixels):
    """Write rows channel by channel: a run where a byte repeats at least 4 times, else one literal of at most 3."""
    content = b""
    for row in pixels:
        content += bytes((2, 2, len(row) >> 8, len(row) & 255))
        for line in row.T:
            at = 0
            while at < len(line):
                same = next((k for k in range(at, len(line)) if line[k] != line[at]), len(line)) - at
                step = min(same, 127) if same > 3 else min(3, len(line) - at)
                content += bytes((128 + step, line[at])) if same > 3 else bytes((step, *line[at : at + step]))
                at += step
    return content


def written(folder, data, size=b"-Y 6 +X 20", head=HEAD, name="sky.hdr"):
    path = folder / name
    path.write_bytes(head + b"\n" + size + b"\n" + data)
    return path


@pytest.mark.parametrize("data", [PIXELS.tobytes(), in_runs(PIXELS)], ids=["whole pixels", "runs"])
def test_a_radiance_picture_is_read(tmp_path, data):
    assert np.array_equal(Texture(written(tmp_path, data)).image, colors(PIXELS))


def test_runs_of_whole_pixels_may_be_longer_than_a_byte(tmp_path):
    """The older way: 1, 1, 1, n repeats the last pixel n times, and another such one right after it 256 n times."""
    row = bytes((9, 8, 7, 130)) + bytes((1, 1, 1, 44)) + bytes((1, 1, 1, 1)) + bytes((5, 5, 5, 128))
    image = Texture(written(tmp_path, row, size=b"-Y 1 +X 302")).image
    expected = np.tile(np.array([(9, 8, 7, 130)], np.uint8), (302, 1))
    expected[-1] = (5, 5, 5, 128)
    assert np.array_equal(image, colors(expected[None]))


@pytest.mark.parametrize(
    ("size", "step"), [(b"+Y 6 +X 20", (-1, 1)), (b"-Y 6 -X 20", (1, -1)), (b"+Y 6 -X 20", (-1, -1))]
)
def test_rows_and_columns_may_run_backwards(tmp_path, size, step):
    expected = colors(PIXELS)[:: step[0], :: step[1]]
    assert np.array_equal(Texture(written(tmp_path, PIXELS.tobytes(), size)).image, expected)


def test_exposures_are_divided_out(tmp_path):
    path = written(tmp_path, PIXELS.tobytes(), head=HEAD + b"EXPOSURE=2\nEXPOSURE= 4.0\n")
    assert np.array_equal(Texture(path).image, colors(PIXELS) / 8)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"head": b"P6\n"}, "not a Radiance picture"),
        ({"head": b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n"}, "its FORMAT is 32-bit_rle_xyze"),
        ({"head": HEAD + b"EXPOSURE=-1\n"}, "its EXPOSURE is a positive number"),
        ({"head": HEAD + b"EXPOSURE=1_0\n"}, "its EXPOSURE is a positive number"),
        ({"size": b"+X 20 -Y 6"}, "its size is written as -Y height \\+X width, not '\\+X 20 -Y 6'"),
        ({"size": b"-Y 6 +X 99999"}, "a texture has 1 to 16384 pixels along a side, not 99999 x 6"),
        ({"size": b"-Y 0 +X 20"}, "not 20 x 0"),
        ({"size": b"-Y 7 +X 20"}, "it ends early"),
        ({"data": in_runs(PIXELS)[:-1]}, "it ends early"),
        ({"data": bytes((2, 2, 0, 20, 128 + 21, 5))}, "goes beyond the end of a row"),
        ({"data": bytes((9, 8, 7, 130, 1, 1, 1, 200))}, "goes beyond the end of a row"),
        ({"data": bytes((1, 1, 1, 5))}, "its first pixel repeats another"),
    ],
)
def test_a_broken_radiance_picture_is_an_error_with_its_name(tmp_path, change, message):
    path = written(tmp_path, **({"data": PIXELS.tobytes()} | change))
    with pytest.raises(SceneError, match=message) as error:
        Texture(path)
    assert str(path) in str(error.value)


def test_no_end_of_a_radiance_picture_is_read_silently(tmp_path):
    """Each shortened file is an error: none gives a picture."""
    whole = in_runs(PIXELS)
    for length in range(0, len(whole), 7):
        with pytest.raises(SceneError):
            Texture(written(tmp_path, whole[:length]))


@pytest.mark.parametrize("kind", [np.float32, np.float16])
def test_an_exr_picture_is_read(tmp_path, kind):
    pixels = (np.random.default_rng(6).random((5, 9, 3)) * 4000).astype(kind)
    path = tmp_path / "sky.exr"
    with OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"RGB": pixels}) as file:
        file.write(str(path))
    assert np.array_equal(Texture(path).image, pixels.astype(np.float32))


def test_a_grey_exr_picture_and_one_of_other_channels(tmp_path):
    for name, channels in (
        ("grey", {"Y": np.full((2, 3), 7, np.float32)}),
        ("depth", {"Z": np.ones((2, 3), np.float32)}),
    ):
        with OpenEXR.File({"type": OpenEXR.scanlineimage}, channels) as file:
            file.write(str(tmp_path / f"{name}.exr"))
    assert np.array_equal(Texture(tmp_path / "grey.exr").image, np.full((2, 3, 3), 7))
    with pytest.raises(SceneError, match="it has the channels Z, not R, G and B, or Y alone"):
        Texture(tmp_path / "depth.exr")


def test_a_sky_of_high_range_lights_a_scene_as_its_numbers_do(tmp_path):
    moderate = PIXELS.copy()
    moderate[..., 3] = np.clip(PIXELS[..., 3], 120, 136)
    pictures = [
        render(
            Scene([icosahedron(1, Material((0.8, 0.8, 0.8)))], [EnvironmentLight(sky)], Camera((0, 0, 4))),
            (24, 16),
            integrator=Path(samples=4),
            backend="numpy",
        ).pixels
        for sky in (written(tmp_path, moderate.tobytes()), colors(moderate))
    ]
    assert pictures[0].max() > 1
    assert np.array_equal(*pictures)


def test_files_of_16_bits_are_srgb_and_files_of_floats_linear(tmp_path):
    numbers = np.array([[0.0, 0.5], [0.2, 1.0]])
    for name in ("deep.png", "deep.tiff"):
        pillow.fromarray(np.rint(numbers * 65535).astype(np.uint16)).save(tmp_path / name)
        np.testing.assert_allclose(Texture(tmp_path / name).image[..., 0], [[0, 0.214041], [0.033105, 1]], atol=1e-5)
        np.testing.assert_allclose(Texture(tmp_path / name, srgb=False).image[..., 0], numbers, atol=1e-5)
    pillow.fromarray(numbers.astype(np.float32)).save(tmp_path / "floats.tiff")
    np.testing.assert_array_equal(Texture(tmp_path / "floats.tiff").image[..., 0], numbers.astype(np.float32))
