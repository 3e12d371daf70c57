"""Several threads run the same kernels over streams of their own: each gets the results of a run alone."""

import gc

import numpy as np
import pytest
from stream_programs import kept, smooth
from test_threads import at_once

import shpy as sh
from shpy.backend.registry import NAMES

THREADS, ROUNDS = 8, 5
every = pytest.mark.parametrize("name", NAMES)


@sh.program
def bend(x: sh.Attrib3f, by: sh.Attrib1f) -> sh.Attrib3f:
    return sh.Attrib3f(sh.sin(x.x) * by, x.z - x.y, x.y * by)


@sh.program
def turned(of: sh.Table[sh.Attrib3f]) -> sh.Attrib3f:
    return of[-1 - sh.grid_index(1) + sh.grid_shape(1)].zxy


@sh.program
def add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


smoothed = sh.repeat(smooth, 3)


def data(number, size):
    return np.random.default_rng([number, size]).normal(size=(size, 3)).astype(np.float32)


def kernels_of(name):
    return {program.name: program.compile(name) for program in (bend, kept, smooth, turned)}


def ran(kernels, name, number, turn):
    """Return the results of kernels, a chain and collective operations for data of this thread and iteration alone."""
    x = data(number, 5 + 701 * (number + turn) % 5000)
    stream, line = sh.Stream(x, sh.Attrib3f, name), sh.Stream(x[:, 0], sh.Attrib1f, name)
    bent = kernels["bend"](kernels["bend"](stream, 0.5), float(number))
    kernels["bend"].run(stream, 2.0, out=stream)
    result = kernels["kept"].run(line, out=line)
    smooth_line, back = sh.Stream.empty(len(x), sh.Attrib1f, name), sh.Stream.empty(len(x), sh.Attrib3f, name)
    kernels["smooth"].run(sh.Table(line), out=smooth_line)
    kernels["turned"].run(sh.Table(stream), out=back)
    found = [bent, stream, line, result.written, smooth_line, back, sh.sort(line), sh.scan(add, smooth_line)]
    found.append(smoothed.run(u=line).streams["u"])
    return [np.asarray(f) for f in found] + [np.float32(smooth_line.sum()), np.int32(result.count)]


@pytest.mark.sampled(3)
@every
def test_eight_threads_run_the_same_kernels_over_streams_of_their_own(name, impatient):
    kernels, alone = kernels_of(name), kernels_of("numpy")
    works = [(number, turn) for number in range(THREADS) for turn in range(ROUNDS)]
    wanted = {work: [a.tobytes() for a in ran(alone, "numpy", *work)] for work in works}
    wrong = []

    def run(number):
        for turn in range(ROUNDS):
            found = [a.tobytes() for a in ran(kernels, name, number, turn)]
            if found != wanted[number, turn]:
                same = [a == b for a, b in zip(found, wanted[number, turn], strict=True)]
                wrong.append((number, turn, same))
            if turn % 4 == number % 4:
                gc.collect()

    assert at_once(*(lambda number=number: run(number) for number in range(THREADS))) == []
    assert wrong == []


@every
def test_threads_read_a_stream_that_they_share(name, impatient):
    x = data(1, 3000)
    stream, kernel = sh.Stream(x, sh.Attrib3f, name), bend.compile(name)
    wanted = {by: np.asarray(bend.compile("numpy")(x, by)).tobytes() for by in map(float, range(THREADS))}
    wrong = []

    def run(by):
        for _ in range(ROUNDS):
            wrong.extend([by] if kernel(stream, by).numpy().tobytes() != wanted[by] else [])

    assert at_once(*(lambda by=float(by): run(by) for by in range(THREADS))) == []
    assert wrong == []
    assert np.array_equal(stream.numpy(), x)
