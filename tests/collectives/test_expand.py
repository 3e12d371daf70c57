"""sh.expand: each element as often as its count says, which is np.repeat."""

import numpy as np
import pytest

import shpy as sh

BACKENDS = ("numpy", "opencl", "glsl")


@sh.struct
class Ray:
    o: sh.Point3f
    n: sh.Attrib1i


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_it_is_numpys_repeat(backend):
    rng = np.random.default_rng(3)
    for n in (1, 2, 3, 37, 1000):
        x, counts = rng.normal(size=(n, 3)).astype(np.float32), rng.integers(-2, 5, n).astype(np.int32)
        times = np.maximum(counts, 0)
        rays = sh.Stream({"o": x, "n": np.arange(n)}, Ray, backend=backend)
        for given in (counts, sh.Stream(counts, sh.Attrib1i, backend=backend)):
            found = sh.expand(rays, given)
            assert found.elements.type is Ray
            assert np.array_equal(found.elements.o.numpy(), np.repeat(x, times, axis=0))
            assert np.array_equal(found.elements.n.numpy(), np.repeat(np.arange(n), times))
            assert np.array_equal(found.indices.numpy(), np.repeat(np.arange(n), times))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_none_and_several_axes(backend):
    s = sh.Stream(np.arange(6, dtype=np.float32).reshape(2, 3), sh.Attrib1f, backend=backend)
    assert sh.expand(s, [[0, 1, 0], [2, 0, 0]]).elements.numpy().tolist() == [1, 3, 3]
    assert sh.expand(s, np.zeros((2, 3), int)).elements.shape == (0,)
    none = sh.Stream(np.zeros(0, np.float32), sh.Attrib1f, backend=backend)
    assert sh.expand(none, []).elements.shape == (0,)


def test_refusals():
    s = sh.Stream(np.zeros(4, np.float32), sh.Attrib1f, backend="numpy")
    with pytest.raises(sh.ShpyTypeError, match=r"counts has the shape \(2,\), and the stream \(4,\)"):
        sh.expand(s, [1, 2])
    with pytest.raises(sh.ShpyTypeError, match=r"add up to 2\*\*31 - 1 or more"):
        sh.expand(s, [2**30] * 4)
    with pytest.raises(sh.ShpyTypeError, match="counts takes ints"):
        sh.expand(s, [0.5] * 4)
