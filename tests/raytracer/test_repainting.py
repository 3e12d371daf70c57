"""Scenes that differ in numbers of materials: nothing is compiled or built, and pictures are those of new Renderers."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from scene_pictures import SIZE, same

import shpy as sh
from raytracer import Camera, DirectionalLight, Material, Mesh, PointLight, Renderer, Scene, Surface
from raytracer.appearance.textures import Texture
from raytracer.errors import SceneError
from raytracer.meshes.shapes import box, floor, icosahedron, sphere
from shpy.run import kernel

BACKENDS = ["numpy", "opencl", "glsl"]
WAYS = {
    "whitted": {"bounces": 2},
    "path": {"integrator": "path", "samples": 1},
    "staged": {"tracer": "staged", "bounces": 1, "grid": 5},
}


def named(name, mesh, **numbers):
    return dataclasses.replace(mesh, name=name, material=Material(**numbers))


def scene(glass=True, lamp=(2.0, 1.5, 1.0), **changes):
    cube = box((1, 1, 1))
    coloured = Mesh(cube.vertices, cube.faces, colors=0.5 + 0.5 * np.eye(3)[np.arange(len(cube.vertices)) % 3])
    clear = {"transmission": 0.8, "ior": 1.4, "absorption": (0.1, 0.2, 0.3)} if glass else {}
    meshes = [
        named("ball", sphere(1.0, rings=6, segments=10).moved((0, 1, 0)), color=(0.7, 0.7, 0.8), reflectivity=0.4),
        named("box", coloured.moved((1.4, 0.5, 0.8), turn=30), color=(0.9, 0.8, 0.7)),
        named("stone", icosahedron(0.6).moved((-1.3, 0.5, 0.9)), color=(0.2, 0.6, 0.3), **clear),
        named("lamp", icosahedron(0.3).moved((0.5, 2.4, 0.4)), color=(0.2, 0.2, 0.2), emission=lamp),
        named("ground", floor(12), color=(0.5, 0.5, 0.5), specular=0.0, reflectivity=0.2),
    ]
    lights = [PointLight((3, 5, 4), (0.8, 0.7, 0.6)), DirectionalLight((1, -2, -1), (0.3, 0.3, 0.5))]
    given = {"meshes": meshes, "lights": lights, "camera": Camera((1, 2.5, 6), (0, 0.7, 0), fov=45)}
    return Scene(**(given | changes))


def with_numbers(made, name, **numbers):
    """Return the scene with other parameters in one mesh's material."""
    material = made.meshes[made.names.index(name)].material
    return made.with_material(name, dataclasses.replace(material, **numbers))


def steps(made):
    """Yield scenes, each with other numbers than the one before."""
    made = with_numbers(made, "ball", color=(0.9, 0.1, 0.3), reflectivity=0.7, shininess=9)
    made = with_numbers(made, "box", color=(0.2, 0.9, 0.6), diffuse=0.5, specular=0.8)
    made = with_numbers(made, "lamp", emission=(0.5, 3.0, 0.7))
    yield made
    if made.meshes[2].material.transmission:
        made = with_numbers(made, "stone", ior=1.7, absorption=(0.9, 0.0, 0.4), transmission=1.0)
    moved = [PointLight((-3, 4, 4), (0.7, 0.8, 0.9)), *made.lights[1:]]
    yield dataclasses.replace(made, lights=moved, ambient=0.3, background=(0.1, 0.2, 0.1))


@cache
def expected(way):
    """Return the pictures of `steps` by new Renderers, which have the same bits on every backend."""
    made = scene(glass=way != "staged")
    return [Renderer(other, backend="numpy", **WAYS[way]).render(SIZE) for other in steps(made)]


def refused(*_, **__):
    raise AssertionError("something was compiled or built")


@pytest.mark.sampled(12)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("way", WAYS)
def test_other_numbers_of_materials_are_shown_and_nothing_is_compiled_or_built(way, backend, monkeypatch):
    options = WAYS[way] | {"backend": backend}
    made = scene(glass=way != "staged")
    pictures = expected(way)  # first, as it compiles kernels for numpy
    renderer = Renderer(made, **options)
    before, compiled = renderer.render(SIZE), set(kernel._executables)
    for other, wanted in zip(steps(made), pictures, strict=True):
        with monkeypatch.context() as patch:
            patch.setattr(Renderer, "_prepare", refused)
            patch.setattr(sh.Program, "compile", refused)
            renderer.show(other)
        found = renderer.render(SIZE)
        assert set(kernel._executables) == compiled
        assert not np.array_equal(found.pixels, before.pixels)
        same(found, wanted)
        before = found
    assert renderer.builds == 1


def plain(**numbers):
    """Return a scene of one material with these numbers and one that stays."""
    meshes = [
        named("box", box((1, 1, 1)), **numbers),
        named("ground", floor(4).moved((0, -0.5, 0)), color=(0.5, 0.6, 0.7), specular=0.0),
    ]
    return Scene(meshes, [PointLight((3, 5, 4))], Camera((1, 2, 4), (0, 0, 0)))


OTHER_CODE = {
    "mirror": {"reflectivity": 0.3},
    "glass": {"transmission": 1.0},
    "lamp": {"emission": (1.0, 0.5, 0.2)},
    "no highlight": {"specular": 0.0},
    "black": {"color": (0.5, 0.0, 0.5)},
    "dark": {"diffuse": 0.0, "specular": 0.0},
}


@pytest.mark.slow
def test_numbers_that_ask_for_other_code_build_anew():
    renderer = Renderer(plain(), backend="numpy")
    for builds, (what, numbers) in enumerate(OTHER_CODE.items(), 2):
        renderer.show(plain(**numbers))
        assert renderer.builds == builds, what
        made = plain(shininess=10.0, **numbers)
        renderer.show(made)
        assert renderer.builds == builds, what
        same(renderer.render(SIZE), Renderer(made, backend="numpy").render(SIZE))
    renderer.show(plain())
    assert renderer.builds == builds + 1, "and without the last one"


@pytest.mark.sampled(2)
@pytest.mark.parametrize("way", ["whitted", "path"])
def test_black_at_the_vertices_of_an_object_that_moves_builds_anew(way):
    cube = box((1, 1, 1))
    white = np.ones((len(cube.vertices), 3))

    def coloured(colors, height):
        mesh = Mesh(cube.vertices, cube.faces, colors=colors).moved((0, height, 0))
        return dataclasses.replace(plain(), meshes=[named("box", mesh, shininess=400.0), *plain().meshes[1:]])

    renderer = Renderer(coloured(white, 0), backend="numpy", **WAYS[way])
    for colors, height, builds in [(white, 0.1, 2), (white, 0.2, 2), (white * (1, 0, 1), 0.3, 3)]:
        made = coloured(colors, height)
        renderer.show(made)
        same(renderer.render(SIZE), Renderer(made, backend="numpy", **WAYS[way]).render(SIZE))
        assert renderer.builds == builds


@pytest.mark.slow
def test_a_lamp_more_is_another_number_of_lights():
    renderer = Renderer(plain(emission=(1.0, 1.0, 1.0)), backend="numpy", **WAYS["path"])
    other = with_numbers(plain(emission=(1.0, 2.0, 1.0)), "ground", emission=(0.1, 0.0, 0.0))
    renderer.show(other)
    assert renderer.builds == 2
    same(renderer.render(SIZE), Renderer(other, backend="numpy", **WAYS["path"]).render(SIZE))


@pytest.mark.slow
def test_meshes_that_come_to_share_a_material_or_no_longer_do_are_built_anew():
    made = scene()
    shared = made.with_material("stone", made.meshes[0].material)
    renderer = Renderer(made, backend="numpy")
    for other, builds in [(shared, 2), (with_numbers(made, "stone", ior=1.6), 3)]:
        renderer.show(other)
        assert renderer.builds == builds
        same(renderer.render(SIZE), Renderer(other, backend="numpy").render(SIZE))


def reddish(hit):
    return Surface(color=sh.Color3f(hit.position.x, 0.2, 0.2))


def greenish(hit):
    return Surface(color=sh.Color3f(0.2, hit.position.x, 0.2))


def test_other_textures_and_programs_are_built_anew_and_their_numbers_are_not():
    picture, other = (Texture(np.full((2, 2, 3), shade)) for shade in (0.3, 0.6))
    renderer = Renderer(plain(diffuse=picture, surface=reddish), backend="numpy")
    for numbers, builds in [
        ({"diffuse": picture, "surface": reddish, "reflectivity": 0.5, "specular": 0.4}, 2),
        ({"diffuse": picture, "surface": reddish, "reflectivity": 0.2, "specular": 0.1}, 2),
        ({"diffuse": other, "surface": reddish, "reflectivity": 0.2, "specular": 0.1}, 3),
        ({"diffuse": other, "surface": greenish, "reflectivity": 0.2, "specular": 0.1}, 4),
    ]:
        made = plain(**numbers)
        renderer.show(made)
        assert renderer.builds == builds
        same(renderer.render(SIZE), Renderer(made, backend="numpy").render(SIZE))


@pytest.mark.slow
def test_objects_that_move_keep_the_materials_that_were_shown():
    made = scene()
    renderer = Renderer(made, backend="numpy")
    lifted = np.eye(4)
    lifted[1, 3] = 0.3
    renderer.move("box", lifted)
    renderer.render((4, 4))
    for k, other in enumerate(steps(made)):
        renderer.show(other)
        lifted[0, 3] = 0.1 * k
        renderer.move("box", lifted)
        there = [mesh.transformed(lifted) if mesh.name == "box" else mesh for mesh in other.meshes]
        same(renderer.render(SIZE), Renderer(dataclasses.replace(other, meshes=there), backend="numpy").render(SIZE))
    assert renderer.builds == 2
    assert renderer.scene.meshes[1].material.color == (0.2, 0.9, 0.6)


def test_only_the_colours_of_meshes_that_have_another_one_are_sent(monkeypatch):
    made = scene()
    renderer = Renderer(made, backend="numpy")
    renderer.render((4, 4))
    sent = []
    update = sh.Table.update

    def counted(table, array, *, start=None):
        sent.append((table.name, len(array), start))
        update(table, array, start=start)

    monkeypatch.setattr(sh.Table, "update", counted)
    renderer.show(with_numbers(made, "box", color=(0.2, 0.3, 0.4)))
    ball, cube = made.meshes[:2]
    assert [part for part in sent if part[0] == "colors"] == [("colors", 3 * len(cube), 3 * len(ball))]
    assert {name for name, *_ in sent} == {"colors", "materials", "glass", "emissions", "lights"}


def test_colours_beyond_the_range_of_numbers_leave_the_scene_before(recwarn):
    made = scene()
    renderer = Renderer(made, backend="numpy")
    before = renderer.render(SIZE)
    with pytest.raises(SceneError, match="is 1e\\+39, out of the range of binary32"):
        renderer.show(with_numbers(made, "box", color=(1e39, 0.5, 0.5)))
    same(renderer.render(SIZE), before)
    with pytest.raises(SceneError, match="out of the range of binary32: choose smaller numbers"):
        Renderer(with_numbers(made, "box", color=(1e39, 0.5, 0.5)), backend="numpy")
    assert not recwarn
