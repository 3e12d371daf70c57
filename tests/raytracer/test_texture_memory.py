"""Pictures are held once as a Texture and once as a table; nothing of their size is made in between. Triangles, too."""

import tracemalloc

import numpy as np
import pytest

import shpy as sh
from raytracer import Camera, Material, Mesh, Scene, Texture
from raytracer.integrators.integrator import Path
from raytracer.integrators.origin import origin_of
from raytracer.kernels import walk
from raytracer.kernels.appearance import Atlas
from raytracer.kernels.eye_rays import EyeRays
from raytracer.kernels.path import PathTracer
from raytracer.meshes.shapes import sphere
from raytracer.scene.layout import Layout

GREY = Material((0.5, 0.5, 0.5))
SIDE = 1024
TEXELS = SIDE * SIDE * 4
"""Bytes of a number of each texel."""


def allocated(run):
    """Return what `run` gives, and the bytes that it held at most beyond those before."""
    tracemalloc.start()
    try:
        result = run()
        return result, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module")
def floats():
    return np.random.default_rng(1).random((SIDE, SIDE, 3), np.float32)


def test_colours_are_decoded_some_rows_at_a_time(floats):
    for pixels in (floats, floats.astype(np.float64), (255 * floats).astype(np.uint8)):
        texture, most = allocated(lambda pixels=pixels: Texture(pixels, srgb=True))
        assert most < 3 * TEXELS + 2 * TEXELS
        part = Texture(pixels[500:501], srgb=True)
        np.testing.assert_array_equal(texture.image[500:501], part.image)


def test_an_atlas_is_filled_in_its_table(floats):
    textures = [Texture(floats), Texture(floats[:100, :7])]
    atlas, most = allocated(lambda: Atlas(textures))
    assert most < 4 * TEXELS + TEXELS
    texels = atlas.texels.data(np.float32).array
    np.testing.assert_array_equal(texels[: SIDE * SIDE, :3].reshape(floats.shape), floats)
    np.testing.assert_array_equal(texels[SIDE * SIDE :, :3].reshape(100, 7, 3), floats[:100, :7])
    assert not texels[:, 3].any()


def test_a_device_takes_the_memory_of_a_table_of_its_own_type(floats):
    table = sh.Table(floats.reshape(-1, 3), sh.Attrib3f)
    data, most = allocated(lambda: table.data(np.float32))
    assert most < TEXELS / 100
    assert not data.array.flags.writeable
    table.update([[1, 2, 3]], start=5)
    assert data.array[5].tolist() == [1, 2, 3]
    assert np.array_equal(table[5], [1, 2, 3])
    before = data.array
    table.update(np.zeros_like(floats).reshape(-1, 3))
    assert before[5].tolist() == [1, 2, 3]
    assert not table.data(np.float32).array.any()


def test_a_table_of_another_precision_is_its_own_memory():
    table = sh.Table(np.arange(8, dtype=np.float32), sh.Attrib1f)
    single, double = table.data(np.float32), table.data(np.float64)
    table.update([7.5], start=2)
    assert single.array[2] == double.array[2] == 7.5
    assert not np.shares_memory(single.array, double.array)


def test_the_origin_of_a_picture_is_a_digest_without_a_copy(floats):
    material = Material(Texture(floats))
    mesh = Mesh(np.eye(3), [[0, 1, 2]], uv=[(0, 0), (1, 0), (0, 1)], material=material)
    scene = Scene([mesh], camera=Camera((3, 3, 3), (0, 0, 0)))
    layout = Layout.of(scene)
    tracer = PathTracer(layout, scene, 1, "numpy")
    _, most = allocated(lambda: origin_of(scene, layout, tracer, scene.camera, Path(), "numpy"))
    assert most < TEXELS


@pytest.mark.parametrize("backend", ["numpy", "opencl"])
def test_a_triangle_of_a_large_path_traced_scene_takes_at_most_250_bytes(monkeypatch, backend):
    """With normals, uv coordinates, several materials and objects."""
    monkeypatch.setattr(walk, "ROOMY", walk.MANY)
    picture = Material(Texture(np.eye(4)))
    balls = [
        sphere(0.5, material, rings=50, segments=83).moved((x, 0, 0)) for x, material in enumerate((picture, GREY))
    ]
    scene = Scene(balls, camera=Camera((0, 0, 3), (0, 0, 0)))
    tracer = PathTracer(Layout.of(scene, backend=backend), scene, 4, backend)
    tables = tracer.program(EyeRays()).recorded.tables.values()
    bytes_ = sum(table.data(np.float32).array.nbytes for table in tables)
    assert scene.triangles > walk.ROOMY
    assert 150 < bytes_ / scene.triangles <= 250
