"""Packets of 32 and 64 elements: clang's vectors, OpenCL's functions by halves, the bits of one element a work item."""

from __future__ import annotations

import numpy as np
import pytest
from backends import test_packet_operations, test_packets
from backends.test_packet_shapes import halved, kept, moved, sloping
from backends.test_packets import both, forms, same

import shpy as sh
from shpy.backend.opencl.device import driver as device
from shpy.backend.opencl.device.driver import machine_of
from shpy.backend.opencl.device.trial import Trial, works
from shpy.backend.opencl.packets.prologue_wide import Words, declare_wide, try_wide
from shpy.backend.opencl.packets.widen import WIDER
from shpy.backend.opencl.text.operations import FUNCTIONS, NATIVE

RNG = np.random.default_rng(9)
each_wide = pytest.mark.parametrize("lanes", WIDER)


def refused(lanes: int) -> bool:
    """Return whether the driver has no vectors of `lanes`; then a kernel of them is a CompileError that says so."""
    if lanes in machine_of(None).widths:
        return False
    with pytest.raises(sh.CompileError, match=f"no vectors of {lanes}"):
        halved.compile("opencl", lanes=lanes)
    return True


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [32])
@pytest.mark.parametrize("base", "iub")
def test_every_operation_on_ints_and_bools(lanes: int, base: str) -> None:
    if refused(lanes):
        return
    test_packet_operations.test_every_operation(lanes, base)


@pytest.mark.slow
@each_wide
@pytest.mark.parametrize("base", "fdiub")
def test_every_operation(lanes: int, base: str) -> None:
    if refused(lanes):
        return
    test_packet_operations.test_every_operation(lanes, base)


@pytest.mark.sampled(2)
@each_wide
def test_vectors_of_every_size_by_halves(lanes: int) -> None:
    if refused(lanes):
        return
    test_packets.check_memory(lanes, "fb")


@pytest.mark.sampled(2)
@each_wide
def test_loops_branches_and_exits(lanes: int) -> None:
    if refused(lanes):
        return
    x, k = RNG.normal(0, 3, 1000).astype(np.float32), RNG.integers(0, 9, 1000).astype(np.int32)
    for found, expected in zip(*both(forms, lanes, x, k), strict=True):
        same(found, expected)


@pytest.mark.parametrize("lanes", [32, pytest.param(64, marks=pytest.mark.slow)])
def test_tails_of_lists_and_rows(lanes: int) -> None:
    if refused(lanes):
        return
    for count in (0, 1, lanes - 1, lanes, lanes + 1, 20_001):
        x, n = RNG.normal(size=(count, 3)).astype(np.float32), RNG.integers(0, 9, count, np.int32)
        for found, expected in zip(*both(moved, lanes, x, n), strict=True):
            same(found, expected, count)
        for program in (halved, kept):
            given = x[:, 0].copy()
            expected = program.compile("numpy").run(given.copy(), out=given.copy()).outputs
            same(program.compile("opencl", lanes=lanes).run(given, out=given).outputs, expected, count)
            same(given, expected, count)
    for shape in ((5, 33), (70, 65), (3, lanes), (2, lanes + 1)):
        for found, expected in zip(*both(sloping, lanes, RNG.integers(0, 9, shape, np.int32)), strict=True):
            same(found, expected, shape)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("lanes", [32])
@pytest.mark.parametrize("options", [{"math": "relaxed"}, {"math": "fast"}, {"precision": "f16"}, {"precision": "f64"}])
def test_functions_of_every_mode_and_precision_have_halves(lanes: int, options: dict[str, str]) -> None:
    """Relaxed and fast mode call the driver's own functions; binary16 is rounded in memory."""
    if refused(lanes):
        return

    @sh.program
    def functions(x: sh.Attrib1f) -> sh.Attrib1f:
        y = sh.sin(x) + sh.cos(x) + sh.tan(0.5 * x) + sh.exp(-x) + sh.log(1 + x) + sh.sqrt(x) + sh.rsqrt(1 + x)
        y += sh.asin(x / 4) + sh.acos(x / 4) + sh.atan(x) + sh.atan2(x, 2.0) + sh.pow(x, 1.5) + sh.sinh(x)
        return y + sh.floor(x) + sh.round(x) + sh.min(x, 2.0) + sh.abs(x) + sh.fma(x, x, x)

    x = np.linspace(
        0.01, 3, 101, dtype=functions.compile("numpy", precision=options.get("precision", "f32"))(1.0).dtype
    )
    found = functions.compile("opencl", lanes=lanes, **options)(x)
    expected = functions.compile("opencl", lanes=1, **options)(x)
    if "precision" in options:
        same(found, expected)
    else:
        np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_a_driver_that_takes_no_wide_vectors_is_asked_for_none(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = machine_of(None)
    monkeypatch.setitem(machine.__dict__, "abilities", device.Abilities())
    assert machine.widths == (4, 8, 16)
    with pytest.raises(sh.CompileError, match="has no vectors of 32") as error:
        halved.compile("opencl", lanes=32, loop_limit=4321)
    assert 'lanes="auto", or 16' in str(error.value)


def test_a_wide_vector_that_computes_wrong_is_not_taken() -> None:
    """The trial compares what its statements give: with another operation it fails."""
    machine = machine_of(None)
    text = try_wide(32).replace("2.0f", "3.0f")
    given, wanted = tuple(range(16)), tuple(float(k + k % 2 * k) for k in range(15, -1, -1))
    trials = {"wrong": Trial("float16", text, given, wanted), "missing": Trial("float16", "a[0] = b;", given, wanted)}
    assert works(machine._place(), machine.options("strict"), trials) == frozenset()


def test_only_what_a_text_uses_is_declared() -> None:
    words = Words()
    words.add_text("int64 i = convert_int64_sat(x); float64 x;")
    assert declare_wide(words, 16) == ""
    text = declare_wide(words, 64)
    assert text.count("typedef") == 4
    assert text.index("typedef float float32 ") < text.index("typedef float float64 ")
    assert text.index("int32 convert_int32_sat(") < text.index("int64 convert_int64_sat(")
    assert "min(" not in text
    assert "double" not in text


@pytest.mark.parametrize("name", sorted({*FUNCTIONS.values(), *NATIVE.values()} - {"any", "all"}))
def test_every_function_of_opencl_has_a_form_for_longer_vectors(name: str) -> None:
    words = Words()
    words.add_text(f"float32 x = {name}(y); int32 i = {name}(j);")
    assert f" {name}(" in declare_wide(words, 32)
