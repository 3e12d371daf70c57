"""Host arguments: any array that numpy can make means its numbers, anything else is a clear error."""

import math
import re

import numpy as np
import pytest

import shpy as sh

BACKENDS = ["numpy", "opencl", "glsl"]
gain = sh.Param(sh.Attrib1f, 2, name="gain")
steps = sh.Param(sh.Attrib1i, 3, name="steps")
tint = sh.Param(sh.Color3f, (1, 2, 3), name="tint")
active = sh.Param(sh.Attrib1b, True, name="active")
turn = sh.Param(sh.Matrix3f, np.eye(3), name="turn")
curve = sh.Table(np.arange(4.0), sh.Attrib1f, name="curve")


@sh.program
def work(x: sh.Attrib1f, v: sh.Attrib3f, n: sh.Attrib1i, keep: sh.Attrib1b):
    return v * x + sh.Attrib1f(n), sh.cond(keep, n, -n)


@sh.program
def nothing() -> sh.Attrib1f:
    return sh.Attrib1f(1)


def expected(x, v, n, keep):
    shape = np.broadcast_shapes(x.shape, v.shape[:-1], n.shape, keep.shape)
    number = n.astype(np.float32)
    first = v * x[..., None] + number[..., None]
    return np.broadcast_to(first, (*shape, 3)), np.broadcast_to(np.where(keep, n, -n), shape)


class Wrapped:
    """Has `__array__`, as foreign arrays do."""

    def __init__(self, array):
        self.array = array

    def __array__(self, dtype=None, copy=None):
        return self.array


class Subclass(np.ndarray):
    pass


def scattered(rng, array):
    """The same numbers elsewhere in memory: with any strides, bytes swapped, not aligned, read only."""
    order = rng.permutation(array.ndim)
    inverse = np.argsort(order)
    moved = np.asarray(array).transpose(order)
    steps = [int(rng.choice([1, 1, 2, 3, -1, -2])) for _ in moved.shape]
    room = np.zeros([max(1, n) * abs(s) for n, s in zip(moved.shape, steps, strict=True)], array.dtype)
    if rng.random() < 0.3:
        raw = np.zeros(room.nbytes + 1, np.uint8)
        room = raw[1:].view(array.dtype).reshape(room.shape)
    view = room[(*(slice(None, None, s) for s in steps), ...)][(*(slice(0, n) for n in moved.shape), ...)]
    view[...] = moved
    view = view.transpose(inverse)
    for axis, extent in enumerate(view.shape):
        first = view[(slice(None),) * axis + (slice(0, 1),)]
        if extent > 1 and (view == first).all():
            view = np.broadcast_to(first, view.shape)  # a stride of zero
    if rng.random() < 0.3:
        view = view.astype(view.dtype.newbyteorder(), order="K")
    if rng.random() < 0.3:
        view = view.view()
        view.flags.writeable = False
    return view


def dressed(rng, array):
    """An argument that means `array`."""
    kind = array.dtype.kind
    if kind == "f":
        array = array.astype(rng.choice(["f2", "f4", "f8", "g", "i1", "i8", "u1", "u8"]))
    elif kind == "i":
        array = array.astype(rng.choice(["i1", "i2", "i4", "i8", "u1", "u4", "u8"]))
    forms = (
        lambda: array,
        lambda: array.tolist(),
        lambda: tuple(array.tolist()) if array.ndim else array[()],
        lambda: array.astype(object).tolist() if array.dtype.kind != "g" else array,
        lambda: Wrapped(array),
        lambda: array.view(Subclass),
        lambda: np.ma.masked_array(array),
        lambda: memoryview(array) if array.dtype.kind not in "g" and array.dtype.isnative else array,
    )
    if not isinstance(array, np.ndarray) or array.size == 0:
        return array
    array = scattered(rng, array)
    return forms[rng.integers(len(forms))]()


def some_arguments(rng):
    shape = tuple(rng.integers(0 if rng.random() < 0.1 else 1, 5, rng.integers(0, 4)))
    found = []
    for size, dtype in ((1, "f4"), (3, "f4"), (1, "i4"), (1, "?")):
        own = tuple(1 if rng.random() < 0.2 and len(shape) > 1 else n for n in shape)
        own = own[rng.integers(0, len(shape) + 1) :] if rng.random() < 0.2 else own
        whole = rng.integers(0, 9, own + ((size,) if size > 1 else ()))
        if rng.random() < 0.2 and whole.ndim:
            whole[...] = whole.flat[0] if whole.size else 0
        found.append(whole.astype(dtype))
    return found


def some_outputs(rng, wanted, given):
    """Arrays to write: fresh ones, parts of one block, or the memory of an input."""
    outputs = []
    for values in wanted:
        alike = [a for a in given if isinstance(a, np.ndarray) and a.dtype == values.dtype and a.shape == values.shape]
        alike = [a for a in alike if a.flags.writeable and np.ma.MaskedArray not in type(a).__mro__]
        if alike and rng.random() < 0.5:
            outputs.append(alike[0])
        elif values.ndim and rng.random() < 0.5:
            block = np.full((*values.shape[:-1], 2 * values.shape[-1]), 77, values.dtype)
            outputs.append(block[..., ::-2] if rng.random() < 0.5 else block[..., 1::2])
        else:
            outputs.append(np.full(values.shape, 77, values.dtype))
    return tuple(outputs)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_any_array_means_its_numbers(backend):
    kernel = work.compile(backend)
    for seed in range(100):
        rng = np.random.default_rng(seed)
        clean = some_arguments(rng)
        wanted = expected(*clean)
        given = [dressed(rng, a) for a in clean]
        before = [np.array(a) for a in given]
        for found, want in zip(kernel(*given), wanted, strict=True):
            np.testing.assert_array_equal(found, want, err_msg=f"seed {seed}", strict=True)
        for array, held in zip(given, before, strict=True):
            np.testing.assert_array_equal(np.array(array), held, err_msg=f"seed {seed}: an input has changed")
        out = some_outputs(rng, wanted, given)
        result = kernel.run(*given, out=out)
        for mine, found, want in zip(out, result.outputs, wanted, strict=True):
            assert mine is found
            np.testing.assert_array_equal(mine, want, err_msg=f"seed {seed} into out", strict=True)


REFUSED = {
    "x": [True, np.zeros(3, bool), [True, False]],
    "v": [1.0, [1, 2], np.zeros((3, 4)), np.zeros((2, 3), bool), np.zeros(())],
    "n": [1.5, np.zeros(3), 2**31, -(2**31) - 1, np.uint64(2**63), True],
    "keep": [1, 0.0, np.zeros(3, np.uint8), [1, 0]],
}
ANYTHING = ["x", b"ab", None, 1j, object(), [1, [2]], {1}, {"a": 1}, range, lambda: 0, slice(3), 10**400, [10**400],
            np.zeros(3, "M8[s]"), np.zeros(3, [("a", "f4")]), np.array(["a"]),
            np.ma.masked_array([1, 2], [True, False]), np.zeros(2, object), np.zeros((1,) * 40), np.zeros((1,) * 64),
            Wrapped("x"), Wrapped(None)]  # fmt: skip


def shown(value):
    return repr(value)[:30]


class Unused:
    """Stands for an executable that must not be run."""

    writes_all = True

    def run(self, call):
        raise AssertionError("it was run")


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", REFUSED)
def test_a_wrong_argument_is_named_before_anything_runs(backend, name, monkeypatch):
    kernel = work.compile(backend)
    monkeypatch.setattr(kernel, "_executable", Unused())
    for wrong in REFUSED[name] + ANYTHING:
        given = {"x": 1.0, "v": (1, 2, 3), "n": 1, "keep": True} | {name: wrong}
        with pytest.raises(sh.ShpyError, match=rf"\b{name}\b") as error:
            kernel(**given)
        assert error.value.loc is not None
        assert error.value.cure, shown(wrong)
        assert len(str(error.value)) < 600, shown(wrong)


SHAPES = ["33", b"ab", "x", (2.9,), True, (True,), 1.5, (None,), -1, (-1, 2), (10**30,), (2,) * 33, (1,) * 65, {2: 1},
          range(3), np.array(3), np.array([2.0]), object, [[2]], "", ("3",), np.array([[2]]), 1j]  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES, ids=shown)
def test_a_shape_is_ints(shape, monkeypatch):
    kernel = nothing.compile("numpy")
    monkeypatch.setattr(kernel, "_executable", Unused())
    with pytest.raises(sh.ShpyTypeError, match="shape"):
        kernel(shape=shape)


@pytest.mark.parametrize("backend", BACKENDS)
def test_shapes_that_are_ints(backend):
    kernel = nothing.compile(backend)
    for shape, wanted in ((3, (3,)), ([2, 3], (2, 3)), (np.array([2, 3]), (2, 3)), (np.int8(4), (4,)), (0, (0,))):
        assert kernel(shape=shape).shape == wanted
    assert kernel(shape=()) == kernel() == 1
    assert kernel(shape=(1,) * 31).shape == (1,) * 31
    assert work.compile(backend)(np.ones((1,) * 31), (1, 2, 3), 1, True)[0].shape == (1,) * 31 + (3,)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("shape", [(10**6, 10**6), 10**13, (10**9,) * 4])
def test_too_large_a_shape_names_the_bytes(backend, shape):
    n = math.prod(np.atleast_1d(shape).tolist())
    with pytest.raises(sh.ShpyError, match=f"nothing .* needs {n * 4:,} bytes"):
        nothing.compile(backend)(shape=shape)


def test_inputs_that_broadcast_to_too_large_a_shape():
    with pytest.raises(sh.ShpyError, match=r"work over the shape .* bytes"):
        work.compile("numpy")(np.zeros((1, 10**7)), np.zeros((10**7, 1, 3)), 1, True)


@pytest.mark.parametrize("backend", BACKENDS)
def test_outputs_have_memory_of_their_own(backend, monkeypatch):
    given = (np.arange(4, dtype=np.float32), np.ones(3, np.float32), 1, True)

    @sh.program
    def two(x: sh.Attrib1f):
        return x + 1, x * 2

    kernel = two.compile(backend)
    block, square = np.zeros(8, np.float32), np.zeros((4, 4), np.float32)
    for out in ((block[::2], block[1::2]), (block[:4], block[:3:-1]), (square[0], square.T[2, :])):
        if np.shares_memory(*out):
            continue
        assert [o.tolist() for o in kernel.run(given[0], out=out).outputs] == [[1, 2, 3, 4], [0, 2, 4, 6]]
    monkeypatch.setattr(kernel, "_executable", Unused())
    zero = np.lib.stride_tricks.as_strided(block, (4,), (0,))
    for out in ((block[:4], block[:4]), (block[:4], block[3:7]), (block[:4], block[3::-1]), (square[0], square[:, 2])):
        with pytest.raises(sh.ShpyTypeError, match=r"out\.0 and out\.1 share memory"):
            kernel.run(given[0], out=out)
    for out in ((zero, block[4:]), (block[4:], zero)):
        with pytest.raises(sh.ShpyTypeError, match=r"elements of out\.[01] share memory"):
            kernel.run(given[0], out=out)
    frozen = np.zeros(4, np.float32)
    frozen.flags.writeable = False
    for wrong in (frozen, [0, 0, 0, 0], None, 1.0, "x", np.zeros(4), np.zeros(5, np.float32), np.zeros(4, ">f4")):
        with pytest.raises(sh.ShpyTypeError, match=r"out\.1"):
            kernel.run(given[0], out=(block[:4], wrong))
    for wrong in (1, "x", (block,), block[:2], {}, (block[:4], block[4:], block[4:])):
        with pytest.raises(sh.ShpyTypeError, match="out"):
            kernel.run(given[0], out=wrong)


NUMBERS = [10**400, -(10**400), 10**309, 1e300, "1", b"1", None, (1, 2), (), [[1], [2]], 1j, {1}, object(), np.zeros(5)]


@pytest.mark.parametrize(
    ("param", "type_", "wrong"),
    [
        (gain, sh.Attrib1f, [True, np.True_, *NUMBERS]),
        (steps, sh.Attrib1i, [1.9, True, np.float32(2), 2**31, float("nan"), *NUMBERS]),
        (tint, sh.Color3f, [(1, 2, 3, 4), (1, None, 2), (True, 1, 1), (10**400, 1, 1), np.zeros((3, 1)), "abc",
                *NUMBERS]),
        (active, sh.Attrib1b, [1, 0.5, np.int8(1), *NUMBERS]),
        (turn, sh.Matrix3f, [1.0, np.zeros((2, 2)), np.zeros((4, 3)), np.zeros((3, 4)), np.zeros(9), sh.Matrix2f(),
                np.eye(3) > 0, [[1, 2, 3], [4, 5, 6], [7, 8, 10**400]], [[1, 2, 3], [4, 5, 6], [7, 8, 1e300]],
                [[1, 2], [3]], *NUMBERS]),
    ],
    ids=["gain", "steps", "tint", "active", "turn"],
)  # fmt: skip
def test_a_param_refuses_by_name_and_keeps_its_value(param, type_, wrong):
    held = np.array(param.value)
    name = param._name
    for value in wrong:
        with pytest.raises(sh.ShpyTypeError, match=rf"\b{name}\b") as error:
            param.value = value
        assert error.value.loc is not None
        assert len(str(error.value)) < 600
        np.testing.assert_array_equal(param.value, held)
        with pytest.raises(sh.ShpyTypeError, match=r"\bfresh\b"):
            sh.Param(type_, value, name="fresh")


def test_a_param_takes_what_an_input_takes():
    for value in (1, 1.5, np.float16(1.5), np.int64(1), sh.Attrib1f(1.5), np.array(1.5), float("inf"), [1.5]):
        gain.value = value
        assert gain.value == np.float32(np.asarray(value).reshape(()))
    steps.value = np.uint8(7)
    assert steps.value == 7
    turn.value = [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
    assert turn.value.tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
    turn.value = sh.Matrix3f()
    np.testing.assert_array_equal(turn.value, np.eye(3))


def test_a_table_refuses_by_name_and_keeps_its_data():
    for wrong in [*ANYTHING, 1.0, [], np.zeros((2, 2)), np.zeros(3), np.zeros(4, bool), np.zeros((2, 2, 2, 2))]:
        with pytest.raises(sh.ShpyTypeError, match=r"\bcurve\b"):
            curve.update(wrong)
        np.testing.assert_array_equal(curve.host_array(), np.arange(4))
    with pytest.raises(sh.ShpyTypeError, match=r"\bfresh\b"):
        sh.Table(np.zeros((2, 2, 2, 2)), sh.Attrib1f, name="fresh")


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_table_is_a_copy(dtype):
    array = np.arange(4, dtype=dtype)
    table = sh.Table(array, sh.Attrib1f, name="table")

    @sh.program
    def read(i: sh.Attrib1i) -> sh.Attrib1f:
        return table[i]

    array[:] = 9
    assert read(np.arange(4)).tolist() == [0, 1, 2, 3]
    array[:] = 5
    assert read(np.arange(4)).tolist() == [0, 1, 2, 3]


OPTIONS = {
    "device": ["x", 1.5, True, [], object()],
    "backend": [[], 3, np, b"numpy"],
    "lanes": [[], True, 4.0, "4", None, 3, -1, np.zeros(2)],
    "loop_limit": [[], "x", 0, -1, 1.5, True, 2**31, np.zeros(2)],
    "precision": [[], None, 32, "f8", np.float32],
    "math": [[], None, "exact", 1],
}


@pytest.mark.parametrize("option", OPTIONS)
def test_a_wrong_option_is_named(option):
    for wrong in OPTIONS[option]:
        with pytest.raises(sh.ShpyTypeError, match=f"{option}=") as error:
            work.compile(**{"backend": "numpy"} | {option: wrong})
        assert error.value.loc is not None
        assert error.value.cure


def test_options_of_numpy_are_ints_too():
    assert work.compile("numpy", device=np.int64(0), lanes=np.int8(1), loop_limit=np.uint8(5)) is work.compile(
        "numpy", device=0, lanes=1, loop_limit=5
    )
    with pytest.raises(sh.BackendUnavailable, match="no device 7"):
        work.compile("numpy", device=7)
    with pytest.raises(sh.BackendUnavailable, match="no device -1"):
        work.compile("numpy", device=-1)


@pytest.mark.parametrize("dtype", ["i8", ">i8", "longdouble"])
def test_integers_beyond_binary64_are_rounded_once(dtype):
    ints = [2**54 + 2**30 + 1, -(2**54) - 2**30 - 1, 2**60 + 2**36 + 1, 2**53 + 1]
    once = np.array([2**54 + 2**31, -(2**54) - 2**31, 2**60 + 2**37, 2**53], np.float32)
    array = np.array(ints).astype(dtype)
    if np.finfo(np.longdouble).nmant < 63:  # there are machines without floats that hold such ints: twice, there
        once = array.astype(np.float64).astype(np.float32)
    table = sh.Table(array, sh.Attrib1f, name="table")

    @sh.program
    def both(x: sh.Attrib1f, i: sh.Attrib1i) -> tuple[sh.Attrib1f, sh.Attrib1f]:
        return x, table[i]

    given, held = both(array, np.arange(4))
    np.testing.assert_array_equal(given, once)
    np.testing.assert_array_equal(held, once)
    at_64, _ = both.compile("numpy", precision="f64")(array, np.arange(4))
    np.testing.assert_array_equal(at_64, array.astype(np.float64))


def test_a_longdouble_out_of_range_is_named():
    beyond = np.ldexp(np.longdouble(1), np.finfo(np.longdouble).maxexp - 1)
    with pytest.raises(sh.ShpyTypeError, match=re.escape(f"x holds {beyond!s}, out of the range of floats of")):
        work(np.array([beyond]), 1, 1, True)
