"""`shpy certify`: what it says of devices that give our bits, and of one that does not."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from testing.faults import op, with_fault

from shpy import cli
from shpy.ir.ops import TRANSCENDENTALS
from shpy.ir.text import print_module
from shpy.testing.certify import command, functions, pictures, sections
from shpy.testing.certify.comparing import results
from shpy.testing.certify.findings import Check, DeviceChoice, Finding, Section
from shpy.testing.certify.golden import KERNELS, digest, golden
from shpy.testing.certify.inputs import pairs, sweep
from shpy.testing.certify.report import grouped, left_line, section_line, verdict, verdict_lines
from shpy.testing.certify.sections import SectionRun, run_section
from shpy.testing.conformance.catalogue import all_cases

ROOT = Path(__file__).parents[2]
CASES = all_cases()
everywhere = pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])


def forget() -> None:
    """Drop the compiled kernels that programs keep: those with a fault must not be used again, nor right ones."""
    functions.function.cache_clear()
    for case in CASES:
        if "program" in vars(case):
            case.program._kernels.clear()


@pytest.fixture(autouse=True)
def _without_kernels() -> Any:
    forget()
    yield
    forget()


def keep(monkeypatch: Any, *names: str) -> None:
    """Make `shpy certify` run these checks alone."""

    def few(wanted: Any = sections.SECTIONS, full: bool = False) -> list[Section]:
        made = sections.sections(wanted, full)
        kept = [[c for c in s.checks if c.name in names] for s in made]
        return [Section(s.name, s.title, None, k) for s, k in zip(made, kept, strict=True)]

    monkeypatch.setattr(command, "sections", few)


FEW = ("add-f", "mandelbrot", "exp", "exp, relaxed", "boxes")


@pytest.mark.sampled(3)
@everywhere
def test_a_device_that_gives_our_bits_is_told_so(backend: str, monkeypatch: Any, capsys: Any, tmp_path: Path) -> None:
    keep(monkeypatch, *FEW)
    path = tmp_path / "certificate.json"
    assert cli.main(["certify", "--backend", backend, "-o", str(path)]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    denormals = " but for denormals" if DeviceChoice(backend).flushes else ""  # some results of exp are denormals
    assert said.out.splitlines()[-1] == f"SAME BITS: {backend}{denormals}. Nothing is left to do."
    content = json.loads(path.read_text())
    (target,) = content["targets"]
    assert {name for s in target["sections"].values() for name in s["findings"]} == set(FEW)
    assert target["sections"]["pictures"]["findings"]["boxes"]["hash"] == golden()["pictures"]["boxes"]


def test_a_fault_is_named_with_its_inputs(monkeypatch: Any, capsys: Any, tmp_path: Path) -> None:
    with_fault(monkeypatch, "glsl", op("mul", "add"))
    keep(monkeypatch, "mul-f", "nbody", "floor-f")
    path = tmp_path / "found.json"
    assert cli.main(["certify", "--backend", "glsl", "--section", "conformance,examples", "-o", str(path)]) == 1
    said = capsys.readouterr().out
    assert "mul-f on glsl, output 0, for {" in said
    assert "nbody: 256 of 256 elements differ" in said
    assert said.splitlines()[-1].startswith("DIFFERS: glsl, in what is named above. ")
    (target,) = json.loads(path.read_text())["targets"]
    found = {name: f["verdict"] for s in target["sections"].values() for name, f in s["findings"].items()}
    assert found == {"mul-f": "differs", "floor-f": "same", "nbody": "differs"}


@everywhere
def test_with_full_every_number_is_compared_with_numpy(backend: str, monkeypatch: Any) -> None:
    monkeypatch.setattr(functions, "everything", lambda part: iter([sweep(8), sweep(4)]))
    (check,) = [c for c in functions.input_checks() if c.name == "exp, part 12 of 64"]
    finding = check.run(DeviceChoice(backend))
    assert finding.verdict == ("denormals" if DeviceChoice(backend).flushes else "same")
    if backend == "numpy":
        assert finding.ulp is not None
        assert 0 < finding.ulp <= 1
    forget()
    with_fault(monkeypatch, backend, op("exp", "exp2"))
    assert check.run(DeviceChoice(backend)).verdict == "differs"


def test_an_error_beyond_the_bound_is_named_with_its_input(monkeypatch: Any) -> None:
    with_fault(monkeypatch, "numpy", op("sinh", "tan"))
    (check,) = [c for c in functions.bound_checks() if c.name == "sinh, relaxed"]
    finding = check.run(DeviceChoice("numpy"))
    assert finding.verdict == "differs"
    assert "units in the last place from" in finding.detail
    assert finding.ulp is not None
    assert finding.ulp > 4


def test_the_json_tells_the_device_and_no_folder(monkeypatch: Any, tmp_path: Path) -> None:
    keep(monkeypatch, "add-f")
    path = tmp_path / "c.json"
    assert cli.main(["certify", "--section", "conformance", "-o", str(path)]) == 0
    text = path.read_text()
    content = json.loads(text)
    assert sorted(content) == ["complete", "format", "full", "golden", "machine", "made", "targets", "verdict"]
    assert content["complete"]
    assert [t["backend"] for t in content["targets"]] == ["numpy", "opencl", "glsl"]
    for target in content["targets"]:
        assert sorted(target) == ["backend", "device", "lanes", "sections", "verdict"]
        assert target["device"]["name"]
        assert target["sections"]["conformance"]["checks"] == 1
        assert target["sections"]["conformance"]["findings"] == {"add-f": {"verdict": "same"}}
    assert content["machine"]["packages"]["numpy"] == np.__version__
    assert str(ROOT) not in text
    assert str(Path.home()) + "/" not in text
    assert [p.name for p in tmp_path.iterdir()] == ["c.json"]


def test_a_driver_that_fails_is_reported_and_the_rest_is_run() -> None:
    def fail(target: DeviceChoice) -> Finding:
        raise OSError("the driver is gone")

    section = Section("functions", "sweeps", None, [Check("a", fail), Check("b", lambda target: Finding("same"))])
    ran = SectionRun(section)
    run_section(ran, DeviceChoice("numpy"), full=False, progress=lambda *_: None)
    assert ran.findings["a"] == Finding("failed", "OSError: the driver is gone")
    assert not ran.findings["b"].wrong
    assert verdict([ran]) == "differs"


def test_checks_that_were_not_reached_are_counted_with_the_command_that_runs_them() -> None:
    checks = [Check(name, lambda target: Finding("same")) for name in "abc"]
    target = DeviceChoice("opencl", lanes=8)
    whole = SectionRun(Section("functions", "sweeps", -1, checks))
    run_section(whole, target, full=True, progress=lambda *_: None)
    assert "3 same (" in section_line(whole)
    assert left_line(whole, target) == []
    assert verdict_lines([whole]) == ["  -> same bits"]
    cut = SectionRun(whole.section, {"a": Finding("denormals")}, 60, cut=True)
    assert "1 same but for denormals, 2 not run (60 s)" in section_line(cut)
    command = "shpy certify --backend opencl --lanes 8 --section functions --full -o functions.json"
    assert left_line(cut, target) == [f"    to run all, in about 3 minutes: {command}"]
    said, meaning = verdict_lines([whole, cut])
    assert said == "  -> same bits but for denormals, in the 4 of 6 checks that were run"
    assert "1.18e-38" in meaning


def test_a_section_without_time_begins_nothing() -> None:
    ran = SectionRun(Section("functions", "sweeps", -1, [Check("a", lambda target: Finding("same"))]))
    run_section(ran, DeviceChoice("numpy"), full=False, progress=lambda *_: None)
    assert ran.cut
    assert ran.left == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--section", "poetry"], "there is no section 'poetry'"),
        (["--device", "0"], "--device and --lanes are of one backend"),
        (["--backend", "opencl", "--device", "99"], "there is no opencl device 99"),
        (["--backend", "glsl", "--lanes", "8"], "glsl has no lanes to choose"),
        (["--section", "inputs"], "section inputs takes hours"),
        (["-o", "nowhere/c.json"], "there is no folder nowhere"),
    ],
)
def test_options_that_do_not_fit_are_refused(words: list[str], said: str, capsys: Any) -> None:
    assert cli.main(["certify", *words]) == 2
    printed = capsys.readouterr()
    assert said in printed.err
    assert printed.out == ""


def test_ctrl_c_before_the_first_result_leaves_one_line_and_no_file(
    monkeypatch: Any, capsys: Any, tmp_path: Path
) -> None:
    monkeypatch.setattr(command, "sections", lambda *_: [Section("functions", "sweeps", None, [Check("a", interrupt)])])
    assert cli.main(["certify", "--backend", "numpy", "-o", str(tmp_path / "c.json")]) == 130
    assert capsys.readouterr().err == "shpy: stopped\n"
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_keeps_what_was_found(monkeypatch: Any, capsys: Any, tmp_path: Path) -> None:
    checks = [Check("a", lambda target: Finding("same")), Check("b", interrupt), Check("c", interrupt)]
    made = [Section("functions", "sweeps", None, checks), Section("accuracy", "bounds", None, checks)]
    monkeypatch.setattr(command, "sections", lambda *_: made)
    monkeypatch.setattr(command, "targets", lambda *_: [DeviceChoice("numpy"), DeviceChoice("glsl")])
    path = tmp_path / "c.json"
    assert cli.main(["certify", "-o", str(path)]) == 130
    said = capsys.readouterr()
    assert said.err == "shpy: stopped\n"
    assert "1 same, 2 not run" in said.out
    assert said.out.endswith(f"\n{path} holds what was found until it was stopped.\n")
    content = json.loads(path.read_text())
    assert not content["complete"]
    target, other = content["targets"]
    assert (target["verdict"], other["verdict"]) == ("same bits", "not run")
    assert target["sections"]["functions"]["findings"] == {"a": {"verdict": "same"}}
    assert [section["not run"] for section in target["sections"].values()] == [2, 3]


def interrupt(target: DeviceChoice) -> Finding:
    raise KeyboardInterrupt


def test_progress_tells_the_time_and_keeps_the_file(monkeypatch: Any, capsys: Any) -> None:
    now = [0.0]
    kept = []
    monkeypatch.setattr(command, "time", SimpleNamespace(monotonic=lambda: now[0]))
    shown = command._Progress("numpy, inputs", None, lambda: kept.append(now[0]))
    for number in range(4):
        shown("sin", number, 320)
        now[0] += 20
    assert kept == [40.0]
    assert capsys.readouterr().err == "numpy, inputs: 3 of 320 (about 1.8 hours left), sin\n"
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    command._Progress("glsl, conformance", 60, lambda: None)("add-f", 0, 9)
    assert capsys.readouterr().err == "\rglsl, conformance: 1 of 9 (0 of at most 60 s), add-f"


def test_pictures_are_not_rendered_where_there_is_no_ray_tracer(monkeypatch: Any) -> None:
    monkeypatch.setitem(sys.modules, "raytracer", None)
    finding = pictures.picture_checks()[0].run(DeviceChoice("numpy"))
    assert finding.verdict == "absent"
    assert "the ray tracer is not installed here" in finding.detail


# The golden file: `scripts/golden` writes it anew.


def test_every_check_of_bits_has_a_hash() -> None:
    assert sorted(golden()["functions"]) == sorted(functions.SWEPT)
    assert sorted(golden()["portable"]) == sorted(functions.PORTABLE) == sorted(TRANSCENDENTALS)
    assert sorted(golden()["examples"]) == sorted(pictures.EXAMPLES) == sorted(p.stem for p in KERNELS.glob("*.ir"))
    assert sorted(golden()["pictures"]) == sorted(pictures.SCENES)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", functions.SWEPT)
def test_the_hash_of_a_sweep_is_that_of_numpy(name: str) -> None:
    finding = results(functions.sweep_of(name), DeviceChoice("numpy"))
    assert digest(finding) == golden()["functions"][name], "run scripts/golden"


@pytest.mark.sampled(48)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
@pytest.mark.parametrize("name", functions.PORTABLE)
def test_the_bits_of_portable_mode_do_not_change(name: str, backend: str) -> None:
    """The hashes are those that strict mode had before its functions were correctly rounded."""
    check = next(check for check in functions.sweep_checks() if check.name == f"{name}, portable")
    assert check.run(DeviceChoice(backend)).verdict in ("same", "denormals")


def test_the_hashes_of_pictures_are_those_of_numpy() -> None:
    assert digest(results(pictures.example("marble"), DeviceChoice("numpy"))) == golden()["examples"]["marble"]
    assert digest(pictures.picture("boxes", "numpy").values()) == golden()["pictures"]["boxes"]


def test_the_kernels_are_those_of_the_examples() -> None:
    # An assignment here would name the slot of a join, which then stays: the maker's line has none.
    for name, program in runpy.run_path(str(ROOT / "scripts/golden"))["kernels"](ROOT / "examples").items():
        if name != "blur":  # its weights are constants that numpy computes, with errors of its own
            text = (KERNELS / f"{name}.ir").read_text()
            assert text == print_module(program.ir, names=False, locations=False), f"{name}: run scripts/golden"


def test_a_hash_tells_bits_apart_but_no_nan() -> None:
    zeros = np.zeros(3, np.float32)
    assert digest([zeros]) != digest([-zeros])
    assert digest([zeros]) != digest([zeros.astype(np.float64)])
    assert digest([zeros, zeros]) != digest([zeros])
    others = np.array([0x7FC00000, 0xFFC00001], np.uint32).view(np.float32)
    assert digest([others[:1]]) == digest([others[1:]])


def test_a_sweep_has_every_exponent_and_no_denormal() -> None:
    x = sweep(16)
    exponents, counts = np.unique(x.view(np.uint32) >> np.uint32(23), return_counts=True)
    assert len(exponents) == 512
    assert set(counts[1:256]) == {16}
    assert not ((x != 0) & (np.abs(x) < 2.0**-126)).any()
    a, b, c = pairs(1 << 12, 3, 3)
    assert len(a) == len(b) == len(c) > 4000


def test_any_beginning_of_the_conformance_list_holds_every_kind() -> None:
    cases = all_cases()
    first = sections.mixed(cases)[:64]
    assert {cases.index(case) * 8 // len(cases) for case in first} == set(range(8))


def test_refusals_that_name_other_functions_alone_are_one_reason() -> None:
    reasons = ["tan needs binary64", "GLSL has none", "pow needs binary64", "tan needs binary64"]
    together = "tan, pow needs binary64"
    assert grouped(reasons) == [together, "GLSL has none", together, together]
