"""How much of a call one dispatch does, and that it makes no difference to the answer."""

import numpy as np
import pytest

import shpy as sh
from shpy import SH_FOR
from shpy.backends import pace as pacing
from shpy.backends.opencl.device import Machine
from shpy.backends.pace import Pace


class Clock:
    """Time that goes on as elements are done: `cost(n)` seconds for the n-th."""

    def __init__(self, cost):
        self.now, self.done, self.cost = 0.0, 0, cost

    def __call__(self):
        return self.now

    def work(self, elements):
        self.now += sum(self.cost(self.done + k) for k in range(elements))
        self.done += elements


def durations(cost, rows, width, seconds=0.1, calls=1):
    clock = Clock(cost)
    pace, found = Pace(seconds, clock), []
    for _ in range(calls):
        after = 0
        for first, count in pace.parts(rows, width):
            assert first == after
            after = first + count
            before = clock.now
            clock.work(count * width)
            found.append(clock.now - before)
        assert after == rows
    return found


def test_a_cheap_kernel_is_soon_one_dispatch():
    assert len(durations(lambda n: 1e-9, 4096, 128)) == 2
    assert len(durations(lambda n: 1e-9, 4096, 128, calls=3)) == 4


def test_a_dear_kernel_is_many_short_ones():
    found = durations(lambda n: 1e-5, 4096, 64)
    assert found[0] == pytest.approx(pacing.FIRST * 1e-5)
    assert max(found[1:]) < 0.11


def test_what_gets_dearer_is_cut_shorter():
    found = durations(lambda n: 1e-7 if n < 1 << 17 else 1e-5, 4096, 64)
    assert sum(seconds > 0.12 for seconds in found) == 1  # the one that could not know yet


def test_a_row_is_never_divided():
    assert durations(lambda n: 1.0, 3, 2 * pacing.FIRST) == [2.0 * pacing.FIRST] * 3


@pytest.mark.parametrize("shape", [(311, 130), (40_430,)])
@pytest.mark.parametrize(("backend", "lanes"), [("glsl", "auto"), ("opencl", 1), ("opencl", 16)])
def test_strips_give_what_one_dispatch_gives(backend, lanes, shape, monkeypatch):
    @sh.program
    def work(x: sh.Attrib1f) -> sh.Attrib1f:
        place = sh.grid_index(len(shape))
        with SH_FOR(0, 20):
            x[:] = x * 0.5 + sh.Attrib1f(place if len(shape) == 1 else place.x - place.y)
        return x

    x = np.arange(311 * 130, dtype=np.float32).reshape(shape)
    whole = work.compile("numpy")(x)
    monkeypatch.setattr(pacing, "FIRST", 300)
    monkeypatch.setattr(Machine, "watched", True)  # as a GPU is, which is not here
    dispatches = []
    original = Pace.parts

    def counted(self, *args):
        for part in original(self, *args):
            dispatches.append(part)
            yield part

    monkeypatch.setattr(Pace, "parts", counted)
    monkeypatch.setattr(Pace.__init__, "__defaults__", (1e-7, *Pace.__init__.__defaults__[1:]))
    np.testing.assert_array_equal(work.compile(backend, lanes=lanes)(x), whole)
    assert len(dispatches) > 10
