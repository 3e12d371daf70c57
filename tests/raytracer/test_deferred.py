"""Deferred shading: hits of a layered depth cube have the colour and the normal of their sample."""

from dataclasses import replace

import numpy as np
import pytest
from scene_pictures import same

import shpy as sh
from raytracer import Camera, LayeredCube, Material, PointLight, Renderer, Scene, SceneError, Surface, Texture, render
from raytracer.kernels import deferred
from raytracer.meshes.shapes import box, floor, sphere

SIZE = (28, 21)
BACKENDS = ["numpy", "opencl", "glsl"]
every = pytest.mark.parametrize("backend", BACKENDS)
MIRROR = Material((0.8, 0.8, 0.9), reflectivity=0.8)
RED = Material((0.9, 0.3, 0.2), specular=0.5)
PICTURE = Texture(np.random.default_rng(0).random((4, 4, 3)))


def striped(hit):
    return Surface(color=sh.cond(sh.fract(2 * hit.position.x) < 0.5, sh.Color3f(0.9, 0.5, 0.1), sh.Color3f(0.1)))


def toon(surface, light):
    return sh.cond(sh.dot(surface.normal, light) > 0.5, 1.0, 0.3) * surface.color


def scene(*, smooth=True, ball=RED, ground=PICTURE, placed=None):
    """Return a ball and boxes before a mirror, over a floor."""
    made = sphere(0.8, ball, rings=12, segments=16)
    meshes = [
        (made if smooth else replace(made, normals=None)).moved((-0.6, 0, 0)),
        box((0.6, 1.2, 0.6), Material((0.2, 0.7, 0.3))).moved((0.9, -0.2, 0.3)),
        box((5, 4, 0.1), MIRROR).moved((0, 1, -1.6)),
        floor(5, Material(ground)).moved((0, -0.8, 0)),
    ]
    if placed is not None:
        meshes[0] = meshes[0].transformed(placed)
    return Scene(meshes, [PointLight((3, 6, 5), (0.8, 0.8, 0.7))], Camera((1, 1.5, 6), (0, 0, -1), fov=45))


def difference(one, other):
    """Return the root of the mean squared difference of two pictures, in steps of 8 bits."""
    return 255 * float(np.sqrt(np.mean((one.pixels - other.pixels) ** 2)))


@pytest.mark.slow
@pytest.mark.parametrize("hit", ["sample", "plane", "triangle"])
@pytest.mark.parametrize(
    "options", [{"bounces": 2}, {"integrator": "path", "samples": 2, "bounces": 3}], ids=["whitted", "path"]
)
def test_every_backend_shades_the_same(hit, options):
    made = scene()
    pictures = []
    for backend in BACKENDS:
        cube = LayeredCube.of(made, 32, backend=backend, hit=hit, shading="deferred")
        pictures.append(render(made, SIZE, backend=backend, secondary=cube, **options))
    for picture in pictures[1:]:
        same(picture, pictures[0])


@pytest.mark.sampled(3)
@every
def test_weights_are_those_of_texels_centres(backend):
    cube = LayeredCube.of(scene(), 16, backend=backend, shading="deferred")
    wanted = LayeredCube.of(scene(), 16, backend="numpy", shading="deferred")
    assert cube.weights.tobytes() == wanted.weights.tobytes()
    b, c = cube.weights.T.astype(np.float64)
    assert min(b.min(), c.min(), (1 - b - c).min()) > -1e-6
    corners = cube.triangles[:, :3].reshape(-1, 3, 3)[cube.images.triangles]
    places = np.einsum("nk,nkx->nx", np.stack([1 - b - c, b, c], axis=1), corners)
    texel = np.repeat(np.arange(len(cube.offsets) - 1), np.diff(cube.offsets))
    axis = texel // 16**2
    along = places[np.arange(len(places)), axis]
    np.testing.assert_allclose(along, cube.images.depths, atol=1e-4 * np.ptp(corners))


@pytest.mark.slow
@every
@pytest.mark.parametrize("hit", ["plane", "triangle"])
def test_flat_surfaces_of_one_colour_differ_by_rounding_alone(backend, hit):
    made = scene(smooth=False, ground=(0.5, 0.5, 0.6))
    exact, found = (
        render(
            made,
            SIZE,
            backend=backend,
            bounces=2,
            secondary=LayeredCube.of(made, 64, backend="numpy", hit=hit, shading=s),
        )
        for s in ("exact", "deferred")
    )
    assert 0 < np.abs(found.pixels - exact.pixels).max() < 3e-3


@pytest.mark.slow
@pytest.mark.parametrize("sizes", [(16, 32, 128), pytest.param((16, 64, 256), marks=pytest.mark.slow)])
@pytest.mark.parametrize("hit", [pytest.param("plane", marks=pytest.mark.slow), "triangle"])
def test_pictures_come_nearer_to_exact_shading_with_the_resolution(hit, sizes):
    """The floor is two triangles with a texture: each texel has its own colour, by the exact test as well."""
    made, errors = scene(), []
    for n in sizes:
        cubes = (LayeredCube.of(made, n, backend="numpy", hit=hit, shading=s) for s in ("exact", "deferred"))
        errors.append(difference(*(render(made, SIZE, backend="numpy", bounces=2, secondary=c) for c in cubes)))
    assert 1 > errors[0] > errors[1] > 2 * errors[2]
    exact, named = (render(made, SIZE, backend="numpy", bounces=2, accel=f"ldc:16:{hit}{s}") for s in ("", ":deferred"))
    assert difference(exact, named) == errors[0]


@pytest.mark.parametrize("backend", ["numpy", pytest.param("opencl", marks=pytest.mark.slow)])
def test_programs_that_make_colours_and_shades_are_kept(backend):
    made = scene(ball=Material(surface=striped, shade=toon), ground=(0.5, 0.5, 0.6))
    exact, found = (
        render(made, SIZE, backend=backend, bounces=2, secondary=LayeredCube.of(made, 128, backend="numpy", shading=s))
        for s in ("exact", "deferred")
    )
    assert difference(exact, found) < 4
    plain = scene(ball=Material((0.5, 0.5, 0.5)), ground=(0.5, 0.5, 0.6))
    assert difference(exact, render(plain, SIZE, backend=backend, bounces=2)) > 10


@pytest.mark.slow
def test_samples_follow_objects_that_move_and_colours_that_change():
    turn = np.eye(4)
    turn[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    turn[:3, 3] = 0.2, 0.1, 0.5
    renderer = Renderer(scene(), accel="ldc:128:triangle:deferred", backend="numpy", bounces=2)
    before = renderer.render(SIZE)
    renderer.move(0, np.eye(4))
    renderer.render(SIZE)
    renderer.move(0, turn)
    exact = render(scene(placed=turn), SIZE, backend="numpy", bounces=2)
    assert difference(renderer.render(SIZE), exact) < 2 < difference(before, exact)
    repainted = scene(ball=Material((0.1, 0.2, 0.9), specular=0.5))
    renderer = Renderer(scene(), accel="ldc:128:triangle:deferred", backend="numpy", bounces=2)
    renderer.show(repainted)
    assert renderer.builds == 1
    same(renderer.render(SIZE), render(repainted, SIZE, accel="ldc:128:triangle:deferred", backend="numpy", bounces=2))


@pytest.mark.slow
def test_samples_follow_the_data_of_their_programs():
    tint = sh.Param(sh.Color3f, (0.9, 0.3, 0.2), name="tint")
    gain = sh.Table([0.5], sh.Attrib1f)

    def tinted(hit):
        return Surface(color=tint * gain[0])

    def made():
        cube = {"accel": "ldc:64:triangle:deferred", "backend": "numpy", "bounces": 1}
        return Renderer(scene(ball=Material(surface=tinted)), **cube)

    renderer = made()
    pictures = [renderer.render(SIZE)]
    for change in (lambda: setattr(tint, "value", (0.1, 0.3, 0.9)), lambda: gain.update([1.0])):
        change()
        pictures.append(renderer.render(SIZE))
        same(pictures[-1], made().render(SIZE))
        assert not np.array_equal(pictures[-1].pixels, pictures[-2].pixels)
    assert renderer.builds == 1


@pytest.mark.slow
def test_only_samples_of_objects_that_move_are_shaded_anew(monkeypatch):
    made = scene(ball=Material(surface=striped))
    renderer = Renderer(made, accel="ldc:64:triangle:deferred", backend="numpy", bounces=2)
    lifted = np.eye(4)
    for number in (0, 1):
        renderer.move(number, lifted)
    renderer.render(SIZE)
    sampled, shaded = renderer._tracer.surfaces.sampled, []
    kernel = sampled._kernel
    monkeypatch.setattr(sampled, "_kernel", lambda *given: shaded.append(len(given[0])) or kernel(*given))
    _, ball, cube = (each.samples for each in renderer.layout.secondary.cubes)
    before = renderer.render(SIZE)
    for moved, wanted in (((0,), [ball]), ((1,), [cube]), ((0, 1), [ball, cube])):
        shaded.clear()
        lifted[1, 3] += 0.1
        for number in moved:
            renderer.move(number, lifted)
        found = renderer.render(SIZE)
        assert shaded == wanted
        assert not np.array_equal(found.pixels, before.pixels)
        sampled.renew()
        same(renderer.render(SIZE), found)
        before = found


def test_normals_and_colours_are_packed_finely():
    @sh.program
    def there_and_back(n: sh.Normal3f, c: sh.Color3f) -> tuple[sh.Normal3f, sh.Color3f]:
        normal = deferred.unpacked_normal(deferred.packed_normal(n))
        return normal, deferred.unpacked_color(deferred.packed_color(c))

    draw = np.random.default_rng(2)
    normals = draw.normal(size=(5000, 3))
    normals = np.concatenate([normals, np.eye(3), -np.eye(3), [[1, 1, 0], [-1, 0, -1], [0, -1, 1]]])
    normals = np.float32(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    colors = np.float32(draw.random((len(normals), 3)))
    found, kept = there_and_back.compile("numpy")(normals, colors)
    assert np.abs(found - normals).max() < np.sqrt(3) / 32767  # half a step along both axes of the octahedron
    axes = slice(5000, 5006)
    assert np.array_equal(found[axes], normals[axes])
    assert np.abs(kept - colors).max() < 0.5 / 1023 + 1e-6
    assert there_and_back.compile("numpy")(normals[:1], np.float32([[1.5, -1, 1]]))[1].tolist() == [[1, 0, 1]]


def glossy(hit):
    return Surface(color=(0.5, 0.5, 0.5), specular=hit.uv.x)


def facing(hit):
    return Surface(color=sh.Color3f(sh.dot(hit.view, hit.normal)))


@pytest.mark.parametrize(
    ("material", "words"),
    [(Material(surface=glossy), "decides specular"), (Material(surface=facing), "reads view")],
)
def test_what_samples_cannot_keep_is_an_error(material, words):
    with pytest.raises(SceneError, match=f'{words}: make the cube with shading="exact"'):
        render(scene(ball=material), (4, 3), accel="ldc:16:plane:deferred", backend="numpy")


def test_shading_is_one_of_two():
    with pytest.raises(SceneError, match="shading is one of 'exact', 'deferred', not 'phong'"):
        LayeredCube.of(box(), 8, backend="numpy", shading="phong")


def test_a_cube_without_samples_shades_nothing():
    thin = Scene([sphere(1e-3, MIRROR, rings=2, segments=3).moved((0, 0, -9))], [PointLight((0, 9, 0))])
    render(thin, (4, 3), accel="ldc:1:plane:deferred", backend="numpy")
