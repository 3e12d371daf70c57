"""Chains give what their kernels give one by one on host arrays, bit for bit."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from loop_stops import stops_loops

import shpy as sh
from shpy.chains.member import stream_names

BACKENDS = ["numpy", "opencl", "glsl"]
on_every_backend = pytest.mark.parametrize("backend", BACKENDS)


@sh.program
def move(x: sh.Attrib1f, v: sh.Attrib1f):
    return {"x": x + 0.25 * v}


@sh.program
def swing(x: sh.Attrib1f, v: sh.Attrib1f):
    return {"v": v - 0.125 * x, "x": x * 0.75}


@sh.program
def blur(x: sh.Table[sh.Attrib1f, 1]) -> sh.Attrib1f:
    i = sh.grid_index(1)
    return 0.5 * x[i] + 0.25 * (x[i - 1] + x[i + 1])


@sh.program
def shift(v: sh.Attrib1f, x: sh.Table[sh.Attrib1f, 1]):
    return {"v": v + x[sh.grid_index(1) + 1], "x": v}


@sh.program
def wear(x: sh.Attrib1f, n: sh.Attrib1i):
    sh.SH_DISCARD(n >= 6)
    return {"n": n + 1, "x": x + 1}


@sh.program
def count_up(n: sh.Attrib1i, limit: sh.Attrib1i, x: sh.Table[sh.Attrib1f, 1]):
    sh.SH_DISCARD(n >= limit)
    return {"n": n + 1 + sh.Attrib1i(sh.min(sh.abs(x[n]), 2.0))}


@sh.program
def stamp(x: sh.Table[sh.Attrib1f, 1], k: sh.Attrib1i) -> sh.Attrib1f:
    return 0.5 * x[sh.grid_index(1) + k] + sh.Attrib1f(k)


@sh.program
def tick(n: sh.Attrib1i, k: sh.Attrib1i):
    sh.SH_DISCARD((n >= 6) | ((n + k) % 3 == 0))
    return {"n": n + 1}


@sh.program
def is_even(n: sh.Attrib1i) -> sh.Attrib1b:
    return n % 2 == 0


ALL = (move, swing, blur, shift, wear, count_up, stamp, tick)
REJECTING = (wear, count_up, tick)


def chains(members):
    """Trees of sequences and repeats over members; a repeat with an index counts its passes in k."""
    nest = lambda inner: st.one_of(  # noqa: E731
        st.lists(inner, min_size=1, max_size=3).map(lambda parts: ("sequence", parts)),
        st.tuples(st.just("repeat"), inner, st.integers(0, 4), st.booleans()).map(counted),
    )
    return st.recursive(members, nest, max_leaves=5)


def loops():
    inner = st.one_of(st.sampled_from(REJECTING), decided_loops(REJECTING))
    return st.tuples(st.just("loop"), chains(inner), st.booleans()).map(counted)


def decided_loops(members):
    """Loops that one member decides; the others may write every element. A decider raises n; no member lowers it."""
    decider = st.sampled_from(REJECTING)
    parts = st.tuples(
        st.lists(st.sampled_from(members), max_size=2), decider, st.lists(st.sampled_from(members), max_size=1)
    )
    return st.tuples(parts, st.booleans()).map(
        lambda drawn: counted(("until", (*drawn[0][0], drawn[0][1], *drawn[0][2]), drawn[0][1].name, drawn[1]))
    )


def reads(tree):
    """Return whether a kernel reads k that no repeat or loop in the tree counts."""
    match tree:
        case ("sequence", parts):
            return any(map(reads, parts))
        case ("until", parts, _, index):
            return index is None and any(map(reads, parts))
        case (_, body, *_, index):
            return index is None and reads(body)
    return "k" in tree.inputs


def counted(tree):
    *first, wants = tree
    parts = tree[1] if tree[0] == "until" else (tree[1],)
    return (*first, "k" if wants and any(map(reads, parts)) else None)


def built(tree):
    match tree:
        case ("sequence", parts):
            return sh.sequence(*map(built, parts))
        case ("repeat", body, times, index):
            return sh.repeat(built(body), times, index=index)
        case ("loop", body, index):
            return sh.loop(built(body), index=index)
        case ("until", parts, decider, index):
            return sh.loop(*parts, index=index, until=decider)
    return tree


def names_of(program):
    if program.outputs.keys() == {"0"}:
        return [next(name for name, type_ in program.inputs.items() if name in ("x", "n"))]
    return list(program.outputs)


class OneByOne:
    """The same over host arrays: every kernel is called, and its outputs take the place of the arrays."""

    def __init__(self, backend, arrays, precision="f32"):
        self.backend, self.precision = backend, precision
        self.arrays = {name: np.array(array) for name, array in arrays.items()}
        self.executions, self.counts, self.numbers = {}, {}, []

    def run(self, tree):
        """Run a tree; returns how many elements were written."""
        match tree:
            case ("sequence", parts):
                return sum([self.run(part) for part in parts])
            case ("repeat", body, times, index):
                return sum([self.run_pass(body, index, k) for k in range(times)])
            case ("loop", body, index):
                total = 0
                for k in itertools.count():
                    written = self.run_pass(body, index, k)
                    total += written
                    if not written:
                        return total
            case ("until", parts, decider, index):
                total = 0
                for k in itertools.count():
                    written = [self.run_pass(part, index, k) for part in parts]
                    total += sum(written)
                    if not any(n for part, n in zip(parts, written, strict=True) if part.name == decider):
                        return total
        inputs = {name: self.arrays[name] for name in tree.inputs}
        if "k" in inputs and self.numbers:
            inputs["k"] = self.numbers[-1]
        names = names_of(tree)
        out = {name: self.arrays[name].copy() for name in names}
        whole = out if tree.outputs.keys() != {"0"} else out[names[0]]
        kernel = tree.compile(self.backend, precision=self.precision)
        result = kernel.run(**inputs, out=whole, shape=self.arrays["x"].shape)
        self.arrays |= out
        self.executions[tree.name] = self.executions.get(tree.name, 0) + 1
        self.counts[tree.name] = self.counts.get(tree.name, 0) + result.count
        return result.count

    def run_pass(self, body, index, k):
        if index is None:
            return self.run(body)
        self.numbers.append(k)
        written = self.run(body)
        self.numbers.pop()
        return written


def check(tree, backend, arrays):
    expected = OneByOne(backend, arrays)
    expected.run(tree)
    chain = built(tree)
    if not isinstance(chain, sh.Chain):
        chain = sh.sequence(chain)
    known = {name: array for name, array in arrays.items() if name in stream_names(chain.steps)}
    for kernel in chain.kernels:
        known |= {name: arrays[name] for name, _ in kernel.outputs}
    result = chain.run(**known, backend=backend)
    for name, stream in result.streams.items():
        array = stream.numpy()
        np.testing.assert_array_equal(array.view(np.int32), expected.arrays[name].view(np.int32), err_msg=name)
    assert {n: k for n, k in result.executions.items() if k} == expected.executions
    assert {n: k for n, k in result.counts.items() if result.executions[n]} == expected.counts


def data(seed, size):
    rng = np.random.default_rng(seed)
    return {
        "x": rng.normal(size=size).astype(np.float32),
        "v": rng.normal(size=size).astype(np.float32),
        "n": rng.integers(0, 8, size).astype(np.int32),
        "limit": rng.integers(0, 12, size).astype(np.int32),
        "k": rng.integers(-4, 4, size).astype(np.int32),
    }


TREES = chains(st.one_of(st.sampled_from(ALL), loops(), decided_loops(ALL)))


@pytest.mark.sampled(3)
@on_every_backend
@settings(max_examples=12)
@given(tree=TREES, seed=st.integers(0, 9), size=st.sampled_from([1, 2, 7, 64, 131]))
def test_random_chains_give_what_their_kernels_give_one_by_one(backend, tree, seed, size):
    check(tree, backend, data(seed, size))


@pytest.mark.sampled(3)
@on_every_backend
def test_a_table_reads_what_the_stream_held_before(backend):
    x = np.array([1, 0, 0, 0, 0], np.float32)
    result = sh.repeat(blur, 2).run(x=x, backend=backend)
    np.testing.assert_array_equal(result.streams["x"], [0.625, 0.3125, 0.0625, 0, 0])


@on_every_backend
def test_what_is_given_keeps_its_elements(backend):
    x = sh.Stream([1.0, 2.0], sh.Attrib1f, backend=backend)
    v = np.array([4, 4], np.float32)
    chain = sh.repeat(swing, 3)
    first, second = (chain.run(x=x, v=v).streams for _ in range(2))
    np.testing.assert_array_equal(x, [1, 2])
    np.testing.assert_array_equal(v, [4, 4])
    np.testing.assert_array_equal(first["x"], second["x"])
    assert first["x"] is not second["x"]
    assert first["x"].backend == backend


@on_every_backend
def test_a_chain_of_no_executions_gives_copies(backend):
    x = sh.Stream([1.0, 2.0], sh.Attrib1f, backend=backend)
    result = sh.repeat(blur, 0).run(x=x)
    assert result.executions == {"blur": 0}
    assert result.counts == {"blur": 0}
    result.streams["x"].update([5, 5])
    np.testing.assert_array_equal(x, [1, 2])


@pytest.mark.sampled(3)
@on_every_backend
def test_numbers_and_params_hold_for_every_element(backend):
    speed = sh.Param(sh.Attrib1f, 8)
    chain = sh.repeat(move, 2)
    np.testing.assert_array_equal(chain.run(x=[0.0, 1.0], v=speed, backend=backend).streams["x"], [4, 5])
    speed.value = 16
    np.testing.assert_array_equal(chain.run(x=[0.0, 1.0], v=speed, backend=backend).streams["x"], [8, 9])
    # A number that kernels replace becomes a stream.
    result = sh.loop(wear).run(x=[0.0, 1.0, 2.0], n=3, backend=backend)
    np.testing.assert_array_equal(result.streams["n"], [6, 6, 6])
    np.testing.assert_array_equal(result.streams["x"], [3, 4, 5])


@sh.struct
class Ray:
    """A ray on its way."""

    at: sh.Point3f
    along: sh.Vector3f
    left: sh.Attrib1i


@sh.program
def generate():
    i = sh.Attrib1f(sh.grid_index(1))
    return {"rays": Ray(sh.Point3f(i, 0, 0), sh.Vector3f(0, 1, 0.5), sh.Attrib1i(i) % 3 + 1)}


@sh.program
def traverse(rays: Ray, heights: sh.Table[sh.Attrib1f, 1]) -> Ray:
    sh.SH_DISCARD(rays.left == 0)
    step = heights[rays.left]
    return Ray(rays.at + step * rays.along, rays.along, rays.left - 1)


@pytest.mark.sampled(3)
@on_every_backend
def test_structs_and_tables(backend):
    chain = sh.sequence(generate, sh.loop(traverse))
    result = chain.run(shape=5, heights=[1, 2, 4, 8], backend=backend)
    rays = result.streams["rays"]
    assert rays.type is Ray
    np.testing.assert_array_equal(rays.numpy().at, [[0, 2, 1], [1, 6, 3], [2, 14, 7], [3, 2, 1], [4, 6, 3]])
    np.testing.assert_array_equal(rays.numpy().left, 0)
    assert result.executions == {"generate": 1, "traverse": 4}
    assert result.counts == {"generate": 5, "traverse": 9}
    again = sh.loop(traverse).run(rays=rays, heights=sh.Table([1, 2, 4, 8], sh.Attrib1f))
    assert again.executions == {"traverse": 1}
    np.testing.assert_array_equal(again.streams["rays"].numpy().at, rays.numpy().at)


@pytest.mark.sampled(3)
@on_every_backend
def test_tables_of_vectors_follow_their_stream(backend):
    @sh.program
    def turn(p: sh.Table[sh.Point3f, 1]) -> sh.Point3f:
        return p[sh.grid_index(1) - 1].yzx

    points = np.arange(63, dtype=np.float32).reshape(21, 3)
    expected = points
    for _ in range(5):
        expected = expected[[0, *range(20)]][:, [1, 2, 0]]
    np.testing.assert_array_equal(sh.repeat(turn, 5).run(p=points, backend=backend).streams["p"], expected)


@on_every_backend
def test_kernels_are_members_too(backend):
    chain = sh.sequence(move.compile(backend), sh.repeat(blur, 2))
    result = chain.run(x=np.arange(4.0), v=1)
    expected = OneByOne(backend, {"x": np.arange(4, dtype=np.float32), "v": np.ones(4, np.float32)})
    expected.run(("sequence", [move, ("repeat", blur, 2, None)]))
    np.testing.assert_array_equal(result.streams["x"], expected.arrays["x"])
    assert result.streams["x"].backend == backend


@pytest.mark.sampled(3)
@on_every_backend
def test_a_sequence_gives_the_bits_of_the_fused_program(backend):
    @sh.program
    def polar(x: sh.Attrib1f, y: sh.Attrib1f):
        return {"r": sh.sqrt(x * x + y * y), "phi": sh.atan2(y, x)}

    @sh.program
    def twist(r: sh.Attrib1f, phi: sh.Attrib1f):
        return {"r": sh.exp(-r), "phi": phi + 1 / (0.5 + r)}

    @sh.program
    def cartesian(r: sh.Attrib1f, phi: sh.Attrib1f):
        return {"a": r * sh.cos(phi), "b": r * sh.sin(phi)}

    x, y = np.random.default_rng(3).normal(size=(2, 500)).astype(np.float32)
    apart = sh.sequence(polar, twist, cartesian).run(x=x, y=y, backend=backend).streams
    fused = (cartesian << twist << polar).compile(backend)(x, y)
    for name, whole in zip(("a", "b"), fused.values() if isinstance(fused, dict) else fused, strict=True):
        np.testing.assert_array_equal(apart[name].numpy().view(np.int32), whole.view(np.int32))


@pytest.mark.sampled(3)
@on_every_backend
def test_a_chain_may_be_a_member_several_times(backend):
    inner = sh.sequence(sh.sequence(wear), move)
    start = {"x": [0.0, 8.0], "v": 4, "n": [0, 4]}
    twice = sh.sequence(inner, sh.repeat(inner, 1), inner).run(**start, backend=backend)
    np.testing.assert_array_equal(twice.streams["x"], [6, 13])
    assert twice.executions == {"wear": 3, "move": 3}
    assert twice.counts == {"wear": 5, "move": 6}
    again = sh.repeat(inner, 3).run(**start, backend=backend)
    np.testing.assert_array_equal(again.streams["x"], twice.streams["x"])


@on_every_backend
def test_empty_streams(backend):
    result = sh.sequence(move, sh.loop(wear)).run(x=np.zeros(0), v=np.zeros(0), n=np.zeros(0, int), backend=backend)
    assert result.streams["x"].shape == (0,)
    assert result.executions == {"move": 1, "wear": 1}
    assert result.counts == {"move": 0, "wear": 0}


@pytest.mark.sampled(3)
@on_every_backend
def test_programs_of_one_name_are_counted_apart(backend):
    first, second = move, sh.sequence(move, where="on")
    other = move.bind(v=2)
    result = sh.sequence(first, other, second).run(x=np.zeros(3), v=1, on=[True, False, True], backend=backend)
    assert result.executions == {"move": 2, "move_2": 1}
    assert result.counts == {"move": 5, "move_2": 3}


@pytest.mark.sampled(3)
@on_every_backend
def test_loops_nest(backend):
    @sh.program
    def outer(n: sh.Attrib1i, m: sh.Attrib1i):
        sh.SH_DISCARD(m == 0)
        return {"n": 3, "m": m - 1}

    @sh.program
    def inner(n: sh.Attrib1i, total: sh.Attrib1i):
        sh.SH_DISCARD(n == 0)
        return {"n": n - 1, "total": total + 1}

    m = np.array([0, 1, 4])
    result = sh.loop(sh.loop(inner), outer).run(n=0, m=m, total=0, backend=backend)
    np.testing.assert_array_equal(result.streams["total"], 3 * m)
    assert result.counts == {"inner": 15, "outer": 5}
    # Rounds of the outer loop: one that sets n, four of three steps and one that finds nothing, and a last one.
    assert result.executions == {"inner": 1 + 4 * 4 + 1, "outer": 6}


@pytest.mark.parametrize("turns", [60_000, 70_000])
def test_a_loop_of_known_length_is_whole_or_the_chain_tells_of_it(turns):
    """llvmpipe stops the loops of an element after 65,535 iterations in all, without an error."""

    @sh.program
    def count(n: sh.Attrib1i):
        c = sh.Attrib1i(0)
        with sh.SH_FOR(0, turns) as i:
            c += 1 + 0 * (i + n)
        return {"n": c}

    chain, n = sh.repeat(count, 2), np.arange(3, dtype=np.int32)
    if turns > 65_535 and stops_loops():
        with pytest.raises(sh.LoopLimitExceeded, match="the device stopped a loop of 3 elements"):
            chain.run(n=n, backend="glsl")
    else:
        assert chain.run(n=n, backend="glsl").streams["n"].numpy().tolist() == [turns] * 3


@sh.program
def beside_a_number(u: sh.Table[sh.Attrib1f, 1], c: sh.Attrib1f) -> dict:
    i = sh.grid_index(1)
    return {"u": c * (u[i - 1] + u[i + 1])}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("count", [1, 2, 3])
@on_every_backend
def test_a_table_beside_a_number_keeps_its_axes(backend, count):
    found = sh.repeat(beside_a_number, 2).run(u=np.ones(count, np.float32), c=0.5, backend=backend).streams["u"]
    assert found.numpy().tolist() == [1] * count


@sh.program
def brighten(red: sh.Attrib1f) -> sh.Attrib1f:
    return red + 0.125


@sh.program
def reject_bright(red: sh.Attrib1f, calls: sh.Attrib1i):
    sh.SH_DISCARD(red >= 1)
    return {"calls": calls + 1}


@pytest.mark.sampled(3)
@on_every_backend
def test_a_loop_over_two_kernels_ends_when_the_second_one_writes_nothing(backend):
    """Listing 4.8 of the thesis: `while (n != 1) { n = 0; K1.execute(); if (K2.execute() == 0) n++; }`."""
    chain = sh.loop(brighten, reject_bright, until="reject_bright")
    assert str(chain) == 'loop(brighten, reject_bright, until="reject_bright")'
    result = chain.run(red=[0.25, 0.5, 0.75], calls=[0, 0, 0], backend=backend)
    # The first element is at 1 after six rounds; in that round the second kernel writes nothing.
    assert result.executions == {"brighten": 6, "reject_bright": 6}
    assert result.streams["red"].numpy().tolist() == [1, 1.25, 1.5]
    assert result.streams["calls"].numpy().tolist() == [5, 3, 1]
    twice = sh.sequence(chain, chain).run(red=[0.25], calls=[0], backend=backend)
    assert twice.executions == {"brighten": 7, "reject_bright": 7}


@sh.program
def work(n: sh.Attrib1i, ready: sh.Attrib1b):
    sh.SH_DISCARD((n >= 5) | ready)
    return {"n": n + 1, "ready": n % 2 == 0}


@sh.program
def finish(n: sh.Attrib1i, ready: sh.Attrib1b):
    sh.SH_DISCARD(~ready)
    return {"n": n + 1, "ready": sh.Attrib1b(False)}


@pytest.mark.sampled(3)
@on_every_backend
def test_a_decider_that_is_held_back_does_not_end_the_loop(backend):
    """Too few elements are ready for its share; after a round without a write of the decider, it runs for any."""
    chain = sh.loop(work, finish, until="finish", when={"finish": sh.share("ready", 1)})
    result = chain.run(n=np.array([0, 1, 3, 4]), ready=np.zeros(4, np.bool_), backend=backend)
    assert result.streams["n"].numpy().min() >= 5
    assert not result.streams["ready"].numpy().any()
