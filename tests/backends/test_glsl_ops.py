"""Operations on GLSL against their meaning: special values, all sizes, beside constants, a million at random.

The conformance list runs each row and conversion over more values in every run, so those here are slow tests.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import shpy as sh
from shpy.backend.base import Call, Options
from shpy.backend.glsl import backend
from shpy.ir import meaning
from shpy.ir.builder import Builder
from shpy.ir.constants import DTYPES
from shpy.ir.nodes import Module, Port, Value
from shpy.ir.ops import COMPOSITES, OPS, result_type
from shpy.ir.types import Base, Type, vec
from shpy.testing.conformance.exact import exact

TINY = float(np.finfo(np.float32).tiny)
MODERATE = [
    0.0,
    -0.0,
    1,
    -1,
    0.5,
    -0.5,
    1.5,
    2.5,
    -2.5,
    3,
    0.1,
    3.7,
    -7.3,
    0.99999994,
    1e10,
    -1e10,
    1e-7,
    np.inf,
    -np.inf,
    np.nan,
]
EXTREME = [*MODERATE, TINY, -TINY, 2**31, -(2**31), 2**31 - 128, -(2**31) - 256, 2**32, 4294967040, 3e9,
           2**24 + 2, 8388607.5, 4194304.5, 65519.9, 65520, 0.49999997, 1.7e38, 3.4028235e38,
           -3.4028235e38]  # fmt: skip
INTS = [0, 1, -1, 2, -2, 3, -3, 7, -7, 31, 32, 33, 63, -32, 12345, -54321, 0x55555555, 2**31 - 1, -(2**31), 1 - 2**31]
N = 1536

Make = Callable[[Builder, list[Value]], Value]


def special(type: Type, moderate: bool) -> Any:
    """The values of a base that are likely to go wrong."""
    if type.is_float:
        return np.array(MODERATE if moderate else EXTREME).astype(np.float32)
    if type.is_bool:
        return np.array([False, True])
    return np.array(INTS, np.int64).astype(DTYPES[type.base])


def values(types: tuple[Type, ...], moderate: bool = False) -> list[Any]:
    """Arrays (n,) or (size, n): for two scalars or less all pairs, else a random choice."""
    rng = np.random.default_rng(len(types))
    arrays = [rng.choice(special(t, moderate), (t.size, N) if t.size > 1 else (N,)) for t in types]
    if len(types) <= 2 and all(t.size == 1 for t in types):
        pairs = np.meshgrid(*(special(t, moderate) for t in types))
        arrays = [np.resize(p.ravel(), N) for p in pairs]
    return arrays


def run(types: tuple[Type, ...], result: Type, arrays: list[Any], make: Make) -> Any:
    """Return the result of `make(builder, inputs)` for the arrays, (n,) or (size, n)."""
    b = Builder("op")
    inputs = [b.input(t, name) for t, name in zip(types, "abc", strict=False)]
    b.store(b.output(result, "result"), make(b, inputs))
    ports = tuple(Port(str(i.name), "") for i in inputs)
    module = Module("op", ports, (Port("result", ""),), (), (), (b.finish(),))
    count = arrays[0].shape[-1]
    out = np.zeros((count, result.size) if result.size > 1 else (count,), DTYPES[result.base])
    executable = backend.compile(module, Options())
    assert executable.run(Call((count,), tuple(np.ascontiguousarray(a.T) for a in arrays), (out,), {}, {})) is None
    return out.T


def flushed(a: Any) -> Any:
    """Denormals, and what may round up from them, as zeros where the device does so."""
    if a.dtype.kind == "f" and any("denormals" in note for note in backend.devices()[0].notes):
        return np.where(np.abs(a) <= np.float32(TINY), np.copysign(np.float32(0), a), a)
    return a


def wrong(found: Any, expected: Any) -> Any:
    """Return a mask of the elements that differ in any bit; all NaNs are equal."""
    found, expected = flushed(found), flushed(expected)
    if found.dtype.kind != "f":
        return found != expected
    with np.errstate(all="ignore"):
        same = (found == expected) & (np.signbit(found) == np.signbit(expected)) | (found != found) & (
            expected != expected
        )
    return ~same


def check(found: Any, expected: Any, arrays: list[Any]) -> None:
    assert found.dtype == expected.dtype
    bad = np.argwhere(wrong(found, expected))
    if len(bad):
        at = bad[0][-1]
        pytest.fail(f"{len(bad)} wrong: {[a[..., at] for a in arrays]} gave {found[..., at]}, not {expected[..., at]}")


def expected_of(name: str, arrays: list[Any], result: Type) -> Any:
    f = exact(name)
    n = arrays[0].shape[-1]
    rows = [a.reshape(-1, n) for a in arrays]  # a scalar as a vector of one, for what sums over components
    with np.errstate(all="ignore"):
        found = np.asarray(f(*rows)).astype(DTYPES[result.base])
    return np.broadcast_to(found, (result.size, n)).reshape((n,) if result.size == 1 else (result.size, n))


def rows() -> list[Any]:
    """Every op with every choice of types that GLSL has."""
    found = []
    for name, op in OPS.items():
        for base in (b for b in "fiub" if Base(b) in op.bases):
            for size in (1, 2, 3, 4):
                for count in "iu" if "X" in op.takes else "i":
                    types = op.arguments(vec(base, size), Base(count))
                    if types is not None:
                        found.append(pytest.param(name, types, id="-".join([name, *map(repr, types)])))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("name", "types"), rows())
def test_an_op_means_what_the_table_says(name: str, types: tuple[Type, ...]) -> None:
    result = result_type(name, types)
    arrays = values(types, moderate=name in COMPOSITES)
    found = run(types, result, arrays, lambda b, inputs: b.let(name, *inputs))
    check(found, expected_of(name, arrays, result), arrays)


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 2, 3, 4])
@pytest.mark.parametrize("target", "fiub")
@pytest.mark.parametrize("source", "fiub")
def test_a_conversion_saturates_or_wraps(source: str, target: str, size: int) -> None:
    a, t = vec(source, size), vec(target, size)
    arrays = values((a,))
    with np.errstate(all="ignore"):
        expected = meaning.convert(arrays[0], DTYPES[t.base])
    check(run((a,), t, arrays, lambda b, inputs: b.let("convert", *inputs, type=t)), expected, arrays)


@pytest.mark.parametrize("size", [1, 3])
def test_half_is_the_nearest_binary16(size: int) -> None:
    t = vec(Base.F, size)
    halves = np.arange(65536, dtype=np.uint16).view(np.float16).astype(np.float32)
    with np.errstate(all="ignore"):
        ties = (halves + np.roll(halves, 1)) / 2
        everything = np.concatenate([halves, ties, ties * np.float32(1.0000001)])
        arrays = [np.resize(everything, (size, 65536 * 3)) if size > 1 else everything]
        expected = arrays[0].astype(np.float16).astype(np.float32)
    check(run((t,), t, arrays, lambda b, inputs: b.let("half", *inputs, type=t)), expected, arrays)


@pytest.mark.sampled(8)
@pytest.mark.parametrize(
    "name", ["add", "sub", "mul", "div", "sqrt", "fma", "mad", "floor", "min", "dot", "normalize", "mod"]
)
def test_a_million_results_are_equal_to_the_bit(name: str) -> None:
    arity = {"sqrt": 1, "floor": 1, "fma": 3, "mad": 3, "normalize": 1}.get(name, 2)
    t = vec(Base.F, 3 if name in ("dot", "normalize") else 1)
    rng = np.random.default_rng(7)
    n = 1 << 20
    shape = (n,) if t.size == 1 else (t.size, n)
    arrays = [(rng.standard_normal(shape) * 10 ** rng.uniform(-4, 4, shape)).astype(np.float32) for _ in range(arity)]
    result = result_type(name, (t,) * arity)
    found = run((t,) * arity, result, arrays, lambda b, inputs: b.let(name, *inputs))
    check(found, expected_of(name, arrays, result), arrays)


@pytest.mark.sampled(84)
@pytest.mark.parametrize("size", [1, 3])
@pytest.mark.parametrize("constant", [0.0, -0.0, 1.0, -1.0, 2.0, float("inf"), float("nan"), 0.1, 1e-30, 3.4028235e38])
@pytest.mark.parametrize("op", ["add", "sub", "mul", "div", "min", "max", "lt", "ge"])
@pytest.mark.parametrize("left", [True, False])
def test_an_operation_with_a_constant_is_not_folded_wrong(op: str, constant: float, left: bool, size: int) -> None:
    t = vec(Base.F, size)
    arrays = values((t,))
    fixed = np.full_like(arrays[0], constant)
    pair = (lambda c, a: (c, a)) if left else (lambda c, a: (a, c))
    result = result_type(op, (t, t))
    found = run((t,), result, arrays, lambda b, i: b.let(op, *pair(b.const(t, [constant] * size), i[0])))
    check(found, expected_of(op, list(pair(fixed, arrays[0])), result), arrays)


@pytest.mark.parametrize("op", ["add", "mul", "sub"])
def test_a_vector_with_some_zeros_is_not_folded_wrong(op: str) -> None:
    t = vec(Base.F, 3)
    arrays = values((t,))
    fixed = np.broadcast_to(np.array([[0.0], [1.0], [-0.0]], np.float32), (3, N))
    found = run((t,), t, arrays, lambda b, i: b.let(op, i[0], b.const(t, [0.0, 1.0, -0.0])))
    check(found, expected_of(op, [arrays[0], fixed], t), arrays)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("base", "fiu")
def test_a_literal_is_exact(base: str) -> None:
    """Ten in a kernel: forty kernels took eight times as long."""
    t = vec(base)
    literals = special(t, moderate=False)[:40].astype(DTYPES[t.base])
    for part in (literals[k : k + 10] for k in range(0, len(literals), 10)):
        b = Builder("op")
        x = b.input(t, "x")
        for k, value in enumerate(part):
            b.store(b.output(t, f"r{k}"), b.let("cond", b.let("eq", x, x), b.const(t, [value]), x))
        outputs = tuple(np.zeros(1, DTYPES[t.base]) for _ in part)
        ports = tuple(Port(f"r{k}", "") for k in range(len(part)))
        module = Module("op", (Port("x", ""),), ports, (), (), (b.finish(),))
        call = Call((1,), (np.zeros(1, DTYPES[t.base]),), outputs, {}, {})
        assert backend.compile(module, Options()).run(call) is None
        check(np.concatenate(outputs), part, [part])


@pytest.mark.sampled(2)
@pytest.mark.parametrize("base", "fiub")
@pytest.mark.parametrize("size", [2, 3, 4])
def test_a_component_at_an_index_is_the_nearest(base: str, size: int) -> None:
    t = vec(base, size)
    arrays = values((t, vec("i")))
    expected = arrays[0][np.clip(arrays[1], 0, size - 1), np.arange(N)]
    found = run((t, vec("i")), t.scalar, arrays, lambda b, i: b.let("component", *i, type=t.scalar))
    check(found, expected, arrays)


@pytest.mark.parametrize("op", ["any_lane", "all_lanes"])
def test_an_element_is_alone(op: str) -> None:
    arrays = [np.resize([True, False], N)]
    check(run((vec("b"),), vec("b"), arrays, lambda b, i: b.let(op, *i, type=vec("b"))), arrays[0], arrays)


CUBED: dict[str, Any] = {
    "min": lambda y, x: sh.min(y, 0.5),
    "pow": lambda y, x: sh.pow(y, 0.3),
    "bits": lambda y, x: sh.bits_from_float(y),
    "int": lambda y, x: sh.Attrib1i(1e6 * y),
    "mix": lambda y, x: sh.mix(y, 0.3, x),
    "length": lambda y, x: sh.length(sh.vec3(x, y, 1) * 2.0),
    "cond": lambda y, x: sh.cond(y > 0.9 * (x * x * x), y, -y),
    "call": lambda y, x: halved(y),
    "call_by_reference": lambda y, x: halve(sh.Attrib1f(x), y),
}


@sh.subroutine
def halved(y: sh.Attrib1f) -> sh.Attrib1f:
    return 0.5 * y


@sh.subroutine
def halve(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
    x *= y
    return x


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", CUBED)
def test_operands_of_functions_and_choices_keep_their_order(name: str) -> None:
    """Mesa computed 0.9 * x * x * x in another order there."""

    @sh.program
    def of_cube(x: sh.Attrib1f):
        return CUBED[name](0.9 * x * x * x, x)

    sh.testing.assert_equivalent(of_cube, np.linspace(0, 1, 5000), backends=("numpy", "glsl"))


def test_what_glsl_leaves_open_of_ints_is_written_out():
    """clamp with bounds that cross, and the absolute value of the least int: NVIDIA's answers are its own."""

    @sh.program
    def bounded(i: sh.Attrib3i, k: sh.Attrib1u):
        near = sh.clamp(i, -3, 5)
        return sh.clamp(i, i.zxy, i.yzx), sh.clamp(k, 7, k >> 1), near, sh.abs(i), sh.abs(near)

    kernel = bounded.compile("glsl")
    for text in ("min(max(i, i.zxy), i.yzx)", "min(max(k, 7u), k >> 1)", "clamp(i, ivec3(-3), ivec3(5))", "sh_abs(i)"):
        assert text in kernel.source
    assert " abs(" in kernel.source  # of what cannot be the least int
    least = -(2**31)
    i, k = np.int32([[least, 5, -7], [1, least, 3], [2**31 - 1, 0, least]]), np.uint32([0, 40, 2**32 - 1])
    wanted = bounded.compile("numpy")(i, k)
    for found, expected in zip(kernel(i, k), wanted, strict=True):
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(wanted[0][0], np.minimum(np.maximum(i[0], i[0, [2, 0, 1]]), i[0, [1, 2, 0]]))
