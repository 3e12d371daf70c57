"""First runs in a fresh process: nothing is known of a kernel's pace yet, so the runtime splits its runs."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from patience import HANGING

TESTS = Path(__file__).parent.parent
SCRIPT = """
import json, sys
import numpy as np
import shpy as sh

backend = sys.argv[1]
SHAPES = [64, 2100, 17_000, 2900, (33, 64), (17, 128), (65, 256), (129, 128), (1, 70_000), (1, 700), (3, 1, 5000)]
SHAPES = SHAPES[int(sys.argv[2]) :: int(sys.argv[3])]
wrong = {}


def adding(k):
    @sh.program
    def add(a: sh.Attrib1f) -> sh.Attrib1f:
        return a + k
    return add


def counting(k):
    @sh.program
    def count(n: sh.Attrib1i) -> sh.Attrib1i:
        sh.SH_DISCARD(n >= k)
        return n + 1
    return count


def placing(k, rank):
    @sh.program
    def place(a: sh.Attrib1f) -> sh.Attrib1f:
        at, all = sh.grid_index(rank), sh.grid_shape(rank)
        number = sh.Attrib1i(0)
        for axis in range(rank):
            number[:] = number * all[axis] + at[axis]
        return a + k * sh.Attrib1f(number)
    return place


# Every kernel is new: `k` stands in its text. Half of them begin over arrays, half over streams in a chain.
for k, shape in enumerate(SHAPES, 1):
    zeros = np.zeros(shape, np.float32)
    numbers = np.arange(zeros.size, dtype=np.float32).reshape(zeros.shape)
    add, place = adding(k), placing(k, zeros.ndim)
    for begin, run in (
        ("chain", lambda p: sh.repeat(p, 3).run(a=zeros, backend=backend).streams["a"].numpy()),
        ("arrays", lambda p: p.compile(backend)(p.compile(backend)(p.compile(backend)(zeros)))),
    ):
        p, q = (add, place) if begin == "chain" else (adding(-k), placing(-k, zeros.ndim))
        sign = 1 if begin == "chain" else -1
        for name, found, expected in (("add", run(p), 3 * k), ("place", run(q), 3 * k * numbers)):
            if (found != sign * expected).any():
                wrong[f"{name} {shape} {begin}"] = int((found != sign * expected).sum())
    result = sh.loop(counting(k)).run(n=np.zeros(shape, np.int32), backend=backend)
    if (result.streams["n"].numpy() != k).any() or result.counts["count"] != k * zeros.size:
        wrong[f"loop {shape}"] = result.counts
print(json.dumps(wrong))
"""


@pytest.mark.slow
@pytest.mark.parametrize("part", ["0::2", pytest.param("1::2", marks=pytest.mark.slow)])
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_first_runs_of_kernels_and_chains(backend, part):
    environment = os.environ | {"PYTHONPATH": str(TESTS.parent), "SHPY_CACHE_DIR": ""}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, backend, *part.split("::")],
        env=environment,
        text=True,
        capture_output=True,
        timeout=HANGING,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {}


IMPORTING = """
import sys, threading
seen = []


class Watch:
    def find_spec(self, name, *rest):
        if name == "pyopencl":
            seen.append(threading.current_thread() is threading.main_thread())


sys.meta_path.insert(0, Watch())
import shpy as sh

print(sh.program(lambda: sh.Attrib1f(2)).compile("opencl")(), seen)
"""


def test_the_first_use_of_opencl_starts_its_library_on_another_thread():
    """There Ctrl-C cannot interrupt the start of an extension in C, which would end the process."""
    done = subprocess.run([sys.executable, "-c", IMPORTING], capture_output=True, text=True, timeout=HANGING)
    assert (done.stdout, done.stderr) == ("2.0 [False]\n", "")
