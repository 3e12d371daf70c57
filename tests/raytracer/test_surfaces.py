"""Programs and textures on surfaces: what they are handed, what they give, and the same bits on every backend."""

import dataclasses
import warnings
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image as pillow
from scene_pictures import BACKENDS, same, same_everywhere

import shpy as sh
from raytracer import (
    Camera,
    DirectionalLight,
    Hit,
    Material,
    Mesh,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    Surface,
    Texture,
    render as rendered,
    shaders,
)
from raytracer.kernels.appearance import Atlas
from raytracer.meshes.shapes import box, cylinder, floor, icosahedron, knot, sphere, torus
from raytracer.meshes.teapot import teapot
from shpy import SH_IF

SUN = (DirectionalLight((0, 0, -1)),)
SPOTS = (PointLight((-3, 6, 5), (0.8, 0.8, 0.8)), PointLight((5, 5, 3), (0.3, 0.3, 0.3)))
AHEAD = Camera((0, 0, 4), (0, 0, 0), fov=45)
BARE = Mesh([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]], name="bare")
PICTURE = np.array([[(1, 0, 0), (0, 1, 0), (0, 0, 1)], [(1, 1, 0), (0, 1, 1), (0.5, 0.25, 0)]])


def shown(mesh, material, size=(24, 20), **changes):
    """A mesh of a material under the sun, without ambient light or background."""
    given = {"lights": SUN, "camera": AHEAD, "ambient": 0.0, "background": (0, 0, 0)}
    scene = Scene([mesh.with_material(material)], **(given | changes))
    return rendered(scene, size, backend="numpy", bounces=1)


def probe(value, mesh=BARE, **changes):
    """Render a value of the Hit, which `value` selects, as the colour of a picture."""

    def surface(hit):
        return Surface(color=value(hit), diffuse=1, specular=0)

    found = shown(mesh, Material(surface=surface, shade=lambda surface, light: surface.color), **changes)
    assert (found.object_id >= 0).sum() > 20
    return found, found.object_id >= 0


def checker(hit: Hit) -> Surface:
    even = (sh.Attrib1i(sh.floor(8 * hit.uv.x)) + sh.Attrib1i(sh.floor(8 * hit.uv.y))) % 2 == 0
    return Surface(color=sh.cond(even, sh.Color3f(0.9), sh.Color3f(0.1)), reflectivity=0.2)


def toon(surface: Surface, light: sh.Vector3f) -> sh.Color3f:
    return surface.color * sh.floor(3 * sh.max(sh.dot(surface.normal, light), 0) + 0.5) / 3


def bumps(hit: Hit) -> Surface:
    waves = sh.Normal3f(*(sh.sin(20 * c) for c in hit.position))
    return Surface(normal=hit.normal + 0.3 * waves, specular=0.6)


@sh.program
def stripes(uv: sh.TexCoord2f) -> sh.Color3f:
    return sh.cond(sh.fract(uv.x * 10) < 0.5, sh.Color3f(1, 0, 0), sh.Color3f(1, 1, 1))


def everything():
    meshes = [
        floor(12, Material(surface=checker)),
        sphere(1, Material((0.2, 0.7, 0.3), shade=toon), rings=8, segments=12).moved((0, 1, 0)),
        box((1.5, 1.5, 1.5), Material(Texture(PICTURE, filter="nearest"))).moved((2.2, 0.75, 0), turn=30),
        torus(0.7, 0.3, Material(surface=stripes), segments=12, sides=8).moved((-1, 0.3, 2)),
        sphere(0.6, Material(surface=bumps), rings=8, segments=12).moved((1, 0.6, 2)),
        cylinder(0.3, 1, Material(Texture(PICTURE, wrap="mirror"), diffuse=Texture([[1, 0.5]]))).moved((2.6, 0.5, 2)),
        icosahedron(0.5, Material((0.5, 0, 0.5), reflectivity=0.3)).moved((-2.5, 0.5, 1)),
    ]
    return Scene(meshes, SPOTS, Camera((0, 3, 7), (0, 0.7, 0), fov=50))


@pytest.mark.slow
def test_backends_and_accelerators_agree_to_the_last_bit():
    scene = everything()
    size = 48, 32
    first = same_everywhere(scene, size)
    assert len(np.unique(first.object_id)) == 8
    same(first, rendered(scene, size, backend="numpy", accel="grid"))


@pytest.mark.parametrize("backend", ["numpy", pytest.param("opencl", marks=pytest.mark.slow)])
def test_the_staged_tracer_agrees(backend):
    scene = everything()
    same(
        rendered(scene, (24, 16), backend=backend, accel="grid"),
        rendered(scene, (24, 16), backend=backend, tracer="staged"),
    )


def test_a_program_that_says_what_a_material_says_changes_nothing():
    plain = Material((0.3, 0.6, 0.9), 0.7, 0.4, 30.0, 0.25)
    numbers = {name: getattr(plain, name) for name in ("color", "diffuse", "specular", "shininess", "reflectivity")}
    ball = sphere(1, rings=12, segments=16)
    same(shown(ball, plain), shown(ball, Material(surface=lambda hit: Surface(**numbers))))
    turned = shown(ball, dataclasses.replace(plain, surface=lambda hit: Surface(normal=2 * hit.normal)))
    np.testing.assert_allclose(turned.pixels, shown(ball, plain).pixels, atol=1e-6)


def test_params_and_tables_of_a_program_may_be_called_as_those_of_the_tracer_are():
    background, scale, normals = (
        sh.Param(sh.Color3f, (0.3, 0.6, 0.9)),
        sh.Param(sh.Attrib1f, 1),
        sh.Table([1.0], sh.Attrib1f),
    )
    program = Material(surface=lambda hit: Surface(color=background * scale * normals[0]))
    same(shown(BARE, program), shown(BARE, Material((0.3, 0.6, 0.9))))


def test_a_shade_takes_the_place_of_phongs_model():
    def lambert(surface, light):
        return surface.diffuse * sh.max(sh.dot(surface.normal, light), 0) * surface.color

    ball = sphere(1, rings=12, segments=16)
    same(shown(ball, Material(specular=0)), shown(ball, Material(specular=0.9, shade=lambert)))


def test_a_shade_is_asked_for_lights_that_are_seen_alone():
    wall, screen = floor(4).moved(tilt=90), floor(1, Material((0, 0, 0), specular=0)).moved((0, 0, 2), tilt=90)
    glowing = wall.with_material(Material(shade=lambda surface, light: sh.Color3f(1, 0, 0)))
    scene = Scene([glowing, screen], SUN, Camera((6, 0, 6), (0, 0, 0)), ambient=0.0, background=(0, 0, 0))
    found = rendered(scene, (64, 48), backend="numpy")
    red, wall_seen = found.pixels[..., 0] == 1, found.object_id == 0
    assert 0.05 < (wall_seen & ~red).sum() / wall_seen.sum() < 0.5
    assert not red[~wall_seen].any()


def test_positions_and_distances_are_the_pictures():
    found, hit = probe(lambda hit: hit.position * 0.5 + 0.5, sphere(1, rings=24, segments=32))
    radius = np.linalg.norm(2 * found.pixels[hit] - 1, axis=-1)
    assert np.abs(radius - 1).max() < 0.02
    seen, _ = probe(lambda hit: sh.Color3f(hit.distance), sphere(1, rings=24, segments=32))
    np.testing.assert_array_equal(seen.pixels[..., 0][hit], seen.depth[hit])


def test_positions_are_the_scenes_wherever_it_stands():
    place = np.array([1e4, -2e4, 5e3])
    camera = Camera(tuple(place + (0, 0, 4)), tuple(place), fov=45)
    found, hit = probe(lambda hit: hit.position, sphere(1).moved(tuple(place)), camera=camera)
    assert np.abs(found.pixels[hit] - place).max() < 1.01
    assert np.abs(np.linalg.norm(found.pixels[hit] - place, axis=-1) - 1).max() < 0.01


def test_what_else_a_hit_knows():
    two = Mesh(np.concatenate([BARE.vertices, BARE.vertices + (2, 0, 0)]), [[0, 1, 2], [5, 4, 3]])
    names = {"triangle": lambda hit: hit.triangle, "outside": lambda hit: sh.cond(hit.outside, 1.0, 0.0)}
    wide = {"camera": Camera((1, 0, 5), (1, 0, 0), fov=60)}
    for name, value in names.items():
        found, hit = probe(lambda hit, value=value: sh.Color3f(value(hit)), two, **wide)
        right = np.argwhere(hit)[:, 1] > 12
        assert set(found.pixels[hit][right][:, 0]) == ({1.0} if name == "triangle" else {0.0})
        assert set(found.pixels[hit][~right & (np.argwhere(hit)[:, 1] < 11)][:, 0]) == (
            {0.0} if name == "triangle" else {1.0}
        )
    found, hit = probe(lambda hit: sh.Color3f(abs(sh.dot(hit.normal, hit.view)), hit.face.z, hit.object))
    assert np.all(found.pixels[hit][:, 1:] == (1, 0))
    assert np.all(found.pixels[hit][:, 0] > 0.9)


def test_vertex_colours_are_handed_over_and_tint_textures():
    colored = dataclasses.replace(BARE, colors=np.full((3, 3), 0.5), uv=np.zeros((3, 2)))
    found, hit = probe(lambda hit: hit.color, colored)
    np.testing.assert_allclose(found.pixels[hit], 0.5, atol=1e-6)
    found, hit = probe(lambda hit: hit.color)
    assert np.all(found.pixels[hit] == 1)
    tinted = shown(colored, Material(Texture(np.full((1, 1, 3), 0.5)), shade=lambda surface, light: surface.color))
    np.testing.assert_allclose(tinted.pixels[hit], 0.25, atol=1e-6)


def test_uv_of_a_box_shows_a_picture_upright_on_its_sides():
    material = Material(Texture(PICTURE, filter="nearest"), shade=lambda surface, light: surface.color)
    for turn in (0, 90, 180, 270):
        found = shown(box().moved(turn=turn), material, (60, 60), camera=Camera((0, 0, 2), (0, 0, 0), fov=30)).pixels
        rows, columns = np.nonzero(found.any(axis=-1))
        top, bottom, left, right = rows.min(), rows.max(), columns.min(), columns.max()
        corners = found[[top, top, bottom, bottom], [left, right, left, right]]
        np.testing.assert_allclose(corners, PICTURE[[0, 0, 1, 1], [0, 2, 0, 2]], atol=1e-6)


@pytest.mark.parametrize("shape", [box, floor, sphere, torus, knot, cylinder, icosahedron, teapot])
def test_uv_of_shapes_lie_on_the_picture(shape):
    mesh = shape()
    assert mesh.uv.shape == (len(mesh), 3, 2)
    assert mesh.uv.min() >= -1e-12
    assert mesh.uv.max() <= 1.5
    assert np.ptp(mesh.uv, axis=1).max() <= 1


def looked_up(image, uv, filter, wrap):
    """OpenGL's definition, in f64."""
    ways = {
        "repeat": lambda k, n: k % n,
        "clamp": lambda k, n: np.clip(k, 0, n - 1),
        "mirror": lambda k, n: np.where(k % (2 * n) < n, k % (2 * n), 2 * n - 1 - k % (2 * n)),
    }
    height, width = image.shape[:2]
    place = np.stack([uv[:, 0] * width, (1 - uv[:, 1]) * height], axis=1)

    def texel(x, y):
        return image[ways[wrap](y.astype(int), height), ways[wrap](x.astype(int), width)]

    if filter == "nearest":
        return texel(*np.floor(place).T)
    low = np.floor(place - 0.5)
    (s, t), (x, y) = (place - 0.5 - low).T[..., None], low.T
    top, bottom = (texel(x, y + k) * (1 - s) + texel(x + 1, y + k) * s for k in (0, 1))
    return top * (1 - t) + bottom * t


@pytest.mark.sampled(6)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("wrap", ["repeat", "clamp", "mirror"])
@pytest.mark.parametrize("filter", ["linear", "nearest"])
def test_textures_are_read_as_opengl_reads_them(filter, wrap, backend):
    rng = np.random.default_rng(3)
    images = [rng.random((3, 5, 3)).astype(np.float32), rng.random((4, 4, 3)).astype(np.float32)]
    atlas = Atlas([Texture(images[0], wrap="clamp"), Texture(images[1], filter=filter, wrap=wrap)])
    uv = np.concatenate(
        [rng.uniform(-3, 3, (500, 2)), rng.random((500, 2)), [(0.5, 0.5), (-1, 2), (0, 0), (1, 1), (1e-9, 1e-9)]]
    )
    uv = uv.astype(np.float32)

    @sh.program
    def read(uv: sh.TexCoord2f) -> sh.Color3f:
        return atlas.sample(1, uv)

    found = read.compile(backend)(uv)
    assert np.array_equal(found.view(np.int32), read.compile("numpy")(uv).view(np.int32))
    expected = looked_up(images[1], uv.astype(np.float64), filter, wrap)
    error = np.abs(found - expected).max(axis=1)
    assert (error < 1e-5).mean() > 0.995  # beside the edge of a texel f32 may choose the other
    if filter == "linear" and wrap != "repeat":
        assert error.max() < 1e-4
    if filter == "nearest":  # the corners of the picture are those of its texels
        np.testing.assert_array_equal(found[-3:], images[1][[-1, 0, -1], [0, -1, 0]])


def test_uv_that_are_no_numbers_read_some_texel():
    atlas = Atlas([Texture(PICTURE), Texture(PICTURE, filter="nearest", wrap="clamp")])

    @sh.program
    def read(number: sh.Attrib1i, uv: sh.TexCoord2f) -> sh.Color3f:
        return atlas.sample(number, uv)

    wild = np.float32([[np.nan, 0], [np.inf, 0], [1e30, -1e30], [-1e-30, 1]])
    for number in (0, 1):
        texts = [read.compile(backend)(np.int32([number] * 4), wild) for backend in BACKENDS]
        assert all(np.array_equal(texts[0], text, equal_nan=True) for text in texts[1:])


def test_srgb_files_are_decoded_and_numbers_are_not(tmp_path):
    grey = np.full((2, 3, 3), 188, np.uint8)
    pillow.fromarray(grey).save(tmp_path / "grey.png")
    assert Texture(tmp_path / "grey.png").image == pytest.approx(np.full((2, 3, 3), 0.5029), abs=1e-4)
    assert Texture(tmp_path / "grey.png", srgb=False).image == pytest.approx(np.full((2, 3, 3), 188 / 255))
    assert Texture(grey).image == pytest.approx(Texture(tmp_path / "grey.png").image)
    assert Texture(grey / 255).image == pytest.approx(np.full((2, 3, 3), 188 / 255))
    pillow.fromarray(np.full((2, 2), 32768, np.uint16)).save(tmp_path / "deep.png")
    assert Texture(tmp_path / "deep.png", srgb=False).image == pytest.approx(np.full((2, 2, 3), 32768 / 65535))


@pytest.mark.slow
def test_a_number_may_be_a_texture():
    card = floor(1).moved(tilt=90)
    half = Texture(np.array([[0.0, 0.8]]), filter="nearest")
    found = shown(card, Material((1, 1, 1), diffuse=half, specular=0), camera=Camera((0, 0, 2), (0, 0, 0), fov=20))
    np.testing.assert_allclose(found.pixels[:, :12], 0, atol=1e-6)
    np.testing.assert_allclose(found.pixels[:, 12:], 0.8, atol=1e-6)
    mirrors = shown(card, Material(specular=0, diffuse=0, reflectivity=half), background=(1, 1, 1))
    assert mirrors.stats.features["reflections"] == 1
    assert mirrors.pixels.max() == 1


def test_only_what_programs_use_is_in_the_kernel(monkeypatch):
    plain = shown(box(), Material())
    monkeypatch.setattr(sh.Program, "compile", lambda *_, **__: None)  # nothing is compiled
    assert not any("program" in name or name == "textures" for name in plain.stats.features)
    scene = Scene([box().with_material(Material(surface=lambda hit: Surface(color=hit.position)))], SUN)
    assert "uvs" not in Renderer(scene, backend="numpy").program.tables
    assert "uvs" in Renderer(Scene([box(material=Material(surface=checker))], SUN), backend="numpy").program.tables
    assert Renderer(scene, backend="numpy").features["reflections"] == 0


def test_a_hit_may_be_read_in_one_branch_and_after_it():
    def surface(hit):
        color = sh.Color3f(0)
        with SH_IF(hit.position.x > 0):
            color[:] = abs(hit.position)
        return Surface(color=color + 0.1 * abs(hit.position))

    found = shown(BARE, Material(surface=surface, shade=lambda surface, light: surface.color))
    left, right = (found.pixels[10, column] for column in (9, 14))
    assert right == pytest.approx(11 * left, rel=1e-3)
    assert left.any()


class Painted(NamedTuple):
    color: sh.Color3f
    reflectivity: sh.Attrib1f


class Glowing(NamedTuple):
    color: sh.Color3f
    glow: sh.Attrib1f


@sh.program
def tones(x: sh.Attrib1f, gain: sh.Attrib1f) -> Painted:
    return Painted(gain * sh.Color3f(x, x, 0), sh.Attrib1f(0))


@sh.program
def across(position: sh.Point3f) -> sh.Attrib1f:
    return abs(position.x)


@sh.program
def glowing(position: sh.Point3f) -> Glowing:
    return Glowing(abs(position), sh.Attrib1f(1))


@sh.program
def wide(uv: sh.Attrib3f) -> sh.Color3f:
    return sh.Color3f(uv)


@sh.program
def striped(position: sh.Point3f, width: sh.Attrib1f = 0.25) -> sh.Color3f:
    return sh.Color3f(sh.fract(position.x / width))


@sh.program
def lambert(light: sh.Vector3f, color: sh.Color3f, normal: sh.Normal3f) -> sh.Color3f:
    return color * sh.max(sh.dot(normal, light), 0)


def test_programs_are_bound_by_name():
    composed = (tones << across).bind(gain=2.0)
    found = shown(BARE, Material(surface=composed, shade=lambert))
    x = (np.arange(24) + 0.5 - 12) / 10 * np.tan(np.radians(22.5)) * 4
    np.testing.assert_allclose(found.pixels[10, 9:15, 0], 2 * abs(x[9:15]), atol=1e-5)
    assert not found.pixels[10, 9:15, 2].any()


def test_a_param_of_a_program_may_change_between_pictures():
    gain = sh.Param(sh.Attrib1f, 1.0, name="gain")
    material = Material(surface=lambda hit: Surface(color=gain * sh.Color3f(1, 1, 1)), specular=0, diffuse=1)
    renderer = Renderer(Scene([BARE.with_material(material)], SUN, AHEAD, (0, 0, 0), 0.0), backend="numpy")
    bright = renderer.render((24, 20)).pixels
    gain.value = 0.5
    np.testing.assert_array_equal(renderer.render((24, 20)).pixels, bright / 2)


def rebound(hit):
    color = sh.Color3f(0)
    with SH_IF(hit.normal.y > 0):
        color = sh.Color3f(1)
    return Surface(color=color)


LINE = rebound.__code__.co_firstlineno
WRONG = {
    "a surface gives a raytracer.Surface, not a float": {"surface": lambda hit: 0.5},
    "a surface gives a raytracer.Surface, not None": {"surface": lambda hit: None},
    r"test_surfaces.py:\d+: Surface\(color=...\) is an sh.Color3f": {"surface": lambda hit: Surface(color="red")},
    r"Surface\(diffuse=...\) is an sh.Attrib1f": {"surface": lambda hit: Surface(diffuse=hit.position)},
    "this Hit has no postion: it has position": {"surface": lambda hit: Surface(color=hit.postion)},
    rf"test_surfaces.py:{LINE + 3}": {"surface": rebound},
    "bare: .* needs uv coordinates": {"surface": checker},
    "bare: a Texture needs uv coordinates": {"color": Texture(PICTURE)},
    "x, gain is nothing that a Hit has": {"surface": tones},
    r"wide \(test_surfaces.py:\d+\): the input uv takes 3 components or one, not 2": {"surface": wide},
    r"a surface takes one input, a Hit \(too many": {"surface": lambda: Surface()},
    r"a shade takes two inputs, a Surface and the unit vector to a light \(too many": {"shade": lambda surface: 1.0},
    "outputs of a surface are named .*, not glow": {"surface": glowing},
    "a shade gives an sh.Color3f, not None": {"shade": lambda surface, light: None},
    "what a shade gives is an sh.Color3f": {"shade": lambda surface, light: "red"},
    "this Surface has no hue: it has color": {"shade": lambda surface, light: surface.hue},
    "gain is nothing that a Surface with its light has": {"shade": tones.rename(x="diffuse")},
}


def test_an_input_with_a_default_may_be_left_out():
    found, bound = (shown(BARE, Material(surface=program)) for program in (striped, striped.bind(width=0.25)))
    same(found, bound)


@pytest.mark.parametrize("message", WRONG)
def test_mistakes_are_told_before_anything_runs(message):
    with pytest.raises((SceneError, sh.ShpyError, AttributeError), match=message):
        shown(BARE, Material(**WRONG[message]))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"color": "red"}, "three numbers"),
        ({"color": (1, 2)}, "three numbers"),
        ({"color": ("a", None, 1j)}, "three numbers"),
        ({"diffuse": 10**400}, "finite and not negative"),
        ({"ior": 10**400}, "a positive number"),
        ({"emission": (1, [2], 3)}, "of linear radiance, 0 or more"),
        ({"diffuse": "x"}, "a number or a Texture"),
        ({"surface": 3}, "a function or a program"),
        ({"reflectivity": 2}, r"\[0, 1\]"),
        ({"color": (1, np.nan, 0)}, "finite"),
    ],
)
def test_materials_that_are_none(given, message):
    with pytest.raises(SceneError, match=message):
        Material(**given)


@pytest.mark.parametrize(
    ("source", "options", "message"),
    [
        (np.ones(3), {}, "shape"),
        (np.ones((2, 2, 2)), {}, "shape"),
        (np.ones((0, 2, 3)), {}, "shape"),
        (-np.ones((2, 2)), {}, "negative"),
        (np.full((2, 2), np.inf), {}, "not finite"),
        (np.full((2, 2), np.nan), {}, "not finite"),
        (np.full((2, 2), np.inf, np.float16), {}, "not finite"),
        (np.full((2, 2), 1e39), {}, "out of the range of binary32"),
        (np.ones((2, 2), np.int32), {}, r"floats or uint8, not int32: write array.astype\(np.uint8\)$"),
        (np.ones((2, 2), np.uint16), {}, "not uint16: write array / 65535, and srgb=True for colours$"),
        (np.ones((2, 2), bool), {}, r"not bool: write array.astype\(float\)$"),
        (np.ones((1, 20000)), {}, "16384"),
        (__file__, {}, "not a readable picture"),
        (PICTURE, {"wrap": "mirrored"}, "'repeat', 'clamp', 'mirror'"),
        (PICTURE, {"filter": "cubic"}, "'linear', 'nearest'"),
    ],
)
def test_textures_that_are_none(source, options, message):
    with pytest.raises(SceneError, match=message):
        Texture(source, **options)


def test_a_picture_of_halves_is_read_without_a_warning():
    halves = np.array([[0, 0.5], [1, 65504]], np.float16)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(Texture(halves).image[..., 0], halves)


def test_a_picture_that_is_not_there():
    with pytest.raises(FileNotFoundError, match=r"nope\.png"):
        Texture("nope.png")


SHADERS = [
    (kind, getattr(shaders, name)())
    for kind, names in (("surface", "checker marble wood spots bumps"), ("shade", "toon oren_nayar cook_torrance"))
    for name in names.split()
]


@pytest.mark.slow
@pytest.mark.parametrize(
    "chosen",
    [pytest.param(SHADERS, id="all")]
    + [pytest.param([pair], id=pair[1].__name__, marks=pytest.mark.slow) for pair in SHADERS],
)
def test_the_ready_made_ones_agree_on_every_backend(chosen):
    """All of them in one kernel, each on a ball."""
    ball = sphere(1, rings=8, segments=12)
    across = 2.2 * (np.arange(len(chosen)) - (len(chosen) - 1) / 2)
    balls = [
        ball.with_material(Material((0.7, 0.5, 0.3), **{kind: shader})).moved((x, 0, 0))
        for x, (kind, shader) in zip(across, chosen, strict=True)
    ]
    scene, size = Scene(balls, SPOTS, dataclasses.replace(AHEAD, fov=35)), (20 * len(chosen), 20)
    first = same_everywhere(scene, size)
    assert np.isfinite(first.pixels).all()
    for number in range(len(balls)):
        assert len(np.unique(first.pixels[first.object_id == number].round(2), axis=0)) > 5


def test_a_rough_surface_without_roughness_is_lamberts():
    ball = sphere(1, rings=12, segments=16)
    plain = shown(ball, Material(specular=0)).pixels
    np.testing.assert_allclose(shown(ball, Material(shade=shaders.oren_nayar(0.0))).pixels, plain, atol=1e-6)
