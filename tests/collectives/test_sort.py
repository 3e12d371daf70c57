"""sh.sort and sh.argsort are stable, with NaN as the greatest number and equal zeros, on every backend."""

import re

import numpy as np
import pytest
from collectives.generated import (
    LARGE,
    OFTEN,
    assert_same_bits,
    by_programs,
    computed,
    floats,
    generated,
    moved,
    stream,
)

import shpy as sh
from shpy.backend.glsl.device.context import Context
from shpy.backend.opencl.device import collective as opencl
from shpy.backend.opencl.device.driver import Machine

__all__ = ["by_programs", "computed", "moved"]


@sh.struct
class Ray:
    o: sh.Point3f
    t: sh.Attrib1f


@sh.program
def distance(ray: Ray) -> sh.Attrib1f:
    return ray.t * 2


@sh.program
def parity(x: sh.Attrib1f) -> sh.Attrib1b:
    return x < 0


def order_of(x, descending):
    """The definition: equal keys, zeros of both signs and all NaN among them, keep their order."""
    if not descending:
        return np.argsort(x, kind="stable")
    return len(x) - 1 - np.argsort(x[::-1], kind="stable")[::-1]


def check(backend, count, seed, **options):
    for n, rng in generated(count, seed, **options):
        x, descending = floats(rng, n), bool(rng.integers(2))
        given, order = stream(x, sh.Attrib1f, backend), order_of(x, descending)
        assert_same_bits(sh.sort(given, descending=descending), x[order])
        if n % 2:
            assert_same_bits(sh.argsort(given, descending=descending), order.astype(np.int32))


@pytest.mark.sampled(3)
def test_sorted_and_stable(moved):
    check(moved, OFTEN, 1)


@pytest.mark.sampled(3)
def test_many_elements(moved):
    check(moved, 11, 2, sizes=LARGE)


@pytest.mark.sampled(2)
def test_programs_do_the_same(by_programs):
    check(by_programs, 100, 5)


@pytest.mark.slow
def test_sorted_and_stable_at_length(moved):
    check(moved, 10_000, 3)


def test_the_digits_of_devices_with_small_caches_or_stacks(monkeypatch):
    rng = np.random.default_rng(7)
    bits = rng.integers(0, 2**32, 140_001, np.uint32)
    unsorted = stream(
        bits, sh.Attrib1u, "opencl"
    )  # the space of the other tests is opened with the digits of this device
    monkeypatch.setattr(opencl, "thread_stack", lambda: 1 << 16)
    own = opencl.collectives(unsorted.place.space)
    memory = unsorted.leaf_entries()[0].memory
    assert_same_bits(own.sort(memory, False).read(), np.sort(bits))
    assert_same_bits(own.order(memory, True, None).read(), order_of(bits, True).astype(np.int32))


@pytest.mark.parametrize("n", [1, 63, 64, 65, 127, 128, 200, 131_071, 131_137, 262_143])
def test_blocks_of_digits_end_anywhere(n):
    """One chunk ends beside a block of digits, or several do; keys are equal, follow each other or are random."""
    rng = np.random.default_rng(n)
    rising = np.arange(n) * 4000 // n
    for keys in (rising, rising + rng.integers(-3, 4, n), rng.integers(-5, 5000, n), np.zeros(n)):
        x = keys.astype(np.int32)
        unsorted = stream(x, sh.Attrib1i, "opencl")
        assert_same_bits(sh.sort(unsorted), np.sort(x))
        assert_same_bits(sh.argsort(unsorted, descending=True), order_of(x, True).astype(np.int32))
        clamped = np.clip(x, 0, 4095)
        assert_same_bits(sh.argsort(unsorted, below=4096), order_of(clamped, False).astype(np.int32))


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("cls", "dtype"), [(sh.Attrib1i, np.int32), (sh.Attrib1u, np.uint32), (sh.Attrib1b, np.bool_)])
def test_ints_and_bools(moved, cls, dtype):
    rng = np.random.default_rng(4)
    for n in (1, 2, 100, 1021):
        bits = rng.integers(0, 2**32, n, np.uint32)
        x = (
            bits % 2 == 0
            if dtype is np.bool_
            else np.where(bits % 3 == 0, bits % 5, bits).astype(np.uint32).view(dtype)
        )
        for descending in (False, True):
            order, given = order_of(x, descending), stream(x, cls, moved)
            assert_same_bits(sh.argsort(given, descending=descending), order.astype(np.int32))
            assert_same_bits(sh.sort(given, descending=descending), x[order])


def test_bools_of_any_byte_are_equal(moved):
    given = stream(np.uint8([255, 2, 0, 7, 1]).view(np.bool_), sh.Attrib1b, moved)
    assert sh.argsort(given).numpy().tolist() == [2, 0, 1, 3, 4]
    assert sh.argsort(given, descending=True).numpy().tolist() == [0, 1, 3, 4, 2]


@pytest.mark.sampled(6)
@pytest.mark.parametrize("below", [1, 2, np.int64(2048), 4096, 4097, 2**31])
def test_keys_below_a_number(moved, below):
    """Keys that are out of range count as the nearest one in range."""
    rng = np.random.default_rng(below)
    for n in (0, 1, 257, 5000):
        for cls, dtype in ((sh.Attrib1i, np.int32), (sh.Attrib1u, np.uint32)):
            x = rng.integers(0, below, n).astype(dtype)
            extremes = np.array([0, 1, np.iinfo(dtype).min, np.iinfo(dtype).max])
            x[::7] = rng.choice(extremes, len(x[::7]))
            for descending in (False, True):
                order = order_of(x.clip(0, below - 1), descending).astype(np.int32)
                assert_same_bits(sh.argsort(stream(x, cls, moved), below=below, descending=descending), order)


@pytest.mark.parametrize("backend", ["opencl", "glsl"])
@pytest.mark.parametrize("cls", [sh.Attrib1i, sh.Attrib1u])
def test_another_bound_takes_the_same_programs(cls, backend, monkeypatch):
    """A bound is an argument: a number of cells may differ in each frame."""
    x = stream(np.arange(300, dtype=np.int32 if cls is sh.Attrib1i else np.uint32), cls, backend)
    for n in (250, 251):
        sh.argsort(x, below=n)
    built = []
    for owner, name in ((Machine, "_compiled"), (Context, "program")):
        make = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *a, make=make, name=name: (built.append(name), make(*a))[1])
    for n in (1, 7, 99, 180, 254):
        wanted = np.argsort(np.arange(300).clip(0, n - 1), kind="stable")
        assert np.array_equal(sh.argsort(x, below=n).numpy(), wanted)
    assert built == []


@pytest.mark.parametrize(("n", "dispatches"), [(3000, 1), (131_071, 1), (131_072, 3)])
def test_below_takes_fewer_passes(monkeypatch, n, dispatches):
    """A digit takes one dispatch for one chunk of elements, and three for several."""
    passes = []
    run = opencl._OpenCLCollectives._run
    count = lambda self, text, name, *a: (passes.append(name), run(self, text, name, *a))  # noqa: E731
    monkeypatch.setattr(opencl._OpenCLCollectives, "_run", count)
    keys = np.arange(n, dtype=np.int32) % 64
    x = stream(keys, sh.Attrib1i, "opencl")
    counts = []
    for options in ({}, {"below": 1 << 13}, {"below": (1 << 13) + 1}, {"below": 64}):
        passes.clear()
        assert np.array_equal(sh.argsort(x, **options).numpy(), np.argsort(keys, kind="stable"))
        counts.append(len(passes))
    assert counts == [dispatches * digits for digits in (3, 1, 2, 1)]


@pytest.mark.parametrize("below", [0, -1, 2**31 + 1, True, 2.0, "64"])
def test_below_is_the_number_of_keys(below):
    x = stream(np.zeros(3, np.int32), sh.Attrib1i, "numpy")
    with pytest.raises(sh.ShpyTypeError, match=re.escape(f"below={below!r} is no int from 1 to 2**31")):
        sh.argsort(x, below=below)
    with pytest.raises(sh.ShpyTypeError, match="is for keys that are ints"):
        sh.argsort(stream(np.zeros(3, np.float32), sh.Attrib1f, "numpy"), below=4)


@pytest.mark.parametrize(("backend", "precision"), [("numpy", "f64"), ("opencl", "f64"), ("opencl", "f16")])
def test_halves_and_doubles(backend, precision):
    rng = np.random.default_rng(5)
    x = np.concatenate([rng.standard_normal(300), [np.nan, -np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, -5e-324]])
    given = sh.Stream(rng.permutation(np.tile(x, 2)), sh.Attrib1f, backend, precision=precision)
    held = given.numpy()
    assert_same_bits(sh.sort(given), held[order_of(held, False)])
    assert_same_bits(sh.argsort(given, descending=True), order_of(held, True).astype(np.int32))


@pytest.mark.sampled(2)
def test_structs_by_a_key(computed):
    rng = np.random.default_rng(6)
    o, t = rng.standard_normal((200, 3)).astype(np.float32), rng.integers(0, 9, 200).astype(np.float32)
    rays = stream({"o": o, "t": t}, Ray, computed)
    order = order_of(t, True)
    found = sh.sort(rays, key=distance, descending=True)
    assert_same_bits(found.numpy().o, o[order])
    assert_same_bits(found.numpy().t, t[order])
    assert_same_bits(sh.gather(rays, sh.argsort(rays, key=distance)).numpy().t, np.sort(t))


@pytest.mark.sampled(2)
def test_a_key_may_be_a_bool_and_axes_are_taken_in_c_order(computed):
    x = np.array([[1, -2, 3], [-4, 5, -6]], np.float32)
    assert sh.sort(stream(x, sh.Attrib1f, computed), key=parity).numpy().tolist() == [1, 3, 5, -2, -4, -6]


def test_the_input_keeps_its_elements(moved):
    for x in ([], [1], [2, 1]):
        given = stream(np.float32(x), sh.Attrib1f, moved)
        found = sh.sort(given)
        found.update(np.full(len(x), 7, np.float32))
        assert given.numpy().tolist() == x


@pytest.mark.parametrize(
    ("cls", "key", "message"),
    [
        (Ray, None, "sh.sort(stream, key=program)"),
        (sh.Attrib1f, distance, "is no key for <Stream (1,) of Attrib1f on numpy>"),
        (sh.Attrib1f, abs, "sh.sort takes a program as key, not builtin_function_or_method"),
    ],
)
def test_keys_that_do_not_fit(cls, key, message):
    with pytest.raises(sh.ShpyTypeError, match=re.escape(message)):
        sh.sort(sh.Stream.empty(1, cls, "numpy"), key=key)


@pytest.mark.undisturbed
def test_the_space_waits_for_a_sort():
    x = stream(np.random.default_rng(8).random(100_000, np.float32), sh.Attrib1f, "opencl")
    space = x.place.space
    space.finish()
    sh.sort(x)
    assert space.machine.started > 0
    space.finish()
    assert space.machine.started == 0
