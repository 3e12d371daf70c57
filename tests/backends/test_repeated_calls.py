"""A call of a kernel like the one before repeats its steps, and gives the outputs of its own inputs."""

from typing import Any, NamedTuple

import numpy as np
import pytest

import shpy as sh
from shpy.backend.opencl.device import run
from shpy.testing.arrays import flat_leaves


@sh.struct
class Frame:
    axes: sh.Matrix2f
    place: sh.Point2f


class Pair(NamedTuple):
    first: sh.Attrib1i
    second: sh.Matrix3f


def turned(x: Any) -> sh.Matrix2f:
    return sh.Matrix2f((x, 2), (3, x * x))


@sh.program
def scalar(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * x


@sh.program
def vector(x: sh.Attrib1f) -> sh.Vector3f:
    return sh.Vector3f(x, 2 * x, x * x)


@sh.program
def matrix(x: sh.Attrib1f) -> sh.Matrix2f:
    return turned(x)


@sh.program
def struct(x: sh.Attrib1f) -> Frame:
    return Frame(turned(x), sh.Point2f(x, 1))


@sh.program
def several(x: sh.Attrib1f) -> tuple[sh.Matrix2f, sh.Attrib2f]:
    return turned(x), sh.Attrib2f(x, -x)


@sh.program
def named(x: sh.Attrib1f) -> Pair:
    return Pair(sh.Attrib1i(x), sh.Matrix3f((x, 0, 0), (0, x, 0), (0, 0, x)))


@sh.program
def nested(x: sh.Attrib1f) -> tuple[Frame, tuple[sh.Attrib1b, sh.Matrix2f]]:
    return Frame(turned(x), sh.Point2f(x, 1)), (x > 2, turned(-x))


@sh.program
def discarded(x: sh.Attrib1f) -> sh.Matrix2f:
    sh.SH_DISCARD(x > 30)
    return turned(x)


PROGRAMS = [scalar, vector, matrix, struct, several, named, nested, discarded]


@pytest.mark.sampled(8)
@pytest.mark.parametrize("shape", [(5,), (3, 2), (1,)], ids=str)
@pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_each_call_has_its_own_outputs(program: sh.Program[Any, Any], backend: str, shape: tuple[int, ...]) -> None:
    kernel = program.compile(backend)
    first = np.arange(1, 1 + np.prod(shape), dtype=np.float32).reshape(shape)
    given = [first * k for k in (1, 10, 1, -3)]
    # A list takes the way that checks everything.
    wanted = [[leaf.tolist() for leaf in flat_leaves(kernel(x.tolist()))] for x in given]
    for call in (kernel, lambda x: kernel.run(x).outputs, program.compile(backend)):
        found = [call(x) for x in given]
        assert [[leaf.tolist() for leaf in flat_leaves(outputs)] for outputs in found] == wanted


SHIFT = sh.Param(sh.Attrib2i, (0, 0))


@sh.program
def around(x: sh.Table[sh.Attrib1i, 2], y: sh.Attrib1i, z: sh.Attrib1i) -> sh.Attrib1i:
    """The sum of two elements, the number of their place, and the element of the table at that place plus SHIFT."""
    at = sh.grid_index(2)
    return y + z + 1000 * at.x + at.y + x[at + SHIFT]


@pytest.mark.parametrize("lanes", [1, 16])
def test_runs_of_several_shapes_take_turns(lanes: int) -> None:
    """More shapes than a kernel keeps launches of, twice, with other params, each over streams and over arrays."""
    kernel = sh.Program(around.recorded).compile("opencl", lanes=lanes)
    rng = np.random.default_rng(0)
    shapes = [(1 + k % 9, 1 + k) for k in range(run._LAUNCHES + 6)] + [(40, 70), (300, 400)]
    for shift in ((0, 0), (1, -2)):
        SHIFT.value = shift
        for shape in shapes:
            x, y, whole = rng.integers(-100, 100, (3, *shape), np.int32)
            rows, columns = (np.clip(np.arange(n) + k, 0, n - 1) for n, k in zip(shape, shift, strict=True))
            numbers = 1000 * np.arange(shape[0])[:, None] + np.arange(shape[1])
            for z in (whole, whole[:1, :1]):
                expected = y + z + numbers + x[rows][:, columns]
                np.testing.assert_array_equal(kernel(x, y, z), expected)
                streams = [sh.Stream(array, sh.Attrib1i, "opencl") for array in (x, y, z)]
                np.testing.assert_array_equal(kernel(*streams).numpy(), expected)
