"""A fork between any two calls: the child ends as a process ends, with its status, whatever its parent had used."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from patience import HANGING

TESTS = Path(__file__).parent.parent
SCRIPT = """
import os, signal, sys
import numpy as np
import shpy as sh
from stress.mode import stressed
from stress.test_ctrl_c import Calls

seed, times, *backends = sys.argv[1:]
random = np.random.default_rng(int(seed))


def fork():
    child = os.fork()
    if not child:
        signal.alarm(30)   # a child that hangs ends by SIGALRM
        sys.exit(7)        # by all handlers of the end of a process
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert status == 7, f"the child ended with {status}"


fork()
with stressed(int(seed)):
    calls = [call for backend in backends for call in Calls(backend).all()]
    for _ in range(int(times)):
        call = calls[random.integers(len(calls))]
        np.testing.assert_array_equal(*call())
        fork()
"""


def check(seed, times, *backends):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)])}
    command = [sys.executable, "-c", SCRIPT, str(seed), str(times), *backends]
    done = subprocess.run(command, env=environment, text=True, capture_output=True, timeout=HANGING)
    assert done.returncode == 0, done.stderr


@pytest.mark.sampled(4)
@pytest.mark.parametrize("backends", [("numpy",), ("opencl",), ("glsl",), ("numpy", "opencl", "glsl")])
def test_children_end(backends):
    check(1, 4, *backends)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10, 15))
def test_many_children_end(seed):
    check(seed, 100, "numpy", "opencl", "glsl")
