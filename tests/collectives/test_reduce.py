"""sh.reduce and the reductions of streams give the bits of their definitions on every backend."""

import math
import re

import numpy as np
import pytest
from backends.running import differs, flushes_denormals
from collectives.definition import (
    AROUND,
    SIZES,
    add,
    add_columns,
    as_columns,
    columns,
    from_columns,
    halve,
    halve_columns,
    rounded,
    target,
    tree,
    trees,
)

import shpy as sh
from shpy.backend.opencl.device import collective as opencl_trees
from shpy.backend.opencl.device.driver import Machine
from shpy.backend.opencl.device.memory import OpenCLSpace
from shpy.collectives.trees import own_tree

__all__ = ["target", "trees"]


def check(target, sizes, seed, programs=((add_columns, add), (halve_columns, halve))):
    for n in sizes:
        x = columns(n, seed, target)
        for program, f in programs:
            found = from_columns(sh.reduce(program, as_columns(x, target)))
            assert not differs(found, tree(x, f)).any(), (n, seed, program)


@pytest.mark.sampled(6)
def test_reductions_have_the_bits_of_the_tree(target):
    """Half of the second one is added: any other order gives other bits. Sums of scalars are in the next test."""
    halves = ((halve_columns, halve),)
    check(target, SIZES, 1, halves)
    check(target, np.random.default_rng(5).integers(1, 300, 14), 2, halves)


@pytest.mark.sampled(6)
def test_scalars_have_the_bits_of_the_tree(target):
    for n in (63, 64, 65, 66, 67, 127, 1003, 4097):
        x = columns(n, 4, target)
        for k in range(0, 16, 6):
            s = sh.Stream(x[:, k].copy(), sh.Attrib1f, backend=target)
            assert not differs(s.sum(), tree(x[:, k], add)).any(), (n, k)
            assert s.argmin() == np.argmin(x[:, k]), (n, k)


def specials(n, seed, backend):
    """Floats with NaN, infinities and denormals here and there."""
    x = columns(n, seed, backend)[:, 0]
    least = 0 if flushes_denormals(backend) else 1e-45
    x[np.random.default_rng(seed).integers(n, size=3)] = np.float32([np.nan, -np.inf, least])
    return x


TINY = np.float32(
    [0, -0.0, 1.4e-45, -1.4e-45, 1e-39, -1e-39, 1.1754944e-38, -1.1754944e-38, 1, np.inf, -np.inf, np.nan]
)


FEW = (1, 2, 19, 60)
"""Sizes: a driver compiles the kernels anew for some of them."""


@pytest.mark.sampled(3)
@pytest.mark.parametrize("cases", [range(8), pytest.param(range(8, 40), marks=pytest.mark.slow)], ids=str)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_denormals_are_no_zeros(backend, cases):
    """Also for a device that flushes them: their bits are compared there."""
    rng = np.random.default_rng(38 + cases.start)
    for case in cases:
        few = rng.choice(TINY[: rng.integers(2, len(TINY) + 1)], (FEW[case // 2 % len(FEW)], 3))
        size = 1 if case % 2 else 3
        x = np.ascontiguousarray(few[:, 0] if size == 1 else few)
        s = sh.Stream(x, sh.Attrib1f if size == 1 else sh.Attrib3f, backend=backend)
        for name in ("min", "max"):
            at = getattr(np, f"arg{name}")(x, axis=0)
            assert np.array_equal(getattr(s, f"arg{name}")(), at), (name, x)
            wanted = np.take_along_axis(x, at[None], axis=0)[0] if size == 3 else x[at]
            assert not differs(getattr(s, name)(), wanted).any(), (name, x)
        for name in ("any", "all"):
            assert np.array_equal(getattr(s, name)(), getattr(x, name)(axis=0)), (name, x)
        assert np.array_equal(s.count(), np.count_nonzero(x, axis=0)), x
        along = sh.Stream(np.stack([few[:, 0], few[:, 1]]), sh.Attrib1f, backend=backend)
        assert np.array_equal(along.argmax(axis=0).numpy(), np.argmax(along.numpy(), axis=0))


@pytest.mark.slow
def test_sizes_around_blocks_and_parts(trees):
    for n in AROUND:
        for seed, x in enumerate((columns(n, 21, trees)[:, 3].copy(), specials(n, 22, trees))):
            s = sh.Stream(x, sh.Attrib1f, backend=trees)
            assert not differs(s.sum(), tree(x, add)).any(), (n, seed)
            for name in ("min", "max"):
                at = getattr(np, f"arg{name}")(x)
                assert getattr(s, f"arg{name}")() == at, (n, name)
                assert not differs(getattr(s, name)(), x[at]).any(), (n, name)
            assert (s.count(), s.any(), s.all()) == (np.count_nonzero(x), x.any(), x.all()), n


def test_parts_are_joined_by_a_launch_of_their_own_where_stores_have_no_order(monkeypatch):
    """On other processors than x86: the bits are the same, and the second launch reads what the first one stored."""
    started, enqueue = [], OpenCLSpace.enqueue

    def counted(space, text, name, *args, **options):
        started.append(name)
        enqueue(space, text, name, *args, **options)

    monkeypatch.setattr(Machine, "orders_stores", False)
    monkeypatch.setattr(OpenCLSpace, "enqueue", counted)
    own_tree.cache_clear()
    try:
        for n in (64, 2**16 + 1, 300_007):
            x = columns(n, 46, "opencl")[:, 0].copy()
            s = sh.Stream(x, sh.Attrib1f, "opencl")
            started.clear()
            assert not differs(s.sum(), tree(x, add)).any(), n
            assert started == (["sh_fold", "sh_join"] if n > 2**16 else ["sh_fold"])
            assert s.argmax() == np.argmax(x)
            assert s.count() == np.count_nonzero(x)
    finally:
        own_tree.cache_clear()


def test_a_reduction_of_any_size_is_one_dispatch(monkeypatch):
    started, enqueue = [], OpenCLSpace.enqueue

    def counted(space, text, name, *args, **options):
        started.append(name)
        enqueue(space, text, name, *args, **options)

    monkeypatch.setattr(OpenCLSpace, "enqueue", counted)
    for n in (64, 2**16 + 1, 300_007):
        x = columns(n, 31, "opencl")
        s, pairs = sh.Stream(x[:, 0].copy(), sh.Attrib1f, "opencl"), as_columns(x, "opencl")
        for run in (s.sum, s.argmax, s.mean, s.sum, lambda pairs=pairs: sh.reduce(add_columns, pairs)):
            started.clear()
            run()
            assert started == ["sh_fold"]


@sh.program
def halve_both(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a - b * 0.5


@pytest.mark.slow
@pytest.mark.parametrize("parts", [2, 1 << 11, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 37))])
def test_parts_of_any_number_have_the_bits_of_the_tree(monkeypatch, parts):
    """As on a device with another number of cores: more parts than a block has elements, among others."""
    monkeypatch.setattr(opencl_trees, "_PARTS", parts)
    own_tree.cache_clear()
    for n in (2**16 + 1, 300_007, 2_400_001):
        x = columns(n, 32, "opencl")[:, 3].copy()
        s, wanted = sh.Stream(x, sh.Attrib1f, "opencl"), tree(x, halve)
        for _ in range(2):
            assert not differs(sh.reduce(halve_both, s), wanted).any(), n
            assert s.argmin() == np.argmin(x), n
    own_tree.cache_clear()


@pytest.mark.slow
def test_ten_thousand_inputs(target):
    check(target, np.random.default_rng(6).integers(1, 5000, 320), 3)


def two_sums(a, b):
    """Return (..., 2), sums and their rounding errors, as the operation "compensated" combines them."""
    with np.errstate(all="ignore"):
        s = a[..., 0] + b[..., 0]
        back = s - a[..., 0]
        error = (a[..., 0] - (s - back)) + (b[..., 0] - back)
        return np.stack((s, a[..., 1] + b[..., 1] + error), axis=-1)


def compensated(x):
    s, e = np.moveaxis(tree(np.stack((x, np.zeros_like(x)), axis=-1), two_sums), -1, 0)
    return np.where(np.isfinite(s), s + np.where(np.isfinite(s), e, 0), s)


def vectors(x, target):
    """A stream (n, 4) of vectors of 4 with the same numbers."""
    return sh.Stream(x.reshape(len(x), 4, 4), sh.Attrib4f, backend=target)


BACKENDS = ("numpy", "opencl", "glsl")


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
def test_sums_of_vectors_along_an_axis(backend):
    for n in (1, 2, 3, 17, 33, 257):
        x = columns(n, 7, backend)
        rows = vectors(x, backend)
        for method, wanted in (("pairwise", tree(x, add)), ("compensated", compensated(x))):
            found = rows.sum(method, axis=0)
            assert found.shape == (4,)
            assert not differs(found.numpy().ravel(), wanted).any(), (n, method)
        with np.errstate(all="ignore"):
            mean = tree(x, add) / np.float32(n)
        assert not differs(rows.mean(axis=-2).numpy().ravel(), mean).any(), n
        assert not differs(rows.mean(), tree(x.reshape(-1, 4), add) / np.float32(4 * n)).any(), n


@pytest.mark.sampled(4)
@pytest.mark.parametrize("backend", BACKENDS)
def test_extremes_and_where_they_stand(backend):
    for n in (1, 2, 3, 17, 33, 257):
        x = columns(n, 8, backend)
        x[:, 0] = np.random.default_rng(n).choice(np.float32([0, -0.0, 1, np.nan] if n > 3 else [0, -0.0]), n)
        rows = vectors(x, backend)
        for name in ("min", "max"):
            at = getattr(np, f"arg{name}")(x, axis=0)
            assert (getattr(rows, f"arg{name}")(axis=0).numpy().ravel() == at).all(), (n, name)
            assert not differs(getattr(rows, name)(axis=0).numpy().ravel(), x[at, range(16)]).any(), (n, name)
            whole = x.reshape(-1, 4)
            at = getattr(np, f"arg{name}")(whole, axis=0)
            assert (getattr(rows, f"arg{name}")() == at).all(), (n, name)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_logic_and_counts(backend):
    x = np.array([[0, -0.0, 1, np.nan], [0, 0, 2, 0], [0, 0, 3, 0]], np.float32)
    s = sh.Stream(x, sh.Attrib1f, backend=backend)
    assert s.any(axis=0).numpy().tolist() == [False, False, True, True]
    assert s.all(axis=0).numpy().tolist() == [False, False, True, False]
    assert s.count(axis=0).numpy().tolist() == [0, 0, 3, 1]
    assert (s.any(), s.all(), s.count()) == (True, False, 4)
    flags = sh.Stream(x > 0, sh.Attrib1b, backend=backend)
    assert (flags.any(), flags.all(), flags.count(), flags.sum()) == (True, False, 3, 3)
    assert (flags.min(), flags.max(), flags.argmax()) == (False, True, 2)
    assert flags.sum(axis=1).type is sh.Attrib1i
    assert flags.any(axis=1).numpy().dtype == np.bool_


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_integers_wrap(backend):
    x = np.random.default_rng(1).integers(0, 2**32, 1000, np.uint32)
    for type_, word in ((sh.Attrib1u, np.uint32), (sh.Attrib1i, np.int32)):
        s = sh.Stream(x.view(word), type_, backend=backend)
        for method in ("pairwise", "compensated", "exact"):
            assert s.sum(method) == x.view(word).sum(dtype=word)
        assert (s.min(), s.argmax()) == (x.view(word).min(), x.view(word).argmax())


@pytest.mark.parametrize("backend", BACKENDS)
def test_no_elements(backend):
    for shape in ((0,), (3, 0), (0, 3)):
        s = sh.Stream.empty(shape, sh.Attrib2f, backend=backend)
        axis = None if len(shape) == 1 else shape.index(0)
        left = () if axis is None else (3,)
        for found, value in ((s.sum(axis=axis), 0), (s.any(axis), False), (s.all(axis), True), (s.count(axis), 0)):
            assert np.array_equal(np.asarray(found), np.full((*left, 2), value))
        assert np.isnan(np.asarray(s.mean(axis))).all()
        for name in ("min", "max", "argmin", "argmax"):
            with pytest.raises(sh.ShpyTypeError, match=f"{name} of no elements has no result"):
                getattr(s, name)(axis)
    with pytest.raises(sh.ShpyTypeError, match=re.escape("sh.reduce of no elements has no result")):
        sh.reduce(add_pairs, s)
    assert sh.Stream.empty((0, 3), sh.Attrib1f, backend=backend).sum(axis=1).shape == (0,)
    assert sh.Stream.empty((0, 3), sh.Attrib1f, backend=backend).min(axis=1).shape == (0,)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_exact_sums_are_rounded_once(backend):
    for n in (0, 1, 2, 3, 17, 2500):
        x = columns(max(n, 1), 9, backend)[:n]
        found = sh.Stream(x.T.copy(), sh.Attrib1f, backend=backend).sum("exact", axis=1).numpy()
        for k, (column, got) in enumerate(zip(x.T, found, strict=True)):
            if np.isnan(column).any() or {np.inf, -np.inf} <= set(column.tolist()):
                assert np.isnan(got), (n, k)
            else:
                wanted = column.sum() if np.isinf(column).any() else rounded(column, np.float32)
                assert got == wanted, (n, k)


def test_an_exact_sum_of_zero_is_positive():
    assert not np.signbit(sh.Stream([-0.0, -0.0], sh.Attrib1f, backend="numpy").sum("exact"))


def test_an_exact_sum_of_infinities_in_several_blocks_raises_nothing():
    x = np.zeros(600_000, np.float32)
    x[[0, -1]] = np.inf, -np.inf
    with np.errstate(all="raise"):
        assert np.isnan(sh.Stream(x, sh.Attrib1f, backend="numpy").sum("exact"))


@sh.program
def add_pairs(a: sh.Attrib2f, b: sh.Attrib2f) -> sh.Attrib2f:
    return a + b


def doubles(rng, n):
    """Doubles whose sum cancels, at all exponents."""
    x = np.ldexp(rng.integers(-(2**52), 2**52, n).astype(float), rng.integers(-1074, 900, n))
    return np.concatenate((x, rng.permutation(-x) * rng.choice([1, 1, 1, 0.5], n)))


@pytest.mark.parametrize("backend", ["numpy", "opencl"])
def test_exact_sums_of_doubles_are_those_of_fsum(backend):
    rng = np.random.default_rng(4)
    for n in (1, 2, 30, 1000):
        x = np.stack([doubles(rng, n) for _ in range(60)])
        wanted = [math.fsum(row) for row in x.tolist()]
        for type_, precision in ((sh.Attrib1f, "f64"), (sh.Attrib1d, "f32")):
            found = sh.Stream(x, type_, backend=backend, precision=precision).sum("exact", axis=1)
            assert found.numpy().tolist() == wanted
            assert found.numpy().dtype == np.float64


@pytest.mark.sampled(4)
@pytest.mark.parametrize("backend", ["numpy", "opencl"])
@pytest.mark.parametrize(("type_", "word"), [(sh.Attrib1d, np.float64), (sh.Attrib1h, np.float16)])
def test_other_floats_than_the_working_one(backend, type_, word):
    x = np.random.default_rng(2).standard_normal(301).astype(word)
    x[7] = np.nan
    s = sh.Stream(x, type_, backend=backend)
    assert (np.isnan(s.min()), s.argmin(), np.isnan(s.sum("compensated"))) == (True, 7, True)
    x[7] = 0
    s.update(x)
    wide = np.float32 if word is np.float16 else word  # binary16 is added in binary32
    total = tree(x.astype(wide), add)
    assert s.sum() == word(total)
    assert s.sum().dtype == word
    assert s.mean() == word(total / wide(301))
    assert s.sum("exact") == word(math.fsum(x.tolist()))


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
@pytest.mark.parametrize(("type_", "precision"), [(sh.Attrib2h, "f32"), (sh.Attrib2f, "f16")])
@pytest.mark.parametrize("n", [2049, 70_001])
def test_a_mean_divides_by_a_number_that_16_bits_do_not_hold(backend, type_, precision, n):
    x = np.full((n, 2), [2.0**-8, -(2.0**-9)], np.float16)
    s = sh.Stream(x, type_, backend=backend, precision=precision)
    wanted = x[0]  # though the sums end at 65,504
    assert s.mean().tobytes() == wanted.tobytes()
    assert s.mean(axis=0).numpy().tobytes() == wanted.tobytes()
    assert s.reshape(1, n).mean(axis=1).numpy().tobytes() == wanted.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
@pytest.mark.parametrize(("type_", "precision"), [(sh.Attrib1h, "f32"), (sh.Attrib1f, "f16")])
def test_16_bits_are_added_in_32(backend, type_, precision):
    s = sh.Stream(np.full(3000, 30.0, np.float16), type_, backend=backend, precision=precision)
    assert (s.mean(), s.mean().dtype, s.sum(), s.sum("compensated")) == (30, np.float16, np.inf, np.inf)
    x = np.random.default_rng(4).normal(0, 100, (40, 5, 2)).astype(np.float16)
    vector = {sh.Attrib1h: sh.Attrib2h, sh.Attrib1f: sh.Attrib2f}[type_]
    v = sh.Stream(x, vector, backend=backend, precision=precision)
    wide = x.astype(np.float32)
    assert v.sum().tobytes() == tree(wide.reshape(-1, 2), add).astype(np.float16).tobytes()
    assert v.sum(axis=0).numpy().tobytes() == tree(wide, add).astype(np.float16).tobytes()
    assert v.mean(axis=0).numpy().tobytes() == (tree(wide, add) / np.float32(40)).astype(np.float16).tobytes()
    assert v.sum("compensated", axis=0).numpy().tobytes() == np.float16(x.astype(np.float64).sum(0)).tobytes()
    assert (v.sum(axis=0).type, v.sum(axis=0).precision) == (vector, precision)
    assert v.sum(axis=0).sum().dtype == np.float16
    none = sh.Stream(np.zeros((0, 3), np.float16), type_, backend=backend, precision=precision)
    assert (none.sum(), none.sum(axis=0).numpy().tolist(), none.sum(axis=1).shape) == (0, [0, 0, 0], (0,))


def test_rounding_twice_is_another_number():
    """The sum is half an ULP and a bit that binary64 drops, so float32(math.fsum(x)) is wrong by one ULP."""
    x = np.float32([1, 2.0**-24, 2.0**-80])
    assert np.float32(math.fsum(x)) == 1
    assert sh.Stream(x, sh.Attrib1f, backend="numpy").sum("exact") == np.nextafter(np.float32(1), np.float32(2))


def test_misuse_names_the_line_and_a_cure():
    s = sh.Stream(np.ones((2, 3)), sh.Attrib1f, backend="numpy")
    with pytest.raises(sh.ShpyTypeError, match=r"test_reduce.py:\d+: axis=2 of .*, which has 2 axes"):
        s.sum(axis=2)
    with pytest.raises(sh.ShpyTypeError, match=r"method='kahan' of a sum\n.*method=\"exact\""):
        s.sum("kahan")
    with pytest.raises(sh.ShpyTypeError, match="takes a program of two elements, not builtin"):
        sh.reduce(max, s)
    with pytest.raises(sh.ShpyTypeError, match=r"add_pairs\(a: sh.Attrib1f, b: sh.Attrib1f\) -> sh.Attrib1f"):
        sh.reduce(add_pairs, s)
    with pytest.raises(sh.ShpyTypeError, match="takes a Stream, not ndarray"):
        sh.reduce(add_pairs, np.ones((2, 2)))
    with pytest.raises(sh.ShpyTypeError, match="the mean of"):
        sh.Stream([1, 2], sh.Attrib1i, backend="numpy").mean()
    with pytest.raises(sh.ShpyTypeError, match="sum takes scalars and vectors"):
        as_columns(np.ones((2, 16)), "numpy").sum()


def test_programs_that_ask_where_they_are_do_not_combine():
    @sh.program
    def here(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
        return a + b + sh.Attrib1f(sh.grid_index(1))

    with pytest.raises(sh.ShpyTypeError, match=r"test_reduce.py:\d+: here uses grid_index"):
        sh.reduce(here, sh.Stream([1, 2], sh.Attrib1f, backend="numpy"))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_programs_with_branches_and_uniforms(backend):
    limit = sh.Param(sh.Attrib1f, 3.0)

    @sh.program
    def longer(a: sh.Point2f, b: sh.Point2f) -> sh.Point2f:
        result = a.copy()
        with sh.SH_IF(sh.dot(b, b) > sh.dot(a, a) * limit):
            result[:] = b
        return result

    def wanted(a, b):
        return np.where((b * b).sum(-1, keepdims=True) > (a * a).sum(-1, keepdims=True) * limit.value, b, a)

    x = np.random.default_rng(3).integers(-9, 9, (77, 2)).astype(np.float32)
    s = sh.Stream(x, sh.Point2f, backend=backend)
    for value in (3.0, 1.5):
        limit.value = value
        assert (sh.reduce(longer, s) == tree(x, wanted)).all()
    along = sh.reduce(longer, sh.Stream(x.reshape(7, 11, 2), sh.Point2f, backend=backend), axis=1)
    assert along.type is sh.Point2f
    assert (along.numpy() == [tree(row, wanted) for row in x.reshape(7, 11, 2)]).all()


@sh.subroutine
def distance_or_half(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
    with sh.SH_IF(x > y):
        sh.SH_RETURN(x - y)
    return y * 0.5


@sh.program
def by_subroutine(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return distance_or_half(a, b)


@pytest.mark.sampled(4)
def test_programs_may_call_subroutines_that_return_early(target):
    for n in (1, 2, 17, 1000):
        x = np.random.default_rng(n).standard_normal(n).astype(np.float32)
        s = sh.Stream(x, sh.Attrib1f, backend=target)
        assert sh.reduce(by_subroutine, s) == tree(x, lambda a, b: np.where(a > b, a - b, b * np.float32(0.5)))


@sh.program
def summed(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


def test_a_driver_that_refuses_the_kernel_of_a_tree_runs_the_program(monkeypatch):
    build = Machine.build

    def refuse(machine, text, *args, **options):
        if opencl_trees.FOLD in text:
            raise machine.cl.RuntimeError("clBuildProgram failed: BUILD_PROGRAM_FAILURE")
        return build(machine, text, *args, **options)

    x = np.random.default_rng(3).standard_normal(100).astype(np.float32)
    s = sh.Stream(x, sh.Attrib1f, backend="opencl")
    own_tree.cache_clear()
    monkeypatch.setattr(Machine, "build", refuse)
    with pytest.warns(sh.ShpyWarning, match="summed reduces slower on OpenCL: the driver refuses"):
        assert sh.reduce(summed, s) == tree(x, add)
    own_tree.cache_clear()


def test_a_result_along_an_axis_is_a_stream_of_its_own():
    s = sh.Stream([[1.0], [2.0]], sh.Attrib1f, backend="numpy")
    total = s.sum(axis=1)
    s.update([[5.0], [6.0]])
    assert total.numpy().tolist() == [1, 2]
