"""Shapes of inputs broadcast as numpy's do: on every backend, for arrays and streams, in bound calls and in blocks."""

import dask.array as da
import numpy as np
import pytest

import shpy as sh

BACKENDS = ["numpy", "opencl", "glsl"]


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector2f


@sh.program
def mixed(x: sh.Attrib1f, v: sh.Vector3f, n: sh.Attrib1i, m: sh.Matrix2f, keep: sh.Attrib1b):
    return v * x + sh.Attrib1f(n), m * x, sh.cond(keep, n, -n)


@sh.program
def ends(ray: Ray, t: sh.Attrib1f) -> sh.Point3f:
    return ray.o + sh.vec3(ray.d, t) * t


@sh.program
def add(a: sh.Attrib1f, b: sh.Attrib1f) -> sh.Attrib1f:
    return a + b


TYPES = {"x": sh.Attrib1f, "v": sh.Vector3f, "n": sh.Attrib1i, "m": sh.Matrix2f, "keep": sh.Attrib1b}
TAILS = {"x": (), "v": (3,), "n": (), "m": (2, 2), "keep": ()}
DTYPES = {"x": np.float32, "v": np.float32, "n": np.int32, "m": np.float32, "keep": np.bool_}


def broadcast(arrays, tails):
    """Return the arrays over the shape that numpy's own broadcasting gives their elements."""
    shape = np.broadcast(*(np.empty(a.shape[: a.ndim - len(t)]) for a, t in zip(arrays, tails, strict=True))).shape
    return shape, [np.broadcast_to(a, shape + t) for a, t in zip(arrays, tails, strict=True)]


def expected(arrays):
    shape, (x, v, n, m, keep) = broadcast(arrays.values(), TAILS.values())
    first = v * x[..., None] + n[..., None].astype(np.float32)
    return shape, (first, m * x[..., None, None], np.where(keep, n, -n))


def drawn(rng):
    """Return inputs of shapes that broadcast: each lacks leading axes, or has 1 along some, or even has no axes."""
    whole = tuple(int(n) for n in rng.integers(0 if rng.random() < 0.1 else 1, 5, rng.integers(0, 5)))
    arrays = {}
    for name, tail in TAILS.items():
        own = tuple(1 if rng.random() < 0.4 else n for n in whole)[int(rng.integers(0, len(whole) + 1)) :]
        arrays[name] = rng.integers(0, 2 if name == "keep" else 9, own + tail).astype(DTYPES[name])
    return arrays


def same(results, wanted, shape):
    for result, right, tail in zip(results, wanted, ((3,), (2, 2), ()), strict=True):
        found = result.numpy() if isinstance(result, sh.Stream) else np.asarray(result)
        assert found.shape == shape + tail
        np.testing.assert_array_equal(found, right)


def check(kernel, backend, rng):
    arrays = drawn(rng)
    shape, wanted = expected(arrays)
    for _ in range(2):  # the second call may be a bound one
        same(kernel(*arrays.values()), wanted, shape)
    views = {name: np.copy(a, order="F") if rng.random() < 0.5 else a.tolist() for name, a in arrays.items() if a.size}
    same(kernel(**{**arrays, **views}), wanted, shape)
    out = tuple(np.zeros_like(w) for w in map(np.asarray, wanted))
    same(kernel.run(**arrays, out=out).outputs, wanted, shape)
    streams = {name: sh.Stream(a, TYPES[name], backend) for name, a in arrays.items()}
    for _ in range(2):
        same(kernel(*streams.values()), wanted, shape)
    some = {name: streams[name] if rng.random() < 0.5 else a for name, a in arrays.items()}
    same(kernel(**some), wanted, shape)
    mask = rng.random(shape) < 0.5
    ran = kernel.run(**some, where=mask)
    for result, right in zip(ran.outputs, wanted, strict=True):
        kept = np.asarray(result.numpy() if isinstance(result, sh.Stream) else result)
        np.testing.assert_array_equal(kept[mask], right[mask])
        assert not kept[~mask].any()


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_random_shapes_broadcast_as_numpys_do(backend):
    rng = np.random.default_rng(23)
    kernel = mixed.compile(backend)
    for _ in range(40 if backend == "numpy" else 8):
        check(kernel, backend, rng)


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
def test_many_random_shapes_broadcast_as_numpys_do(backend):
    rng = np.random.default_rng(24)
    kernel = mixed.compile(backend)
    for _ in range(1000):
        check(kernel, backend, rng)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_open_grids_rows_and_columns(backend):
    kernel = add.compile(backend)
    y, x = np.ogrid[0:3, 0:5]
    for a, b in [(y, x), (x, y), (np.ones((3, 1)), np.arange(4.0)), (np.ones((3, 1)), np.ones((1, 4))), (y, 1), (1, 2)]:
        for _ in range(2):
            np.testing.assert_array_equal(kernel(a, b), np.asarray(a + b, np.float32), strict=True)
    one, other = (sh.Stream(a, sh.Attrib1f, backend) for a in (y, x))
    for a, b in [(one, other), (one, x), (y, other), (one, 2)]:
        for _ in range(2):
            right = np.asarray(
                sum(np.asarray(g.numpy() if isinstance(g, sh.Stream) else g) for g in (a, b)), np.float32
            )
            np.testing.assert_array_equal(kernel(a, b).numpy(), right, strict=True)
    np.testing.assert_array_equal(kernel(one, other).numpy(), y + x)
    one.update(y * 10)
    np.testing.assert_array_equal(kernel(one, other).numpy(), y * 10 + x)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_fields_and_arguments_of_a_struct_broadcast(backend):
    rng = np.random.default_rng(25)
    o, d, t = (rng.integers(0, 9, s).astype(np.float32) for s in ((3, 1, 3), (4, 2), (2, 1, 1)))
    _, (wide_o, wide_d, wide_t) = broadcast((o, d, t), ((3,), (2,), ()))
    wanted = wide_o + np.concatenate([wide_d, wide_t[..., None]], -1) * wide_t[..., None]
    np.testing.assert_array_equal(ends.compile(backend)({"o": o, "d": d}, t), wanted)
    fields = {"o": np.broadcast_to(o, (3, 4, 3)), "d": np.broadcast_to(d, (3, 4, 2))}
    stream = sh.Stream(fields, Ray, backend)
    np.testing.assert_array_equal(ends.compile(backend)(stream, t).numpy(), wanted)


@pytest.mark.parametrize("chunks", [1, 2, 5])
def test_blocks_broadcast_as_numpys_arrays_do(chunks):
    rng = np.random.default_rng(chunks)
    for _ in range(6):
        arrays = drawn(rng)
        shape, wanted = expected(arrays)
        if 0 in shape or not shape:
            continue
        names = [name for name, a in arrays.items() if a.ndim > len(TAILS[name]) and rng.random() < 0.7] or ["x"]
        cut = {
            n: da.from_array(arrays[n], chunks=(*[chunks] * (arrays[n].ndim - len(TAILS[n])), *TAILS[n])) for n in names
        }
        made = sh.map_blocks(mixed.compile("numpy"), **{**arrays, **cut})
        same([part.compute(scheduler="sync") for part in made], wanted, shape)


def test_shapes_that_do_not_broadcast_are_named():
    with pytest.raises(sh.ShpyTypeError, match=r"the element shapes do not broadcast: a \(3, 1\), b \(2, 4\)"):
        add(np.zeros((3, 1)), np.zeros((2, 4)))
    with pytest.raises(sh.ShpyTypeError, match=r"do not broadcast: a \(3,\), b \(4,\)"):
        add(sh.Stream(np.zeros(3), sh.Attrib1f, "numpy"), sh.Stream(np.zeros(4), sh.Attrib1f, "numpy"))
