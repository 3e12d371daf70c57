"""The command `shpy certify`: whether the devices of this machine give the bits that the package ships.

Stage: above all others. Takes the words of the command line, prints the report, gives the exit status.

    shpy certify                                   # every backend, on its first device
    shpy certify --backend opencl --device 1 -o certificate.json
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from shpy.accuracy.files import check_file, write_json
from shpy.backends.registry import NAMES, backend, backends
from shpy.errors import BackendUnavailable, ShpyError
from shpy.testing.certify.findings import Section, Target
from shpy.testing.certify.report import certificate, device_lines, difference_lines, section_line, verdict
from shpy.testing.certify.sections import SECTIONS, Ran, run_section, sections

__all__ = ["certify", "chosen_sections", "targets"]

_ABOUT = """\
Programs in strict mode, the default, give the same bits on every device. This runs programs whose results are known
on the devices below, and compares every bit."""


def certify(options: argparse.Namespace) -> int:
    """Run the checks; 0 where every device gives the same bits, 1 where one differs, 2 for options that do not fit."""
    try:
        wanted = targets(options.backend, options.device, options.lanes)
        names = chosen_sections(options.section)
        check_file(options.output)
    except ShpyError as error:
        print(f"shpy certify: {error}", file=sys.stderr)
        return 2
    made = sections(names, options.full)
    print(_ABOUT)
    print(_expected(len(wanted), options.full), flush=True)
    found = {target: _run(target, made, options.full) for target in wanted}
    write_json(options.output, certificate(found, options.full))
    return _conclude(found, options.output)


def _expected(devices: int, full: bool) -> str:
    """How long it will take, in words."""
    if full:
        return "With --full this takes hours: every function of one argument runs on all 4,294,967,296 numbers."
    return f"This takes at most about two minutes for {'each device' if devices > 1 else 'the device'}."


def targets(name: str | None, device: int | None, lanes: int | None) -> list[Target]:
    """The devices that are asked for: without a backend's name the first device of each backend.

    Raises ShpyError for a backend, a device or a width that is not there.
    """
    if name is None:
        if device is not None or lanes is not None:
            raise ShpyError("--device and --lanes are of one backend", cure=f"--backend {', '.join(NAMES[1:])}")
        return [Target(found.name) for found in backends() if found.available]
    known = backend(name).devices()
    if not 0 <= (device or 0) < len(known):
        raise BackendUnavailable(
            f"there is no {name} device {device}", cure=f"--device 0 to {len(known) - 1}: see shpy doctor"
        )
    if lanes not in (None, 1) and name != "opencl":
        raise ShpyError(f"{name} has no lanes to choose", cure="--backend opencl, or no --lanes")
    return [Target(name, device, lanes)]


def chosen_sections(words: str | None) -> list[str]:
    """The sections that are named, or all; ShpyError for a name that is none."""
    names = words.split(",") if words is not None else list(SECTIONS)
    unknown = [name for name in names if name not in SECTIONS]
    if unknown:
        raise ShpyError(f"there is no section {unknown[0]!r}", cure=", ".join(SECTIONS))
    return names


def _run(target: Target, made: Sequence[Section], full: bool) -> list[Ran]:
    print("\n" + "\n".join(device_lines(target)), flush=True)
    rans = []
    for section in made:
        shown = _Progress(f"{target.backend}, {section.name}")
        try:
            ran = run_section(section, target, full=full, progress=shown)
        finally:
            shown.clear()
        print("\n".join([section_line(ran), *difference_lines(ran)]), flush=True)
        rans.append(ran)
    print(f"  -> {verdict(rans)}", flush=True)
    return rans


class _Progress:
    """A line on a terminal that tells what is being run; nothing elsewhere."""

    def __init__(self, what: str) -> None:
        self.what = what
        self.width = 0

    def __call__(self, name: str, number: int, count: int) -> None:
        if sys.stderr.isatty():
            line = f"{self.what}: {number + 1} of {count}, {name}"[:100]
            print(f"\r{line:{self.width}}", end="", file=sys.stderr, flush=True)
            self.width = len(line)

    def clear(self) -> None:
        """Take the line away."""
        if self.width:
            print(f"\r{'':{self.width}}\r", end="", file=sys.stderr, flush=True)


def _conclude(found: dict[Target, list[Ran]], path: Path) -> int:
    wrong = [target.backend for target, rans in found.items() if verdict(rans) == "differs"]
    print(f"\n{path} holds every result.")
    if wrong:
        print(f"DIFFERS: {', '.join(wrong)}. Please open an issue and attach {path.name}: it is all that is needed.")
        return 1
    said = [target.backend + verdict(rans).removeprefix("same bits") for target, rans in found.items()]
    print(f"SAME BITS: {', '.join(said)}. Nothing is left to do.")
    return 0
