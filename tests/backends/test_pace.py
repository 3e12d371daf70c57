"""The pace: the part of a call that one dispatch does, which never changes the answer."""

import numpy as np
import pytest

import shpy as sh
from shpy import SH_DISCARD, SH_FOR, SH_WHILE
from shpy.backend.device import pace as pacing
from shpy.backend.device.pace import Pace
from shpy.backend.opencl.device import building

pytestmark = pytest.mark.undisturbed


class Clock:
    """Time that goes on as elements are done: `cost(n)` seconds for the n-th."""

    def __init__(self, cost):
        self.now, self.done, self.cost = 0.0, 0, cost

    def __call__(self):
        return self.now

    def work(self, elements):
        self.now += sum(self.cost(self.done + k) for k in range(elements))
        self.done += elements


def durations(cost, rows, width, seconds=0.1, calls=1, **options):
    clock = Clock(cost)
    pace, found = Pace(seconds, clock, **options), []
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
    assert len(durations(lambda n: 1e-9, 4096, 128)) == 5
    assert len(durations(lambda n: 1e-9, 4096, 128, calls=3)) == 7


def test_a_small_run_that_was_brief_is_not_waited_for_again():
    clock = Clock(lambda n: 1e-9)
    pace = Pace(0.1, clock)
    for _ in pace.parts(1, 1024, 2):  # the only row, of two that a dispatch has at least
        clock.work(1024)
    assert pace.fits(1024)
    assert not pace.fits(1025)


def test_a_dear_kernel_is_many_short_ones():
    found = durations(lambda n: 1e-5, 4096, 64)
    assert found[0] == pytest.approx(pacing.FIRST * 1e-5)
    assert max(found[1:]) < 0.11


def test_what_gets_dearer_is_cut_shorter():
    found = durations(lambda n: 1e-7 if n < 1 << 14 else 1e-5, 4096, 64)
    assert sum(seconds > 0.12 for seconds in found) == 1  # the one that could not know yet


def test_what_each_dispatch_costs_does_not_make_it_shorter():
    """16 elements in 5 ms: far more of them would take no longer."""
    clock = Clock(lambda n: 1e-9)
    pace = Pace(0.1, clock)
    pace.elements = 1 << 20
    for _ in pace.parts(16):
        clock.now += 0.005
    assert pace.elements == 1 << 20


def test_a_kernel_whose_cost_is_in_its_data_begins_small():
    found = durations(lambda n: 1e-9 if n < 1 << 19 else 1e-5, 512, 1024, calls=2, steady=False)
    assert max(found) < 0.2
    assert len(durations(lambda n: 1e-9, 512, 1024, calls=2, steady=False)) == 5 + 3


def test_what_gets_cheaper_is_cut_longer_although_rows_do_not_fill_a_dispatch():
    """2,500 elements are one row of 1,536 and a part of another, so no dispatch has as many."""
    clock = Clock(lambda n: 1e-6)
    pace = Pace(0.1, clock)
    pace.elements = 2500
    counts = []
    for _, count in pace.parts(100, 1536):
        clock.work(count * 1536)
        counts.append(count)
    assert counts == [1, 13, 65, 21]


def test_a_small_rest_says_nothing():
    clock = Clock(lambda n: 1e-5 if n < 10_000 else 1e-9)
    pace = Pace(0.1, clock)
    pace.elements = 10_000
    for _, count in pace.parts(11, 1000):
        clock.work(count * 1000)
    assert pace.elements == 10_000


def test_each_core_has_a_row():
    clock = Clock(lambda n: 1.0)
    for _, count in Pace(0.1, clock).parts(100, 1, 4):
        clock.work(count)
        assert count == 4 or clock.done == 100 or clock.done == pacing.FIRST


def test_a_row_is_never_divided():
    assert durations(lambda n: 1.0, 3, 2 * pacing.FIRST) == [2.0 * pacing.FIRST] * 3


@pytest.mark.sampled(4)
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
    monkeypatch.setattr(building, "_CPU_SECONDS", 1e-7)
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


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("backend", "lanes"), [("glsl", "auto"), ("opencl", 1), ("opencl", 4), ("opencl", "auto")])
def test_strips_keep_statuses(backend, lanes, monkeypatch):
    """Loops out of budget, discarded elements and what `out` held are the same however a call is cut."""

    @sh.program
    def work(n: sh.Attrib1i) -> sh.Attrib1i:
        SH_DISCARD(n % 7 == 0)
        total = sh.Attrib1i(0)
        with SH_WHILE(lambda: total < n):
            total += 1
        return total

    n = np.random.default_rng(1).integers(0, 60, (97, 64), dtype=np.int32)
    monkeypatch.setattr(pacing, "FIRST", 1)
    monkeypatch.setattr(pacing, "AGAIN", 1)
    monkeypatch.setattr(building, "_CPU_SECONDS", 1e-9)
    monkeypatch.setattr(Pace.__init__, "__defaults__", (1e-9, *Pace.__init__.__defaults__[1:]))
    kernel = work.compile(backend, lanes=lanes, loop_limit=49)
    few = np.minimum(n, 40)
    result = kernel.run(few, out=np.full_like(n, 77))
    np.testing.assert_array_equal(result.outputs, np.where(few % 7 == 0, 77, few))
    np.testing.assert_array_equal(result.written, few % 7 != 0)
    with pytest.raises(sh.LoopLimitExceeded) as error:
        kernel(n)
    stopped = (n > 49) & (n % 7 != 0)
    assert error.value.count == stopped.sum()
    np.testing.assert_array_equal(error.value.result.written, ~stopped & (n % 7 != 0))


def test_a_run_is_brief_once_one_as_large_took_milliseconds():
    clock = iter(range(1000))
    pace = Pace(1.0, lambda: next(clock) * 1e-3)
    assert not pace.is_brief(64)
    list(pace.parts(64))
    assert sum(pace.is_brief(64) for _ in range(640)) == 630  # now and then one is timed again
    assert not pace.is_brief(65)
    pace.bounded = False
    assert not any(pace.is_brief(64) for _ in range(20))


def test_a_slower_run_is_not_brief_any_more():
    ticks = iter([0.0, 0.001, 1.0, 2.0])
    pace = Pace(1.0, lambda: next(ticks))
    list(pace.parts(64))
    assert pace.is_brief(64)
    list(pace.parts(64))
    assert not any(pace.is_brief(64) for _ in range(20))


def test_as_many_elements_fit_as_a_dispatch_takes():
    clock = iter(range(1000))
    pace = Pace(0.1, lambda: next(clock) * 1e-3)
    list(pace.parts(256))
    assert pace.fits(2048)
    assert not pace.fits(2049)
    pace.steady = False
    assert not pace.fits(1)


@pytest.mark.parametrize("reads", [True, False])
def test_a_run_is_waited_for_until_its_time_is_known(reads):
    """One that is read next has to be brief to go on unwaited; any other has to fit in one dispatch."""
    clock, started, waited = iter(range(1000)), [], []
    pace = Pace(0.1, lambda: next(clock) * 1e-2)
    run = pace.driver(32, lambda *part: started.append(part), waited.append, 4, reads=reads)
    for _ in range(3):
        run()
    assert started == [(0, 32)] * 3
    assert len(waited) == (3 if reads else 0)


@pytest.mark.parametrize("shape", [(64,), (4, 16)])
def test_a_small_run_over_arrays_is_timed_again_now_and_then(shape, monkeypatch):
    """Its arguments stay set from run to run, and its pace is asked once for each run."""

    @sh.program
    def add(x: sh.Attrib1f) -> sh.Attrib1f:
        return x + 1

    kernel, x = add.compile("opencl", lanes=1), np.zeros(shape, np.float32)
    kernel(x)
    timed, original = [], Pace.parts
    monkeypatch.setattr(Pace, "was_brief", lambda *_: True)
    monkeypatch.setattr(Pace, "parts", lambda *given: (timed.append(given), original(*given))[1])
    for _ in range(2 * pacing.AGAIN_AFTER):
        kernel(x)
    assert len(timed) == 2
