"""Chains in the stress mode give what their kernels give one by one, undisturbed."""

import random

import numpy as np
import pytest
from backends.running import differs
from chains.test_chains import ALL, OneByOne, built, count_up, counted, move, swing, tick, wear
from chains.test_shares import check as check_share, is_alive
from stress.mode import stressed

import shpy as sh
from shpy.chains.member import stream_names

BACKENDS = ("numpy", "opencl", "glsl")
WORDS = {"f16": np.float16, "f32": np.float32, "f64": np.float64}
SHAPES = (1, 64, 2100, 2900, (33, 64), (17, 128), (1, 2300), (2300, 1), (5, 7, 70))


@sh.program
def roll(x: sh.Table[sh.Attrib1f, 2], v: sh.Attrib1f):
    i = sh.grid_index(2)
    return {"x": 0.5 * x[i] + 0.25 * x[i + (0, 1)] + 0.125 * x[i - (1, 0)] + v}


@sh.program
def place(x: sh.Attrib1f, n: sh.Attrib1i):
    i, extents = sh.grid_index(2), sh.grid_shape(2)
    return {"n": n + 1, "x": x + sh.Attrib1f(i.y * extents.x - i.x)}


@sh.program
def settle(n: sh.Attrib1i, v: sh.Attrib1f):
    """Stop at another iteration for each element, and reject it where it had nothing to do."""
    k = sh.Attrib1i(0)
    with sh.SH_WHILE(lambda: (k < 40) & (v > 0.25)):
        v[:] = v * 0.75
        k += 1
    sh.SH_DISCARD(k == 0)
    return {"n": n + k, "v": v}


@sh.program
def curve(x: sh.Attrib1f, v: sh.Attrib1f):
    """Compute with elementary functions; v stays within 1. Of large v, exp10 and erfc give denormals and infinities."""
    v = sh.clamp(v, -2, 2)
    y = sh.hypot(sh.cbrt(x), sh.log1p(abs(v))) - sh.expm1(-abs(v)) * sh.exp10(v)
    return {"x": y, "v": 0.5 * sh.erf(x) * sh.cospi(v) + 0.25 * sh.sinpi(x) * sh.erfc(v)}


def looking():
    """Return a kernel that reads a table of its own, large enough to be lent to a device that works in our memory."""
    heights = sh.Table(np.arange(20_000) % 17 / 4 - 2, sh.Attrib1f)

    @sh.program
    def look(x: sh.Attrib1f, n: sh.Attrib1i):
        return {"x": 0.5 * x + heights[n * 2221]}

    return look


look = looking()
MEMBERS = {
    1: (*ALL, settle, look, curve),
    2: (roll, place, move, swing, wear, tick, settle, look, curve),
    3: (move, swing, wear, tick, settle, look, curve),
}
"""Kernels of chains over shapes of each rank."""
LOOPED = {1: (wear, count_up, tick, settle), 2: (wear, tick, settle), 3: (wear, tick, settle)}
"""Chains that reject every element in the end."""


def tree(rng, rank, depth=0):
    """Draw a chain: sequences, repeats and loops."""
    kind = rng.choice(("kernel", "kernel", "sequence", "repeat", "loop")) if depth < 3 else "kernel"
    match kind:
        case "sequence":
            return ("sequence", [tree(rng, rank, depth + 1) for _ in range(rng.randint(1, 3))])
        case "repeat":
            return counted(("repeat", tree(rng, rank, depth + 1), rng.choice((0, 1, 2, 5)), rng.random() < 0.5))
        case "loop":
            return counted(("loop", rng.choice(LOOPED[rank]), rng.random() < 0.5))
    return rng.choice(MEMBERS[rank])


def data(seed, shape, word=np.float32):
    """Draw arrays for every name: no product of theirs is a denormal, which a device may flush."""
    rng = np.random.default_rng(seed)
    return {
        "x": rng.integers(-64, 64, shape).astype(word),
        "v": rng.integers(-8, 8, shape).astype(word) / 8,
        "n": rng.integers(0, 8, shape).astype(np.int32),
        "limit": rng.integers(0, 12, shape).astype(np.int32),
        "k": rng.integers(-4, 4, shape).astype(np.int32),
    }


def check(number, precision="f32"):
    """Run one chain on every backend, in the stress mode, and compare it with its kernels one by one."""
    rng = random.Random(number)
    shape = rng.choice(SHAPES)
    rank = 1 if isinstance(shape, int) else len(shape)
    drawn = ("sequence", [tree(rng, rank) for _ in range(rng.randint(1, 3))])
    arrays = data(number, shape, WORDS[precision])
    expected = OneByOne("numpy", arrays, precision)
    expected.run(drawn)
    chain = built(drawn)
    names = stream_names(chain.steps)
    for backend in BACKENDS[: 2 if precision == "f64" else 3]:  # GLSL has no f64
        with stressed(number):
            result = chain.run(**{n: arrays[n] for n in names}, backend=backend, precision=precision)
            found = {name: stream.numpy() for name, stream in result.streams.items()}
            executions = {n: k for n, k in result.executions.items() if k}
            counts = {n: k for n, k in result.counts.items() if result.executions[n]}
        for name, array in found.items():
            assert array.dtype == expected.arrays[name].dtype
            # Chains reach infinity minus infinity, and no backend promises the sign of a NaN.
            places = np.flatnonzero(differs(array, expected.arrays[name]))
            assert not places.size, f"chain {number}, {backend}, {name} at {places[:9]}: {drawn}"
        assert (backend, executions, counts) == (backend, expected.executions, expected.counts)


@pytest.mark.sampled(12)
@pytest.mark.parametrize("shard", range(12))
def test_chains_agree(shard):
    for number in range(5 * shard, 5 * shard + 3):
        check(number)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["f16", "f64"])
def test_chains_agree_at_other_precisions(precision):
    for number in range(100, 105):
        check(number, precision)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["f16", "f64"])
def test_many_chains_agree_at_other_precisions(precision):
    for number in range(105, 160):
        check(number, precision)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_runs_read_tables_as_they_were(backend):
    """The chain does not wait for runs of `look`, and the mode changes its table before they begin."""
    arrays = data(0, 2100)
    expected = OneByOne("numpy", arrays)
    expected.run(("repeat", look, 3, None))
    for seed in range(20):
        with stressed(seed):
            found = sh.repeat(looking(), 3).run(x=arrays["x"], n=arrays["n"], backend=backend).streams["x"].numpy()
        np.testing.assert_array_equal(found, expected.arrays["x"])


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_shares_agree(backend):
    for seed, n in enumerate((1, 64, 2100, 2900)):
        with stressed(seed):
            check_share(backend, n, seed, 0.3, sh.share("waiting", 0.3, of=is_alive))


@pytest.mark.slow
@pytest.mark.parametrize("shard", range(40))
def test_many_chains_agree(shard):
    for number in range(1000 + 50 * shard, 1050 + 50 * shard):
        check(number)
