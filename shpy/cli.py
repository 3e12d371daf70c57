"""The command `shpy`: show the backends of this machine, compare programs between backends, measure and view them.

Stage: above all others. Takes the arguments of the command line, prints, and returns the exit status.

    shpy --version
    shpy doctor                                   # status 0 if numpy works; it needs no driver
    shpy doctor --all                             # status 0 only where every backend works
    shpy diff a.ir --backends numpy,opencl        # status 1 with the first statement at which two of them diverge
    shpy certify                                  # status 1 where a device gives other bits than the package ships
    shpy accuracy module:program                  # errors in ULP on every backend
    shpy tradeoff module:program --error 2ulp -o t.png
    shpy view shader.py                           # a live page, recorded again on save
"""

from __future__ import annotations

import argparse
import platform
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

import shpy as sh
from shpy.accuracy.commands import add_commands
from shpy.backend.registry import NAMES
from shpy.command import MOST, add_completion, real, run, whole
from shpy.ir.traverse import grid_rank
from shpy.packages import DISTRIBUTION, extras, install, installed
from shpy.view.command import add_view

_LONGEST = 1 << 26
"""The most characters of an IR text that are read."""
_WIDTH = 8
"""Columns of a name, so that the texts beside the names line up."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return the exit status: 0 if all that was asked for is available, else 1; 130 after Ctrl-C."""
    return run("shpy", lambda: _run(arguments))


def _run(arguments: Sequence[str] | None) -> int:
    parser = argparse.ArgumentParser(prog="shpy", description="Kernels written once in Python, run on every target.")
    parser.add_argument("--version", action="version", version=f"shpy {installed(DISTRIBUTION) or 'not installed'}")
    add_completion(parser)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    command = commands.add_parser("doctor", help="what is installed, what is missing, and the command that mends it")
    command.add_argument("--all", action="store_true", help="exit with status 1 unless every backend works")
    command.set_defaults(run=lambda options: doctor(every=options.all))
    _add_diff(commands)
    _add_certify(commands)
    add_commands(commands)
    add_view(commands)
    options = parser.parse_args(arguments)
    status: int = options.run(options)
    return status


def _add_diff(commands: Any) -> None:
    command = commands.add_parser(
        "diff", help="compare an IR text on every backend, and name the statement where they diverge"
    )
    command.add_argument("ir", type=Path, help="a file with the text of a program's IR, or - for standard input")
    command.add_argument(
        "--backends", help="numpy,opencl,glsl,interpreter or a width: opencl-4 (default: each there is)"
    )
    command.add_argument("--ulp", type=real(0), default=0, help="how far apart results may be (default: the same bits)")
    command.add_argument("--count", type=whole(1, MOST), default=64, help="elements to run (default: 64)")
    command.add_argument("--seed", type=whole(0), default=0, help="of the inputs (default: 0)")
    command.add_argument("--precision", default="f32", help="the working precision (default: f32)")
    command.add_argument("--math", default="strict", help="strict, portable, relaxed or fast (default: strict)")
    command.add_argument("--fuse", action="store_true", help="round a * b + c once, with the same bits everywhere")
    command.set_defaults(run=diff)


def _add_certify(commands: Any) -> None:
    command = commands.add_parser(
        "certify",
        help="test whether the devices of this machine compute the bits that the package ships",
        description="Run programs whose results are known, print a report, and write it as JSON for an issue.",
    )
    command.add_argument("--backend", choices=NAMES, help="the backend to check (default: each that is available)")
    command.add_argument("--device", type=whole(0), help="the number of its device, as shpy doctor counts (default: 0)")
    command.add_argument("--lanes", type=int, choices=(1, 4, 8, 16, 32, 64), help="opencl: lanes that run together")
    command.add_argument(
        "--section",
        help="of conformance,functions,accuracy,examples,pictures, with commas between them (default: all); or inputs",
    )
    command.add_argument(
        "--full",
        action="store_true",
        help="all checks without a limit of time, and functions of one argument on all 2**32 inputs: hours",
    )
    command.add_argument(
        "-o", "--output", type=Path, default=Path("certificate.json"), help="(default: certificate.json)"
    )
    command.set_defaults(run=certify)


def certify(options: argparse.Namespace) -> int:
    """Check the devices; 0 where they give the same bits, 1 where one does not, 2 for options that do not fit."""
    from shpy.testing.certify.command import certify

    return certify(options)


def diff(options: argparse.Namespace) -> int:
    """Print whether a program in the form of IR text agrees on the backends; 0 if so, 1 if not, 2 for a bad text."""
    from shpy import testing

    try:
        program = sh.Program.from_ir(sh.parse(_read(options.ir)))
        names = options.backends.split(",") if options.backends else None
        rank = grid_rank(program.ir) or 1
        shape = (max(1, round(options.count ** (1 / rank))),) * rank
        # Beyond one axis, inputs are the same for every element, so elements are told apart by their index.
        inputs = testing.inputs(program, options.count if rank == 1 else 1, options.seed)
        settings = {name: getattr(options, name) for name in ("ulp", "precision", "math", "fuse")}
        print(testing.assert_equivalent(program, *inputs, backends=names, shape=shape, **settings))
    except AssertionError as difference:
        print(difference)
        return 1
    except BrokenPipeError:
        raise
    except (OSError, UnicodeDecodeError, sh.ShpyError) as error:
        print(f"shpy diff: {error}", file=sys.stderr)
        return 2
    return 0


def _read(path: Path) -> str:
    """Return the text of a file, or of standard input for "-"; ShpyError if it is longer than `_LONGEST` characters."""
    with nullcontext(sys.stdin) if str(path) == "-" else path.open() as file:
        text = file.read(_LONGEST + 1)
    if len(text) > _LONGEST:
        raise sh.ShpyError(f"{path} is longer than {_LONGEST} characters", cure="the IR text of one program")
    return text


def doctor(every: bool = False) -> int:
    """Print what is there and what is missing; 0 where numpy works (with `every`: each backend), else 1."""
    print(f"shpy {installed(DISTRIBUTION) or '(not installed)'} on Python {platform.python_version()}")
    for package in ("numpy", "lark"):
        print(f"  {package:{_WIDTH}} {installed(package)}")
    print("\nbackends")
    faults = {backend.name: _examine(backend) for backend in sh.backends()}
    for extra, packages in extras().items():
        print(f"\noptional: {extra}")
        missing = [package for package in packages if installed(package) is None]
        for package in packages:
            print(f"  {package:{_WIDTH}} {installed(package) or 'missing'}")
        if missing:
            print(f"  to install: {install(*missing)}")
    broken = [name for name, fault in faults.items() if fault]
    try:
        default, wrong = f"the default is {sh.default_backend()}: {sh.default_backend().why}", False
    except sh.ShpyError as error:
        default, wrong = str(error), True
    print(f"\n{len(faults) - len(broken)} of {len(faults)} backends work; {default}")
    return int(wrong or (bool(broken) if every else "numpy" in broken))


def _examine(backend: sh.BackendInfo) -> str | None:
    """Try a backend and print its devices and its state; return the fault, None if it works."""
    fault, cure = backend.reason, backend.cure
    if fault is None:
        fault = try_out(backend.name)
    print(f"  {backend.name:{_WIDTH}} {'works' if fault is None else fault}")
    for number, device in enumerate(backend.devices):
        lines = [f"device {number}: {device.name}", device.version, ", ".join(device.features), *device.notes]
        print("\n".join(f"{'':{_WIDTH + 3 + (2 if k else 0)}}{line}" for k, line in enumerate(lines) if line))
    if cure:
        print(f"{'':{_WIDTH + 3}}to mend it: {cure}")
    return fault


def try_out(backend: str) -> str | None:
    """Compile and run a small program; return the error, or None."""

    @sh.program
    def line(x: sh.Attrib1f) -> sh.Attrib1f:
        return sh.Attrib1f(2 * x + 1)

    # Drivers raise errors of any type, and `doctor` must survive them.
    try:
        values = line.compile(backend)(np.arange(5))
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None if np.array_equal(values, [1, 3, 5, 7, 9]) else f"2 * x + 1 of 0 to 4 gave {values}"
