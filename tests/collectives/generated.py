"""Inputs for compact, gather, scatter, sort and histogram, and the targets on which each runs."""

from contextlib import contextmanager

import numpy as np
import pytest
from backends.running import LANES
from collectives.definition import each

import shpy as sh
from shpy.backend.base import Collectives
from shpy.backend.opencl.device import collective
from shpy.backend.registry import backend as backend_named

MOVED = ("numpy", "opencl", "glsl")
"""Targets of what moves elements: kernels of the backend's own, which know no lanes, or programs on GLSL."""
COMPUTED = ("numpy", *LANES, "glsl")
"""Targets of what runs programs of the user."""
OFTEN = 240
"""Small inputs in every run: each size with 16 of them. 10,000 are slow."""
SMALL = (0, 1, 2, 3, 5, 7, 8, 13, 15, 16, 17, 31, 32, 33, 61)
LARGE = (127, 128, 129, 257, 1021, 4095, 4096, 4097, 8209, 32_771, 65_537)
"""Sizes above packets, tiles, a row of a texture and the chunks of OpenCL."""

SPECIAL = np.concatenate(
    [
        np.float32([0, -0.0, 1, -1, np.inf, -np.inf, 1e-40, -1e-40, 3e38, -3e38, 1e-38]),
        np.uint32([1, 0x80000001, 0x7FFFFF, 0x7FC00000, 0xFFC00000, 0x7FC12345, 0xFFFFFFFF]).view(np.float32),
    ]
)


def floats(rng, n):
    """Numbers of one of several kinds: equal ones, NaN, infinities, denormals and both zeros are among them."""
    match rng.integers(6):
        case 0:
            return rng.standard_normal(n).astype(np.float32)
        case 1:
            return rng.integers(-2, 3, n).astype(np.float32) * np.float32(rng.choice([1, -1]))
        case 2:
            return rng.choice(SPECIAL, n)
        case 3:
            return np.sort(rng.standard_normal(n).astype(np.float32))[:: rng.choice([1, -1])]
        case 4:
            bits = rng.integers(0, 2**32, n, np.uint32)
            return np.where(np.isnan(bits.view(np.float32)), bits | 0x400000, bits).astype(np.uint32).view(np.float32)
    return np.full(n, rng.choice(SPECIAL))


def generated(count, seed, sizes=SMALL):
    """Yield `count` sizes, each with the random numbers that make its input."""
    for k in range(count):
        yield sizes[k % len(sizes)], np.random.default_rng([k, seed])


def stream(array, type_, backend):
    return sh.Stream(array, type_, backend=backend)


def assert_same_bits(found, wanted):
    found = np.asarray(found)
    assert found.shape == wanted.shape
    assert found.dtype == wanted.dtype
    assert found.tobytes() == wanted.tobytes(), (found, wanted)


@contextmanager
def running(target, monkeypatch):
    """Give the backend of a target; programs have its lanes."""
    with monkeypatch.context() as patch:
        if target in LANES:
            compile_any = sh.Program.compile

            def compile_at_width(program, backend=None, **options):
                lanes = {"lanes": LANES[target]} if backend == "opencl" else {}
                return compile_any(program, backend, **lanes, **options)

            patch.setattr(sh.Program, "compile", compile_at_width)
        yield target.partition("-")[0]


@pytest.fixture(params=MOVED)
def moved(request, monkeypatch):
    """A backend whose kernels move elements; those of OpenCL in chunks of which large streams have several."""
    monkeypatch.setattr(collective, "_LEAST", 1 << 14)
    return request.param


@pytest.fixture(params=["numpy", "opencl"])
def by_programs(request, monkeypatch):
    """A backend on which programs move elements, as they do where the backend has no kernels for it."""
    monkeypatch.setattr(backend_named(request.param).space(None), "collectives", Collectives())
    return request.param


@pytest.fixture(params=each(COMPUTED))
def computed(request, monkeypatch):
    """The backend of a target of what runs programs; OpenCL's own kernels have chunks as in `moved`."""
    monkeypatch.setattr(collective, "_LEAST", 1 << 14)
    with running(request.param, monkeypatch) as backend:
        yield backend
