"""sh.scan gives the bits of its definition on every backend."""

import re

import numpy as np
import pytest
from backends.running import differs
from collectives.definition import (
    AROUND,
    SIZES,
    TARGETS,
    add,
    add_columns,
    as_columns,
    columns,
    from_columns,
    halve,
    halve_columns,
    prefixes,
    target,
    tree,
    trees,
)

import shpy as sh

__all__ = ["target", "trees"]


@sh.program
def add_ints(a: sh.Attrib1u, b: sh.Attrib1u) -> sh.Attrib1u:
    return a + b


def check(target, sizes, seed):
    for n in sizes:
        x = columns(n, seed, target)
        for program, f in ((add_columns, add), (halve_columns, halve)):
            found = from_columns(sh.scan(program, as_columns(x, target)).numpy())
            assert not differs(found, prefixes(x, f)).any(), (n, seed, program)


@pytest.mark.sampled(6)
def test_prefixes_have_the_bits_of_the_definition(target):
    check(target, SIZES, 1)
    check(target, np.random.default_rng(5).integers(1, 300, 14), 2)


@sh.program
def halve_scalars(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a - b * 0.5


@pytest.mark.sampled(6)
def test_prefixes_of_scalars(target):
    for n in (63, 64, 65, 66, 67, 127, 1003, 4097):
        x = columns(n, 4, target)
        for k in range(0, 16, 5):
            s = sh.Stream(x[:, k].copy(), sh.Attrib1f, backend=target)
            wanted = prefixes(x[:, k], halve)
            assert not differs(sh.scan(halve_scalars, s).numpy(), wanted).any(), (n, k)
            shifted = np.append(np.float32(0), wanted[:-1])
            assert not differs(sh.scan(halve_scalars, s, exclusive=True).numpy(), shifted).any(), (n, k)


@pytest.mark.slow
def test_sizes_around_blocks_and_parts(trees):
    for n in AROUND:
        for seed in (0, 3, 12):  # numbers, all exponents, NaN
            x = columns(n, 5, trees)[:, seed].copy()
            s, wanted = sh.Stream(x, sh.Attrib1f, backend=trees), prefixes(x, halve)
            assert not differs(sh.scan(halve_scalars, s).numpy(), wanted).any(), (n, seed)
            shifted = np.append(np.float32(0), wanted[:-1])
            assert not differs(sh.scan(halve_scalars, s, exclusive=True).numpy(), shifted).any(), (n, seed)


@pytest.mark.slow
def test_ten_thousand_inputs(target):
    check(target, np.random.default_rng(6).integers(1, 5000, 320), 3)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_the_last_prefix_of_a_power_of_two_is_the_reduction(backend):
    x = columns(256, 4, backend)
    found = from_columns(sh.scan(halve_columns, as_columns(x, backend))[-1])
    assert not differs(found, from_columns(sh.reduce(halve_columns, as_columns(x, backend)))).any()


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_exclusive_prefixes_begin_with_zero(backend):
    for n in (0, 1, 2, 3, 4, 5, 17, 300):
        x = np.random.default_rng(n).integers(0, 2**32, n, np.uint32)
        s = sh.Stream(x, sh.Attrib1u, backend=backend)
        sums = np.cumsum(x, dtype=np.uint32)
        assert sh.scan(add_ints, s).numpy().tolist() == sums.tolist()
        assert sh.scan(add_ints, s, exclusive=True).numpy().tolist() == [0, *sums[:-1]][:n]


def test_prefixes_keep_the_shape_and_the_type():
    s = sh.Stream(np.ones((2, 3), np.uint32), sh.Attrib1u, backend="numpy")
    found = sh.scan(add_ints, s)
    assert (found.shape, found.type) == ((2, 3), sh.Attrib1u)
    assert found.numpy().tolist() == [[1, 2, 3], [4, 5, 6]]
    assert s.numpy().tolist() == [[1, 1, 1], [1, 1, 1]]


def test_misuse_names_the_line_and_a_cure():
    s = sh.Stream([1.0, 2.0], sh.Attrib1f, backend="numpy")
    with pytest.raises(sh.ShpyTypeError, match=re.escape("add_ints(a: sh.Attrib1f, b: sh.Attrib1f)")):
        sh.scan(add_ints, s)


def test_a_result_keeps_its_memory():
    """The prefixes lie in memory that was allocated as vectors, and is not given to others while they are there."""
    s = sh.Stream(np.arange(1000, dtype=np.uint32), sh.Attrib1u, backend="opencl")
    found = sh.scan(add_ints, s)
    others = [sh.Stream(np.full(1000, k, np.uint32), sh.Attrib1u, backend="opencl") for k in range(8)]
    assert (found.numpy() == np.cumsum(np.arange(1000))).all()
    assert [int(o[0]) for o in others] == list(range(8))


@sh.program
def halve_vectors(a: sh.Attrib3f, b: sh.Attrib3f) -> sh.Attrib3f:
    return a - b * 0.5


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["f16", "f64"])
def test_trees_at_other_working_precisions(target, precision, request):
    """Reductions and prefixes of scalars and vectors, in the runs of one part and of several.

    Kernels take long to compile: a width of OpenCL takes scalars at one precision and vectors at the other.
    """
    if (target, precision) == ("glsl", "f64"):
        with pytest.raises(sh.ShpyTypeError, match=r"GLSL 3\.30 has no f64"):
            sh.Stream([1.0], sh.Attrib1f, target, precision=precision)
        return
    word = {"f16": np.float16, "f64": np.float64}[precision]
    turn = TARGETS.index(request.node.callspec.params["target"]) // 2 + (precision == "f64")
    kinds = [False, True] if target != "opencl" else [turn % 2 == 0]
    for n in (1, 2, 7, 130, 70_001):
        x = np.random.default_rng(n).standard_normal((n, 3)).astype(word)
        for program, data in ((halve_vectors, x) if vectors else (halve_scalars, x[:, 0].copy()) for vectors in kinds):
            s = sh.Stream(data, sh.Attrib3f if data.ndim > 1 else sh.Attrib1f, target, precision=precision)
            assert not differs(sh.reduce(program, s), tree(data, halve)).any(), n
            assert not differs(sh.scan(program, s).numpy(), prefixes(data, halve)).any(), n
