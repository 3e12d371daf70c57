"""The commands `shpy accuracy` and `shpy tradeoff`.

Stage: above all others. Takes the arguments of the command line, prints, and returns the exit status.

    shpy accuracy examples/trace.py:cube_root --domain a=1:8 -o error.png
    shpy tradeoff package.module:program --error 2ulp --domain x=1e-3:1e3:log -o t.png
"""

from __future__ import annotations

import argparse
import importlib
import math
import runpy
import sys
import traceback
from pathlib import Path
from typing import Any

from shpy.accuracy.measuring import measure
from shpy.accuracy.rounding_lines import roundings
from shpy.accuracy.tradeoffs import tradeoff
from shpy.choices import Choice, combinations
from shpy.command import MOST, progress_lines, whole
from shpy.errors import ShpyError
from shpy.files import import_from
from shpy.ir.types import Base
from shpy.lang.data.tables import TableType
from shpy.lang.data.textures import TextureType
from shpy.lang.values.structure import leaves
from shpy.pictures.outputs import check_output, write_json
from shpy.programs import Program
from shpy.units import Budget

_COUNT, _SEED = whole(1, MOST), whole(0)
_USUAL = (-10.0, 10.0)
"""The default range of a float."""


def add_commands(commands: Any) -> None:
    """Add both to the commands of `shpy`."""
    accuracy = commands.add_parser("accuracy", help="measure the errors of a program on every backend")
    _add_shared(accuracy, 2000)
    accuracy.add_argument("--precision", default="f32", help="f32,f64,f16 (default: f32)")
    accuracy.add_argument(
        "--lines", nargs="?", const="", metavar="OUTPUT", help="also name the lines that lose the digits of one output"
    )
    accuracy.set_defaults(run=lambda options: _guarded(_accuracy, options))
    trade = commands.add_parser(
        "tradeoff", help="measure time and error of every variant, and choose the fastest within an error"
    )
    _add_shared(trade, 1000)
    trade.add_argument("--error", required=True, type=_budget, help="the most that is wanted: 2ulp, 1e-3 (relative)")
    trade.add_argument("--precision", default="f32,f16,f64", help="f32,f64,f16 (default: all)")
    trade.add_argument("--elements", type=_COUNT, default=100_000, help="how many elements are timed (default: 100000)")
    trade.set_defaults(run=lambda options: _guarded(_tradeoff, options))


def _budget(text: str) -> Budget:
    try:
        return Budget.parse(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"an error such as 2ulp, or 1e-3 for a relative one, not {text!r}") from None


def _add_shared(command: argparse.ArgumentParser, samples: int) -> None:
    command.add_argument("program", help="module:name, or path/to/file.py:name, of a program or a choice")
    command.add_argument(
        "--domain", action="append", default=[], metavar="NAME=LO:HI[:log]", help="an input's range (default: -10:10)"
    )
    command.add_argument("--backends", help="numpy,opencl,glsl (default: each that is available)")
    command.add_argument("--math", help="strict,portable,relaxed,fast (default: each)")
    command.add_argument(
        "--fuse", action="store_true", help="strict and portable mode with a * b + c rounded once, too"
    )
    command.add_argument("--reference", default="mpmath", choices=("mpmath", "f64"), help="(default: mpmath)")
    command.add_argument("--samples", type=_COUNT, default=samples, help=f"elements of the domain (default: {samples})")
    command.add_argument("--seed", type=_SEED, default=0, help="of the inputs (default: 0)")
    command.add_argument("-o", "--output", type=Path, help="a picture, with JSON beside it; or JSON alone")


def _guarded(command: Any, options: argparse.Namespace) -> int:
    try:
        if options.output is not None:
            check_output(options.output)
        status: int = command(options)
        return status
    except BrokenPipeError:
        raise
    except (ShpyError, OSError, ValueError) as error:
        print(f"shpy {options.command}: {error}", file=sys.stderr)
        return 2


def _accuracy(options: argparse.Namespace) -> int:
    program = next(combinations(load(options.program)))[1]
    shared = _shared(options, program)
    report = measure(program, **shared)
    print(report.table())
    _write(report, options.output)
    if options.lines is not None:
        drawn = {name: shared[name] for name in ("domain", "samples", "seed")}
        print(roundings(program, output=options.lines or None, **drawn))
    return 0


def _tradeoff(options: argparse.Namespace) -> int:
    program = load(options.program)
    result = tradeoff(
        program,
        budget=options.error,
        elements=options.elements,
        progress=progress_lines("variants and rounds of timing"),
        **_shared(options, program),
    )
    print(result.table())
    _write(result, options.output)
    try:
        print(f"the pick for {options.error}: {result.pick}")
    except ShpyError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _shared(options: argparse.Namespace, program: Program | Choice) -> dict[str, Any]:
    return {
        "domain": parse_domain(options.domain, next(combinations(program))[1]),
        "backends": options.backends.split(",") if options.backends else None,
        "math": options.math.split(",") if options.math else None,
        "fuse": (False, True) if options.fuse else False,
        "precision": options.precision.split(","),
        "reference": options.reference,
        "samples": options.samples,
        "seed": options.seed,
    }


def _write(result: Any, path: Path | None) -> None:
    if path is None:
        return
    if path.suffix == ".json":
        write_json(path, result.json())
    else:
        result.plot(path)


def load(words: str) -> Program | Choice:
    """Return the program or choice that `module:name` or `path.py:name` names.

    Raises ShpyError where there is none, and where the module fails, with the line.
    """
    where, _, name = words.rpartition(":")
    if not where or not name:
        raise ShpyError(f"{words!r} names no program", cure="module:program, or path/to/file.py:program")
    namespace = _run_module(where)
    program = namespace.get(name)
    if not isinstance(program, Program | Choice):
        programs = [n for n, v in namespace.items() if isinstance(v, Program | Choice)]
        raise ShpyError(f"{where} has no program {name!r}", cure=", ".join(f"{where}:{n}" for n in programs) or None)
    return program


def _run_module(where: str) -> dict[str, Any]:
    """Return the names that a file or module defines."""
    is_file = where.endswith(".py")
    if is_file and not Path(where).is_file():
        raise ShpyError(f"there is no file {where}", cure="module:program, or path/to/file.py:program")
    if not (is_file or all(part.isidentifier() for part in where.split("."))):
        raise ShpyError(f"{where} is no name of a module", cure="module:program, or path/to/file.py:program")
    try:
        if is_file:
            import_from(Path(where).resolve().parent)
            return runpy.run_path(where)
        sys.path.insert(0, "")
        return vars(importlib.import_module(where))
    except ShpyError:
        raise  # the error names its line
    except SyntaxError as error:
        raise ShpyError(f"{error.filename}:{error.lineno}: {type(error).__name__}: {error.msg}") from error
    except ImportError as error:
        if not is_file and error.name in (None, where, where.partition(".")[0]):
            raise ShpyError(f"{where} cannot be imported: {error}", cure="path/to/file.py:program") from error
        raise _at_its_line(error) from error
    except (Exception, SystemExit) as error:  # whatever the user's own lines raise
        raise _at_its_line(error) from error


def _at_its_line(error: BaseException) -> ShpyError:
    """Return an error that names the last line outside of Python's import."""
    lines = [s for s in traceback.extract_tb(error.__traceback__) if not s.filename.startswith("<frozen")]
    return ShpyError(f"{lines[-1].filename}:{lines[-1].lineno}: {type(error).__name__}: {error}")


def parse_domain(ranges: list[str], program: Program) -> dict[str, Any]:
    """Read each `NAME=LO:HI[:log]`; other inputs get -10 to 10, ints 0 to 100.

    Raises ShpyError for words that are no range of an input, and for a program that takes tables.
    """
    inputs = program.recorded.inputs
    layouts = {name: t for name, t in inputs.items() if not isinstance(t, TableType | TextureType)}
    flat = [leaf for name, layout in layouts.items() for leaf, _, _ in leaves(layout, name)]
    domain: dict[str, Any] = {}
    for words in ranges:
        name, _, spoken = words.partition("=")
        parts = spoken.split(":")
        try:
            low, high = float(parts[0]), float(parts[1])
            if not math.isfinite(high - low) or low > high or parts[2:] not in ([], ["log"]):
                raise ValueError("a range has two ends")
        except (ValueError, IndexError):
            raise ShpyError(f"--domain {words!r} is no range", cure="--domain x=1e-3:1e3:log") from None
        if name not in inputs and name not in flat:
            listing = f"whose inputs are {', '.join(flat)}" if flat else "which has none"
            raise ShpyError(
                f"--domain {words!r}: {name or 'an empty name'} is no input of {program.name}, {listing}",
                cure=f"--domain {flat[0]}={spoken}" if flat else "no --domain",
            )
        domain[name] = (low, high, *parts[2:])
    for name, layout in program.recorded.inputs.items():
        if isinstance(layout, TableType | TextureType):
            raise ShpyError(f"{name} is a table, which no range describes", cure=f"program.bind({name}=table)")
        for leaf, _, cls in leaves(layout, name):
            if leaf not in domain and name not in domain:
                domain[leaf] = _USUAL if cls.type.is_float else (0, 100) if cls.type.base is not Base.B else (0, 1)
    return domain
