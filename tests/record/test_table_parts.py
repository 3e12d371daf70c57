"""A part of a table that is replaced: every backend reads it, and it alone is sent."""

import numpy as np
import pytest

import shpy as sh
from shpy.ir import tabledata
from shpy.ir.tabledata import TableData

BACKENDS = ["numpy", "opencl", "glsl"]
KINDS = {"small": 10, "lent": 70_000}
"""OpenCL on a CPU reads large arrays where they lie."""


@sh.struct
class Pair:
    a: sh.Attrib1f
    b: sh.Attrib1f


def reader(table):
    @sh.program
    def read(i: sh.Attrib1i) -> table.type:
        return table[i]

    return read


@pytest.mark.sampled(3)
@pytest.mark.parametrize("count", KINDS.values(), ids=KINDS)
@pytest.mark.parametrize("type_", [sh.Attrib1f, sh.Attrib3f, sh.Attrib4f, sh.Attrib2i])
@pytest.mark.parametrize("backend", BACKENDS)
def test_parts_are_read_as_a_new_table_would_be(backend, type_, count):
    shape = (count, type_.size) if type_.size > 1 else (count,)
    dtype = np.int32 if type_ is sh.Attrib2i else np.float32
    held = np.arange(np.prod(shape)).reshape(shape).astype(dtype)
    table = sh.Table(held, type_, name="held")
    kernel, every = reader(table).compile(backend), np.arange(count, dtype=np.int32)
    assert np.array_equal(kernel(every), held)
    for start, stop in [(3, 5), (0, 1), (count - 2, count), (4, 9), (2, count)]:
        held[start:stop] = -7 * held[start:stop] - 1
        table.update(held[start:stop], start=start)
        if stop != 1:  # two parts at once
            assert np.array_equal(kernel(every), held), (start, stop)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("dtype", [np.float32, np.int32])
def test_a_shared_array_is_read_in_place_until_a_part_is_replaced(backend, dtype):
    given = np.arange(70_000, dtype=dtype)
    given.flags.writeable = False
    table = sh.Table(given, sh.Attrib1f if dtype == np.float32 else sh.Attrib1i, name="held", copy=False)
    kernel, every = reader(table).compile(backend), np.arange(len(given), dtype=np.int32)
    assert np.shares_memory(table.host_array(), given)
    assert np.array_equal(kernel(every), given)
    for start in (5, 6):
        table.update([-1, -2], start=start)
    assert kernel(every)[4:9].tolist() == [4, -1, -1, -2, 8]
    assert given[4:9].tolist() == [4, 5, 6, 7, 8]


def test_a_read_only_view_is_copied():
    given = np.arange(8, dtype=np.float32)
    view = given.reshape(2, 4)
    view.flags.writeable = False
    table = sh.Table(view, sh.Attrib4f, name="held")
    given[0] = 9
    assert table[0].x == 0


def test_an_array_that_can_be_written_is_not_shared():
    given = np.arange(8, dtype=np.float32)
    view = given.reshape(2, 4)
    view.flags.writeable = False
    for array in (given.reshape(2, 4), view):
        with pytest.raises(sh.ShpyTypeError, match="held with copy=False shares an array, and this one can be written"):
            sh.Table(array, sh.Attrib4f, name="held", copy=False)
    given.flags.writeable = False  # as the message says to write it
    assert sh.Table(view, sh.Attrib4f, copy=False)[1].y == 5
    assert sh.Table([1, 2], sh.Attrib1f, copy=False)[1] == 2  # numbers that are converted need no array
    pair = sh.Table({"a": given, "b": [0.0] * 8}, Pair, copy=False)
    assert [np.shares_memory(part.host_array(), given) for part in pair._parts] == [True, False]
    with pytest.raises(sh.ShpyTypeError, match="copy=0 is neither True nor False"):
        sh.Table(given, sh.Attrib1f, copy=0)


def test_a_part_of_a_table_of_two_axes_is_rows():
    held = np.zeros((5, 3), np.float32)
    table = sh.Table(held, sh.Attrib1f, name="held")

    @sh.program
    def read(row: sh.Attrib1i, column: sh.Attrib1i) -> sh.Attrib1f:
        return table[row, column]

    rows, columns = np.indices((5, 3), dtype=np.int32).reshape(2, -1)
    kernels = [read.compile(backend) for backend in BACKENDS]
    for kernel in kernels:
        kernel(rows, columns)
    table.update([[1, 2, 3], [4, 5, 6]], start=2)
    held[2:4] = [[1, 2, 3], [4, 5, 6]]
    for kernel in kernels:
        assert np.array_equal(kernel(rows, columns), held.ravel())


def test_a_struct_is_replaced_in_all_its_fields():
    @sh.struct
    class Ball:
        center: sh.Point3f
        radius: sh.Attrib1f

    balls = sh.Table({"center": np.zeros((3, 3)), "radius": np.zeros(3)}, Ball)
    balls.update({"center": [(1, 2, 3)], "radius": [4]}, start=1)
    assert np.array_equal(balls[1].center, [1, 2, 3])
    assert [float(balls[k].radius) for k in range(3)] == [0, 4, 0]
    with pytest.raises(sh.ShpyIndexError):
        balls.update({"center": [(9, 9, 9)], "radius": [9]}, start=3)
    assert float(balls[2].radius) == 0


def test_parts_out_of_range_and_of_other_shapes_change_nothing():
    table = sh.Table(np.zeros((4, 2)), sh.Attrib2f, name="held")
    for part, start in [(np.ones((2, 2)), 3), (np.ones((1, 2)), -1), (np.ones((5, 2)), 0)]:
        with pytest.raises(sh.ShpyIndexError, match="which has 4"):
            table.update(part, start=start)
    with pytest.raises(sh.ShpyTypeError):
        table.update(np.ones((2, 3)), start=0)
    assert np.array_equal(table.host_array(), np.zeros((4, 2)))


def test_a_stream_is_updated_whole():
    table = sh.Table(sh.Stream(np.zeros(4), sh.Attrib1f, backend="numpy"))
    with pytest.raises(sh.ShpyTypeError, match="whole"):
        table.update([1.0], start=2)


def test_what_changed_is_known_part_by_part(monkeypatch):
    data = TableData(np.zeros(20))
    data.change(3, np.ones(2))
    data.change(5, np.ones(4))
    data.change(1, np.ones(1))
    assert data.changed_since(0) == [(1, 2), (3, 9)]
    assert data.changed_since(2) == [(1, 2)]
    assert data.changed_since(3) == []
    assert data.changed_since(None) is None
    monkeypatch.setattr(tabledata, "PARTS", 3)
    data.change(0, np.ones(1))
    assert data.changed_since(0) is None
    assert data.changed_since(1) == [(0, 2), (5, 9)]
    data.replace(np.zeros(20), 9)
    assert data.changed_since(8) is None


def _both(first, second):
    @sh.program
    def both(i: sh.Attrib1i) -> sh.Attrib1f:
        return first[i] + second[i]

    return both


def test_two_tables_of_one_name():
    """An error, and with `unique=False` a number; a table whose name is to be unique has it, whoever comes first."""

    one, other = (sh.Table([1, 2], sh.Attrib1f, "x") for _ in range(2))
    with pytest.raises(sh.RecordError, match="two tables are named 'x'"):
        _both(one, other)
    numbered = sh.Table([3, 4], sh.Attrib1f, "x", unique=False)
    assert _both(numbered, one).tables == {"x": one, "x_2": numbered}
