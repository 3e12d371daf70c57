"""Tables that change, or are gone, while runs that read them may be under way: each run sees the data of its start."""

from __future__ import annotations

import gc

import numpy as np
import pytest

import shpy as sh

COUNT, READ, STEPS, ELEMENTS = 1 << 20, 100, 12, 20_000


def chain_over(table, backend):
    """Return a chain whose steps read much of a table, so that the last ones are under way when `run` returns."""

    @sh.program
    def total(u: sh.Attrib1f) -> sh.Attrib1f:
        i = sh.grid_index(1)
        s = sh.Attrib1f(0)
        with sh.SH_FOR(READ) as k:
            s += table[(i * 7919 + k * 31) % COUNT]
        return u + s

    return sh.repeat(total.compile(backend), STEPS)


def filled(number):
    return np.full(COUNT, number, np.float32)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
@pytest.mark.parametrize("change", ["a part", "all", "all, and another run", "the table is gone"])
def test_a_run_reads_the_data_of_its_start(backend, change):
    elements = ELEMENTS if backend == "opencl" else 64
    u = np.zeros(elements, np.float32)
    table = sh.Table(filled(1), sh.Attrib1f)
    chain = chain_over(table, backend)
    for _ in range(2):  # the runtime knows now that the runs are brief, and waits for none
        chain.run(u=u).streams["u"].numpy()
    started = chain.run(u=u).streams["u"]
    if change == "a part":
        table.update(filled(5), start=0)
    elif change == "the table is gone":
        del table, chain
    else:
        table.update(filled(5))
        if change == "all, and another run":
            assert np.all(chain.run(u=u).streams["u"].numpy() == 5 * READ * STEPS)
    gc.collect()
    others = [filled(9) for _ in range(4)]  # which get the memory that is free
    assert np.all(started.numpy() == READ * STEPS)
    del others
