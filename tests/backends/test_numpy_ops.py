"""Every row of the op table as numpy text, against its meaning: operands varying, uniform, literal and splatted."""

import itertools
import tracemalloc

import numpy as np
import pytest

from shpy.backend.base import Call, Options
from shpy.backend.numpy.device.run import backend
from shpy.backend.numpy.lanes import MANY, dot, maximum, minimum, select
from shpy.ir import meaning
from shpy.ir.builder import Builder
from shpy.ir.constants import DTYPES, from_array
from shpy.ir.nodes import Module, Param, Port
from shpy.ir.ops import OPS, result_type
from shpy.ir.types import Base, vec
from shpy.testing.conformance.exact import exact

FLOATS = [0.0, -0.0, 1.0, -1.0, 0.5, 2.5, -2.5, 1e-45, 1e-30, 3e38, np.inf, -np.inf, np.nan, 0.1, -7.3, 2147483648.0]
INTS = [0, 1, -1, 2, -3, 31, 32, 33, 2**31 - 1, -(2**31), 7, -7]
VALUES = {
    Base.F: np.array(FLOATS, np.float32),
    Base.D: np.array(FLOATS, np.float64),
    Base.I: np.array(INTS, np.int64).astype(np.int32),
    Base.U: np.array(INTS, np.int64).astype(np.uint32),
    Base.B: np.array([False, True]),
}
KINDS = ("varying", "uniform", "literal", "splat")


def operand(type, kind, rng):
    """Data for an operand: (n, size) or (n,) with n = 1 for all but the varying; a splat has equal components."""
    pool = VALUES[type.base]
    lanes = 64 if kind == "varying" else 1
    data = rng.choice(pool, (lanes, 1 if kind == "splat" else type.size))
    return np.broadcast_to(data, (lanes, type.size)) if type.size > 1 else data[:, 0]


def run(types, kinds, data, make, result):
    b = Builder("program")
    args, inputs, ports, params = [], [], [], []
    for n, (type, kind, given) in enumerate(zip(types, kinds, data, strict=True)):
        if kind == "varying":
            args.append(b.input(type, f"x{n}"))
            inputs.append(np.ascontiguousarray(given))
            ports.append(Port(f"x{n}", "any"))
        elif kind == "uniform":
            params.append(Param(f"p{n}", "any", type, from_array(type, given[0])))
            args.append(b.let("param", type=type, attr=f"p{n}"))
        elif kind == "splat" and type.size > 1:
            args.append(b.splat(b.const(type.scalar, [given[0, 0]]), type.size))
        else:
            args.append(b.const(type, np.atleast_1d(given[0])))
    b.store(b.output(result, "out"), make(b, args))
    module = Module("program", tuple(ports), (Port("out", "any"),), tuple(params), (), (b.finish(),))
    out = np.zeros((64, result.size) if result.size > 1 else 64, DTYPES[result.base])
    given_params = {p.name: data[int(p.name[1:])][0] for p in params}
    backend.compile(module, Options()).run(Call((64,), tuple(inputs), (out,), given_params, {}))
    return out


@pytest.mark.parametrize("base", VALUES, ids=lambda base: base.name)
@pytest.mark.parametrize("lanes", [30, 5000])
def test_selects_of_many_lanes_are_those_of_few(lanes, base):
    rng = np.random.default_rng(3)
    a, b = (rng.choice(VALUES[base], (3, lanes)) for _ in "ab")
    mask = rng.random(lanes) < 0.4
    for x, y in ((a, b), (a[0], b[0]), (a[0, 0], b[0]), (a, b[:, :1]), (a[0], b[0, 0]), (a[0], VALUES[base][0].item())):
        found = select(mask, x, y)
        assert found.dtype == a.dtype
        assert found.tobytes() == np.where(mask, x, y).astype(a.dtype).tobytes()
    if base is not Base.B:
        for ours, table in ((minimum, meaning.minimum), (maximum, meaning.maximum)):
            assert ours(a, b).tobytes() == table(a, b).tobytes()


def assert_equal(found, expected, told):
    if found.dtype.kind != "f":
        np.testing.assert_array_equal(found, expected, told)
        return
    nan = np.isnan(found) & np.isnan(expected)
    good = nan | (found.view(f"u{found.dtype.itemsize}") == expected.view(f"u{found.dtype.itemsize}"))
    assert good.all(), f"{told}: {found[~good][:4]} instead of {expected[~good][:4]}"


def argument_types(op):
    """Some lists of argument types that the row takes."""
    arity = len(OPS[op].takes)
    found = []
    for base in (Base.F, Base.D, Base.I, Base.U, Base.B):
        for size in (1, 3, 2):
            t = vec(base, size)
            choices = (t, t.scalar, t.based(Base.B), t.based(Base.I), t.based(Base.U))
            for types in itertools.product(dict.fromkeys(choices), repeat=arity):
                try:
                    result_type(op, types)
                except TypeError:
                    continue
                if types[0].base is base or op == "cond":
                    found.append(types)
    return list(dict.fromkeys(found))


@pytest.mark.sampled(8)
@pytest.mark.parametrize("op", OPS)
def test_an_operation_means_what_the_table_says(op):
    rng = np.random.default_rng(len(op))
    types_taken = argument_types(op)
    assert types_taken
    for types in types_taken:
        result = result_type(op, types)
        for kinds in itertools.product(KINDS, repeat=len(types)):
            if kinds.count("varying") == 0 and rng.random() < 0.7:
                continue
            if len(types) == 3 and rng.random() < 0.8:
                continue
            data = [operand(t, k, rng) for t, k in zip(types, kinds, strict=True)]
            found = run(types, kinds, data, lambda b, args: b.let(op, *args), result)
            lanes = [np.broadcast_to(d, (64, *d.shape[1:])) for d in data]
            with np.errstate(all="ignore"):
                if op in ("any", "all") and types[0].size == 1:
                    expected = lanes[0]
                elif types[0].size == 1 and op in ("dot", "length", "distance", "normalize", "reflect", "refract"):
                    expected = element_by_element(op, lanes, result)
                elif types[0].size == 1 and op == "faceforward":
                    expected = element_by_element(op, lanes, result)
                else:
                    expected = np.asarray(exact(op)(*(np.array(a.T) for a in lanes))).T
            assert_equal(found, np.ascontiguousarray(expected), f"{op} {types} {kinds}")


def element_by_element(op, lanes, result):
    """Evaluate an operation on vectors for scalars: its definition takes one element as an array without axes."""
    each = [OPS[op].meaning(*(np.asarray(a[n]) for a in lanes)) for n in range(64)]
    return np.array(each, DTYPES[result.base])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("target", "fdiub")
@pytest.mark.parametrize("source", "fdiub")
@pytest.mark.parametrize("size", [1, 3])
def test_convert(source, target, size, kind):
    if source == target:
        return
    rng = np.random.default_rng(1)
    type, result = vec(source, size), vec(target, size)
    data = operand(type, kind, rng)
    found = run([type], [kind], [data], lambda b, args: b.let("convert", *args, type=result), result)
    with np.errstate(all="ignore"):
        expected = meaning.convert(np.broadcast_to(data, (64, *data.shape[1:])), DTYPES[result.base])
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("kinds", list(itertools.product(KINDS[:3], repeat=2)))
def test_components_at_an_index_are_clamped(kinds):
    rng = np.random.default_rng(2)
    types = [vec("f", 3), vec("i")]
    data = [operand(types[0], kinds[0], rng), rng.integers(-2, 5, 64 if kinds[1] == "varying" else 1, np.int32)]
    found = run(types, kinds, data, lambda b, args: b.let("component", *args, type=vec("f")), vec("f"))
    vectors, index = np.broadcast_to(data[0], (64, 3)), np.broadcast_to(data[1], 64)
    np.testing.assert_array_equal(found, vectors[np.arange(64), np.clip(index, 0, 2)])


@pytest.mark.parametrize("kinds", list(itertools.product(KINDS[:3], repeat=2)))
def test_construct_and_swizzle(kinds):
    rng = np.random.default_rng(3)
    types = [vec("i"), vec("i", 2)]
    data = [operand(t, k, rng) for t, k in zip(types, kinds, strict=True)]

    def make(b, args):
        whole = b.let("construct", args[1], args[0], type=vec("i", 3))
        return b.swizzle(whole, [2, 0, 0, 1])

    found = run(types, kinds, data, make, vec("i", 4))
    scalars, pairs = np.broadcast_to(data[0], 64), np.broadcast_to(data[1], (64, 2))
    np.testing.assert_array_equal(found, np.stack([scalars, pairs[:, 0], pairs[:, 0], pairs[:, 1]], -1))


def test_a_dot_product_of_many_lanes_keeps_one_product_at_a_time():
    a, b = np.random.default_rng(4).normal(size=(2, 4, 2 * MANY)).astype(np.float32)
    tracemalloc.start()
    found = dot(a, b)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_array_equal(found, meaning.dot(a, b))
    assert peak < 3 * found.nbytes  # the sum and a product; all products would be four
