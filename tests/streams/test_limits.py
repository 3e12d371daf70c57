"""Errors in words: sizes beyond memory, and pickles of streams on a device, programs, kernels and chains."""

from __future__ import annotations

import copy
import pickle
from typing import NamedTuple

import numpy as np
import pytest

import shpy as sh
from shpy.backend.registry import NAMES

every = pytest.mark.parametrize("name", NAMES)


class Pair(NamedTuple):
    a: sh.Attrib3f
    b: sh.Attrib1i


@sh.program
def double(x: sh.Attrib1f) -> sh.Attrib1f:
    return 2 * x


@every
@pytest.mark.parametrize("size", [10**12, 10**13, 10**19])
def test_sizes_beyond_memory_are_errors_in_words(name, size):
    stream = sh.Stream([1, 2], sh.Attrib1i, name)
    for call in (
        lambda: sh.Stream.empty(size, sh.Attrib3f, name),
        lambda: sh.scatter(stream, [0, 1], size),
        lambda: sh.histogram(stream, size),
    ):
        with pytest.raises(sh.ShpyError, match=r"elements|memory|bins"):
            call()


@every
def test_copies_of_streams_have_memory_of_their_own(name):
    for make in (copy.copy, copy.deepcopy):
        stream = sh.Stream([1.0, 2.0], sh.Attrib1f, name)
        made = make(stream)
        stream.update([5, 6])
        assert (made.numpy().tolist(), made.place) == ([1, 2], stream.place)


@every
def test_streams_are_pickled(name):
    given = Pair(np.ones((4, 3)), np.arange(4))
    for stream in (sh.Stream(given, Pair, name), sh.Stream([[0.1], [0.2]], sh.Attrib1f, name, precision="f16")):
        found = pickle.loads(pickle.dumps(stream))
        assert (found.type, found.shape, found.place) == (stream.type, stream.shape, stream.place)
        assert str(found.numpy()) == str(stream.numpy())


@pytest.mark.parametrize(
    "value", [double, double.compile("numpy"), sh.repeat(double, 2)], ids=["program", "kernel", "chain"]
)
def test_programs_kernels_and_chains_are_their_own_copies(value):
    assert copy.deepcopy(value) is value
    assert copy.copy(value) is value
