"""Pictures of 16 bits a channel are read whole: PNG, TIFF and PPM files whose numbers are known by construction."""

import struct
import zlib
from io import BytesIO

import numpy as np
import pytest
from gltf_files import File

from raytracer import Scene, SceneError, Texture
from raytracer.appearance.textures import decoded, opened, pixels_of
from raytracer.meshes import pictures
from raytracer.meshes.folder import Notices

GREY, RGB, GREY_ALPHA, RGBA = 0, 2, 4, 6
CHANNELS = {GREY: 1, RGB: 3, GREY_ALPHA: 2, RGBA: 4}
ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
"""The passes of PNG's interlacing: first column and row, steps across and down."""


def chunk(name, data):
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def filtered(numbers, rng):
    """Return the rows of a PNG picture, each by a filter drawn at random."""
    size = 2 * numbers.shape[2]
    rows = np.ascontiguousarray(numbers, ">u2").view(np.uint8).reshape(len(numbers), -1).astype(int)
    before, found = np.zeros(rows.shape[1], int), []
    for row in rows:
        left = np.concatenate([np.zeros(size, int), row[:-size]]) if size < len(row) else np.zeros_like(row)
        corner = np.concatenate([np.zeros(size, int), before[:-size]]) if size < len(row) else np.zeros_like(row)
        p = left + before - corner
        away = np.stack([abs(p - left), abs(p - before), abs(p - corner)])
        paeth = np.choose(away.argmin(axis=0), [left, before, corner])
        kind = int(rng.integers(5))
        guess = [np.zeros_like(row), left, before, (left + before) // 2, paeth][kind]
        found.append(bytes([kind]) + ((row - guess) % 256).astype(np.uint8).tobytes())
        before = row
    return b"".join(found)


def png(numbers, kind, rng, *, interlaced=False, key=None):
    height, width, _ = numbers.shape
    if interlaced:
        parts = [numbers[y::down, x::across] for x, y, across, down in ADAM7]
        data = b"".join(filtered(part, rng) for part in parts if part.size)
    else:
        data = filtered(numbers, rng)
    head = struct.pack(">IIBBBBB", width, height, 16, kind, 0, 0, int(interlaced))
    keyed = b"" if key is None else chunk(b"tRNS", np.asarray(key, ">u2").tobytes())
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + keyed + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")
    )


def tiff(numbers, order, *, compressed=False, predicted=False, extra=None, planes=False, photometric=2):
    """Return a TIFF file of one strip, or of one for each channel."""
    height, width, channels = numbers.shape
    held = numbers.astype(np.uint16)
    if predicted:
        held = np.concatenate([held[:, :1], np.diff(held, axis=1)], axis=1)
    parts = np.moveaxis(held, 2, 0) if planes else [held]
    strips = [np.ascontiguousarray(part, f"{order}u2").tobytes() for part in parts]
    strips = [zlib.compress(strip) if compressed else strip for strip in strips]
    tags = {
        256: ("H", [width]), 257: ("H", [height]), 258: ("H", [16] * channels), 259: ("H", [8 if compressed else 1]),
        262: ("H", [photometric]), 273: ("I", []), 277: ("H", [channels]), 278: ("H", [height]),
        279: ("I", [len(strip) for strip in strips]), 284: ("H", [2 if planes else 1]),
    }  # fmt: skip
    if predicted:
        tags[317] = ("H", [2])
    if extra is not None:
        tags[338] = ("H", [extra])
    start = 8 + 2 + 12 * len(tags) + 4
    tags[273] = ("I", [0] * len(strips))
    longer = sum(len(values) * struct.calcsize(f"={kind}") for kind, values in tags.values())
    first = start + longer + 8
    tags[273] = ("I", [first + sum(map(len, strips[:k])) for k in range(len(strips))])
    entries, tail = b"", b""
    for tag, (kind, values) in sorted(tags.items()):
        data = struct.pack(f"{order}{len(values)}{kind}", *values)
        if len(data) > 4:
            place, data = start + len(tail), data
            tail += data
            data = struct.pack(f"{order}I", place)
        entries += struct.pack(f"{order}HHI", tag, 3 if kind == "H" else 4, len(values)) + data.ljust(4, b"\0")
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}I", 8)
    found = head + struct.pack(f"{order}H", len(tags)) + entries + bytes(4) + tail
    return found.ljust(first, b"\0") + b"".join(strips)


def share(numbers):
    return np.float32(numbers) / np.float32(65535)


def read(data, **options):
    with opened(BytesIO(data)) as picture:
        return pixels_of(picture, **options)


def same(found, expected):
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found.reshape(expected.shape), expected)


@pytest.mark.parametrize("interlaced", [False, True])
@pytest.mark.parametrize("kind", CHANNELS)
@pytest.mark.parametrize("size", [(1, 1), (3, 2), (9, 13)])
def test_png(kind, interlaced, size):
    rng = np.random.default_rng(kind)
    numbers = rng.integers(0, 65536, (*size, CHANNELS[kind]))
    data = png(numbers, kind, rng, interlaced=interlaced)
    clear = kind in (GREY_ALPHA, RGBA)
    same(read(data), share(numbers[..., :-1] if clear else numbers))
    alpha = read(data, alpha=True)
    if clear:
        same(alpha, share(numbers[..., -1]))
    else:
        assert alpha is None


@pytest.mark.parametrize("kind", [GREY, RGB])
def test_the_clear_colour_of_png(kind):
    numbers = np.array([[[1000] * CHANNELS[kind], [1001] * CHANNELS[kind]]])
    data = png(numbers, kind, np.random.default_rng(0), key=numbers[0, 0])
    same(read(data, alpha=True), np.float32([[0, 1]]))
    same(read(data), share(numbers))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("channels", [3, 4])
def test_tiff(order, compressed, channels):
    numbers = np.random.default_rng(channels).integers(0, 65536, (5, 6, channels))
    data = tiff(numbers, order, compressed=compressed, extra=2 if channels == 4 else None)
    same(read(data), share(numbers[..., :3]))
    if channels == 4:
        same(read(data, alpha=True), share(numbers[..., 3]))


@pytest.mark.parametrize("order", ["<", ">"])
def test_tiff_with_a_predictor(order):
    numbers = np.random.default_rng(1).integers(0, 65536, (5, 6, 3))
    same(read(tiff(numbers, order, compressed=True, predicted=True)), share(numbers))


def test_tiff_with_colours_that_alpha_has_multiplied():
    numbers = np.array([[[30000, 20000, 10000, 40000], [0, 0, 0, 0]]])
    found = read(tiff(numbers, "<", extra=1))
    np.testing.assert_allclose(found, [[[0.75, 0.5, 0.25], [0, 0, 0]]], rtol=1e-6)


def test_tiff_of_four_inks():
    numbers = np.array([[[0, 16384, 65535, 32768]]])
    found = read(tiff(numbers, ">", photometric=5))
    np.testing.assert_allclose(found, [[(1 - share(numbers[0, 0, :3])) * (1 - share(32768))]], rtol=1e-6)


@pytest.mark.parametrize("compressed", [False, True])
def test_tiff_in_planes_is_refused(compressed):
    numbers = np.random.default_rng(2).integers(0, 65536, (5, 6, 3))
    with pytest.raises(
        SceneError, match=r"^its channels of 16 bits lie in planes, which are not read: save it with inter"
    ):
        read(tiff(numbers, "<", compressed=compressed, planes=True))


@pytest.mark.parametrize("most", [256, 1023, 65535])
def test_ppm(most, tmp_path):
    numbers = np.random.default_rng(most).integers(0, most + 1, (4, 3, 3))
    head = f"3 4\n{most}\n"
    words = " ".join(map(str, numbers.ravel())).replace(" ", "\n# a comment\n", 1)
    expected = np.float32(numbers) / np.float32(most)
    same(read(f"P6\n{head}".encode() + numbers.astype(">u2").tobytes()), expected)
    same(read(f"P3\n{head}{words}\n".encode()), expected)
    with pytest.raises(SceneError, match="it ends after 9 of 36 numbers"):
        read(f"P6\n{head}".encode() + numbers[:1].astype(">u2").tobytes())


def test_a_texture_of_16_bits_is_decoded_from_srgb(tmp_path):
    numbers = np.random.default_rng(3).integers(0, 65536, (4, 5, 4))
    path = tmp_path / "deep.png"
    path.write_bytes(png(numbers, RGBA, np.random.default_rng(0)))
    np.testing.assert_allclose(Texture(path).image, decoded(numbers[..., :3] / 65535), rtol=1e-6)
    np.testing.assert_array_equal(Texture(path, srgb=False).image, share(numbers[..., :3]))
    np.testing.assert_array_equal(Texture(path, alpha=True).image[..., 0], share(numbers[..., 3]))


def test_a_normal_map_of_a_file_keeps_its_slopes(tmp_path):
    numbers = np.full((2, 2, 3), (32768 + 40, 32768, 65535))
    file = File()
    source = file.add("images", {"bufferView": file.view(png(numbers, RGB, np.random.default_rng(0)))})
    texture = file.add("textures", {"source": source})
    file.node(mesh=file.mesh(file.square(material=file.material(normalTexture={"index": texture}))))
    scene = Scene.load(file.save(tmp_path / "bumps.glb"))
    np.testing.assert_allclose(scene.meshes[0].material.normal.image[0, 0], numbers[0, 0] / 65535, atol=1e-7)


@pytest.mark.parametrize("kind", CHANNELS)
def test_a_picture_that_is_too_large_is_made_smaller_in_16_bits(kind, monkeypatch):
    numbers = np.random.default_rng(kind).integers(0, 65536, (8, 8, CHANNELS[kind]))
    data = png(numbers, kind, np.random.default_rng(0))
    monkeypatch.setattr(pictures, "MOST", 32)
    found = pictures.Pictures(Notices("a")).get(0, "a", lambda: BytesIO(data)).pixels
    colours = CHANNELS[kind] - (kind in (GREY_ALPHA, RGBA))
    means = (numbers / 65535).reshape(4, 2, 4, 2, -1).mean(axis=(1, 3))[..., :colours]
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, means, rtol=1e-6)
