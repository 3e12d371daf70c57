"""The benchmarks measure what they say; without any peer, every backend gives numpy's answer at a small size."""

import json
import multiprocessing
import os
import re
import shutil
import subprocess
import sys
import threading
from contextlib import ExitStack, nullcontext
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

import pages
from texts import TEXTS

from benchmarks import answers, calls, command, gradients, peers, report, rounds, startup
from benchmarks.tables import Setup, Table
from benchmarks.work import TARGETS, Work, compare
from raytracer.meshes.shapes import knot
from shpy.backend.base import Options
from shpy.backend.glsl import text_for
from shpy.backend.glsl.device.context import open_context
from shpy.packages import install


@pytest.fixture(scope="module")
def mesh():
    return knot(segments=24, sides=6)


@pytest.mark.sampled(12)
@pytest.mark.parametrize("work", [*command.KERNELS.values(), *command.CHAINS.values()], ids=lambda work: work.name)
def test_every_backend_gives_the_answer_of_numpy(work):
    contenders = [*TARGETS, "masks", "hand"]
    measured = rounds.run(work, work.quick, contenders, rounds=0)
    assert measured.failed == {}
    assert list(measured.agreement) == [c for c in contenders if c in work.versions]
    assert {n: a.text for n, a in measured.agreement.items() if not a.same} == {}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", ["primary", "secondary-any"])
def test_rays_find_the_same_on_every_backend(name, mesh):
    (work,) = command.works([name], mesh)
    measured = rounds.run(work, 16, [*TARGETS], rounds=0)
    assert measured.failed == {}
    assert list(measured.agreement) == ["opencl", "plain", "opencl-1", "glsl"]
    assert {n: a.text for n, a in measured.agreement.items() if not a.same} == {}


@pytest.mark.slow  # rays of each kind run in every run
def test_frames_are_the_same_on_every_backend(mesh):
    (work,) = command.works(["frame-1024"], mesh)
    measured = rounds.run(work, 16, [*TARGETS], rounds=0)
    assert measured.failed == {}
    assert list(measured.agreement) == ["opencl", "plain", "glsl"]
    assert {n: a.text for n, a in measured.agreement.items() if not a.same} == {}


def toy(**versions):
    work = Work("toy", "{size} numbers", lambda size: (np.arange(size),), 4, 4, within=0.01, share=0.25)
    for name, factor in versions.items():
        work.version(name)(lambda a, factor=factor: lambda: a * factor)
    return work


def test_contenders_take_turns():
    work, called = Work("toy", "", lambda size: (), 1, 1, within=0), []
    for name in ("a", "b"):
        work.version(name)(lambda name=name: lambda: called.append(name) or 0)
    measured = rounds.run(work, 1, ["a", "b"], rounds=3)
    order = [name for k, name in enumerate(called) if k == 0 or called[k - 1] != name]
    assert order == ["a", "b"] * 4
    assert [len(s) for s in measured.seconds.values()] == [3, 3]


def test_a_wrong_answer_is_found():
    measured = rounds.run(toy(masks=1.0, numba=1.5), 4, ["masks", "numba"], rounds=0)
    assert measured.agreement["masks"].same
    assert not measured.agreement["numba"].same
    assert measured.agreement["numba"].text == "5.0e-01, 75.00% beyond WRONG"
    assert not measured.right


def test_sums_in_another_order_than_that_of_the_reference_say_so():
    """The reference may be the one that is far from the exact sums; what is far from both is wrong."""
    work = toy(masks=1.5, numba=1.0, jax=2.0)
    work.exact = lambda a: a * 1.0
    measured = rounds.run(work, 4, ["masks", "numba", "jax"], rounds=0)
    texts = {name: agreement.text for name, agreement in measured.agreement.items()}
    assert texts["masks"] == "0.0e+00"
    assert texts["numba"] == "3.3e-01, 75.00% beyond, other order"
    assert texts["jax"].endswith(" WRONG")
    assert [a.same for a in measured.agreement.values()] == [True, True, False]


def test_answers_are_compared_by_size_and_by_share():
    work = toy()
    assert compare(work, [100.0, 0, 0, 0], [100.9, 0.009, 0, 0]).same
    assert compare(work, [1.0, 0, 0, np.inf], [5.0, 0, 0, np.inf]).same
    assert not compare(work, [1.0, 1, 0, 0], [5.0, 5, 0, 0]).same
    assert not compare(work, [np.nan, np.nan, 0, 0], [5.0, 5, 0, 0]).same
    assert not compare(work, [0.0], [0.0, 0.0]).same


def test_a_contender_that_fails_is_noted(capsys):
    work = toy(masks=1.0)
    work.version("numba")(lambda a: lambda: a.nothing)
    measured = rounds.run(work, 4, ["masks", "numba"], rounds=1)
    assert measured.failed == {"numba": "AttributeError: 'numpy.ndarray' object has no attribute 'nothing'"}
    assert not measured.right
    assert report.table(measured).rows[-1][0] == "numba"
    assert report.table(measured).rows[-1][-1].startswith("failed: AttributeError")


def test_a_missing_peer_is_named_with_its_cure(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.setattr(peers.importlib.util, "find_spec", lambda name: None)
    found, missing = peers.available(["masks", "numba"])
    assert (found, missing) == (["masks"], {"numba": install("numba")})


def test_the_command_prints_and_writes(tmp_path, capsys):
    words = ["--only", "mandelbrot", "--targets", "numpy", "--peers", "masks", "--rounds", "1"]
    assert command.main([*words, "--size", "16", "--json", str(tmp_path / "a.json")]) == 0
    printed = capsys.readouterr().out
    assert "### mandelbrot\n\nMandelbrot set, 16 x 16, at most 256 iterations." in printed
    document = json.loads((tmp_path / "a.json").read_text())
    assert document["command"].startswith("python -m benchmarks")
    assert [row[0] for row in document["tables"][0]["rows"]] == ["shpy, numpy", "numpy, plain masks"]
    (work,) = document["works"]
    assert list(work["seconds"]) == ["numpy", "masks"]


def test_unknown_names_are_refused():
    with pytest.raises(SystemExit, match="no work nothing; there are mandelbrot, nbody"):
        command.main(["--only", "nothing"])


def test_the_texts_are_those_that_kernels_have():
    program = startup.straight(20)
    for backend in ("numpy", "opencl"):
        assert TEXTS[backend](program.ir) == program.compile(backend, lanes=1).source
    device = open_context(0).limits
    assert text_for(program.ir, Options(), device) == program.compile("glsl").source


@pytest.mark.parametrize(("status", "found"), [(0, True), (1, False)])
def test_a_browser_that_only_asks_to_be_installed_is_none(status, found, monkeypatch, tmp_path):
    command = tmp_path / "chromium-browser"
    command.write_text(f"#!/bin/sh\nexit {status}\n")
    command.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert pages.chromium.__wrapped__() == (str(command) if found else None)


@pytest.mark.parametrize(
    ("name", "row"),
    [
        ("lights", "| lights |"),
        pytest.param("importing", "| `shpy`      | ", marks=pytest.mark.slow),
        pytest.param("starting", "| numpy  | ", marks=pytest.mark.slow),
    ],
)
def test_a_study_gives_a_table(name, row, mesh, capsys):
    assert command.main(["--only", name, "--peers", "none", "--quick"]) == 0
    printed = capsys.readouterr().out
    assert f"### {name}" in printed
    assert row in printed


def doubled(peer):
    """Return a work whose peer has a process of its own."""
    work = Work("doubled", "{size} numbers", lambda size: (np.arange(size),), 4, 4, within=0)
    for name in ("masks", "numba"):
        work.version(name)(lambda a: lambda: 2 * a)
    work.version("drjit")(lambda a: lambda: os._exit(3))
    work.version("taichi")(lambda a: AbortsLater())
    return work


class AbortsLater:
    """A version whose process ends by a signal in the first round, after the warm-up, two trials and the calls."""

    def __init__(self):
        self.calls = 0

    def __call__(self):
        self.calls += 1
        if self.calls > 4:
            os.abort()
        return np.arange(4) * 2


@pytest.mark.slow  # four processes; those of studies and one that hangs are in every run
def test_peers_have_processes_of_their_own(monkeypatch):
    """Their answers, errors and ends arrive here."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    names = ["masks", "taichi", "numba", "drjit"]
    measured = rounds.run(doubled(None), 4, names, rounds=2, find=doubled)
    assert measured.agreement["numba"].same
    assert measured.failed == {
        "drjit": "its process ended by exit status 3",
        "taichi": "its process ended by SIGABRT",
    }
    assert {name: len(seconds) for name, seconds in measured.seconds.items()} == {"masks": 2, "numba": 2}
    cells = {row[0]: row for row in report.table(measured).rows}
    assert cells["Taichi"] == ["Taichi", *[""] * 9, "failed: its process ended by SIGABRT"]


def hangs(peer):
    """Return a work whose peer computes for ever."""
    work = Work("hangs", "{size} numbers", lambda size: (np.arange(size),), 4, 4, within=0)
    work.version("masks")(lambda a: lambda: 2 * a)
    work.version("numba")(lambda a: threading.Event().wait)
    return work


def test_a_peer_that_hangs_is_ended(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    monkeypatch.setattr(rounds, "LIMIT", 0.2)
    monkeypatch.setattr(rounds, "ENDING", 0.0)
    measured = rounds.run(hangs(None), 4, ["numba", "masks"], rounds=1, find=hangs)
    assert measured.failed == {"numba": "it gave no answer in 0.2 s"}
    assert list(measured.seconds) == ["masks"]
    assert multiprocessing.active_children() == []


WORDS = ["--only", "mandelbrot,lights,calls", "--targets", "numpy", "--peers", "none", "--quick", "--size", "8"]
CALLS = Table("calls", "", ["call", "median"], [["shpy, numpy", "1.0"]])


def test_a_study_that_raises_ends_no_run(monkeypatch, tmp_path, capsys):
    """Earlier results are in the file by then, and later ones are measured; the page has what there is."""

    def fails(setup):
        (unfinished,) = tmp_path.iterdir()
        assert len(json.loads(unfinished.read_text())["tables"]) == 1
        raise OSError("the battery is empty")

    monkeypatch.setitem(command.STUDIES, "lights", fails)
    monkeypatch.setitem(command.STUDIES, "calls", lambda setup: CALLS)
    assert command.main([*WORDS, "--write", str(tmp_path)]) == 1
    assert capsys.readouterr().out.endswith("lights failed: OSError: the battery is empty\n")
    page, path = sorted(tmp_path.iterdir(), key=lambda path: path.suffix, reverse=True)
    document = json.loads(path.read_text())
    assert [table["name"] for table in document["tables"]] == ["mandelbrot", "calls"]
    assert document["failed"] == {"lights": "OSError: the battery is empty"}
    assert re.search(r"\| shpy, numpy +\| +1\.0 \|", page.read_text())
    line = "- rays are not on this page: no run has the table primary: `python -m benchmarks --only primary --write`\n"
    assert line in page.read_text()


def test_a_run_that_is_stopped_says_where_its_results_are(monkeypatch, tmp_path, capsys):
    def stops(setup):
        raise KeyboardInterrupt

    monkeypatch.setitem(command.STUDIES, "lights", stops)
    assert command.main([*WORDS, "--write", str(tmp_path)]) == 130
    (path,) = tmp_path.iterdir()
    assert path.name == "mandelbrot-lights-calls.json.unfinished"
    message = f"benchmarks: stopped; results so far: {path} (to use them, drop .unfinished from the name)\n"
    assert capsys.readouterr().err == message
    path.rename(path.with_suffix(""))
    assert answers.Results.read(tmp_path).cell("mandelbrot", "shpy, numpy", "ratio") == "1.00"
    assert command.main(["--only", "lights", "--peers", "none", "--json", str(tmp_path / "a.json")]) == 130
    assert capsys.readouterr().err == "benchmarks: stopped\n"


def test_studies_leave_out_peers_that_are_not_asked_for(monkeypatch):
    monkeypatch.setattr(peers, "available", lambda names: (names, {}))
    monkeypatch.setattr(peers.Peer, "version", "1.0")
    monkeypatch.setattr(gradients, "peer_run", lambda peer, *_: nullcontext(peer))
    seen = []
    monkeypatch.setitem(command.STUDIES, "fitting", lambda setup: seen.append(setup) or CALLS)
    for text in ("none", "masks,jax"):
        assert command.main(["--only", "fitting", "--quick", "--peers", text]) == 0
    with ExitStack() as ending:
        runs = [gradients.runs_of_peers(setup, ending, None, slice(1), ()) for setup in seen]
    assert runs == [{}, {"JAX": "jax"}]


def test_peers_of_studies_have_processes_of_their_own(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    with rounds.peer_run("masks", calls.PEERS["masks"][1], np.arange(3)) as run:
        assert run(0)[0].tolist() == [1, 2, 3]
        times = rounds.in_turns({"numpy": run, "here": list}, 3)
        assert all(len(t.seconds) == len(t.cpu) == 3 and min(t.seconds) > 0 for t in times.values())
        with pytest.raises(rounds.Failed, match=r"^numpy, plain masks: TypeError: "):
            run("many")


SLOW = pytest.mark.slow


@SLOW
def test_decisions_are_raced():
    done = subprocess.run([sys.executable, "scripts/decisions", "arguments", "places"], capture_output=True, text=True)
    rows = [line.split() for line in done.stdout.splitlines()]
    assert [row[0] for row in rows] == ["arguments", "places"], done.stderr
    assert all(float(number) > 0 for row in rows for number in row[1:4])


@pytest.mark.parametrize(
    "name",
    ["lights", *(pytest.param(name, marks=SLOW) for name in ("importing", "calls", "equal-error"))],
)
def test_each_study_keeps_the_seconds_of_its_rounds(name, mesh):
    table = command.STUDIES[name](Setup(mesh, quick=True))
    assert table.rounds
    assert all(len(seconds) > 1 and min(seconds) > 0 for seconds in table.rounds.values())


@SLOW
def test_looks_are_compared_with_mitsuba_where_it_is_installed(mesh):
    table = command.STUDIES["looks"](Setup(mesh, True, ["mitsuba"]))
    assert [row[0] for row in table.rows] == ["chalk", "brushed metal"]
    assert all(float(row[1]) > 0 for row in table.rows)


def test_the_page_of_answers_is_what_its_command_writes():
    """The results in the tree give docs/benchmarks.md, which stays one page."""
    page = answers.page(answers.Results.read())
    assert answers.PAGE.read_text() == page
    assert page.count("\n") <= 150


def test_results_on_the_page_are_of_works_and_studies_that_the_command_knows():
    results = answers.Results.read()
    runs = [*results.runs.values(), *results.machines.values()]
    assert {name for run in runs for name in run["tables"]} <= {*command.WORKS, *command.STUDIES}


def test_contenders_on_the_page_have_a_version_that_the_command_runs(mesh):
    results = answers.Results.read()
    works = {work.name: work for work in command.works(command.WORKS, mesh)}
    for run in [*results.runs.values(), *results.machines.values()]:
        for name in {*run["tables"]} & {*works}:
            labels = {report.label(version) for version in works[name].versions}
            assert {row[0] for row in run["tables"][name]["rows"]} <= labels, name


def test_the_newest_run_of_a_table_is_on_the_page_and_older_files_go(tmp_path):
    def keep(stem, date, *names):
        tables = [{"name": name, "head": ["", "ms"], "rows": [["shpy, OpenCL", stem]]} for name in names]
        run = {"date": date, "machine": "m", "command": "c", "tables": tables}
        (tmp_path / f"{stem}.json").write_text(json.dumps(run))

    keep("old", "2026-11-21", "blur")
    keep("partial", "2026-11-22 09:30", "blur", "nbody")
    keep("new", "2026-11-22 10:00", "blur")
    results = answers.Results.read(tmp_path)
    assert [results.cell(name, "shpy, OpenCL", "ms") for name in ("blur", "nbody")] == ["new", "partial"]
    answers.drop_superseded(tmp_path)
    assert sorted(p.stem for p in tmp_path.iterdir()) == ["new", "partial"]
    with pytest.raises(answers.NotMeasured, match="--only sort --write"):
        results.table("sort")


def test_a_part_of_a_run_replaces_its_rows_of_the_page(tmp_path, capsys):
    folder = tmp_path / "results"
    shutil.copytree(answers.FOLDER, folder)
    words = ["--quick", "--only", "mandelbrot", "--size", "8", "--targets", "opencl,plain", "--peers", "none"]
    assert command.main([*words, "--write", str(folder)]) == 0
    (run,) = (json.loads(path.read_text()) for path in folder.glob("mandelbrot.json"))
    assert list(run["works"][0]["seconds"]) == ["opencl", "plain"]
    assert [len(seconds) for seconds in run["works"][0]["seconds"].values()] == [2, 2]
    page = (folder / "benchmarks.md").read_text()
    assert re.search(r"shpy, plain call +\| +[\d.]+ +\| +\|", page)
    assert "| JAX                   |            |" in page


def test_quick_results_are_not_for_the_page(capsys):
    assert command.main(["--quick", "--only", "calls", "--write"]) == 2
    assert "--write FOLDER, another one" in capsys.readouterr().err
