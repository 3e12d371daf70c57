"""The maintainer's command that writes the golden hashes anew, from numpy: run it where strict results change.

    python -m shpy.testing.certify --write-golden         # in the root of the repository, then read the diff

Stage: test. The kernels of the examples come from the folder `examples`, which is not installed with the package.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path
from typing import Any

from shpy.command import run
from shpy.programs import Program
from shpy.run.kernel import Kernel
from shpy.testing.certify import functions, golden, pictures
from shpy.testing.certify.findings import DeviceChoice


def kernels(folder: Path) -> dict[str, Program]:
    """Return the examples' kernels by name, recorded from the files in a folder."""
    sys.path.insert(0, str(folder))
    try:
        mandelbrot, planet, algebra, blur, life, nbody = (
            importlib.import_module(name) for name in ("mandelbrot", "planet", "algebra", "blur", "life", "nbody")
        )
    finally:
        sys.path.remove(str(folder))
    return {
        "mandelbrot": mandelbrot.palette << mandelbrot.mandelbrot,
        "planet": planet.planet,
        "marble": algebra.BALLS[2],
        "dents": algebra.BALLS[3],
        "blur": blur.gaussian(5),
        "life": life.generation,
        "nbody": _compiled(nbody.simulation(*nbody.galaxies(256), 0.01, "numpy")),
    }


def _compiled(advance: Any) -> Program:
    """Return the program whose kernel a function closes over."""
    contents = (cell.cell_contents for cell in advance.__closure__)
    return next(Program(value.recorded) for value in contents if isinstance(value, Kernel))


def hashes() -> dict[str, dict[str, str]]:
    """Return the golden hashes, as numpy gives them here."""
    here = DeviceChoice("numpy")
    return {
        "functions": {name: golden.digest(functions.sweep_of(name).run(here)) for name in functions.SWEPT},
        "portable": {
            name: golden.digest(functions.sweep_of(name, "portable").run(here)) for name in functions.PORTABLE
        },
        "examples": {name: golden.digest(pictures.example(name).run(here)) for name in pictures.EXAMPLES},
        "pictures": {name: golden.digest(pictures.picture(name, "numpy").values()) for name in pictures.SCENES},
    }


def main() -> int:
    """Write the golden file; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m shpy.testing.certify", description=__doc__.splitlines()[0])
    parser.add_argument("--write-golden", action="store_true", required=True, help="write golden.json and the kernels")
    parser.add_argument("--examples", type=Path, default=Path("examples"), help="their folder (default: examples)")
    options = parser.parse_args()
    pictures.record_examples(kernels(options.examples))
    golden.write(hashes())
    print(f"wrote {golden.FILE.name} and {len(pictures.EXAMPLES)} kernels: read the diff")
    return 0


if __name__ == "__main__":
    sys.exit(run("shpy.testing.certify", main))
