"""Test extensions of glTF: instances of one node, and transforms of textures."""

import numpy as np
import pytest
from gltf_files import CORNERS, HALVES, MATT, SQUARE, File

import shpy as sh
from raytracer import Camera, Scene, SceneError, Texture, render
from raytracer.scene.layout import Layout

INSTANCING = "EXT_mesh_gpu_instancing"


def test_instances_of_one_node(tmp_path):
    """Each is moved in the node's coordinates: by scale, rotation and translation, in this order."""
    file = File()
    half = np.sqrt(0.5)
    attributes = {
        "TRANSLATION": file.array([[0, 0, 0], [5, 0, 0]]),
        "ROTATION": file.array([[0, 0, 0, 1], [0, 0, half, half]]),
        "SCALE": file.array([[1, 1, 1], [2, 1, 1]]),
    }
    mesh = file.mesh(file.square(), name="leaf")
    file.node(mesh=mesh, translation=[0, 0, 3], extensions={INSTANCING: {"attributes": attributes}})
    file.tree["extensionsUsed"] = file.tree["extensionsRequired"] = [INSTANCING]
    scene = Scene.load(file.save(tmp_path / "leaves.glb"))
    assert len(Layout.of(scene, "instances").triangles) == 3 * (2 + 2)  # of the leaf, and of the floor
    one, other, _ = scene.meshes
    assert one.name == other.name == "leaf"
    np.testing.assert_allclose(one.vertices, SQUARE + (0, 0, 3))
    expected = SQUARE[:, [1, 0, 2]] * (-1, 2, 1) + (5, 0, 3)  # x to y, y to -x
    np.testing.assert_allclose(other.vertices, expected, atol=1e-6)


def test_instances_of_several_lengths(tmp_path):
    file = File()
    attributes = {"TRANSLATION": file.array(np.zeros((2, 3))), "SCALE": file.array(np.ones((3, 3)))}
    file.node(mesh=file.mesh(file.square()), extensions={INSTANCING: {"attributes": attributes}})
    with pytest.raises(SceneError, match="several lengths"):
        Scene.load(file.save(tmp_path / "leaves.glb"))


def moved_square(tmp_path, **transform):
    """The uv coordinates of the square's triangles (2, 3, 2) with v downward, where a texture has a transform."""
    file = File()
    texture = {"index": file.picture(np.full((2, 2, 3), 200)), "extensions": {"KHR_texture_transform": transform}}
    look = {"baseColorTexture": texture, "metallicFactor": 0}
    other = {"TEXCOORD_1": file.array(CORNERS[::-1])}
    primitive = file.square(material=file.material(pbrMetallicRoughness=look), attributes=other)
    file.node(mesh=file.mesh(primitive))
    file.tree["extensionsUsed"] = ["KHR_texture_transform"]
    return Scene.load(file.save(tmp_path / "moved.glb")).meshes[0].uv * (1, -1) + (0, 1)


@pytest.mark.parametrize(
    ("transform", "expected"),
    [
        ({}, CORNERS),
        ({"offset": [0.5, 0.25]}, CORNERS + (0.5, 0.25)),
        ({"scale": [2, 3]}, CORNERS * (2, 3)),
        ({"rotation": np.pi / 2}, CORNERS[:, ::-1] * (1, -1)),  # (1, 0) to (0, -1), which is upward
        ({"rotation": np.pi / 2, "scale": [2, 1], "offset": [0, 1]}, CORNERS[:, ::-1] * (1, -2) + (0, 1)),
        ({"texCoord": 1}, CORNERS[::-1]),
    ],
)
def test_transforms_of_textures(transform, expected, tmp_path):
    np.testing.assert_allclose(moved_square(tmp_path, **transform), expected[np.reshape(HALVES, (2, 3))], atol=1e-6)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("quarters", "color"), [(0, [0, 1, 0]), (1, [0, 0, 1])])
def test_a_picture_whose_coordinates_are_rotated(tmp_path, quarters, color):
    """About the middle: the right half is green; after a quarter it is the picture's upper half, which is blue."""
    file = File()
    pixels = [[[0, 0, 255], [0, 0, 255]], [[255, 0, 0], [0, 255, 0]]] if quarters else [[[255, 0, 0], [0, 255, 0]]] * 2
    move = {"rotation": quarters * np.pi / 2, "offset": [0, quarters]}
    texture = {"index": file.picture(pixels, magFilter=9728), "extensions": {"KHR_texture_transform": move}}
    look = {"baseColorTexture": texture, "metallicFactor": 0}
    file.node(mesh=file.mesh(file.square(material=file.material(pbrMetallicRoughness=look, extensions=MATT))))
    meshes = Scene.load(file.save(tmp_path / "turned.glb")).meshes
    image = render(Scene(meshes, (), Camera((0, 0, 4), fov=45), ambient=1.0), (16, 16), backend="numpy", bounces=0)
    assert image.pixels[7, 10].tolist() == color


def textured(file, transform, picture=0.8):
    """A textureInfo with a transform of its own."""
    extensions = {"extensions": {"KHR_texture_transform": transform}} if transform else {}
    return {"index": file.picture(np.full((2, 2, 3), 255 * picture, np.uint8))} | extensions


def downward(uv):
    """Coordinates whose v runs down, as in glTF."""
    return uv * (1, -1) + (0, 1)


def moved_by(transform, uv):
    """KHR_texture_transform: scale, rotate, then add the offset."""
    cos, sin = np.cos(transform.get("rotation", 0)), np.sin(transform.get("rotation", 0))
    turned = uv * transform.get("scale", (1, 1)) @ np.array([[cos, -sin], [sin, cos]])
    return turned + transform.get("offset", (0, 0))


@pytest.mark.parametrize("first", [{}, {"scale": [2, -3], "rotation": 0.5, "offset": [0.25, 1]}])
@pytest.mark.parametrize("normals", [None, {"scale": [0.5, 2], "rotation": -1}])
def test_textures_of_one_material_that_are_moved_apart(first, normals, tmp_path):
    file, other = File(), {"scale": [4, 0.5], "rotation": 2, "offset": [-1, 0.125]}
    look = {"baseColorTexture": textured(file, first)}
    named = {} if normals is None else {"normalTexture": textured(file, normals)}
    named |= {"emissiveTexture": textured(file, other), "emissiveFactor": [1, 1, 1]}
    file.node(mesh=file.mesh(file.square(material=file.material(pbrMetallicRoughness=look, **named))))
    mesh = Scene.load(file.save(tmp_path / "apart.glb")).meshes[0]
    plain = np.pad(np.eye(2), ((0, 0), (0, 1)))
    for texture, transform in ((mesh.material.base_color, first), (mesh.material.emission, other)):
        rows = np.array(plain if texture.transform is None else texture.transform)
        read = mesh.uv @ rows[:, :2].T + rows[:, 2]
        expected = moved_by(transform, CORNERS)[np.reshape(HALVES, (2, 3))]
        np.testing.assert_allclose(downward(read), expected, atol=1e-6)
    assert normals is None or mesh.material.normal.transform is None


@pytest.mark.parametrize(
    "emissive",
    [
        {"texCoord": 1},
        {"extensions": {"KHR_texture_transform": {"texCoord": 1}}},
    ],
)
def test_textures_at_second_coordinates_are_named(emissive, tmp_path):
    file = File()
    look = {"baseColorTexture": textured(file, {})}
    file.node(
        mesh=file.mesh(
            file.square(
                material=file.material(pbrMetallicRoughness=look, emissiveTexture=textured(file, {}) | emissive)
            )
        )
    )
    with pytest.warns(sh.ShpyWarning, match=r"second uv coordinates or transforms in materials \(1\)"):
        Scene.load(file.save(tmp_path / "apart.glb"))


def test_a_picture_beside_coordinates_without_area_is_named(tmp_path):
    file = File()
    look = {"baseColorTexture": textured(file, {"scale": [0, 1]})}
    file.node(
        mesh=file.mesh(
            file.square(material=file.material(pbrMetallicRoughness=look, emissiveTexture=textured(file, {})))
        )
    )
    with pytest.warns(sh.ShpyWarning, match=r"second uv coordinates or transforms in materials \(1\)"):
        Scene.load(file.save(tmp_path / "flat.glb"))


GLOSSY = "KHR_materials_pbrSpecularGlossiness"


def glossy(tmp_path, *pictures, **gloss):
    """The material of a file with these factors and pictures."""
    file = File()
    for name, pixels in zip(("diffuseTexture", "specularGlossinessTexture"), pictures, strict=False):
        gloss[name] = {"index": file.picture(pixels)}
    file.node(mesh=file.mesh(file.square(material=file.material(extensions={GLOSSY: gloss}))))
    file.tree["extensionsUsed"] = file.tree["extensionsRequired"] = [GLOSSY]
    return Scene.load(file.save(tmp_path / "glossy.glb")).meshes[0].material


def plain(tmp_path, **look):
    file = File()
    file.node(mesh=file.mesh(file.square(material=file.material(pbrMetallicRoughness=look))))
    return Scene.load(file.save(tmp_path / "plain.glb")).meshes[0].material


@pytest.mark.parametrize(
    ("gloss", "look"),
    [
        (
            {"diffuseFactor": [0.5, 0.25, 0.125, 1], "specularFactor": [0.04] * 3, "glossinessFactor": 0.25},
            {"baseColorFactor": [0.5, 0.25, 0.125, 1], "metallicFactor": 0, "roughnessFactor": 0.75},
        ),
        (
            {"diffuseFactor": [0, 0, 0, 1], "specularFactor": [1, 0.5, 0.25], "glossinessFactor": 0.75},
            {"baseColorFactor": [1, 0.5, 0.25, 1], "metallicFactor": 1, "roughnessFactor": 0.25},
        ),
    ],
)
def test_specular_and_glossiness(gloss, look, tmp_path):
    """Compare with metallic-roughness where both models are known: for no metal and for all metal."""
    one, other = glossy(tmp_path, **gloss), plain(tmp_path, **look)
    np.testing.assert_allclose(one.base_color, other.base_color, atol=1e-5)
    for name in ("specular", "roughness", "metallic"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-4), name


def test_pictures_of_specular_and_glossiness(tmp_path):
    """Each texel is converted by itself: here the left half is wood, and the right half a metal."""
    colors = np.zeros((2, 4, 3))
    colors[:, :2] = 188, 92, 20
    shine = np.full((2, 2, 4), (56, 56, 56, 51))  # half as wide: its texels are repeated
    shine[:, 1] = 255, 188, 99, 255
    look = glossy(tmp_path, colors, shine, glossinessFactor=0.5)
    wood, metal = (plain_numbers(part) for part in ((188, 92, 20), (255, 188, 99)))
    base, metallic, roughness = (texture.image for texture in (look.base_color, look.metallic, look.roughness))
    np.testing.assert_allclose(base[0, 3], metal, atol=1e-4)
    np.testing.assert_allclose(base[0, 0] / wood, (base[0, 0] / wood)[0] * np.ones(3), atol=0.02)
    np.testing.assert_allclose(metallic[0, :, 0], [0, 0, 1, 1], atol=0.02)
    np.testing.assert_allclose(roughness[0, :, 0], [0.9, 0.9, 0.5, 0.5], atol=1e-5)
    same = glossy(tmp_path, np.full((2, 2, 3), (188, 92, 20)), specularFactor=[0.04] * 3, glossinessFactor=0.25)
    assert (same.metallic, same.roughness) == (pytest.approx(0, abs=1e-3), pytest.approx(0.75))
    np.testing.assert_allclose(same.base_color.image[0, 0], wood, atol=1e-3)


def plain_numbers(color):
    """Return a colour of sRGB bytes as linear numbers."""
    return Texture(np.array([[color]], np.uint8)).image[0, 0]
