import os

import numpy as np
import pytest
from PIL import Image as pillow

from raytracer import Image, SceneError
from raytracer.image import Stats, writer

STATS = Stats("numpy", 0.0, 0.0, 0.0, 0.0, 6, 1)


@pytest.fixture
def image():
    rng = np.random.default_rng(0)
    pixels = rng.uniform(0, 1, (4, 6, 3)).astype(np.float32)
    normal = rng.normal(size=(4, 6, 3)).astype(np.float32)
    ids = np.arange(24, dtype=np.int32).reshape(4, 6) - 1
    depth = np.where(ids < 0, np.inf, 1 + ids).astype(np.float32)
    return Image(pixels, depth, normal, ids, np.ones((4, 6), np.int32), STATS)


def test_png_is_srgb(image, tmp_path):
    from PIL import Image as pillow

    image.pixels[0, :5, 0] = [0, 0.002, 0.21404, 1, 7]
    path = image.save(tmp_path / "a.png")
    read = np.asarray(pillow.open(path))
    assert read.shape == (4, 6, 3)
    assert read[0, :5, 0].tolist() == [0, 7, 127, 255, 255]


def test_npy_keeps_every_layer(image, tmp_path):
    read = np.load(image.save(tmp_path / "a.npy"))
    for name in ("pixels", "depth", "normal", "object_id", "rays"):
        np.testing.assert_array_equal(read[name], getattr(image, name))


def test_exr_keeps_every_layer(image, tmp_path):
    import OpenEXR as exr

    with exr.File(str(image.save(tmp_path / "a.exr")), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    np.testing.assert_array_equal(np.stack([channels[c] for c in "RGB"], axis=-1), image.pixels)
    np.testing.assert_array_equal(channels["depth.Z"], image.depth)
    np.testing.assert_array_equal(channels["normal.Y"], image.normal[..., 1])
    np.testing.assert_array_equal(channels["object.id"], image.object_id)
    np.testing.assert_array_equal(channels["rays.count"], image.rays)


def test_an_interrupted_write_leaves_the_old_file_alone(image, tmp_path, monkeypatch):
    path = image.save(tmp_path / "a.npy")
    before = path.read_bytes()

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "save", stopped)
    with pytest.raises(KeyboardInterrupt):
        image.save(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["a.npy"]


def test_wrong_paths_are_named(image, tmp_path):
    with pytest.raises(SceneError, match=r"\.png, \.jpg, \.jpeg, \.webp, \.exr, \.npy, not as \.gif"):
        image.save(tmp_path / "a.gif")
    with pytest.raises(FileNotFoundError, match="no folder"):
        image.save(tmp_path / "gone" / "a.png")
    with pytest.raises(SceneError, match=f"{tmp_path} is a folder: name a file in it, such as {tmp_path}/picture.png"):
        image.save(tmp_path)
    assert os.listdir(tmp_path) == []


def test_it_shows_itself_in_a_notebook(image):
    assert image._repr_png_().startswith(b"\x89PNG")


def test_webp_loses_nothing(image, tmp_path):
    with pillow.open(image.save(tmp_path / "picture.webp")) as found:
        np.testing.assert_array_equal(np.asarray(found.convert("RGB")), image.srgb)


@pytest.mark.parametrize("ending", ["jpg", "jpeg"])
def test_jpeg_keeps_colours_better_than_by_default(image, tmp_path, ending):
    """By default each four pixels share a colour, which noise shows."""

    def off(path):
        with pillow.open(path) as found:
            return np.abs(np.asarray(found).astype(int) - image.srgb).max()

    image.to_pil().save(tmp_path / "default.jpg")
    assert off(image.save(tmp_path / f"picture.{ending}")) < off(tmp_path / "default.jpg") / 4


def test_it_is_an_array_and_a_picture_of_pillow(image):
    assert np.shares_memory(np.asarray(image), image.pixels)
    np.testing.assert_array_equal(np.asarray(image, np.float64), image.pixels)
    copied = np.array(image)
    copied[0] = 9
    assert image.pixels[0].max() < 9
    np.testing.assert_array_equal(np.asarray(image.to_pil()), image.srgb8())


@pytest.mark.parametrize(("ending", "side"), [(".webp", 16_384), (".jpg", 65_501)])
def test_sizes_that_a_format_cannot_hold_are_refused_before_anything_is_rendered(tmp_path, ending, side):
    with pytest.raises(SceneError, match=f"{ending[1:]} holds at most .* pixels a side, not {side:,}: .png"):
        writer(tmp_path / f"a{ending}", (4, side))
