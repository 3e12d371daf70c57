"""Gradients of sums by the elements of Tables and Textures: difference quotients at f64, the same bits everywhere."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy import SH_BREAK, SH_DISCARD, SH_ELSE, SH_FOR, SH_IF, SH_RETURN, SH_WHILE
from tests.backends.running import TARGETS

RNG = np.random.default_rng(53)
UV = RNG.random((9, 11, 2)).astype(np.float32)
TARGET = RNG.random((9, 11)).astype(np.float32)

gain = sh.Param(sh.Attrib1f, 1.5, name="gain")
row = sh.Param(sh.Attrib1i, 2, name="row")
heights = sh.Table(RNG.random((4, 5)), sh.Attrib1f, name="heights")
tints = sh.Table(RNG.random((6, 3)), sh.Color3f, name="tints")
level = heights[row, 1] * gain
"""A uniform that follows two Params and an element of a table."""


@sh.subroutine
def tinted(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_IF(x < 0.1):
        SH_RETURN(x * x)
    return sh.dot(tints[sh.Attrib1i(x * 7)], sh.vec3(x, 1, x * x))


@sh.program
def error(uv: sh.Attrib2f, target: sh.Attrib1f, bumps: sh.Table[sh.Attrib1f, 3]) -> sh.Attrib1f:
    """Reads two elements of one table, one out of range on each axis, by a subroutine twice, and in a branch."""
    SH_DISCARD(uv.y > 0.9)
    at = sh.Attrib2i(uv * 8) - 2
    h = heights[at] * heights[at.y, at.x + 1] + sh.sin(tinted(uv.x)) * gain + level
    with SH_IF(uv.x > 0.5):
        h += sh.exp(bumps[at.x, at.y, 1] * uv.y)
    with SH_ELSE():
        h *= tinted(uv.y)
    return (h - target) * (h - target)


BUMPS = RNG.random((2, 3, 2)).astype(np.float32)
step = sh.value_and_gradient(error, (gain, heights, "bumps", tints))


def differences(value: Any, start: Any, change: float = 1e-5) -> Any:
    """Return the central differences of value(array) by each number of an array."""
    slopes = np.zeros(start.shape)
    for at in np.ndindex(start.shape):
        ends = [np.array(start, np.float64) for _ in range(2)]
        ends[0][at] += change
        ends[1][at] -= change
        slopes[at] = (value(ends[0]) - value(ends[1])) / (2 * change)
    return slopes


def with_data(table: sh.Table, run: Any) -> Any:
    """Return the function of a table's data that is run() with them."""

    def value(data: Any) -> float:
        before = table.host_array().copy()
        try:
            table.update(data)
            return float(run())
        finally:
            table.update(before)

    return value


def test_the_gradient_is_the_difference_quotient() -> None:
    whole = error.compile("numpy", precision="f64")
    value, (d_gain, d_heights, d_bumps, d_tints) = step(UV, TARGET, BUMPS, precision="f64", backend="numpy")
    total = lambda bumps=BUMPS: whole(UV, TARGET, bumps).sum()  # noqa: E731
    assert np.isclose(value, total(), rtol=1e-13)
    assert np.allclose(d_heights, differences(with_data(heights, total), heights.host_array()), rtol=1e-7, atol=1e-7)
    assert np.allclose(d_tints, differences(with_data(tints, total), tints.host_array()), rtol=1e-7, atol=1e-7)
    assert np.allclose(d_bumps, differences(total, BUMPS), rtol=1e-7, atol=1e-7)
    assert (d_heights.shape, d_bumps.shape, d_tints.shape) == ((4, 5), (2, 3, 2), (6, 3))
    assert np.isclose(d_gain, sh.value_and_gradient(error, gain)(UV, TARGET, BUMPS, precision="f64")[1], rtol=1e-13)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("target", TARGETS)
def test_the_same_bits_on_every_backend_and_over_streams(target: str) -> None:
    """Arrays, and streams with a mask; some elements of both are discarded."""
    streams = sh.Stream(UV, sh.Attrib2f, target), sh.Stream(TARGET, sh.Attrib1f, target)
    some = UV[..., 0] * UV[..., 1] < 0.2
    mask = sh.Stream(some, sh.Attrib1b, target)
    runs = [
        (step(UV, TARGET, BUMPS, backend="numpy"), step(UV, TARGET, BUMPS, backend=target)),
        (step(UV, TARGET, BUMPS, backend="numpy", where=some), step(*streams, bumps=BUMPS, where=mask)),
    ]
    for expected, again in runs:
        assert again[0] == expected[0]
        for x, y in zip(again[1], expected[1], strict=True):
            assert np.array_equal(x, y)
            assert x.dtype == np.float32
    assert (runs[0][0][1][1] != runs[1][0][1][1]).any()
    none = step(UV, TARGET, BUMPS, backend=target, where=False)
    assert not any(np.any(x) for x in (none[0], *none[1]))


def test_sums_are_those_of_numpy_in_order() -> None:
    """A sum of squares by its table, at f32: each place adds the bars of its elements in the order of these."""

    @sh.program
    def squares(k: sh.Attrib1i, x: sh.Attrib1f) -> sh.Attrib1f:
        h = heights[k, 2] - x
        return h * h

    k, x = RNG.integers(-3, 7, 500).astype(np.int32), RNG.random(500).astype(np.float32)
    _, slope = sh.value_and_gradient(squares, "heights")(k, x, backend="numpy")
    bars = np.float32(2) * (heights.host_array()[k.clip(0, 3), 2].astype(np.float32) - x)
    expected = np.zeros((4, 5), np.float32)
    np.add.at(expected, (k.clip(0, 3), 2), bars)
    assert np.array_equal(slope, expected)


@sh.struct
class Blob:
    center: sh.Point2f
    turn: sh.Matrix2f


def test_structs_textures_and_one_element() -> None:
    """Tables of structs with matrices, textures of three filters, captured and as an argument, and a single place."""
    data = {"center": RNG.random((3, 2)), "turn": RNG.random((3, 2, 2))}
    blobs = sh.Table(data, Blob)
    image = RNG.random((4, 3, 3)).astype(np.float32)
    textures = [sh.Texture2D(image, filter=f, wrap="repeat") for f in ("nearest", "linear", "cubic")]

    @sh.program
    def seen(uv: sh.Attrib2f, picture: sh.Texture2D[sh.Color3f]) -> sh.Attrib1f:
        blob = blobs[sh.Attrib1i(uv.x * 3)]
        far = sh.length(blob.turn @ (uv - blob.center))
        colors = [*(texture(uv) for texture in textures), picture(uv.yx)]
        return sum((sh.dot(c, c) * uv.x for c in colors), far)

    places = UV[:3].astype(np.float64)
    inputs = places, sh.Texture2D(image)
    by = sh.value_and_gradient(seen, (textures[0], "picture", blobs, *textures[1:]))
    _, (nearest, picture, d_blobs, linear, cubic) = by(*inputs, precision="f64", backend="numpy")
    whole = seen.compile("numpy", precision="f64")
    total = lambda picture=inputs[1]: whole(places, picture).sum()  # noqa: E731
    for texture, slope in zip(textures, (nearest, linear, cubic), strict=True):
        assert np.allclose(slope, differences(with_data(texture.table, total), image), rtol=1e-6, atol=1e-7)
    assert np.allclose(picture, differences(lambda x: total(sh.Texture2D(x)), image), rtol=1e-6, atol=1e-7)
    for name, slope in (("center", d_blobs.center), ("turn", d_blobs.turn)):

        def moved(field: Any, name: str = name) -> float:
            blobs.update(data | {name: field})
            return float(total())

        assert np.allclose(slope, differences(moved, data[name]), rtol=1e-6, atol=1e-7)
        blobs.update(data)
    value, single = sh.value_and_gradient(seen, textures[1])([0.5, 0.5], image)
    assert (np.shape(value), single.shape) == ((), (4, 3, 3))
    assert single.any()


def test_a_table_over_a_stream_and_halves() -> None:
    @sh.program
    def squares(x: sh.Attrib1f, k: sh.Attrib1i, rows: sh.Table[sh.Attrib1f]) -> sh.Attrib1f:
        return rows[k] * x * x

    rows = sh.Table(sh.Stream([1.0, 2, 3], sh.Attrib1f, "opencl"))
    value, slope = sh.value_and_gradient(squares.bind(rows=rows), rows)([1, 2, 3, 4], [0, 2, 2, 5])
    assert (value, slope.tolist()) == (1 + 12 + 27 + 48, [1, 0, 29])
    run = sh.value_and_gradient(squares.bind(k=sh.Param(sh.Attrib1i, 1)), "rows")
    for target in ("numpy", "opencl"):
        value, slope = run([0.5, 2, 0.25], [1.0, 2, 3], precision="f16", backend=target)
        assert (slope.dtype, slope.tolist()) == (np.float16, [0, 4.3125, 0])


def test_loops() -> None:
    """Reads beside a loop, in a loop that finds an index, in a loop of Python, and before a loop without a bound."""

    @sh.program
    def found(x: sh.Attrib1f) -> sh.Attrib1f:
        k = sh.Attrib1i(0)
        with SH_FOR(0, 4) as n:
            with SH_IF(heights[n, 0] < x):
                k[:] = n
        total = heights[k, 1] * 1
        factor = heights[k, 2]
        with SH_FOR(0, 3):
            total *= factor
        return total + sum(heights[n, 3] * x for n in range(4))

    x = RNG.random(20)
    _, slope = sh.value_and_gradient(found, heights)(x, precision="f64", backend="numpy")
    whole = found.compile("numpy", precision="f64")
    quotients = differences(with_data(heights, lambda: whole(x).sum()), heights.host_array(), 1e-7)
    assert np.allclose(slope, quotients, rtol=1e-6, atol=1e-6)

    @sh.program
    def power(x: sh.Attrib1f) -> sh.Attrib1f:
        total, k, factor = sh.Attrib1f(1), sh.Attrib1f(0), heights[sh.Attrib1i(x), 0]
        with SH_WHILE(lambda: k < x):
            total *= factor
            k += 1
        return total

    _, slope = sh.value_and_gradient(power, heights, most=2)([1, 2, 3], backend="numpy")
    assert np.array_equal(slope[:3, 0], [0, 1, 2 * np.float32(heights.host_array()[2, 0])])
    assert np.isnan(slope[3, 0])  # three iterations
    assert not slope[:, 1:].any()


@sh.subroutine
def column(x: sh.Attrib1f, count: sh.Attrib1i) -> sh.Attrib1f:
    """Leaves its loop early, and reads one table in the arithmetic of another's index."""
    total = sh.Attrib1f(0)
    with SH_FOR(0, 4) as n:
        with SH_IF(n >= count):
            SH_RETURN(total * x)
        total += heights[n, sh.Attrib1i(x * 5)] * total + tinted(x * n)
    return total


@sh.program
def marched(uv: sh.Attrib2f, target: sh.Attrib1f) -> sh.Attrib1f:
    """Reads in nested loops, up to 60 of `heights` and 15 of `tints`, beside one outside of them."""
    light = sh.Attrib1f(1) * heights[0, 0] * gain
    with SH_FOR(0, 3) as i:
        with SH_FOR(0, 15) as j:
            step = heights[i, j - 5] * uv.x
            SH_BREAK(light > 1.6 + uv.y)
            light += sh.sin(step + light)
        light *= sh.cos(column(uv.y, i + 1) * 0.1)
    return (light - target) * (light - target)


def test_reads_in_loops() -> None:
    """The difference quotient in four runs, and the same bits on every backend, also from a pickled function."""
    by = sh.value_and_gradient(marched, (gain, heights, tints))
    value, (d_gain, d_heights, d_tints) = by(UV, TARGET, precision="f64", backend="numpy")
    whole = marched.compile("numpy", precision="f64")
    total = lambda: whole(UV, TARGET).sum()  # noqa: E731
    assert np.isclose(value, total(), rtol=1e-13)
    assert np.allclose(d_heights, differences(with_data(heights, total), heights.host_array()), rtol=1e-6, atol=1e-6)
    assert np.allclose(d_tints, differences(with_data(tints, total), tints.host_array()), rtol=1e-6, atol=1e-6)
    assert np.isclose(d_gain, sh.value_and_gradient(marched, gain)(UV, TARGET, precision="f64")[1], rtol=1e-12)
    expected = by(UV, TARGET, backend="numpy")
    pickled = pickle.loads(pickle.dumps(by))
    for target in TARGETS[1:]:
        again = pickled(UV, TARGET, backend=target)
        assert again[0] == expected[0]
        for x, y in zip(again[1], expected[1], strict=True):
            assert np.array_equal(x, y), target


@pytest.mark.slow
def test_reads_in_loops_of_structs_textures_and_streams() -> None:
    """A texture whose four texels a loop reads, a Table of structs, a mask over streams, an element beyond `most`."""
    data = {"center": RNG.random((3, 2)), "turn": RNG.random((3, 2, 2))}
    blobs = sh.Table(data, Blob)
    sheet = sh.Texture2D(RNG.random((5, 6)), filter="linear", wrap="repeat")

    @sh.program
    def walked(uv: sh.Attrib2f) -> sh.Attrib1f:
        p, total = sh.Attrib2f(uv), sh.Attrib1f(0)
        with SH_WHILE(lambda: (p.x < 1.2) & (total < 9)):
            blob = blobs[sh.Attrib1i(p.y * 3)]
            total += sheet(p) * sh.length(blob.turn @ (p - blob.center))
            p += 0.1 + 0.02 * uv.yx
        return total

    by = sh.value_and_gradient(walked, (sheet, blobs), most=9)
    starts = UV[UV[..., 0] > 0.5].astype(np.float64)
    _, (d_sheet, d_blobs) = by(starts, precision="f64", backend="numpy")
    whole = walked.compile("numpy", precision="f64")
    total = lambda: whole(starts).sum()  # noqa: E731
    image = sheet.table.host_array()
    assert np.allclose(d_sheet, differences(with_data(sheet.table, total), image), rtol=1e-6, atol=1e-6)

    def turned(turn: Any) -> float:
        blobs.update(data | {"turn": turn})
        return float(total())

    assert np.allclose(d_blobs.turn, differences(turned, data["turn"]), rtol=1e-6, atol=1e-6)
    blobs.update(data)
    narrow = starts.astype(np.float32)
    some = starts[:, 0] > 0.7
    expected = by(narrow, where=some, backend="numpy")
    again = by(sh.Stream(narrow, sh.Attrib2f, "opencl"), where=sh.Stream(some, sh.Attrib1b, "opencl"))
    assert np.array_equal(again[1][0], expected[1][0])
    assert np.array_equal(again[1][1].center, expected[1][1].center)
    assert np.isnan(by([0.0, 0.5], backend="numpy")[1][0]).any()


def test_a_loop_without_a_bound_is_refused_with_a_cure_that_holds() -> None:
    """Reads of Tables take reverse mode, so the cure is no other mode."""

    @sh.program
    def endless(x: sh.Attrib1f) -> sh.Attrib1f:
        y = sh.Attrib1f(x)
        with SH_WHILE(lambda: y < 9):
            y += heights[0, 0]
        return y * gain

    cure = "SH_FOR with numbers of Python and SH_BREAK(c) in it; or most=64, where elements that take more iterations"
    for wrt in (heights, (gain, heights)):
        with pytest.raises(sh.RecordError, match="this loop has no known bound") as e:
            sh.value_and_gradient(endless, wrt)
        assert e.value.cure == f"{cure} give NaN"
        assert e.value.loc is not None
        assert Path(__file__).read_text().splitlines()[e.value.loc.line - 1].strip().startswith("with SH_WHILE")
    assert sh.value_and_gradient(endless, heights, most=64)(1.0)[1][0, 0] > 0
    with pytest.raises(sh.RecordError, match="no known bound") as e:
        sh.accuracy.roundings(endless, {"x": (1, 2)})
    assert e.value.cure == f"{cure} give NaN"
    sh.accuracy.roundings(endless, {"x": (1, 2)}, samples=2, most=64)
    with pytest.raises(sh.RecordError, match="no known bound") as e:
        sh.value_and_gradient(endless, gain)
    assert e.value.cure == f'{cure} give NaN; or mode="forward"'
    sh.value_and_gradient(endless, gain, mode="forward")(1.0)


def test_a_fit_finds_a_table() -> None:
    """A table of 6 x 6 that is fitted to 24 x 24 places of another one in 60 steps, and a factor with it."""
    rows, columns = np.indices((24, 24))
    places = (np.stack([columns, rows], axis=-1) / 24).astype(np.float32)
    truth = np.sin(np.arange(36.0)).reshape(6, 6) + 2
    sheet, factor = sh.Texture2D(truth, name="sheet"), sh.Param(sh.Attrib1f, 1.0)

    @sh.program
    def shown(uv: sh.TexCoord2f) -> sh.Attrib1f:
        return sheet(uv) * factor

    @sh.program
    def misfit(uv: sh.TexCoord2f, target: sh.Attrib1f) -> sh.Attrib1f:
        d = shown(uv) - target
        return d * d

    picture = shown.compile("numpy")(places)
    sheet.update(np.full((6, 6), 1.5))
    factor.value = 1.25
    both = sh.value_and_gradient(misfit, (sheet, factor))
    first = both(places, picture, backend="numpy")[0]
    for _ in range(60):
        last, (d_sheet, d_factor) = both(places, picture, backend="numpy")
        sheet.update(sheet.table.host_array() - 0.02 * d_sheet)
        factor.value = factor.value - 1e-5 * d_factor
    assert last < 1e-3 * first
    assert np.allclose(sheet.table.host_array() * factor.value, truth, atol=0.05)


def test_errors() -> None:
    counts = sh.Table(np.arange(4), sh.Attrib1i, name="counts")

    @sh.program
    def stepped(x: sh.Attrib1f) -> sh.Attrib1f:
        return sh.cond(heights[0, 0] > x, counts[2] * x, gain)

    with pytest.raises(sh.ShpyTypeError, match="counts is a Table of Attrib1i, which has no derivative"):
        sh.value_and_gradient(stepped, counts)
    for table in (heights, tints):
        match = f"by {table.name}: stepped does not depend on its elements, or in steps alone"
        with pytest.raises(sh.RecordError, match=match):
            sh.value_and_gradient(stepped, (gain, table))
    with pytest.raises(sh.ShpyTypeError, match="a gradient by a Table takes reverse mode"):
        sh.value_and_gradient(error, heights, mode="forward")
    with pytest.raises(sh.ShpyTypeError, match="takes Params and Tables, and uv is another input"):
        sh.value_and_gradient(error, "uv")
    with pytest.raises(sh.ShpyTypeError, match="heights is named twice"):
        sh.value_and_gradient(error, (heights, "heights"))
    for call in (lambda: error.gradient(heights), lambda: error.jvp("bumps")):
        with pytest.raises(sh.ShpyTypeError, match=r"is a Table, each element .*\s.*sh.value_and_gradient\(error"):
            call()
    with pytest.raises(sh.ShpyTypeError, match="is no input or Param of stepped"):
        sh.value_and_gradient(stepped, "gian")
    with pytest.raises(sh.ShpyTypeError, match="error lacks its input bumps"):
        step(UV, TARGET)
