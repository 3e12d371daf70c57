"""Conformance cases of operations: every row of the op table for every base and size, and every structural operation.

A row's case has one output for each size that it takes. Two scalars meet in all pairs of special values.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import shpy as sh
from shpy.backend.base import Array
from shpy.ir.builder import Builder
from shpy.ir.constants import DTYPES
from shpy.ir.nodes import Function, Module, Param, Port, Table, Value
from shpy.ir.ops import OPS, result_type
from shpy.ir.types import Base, Type, vec
from shpy.testing.conformance.cases import SPECIAL, Case
from shpy.testing.conformance.exact import exact

NO_DOUBLES = {"glsl": "has no 64-bit floats"}


def kind(type: Type) -> str:
    """Return the language type of an IR type: `Attrib3f`."""
    return f"Attrib{type.size}{type.base.value}"


def program(entry: Function, params: tuple[Param, ...] = (), tables: tuple[Table, ...] = (), *callees: Function) -> Any:
    """Return the program whose entry this is."""
    inputs = tuple(Port(str(i.name), kind(i.type)) for i in entry.inputs)
    outputs = tuple(Port(str(o.name), kind(o.type)) for o in entry.outputs)
    return sh.Program.from_ir(Module("operation", inputs, outputs, params, tables, (*callees, entry)))


def values(name: str, types: tuple[Type, ...], size: int) -> list[Array]:
    """Return an array for each argument: special values, in all pairs or by random choice, then ordinary numbers."""
    rng = np.random.default_rng(size)
    pools = [SPECIAL[t.base] for t in types]
    if size == 1 and len(types) <= 2:
        arrays = [a.ravel() for a in np.meshgrid(*pools)]
    else:
        arrays = [rng.choice(p, (600, t.size) if t.size > 1 else 600) for p, t in zip(pools, types, strict=True)]
    extended = [np.concatenate([a, ordinary(rng, a)]) for a in arrays]
    if name == "ldexp":
        extended = [np.concatenate(pair) for pair in zip(extended, beside_ties(types[0], rng), strict=True)]
    return extended


def beside_ties(type: Type, rng: Any, count: int = 400) -> tuple[Array, Array]:
    """Return floats and exponents whose `ldexp` is a denormal, or a number beside one, that is nearly a tie.

    A target that rounds twice on the way gets some of these wrong.
    """
    info = np.finfo(DTYPES[type.base])
    digits, last_place = info.nmant + 1, info.minexp - info.nmant
    shape = (count, type.size) if type.size > 1 else (count,)
    lost = rng.integers(1, digits + 3, shape)
    whole = rng.integers(0, 2**digits, shape) >> lost << lost
    mantissa = (whole + (1 << (lost - 1)) + rng.integers(-2, 3, shape)) * rng.choice([-1, 1], shape)
    raised = rng.integers(-digits, info.maxexp - digits - 2, shape)
    x = np.ldexp(mantissa.astype(np.float64), raised).astype(info.dtype)
    return x, (last_place - lost - raised).astype(np.int32)


def ordinary(rng: Any, like: Array) -> Array:
    """Return 200 elements such as programs compute with."""
    shape = (200, *like.shape[1:])
    if like.dtype.kind == "f":
        return np.asarray(rng.standard_normal(shape) * 10.0 ** rng.integers(-2, 3, shape), like.dtype)
    return np.asarray(rng.integers(0, 2 if like.dtype == bool else 100, shape), like.dtype)


def row_case(name: str, base: str, count: str) -> Case | None:
    """Return the case of one row of the table for one base."""
    arguments = {n: OPS[name].arguments(vec(base, n), Base(count)) for n in (1, 2, 3, 4)}
    sizes = {n: types for n, types in arguments.items() if types is not None}
    if not sizes:
        return None
    b = Builder("operation")
    arrays: dict[str, Any] = {}
    results = []
    for size, types in sizes.items():
        ports = [b.input(t, f"{'abc'[k]}{size}") for k, t in enumerate(types)]
        for i, array in zip(ports, values(name, types, size), strict=True):
            arrays[str(i.name)] = array
        results.append(b.let(name, *ports))
    for size, value in zip(sizes, results, strict=True):
        b.store(b.output(value.type, f"r{size}"), value)
    function = b.finish()
    shifted = f"-{count}" if "X" in OPS[name].takes else ""
    longest = max(len(a) for a in arrays.values())
    inputs = {n: a[np.arange(longest) % len(a)] for n, a in arrays.items()}

    def meaning(arrays: Mapping[str, Array]) -> list[Array]:
        return [meant(name, types, [arrays[f"{'abc'[k]}{n}"] for k in range(len(types))]) for n, types in sizes.items()]

    refused = NO_DOUBLES if base == "d" else {}
    return Case(f"{name}-{base}{shifted}", lambda: program(function), inputs, refused=refused, meaning=meaning)


def meant(name: str, types: tuple[Type, ...], arrays: list[Array]) -> Array:
    """Return the exact result of an operation, by its row in the table, for arrays (n,) or (n, size)."""
    result = result_type(name, types)
    # A vector of one component, so that a sum over components is not one over elements.
    columns = [a.T if a.ndim > 1 else a[None] for a in arrays]
    with np.errstate(all="ignore"):
        exact_values = np.asarray(exact(name)(*columns)).astype(DTYPES[result.base])
    whole = np.broadcast_to(exact_values, (result.size, len(arrays[0])))
    return whole[0] if result.size == 1 else np.ascontiguousarray(whole.T)


def rows() -> list[Case]:
    """Return every row of the table with every base."""
    row_cases = []
    for name, op in OPS.items():
        for base in (b for b in "fdhiub" if Base(b) in op.bases):
            for count in "iu" if "X" in op.takes else "i":
                case = row_case(name, base, count)
                if case is not None:
                    row_cases.append(case)
    return row_cases


# Structural operations


def _input(b: Builder, type: Type, name: str, seed: int, arrays: dict[str, Any]) -> Value:
    special = SPECIAL[type.base]
    count = 3 * len(SPECIAL[Base.F])
    rng = np.random.default_rng(seed)
    first = np.resize(special, count)
    arrays[name] = first if type.size == 1 else np.stack([first, *rng.choice(special, (type.size - 1, count))], -1)
    return b.input(type, name)


def structural(
    name: str,
    b: Builder,
    results: list[Value],
    arrays: dict[str, Any],
    bases: str = "",
    params: tuple[Param, ...] = (),
    tables: tuple[Table, ...] = (),
    *callees: Function,
) -> Case:
    """Return the case of a builder whose outputs are these values; `bases` says whether there are doubles."""
    for n, value in enumerate(results):
        b.store(b.output(value.type, f"r{n}"), value)
    function = b.finish()
    refused = NO_DOUBLES if "d" in bases else {}
    return Case(name, lambda: program(function, params, tables, *callees), arrays, refused=refused)


def convert_case(source: str, target: str) -> Case:
    """Return a conversion between two bases, for every size."""
    b = Builder("operation")
    arrays: dict[str, Any] = {}
    results = [
        b.let("convert", _input(b, vec(source, n), f"a{n}", n, arrays), type=vec(target, n)) for n in (1, 2, 3, 4)
    ]
    return structural(f"convert-{source}-{target}", b, results, arrays, source + target)


def vector_case(base: str) -> Case:
    """Return the case of construct, splat, swizzle and component for every size."""
    b = Builder("operation")
    arrays: dict[str, Any] = {}
    scalar = _input(b, vec(base), "s", 0, arrays)
    index = _input(b, vec(Base.I), "i", 9, arrays)
    results = []
    for n in (2, 3, 4):
        t = vec(base, n)
        v = _input(b, t, f"v{n}", n, arrays)
        parts = [scalar, v] if n < 4 else [b.swizzle(v, (3, 0)), b.swizzle(v, (1,)), scalar]
        results.append(b.let("construct", *parts, type=vec(base, min(n + 1, 4))))
        results.append(b.splat(scalar, n))
        results.append(b.swizzle(v, (n - 1, 0, 0, 1)))
        results.append(b.let("component", v, index, type=t.scalar))
    return structural(f"vectors-{base}", b, results, arrays, base)


LONG_OPS = (
    *("add", "sub", "mul", "div", "neg", "abs", "min", "max", "lt", "eq", "cond", "and", "not", "shl", "floordiv"),
    *("floor", "sqrt", "clamp", "float_from_bits", "bits_from_float", "sin", "dot", "any", "all"),
)


def long_case(base: str, name: str) -> Case | None:
    """Return the case of one operation on vectors of eight, which are made and taken apart inside of a program."""
    types = OPS[name].arguments(vec(base, 8))
    if types is None:
        return None
    b = Builder("operation")
    arrays: dict[str, Any] = {}
    args = []
    for k, t in enumerate(types):
        halves = [_input(b, t.sized(4), f"{'abc'[k]}{n}", 2 * k + n, arrays) for n in range(2)]
        args.append(b.let("construct", *halves, type=t))
    result = b.let(name, *args)
    whole = result.type.size > 1
    outputs = [b.swizzle(result, (0, 1, 2, 3)), b.swizzle(result, (7, 6, 5, 4))] if whole else [result]
    return structural(f"long-{name}-{base}", b, outputs, arrays, base)


def long_vector_case(base: str) -> Case:
    """Return the case of vectors of eight in variables, arrays and loops: swizzles, stores and components."""
    b = Builder("operation")
    arrays: dict[str, Any] = {}
    index = _input(b, vec(Base.I), "i", 9, arrays)
    halves = [_input(b, vec(base, 4), f"v{n}", n, arrays) for n in range(2)]
    long = vec(base, 8)
    v = b.let("construct", *halves, type=long)
    slot, many = b.variable(long, name="slot"), b.variable(long, 3, name="many")
    b.store(slot, v)
    with b.when(b.let("gt", index, b.const(vec(Base.I), [1]))):
        b.store(slot, b.swizzle(v, (7, 6)), (4, 1))
        b.store(many, b.swizzle(b.load(slot), (1, 0, 3, 2, 5, 4, 7, 6)), index=b.const(vec(Base.I), [1]))
    with b.otherwise():
        b.store(many, b.let("component", v, index, type=long.scalar), (5,), index=index)
    element = b.load(many, index)
    rest = [b.swizzle(b.load(slot), (4, 0, 1, 7)), b.swizzle(element, (5, 6, 7)), b.swizzle(element, (2,))]
    picked = b.let("component", b.load(slot), index, type=long.scalar)
    return structural(f"long-vectors-{base}", b, [*rest, picked], arrays, base)


def constant_case(base: str) -> Case:
    """Return the case of every special value as a constant: alone, and in a vector."""
    b = Builder("operation")
    arrays: dict[str, Any] = {}
    which = _input(b, vec(Base.I), "n", 0, arrays)
    special = SPECIAL[Base(base)].tolist()
    arrays["n"] = np.arange(len(special), dtype=np.int32)
    one, four = b.variable(vec(base), name="one"), b.variable(vec(base, 4), name="four")
    for n, value in enumerate(special):
        with b.when(b.let("eq", which, b.const(vec(Base.I), [n]))):
            b.store(one, b.const(vec(base), [value]))
            b.store(four, b.const(vec(base, 4), [value, special[0], value, special[-1]]))
    return structural(f"const-{base}", b, [b.load(one), b.load(four)], arrays, base)


def load_case(base: str) -> Case:
    """Arrays of scalars and vectors, in range and out of it."""
    b = Builder("operation")
    arrays: dict[str, Any] = {}
    i, j = _input(b, vec(Base.I), "i", 1, arrays), _input(b, vec(Base.I), "j", 2, arrays)
    arrays["j"] = arrays["j"][::-1] % 7 - 1
    results = []
    for n in (1, 3):
        v = _input(b, vec(base, n), f"v{n}", n, arrays)
        slot = b.variable(v.type, 5, f"array{n}")
        for k in range(3):
            b.store(slot, v, index=b.const(vec(Base.I), [2 * k]))
        b.store(slot, v, index=i)
        if n == 3:
            b.store(slot, b.swizzle(v, (2, 0)), (0, 1), index=j)
        results += [b.load(slot, i), b.load(slot, j)]
    return structural(f"load-{base}", b, results, arrays, base)


def param_case(base: str) -> Case:
    """Params of every size, with their initial values."""
    from shpy.ir.constants import encode

    b = Builder("operation")
    arrays: dict[str, Any] = {}
    params, outputs = [], []
    for n in (1, 2, 3, 4):
        t, name = vec(base, n), f"p{n}"
        params.append(Param(name, kind(t), t, encode(t, np.resize(SPECIAL[t.base][-4:], n).tolist())))
        variable = _input(b, t, f"v{n}", n, arrays)
        param = b.let("param", type=t, attr=name)
        outputs.append(param)
        outputs.append(b.let("cond", b.let("eq", variable, param), param, variable))
    return structural(f"param-{base}", b, outputs, arrays, base, tuple(params))


def table_case(base: str, size: int, rank: int) -> Case:
    """Return a table of a type and rank: elements at indices in range and out of it, and its size."""
    t = vec(base, size)
    extents = (2, 3, 5)[:rank]
    special = SPECIAL[t.base]
    data = np.random.default_rng(rank).choice(special, (*extents, size) if size > 1 else extents)
    b = Builder("operation")
    arrays: dict[str, Any] = {}
    table = Table("table", t, rank)
    index = _input(b, vec(Base.I, rank), "index", rank, arrays)
    small = np.random.default_rng(rank).integers(-2, 7, arrays["index"].shape)
    arrays["index"] = np.where(np.arange(small.shape[0]).reshape(-1, *[1] * (rank > 1)) % 3 > 0, small, arrays["index"])
    arrays["table"] = data
    results = [b.let("table", index, type=t, attr="table"), b.let("table_size", type=vec(Base.I, rank), attr="table")]
    return structural(f"table-{t}-{rank}d", b, results, arrays, base, (), (table,))


def grid_case(rank: int) -> Case:
    """Return the case of grid_index and grid_shape of a grid of this many axes."""
    b = Builder("operation")
    case = structural(
        f"grid-{rank}d", b, [b.let(op, type=vec(Base.I, rank)) for op in ("grid_index", "grid_shape")], {}
    )
    case.shape = (3, 2, 5, 7)[:rank]
    return case


def half_case() -> Case:
    """Return the case of every binary16, the values halfway between two, and those just beside."""
    halves = np.arange(65536, dtype=np.uint16).view(np.float16).astype(np.float32)
    halves = np.sort(halves[np.isfinite(halves)])[::7]
    between = (halves[1:] + halves[:-1]) / 2
    numbers = np.concatenate([halves, between, np.nextafter(between, np.float32(0)), SPECIAL[Base.F]])
    b = Builder("operation")
    rounded = b.let("half", b.input(vec("f"), "x"), type=vec("f"))
    return structural("half", b, [rounded], {"x": numbers.astype(np.float32)})


def call_case() -> Case:
    """Return a pure function, called twice."""
    callee = Builder("twice")
    callee.pure = True
    x = callee.input(vec("f", 3), "x")
    callee.store(callee.output(vec("f", 3), "r"), callee.let("add", x, x))
    function = callee.finish()
    b = Builder("operation")
    arrays: dict[str, Any] = {}
    v = _input(b, vec("f", 3), "v", 3, arrays)
    return structural("call", b, [*b.call(function, *b.call(function, v))], arrays, "", (), (), function)


def lanes_case() -> Case:
    """Return the case that other lanes may change which branch is taken, and never the result."""
    b = Builder("operation")
    arrays: dict[str, Any] = {}
    c = _input(b, vec(Base.B), "c", 0, arrays)
    result = b.variable(vec(Base.I), name="result")
    one, two = (b.const(vec(Base.I), [n]) for n in (1, 2))
    with b.when(b.let("any_lane", c, type=vec(Base.B))):
        b.store(result, b.let("cond", c, one, two))
    with b.otherwise():
        b.store(result, two)
    with b.when(b.let("all_lanes", c, type=vec(Base.B))):
        b.store(result, b.let("add", b.load(result), one))
    with b.otherwise(), b.when(c):
        b.store(result, two)
    return structural("lanes", b, [b.load(result)], arrays)


def extremes_case(base: str) -> Case:
    """Return the case that no element is beyond the least and the greatest of those that run with it."""
    b = Builder("operation")
    arrays: dict[str, Any] = {}
    x = _input(b, vec(base), "x", 0, arrays)
    x = b.let("cond", b.let("eq", x, x), x, b.const(x.type, [1]))  # a NaN may count or not
    bounds = [b.let("le", b.let("min_lane", x, type=x.type), x), b.let("ge", b.let("max_lane", x, type=x.type), x)]
    return structural(f"extremes-{base}", b, bounds, arrays, base)


ROWS = rows()


def cases() -> list[Case]:
    """Return every operation."""
    all_cases = list(ROWS)
    all_cases += [convert_case(a, b) for a in "fdhiub" for b in "fdhiub" if a != b]
    all_cases += [case for name in LONG_OPS for base in "fdiub" if (case := long_case(base, name))]
    for make in (vector_case, long_vector_case, constant_case, load_case, param_case):
        all_cases += [make(base) for base in "fdhiub"]
    all_cases += [table_case(base, size, rank) for base in "fiub" for size in (1, 2, 3, 4) for rank in (1, 2, 3)]
    all_cases += [table_case("d", 3, 2), table_case("h", 2, 1), *map(grid_case, (1, 2, 3, 4))]
    return [*all_cases, half_case(), call_case(), lanes_case(), *map(extremes_case, "fdhiu")]
