"""Scenes with a MetallicRoughness: its numbers, textures and programs, beside other materials, in every tracer."""

import dataclasses
import pickle

import numpy as np
import pytest

import shpy as sh
from raytracer import (
    Camera,
    EnvironmentLight,
    LayeredCube,
    Material,
    Mesh,
    MetallicRoughness,
    Path,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    Staged,
    Surface,
    Texture,
    Whitted,
    render,
)
from raytracer.meshes.shapes import box, floor, sphere
from raytracer.view.editing import Edits

GOLD, COPPER = (1.0, 0.77, 0.34), (0.95, 0.64, 0.54)
RAMP = Texture(np.linspace(0, 1, 64).reshape(8, 8).astype(np.float32), srgb=False)
PAINT = Texture(np.random.default_rng(1).random((8, 8, 3)).astype(np.float32))
SQUARE = Mesh(
    [[-1, 0, 0], [1, 0, 0], [1, 2, 0], [-1, 2, 0]], [[0, 1, 2], [0, 2, 3]], uv=[[0, 0], [1, 0], [1, 1], [0, 1]]
)


def rings(hit):
    return Surface(roughness=sh.fract(3 * hit.position.y), base_color=sh.Color3f(1, 0.8, 0.5), metallic=1)


def ball(material, x, z=0.0):
    return sphere(0.5, material, rings=8, segments=16).moved((x, 0, z))


LAYERED = [
    ball(MetallicRoughness(GOLD, 1, 0.3), -1.2),
    ball(MetallicRoughness((0.8, 0.1, 0.1), 0, 0.4), 0),
    ball(MetallicRoughness((0.1, 0.2, 0.8), 0.5, 0.0), 1.2),
    floor(4, MetallicRoughness((0.5,) * 3, 0, 1)).moved((0, -0.5, 0)),
]
COATED = [
    *LAYERED,
    ball(MetallicRoughness(COPPER, 0, 0.7, clearcoat=1, clearcoat_roughness=0.1), 0, -1.2),
    ball(MetallicRoughness((0.9, 1, 0.9), 0, 0.2, transmission=0.8), -1.2, 1),
]
MIXED = [
    *COATED,
    ball(Material(reflectivity=GOLD), 1.2, -1.2),
    ball(Material(transmission=0.9), 0, 1.2),
    ball(MetallicRoughness(surface=rings), 1.2, 1.2),
    ball(MetallicRoughness(COPPER, alpha=0.5), -1.2, -1.2),
]
TEXTURED = [
    *LAYERED,
    SQUARE.with_material(MetallicRoughness(PAINT, RAMP, RAMP, ior=RAMP, specular=RAMP, specular_color=PAINT)),
    SQUARE.with_material(
        MetallicRoughness(clearcoat=RAMP, clearcoat_roughness=RAMP, transmission=RAMP, emission=PAINT, alpha=RAMP)
    ).moved((1, 0, 1)),
    SQUARE.with_material(MetallicRoughness(GOLD, 1, normal=PAINT, cutout=RAMP)).moved((-2, 0, 1)),
]
SCENES = {"layered": LAYERED, "coated": COATED, "mixed": MIXED, "textured": TEXTURED}
CAMERA = Camera((0, 2, 4), (0, 0, 0), fov=45)


def scene_of(meshes, integrator):
    lights = [PointLight((2, 3, 2))]
    if isinstance(integrator, Path):
        lights.append(EnvironmentLight((0.4, 0.5, 0.6)))
    return Scene(meshes, lights, CAMERA)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [Path(samples=2, bounces=5), Whitted()], ids=["path", "whitted"])
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name == "mixed" else pytest.mark.slow) for name in SCENES]
)
def test_pictures_have_the_same_bits_on_every_backend(name, integrator):
    scene = scene_of(SCENES[name], integrator)
    images = [render(scene, (24, 16), integrator=integrator, backend=b) for b in ("numpy", "opencl", "glsl")]
    assert np.isfinite(images[0].pixels).all()
    assert images[0].pixels.max() > 0
    for other in images[1:]:
        np.testing.assert_array_equal(images[0].pixels, other.pixels)


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (4, 8, 16))])
def test_pictures_have_the_same_bits_at_every_width(lanes):
    scene = scene_of(MIXED, Path())
    expected = render(scene, (16, 12), integrator=Path(samples=2), backend="numpy")
    renderer = Renderer(scene, integrator=Path(samples=2), backend="opencl")
    renderer.kernel = renderer.program.compile("opencl", lanes=lanes, loop_limit=None)
    np.testing.assert_array_equal(renderer.render((16, 12)).pixels, expected.pixels)


@pytest.mark.sampled(12)
@pytest.mark.parametrize(
    ("field", "number", "picture"),
    [
        ("base_color", (0.25, 0.5, 0.75), None),
        ("metallic", 0.25, None),
        ("roughness", 0.25, None),
        ("ior", 2.0, None),
        ("specular", 0.25, None),
        ("specular_color", (2.0, 0.5, 0.25), None),
        ("clearcoat", 0.25, {"clearcoat_roughness": 0.5}),
        ("clearcoat_roughness", 0.25, {"clearcoat": 1.0}),
        ("transmission", 0.25, None),
        ("emission", (0.25, 0.5, 0.75), None),
        ("alpha", 0.25, None),
    ],
)
def test_a_picture_of_one_colour_is_a_number(field, number, picture):
    """A texture that is the same everywhere gives the same light as the number that it holds."""
    pixels = np.broadcast_to(np.float32(number), (2, 2, 3)).copy()
    images = []
    for value in (number, Texture(pixels, srgb=False)):
        look = MetallicRoughness(**{"base_color": (0.5, 0.4, 0.3), **(picture or {}), field: value})
        scene = Scene([SQUARE.with_material(look)], [EnvironmentLight((1, 1, 1))], Camera((0, 1, 4), (0, 1, 0)))
        images.append(render(scene, (6, 6), integrator=Path(samples=4, bounces=3), backend="numpy").pixels)
    np.testing.assert_allclose(*images, atol=1e-6)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "integrator", [Whitted(), pytest.param(Path(samples=256), marks=pytest.mark.slow)], ids=["whitted", "path"]
)
@pytest.mark.parametrize("glass", [False, True])
def test_mirrors_of_phongs_model_have_colours(integrator, glass):
    mirror = Material(reflectivity=(1, 0.5, 0.25), specular=0, diffuse=0)
    meshes = [floor(9, mirror)]
    if glass:  # which has a tracer of its own
        meshes.append(box((1, 1, 1), Material(transmission=1.0)).moved((20, 0, 0)))
    scene = Scene(meshes, [], Camera((0, 4, 0.001), (0, 0, 0)), background=(1, 1, 1), ambient=0)
    image = render(scene, (4, 4), integrator=integrator, backend="numpy")
    np.testing.assert_allclose(image.pixels.mean(axis=(0, 1)), (1, 0.5, 0.25), atol=0.02)


@pytest.mark.parametrize(
    "integrator", [Whitted(bounces=2), pytest.param(Path(samples=4), marks=pytest.mark.slow)], ids=["whitted", "path"]
)
def test_a_grey_colour_of_a_mirror_is_its_number(integrator):
    """A mirror of equal channels takes the kernel of a number; beside a coloured one it shows the same."""
    images = []
    for share in (0.5, (0.5, 0.5, 0.5)):
        for other in ((), (ball(Material(reflectivity=GOLD), 30.0),)):
            meshes = [floor(4, Material(reflectivity=share)).moved((0, -0.5, 0)), ball(Material(), 0), *other]
            images.append(render(Scene(meshes, [PointLight((2, 3, 2))], CAMERA), (12, 8), integrator=integrator).pixels)
    for image in images[1:]:
        np.testing.assert_allclose(images[0], image, atol=2e-6)


@pytest.mark.parametrize("share", [(1.1, 0, 0), (-0.1, 0, 0), (np.nan, 0, 0), (1, 1), "red", 1.5])
def test_shares_of_mirrors_are_checked(share):
    with pytest.raises(SceneError):
        Material(reflectivity=share)


def test_whitted_shows_the_matt_lobe_as_phongs_model_does():
    looks = [Material((0.5, 0.5, 0.5), diffuse=1, specular=0), MetallicRoughness((0.5,) * 3, specular=0, roughness=1)]
    images = [
        render(
            Scene([floor(4, look)], [PointLight((1, 3, 1))], Camera((0, 4, 0.1), (0, 0, 0))), (8, 8), backend="numpy"
        )
        for look in looks
    ]
    np.testing.assert_allclose(images[0].pixels, images[1].pixels, atol=3e-3)


@pytest.mark.slow
@pytest.mark.sampled(4)
@pytest.mark.parametrize("beside", [(), (ball(Material(transmission=1.0), 20.0),)], ids=["alone", "beside glass"])
@pytest.mark.parametrize("roughness", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_whitted_gains_no_light(roughness, metallic, beside):
    """Under ambient light of 1 and a background of 1 a white surface shows at most 1."""
    look = MetallicRoughness((1, 1, 1), metallic, roughness, clearcoat=0.5)
    scene = Scene([ball(look, 0), *beside], [], CAMERA, background=(1, 1, 1), ambient=1)
    image = render(scene, (12, 8), backend="numpy")
    assert image.pixels.max() <= 1 + 1e-4
    if not metallic:
        assert image.pixels[image.object_id == 0].min() > 0.97


def test_whitted_mirrors_in_the_colour_of_a_metal():
    scene = Scene([floor(9, MetallicRoughness(GOLD, 1, 0))], [], Camera((0, 4, 0.001), (0, 0, 0)), background=(1, 1, 1))
    image = render(scene, (4, 4), backend="numpy")
    np.testing.assert_allclose(image.pixels, np.broadcast_to(GOLD, (4, 4, 3)), atol=3e-3)


@pytest.mark.slow
def test_alpha_shows_what_lies_behind():
    half = MetallicRoughness((0, 0, 0), specular=0, alpha=0.5)
    for integrator in (Whitted(), Path(samples=512)):
        scene = Scene([SQUARE.with_material(half)], [], Camera((0, 1, 3), (0, 1, 0), fov=20), background=(1, 0.5, 0))
        image = render(scene, (4, 4), integrator=integrator, backend="numpy")
        np.testing.assert_allclose(image.pixels.mean(axis=(0, 1)), (0.5, 0.25, 0), atol=0.02)


PANE = MetallicRoughness((1, 0.5, 0), specular=0, roughness=0, transmission=1)


@pytest.mark.parametrize("integrator", [Whitted(), Path(samples=16)], ids=["whitted", "path"])
def test_a_thin_wall_tints_what_is_behind_it(integrator):
    scene = Scene([SQUARE.with_material(PANE)], [], Camera((0, 1, 3), (0, 1, 0), fov=20), background=(1, 1, 1))
    image = render(scene, (4, 4), integrator=integrator, backend="numpy")
    np.testing.assert_allclose(image.pixels, np.broadcast_to((1, 0.5, 0), (4, 4, 3)), atol=1e-4)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("share", [1.0, 0.5])
@pytest.mark.parametrize("integrator", [Whitted(), Path(samples=64, bounces=1)], ids=["whitted", "path"])
def test_lights_shine_through_smooth_thin_walls(integrator, share):
    """A wall that reflects nothing but its matt rest takes that rest from a light, and tints what it lets through."""
    ground = floor(20, Material((1, 1, 1), diffuse=1, specular=0))
    images = []
    for walls in ([], [floor(4, dataclasses.replace(PANE, transmission=share)).moved((0, 1, 0))]):
        scene = Scene([ground, *walls], [PointLight((0, 3, 0))], Camera((4, 0.5, 0), (0, 0, 0), fov=5), ambient=0)
        images.append(render(scene, (4, 4), integrator=integrator, backend="numpy").pixels)
    expected = images[0] * share * np.array((1, 0.5, 0))
    np.testing.assert_allclose(images[1].mean(axis=(0, 1)), expected.mean(axis=(0, 1)), atol=2e-3, rtol=0.02)


@pytest.mark.slow
def test_a_rough_thin_wall_lets_the_environment_through():
    rough = dataclasses.replace(PANE, roughness=0.5)
    above = EnvironmentLight(Texture(np.float32([[[1, 1, 1]], [[0, 0, 0]]]), srgb=False, filter="nearest"))
    scene = Scene([floor(40, rough)], [above], Camera((0, -3, 0.01), (0, 0, 0), fov=20))
    image = render(scene, (4, 4), integrator=Path(samples=64), backend="numpy")
    red, green, blue = image.pixels.mean(axis=(0, 1))
    assert 0.9 < red <= 1  # light that microfacets mirror to the other side of the wall is lost
    assert (green, blue) == (pytest.approx(red / 2, rel=1e-3), 0)


def test_programs_decide_layers():
    scene = scene_of([ball(MetallicRoughness(surface=rings), 0)], Path())
    image = render(scene, (8, 6), integrator=Path(samples=4), backend="numpy")
    plain = render(
        scene_of([ball(MetallicRoughness(), 0)], Path()), (8, 6), integrator=Path(samples=4), backend="numpy"
    )
    assert not np.allclose(image.pixels, plain.pixels)
    with pytest.raises(
        SceneError,
        match=r"rings \(test_metallic_roughness.py:\d+\): base_color, metallic, roughness of a Surface belong to a "
        r"MetallicRoughness, and this is the surface of a Material: write MetallicRoughness\(surface=...\)",
    ):
        render(scene_of([ball(Material(surface=rings), 0)], Path()), (8, 6), integrator=Path(samples=4))
    with pytest.raises(SceneError, match=r"shininess of a Surface belongs to a Material, .* Material\(surface=...\)$"):
        render(scene_of([ball(MetallicRoughness(surface=lambda hit: Surface(shininess=3)), 0)], Whitted()), (8, 6))
    cure = r"write Material\(surface=...\) or MetallicRoughness\(transmission=...\)$"
    with pytest.raises(SceneError, match=f"transmission of a Surface belongs to a Material, .*: {cure}"):
        render(scene_of([ball(MetallicRoughness(surface=lambda hit: Surface(transmission=1)), 0)], Whitted()), (8, 6))


def test_a_program_of_colours_serves_both_models():
    def checks(hit):
        return Surface(color=abs(sh.Color3f(*hit.normal)))

    for look in (Material(surface=checks), MetallicRoughness(surface=checks)):
        image = render(scene_of([ball(look, 0)], Whitted()), (8, 6), backend="numpy")
        assert np.ptp(image.pixels[image.object_id == 0], axis=1).max() > 0.05


@pytest.mark.slow
@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "meshes", [LAYERED, [*LAYERED[:2], ball(Material(reflectivity=GOLD), 1.2)], [ball(Material(reflectivity=GOLD), 0)]]
)
def test_the_staged_tracer_gives_the_same_bits(meshes):
    scene = scene_of(meshes, Staged())
    images = [render(scene, (12, 8), integrator=kind(bounces=2), backend="numpy") for kind in (Whitted, Staged)]
    np.testing.assert_array_equal(images[0].pixels, images[1].pixels)


def test_the_staged_tracer_refuses_thin_walls():
    with pytest.raises(SceneError, match="the staged tracer follows mirrored rays alone, and this scene has glass"):
        Renderer(scene_of([ball(PANE, 0)], Staged()), integrator=Staged(), backend="numpy")


@pytest.mark.slow
def test_deferred_cubes_keep_layers():
    """Mirrors show planes by samples of their colours as they show them by their triangles."""
    mirror = box((1, 1, 1), MetallicRoughness(GOLD, 1, 0)).moved((0, 0, 0))
    walls = [floor(6, MetallicRoughness((0.2, 0.4, 0.8), 0.5, 0.5)).moved((0, -0.5, 0))]
    scene = scene_of([mirror, *walls], Whitted())
    images = []
    for shading in ("exact", "deferred"):
        cube = LayeredCube.of(scene, resolution=64, shading=shading, backend="numpy")
        images.append(render(scene, (12, 8), integrator=Whitted(secondary=cube), backend="numpy").pixels)
    np.testing.assert_allclose(images[0], images[1], atol=2e-3)


@pytest.mark.parametrize(
    ("look", "message"),
    [
        ({"roughness": 1.5}, "the roughness of a material is a number from 0 to 1, or a Texture, not 1.5"),
        ({"metallic": -0.1}, "the metallic of a material is a number from 0 to 1, or a Texture, not -0.1"),
        ({"metallic": "1"}, "the metallic of a material is a number from 0 to 1, or a Texture, not '1'"),
        ({"alpha": np.nan}, "the alpha of a material is a number from 0 to 1, or a Texture, not nan"),
        ({"base_color": (2, 0, 0)}, r"the base_color of a material is \(r, g, b\), each from 0 to 1, or a Texture"),
        ({"emission": (-1, 0, 0)}, r"the emission of a material is \(r, g, b\), each 0 or more, or a Texture"),
        ({"ior": -1}, "the ior of a material is a refractive index, such as 1.5, or 0 for what mirrors all"),
        ({"normal": 1}, "the normal of a material is a Texture or None, not 1"),
        ({"surface": 1}, "a material's surface is a function or a program, not 1"),
    ],
)
def test_wrong_fields_are_refused(look, message):
    with pytest.raises(SceneError, match=message):
        MetallicRoughness(**look)


def test_numbers_beyond_binary32_are_refused():
    scene = scene_of([ball(MetallicRoughness(specular_color=(1e39, 0, 0)), 0)], Whitted())
    with pytest.raises(SceneError, match="out of the range of binary32"):
        Renderer(scene, backend="numpy")


def test_materials_are_values():
    look = MetallicRoughness(GOLD, 1, 0.3)
    assert look == MetallicRoughness(np.array(GOLD), np.int64(1), np.float64(0.3))
    assert pickle.loads(pickle.dumps(look)) == look
    assert dataclasses.replace(look, roughness=0.4) != look
    textured = MetallicRoughness(alpha=RAMP)
    assert dataclasses.replace(textured, roughness=0.4).textures == textured.textures


def test_numbers_change_without_a_new_kernel():
    scene = scene_of(LAYERED, Whitted())
    renderer = Renderer(scene, backend="numpy")
    other = scene_of([m.with_material(dataclasses.replace(m.material, roughness=0.6)) for m in LAYERED], Whitted())
    renderer.show(other)
    assert renderer.builds == 1
    np.testing.assert_array_equal(renderer.render((8, 6)).pixels, render(other, (8, 6), backend="numpy").pixels)


def test_the_page_has_a_control_for_each_number():
    scene = scene_of([ball(MetallicRoughness(GOLD, 1, RAMP), 0)], Whitted())
    edits = Edits(scene)
    (material,) = edits.describe()["materials"]
    names = [control["title"] for control in material["controls"]]
    assert names == [
        *("specular", "transmission", "ior", "emission", "base_color", "metallic"),
        *("specular_color", "clearcoat", "clearcoat_roughness", "sheen_color", "sheen_roughness"),
        *("anisotropy", "anisotropy_rotation", "thickness", "attenuation_color", "alpha"),
    ]
    assert edits.set({f"material.{material['label']}.metallic": [0.5]}) == []
    assert edits.applied(scene).meshes[0].material.metallic == 0.5
    assert edits.set({f"material.{material['label']}.metallic": [2.0]}) != []


@pytest.mark.slow
@pytest.mark.sampled(2)
@pytest.mark.parametrize("integrator", [Whitted(bounces=2), Path(samples=2, bounces=3)], ids=["Whitted", "Path"])
def test_layered_objects_move_and_change_shape(integrator):
    """Pictures after moves are those of a scene that was made so, to the bit, with pictures on what moves, too."""
    dents = Texture(np.random.default_rng(4).random((4, 4, 3)).astype(np.float32), srgb=False)
    gold = MetallicRoughness((1, 0.77, 0.34), metallic=1, roughness=dents, clearcoat=0.5, normal=dents)
    ground = floor(4, MetallicRoughness((0.5, 0.5, 0.5), roughness=0.3))
    ball = sphere(0.5, gold, rings=8, segments=12)
    scene = Scene([ball, ground], [PointLight((2, 3, 2))], CAMERA)
    renderer = Renderer(scene, integrator=integrator, backend="numpy")
    renderer.render((12, 8))
    place = np.eye(4)
    for k in range(2):
        place[0, 3] = 0.3 * k
        shape = ball.vertices * (1, 1 + 0.2 * k, 1)
        renderer.deform(0, shape)
        renderer.move(0, place)
        image = renderer.render((12, 8))
        moved = renderer.scene.meshes[0]
        expected = render(Scene([moved, ground], scene.lights, CAMERA), (12, 8), integrator=integrator, backend="numpy")
        np.testing.assert_array_equal(image.pixels, expected.pixels)
    assert renderer.builds == 2


def test_a_material_that_glsl_cannot_compile_is_an_error_that_names_other_backends():
    layers = {"clearcoat": 1.0, "sheen_color": (0.5, 0.5, 0.5), "sheen_roughness": 0.4, "anisotropy": 0.5}
    everything = MetallicRoughness((1, 0.5, 0.2), 0.5, 0.3, transmission=0.5, thickness=1.0, **layers)
    with pytest.raises(sh.CompileError, match=r"^GLSL cannot run the kernel of this scene here: OpenGL") as caught:
        render(Scene([box(material=everything)]), (4, 4), backend="glsl", integrator=Path(samples=1, fuse=True))
    assert caught.value.cure == 'backend="opencl" or backend="numpy"'
