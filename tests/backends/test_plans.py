"""Calls like the one before take a short way: they give the same as the first call, whatever has changed since."""

from __future__ import annotations

import numpy as np
import pytest

import shpy as sh
from shpy.backend.registry import NAMES

every = pytest.mark.parametrize("name", NAMES)
gain = sh.Param(sh.Attrib2f, (1, 2), name="gain")


@sh.program
def scaled(x: sh.Attrib2f, by: sh.Attrib1f) -> sh.Attrib2f:
    sh.SH_DISCARD(x.x < 0)
    return x * by * gain


@sh.program
def parts(x: sh.Attrib1i, y: sh.Attrib1i) -> tuple[sh.Attrib1i, sh.Attrib1b]:
    return x - y, x > y


def expected(x, by, factors):
    return np.where(x[..., :1] < 0, np.float32(0), x * np.float32(by) * np.float32(factors))


@every
def test_a_second_call_is_planned_and_gives_the_same(name):
    kernel, x = scaled.compile(name), np.random.default_rng(1).normal(size=(40, 2)).astype(np.float32)
    gain.value = (1, 2)
    first = kernel(x, 3.0)
    assert [key for key, bound in kernel._bound_calls.items() if bound is not None]
    assert np.array_equal(kernel(x, 3.0), first)
    assert np.array_equal(kernel(-x, 3.0), expected(-x, 3, (1, 2)))
    gain.value = (4, 8)
    assert np.array_equal(kernel(x, 0.5), expected(x, 0.5, (4, 8)))
    assert np.array_equal(kernel(x[:7], 3.0), expected(x[:7], 3, (4, 8)))
    gain.value = (1, 2)


@every
@pytest.mark.parametrize("count", [3, 50_000])
def test_out_may_be_an_input_or_a_part_of_it(name, count):
    kernel, x = scaled.compile(name), np.random.default_rng(2).normal(size=(count, 2)).astype(np.float32)
    wanted = np.where(x[:, :1] < 0, x, expected(x, 2, (1, 2)))
    for _ in range(3):
        given = x.copy()
        result = kernel.run(given, 2.0, out=given)
        assert result.outputs is given
        assert np.array_equal(given, wanted)
        assert result.count == result.written.sum() == (x[:, 0] >= 0).sum()
    whole = np.zeros((count + 1, 2), np.float32)
    whole[:-1] = x
    kernel.run(whole[:-1], 2.0, out=whole[1:])
    assert np.array_equal(whole[1:], np.where(x[:, :1] < 0, whole[1:], expected(x, 2, (1, 2))))


@every
def test_several_outputs_and_results_that_are_kept_apart(name):
    kernel, x = parts.compile(name), np.arange(20, dtype=np.int32)
    results = [kernel(x, np.int32([k])) for k in range(4)]
    for k, (difference, more) in enumerate(results):
        assert np.array_equal(difference, x - k)
        assert more.dtype == np.bool_
        assert np.array_equal(more, x > k)


@every
def test_whatever_is_converted_or_broadcast_is_checked_each_time(name):
    kernel = parts.compile(name)
    for _ in range(2):
        grid = np.arange(6, dtype=np.int32).reshape(2, 3)
        assert np.array_equal(kernel(grid, np.int32([0, 1, 5]))[0], grid - [0, 1, 5])
        with pytest.raises(sh.ShpyTypeError, match="out of the range"):
            kernel(np.array([2**40]), np.array([1]))
        with pytest.raises(sh.ShpyTypeError, match="takes ints, not float32"):
            kernel(np.float32([1]), np.int32([1]))
        assert kernel(np.array([1, 2], ">i4"), np.array([1, 1], np.int32))[0].tolist() == [0, 1]


@pytest.mark.parametrize("name", ["numpy", "opencl"])
def test_each_precision_has_plans_of_its_own(name):
    x = np.array([[1.1, 2.2]])
    for precision, dtype in (("f32", np.float32), ("f64", np.float64)):
        kernel = scaled.compile(name, precision=precision)
        for _ in range(3):
            found = kernel(x.astype(dtype), 0.1)
            assert found.dtype == dtype
            assert np.array_equal(found, x.astype(dtype) * dtype(0.1) * dtype([1, 2]))


@pytest.fixture
def checks(monkeypatch):
    """The runs whose inputs were checked."""
    made, prepare = [], sh.Kernel.prepare_on_device
    monkeypatch.setattr(sh.Kernel, "prepare_on_device", lambda *given: made.append(1) or prepare(*given))
    return made


@every
def test_streams_of_a_signature_are_checked_once(name, checks):
    kernel, x = scaled.compile(name), np.random.default_rng(3).normal(size=(40, 2)).astype(np.float32)
    by = np.linspace(1, 2, 40, dtype=np.float32)
    lots, factor = sh.Stream(x, sh.Attrib2f, name), sh.Stream(by, sh.Attrib1f, name)
    gain.value = (1, 2)
    first = kernel(lots, factor)
    assert np.array_equal(first.numpy(), expected(x, by[:, None], (1, 2)))
    gain.value = (4, 8)
    second = kernel.run(lots, factor)
    assert np.array_equal(second.outputs.numpy(), expected(x, by[:, None], (4, 8)))
    assert second.count == (x[:, 0] >= 0).sum()
    assert np.array_equal(first.numpy(), expected(x, by[:, None], (1, 2)))
    gain.value = (1, 2)
    assert len(checks) == 1
    kernel(lots, sh.Stream(2.0, sh.Attrib1f, name))
    kernel(lots, 3.0)
    assert len(checks) == 3


@every
def test_out_of_known_streams_is_checked_each_time(name, checks):
    kernel, x = scaled.compile(name), np.random.default_rng(4).normal(size=(33, 2)).astype(np.float32)
    by = sh.Stream(np.full(33, 2, np.float32), sh.Attrib1f, name)
    kernel(sh.Stream(x, sh.Attrib2f, name), by)
    target = sh.Stream(x, sh.Attrib2f, name)
    assert kernel.run(target, by, out=target).outputs is target
    assert np.array_equal(target.numpy(), np.where(x[:, :1] < 0, x, expected(x, 2, (1, 2))))
    assert len(checks) == 1
    with pytest.raises(sh.ShpyTypeError, match=r"not of sh.Attrib2f and the shape \(33,\)"):
        kernel.run(target, by, out=sh.Stream.empty(32, sh.Attrib2f, name))
    with pytest.raises(sh.ShpyTypeError, match="is an array and other data of this run are streams"):
        kernel.run(target, by, out=x)
    with pytest.raises(sh.ShpyTypeError, match="is not there"):
        kernel.run(target, by, out=sh.Stream.empty(33, sh.Attrib2f, "numpy", precision="f64"))
    assert np.array_equal(target.numpy(), np.where(x[:, :1] < 0, x, expected(x, 2, (1, 2))))


@every
def test_streams_of_other_types_and_places_are_checked(name):
    kernel, whole = parts.compile(name), np.arange(20, dtype=np.int32)
    x = sh.Stream(whole, sh.Attrib1i, name)
    for _ in range(2):
        difference, more = kernel(x, x)
        assert not difference.numpy().any()
        assert not more.numpy().any()
    with pytest.raises(sh.ShpyTypeError):
        kernel(x, sh.Stream(whole.astype(np.float32), sh.Attrib1f, name))
    with pytest.raises(sh.ShpyTypeError, match="is not there"):
        kernel(x, sh.Stream(whole, sh.Attrib1i, "numpy", precision="f64"))
    with pytest.raises(sh.ShpyTypeError, match="do not broadcast"):
        kernel(x, x[:7])


@sh.struct
class Body:
    at: sh.Attrib2f
    mass: sh.Attrib1i


@sh.program
def moved(body: Body, by: sh.Table[sh.Attrib2f], base: sh.Table[sh.Attrib1i, 2]) -> Body:
    return Body(body.at + by[body.mass], body.mass + base[0, 1])


@pytest.mark.sampled(3)
@every
def test_structs_and_tables_in_streams_are_checked_once(name, checks):
    kernel, rng = moved.compile(name), np.random.default_rng(5)
    at, by = (rng.integers(-99, 99, (n, 2)).astype(np.float32) for n in (40, 7))
    mass = rng.integers(0, 7, 40).astype(np.int32)
    bodies = sh.Stream({"at": at, "mass": mass}, Body, name)
    steps, rows = sh.Stream(by, sh.Attrib2f, name), sh.Stream(np.int32([[5, 3], [0, 0]]), sh.Attrib1i, name)
    for table in (steps, sh.Table(steps), sh.Table(steps)):
        result = kernel(bodies, table, sh.Table(rows)).numpy()
        assert np.array_equal(result.at, at + by[mass])
        assert np.array_equal(result.mass, mass + 3)
    assert len(checks) == 2, "a stream that is read by index has a signature of its own"
    steps.update(2 * by)
    rows.update(np.int32([[5, 1], [0, 0]]))
    kernel.run(bodies, sh.Table(steps), sh.Table(rows), out=bodies)
    assert np.array_equal(bodies.numpy().at, at + 2 * by[mass])
    assert np.array_equal(bodies.numpy().mass, mass + 1)
    assert len(checks) == 2
    with pytest.raises(sh.ShpyTypeError, match="out is memory that the Table"):
        kernel.run(bodies, sh.Table(bodies["at"]), sh.Table(rows), out=bodies)
    for table in (sh.Table(rows), sh.Table(by, sh.Attrib2f)):  # of another rank and type; on the host
        with pytest.raises(sh.ShpyTypeError):
            kernel(bodies, table, sh.Table(steps))
    assert np.array_equal(kernel(bodies, sh.Table(by, sh.Attrib2f), sh.Table(rows)).numpy().mass, mass + 2)
    few = kernel(bodies, sh.Table(sh.Stream(by[:2], sh.Attrib2f, name)), sh.Table(rows)).numpy()
    assert np.array_equal(few.at, at + 2 * by[mass] + by[np.minimum(mass + 1, 1)])
