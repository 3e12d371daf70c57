"""Outputs of runs over arrays: written in place where that is possible, and nothing but what the program wrote."""

import gc
import weakref

import numpy as np
import pytest

import shpy as sh
from shpy import SH_DISCARD, SH_DO, SH_UNTIL
from shpy.backend.base import Call
from shpy.backend.opencl.device import outputs
from shpy.backend.opencl.device.driver import machine_of
from shpy.ir.nodes import Status
from shpy.run import tiers

COUNT = 70_000
X = np.random.default_rng(5).normal(0, 1, COUNT).astype(np.float32)
PLACES = {"one": (COUNT,), "image": (250, 280), "small": (60,)}


@sh.program
def several(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib3f, sh.Attrib1i, sh.Attrib1b, sh.Attrib2f]:
    SH_DISCARD(x > 0.5)
    n = sh.Attrib1i(0)
    y = sh.Attrib1f(x)
    with SH_DO():
        y[:] = y * 0.75 + 1
        n += 1
        SH_UNTIL(y > 2.5)
    return y, sh.Attrib3f(x, y, -1), n, y > x, sh.Attrib2f(y, 7)


@sh.program
def endless(x: sh.Attrib1f) -> sh.Attrib2f:
    y = sh.Attrib1f(x)
    with SH_DO():
        y[:] = y + 1
        SH_UNTIL((y > 3) & (x < 1.5))
    return sh.Attrib2f(y, x)


@pytest.mark.parametrize("shape", PLACES.values(), ids=PLACES)
@pytest.mark.parametrize("precision", ["f16", "f32", "f64"])
def test_elements_that_are_not_written_are_zeros(shape, precision):
    x = X[: np.prod(shape)].reshape(shape)
    kernel = several.compile("opencl", precision=precision)
    for _ in range(2):  # memory that is used again holds numbers of the run before
        results = kernel(x)
        for result, expected in zip(results, several.compile("numpy", precision=precision)(x), strict=True):
            assert result.dtype == expected.dtype
            assert result.tobytes() == expected.tobytes()
        discarded = x.astype(results[0].dtype) > 0.5
        assert not results[0][discarded].any()
        assert results[0][~discarded].all()


def test_elements_that_a_loop_stopped_are_zeros():
    kernel = endless.compile("opencl", loop_limit=50)
    result = np.zeros((COUNT, 2), np.float32)
    status = kernel._executable.run(Call(X.shape, (X,), (result,), {}, {}, fresh=True))
    stopped = X >= 1.5
    assert stopped.any()
    assert np.array_equal(status, np.where(stopped, Status.FIRST_LOOP, Status.WRITTEN))
    assert not result[stopped].any()
    assert np.array_equal(result[~stopped, 1], X[~stopped])
    with pytest.raises(sh.LoopLimitExceeded):
        kernel(X)


def test_elements_of_the_callers_array_that_are_not_written_stay():
    @sh.program
    def one(x: sh.Attrib1f) -> sh.Attrib3f:
        SH_DISCARD(x > 0.5)
        return sh.Attrib3f(x, x * 2, -1)

    for kernel in (kernel for kernel in map(one.compile, ("numpy", "opencl")) for _ in range(2)):
        out = np.full((COUNT, 3), 9, np.float32)
        kernel.run(X, out=out)
        assert (out[X > 0.5] == 9).all()
        assert np.array_equal(out[X <= 0.5], np.stack([X, X * 2, np.full_like(X, -1)], -1)[X <= 0.5])


def test_new_outputs_are_the_memory_that_the_kernel_writes(monkeypatch):
    machine = machine_of(None)
    copied = []
    monkeypatch.setattr(type(machine), "download", lambda self, array, *_: copied.append(array.nbytes))
    written = several.compile("opencl")(X)
    shares = machine.shares_memory
    bools = written[3].nbytes  # which a buffer holds as bytes
    assert copied == ([bools] if shares else [*(a.nbytes for a in written), 4 * COUNT])


def test_what_the_device_writes_is_kept_until_an_interrupted_run_has_ended(monkeypatch):
    """The statuses belong to no caller, so that nobody else would hold them."""
    abandoned, arrays = [], []

    def interrupted(machine, prepared, call, written):
        arrays.extend(weakref.ref(output.array) for output in written if output.array is not None)
        raise KeyboardInterrupt

    machine = machine_of(None)
    monkeypatch.setattr("shpy.backend.opencl.device.run.collect", interrupted)
    monkeypatch.setattr(type(machine), "abandon", lambda self, things: abandoned.append(things))
    with pytest.raises(KeyboardInterrupt):
        several.compile("opencl")(X)
    machine.queue.finish()
    gc.collect()
    assert arrays or not machine.shares_memory
    assert all(array() is not None for array in arrays)
    abandoned.clear()
    gc.collect()
    assert all(array() is None for array in arrays)


def test_numpy_begins_with_zeros_again_after_an_error_of_opencl(monkeypatch):
    for name, value in {"_COLD": (0, 0), "_CACHED": (0, 0), "_START": 0, "_COMPILER": 0, "_LOOK": 0}.items():
        monkeypatch.setattr(tiers, name, value)
    collect = outputs.collect

    def failing(machine, prepared, call, arrays):
        collect(machine, prepared, call, arrays)
        for array in call.outputs:
            array.fill(5)
        raise MemoryError("the device is full")

    monkeypatch.setattr("shpy.backend.opencl.device.run.collect", failing)
    executable = tiers.auto.compile(several.ir, several.compile("auto").options)
    expected = several.compile("numpy")(X)
    for _ in range(2):
        results = [np.zeros_like(array) for array in expected]
        status = executable.run(Call(X.shape, (X,), tuple(results), {}, {}, fresh=True))
        assert np.array_equal(status == Status.WRITTEN, X <= 0.5)
        for result, right in zip(results, expected, strict=True):
            assert result.tobytes() == right.tobytes()
    assert executable.notes[-1] == "runs on numpy: opencl gave an error (MemoryError: the device is full)"
