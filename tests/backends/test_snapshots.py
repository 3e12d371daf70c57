"""Golden texts of small programs: the IR once it is tidied, and what each target is given.

They are read by people, not only compared.
"""

from pathlib import Path

import pytest
from backends import snapshot_programs
from backends.running import TARGETS

import shpy as sh
from shpy.backends.base import Options
from shpy.backends.opencl.packet_prologue import Abilities
from shpy.backends.opencl.packets import print_packets
from shpy.backends.opencl.runtime import PACKET_TARGET
from shpy.passes.pipeline import optimise, prepare
from shpy.passes.precision import set_precision

PROGRAMS = {name: thing for name, thing in vars(snapshot_programs).items() if isinstance(thing, sh.Program)}
SUFFIX = {"numpy": "py", "opencl": "cl", "glsl": "glsl"}
FILE = Path(snapshot_programs.__file__)


@pytest.mark.parametrize("name", PROGRAMS)
def test_the_ir(name, snapshots):
    tidied = optimise(set_precision(PROGRAMS[name].ir, "f32"))
    snapshots.check(f"programs/{name}.ir", str(tidied).replace(str(FILE.parent) + "/", ""))


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", PROGRAMS)
def test_the_text_for(target, name, snapshots):
    snapshots.check(f"programs/{name}.{SUFFIX[target]}", PROGRAMS[name].compile(target, lanes=1).source)


@pytest.mark.parametrize("name", PROGRAMS)
def test_the_text_for_packets(name, snapshots):
    """Of eight elements, for a compiler that has OpenCL C and nothing besides; one with its prologue, others not."""
    kernel = print_packets(prepare(PROGRAMS[name].ir, Options(), PACKET_TARGET).module, 8, Abilities())
    first = 0 if name == "mandelbrot" else next(at for at, loc in enumerate(kernel.lines) if loc)
    snapshots.check(f"programs/{name}.packets.cl", "\n".join(kernel.text.splitlines()[first:]) + "\n")
