"""Every row of the op table on OpenCL against its meaning, over special values and all sizes.

The conformance list runs each row, conversion and structural operation over more values in every run, so those here are
slow tests; what stays are operations beside constants.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from shpy.backend.base import Call, Options
from shpy.backend.opencl.device.building import backend
from shpy.ir import meaning
from shpy.ir.builder import Builder
from shpy.ir.constants import DTYPES
from shpy.ir.nodes import Module, Port, Value
from shpy.ir.ops import OPS, result_type
from shpy.ir.types import Base, Type, vec
from shpy.ir.verifier import verify
from shpy.testing.conformance.exact import exact

FLOATS = [0.0, -0.0, 1, -1, 0.5, -0.5, 1.5, 2.5, -2.5, 0.1, 3.7, -7.3, 1e-45, -1e-40, 1.1754944e-38, 1e10, -1e10, 2**31,
          -(2**31), 2**31 + 256, 2**32, 4294967040, 2**24 + 2, 65519.9, 65520, 6e-8, 2.9e-8, 1.7e38, 3.4028235e38,
          -3.4028235e38, np.inf, -np.inf, np.nan]  # fmt: skip
INTS = [
    0,
    1,
    -1,
    2,
    -2,
    3,
    -3,
    7,
    -7,
    31,
    32,
    33,
    63,
    12345,
    -54321,
    0x55555555,
    2**31 - 1,
    2**31 - 2,
    -(2**31),
    1 - 2**31,
]
SPECIAL = {
    Base.F: np.array(FLOATS, np.float64).astype(np.float32),
    Base.D: np.array([*FLOATS, 1e300, -1e-310, 5e-324], np.float64),
    Base.I: np.array(INTS, np.int64).astype(np.int32),
    Base.U: np.array(INTS, np.int64).astype(np.uint32),
    Base.B: np.array([False, True]),
}
ELEMENTS = 1500
SIZES = (1, 2, 3, 4)


def values(type: Type, which: int, of: int) -> Any:
    """Special values: all pairs for the first two scalar arguments, any for more; (size, n) for vectors."""
    special = SPECIAL[type.base]
    rng = np.random.default_rng(which)
    if type.size == 1 and which < 2 and of <= 2:
        pairs = np.stack(np.meshgrid(special, special), 0).reshape(2, -1)[which]
        return np.resize(pairs, ELEMENTS)
    shape = (ELEMENTS,) if type.size == 1 else (type.size, ELEMENTS)
    return rng.choice(special, shape)


@dataclass(frozen=True)
class Case:
    """One result to compute: argument types and arrays, (size, n) or (n,), what makes it, and what it must be."""

    types: tuple[Type, ...]
    result: Type
    arrays: list[Any]
    make: Callable[[Builder, list[Value]], Value]
    expected: Any


def check(*cases: Case) -> None:
    """Run all cases in one program, an output each, and compare."""
    b = Builder("ops")
    outputs = []
    for case in cases:
        inputs = [b.input(t) for t in case.types]
        outputs.append(np.zeros((ELEMENTS, case.result.size)[: min(case.result.size, 2)], DTYPES[case.result.base]))
        b.store(b.output(case.result), case.make(b, inputs))
    function = b.finish()
    ports = (
        tuple(Port(f"p{k}", "") for k in range(len(function.inputs))),
        tuple(Port(f"r{k}", "") for k in range(len(outputs))),
    )
    module = Module("ops", *ports, (), (), (function,))
    verify(module)
    flat = tuple(np.ascontiguousarray(a.T) for case in cases for a in case.arrays)
    assert backend.compile(module, Options()).run(Call((ELEMENTS,), flat, tuple(outputs), {}, {})) is None
    for case, out in zip(cases, outputs, strict=True):
        same(out.T, case.expected, case.arrays)


def same(found: Any, expected: Any, inputs: list[Any]) -> None:
    """Equal bits; every NaN is the same."""
    assert found.dtype == expected.dtype
    assert found.shape == expected.shape
    if found.dtype.kind == "f":
        equal = (found == expected) & (np.signbit(found) == np.signbit(expected)) | np.isnan(found) & np.isnan(expected)
    else:
        equal = found == expected
    wrong = np.argwhere(~equal)
    if len(wrong):
        at = tuple(wrong[0])
        given = [a[..., at[-1]] for a in inputs]
        pytest.fail(f"{len(wrong)} wrong; for {given} found {found[..., at[-1]]}, expected {expected[..., at[-1]]}")


def rows() -> list[Any]:
    found = []
    for name, op in OPS.items():
        for base in (b for b in "fdiub" if Base(b) in op.bases):
            for shift in "iu" if "X" in op.takes else "i":
                found.append(pytest.param(name, base, shift, id=f"{name}-{base}{shift if 'X' in op.takes else ''}"))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("name", "base", "shift"), rows())
def test_op(name: str, base: str, shift: str) -> None:
    cases = []
    for size in SIZES:
        types = OPS[name].arguments(vec(base, size), Base(shift))
        if types is None:
            continue
        result = result_type(name, types)
        arrays = [values(t, k, len(types)) for k, t in enumerate(types)]
        with np.errstate(all="ignore"):
            # A vector of one component, so that a sum over components is not one over elements.
            columns = [a if t.size > 1 else a[None] for a, t in zip(arrays, types, strict=True)]
            expected = np.broadcast_to(exact(name)(*columns), (result.size, ELEMENTS)).astype(DTYPES[result.base])
        expected = expected[0] if result.size == 1 else expected
        make = lambda b, inputs: b.let(name, *inputs)  # noqa: E731
        cases.append(Case(types, result, arrays, make, expected))
    check(*cases)


@pytest.mark.slow
@pytest.mark.parametrize(("source", "target"), [(s, t) for s in "fdiub" for t in "fdiub" if s != t])
def test_convert(source: str, target: str) -> None:
    cases = []
    for size in SIZES:
        a, t = vec(source, size), vec(target, size)
        arrays = [values(a, 0, 1)]
        with np.errstate(all="ignore"):
            expected = meaning.convert(arrays[0], DTYPES[t.base])
        cases.append(Case((a,), t, arrays, lambda b, i, t=t: b.let("convert", *i, type=t), expected))
    check(*cases)


@pytest.mark.slow
def test_half_rounds_to_binary16() -> None:
    cases = []
    for size in SIZES:
        t = vec(Base.F, size)
        arrays = [values(t, 0, 1)]
        with np.errstate(all="ignore"):
            expected = arrays[0].astype(np.float16).astype(np.float32)
        cases.append(Case((t,), t, arrays, lambda b, i, t=t: b.let("half", *i, type=t), expected))
    check(*cases)


@pytest.mark.slow
@pytest.mark.parametrize("base", "fdiub")
def test_vectors_are_taken_apart_and_put_together(base: str) -> None:
    cases = []
    for size in SIZES[1:]:
        t, order = vec(base, size), (1, 0, 1, 1)[:size]
        arrays = [values(t, 0, 1)]
        cases.append(Case((t,), t, arrays, lambda b, i, order=order: b.swizzle(i[0], order), arrays[0][list(order)]))

        def rebuilt(b: Builder, i: list[Value], t: Type = t, order: tuple[int, ...] = order) -> Value:
            return b.let("construct", *(b.swizzle(i[0], (k,)) for k in order), type=t)

        cases.append(Case((t,), t, arrays, rebuilt, arrays[0][list(order)]))
        scalar = [values(t.scalar, 0, 1)]
        splat = lambda b, i, size=size: b.splat(i[0], size)  # noqa: E731
        cases.append(Case((t.scalar,), t, scalar, splat, np.broadcast_to(scalar[0], (size, ELEMENTS))))
    check(*cases)


@pytest.mark.slow
@pytest.mark.parametrize("base", "fdiub")
def test_a_component_at_an_index_is_clamped(base: str) -> None:
    cases = []
    for size in SIZES[1:]:
        t = vec(base, size)
        arrays = [values(t, 0, 1), values(vec(Base.I), 1, 2)]
        expected = arrays[0][np.clip(arrays[1], 0, size - 1), np.arange(ELEMENTS)]
        pick = lambda b, i, t=t: b.let("component", *i, type=t.scalar)  # noqa: E731
        cases.append(Case((t, vec(Base.I)), t.scalar, arrays, pick, expected))
    check(*cases)


@pytest.mark.sampled(20)
@pytest.mark.parametrize("op", ["add", "sub", "mul"])
@pytest.mark.parametrize("constant", [-(2**31), -3, -1, 1, 2, 2**31 - 1])
def test_ints_wrap_beside_constants(op: str, constant: int) -> None:
    f = OPS[op].meaning
    assert f is not None
    cases = []
    for size in (1, 3):
        t = vec(Base.I, size)
        arrays = [values(t, 0, 1)]
        x, fixed = arrays[0], np.full_like(arrays[0], constant)
        for left in (True, False):

            def make(b: Builder, i: list[Value], t: Type = t, left: bool = left) -> Value:
                pair = [b.const(t, [constant] * t.size), i[0]]
                made = b.let(op, *(pair if left else pair[::-1]))
                return b.let("sub", made, b.let(op, made, i[0]))

            once = f(fixed, x) if left else f(x, fixed)
            cases.append(Case((t,), t, arrays, make, once - f(once, x)))
    check(*cases)


def test_a_sum_that_wraps_is_less() -> None:
    t = vec(Base.I)
    arrays = [values(t, 0, 1)]

    def make(b: Builder, i: list[Value]) -> Value:
        return b.let("gt", b.let("add", i[0], b.const(t, [1])), i[0])

    check(Case((t,), vec(Base.B), arrays, make, arrays[0] != 2**31 - 1))


@pytest.mark.slow
@pytest.mark.parametrize("base", "fdiu")
def test_literals_are_exact(base: str) -> None:
    t, special = vec(base, 4), SPECIAL[Base(base)]
    cases = []
    for k in range(0, len(special), 4):
        chunk = np.resize(special[k : k + 4], 4)
        constant = lambda b, _, c=chunk: b.const(t, c.tolist())  # noqa: E731
        cases.append(Case((), t, [], constant, np.repeat(chunk[:, None], ELEMENTS, 1)))
    check(*cases)
