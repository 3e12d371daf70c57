"""Media: what lies between two surfaces tints, bends and mirrors, whichever surface is met and wherever the eye is.

Random columns of bodies, nested, touching, overlapping and hollow, stand side by side in one picture. Each pixel looks
along one of them, and the light that is left is a product of exp(-a d) over the way, computed in binary64.
"""

import dataclasses
import itertools

import numpy as np
import pytest
from scene_pictures import BACKENDS, same
from test_glass import fresnel, rays_of

import shpy as sh
from raytracer import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Material,
    Mesh,
    Path,
    PointLight,
    Renderer,
    Scene,
    Surface,
    Whitted,
    render,
)
from raytracer.meshes.shapes import box, floor, icosahedron, sphere

EVERY = [pytest.param(backend, marks=pytest.mark.slow) for backend in BACKENDS[1:]]
CLEAR = Material((0, 0, 0), diffuse=0, specular=0, transmission=1.0, ior=1.0)
GLOW = Material((0, 0, 0), diffuse=0, specular=0, emission=(1, 1, 1))
MIRROR = Material((0, 0, 0), diffuse=0, specular=0, reflectivity=1.0)
WHITE = Material((1, 1, 1), diffuse=1.0, specular=0)
APART = 10
"""Pixels from one column to the next; each pixel is one wide."""
INTEGRATORS = {"whitted": Whitted(bounces=40), "path": Path(bounces=4, samples=1)}
A = np.array([1.0, 0.5, 0.1])


def tinted(absorption, **changes):
    return dataclasses.replace(CLEAR, absorption=tuple(absorption), **changes)


class Column:
    """A random stack of bodies along z at x: a list of (low, high, volume, absorption), and their meshes."""

    def __init__(self, rng, x):
        self.x, self.meshes, self.bodies = x, [], []
        parents = [(-8.0, 8.0, 9.0)]
        for _ in range(rng.integers(1, 6)):
            low, high, wide = parents[rng.integers(len(parents))]
            places = np.unique([low, high, *np.arange(np.ceil(low), high)])  # where other bodies often end
            ends = np.sort(rng.choice(places, 2, replace=False))
            if rng.random() < 0.5:
                ends = np.sort(rng.uniform(low, high, 2))
            width = wide * (1.0 if rng.random() < 0.2 else rng.uniform(0.6, 0.95))
            self.add(rng, ends, width)
            parents.append((*ends, width))

    def add(self, rng, ends, width):
        low, high = ends
        if high - low < 0.05:
            return
        material = tinted(rng.uniform(0, 0.3, 3))
        middle = (self.x, 0, (low + high) / 2)
        self.meshes.append(box((width, width, high - low), material).moved(middle))
        volume = width * width * (high - low)
        hollow = rng.random() < 0.3 and high - low > 0.5
        part = (high - low) * rng.uniform(0.3, 0.8)
        if hollow:
            side = width * 0.9
            self.meshes.append(box((side, side, part), material, inward=True).moved(middle))
            volume -= side * side * part
            centre = middle[2]
            spans = [(low, centre - part / 2), (centre + part / 2, high)]
        else:
            spans = [(low, high)]
        self.bodies.append((spans, np.float32(volume), np.array(material.absorption)))

    def kept(self, start, end):
        """Return the share of light that a way along z leaves."""
        cuts = np.unique([start, end, *(z for spans, *_ in self.bodies for span in spans for z in span)])
        cuts = cuts[(cuts >= min(start, end)) & (cuts <= max(start, end))]
        total = np.zeros(3)
        for low, high in itertools.pairwise(cuts):
            middle = (low + high) / 2
            around = [(v, -k) for k, (spans, v, _) in enumerate(self.bodies) if any(a < middle < b for a, b in spans)]
            if around:
                total += (high - low) * self.bodies[-min(around)[1]][2]
        return np.exp(-total)


def columns(seed, count):
    rng = np.random.default_rng(seed)
    return [Column(rng, APART * (k - count // 2)) for k in range(count)], rng


def seen(made, meshes, eye, integrator, backend, lights=(), **changes):
    """Render one pixel for each column, along -z from z = `eye`."""
    wide = APART * len(made)
    middle = -APART * (len(made) // 2) + wide / 2 - 0.5
    camera = Camera((middle, 0.013, eye), (middle, 0.013, eye - 1), projection="orthographic", span=1.0)
    scene = Scene([*(mesh for column in made for mesh in column.meshes), *meshes], lights, camera, (0, 0, 0), **changes)
    image = render(scene, (wide, 1), backend=backend, integrator=integrator)
    return image.pixels[0, ::APART]


def water_and_glass():
    """Water of 1.33 with a slab of glass of 1.5 in it, and the eye in the water."""
    water = tinted((0, 0, 0), ior=1.33)
    return [box((60, 60, 30), water), box((50, 50, 1), tinted((0, 0, 0), ior=1.5))]


def wall(z, material):
    return floor(40, material).moved((0, 0, z), tilt=90)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["whitted", "path"])
def test_fresnels_share_of_glass_in_water_is_that_of_the_ratio(integrator):
    water, glass = water_and_glass()
    glass = glass.with_material(tinted((99, 99, 99), ior=1.5))
    scene = Scene([water, glass, wall(9, GLOW)], (), Camera((0.1, 0.2, 5), (0.1, 0.2, 0), fov=1e-3), ambient=0.0)
    options = {"samples": 256} if integrator == "path" else {}
    found = render(scene, (8, 8), backend="numpy", integrator=integrator, bounces=4, **options).pixels
    share = ((1.5 - 1.33) / (1.5 + 1.33)) ** 2
    error = 4 * (share / (256 * 64)) ** 0.5 if options else 1e-6
    np.testing.assert_allclose(found.mean(), share, atol=error)


def test_snells_angles_through_glass_in_water():
    """The place on a wall that each ray meets, through water, glass and water, in binary64."""

    def where(hit):
        return Surface(color=hit.position * 0.02 + 0.5)

    camera = Camera((0, 0, 5), (1.5, 0.5, 0), fov=40)
    shown = wall(-6, Material(surface=where, specular=0))
    scene = Scene([*water_and_glass(), shown], (), camera, background=(0, 0, 0), ambient=1.0)
    found = render(scene, (32, 24), backend="numpy", bounces=2).pixels[..., :2]
    ray = rays_of(camera, 32, 24)
    aside = np.linalg.norm(ray[..., :2], axis=-1, keepdims=True)
    sine = aside * 1.33 / 1.5
    place = ray[..., :2] / -ray[..., 2:] * 10 + ray[..., :2] / aside * sine / np.sqrt(1 - sine**2)
    shares = (1 - fresnel(-ray[..., 2:], 1.5 / 1.33)) ** 2
    np.testing.assert_allclose(found, shares * (place * 0.02 + 0.5), atol=4e-5)


def test_glass_that_touches_water_has_one_surface_with_it():
    """Seen along the axis through water, then glass: three surfaces, of which the middle one is between the two."""
    glass, water = box((9, 9, 2), tinted((0, 0, 0), ior=1.5)), box((9, 9, 2), tinted((99, 99, 99), ior=1.33))
    camera = Camera((0.1, 0.2, 5), (0.1, 0.2, 0), fov=1e-3)
    scene = Scene([glass.moved((0, 0, 1)), water.moved((0, 0, -1)), wall(9, GLOW)], (), camera, ambient=0.0)
    found = render(scene, (4, 4), backend="numpy", bounces=12).pixels
    first, second = fresnel(1.0, 1.5), fresnel(1.0, 1.33 / 1.5)
    np.testing.assert_allclose(found, first + (1 - first) ** 2 * second / (1 - first * second), atol=2e-5)


@pytest.mark.slow
def test_a_block_of_glass_stands_on_a_floor():
    """An opaque surface is seen where glass touches it, and nothing below it."""
    block = box((2, 1, 2), tinted(A)).moved((0, 0.5, 0))
    scene = Scene(
        [floor(9, GLOW), block], (), Camera((0.1, 4, 0.2), (0.1, 0, 0.2), up=(0, 0, 1), fov=1e-3), ambient=0.0
    )
    for integrator in INTEGRATORS.values():
        found = render(scene, (4, 4), backend="numpy", integrator=integrator).pixels
        np.testing.assert_allclose(found, np.broadcast_to(np.exp(-A), found.shape), rtol=1e-4)


LIGHTS = {
    "point": PointLight((0.2, 40, 0.1), (1, 1, 1)),
    "directional": DirectionalLight((0.1, -1, 0.2), (1, 1, 1)),
    "area": None,
    "environment": EnvironmentLight((1, 1, 1)),
}


def shadow(light, meshes, integrator, **options):
    """Return the light on a floor below meshes."""
    lights = [light] if light else []
    lamp = [] if light else [floor(3, dataclasses.replace(GLOW, emission=(200, 200, 200))).moved((0, 40, 0))]
    camera = Camera((0, 0.4, 1.2), (0, 0, 0), fov=1)
    scene = Scene([floor(4, WHITE), *meshes, *lamp], lights, camera, (0, 0, 0), 0.0)
    return render(scene, (8, 8), backend="numpy", integrator=integrator, **options).pixels.mean(axis=(0, 1))


@pytest.mark.parametrize(
    ("name", "integrator"),
    [
        ("point", "path"),
        *(pytest.param(name, "path", marks=pytest.mark.slow) for name in ("area", "directional", "environment")),
        *(pytest.param(name, "whitted", marks=pytest.mark.slow) for name in ("point", "directional")),
    ],
)
def test_a_pane_of_alpha_a_tenth_casts_a_tenth_of_a_shadow(name, integrator):
    """Panes of files have a transmission of 0.9 and an ior of 1, and no inside; those of the middle are closed."""
    pane = Material((0, 0, 0), diffuse=0, specular=0, transmission=0.9, ior=1.0)
    thin, plate = floor(200, pane).moved((0, 2, 0)), box((200, 0.1, 200), pane).moved((0, 3, 0))
    sampled = name in ("area", "environment")
    options = {"bounces": 1, "samples": 64 if sampled else 1} if integrator == "path" else {}
    bare, one, both = (shadow(LIGHTS[name], m, integrator, **options) for m in ([], [thin], [thin, plate]))
    assert bare.min() > 0.01
    for pixel, share in ((one, 0.9), (both, 0.9**3)):
        np.testing.assert_allclose(pixel / bare, share, rtol=2e-2 if sampled else 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["directional", *(pytest.param(name, marks=pytest.mark.slow) for name in ("area", "point"))]
)
def test_shadows_take_the_medium_from_the_shading_point_on(name):
    """The floor lies in a body, another one is in that, and the light is outside of both."""
    outer, inner = box((9, 4, 9), tinted(A)), box((8, 1, 8), tinted(2 * A)).moved((0, 1, 0))
    for integrator in ("whitted", "path") if name != "area" else ("path",):
        options = {"bounces": 1, "samples": 64 if name == "area" else 1} if integrator == "path" else {}
        bare, shaded = (shadow(LIGHTS[name], m, integrator, **options) for m in ([], [outer, inner]))
        slant = 1.05**0.5 if name == "directional" else 1.0
        seen = (0.4**2 + 1.2**2) ** 0.5  # from the camera, which is in the body, too
        expected = np.exp(-A * (3 * slant + seen))
        np.testing.assert_allclose(shaded / bare, expected, rtol=2e-2 if name == "area" else 5e-3)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("aperture", [0.0, 0.5])
def test_an_eye_in_a_body_sees_it(aperture):
    ball = tinted(A)
    scene = Scene([sphere(2, ball, rings=24, segments=48), wall(-9, GLOW)], (), Camera((0, 0, 0.5), aperture=aperture))
    camera = dataclasses.replace(scene.camera, position=(0.01, 0.02, 1.0), target=(0.01, 0.02, -5.0), fov=1e-3)
    for integrator in INTEGRATORS.values():
        found = render(dataclasses.replace(scene, camera=camera), (4, 4), backend="numpy", integrator=integrator).pixels
        np.testing.assert_allclose(found.mean(axis=(0, 1)), np.exp(-3 * A), rtol=2e-2)


@pytest.mark.slow
def test_bodies_move():
    """A lamp seen through a body that comes, touches another one, and goes; the pictures are those of a new scene."""
    outer, inner = (
        dataclasses.replace(box((4, 4, d), tinted(A * f)), name=n) for d, f, n in ((2, 1, "a"), (1, 3, "b"))
    )
    camera = Camera((0.1, 0.2, 7), (0.1, 0.2, 0), fov=1e-3)
    for integrator in INTEGRATORS.values():
        renderer = Renderer(Scene([outer, inner.moved((20, 0, 0)), wall(-9, GLOW)], (), camera, ambient=0.0),
                            backend="numpy", integrator=integrator)  # fmt: skip
        for z in (0.0, 1.5, 1.0, 6.5, 30.0):
            place = np.eye(4)
            place[:3, 3] = (-20, 0, z)
            renderer.move("b", place)
            ends = np.clip([z - 0.5, z + 0.5], -9, 7)
            both = np.clip(ends, -1, 1)
            way = 3 * np.ptp(ends) + 2 - np.ptp(both)
            found = renderer.render((4, 4)).pixels
            np.testing.assert_allclose(found, np.broadcast_to(np.exp(-A * way), found.shape), rtol=1e-4)


def test_an_open_surface_is_entered_and_stays():
    """A pool: its water has a surface alone, and a lamp on the ground."""
    pool = floor(50, tinted(A, ior=1.33))
    camera = Camera((0.1, 3, 0.2), (0.1, 0, 0.2), up=(0, 0, 1), fov=1e-3)
    scene = Scene([pool, floor(50, GLOW).moved((0, -2, 0))], (), camera, (0, 0, 0), 0.0)
    found = render(scene, (4, 4), backend="numpy", bounces=1).pixels
    np.testing.assert_allclose(
        found, np.broadcast_to((1 - fresnel(1.0, 1.33)) * np.exp(-2 * A), found.shape), rtol=1e-4
    )


def test_scenes_of_thin_walls_have_no_media(monkeypatch):
    monkeypatch.setattr(sh.Program, "compile", lambda *_, **__: None)  # nothing is compiled
    pane = Scene([floor(3, tinted((0, 0, 0), transmission=0.9)), box()])
    assert "media" not in Renderer(pane, backend="numpy").program.tables
    assert "media" in Renderer(Scene([box(material=tinted(A)), box()]), backend="numpy").program.tables


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", ["whitted", "path"])
def test_the_first_triangle_casts_a_shadow_in_a_scene_with_glass(name):
    """The scene's triangle 0 is opaque and alone; the light of a lamp above falls on the floor beside it only."""
    screen = Mesh([(-1, 1, -1), (-1, 1, 1), (1, 1, -1)], [(0, 1, 2)])
    pane = box((0.5, 0.5, 0.5), dataclasses.replace(CLEAR, ior=1.5 if name == "whitted" else 1.0)).moved((30, 0, 0))
    camera = Camera((0, 0.9, 0), (0, 0, 0), up=(0, 0, -1), fov=150)
    scene = Scene([screen, floor(9, WHITE), pane], [DirectionalLight((0, -1, 0))], camera, (0, 0, 0), 0.0)
    options = {"samples": 1, "bounces": 1} if name == "path" else {}
    found = render(scene, (24, 24), backend="numpy", integrator=name, **options)
    row, column = np.mgrid[:24, :24]
    x, z = column - 11.5, row - 11.5
    width = 0.9 * np.tan(np.radians(75)) / 12  # of a pixel on the floor
    shade = (x * width > -1 + width) & (z * width > -1 + width) & ((x + z) * width < -2 * width)
    floor_seen = found.object_id == 1
    assert shade.sum() > 5
    assert not found.pixels[shade & floor_seen].any()
    assert found.pixels[floor_seen & ((x + z) * width > 2 * width)].min() > 0.1


@pytest.mark.slow
def test_a_scene_without_lights_moves_and_is_shown_again_under_path():
    """Only the background shines, of which mirrors show what they see."""

    def made(color, place):
        ball = dataclasses.replace(icosahedron(1, Material(color, reflectivity=0.5)).moved((place, 0, 0)), name="ball")
        return Scene([ball, floor(9, WHITE).moved((0, -1, 0))], (), Camera((0, 1, 6)), (0.2, 0.4, 0.8))

    integrator = Path(samples=2, bounces=3)
    renderer = Renderer(made((1, 0, 0), 0), backend="numpy", integrator=integrator)
    renderer.show(made((0, 1, 0), 0))
    same(renderer.render((16, 12)), render(made((0, 1, 0), 0), (16, 12), backend="numpy", integrator=integrator))
    assert renderer.builds == 1
    place = np.eye(4)
    for place[0, 3] in (2.0, 1.0):
        renderer.move("ball", place)
        renderer.render((16, 12))
    assert renderer.builds == 2  # the first move alone
    same(renderer.render((16, 12)), render(made((0, 1, 0), 1), (16, 12), backend="numpy", integrator=integrator))


def check(seed, count, name, backend):
    """Compare a lamp seen through each column, directly and in a mirror, with the product along the way."""
    made, rng = columns(seed, count)
    integrator = INTEGRATORS[name]
    eye = float(rng.choice([9.0, rng.uniform(-4, 7)]))
    walls = np.where(rng.random(count) < 0.5, -8.5, rng.uniform(-7.9, eye - 0.3, count))
    lamps = [floor(1.2, GLOW).moved((c.x, 0, w), tilt=90) for c, w in zip(made, walls, strict=True)]
    found = seen(made, lamps, eye, integrator, backend, ambient=0.0)
    expected = [column.kept(eye, wall) for column, wall in zip(made, walls, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=3e-4, atol=1e-6)
    mirrors = [floor(1.2, MIRROR).moved((c.x, 0, w), tilt=90) for c, w in zip(made, walls, strict=True)]
    above = [floor(3.0, GLOW).moved((c.x, 0, 9.5), tilt=-90) for c in made]
    found = seen(made, [*mirrors, *above], eye, integrator, backend, ambient=0.0)
    expected = [c.kept(eye, wall) * c.kept(wall, 9.5) for c, wall in zip(made, walls, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=5e-4, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("backend", [BACKENDS[0], *EVERY])
@pytest.mark.parametrize("name", INTEGRATORS)
def test_light_along_a_column_is_a_product(name, backend):
    check(1, 16 if backend == "numpy" else 40, name, backend)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 6))
@pytest.mark.parametrize("name", INTEGRATORS)
def test_light_along_many_columns_is_a_product(name, seed):
    check(seed, 40, name, "numpy")
