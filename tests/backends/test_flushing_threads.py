"""A thread in which another library made the processor take denormal numbers for zero, as Taichi does when it starts.

Everything computes in it as it does elsewhere, and leaves the thread as it was.
"""

from __future__ import annotations

import ctypes
import platform
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import shpy as sh
from shpy.ieee import ieee_arithmetic, keeps_denormals

WORDS = {"x86_64": (28, 0x8040), "aarch64": (0, 1 << 24)}
"""The offset in C's environment of the word that controls denormals, and the bits that flush them to zero."""


def flush():
    """Make this thread take denormals for zero."""
    at, bits = WORDS[platform.machine()]
    library, environment = ctypes.PyDLL(None), bytearray(64)
    held = (ctypes.c_char * 64).from_buffer(environment)
    library.fegetenv(held)
    word = int.from_bytes(environment[at : at + 4], "little") | bits
    environment[at : at + 4] = word.to_bytes(4, "little")
    library.fesetenv(held)
    assert not keeps_denormals()


def in_a_flushing_thread(work):
    """Return the result of a function in a thread that flushes before and after it."""
    found = []

    def run():
        flush()
        try:
            found.append(work())
        except Exception as error:
            found.append(error)
        found.append(keeps_denormals())

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    if isinstance(found[0], Exception):
        raise found[0]
    assert found[1] is False, "the thread was not left as it was"
    return found[0]


def small(precision="f32"):
    """Denormal numbers, made from their bits."""
    bits = {"f16": np.uint16, "f32": np.uint32, "f64": np.uint64}[precision]
    floats = {"f16": np.float16, "f32": np.float32, "f64": np.float64}[precision]
    return np.arange(100, 140, dtype=bits).view(floats)


def recorded():
    """A program with a constant, a Param and a Table that are denormal, made where it is called."""
    gain = sh.Param(sh.Attrib1f, 3e-39, name="gain")
    steps = sh.Table([1e-40, 2e-40, 3e-40], sh.Attrib1f, name="steps")

    @sh.program
    def work(x: sh.Attrib1f) -> sh.Attrib4f:
        folded = sh.Attrib1f(1e-30) * 1e-10
        return sh.Attrib4f(x * 0.5 + 1e-41, x + gain, steps[1] + folded, sh.sqrt(x) + sh.min(x, 1e-39))

    return work


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", ["f16", "f32", "f64"])
@pytest.mark.parametrize("name", ["numpy", "opencl"])
def test_kernels_compute_as_elsewhere(name, precision):
    x = small(precision)
    wanted = recorded().compile(name, precision=precision)(x)
    assert np.any(wanted[:, 0] != 0)

    def work():
        kernel = recorded().compile(name, precision=precision)
        return kernel(x), kernel.run(x, out=np.zeros_like(wanted)).outputs

    for found in in_a_flushing_thread(work):
        assert found.tobytes() == wanted.tobytes()


def test_lists_of_numbers_are_converted_as_elsewhere():
    kernel, numbers = recorded().compile("numpy"), [1e-40, 2.5e-39, 1.0]
    assert in_a_flushing_thread(lambda: kernel(numbers)).tobytes() == kernel(numbers).tobytes()


@sh.program
def add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


@sh.program
def halve(u: sh.Attrib1f) -> sh.Attrib1f:
    return u * 0.5


@pytest.mark.slow
@pytest.mark.parametrize("name", ["numpy", "opencl"])
def test_streams_compute_as_elsewhere(name):
    numbers = [k * 1e-41 for k in range(-40, 40)]

    def work():
        s = sh.Stream(numbers, sh.Attrib1f, name)
        s.update(numbers[::-1])
        bins = sh.histogram(s, 8, range=(-1e-40, 2e-40))
        sums = [s.sum(method=method) for method in ("pairwise", "compensated", "exact")]
        chain = sh.repeat(halve, 3).run(u=s).streams["u"]
        found = [s, halve(s), sh.sort(s), sh.scan(add, s), sh.reduce(add, s), s.mean(), s.min(), s.argmax(), *sums]
        found += [
            s.count(),
            chain,
            bins,
            sh.scatter(s, sh.Stream([k % 7 for k in range(80)], sh.Attrib1i, name), 7, combine=add),
        ]
        return [np.asarray(f).tobytes() for f in found]

    assert in_a_flushing_thread(work) == work()


def test_the_environment_is_changed_for_as_long_as_it_is_needed():
    def work():
        with ieee_arithmetic():
            assert keeps_denormals()
            with ieee_arithmetic():
                assert keeps_denormals()
            assert keeps_denormals()
        return keeps_denormals()

    assert in_a_flushing_thread(work) is False
    with ieee_arithmetic():
        assert keeps_denormals()
    assert keeps_denormals()


_FIRST = """
import sys
sys.path.insert(0, TESTS)
from backends.test_flushing_threads import flush, small
flush()
import numpy as np
import shpy as sh
@sh.program
def half(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * 0.5
print([b.name for b in sh.backends() if any("denormals" in n or "wrong" in n for d in b.devices for n in d.notes)])
for name in ("numpy", "opencl"):
    print(half.compile(name)(small()).view(np.uint32).tolist())
"""


def test_devices_that_are_opened_by_such_a_thread_compute_as_elsewhere(tmp_path, monkeypatch):
    """The driver's threads are started with denormals; what probes find is not spoilt, and later processes read it."""
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path))
    text = _FIRST.replace("TESTS", repr(str(Path(__file__).parents[1])))
    wanted = (small() * np.float32(0.5)).view(np.uint32).tolist()
    for later in (text, text.replace("\nflush()", "")):
        lines = subprocess.run([sys.executable, "-c", later], capture_output=True, text=True, check=True).stdout.split(
            "\n"
        )
        assert lines[1:3] == [str(wanted), str(wanted)]
        assert "opencl" not in lines[0]
