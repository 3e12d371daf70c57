"""Surfaces that no light changes: known colours, what they do to others, and the same bits everywhere."""

import dataclasses

import numpy as np
import pytest
from gltf_files import SQUARE, File
from scene_pictures import same, same_everywhere
from test_file_materials import AHEAD, gltf

from raytracer import (
    Camera,
    EnvironmentLight,
    GBuffer,
    LayeredCube,
    Material,
    MetallicRoughness,
    Path,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    Staged,
    Texture,
    Unlit,
    Whitted,
    render,
)
from raytracer.meshes.shapes import box, floor, sphere

SIZE = 18, 12
COLOR = (0.9, 0.4, 0.1)
CAMERA = Camera((0, 2, 5), (0, 0.4, 0), fov=28)
BALL = sphere(0.6, Unlit(COLOR), rings=8, segments=12).moved((-0.7, 0.6, 0))
MIRROR = floor(6, Material((0.3, 0.3, 0.3), reflectivity=0.5))
OTHERS = {
    "Phong": [MIRROR, box((0.8, 0.8, 0.8)).moved((0.8, 0.4, 0))],
    "layered": [MIRROR, box((0.8, 0.8, 0.8), MetallicRoughness(COLOR, metallic=1, roughness=0.2)).moved((0.8, 0.4, 0))],
    "glass": [MIRROR, box((0.8, 0.8, 0.8), Material(transmission=0.8)).moved((0.8, 0.4, 0))],
    "lamp": [floor(6), floor(1, Material((0, 0, 0), emission=(4, 4, 4))).moved((0, 3, 0))],
}
LIGHT = PointLight((2, 4, 3))


def around(others, material=None, **changes):
    ball = BALL if material is None else BALL.with_material(material)
    return dataclasses.replace(Scene([ball, *OTHERS[others]], [LIGHT], CAMERA), **changes)


@pytest.mark.sampled(9)
@pytest.mark.parametrize("others", OTHERS)
@pytest.mark.parametrize("integrator", [Whitted(bounces=2), Path(samples=2, bounces=3)], ids=["Whitted", "Path"])
def test_its_colour_is_what_is_seen(integrator, others):
    image = render(around(others), SIZE, integrator=integrator, backend="numpy")
    seen = image.object_id == 0
    assert seen.sum() > 4
    if isinstance(integrator, Whitted):
        np.testing.assert_allclose(image.pixels[seen], np.tile(COLOR, (seen.sum(), 1)), rtol=1e-6)
    assert image.stats.features["unlit"]
    dark = render(around(others, lights=[]), SIZE, integrator=integrator, backend="numpy")
    inner = np.all([np.roll(seen, shift, axis) for axis in (0, 1) for shift in (-1, 1)], axis=0) & seen
    assert inner.sum() > 3
    np.testing.assert_allclose(dark.pixels[inner], np.tile(COLOR, (inner.sum(), 1)), rtol=1e-6)


def test_mirrors_show_it_and_it_throws_shadows():
    mirror = floor(6, Material((0, 0, 0), diffuse=0, specular=0, reflectivity=1))
    camera = Camera((0, 1, 5), (0, 0, 0), fov=50)
    scene = Scene([sphere(0.6, Unlit(COLOR)).moved((0, 0.6, 0)), mirror], [], camera, background=(0, 0, 0))
    for integrator in (Whitted(), Path(samples=1)):
        pixels = render(scene, (16, 16), integrator=integrator, backend="numpy").pixels
        np.testing.assert_allclose(pixels[10, 8], COLOR, rtol=1e-6)
    above = Camera((0, 5, 0.01), (0, 0, 0), fov=40)
    blocked = Scene([floor(0.5, Unlit(COLOR)).moved((0, 1, 0)), floor(6)], [PointLight((1, 4, 0))], above, ambient=0.0)
    pixels = render(blocked, (16, 16), backend="numpy").pixels
    assert (pixels.max(axis=2) == 0).any()


def test_it_lights_nothing():
    """A floor under a bright ceiling without a light: paths find the ceiling by chance, and it is black to them."""
    meshes = [floor(2, Unlit((50, 50, 50))).moved((0, 1, 0)), floor(6)]
    camera = Camera((0, 0.5, 4), (0, 0, 0))
    for lights in ([], [EnvironmentLight((0.5, 0.5, 0.5))]):
        scene = Scene(meshes, lights, camera, background=(0, 0, 0))
        bright = render(scene, SIZE, integrator=Path(samples=8, bounces=2), backend="numpy")
        shade = dataclasses.replace(scene, meshes=[meshes[0].with_material(Unlit((0, 0, 0))), meshes[1]])
        dark = render(shade, SIZE, integrator=Path(samples=8, bounces=2), backend="numpy")
        ground = bright.object_id == 1
        inside = np.zeros_like(ground)
        inside[1:-1] = ground[1:-1] & ground[2:] & ground[:-2]
        assert inside.any()
        np.testing.assert_array_equal(bright.pixels[inside], dark.pixels[inside])


@pytest.mark.slow
def test_pictures_vertex_colours_and_alpha():
    texture = Texture(np.full((1, 1, 3), 0.5), srgb=False)
    square = dataclasses.replace(floor(2, Unlit(texture)), colors=np.tile((1.0, 0.5, 0.0), (4, 1)))
    above = Camera((0, 3, 0.01), (0, 0, 0), fov=20)
    for alpha, expected in ((1.0, (0.5, 0.25, 0.0)), (0.25, (0.125 + 0.75, 0.0625 + 0.75, 0.75))):
        mesh = square.with_material(Unlit(texture, alpha=alpha))
        scene = Scene([mesh], [], above, background=(1, 1, 1))
        np.testing.assert_allclose(render(scene, (4, 4), backend="numpy").pixels[2, 2], expected, rtol=1e-6)
        traced = render(scene, (4, 4), integrator=Path(samples=256), backend="numpy").pixels
        np.testing.assert_allclose(traced.mean(axis=(0, 1)), expected, atol=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("integrator", "others"), [(Whitted(bounces=2), "layered"), (Path(samples=1, bounces=2), "glass")]
)
def test_every_backend_has_the_same_bits(integrator, others):
    same_everywhere(around(others), SIZE, ("numpy", "opencl"), integrator=integrator)


@pytest.mark.slow
def test_other_tracers_cubes_and_a_rasteriser_show_it():
    scene = around("Phong")
    whole = render(scene, SIZE, backend="numpy", accel="grid")
    same(render(scene, SIZE, integrator=Staged(), backend="numpy"), whole)
    cube = LayeredCube.of(scene, resolution=64, shading="deferred", backend="numpy")
    deferred = render(scene, SIZE, integrator=Whitted(secondary=cube), backend="numpy")
    np.testing.assert_allclose(deferred.pixels[whole.object_id == 0], whole.pixels[whole.object_id == 0], atol=2e-3)
    position = np.where(whole.object_id[..., None] == 0, (0.0, 0.0, 0.0), 1e3)
    buffer = GBuffer(position, np.tile((0.0, 0, 1), (12, 18, 1)), np.where(whole.object_id == 0, 0, -1))
    seen = render(scene, primary=buffer, backend="numpy")
    np.testing.assert_allclose(seen.pixels[whole.object_id == 0], whole.pixels[whole.object_id == 0], rtol=1e-6)


@pytest.mark.slow
def test_numbers_change_and_it_moves():
    scene = around("Phong")
    renderer = Renderer(scene, backend="numpy")
    renderer.show(around("Phong", Unlit((0.1, 0.9, 0.2))))
    renderer.move(0, np.eye(4) + np.eye(4, k=3) * 0)
    place = np.eye(4)
    place[0, 3] = 0.5
    renderer.move(0, place)
    moved = BALL.with_material(Unlit((0.1, 0.9, 0.2))).transformed(place)
    expected = render(Scene([moved, *OTHERS["Phong"]], [LIGHT], CAMERA), SIZE, backend="numpy")
    same(renderer.render(SIZE), expected)
    renderer.show(around("Phong", Material(COLOR)))
    assert "unlit" not in renderer.features


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"color": (1, 1)}, r"the color of an Unlit is \(r, g, b\), each 0 or more, or a Texture, not \(1, 1\)"),
        ({"color": (-1, 0, 0)}, "each 0 or more"),
        ({"alpha": 2}, "the alpha of an Unlit is a number from 0 to 1, or a Texture, not 2"),
        ({"cutout": 0.5}, r"the cutout of an Unlit is a Texture or None, not 0\.5"),
    ],
)
def test_other_numbers_are_refused(options, words):
    with pytest.raises(SceneError, match=words):
        Unlit(**options)


def test_materials_of_files_are_unlit(tmp_path):
    look = {"baseColorFactor": [0.2, 0.4, 0.6, 0.5], "metallicFactor": 0}
    material = gltf(tmp_path, pbrMetallicRoughness=look, extensions={"unlit": {}})
    assert material == Unlit((0.2, 0.4, 0.6))
    blended = gltf(
        tmp_path,
        pbrMetallicRoughness=look,
        alphaMode="BLEND",
        extensions={"unlit": {}},
        emissiveFactor=[1] * 3,
    )
    assert blended == Unlit((0.2, 0.4, 0.6), alpha=0.5)
    file = File()
    image = file.picture(np.full((2, 2, 3), 0.5))
    look = {"baseColorTexture": {"index": image}, "baseColorFactor": [0.5, 1, 1, 1]}
    painted = file.material(pbrMetallicRoughness=look, extensions={"KHR_materials_unlit": {}})
    file.node(mesh=file.mesh(file.square(material=painted)))
    file.tree["extensionsUsed"] = file.tree["extensionsRequired"] = ["KHR_materials_unlit"]
    scene = Scene.load(file.save(tmp_path / "unlit.glb"), strict=True)
    (mesh, *_) = scene.meshes
    assert isinstance(mesh.material, Unlit)
    assert len(mesh.vertices) == len(SQUARE)
    picture = mesh.material.color.image[0, 0]
    seen = render(Scene([mesh], [], AHEAD), (8, 8), backend="numpy").pixels[4, 4]
    np.testing.assert_allclose(seen, picture, rtol=1e-6)
