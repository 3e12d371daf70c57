"""What lies in a packet: a row of elements where lanes stay together, a block of an image where they part."""

import numpy as np
import pytest
from backends.test_packets import both, each_width, same

import shpy as sh
from shpy import SH_WHILE

RNG = np.random.default_rng(7)
heights = sh.Table(RNG.normal(size=(48, 64)).astype(np.float32), sh.Attrib1f, name="heights")
pairs = sh.Table(RNG.normal(size=(90, 2)).astype(np.float32), sh.Attrib2f, name="pairs")


@sh.program
def moved(x: sh.Attrib3f, n: sh.Attrib1i) -> tuple[sh.Attrib3f, sh.Attrib1f, sh.Attrib1b]:
    return x.zxy * 2.0 + sh.Attrib1f(n), x.x - x.y * x.z, n > 3


@sh.program
def sloping(n: sh.Attrib1i) -> tuple[sh.Attrib1f, sh.Attrib2f]:
    row, column = sh.grid_index(2)
    return heights[row + 1, column - 2] - heights[row, column], sh.Attrib2f(n * row, column)


@sh.program
def beside(n: sh.Attrib1i) -> tuple[sh.Attrib2f, sh.Attrib1i]:
    i = sh.grid_index(1)
    return pairs[i - 3] - pairs[i], n * i


@sh.program
def countdown(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_WHILE(lambda: x > 0):
        x -= 1
    return x


@each_width
@pytest.mark.parametrize("shape", [(5, 33), (40, 16), (3, 100), (70, 1), (2, 3, 20), (91,), (3,)])
def test_lanes_that_stay_together_are_a_row(lanes: int, shape: tuple[int, ...]) -> None:
    x, n = RNG.normal(size=(*shape, 3)).astype(np.float32), RNG.integers(0, 9, shape, np.int32)
    placed = {1: [beside], 2: [sloping]}.get(len(shape), [])
    for program, arrays in ((moved, (x, n)), *((p, (n,)) for p in placed)):
        assert f"1 row of {lanes}" in program.compile("opencl", lanes=lanes).source
        for found, expected in zip(*both(program, lanes, *arrays), strict=True):
            same(found, expected)


@each_width
@pytest.mark.parametrize("shape", [(9, 37), (70, 1), (5, 64), (91,)])
def test_lanes_that_part_are_a_block(lanes: int, shape: tuple[int, ...]) -> None:
    assert f"{lanes // 4} row{'s' if lanes > 4 else ''} of 4" in countdown.compile("opencl", lanes=lanes).source
    same(*both(countdown, lanes, RNG.uniform(-3, 30, shape).astype(np.float32)))
