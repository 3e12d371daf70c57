"""Repeated reductions and scans of a stream, prepared by an earlier one, give the answers of the present elements."""

import threading

import numpy as np
import pytest
from collectives.definition import target

import shpy as sh

__all__ = ["target"]


@sh.program
def negated(x: sh.Attrib1f) -> sh.Attrib1f:
    return -x


@sh.program
def add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


@sh.program
def subtract(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a - b


@pytest.mark.sampled(5)
def test_a_repeated_reduction_sees_what_the_stream_holds_now(target):
    """A reduction is prepared for the memory that the stream has at that time, and a run may replace that."""
    n = 5000
    x = np.random.default_rng(8).integers(-99, 99, n).astype(np.float32)
    s = sh.Stream(x, sh.Attrib1f, target)
    view = s.reshape(50, 100)

    def check_all(stream, values):
        for _ in range(2):
            assert stream.sum() == stream.sum("pairwise") == stream.sum(method="compensated") == values.sum()
            assert (stream.min(), stream.max()) == (values.min(), values.max())
            assert (stream.argmin(), stream.argmax()) == (values.argmin(), values.argmax())
            assert (stream.any(), stream.all()) == (values.any(), values.all())
            assert stream.count() == np.count_nonzero(values)
            sums = sh.scan(add, stream)
            assert np.array_equal(sums.numpy().ravel(), np.cumsum(values))
            assert sums.shape == stream.shape
            before = sh.scan(add, stream, exclusive=True)
            assert np.array_equal(before.numpy().ravel(), np.cumsum(values) - values)
            assert np.array_equal(sums.numpy().ravel(), np.cumsum(values)), "each scan has memory of its own"
            assert sh.scan(subtract, stream)[...].ravel()[1] == values[0] - values[1]

    check_all(s, x)
    s.update(x + 7)
    check_all(s, x + 7)
    check_all(view, x + 7)
    negated.compile(target).run(s, out=s)
    check_all(s, -x - 7)
    check_all(view, -x - 7)
    own, other = (sh.Stream(a, sh.Attrib1f, target) for a in (x, 2 * x))
    check_all(own, x)
    (entry,) = own.leaf_entries()
    entry.replace(other.leaf_entries()[0].memory)  # as a run does whose output is its own input, on some devices
    check_all(own, 2 * x)
    assert np.array_equal(own.reshape(50, 100).sum(axis=0).numpy(), 2 * x.reshape(50, 100).sum(axis=0))


def test_threads_share_what_a_reduction_prepared():
    streams = [sh.Stream(np.full(n, k, np.float32), sh.Attrib1f, "opencl") for k, n in ((1, 3000), (2, 70_000))]
    answers: list[list[float]] = [[] for _ in range(4)]
    threads = [
        threading.Thread(target=lambda k=k: answers[k].extend(streams[k % 2].sum() for _ in range(50)))
        for k in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == [[3000] * 50, [140_000] * 50] * 2
