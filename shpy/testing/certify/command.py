"""The command `shpy certify`: compare the devices of this machine with the bits that the package ships.

Stage: above all others. Takes the words of the command line, prints the report, gives the exit status.

    shpy certify                                   # every backend, on its first device
    shpy certify --backend opencl --device 1 -o certificate.json
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from shpy.backend.registry import NAMES, backend, backends
from shpy.errors import BackendUnavailable, ShpyError
from shpy.pictures.outputs import check_file, write_json
from shpy.testing.certify.findings import DeviceChoice, Section
from shpy.testing.certify.report import (
    certificate,
    device_lines,
    difference_lines,
    duration,
    left_line,
    section_line,
    verdict,
    verdict_lines,
)
from shpy.testing.certify.sections import INPUTS, SECTIONS, SectionRun, run_section, sections

_ABOUT = """\
Programs in strict mode, the default, give the same bits on every device. This runs programs whose results are known
on the devices below, and compares every bit."""
_OFTEN = 30.0
"""Seconds between the files that are written, and the lines of progress that are printed, while a section runs."""


def certify(options: argparse.Namespace) -> int:
    """Run the checks; 0 where every device gives the same bits, 1 where one differs, 2 for options that do not fit.

    After Ctrl-C the file holds what was found until then.
    """
    try:
        devices = targets(options.backend, options.device, options.lanes)
        names = chosen_sections(options.section, options.full)
        check_file(options.output)
    except ShpyError as error:
        print(f"shpy certify: {error}", file=sys.stderr)
        return 2
    checks = sections(names, options.full)
    print(_ABOUT)
    print(_expected(len(devices), checks, options.full), flush=True)
    results = {target: [SectionRun(section) for section in checks] for target in devices}

    def keep() -> None:
        write_json(options.output, certificate(results, options.full))

    try:
        for target, rans in results.items():
            _run(target, rans, options.full, keep)
    except KeyboardInterrupt:
        if any(ran.findings for rans in results.values() for ran in rans):
            keep()
            print(f"\n{options.output} holds what was found until it was stopped.", flush=True)
        raise
    keep()
    return _conclude(results, options.output)


def _expected(devices: int, checks: Sequence[Section], full: bool) -> str:
    """Return the estimated time and the way to stop, in words."""
    each = f"each of the {devices} devices" if devices > 1 else "the device"
    if any(section.name == INPUTS for section in checks):
        text = f"This takes hours for {each}: functions run on all 4,294,967,296 numbers."
    elif full:
        text = f"This runs all checks, which takes minutes for {each}, or an hour where a driver compiles slowly."
    else:
        text = f"This takes at most about two minutes for {each}, more on a simulator."
    return f"{text}\nCtrl-C ends it and keeps what was found."


def targets(name: str | None, device: int | None, lanes: int | None) -> list[DeviceChoice]:
    """Return the devices that are asked for: without a backend's name the first device of each backend.

    Raises ShpyError for a backend, a device or a width that is not there.
    """
    if name is None:
        if device is not None or lanes is not None:
            raise ShpyError("--device and --lanes are of one backend", cure=f"--backend {', '.join(NAMES[1:])}")
        return [DeviceChoice(candidate.name) for candidate in backends() if candidate.available]
    devices = backend(name).devices()
    if not 0 <= (device or 0) < len(devices):
        raise BackendUnavailable(
            f"there is no {name} device {device}", cure=f"--device 0 to {len(devices) - 1}: see shpy doctor"
        )
    if lanes not in (None, 1) and name != "opencl":
        raise ShpyError(f"{name} has no lanes to choose", cure="--backend opencl, or no --lanes")
    return [DeviceChoice(name, device, lanes)]


def chosen_sections(words: str | None, full: bool) -> list[str]:
    """Return the sections that are named, or all; ShpyError for an unknown one, and for one that takes hours."""
    names = words.split(",") if words is not None else list(SECTIONS)
    unknown = [name for name in names if name not in (*SECTIONS, INPUTS)]
    if unknown:
        raise ShpyError(f"there is no section {unknown[0]!r}", cure=", ".join((*SECTIONS, INPUTS)))
    if INPUTS in names and not full:
        raise ShpyError(f"section {INPUTS} takes hours", cure=f"--section {INPUTS} --full")
    return names


def _run(target: DeviceChoice, rans: Sequence[SectionRun], full: bool, keep: Callable[[], None]) -> None:
    """Run the sections and print what each finds, also where Ctrl-C ends it; `keep` writes the file meanwhile."""
    print("\n" + "\n".join(device_lines(target)), flush=True)
    for ran in rans:
        shown = _Progress(f"{target.backend}, {ran.section.name}", None if full else ran.section.seconds, keep)
        try:
            run_section(ran, target, full=full, progress=shown)
        finally:
            shown.clear()
            if ran.findings:
                lines = [section_line(ran), *left_line(ran, target), *difference_lines(ran)]
                print("\n".join(lines), flush=True)
    print("\n".join(verdict_lines(rans)), flush=True)


class _Progress:
    """Tells what is being run: on a terminal in a line that changes, elsewhere in a line now and then."""

    def __init__(self, what: str, limit: float | None, keep: Callable[[], None]) -> None:
        """`limit`: the seconds after which no check begins; `keep` is called now and then."""
        self.what = what
        self.limit = limit
        self.keep = keep
        self.width = 0
        self.started = self.kept = time.monotonic()

    def __call__(self, name: str, number: int, count: int) -> None:
        now = time.monotonic()
        rare = now - self.kept > _OFTEN
        if rare:
            self.kept = now
            self.keep()
        if sys.stderr.isatty():
            line = self._line(name, number, count, now - self.started)
            print(f"\r{line:{self.width}}", end="", file=sys.stderr, flush=True)
            self.width = len(line)
        elif rare and self.limit is None:
            print(self._line(name, number, count, now - self.started), file=sys.stderr, flush=True)

    def _line(self, name: str, number: int, count: int, seconds: float) -> str:
        time_ = ""
        if self.limit is not None:
            time_ = f" ({seconds:.0f} of at most {self.limit:.0f} s)"
        elif number and seconds > 5:
            time_ = f" (about {duration(seconds / number * (count - number))} left)"
        return f"{self.what}: {number + 1} of {count}{time_}, {name}"[:100]

    def clear(self) -> None:
        """Take the line away."""
        if self.width:
            print(f"\r{'':{self.width}}\r", end="", file=sys.stderr, flush=True)


def _conclude(results: dict[DeviceChoice, list[SectionRun]], path: Path) -> int:
    print(f"\n{path} holds every result.")
    wrong = [target.backend for target, rans in results.items() if verdict(rans) == "differs"]
    if wrong:
        print(
            f"DIFFERS: {', '.join(wrong)}, in what is named above. "
            f"Please open an issue and attach {path.name}: it holds all that is needed."
        )
        return 1
    verdicts = ", ".join(target.backend + verdict(rans).removeprefix("same bits") for target, rans in results.items())
    left = sum(ran.left for rans in results.values() for ran in rans)
    if left:
        print(
            f"SAME BITS: {verdicts}. {left:,} checks did not fit into their time; the lines above tell how to run them."
        )
    else:
        refused = sum(
            f.verdict == "refused" for rans in results.values() for ran in rans for f in ran.findings.values()
        )
        rest = f"{refused:,} checks were refused, as told above." if refused else "Nothing is left to do."
        print(f"SAME BITS: {verdicts}. {rest}")
    return 0
