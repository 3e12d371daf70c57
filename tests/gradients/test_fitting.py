"""Sums over all elements and their gradients by Params: the same bits everywhere, and a fit that finds its numbers."""

from __future__ import annotations

import numpy as np
import pytest

import shpy as sh
from shpy import SH_DISCARD
from tests.backends.running import TARGETS


@sh.struct
class Disc:
    center: sh.Point2f
    radius: sh.Attrib1f


disc = sh.Param(Disc, {"center": (0.4, 0.5), "radius": 0.2}, name="disc")
tint = sh.Param(sh.Color3f, (0.5, 0.5, 0.5), name="tint")
turn = sh.Param(sh.Matrix2f, np.eye(2), name="turn")


def drawn(uv):
    return tint * (1 - sh.smoothstep(-0.1, 0.1, sh.distance(turn @ uv, disc.center) - disc.radius))


@sh.program
def error(uv: sh.TexCoord2f, target: sh.Color3f) -> sh.Attrib1f:
    SH_DISCARD(uv.x > 0.9)
    d = drawn(uv) - target
    return sh.dot(d, d)


UV = np.random.default_rng(1).random((17, 23, 2)).astype(np.float32)
TARGET = np.random.default_rng(2).random((17, 23, 3)).astype(np.float32)


def test_the_same_bits_on_every_backend_and_over_streams() -> None:
    step = sh.value_and_gradient(error, (disc, tint, turn))
    value, (d_disc, d_tint, d_turn) = step(UV, TARGET, backend="numpy")
    assert (d_disc.center.shape, d_tint.shape, d_turn.shape) == ((2,), (3,), (2, 2))
    for target in TARGETS:
        streams = sh.Stream(UV, sh.TexCoord2f, target), sh.Stream(TARGET, sh.Color3f, target)
        for again, (e_disc, e_tint, e_turn) in (step(UV, target=TARGET, backend=target), step(*streams)):
            assert again == value
            assert np.array_equal(e_disc.center, d_disc.center)
            assert e_disc.radius == d_disc.radius
            assert np.array_equal(e_tint, d_tint)
            assert np.array_equal(e_turn, d_turn)


def test_the_gradient_is_the_difference_quotient() -> None:
    value, d_tint = sh.value_and_gradient(error, "tint")(UV, TARGET, precision="f64")
    whole = error.compile("numpy", precision="f64")
    assert np.isclose(value, whole(UV, TARGET).sum(), rtol=1e-12)
    sums = []
    try:
        for change in (1e-4, -1e-4):
            tint.value = (0.5, 0.5 + change, 0.5)
            sums.append(whole(UV, TARGET).sum())
    finally:
        tint.value = (0.5, 0.5, 0.5)
    assert np.isclose((sums[0] - sums[1]) / 2e-4, d_tint[1], rtol=1e-4)


def test_a_fit_finds_the_numbers_of_a_picture() -> None:
    rows, columns = np.indices((24, 24))
    uv = (np.stack([columns, rows], axis=-1) + 0.5).astype(np.float32) / 24

    @sh.program
    def shown(uv: sh.TexCoord2f) -> sh.Color3f:
        return drawn(uv)

    step = sh.value_and_gradient(error, (disc, tint))
    try:
        disc.value, tint.value = {"center": (0.55, 0.45), "radius": 0.3}, (0.9, 0.6, 0.2)
        picture = shown.compile("numpy")(uv)
        disc.value, tint.value = {"center": (0.4, 0.5), "radius": 0.2}, (0.5, 0.5, 0.5)
        first = step(uv, picture, backend="numpy")[0]
        for _ in range(60):
            last, (d_disc, d_tint) = step(uv, picture, backend="numpy")
            now = disc.value
            disc.value = {"center": now.center - 8e-5 * d_disc.center, "radius": now.radius - 8e-5 * d_disc.radius}
            tint.value = tint.value - 3e-3 * d_tint
        assert last < 1e-4 * first
        assert np.allclose(disc.value.center, (0.55, 0.45), atol=1e-2)
        assert np.allclose(tint.value, (0.9, 0.6, 0.2), atol=1e-2)
    finally:
        disc.value, tint.value = {"center": (0.4, 0.5), "radius": 0.2}, (0.5, 0.5, 0.5)


def test_what_is_refused() -> None:
    @sh.program
    def read(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * tint.x

    with pytest.raises(sh.ShpyTypeError, match="takes Params and Tables, and x is another input"):
        sh.value_and_gradient(read, "x")
    with pytest.raises(sh.ShpyTypeError, match="is no input or Param of read"):
        sh.value_and_gradient(read, disc)
