"""Chains under the backend "auto": numpy's bits before, while and after OpenCL takes over, and results on numpy."""

import gc
import importlib
import pickle
import sys
import threading

import dask.array as dask_array
import numpy as np
import pytest

import shpy as sh
from shpy.backend.opencl.device import building as opencl
from shpy.chains import takeover
from shpy.chains.running import Run
from shpy.display.screen import Moment
from shpy.pictures.evolution import Evolution
from shpy.run import tiers
from shpy.testing.arrays import flat_leaves

RNG = np.random.default_rng(7)
FIELD = RNG.random((37, 150), np.float32)
EAGER = {"_COLD": (0.0, 0.0), "_CACHED": (0.0, 0.0), "_START": 0.0, "_COMPILER": 0.0, "_LAUNCH": 0.0, "_TRIED": 1000}
"""Constants with which OpenCL takes over at the first start of a kernel, and is not compared with numpy."""


@pytest.fixture(autouse=True)
def auto(monkeypatch):
    monkeypatch.setenv("SHPY_BACKEND", "auto")
    monkeypatch.setattr("shpy.backend.registry._default", None)


@pytest.fixture
def eager(monkeypatch):
    for name, value in EAGER.items():
        monkeypatch.setattr(tiers, name, value)


@sh.program
def smooth(u: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    i = sh.grid_index(2)
    return 0.25 * (u[i + (0, 1)] + u[i - (0, 1)] + u[i + (1, 0)] + u[i - (1, 0)])


@sh.program
def halve(x: sh.Attrib1i, steps: sh.Attrib1i):
    sh.SH_DISCARD(x <= 1)
    return {"x": x // 2, "steps": steps + 1}


@sh.program
def add(total: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    return total + sh.sqrt(sh.Attrib1f(n))


@sh.struct
class Particle:
    at: sh.Point2f
    speed: sh.Vector2f


@sh.program
def fall(p: Particle) -> Particle:
    return Particle(p.at + 0.1 * p.speed, p.speed - (0, 0.98))


@sh.program
def is_large(total: sh.Attrib1f) -> sh.Attrib1b:
    return total > 0.5


@sh.program
def waves():
    i = sh.grid_index(2)
    return {"total": sh.sin(sh.Attrib1f(i.x * 7 + i.y))}


NUMBERS = np.arange(1, 900, dtype=np.int32)
PARTICLES = {"at": RNG.random((500, 2), np.float32), "speed": RNG.random((500, 2), np.float32)}
CASES = {
    "repeat": (lambda: sh.repeat(smooth, 9), {"u": FIELD}),
    "loop": (lambda: sh.loop(halve), {"x": NUMBERS, "steps": np.zeros_like(NUMBERS)}),
    "index": (lambda: sh.repeat(add, 5, index="n"), {"total": FIELD}),
    "where": (lambda: sh.repeat(add, 5, index="n", where=is_large), {"total": FIELD}),
    "sequence": (lambda: sh.sequence(sh.repeat(smooth, 4), sh.repeat(smooth, 3)), {"u": FIELD}),
    "struct": (lambda: sh.repeat(fall, 6), {"p": PARTICLES}),
    "shape": (lambda: sh.sequence(waves, sh.repeat(add, 3)), {"n": 2, "shape": (20, 70)}),
    "number": (lambda: sh.repeat(add, 3), {"total": FIELD, "n": 2}),
}


def contents(result):
    """Return the shapes and bits of a result's streams, and its counts."""
    streams = {
        name: (s.shape, [np.asarray(x).tobytes() for x in flat_leaves(s.numpy())]) for name, s in result.streams.items()
    }
    return streams, result.executions, result.counts


@pytest.mark.parametrize("precision", ["f32", pytest.param("f16", marks=pytest.mark.slow), "f64"])
@pytest.mark.parametrize("case", CASES)
def test_results_have_the_bits_of_numpy_and_lie_there(eager, case, precision):
    chain, inputs = CASES[case][0](), CASES[case][1]
    before = pickle.dumps(inputs)
    expected = chain.run(**inputs, backend="numpy", precision=precision)
    assert chain.runs_on == "numpy"
    for _ in range(3):
        result = chain.run(**inputs, precision=precision)
        assert contents(result) == contents(expected)
        assert {stream.place.backend for stream in result.streams.values()} == {"numpy"}
    assert chain.runs_on == "opencl"
    assert chain.notes[0].startswith("runs on opencl, after ")
    assert pickle.dumps(inputs) == before


def test_a_chain_that_repeats_tells_the_rest_and_a_small_one_stays(monkeypatch):
    """One of 1,000 passes is enough to know that the others pay. A start of OpenCL takes longer than a small pass."""
    for name in ("_COLD", "_CACHED"):
        monkeypatch.setattr(tiers, name, (0.01, 0.0))
    for name in ("_START", "_COMPILER"):
        monkeypatch.setattr(tiers, name, 0.0)
    chain = sh.repeat(smooth, 1000)
    chain.run(u=FIELD)
    assert chain.runs_on == "opencl"
    assert float(chain.notes[0].split()[4]) == 0.0
    monkeypatch.setattr(tiers, "_LAUNCH", 3600.0)
    opened = []
    monkeypatch.setattr(takeover.Takeover, "_run_on_opencl", lambda self, begin: opened.append(begin))
    chain._takeover._was_small = True
    assert contents(chain.run(u=FIELD)) == contents(chain.run(u=FIELD, backend="numpy"))
    assert not opened


def test_streams_kernels_and_backends_say_where_a_chain_runs(eager, monkeypatch):
    chain = sh.repeat(smooth, 3)
    stream = sh.Stream(FIELD, sh.Attrib1f)
    for _ in range(3):
        assert chain.run(u=stream).streams["u"].place.backend == "numpy"
        chain.run(u=FIELD, backend="numpy")
        assert chain.run(u=FIELD, backend="opencl").streams["u"].place.backend == "opencl"
        compiled = sh.repeat(smooth.compile("numpy"), 3)
        compiled.run(u=FIELD)
        assert (chain.runs_on, compiled.runs_on) == ("numpy", "numpy")
    monkeypatch.setenv("SHPY_BACKEND", "opencl")
    assert chain.run(u=FIELD).streams["u"].place.backend == "opencl"
    assert chain.runs_on == "opencl"
    assert chain.notes == ("chosen by SHPY_BACKEND",)


def test_mistakes_are_the_callers_and_change_nothing(eager):
    chain = sh.repeat(add, 3)
    chain.run(total=FIELD, n=2)
    assert chain.runs_on == "opencl"
    for inputs in ({"total": FIELD}, {"total": FIELD, "n": 2, "other": 3}, {"total": FIELD, "n": np.ones(4, np.int32)}):
        messages = []
        for backend in (None, "numpy"):
            with pytest.raises(sh.ShpyTypeError) as raised:
                chain.run(**inputs, backend=backend)
            assert raised.value.__context__ is None
            messages.append(str(raised.value))
        assert messages[0] == messages[1]
        assert chain.runs_on == "opencl"


def test_limits_give_the_streams_so_far_on_numpy(eager):
    chain = sh.loop(halve, loop_limit=4)
    inputs = {"x": NUMBERS, "steps": np.zeros_like(NUMBERS)}
    results = []
    for backend in ("numpy", None, None):
        with pytest.raises(sh.LoopLimitExceeded) as raised:
            chain.run(**inputs, backend=backend)
        assert {s.place.backend for s in raised.value.result.streams.values()} == {"numpy"}
        results.append((str(raised.value), contents(raised.value.result)))
    assert results[0] == results[1] == results[2]
    assert chain.runs_on == "opencl"


@pytest.mark.parametrize("way", ["refused", "missing", "inexact", "slower"])
def test_numpy_stays_where_opencl_may_not_cannot_or_is_slower(eager, monkeypatch, way):
    def refuse(*_):
        raise RuntimeError("out of resources")

    reason = {
        "refused": "opencl does not take it (RuntimeError: out of resources)",
        "missing": "there is no opencl here",
        "inexact": "opencl's device gets denormals wrong",
        "slower": "opencl is slower here",
    }[way]
    if way == "refused":
        monkeypatch.setattr(opencl.OpenCLBackend, "compile", refuse)
    elif way == "missing":
        monkeypatch.setattr(tiers, "is_installed", lambda: False)
    elif way == "inexact":
        monkeypatch.setattr(opencl.OpenCLBackend, "faults", lambda *_: frozenset({"denormals"}))
    else:
        monkeypatch.setattr(tiers, "_TRIED", 1)
        monkeypatch.setattr(takeover.time, "perf_counter", iter(range(0, 10**9, 10**6)).__next__)

    @sh.program
    def own(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * 1.25 + 0.5

    chain = sh.repeat(own, 4)
    expected = contents(chain.run(x=FIELD, backend="numpy"))
    for _ in range(3):
        assert contents(chain.run(x=FIELD)) == expected
    assert chain.runs_on == "numpy"
    assert chain.notes == (f"runs on numpy: {reason}",)


def test_threads_and_copies_in_other_processes(eager):
    chain, results = sh.repeat(smooth, 6), []
    expected = contents(chain.run(u=FIELD, backend="numpy"))
    threads = [threading.Thread(target=lambda: results.append(contents(chain.run(u=FIELD)))) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [expected] * 6
    assert chain.runs_on == "opencl"
    assert pickle.loads(pickle.dumps(chain)).runs_on == "numpy"


@pytest.mark.parametrize("scheduler", ["synchronous", "threads"])
def test_blocks_of_dask_arrays_have_the_bits_of_one_run(eager, scheduler):
    field = RNG.random((90, 120), np.float32)
    blocks = sh.map_overlap(sh.repeat(smooth, 4), {"u": dask_array.from_array(field, chunks=(40, 50))})["u"]
    expected = sh.repeat(smooth, 4).run(u=field, backend="numpy").streams["u"].numpy()
    assert blocks.compute(scheduler=scheduler).tobytes() == expected.tobytes()


def test_no_run_holds_memory_after_its_end(eager):
    chain = sh.repeat(smooth, 6)
    gc.collect()
    gc.disable()
    try:
        for _ in range(3):
            chain.run(u=FIELD)
            assert not [it for it in gc.get_objects() if isinstance(it, Run)]
    finally:
        gc.enable()
    assert chain.runs_on == "opencl"


EDITED = """\
import shpy as sh

@sh.program
def scale(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * {factor}

chain = sh.repeat(scale, 3)
"""


def test_an_edited_file_is_another_chain(eager, monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    for factor, expected in ((2.0, 8.0), (3.125, 30.517578125)):
        (tmp_path / "edited_chain.py").write_text(EDITED.format(factor=factor))
        importlib.invalidate_caches()
        sys.modules.pop("edited_chain", None)
        chain = importlib.import_module("edited_chain").chain
        for _ in range(2):
            assert chain.run(x=np.ones(9)).streams["x"].numpy()[0] == expected
        assert chain.runs_on == "opencl"
    del sys.modules["edited_chain"]


def evolved(chain, values, frames, **options):
    """Return the bits of each frame's streams of an evolution, and the chain's backend after it."""
    evolution, moment = Evolution(chain, None, values, **options), Moment((5, 4))
    frame_bits = []
    for _ in range(frames):
        evolution.step(moment)
        arrays = (s.numpy() if isinstance(s, sh.Stream) else s for s in evolution._streams.values())
        frame_bits.append([np.asarray(leaf).tobytes() for array in arrays for leaf in flat_leaves(array)])
    return frame_bits, chain.runs_on


@pytest.mark.parametrize("case", ["repeat", "loop", "struct", "index"])
def test_animations_and_widgets_go_on_with_opencl(eager, case):
    chain, inputs = CASES[case][0](), CASES[case][1]
    expected, _ = evolved(chain, inputs, 4, backend="numpy")
    assert evolved(chain, inputs, 4) == (expected, "opencl")


def test_a_stream_or_a_compiled_kernel_pins_an_animation(eager):
    chain = sh.repeat(smooth, 9)
    expected, _ = evolved(chain, {"u": FIELD}, 3, backend="numpy")
    assert evolved(chain, {"u": sh.Stream(FIELD, sh.Attrib1f, "numpy")}, 3) == (expected, "numpy")
    compiled = sh.repeat(smooth.compile("opencl"), 9)
    evolution = Evolution(compiled, None, {"u": FIELD})
    for frame in expected:
        evolution.step(Moment((5, 4)))
        assert evolution._streams["u"].backend == "opencl"  # it is not copied between frames
        assert [evolution._streams["u"].numpy().tobytes()] == frame


def test_an_animation_without_a_backend_has_the_frames_of_numpy(eager, tmp_path):
    @sh.program
    def brown(u: sh.Attrib1f) -> sh.Color3f:
        return sh.Color3f(u, u * 0.5, u * u)

    for backend in (None, "numpy"):
        chain = sh.repeat(smooth, 5)
        sh.animate(chain, tmp_path / f"{backend}.gif", frames=4, show=brown, u=FIELD, backend=backend)
    assert (tmp_path / "None.gif").read_bytes() == (tmp_path / "numpy.gif").read_bytes()
