"""The number of the pass of `sh.repeat`, and of the round of `sh.loop`: one kernel reads it, the device counts."""

import dask.array as da
import numpy as np
import pytest

import shpy as sh
from shpy.chains.running import Run
from shpy.display.screen import Moment
from shpy.pictures.evolution import Evolution

on_every_backend = pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])


def compared(keys, stage, distance):
    i = sh.grid_index(1)
    a, b = keys[i], keys[i ^ distance]
    lower, ascends = (i & distance) == 0, (i & (2 << stage)) == 0
    return sh.cond(lower == ascends, sh.min(a, b), sh.max(a, b))


@sh.program
def exchange(keys: sh.Table[sh.Attrib1i, 1], k: sh.Attrib1i) -> sh.Attrib1i:
    """Pass k of a bitonic sort: in stage s, keys at the distances 2**s, ..., 2, 1 are compared."""
    s = sh.Attrib1i(0)
    with sh.SH_WHILE(lambda: (s + 1) * (s + 2) // 2 <= k):
        s += 1
    distance = 1 << (s * (s + 3) // 2 - k)
    return compared(keys, s, distance)


@sh.program
def exchange_in_stage(keys: sh.Table[sh.Attrib1i, 1], stage: sh.Attrib1i, step: sh.Attrib1i):
    """The same in nested repeats, with 10 steps in each stage: the first steps of early stages change nothing."""
    i = sh.grid_index(1)
    first = 9 - stage
    changed = compared(keys, stage, 1 << sh.max(stage + first - step, 0))
    return {"keys": sh.cond(step < first, keys[i], changed)}


KEYS = np.random.default_rng(7).integers(-(2**31), 2**31, 1024).astype(np.int32)


@pytest.mark.sampled(3)
@on_every_backend
def test_one_kernel_sorts_1024_keys(backend):
    result = sh.repeat(exchange, 55, index="k").run(keys=KEYS, backend=backend)
    np.testing.assert_array_equal(result.streams["keys"], np.sort(KEYS))
    assert result.streams.keys() == {"keys"}
    assert (result.executions, result.counts) == ({"exchange": 55}, {"exchange": 55 * 1024})


@pytest.mark.sampled(3)
@on_every_backend
def test_nested_passes_sort_them(backend):
    chain = sh.repeat(sh.repeat(exchange_in_stage, 10, index="step"), 10, index="stage")
    assert list(chain.inputs) == ["keys"]
    np.testing.assert_array_equal(chain.run(keys=KEYS, backend=backend).streams["keys"], np.sort(KEYS))


@on_every_backend
def test_few_runs_are_bound(backend, monkeypatch):
    bound, bind = [], Run._bind
    monkeypatch.setattr(Run, "_bind", lambda run, *given: bound.append(given) or bind(run, *given))
    sh.repeat(exchange, 55, index="k").run(keys=KEYS, backend=backend)
    assert len(bound) == 3  # the given keys, and two memories that take turns


@sh.program
def note(digits: sh.Attrib1i, k: sh.Attrib1i):
    return {"digits": 10 * digits + k}


@sh.program
def is_odd(k: sh.Attrib1i, digits: sh.Attrib1i) -> sh.Attrib1b:
    return (k % 2 == 1) | (digits < 0)


def digits_of(chain, backend="numpy", **given):
    found = chain.run(digits=np.zeros(3, np.int32), backend=backend, **given).streams["digits"].numpy()
    assert (found == found[0]).all()
    return int(found[0])


@on_every_backend
def test_the_innermost_repeat_that_names_it_counts(backend):
    inner = sh.repeat(note, 3, index="k")
    assert digits_of(inner, backend) == 12
    assert digits_of(sh.repeat(note, 1, index="k"), backend) == 0
    assert digits_of(sh.repeat(sh.sequence(inner, note), 2, index="k"), backend) == 1_200_121
    assert digits_of(sh.repeat(inner, 2), backend) == 12_012
    assert digits_of(sh.repeat(sh.repeat(note, 2), 3, index="k"), backend) == 1122
    assert digits_of(sh.sequence(note, inner, note), backend, k=7) == 70_127  # a stream of this name outside
    assert digits_of(sh.sequence(inner, inner), backend) == 12_012


@pytest.mark.sampled(3)
@on_every_backend
def test_conditions_read_it(backend):
    assert digits_of(sh.repeat(note, 6, where=is_odd, index="k"), backend) == 135
    assert digits_of(sh.repeat(note, 6, index="k").where(is_odd), backend) == 135
    assert digits_of(sh.sequence(sh.repeat(note, 4, index="k"), where=is_odd), backend) == 13


@sh.program
def fill(k: sh.Attrib1i):
    return {"x": sh.grid_index(1) * 10 + k}


@on_every_backend
def test_it_does_not_tell_the_shape(backend):
    found = sh.repeat(fill, 3, index="k").run(shape=4, backend=backend).streams["x"]
    np.testing.assert_array_equal(found, [2, 12, 22, 32])
    one = np.array([4], np.int32)
    assert sh.repeat(note, 3, index="k").run(digits=one, backend=backend).streams["digits"].shape == (1,)
    image = np.zeros((0, 3), np.int32)
    assert sh.repeat(note, 3, index="k").run(digits=image, backend=backend).streams["digits"].shape == (0, 3)


@sh.program
def ripen(age: sh.Attrib1i, turn: sh.Attrib1i):
    sh.SH_DISCARD(age >= 0)
    return {"age": sh.cond(turn >= sh.grid_index(1), turn, age)}


@sh.program
def is_late(turn: sh.Attrib1i, age: sh.Attrib1i) -> sh.Attrib1b:
    return (turn > 2) & (age < 0)


@pytest.mark.sampled(3)
@on_every_backend
def test_a_loop_counts_its_rounds(backend):
    chain = sh.loop(ripen, index="turn")
    result = chain.run(age=np.full(5, -1, np.int32), backend=backend)
    np.testing.assert_array_equal(result.streams["age"], [0, 1, 2, 3, 4])
    assert result.executions == {"ripen": 6}
    limited = sh.loop(ripen, index="turn", loop_limit=3)
    with pytest.raises(sh.LoopLimitExceeded) as caught:
        limited.run(age=np.full(5, -1, np.int32), backend=backend)
    np.testing.assert_array_equal(caught.value.result.streams["age"], [0, 1, 2, -1, -1])


@sh.program
def wait(left: sh.Attrib1i):
    sh.SH_DISCARD(left == 0)
    return {"left": left - 1}


@pytest.mark.sampled(3)
@on_every_backend
def test_a_share_reads_the_number_of_the_round(backend):
    chain = sh.loop(wait, ripen, when={"ripen": sh.share(is_late, 0.2)}, index="turn")
    result = chain.run(age=np.full(3, -1, np.int32), left=np.full(3, 5, np.int32), backend=backend)
    np.testing.assert_array_equal(result.streams["age"], 3)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("backend", "precision"), [("numpy", "f16"), ("numpy", "f64"), ("opencl", "f64"), ("glsl", "f16")]
)
def test_it_is_an_int_at_every_precision(backend, precision):
    result = sh.repeat(exchange, 55, index="k").run(keys=KEYS, backend=backend, precision=precision)
    np.testing.assert_array_equal(result.streams["keys"], np.sort(KEYS))


@on_every_backend
def test_an_output_without_a_name_replaces_another_stream(backend):
    @sh.program
    def add(total: sh.Attrib1i, k: sh.Attrib1i) -> sh.Attrib1i:
        return total + k

    found = sh.repeat(add.compile(backend), 5, index="k").run(total=[0, 5]).streams["total"]
    np.testing.assert_array_equal(found, [10, 15])


@sh.program
def spread(u: sh.Table[sh.Attrib1i, 1], k: sh.Attrib1i):
    i = sh.grid_index(1)
    return {"u": 3 * u[i + 1] - u[i - 1] + k}


def test_blocks_count_as_one_run_does():
    chain, u = sh.repeat(spread, 3, index="k"), KEYS[:100]
    found = sh.map_overlap(chain, {"u": da.from_array(u, 30)}, steps=2)["u"].compute()
    np.testing.assert_array_equal(found, sh.repeat(chain, 2).run(u=u).streams["u"])
    with pytest.raises(sh.ShpyTypeError, match="k is no stream of"):
        sh.map_overlap(chain, {"u": da.from_array(u, 30), "k": 3})


def test_each_frame_of_an_animation_counts_from_0():
    shown = Evolution(sh.repeat(note, 3, index="k"), None, {"digits": np.zeros((2, 2), np.int32)}, backend="numpy")
    for wanted in (12, 12_012):
        shown.step(Moment((2, 2)))
        np.testing.assert_array_equal(shown.picture(Moment((2, 2))), wanted)


def test_an_index_is_not_filled_by_its_name():
    @sh.program
    def noted(digits: sh.Attrib1i, frame: sh.Attrib1i):
        return {"digits": 10 * digits + frame}

    shown = Evolution(sh.repeat(noted, 3, index="frame"), None, {"digits": np.zeros((2, 2), np.int32)}, backend="numpy")
    shown.step(Moment((2, 2), frame=7))
    np.testing.assert_array_equal(shown.picture(Moment((2, 2))), 12)


@sh.program
def real(x: sh.Attrib1f, k: sh.Attrib1f) -> dict:
    return {"x": x + k}


@sh.program
def gathers(x: sh.Attrib1i, k: sh.Table[sh.Attrib1i, 1]) -> dict:
    return {"x": x + k[0]}


@sh.program
def writes(x: sh.Attrib1i, k: sh.Attrib1i) -> dict:
    return {"x": x + k, "k": k}


NOTE = "note(digits: Attrib1i, k: Attrib1i) -> (digits: Attrib1i)"


@pytest.mark.parametrize(
    ("call", "problem", "cure"),
    [
        (lambda: sh.repeat(note, 3, index=3), "index=3 is no name of an input", "an input k: sh.Attrib1i"),
        (lambda: sh.repeat(note, 3, index=""), "index='' is no name of an input", "an input k: sh.Attrib1i"),
        (lambda: sh.repeat(note, 3, index="shape"), "index='shape' is no name of an input", "an input k: sh.Attrib1i"),
        (
            lambda: sh.repeat(note, 3, index="j"),
            f'no kernel of repeat(note, 3, index="j") reads j, the number of the pass: {NOTE}',
            "an input j: sh.Attrib1i, or no index=",
        ),
        (
            lambda: sh.repeat(sh.repeat(note, 2, index="k"), 3, index="k"),
            "reads k, the number of the pass",
            "an input k: sh.Attrib1i, or no index=",
        ),
        (
            lambda: sh.repeat(real, 3, index="k"),
            "k, the number of the pass, is an Attrib1f in real(",
            "k: sh.Attrib1i",
        ),
        (
            lambda: sh.repeat(gathers, 3, index="k"),
            "k, the number of the pass, is a Table[Attrib1i, 1] in gathers(",
            "k: sh.Attrib1i",
        ),
        (
            lambda: sh.repeat(writes, 3, index="k"),
            'writes k, which is the number of the pass in repeat(writes, 3, index="k")',
            "another name for index=",
        ),
        (
            lambda: sh.loop(ripen, index="k"),
            "no kernel of loop(ripen) reads k, the number of the round: ripen(",
            "an input k: sh.Attrib1i, or no index=",
        ),
        (
            lambda: sh.repeat(note, 3, index="k").run(digits=[0, 1], k=2, backend="numpy"),
            'k is given, and repeat(note, 3, index="k") counts it: it is the number of the pass',
            "no k=",
        ),
        (
            lambda: sh.repeat(note, 3, index="k").run(backend="numpy"),
            'repeat(note, 3, index="k") lacks digits, which note(',
            "chain.run(digits=…)",
        ),
    ],
)
def test_errors(call, problem, cure):
    with pytest.raises(sh.ShpyTypeError) as caught:
        call()
    found, lines = caught.value, call.__code__.co_lines()
    assert found.loc.file == __file__
    assert found.loc.line in {line for *_, line in lines}
    assert problem in found.message
    assert cure in found.cure
