"""The conformance list on every driver that is installed: no result differs in a bit, and nothing ends the process."""

import json
import subprocess
from pathlib import Path
from typing import Any

import drivers
import pytest
from drivers import DRIVERS, Driver, Report, cases_of, certify, run, write_certified


def test_a_row_tells_what_is_corrected_refused_and_wrong():
    notes = ["this device gets fma wrong: strict mode corrects it", "this device flushes denormals to zero"]
    refused = "refused: D has no f64"
    report = Report("D", "1.0", notes, {"one": "same", "two": refused, "three": "wrong: 1, not 2", "four": refused})
    assert report.faults == ["three: wrong: 1, not 2"]
    assert report.row(Driver("driver", "opencl-1")) == (
        f"| driver | D, 1.0 | same bits: 1 programs (4 of {len(cases_of('opencl-1'))} were run); "
        "corrected: gets fma wrong (strict mode corrects it); flushes denormals to zero; "
        "refused: has no f64 (2 programs); three: wrong: 1, not 2 |"
    )


def test_a_row_tells_what_certify_said(monkeypatch: Any, tmp_path: Path) -> None:
    ok, other = {"verdict": "same"}, {"verdict": "differs"}
    sections = {
        "functions": {"findings": {"sin": ok, "cos": {"verdict": "denormals"}}, "not run": 3, "seconds": 39.6},
        "accuracy": {"findings": {"exp, f64": {"verdict": "refused"}}, "not run": 0, "seconds": 2.0},
    }
    target = {"verdict": "same bits but for denormals", "sections": sections}

    def report(command: list[str], **_: Any) -> Any:
        Path(command[-1]).write_text(json.dumps({"targets": [target]}))

    monkeypatch.setattr(subprocess, "run", report)
    driver = next(d for d in DRIVERS if d.name == "llvmpipe")
    row = certify(driver)
    assert row == "| llvmpipe | same bits but for denormals | 2 | 1 | 3 | 42 |"
    sections["functions"]["findings"]["exp"] = other  # type: ignore[index]
    target["verdict"] = "differs"
    assert certify(driver).startswith("| llvmpipe | differs: exp | 2 | 1 |")

    document = tmp_path / "certify.md"
    head = "# Text\n\n| --- | --- | ---: | ---: | ---: | ---: |\n"
    document.write_text(f"{head}| PoCL | old | 1 | 0 | 0 | 2 |\n| llvmpipe | old | 1 | 0 | 0 | 2 |\n")
    monkeypatch.setattr(drivers, "CERTIFIED", document)
    write_certified(row)
    assert document.read_text() == f"{head}{row}\n| PoCL | old | 1 | 0 | 0 | 2 |\n"


@pytest.mark.slow
@pytest.mark.parametrize("driver", [d for d in DRIVERS if d.installed], ids=lambda d: d.name)
def test_a_driver_gives_the_same_bits_or_refuses(driver: Driver) -> None:
    report = run(driver)
    assert not report.faults
    assert report.outcomes
