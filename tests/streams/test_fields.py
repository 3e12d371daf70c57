"""Fields of streams of structs: streams over the same memory, on the device."""

from __future__ import annotations

import copy
import pickle
from typing import NamedTuple

import numpy as np
import pytest

import shpy as sh

BACKENDS = ("numpy", "opencl", "glsl")


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector3f


@sh.struct
class Hit:
    ray: Ray
    frame: sh.Matrix2f
    sum: sh.Attrib1i


class Pair(NamedTuple):
    near: sh.Attrib1f
    far: sh.Attrib2f


@sh.program
def doubled(x: sh.Point3f) -> sh.Point3f:
    return sh.Point3f(x * 2)


def hits(backend):
    n = np.arange(12, dtype=np.float32).reshape(4, 3)
    data = {
        "ray": {"o": n, "d": -n},
        "frame": np.arange(16, dtype=np.float32).reshape(4, 2, 2),
        "sum": np.arange(4, dtype=np.int32),
    }
    return sh.Stream(data, Hit, backend=backend), n


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_field_is_a_stream_over_the_same_memory(backend):
    stream, n = hits(backend)
    rays = stream.ray
    assert (rays.type, rays.shape, rays.backend) == (Ray, (4,), backend)
    assert (rays.o.type, rays["d"].type, stream.frame.type) == (sh.Point3f, sh.Vector3f, sh.Matrix2f)
    assert np.array_equal(rays.o.numpy(), n)
    assert np.array_equal(stream["ray"]["d"].numpy(), -n)
    assert np.array_equal(stream.frame.numpy(), np.arange(16).reshape(4, 2, 2))
    assert np.array_equal(stream["sum"].numpy(), np.arange(4))  # `sum` is a method
    found = doubled.compile(backend)(rays.o)
    assert np.array_equal(found.numpy(), 2 * n)
    doubled.compile(backend).run(rays.o, out=rays.o)
    assert np.array_equal(
        stream.numpy()["ray"]["o"] if isinstance(stream.numpy(), dict) else stream.ray.o.numpy(), 2 * n
    )
    rays.d.update(n)
    assert np.array_equal(stream.ray.d.numpy(), n)
    assert rays.o.sum().tolist() == (2 * n).sum(0).tolist()
    del stream
    assert np.array_equal(rays.d.numpy(), n)


@pytest.mark.parametrize("backend", BACKENDS)
def test_fields_of_named_tuples(backend):
    pairs = sh.Stream({"near": np.float32([1, 2]), "far": np.float32([[3, 4], [5, 6]])}, Pair, backend=backend)
    assert pairs.near.numpy().tolist() == [1, 2]
    assert sh.Table(pairs.far).shape == (2,)
    assert pairs.reshape(2, 1).far.shape == (2, 1)


def test_names_that_are_no_fields():
    stream, _ = hits("numpy")
    with pytest.raises(
        AttributeError, match=r"has the fields ray, frame, sum, not 'rays'\n  write instead: stream\[\"ray\"\]"
    ):
        _ = stream.rays
    with pytest.raises(sh.ShpyTypeError, match="has the fields ray, frame, sum, not 'x'"):
        stream["x"]
    plain = sh.Stream(np.float32([1]), sh.Attrib1f, backend="numpy")
    with pytest.raises(AttributeError, match="has no fields, not 'o'"):
        _ = plain.o
    assert not hasattr(plain, "__array_interface__")
    assert copy.copy(stream).ray.o.shape == (4,)
    assert pickle.loads(pickle.dumps(plain)).numpy().tolist() == [1]
