"""Many kernels, one after the other: what is not used any more is released."""

import gc
import os

import numpy as np
import pytest

import shpy as sh
from shpy import kernel as kernels
from shpy.backends.glsl import backend as glsl
from shpy.backends.opencl.device import machine_of


def run_distinct(backend, first, count):
    """Compile and run so many programs that differ in a constant."""
    for k in range(first, first + count):

        @sh.program
        def work(x: sh.Attrib1f) -> sh.Attrib1f:
            return x + sh.Attrib1f(k) * 0.5  # noqa: B023

        assert work.compile(backend)(np.float32([1])).tolist() == [1 + k * 0.5]
    gc.collect()


def programs_of(backend):
    return len((machine_of(None) if backend == "opencl" else glsl._runtime(0))._programs)


@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_programs_that_were_evicted_are_released(backend, monkeypatch):
    monkeypatch.setattr(kernels, "_executables", {})
    monkeypatch.setattr(kernels, "_KEPT", 3)
    run_distinct(backend, 10_000, 3)
    held = programs_of(backend)
    files = len(os.listdir("/proc/self/fd"))
    run_distinct(backend, 20_000, 12)
    assert programs_of(backend) <= held
    assert len(os.listdir("/proc/self/fd")) <= files


@pytest.mark.slow
@pytest.mark.parametrize(("backend", "maps"), [("numpy", 0), ("glsl", 1), ("opencl", 4)])
def test_many_kernels_take_few_maps(backend, maps, monkeypatch):
    """PoCL itself never unmaps the code of a kernel, four maps, whoever releases the kernel."""
    monkeypatch.setattr(kernels, "_KEPT", 8)

    def mapped():
        with open("/proc/self/maps") as file:
            return sum(1 for _ in file)

    run_distinct(backend, 0, 50)
    before = mapped()
    run_distinct(backend, 1000, 300)
    assert mapped() - before <= maps * 300 + 100
