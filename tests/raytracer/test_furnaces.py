"""White furnaces: no material, by hand or of a file, sends out more light than it receives, in Path and in Whitted.

Three kernels show all materials without pictures, one each for opaque balls, clear ones and bodies: beside the ball
stand grains, too small to be seen, that need the rest of the code. Materials with pictures stand in one scene.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest
from gltf_files import File
from test_microfacets import BALL, check_gains_nothing

from raytracer import Camera, EnvironmentLight, MetallicRoughness, Path, Renderer, Scene, Texture, Whitted, render
from raytracer.meshes.shapes import icosahedron, sphere

LAYERS = {"clearcoat": 0.5, "sheen_color": (0.5, 0.5, 0.5), "sheen_roughness": 0.5, "anisotropy": 0.5}
EVERYTHING = [
    MetallicRoughness((0, 0, 0), specular=0),
    MetallicRoughness(**LAYERS, transmission=0.5, multiscatter=True, alpha=0.5),
    MetallicRoughness(transmission=0.5, thickness=1, attenuation_color=(0.5, 0.6, 0.7), attenuation_distance=1),
]
AROUND = EnvironmentLight((1, 1, 1))
SMALL_BALL = sphere(1, rings=12, segments=24)
ACROSS = 16
"""Balls of a row."""
PICTURED = (
    *("base_color", "metallic", "roughness", "ior", "specular", "specular_color", "clearcoat", "clearcoat_roughness"),
    *("sheen_color", "sheen_roughness", "anisotropy", "transmission", "alpha", "normal"),
)
OF_A_BODY = {"base_color", "roughness", "transmission", "normal"}
"""The fields that may be pictures, and those that may be pictures in a body."""
TEXTURES = {
    "pbrMetallicRoughness": ("baseColorTexture", "metallicRoughnessTexture"),
    "KHR_materials_clearcoat": ("clearcoatTexture", "clearcoatRoughnessTexture"),
    "KHR_materials_sheen": ("sheenColorTexture", "sheenRoughnessTexture"),
    "KHR_materials_specular": ("specularTexture", "specularColorTexture"),
    "KHR_materials_anisotropy": ("anisotropyTexture",),
    "KHR_materials_transmission": ("transmissionTexture",),
}
INTEGRATORS = {"path": Path(samples=64, bounces=8), "whitted": Whitted(bounces=8)}


@cache
def renderer_of(integrator, is_clear, is_body):
    look = (
        MetallicRoughness(transmission=0.5, thickness=1) if is_body else MetallicRoughness(alpha=0.5 if is_clear else 1)
    )
    return Renderer(furnace(look), integrator=INTEGRATORS[integrator], backend="opencl")


def furnace(material):
    """Return a ball of a material in light of 1 from everywhere."""
    grain = dataclasses.replace(icosahedron(1e-3), uv=np.zeros((20, 3, 2)))
    grains = [grain.with_material(look, f"grain {k}").moved((k, 0, 50)) for k, look in enumerate(EVERYTHING)]
    return Scene([BALL.with_material(material), *grains], [AROUND], Camera((0, 0, 6), fov=20))


def colors_of(integrator, material):
    """Return the colours of a ball's pixels, (n, 3)."""
    renderer = renderer_of(integrator, material.numbers["transmission"] > 0, material.is_body)
    builds = renderer.builds
    renderer.show(furnace(material))
    assert renderer.builds == builds
    image = renderer.render((16, 16))
    colors = image.pixels[image.object_id == 0].astype(np.float64)
    assert np.isfinite(colors).all()
    return colors


def random_material(rng):
    """Return a material with numbers anywhere in their ranges, and often at an end."""

    def one_of(*values):
        return values[rng.integers(len(values))]

    look = MetallicRoughness(
        base_color=one_of((1, 1, 1), tuple(rng.random(3))),
        metallic=one_of(0, 1, rng.random()),
        roughness=one_of(0, 1e-4, 0.03, 0.05, 1, rng.random(), rng.random()),
        ior=one_of(1.5, 1.0, 0, 2.4, 1.33),
        specular=one_of(1, 0, rng.random()),
        specular_color=one_of((1, 1, 1), (1, 0, 0), (3, 2, 8)),
        clearcoat=one_of(0, 0, 1, rng.random()),
        clearcoat_roughness=one_of(0, rng.random()),
        transmission=one_of(0, 0, 0, 1, rng.random()),
        alpha=one_of(1, 1, 1, 0.5),
        sheen_color=one_of((0, 0, 0), (0, 0, 0), (1, 1, 1), tuple(rng.random(3))),
        sheen_roughness=one_of(0, 1, rng.random(), rng.random()),
        anisotropy=one_of(0, 0, 1, rng.random()),
        anisotropy_rotation=one_of(0, 90, 360 * rng.random()),
        multiscatter=bool(rng.integers(2)),
    )
    return dataclasses.replace(look, thickness=one_of(0, 1)) if look.alpha == 1 and look.ior > 0 else look


def random_entry(rng):
    """Return a material of glTF with numbers anywhere in their ranges, and often at an end."""

    def share():
        return float(rng.choice([0, 1, rng.random(), rng.random()]))

    def color():
        return [[1.0, 1.0, 1.0], rng.random(3).tolist()][rng.integers(2)]

    extensions = {
        "KHR_materials_clearcoat": {"clearcoatFactor": share(), "clearcoatRoughnessFactor": share()},
        "KHR_materials_sheen": {"sheenColorFactor": color(), "sheenRoughnessFactor": share()},
        "KHR_materials_specular": {"specularFactor": share(), "specularColorFactor": color()},
        "KHR_materials_ior": {"ior": float(rng.choice([0, 1, 1.33, 1.5, 2.4]))},
        "KHR_materials_anisotropy": {"anisotropyStrength": share(), "anisotropyRotation": 6 * rng.random()},
        "KHR_materials_transmission": {"transmissionFactor": share()},
    }
    used = {name: entry for name, entry in extensions.items() if rng.random() < 0.4}
    if "KHR_materials_transmission" in used and rng.random() < 0.5 and used.get("KHR_materials_ior") != {"ior": 0.0}:
        used["KHR_materials_volume"] = {"thicknessFactor": 1.0, "attenuationDistance": 1.0, "attenuationColor": color()}
    look = {"baseColorFactor": [*color(), 1.0], "metallicFactor": share(), "roughnessFactor": share()}
    return {"pbrMetallicRoughness": look, "extensions": used}


def random_texels(rng, channels=3):
    """Return numbers from 0 to 1, half of them ends; in half of the pictures all of them are above 0.9."""
    ends = rng.integers(0, 2, (4, 4, channels))
    texels = np.where(rng.random(ends.shape) < 0.5, ends, rng.random(ends.shape))
    return 1 - 0.1 * texels if rng.random() < 0.5 else texels


def with_pictures(look, rng):
    """Put pictures in the place of half of the numbers and colours of a material; some go beyond 1."""
    fields = PICTURED if not look.thickness else [name for name in PICTURED if name in OF_A_BODY]
    fields = [name for name in fields if rng.random() < 0.5]
    return dataclasses.replace(look, **{name: Texture(rng.choice([1, 1, 3]) * random_texels(rng)) for name in fields})


def add_pictures(entry, file, rng):
    """Add pictures to half of the slots that an entry of a glTF file has."""
    tables = entry["extensions"] | {"pbrMetallicRoughness": entry["pbrMetallicRoughness"], "normal": entry}
    for name, slots in (TEXTURES | {"normal": ("normalTexture",)}).items():
        for slot in slots if name in tables else ():
            if rng.random() < 0.5:
                tables[name][slot] = {"index": file.picture(255 * random_texels(rng, 4))}


def materials_of_a_file(path, count, pictures=False):
    file, rng = File(), np.random.default_rng(int(pictures))
    for _ in range(count):
        entry = random_entry(rng)
        if pictures:
            add_pictures(entry, file, rng)
        file.node(mesh=file.mesh(file.square(material=file.material(**entry))))
    return [mesh.material for mesh in Scene.load(file.save(path), floor=False).meshes[:count]]


def colors_of_all(integrator, looks):
    """Return the colours of the pixels of balls that stand side by side, an array (n, 3) for each."""
    places = [(3 * (k % ACROSS), 3 * (k // ACROSS), 0) for k in range(len(looks))]
    balls = [SMALL_BALL.with_material(look).moved(place) for look, place in zip(looks, places, strict=True)]
    middle = np.add(places[0], places[-1]) / 2
    middle[0] = 1.5 * (ACROSS - 1)
    rows = -(-len(looks) // ACROSS)
    camera = Camera((*middle[:2], 9), middle, projection="orthographic", span=3 * min(rows, ACROSS))
    size = 16 * ACROSS, 16 * rows
    image = render(Scene(balls, [AROUND], camera), size, integrator=INTEGRATORS[integrator], backend="opencl")
    assert np.isfinite(image.pixels).all()
    return [image.pixels[image.object_id == k].astype(np.float64) for k in range(len(looks))]


def check(integrator, colors):
    """Check the mean in path tracing, and each pixel of Whitted's tracer, which has no noise."""
    if integrator == "path":
        check_gains_nothing(colors)
    else:
        assert colors.max() <= 1 + 1e-4, colors.max()
    return colors.mean(axis=0).max()


def test_opaque_materials_gain_no_light_in_a_furnace():
    looks = [random_material(np.random.default_rng(seed)) for seed in range(40)]
    opaque = [look for look in looks if not look.numbers["transmission"]]
    assert len(opaque) > 15
    assert max(check("path", colors_of("path", look)) for look in opaque) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("origin", ["hand", "file"])
@pytest.mark.filterwarnings("ignore::shpy.ShpyWarning")
def test_no_material_gains_light_in_a_furnace(tmp_path, origin, integrator):
    if origin == "file":
        looks = materials_of_a_file(tmp_path / "grid.glb", 250)
    else:
        looks = [random_material(np.random.default_rng(seed)) for seed in range(250)]
    assert len(set(looks)) == 250
    for look in looks:
        check(integrator, colors_of(integrator, look))


@pytest.mark.slow
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("origin", ["hand", "file"])
@pytest.mark.filterwarnings("ignore::shpy.ShpyWarning")
def test_no_material_with_pictures_gains_light_in_a_furnace(tmp_path, origin, integrator):
    if origin == "file":
        looks = materials_of_a_file(tmp_path / "grid.glb", 250, pictures=True)
    else:
        generators = map(np.random.default_rng, range(250))
        looks = [with_pictures(random_material(rng), rng) for rng in generators]
    assert set(PICTURED if origin == "hand" else OF_A_BODY) <= {
        name for look in looks for name in PICTURED if isinstance(getattr(look, name), Texture)
    }
    assert max(check(integrator, colors) for colors in colors_of_all(integrator, looks)) > 0.9
