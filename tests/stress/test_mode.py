"""The stress mode disturbs what it says it disturbs: otherwise it could find nothing."""

import numpy as np
import pytest
from stress.mode import GIVEN_BACK, TAKEN, stressed

import shpy as sh
from shpy.backend.device.pace import Pace
from shpy.backend.opencl.device.driver import machine_of
from shpy.backend.registry import backend as backend_named


@sh.program
def add(a: sh.Attrib1f) -> sh.Attrib1f:
    return a + 1


def test_runs_are_split_into_few_and_many_dispatches_and_not_at_all():
    counts = set()
    with stressed(1):
        for _ in range(50):
            parts = list(Pace().parts(100))
            assert [first for first, _ in parts] == np.cumsum([0, *(n for _, n in parts)])[:-1].tolist()
            assert sum(n for _, n in parts) == 100
            counts.add(len(parts))
        assert len({Pace().fits(10) for _ in range(50)}) == 2
    assert counts == {1, 2, 3, 9}


@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_a_run_takes_several_dispatches(backend, monkeypatch):
    from shpy.backend.glsl.device.run import Runtime
    from shpy.backend.opencl.device.waiting import Waiter

    seen = []
    seam, name = (Runtime, "_dispatch") if backend == "glsl" else (Waiter, "wait")
    real = getattr(seam, name)
    monkeypatch.setattr(seam, name, lambda *args: (seen.append(1), real(*args))[1])
    kernel = add.compile(backend)
    x = np.zeros((100, 64), np.float32)
    kernel(x)
    most = 0
    for seed in range(20):
        seen.clear()
        with stressed(seed):
            assert (kernel(x) == 1).all()
        most = max(most, len(seen))
    assert most >= 9


@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_fresh_memory_holds_a_pattern(backend):
    with stressed(3):
        found = sh.Stream.fresh((70, 4), sh.Attrib1f, sh.Stream([0.0], sh.Attrib1f, backend).place).numpy()
    assert (found.view(np.uint32) == TAKEN).all()


def test_memory_that_is_given_back_is_overwritten():
    machine = machine_of(None)
    with stressed(3):
        s = sh.Stream(np.ones(50, np.float32), sh.Attrib1f, backend="opencl")
        buffer = s._memories[0].buffer
        del s
        with machine.lock:
            machine.give_back([machine.take(1 << 20)])
            found = np.empty(50, np.uint32)
            machine.download(found, buffer)
            machine.queue.finish()
    assert (found == GIVEN_BACK).all()


def test_the_same_seed_makes_the_same_choices():
    chosen = []
    for _ in range(2):
        with stressed(11) as mode:
            chosen.append([mode.parts(40) for _ in range(10)])
    assert chosen[0] == chosen[1]


def test_nothing_of_it_stays():
    with stressed(1):
        pass
    assert list(Pace().parts(1)) == [(0, 1)]
    assert Pace.parts.__module__ == "shpy.backend.device.pace"
    assert backend_named("opencl").space(None).allocate.__func__.__module__ == "shpy.backend.opencl.device.memory"
    assert np.empty.__name__ == "empty"
