"""White furnaces: no material, by hand or of a file, sends out more light than it receives, in Path and in Whitted.

Three kernels show all materials, one each for opaque balls, clear ones and bodies: beside the ball stand grains, too
small to be seen, that need the rest of the code.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest
from gltf_files import File
from test_microfacets import BALL, check_gains_nothing

from raytracer import Camera, EnvironmentLight, MetallicRoughness, Path, Renderer, Scene, Whitted
from raytracer.meshes.shapes import icosahedron

LAYERS = {"clearcoat": 0.5, "sheen_color": (0.5, 0.5, 0.5), "sheen_roughness": 0.5, "anisotropy": 0.5}
EVERYTHING = [
    MetallicRoughness((0, 0, 0), specular=0),
    MetallicRoughness(**LAYERS, transmission=0.5, multiscatter=True, alpha=0.5),
    MetallicRoughness(transmission=0.5, thickness=1, attenuation_color=(0.5, 0.6, 0.7), attenuation_distance=1),
]
AROUND = EnvironmentLight((1, 1, 1))
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


def materials_of_a_file(path, count):
    file, rng = File(), np.random.default_rng(0)
    for _ in range(count):
        file.node(mesh=file.mesh(file.square(material=file.material(**random_entry(rng)))))
    return [mesh.material for mesh in Scene.load(file.save(path), floor=False).meshes[:count]]


def check(integrator, look):
    """Check the mean in path tracing, and each pixel of Whitted's tracer, which has no noise."""
    colors = colors_of(integrator, look)
    if integrator == "path":
        check_gains_nothing(colors)
    else:
        assert colors.max() <= 1 + 1e-4, colors.max()
    return colors.mean(axis=0).max()


def test_opaque_materials_gain_no_light_in_a_furnace():
    looks = [random_material(np.random.default_rng(seed)) for seed in range(40)]
    opaque = [look for look in looks if not look.numbers["transmission"]]
    assert len(opaque) > 15
    assert max(check("path", look) for look in opaque) > 0.9


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
        check(integrator, look)
