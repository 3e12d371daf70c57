"""Fused multiply-adds of numpy, against rational arithmetic."""

import itertools

import numpy as np
import pytest
from rational import each

from shpy.ir.multiply_add import multiply_add

TYPES = [np.float16, np.float32, np.float64]
each_type = pytest.mark.parametrize("dtype", TYPES)


def agree(a, b, c):
    with np.errstate(all="ignore"):
        results = multiply_add(a, b, c)
    right = each(a, b, c)
    unsigned = {2: np.uint16, 4: np.uint32, 8: np.uint64}[a.dtype.itemsize]
    same = (results.view(unsigned) == right.view(unsigned)) | (np.isnan(results) & np.isnan(right))
    wrong = np.flatnonzero(~same)
    assert not wrong.size, [(a[k], b[k], c[k], results[k], right[k]) for k in wrong[:3]]


@pytest.mark.sampled(3)
@each_type
def test_numbers_at_the_edges(dtype):
    numbers = np.finfo(dtype)
    edges = [0, 1, 1 + numbers.eps, 1 - numbers.epsneg, 3, numbers.tiny, numbers.smallest_subnormal, numbers.max]
    edges += [numbers.tiny * 0.75, float(numbers.max) / 2, np.inf, 0.5, numbers.eps, numbers.eps**2]
    signed = np.array([*edges, *(-e for e in edges), np.nan], dtype)
    a, b, c = (np.array(v, dtype) for v in zip(*itertools.product(signed, repeat=3), strict=True))
    agree(a, b, c)


@pytest.mark.sampled(4)
@each_type
@pytest.mark.parametrize("share", [1, 8])
def test_sums_that_nearly_cancel_and_middles(dtype, share):
    """Draw products that nearly overflow or vanish, and moderate ones."""
    rng, numbers = np.random.default_rng(share), np.finfo(dtype)
    span = max(1, (int(numbers.maxexp) // 2 - 2) // share)
    a, b = ((1 + rng.random(600)) * 2.0 ** rng.integers(-span, span, 600) for _ in range(2))
    a, b = (v.astype(dtype) * rng.choice([-1, 1], 600).astype(dtype) for v in (a, b))
    with np.errstate(all="ignore"):
        product = a * b
        unit = np.spacing(product)
        near = np.nan_to_num(product + rng.integers(-3, 4, 600).astype(dtype) * unit)
        half = np.nan_to_num(unit * dtype(0.5))
        added = (-product, -near, half, -half, half * dtype(0.5), near * dtype(2**10), product * numbers.eps)
    for c in added:
        agree(a, b, np.nan_to_num(c).astype(dtype))


def test_few_numbers_and_shapes_that_are_broadcast():
    one, many = np.float64(0.1), np.linspace(-3, 3, 7)
    assert multiply_add(one, one, one).shape == ()
    wide = multiply_add(many[:, None], many, one)
    assert wide.shape == (7, 7)
    assert wide[2, 3] == multiply_add(many[2], many[3], one)
    assert multiply_add(np.float32(3), np.float32([1, 2]), np.float32(1)).tolist() == [4, 7]
