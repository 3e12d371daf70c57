"""Glass in Whitted's tracer: Fresnel's shares, refraction, absorption, shadows, and the same bits everywhere."""

import dataclasses
import itertools

import numpy as np
import pytest
from scene_pictures import BACKENDS, same

import shpy as sh
from raytracer import (
    Camera,
    DirectionalLight,
    Material,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    Surface,
    Texture,
    render,
)
from raytracer.kernels import walk
from raytracer.meshes.shapes import box, floor, sphere, torus

CLEAR = Material((0, 0, 0), specular=0, transmission=1.0)
RED, GREEN, BLUE = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def wall(z, color, size=1e5):
    """A wall across the z axis that shows its colour whatever the light is."""
    return floor(size, Material(color, specular=0)).moved((0, 0, z), tilt=90)


def before(material, *, camera=None, walls=((8, RED), (-8, GREEN)), bounces=8, slab=1.0, size=(9, 9), **changes):
    """A slab across the z axis, a red wall behind the viewer and a green one behind the slab, without lights."""
    meshes = [box((100, 100, slab), material), *(wall(z, color) for z, color in walls)]
    camera = camera or Camera((0, 0, 5), (0, 0, 0), fov=1e-3)
    scene = Scene(meshes, (), camera, background=(0, 0, 1), ambient=1.0)
    return render(scene, size, backend="numpy", bounces=bounces, **changes).pixels


@pytest.mark.sampled(4)
@pytest.mark.parametrize("ior", [1.1, 1.5, 2.42, 0.75])
def test_fresnel_at_normal_incidence(ior):
    share = ((ior - 1) / (ior + 1)) ** 2
    one = before(dataclasses.replace(CLEAR, ior=ior, absorption=(99, 99, 99)))
    np.testing.assert_allclose(one[..., 0], share, atol=1e-5)
    assert not one[..., 1:].any()
    both = before(dataclasses.replace(CLEAR, ior=ior))
    np.testing.assert_allclose(both[..., 0], 2 * share / (1 + share), atol=4e-5)
    np.testing.assert_allclose(both[..., 1], (1 - share) / (1 + share), atol=4e-5)


def fresnel(cosine, ratio):
    """Return the reflectance of unpolarised light, in f64; `ratio` of the indices, behind to before."""
    square = 1 - (1 - cosine**2) / ratio**2
    inner = np.sqrt(np.maximum(square, 0))
    across = (cosine - ratio * inner) / (cosine + ratio * inner)
    along = (ratio * cosine - inner) / (ratio * cosine + inner)
    return np.where(square > 0, (across**2 + along**2) / 2, 1.0)


def rays_of(camera, width, height):
    view = camera.view(width, height)
    row, column = np.mgrid[:height, :width] + 0.5
    ray = view.corner + column[..., None] * view.across + row[..., None] * view.down
    return ray / np.linalg.norm(ray, axis=-1, keepdims=True)


def test_nothing_leaves_beyond_the_critical_angle():
    """From within glass, upward: green is what Fresnel's equations let through, red what is mirrored once."""
    camera = Camera((0, 0, 0.2), (0.8, 0, 1), fov=60)
    red = dataclasses.replace(CLEAR, absorption=(0, 0, 0))
    found = before(red, camera=camera, walls=((8, GREEN),), bounces=1, size=(64, 48))
    cosine = rays_of(camera, 64, 48)[..., 2]
    ahead = cosine > 0.05
    expected = 1 - fresnel(cosine[ahead], 1 / 1.5)
    np.testing.assert_allclose(found[..., 1][ahead], expected, atol=2e-4)
    assert 0.2 < (expected == 0).mean() < 0.8


def test_a_slab_moves_what_is_behind_it_aside():
    """The place on the wall that each ray meets, by Snell's law in f64."""

    def where(hit):
        return Surface(color=hit.position * 0.01 + 0.5)

    camera, thick = Camera((0, 0, 5), (1.5, 0.5, 0), fov=40), 1.0
    meshes = [box((100, 100, thick), CLEAR), floor(200, Material(surface=where, specular=0)).moved((0, 0, -8), tilt=90)]
    scene = Scene(meshes, (), camera, background=(0, 0, 0), ambient=1.0)
    found = render(scene, (32, 24), backend="numpy", bounces=2).pixels[..., :2]
    ray = rays_of(camera, 32, 24)
    aside = np.linalg.norm(ray[..., :2], axis=-1, keepdims=True)
    inside = aside / 1.5 / np.sqrt(1 - (aside / 1.5) ** 2)  # tan of the angle in the slab
    along = ray[..., :2] / aside
    outside = ray[..., :2] / -ray[..., 2:]
    place = outside * (13 - thick) + along * inside * thick
    shares = (1 - fresnel(-ray[..., 2:], 1.5)) ** 2
    np.testing.assert_allclose(found, shares * (place * 0.01 + 0.5), atol=2e-5)


def test_no_light_is_lost_or_made():
    """Before a background of 1 everything looks like it, however often light is mirrored inside: a furnace."""
    ball = sphere(1, CLEAR, rings=48, segments=96)
    scene = Scene([ball], (), Camera((0, 0, 4), (0, 0, 0), fov=40), background=(1, 1, 1), ambient=0.0)
    few, many = (render(scene, (48, 48), backend="numpy", bounces=n).pixels for n in (2, 16))
    assert many.max() <= 1 + 1e-5
    assert few.max() <= 1 + 1e-5
    assert 1 - many.mean() < (1 - few.mean()) / 10
    assert np.percentile(many, 2) > 0.98


def test_light_is_absorbed_on_its_way():
    found = before(dataclasses.replace(CLEAR, ior=1.0, absorption=(0.1, 0.5, 2)), slab=2.0, walls=((-8, (1, 1, 1)),))
    np.testing.assert_allclose(found, np.broadcast_to(np.exp([-0.2, -1.0, -4.0]), found.shape), rtol=1e-5)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("light", [DirectionalLight((0, 0, -1)), PointLight((0, 0, 600))])
@pytest.mark.parametrize("count", [1, 3])
def test_shadows_of_glass_are_tinted(light, count):
    pane = dataclasses.replace(CLEAR, transmission=0.5, absorption=(0, 1, 2))
    panes = [box((8, 8, 0.5), pane).moved((0, 0, 1 + k)) for k in range(count)]
    camera = Camera((3, 0, 0.5), (0, 0, 0), fov=4)
    lit = Scene([wall(0, (1, 1, 1))], (light,), camera, (0, 0, 0), 0.0)
    through = dataclasses.replace(lit, meshes=(*lit.meshes, *panes))
    bare, shaded = (render(scene, (8, 8), backend="numpy").pixels for scene in (lit, through))
    assert bare.min() > 0.5
    expected = (0.25 * np.exp(-0.5 * np.array([0, 1, 2]))) ** count
    np.testing.assert_allclose(shaded / bare, np.broadcast_to(expected, bare.shape), rtol=1e-3)


def test_what_stands_before_or_behind_glass_casts_its_shadow():
    camera = Camera((3, 0, 0.5), (0, 0, 0), fov=4)
    pane, screen = box((8, 8, 0.5), CLEAR).moved((0, 0, 1)), box((8, 8, 0.2), Material())
    for place in (0.6, 2.5):
        meshes = [wall(0, (1, 1, 1)), pane, screen.moved((0, 0, place))]
        scene = Scene(meshes, (DirectionalLight((0, 0, -1)),), camera, (0, 0, 0), 0.0)
        assert not render(scene, (8, 8), backend="numpy").pixels.any()


def shapes():
    def frosted(hit):
        return Surface(transmission=sh.cond(hit.position.y > 0.5, 1.0, 0.3), ior=1.3)

    half = Texture(np.array([[1.0, 0.0], [0.0, 0.5]]))
    green = dataclasses.replace(CLEAR, absorption=(2, 0.3, 2))
    meshes = [
        floor(12, Material((0.6, 0.5, 0.4), reflectivity=0.2)),
        sphere(1, CLEAR, rings=8, segments=12).moved((-1.3, 1.01, 0)),
        box((1.2, 1.2, 1.2), green).moved((1.2, 0.61, 0.3), turn=30),
        torus(0.5, 0.2, Material((0.8, 0.2, 0.1), surface=frosted), segments=12, sides=8).moved((0.2, 0.5, 2), tilt=70),
        box((0.8, 0.8, 0.8), Material((0.1, 0.2, 0.9), transmission=half)).moved((-0.5, 0.41, 2.5)),
    ]
    lights = (PointLight((-3, 6, 5), (0.8, 0.8, 0.8)), DirectionalLight((-5, -5, -3), (0.3, 0.3, 0.3)))
    return Scene(meshes, lights, Camera((0, 3, 7), (0, 0.7, 0), fov=42))


@pytest.mark.slow
def test_backends_and_accelerators_agree_to_the_last_bit(monkeypatch):
    scene = shapes()
    size = 30, 20
    first = render(scene, size, backend="numpy", bounces=5)
    assert first.stats.features["glass"]
    assert first.rays.max() > 12
    for backend in BACKENDS[1:]:
        same(first, render(scene, size, backend=backend, bounces=5))
    same(first, render(scene, size, backend="numpy", bounces=5, accel="grid"))
    monkeypatch.setattr(walk, "MANY", 1)
    alone = Renderer(scene, backend="opencl", bounces=5)
    assert isinstance(alone._tracer.intersector, walk.SplitWalk)
    assert "find_two(" in alone.kernel.source  # two rays take turns
    same(first, alone.render(size))


def test_arrays_of_rays_that_wait_are_named(monkeypatch):
    monkeypatch.setattr(sh.Program, "compile", lambda *_, **__: None)  # nothing is compiled
    clear = Material(transmission=1.0, ior=1.3, absorption=(0.1, 0.2, 0.3))
    scene = Scene([box((3, 3, 3), clear), box((1, 1, 1), clear)], (PointLight((0, 5, 0)),), Camera((0, 0, 6)))
    text = str(Renderer(scene, backend="numpy", bounces=2).program.ir)
    for name in ("waiting_eye", "waiting_direction", "waiting_share", "waiting_left", "waiting_bodies"):
        assert name in text


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [1, pytest.param(4, marks=pytest.mark.slow), 16])
def test_every_width_agrees(lanes):
    renderer = Renderer(shapes(), backend="opencl", bounces=4)
    first = renderer.render((24, 16))
    renderer.kernel = renderer.program.compile("opencl", lanes=lanes, loop_limit=None)
    same(first, renderer.render((24, 16)))


@pytest.mark.slow
def test_more_bounces_than_rays_that_may_wait():
    scene = Scene([sphere(1, CLEAR, rings=6, segments=8)], (), Camera((0, 0, 4), (0, 0, 0), fov=40), ambient=0.0)
    for backend, other in itertools.pairwise(BACKENDS):
        same(*(render(scene, (16, 16), backend=name, bounces=20) for name in (backend, other)))


def test_only_scenes_with_glass_have_its_code(monkeypatch):
    monkeypatch.setattr(sh.Program, "compile", lambda *_, **__: None)  # nothing is compiled
    scene = Scene([box()], (DirectionalLight((0, 0, -1)),))
    assert "glass" not in Renderer(scene, backend="numpy").features
    assert "glass" not in Renderer(scene, backend="numpy").program.tables
    assert "glass" in Renderer(Scene([box(material=CLEAR)]), backend="numpy").program.tables


def test_the_staged_tracer_refuses_glass():
    with pytest.raises(
        SceneError, match=r"staged tracer follows mirrored rays alone, .* glass: choose the unified tracer, Whitted"
    ):
        render(Scene([box(material=CLEAR)]), (8, 8), backend="numpy", tracer="staged")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"transmission": 1.5}, r"transmission lies in \[0, 1\]"),
        ({"ior": 0}, "refractive index"),
        ({"ior": "glass"}, "refractive index"),
        ({"absorption": (-1, 0, 0)}, "absorption"),
        ({"absorption": 2}, "absorption"),
    ],
)
def test_materials_that_are_none(given, message):
    with pytest.raises(SceneError, match=message):
        Material(**given)
