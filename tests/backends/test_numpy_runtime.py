"""The runtime of the numpy backend: tiles, uniform inputs, outputs in place, statuses, tables, precisions."""

import numpy as np
import pytest

import shpy as sh
from shpy.backend.base import Call, Options
from shpy.backend.numpy.device.run import NumpyBackend
from shpy.backend.numpy.lanes import pick, put, put_aside, vector
from shpy.backend.numpy.tables import TableView
from shpy.errors import BackendUnavailable
from shpy.ir.builder import Builder
from shpy.ir.nodes import Discard, Loc, Module, Param, Port, Status, Table
from shpy.ir.tabledata import TableData
from shpy.ir.types import Base, vec

F, F2, I, I2 = vec("f"), vec("f", 2), vec("i"), vec("i", 2)  # noqa: E741


def module_of(b, params=(), tables=()):
    function = b.finish()
    inputs = tuple(Port(v.name, "any") for v in function.inputs)
    return Module(b.name, inputs, tuple(Port(v.name, "any") for v in function.outputs), params, tables, (function,))


def run(module, count, inputs, outputs, params=None, tables=None, tile=4, shape=None, options=Options()):  # noqa: B008
    executable = NumpyBackend().compile(module, options, tile=tile)
    return executable.run(Call(shape or (count,), tuple(inputs), tuple(outputs), params or {}, tables or {}))


def doubled(type=F):
    b = Builder("doubled")
    x = b.input(type, "x")
    b.store(b.output(type, "y"), b.let("add", x, x))
    return module_of(b)


@pytest.mark.parametrize("count", [0, 1, 3, 4, 5, 13])
def test_any_number_of_elements(count):
    x, y = np.arange(count, dtype=np.float32), np.zeros(count, np.float32)
    assert run(doubled(), count, [x], [y]) is None
    np.testing.assert_array_equal(y, 2 * x)


def test_an_input_may_be_the_same_for_all():
    y = np.zeros((6, 2), np.float32)
    run(doubled(F2), 6, [np.float32([[1, 2]])], [y])
    np.testing.assert_array_equal(y, np.full((6, 2), [2, 4]))


def test_an_output_may_be_an_input():
    b = Builder("turned")
    v = b.input(F2, "v")
    b.store(b.output(F2, "left"), b.swizzle(v, [1, 0]))
    b.store(b.output(F2, "right"), v)
    data = np.arange(20, dtype=np.float32).reshape(10, 2)
    before, other = data.copy(), np.zeros((10, 2), np.float32)
    run(module_of(b), 10, [data], [data, other])
    np.testing.assert_array_equal(data, before[:, ::-1])
    np.testing.assert_array_equal(other, before)


@pytest.mark.parametrize("count", [3, 10])
def test_two_outputs_may_exchange_their_inputs(count):
    b = Builder("exchanged")
    x, y = b.input(F, "x"), b.input(F, "y")
    b.store(b.output(F, "first"), y)
    b.store(b.output(F, "second"), x)
    x, y = np.arange(count, dtype=np.float32), np.full(count, 7, np.float32)
    run(module_of(b), count, [x, y], [x, y])
    np.testing.assert_array_equal(x, np.full(count, 7))
    np.testing.assert_array_equal(y, np.arange(count))


def test_a_discarded_element_keeps_what_the_output_held():
    b = Builder("positive")
    x, y = b.input(F, "x"), b.output(F2, "y")
    with b.when(b.let("lt", x, b.const(F, [0]))):
        b.exit(Discard)
    b.store(y, b.splat(x, 2))
    x, y = np.float32([1, -1, 2, -2, 3]), np.full((5, 2), 9, np.float32)
    status = run(module_of(b), 5, [x], [y])
    assert status.dtype == np.int32
    assert status.tolist() == [Status.WRITTEN, Status.DISCARDED, Status.WRITTEN, Status.DISCARDED, Status.WRITTEN]
    np.testing.assert_array_equal(y[:, 1], [1, 9, 2, 9, 3])


def endless():
    b = Builder("endless")
    x = b.input(F, "x")
    y = b.variable(F, name="y")
    b.store(y, x)
    with b.loop(loc=Loc("endless.py", 3)) as loop:
        b.store(y, b.let("sub", b.load(y), b.const(F, [1])))
        loop.until(b.let("eq", b.load(y), b.const(F, [0])))
    b.store(b.output(F, "z"), b.load(y))
    return module_of(b)


def test_a_loop_over_its_budget_ends_its_element_and_no_other():
    x, z = np.float32([3, 0.5, 100, 101]), np.full(4, 7, np.float32)
    executable = NumpyBackend().compile(endless(), Options(loop_limit=100))
    status = executable.run(Call((4,), (x,), (z,), {}, {}))
    first = Status.FIRST_LOOP
    assert status.tolist() == [Status.WRITTEN, first, Status.WRITTEN, first]
    assert executable.loops == (Loc("endless.py", 3),)
    np.testing.assert_array_equal(z, [0, 7, 0, 7])


def test_a_table_is_read_again_when_its_version_changes():
    b = Builder("look")
    i = b.input(I, "i")
    b.store(b.output(F2, "found"), b.let("table", i, type=F2, attr="colours"))
    executable = NumpyBackend().compile(module_of(b, tables=(Table("colours", F2, 1),)), Options())
    data = TableData(np.float32([[1, 2], [3, 4]]))
    found = np.zeros((3, 2), np.float32)
    call = Call((3,), (np.int32([-1, 1, 5]),), (found,), {}, {"colours": data})
    executable.run(call)
    assert found.tolist() == [[1, 2], [3, 4], [3, 4]]
    data.array = np.zeros_like(data.array)
    executable.run(call)
    assert found.tolist() == [[1, 2], [3, 4], [3, 4]], "no new version, no new copy"
    data.version += 1
    executable.run(call)
    assert found.tolist() == [[0, 0]] * 3


def test_params_and_the_grid():
    b = Builder("where")
    index, shape = b.let("grid_index", type=I2), b.let("grid_shape", type=I2)
    scale = b.let("param", type=F2, attr="scale")
    place = b.let("div", b.let("convert", index, type=F2), b.let("convert", shape, type=F2))
    b.store(b.output(F2, "place"), b.let("mul", place, scale))
    place = np.zeros((6, 2), np.float32)
    params = {"scale": np.float32([1, 10])}
    run(module_of(b, params=(Param("scale", "any", F2, (0, 0)),)), 6, [], [place], params, shape=(2, 3))
    expected = [[y / 2, x / 3 * 10] for y in range(2) for x in range(3)]
    np.testing.assert_allclose(place, expected, rtol=1e-6)


@pytest.mark.parametrize(("precision", "dtype"), [("f16", np.float16), ("f32", np.float32), ("f64", np.float64)])
def test_precisions(precision, dtype):
    b = Builder("third")
    x = b.input(F, "x")
    b.store(b.output(F, "y"), b.let("div", b.let("add", x, b.const(F, [0.1])), b.const(F, [3])))
    x, y = np.linspace(-2, 2, 50).astype(dtype), np.zeros(50, dtype)
    run(module_of(b), 50, [x], [y], options=Options(precision=precision))
    np.testing.assert_array_equal(y, (x + dtype(0.1)) / dtype(3))


def test_there_is_one_device():
    (device,) = NumpyBackend().devices()
    assert device.version == np.__version__
    with pytest.raises(BackendUnavailable, match="one device"):
        NumpyBackend().compile(doubled(), Options(device=1))


@pytest.mark.parametrize("rank", [1, 2, 3])
def test_a_gather_clamps_each_axis(rank):
    rng = np.random.default_rng(rank)
    shape = (4, 3, 2)[:rank]
    array = rng.random((*shape, 3)).astype(np.float32)
    index = rng.integers(-3, 6, (rank, 40)).astype(np.int32)
    clamped = tuple(np.clip(index, 0, np.array(shape)[:, None] - 1))
    view = TableView(array, rank)
    given = index[0] if rank == 1 else index
    np.testing.assert_array_equal(view.gather(given), array[clamped].T)
    one = index[0, 5] if rank == 1 else index[:, 5:6]
    np.testing.assert_array_equal(view.at(one)[:, 0], array[clamped][5])
    assert TableView(array[..., 0], rank).gather(given).tolist() == array[clamped][:, 0].tolist()


def test_the_elements_of_a_local_array():
    a = np.zeros((3, 2, 4), np.float32)
    put(a, np.int32([0, 2, 3, -1]), vector(np.float32([1, 2, 3, 4]), np.float32(5)))
    put(a, np.int32([1, 1, 1, 7]), np.float32(9), (1,))
    put(a, np.int32(2), np.float32([[6]]), (0,))
    put(a, np.int32(3), np.float32(8))
    assert a[:, :, 0].tolist() == [[1, 5], [0, 9], [6, 0]]
    assert a[:, :, 1].tolist() == [[0, 0], [0, 9], [6, 5]]
    assert a[:, :, 3].tolist() == [[0, 0], [0, 0], [6, 0]]
    assert pick(a, np.int32([0, 9, -4, 1])).tolist() == [[1, 6, 0, 0], [5, 5, 0, 0]]
    assert pick(a, np.int32(9)).tolist() == a[2].tolist()
    assert pick(np.float32([[1], [2]]), np.int32([5, 0])).tolist() == [2, 1]


def test_what_is_picked_is_a_copy():
    a = np.zeros((2, 3), np.float32)
    picked = pick(a, np.int32(0))
    put(a, np.int32(0), np.float32([1, 1, 1]))
    assert picked.tolist() == [0, 0, 0]


def test_the_largest_index_is_no_negative_one():
    b = Builder("last")
    h = b.input(vec(Base.U), "h")
    array = b.variable(F, 3, "array")
    b.store(array, b.const(F, [5]), index=b.const(I, [0]))
    b.store(array, b.const(F, [7]), index=h)
    b.store(b.output(F, "y"), b.load(array, h))
    y = np.zeros(3, np.float32)
    run(module_of(b), 3, [np.uint32([2**32 - 1, 1, 0])], [y])
    assert y.tolist() == [0, 7, 7]


def test_a_uniform_double_is_no_literal():
    limit = sh.Param(sh.Attrib1f, -2.0, name="limit")

    @sh.program
    def bounded(x: sh.Attrib1f) -> sh.Attrib1f:
        return x + sh.max(0.0, limit) + sh.min(1.5, limit)

    np.testing.assert_array_equal(bounded.compile("numpy", precision="f64")(np.float64([1, 2])), [-1, 0])


@pytest.mark.parametrize("leaving", [np.False_, np.True_, np.array([True, False, True])])
def test_lanes_leave_by_a_mask_that_is_the_same_for_all_or_not(leaving):
    whole, lane, value = np.zeros(5, np.float32), np.array([0, 2, 4]), np.float32([1, 2, 3])
    put_aside(whole, lane, leaving, value)
    expected = np.where(leaving, value, 0)
    assert whole.tolist() == [expected[0], 0, expected[1], 0, expected[2]]
