"""Golden texts of small programs: the IR once it is tidied, and what each target is given.

They are read by people, not only compared.
"""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from backends import snapshot_programs
from backends.running import TARGETS
from texts import TEXTS

import shpy as sh
from shpy.backend.base import Options
from shpy.backend.opencl.device.driver import PACKET_TARGET
from shpy.backend.opencl.packets.kernel import print_packets
from shpy.backend.opencl.packets.prologue import Abilities
from shpy.passes.pipeline import optimise, prepare
from shpy.passes.precision import set_precision
from shpy.testing.conformance.catalogue import all_cases

PROGRAMS = {name: thing for name, thing in vars(snapshot_programs).items() if isinstance(thing, sh.Program)}
SUFFIX = {"numpy": "py", "opencl": "cl", "glsl": "glsl"}
FILE = Path(snapshot_programs.__file__)


@pytest.mark.parametrize("name", PROGRAMS)
def test_the_ir(name, snapshots):
    tidied = optimise(set_precision(PROGRAMS[name].ir, "f32"))
    snapshots.check(f"programs/{name}.ir", str(tidied).replace(str(FILE.parent) + "/", ""))


@pytest.mark.sampled(8)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", PROGRAMS)
def test_the_text_for(target, name, snapshots):
    """GLSL's is for a device without faults: others get corrections of their own."""
    program = PROGRAMS[name]
    text = TEXTS["glsl"](program.ir) if target == "glsl" else program.compile(target, lanes=1).source
    snapshots.check(f"programs/{name}.{SUFFIX[target]}", text)


@pytest.mark.parametrize("name", PROGRAMS)
def test_the_text_for_packets(name, snapshots):
    """Packets of eight elements for a compiler with OpenCL C alone; one text with its prologue, others without."""
    kernel = print_packets(prepare(PROGRAMS[name].ir, Options(), PACKET_TARGET).module, 8, Abilities())
    first = 0 if name == "mandelbrot" else next(at for at, loc in enumerate(kernel.lines) if loc)
    snapshots.check(f"programs/{name}.packets.cl", "\n".join(kernel.text.splitlines()[first:]) + "\n")


CONVERSION = next(case.program for case in all_cases() if case.name == "convert-d-h")
PRINTED = {name: PROGRAMS[name] for name in [*PROGRAMS][::2]}
PRINTED["conversion"] = CONVERSION  # whose packets need several structs of vectors
PRINTING = """
import hashlib, sys
from backends.test_snapshots import PRINTED, texts
for name in PRINTED:
    print(name, *(hashlib.sha256(text.encode()).hexdigest() for text in texts(name)))
"""


def texts(name):
    """The texts of a program for every target, OpenCL's at three widths."""
    module = PRINTED[name].ir
    yield TEXTS["numpy"](module)
    yield TEXTS["opencl"](module)
    if name in PROGRAMS:  # GLSL has no vectors of doubles
        yield TEXTS["glsl"](module)
    prepared = prepare(module, Options(), PACKET_TARGET).module
    for lanes in (8, 64):
        yield print_packets(prepared, lanes, Abilities()).text


def test_every_process_prints_the_same_texts():
    """Kernels are kept on disk under the hashes of their texts; the order of a set differs from process to process."""
    other = subprocess.run(
        [sys.executable, "-c", PRINTING],
        env={**os.environ, "PYTHONHASHSEED": "4", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    hashes = [" ".join((name, *(hashlib.sha256(t.encode()).hexdigest() for t in texts(name)))) for name in PRINTED]
    assert other.stdout.splitlines() == hashes


def test_a_kept_text_is_compared_and_written_when_asked(tmp_path, snapshots):
    kept = tmp_path / "kept.txt"
    kept.write_text("one two three")
    compare, update = type(snapshots)(update=False), type(snapshots)(update=True)
    compare.check_part(kept, "two", "two")
    with pytest.raises(AssertionError, match=r"kept\.txt is out of date: run pytest --update-snapshots"):
        compare.check_part(kept, "two", "2")
    assert kept.read_text() == "one two three"
    update.check_part(kept, "two", "2")
    assert kept.read_text() == "one 2 three"
    with pytest.raises(AssertionError, match="there is no snapshot nowhere"):
        compare.check("nowhere.txt", "text")
