"""Collective operations in the stress mode give the bits of their definitions, at sizes of several dispatches."""

import numpy as np
import pytest
from collectives import (
    test_choosing,
    test_compact,
    test_gather,
    test_histogram,
    test_reduce,
    test_scan,
    test_scatter,
    test_sort,
)
from stress.mode import stressed

BACKENDS = ("numpy", "opencl", "glsl")
SIZES = (0, 1, 2, 17, 63, 257, 1021, 2048, 2049, 2900, 4097)
BY_ELEMENTS = {
    "compact": test_compact.check,
    "gather": test_gather.check,
    "histogram": test_histogram.check,
    "scatter": test_scatter.check,
    "folds": test_scatter.check_folds,
    "sort": test_sort.check,
    "unique": test_choosing.check_unique,
    "top_k": test_choosing.check_top_k,
}
"""Checks of `count` inputs, whose sizes are some of `sizes`."""
BY_SIZES = {"reduce": test_reduce.check, "scan": test_scan.check}
"""Checks of one input for each size."""


def check(name, backend, seed, count):
    with stressed(seed):
        if name in BY_ELEMENTS:
            BY_ELEMENTS[name](backend, count, seed, sizes=SIZES)
        else:
            BY_SIZES[name](backend, np.random.default_rng(seed).choice(SIZES[1:], count), seed)


@pytest.mark.sampled(16)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", [*BY_ELEMENTS, *BY_SIZES])
def test_collectives_agree(name, backend):
    for seed in (1, 2):
        check(name, backend, seed, 11)


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", [*BY_ELEMENTS, *BY_SIZES])
def test_many_collectives_agree(name, backend):
    for seed in range(10, 20):
        check(name, backend, seed, 22)
