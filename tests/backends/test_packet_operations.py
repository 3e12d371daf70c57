"""Every operation of a type in one kernel of OpenCL: at one lane and in packets, for numbers and for vectors."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from backends.running import compiled_anew, differs
from backends.test_opencl_ops import ELEMENTS, values
from backends.test_packets import same

import shpy as sh
from shpy import SH_WHILE
from shpy.backend.base import Array, Call, Options
from shpy.backend.opencl.device.building import backend
from shpy.backend.opencl.device.driver import machine_of
from shpy.backend.opencl.packets.prologue import Abilities
from shpy.ir.builder import Builder
from shpy.ir.nodes import Module, Port
from shpy.ir.ops import OPS
from shpy.ir.types import vec
from shpy.testing.conformance.operations import meant


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The compiler is not Clang: it has functions of OpenCL alone."""
    with monkeypatch.context() as patch:
        patch.setitem(machine_of(None).__dict__, "abilities", Abilities())
        yield


@pytest.mark.sampled(3)
@pytest.mark.parametrize("base", "fdiub")
def test_every_operation_of_one_lane(base: str) -> None:
    check_every_operation(1, base, 1)


@pytest.mark.sampled(6)
@pytest.mark.parametrize(("base", "size", "lanes"), [("f", 3, 4), ("d", 2, 1), ("i", 4, 4), ("u", 3, 1), ("b", 2, 4)])
def test_every_operation_on_vectors(base: str, size: int, lanes: int) -> None:
    check_every_operation(lanes, base, size)


@pytest.mark.sampled(12)
@pytest.mark.parametrize("base", "fdiub")
@pytest.mark.parametrize("lanes", [16, 8])
def test_every_operation(lanes: int, base: str) -> None:
    check_every_operation(lanes, base, 1)


@pytest.mark.sampled(6)
@pytest.mark.usefixtures("plain")
@pytest.mark.parametrize(("base", "lanes"), [(base, 1) for base in "fdiu"] + [("f", 8), ("b", 4)])
def test_every_operation_where_the_compiler_has_no_extensions(base: str, lanes: int) -> None:
    check_every_operation(lanes, base, 1)


@pytest.mark.usefixtures("plain")
def test_lanes_where_the_compiler_has_no_extensions() -> None:
    @sh.program
    def ask(x: sh.Attrib1f, n: sh.Attrib1i) -> tuple[sh.Attrib1b, sh.Attrib1b, sh.Attrib1f]:
        y, k = sh.Attrib1f(x), sh.Attrib1i(0)
        with SH_WHILE(lambda: k < n):
            y[:] = sh.round(1.5 * y) + k
            k += 1
        return sh.any_lane(x > 20), sh.all_lanes(x > 20), y

    x, n = np.arange(37, dtype=np.float32) - 8, np.arange(37) % 5
    some, every, found = compiled_anew(ask, "opencl", lanes=8)(x, n)
    packets = [x[k : k + 8] > 20 for k in range(0, 37, 8)]
    assert np.array_equal(some, np.repeat([p.any() for p in packets], 8)[:37])
    assert np.array_equal(every, np.repeat([p.all() for p in packets], 8)[:37])
    same(found, ask.compile("numpy")(x, n)[2])


def check_every_operation(lanes: int, base: str, size: int) -> None:
    """All rows of the table for vectors of one base and size in one program, over special values."""
    b = Builder("ops")
    inputs: list[Array] = []
    cases = []
    for name, op in OPS.items():
        types = op.arguments(vec(base, size))
        if types is None:
            continue
        arrays = [np.ascontiguousarray(values(a, k, len(types)).T) for k, a in enumerate(types)]
        made = b.let(name, *(b.input(a) for a in types))
        b.store(b.output(made.type), made)
        inputs += arrays
        cases.append((name, meant(name, types, arrays)))
    function = b.finish()
    ports = tuple(Port(f"p{k}", "") for k in range(len(inputs)))
    module = Module("ops", ports, tuple(Port(f"r{k}", "") for k in range(len(cases))), (), (), (function,))
    outputs = tuple(np.zeros_like(expected) for _, expected in cases)
    backend.compile(module, Options(lanes=lanes)).run(Call((ELEMENTS,), tuple(inputs), outputs, {}, {}))
    for (name, expected), found in zip(cases, outputs, strict=True):
        same(found, expected, name)


@sh.program
def reciprocal_root(x: sh.Attrib1f) -> sh.Attrib1f:
    return sh.rsqrt(x)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("lanes", [4, 8, 16])
def test_a_reciprocal_root_begins_with_the_processors_estimate(lanes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its bits are those of the formula; `scripts/exhaustive rsqrt` compares all numbers."""
    special = np.float32([0, -0.0, np.inf, -np.inf, np.nan, -1, 1e-45, 1e-40, 2.0**-126, 3.4028235e38])
    others = np.random.default_rng(5).integers(0, 2**32, 1 << 16).astype(np.uint32).view(np.float32)
    x = np.concatenate([special, others])
    machine = machine_of(None)
    expected = reciprocal_root.compile("numpy")(x)
    for guesses in (machine.abilities.guesses, frozenset[int]()):
        abilities = replace(machine.abilities, guesses=guesses)
        monkeypatch.setitem(vars(machine), "abilities", abilities)
        kernel = compiled_anew(reciprocal_root, "opencl", lanes=lanes)
        estimated = "__builtin_ia32_rsqrt" in kernel.source
        assert estimated == (lanes in guesses and "fused" in machine.binary64)
        assert not differs(kernel(x), expected).any()


@pytest.mark.sampled(2)
@pytest.mark.parametrize("lanes", [4, 8, 32])
def test_a_relaxed_reciprocal_root_is_the_processors_estimate_and_a_step(lanes: int) -> None:
    special = np.float32([0, -0.0, np.inf, -np.inf, np.nan, -1])
    bits = np.random.default_rng(6).integers(0, 1 << 31, 1 << 16).astype(np.uint32)  # denormals are some of these
    kernel = compiled_anew(reciprocal_root, "opencl", lanes=lanes, math="relaxed")
    if machine_of(None).abilities.guesses:
        assert "__builtin_ia32_rsqrt" in kernel.source
    with np.errstate(all="ignore"):
        assert not differs(kernel(special), (1 / np.sqrt(special)).astype(np.float32)).any()
        x = np.concatenate([np.geomspace(1e-45, 1e-38, 1000, dtype=np.float32), bits.view(np.float32)])
        exact = 1 / np.sqrt(x.astype(np.float64))
        assert (np.isnan(kernel(x)) == np.isnan(exact)).all()
        finite = np.isfinite(exact) & (exact > 0)
        error = kernel(x)[finite] - exact[finite]
    assert (abs(error) <= 2 * np.spacing(exact[finite].astype(np.float32))).all()


def test_another_function_of_that_name_is_not_replaced() -> None:
    @sh.subroutine
    def rsqrt_strict(x: sh.Attrib1f) -> sh.Attrib1f:
        return sh.fma(x, x, 1.0) / sh.sqrt(x)

    @sh.program
    def other(x: sh.Attrib1f) -> sh.Attrib1f:
        return rsqrt_strict(x) + rsqrt_strict(x + 1)

    assert "__builtin_ia32_rsqrt" not in compiled_anew(other, "opencl", lanes=8).source


@pytest.mark.parametrize("lanes", [4, 8, 16, 32, 64])
def test_floats_become_ints_as_the_language_says(lanes: int) -> None:
    """Towards zero, the nearest int for numbers out of range, 0 for NaN: of every exponent, and of each border."""

    @sh.program
    def whole(x: sh.Attrib1f) -> sh.Attrib1i:
        return sh.Attrib1i(x)

    bits = np.random.default_rng(4).integers(0, 2**32, 20_000, np.uint64).astype(np.uint32).view(np.float32)
    borders = np.float32([2**31, -(2**31), 2**31 - 128, -(2**31) - 256, 2**32, 1.0, 0.99999994, 0.0, np.inf, np.nan])
    x = np.concatenate([bits, borders, -borders])
    expected = [0 if v != v else max(-(2**31), min(2**31 - 1, int(v))) if abs(v) < 2**40 else
                (2**31 - 1 if v > 0 else -(2**31)) for v in x.tolist()]  # fmt: skip
    kernel = whole.compile("opencl", lanes=lanes)
    np.testing.assert_array_equal(kernel(x), expected)
    fast = whole.compile("opencl", lanes=lanes, math="fast")
    np.testing.assert_array_equal(fast(borders), kernel(borders))
    assert "convert_int" in fast.source  # whose compiler may take every number for finite
    has_instruction = machine_of(None).abilities.truncations
    assert ("convert_int" not in kernel.source) == bool(has_instruction and min(has_instruction) <= lanes)
