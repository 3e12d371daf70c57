"""The sections of a certificate, and how one is run on a target.

Stage: test. By default a section ends after its seconds; its checks are in an order that mixes their kinds.

    ran = Ran(section)
    run_section(ran, target, full=False, progress=show)     # after Ctrl-C, `ran` holds what was found until then
"""

from __future__ import annotations

import functools
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import shpy
from shpy.errors import CompileError, ShpyWarning
from shpy.testing.certify.findings import Check, DeviceChoice, Finding, Section
from shpy.testing.certify.functions import bound_checks, input_checks, sweep_checks
from shpy.testing.certify.pictures import example_checks, picture_checks
from shpy.testing.conformance.cases import Case
from shpy.testing.conformance.catalogue import all_cases

SECTIONS: Final = ("conformance", "functions", "accuracy", "examples", "pictures")
INPUTS: Final = "inputs"
"""The section that takes hours: run with `--full` alone."""
_GOLDEN_RATIO: Final = 0.6180339887498949

Progress = Callable[[str, int, int], None]
"""Called with the name of a check before it is run, its number, and the number of checks."""


@dataclass
class SectionRun:
    """The findings of a section on a target so far, by the names of its checks, in `seconds`.

    `cut`: its time ended before its checks did.
    """

    section: Section
    findings: dict[str, Finding] = field(default_factory=dict)
    seconds: float = 0
    cut: bool = False

    @property
    def left(self) -> int:
        """The number of checks that were not run."""
        return len(self.section.checks) - len(self.findings)

    @property
    def wrong(self) -> dict[str, Finding]:
        """The findings that speak against the device."""
        return {name: finding for name, finding in self.findings.items() if finding.wrong}

    def count(self, verdict: str) -> int:
        """Count the checks with this verdict."""
        return sum(finding.verdict == verdict for finding in self.findings.values())


def sections(names: Sequence[str] = SECTIONS, full: bool = False) -> list[Section]:
    """Return the sections of these names, in their order; `full` adds INPUTS to all of SECTIONS."""
    result = []
    chosen = {*names, INPUTS} if full and set(names) == set(SECTIONS) else set(names)
    for name in (*SECTIONS, INPUTS):
        if name not in chosen:
            continue
        match name:
            case "conformance":
                checks = [Check(case.name, functools.partial(_conform, case)) for case in mixed(all_cases())]
                result.append(Section(name, "small programs with known results", 60, checks))
            case "functions":
                result.append(Section(name, "every exponent, and hard ones", 40, sweep_checks()))
            case "accuracy":
                result.append(Section(name, "errors in relaxed mode and at f64", 15, bound_checks()))
            case "examples":
                result.append(Section(name, "kernels of the examples", None, example_checks()))
            case "pictures":
                result.append(Section(name, "rendered scenes", None, picture_checks()))
            case "inputs":
                result.append(Section(name, "functions on all 4,294,967,296 numbers", None, input_checks()))
    return result


def mixed(cases: list[Case]) -> list[Case]:
    """Return the cases in an order in which any first part contains cases of all kinds."""
    order = sorted(range(len(cases)), key=lambda k: k * _GOLDEN_RATIO % 1)
    return [cases[k] for k in order]


def _conform(case: Case, target: DeviceChoice) -> Finding:
    wrong = case.difference(case.run(target.backend, **target.options), target.backend, **target.options)
    return Finding("differs", wrong) if wrong else Finding("same")


def run_section(ran: SectionRun, target: DeviceChoice, *, full: bool, progress: Progress) -> None:
    """Run the checks of a section, for its seconds or all of them, and keep in `ran` what each finds."""
    checks, limit = ran.section.checks, None if full else ran.section.seconds
    started = time.monotonic()
    try:
        for number, check in enumerate(checks):
            ran.seconds = time.monotonic() - started
            if limit is not None and ran.seconds > limit:
                ran.cut = True
                break
            progress(check.name, number, len(checks))
            ran.findings[check.name] = _guarded(check, target)
    finally:
        ran.seconds = time.monotonic() - started


def _guarded(check: Check, target: DeviceChoice) -> Finding:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ShpyWarning)
        finding = _finding(check, target)
    return replace(finding, warnings=tuple(_impersonal(str(warning.message)) for warning in caught))


def _finding(check: Check, target: DeviceChoice) -> Finding:
    # Drivers raise errors of any type, and the checks after them must still run.
    try:
        return check.run(target)
    except CompileError as error:
        return Finding("refused", _impersonal(error.message))
    except Exception as error:
        return Finding("failed", _impersonal(f"{type(error).__name__}: {error}"))


def _impersonal(text: str) -> str:
    """Return the text without the folders of this machine."""
    return text.replace(f"{Path(shpy.__file__).parents[1]}/", "").replace(str(Path.home()), "~")
