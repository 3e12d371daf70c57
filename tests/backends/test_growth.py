"""Many kernels, one after the other: what is not used any more is released."""

import gc
import os
import threading
import time

import numpy as np
import pytest

import shpy as sh
from shpy.backend.glsl import backend as glsl
from shpy.backend.opencl.device.driver import machine_of
from shpy.run import kernel as kernels


def run_distinct(backend, first, count):
    """Compile and run `count` programs that differ in a constant."""
    for k in range(first, first + count):

        @sh.program
        def work(x: sh.Attrib1f) -> sh.Attrib1f:
            return x + sh.Attrib1f(k) * 0.5  # noqa: B023

        assert work.compile(backend)(np.float32([1])).tolist() == [1 + k * 0.5]
    gc.collect()


def programs_of(backend):
    return len((machine_of(None) if backend == "opencl" else glsl._runtime(0))._programs)


def open_files():
    """Count the open files of this process, but for those that a thread beside the test opens for a moment."""

    def counted():
        time.sleep(0.01)
        return len(os.listdir("/proc/self/fd"))

    return min(counted() for _ in range(20))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_programs_that_were_evicted_are_released(backend, monkeypatch):
    monkeypatch.setattr(kernels, "_executables", {})
    monkeypatch.setattr(kernels, "_KEPT", 3)
    run_distinct(backend, 10_000, 3)
    held = programs_of(backend)
    files = open_files()
    run_distinct(backend, 20_000, 12)
    assert programs_of(backend) <= held
    assert open_files() <= files


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_kernels_start_no_threads_of_their_own(backend):
    """Each kernel of GLSL looked for one more device, and left the thread that had not found it."""
    run_distinct(backend, 30_000, 2)
    before = set(threading.enumerate())
    run_distinct(backend, 40_000, 3)
    assert set(threading.enumerate()) <= before


def measured():
    """The memory maps, the open files and the resident MiB of this process."""
    gc.collect()
    with open("/proc/self/maps") as file:
        maps = sum(1 for _ in file)
    with open("/proc/self/statm") as file:
        resident = int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
    return np.array([maps, len(os.listdir("/proc/self/fd")), resident])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("backend", "count", "maps", "mebibytes"),
    [("numpy", 5000, 0, 0.002), ("glsl", 2000, 0.2, 0.2), ("opencl", 1000, 4, 0.1)],
)
def test_thousands_of_kernels_take_few_maps_and_little_memory(backend, count, maps, mebibytes, monkeypatch):
    """Bounds are for each kernel, beside those that are kept.

    PoCL itself never unmaps the code of a kernel, four maps, whoever releases the kernel. It takes a third of a second
    of CPU to compile one, which is why there are only a thousand of them.
    """
    monkeypatch.setattr(kernels, "_KEPT", 8)
    run_distinct(backend, 100_000, 60)
    before = measured()
    run_distinct(backend, 200_000, count)
    grown = measured() - before
    assert grown[0] <= maps * count + 100
    assert grown[1] <= 0
    assert grown[2] <= mebibytes * count + 10


def assert_takes_nothing(call, first, count):
    """`call(n)` does something n times: after the first ones, more take no maps, no open files and no memory."""
    call(first)
    before = measured()
    call(count)
    maps, files, resident = measured() - before
    assert maps <= 10
    assert files <= 0
    assert resident <= 4


every = pytest.mark.parametrize("backend", ["numpy", "glsl", "opencl"])


@pytest.mark.slow
@every
def test_a_hundred_thousand_calls_take_nothing(backend):
    @sh.program
    def work(x: sh.Attrib1f, y: sh.Attrib2f) -> sh.Attrib2f:
        return x + y * 0.5

    kernel = work.compile(backend)
    y = np.float32([[1, 2], [3, 4], [5, 6]])

    def call(count):
        for k in range(count):
            n = 1 + k % 3
            kernel(np.float32(k), y[:n])

    assert_takes_nothing(call, 1000, 100_000)


@sh.program
def fall(x: sh.Attrib3f, by: sh.Attrib1f) -> sh.Attrib3f:
    sh.SH_DISCARD(x.y < 0)
    return x - sh.Attrib3f(0, by, 0)


@sh.program
def smooth(u: sh.Table[sh.Attrib1f]) -> sh.Attrib1f:
    i = sh.grid_index(1)
    return 0.25 * u[i - 1] + 0.5 * u[i] + 0.25 * u[i + 1]


@sh.program
def halve(n: sh.Attrib1i) -> sh.Attrib1i:
    sh.SH_DISCARD(n == 0)
    return n // 2


@pytest.mark.slow
@every
def test_a_hundred_thousand_calls_over_streams_take_nothing(backend):
    """Results that are kept for a while, written to a stream, counted, and read by index."""
    kernel, reader = fall.compile(backend), smooth.compile(backend)
    streams = [sh.Stream(np.ones((n, 3)), sh.Attrib3f, backend) for n in (3, 70, 900)]
    table, out = sh.Table(sh.Stream(np.ones(70), sh.Attrib1f, backend)), sh.Stream.empty(70, sh.Attrib1f, backend)

    def call(count):
        for k in range(0, count, 4):
            stream = streams[k % 3]
            kept = kernel(stream, 0.5)
            kernel.run(kept, stream[:1, 0] if k % 64 == 0 else 0.25, out=stream)
            counted = kernel.run(stream, 0.25)
            if k % 64 == 0:
                assert counted.count <= stream.size
            reader.run(table, out=out)

    assert_takes_nothing(call, 2000, 100_000)


@pytest.mark.slow
@every
def test_ten_thousand_dropped_streams_take_nothing(backend):
    """Streams of many sizes, so that few of them fit where another one was."""
    x = np.random.default_rng(1).normal(size=(5000, 3))

    def drop(count):
        for k in range(count):
            stream = sh.Stream(x[: 1 + 37 * k % 5000], sh.Attrib3f, backend)
            if k % 10 == 0:
                stream.copy().numpy()

    assert_takes_nothing(drop, 5000, 10_000)


@pytest.mark.slow
@every
def test_a_thousand_runs_of_chains_take_nothing(backend):
    """Chains with a stencil, and with a loop whose rounds discard elements."""
    repeated, ended = sh.repeat(smooth, 5), sh.loop(halve)
    u, n = np.linspace(0, 1, 500), np.arange(100)

    def run(count):
        for k in range(0, count, 2):
            repeated.run(u=u[: 100 + k % 400], backend=backend).streams["u"].numpy()
            assert ended.run(n=n, backend=backend).executions == {"halve": 8}

    assert_takes_nothing(run, 400, 1000)


@sh.program
def add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


@pytest.mark.slow
@every
def test_a_thousand_collective_operations_of_each_kind_take_nothing(backend):
    """Over streams of a few sizes: each size has runs of its own."""
    x = np.random.default_rng(2).normal(size=3000)
    index = np.random.default_rng(3).integers(0, 40, 3000)

    def run(count):
        for k in range(count):
            n = 500 * (1 + k % 6)
            stream, cells = sh.Stream(x[:n], sh.Attrib1f, backend), sh.Stream(index[:n], sh.Attrib1i, backend)
            assert sh.gather(sh.sort(stream), [0])[0] == stream.min()
            sh.scan(add, stream)
            sh.argsort(cells)
            sh.compact(stream, x[:n] > 0)
            assert sh.histogram(cells, 40).sum() == n
            sh.histogram(stream, 10, range=(-1, 1))
            sh.scatter(stream, cells, 40, combine=add).numpy()

    assert_takes_nothing(run, 300, 1000)
