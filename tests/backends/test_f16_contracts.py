"""Promises of the language at every precision: fractions below 1, finite noise, roundings, 53 bits."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

import shpy as sh

BACKENDS = ("numpy", "opencl", "glsl")
WORDS = np.concatenate(
    [
        np.uint32(
            [0, 1, 0xFF, 0x100, 0x00FFEFFF, 0x00FFF000, 0x7FFFFFFF, 0x80000000, 0xFFE00000, 0xFFFFFF00, 2**32 - 1]
        ),
        np.random.default_rng(5).integers(0, 2**32, 2000, np.uint32),
    ]
)
POINTS = np.random.default_rng(6).uniform(-100, 100, (500, 3)).astype(np.float16).astype(np.float32)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", ["f16", "f32"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_unit_float_is_the_upper_bits(backend, precision):
    @sh.program
    def unit(u: sh.Attrib1u):
        return sh.unit_float(u)

    found = unit.compile(backend, precision=precision)(WORDS)
    bits = {"f16": 11, "f32": 24}[precision]
    assert found.max() < 1
    assert np.array_equal(found.astype(np.float64), (WORDS >> np.uint32(32 - bits)) * 2.0**-bits)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_noise_of_binary16_is_near_that_of_binary32(backend):
    @sh.program
    def noises(p: sh.Point3f):
        cells = sh.library.cellnoise(p, 4)
        return (
            sh.noise(p.x),
            sh.noise(p.xy),
            sh.noise(p),
            cells,
            sh.library.worley(p.xy, count=2),
            sh.library.fbm(p.xy, 3),
        )

    half = noises.compile(backend, precision="f16")(POINTS)
    whole = noises.compile("numpy")(POINTS)
    for name, a, b in zip(("1", "2", "3", "cells", "worley"), half, whole, strict=False):
        away = np.abs(a.astype(np.float64) - b)
        assert away.max() < {"cells": 2.0**-11, "worley": 0.01}.get(name, 0.02), name
    assert np.isfinite(half[5]).all()
    assert (half[3] < 1).all()


@pytest.mark.sampled(2)
@pytest.mark.parametrize("math_mode", ["strict", "portable"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_mad_rounds_twice_at_f16(backend, math_mode):
    @sh.program
    def both(a: sh.Attrib1f, b: sh.Attrib1f, c: sh.Attrib1f):
        return sh.mad(a, b, c), sh.fma(a, b, c)

    a, b, c = (np.random.default_rng(k).normal(size=5000).astype(np.float16) for k in range(3))
    twice, once = both.compile(backend, precision="f16", math=math_mode)(a, b, c)
    assert np.array_equal(twice, a * b + c)
    assert (twice != once).any()


TAU = sh.Attrib1f(math.pi) * 2
THIRD = sh.Attrib1f(math.pi) / 3
VECTOR = sh.Attrib3f(0.1, 0.2, 0.3) * THIRD
GAIN = sh.Param(sh.Attrib1f, THIRD)
SCALE = sh.Param(sh.Attrib1f, 2.0)
DEPENDENT = THIRD * SCALE


@sh.program
def constants(x: sh.Attrib1f):
    return x + TAU, x + THIRD, x + VECTOR, x + GAIN, x + DEPENDENT, x + VECTOR.y, x + sh.sqrt(THIRD)


def wanted(word):
    """Return what each constant is where every operation is rounded to a type."""
    pi, third = word(math.pi), word(word(math.pi) / word(3))
    vector = [word(k) * third for k in (0.1, 0.2, 0.3)]
    return [pi * word(2), third, vector, third, third * word(2), vector[1], np.sqrt(third)]


@pytest.mark.parametrize("backend", ["numpy", "opencl"])
def test_constants_keep_53_bits_until_the_precision_is_known(backend):
    for found, number in zip(constants.compile(backend, precision="f64")(0.0), wanted(np.float64), strict=True):
        assert np.array_equal(found, number)
        assert found.dtype == np.float64


@pytest.mark.parametrize("backend", BACKENDS)
def test_constants_of_binary32_are_those_of_its_operations(backend):
    for found, number in zip(constants.compile(backend)(0.0), wanted(np.float32), strict=True):
        assert np.array_equal(found, number)
        assert found.dtype == np.float32


def test_constants_are_numbers_of_binary32_on_the_host():
    assert float(THIRD) == np.float32(np.float32(math.pi) / np.float32(3))
    assert np.asarray(VECTOR).dtype == np.float32
    assert pickle.loads(pickle.dumps(THIRD))._const == THIRD._const
    again = sh.Program.from_ir(sh.parse(str(constants.ir)))
    assert np.array_equal(again.compile("numpy", precision="f64")(0.0)[1], wanted(np.float64)[1])


def test_constants_beyond_the_range_of_a_type_stay_what_they_were():
    huge = sh.Attrib1f(1e30) * 1e30

    @sh.program
    def beyond(x: sh.Attrib1f):
        return x + huge

    assert beyond.compile("numpy")(0.0) == np.inf
