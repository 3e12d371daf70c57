"""Random programs over grids of two axes: numpy's blocks, and packets in lines, have the bits of single elements."""

import numpy as np
import pytest
from backends.test_packets import same

import shpy as sh
from shpy import SH_ELSE, SH_FOR, SH_IF, SH_RETURN, SH_WHILE

SHAPES = ((4, 7), (1, 6), (5, 1), (3, 40))
FIELD = sh.Table(np.arange(35, dtype=np.float32).reshape(5, 7) / 8 - 2, sh.Attrib1f, name="field")
PAIRS = sh.Table(np.arange(40, dtype=np.int32).reshape(4, 5, 2) - 9, sh.Attrib2i, name="pairs")
MODES = ({}, {}, {"precision": "f64"}, {"fuse": True}, {"math": "portable"}, {"precision": "f16"}, {})
SCALE = sh.Param(sh.Attrib2f, (0.5, -3), name="scale")


@sh.subroutine
def shade(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
    return sh.noise(sh.vec2(x, y)) * x + sh.floor(y)


def turned(v: sh.Attrib2f, k: sh.Attrib1i) -> sh.Attrib2f:
    w = sh.Attrib2f(v)
    with SH_IF(k % 3 == 1):
        w[:] = sh.vec2(-v.y, v.x)
    return w + sh.Attrib2f(k)


def settled(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
    """Call functions, one of which has two forms, from a loop that ends for each element by itself."""
    total = sh.Attrib1f(x)
    with SH_WHILE(lambda: (sh.abs(total) > 1) & (sh.abs(total) < 1e4)):
        total *= 0.375
    return shade(total, y) + sh.pow(sh.abs(y), total)


def first(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
    return sh.floor(x * 2)


def placed(x: sh.Attrib1f, k: sh.Attrib1i) -> sh.Attrib1f:
    """A value that varies with the index alone where its arguments are the same for all elements."""
    row, column = sh.grid_index(2)
    w = sh.vec2(x, column - k)
    with SH_IF(column > k):
        w.x = w.x * 2
    with SH_IF(row == 1):
        SH_RETURN(w.x)
    return w.x * w.y + sh.Attrib1f(row)


def stored(x: sh.Attrib1f, k: sh.Attrib1i) -> sh.Attrib1f:
    row, column = sh.grid_index(2)
    numbers = sh.Array(sh.Attrib1f, 3)
    numbers[column % 3] = x
    return numbers[k] + numbers[row % 3]


SUBROUTINES = [
    [sh.subroutine(alone=alone)(function) for function in (turned, settled, first, placed, stored)]
    for alone in (False, True)
]


class Maker:
    """Makes expressions from the index of an element, whose row and column are values of a line of the grid each."""

    def __init__(self, seed, x, v):
        self.rng = np.random.default_rng(seed)
        self.loops = seed % 3 == 0  # of which elements leave in other iterations: then numpy takes no blocks
        self.turned, self.settled, self.first, self.placed, self.stored = SUBROUTINES[self.loops]
        self.index = sh.grid_index(2)
        row, column = self.index
        self.ints = [row, column, self.index.x * 2 - 3, sh.grid_shape(2).y]
        self.floats = [sh.Attrib1f(row) * 0.5, sh.Attrib1f(column) - 1.25, sh.Attrib1f(x), SCALE.x]
        self.vectors = [sh.Attrib2f(v), sh.Attrib2f(self.index), sh.Attrib2f(SCALE), sh.Attrib2f(self.floats[0])]

    def some(self, values):
        return values[self.rng.integers(len(values))]

    def int(self):
        a, b = self.some(self.ints), self.some(self.ints)
        return [
            lambda: a + b,
            lambda: a * b - 1,
            lambda: sh.max(a, b) % 5,
            lambda: PAIRS[self.place()].y,
            lambda: sh.cond(a < b, a, b + 1),
            lambda: sh.Attrib1i(self.some(self.floats)),
        ][self.rng.integers(6)]()

    def place(self):
        a, b = self.some(self.ints), self.some(self.ints)
        return [
            lambda: self.index + tuple(int(k) for k in self.rng.integers(-1, 2, 2)),
            lambda: sh.Attrib2i(a, b),
            lambda: sh.Attrib2i(a),
            lambda: self.index.yx,
            lambda: self.index.xx + sh.Attrib2i(b, 1),
        ][self.rng.integers(5)]()

    def float(self):
        a, b, v = self.some(self.floats), self.some(self.floats), self.some(self.vectors)
        return [
            lambda: a + b,
            lambda: a * b,
            lambda: a - sh.fract(b),
            lambda: sh.min(a, b) / 3,
            lambda: sh.sqrt(sh.abs(a)),
            lambda: FIELD[self.place()],
            lambda: FIELD[self.place()] - FIELD[self.place()],
            lambda: sh.dot(v, self.some(self.vectors)),
            lambda: sh.length(v),
            lambda: v[self.some(self.ints) % 2],
            lambda: sh.cond(self.some(self.ints) > 1, a, b),
            lambda: shade(a, b),
            lambda: self.settled(a, b) if self.loops else self.first(a, b),
            lambda: self.first(b, a),
            lambda: self.placed(a, self.some(self.ints)),
            lambda: (self.stored if self.loops else self.placed)(b, sh.grid_shape(2).y // 2),
        ][self.rng.integers(16)]()

    def vector(self):
        a, v, w = self.some(self.floats), self.some(self.vectors), self.some(self.vectors)
        return [
            lambda: sh.vec2(a, self.some(self.floats)),
            lambda: sh.Attrib2f(a),
            lambda: sh.Attrib2f(self.some(self.ints)),
            lambda: v + w,
            lambda: v * a,
            lambda: sh.mix(v, w, a),
            lambda: v.yx - w.xx,
            lambda: sh.cond(v < w, v, w),
            lambda: self.turned(v, self.some(self.ints)),
        ][self.rng.integers(9)]()

    def condition(self):
        return self.some(self.floats) > 0.5 if self.rng.integers(2) else self.some(self.ints) % 2 == 0

    def statement(self, depth=0):
        match self.rng.integers(10):
            case 0 | 1 | 2:
                self.floats.append(self.float())
            case 3 | 4:
                self.vectors.append(self.vector())
            case 5:
                self.ints.append(self.int())
            case 6 | 7 if depth < 2:
                changed, moved = sh.Attrib1f(self.float()), sh.Attrib2f(self.vector())
                with SH_IF(self.condition()):
                    self.nested(depth)
                    changed[:] = self.float()
                    moved.y = self.float()
                with SH_ELSE():
                    self.nested(depth)
                    moved[:] = self.vector()
                self.floats.append(changed)
                self.vectors.append(moved)
            case 8 if depth < 2:
                total = sh.Attrib1f(self.float())
                with SH_FOR(int(self.rng.integers(1, 4))) as k:
                    count = len(self.ints)
                    self.ints.append(k)
                    self.nested(depth)
                    total += self.float() * 0.25
                    del self.ints[count:]
                self.floats.append(total)
            case 9 if depth < 2 and self.loops:
                total, end = sh.Attrib1f(self.float()), self.float()
                with SH_WHILE(lambda: (sh.abs(total) < end) & (sh.abs(total) < 1e4)):
                    self.nested(depth)
                    total[:] = sh.abs(total) * 1.5 + 0.5
                self.floats.append(total)
            case _:
                self.floats.append(self.float())

    def nested(self, depth):
        sizes = [len(values) for values in (self.ints, self.floats, self.vectors)]
        for _ in range(self.rng.integers(3)):
            self.statement(depth + 1)
        for values, size in zip((self.ints, self.floats, self.vectors), sizes, strict=True):
            del values[size:]


def random_program(seed):
    @sh.program
    def program(x: sh.Attrib1f, v: sh.Attrib2f) -> tuple[sh.Attrib1f, sh.Attrib2f, sh.Attrib1i]:
        maker = Maker(seed, x, v)
        for _ in range(8):
            maker.statement()
        return maker.floats[-1] + maker.float(), maker.vectors[-1], maker.ints[-1]

    return program


def inputs_of(seed):
    rng, shape = np.random.default_rng(seed), SHAPES[seed % len(SHAPES)]
    # An input of one column, or of one row, is the same for the others.
    shapes = (shape, (shape[0], 1), (1, shape[1]), ())
    x = rng.normal(0, 2, shapes[rng.integers(4)]).astype(np.float32)
    return x, rng.normal(0, 2, (*shape, 2)).astype(np.float32)


def check(seed):
    program, inputs = random_program(seed), inputs_of(seed)
    # Two elements may take turns where no iteration is counted.
    options = {"loop_limit": None if seed % 2 else 100} | MODES[seed % len(MODES)]
    expected = program.compile("opencl", lanes=1, **options)(*inputs)
    for kernel in (
        program.compile("numpy", **options),
        program.compile("opencl", lanes=(4, 8, 16)[seed // 4 % 3], **options),
    ):
        for one, other in zip(kernel(*inputs), expected, strict=True):
            same(one, other)


@pytest.mark.sampled(10)
@pytest.mark.parametrize("seed", range(300))
def test_random_programs_have_the_bits_of_single_elements(seed):
    check(seed)


def test_a_name_that_a_branch_gives_to_a_value_from_outside_ends_with_the_branch():
    """OpenCL's text of this program read such a name after the branch."""
    check(171)


def test_random_programs_run_in_blocks():
    """Otherwise the test above would say nothing."""
    layouts = [random_program(seed).compile("numpy")._executable.layout for seed in range(30)]
    assert sum(layout.grid for layout in layouts) >= 10
    assert sum(layout.grid and layout.apart for layout in layouts) >= 5
