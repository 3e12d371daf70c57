"""Ctrl-C anywhere in a run: the next calls give the right bits, and streams that the run did not write keep theirs."""

import gc
from threading import Thread
from unittest.mock import patch

import numpy as np
import pytest
from patience import HANGING
from stress.interrupts import Interrupted, at_line, in_a_draw
from stress.mode import stressed

import shpy as sh
from shpy.backend.device.pace import Pace

BACKENDS = ("numpy", "opencl", "glsl")
X = np.arange(2500, dtype=np.float32).reshape(50, 50)


@sh.program
def double(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * 2


@sh.program
def large(x: sh.Attrib1f) -> sh.Attrib1f:
    sh.SH_DISCARD(x < 1000)
    return x + 1


@sh.program
def move(x: sh.Attrib1f, t: sh.Table[sh.Attrib1f, 2]):
    return {"x": x + t[sh.grid_index(2) + 1]}


LATER = np.pad(X, (0, 1), "edge")[1:, 1:]


class Calls:
    """Calls of every kind on one backend; each returns what it gives and what it should give."""

    def __init__(self, backend):
        self.backend = backend
        self.x = sh.Stream(X, sh.Attrib1f, backend)
        self.kernels = {p.name: p.compile(backend) for p in (double, large)}

    def arrays(self):
        return self.kernels["double"](X), 2 * X

    def few(self):
        return self.kernels["double"](X[0]), 2 * X[0]

    def some(self):
        out = np.full_like(X, 7)
        self.kernels["large"].run(X, out=out)
        return out, np.where(X < 1000, 7, X + 1)

    def streams(self):
        return self.kernels["double"](self.x).numpy(), 2 * X

    def some_of_streams(self):
        out = sh.Stream(np.full_like(X, 7), sh.Attrib1f, self.backend)
        self.kernels["large"].run(self.x, out=out)
        return out.numpy(), np.where(X < 1000, 7, X + 1)

    def live(self):
        out = self.kernels["double"].run(self.x, where=sh.Stream(X < 50, sh.Attrib1b, self.backend)).outputs
        return out.numpy(), np.where(X < 50, 2 * X, 0)

    def chain(self):
        found = sh.repeat(move, 3).run(x=self.x, t=sh.Table(self.x)).streams["x"].numpy()
        return found, X + LATER + LATER + LATER

    def sort(self):
        return sh.sort(self.x).numpy(), X.reshape(-1)

    def total(self):
        return self.x.sum(method="exact"), np.float32(X.sum(dtype=np.float64))

    def table(self):
        t = sh.Table(X, sh.Attrib1f)
        t.update(X + 1)
        found = sh.gather(sh.Stream(X.reshape(-1) + 1, sh.Attrib1f, self.backend), self.kernels_index()).numpy()
        return found, (X.reshape(-1) + 1)[::-1]

    def kernels_index(self):
        return sh.Stream(np.arange(2500, dtype=np.int32)[::-1].copy(), sh.Attrib1i, self.backend)

    def all(self):
        return [self.arrays, self.few, self.some, self.streams, self.some_of_streams, self.live, self.chain,
                self.sort, self.total, self.table]  # fmt: skip

    def check(self):
        for call in self.all():
            np.testing.assert_array_equal(*call(), err_msg=call.__name__)
        np.testing.assert_array_equal(self.x.numpy(), X)


def check_in_another_thread(work):
    """Do some work in another thread, which would wait for ever for a lock that an interrupt left to this one."""
    done = []
    thread = Thread(target=lambda: done.append(work()), daemon=True)
    thread.start()
    thread.join(HANGING)
    assert done, "the calls of another thread failed, or did not end"


def check(backend, seed, times):
    """Interrupt calls at random places, and make all calls after some of the interrupts."""
    random = np.random.default_rng(seed)
    calls = Calls(backend)
    calls.check()
    interrupts = 0
    for k in range(times):
        call = calls.all()[random.integers(len(calls.all()))]
        draws = backend == "glsl" and k % 2
        place = in_a_draw(random.integers(1, 8)) if draws else at_line(random.integers(1, 250))
        with stressed(int(random.integers(2**16))):
            try:
                with place:
                    call()
                continue
            except Interrupted:
                interrupts += 1
            gc.collect()  # what the interrupted run held is gone, as after a prompt of Python
            np.testing.assert_array_equal(*call(), err_msg=f"{call.__name__} after Ctrl-C in itself")
            if interrupts % 5 == 0:
                calls.check()
    check_in_another_thread(calls.check)
    assert interrupts > times // 4


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_calls_after_an_interrupt(backend):
    check(backend, 1, 30)


def test_a_run_in_parts_is_interrupted_at_each_line():
    """The kernel of a small run on OpenCL holds where a dispatch begins, which the next run must not find there."""
    kernel = double.compile("opencl")
    kernel(X)
    interrupts = 0
    for line in range(1, 120):
        with patch.object(Pace, "is_brief", lambda *_: False), patch.object(Pace, "parts", parts_of_a_row):
            try:
                with at_line(line):
                    kernel(X)
            except Interrupted:
                interrupts += 1
        other = X + line  # its results are nowhere in memory yet
        np.testing.assert_array_equal(kernel(other), 2 * other, err_msg=f"after Ctrl-C at line {line} of the run")
    assert interrupts > 60
    check_in_another_thread(lambda: kernel(X))


def parts_of_a_row(pace, rows, *size):
    """Return dispatches of one row each, in place of `Pace.parts`."""
    return [(first, 1) for first in range(rows)]


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_small_run_is_interrupted_at_each_line(backend):
    """Also behind each lock that it takes: the next run, on another thread, waits for none of them."""
    kernel = double.compile(backend)
    kernel(X[0])
    interrupts = 0
    for line in range(1, 90):
        try:
            with at_line(line):
                kernel(X[0])
        except Interrupted:
            interrupts += 1
            check_in_another_thread(lambda: kernel(X[0]))
    assert interrupts > 10


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("seed", range(10, 20))
def test_calls_after_many_interrupts(backend, seed):
    check(backend, seed, 300)
