"""Streams for which there is not enough memory: an error, after which the device goes on."""

import subprocess
import sys

import pytest
from patience import HANGING

CODE = """
import resource, sys
import numpy as np
import shpy as sh

x = np.ones(20_000_000, np.float32)  # 80 MB
backend = sys.argv[1]
assert sh.Stream(x[:10], sh.Attrib1f, backend).sum() == 10
now = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (now + 300 * 2**20, resource.RLIM_INFINITY))
kept = []
try:
    while True:
        kept.append(sh.Stream(x, sh.Attrib1f, backend))
except sh.ShpyError as error:
    print(error)
del kept
print(sh.Stream(x[:1000], sh.Attrib1f, backend).sum())
"""


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_streams_that_exhaust_memory_are_an_error(backend):
    done = subprocess.run(
        [sys.executable, "-c", CODE, backend], capture_output=True, text=True, timeout=HANGING, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    needed = "20,000,000 elements need 80,000,000 bytes, which is more than there are"
    assert ("GL_OUT_OF_MEMORY" if backend == "glsl" else needed) in done.stdout
    assert done.stdout.endswith("1000.0\n")
