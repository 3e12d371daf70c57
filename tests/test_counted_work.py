"""Work that no result shows: repeated calls skip their checks, and parts of streams are read alone."""

import numpy as np
import pytest

import shpy as sh
from shpy.backend.glsl.device.memory import GlslMemory
from shpy.backend.numpy.device.memory import NumpyMemory
from shpy.backend.opencl.device.memory import OpenCLMemory
from shpy.run import host

BACKENDS = ["numpy", "opencl", "glsl"]
MEMORIES = {"numpy": NumpyMemory, "opencl": OpenCLMemory, "glsl": GlslMemory}


@sh.program
def scaled(v: sh.Attrib3f, by: sh.Attrib1f) -> sh.Attrib3f:
    return v * by


V = np.arange(12, dtype=np.float32).reshape(4, 3)
BY = np.arange(4, dtype=np.float32)
REPEATED = {
    "arrays": lambda _: (V, BY),
    "a float": lambda _: (V, 2.0),
    "one element of an array": lambda _: (V, BY[1:2]),
    "streams": lambda b: (sh.Stream(V, sh.Attrib3f, backend=b), sh.Stream(BY, sh.Attrib1f, backend=b)),
}
CHECKED = {
    "a conversion": lambda _: (V.astype(np.float64), BY),
    "a broadcast": lambda _: (np.stack([V, V]), BY),
    "an array beside a stream": lambda b: (sh.Stream(V, sh.Attrib3f, backend=b), BY),
}


@pytest.mark.undisturbed
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("kind", [*REPEATED, *CHECKED])
def test_a_call_of_a_known_signature_is_checked_once(kind, backend, monkeypatch):
    bound, bind = [], host.bind
    monkeypatch.setattr(host, "bind", lambda *a: (bound.append(1), bind(*a))[1])
    kernel = scaled.compile(backend)
    given = {**REPEATED, **CHECKED}[kind](backend)
    for _ in range(4):
        found = kernel(*given)
    v, by = (np.asarray(x.numpy() if isinstance(x, sh.Stream) else x, np.float32) for x in given)
    assert np.array_equal(found.numpy() if isinstance(found, sh.Stream) else found, v * by[..., None])
    assert len(bound) == (1 if kind in REPEATED else 4)


@pytest.mark.undisturbed
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("key", "rows"), [(3, 1), (-1, 1), (slice(2, 5), 3), (slice(None, 4), 4), (slice(7, 7), 0), ((3, 1), None)]
)
def test_a_part_of_a_stream_is_read_alone(key, rows, backend, monkeypatch):
    """A row has 5 elements of 3 floats. Other keys read the whole stream."""
    x = np.arange(2000 * 15, dtype=np.float32).reshape(2000, 5, 3)
    s = sh.Stream(x, sh.Attrib3f, backend=backend)
    moved, read = [], MEMORIES[backend].read

    def counted(memory, begin=0, end=None):
        moved.append((memory.count if end is None else end) - begin)
        return read(memory, begin, end)

    monkeypatch.setattr(MEMORIES[backend], "read", counted)
    assert np.array_equal(s[key], x[key])
    assert sum(moved) == 5 * (2000 if rows is None else rows)
