"""The values of a scene are not in its kernel: scenes alike in their features share one, and it is compiled once."""

import dataclasses
import re

import numpy as np
import pytest

import shpy as sh
from raytracer import Camera, DirectionalLight, EnvironmentLight, Intersector, Material, PointLight, Renderer, Scene
from raytracer.kernels.eye_rays import EyeRays
from raytracer.kernels.glass import GlassTracer
from raytracer.kernels.path import PathTracer
from raytracer.kernels.picture import eye_rays
from raytracer.kernels.tracer import Tracer
from raytracer.meshes.shapes import box, floor, icosahedron, sphere, torus
from raytracer.scene.layout import Layout
from shpy.run import kernel
from shpy.run.kernel import forget_data

BACKENDS = ["numpy", "opencl", "glsl"]
SLOW = [pytest.param(backend, marks=pytest.mark.slow) for backend in BACKENDS[1:]]
"""To compile there takes seconds."""
SIZE = (24, 18)


def one(**changes):
    meshes = [
        sphere(1.0, Material((0.7, 0.7, 0.8), reflectivity=0.4), rings=6, segments=10).moved((0, 1, 0)),
        floor(12, Material((0.5, 0.5, 0.5), specular=0.0)),
    ]
    lights = [PointLight((3, 5, 4), (0.8, 0.7, 0.6)), DirectionalLight((1, -2, -1), (0.3, 0.3, 0.5))]
    given = {"meshes": meshes, "lights": lights, "camera": Camera((1, 2.5, 6), (0, 0.7, 0), fov=45)}
    return Scene(**(given | changes))


def other(**changes):
    """A scene of the same features and other values, each of them."""
    meshes = [
        box((1, 2, 1), Material((0.2, 0.9, 0.3), diffuse=0.5, shininess=9)).moved((-2, 0.9, 0.5), turn=20),
        torus(0.8, 0.3, Material((0.9, 0.4, 0.1), reflectivity=0.7), segments=40, sides=30).moved((0.5, 0.6, 0)),
        icosahedron(0.5, Material((0.3, 0.3, 0.9), specular=0.9)).moved((0, 2, 0)),
        floor(30, Material((0.4, 0.6, 0.5), specular=0.1)),
    ]
    lights = [
        DirectionalLight((-1, -1, 0.5), (0.2, 0.6, 0.2)),
        PointLight((-3, 6, 1), (0.5, 0.3, 0.3)),
        PointLight((0, 3, 9), (0.1, 0.2, 0.4)),
    ]
    camera = Camera((-3, 3.5, 5), (0, 0.4, 0.1), fov=60)
    given = {"meshes": meshes, "lights": lights, "camera": camera, "background": (0.9, 0.2, 0.1), "ambient": 0.3}
    return Scene(**(given | changes))


def glowing(scene):
    """The scene with two lamps, or one more."""
    lamp = box((0.5, 0.1, 0.5), Material((0.5, 0.5, 0.5), emission=(4, 3, 2)))
    return Scene([*scene.meshes, lamp.moved((0, 4, 0))], scene.lights, scene.camera, background=scene.background)


def text(scene, bounces=2, accel="bvh", integrator="whitted"):
    """Return the IR from which a scene's kernel is compiled, without the lines of Python."""
    layout = Layout.of(scene, accel)
    if integrator == "path":
        program = PathTracer(layout, scene, bounces, "numpy").program(EyeRays())
    else:
        tracer = Tracer(layout, scene.background, scene.ambient, bounces, "numpy")
        if tracer.surfaces.clear:
            tracer = GlassTracer(layout, scene.background, scene.ambient, bounces, "numpy")
        program = eye_rays(tracer, EyeRays())
    return re.sub(r"^file .*\n| @\d+:\d+", "", str(forget_data(program.ir)), flags=re.MULTILINE)


OPTIONS = {
    "bvh": {},
    "grid": {"accel": "grid"},
    "path": {"integrator": "path"},
}
PAIRS = {name: (one, other, options) for name, options in OPTIONS.items()} | {
    "one light": (
        lambda: one(lights=[PointLight((3, 5, 4))]),
        lambda: other(lights=[PointLight((-1, 7, 2), (0.2, 0.9, 0.4))]),
        {},
    ),
    "one material": (
        lambda: one(meshes=[sphere(), sphere().moved((2, 0, 0))]),
        lambda: other(meshes=[mesh.with_material(Material((0.1, 0.2, 0.4), 0.3, 0.9, 7)) for mesh in other().meshes]),
        {},
    ),
    "far away": (
        lambda: one(meshes=[mesh.moved((1e4, 0, 0)) for mesh in one().meshes]),
        lambda: other(meshes=[mesh.moved((0, 0, -1e6)) for mesh in other().meshes]),
        {},
    ),
    "falloff": (
        lambda: one(lights=[*one().lights, PointLight((0, 3, 3), falloff="square")]),
        lambda: other(lights=[*other().lights, PointLight((0, 3, 2), (9, 9, 2), "square")]),
        {},
    ),
    "glass": (
        lambda: one(meshes=[*one().meshes, sphere(0.4, Material(transmission=1.0)).moved((0, 1, 3))]),
        lambda: other(meshes=[*other().meshes, box((1, 1, 1), Material(transmission=0.4, ior=1.2)).moved((0, 1, 2))]),
        {},
    ),
    "area lights": (lambda: glowing(one()), lambda: glowing(glowing(other())), {"integrator": "path"}),
    "environment": (
        lambda: one(lights=[*one().lights, EnvironmentLight((1, 1, 0.5))]),
        lambda: other(lights=[*other().lights, EnvironmentLight((0.2, 0.4, 0.9))]),
        {"integrator": "path"},
    ),
}


IDLE = {
    "highlights": Material(specular=0.0, shininess=7.0),
    "glass": Material(specular=0.0, ior=2.0, absorption=(1, 2, 3)),
    "texture": Material(specular=0.0),
}
"""Materials with numbers of a feature whose coefficient is 0; the last one's mesh has uv coordinates."""


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", IDLE)
def test_a_feature_that_has_nothing_to_do_costs_nothing(name, monkeypatch):
    monkeypatch.setattr(sh.Program, "compile", lambda *_, **__: None)  # nothing is compiled
    texts = []
    for material, uv in ((Material(specular=0.0), False), (IDLE[name], name == "texture")):
        mesh = dataclasses.replace(box(material=material), uv=np.ones((12, 3, 2)) if uv else None)
        texts.append(str(Renderer(one(meshes=[mesh, floor(9)]), backend="numpy").program.ir))
    assert texts[0] == texts[1]


@pytest.mark.sampled(4)
@pytest.mark.parametrize("pair", PAIRS)
def test_scenes_alike_in_their_features_have_one_text(pair):
    first, second, options = PAIRS[pair]
    assert text(first(), **options) == text(second(), bounces=5, **options)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "changes",
    [
        {"lights": one().lights[:1]},
        {"lights": one().lights[1:]},
        {"lights": ()},
        {"meshes": [mesh.with_material(Material()) for mesh in one().meshes]},
        {"meshes": [sphere(), floor(3)]},
        {"meshes": one().meshes[:1]},
    ],
    ids=["a point", "a direction", "dark", "nothing mirrors", "no reflections", "one mesh"],
)
def test_a_feature_less_is_another_text(changes):
    assert text(one()) != text(one(**changes))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_second_scene_compiles_nothing_and_shows_itself(backend, monkeypatch):
    share(backend, {}, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", ["grid", "path"])
def test_a_second_scene_compiles_nothing_in_other_ways(name, backend, monkeypatch):
    share(backend, OPTIONS[name], monkeypatch)


def share(backend, options, monkeypatch):
    """Two scenes have one kernel, and each has its own picture."""
    samples = {"samples": 2} if options.get("integrator") == "path" else {}
    wanted = [alone(scene, options, samples) for scene in (one(), other())]
    monkeypatch.setattr(kernel, "_executables", {})
    renderers = [Renderer(one(), backend=backend, bounces=2, **options)]
    compiled = len(kernel._executables)
    renderers.append(Renderer(other(), backend=backend, bounces=2, **options))
    assert len(kernel._executables) == compiled == 1
    for _ in range(2):
        for renderer, expected in zip(renderers, wanted, strict=True):
            for layer, same in zip(renderer.render(SIZE, **samples).layers.values(), expected, strict=True):
                assert np.array_equal(layer, same)


def alone(scene, options, samples):
    """The layers of a picture by a kernel on numpy that has the scene's values as constants."""
    renderer = Renderer(scene, backend="numpy", bounces=2, **options)
    fixed = {name: param.value for name, param in renderer.params.items() if name not in BETWEEN}
    assert {"background", "bounces"} <= set(fixed)
    program = renderer.program.specialize(**fixed)
    renderer.kernel, renderer.params = program.compile("numpy", loop_limit=None), program.params
    return list(renderer.render(SIZE, **samples).layers.values())


BETWEEN = {
    "eye", "corner", "across", "down", "first_row", "top_row", "seed", "first_sample", "past_sample",
}  # fmt: skip
"""Params that a renderer sets between runs."""


@pytest.mark.parametrize("backend", ["numpy", *SLOW])
def test_a_second_staged_tracer_compiles_nothing(backend, monkeypatch):
    monkeypatch.setattr(kernel, "_executables", {})
    Renderer(one(), backend=backend, tracer="staged")
    compiled = set(kernel._executables)
    Renderer(other(), backend=backend, tracer="staged", bounces=1, grid=7)
    assert set(kernel._executables) == compiled


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_second_intersector_compiles_nothing(backend, monkeypatch):
    query(backend, "bvh", ["intersect"], monkeypatch)


@pytest.mark.slow
def test_a_layered_cube_of_a_deformed_mesh_compiles_nothing(monkeypatch):
    query("numpy", "ldc:64:triangle", ["intersect", "occluded"], monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("accel", ["bvh", "grid"])
def test_no_query_of_a_second_intersector_compiles_anything(backend, accel, monkeypatch):
    query(backend, accel, ["intersect", "occluded", "count", "all_hits", "closest_point"], monkeypatch)


def query(backend, accel, names, monkeypatch):
    """Two meshes have the same kernels, and each its own hits."""
    monkeypatch.setattr(kernel, "_executables", {})
    small, large = sphere(1.0, rings=8, segments=12), sphere(2.0, rings=20, segments=40)  # grids of several cells
    ask(Intersector(small, accel=accel, backend=backend), names)
    compiled = list(kernel._executables)
    found = ask(Intersector(large, accel=accel, backend=backend), names)
    assert list(kernel._executables) == compiled
    expected = ask(Intersector(large, accel="brute", backend="numpy"), names)
    for name, shown, wanted in zip(names, found, expected, strict=True):
        assert np.array_equal(shown, wanted), name


def ask(shoot, names):
    """The triangles that some rays meet, or whether they meet any, for each query."""
    rng = np.random.default_rng(4)
    eye, way = rng.normal(size=(200, 3)), rng.normal(size=(200, 3))
    ways = {
        "intersect": lambda: shoot.intersect(eye, way).triangle,
        "occluded": lambda: shoot.occluded(eye, way),
        "count": lambda: shoot.count(eye, way),
        "all_hits": lambda: shoot.all_hits(eye, way).triangle,
        "closest_point": lambda: shoot.closest_point(eye).triangles,
    }
    return [ways[name]() for name in names]


def test_params_hold_the_scenes_values():
    renderer = Renderer(other(), bounces=5)
    values = {name: np.asarray(param.value).tolist() for name, param in renderer.params.items()}
    assert values["bounces"] == 5
    assert values["lights_count"] == 3
    assert np.allclose(values["background"], (0.9, 0.2, 0.1))
    assert np.isclose(values["ambient"], 0.3)
    assert isinstance(renderer.params["nodes"], sh.Param)
