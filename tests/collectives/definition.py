"""The definitions of sh.reduce and sh.scan in plain numpy, and inputs on which another order gives other bits."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from backends.running import LANES, flushes_denormals

import shpy as sh
from shpy.backend.opencl.device.building import backend
from shpy.backend.opencl.device.driver import Machine
from shpy.collectives.trees import own_tree

TREES = {f"opencl-trees-{n}": n for n in (4, 8, 16)}
TARGETS = ("numpy", *LANES, *TREES, "glsl")
SIZES = (1, 2, 3, 5, 7, 13, 15, 16, 17, 31, 61, 63, 64, 65, 127, 128, 129, 255, 257, 509, 1021, 4095, 4096, 4097, 8209)


AROUND = [n + k for n in (1024, 3072, 2**16, 2**17) for k in (-1, 0, 1)] + [2, 99_991, 300_007]
"""Sizes around the blocks and parts of `opencl.trees`, and primes."""


def each(targets):
    """Return the parameters of a test: OpenCL's widths but for 1 and 8 are slow."""
    rare = {"opencl-4", "opencl-16", "opencl-trees-4", "opencl-trees-16"}
    return [pytest.param(name, marks=[pytest.mark.slow] * (name in rare)) for name in targets]


@pytest.fixture(params=each(["numpy", *TREES, "glsl"]))
def trees(request, monkeypatch):
    """A backend that takes large streams in a few runs."""
    yield from _at_widths(request.param, monkeypatch)


@pytest.fixture(params=each(TARGETS))
def target(request, monkeypatch):
    """A backend, and the lanes of its packets: where streams lie, programs are compiled with these.

    Those of TREES fold and scan in kernels of OpenCL's own, those of LANES by programs, as a GPU does.
    """
    yield from _at_widths(request.param, monkeypatch)


def _at_widths(name, monkeypatch):
    own_tree.cache_clear()
    if name in TREES:
        monkeypatch.setattr(Machine, "lanes", TREES[name])
    if name in LANES:
        space = backend.space(None)
        monkeypatch.setattr(space, "collectives", replace(space.collectives, tree=None))
        compile_for = sh.Program.compile

        def at_width(program, backend=None, **options):
            lanes = {} if backend == "numpy" else {"lanes": LANES[name]}  # the host takes the last steps
            return compile_for(program, backend, **{**lanes, **options})

        monkeypatch.setattr(sh.Program, "compile", at_width)
    yield name.partition("-")[0]
    own_tree.cache_clear()


def tree(x, f):
    """The balanced tree of neighbours over the first axis: an odd last element passes unchanged."""
    while len(x) > 1:
        pairs = len(x) // 2 * 2
        x = np.concatenate((f(x[0:pairs:2], x[1:pairs:2]), x[pairs:]))
    return x[0]


def prefixes(x, f):
    """Return the prefixes over the first axis: each combines the largest aligned blocks that form it, left to right."""
    blocks = [x]
    while len(blocks[-1]) > 1:
        pairs = len(blocks[-1]) // 2 * 2
        blocks.append(f(blocks[-1][0:pairs:2], blocks[-1][1:pairs:2]))
    ends = np.arange(1, len(x) + 1)
    found, begun = np.zeros_like(x), np.zeros(len(x), bool)
    for k in range(len(blocks))[::-1]:
        here = (ends >> k) & 1 == 1
        block = blocks[k][ends[here] // 2 ** (k + 1) * 2]
        found[here] = np.where(begun[here].reshape(-1, *[1] * (x.ndim - 1)), f(found[here], block), block)
        begun |= here
    return found


COLUMNS = 16


def columns(n, seed, target):
    """(n, 16) float32: sums that cancel, all exponents, denormals, zeros of both signs, infinities, NaN."""
    rng = np.random.default_rng([n, seed])
    x = rng.standard_normal((n, COLUMNS)).astype(np.float32)
    # No denormal may arise on a device that flushes them: nothing below 2**-100 has a bit below 2**-124.
    least = -100 if flushes_denormals(target) else -149
    exponents = rng.integers(least, 100, (n, 4))
    x[:, 1:5] = np.ldexp(rng.integers(-(2**23), 2**23, (n, 4)).astype(np.float32), exponents.clip(None, 100) - 1)
    x[:, 5] = np.ldexp(x[:, 5].round(1), least + 1) if least < -100 else np.ldexp(x[:, 5].round(), least)
    x[: n // 2, 6] = -x[n - n // 2 :, 6][::-1]
    x[:, 7] = rng.permutation(np.repeat(np.float32([1e30, -1e30, 1, 1e-3]), -(-n // 4)))[:n]
    x[:, 8] = rng.choice(np.float32([0, -0.0]), n)
    x[:, 9] = rng.integers(-3, 4, n)
    x[rng.integers(n), 10] = np.inf
    x[rng.integers(n, size=2), 11] = [np.inf, -np.inf]
    x[rng.integers(n), 12] = np.nan
    x[:, 13] = rng.choice(np.float32([3e38, -3e38, 1]), n)
    x[:, 14] = rng.integers(2**23, 2**24, n)
    return x


def rounded(numbers, dtype):
    """The number of a dtype that is nearest to the exact sum, half to even; the numbers are finite."""
    exact = sum(map(Fraction, numbers.tolist()), Fraction(0))
    largest = Fraction(float(np.finfo(dtype).max))
    if abs(exact) >= largest * (1 + Fraction(1, 2 ** (np.finfo(dtype).nmant + 2))):
        return dtype(math.copysign(math.inf, exact))
    near = dtype(float(min(max(exact, -largest), largest)))
    around = [near, np.nextafter(near, dtype(-np.inf)), np.nextafter(near, dtype(np.inf))]
    word = {4: np.uint32, 8: np.uint64}[near.nbytes]
    finite = [c for c in around if np.isfinite(c)]
    return min(finite, key=lambda c: (abs(Fraction(float(c)) - exact), int(c.view(word)) & 1))


@sh.struct
class Columns:
    """Sixteen numbers: as many inputs in one run."""

    a: sh.Attrib4f
    b: sh.Attrib4f
    c: sh.Attrib4f
    d: sh.Attrib4f


def as_columns(x, backend):
    """A stream of Columns with the sixteen columns of an array."""
    return sh.Stream(dict(zip("abcd", np.split(x, 4, axis=1), strict=True)), Columns, backend=backend)


def from_columns(found):
    """The array (n, 16) or (16,) of what a stream of Columns holds."""
    return np.concatenate(list(found), axis=-1)


@sh.program
def add_columns(a: Columns, b: Columns) -> Columns:
    return Columns(a.a + b.a, a.b + b.b, a.c + b.c, a.d + b.d)


@sh.program
def halve_columns(a: Columns, b: Columns) -> Columns:
    return Columns(a.a - b.a * 0.5, a.b - b.b * 0.5, a.c - b.c * 0.5, a.d - b.d * 0.5)


def add(a, b):
    """Return the sums of `add_columns`."""
    with np.errstate(all="ignore"):
        return a + b


def halve(a, b):
    """Combine as `halve_columns` does: neither associative nor commutative."""
    with np.errstate(all="ignore"):
        return a - b * a.dtype.type(0.5)
