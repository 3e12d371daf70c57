"""Scenes that are rarely made: mirrors that shine, mirrored meshes, numbers at the ends of their range."""

import dataclasses

import numpy as np
import pytest

import shpy as sh
from raytracer import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Hit,
    Material,
    Path,
    PointLight,
    Scene,
    SceneError,
    Staged,
    Surface,
    Texture,
    render,
    shaders,
)
from raytracer.meshes.shapes import floor, sphere
from shpy import SH_DISCARD, SH_IF, SH_RETURN

AHEAD = Camera((0, 0, 3))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("kind", [{}, {"reflectivity": 0.5}, {"reflectivity": 1.0}, {"transmission": 0.5, "ior": 1.0}])
def test_every_surface_sends_out_all_of_its_emission(kind):
    lamp = floor(50, Material((0, 0, 0), diffuse=0, specular=0, emission=(1, 0.5, 0.25), **kind)).moved(tilt=90)
    scene = Scene(lamp, [], AHEAD, background=(0, 0, 0), ambient=0)
    integrators = [None, Path(samples=4)] + ([Staged()] if "ior" not in kind else [])
    for integrator in integrators:
        options = {} if integrator is None else {"integrator": integrator}
        assert render(scene, (8, 8), **options).pixels[4, 4].tolist() == [1, 0.5, 0.25]


def test_a_mirror_shows_the_emission_of_another_one():
    wall = floor(50, Material((0, 0, 0), diffuse=0, specular=0, reflectivity=0.5)).moved(tilt=90)
    behind = floor(50, Material((0, 0, 0), diffuse=0, specular=0, reflectivity=1.0, emission=(1, 1, 1)))
    scene = Scene([wall, behind.moved((0, 0, 6), tilt=-90)], [], AHEAD, background=(0, 0, 0), ambient=0)
    np.testing.assert_allclose(render(scene, (8, 8), bounces=1).pixels[4, 4], 0.5)


def test_a_negative_scale_mirrors_a_mesh_as_a_matrix_does():
    glass = sphere(1, Material((0, 0, 0), diffuse=0, specular=0, transmission=1, ior=1.5)).moved((0.2, 0, 0))
    moved, mirrored = glass.moved(scale=-1), glass.transformed(np.diag([-1.0, -1, -1, 1]))
    np.testing.assert_array_equal(moved.faces, mirrored.faces)
    np.testing.assert_allclose(moved.vertices, mirrored.vertices)
    np.testing.assert_allclose(moved.normals, mirrored.normals, atol=1e-12)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("length", [1e-200, 1e-310, 1e200])
def test_the_length_of_a_directional_light_does_not_matter(length):
    picture, unit = (
        render(Scene(floor(4), [DirectionalLight((0, -x, x))], Camera((0, 3, 3))), (8, 8)).pixels for x in (length, 1)
    )
    np.testing.assert_allclose(picture, unit, rtol=1e-6)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("shininess", [1e3, 1e6, 1e10])
def test_the_sharpest_highlight_is_no_brighter_than_its_height(shininess):
    surface = Material((0, 0, 0), diffuse=0, specular=0.5, shininess=shininess)
    found = []
    for x, y, z in np.random.default_rng(0).normal(size=(12, 3)) + (0, 3, 0):
        camera = Camera((x, y, z), projection="orthographic", span=0.1)
        scene = Scene(floor(4, surface), [DirectionalLight((x, -y, z))], camera, ambient=0)
        found.append(render(scene, (2, 2), backend="numpy").pixels)
    np.testing.assert_allclose(np.max(found), 0.5, rtol=1e-6)
    dim = render(scene, (2, 2), backend="numpy", integrator=Path(samples=2))
    assert np.isfinite(dim.pixels).all()


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "made",
    [
        lambda x: Scene(floor(4, Material(shininess=x)), [PointLight((0, 3, 0))]),
        lambda x: Scene(floor(4, Material((x, 0, 0))), [PointLight((0, 3, 0))]),
        lambda x: Scene(floor(4, Material(emission=(x, 0, 0)))),
        lambda x: Scene(floor(4, Material(absorption=(x, 0, 0), transmission=0.5))),
        lambda x: Scene(floor(4), [PointLight((0, 3, 0), (0, x, 0))]),
        lambda x: Scene(floor(4), background=(x, 0, 0)),
    ],
)
def test_numbers_beyond_the_range_of_a_pixel_are_told(made):
    for given in ({"precision": "f32"}, {"precision": "f64"}, {"integrator": "path"}):
        with pytest.raises(SceneError, match=r"is 1e\+39, out of the range of binary32: choose smaller numbers"):
            render(made(1e39), (8, 8), backend="numpy", **given)
    assert np.isfinite(render(made(2.0), (8, 8)).pixels).all()


def test_a_texture_that_is_filtered_otherwise_is_another_scene():
    pictures = np.random.default_rng(0).random((4, 4, 3))

    def scene(**options):
        return Scene(floor(4, Material(Texture(pictures, srgb=False, **options), specular=0)), [], Camera((0, 2, 3)))

    first = render(scene(filter="nearest"), (8, 6), integrator=Path(samples=2))
    for options in ({"filter": "linear"}, {"filter": "nearest", "wrap": "mirror"}):
        with pytest.raises(SceneError, match="was not path traced from this scene"):
            render(scene(**options), (8, 6), integrator=Path(samples=4), resume=first)


@sh.program
def two(u: sh.Attrib1f, v: sh.Attrib1f) -> sh.Color3f:
    return sh.Color3f(u, v, 0)


@pytest.mark.parametrize(
    ("sky", "words"), [(two, ", not u, v$"), (lambda u, v: u, "'v'"), (lambda: (1, 1, 1), "too many")]
)
def test_the_program_of_a_sky_takes_a_direction_alone(sky, words):
    with pytest.raises(SceneError, match=f": the program of an EnvironmentLight takes one input, a direction.*{words}"):
        render(Scene([floor(1)], [EnvironmentLight(sky)]), (4, 4), backend="numpy", integrator="path")


def cut(hit: Hit) -> Surface:
    SH_DISCARD(hit.uv.x > 0.5)
    return Surface()


def dark(surface: Surface, light: sh.Vector3f) -> sh.Color3f:
    with SH_IF(light.x > 0):
        SH_DISCARD()
    return surface.color


@pytest.mark.parametrize(("kind", "program"), [("surface", cut), ("shade", dark)])
def test_a_program_of_a_surface_that_discards_names_the_cutout(kind, program):
    """It would end the pixel, with other layers for each integrator."""
    scene = Scene([floor(1, Material(**{kind: program}))], [DirectionalLight((0, -1, 0))])
    with pytest.raises(SceneError, match=rf"{program.__name__} \(test_.*: SH_DISCARD would end .* cutout says where"):
        render(scene, (4, 4), backend="numpy")


def early(hit: Hit) -> Surface:
    with SH_IF(hit.uv.x > 0.5):
        SH_RETURN(Surface(color=(1, 0, 0)))
    return Surface(color=(0, 1, 0))


@sh.program
def early_program(uv: sh.TexCoord2f) -> sh.Color3f:
    with SH_IF(uv.x > 0.5):
        SH_RETURN(sh.Color3f(1, 0, 0))
    return sh.Color3f(0, 1, 0)


def late(hit: Hit) -> Surface:
    color = sh.Color3f(0, 1, 0)
    with SH_IF(hit.uv.x > 0.5):
        color[:] = (1, 0, 0)
    return Surface(color=color)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("surface", [early, sh.subroutine(early)])
def test_a_surface_that_returns_early_names_ways_that_work(surface):
    with pytest.raises(SceneError, match=r"early \(test_.*SH_RETURN: store .* color\[:\] = .* or make it an sh.Pro"):
        shown(surface)
    assert np.array_equal(shown(late), shown(early_program))


@dataclasses.dataclass
class Stripes:
    """It has no hash, as a dataclass that can be changed."""

    width: float

    def __call__(self, hit: Hit) -> Surface:
        return Surface(color=(self.width, 0, 0))


@dataclasses.dataclass
class Steps:
    count: float

    def __call__(self, surface: Surface, light: sh.Vector3f) -> sh.Color3f:
        return surface.color * self.count


def test_programs_may_be_objects_without_a_hash():
    assert np.array_equal(shown(Stripes(0.5)), shown(lambda hit: Surface(color=(0.5, 0, 0))))
    assert np.array_equal(shown(None, Steps(3.0)), shown(None, lambda surface, light: surface.color * 3.0))


def shown(surface, shade=None):
    scene = Scene(
        [floor(2, Material(surface=surface, shade=shade, specular=0))],
        [DirectionalLight((0, -1, 0))],
        Camera((0, 3, 1)),
    )
    return render(scene, (4, 4), backend="numpy").pixels


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: shaders.marble(size=0), "the size of marble"),
        (lambda: shaders.wood(size=np.inf), "the size of wood"),
        (lambda: shaders.spots(size=-1.0), "the size of spots"),
        (lambda: shaders.bumps(size=np.nan), "the size of bumps"),
        (lambda: shaders.toon(0), "the number of steps of toon"),
        (lambda: shaders.cook_torrance(0), "the roughness of cook_torrance"),
    ],
)
def test_numbers_that_ready_made_programs_divide_by_are_above_0(make, what):
    with pytest.raises(SceneError, match=f"{what} is a finite number above 0, not"):
        make()


def test_a_param_may_be_the_size_of_a_pattern():
    size = sh.Param(sh.Attrib1f, 0.5)
    assert np.array_equal(shown(shaders.marble(size=size)), shown(shaders.marble(size=0.5)))
