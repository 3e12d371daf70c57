"""The study of layered depth cubes: its cases, its tables and files, and its end in time."""

import csv
import dataclasses
import json
import re

import numpy as np
import pytest

from raytracer import SceneError
from raytracer.cli import main
from raytracer.meshes.shapes import sphere
from raytracer.studies import layered as studying, layered_measuring as measuring
from raytracer.studies.layered_measuring import Model, bumpy, models, unit


@pytest.fixture(scope="module")
def full():
    return models()


@pytest.fixture
def few(monkeypatch):
    """One small model, two hit tests, one resolution, each timed once; no grid."""
    ball = Model("knot", (unit(bumpy(sphere(0.5, rings=6, segments=8), 0.1)),))
    plan = dataclasses.replace(studying.QUICK, size=(48, 36), tolerances=(), framed=(8,), resolutions=(8,))
    cases = studying.cases
    monkeypatch.setattr(studying, "QUICK", plan)
    monkeypatch.setattr(studying, "_TESTS", ("triangle", "sample"))
    monkeypatch.setattr(studying, "models", lambda quick: (ball,))
    monkeypatch.setattr(studying, "cases", lambda *given: [c for c in cases(*given) if c.accel != "grid"][:3])
    monkeypatch.setattr(measuring, "ROUNDS", 1)


def test_cases_are_different_and_cover_what_is_studied(full):
    found = studying.cases(["opencl"], full, studying.FULL)
    assert len(set(found)) == len(found)
    cubes = [c for c in found if c.accel == "ldc"]
    for model in full:
        assert {c.resolution for c in cubes if c.model == model.name} >= {512, 1024}
    of_studied = [c for c in cubes if c.model == studying.FULL.studied]
    studied = {(c.hit, c.resolution, c.tolerance) for c in of_studied}
    sizes = (128, 256, 512, 1024, 2048)
    assert studied == {(hit, n, None) for hit in ("sample", "plane", "triangle") for n in sizes} | {
        ("sample", n, tolerance) for n in sizes for tolerance in (1e-4, 1e-3, 1e-2)
    }
    halves = {(c.hit, c.resolution) for c in of_studied if c.depths == "half"}
    assert halves == {(hit, n) for hit in ("sample", "plane") for n in sizes}
    blocks = [(c.hit, c.resolution, c.block) for c in of_studied if c.block is not None]
    assert blocks == [("plane", 512, block) for block in (1, 4, 16, 64, 512)]


def test_models_have_the_triangles_of_the_paper_and_sides_of_length_1(full):
    assert [len(m.meshes[0]) for m in full] == [8_192, 20_264, 100_000, 300_000, 1_628]
    for model in full:
        assert np.ptp(model.meshes[0].corners, axis=(0, 1)).max() == pytest.approx(1)
    frames = full[-1].meshes
    assert len(frames) > 1
    assert abs(frames[0].corners - frames[1].corners).max() > 1e-3


@pytest.mark.slow
def test_the_study_measures_every_case_and_writes_them(few, tmp_path):
    told = []
    found = studying.study(["numpy"], quick=True, progress=lambda done, total: told.append((done, total)))
    assert found.skipped == ()
    assert [str(m.case) for m in found.measured] == ["BVH", "8² triangle", "8² sample"]
    assert told[-1] == (3, 3)
    for m in found.measured:
        assert m.build_seconds > 0
        assert m.nbytes > 0
        assert m.frame_seconds > 0
        exact = m.case.hit != "sample"
        assert (m.errors["rmse"] == 0) == exact
        assert all((w.all == 0) == exact and w.all < 1 for w in m.wrong.values())
    _, fine, rough = found.measured
    assert fine.samples > rough.samples > 0
    path = tmp_path / "plot.png"
    found.plot(path)
    assert path.stat().st_size > 10_000
    assert (tmp_path / "plot-pictures.png").stat().st_size > 5_000
    assert len(json.loads(path.with_suffix(".json").read_text())["measured"]) == 3
    with path.with_suffix(".csv").open() as file:
        assert [row["accel"] for row in csv.DictReader(file)] == ["bvh", "ldc", "ldc"]
    text = re.sub(" +", " ", found.markdown())
    assert "| knot | 82 | 8² triangle |" in text
    assert "| sample | 8 |" in text
    assert "Blocks" not in text
    of_block, of_half = (
        dataclasses.replace(rough, case=dataclasses.replace(rough.case, **options))
        for options in ({"block": 4}, {"depths": "half"})
    )
    more = dataclasses.replace(found, measured=(*found.measured, of_block, of_half))
    _, blocks = re.sub(" +", " ", more.markdown()).split("**Blocks of the coarse level, knot, 8² plane, numpy**")
    assert "| block | build ms | MiB | secondary rays | mirrored ms | shadow ms | scattered ms |" in blocks
    assert blocks.count("\n| 4 |") == 1
    assert [str(m.case) for m in more.studied("numpy")] == ["8² triangle", "8² sample", "8² sample half"]


def test_a_study_ends_in_time(few):
    found = studying.study(["numpy"], quick=True, minutes=0)
    assert not found.measured
    assert len(found.skipped) == 3
    assert "3 measurements were left out" in found.markdown()


@pytest.mark.slow
def test_the_command(few, tmp_path, capsys):
    path, mesh = tmp_path / "layered.svg", tmp_path / "two.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n")
    given = ["study", "layered", "--quick", "--backend", "numpy", "--minutes", "0", "--size", "8x6"]
    assert main([*given, "--mesh", str(mesh), "-o", str(path)]) == 0
    assert "3 measurements were left out" in capsys.readouterr().out
    assert path.exists()
    assert main([*given, "--mesh", str(tmp_path / "gone.obj")]) == 1
    assert "gone" in capsys.readouterr().err
    assert main(["study", "christen", "--quick"]) == 1
    assert "are for `raytracer study layered`" in capsys.readouterr().err


def test_a_mesh_without_triangles_is_no_model(few, tmp_path):
    path = tmp_path / "points.obj"
    path.write_text("v 0 0 0\n")
    with pytest.raises(SceneError):
        studying.study(["numpy"], quick=True, files=[path], minutes=0)
