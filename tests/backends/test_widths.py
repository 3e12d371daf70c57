"""`lanes="auto"` tries other widths on the data of a run, keeps the fastest one, and remembers it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

import shpy as sh
from shpy.backend.base import Call, DeviceCall
from shpy.backend.opencl.device import run as runtime, widths
from shpy.backend.opencl.device.driver import machine_of
from shpy.backend.opencl.device.widths import Choosing, measured_widths, next_width
from shpy.errors import CompileError


@dataclass
class Clock:
    """Time as the fake kernels spend it, and how much of it other programs took."""

    now: float = 0.0
    others: float = 0.0
    started: float = 0.0
    resolution: float = 1e-9

    def perf_counter(self) -> float:
        return self.now + self.others

    def process_time(self) -> float:
        return self.now

    def get_clock_info(self, name):
        return self


class Ticks:
    """Time that goes on by a second whenever somebody looks: every run and every compilation takes as long."""

    def __init__(self) -> None:
        self.seconds = itertools.count(0.0)

    def perf_counter(self) -> float:
        return next(self.seconds)

    process_time = perf_counter

    def get_clock_info(self, name):
        return SimpleNamespace(resolution=1e-9)


@dataclass
class Fake:
    """A kernel of a width that takes so many seconds an element and writes its width."""

    lanes: int
    pace: float
    clock: Clock
    shapes: list[tuple[int, ...]] = field(default_factory=list)
    notes: tuple[str, ...] = ()
    loops: tuple[None, ...] = ()
    writes_all: bool = True

    @property
    def source(self) -> str:
        return f"float{self.lanes}"

    def run(self, call: Call) -> None:
        self.shapes.append(call.shape)
        self.clock.now += self.pace * call.count
        for out in call.outputs:
            out[:] = self.lanes

    def ready(self, call: DeviceCall, *, once: bool = False):
        def start() -> None:
            self.shapes.append(call.shape)
            self.clock.started += self.pace * int(np.prod(call.shape))
            for out in call.outputs:
                out.writers.append(self.lanes)

        return start


@dataclass
class Memory:
    """Memory of a device that knows which widths wrote it."""

    count: int
    type: str = "f"
    dtype: str = "float32"
    writers: list[int] = field(default_factory=list)


@dataclass
class Space:
    """A device whose runs take their time when somebody waits for them."""

    clock: Clock
    waits: int = 0
    counted: bool = False
    parts: list[tuple[int, int]] = field(default_factory=list)

    def finish(self) -> None:
        if self.counted:
            self.waits += 1
            self.clock.now += self.clock.started
            self.clock.started, self.counted = 0.0, False

    def start(self, runs) -> None:
        for run in runs:
            run()
            self.counted = True

    def allocate(self, count, type, dtype):
        return Memory(count, type, dtype)

    def part(self, memory, begin, count):
        self.parts.append((begin, count))
        return Memory(count)


@dataclass
class Compiler:
    """A compiler beside the runs: it has ended unless it is `slow`, and gives what `kernels` does."""

    kernels: object
    slow: bool = False
    busy: bool = False
    asked: list[int] = field(default_factory=list)
    seconds: float = 0.0

    def begin(self, lanes):
        self.asked.append(lanes)
        return SimpleNamespace(done=lambda: not self.slow, result=lambda: (self.kernels(lanes), self.seconds))


@pytest.fixture
def clock(monkeypatch, tmp_path):
    made = Clock()
    monkeypatch.setattr(widths, "time", made)
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "cache"))
    return made


def call(*shape: int) -> Call:
    count = int(np.prod(shape))
    return Call(shape, (np.zeros(count, np.float32), np.zeros(1, np.float32)), (np.zeros(count, np.float32),), {}, {})


def device_call(*shape: int) -> DeviceCall:
    count = int(np.prod(shape))
    return DeviceCall(shape, (Memory(count), Memory(1)), (Memory(count),), None, {}, {})


def choosing(clock, paces, seconds=0.1, measured=(), spread=0):
    """A choice that begins with the width that was measured first, or 8; `paces` are those of 8, 16, 32, 64."""
    kernels = {lanes: Fake(lanes, pace, clock) for lanes, pace in zip((8, 16, 32, 64), paces, strict=False)}
    first = kernels[measured[0] if measured else 8]
    compiler = Compiler(kernels.__getitem__)
    return Choosing(first, tuple(kernels), compiler, seconds, "0" * 64, Space(clock), measured, spread), kernels


@pytest.mark.parametrize(("paces", "chosen"), [((1e-6, 0.7e-6), 16), ((1e-6, 1.3e-6), 8), ((1e-6, 0.99e-6), 8)])
def test_the_faster_width_stays_and_is_remembered(clock, paces, chosen):
    choice, _ = choosing(clock, paces)
    for _ in range(19):
        given = call(20_000)
        choice.run(given)
    assert (given.outputs[0] == chosen).all()
    assert choice.source == f"float{chosen}"
    assert choice.notes[-1].startswith(f"{chosen} lanes, whose runs of this program take ")
    assert measured_widths("0" * 64, (8, 16)) == (chosen, 24 - chosen)
    assert measured_widths("0" * 64, (4, 32)) == ()


@pytest.mark.parametrize(
    ("paces", "chosen", "tried"),
    [
        ((4e-6, 3e-6, 2e-6, 1e-6), 64, {8, 16, 32, 64}),
        ((4e-6, 3e-6, 2e-6, 2e-6), 32, {8, 16, 32, 64}),
        ((4e-6, 3e-6, 3e-6, 1e-6), 64, {8, 16, 32, 64}),
        ((4e-6, 4e-6, 4e-6, 3e-6), 64, {8, 16, 32, 64}),
        ((4e-6, 3e-6, 4e-6, 1e-6), 16, {8, 16, 32}),
        ((4e-6, 4.5e-6, 1e-6, 1e-6), 8, {8, 16}),
    ],
)
def test_wider_packets_are_tried_until_one_loses(clock, paces, chosen, tried):
    choice, kernels = choosing(clock, paces)
    for _ in range(60):
        choice.run(call(20_000))
    assert choice.source == f"float{chosen}"
    assert {lanes for lanes, kernel in kernels.items() if kernel.shapes} == tried
    kept = measured_widths("0" * 64, (4, 8, 16, 32, 64))
    assert kept[0] == chosen
    assert set(kept) == tried


def test_each_trial_waits_until_runs_have_taken_as_long_as_compiling(clock):
    choice, kernels = choosing(clock, (1e-6, 5e-7, 2.5e-7))
    choice._builder.seconds = 1.0
    while choice.source == "float8":
        choice.run(call(20_000))
    assert choice.notes[-1].startswith("16 lanes, whose runs of this program take 0.50 of the time of 8; 32 are tried")
    for _ in range(99):
        choice.run(call(20_000))
    assert kernels[32].shapes == []
    choice.run(call(20_000))
    choice.run(call(20_000))
    assert kernels[32].shapes != []


def test_a_later_process_goes_on_with_what_was_measured(clock):
    choice, kernels = choosing(clock, (4e-6, 3e-6, 2e-6, 2e-6), measured=(16, 8))
    for _ in range(60):
        choice.run(call(20_000))
    assert kernels[8].shapes == []
    assert choice.notes[-1].startswith("32 lanes, whose runs of this program take 0.67 of the time of 16 and 1.00")


@pytest.mark.parametrize(
    ("current", "measured", "wanted"),
    [(8, {8}, 16), (8, {8, 16}, 4), (8, {4, 8, 16}, None), (16, {8, 16}, 32), (64, {32, 64}, None), (4, {4, 8}, None)],
)
def test_the_wider_neighbour_is_measured_first(current, measured, wanted):
    assert next_width(current, measured, (4, 8, 16, 32, 64)) == wanted


def test_a_level_width_does_not_end_the_trials_of_a_later_process(clock):
    """The process ends after 32 lanes were found to be level with 16: the next one measures 32 and then 64."""
    choice, _ = choosing(clock, (4e-6, 3e-6, 3e-6, 1e-6), measured=(16, 8))
    while "1.00 of the time of 32" not in choice.notes[-1]:
        choice.run(call(20_000))
    assert measured_widths("0" * 64, (8, 16, 32, 64)) == (16, 8)
    later, _ = choosing(clock, (4e-6, 3e-6, 3e-6, 1e-6), measured=(16, 8))
    for _ in range(60):
        later.run(call(20_000))
    assert later.source == "float64"
    assert measured_widths("0" * 64, (8, 16, 32, 64)) == (64, 8, 16, 32)


def test_nothing_is_tried_before_the_runs_have_taken_as_long_as_compiling(clock):
    choice, kernels = choosing(clock, (1e-6, 1e-7), seconds=0.19)
    for _ in range(9):
        choice.run(call(20_000))
    assert kernels[16].shapes == []
    assert choice.notes == ("8 lanes; 16 are tried once runs have taken as long as compiling",)
    choice.run(call(20_000))
    choice.run(call(20_000))
    assert kernels[16].shapes != []


def test_no_run_waits_for_a_compiler(clock):
    choice, _ = choosing(clock, (1e-6, 0.7e-6))
    choice._builder.slow = True
    for _ in range(500):
        choice.run(call(20_000))
    assert clock.now == pytest.approx(500 * 0.02)
    assert choice._builder.asked == [16]
    assert choice.notes == ("8 lanes; 16 are tried once another process has compiled them",)
    choice._builder.slow = False
    choice.run(call(20_000))
    assert choice.notes == ("8 lanes; 16 are tried now",)


def test_a_trial_adds_about_a_run_to_each_run(clock):
    """The first sample of another width is run once more."""
    choice, _ = choosing(clock, (6e-7, 0.7 * 6e-7), seconds=0.01)
    taken = []
    while choice.source == "float8":
        begin = clock.now
        choice.run(call(100, 1000))
        taken.append(clock.now - begin)
    assert taken[:2] == pytest.approx([0.06, 0.06 + 0.03 * (1 + 2 * 0.7)])
    assert taken[2:] == pytest.approx([0.06 + 0.03 * (1 + 0.7)] * (len(taken) - 2))


def test_nothing_is_tried_while_another_kernel_is_compiled(clock):
    choice, kernels = choosing(clock, (1e-6, 0.7e-6))
    choice._builder.busy = True
    for _ in range(99):
        choice.run(call(20_000))
    assert kernels[16].shapes == []
    choice._builder.busy = False
    choice.run(call(20_000))
    assert kernels[16].shapes != []


def test_trials_end_where_there_is_no_memory_for_samples(clock):
    choice, kernels = choosing(clock, (1e-6, 0.7e-6))

    def refuse(given):
        raise MemoryError

    kernels[16].run = refuse
    for _ in range(9):
        choice.run(call(20_000))
    assert choice.notes == ("8 lanes, since there is no memory for trials",)


def test_short_runs_say_nothing_about_a_width(clock):
    choice, kernels = choosing(clock, (0.9e-6, 1e-7))
    for _ in range(999):
        choice.run(call(1000))
    assert kernels[16].shapes == []


def test_short_runs_that_are_disturbed_say_nothing_either(clock):
    choice, kernels = choosing(clock, (0.9e-6, 1e-7))
    disturb(kernels[8], clock, (0.0, 0.01, 0.02))
    for _ in range(999):
        choice.run(call(1000))
    assert kernels[16].shapes == []


def test_long_runs_of_few_elements_do(clock):
    choice, _ = choosing(clock, (1e-5, 0.7e-5))
    for _ in range(40):
        choice.run(call(1000))
    assert choice.source == "float16"


def test_the_results_of_the_run_that_is_tried_stay(clock):
    choice, _ = choosing(clock, (1e-5, 1e-6))
    given = call(100, 200)
    choice.run(given)
    assert (given.outputs[0] == 8).all()


def test_a_part_of_a_long_run_is_enough(clock):
    choice, kernels = choosing(clock, (1e-4, 1e-5))
    choice.run(call(100, 200))
    kernels[8].shapes.clear()
    choice.run(call(100, 200))
    assert set(kernels[16].shapes) == {(2, 200)}
    assert kernels[8].shapes == [(100, 200)] + 5 * [(2, 200)]


def test_a_disturbed_run_does_not_decide(clock):
    """Other programs slow most of the runs of the faster width."""
    choice, kernels = choosing(clock, (1e-6, 0.7e-6), seconds=0.02)
    disturb(kernels[16], clock, (0.02, 0.01, 0.03, 0.0, 0.02, 0.01, 0.04))
    for _ in range(19):
        choice.run(call(20_000))
    assert choice.source == "float16"


def disturb(kernel, clock, seconds):
    """Let other programs take these seconds of a kernel's runs, over and over."""
    run, taken = kernel.run, itertools.cycle(seconds)

    def disturbed(given):
        clock.others += next(taken)
        run(given)

    kernel.run = disturbed


@pytest.mark.parametrize(
    ("spread", "resolution", "chosen"), [(16_000 // 16, 1e-9, 16), (20_000, 1e-9, 8), (1, 1e-2, 8)]
)
def test_cpu_time_decides_where_all_cores_have_work(clock, spread, resolution, chosen):
    """A run that leaves cores idle, or a clock that is too coarse, needs the time on the wall."""
    clock.resolution = resolution
    choice, kernels = choosing(clock, (1e-6, 0.7e-6), seconds=0.02, spread=spread)
    disturb(kernels[16], clock, (0.02, 0.01, 0.03))
    for _ in range(19):
        choice.run(call(20_000))
    assert choice.source == f"float{chosen}"


@pytest.mark.parametrize(("paces", "chosen"), [((1e-6, 0.7e-6), 16), ((1e-6, 1.3e-6), 8), ((1e-6, 0.99e-6), 8)])
def test_runs_over_streams_are_tried_too(clock, paces, chosen):
    choice, _ = choosing(clock, paces)
    calls = [device_call(20_000) for _ in range(19)]
    for given in calls:
        choice._space.start([choice.ready(given, once=True)])
    assert choice.source == f"float{chosen}"
    assert measured_widths("0" * 64, (8, 16)) == (chosen, 24 - chosen)
    writers = [given.outputs[0].writers for given in calls]
    assert writers == [[8]] * 17 + [[chosen]] * 2  # samples, 12 of them from the sixth run on, are written elsewhere


def test_a_run_that_is_repeated_changes_its_width(clock):
    choice, _ = choosing(clock, (1e-6, 0.7e-6))
    given = device_call(20_000)
    run = choice.ready(given)
    for _ in range(19):
        run()
    assert given.outputs[0].writers == [8] * 16 + [16] * 3


def test_only_the_first_run_over_streams_is_waited_for(clock):
    """It tells how long the others take; one over many more elements is waited for again."""
    choice, _ = choosing(clock, (1e-7, 0.7e-7), seconds=0.5)
    for count in (20_000, 20_000, 40_000, 9_000, 50_000, 50_000):
        choice._space.start([choice.ready(device_call(count))])
    assert choice._space.waits == 3  # for the first, for those started before the fifth, and for the fifth
    assert choice._spent == pytest.approx(189_000e-7 - 9_000e-7)


def test_the_middle_of_a_long_run_over_streams_is_enough(clock):
    choice, kernels = choosing(clock, (1e-4, 1e-5))
    choice.ready(device_call(100, 200))()
    kernels[8].shapes.clear()
    choice.ready(device_call(100, 200))()
    assert set(kernels[16].shapes) == {(2, 200)}
    assert kernels[8].shapes == [(100, 200)] + 5 * [(2, 200)]
    assert set(choice._space.parts) == {(49 * 200, 400)}  # the other input is one element for all


def test_a_width_that_does_not_compile_is_left_alone(clock):
    def refuse(lanes):
        raise CompileError("no float16 here")

    choice = Choosing(Fake(8, 1e-4, clock), (8, 16), Compiler(refuse), 0.1, "0" * 64, Space(clock))
    choice.run(call(20_000))
    choice.run(call(20_000))
    assert choice.source == "float8"
    assert choice.notes == ("8 lanes, since 16 do not compile: no float16 here",)


@pytest.mark.parametrize("where", ["arrays", "streams", "chain"])
def test_a_kernel_that_changes_its_width_gives_the_same_bits(monkeypatch, tmp_path, where):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(widths, "time", Ticks())
    monkeypatch.setattr(widths, "_GAIN", 1e9)  # the other width always wins

    @sh.program
    def wave(x: sh.Attrib1f):
        return {"y": x * x / (1 + x) + 0.125 * sh.grid_index(1)}

    x = np.linspace(0, 9, 20_000, dtype=np.float32)
    limit = 12_345 + ord(where[0])  # a kernel that nobody has compiled yet
    printed, print_ = [], runtime._printed
    monkeypatch.setattr(runtime, "_printed", lambda *given: printed.append(given[-1]) or print_(*given))
    kernel, expected = wave.compile("opencl", loop_limit=limit), wave.compile("numpy")(x)["y"]
    machine, texts = machine_of(None), [kernel.source]
    stream = sh.Stream(x, sh.Attrib1f, "opencl")
    while "are tried" in kernel.notes[-1]:
        if where == "arrays":
            found = kernel(x)["y"]
        else:
            streams = kernel(stream) if where == "streams" else sh.sequence(kernel).run(x=stream).streams
            found = streams["y"].numpy()
        assert np.array_equal(found, expected)
        texts.append(kernel.source)
    wider = [lanes for lanes in machine.widths if lanes > machine.lanes > 1]
    assert len(set(texts)) == 1 + len(wider)
    assert all(f"float{lanes} " in kernel.source for lanes in wider[-1:])
    assert printed == [machine.lanes]  # the others were compiled elsewhere
