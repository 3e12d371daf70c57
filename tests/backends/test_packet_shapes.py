"""The elements of a packet: a part of a list or row where lanes agree, a block of an image where they diverge."""

import numpy as np
import pytest
from backends.test_packets import both, each_width, same

import shpy as sh
from shpy import SH_DISCARD, SH_IF, SH_WHILE

RNG = np.random.default_rng(7)
LENT = 1 << 14
"""Numbers of which an array is long enough to be lent to a device that works in the host's memory."""
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


@pytest.mark.sampled(4)
@each_width
@pytest.mark.parametrize("shape", [(5, 33), (40, 16), (3, 100), (70, 1), (2, 3, 20), (91,), (3,)])
def test_lanes_that_stay_together_are_a_row(lanes: int, shape: tuple[int, ...]) -> None:
    x, n = RNG.normal(size=(*shape, 3)).astype(np.float32), RNG.integers(0, 9, shape, np.int32)
    placed = {1: [beside], 2: [sloping]}.get(len(shape), [])
    for program, arrays in ((moved, (x, n)), *((p, (n,)) for p in placed)):
        told = f"{lanes} that follow one another" if program is moved else f"1 row of {lanes}"
        assert told in program.compile("opencl", lanes=lanes).source
        for found, expected in zip(*both(program, lanes, *arrays), strict=True):
            same(found, expected)


@pytest.mark.sampled(4)
@each_width
@pytest.mark.parametrize("shape", [(9, 37), (70, 1), (5, 64), (91,)])
def test_lanes_that_part_are_a_block(lanes: int, shape: tuple[int, ...]) -> None:
    told = "4 that follow one another" if lanes == 4 else f"{lanes // 4} rows of 4"
    assert told in countdown.compile("opencl", lanes=lanes).source
    same(*both(countdown, lanes, RNG.uniform(-3, 30, shape).astype(np.float32)))


@sh.program
def halved(x: sh.Attrib1f) -> sh.Attrib1f:
    return 0.5 * x + 1.0


@sh.program
def kept(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_IF(x < 0):
        SH_DISCARD()
    return sh.cond(x > 1, x * x, 3.0)


@pytest.mark.sampled(2)
@each_width
def test_a_list_has_no_rows_to_test(lanes: int) -> None:
    text = halved.compile("opencl", lanes=lanes).source
    assert "int row" not in text
    assert ".whole" not in text


@pytest.mark.sampled(4)
@each_width
@pytest.mark.parametrize("program", [halved, kept])
def test_the_end_of_a_list_is_where_the_array_ends(lanes: int, program: sh.Program) -> None:
    """Short lists are copied to the device; long ones are worked on where they lie, in place too."""
    numpy, opencl = program.compile("numpy"), program.compile("opencl", lanes=lanes)
    for count in (0, 1, lanes - 1, lanes, lanes + 1, LENT - 1, LENT, LENT + 1, LENT + lanes - 1):
        held = RNG.uniform(-1, 3, count + 2 * lanes).astype(np.float32)
        x, after = held[:count], held[count:].copy()
        expected = numpy.run(x.copy(), out=x.copy())
        found = opencl.run(x.copy(), out=x.copy())
        assert np.array_equal(found.written, expected.written)
        same(found.outputs, expected.outputs, count)
        same(opencl.run(x, out=x).outputs, expected.outputs, count)
        same(x, expected.outputs, count)
        same(held[count:], after, count)


def test_large_programs_know_their_place_on_three_axes():
    """A large program stands in a function of its own, which is handed the shape that its packet needs."""

    @sh.program
    def large(t: sh.Table[sh.Attrib1f, 3]) -> sh.Attrib1f:
        p = sh.grid_index(3)
        total = sh.Attrib1f(0)
        for k in range(150):
            total += sh.sqrt(t[p.x, p.y + k, p.z] + k)
        return total

    t = sh.Table(np.random.default_rng(1).random((3, 9, 5)), sh.Attrib1f)
    packets = large.compile("opencl", lanes=8)
    assert "large_packet" in packets.source
    assert (packets(t, shape=(3, 9, 5)) == large.compile("numpy")(t, shape=(3, 9, 5))).all()
