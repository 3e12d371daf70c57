"""Runs of other sizes need no other code: a driver that generates code in the middle of runs stops them for seconds.

PoCL keeps what it generates in a folder, one file for each kernel, size of group and kind of launch. So a
script with an empty folder says after which run there was another file.
"""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from patience import HANGING

import shpy as sh
from shpy.backend.opencl.device.driver import machine_of

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
SCRIPT = """
import json, os, pathlib
import numpy as np
import shpy as sh
from shpy import SH_DISCARD

@sh.program
def double(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * 2

@sh.program
def positive(x: sh.Attrib1f) -> sh.Attrib1f:
    SH_DISCARD(x < 0)
    return x * 2

def code():
    folder = pathlib.Path(os.environ["POCL_CACHE_DIR"])
    return sorted("/".join(path.parts[-3:-1]) for path in folder.rglob("*.so") if path.stem[:4] not in ("try_", "prob"))

SIZES = 10, 1000, 1001, 1009, 70_000, 1_200_000, 17
made = {}

def after(name, run):
    before = code()
    for size in SIZES:
        run(size)
        found, before = [c for c in code() if c not in before], code()
        made.setdefault(name, []).append(found)

for lanes in (1, 8):
    kernel = double.compile("opencl", lanes=lanes)
    after(f"{lanes} lanes", lambda size: kernel(np.ones(size, np.float32)))

kept = positive.compile("opencl", lanes=8)

def keep_positive(size):
    x = np.where(np.arange(size) % 3, 1, -1).astype(np.float32)
    result = kept.run(sh.Stream(x, sh.Attrib1f, "opencl"))
    assert int(result.count) == np.count_nonzero(x > 0)

after("statuses", keep_positive)
x = sh.Stream(np.ones(1_300_000, np.float32), sh.Attrib1f, "opencl")
after("lists", lambda size: kernel.run(x, where=sh.Stream(np.arange(len(x)) < size, sh.Attrib1b, "opencl")))
print(json.dumps(made))
"""


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    """The code that was generated at each size, by the names of its runs: one process starts with an empty folder."""
    folder = tmp_path_factory.mktemp("code")
    folders = {"POCL_CACHE_DIR": str(folder), "PYTHONPATH": ROOT}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env=os.environ | folders,
        text=True,
        stdout=subprocess.PIPE,
        check=True,
        timeout=HANGING,
    )
    return json.loads(done.stdout.splitlines()[-1])


def kernels(runs):
    """Return the kernels for which code was generated during these runs: a name for each time."""
    return sorted(code.split("/")[0] for run in runs for code in run)


def test_runs_of_every_size_share_the_code_that_compile_made(generated):
    assert (generated["1 lanes"], generated["8 lanes"]) == ([[]] * 7, [[]] * 7)


def test_statuses_of_every_number_are_counted_by_one_code(generated):
    assert kernels(generated["statuses"]) == ["count_statuses", "keep"]


def test_lists_of_every_number_of_live_elements_share_their_code(generated):
    assert {"mark", "place"} < set(names := kernels(generated["lists"]))
    assert len(names) == len(set(names))


def test_a_compilation_hears_an_interrupt(monkeypatch):
    """The wait for the first launch, during which the driver generates code, ends; the device serves what follows."""

    @sh.program
    def triple(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * 3

    def interrupted(event):
        event.wait()
        raise KeyboardInterrupt

    monkeypatch.setattr(machine_of(None).waiter, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        triple.compile("opencl")
    monkeypatch.undo()
    assert triple.compile("opencl")(np.float32([1, 2])).tolist() == [3, 6]
