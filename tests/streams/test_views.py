"""A view in another shape is the same memory: what a run, a scatter or an update writes to one is in the other."""

import re

import numpy as np
import pytest

import shpy as sh

on_every_backend = pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])


@sh.struct
class Ball:
    at: sh.Point2f
    mass: sh.Attrib1f


@sh.program
def bump(x: sh.Attrib1f) -> sh.Attrib1f:
    return x + 1


@sh.program
def bump_some(x: sh.Attrib1f) -> sh.Attrib1f:
    sh.SH_DISCARD(x < 5)
    return x * 2


@sh.program
def place() -> sh.Attrib1i:
    i = sh.grid_index(2)
    return 100 * i.x + i.y


@pytest.mark.sampled(3)
@on_every_backend
def test_what_is_written_to_one_is_in_the_other(backend):
    x = np.arange(5000, dtype=np.float32)
    whole = sh.Stream(x, sh.Attrib1f, backend)
    view = whole.reshape(50, 100)
    again = view.reshape((5, 10, 100))
    assert (whole.shape, view.shape, again.shape) == ((5000,), (50, 100), (5, 10, 100))
    for step, program in enumerate((bump, bump_some, bump)):
        written = (view, whole, again)[step]
        program.compile(backend).run(written, out=written)
        x = np.where(x < 5, x, x * 2) if program is bump_some else x + 1
        for stream in (whole, view, again):
            assert stream.numpy().tobytes() == x.tobytes()
    sh.scatter(sh.Stream([7, 8], sh.Attrib1f, backend), [101, 4999], out=view)
    x[[101, 4999]] = 7, 8
    assert whole.numpy().tobytes() == again.numpy().tobytes() == x.tobytes()
    whole.update(-x)
    assert view.numpy().tobytes() == (-x).tobytes()
    masked = np.arange(5000) % 3 == 0
    bump.compile(backend).run(view, out=view, where=masked.reshape(50, 100))
    assert whole.numpy().tobytes() == np.where(masked, -x + 1, -x).tobytes()


@on_every_backend
def test_a_view_outlives_its_stream(backend):
    view = sh.Stream(np.arange(6), sh.Attrib1i, backend).reshape(2, 3)
    others = [sh.Stream(np.full(6, 9), sh.Attrib1i, backend) for _ in range(3)]
    assert view.numpy().tolist() == [[0, 1, 2], [3, 4, 5]]
    assert sum(int(other.sum()) for other in others) == 3 * 54


@pytest.mark.sampled(3)
@on_every_backend
def test_kernels_see_the_shape_of_the_view(backend):
    x = sh.Stream.empty(6, sh.Attrib1i, backend)
    place.compile(backend).run(out=x.reshape(2, 3))
    assert x.numpy().tolist() == [0, 1, 2, 100, 101, 102]
    assert x.reshape(2, 3).sum(axis=0).numpy().tolist() == [100, 102, 104]
    assert sh.Table(x.reshape(3, 2)).shape == (3, 2)


@on_every_backend
def test_structs_and_no_elements(backend):
    at = np.arange(12, dtype=np.float32).reshape(6, 2)
    balls = sh.Stream({"at": at, "mass": at[:, 0]}, Ball, backend).reshape(3, 2)
    assert balls.type is Ball
    assert balls.numpy().at.tolist() == at.reshape(3, 2, 2).tolist()
    assert sh.Stream.empty(0, Ball, backend).reshape(0, 4).shape == (0, 4)


def test_a_chain_writes_no_view_of_what_it_is_given():
    x = sh.Stream(np.zeros(6), sh.Attrib1f, "numpy")
    found = sh.repeat(bump, 3).run(x=x.reshape(2, 3)).streams["x"]
    assert (x.numpy().tolist(), found.numpy().tolist()) == ([0] * 6, [[3] * 3] * 2)


@pytest.mark.parametrize("shape", [(7,), (2, 2), ()])
def test_a_shape_of_other_elements(shape):
    x = sh.Stream(np.zeros(6), sh.Attrib1f, "numpy")
    with pytest.raises(sh.ShpyTypeError, match=re.escape(f"has no view of the shape {shape}")) as error:
        x.reshape(*shape)
    assert "test_views.py" in str(error.value)


PLACES = [("opencl", "f16"), ("opencl", "f32"), ("opencl", "f64"), ("glsl", "f16"), ("glsl", "f32")]


@pytest.mark.parametrize(("source", "precision"), PLACES)
@pytest.mark.parametrize("kind", [sh.Attrib1f, sh.Attrib3f, sh.Attrib2b, sh.Attrib1u], ids=lambda kind: kind.__name__)
def test_a_stream_that_moved_to_numpy_has_memory_of_its_own(source, kind, precision):
    values = np.random.default_rng(3).integers(0, 2, (5, 3, kind.type.size)[: 2 + (kind.type.size > 1)])
    values = values != 0 if kind is sh.Attrib2b else values
    others = 1 - values if kind is not sh.Attrib2b else ~values
    stream = sh.Stream(values, kind, source, precision=precision)
    moved = stream.to("numpy")
    native = moved.native()
    assert native.flags.carray
    assert native.dtype == sh.Stream(values, kind, "numpy", precision=precision).native().dtype
    stream.update(others)
    np.testing.assert_array_equal(moved.numpy(), values)
    moved.update(values[::-1])
    np.testing.assert_array_equal(stream.numpy(), others)


@pytest.mark.parametrize(
    ("shape", "expected"),
    [((-1,), (12,)), (-1, (12,)), ((-1, 2), (6, 2)), ((3, -1), (3, 4)), ((2, -1, 2), (2, 3, 2)), ((12, -1), (12, 1))],
)
def test_one_extent_may_be_left_open(shape, expected):
    stream = sh.Stream(np.arange(12), sh.Attrib1f, "numpy").reshape(3, 4)
    assert stream.reshape(shape).shape == expected
    assert np.arange(12).reshape(shape).shape == expected


@pytest.mark.parametrize("shape", [(-1, -1), (-1, 5), (-2, 6), (-1, 0)])
def test_extents_that_cannot_be_completed(shape):
    with pytest.raises(sh.ShpyTypeError, match="has a negative extent"):
        sh.Stream(np.arange(12), sh.Attrib1f, "numpy").reshape(shape)


def test_an_array_that_cannot_be_shared_says_why():
    array = np.zeros(8, np.float32)
    frozen = array[:]
    frozen.flags.writeable = False
    for bad, word in (
        (array[::2], "non-contiguous float32"),
        (frozen, "read-only float32"),
        (array[:].astype(">f4"), ">f4"),
    ):
        with pytest.raises(sh.ShpyTypeError, match=f"not this {word} array"):
            sh.Stream.wrap(bad, sh.Attrib1f)
