"""Integrators as values: what they hold, what they refuse, and the keywords that name them one by one."""

import dataclasses
import subprocess
import sys

import pytest
from scene_pictures import same

import shpy as sh
from raytracer import Intersector, LayeredCube, Path, PointLight, Renderer, Scene, SceneError, Staged, Whitted, render
from raytracer.integrators import integrator
from raytracer.integrators.integrator import Options, chosen
from raytracer.meshes.shapes import box, floor
from shpy.passes import modes

BACKENDS = ("numpy", "opencl", "glsl")
SCENE = Scene([box(), floor(4)], [PointLight((2, 4, 3))], name="box")


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("value", "keywords"),
    [
        (Whitted(bounces=1, samples=4, accel="grid", grid=3), {"bounces": 1, "samples": 4, "accel": "grid", "grid": 3}),
        (Staged(bounces=1, threshold=0.5, grid=4), {"tracer": "staged", "bounces": 1, "threshold": 0.5, "grid": 4}),
        (Path(bounces=2, samples=3, seed=7), {"integrator": "path", "bounces": 2, "samples": 3, "seed": 7}),
        (Whitted(precision="f64", math="relaxed"), {"precision": "f64", "math": "relaxed"}),
    ],
    ids=lambda v: type(v).__name__,
)
def test_a_value_renders_as_the_keywords_do(value, keywords):
    given = dict(keywords)
    assert chosen(given.pop("integrator", "whitted"), given) == value
    by_value = render(SCENE, (6, 5), integrator=value, backend="numpy")
    assert by_value.samples == value.samples
    same(by_value, render(SCENE, (6, 5), backend="numpy", **keywords))


def test_defaults_are_those_of_each_integrator():
    assert [(i.bounces, i.samples, i.structure) for i in (Whitted(), Staged(), Path())] == [
        (3, 1, "bvh"),
        (3, 1, "grid"),
        (8, 64, "bvh"),
    ]
    assert chosen("whitted", {}) == chosen("whitted", {"bounces": None, "samples": None, "accel": None}) == Whitted()
    assert Whitted(accel="ldc:64").structure == "bvh"


def test_every_keyword_is_a_field_of_an_integrator():
    fields = {f.name for kind in (Whitted, Staged, Path) for f in dataclasses.fields(kind)}
    assert set(Options.__annotations__) == fields | {"tracer"}


def test_what_an_integrator_does_not_use_may_be_given_by_keyword():
    assert chosen("whitted", {"threshold": 0.3, "seed": 5}) == Whitted()
    assert chosen("path", {"threshold": 0.3}) == Path()
    with pytest.raises(SceneError, match="a share from 0 to 1, not 2"):
        chosen("path", {"threshold": 2})
    with pytest.raises(SceneError, match="a seed is a whole number"):
        chosen("whitted", {"seed": -1})


def test_the_samples_of_a_picture_take_the_place_of_the_integrators():
    renderer = Renderer(SCENE, integrator=Path(samples=2, bounces=1), backend="numpy")
    assert [renderer.render((4, 3)).samples, renderer.render((4, 3), samples=5).samples] == [2, 5]
    with pytest.raises(SceneError, match="samples is a number from 1 to 16,777,216, not 0"):
        renderer.render((4, 3), samples=0)


@pytest.mark.slow
def test_a_fused_picture_has_the_same_bits_on_every_backend():
    first, *others = (render(SCENE, (8, 6), integrator=Whitted(fuse=True), backend=name) for name in BACKENDS)
    for other in others:
        same(first, other)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Whitted(bounces=True), "bounces is a number from 0 to 64, not True"),
        (lambda: Whitted(samples=2), "samples is a square number from 1 to 64, not 2"),
        (
            lambda: Whitted(accel="octree"),
            "the accelerator is one of 'bvh', 'grid', 'brute', 'instances', 'ldc:1024', not 'octree'",
        ),
        (lambda: Whitted(accel="bvh:sah"), "the hierarchy has one builder now: accel=\"bvh\", not 'bvh:sah'"),
        (lambda: Staged(accel="bvh"), 'accel="grid" or "brute", not "bvh"'),
        (lambda: Whitted(secondary=box()), "secondary is a LayeredCube, not Mesh"),
        (lambda: Whitted(accel="ldc", precision="f64"), "works at precision=\"f32\", not 'f64'"),
        (lambda: Whitted(precision="f8"), "precision is one of 'f16', 'f32', 'f64', not 'f8'"),
        (lambda: Staged(precision=["f32"]), r"precision is one of 'f16', 'f32', 'f64', not \['f32'\]"),
        (
            lambda: render(SCENE, (2, 2), math="exact"),
            "math is one of 'strict', .*, 'fast', not 'exact'",
        ),
        (lambda: Path(fuse=1), "fuse is True or False, not 1"),
        (lambda: Path(math="fast", fuse=True), "math='fast' contracts by itself"),
        (lambda: Path(precision="f16"), "works at precision=\"f32\", not 'f16'"),
        (lambda: Path(seed=2**32), r"a seed is a whole number from 0 to 2\*\*32 - 1"),
        (lambda: Staged(accel="ldc:64"), 'go through a layered depth cube with tracer="unified" alone'),
        (lambda: chosen(Path(), {"bounces": 2}), r"bounces belongs to the integrator: Path\(bounces=2\)"),
        (lambda: render(SCENE, (2, 2), integrator=Staged(), max_error=1.0), "leave the choice to it"),
        (lambda: render(SCENE, (2, 2), max_error=1.0, resume="a.exr"), 'resume is for integrator="path"'),
    ],
)
def test_what_makes_no_integrator_is_an_error(make, message):
    with pytest.raises(SceneError, match=message):
        make()


def test_precisions_and_modes_are_those_of_compile():
    assert integrator.PRECISIONS == modes.PRECISIONS
    assert integrator.MATH == modes.MODES


def test_a_cube_belongs_to_integrators_with_secondary_rays():
    cube = LayeredCube.of(SCENE, 8, backend="numpy")
    assert chosen("path", {"secondary": cube}).secondary is cube
    with pytest.raises(SceneError, match='tracer="unified" alone'):
        chosen("whitted", {"tracer": "staged", "secondary": cube})
    with pytest.raises(TypeError, match="secondary"):
        Staged(secondary=cube)


def test_an_unknown_option_is_said_with_those_that_there_are():
    with pytest.raises(TypeError, match=r"^Whitted has no option 'foo': its options are bounces, samples, accel, "):
        chosen("whitted", {"foo": 1})


ASKED = {
    "render": lambda backend: render(SCENE, (2, 2), backend=backend),
    "staged": lambda backend: render(SCENE, (2, 2), backend=backend, integrator=Staged()),
    "path": lambda backend: Renderer(SCENE, backend=backend, integrator="path"),
    "queries": lambda backend: Intersector(box(), backend=backend).count([[0, 0, 3]], [[0, 0, -1]]),
    "closest point": lambda backend: Intersector(box(), backend=backend).closest_point([0, 0, 3]),
    "cube": lambda backend: LayeredCube.of(box(), resolution=8, backend=backend),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["cuda", 3])
@pytest.mark.parametrize("name", ASKED)
def test_a_backend_that_is_not_there_is_told_at_the_users_line(name, backend):
    with pytest.raises(sh.ShpyError, match="backend") as error:
        ASKED[name](backend)
    assert (error.value.loc.file, error.value.loc.line) == (__file__, ASKED[name].__code__.co_firstlineno)


def test_the_command_tells_no_line_of_the_ray_tracer():
    words = ["render", "boxes", "--size", "2x2", "--backend", "cuda"]
    done = subprocess.run([sys.executable, "-m", "raytracer", *words], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.splitlines()[0]) == (1, "raytracer: there is no backend 'cuda'")
