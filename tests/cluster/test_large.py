"""Gray-Scott over more data than a worker may hold, with the bits of one process."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from typing import NamedTuple

import dask
import numpy as np
import pytest
from dask.distributed import Client, LocalCluster

import shpy as sh

SIDE, STEPS, LIMIT = 4096, 8, 400 * 10**6


class UV(NamedTuple):
    u: sh.Attrib1f
    v: sh.Attrib1f


@sh.program
def start() -> UV:
    i = sh.grid_index(2)
    spot = sh.cond(sh.unit_float(sh.hash(i.x // 64, i.y // 64)) < 0.1, 1.0, 0.0)
    return UV(1 - 0.5 * spot, 0.25 * spot)


@sh.program
def gray_scott(u: sh.Table[sh.Attrib1f, 2], v: sh.Table[sh.Attrib1f, 2]) -> UV:
    i = sh.grid_index(2)

    def laplacian(t):
        return t[i + (0, 1)] + t[i - (0, 1)] + t[i + (1, 0)] + t[i - (1, 0)] - 4 * t[i]

    a, b = u[i], v[i]
    reaction = a * b * b
    return UV(a + 0.16 * laplacian(u) - reaction + 0.035 * (1 - a), b + 0.08 * laplacian(v) + reaction - 0.095 * b)


def digest(u, v):
    return hashlib.sha256(u.tobytes() + v.tobytes()).hexdigest()


def peak():
    """Return the bytes that this process has held at most: `ru_maxrss` has those of its parent where that held more."""
    with open("/proc/self/status") as status:
        (line,) = (line for line in status if line.startswith("VmHWM:"))
    return int(line.split()[1]) * 1024


def alone():
    """Print the hash of one run, and the bytes that it took at most."""
    u, v = start.compile("numpy")(shape=(SIDE, SIDE))
    found = sh.repeat(gray_scott.compile("numpy"), 2 * STEPS).run(u=u, v=v).streams
    print(digest(found["u"].numpy(), found["v"].numpy()), peak())


@pytest.mark.slow
def test_a_grid_that_one_worker_cannot_hold_has_the_bits_of_one_process():
    code = f"import sys; sys.path.insert(0, {__file__.rpartition('/')[0]!r}); import test_large; test_large.alone()"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    wanted, peak = ran.stdout.split()
    assert int(peak) > LIMIT
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, memory_limit=LIMIT, dashboard_address=None
        ) as cluster,
        Client(cluster),
    ):
        first = sh.map_blocks(start.compile("numpy"), shape=(SIDE, SIDE), chunks=(512, 512))
        fields = {"u": first.u, "v": first.v}
        for _ in range(2):
            fields = sh.map_overlap(gray_scott.compile("numpy"), fields, steps=STEPS)
        made = np.empty((2, SIDE, SIDE), np.float32)
        for array, stream in zip(made, dask.persist(fields["u"], fields["v"]), strict=True):
            for rows in range(0, SIDE, 512):
                array[rows : rows + 512] = stream[rows : rows + 512].compute()
    print(f"one run took {int(peak) / 1e6:.0f} MB, a worker may hold {LIMIT / 1e6:.0f} MB")
    assert digest(*made) == wanted
