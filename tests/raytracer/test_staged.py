"""The staged tracer: the unified kernel's pictures bit for bit; its threshold decides how often its kernels run."""

import numpy as np
import pytest
from scene_pictures import LIGHTS, same, small

from raytracer import Camera, Mesh, Renderer, Scene, SceneError, Staged, render
from raytracer.cli import main
from raytracer.integrators.layers import BANDS
from raytracer.meshes.shapes import box, floor, sphere


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["numpy", "opencl", pytest.param("glsl", marks=pytest.mark.slow)])
def test_the_pictures_are_those_of_the_unified_kernel_for_every_threshold(backend, monkeypatch):
    # A small picture, too, copies its last rays to other streams.
    monkeypatch.setattr("raytracer.integrators.staged.LEAST", 16)
    scene = small(60)  # triangles inside and outside of the grid
    unified = render(scene, (24, 16), backend=backend, bounces=1, accel="grid")
    staged = Renderer(scene, backend=backend, bounces=1, tracer="staged")
    assert staged.layout.structure.outside == 2
    for threshold in (0, 0.2, 1):
        staged.staged.threshold = threshold
        image = staged.render((24, 16))
        same(image, unified)
        assert image.stats.calls["compact"] > 2
    masked = render(scene, (24, 16), backend=backend, integrator=Staged(bounces=1, early_z=True, at_once=4))
    same(masked, unified)
    calls = masked.stats.calls
    assert "compact" not in calls
    assert calls["mask"] == sum(calls[stage] for stage in ("precalculate", "traverse", "intersect", "shade"))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("scene", [Scene.builtin("boxes"), Scene.builtin("mixed")], ids=["boxes", "mixed"])
def test_built_in_scenes(scene):
    unified = render(scene, (16, 12), backend="numpy", bounces=1, accel="grid")
    same(render(scene, (16, 12), backend="numpy", bounces=1, tracer="staged", grid=20), unified)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    "changes",
    [
        {"lights": ()},
        {"lights": (), "meshes": [box()]},
        {"meshes": [sphere(rings=8, segments=12)]},
        {"meshes": [Mesh(box().vertices, box().faces, colors=box().vertices + 0.5), floor(9)], "lights": LIGHTS[:1]},
    ],
    ids=["no light", "neither light nor mirror", "nothing outside the grid", "vertex colours"],
)
def test_what_a_scene_lacks_changes_nothing(changes):
    scene = small(60, **changes)
    unified = render(scene, (20, 16), backend="numpy", bounces=1)
    same(render(scene, (20, 16), backend="numpy", bounces=1, tracer="staged", grid=7), unified)


@pytest.mark.sampled(6)
@pytest.mark.parametrize(
    "options",
    [{"samples": 4}, {"precision": "f64"}, {"accel": "brute"}, {"bounces": 0}, {"math": "relaxed"}],
    ids=lambda o: next(iter(o)),
)
def test_options_mean_what_they_mean_to_the_unified_kernel(options):
    given = {"accel": "grid", "bounces": 1, "backend": "numpy", **options}
    same(render(small(60), (18, 12), tracer="staged", **given), render(small(60), (18, 12), **given))


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["numpy", pytest.param("opencl", marks=pytest.mark.slow)])
def test_half_precision_means_what_it_means_to_the_unified_kernel(backend):
    given = {"bounces": 1, "backend": backend, "precision": "f16"}
    unified = render(small(60), (24, 16), accel="grid", **given)
    same(render(small(60), (24, 16), tracer="staged", **given), unified)
    assert len(np.unique(unified.object_id)) == 5, "the floor, three things on it and the sky are in the picture"
    other = render(small(60), (24, 16), accel="grid", **(given | {"precision": "f32"}))
    assert not np.array_equal(unified.pixels, other.pixels)


def test_another_camera_and_size_need_no_new_kernels():
    renderer = Renderer(small(60), backend="numpy", bounces=1, tracer="staged")
    renderer.render((8, 8))
    camera = Camera((-3, 2, 5), (0, 0.5, 0))
    unified = render(small(60, camera=camera), (20, 10), backend="numpy", bounces=1)
    same(renderer.render((20, 10), camera=camera), unified)


def test_bands_of_rows_make_the_same_picture(monkeypatch):
    renderer = Renderer(small(60), backend="numpy", bounces=1, tracer="staged")
    whole = renderer.render((16, 12))
    monkeypatch.setitem(BANDS, "staged", 16 * 5)
    same(renderer.render((16, 12)), whole)


def test_the_threshold_decides_how_often_the_intersector_runs():
    """One cell or triangle a call, as in the thesis: the more rays must wait, the fewer calls of the intersector."""
    renderer = Renderer(small(60), backend="numpy", bounces=1, tracer="staged", grid=12)
    renderer.staged.at_once.value = 1
    calls = []
    for threshold in (0, 0.3, 1):
        renderer.staged.threshold = threshold
        calls.append(dict(renderer.render((16, 12)).stats.calls))
    intersections, traversals = ([c[stage] for c in calls] for stage in ("intersect", "traverse"))
    assert intersections == sorted(intersections, reverse=True)
    assert intersections[-1] < intersections[0]
    assert traversals[-1] > traversals[0]
    assert {c["generate"] for c in calls} == {1}
    assert len({c["shade"] for c in calls}) == 1


def test_rays_that_are_few_run_alone_or_with_all_others(monkeypatch):
    monkeypatch.setattr("raytracer.integrators.staged.LEAST", 16)
    renderer = Renderer(small(60), backend="numpy", bounces=2, tracer="staged")
    alone = renderer.render((24, 16))
    renderer.staged.compacts = False
    among_all = renderer.render((24, 16))
    same(alone, among_all)
    assert alone.stats.alive == among_all.stats.alive
    assert "compact" not in among_all.stats.calls


def test_at_once_decides_how_many_calls_there_are():
    few, many = (
        render(small(60), (24, 16), backend="numpy", integrator=Staged(bounces=1, grid=12, at_once=n)) for n in (64, 1)
    )
    same(few, many)
    for stage in ("traverse", "intersect"):
        assert many.stats.calls[stage] > 2 * few.stats.calls[stage]
    assert many.stats.calls["shade"] == few.stats.calls["shade"]


def test_stats_tell_the_rays_of_each_round():
    stats = render(small(60), (24, 16), backend="numpy", bounces=1, tracer="staged").stats
    assert stats.alive[0] == 24 * 16
    assert stats.calls["shade"] == len(stats.alive)
    assert len(stats.alive) == 2 * (1 + len(LIGHTS))  # an eye ray and a mirrored one, with a shadow ray for each light
    assert all(rays > 0 for rays in stats.alive)
    assert render(small(60), (8, 8), backend="numpy").stats.alive == ()


def test_an_empty_scene_shows_its_background():
    scene = Scene(background=(0.25, 0.5, 1))
    same(render(scene, (6, 4), tracer="staged"), render(scene, (6, 4)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tracer": "stages"}, "the tracer is one of 'unified', 'staged', not 'stages'"),
        ({"tracer": "staged", "accel": "bvh"}, 'accel="grid" or "brute", not "bvh"'),
        ({"tracer": "staged", "threshold": 1.5}, "a share from 0 to 1, not 1.5"),
        ({"tracer": "staged", "threshold": float("nan")}, "a share from 0 to 1, not nan"),
        ({"tracer": "staged", "threshold": True}, "a share from 0 to 1, not True"),
        ({"tracer": "staged", "at_once": 0}, "at_once is a number of cells or triangles from 1 to 65,536, not 0"),
        ({"tracer": "staged", "at_once": 2.0}, "at_once is a number of cells or triangles from 1 to 65,536, not 2.0"),
        ({"tracer": "staged", "early_z": 1}, "early_z is True or False, not 1"),
        ({"tracer": "staged", "grid": 0}, "from 1 to 128 cells along each axis, not 0"),
        ({"tracer": "staged", "grid": 20.0}, "from 1 to 128 cells along each axis, not 20.0"),
        ({"grid": 20}, "grid=20 is for accel=\"grid\", not 'bvh'"),
        ({"tracer": "staged", "max_error": 1.0}, "max_error chooses among the variants of the unified tracer"),
    ],
)
def test_errors(options, message):
    with pytest.raises(SceneError, match=message.replace("(", r"\(")):
        render(small(60), (4, 4), backend="numpy", **options)


def test_the_command(tmp_path, capsys):
    words = ["render", "boxes", "--size", "8x6", "--backend", "numpy", "--bounces", "1"]
    names = [str(tmp_path / name) for name in ("staged.npy", "unified.npy")]
    assert main([*words, "--tracer", "staged", "--threshold", "0.5", "--grid", "10", "-o", names[0]]) == 0
    assert main([*words, "-o", names[1]]) == 0
    np.testing.assert_array_equal(*map(np.load, names))
    assert main([*words, "--tracer", "staged", "--accel", "bvh", "-o", names[0]]) == 1
    assert "the staged tracer goes through cells" in capsys.readouterr().err
