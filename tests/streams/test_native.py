"""Memory that streams share with other libraries: how long it stays, who may use it, and what overlaps."""

from __future__ import annotations

import gc
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyopencl.array
import pytest

import shpy as sh
from shpy.backend.registry import NAMES, backend

every = pytest.mark.parametrize("name", NAMES)


@sh.program
def double(x: sh.Attrib1f) -> sh.Attrib1f:
    return 2 * x


@sh.program
def both(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f]:
    return x + 1, x + 2


@sh.program
def third(of: sh.Table[sh.Attrib1f]) -> sh.Attrib1f:
    return of[3]


@sh.program
def third_of_first(of: sh.Table[sh.Attrib1f, 2]) -> sh.Attrib1f:
    return of[0, 3]


@sh.program
def scaled(x: sh.Attrib1f, by: sh.Attrib1f) -> sh.Attrib1f:
    return x * by


@sh.program
def kept(x: sh.Attrib1f) -> sh.Attrib1f:
    sh.SH_DISCARD(x > 2)
    return x + 10


def refused(message):
    return pytest.raises(sh.ShpyTypeError, match=re.escape(message))


def numbers(count=1000):
    return np.arange(count, dtype=np.float32)


def held(native):
    """The numbers in an array or texture, whichever library it is of."""
    if isinstance(native, np.ndarray):
        return native.copy()
    if isinstance(native, pyopencl.array.Array):
        return native.get()
    if isinstance(native, pyopencl.Buffer):
        found = np.empty(native.size // 4, np.float32)
        queue = sh.Stream([0], sh.Attrib1f, "opencl").native().queue
        pyopencl.enqueue_copy(queue, found, native)
        return found
    like = sh.Stream(0.0, sh.Attrib1f, "glsl")
    return np.frombuffer(like.on_device(lambda _: native.read()), np.float32)


def used_again(name):
    """Make and run over many streams, which take whatever memory is free."""
    for fill in (-1.0, -2.0):
        filled = [sh.Stream(np.full(1000, fill), sh.Attrib1f, name) for _ in range(4)]
        for stream in filled:
            double.compile(name)(stream)


# How long it stays


@pytest.mark.sampled(4)
@every
@pytest.mark.parametrize("part", ["result", "replaced", "wrapped again", "copy"])
def test_memory_of_native_stays_as_long_as_somebody_holds_it(name, part):
    gc.collect()
    stream = sh.Stream(numbers(), sh.Attrib1f, name)
    if part == "result":
        native = double.compile(name)(stream).native()
    elif part == "replaced":
        native = stream.native()
        kept.compile(name).run(stream, out=stream)
    elif part == "wrapped again":
        native = sh.Stream.wrap(stream.copy().native())
        native = native.native()
    else:
        native = stream.copy().native()
    del stream
    gc.collect()
    before = held(native)
    used_again(name)
    assert np.array_equal(held(native), before, equal_nan=True)


def test_a_part_of_a_buffer_keeps_the_whole():
    buffer = sh.Stream(numbers(), sh.Attrib1f, "opencl").native()[500:600].base_data
    part = sh.Stream(numbers(), sh.Attrib1f, "opencl").native().base_data[1024:2048]
    gc.collect()
    before = held(buffer), held(part)
    used_again("opencl")
    assert np.array_equal(held(buffer), before[0], equal_nan=True)
    assert np.array_equal(held(part), before[1], equal_nan=True)


def test_textures_that_nobody_holds_are_released():
    like = sh.Stream(0.0, sh.Attrib1f, "glsl")
    texture = sh.Stream(numbers(), sh.Attrib1f, "glsl").native()
    of_gl, doomed = like.on_device(lambda _, texture=texture: texture.mglo), backend("glsl").space(0)._context.doomed
    gc.collect()
    assert of_gl not in doomed
    del texture
    assert of_gl in doomed
    like.numpy()  # the next job releases it
    assert doomed == []


# Who may use it


def test_a_texture_refuses_other_threads():
    stream = sh.Stream(numbers(), sh.Attrib1f, "glsl")
    texture = stream.native()
    assert (texture.size, texture.components, texture.dtype) == ((1024, 1), 1, "f4")
    for use in (texture.read, texture.use, lambda: texture.write(b""), texture.build_mipmaps, texture.release):
        with refused("a texture of a stream belongs to the thread of shpy's GL context") as caught:
            use()
        assert caught.value.cure == "stream.on_device(lambda texture: texture.read())"
    read = np.frombuffer(stream.on_device(lambda texture: texture.read()), np.float32)
    assert np.array_equal(read[:1000], numbers(), equal_nan=True)


@every
def test_on_device_calls_a_function_with_what_native_gives(name):
    stream = sh.Stream(numbers(), sh.Attrib1f, name)
    assert stream.on_device(lambda native: native is not None) is True
    with pytest.raises(ZeroDivisionError):
        stream.on_device(lambda native: 1 / 0)
    many = sh.Stream(np.zeros((2, 2, 2)), sh.Matrix2f, name)
    assert many.on_device(lambda *natives: len(natives)) == len(many.native())


def test_gl_is_settled_after_a_function_of_a_user():
    stream = sh.Stream(numbers(), sh.Attrib1f, "glsl")

    def disturb(texture):
        gl = texture.ctx
        gl.enable(gl.BLEND | gl.DEPTH_TEST)
        framebuffer = gl.framebuffer([gl.texture((4, 4), 4)])
        framebuffer.use()
        framebuffer.release()

    stream.on_device(disturb)
    assert np.array_equal(double.compile("glsl")(stream).numpy(), 2 * numbers(), equal_nan=True)
    assert np.array_equal(double.compile("glsl")(numbers()), 2 * numbers(), equal_nan=True)


# What overlaps


def twins(name):
    """Two streams over the same memory."""
    native = sh.Stream(numbers(), sh.Attrib1f, name).native()
    return sh.Stream.wrap(native), sh.Stream.wrap(native)


def parts(name, *ranges):
    """Return streams over ranges of elements of the same memory; each begins at a multiple of 64."""
    if name == "numpy":
        whole = numbers()
        return [sh.Stream.wrap(whole[begin:end]) for begin, end in ranges]
    native = sh.Stream(numbers(), sh.Attrib1f, name).native()
    held = [(native.base_data[4 * begin : 4 * end], end - begin) for begin, end in ranges]
    return [sh.Stream.wrap(pyopencl.array.Array(native.queue, size, np.float32, data=part)) for part, size in held]


@every
def test_two_outputs_over_the_same_memory_are_refused(name):
    one, other = twins(name)
    with refused("two outputs have the same memory, and each needs its own"):
        both.compile(name).run(sh.Stream(one.numpy(), sh.Attrib1f, name), out=(one, other))


@every
def test_a_table_over_the_memory_of_out_is_refused(name):
    one, other = twins(name)
    with refused("out is memory that the Table of reads"):
        {1: third, 2: third_of_first}[len(one.shape)].compile(name).run(sh.Table(one, name="of"), out=other)
    stream = sh.Stream(numbers(), sh.Attrib1f, name)
    with refused("out is memory that the Table of reads"):
        third.compile(name).run(sh.Table(stream, name="of"), out=sh.Stream.wrap(stream.native()))


@every
def test_an_input_may_be_the_memory_of_out(name):
    one, other = twins(name)
    wanted = 2 * one.numpy()
    double.compile(name).run(one, out=other)
    assert np.array_equal(one.numpy(), wanted, equal_nan=True)


@pytest.mark.parametrize("name", ["numpy", "opencl"])
@pytest.mark.parametrize("order", [0, 1])
def test_an_input_may_overlap_out(name, order):
    pair = parts(name, (0, 900), (64, 964))
    read, out = pair[order], pair[1 - order]
    wanted = 2 * read.numpy()
    double.compile(name).run(read, out=out)
    assert np.array_equal(out.numpy(), wanted, equal_nan=True)
    with refused("two outputs have the same memory"):
        both.compile(name).run(sh.Stream(wanted, sh.Attrib1f, name), out=pair)
    with refused("out is memory that the Table of reads"):
        third.compile(name).run(sh.Table(read, name="of"), out=out)


@pytest.mark.parametrize("name", ["numpy", "opencl"])
@pytest.mark.parametrize("apart", [0, 64])
def test_parts_of_one_memory_that_do_not_overlap_are_memories_of_their_own(name, apart):
    low, high, read = parts(name, (0, 256), (256 + apart, 512 + apart), (704, 960))
    wanted = read.numpy()
    both.compile(name).run(read, out=(low, high))
    assert np.array_equal(low.numpy(), wanted + 1)
    assert np.array_equal(high.numpy(), wanted + 2)
    third.compile(name).run(sh.Table(low, name="of"), out=high)
    assert (high.numpy() == wanted[3] + 1).all()


@pytest.mark.parametrize("name", ["numpy"])
def test_a_number_for_all_elements_may_lie_in_out(name):
    whole = numbers() + 2
    by = sh.Stream.wrap(whole[:1])
    scaled.compile(name).run(sh.Stream(numbers(), sh.Attrib1f, name), by, out=sh.Stream.wrap(whole))
    assert np.array_equal(whole, 2 * numbers(), equal_nan=True)


@every
def test_a_scatter_may_write_the_memory_of_its_values_and_indices(name):
    one, other = twins(name)
    given = one.numpy()
    sh.scatter(one, np.arange(one.size)[::-1].reshape(one.shape), out=other)
    assert np.array_equal(other.numpy().ravel(), given.ravel()[::-1], equal_nan=True)


# What can be wrapped


@pytest.mark.parametrize("dtype", [np.complex64, object, "U3", "M8[s]", [("x", np.float32)]])
def test_arrays_of_other_things_are_refused(dtype):
    with refused("no type has elements of ") as caught:
        sh.Stream.wrap(np.zeros(4, dtype))
    assert caught.value.cure.startswith("an array of float32")


DEVICES = """
import numpy as np
import shpy as sh

assert len(sh.backends()[1].devices) == 2
for device in (0, 1):
    stream = sh.Stream(np.arange(4.0), sh.Attrib1f, "opencl", device=device)
    shared = sh.Stream.wrap(stream.native())
    stream.update(np.arange(4.0) + 1)
    assert (shared.device, shared.numpy().tolist(), shared.sum()) == (device, [1, 2, 3, 4], 10)
"""


def test_an_array_of_any_device_is_shared_where_it_lies():
    environment = os.environ | {"POCL_DEVICES": "pthread pthread", "PYTHONPATH": str(Path(sh.__file__).parents[1])}
    ran = subprocess.run([sys.executable, "-c", DEVICES], env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
