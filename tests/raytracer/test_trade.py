"""Variants of a scene, what they cost and how far off they are, and which one is taken."""

import dataclasses
import json
import re
import sys

import numpy as np
import pytest

import shpy as sh
from raytracer import Material, PointLight, Scene, SceneError, render, tradeoff
from raytracer.cli import main
from raytracer.integrators.renderer import Renderer
from raytracer.meshes.shapes import box, floor, sphere
from raytracer.studies import tradeoff as trade
from raytracer.studies.tradeoff import Candidate, Tradeoff, Variant, beside, errors

LIGHT = PointLight((2, 4, 3))
FLIP = sys.version_info < (3, 14)
"""flip-evaluator is there: it is built for no later Python."""


@pytest.fixture(autouse=True)
def _quickly(monkeypatch):
    monkeypatch.setattr(trade, "SIZE", (24, 16))
    monkeypatch.setattr(trade, "ROUNDS", 1)


@pytest.fixture
def unflipped(monkeypatch):
    """Compute no FLIP, which takes longer than a picture of this size."""
    monkeypatch.setattr(trade, "_flip", lambda seen, wanted: {})


def keep(monkeypatch, kept):
    """Measure only the variants that are `kept`; test_every_variant_of_a_scene_is_measured has them all."""
    every = trade._variants
    monkeypatch.setattr(trade, "_variants", lambda scene, bounces: [v for v in every(scene, bounces) if kept(v)])


def is_plain(variant):
    return (variant.precision, variant.math) == ("f32", "strict")


def mirrors():
    return Scene([box(), floor(8, Material(reflectivity=0.6))], [LIGHT], name="mirrors")


def candidate(seconds, error, name="strict"):
    found = {"rmse": error, "max": error, "off": 0.0, "objects": 0.0}
    return Candidate(Variant("f32", name, "bvh", 1), seconds, (seconds, seconds), found, {**found, "rmse": error / 2})


def test_errors_are_those_of_the_bytes_of_a_picture():
    image = render(mirrors(), (6, 4), backend="numpy")
    assert errors(image, image) == {"rmse": 0, "max": 0, "off": 0, "objects": 0} | ({"flip": 0} if FLIP else {})
    pixels, objects = image.pixels.copy(), image.object_id.copy()
    pixels[1, 2] = 0
    objects[0, :3] += 1
    other = dataclasses.replace(image, pixels=pixels, object_id=objects)
    off = image.srgb[1, 2].astype(float)
    found = errors(other, image)
    assert found["max"] == pytest.approx(off.max(), abs=0.5)
    assert found["rmse"] == pytest.approx(np.sqrt((off**2).sum() / 72), rel=0.02)
    assert found["off"] == pytest.approx(1 / 24)
    assert found["objects"] == pytest.approx(3 / 24)
    assert ("flip" in found) == FLIP
    assert not FLIP or 0 < found["flip"] < 1


def test_the_fastest_within_the_error_is_taken_and_what_is_unseen_counts():
    slow, fast, far = candidate(3.0, 0.1), candidate(2.0, 0.4), candidate(1.0, 9.0)
    hidden = dataclasses.replace(candidate(0.5, 0.0), unseen={**far.error})
    t = Tradeoff("s", "numpy", 0.5, (hidden, far, fast, slow))
    assert t.pick is fast
    assert t.frontier == (hidden, fast, slow)
    with pytest.raises(SceneError, match=r"within 0.01/255: the closest, f32 strict bvh, 1 bounces, is 0.1"):
        _ = dataclasses.replace(t, max_error=0.01).pick
    lines = t.table().splitlines()
    assert [line[0] for line in lines[2:6]] == ["*", " ", "→", "*"]


@pytest.mark.usefixtures("unflipped")
def test_a_scene_larger_than_f16_holds_is_traded_without_f16(monkeypatch):
    keep(monkeypatch, lambda v: (v.math, v.accel) == ("strict", "bvh"))
    t = tradeoff(Scene([box((1e6, 1e6, 1e6))], [LIGHT]), backend="numpy", bounces=0)
    assert {c.variant.precision for c in t.candidates} == {"f32", "f64"}
    assert any("f16 holds numbers up to 65504" in reason for _, reason in t.skipped)


def test_of_variants_that_are_not_separable_in_time_the_closest_is_taken():
    close = dataclasses.replace(candidate(2.2, 0.1), spread=(1.9, 2.4))
    fast, far = candidate(2.0, 0.4), dataclasses.replace(candidate(1.0, 9.0), spread=(0.9, 2.1))
    t = Tradeoff("s", "numpy", 0.5, (far, fast, close, candidate(3.0, 0.01)))
    assert t.pick is close
    assert [row["like_fastest"] for row in t.json()["candidates"]] == [True, False, True, False]
    assert "≈" in t.table().splitlines()[2]


def test_the_table_explains_its_columns_and_short_names():
    strict = candidate(1.0, 0.1)
    cube = dataclasses.replace(strict, variant=Variant("f16", "strict", "ldc:512:triangle", 2))
    said = Tradeoff("s", "numpy", 0.5, (strict, cube)).table()
    table, _, legend = said.partition("\n\n")
    assert "flip" not in said
    explained = [line.split("  ")[1] for line in legend.splitlines() if line[2] != " "]
    headings = [h for h in table.splitlines()[1].split("  ") if h]
    assert {h.strip() for h in headings} <= {e.strip() for e in explained}
    assert {"f16", "f32", "strict", "bvh", "ldc:512:triangle"} <= {e.strip() for e in explained}
    assert "secondary rays in a layered depth cube of 512 x 512 texels, with an exact hit test" in said


@pytest.mark.slow
@pytest.mark.usefixtures("unflipped")
def test_every_variant_of_a_scene_is_measured():
    t = tradeoff(mirrors(), max_error=0.5, backend="numpy", bounces=1)
    assert {c.variant.bounces for c in t.candidates} == {0, 1}
    assert {c.variant.precision for c in t.candidates} == {"f16", "f32", "f64"}
    assert {c.variant.accel for c in t.candidates} == {"bvh", "grid", "brute"}
    by = {c.variant: c for c in t.candidates}
    assert by[Variant("f64", "strict", "bvh", 1)].worst == 0
    assert by[Variant("f32", "strict", "bvh", 1)].worst < 0.5 < by[Variant("f32", "strict", "bvh", 0)].worst
    assert t.pick.worst <= 0.5
    assert [c.seconds for c in t.candidates] == sorted(c.seconds for c in t.candidates)


@pytest.mark.slow
@pytest.mark.usefixtures("unflipped")
def test_without_mirrors_no_bounce_is_measured(monkeypatch):
    keep(monkeypatch, is_plain)
    t = tradeoff(Scene([box()], [LIGHT]), backend="numpy")
    assert {c.variant.bounces for c in t.candidates} == {0}


def test_layered_cubes_are_variants_where_many_triangles_meet_secondary_rays(monkeypatch):
    def cubes(lights, reflectivity, bounces, rings=34):
        ball = sphere(rings=rings, material=Material(reflectivity=reflectivity))
        scene = Scene(ball, lights, name="ball")
        return [v for v in trade._variants(scene, bounces) if v.accel.startswith("ldc")]

    assert [v.accel for v in cubes([LIGHT], 0, 2)] == list(trade.LAYERED)
    assert {v.bounces for v in cubes([LIGHT], 0.5, 2)} == {2}
    assert len(cubes([], 0.5, 2)) == len(trade.LAYERED)
    assert cubes([], 0, 2) == cubes([], 0.5, 0) == cubes([LIGHT], 0, 2, rings=4) == []


@pytest.mark.usefixtures("unflipped")
def test_a_layered_cube_is_picked_and_rendered_where_it_wins(monkeypatch):
    bvh, cube = Variant("f32", "strict", "bvh", 0), Variant("f32", "strict", "ldc:24:triangle", 0)
    large = Variant("f32", "strict", "ldc:8192", 0)
    monkeypatch.setattr(trade, "_variants", lambda scene, bounces: [bvh])
    scene = Scene([box(), floor(8)], [LIGHT], name="box")
    with pytest.raises(SceneError, match="no variant is within"):
        render(scene, (16, 12), backend="numpy", max_error=1e-9)
    monkeypatch.setattr(trade, "_variants", lambda scene, bounces: [bvh, cube, large])
    monkeypatch.setattr(trade, "_times", lambda made: [(float(v == bvh), (0.0, 0.0)) for v, _ in made])
    monkeypatch.setattr("raytracer.layered.building.free_bytes", lambda: 1)
    found, measured = [], trade._measured
    monkeypatch.setattr(trade, "_measured", lambda *given: found.append(measured(*given)) or found[-1])
    assert render(scene, (16, 12), backend="numpy", max_error=1.0).stats.picked == str(cube)
    ((t, _),) = found
    assert t.pick.variant == cube
    assert t.pick.worst < 1.0
    assert [what for what, _ in t.skipped] == [str(large)]
    assert "choose a lower resolution" in t.table()


@pytest.mark.usefixtures("unflipped")
def test_render_takes_an_error(monkeypatch):
    keep(monkeypatch, is_plain)
    scene = mirrors()
    made = []
    build = Renderer.__init__
    monkeypatch.setattr(Renderer, "__init__", lambda self, *a, **k: (made.append(k), build(self, *a, **k))[1])
    image = render(scene, (32, 24), backend="numpy", bounces=2, max_error=1.0)
    assert "2 bounces" in image.stats.picked or "1 bounces" in image.stats.picked
    assert len({str(k) for k in made}) == len(made), "each variant is made once"
    assert errors(image, render(scene, (32, 24), backend="numpy", bounces=2, precision="f64"))["rmse"] < 1.5
    assert render(scene, (8, 6), backend="numpy").stats.picked == ""


def test_what_cannot_be_traded_is_said():
    with pytest.raises(SceneError, match="max_error is a positive number of 255ths, not 0"):
        tradeoff(mirrors(), max_error=0, backend="numpy")
    with pytest.raises(SceneError, match="max_error is a positive number of 255ths, not 'low'"):
        render(mirrors(), max_error="low", backend="numpy")
    with pytest.raises(SceneError, match="has no triangles"):
        tradeoff(Scene(), backend="numpy")
    with pytest.raises(SceneError, match=r"pictures show a Scene, .*, not <Mesh box"):
        tradeoff(box(), backend="numpy")


def test_the_other_camera_sees_the_scene_too():
    scene = mirrors()
    moved = beside(scene.camera)
    assert moved.target == scene.camera.target
    assert moved.position != scene.camera.position
    seen, other = (
        (render(dataclasses.replace(scene, camera=c), (24, 16), backend="numpy").object_id >= 0).mean()
        for c in (scene.camera, moved)
    )
    assert 0.7 * seen < other < seen  # from a little farther


@pytest.mark.slow
def test_the_command_prints_and_draws(tmp_path, capsys, monkeypatch):
    keep(monkeypatch, lambda v: (v.precision, v.accel) == ("f32", "bvh") and (v.bounces or v.math == "strict"))
    picture = tmp_path / "t.png"
    assert main(["tradeoff", "boxes", "--backend", "numpy", "--bounces", "1", "--error", "2", "-o", str(picture)]) == 0
    said = capsys.readouterr().out
    assert "boxes on numpy" in said
    assert ("flip" in said) == FLIP
    assert said.splitlines()[-1].startswith("within 2/255: ")
    assert picture.read_bytes().startswith(b"\x89PNG")
    held = json.loads(picture.with_suffix(".json").read_text())
    assert held["scene"] == "boxes"
    assert len(held["candidates"]) == len(re.findall(r"\d bounces  ", said))
    assert list(tmp_path.glob(".*")) == []


def test_a_reference_on_numpy_is_told():
    with pytest.warns(sh.ShpyWarning, match="the reference is rendered on numpy, which is slower: glsl has no f64"):
        exact = trade.reference(mirrors(), "glsl", 0)
    assert exact.backend == "numpy"


@pytest.mark.usefixtures("unflipped")
def test_progress_counts_the_references_too(monkeypatch):
    seen = []
    monkeypatch.setattr(trade, "_variants", lambda scene, bounces: [Variant("f32", "strict", "bvh", 0)])
    tradeoff(mirrors(), max_error=200, backend="numpy", progress=lambda *counts: seen.append(counts))
    pictures = 2 + len(trade.AROUND)
    assert seen == [(n, pictures + 1) for n in range(pictures + 2)]
