"""Path tracing: known answers, both ways of finding lights, and the same bits wherever it runs and in any parts."""

import dataclasses
import math

import numpy as np
import pytest
from scene_pictures import same, same_everywhere

import shpy as sh
from raytracer import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Image,
    Material,
    Mesh,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    Surface,
    Texture,
    cli,
    render,
)
from raytracer.integrators import progressive
from raytracer.integrators.layers import BANDS
from raytracer.kernels import walk
from raytracer.kernels.emitters import Chances, alias_table, probabilities_of
from raytracer.kernels.eye_rays import EyeRays
from raytracer.kernels.path import PathTracer, power
from raytracer.meshes.shapes import box, floor, icosahedron, sphere
from raytracer.scene.layout import Layout
from shpy.ir.traverse import loops

WHITE = Material((1, 1, 1), diffuse=1, specular=0)
BLACK = Material((0, 0, 0), diffuse=0, specular=0)
DOWN = Camera((0, 2, 0), (0, 0, 0), up=(0, 0, 1), fov=0.01)
"""It sees one point of a floor: each of its pixels is an estimate of the same number."""
SLANTED = Camera((0.5, 0.5, 0), (0, 0, 0), fov=0.01)
MORE = 128, 128  # four times as many estimates


def traced(scene, size=(64, 64), **options):
    """Return a picture by the backend that compiles fastest; many pixels take it less time than many samples."""
    given = {"backend": "numpy", "integrator": "path", "samples": 1, "bounces": 1}
    return render(scene, size, **(given | options))


def mean_of(image):
    """The mean of all pixels and channels, and its standard error."""
    values = image.pixels.astype(np.float64).mean(axis=2).reshape(-1)
    return values.mean(), values.std(ddof=1) / math.sqrt(len(values))


def agrees(image, expected, least=1e-6):
    """An estimate without bias lies beyond four standard errors once in 16,000 times."""
    mean, error = mean_of(image)
    assert abs(mean - expected) < 4 * error + least, f"{mean} is not {expected} within 4 times {error}"


def lamp(side, height, radiance=(1, 1, 1)):
    """A square light over the origin that shines on what is below, and above."""
    dark = Material((0, 0, 0), diffuse=0, specular=0, emission=radiance)
    return floor(side, dark).moved((0, height, 0))


def form_factor(half, height):
    """Return the view factor of a point for a parallel square centred over it, with sides 2 * half (Howell, B-4)."""
    x = half / height
    return 4 / math.pi * x / math.sqrt(1 + x * x) * math.atan(x / math.sqrt(1 + x * x))


def test_white_furnace():
    """A surface that scatters all light cannot be told from the light around it."""
    image = traced(Scene([icosahedron(1, WHITE)], [EnvironmentLight((1, 1, 1))], Camera((0, 0, 4))))
    assert (image.object_id == 0).sum() > 50
    np.testing.assert_allclose(image.pixels, 1, atol=1e-3)


@pytest.mark.slow
def test_white_furnace_of_a_box_that_is_open():
    room = box((2, 2, 2), WHITE, inward=True)
    open_room = Mesh(room.vertices, room.faces[:-2], material=WHITE)
    image = traced(Scene([open_room], [EnvironmentLight((0.5, 1, 2))], Camera((0, 0, 0.5))), bounces=64, samples=4)
    for channel, expected in enumerate((0.5, 1, 2)):
        values = image.pixels[..., channel].astype(np.float64)
        assert abs(values.mean() - expected) < 4 * values.std() / 64 + 0.01 * expected  # the rest is beyond 64 bounces


@pytest.mark.slow
@pytest.mark.parametrize("shininess", [0, 20])
def test_a_glossy_surface_seen_from_above_loses_nothing(shininess):
    shiny = Material((0, 0, 0), diffuse=0, specular=0.75, shininess=shininess)
    agrees(traced(Scene([floor(9, shiny)], [EnvironmentLight((1, 1, 1))], DOWN), samples=4), 0.75)


def test_a_lobe_of_exponent_0_is_the_hemisphere_about_the_mirrored_ray():
    """Seen at 60 degrees, the hemisphere and that about the normal share (1 + cos 60) / 2 of the cosine's integral."""
    shiny = Material((0, 0, 0), diffuse=0, specular=0.8, shininess=0)
    aslant = Camera((math.sqrt(3), 1, 0), (0, 0, 0), fov=0.01)
    agrees(traced(Scene([floor(9, shiny)], [EnvironmentLight((1, 1, 1))], aslant), samples=4), 0.8 * 0.75)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("side", [0.02, 1.0, 40.0])
def test_a_floor_under_a_square_light(side):
    ground = floor(9, Material((0.5, 0.5, 0.5), diffuse=0.8, specular=0))
    image = traced(Scene([ground, lamp(side, 1, (3, 3, 3))], camera=SLANTED), samples=4)
    agrees(image, 0.4 * 3 * form_factor(side / 2, 1))


@pytest.mark.slow
@pytest.mark.parametrize(("falloff", "sign"), [("square", 1), ("none", -1)])
def test_point_lights_are_those_of_the_other_integrator(falloff, sign):
    lights = [PointLight((1, 3, 1), (sign * 0.9, sign * 0.6, sign * 0.3), falloff=falloff)]
    ground = floor(9, Material((0.5, 0.6, 0.7), diffuse=0.8, specular=0))
    ball = sphere(0.5, Material((0.9, 0.2, 0.2), specular=0), rings=8, segments=12).moved((0.6, 0.5, 0))
    scene = Scene([ground, ball], lights, Camera((0, 3, 4)), ambient=0, background=(0.1, 0.2, 0.3))
    one = traced(scene, (24, 24), backend="opencl", samples=64)
    other = render(scene, (24, 24), backend="opencl", samples=64, bounces=0)
    difference = np.abs(one.pixels - other.pixels).mean(axis=2)
    assert np.median(difference) < 1e-3
    assert difference.mean() < 4e-3  # at edges the samples are others


@pytest.mark.slow
def test_many_lights_are_one_after_the_other():
    ground = floor(9, Material((1, 1, 1), diffuse=0.5, specular=0))
    lights = [
        PointLight((0, 3, 0), (1, 1, 1)),
        DirectionalLight((0, -1, 0), (0.2, 0.2, 0.2)),
        EnvironmentLight((2, 2, 2)),
    ]
    shining = lamp(0.5, 1.0, (9, 9, 9)).moved((0, 1, 0))
    scene = Scene([ground, shining], lights, SLANTED)
    factor = form_factor(0.25, 2)  # the lamp hides a part of the environment, the two other lights wholly or not at all
    expected = 0.5 * (9 * factor + 2 * (1 - factor))
    agrees(traced(scene, MORE, samples=4), expected)
    moved = Scene([ground, lamp(0.5, 2.0, (9, 9, 9))], [PointLight((0, 1, 0)), *lights[2:]], SLANTED)
    agrees(traced(moved, MORE, samples=4), expected + 0.5)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("aimed", "met"), [(1.0, 0.0), (0.0, 1.0)], ids=["aimed", "met"])
def test_either_way_of_finding_lights_gives_the_same(monkeypatch, aimed, met):
    shiny = Material((0.5, 0.5, 0.5), diffuse=0.6, specular=0.4, shininess=8)
    sky = EnvironmentLight(np.random.default_rng(1).random((4, 8, 3)))
    scene = Scene([floor(9, shiny), lamp(2, 1.5, (2, 2, 2))], [sky], SLANTED)
    mean, error = mean_of(traced(scene, samples=4))
    monkeypatch.setattr(PathTracer, "aimed_share", staticmethod(lambda density, other: aimed))
    monkeypatch.setattr(PathTracer, "met_share", staticmethod(lambda density, other: met))
    other, larger = mean_of(traced(scene, MORE, samples=4))
    assert abs(mean - other) < 4 * math.hypot(error, larger)


def test_shares_of_both_ways_add_up_to_the_whole():
    densities = np.float32([1e-38, 1e-3, 1.0, 7.0, 1e20, 3e38])
    a, b = np.meshgrid(densities, densities)
    with np.errstate(over="ignore"):
        np.testing.assert_allclose(power(a, b) + power(b, a), 1, rtol=1e-6)
    assert power(3.0, 4.0) == pytest.approx(9 / 25)
    assert power(5.0, 0.0) == 1


@pytest.mark.slow
def test_roulette_and_bounces():
    """In a closed room that shines and scatters, light is a geometric series."""
    room = box((2, 2, 2), Material((1, 1, 1), diffuse=0.6, specular=0, emission=(1, 1, 1)), inward=True)
    scene = Scene([room], camera=Camera((0, 0, 0.5)))
    for bounces in (0, 1, 3, 8, 64):
        agrees(traced(scene, bounces=bounces, samples=4), (1 - 0.6 ** (bounces + 1)) / 0.4, 1e-5)


def test_a_mirror_shows_lights_and_background():
    mirror = Material((1, 1, 1), diffuse=0, specular=0, reflectivity=1)
    scene = Scene([floor(9, mirror), lamp(1, 1, (3, 2, 1))], camera=Camera((0.5, 0.5, 0)), background=(0.2, 0.4, 0.6))
    image = traced(scene, (16, 16), samples=1)
    seen = {tuple(pixel) for pixel in image.pixels.reshape(-1, 3)}
    assert seen == {tuple(np.float32((3, 2, 1))), tuple(np.float32((0.2, 0.4, 0.6)))}
    half = Material((1, 1, 1), diffuse=0.5, specular=0, reflectivity=0.25)
    lit = Scene([floor(9, half)], [EnvironmentLight((1, 1, 1))], DOWN)
    agrees(traced(lit, samples=4), 0.25 + 0.75 * 0.5)


def test_glass_loses_nothing_but_what_it_absorbs():
    clear = {"diffuse": 0, "specular": 0, "transmission": 1}
    sky, camera = [EnvironmentLight((1, 1, 1))], Camera((0, 3, 0), (0, 0, 0), up=(0, 0, 1), fov=0.01)
    ball = icosahedron(1, Material((0, 0, 0), **clear))
    np.testing.assert_allclose(traced(Scene([ball], sky, Camera((0, 0, 4))), bounces=64).pixels.max(), 1, atol=1e-3)
    slab = box((40, 1, 40), Material((0, 0, 0), **clear, ior=1.5, absorption=(0.5, 0.5, 0.5)))
    image = traced(Scene([slab], sky, camera), bounces=64, samples=4)
    mirrored, kept = 0.04, math.exp(-0.5)  # Fresnel at normal incidence; light goes to and fro between both sides
    expected = mirrored + (1 - mirrored) ** 2 * kept * (1 + mirrored * kept) / (1 - (mirrored * kept) ** 2)
    agrees(image, expected)


@pytest.mark.slow
def test_a_picture_of_the_sky_lights_a_floor():
    sky = np.zeros((16, 32, 3))
    sky[3, 20] = 50
    sky[5, 4:7] = 2
    row, column = (np.mgrid[:1600, :3200] + 0.5) / 100
    height = math.pi * (0.5 - row / 16)
    light = Texture(sky, filter="nearest")
    cells = sky[row.astype(int), column.astype(int), 0] * np.maximum(np.sin(height), 0) * np.cos(height)
    expected = cells.sum() * (math.pi / 1600) * (2 * math.pi / 3200) / math.pi
    scene = Scene([floor(9, WHITE)], [EnvironmentLight(light)], DOWN)
    image = traced(scene, samples=4)
    agrees(image, expected)
    mean, error = mean_of(image)
    assert error < 0.02 * mean  # where it is 0.17 if directions are chosen evenly
    bright = traced(Scene([icosahedron(1e-3, BLACK)], [EnvironmentLight(light)], Camera((0, 0, 4), fov=150)))
    assert bright.pixels.max() <= 50


def test_where_a_picture_of_the_sky_is_seen():
    sky = np.zeros((2, 4, 3))
    sky[0, 2], sky[1, 1] = (1, 0, 0), (0, 1, 0)  # up to the right, down to the left of (0, 0, -1)
    light = EnvironmentLight(Texture(sky, filter="nearest"))
    tiny = icosahedron(1e-6, BLACK).moved((0, 0, 50))
    image = traced(Scene([tiny], [light], Camera((0, 0, 1), (0, 0, 0), fov=60)), (8, 8), samples=4)
    assert image.pixels[2, 6].tolist() == [1, 0, 0]
    assert image.pixels[6, 2].tolist() == [0, 1, 0]
    assert not image.pixels[[2, 6], [2, 6]].any()


def test_a_program_of_the_sky():
    def sky(direction: sh.Vector3f) -> sh.Color3f:
        return sh.Color3f(1, 1, 1) * sh.max(direction.y, 0.0)

    agrees(traced(Scene([floor(9, WHITE)], [EnvironmentLight(sky)], DOWN), samples=4), 2 / 3)


def test_programs_say_what_shines():
    def glow(hit):
        return Surface(emission=sh.cond(hit.position.x > 0, 2.0, 0.0) * sh.Color3f(1, 1, 1))

    ceiling = floor(40.0, Material((0, 0, 0), diffuse=0, specular=0, surface=glow)).moved((0, 1, 0))
    scene = Scene([floor(9, WHITE), ceiling], camera=SLANTED)
    agrees(traced(scene, samples=4), form_factor(20, 1))


def everything():
    def spots(hit):
        return Surface(
            color=abs(sh.sin(9 * hit.position)), emission=sh.cond(hit.uv.x > 0.9, 1.0, 0.0) * sh.Color3f(1, 2, 3)
        )

    meshes = [
        floor(9, Material((0.6, 0.6, 0.5), specular=0.3)),
        sphere(0.6, Material((0, 0, 0), diffuse=0, specular=0, transmission=0.9), rings=6, segments=8).moved(
            (0, 0.7, 1)
        ),
        sphere(0.5, Material((0.9, 0.6, 0.3), reflectivity=0.5), rings=6, segments=8).moved((1.2, 0.5, 0)),
        box((0.8, 0.8, 0.8), Material(surface=spots)).moved((-1.2, 0.4, 0)),
        lamp(0.7, 2.5, (5, 4, 3)),
    ]
    sky = np.random.default_rng(0).random((8, 16, 3))
    lights = [PointLight((2, 3, 2)), DirectionalLight((1, -1, -1), (0.2, 0.2, 0.2)), EnvironmentLight(sky)]
    return Scene(meshes, lights, Camera((0, 1.5, 5), (0, 0.6, 0), aperture=0.1))


def test_backends_bands_and_parts_give_the_same_bits(monkeypatch, tmp_path):
    scene = everything()
    options = {"integrator": "path", "samples": 3, "bounces": 5, "seed": 7}
    first = same_everywhere(scene, (12, 9), ("numpy", "glsl"), **options)
    assert len(np.unique(first.object_id)) > 3
    renderer = Renderer(scene, backend="opencl", integrator="path", bounces=5, seed=7)
    same(first, renderer.render((12, 9), samples=3))
    monkeypatch.setitem(BANDS, "paths on a device", 30)
    monkeypatch.setattr(progressive, "SAMPLES_AT_ONCE", 2)
    same(first, renderer.render((12, 9), samples=3))
    for ending in (".npy", ".exr"):
        path = renderer.render((12, 9), samples=1).save(tmp_path / f"part{ending}")
        whole = renderer.render((12, 9), samples=3, resume=path)
        same(first, whole)
        assert whole.samples == 3
    monkeypatch.setattr(walk, "MANY", 1)
    alone = Renderer(scene, backend="opencl", integrator="path", bounces=5, seed=7)
    assert isinstance(alone._tracer.intersector, walk.SplitWalk)
    same(first, alone.render((12, 9), samples=3))
    other = Renderer(scene, backend="opencl", integrator="path", bounces=5, seed=8).render((12, 9), samples=3)
    assert (other.pixels != first.pixels).mean() > 0.5


def test_scattered_rays_walk_alone_among_many_triangles(monkeypatch):
    def walk_of(triangles, **options):
        monkeypatch.setattr(walk, "MANY", triangles)
        renderer = Renderer(sphere_under_a_lamp, **({"backend": "opencl", "integrator": "path"} | options))
        return type(renderer._tracer.intersector).__name__

    monkeypatch.setattr(Renderer, "_choose", lambda *_, **__: None)  # nothing is compiled
    sphere_under_a_lamp = Scene([sphere(0.5, WHITE, rings=6, segments=8), lamp(1, 2)])
    count = sphere_under_a_lamp.triangles
    assert walk_of(count) == "SplitWalk"
    monkeypatch.setattr(walk, "ROOMY", count - 1)
    assert walk_of(count) == "AloneWalk"
    assert walk_of(count + 1) == walk_of(count, integrator="whitted") == "BvhIntersector"
    assert walk_of(count, backend="numpy") == walk_of(count, backend="glsl") == "BvhIntersector"
    assert walk_of(count, accel="grid") == "GridIntersector"


@pytest.mark.slow
@pytest.mark.parametrize("widths", [(1, 16), (4, 8)])
def test_lanes_give_the_same_bits(widths):
    renderer = Renderer(everything(), backend="numpy", integrator="path", bounces=3)
    renderer.render((4, 3), samples=1)
    start = np.zeros((5, 7, 3), np.float32)
    renderer.params["past_sample"].value = 2
    expected = renderer.kernel(start)
    for lanes in widths:
        found = renderer.program.compile("opencl", lanes=lanes, loop_limit=None)(start)
        for one, layer in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one, layer)


@pytest.fixture(scope="module")
def small():
    scene = Scene([floor(9, WHITE), lamp(1, 2)], camera=Camera((2, 1, 2)))
    return Renderer(scene, backend="numpy", integrator="path", bounces=1)


def test_a_camera_in_arrays_is_known_by_its_numbers(small):
    part = small.render((4, 3), samples=1, camera=Camera(np.array([2.0, 1, 2])))
    assert small.render((4, 3), samples=2, resume=part, camera=Camera((2, 1, 2))).samples == 2
    with pytest.raises(SceneError, match="not path traced from this scene"):
        small.render((4, 3), samples=2, resume=part, camera=Camera(np.array([2.0, 1, 2 + 1e-12])))


def test_a_picture_of_something_else_is_not_continued(small, tmp_path):
    part = small.render((4, 3), samples=2)
    assert small.render((4, 3), samples=2, resume=part).pixels.tolist() == part.pixels.tolist()
    with pytest.raises(SceneError, match=r"an Image, or its \.exr or \.npy file, not 3"):
        small.render((4, 3), samples=2, resume=3)
    with pytest.raises(SceneError, match="2 samples already, more than 1"):
        small.render((4, 3), samples=1, resume=part)
    with pytest.raises(SceneError, match="4 x 3 pixels, not 4 x 4"):
        small.render((4, 4), samples=4, resume=part)
    with pytest.raises(SceneError, match="not path traced from this scene"):
        small.render((4, 3), samples=4, resume=part, camera=Camera((1, 1, 2)))
    with pytest.raises(FileNotFoundError, match="no picture"):
        small.render((4, 3), samples=4, resume=tmp_path / "gone.npy")
    wrong = tmp_path / "wrong.npy"
    np.save(wrong, np.zeros((3, 4, 3)))
    with pytest.raises(SceneError, match="no picture that raytracer saved"):
        small.render((4, 3), samples=4, resume=wrong)


def test_progress_counts_the_rows_of_all_passes(small, monkeypatch):
    monkeypatch.setitem(BANDS, "paths on numpy", 8)
    monkeypatch.setattr(progressive, "SAMPLES_AT_ONCE", 2)
    seen = []
    counts = [image.samples for image in small.passes((4, 3), samples=3, progress=lambda *rows: seen.append(rows))]
    assert counts == [2, 3]
    assert seen == [(2, 6), (3, 6), (5, 6), (6, 6)]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"integrator": "light"}, "one of 'whitted', 'path'"),
        ({"seed": -1}, "seed"),
        ({"samples": 0}, "samples"),
        ({"samples": 1.5}, "samples"),
        ({"bounces": 65}, "bounces"),
        ({"tracer": "staged"}, "leave it out"),
        ({"precision": "f64"}, "f32"),
        ({"max_error": 1.0}, "max_error"),
        ({"integrator": "whitted", "resume": "a.npy"}, "no samples to add to"),
    ],
)
def test_options_that_do_not_go_together(options, words):
    with pytest.raises(SceneError, match=words):
        render(Scene([floor(1)]), (4, 4), **({"backend": "numpy", "integrator": "path"} | options))


def test_a_shade_is_refused_by_name():
    def toon(surface, light):
        return surface.color

    with pytest.raises(SceneError, match=r"toon \(test_path.py:\d+\): a shade is for"):
        render(Scene([floor(1, Material(shade=toon))]), (4, 4), backend="numpy", integrator="path")


@pytest.mark.parametrize("source", [(1, 2), "sky", (1, -1, 0), (np.nan, 0, 0), None, ("a", "b", "c")])
def test_sources_that_are_no_environment(source):
    with pytest.raises((SceneError, FileNotFoundError)):
        EnvironmentLight(source)


def test_environments_that_cannot_be():
    with pytest.raises(SceneError, match="at most one"):
        Scene([], [EnvironmentLight((1, 1, 1))] * 2)
    with pytest.raises(SceneError, match="something to light"):
        render(Scene([], [EnvironmentLight((1, 1, 1))]), (4, 4), backend="numpy", integrator="path")

    def sky(direction):
        return "blue"

    with pytest.raises(SceneError, match=r"sky \(test_path.py:\d+\).*Color3f"):
        render(Scene([floor(1)], [EnvironmentLight(sky)]), (4, 4), backend="numpy", integrator="path")


def test_scenes_without_light_and_without_anything():
    dark = traced(Scene([floor(1)], camera=Camera((0, 1, 1)), background=(0, 0, 0)), (16, 16))
    assert not dark.pixels.any()
    empty = traced(Scene([], background=(0.1, 0.2, 0.3)), (16, 16))
    np.testing.assert_array_equal(empty.pixels, np.broadcast_to(np.float32((0.1, 0.2, 0.3)), (16, 16, 3)))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("lights", [[], [PointLight((0, 3, 0))]], ids=["alone", "beside a light"])
@pytest.mark.parametrize("dark", ["without area", "of a black picture"])
def test_triangles_that_shine_but_send_no_light_change_nothing(dark, lights):
    flat = Mesh(np.zeros((3, 3)), [[0, 1, 2]], uv=np.zeros((3, 2)))
    black = floor(1, dataclasses.replace(WHITE, emission=Texture([[0.0]]))).moved((0, 1, 0))
    lit = flat.with_material(Material(emission=(1, 1, 1))) if dark == "without area" else black
    other = lit.with_material(dataclasses.replace(lit.material, emission=(0, 0, 0)))
    scenes = (Scene([floor(4, WHITE), mesh], lights, Camera((0, 3, 3))) for mesh in (lit, other))
    seen, expected = (traced(scene, (16, 16), samples=2) for scene in scenes)
    np.testing.assert_array_equal(seen.pixels, expected.pixels)


def test_emission_is_seen_and_lights_nothing_in_the_other_integrator():
    scene = Scene([floor(9, WHITE), lamp(1, 1, (3, 2, 1))], camera=Camera((2, 0.5, 0)), ambient=0, background=(0, 0, 0))
    image = render(scene, (32, 32), backend="numpy")
    assert np.all(image.pixels[image.object_id == 1] == (3, 2, 1))
    assert not image.pixels[image.object_id != 1].any()


def test_choices_have_the_probabilities_that_they_say():
    rng = np.random.default_rng(2)
    for weights in (rng.random(7), np.array([0, 1, 0, 1e-9, 5]), np.array([3.0]), rng.random(1000) ** 8):
        thresholds, aliases = alias_table(weights)
        found = probabilities_of(thresholds, aliases)
        assert found.sum() == pytest.approx(1, abs=1e-12)
        np.testing.assert_allclose(found, weights / weights.sum(), atol=2e-7)
        assert np.all((found > 0) == (weights > 0))


def test_a_light_is_chosen_by_the_power_that_it_has_at_the_size_of_the_scene():
    lights = [DirectionalLight((0, -1, 0), (3, 3, 3)), PointLight((0, 5, 0), (8, 8, 8), falloff="square")]
    scene = Scene([floor(6, WHITE)], lights)
    probabilities = PathTracer(Layout.of(scene, "bvh"), scene, 1, "numpy").emitters.chances.probabilities
    powers = np.array([3, 8 / (2 * 6.0**2)])
    np.testing.assert_allclose(probabilities, powers / powers.sum(), rtol=1e-5)


def test_samples_begin_together_in_a_packet_and_else_as_soon_as_one_has_ended():
    scene = Scene([floor(6, WHITE)], [PointLight((0, 5, 0))])
    layout = Layout.of(scene, "brute")
    programs = {b: PathTracer(layout, scene, 1, b).program(EyeRays()) for b in ("numpy", "opencl", "glsl")}
    count = {b: len(list(loops(program.ir))) for b, program in programs.items()}
    assert count["opencl"] == count["numpy"] + 1 == count["glsl"] + 1  # a path's own loop inside that of the samples


def test_the_kernel_makes_those_choices():
    weights = np.array([1.0, 2, 0, 5])
    chances = Chances(weights, numbers=[10, 11, 12, 13])

    @sh.program
    def choose() -> tuple[sh.Attrib1i, sh.Attrib1i, sh.Attrib1f]:
        k = sh.grid_index(1)
        return chances.choose(sh.hash(k, 0), sh.hash(k, 1))

    for backend in ("numpy", "opencl"):
        places, numbers, densities = choose.compile(backend)(shape=80_000)
        counts = np.bincount(places, minlength=4)
        assert np.all(np.abs(counts - 10_000 * weights) < 4 * np.sqrt(10_000 * weights) + 1e-9)
        np.testing.assert_array_equal(numbers, places + 10)
        np.testing.assert_array_equal(densities, chances.densities[places])


def test_the_command_continues_a_picture(tmp_path, capsys):
    path, whole = tmp_path / "a.exr", tmp_path / "b.exr"
    line = ["render", "cornell", "--integrator", "path", "--size", "8x8", "--bounces", "2", "--backend", "numpy"]
    assert cli.main([*line, "--samples", "1", "-o", str(path), "--resume"]) == 0
    assert cli.main([*line, "--samples", "3", "-o", str(path), "--resume"]) == 0
    assert cli.main([*line, "--samples", "3", "-o", str(whole)]) == 0
    same(Image.load(path), Image.load(whole))
    capsys.readouterr()
    assert cli.main([*line, "--samples", "3", "-o", str(tmp_path / "a.png"), "--resume"]) == 1
    assert "hold all numbers: .exr or .npy" in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_writes_what_there_is_after_an_interruption(tmp_path, capsys, monkeypatch):
    path, passes = tmp_path / "a.npy", Renderer.passes
    line = ["render", "cornell", "--integrator", "path", "--size", "4x4", "--bounces", "1", "--backend", "numpy"]

    def stopped(*given, **options):
        yield next(passes(*given, **options))
        raise KeyboardInterrupt

    monkeypatch.setattr(Renderer, "passes", stopped)
    assert cli.main([*line, "--samples", "40", "-o", str(path)]) == 130
    assert "stopped after 16 of 40 samples, which were written" in capsys.readouterr().err
    assert Image.load(path).samples == 16
