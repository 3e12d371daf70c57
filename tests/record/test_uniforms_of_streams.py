"""Uniforms that read a Table over a Stream: the value of the stream's element, before and after it changes."""

import numpy as np
import pytest

import shpy as sh

BACKENDS = ["numpy", "opencl", "glsl"]
at = sh.Param(sh.Attrib1i, 1, name="at")


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_uniform_follows_a_stream_and_a_param(backend):
    stream = sh.Stream([3.0, 1.5, 2.0], sh.Attrib1f, backend)
    table = sh.Table(stream)
    picked = table[at] * 2

    @sh.program
    def scaled(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * picked

    @sh.program
    def halved(x: sh.Attrib1f) -> sh.Attrib1f:
        return x / 2

    for other in BACKENDS:
        at.value = 1
        assert picked.value == 3
        kernel = scaled.compile(other)
        assert kernel([1, 2]).tolist() == [3, 6]
        at.value = 0
        assert kernel([1, 2]).tolist() == [6, 12]
        stream.update([5.0, 0.0, 0.0])
        assert kernel([1, 2]).tolist() == [10, 20]
        halved.compile(backend).run(stream, out=stream)
        assert np.asarray(picked) == 5
        assert kernel([1, 2]).tolist() == [5, 10]
        stream.update([3.0, 1.5, 2.0])


@pytest.mark.parametrize("backend", BACKENDS)
def test_an_element_of_structs_is_a_uniform_too(backend):
    @sh.struct
    class Ball:
        center: sh.Point3f
        radius: sh.Attrib1f

    stream = sh.Stream({"center": np.arange(6.0).reshape(2, 3), "radius": np.array([7.0, 8.0])}, Ball, backend)
    ball = sh.Table(stream)[at]
    at.value = 1
    assert np.asarray(ball.center).tolist() == [3, 4, 5]
    assert ball.radius.value == 8


def test_an_error_inside_a_property_is_raised_as_it_is(monkeypatch):
    doubled = sh.Param(sh.Attrib1f, 1, name="factor") * 2

    def at_precision(self, precision, math):
        return None.missing

    monkeypatch.setattr(type(doubled), "at", at_precision)
    with pytest.raises(AttributeError, match="'NoneType' object has no attribute 'missing'"):
        doubled.value  # noqa: B018
    with pytest.raises(sh.ShpyAttributeError, match="'Attrib1f' object has no attribute 'length'"):
        doubled.length  # noqa: B018
