"""The light of materials that were read from glTF files: known heights, furnaces, and the same bits everywhere."""

import numpy as np
import pytest
from gltf_files import HALVES, SQUARE, File
from test_file_materials import AHEAD, gltf
from test_microfacets import check_gains_nothing, error_of, furnace

from raytracer import DirectionalLight, Mesh, MetallicRoughness, Path, Scene, Whitted, render

BLACK = {"baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0}


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("look", "extensions", "f0"),
    [
        ({**BLACK, "roughnessFactor": 0.5}, {}, 0.04),
        ({**BLACK, "roughnessFactor": 1}, {}, 0.04),
        ({**BLACK, "roughnessFactor": 0.5}, {"ior": {"ior": 2}}, 1 / 9),
        (
            {**BLACK, "roughnessFactor": 0.5},
            {"specular": {"specularFactor": 0.5, "specularColorFactor": [2, 1, 0]}},
            (0.04, 0.02, 0),
        ),
        ({"baseColorFactor": [1, 0.5, 0.25, 1], "metallicFactor": 1, "roughnessFactor": 0.7}, {}, (1, 0.5, 0.25)),
        (
            {**BLACK, "roughnessFactor": 0.5},
            {"specular": {"specularFactor": 0}, "clearcoat": {"clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.5}},
            0.02,
        ),
    ],
    ids=["black plastic", "black chalk", "an index of 2", "specular", "metal", "a coat over black"],
)
def test_the_highlight_of_a_file_has_the_height_of_its_formulas(tmp_path, look, extensions, f0):
    """At normal incidence, D V F is F0 / (4 pi roughness**4), and a light of 1 shows pi times that."""
    material = gltf(tmp_path, pbrMetallicRoughness=look, extensions=extensions)
    square = Mesh(SQUARE, np.reshape(HALVES, (2, 3)), material=material)
    scene = Scene([square], [DirectionalLight((0, 0, -1))], AHEAD, ambient=0.0)
    seen = render(scene, (8, 8), backend="numpy", bounces=0).pixels[4, 4]
    np.testing.assert_allclose(seen, np.broadcast_to(f0, 3) / (4 * look["roughnessFactor"] ** 4), rtol=1e-5, atol=1e-7)


@pytest.mark.slow
@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("color", "metallic", "roughness", "albedo"), [(1, 0, 0.3, 1), (1, 1, 0.5, 0.882), (0, 0, 0.2, 0.0812)]
)
def test_materials_of_files_gain_no_light_in_a_furnace(tmp_path, color, metallic, roughness, albedo):
    """Phong's model, in which files were read before, returns 1.66, 1.50 and 0.68 here."""
    look = {"baseColorFactor": [color] * 3 + [1], "metallicFactor": metallic, "roughnessFactor": roughness}
    colors = furnace(gltf(tmp_path, pbrMetallicRoughness=look), backend="opencl", size=(32, 32))
    check_gains_nothing(colors)
    assert abs(colors[:, 0].mean() - albedo) < 4 * error_of(colors)[0] + 0.006  # pixels at the edge see the furnace
    same = MetallicRoughness((color,) * 3, metallic, roughness)
    np.testing.assert_array_equal(colors, furnace(same, backend="opencl", size=(32, 32)))


def pictured():
    """Return a file with pictures in all slots of metal, plastic, coats and thin walls, under a light."""
    file = File()
    rng = np.random.default_rng(3)

    def picture(channels=3):
        pixels = rng.integers(0, 256, (4, 4, channels))
        pixels[0, 0, 3:] = 0
        return {"index": file.picture(pixels)}

    bumps = np.full((4, 4, 3), (128, 128, 255))
    bumps[1:3, 1:3] = 160, 110, 230
    look = {"baseColorTexture": picture(4), "metallicRoughnessTexture": picture(), "roughnessFactor": 0.8}
    layers = {
        "specular": {"specularTexture": picture(4), "specularColorTexture": picture()},
        "clearcoat": {
            "clearcoatFactor": 0.7,
            "clearcoatTexture": picture(),
            "clearcoatRoughnessFactor": 0.5,
            "clearcoatRoughnessTexture": picture(),
        },
    }
    thin = {"transmission": {"transmissionFactor": 0.8, "transmissionTexture": picture()}, "ior": {"ior": 1.7}}
    glow = {"emissiveTexture": picture(), "emissiveFactor": [0.2, 0.1, 0.1], "alphaMode": "BLEND"}
    normals = {"normalTexture": {"index": file.picture(bumps), "scale": 0.7}}
    for x, entry, extensions in ((-1, normals, layers), (1, {**glow, **normals}, thin), (0, {}, {})):
        extensions = {f"KHR_materials_{name}": value for name, value in extensions.items()}
        material = file.material(pbrMetallicRoughness=look, extensions=extensions, **entry)
        file.node(mesh=file.mesh(file.square(material=material)), translation=[x, 0, x])
    file.tree["extensionsUsed"] = [f"KHR_materials_{name}" for name in (*layers, *thin)]
    file.light(type="point", intensity=30, place={"translation": [1, 3, 4]})
    return file


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [Whitted(), Path(samples=2, bounces=3)], ids=["whitted", "path"])
def test_backends_agree_about_a_file_with_pictures_in_all_slots(tmp_path, integrator):
    scene = Scene.load(pictured().save(tmp_path / "all.glb"))
    names = set().union(*(mesh.material.textures for mesh in scene.meshes))
    assert names == {
        *("color", "metallic", "roughness", "specular", "tint", "clearcoat", "clearcoat_roughness", "thin"),
        *("emission", "normal_map", "transmission", "cutout"),
    }
    first, *others = (
        render(scene, (24, 16), integrator=integrator, backend=name) for name in ("numpy", "opencl", "glsl")
    )
    assert np.unique(first.pixels.reshape(-1, 3), axis=0).shape[0] > 100
    for other in others:
        np.testing.assert_array_equal(first.pixels, other.pixels)
