"""The study of the thesis: its cases, its tables and files, and its end in time."""

import csv
import json

import pytest

import shpy as sh
from raytracer import SceneError
from raytracer.cli import main
from raytracer.studies import christen


@pytest.fixture
def few(monkeypatch):
    """Two sizes of a grid, two numbers of iterations, one threshold, the smallest scene, once."""
    monkeypatch.setattr(christen, "SCENES", {"A": "boxes"})
    monkeypatch.setattr(christen, "COMPARED", ("A",))
    monkeypatch.setattr(christen, "GRIDS", (5, 20))
    monkeypatch.setattr(christen, "_OFTEN", 1)
    monkeypatch.setattr(christen, "ITERATIONS", (1, 2))
    monkeypatch.setattr(christen, "THRESHOLDS", (0.2,))
    monkeypatch.setattr(christen.study, "__kwdefaults__", {**christen.study.__kwdefaults__, "size": (6, 4)})


def test_cases_are_different_and_cover_what_the_thesis_varies():
    found = christen.cases(["numpy", "opencl", "glsl"])
    assert len(set(found)) == len(found)
    assert {c.scene for c in found} == {"A", "B", "C"}
    for key, values in (("grid", christen.GRIDS), ("iterations", christen.ITERATIONS)):
        assert {getattr(c, key) for c in found} == set(values)
        assert {getattr(c, key) for c in found if c.backend == "opencl" and c.tracer == "unified"} == set(values)
    for way in ("all", "masked"):
        compared = {(c.scene, c.backend) for c in found if c.way == way}
        assert compared == {(scene, backend) for scene in christen.COMPARED for backend in ("opencl", "glsl")}
    for scene in christen.SCENES:
        assert {c.threshold for c in found if (c.scene, c.at_once) == (scene, 1)} == set(christen.THRESHOLDS)
        assert {c.iterations for c in found if (c.scene, c.backend) == (scene, "numpy")} == set(christen.ITERATIONS)


@pytest.mark.slow
def test_the_study_measures_every_case_and_writes_them(few, tmp_path):
    told = []
    found = christen.study(["numpy"], progress=lambda done, total: told.append((done, total)))
    assert found.skipped == ()
    assert [m.case for m in found.measured] == christen.cases(["numpy"])
    assert told[-1] == (len(found.measured), len(found.measured))
    for m in found.measured:
        assert m.seconds > 0
        assert len(m.alive) == len(m.round_seconds)
        assert bool(m.calls) == (m.case.tracer == "staged")
    found.plot(tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 10_000
    stored = json.loads((tmp_path / "plot.json").read_text())
    assert len(stored["measured"]) == len(found.measured)
    with (tmp_path / "plot.csv").open() as file:
        assert [row["tracer"] for row in csv.DictReader(file)] == [m.case.tracer for m in found.measured]
    text = found.markdown()
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    assert ["A", "numpy", "staged"] in [row[:3] for row in rows]
    passes = {
        row[2]: int(row[4])
        for row in rows
        if row[:2] == ["A", "numpy"] and row[2] in ("all", "masked") and len(row) == 7
    }
    assert passes["all"] == 0 < passes["masked"]
    assert f"{found.machine} (numpy: " in text


def test_a_study_ends_in_time_and_names_what_is_missing(few):
    found = christen.study(["numpy"], minutes=0)
    assert not found.measured
    assert list(found.skipped) == christen.cases(["numpy"])
    assert f"{len(found.skipped)} measurements were left out" in found.markdown()


def test_errors(few, tmp_path):
    with pytest.raises(SceneError, match="a study needs a backend"):
        christen.study([])
    with pytest.raises(sh.BackendUnavailable, match="vulkan is not available"):
        christen.study(["vulkan"])


def test_the_command(few, tmp_path, capsys):
    path = tmp_path / "christen.svg"
    assert main(["study", "christen", "--backend", "numpy", "--minutes", "0", "--cpu", "-o", str(path)]) == 0
    assert "CPU time of all cores" in capsys.readouterr().out
    assert path.exists()
    assert path.with_suffix(".csv").exists()
    assert main(["study", "christen", "-o", str(tmp_path / "gone" / "a.png")]) == 1
    assert "gone" in capsys.readouterr().err
