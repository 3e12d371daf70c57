"""A kernel of a loop that waits for a share of the live elements runs in the rounds in which a host loop runs it."""

import pickle
import re

import numpy as np
import pytest

import shpy as sh

BACKENDS = ("numpy", "opencl", "glsl")
on_every_backend = pytest.mark.parametrize("backend", BACKENDS)


@sh.program
def walk(x: sh.Attrib1f, left: sh.Attrib1i, waiting: sh.Attrib1b):
    """Halve x until it is below 1, and wait then."""
    sh.SH_DISCARD(waiting | (left == 0))
    y = x * 0.5
    return {"x": y, "waiting": y < 1}


@sh.program
def hit(x: sh.Attrib1f, left: sh.Attrib1i, waiting: sh.Attrib1b):
    """Send an element that waits on its way again, `left` times."""
    sh.SH_DISCARD(~waiting)
    return {"x": x * 24 + sh.Attrib1f(left), "left": left - 1, "waiting": sh.Attrib1b(False)}


@sh.program
def is_alive(left: sh.Attrib1i) -> sh.Attrib1b:
    return left > 0


@sh.program
def is_waiting(waiting: sh.Attrib1b, left: sh.Attrib1i) -> sh.Attrib1b:
    return waiting & (left >= 0)


def data(n, seed):
    rng = np.random.default_rng(seed)
    return {
        "x": rng.uniform(0.25, 100, n).astype(np.float32),
        "left": rng.integers(0, 5, n).astype(np.int32),
        "waiting": np.zeros(n, np.bool_),
    }


def by_hand(arrays, least, of_alive):
    """Run the loop by kernels over host arrays; returns the arrays and how often each kernel ran."""
    arrays = {name: array.copy() for name, array in arrays.items()}
    ran = {"walk": 0, "hit": 0}
    shape = arrays["x"].shape

    def run(program):
        names = list(program.outputs)
        out = {name: arrays[name].copy() for name in names}
        result = program.compile("numpy").run(**arrays, out=out, shape=shape)
        arrays.update(out)
        ran[program.ir.name] += 1
        return result.count

    forced = False
    while True:
        wrote = run(walk)
        ready = int(arrays["waiting"].sum())
        live = int((arrays["left"] > 0).sum()) if of_alive else arrays["x"].size
        if ready and (forced or ready >= least * live):
            wrote += run(hit)
            ready = 0
        if not wrote and not ready:
            return arrays, ran
        forced = not wrote


def check(backend, n, seed, least, share):
    arrays = data(n, seed)
    expected, ran = by_hand(arrays, least, share.of is not None)
    result = sh.loop(walk, hit, when={"hit": share}).run(**arrays, backend=backend)
    assert {name: result.executions[name] for name in ran} == ran
    for name, stream in result.streams.items():
        assert stream.numpy().tobytes() == expected[name].tobytes(), (name, backend, n, least)


@pytest.mark.sampled(15)
@pytest.mark.parametrize("least", [0.01, 0.2, 0.75, 1.0])
@on_every_backend
def test_a_share_decides_as_a_host_loop(backend, least):
    for n in (1, 63, 2049):
        check(backend, n, n, least, sh.share("waiting", least))
        check(backend, n, n, least, sh.share("waiting", least, of=is_alive))
        check(backend, n, n, least, sh.share(is_waiting, least, of=is_alive))


def test_fewer_executions_for_a_larger_share():
    arrays = data(3000, 5)
    ran = {}
    for least in (0.001, 0.5):
        chain = sh.loop(walk, hit, when={"hit": sh.share("waiting", least)})
        ran[least] = chain.run(**arrays, backend="numpy")
    assert ran[0.5].executions["hit"] < ran[0.001].executions["hit"]
    for name, stream in ran[0.5].streams.items():
        assert stream.numpy().tobytes() == ran[0.001].streams[name].numpy().tobytes()
    assert ran[0.5].counts == ran[0.001].counts


@pytest.mark.sampled(3)
@on_every_backend
def test_the_loop_may_be_a_part_of_a_chain(backend):
    arrays = data(500, 6)
    inner = sh.loop(walk, hit, when={"hit": sh.share("waiting", 0.6)})
    expected = inner.run(**arrays, backend="numpy")
    for chain in (sh.sequence(inner), sh.repeat(inner, 2), sh.loop(inner), pickle.loads(pickle.dumps(inner))):
        found = chain.run(**arrays, backend=backend)
        for name, stream in expected.streams.items():
            assert found.streams[name].numpy().tobytes() == stream.numpy().tobytes(), (str(chain), name)


def test_no_elements():
    result = sh.loop(walk, hit, when={"hit": sh.share("waiting", 1)}).run(**data(0, 1), backend="numpy")
    assert result.streams["x"].shape == (0,)


def test_a_chain_tells_its_shares():
    chain = sh.loop(walk, hit, when={"hit": sh.share("waiting", 0.25, of=is_alive)})
    assert str(chain) == "loop(walk, hit when share('waiting', 0.25, of=is_alive))"


@pytest.mark.parametrize("least", [0, -0.5, 1.5, "half", True, float("nan")])
def test_shares_that_are_none(least):
    with pytest.raises(sh.ShpyTypeError, match=re.escape(f"a share of {least!r}")) as error:
        sh.share("waiting", least)
    assert "test_shares.py" in str(error.value)


@pytest.mark.parametrize(
    ("when", "message"),
    [
        ({"hot": sh.share("waiting", 0.5)}, "when={'hot': share('waiting', 0.5)} of a loop of walk, hit"),
        ({"hit": 0.5}, "when={'hit': 0.5} of a loop of walk, hit"),
        ({"hit": sh.share("wating", 0.5)}, "wating of share('wating', 0.5) is no stream of the loop of walk, hit"),
        ({"hit": sh.share("x", 0.5)}, "the stream x is an Attrib1f in the loop of walk, hit and an Attrib1b in"),
    ],
)
def test_conditions_that_do_not_fit(when, message):
    with pytest.raises(sh.ShpyTypeError, match=re.escape(message)) as error:
        sh.loop(walk, hit, when=when)
    assert "test_shares.py" in str(error.value)


def test_a_stream_that_is_only_read_by_index_is_none_of_the_elements():
    @sh.program
    def look(x: sh.Attrib1f, marks: sh.Table[sh.Attrib1b, 1]) -> sh.Attrib1f:
        sh.SH_DISCARD(marks[0])
        return x

    with pytest.raises(sh.ShpyTypeError, match=re.escape("marks of share('marks', 0.5) is no stream")):
        sh.loop(look, when={"look": sh.share("marks", 0.5)})


@pytest.mark.parametrize("condition", [3, walk])
def test_conditions_that_are_none(condition):
    with pytest.raises(sh.ShpyTypeError, match="is neither the name of a stream nor a program of the element"):
        sh.share(condition, 0.5)
