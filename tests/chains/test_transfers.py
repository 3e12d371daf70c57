"""Between the first upload and the last download nothing goes over to the host and back."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

import shpy as sh
from benchmarks.chains import JACOBI, PARTICLES, SORTS

BACKENDS = ["numpy", "opencl", "glsl"]
on_every_backend = pytest.mark.parametrize("backend", BACKENDS)


@sh.program
def smooth(u: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    i = sh.grid_index(2)
    return 0.25 * (u[i + (0, 1)] + u[i - (0, 1)] + u[i + (1, 0)] + u[i - (1, 0)])


@sh.program
def cool(u: sh.Attrib1f, rate: sh.Attrib1f):
    sh.SH_DISCARD(u < 0.25)
    return {"u": u * rate}


@sh.program
def add(a: sh.Attrib1i, b: sh.Attrib1i) -> sh.Attrib1i:
    return a + b


@pytest.fixture
def transfers(monkeypatch):
    """A function that counts, from its call on, what a device's memories read and write."""

    def watch(backend):
        seen = {"read": 0, "write": 0}
        memory = type(sh.Stream.empty(1, sh.Attrib1f, backend).leaf_entries()[0].memory)
        for name in seen:
            actual = getattr(memory, name)

            def counted(self, *args, name=name, actual=actual):
                seen[name] += 1
                return actual(self, *args)

            monkeypatch.setattr(memory, name, counted)
        return seen

    return watch


@pytest.mark.sampled(3)
@on_every_backend
def test_arrays_go_to_the_device_once_and_nothing_comes_back(backend, transfers):
    image = np.random.default_rng(1).random((9, 11), np.float32)
    chain = sh.repeat(sh.sequence(sh.repeat(smooth, 3), cool), 20)
    seen = transfers(backend)
    result = chain.run(u=image, rate=0.5, backend=backend)
    # Two streams, and the zero at which the device begins to count what cool writes.
    assert seen == {"read": 0, "write": 3}
    assert result.executions == {"smooth": 60, "cool": 20}
    result.streams["u"].numpy()
    assert seen["read"] == 1
    assert result.counts["smooth"] == 60 * 99
    assert seen["read"] == 2


@on_every_backend
def test_streams_stay_where_they_are(backend, transfers):
    u = sh.Stream(np.ones((4, 4)), sh.Attrib1f, backend=backend)
    seen = transfers(backend)
    first = sh.repeat(smooth, 7).run(u=u)
    sh.repeat(smooth, 2).run(u=first.streams["u"])
    assert seen == {"read": 0, "write": 0}


@on_every_backend
def test_a_loop_reads_a_count_and_no_elements(backend, transfers):
    seen = transfers(backend)
    result = sh.loop(cool).run(u=np.linspace(0, 1, 50, dtype=np.float32), rate=0.5, backend=backend)
    assert result.executions == {"cool": 4}
    assert seen["read"] == 0


@pytest.mark.sampled(2)
@pytest.mark.parametrize("kernel", [smooth, cool])
@on_every_backend
def test_each_assignment_of_memories_is_made_ready_once(backend, kernel, monkeypatch):
    ready = []
    actual = sh.Kernel.prepare_on_device
    monkeypatch.setattr(sh.Kernel, "prepare_on_device", lambda *args: ready.append(1) or actual(*args))
    u = sh.Stream(np.ones((4, 4)), sh.Attrib1f, backend=backend)
    rate = {} if kernel is smooth else {"rate": 1}
    result = sh.repeat(kernel, 1000).run(u=u, **rate)
    assert result.executions == {kernel.name: 1000}
    assert len(ready) <= 3


@pytest.mark.sampled(3)
@on_every_backend
def test_a_grid_goes_to_the_device_once_and_comes_back_once(backend, transfers):
    """As the benchmarks time it, from an array on the host to an array on the host."""
    run = JACOBI.versions[backend](*JACOBI.inputs(16))
    seen = transfers(backend)
    run()
    assert seen == {"read": 1, "write": 1}


@pytest.mark.sampled(3)
@on_every_backend
def test_sorts_and_counts_of_particles_read_nothing(backend, transfers):
    """Positions and velocities go to the device and come back; a sort by merging uploads a number for each merge.

    It uploads the bound of the keys, too, so that one kernel clamps them for every bound.
    """
    count = 50
    run = PARTICLES.versions[backend](*PARTICLES.inputs(count))
    seen = transfers(backend)
    run()
    numbers = count.bit_length() + 1 if backend == "glsl" else 0
    assert seen == {"read": 2, "write": 2 + SORTS * numbers}


@on_every_backend
def test_a_scatter_that_combines_reads_a_count_and_no_elements(backend, transfers):
    """It reads the number of places that a run wrote: a place may have more values than one run combines."""
    cells = sh.Stream(np.arange(50) % 7, sh.Attrib1i, backend=backend)
    ones = sh.Stream(np.ones(50, np.int32), sh.Attrib1i, backend=backend)
    seen = transfers(backend)
    counts = sh.scatter(ones, cells, 7, combine=add)
    assert seen["read"] == 0
    assert np.array_equal(counts.numpy(), sh.histogram(cells, 7).numpy())
