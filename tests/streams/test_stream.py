"""Streams: data that stays on a device, kernels that run over it, and the errors of whoever misplaces it."""

from __future__ import annotations

import gc
import re
from typing import NamedTuple

import numpy as np
import pytest

import shpy as sh
from shpy.backend.registry import NAMES, backend

every = pytest.mark.parametrize("name", NAMES)


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector3f


class Split(NamedTuple):
    whole: sh.Attrib1i
    rest: sh.Attrib1f


@sh.program
def scale(x: sh.Point3f, by: sh.Attrib1f) -> sh.Point3f:
    return x * by


@sh.program
def split(x: sh.Attrib1f) -> Split:
    n = sh.Attrib1i(sh.floor(x))
    return Split(n, x - n)


@sh.program
def step(r: Ray) -> Ray:
    r.o += r.d
    return r


@sh.program
def positive(x: sh.Attrib1f) -> sh.Attrib1f:
    sh.SH_DISCARD(x <= 0)
    return x * x


@sh.program
def at(i: sh.Attrib1i, of: sh.Table[sh.Attrib3f]) -> sh.Attrib3f:
    return of[i]


@sh.program
def turn(m: sh.Matrix2f, x: sh.Attrib2f) -> sh.Attrib2f:
    return m @ x


@sh.program
def transpose(m: sh.Matrix2f) -> sh.Matrix2f:
    return sh.transpose(m)


@sh.program
def place(x: sh.Attrib1f) -> sh.Attrib2i:
    return sh.grid_index(2)


@sh.program
def twice_halves(x: sh.Attrib3h) -> sh.Attrib3h:
    return x + x


def points(count=1000, seed=0):
    return np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32)


@every
@pytest.mark.parametrize("count", [0, 1, 2, 63, 64, 4095, 4096, 4097, 70_001])
def test_a_run_over_streams_gives_the_same_as_one_over_arrays(name, count):
    x = points(count)
    y = scale(sh.Stream(x, sh.Point3f, name), 3.0)
    assert isinstance(y, sh.Stream)
    assert (y.shape, y.type, y.backend, len(y)) == ((count,), sh.Point3f, name, count)
    assert np.array_equal(np.asarray(y), scale(x, 3.0))


@pytest.mark.sampled(3)
@every
def test_structs_tuples_and_matrices(name):
    o, d = points(50), points(50, 1)
    moved = step(sh.Stream({"o": o, "d": d}, Ray, name))
    assert isinstance(moved, sh.Stream)
    assert np.array_equal(moved.numpy().o, o + d)
    assert np.array_equal(moved[3:7].d, d[3:7])
    parts = split(sh.Stream([1.25, -2.5], sh.Attrib1f, name))
    assert type(parts) is Split
    assert parts.whole.numpy().tolist() == [1, -3]
    assert parts.rest.numpy().tolist() == [0.25, 0.5]
    m = np.arange(12, dtype=np.float32).reshape(3, 2, 2)
    matrices = sh.Stream(m, sh.Matrix2f, name)
    assert np.array_equal(transpose(matrices).numpy(), m.transpose(0, 2, 1))
    assert np.array_equal(turn(matrices, np.float32([1, 2])).numpy(), m @ np.float32([1, 2]))


@every
def test_fields_of_a_struct_may_be_streams_of_their_own(name):
    o, d = sh.Stream(points(9), sh.Point3f, name), sh.Stream(points(9, 1), sh.Vector3f, name)
    assert np.array_equal(step({"o": o, "d": d}).numpy().o, o.numpy() + d.numpy())


@pytest.mark.sampled(2)
@every
@pytest.mark.parametrize(
    ("type_", "dtype"),
    [(sh.Attrib1i, np.int32), (sh.Attrib3u, np.uint32), (sh.Attrib1b, np.bool_), (sh.Attrib3b, np.bool_)],
)
def test_ints_and_bools_stay_as_they_are(name, type_, dtype):
    shape = (5, 7, type_.size) if type_.size > 1 else (5, 7)
    x = np.random.default_rng(2).integers(0, 2**31, shape) % (2 if dtype == np.bool_ else 2**31)
    stream = sh.Stream(x.astype(dtype), type_, name)
    assert stream.numpy().dtype == dtype
    assert np.array_equal(stream.numpy(), x.astype(dtype))
    assert np.array_equal(stream.copy().to("numpy").numpy(), x.astype(dtype))


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("name", "precision"), [("numpy", "f64"), ("opencl", "f64"), *((n, "f16") for n in NAMES)])
def test_other_precisions(name, precision):
    x = points(100)
    y = scale(sh.Stream(x, sh.Point3f, name, precision=precision), 0.1)
    expected = scale.compile("numpy", precision=precision)(x, 0.1)
    assert y.numpy().dtype == expected.dtype
    assert np.array_equal(y.numpy(), expected)


@pytest.mark.sampled(3)
@every
def test_halves_lie_on_every_device(name):
    x = np.float16([0, -0.0, 1.5, 2.0**-24, 30000, np.inf, np.nan]).repeat(3).reshape(7, 3)
    stream = sh.Stream(x, sh.Attrib3h, name)
    assert stream.numpy().tobytes() == x.tobytes()
    assert twice_halves(stream).numpy().tobytes() == (x * np.float16(2)).tobytes()
    assert sh.sequence(twice_halves).run(x=x, backend=name).streams["x"].numpy().dtype == np.float16
    assert not sh.Stream.empty(4, sh.Attrib1h, name).numpy().any()


@pytest.mark.sampled(3)
@every
def test_discarded_elements_keep_what_out_held(name):
    x = points(300)[:, 0]
    kernel, stream = positive.compile(name), sh.Stream(x, sh.Attrib1f, name)
    result = kernel.run(stream)
    assert result.count == np.count_nonzero(x > 0)
    assert np.array_equal(result.written.numpy(), x > 0)
    assert np.array_equal(result.outputs.numpy(), np.where(x > 0, x * x, 0))
    out = sh.Stream(np.full(300, 7), sh.Attrib1f, name)
    assert kernel.run(stream, out=out).outputs is out
    assert np.array_equal(out.numpy(), np.where(x > 0, x * x, np.float32(7)))
    kernel.run(stream, out=stream)
    assert np.array_equal(stream.numpy(), np.where(x > 0, x * x, x))


@every
def test_a_run_without_inputs_writes_a_stream(name):
    @sh.program
    def index() -> sh.Attrib1i:
        return sh.grid_index(1)

    out = sh.Stream.empty(5000, sh.Attrib1i, name)
    index.compile(name).run(out=out)
    assert np.array_equal(out.numpy(), np.arange(5000))


@every
def test_the_place_in_the_grid_is_that_of_the_stream(name):
    out = place(sh.Stream(np.zeros((37, 130)), sh.Attrib1f, name)).numpy()
    assert np.array_equal(out, np.stack(np.indices((37, 130)), axis=-1))


@pytest.mark.sampled(3)
@every
def test_a_table_reads_a_stream_where_it_is(name):
    x, i = points(), np.arange(-3, 1005)
    stream = sh.Stream(x, sh.Attrib3f, name)
    table = sh.Table(stream)
    assert np.array_equal(at(i, table).numpy(), x[np.clip(i, 0, 999)])
    stream.update(2 * x)
    assert np.array_equal(at(i, table).numpy(), 2 * x[np.clip(i, 0, 999)])
    scale.compile(name).run(stream, 5.0, out=stream)
    assert np.array_equal(at(i, table).numpy(), 10 * x[np.clip(i, 0, 999)])


@pytest.mark.sampled(3)
@every
def test_a_table_of_structs_and_a_texture_over_streams(name):
    rays = sh.Table(sh.Stream({"o": points(20), "d": points(20, 1)}, Ray, name))
    image = sh.Texture2D(sh.Stream(points(12).reshape(3, 4, 3), sh.Color3f, name))

    @sh.program
    def look(i: sh.Attrib1i) -> tuple[sh.Vector3f, sh.Color3f]:
        return rays[i].d, image(sh.Attrib2f(0.375, 0.5))

    d, c = look(np.arange(20))
    assert np.array_equal(d.numpy(), points(20, 1))
    assert np.array_equal(c.numpy()[7], points(12).reshape(3, 4, 3)[1, 1])


@every
def test_a_loop_beyond_its_limit_is_an_error(name):
    @sh.program
    def down(n: sh.Attrib1i) -> sh.Attrib1i:
        with sh.SH_WHILE(lambda: n != 0):
            n -= 1
        return n

    with pytest.raises(sh.LoopLimitExceeded, match="more than 10 iterations in 2 elements") as caught:
        down.compile(name, loop_limit=10)(sh.Stream([3, 40, 5, 60], sh.Attrib1i, name))
    assert caught.value.result.count == 2
    assert caught.value.result.written.numpy().tolist() == [True, False, True, False]


def test_libraries_share_their_memory():
    x = points(6)
    stream = sh.Stream.wrap(x)
    scale.compile("numpy").run(stream, 2.0, out=stream)
    assert np.array_equal(x, 2 * points(6))
    assert np.shares_memory(np.from_dlpack(stream), x)
    native = sh.Stream(x, sh.Point3f, "opencl").native()
    assert np.array_equal(native.get(), x)
    wrapped = sh.Stream.wrap(native + 1)
    assert wrapped.type is sh.Attrib3f
    positive_part = scale.compile("opencl").run(wrapped, 2.0, out=wrapped).outputs
    assert np.array_equal(positive_part.numpy(), 2 * (x + 1))


def test_memory_of_another_dtype_is_not_shared():
    for dtype in (np.int64, np.uint8, ">f4"):
        with refused("shares a contiguous, writeable"):
            sh.Stream.wrap(np.zeros(4, dtype))
    read_only = np.zeros(4, np.float32)
    read_only.flags.writeable = False
    with refused("a stream of f shares a contiguous, writeable float32 array, not this read-only float32 array"):
        sh.Stream.wrap(read_only)
    with refused("a stream of i shares a contiguous pyopencl array of int32, not int64"):
        sh.Stream.wrap(sh.Stream([1], sh.Attrib1i, "opencl").native().astype(np.int64))
    assert sh.Stream.wrap(np.zeros(4, np.float16)).precision == "f16"
    parts = sh.Stream(np.arange(10.0), sh.Attrib1f, "opencl").native()
    for part in (parts[2:6], parts[::2], parts.reshape(2, 5).T):
        with refused("a stream shares a whole buffer, and this pyopencl array is a part of one, or transposed"):
            sh.Stream.wrap(part)
    assert sh.Stream.wrap(parts)[::2].tolist() == [0, 2, 4, 6, 8]  # the cure
    with refused("the array is a masked array, and a kernel runs over every element"):
        sh.Stream.wrap(np.ma.array(np.zeros(2, np.float32), mask=[False, True]))
    with refused("ndarray is memory of numpy, which opencl cannot share"):
        sh.Stream.wrap(np.zeros(4, np.float32), sh.Attrib1f, "opencl")


@pytest.mark.parametrize(("type_", "dtype"), [(sh.Attrib1d, np.float64), (sh.Attrib1h, np.float16)])
def test_doubles_and_halves_are_shared_at_the_working_precision(type_, dtype):
    x = np.ones(4, dtype)
    stream = sh.Stream.wrap(x, type_)
    assert stream.place == sh.Stream(x, type_, "numpy").place
    stream.update(x * 2)
    assert x.tolist() == [2] * 4


@pytest.mark.parametrize("type_", [sh.Matrix2f, Ray])
def test_several_leaves_do_not_share_one_array(type_):
    with refused(f"one array or texture is the memory of scalars or vectors, and {type_.__name__} has several leaves"):
        sh.Stream.wrap(np.zeros((4, 2, 2), np.float32), type_)


def test_arrays_of_f64_on_a_device_are_shared():
    native = sh.Stream([1.0, 0.1], sh.Attrib1f, "opencl", precision="f64").native()
    wrapped = sh.Stream.wrap(native)
    assert (wrapped.precision, wrapped.numpy().tolist()) == ("f64", [1.0, 0.1])


def test_a_texture_of_any_width_can_be_wrapped():
    image = points(600)[:, :2].reshape(20, 30, 2).copy()
    context = sh.Stream(0.0, sh.Attrib1f, "glsl").native().ctx
    space = backend("glsl").space(0)
    texture = space.call(lambda: context.texture((30, 20), 2, image.tobytes(), dtype="f4"))
    stream = sh.Stream.wrap(texture)
    assert stream.shape == (20, 30)

    @sh.program
    def twice(x: sh.Attrib2f) -> sh.Attrib2f:
        return 2 * x

    twice.compile("glsl").run(stream, out=stream)
    read = np.frombuffer(space.call(texture.read), np.float32)
    assert np.array_equal(read.reshape(image.shape), 2 * image)


def refused(message):
    return pytest.raises(sh.ShpyTypeError, match=re.escape(message))


@pytest.mark.parametrize(
    ("shape", "type_", "fitted"),
    [((3, 100), sh.Attrib3f, (100, 3)), (12, sh.Attrib3f, (4, 3)), (18, sh.Matrix3f, (2, 3, 3))],
)
def test_the_cure_for_another_last_axis_is_an_expression_that_fits(shape, type_, fitted):
    array = m = np.zeros(shape)
    with refused(f"takes an array (*S, {', '.join(map(str, fitted[1:]))})") as caught:
        sh.Stream(array, type_, "numpy")
    assert eval(caught.value.cure, {"array": array, "m": m, "np": np}).shape == fitted


def test_no_cure_reshapes_numbers_that_do_not_fill_matrices():
    with refused("takes an array (*S, 3, 3), not (5, 3, 2)") as caught:
        sh.Stream(np.zeros((5, 3, 2)), sh.Matrix3f, "numpy")
    assert caught.value.cure == "an array whose last two axes have 3 components each"


@pytest.mark.parametrize(
    "call",
    [
        lambda: sh.Stream([1.0], sh.Attrib1d, "glsl"),
        lambda: sh.Stream.empty(3, sh.Attrib1f, "glsl", precision="f64"),
        lambda: sh.Stream([1.0], sh.Attrib1f, "numpy", precision="f64").to("glsl"),
        lambda: sh.Stream.empty(2**50, sh.Attrib1f, "opencl"),
        lambda: sh.Stream.wrap(np.zeros(3)[::2]),
    ],
)
def test_errors_of_a_device_name_the_users_line(call):
    with pytest.raises(sh.ShpyError) as caught:
        call()
    assert str(caught.value).startswith(f"{__file__}:{call.__code__.co_firstlineno}: ")


def test_errors_name_the_cure():
    stream = sh.Stream(points(4), sh.Point3f, "opencl")
    with refused("scale is compiled for numpy, and <Stream (4,) of Point3f on opencl> is not there") as caught:
        scale.compile("numpy")(stream, 1.0)
    assert caught.value.cure == "stream.to('numpy')"
    with refused("scale is compiled for opencl, f64, and") as caught:
        scale.compile("opencl", precision="f64")(stream, 1.0)
    assert caught.value.cure == 'sh.Stream(stream.numpy(), sh.Point3f, "opencl", precision="f64")'
    with refused("mask is <Stream (4,) of Attrib1b on opencl, f64>") as caught:
        sh.compact(stream, sh.Stream([True] * 4, sh.Attrib1b, "opencl", precision="f64"))
    assert caught.value.cure == 'sh.Stream(stream.numpy(), sh.Attrib1b, "opencl", precision="f32")'
    with refused("x is a Point3f, f3, and <Stream (2,) of Attrib2f on opencl> holds f2"):
        scale(sh.Stream(np.zeros((2, 2)), sh.Attrib2f, "opencl"), 1.0)
    with refused("the element shapes do not broadcast: x (4,), by (4, 3)"):
        scale(stream, np.zeros((4, 3)))
    with refused("update of a stream keeps its shape: (4,), not (5,)"):
        stream.update(points(5))
    with refused("out is an array and other data of this run are streams"):
        scale.compile("opencl").run(stream, 1.0, out=np.zeros((4, 3), np.float32))
    with refused("out is <Stream (5,) of Point3f on opencl>, not of sh.Point3f and the shape (4,)"):
        scale.compile("opencl").run(stream, 1.0, out=sh.Stream.empty(5, sh.Point3f, "opencl"))
    with refused("out is memory that the Table of reads"):
        at.compile("opencl").run(np.arange(4), sh.Table(stream, name="of"), out=stream)
    with refused("two outputs have the same memory, and each needs its own"):
        both = sh.Stream.empty(2, sh.Attrib1i, "opencl")

        @sh.program
        def twins(n: sh.Attrib1i) -> tuple[sh.Attrib1i, sh.Attrib1i]:
            return n, n + 1

        twins.compile("opencl").run(both, out=(both, both))
    with refused("a stream of Ray is several arrays"):
        np.asarray(sh.Stream.empty(2, Ray))
    with refused("backend='cuda'"):
        sh.Stream([1], sh.Attrib1f, "cuda")
    with refused("a stream takes floats, not bool"):
        sh.Stream([True], sh.Attrib1f)
    with refused("a stream is neither true nor false"):
        bool(stream)
    for other in (2, 2.0, np.float32(2), np.zeros(4)):
        with refused("a stream is not compared element by element"):
            _ = stream == other
        with refused("a stream is not compared element by element"):
            _ = stream != other
    assert stream != sh.Stream([1.0], sh.Attrib1f, stream.backend)
    assert stream in {stream: 1}
    with refused("the fields of a stream have one shape, not o (4,), d (5,)"):
        sh.Stream({"o": points(4), "d": points(5)}, Ray)
    with refused("a Table cannot be empty"):
        sh.Table(sh.Stream.empty(0, sh.Attrib1f))


@pytest.mark.sampled(3)
@every
def test_dropped_streams_give_their_memory_back(name):
    space = backend(name).space(None)
    x = points(10_000)
    kernel = scale.compile(name)
    for _ in range(3):
        kernel(sh.Stream(x, sh.Point3f, name), 2.0)
    gc.collect()
    before = pooled(name, space)
    for _ in range(300):
        kernel(sh.Stream(x, sh.Point3f, name), 2.0)
    gc.collect()
    assert pooled(name, space) <= before + 4


def pooled(name, space):
    """Return the number of buffers or textures that a device holds."""
    return {"opencl": lambda: len(space.machine.pool), "glsl": lambda: len(space._store.pool)}.get(name, int)()


@every
@pytest.mark.parametrize("type_", [sh.Attrib1f, sh.Point3f, sh.Attrib1b, sh.Attrib2i])
def test_an_index_or_a_slice_reads_its_rows_alone(name, type_, monkeypatch):
    size = type_.size
    tail = (size,) if size > 1 else ()
    dtype = {"f": np.float32, "i": np.int32, "b": np.bool_}[type_.base.value]
    lots = np.random.default_rng(3).integers(0, 2, (5, 3001, *tail)).astype(dtype)
    for array in (lots, lots.reshape(-1, *tail), lots[:, :1], lots[:0], lots[0, 0]):
        stream = sh.Stream(array, type_, backend=name)
        extents = stream.shape
        keys = [..., (), None]
        if extents:
            n = extents[0]
            keys += [slice(None), slice(1, 3), slice(-2, None), slice(3, 1), slice(n - 1, n + 9), slice(0, n, 2)]
            keys += [0, -1, n // 2, np.int64(n // 3)] if n else []
        for key in keys:
            wanted, found = array[key], stream[key]
            assert type(found) is type(wanted), key
            assert found.shape == wanted.shape, key
            assert found.dtype == wanted.dtype, key
            assert np.array_equal(found, wanted), key
    stream = sh.Stream(lots, type_, backend=name)
    memory = type(stream.leaf_entries()[0].memory)
    read, asked = memory.read, []
    monkeypatch.setattr(memory, "read", lambda self, *rows: asked.append(rows) or read(self, *rows))
    assert np.array_equal(stream[2:4], lots[2:4])
    assert asked == [(2 * 3001, 4 * 3001)]
    with pytest.raises(IndexError):
        stream[5]


@every
def test_functions_of_numpy_take_the_elements_and_store_none(name):
    x = sh.Stream(np.float32([[1, 2], [3, 5]]), sh.Attrib1f, backend=name)
    assert np.sum(x) == 11
    assert np.mean(x) == 2.75
    assert np.max(x, axis=0).tolist() == [3, 5]
    assert np.concatenate([x, x], axis=1).shape == (2, 4)
    with pytest.raises(ValueError, match="read-only"):
        np.copyto(x, 0)
    assert np.any(x, axis=1).tolist() == [True, True]
