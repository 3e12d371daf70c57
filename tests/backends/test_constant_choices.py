"""A bool that chooses between two constant vectors, on OpenCL.

The code generator of LLVM 15, with which PoCL 3.1 compiles, ends the process over a bool that chooses between constant
masks of three. So the programs run in a process of their own.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from patience import HANGING

MASKS = """
    chosen = sh.cond(sh.cond(x < y, sh.Attrib3b(False, True, False), sh.Attrib3b(True, True, True)), 1.0, v)
"""
INTS = """
    chosen = sh.cond(sh.cond(x < y, sh.Attrib3i(0, 5, 7), sh.Attrib3i(1, 2, 8)) > 3, 1.0, sh.Attrib3f(y))
"""
NESTED = """
    inner = sh.cond(v.z < x, sh.Attrib3b(True, False, False), sh.Attrib3b(False, True, True))
    chosen = sh.cond(sh.cond(x < y, sh.Attrib3b(False, True, False), inner), 1.0, sh.Attrib3f(y))
"""
UNIFORM = """
    chosen = sh.cond(sh.cond(threshold < 2, sh.Attrib3b(False, True, False), sh.Attrib3b(True, True, True)), 1.0, v)
"""
PROGRAM = """
import numpy as np
import shpy as sh

print("{name}", flush=True)
threshold = sh.Param(sh.Attrib1f, 1.0)

@sh.program
def choice(x: sh.Attrib1f, v: sh.Attrib3f):
    y = v.y
    {body}
    return chosen

x = np.float32([-1, 0, 1, 2])
v = np.float32([[0, 1, 2], [3, 0, -1], [1, 1, 1], [0, 3, 5]])
expected = np.asarray(choice.compile("numpy")(x, v))
found = np.asarray(choice.compile("opencl", lanes=1)(x, v))
assert found.shape == (4, 3) and found.tobytes() == expected.tobytes(), (found, expected)
"""


BODIES = {"masks": MASKS, "ints": INTS, "nested": NESTED, "uniform": UNIFORM}


def test_choices_of_constant_vectors_of_three_compile(tmp_path: Path) -> None:
    """One process compiles all of them. It prints the name of each before, so the last one is that which ended it."""
    file = tmp_path / "choice.py"
    file.write_text("".join(PROGRAM.format(name=name, body=body.strip()) for name, body in BODIES.items()))
    done = subprocess.run([sys.executable, file], capture_output=True, text=True, timeout=HANGING)
    assert (done.returncode, done.stdout.split()) == (0, list(BODIES)), done.stderr
