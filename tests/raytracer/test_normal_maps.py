"""Test normal maps: of glTF, and of materials."""

import dataclasses

import numpy as np
import pytest
from gltf_files import SQUARE, File
from scene_pictures import same

from raytracer import Camera, Instance, Material, Mesh, PointLight, Scene, SceneError, Texture, render
from raytracer.meshes.shapes import sphere

AHEAD = Camera((0, 0, 4), (0, 0, 0), fov=45)
LIGHTS = (PointLight((2, 3, 5)),)
UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
FACES = [[0, 1, 2], [0, 2, 3]]
SLOPE = np.array([0.48, 0.36, 0.8])


def mapped(normal, shape=(1, 1)):
    return Texture(np.broadcast_to((np.asarray(normal) + 1) / 2, (*shape, 3)).astype(np.float32), srgb=False)


def normals_of(mesh, texture, backend="numpy", camera=AHEAD):
    material = Material(normal_map=texture)
    image = render(Scene([mesh.with_material(material)], LIGHTS, camera), (9, 9), backend=backend, bounces=0)
    return image.normal[4, 4]


def square(uv=UV, vertices=SQUARE):
    return Mesh(vertices, FACES, uv=uv)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_red_leans_to_u_and_green_to_v(backend):
    np.testing.assert_allclose(normals_of(square(), mapped(SLOPE), backend), SLOPE, atol=1e-6)


@pytest.mark.parametrize(
    ("uv", "expected"),
    [
        (UV[:, ::-1], (0.36, 0.48, 0.8)),  # u goes up and v to the right: mirrored
        (UV * (-1, 1), (-0.48, 0.36, 0.8)),
        (np.roll(UV, 1, axis=0), (-0.36, 0.48, 0.8)),  # u goes up, v to the left
        (UV * (5, 0.1) + 3, SLOPE),
        (UV * 0, (0, 0, 1)),
    ],
)
def test_the_frame_is_that_of_the_uv_coordinates(uv, expected):
    np.testing.assert_allclose(normals_of(square(uv), mapped(SLOPE)), expected, atol=1e-5)


def test_from_behind_what_stood_out_goes_in():
    behind = Camera((0, 0, -4), (0, 0, 0), fov=45)
    np.testing.assert_allclose(normals_of(square(), mapped(SLOPE), camera=behind), -SLOPE, atol=1e-6)


def test_a_mesh_that_is_rotated_takes_its_frame_along():
    turn = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    found = normals_of(Instance(square(), turn).placed, mapped(SLOPE))
    np.testing.assert_allclose(found, turn[:3, :3] @ SLOPE, atol=1e-6)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("integrator", ["whitted", "path"])
@pytest.mark.parametrize("flat", [127, 128])
def test_a_flat_map_changes_no_bit(integrator, flat):
    ball = sphere(rings=12, segments=24)
    texture = Texture(np.full((4, 4, 3), (flat, flat, 255), np.uint8), srgb=False)
    plain, bumpy = (
        render(
            Scene([ball.with_material(material)], LIGHTS, AHEAD),
            (24, 24),
            backend="numpy",
            integrator=integrator,
            samples=1,
        )
        for material in (Material(), Material(normal_map=texture))
    )
    same(bumpy, plain)


def test_the_light_follows_the_map():
    """A slope to the right under a light from the right is brighter, to the left darker."""
    light = (PointLight((30, 0, 30)),)
    seen = []
    for x in (-0.6, 0, 0.6):
        material = Material(normal_map=mapped((x, 0, 0.8)), specular=0.0)
        scene = Scene([square().with_material(material)], light, AHEAD, ambient=0.0)
        seen.append(render(scene, (9, 9), backend="numpy", bounces=0).pixels[4, 4, 0])
    np.testing.assert_allclose(np.divide(seen, seen[1]), [0.2, 1, 1.4], rtol=0.05)


def test_a_map_is_a_texture():
    with pytest.raises(SceneError, match="normal_map is a Texture or None"):
        Material(normal_map=(0, 0, 1))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("scale", [1, 0.5, 2])
def test_the_maps_of_a_gltf_file(scale, tmp_path):
    """Green leans upward in the picture; `scale` multiplies the slopes."""
    file = File()
    pixels = np.full((1, 1, 3), np.rint((SLOPE + 1) / 2 * 255))
    material = file.material(normalTexture={"index": file.picture(pixels), "scale": scale})
    file.node(mesh=file.mesh(file.square(material=material)))
    scene = Scene.load(file.save(tmp_path / "bumpy.glb"))
    image = render(dataclasses.replace(scene, camera=AHEAD), (9, 9), backend="numpy", bounces=0)
    expected = SLOPE * (scale, scale, 1)
    np.testing.assert_allclose(image.normal[4, 4], expected / np.linalg.norm(expected), atol=0.01)
