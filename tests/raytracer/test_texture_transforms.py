"""Affine maps of the uv coordinates at which one texture is read: `Texture(transform=...)`."""

import numpy as np
import pytest

import shpy as sh
from raytracer import Camera, EnvironmentLight, Material, Path, Scene, SceneError, Texture, render
from raytracer.integrators.origin import _picture
from raytracer.kernels.appearance import Atlas
from raytracer.meshes.shapes import floor

TURN = ((0.0, -2.0, 0.5), (1.0, 0.25, -3.0))
IMAGE = np.random.default_rng(3).random((4, 5, 3)).astype(np.float32)


@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_a_texture_is_read_at_the_place_that_its_transform_says(backend):
    """Beside textures with another transform and with none; the same bits on every backend."""
    others = Texture(IMAGE, transform=((3, 0, 0), (0, 3, 0))), Texture(IMAGE)
    atlas, plain = Atlas([*others, Texture(IMAGE, transform=TURN)]), Atlas([*others[1:], Texture(IMAGE)])
    uv = np.random.default_rng(4).uniform(-2, 2, (300, 2)).astype(np.float32)

    @sh.program
    def read(uv: sh.TexCoord2f, number: sh.Attrib1i) -> sh.Color3f:
        return atlas.sample(number, uv)

    @sh.program
    def read_plain(uv: sh.TexCoord2f) -> sh.Color3f:
        return plain.sample(1, uv)

    kernel, plainly = read.compile(backend), read_plain.compile("numpy")
    rows = np.float32(TURN)
    moved = uv[:, :1] * rows[:, 0] + uv[:, 1:] * rows[:, 1] + rows[:, 2]
    np.testing.assert_array_equal(kernel(uv, np.int32(2)), plainly(moved))
    np.testing.assert_array_equal(kernel(uv, np.int32(1)), plainly(uv))


def test_a_material_shows_one_picture_several_times():
    scenes = [
        Scene([floor(2, Material(texture, specular=0))], (), Camera((0, 3, 0.001), (0, 0, 0)), ambient=1.0)
        for texture in (
            Texture(IMAGE, filter="nearest", transform=((2, 0, 0), (0, 2, 0))),
            Texture(np.tile(IMAGE, (2, 2, 1)), filter="nearest"),
        )
    ]
    for integrator in ("whitted", Path(samples=4, bounces=1)):
        one, other = (render(s, (24, 24), integrator=integrator, backend="numpy").pixels for s in scenes)
        assert (np.abs(one - other).max(axis=2) > 1e-5).mean() < 0.02  # at the edges of texels f32 may choose the other


def test_a_transform_belongs_to_what_a_picture_is_resumed_by():
    assert len({_picture(Texture(IMAGE, transform=rows)) for rows in (None, TURN, ((1, 0, 0), (0, 1, 0)))}) == 3


def test_the_complement_of_a_texture_has_its_transform():
    assert Texture(IMAGE, transform=TURN).complement.transform == TURN


@pytest.mark.parametrize("transform", [3, ((1, 0), (0, 1)), np.eye(3), ((1, 0, np.nan), (0, 1, 0)), "12"])
def test_other_transforms_are_errors(transform):
    with pytest.raises(SceneError, match="transform of a texture"):
        Texture(IMAGE, transform=transform)


def test_pictures_around_a_scene_have_none():
    with pytest.raises(SceneError, match="rotation= turns it"):
        EnvironmentLight(Texture(IMAGE, transform=TURN))
    with pytest.raises(SceneError, match="its Texture has no transform"):
        Scene([floor(2)], background=Texture(IMAGE, transform=TURN))
