"""The anisotropy of a MetallicRoughness: stretched highlights, its bits, where programs and files say it."""

import dataclasses
import math

import numpy as np
import pytest
from gltf_files import File
from scene_pictures import CAMERA, check_other_numbers, same, same_everywhere, two_balls
from test_file_materials import gltf, obj
from test_microfacets import check_gains_nothing, furnace

from raytracer import (
    Camera,
    EnvironmentLight,
    GBuffer,
    Mesh,
    MetallicRoughness,
    Path,
    PointLight,
    Scene,
    SceneError,
    Staged,
    Surface,
    Texture,
    Whitted,
    render,
)
from raytracer.appearance.albedo import ACROSS, albedo_table
from raytracer.kernels.anisotropy import MARGIN, SHARPER
from raytracer.meshes.shapes import floor, knot, sphere

BRUSHED = MetallicRoughness((0.9, 0.8, 0.7), metallic=1, roughness=0.25, anisotropy=0.7, anisotropy_rotation=20)
PICTURE = Texture(np.random.default_rng(3).random((4, 4, 3)).astype(np.float32), srgb=False)


def metals(**changes):
    wood = MetallicRoughness((0.5, 0.2, 0.1), roughness=0.3, anisotropy=PICTURE, anisotropy_rotation=-30, clearcoat=0.5)
    return two_balls(BRUSHED, wood, **{"lights": [PointLight((2, 4, 3)), EnvironmentLight((0.3,) * 3)], **changes})


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [Path(samples=2, bounces=3), Whitted(bounces=2)], ids=["Path", "Whitted"])
def test_every_backend_has_the_same_bits(integrator):
    lights = {} if isinstance(integrator, Path) else {"lights": [PointLight((2, 4, 3))]}
    same_everywhere(metals(**lights), (12, 8), integrator=integrator)


LAMP, ABOVE = PointLight((0, 3, 0)), Camera((0, 3, 0), (0, 0, 0), up=(0, 0, -1), fov=60)


def spread(material, uv=None):
    """Return the widths, across and down, of the highlight of a light above a floor that is seen from above."""
    mesh = floor(4, material) if uv is None else dataclasses.replace(floor(4, material), uv=uv)
    eye = Camera((0, 3, 0), (0, 0, 0), up=(0, 0, -1), fov=60)
    pixels = render(Scene([mesh], [LAMP], eye, (0, 0, 0), 0.0), (33, 33), backend="numpy").pixels[..., 0]
    place = np.arange(33) - 16
    across, down = (np.average(place**2, weights=pixels.sum(axis=axis).astype(np.float64)) for axis in (0, 1))
    return math.sqrt(across), math.sqrt(down)


def test_highlights_stretch_to_where_u_grows_and_turn():
    """On this floor u grows to the right and v to the top."""
    across, down = spread(dataclasses.replace(BRUSHED, anisotropy_rotation=0.0))
    assert across > 2 * down
    turned = spread(dataclasses.replace(BRUSHED, anisotropy_rotation=90.0))
    assert turned == pytest.approx((down, across), rel=1e-4)
    up = np.full((2, 2, 3), (0.5, 1.0, 1.0), np.float32)
    assert spread(dataclasses.replace(BRUSHED, anisotropy=Texture(up, srgb=False), anisotropy_rotation=0.0)) != turned
    up[..., 2] = 0.7
    pictured = dataclasses.replace(BRUSHED, anisotropy=Texture(up, srgb=False), anisotropy_rotation=0.0)
    assert spread(pictured) == pytest.approx(turned, rel=1e-4)
    plain = dataclasses.replace(BRUSHED, anisotropy=0.0)
    assert spread(dataclasses.replace(BRUSHED), uv=np.zeros((2, 3, 2))) == pytest.approx(spread(plain), rel=1e-5)


def test_what_turns_left_from_u_is_nearer_to_v():
    """The highlight is longest where the rotation points: for 45 degrees up and to the right, mirrored uv or not."""
    look = dataclasses.replace(BRUSHED, anisotropy_rotation=45.0)
    plain = floor(4, look)
    place = np.arange(17) - 8
    for flip, sign in ((1, 1), (-1, -1)):
        mesh = dataclasses.replace(plain, uv=plain.uv * (flip, 1))
        pixels = render(Scene([mesh], [LAMP], ABOVE, (0, 0, 0), 0.0), (17, 17), backend="numpy").pixels
        assert sign * (pixels[..., 0] * place * -place[:, None]).sum() > 0


def test_an_anisotropy_of_0_changes_no_light():
    """It is the same lobe, though not the same arithmetic, whether or not the kernel knows directions."""
    plain = dataclasses.replace(BRUSHED, anisotropy=0.0)
    beside = [sphere(0.3, BRUSHED, rings=4, segments=6).moved((30, 0, 0))]
    images = [render(Scene([floor(4, plain), *more], [LAMP], CAMERA), (12, 8)) for more in ([], beside)]
    np.testing.assert_allclose(*(image.pixels for image in images), rtol=2e-5, atol=1e-6)


@pytest.mark.slow
def test_programs_decide_it():
    def strokes(hit):
        return Surface(anisotropy=0.7, anisotropy_rotation=20 + 0 * hit.uv.x)

    look = dataclasses.replace(BRUSHED, anisotropy=0.0, anisotropy_rotation=0.0, surface=strokes)
    scenes = [Scene([floor(4, m)], [LAMP], CAMERA) for m in (BRUSHED, look)]
    images = [render(scene, (12, 8), backend="numpy").pixels for scene in scenes]
    np.testing.assert_allclose(*images, rtol=1e-5)
    turned = dataclasses.replace(look, surface=lambda hit: Surface(anisotropy_rotation=30))
    plain = dataclasses.replace(look, surface=None)
    scenes = [Scene([floor(4, m)], [LAMP], CAMERA) for m in (turned, plain)]
    same(*(render(scene, (6, 4), backend="numpy") for scene in scenes))


@pytest.mark.slow
def test_other_tracers_and_changes():
    scene = metals(lights=[PointLight((2, 4, 3))])
    whole = render(scene, (12, 8), backend="numpy", accel="grid")
    same(render(scene, (12, 8), integrator=Staged(), backend="numpy"), whole)
    check_other_numbers(scene, (12, 8), anisotropy=0.3, anisotropy_rotation=80.0)
    seen = GBuffer(np.zeros((4, 4, 3)), np.ones((4, 4, 3)), np.zeros((4, 4), int), np.zeros((4, 4, 2)))
    with pytest.raises(SceneError, match=r"a GBuffer has no tangents, and mesh 0 .* has an anisotropy"):
        render(scene, (4, 4), primary=seen, backend="numpy")


def test_a_mesh_needs_uv_coordinates():
    bare = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name="shard", material=BRUSHED)
    with pytest.raises(SceneError, match="shard: an anisotropy needs uv coordinates, and the mesh has none"):
        render(Scene([bare], []), (4, 4), backend="numpy")


@pytest.mark.slow
def test_a_brushed_white_ball_gains_nothing():
    plastic = MetallicRoughness((1, 1, 1), roughness=0.15, anisotropy=0.8)
    for look in (plastic, dataclasses.replace(plastic, metallic=1.0), dataclasses.replace(plastic, roughness=0.0)):
        colors = furnace(look, backend="opencl")
        check_gains_nothing(colors)
        assert colors.mean() > 0.5


def albedo(cosine, angle, along, across):
    """Return the integrals a - b and b of an anisotropic distribution, as `integrals` of `appearance.albedo`."""
    lattice = (np.arange(96) + 0.5) / 96
    turn, level = np.meshgrid(2 * np.pi * lattice, lattice)
    sine = math.sqrt(1 - cosine * cosine)
    view = np.array([sine * math.cos(angle), sine * math.sin(angle), cosine])
    widths = np.array([along, across, 1])
    seen = widths * view / np.linalg.norm(widths * view)
    z = (1 - level) * (1 + seen[2]) - seen[2]
    radius = np.sqrt(np.maximum(1 - z * z, 0))
    half = np.stack([radius * np.cos(turn) + seen[0], radius * np.sin(turn) + seen[1], z + seen[2]])
    half *= widths[:, None, None]
    half /= np.linalg.norm(half, axis=0)
    facing = np.einsum("i,ijk->jk", view, half)
    light = 2 * facing * half - view[:, None, None]
    out, into = (np.linalg.norm(v * widths.reshape(-1, *[1] * (v.ndim - 1)), axis=0) for v in (view, light))
    share = np.where(light[2] > 0, light[2] * (cosine + out) / (light[2] * out + cosine * into), 0)
    b = (share * (1 - np.clip(facing, 0, 1)) ** 5).mean()
    return np.array([share.mean() - b, b])


def test_two_albedos_bound_that_of_an_anisotropic_surface():
    table, roots = albedo_table().astype(np.float64), np.linspace(0, 1, ACROSS)

    def read(cosine, roughness):
        row = min(int(roughness * (ACROSS - 1)), ACROSS - 2)
        part = roughness * (ACROSS - 1) - row
        values = (1 - part) * table[row, :-1] + part * table[row + 1, :-1]
        return np.array([np.interp(math.sqrt(cosine), roots, values[:, k]) for k in range(2)])

    rng = np.random.default_rng(2)
    for _ in range(150):
        roughness, strength = rng.uniform(1 / (ACROSS - 1), 1), math.sqrt(rng.random())
        across = roughness**2
        along = across + strength**2 * (1 - across)
        cosine, angle = rng.random() ** 3, rng.uniform(0, 2 * math.pi)
        least = max((1 - SHARPER * strength) * roughness, 1 / (ACROSS - 1))
        bound = np.maximum(read(cosine, least), read(cosine, math.sqrt(along))) + (0, MARGIN)
        for f0 in (0.0, 0.04, 1.0):
            excess = (albedo(cosine, angle, along, across) - bound) @ (f0, 1)
            assert excess <= 1e-4, (roughness, strength, cosine, angle, f0)


def test_files_have_an_anisotropy(tmp_path):
    brush = {"anisotropyStrength": 0.6, "anisotropyRotation": math.pi / 2}
    material = gltf(tmp_path, extensions={"anisotropy": brush})
    assert (material.anisotropy, material.anisotropy_rotation) == (0.6, 90)
    file = File()
    brush["anisotropyTexture"] = {"index": file.picture([[[255, 0, 51], [0, 255, 255]]], magFilter=9728)}
    pictured = gltf(tmp_path, file=file, extensions={"anisotropy": brush})
    np.testing.assert_allclose(pictured.anisotropy.image[0], [[1, 0, 0.12], [0, 1, 0.6]], rtol=1e-6)
    material = obj(tmp_path, "Pr 0.5\nPm 1\naniso 0.5\nanisor 0.25")
    aspect = math.sqrt(1 - 0.9 * 0.5)
    assert material.roughness**2 == pytest.approx(0.25 * aspect)
    across = material.roughness**2
    assert across + material.anisotropy**2 * (1 - across) == pytest.approx(0.25 / aspect)
    assert material.anisotropy_rotation == 90


@pytest.mark.parametrize("wrong", [{"anisotropy": 1.5}, {"anisotropy_rotation": math.inf}, {"multiscatter": 1}])
def test_other_numbers_are_refused(wrong):
    with pytest.raises(SceneError, match=f"{next(iter(wrong))}"):
        MetallicRoughness(**wrong)


@pytest.mark.slow
def test_a_knot_shows_a_number():
    scene = Scene([knot(2, 3, 0.4, 0.1, BRUSHED, segments=24, sides=6)], [EnvironmentLight((1, 1, 1))], CAMERA)
    assert np.isfinite(render(scene, (8, 6), integrator=Path(samples=2), backend="numpy").pixels).all()
