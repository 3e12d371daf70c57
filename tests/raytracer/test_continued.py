"""A picture is continued by what it was begun with alone: each public argument is changed once, and `resume` tells."""

import dataclasses
import functools
import hashlib
import inspect
import itertools
import subprocess
import sys
from pathlib import PurePath

import numpy as np
import pytest

import shpy as sh
from raytracer import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Hit,
    Instance,
    LayeredCube,
    Material,
    Mesh,
    MetallicRoughness,
    Path,
    PointLight,
    Renderer,
    Scene,
    SceneError,
    SpotLight,
    Surface,
    Texture,
    Unlit,
    render,
)
from raytracer.appearance.programs import GIVEN, OF_LAYERS, fields_of
from raytracer.integrators import origin
from raytracer.integrators.integrator import Options
from raytracer.meshes.shapes import box, floor, sphere

PIXELS = np.random.default_rng(1).random((4, 4, 3)).round(3)
OTHER = np.random.default_rng(2).random((4, 4, 3)).round(3)
SQUARE = {
    "vertices": [[-1, 0, 0], [1, 0, 0], [1, 2, 0], [-1, 2, 0]],
    "faces": [[0, 1, 2], [0, 2, 3]],
    "normals": [[0, 0, 1]] * 4,
    "colors": [[1, 1, 1]] * 3 + [[1, 0.5, 0]],
    "name": "square",
    "uv": [[0, 0], [1, 0], [1, 1], [0, 1]],
}
PLACE, ASIDE, SWAP = np.eye(4), np.diag([0.5, 1, 1, 1.0]), ((0, 1, 0), (1, 0, 0))
GAIN = sh.Param(sh.Attrib1f, 0.5, name="gain")


def base():
    """Return the arguments of the pieces of a scene that has all of them; a change replaces one of an entry."""
    return {
        "Texture": {"source": PIXELS, "srgb": True, "filter": "linear", "wrap": "repeat", "alpha": False},
        "Material": {"diffuse": 0.7},
        "MetallicRoughness": {"roughness": 0.4},
        "Unlit": {"color": (0.1, 0.2, 0.3)},
        "Mesh": dict(SQUARE),
        "Instance": {"transform": PLACE, "name": "there"},
        "Camera": {"position": (0.2, 1.5, 5), "target": (0, 0.6, 0), "aperture": 0.1, "focus": 4.0},
        "PointLight": {"position": (2, 3, 2), "color": (1, 1, 1), "falloff": "none"},
        "DirectionalLight": {"direction": (1, -1, -1), "color": (0.2, 0.2, 0.2)},
        "SpotLight": {"position": (-2, 3, 2), "direction": (2, -3, -2), "inner": 10, "outer": 30},
        "EnvironmentLight": {"source": (0.1, 0.2, 0.3)},
        "Scene": {},
        "Path": {"samples": 1, "bounces": 2},
        "surface": lambda hit: Surface(color=sh.Color3f(hit.uv, 0)),
        "Renderer": {"backend": "numpy"},
        "cube": None,
    }


def made(pieces):
    """Return the scene and the integrator of these arguments, and the arguments of the Renderer."""
    texture = Texture(**pieces["Texture"])
    painted = Material(**{"color": texture, **pieces["Material"]})
    square = Mesh(**{"material": painted, **pieces["Mesh"]})
    instance = Instance(**{"mesh": square, **pieces["Instance"]})
    described = Mesh(**SQUARE, material=Material(surface=pieces["surface"])).moved((2, 0, -1))
    layered = Mesh(**SQUARE, material=MetallicRoughness(**(pieces["MetallicRoughness"] or {}))).moved((-2, 0, -1))
    shown = [Mesh(**SQUARE, material=Unlit(**look)).moved((-2, 0, -3)) for look in [pieces["Unlit"]] if look]
    glass = sphere(0.4, Material(transmission=0.9), rings=4, segments=5).moved((0, 0.5, 1))
    lights = [
        PointLight(**pieces["PointLight"]), DirectionalLight(**pieces["DirectionalLight"]),
        *(SpotLight(**spot) for spot in [pieces["SpotLight"]] if spot), EnvironmentLight(**pieces["EnvironmentLight"]),
    ]  # fmt: skip
    meshes = [floor(9), instance, described, *([layered] if pieces["MetallicRoughness"] else []), *shown, glass]
    scene = Scene(**{"meshes": meshes, "lights": lights, "camera": Camera(**pieces["Camera"]), **pieces["Scene"]})
    options = dict(pieces["Path"])
    if pieces["cube"] is not None:
        options["secondary"] = LayeredCube.of(
            scene, **{"resolution": 16, "block": 8, "backend": "numpy"} | pieces["cube"]
        )
    return scene, Path(**options), pieces["Renderer"]


def change(piece, name, value):
    def changed(pieces):
        pieces[piece] = {**(pieces[piece] or {}), name: value}

    return changed


def of_cube(**options):
    def changed(pieces):
        pieces["cube"] = options

    return changed


def surface(program):
    def changed(pieces):
        pieces["surface"] = program

    return changed


def calibrated(**options):
    given = {"K": np.diag([5.0, 5, 1]), "pose": np.eye(4), "size": (8, 6), **options}

    def changed(pieces):
        pieces["Scene"] = {"camera": Camera.from_intrinsics(**given)}

    return changed


def nothing(_):
    """Change nothing."""


def reader(name):
    """Return a surface that reads a field of its hit."""

    def program(hit):
        value = getattr(hit, name)
        numbers = (
            list(value) if getattr(value, "size", 1) > 1 else [sh.cond(value, 1.0, 0.0) if name == "outside" else value]
        )
        return Surface(diffuse=sh.Attrib1f(numbers[0]))

    return program


def giver(name):
    """Return a surface that decides a field."""
    colors = ("color", "base_color", "sheen_color", "normal", "emission")
    return lambda hit: Surface(**{name: (0.3, 0.2, 0.9) if name in colors else 0.3})


LAYERS = dict.fromkeys(("metallic", "roughness", "ior", "specular", "clearcoat", "clearcoat_roughness"), 0.3)
LAYERS |= {"transmission": 0.3, "alpha": 0.3, "sheen_roughness": 0.3, "anisotropy": 0.3, "anisotropy_rotation": 9}
LAYERS |= {"multiscatter": True, "thickness": 0.3, "attenuation_color": (0.3, 0.2, 1), "attenuation_distance": 0.3}
LAYERS |= dict.fromkeys(("base_color", "specular_color", "sheen_color", "emission"), (0.3, 0.2, 1))
MESH = {
    "vertices": [[-1, 0, 0], [1, 0, 0], [1, 2, 0], [-1, 2.5, 0]], "faces": [[0, 1, 3], [1, 2, 3]],
    "material": Material(), "normals": [[0, 1, 2]] * 4,
    "colors": [[1, 1, 0.5]] * 4, "uv": [[0, 0], [1, 0], [1, 1], [0, 0.5]],
}  # fmt: skip
POINT = {"position": (2, 3, 2.1), "color": (1, 1, 0.9), "falloff": "square", "range": 9.0}
SPOT = {"position": (-2, 3, 2.1), "direction": (2, -3, -2.1), "inner": 11, "outer": 31, "color": (1, 1, 0.9)}
SPOT |= {"falloff": "none", "range": 9.0}
UNLIT = {"color": (0.1, 0.2, 0.4), "alpha": 0.5, "cutout": Texture(PIXELS)}
PHONG = {"color": (0.5, 0.5, 0.5), "diffuse": 0.71, "specular": 0.1, "shininess": 41, "reflectivity": 0.1}
PHONG |= {"transmission": 0.1, "ior": 1.4, "absorption": (0, 1, 0), "emission": (0, 1, 0)}
CUBE = {"resolution": 24, "block": 4, "hit": "triangle", "tolerance": 0.5, "conservative": True}
CUBE |= {"shading": "deferred", "depths": "half"}
CAMERA = {"position": (0.2, 1.5, 5.001), "target": (0, 0.61, 0), "up": (0, 1, 0.5), "fov": 41, "aperture": 0.2}
CAMERA |= {"focus": 3.0, "aspect": 1.5}
PATH = {"bounces": 3, "precision": "f64", "math": "fast", "fuse": True, "seed": 1, "clamp": 0.05}
PICTURE = {"source": OTHER, "srgb": False, "filter": "nearest", "wrap": "mirror", "alpha": True, "transform": SWAP}
CALIBRATION = {"K": np.diag([5.0, 5.1, 1]), "pose": np.eye(4) + np.eye(4, k=3), "size": (9, 6), "aperture": 0.1}
CHANGES = {
    "Scene.meshes": change("Scene", "meshes", [floor(8)]),
    "Scene.lights": change("Scene", "lights", [PointLight((2, 3, 2))]),
    "Scene.camera": change("Scene", "camera", Camera((0, 1, 4))),
    "Scene.background": change("Scene", "background", (1, 0, 0)),
    "Scene.background, a picture": change("Scene", "background", Texture(PIXELS)),
    "Scene.background, another picture": change("Scene", "background", Texture(OTHER)),
    "Scene.background, a filter": change("Scene", "background", Texture(PIXELS, filter="nearest")),
    "Scene.background, a program": change("Scene", "background", lambda d: abs(sh.Color3f(*d))),
    "Scene.background, another program": change("Scene", "background", lambda d: abs(sh.Color3f(d.x))),
    **{f"Material.{name}": change("Material", name, value) for name, value in PHONG.items()},
    "Material.reflectivity, a colour": change("Material", "reflectivity", (0.1, 0.2, 0.1)),
    "Material.surface": change("Material", "surface", giver("color")),
    "Material.shade": change("Material", "shade", lambda surface, light: surface.color),
    "Material.cutout": change("Material", "cutout", Texture(PIXELS)),
    "Material.normal_map": change("Material", "normal_map", Texture(PIXELS, srgb=False)),
    **{f"MetallicRoughness.{name}": change("MetallicRoughness", name, value) for name, value in LAYERS.items()},
    "MetallicRoughness.normal": change("MetallicRoughness", "normal", Texture(PIXELS, srgb=False)),
    "MetallicRoughness.cutout": change("MetallicRoughness", "cutout", Texture(PIXELS)),
    "MetallicRoughness.surface": change("MetallicRoughness", "surface", giver("emission")),
    **{f"Mesh.{name}": change("Mesh", name, value) for name, value in MESH.items()},
    "Instance.mesh": change("Instance", "mesh", box((1, 1, 1))),
    "Instance.transform": change("Instance", "transform", ASIDE),
    **{f"Camera.{name}": change("Camera", name, value) for name, value in CAMERA.items()},
    "Camera.projection": change("Scene", "camera", Camera((0.2, 1.5, 5), (0, 0.6, 0), projection="panorama")),
    "Camera.span": change("Scene", "camera", Camera((0.2, 1.5, 5), (0, 0.6, 0), projection="orthographic", span=3)),
    "Camera.intrinsics": calibrated(),
    **{f"Camera.from_intrinsics.{name}": calibrated(**{name: value}) for name, value in CALIBRATION.items()},
    "Camera.from_intrinsics.focus": calibrated(aperture=0.1, focus=2.0),
    **{f"PointLight.{name}": change("PointLight", name, value) for name, value in POINT.items()},
    **{f"SpotLight.{name}": change("SpotLight", name, value) for name, value in SPOT.items()},
    **{f"Unlit.{name}": change("Unlit", name, value) for name, value in UNLIT.items()},
    "DirectionalLight.direction": change("DirectionalLight", "direction", (1, -1, -1.1)),
    "DirectionalLight.color": change("DirectionalLight", "color", (0.2, 0.2, 0.3)),
    "EnvironmentLight.source": change("EnvironmentLight", "source", (0.1, 0.2, 0.4)),
    "EnvironmentLight.rotation": change("EnvironmentLight", "rotation", 30),
    "EnvironmentLight.strength": change("EnvironmentLight", "strength", 2),
    "EnvironmentLight.source, a picture": change("EnvironmentLight", "source", PIXELS),
    "EnvironmentLight.source, another picture": change("EnvironmentLight", "source", OTHER),
    "EnvironmentLight.source, a filter": change("EnvironmentLight", "source", Texture(PIXELS, filter="nearest")),
    "EnvironmentLight.source, a program": change("EnvironmentLight", "source", lambda d: abs(sh.Color3f(*d))),
    "EnvironmentLight.source, another program": change("EnvironmentLight", "source", lambda d: abs(sh.Color3f(d.x))),
    **{f"Texture.{name}": change("Texture", name, value) for name, value in PICTURE.items()},
    **{f"Path.{name}": change("Path", name, value) for name, value in PATH.items()},
    **{f"Path.math, {mode}": change("Path", "math", mode) for mode in ("portable", "relaxed")},
    "Path.secondary": of_cube(),
    "LayeredCube.of.mesh_or_scene": of_cube(),
    **{f"LayeredCube.of.{name}": of_cube(**{"hit": "sample", name: value}) for name, value in CUBE.items()},
    **{f"Hit.{name}": surface(reader(name)) for name in fields_of(Hit)},
    **{f"Surface.{name}": surface(giver(name)) for name in GIVEN if name not in OF_LAYERS},
    **{f"Surface.{name}": change("MetallicRoughness", "surface", giver(name)) for name in OF_LAYERS},
    "Surface.color, a Param": surface(lambda hit: Surface(color=sh.Color3f(1, 1, 1) * GAIN)),
}
"""The changes that give another picture, by the argument."""

NO_BITS = {
    "Scene.ambient": change("Scene", "ambient", 0.5),
    "Scene.name": change("Scene", "name", "other"),
    "Mesh.name": change("Mesh", "name", "other"),
    "Instance.name": change("Instance", "name", "other"),
    "Path.samples": change("Path", "samples", 5),
    "Path.accel": change("Path", "accel", "grid"),
    "Path.accel, brute": change("Path", "accel", "brute"),
    "Path.grid": lambda pieces: pieces["Path"].update(accel="grid", grid=3),
    "Renderer.backend": change("Renderer", "backend", "opencl"),
    "Renderer.transparent": change("Renderer", "transparent", True),
    "another function of the same text": surface(lambda hit: Surface(color=sh.Color3f(hit.uv, 0))),
}
"""The changes that keep every bit."""

OUT_OF_PLACE = {
    "Renderer.scene": "Scene.meshes",
    "Renderer.integrator": "Path.seed",
    "Renderer.options": "Path.seed",
    "Renderer.primary": "test_primary.py: not for Path",
    "LayeredCube.of.backend": "Renderer.backend",
    "LayeredCube.of.builder": "Renderer.backend",
    "render.scene": "Scene.meshes",
    "render.size": "test_path.py",
    "render.integrator": "Path.seed",
    "render.backend": "Renderer.backend",
    "render.resume": "every case here",
    "render.max_error": "test_integrators.py: not for Path",
    "render.progress": "test_path.py",
    "render.cluster": "test_cluster.py",
    "render.tile_rows": "test_cluster.py",
    "render.partitions": "test_partitions.py",
    "render.primary": "test_primary.py: not for Path",
    "render.transparent": "test_transparent.py",
    "render.denoise": "test_denoising.py",
    "render.options": "Path.seed",
    **{
        f"Renderer.render.{name}": "render"
        for name in ("size", "camera", "samples", "progress", "resume", "primary", "transparent")
    },
}
"""Arguments whose cases are others or stand elsewhere."""


def arguments(function, name):
    skipped = ("self", "cls")
    return {f"{name}.{argument}" for argument in inspect.signature(function).parameters if argument not in skipped}


def test_every_public_argument_has_a_case():
    classes = (
        Scene, Material, MetallicRoughness, Unlit, Mesh, Instance, Camera, PointLight, SpotLight, DirectionalLight,
        EnvironmentLight, Texture, Path, Renderer,
    )  # fmt: skip
    wanted = set().union(*(arguments(each, each.__name__) for each in classes))
    wanted |= arguments(Camera.from_intrinsics, "Camera.from_intrinsics")
    wanted |= arguments(LayeredCube.of, "LayeredCube.of")
    wanted |= arguments(render, "render") | arguments(Renderer.render, "Renderer.render")
    wanted |= {f"Hit.{name}" for name in fields_of(Hit)} | {f"Surface.{name}" for name in GIVEN}
    cases = [name.split(",")[0] for name in (*CHANGES, *NO_BITS, *OUT_OF_PLACE) if "." in name]
    assert wanted == set(cases)
    assert set(Options.__annotations__) <= {name.split(".")[1] for name in wanted if name.startswith("Path.")} | {
        "tracer",  # for Whitted and Staged alone
        "threshold",
        "min_contribution",
        "at_once",
        "early_z",
    }


@functools.cache
def origin_of(changed):
    return uncompiled_origin(changed)


def uncompiled_origin(*changes):
    """Return the origin of the pictures of changed pieces; the Renderer compiles nothing."""
    pieces = base()
    for changed in changes:
        changed(pieces)
    scene, integrator, options = made(pieces)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Renderer, "_choose", lambda *_, **__: None)
        return Renderer(scene, integrator=integrator, **options).origin()


@pytest.fixture
def uncompiled(monkeypatch):
    """Let Renderers compile nothing."""
    monkeypatch.setattr(Renderer, "_choose", lambda *_, **__: None)


@pytest.fixture(scope="module")
def before():
    return origin_of(nothing)


REFUSED = {"Material.shade", "Path.precision"}
"""The changes that path tracing refuses by itself."""


@pytest.mark.parametrize("name", sorted(CHANGES.keys() - REFUSED))
def test_a_change_of_any_argument_is_another_picture(name, before):
    found = origin_of(CHANGES[name])
    with pytest.raises(SceneError, match="was not path traced from this scene, camera, seed and options; they"):
        origin.check_origin("a.npy", before, found)


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_what_path_tracing_cannot_show_is_refused(name):
    with pytest.raises(SceneError, match="path"):
        origin_of(CHANGES[name])


def test_all_changes_are_different_pictures():
    alike = {"Path.secondary", "LayeredCube.of.mesh_or_scene"}
    found = {name: origin_of(changed) for name, changed in CHANGES.items() if name not in REFUSED}
    for (name, one), (other, two) in itertools.combinations(found.items(), 2):
        assert (one == two) == ({name, other} == alike), (name, other)


@pytest.mark.parametrize("name", NO_BITS)
def test_what_changes_no_bit_is_no_other_picture(name, before):
    assert origin_of(NO_BITS[name]) == before


@pytest.fixture(scope="module")
def begun():
    scene, integrator, options = made(base())
    return Renderer(scene, integrator=integrator, **options).render((6, 5), samples=1)


@pytest.fixture(scope="module")
def whole():
    scene, integrator, options = made(base())
    return Renderer(scene, integrator=integrator, **options).render((6, 5), samples=3)


@pytest.mark.sampled(len(NO_BITS))
@pytest.mark.parametrize("name", NO_BITS)
def test_a_picture_goes_on_to_the_bits_of_one_without_a_break(name, begun, whole):
    pieces = base()
    NO_BITS[name](pieces)
    scene, integrator, options = made(pieces)
    found = Renderer(scene, integrator=integrator, **options).render((6, 5), samples=3, resume=begun)
    for layer, expected in whole.layers.items():
        np.testing.assert_array_equal(found.layers[layer], expected)


@pytest.mark.sampled(180)
@pytest.mark.parametrize("name", sorted(CHANGES.keys() - REFUSED))
def test_another_picture_is_not_continued(name, begun, uncompiled):
    pieces = base()
    CHANGES[name](pieces)
    scene, integrator, options = made(pieces)
    with pytest.raises(SceneError, match="the picture to resume was not path traced from this scene"):
        Renderer(scene, integrator=integrator, **options).render((6, 5), samples=3, resume=begun)


def test_the_parts_that_differ_are_named(before):
    def message(*names):
        found = uncompiled_origin(*(CHANGES[name] for name in names))
        with pytest.raises(SceneError) as refused:
            origin.check_origin("a.npy", before, found)
        return str(refused.value).removeprefix("a.npy was not path traced from this scene, camera, seed and options; ")

    assert message("Path.seed") == "they differ in: seed (0 in the picture, 1 here). Begin a new one"
    assert message("Camera.fov", "Mesh.colors") == "they differ in: vertex colors, camera. Begin a new one"
    assert message("Surface.color") == "they differ in: surface programs. Begin a new one"
    assert message("Path.math") == (
        "they differ in: math (strict in the picture, fast here), backend (not noted in the picture, numpy here). "
        "Begin a new one"
    )


@pytest.mark.usefixtures("uncompiled")
def test_the_data_of_a_program_belong_to_the_picture():
    table, param = sh.Table(np.arange(4.0), sh.Attrib1f), sh.Param(sh.Attrib1f, 0.5)
    twice = param * 2

    def painted(hit):
        return Surface(color=sh.Color3f(table[hit.triangle], twice, 0))

    scene = Scene([floor(2, Material(surface=painted))])
    renderer = Renderer(scene, integrator=Path(samples=1), backend="numpy")
    found = [renderer.origin()]
    param.value = 0.25
    found.append(renderer.origin())
    table.update([0.0, 1, 2, 4])
    found.append(renderer.origin())
    assert len(set(found)) == 3
    param.value = 0.5
    table.update(np.arange(4.0))
    assert renderer.origin() == found[0]
    assert Renderer(scene, integrator=Path(samples=1), backend="opencl").origin() == found[0]


def test_a_picture_is_known_again_in_another_process(before):
    lines = "import test_continued as t; print(t.origin_of(t.nothing))"
    given = {"cwd": PurePath(__file__).parent, "check": True, "capture_output": True, "text": True}
    assert subprocess.run([sys.executable, "-c", lines], **given).stdout.strip() == before


def test_two_red_and_blue_programs_are_not_mixed():
    def begun(color):
        return uncompiled_origin(surface(lambda hit: Surface(emission=color)))

    with pytest.raises(SceneError, match="they differ in: surface programs"):
        origin.check_origin("a.npy", begun((1, 0, 0)), begun((0, 0, 1)))


def test_a_scene_that_moves_as_one_is_another_picture():
    """A directional light and the numbers relative to the scene's middle stay."""

    def part(place):
        scene = Scene([floor(4).moved(place)], [DirectionalLight((0, -1, 0))], Camera((0, 3, 8)))
        return Renderer(scene, integrator=Path(samples=1), backend="numpy")

    image = part((0, 0, 0)).render((3, 2))
    with pytest.raises(SceneError, match="they differ in: triangles"):
        part((1, 0, 0)).render((3, 2), resume=image, samples=2)


def test_an_empty_scene_is_continued_by_its_background_alone():
    image = render(Scene(), (3, 2), integrator=Path(samples=1), backend="numpy")
    whole = render(Scene(), (3, 2), integrator=Path(samples=2), backend="numpy", resume=image)
    np.testing.assert_array_equal(whole.pixels, image.pixels)
    for other in (Scene(background=(1, 0, 0)), Scene([floor(1)])):
        with pytest.raises(SceneError, match="they differ in: "):
            render(other, (3, 2), integrator=Path(samples=2), backend="numpy", resume=image)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ("", "a.npy was not path traced by raytracer, so it has no samples to add to: begin a new one"),
        (
            "0123456789abcdef",
            "a.npy was path traced by another version of raytracer: begin a new one with this version",
        ),
        ("999 seed=0", "a.npy was path traced by another version of raytracer: begin a new one with this version"),
    ],
)
def test_pictures_of_other_versions_are_refused(found, words, begun):
    with pytest.raises(SceneError) as refused:
        origin.check_origin("a.npy", found, begun.origin)
    assert str(refused.value) == words


def test_a_file_of_an_earlier_version_is_refused(begun, tmp_path):
    path = dataclasses.replace(begun, origin="0123456789abcdef").save(tmp_path / "old.npy")
    scene, integrator, options = made(base())
    with pytest.raises(SceneError, match=r"old\.npy was path traced by another version of raytracer"):
        Renderer(scene, integrator=integrator, **options).render((6, 5), samples=3, resume=path)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("look", "sky", "digest"),
    [(None, (0.1, 0.2, 0.3), "ffcfadd61ca7c4c9"), ({"roughness": 0.4}, PIXELS, "6c789d04bfc41621")],
    ids=["plain", "layered"],
)
def test_other_pixels_have_another_generation(look, sky, digest):
    """Compare with the digest of this generation: raise `GENERATION` for other pixels, and note theirs here."""
    pieces = base() | {"MetallicRoughness": look, "EnvironmentLight": {"source": sky}}
    scene, integrator, options = made(pieces | {"SpotLight": None, "Unlit": None})
    whole = Renderer(scene, integrator=integrator, **options).render((6, 5), samples=3)
    pixels = hashlib.sha256(whole.pixels.tobytes() + whole.normal.tobytes()).hexdigest()[:16]
    assert {origin.GENERATION: pixels} == {"6": digest}
