"""The number of axes that a program needs: one for a program and all that it calls, whichever way they meet."""

import numpy as np
import pytest

import shpy as sh


@sh.program
def depth() -> sh.Attrib1f:
    return sh.Attrib1f(sh.grid_index(3).x)


@sh.program
def row(x: sh.Attrib1f) -> sh.Attrib1f:
    return x + sh.grid_index(2).x


@sh.program
def height() -> sh.Attrib1i:
    return sh.grid_shape(2).x


@sh.program
def alive() -> sh.Attrib1b:
    return sh.grid_index(1) > 0


def called():
    @sh.program
    def picture() -> sh.Attrib1f:
        return depth() + sh.grid_index(2).x


def called_later():
    @sh.program
    def picture() -> sh.Attrib1f:
        r = sh.grid_index(2).x
        return depth() + r


def called_in_a_subroutine():
    @sh.subroutine
    def inner(x: sh.Attrib1f) -> sh.Attrib1f:
        return depth() + x

    @sh.program
    def picture() -> sh.Attrib1f:
        return inner(sh.Attrib1f(1)) + height()


MEETINGS = {
    "called": called,
    "called later": called_later,
    "called in a subroutine": called_in_a_subroutine,
    "joined": lambda: depth & height,
    "fused": lambda: row << depth,
    "where of a chain": lambda: sh.repeat(row, 2, where=alive).run(x=np.zeros((2, 3))),
}


@pytest.mark.parametrize("meet", MEETINGS.values(), ids=MEETINGS)
def test_programs_of_other_ranks_do_not_meet(meet):
    """On numpy and GLSL they gave pictures that differed, without a word."""
    with pytest.raises(sh.ShpyTypeError, match=r"takes? elements of [123] axes.*, and .*:\d+ takes [123]\n") as caught:
        meet()
    assert "sh.grid_index(" in caught.value.cure
    assert caught.value.loc.file == __file__


@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
def test_programs_of_one_rank_meet(backend):
    both = (height & row).compile(backend)
    heights, rows = both(np.zeros((2, 3), np.float32))
    assert (heights == 2).all()
    np.testing.assert_array_equal(rows, [[0, 0, 0], [1, 1, 1]])
