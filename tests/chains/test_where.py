"""`where` in a chain: elements for which the condition is False do not run, and keep their values."""

import numpy as np
import pytest

import shpy as sh

on_every_backend = pytest.mark.parametrize("backend", ["numpy", "opencl", "glsl"])
SHARES = pytest.mark.parametrize("share", [1.0, 0.3, 0.01, 0.0])


@sh.program
def iterate(c: sh.Point2f, weights: sh.Table[sh.Attrib1f, 1]):
    """Some of everything: a loop that lanes leave, a table, the place in the grid, two outputs."""
    z = sh.Attrib2f(0, 0)
    n = sh.Attrib1i(0)
    with sh.SH_WHILE(lambda: (n < 20) & (sh.dot(z, z) < 4)):
        z[:] = sh.Attrib2f(z.x * z.x - z.y * z.y, 2 * z.x * z.y) + c
        n += 1
    at = sh.grid_index(2)
    return {"z": z * weights[n], "n": n + 100 * at.x - at.y * sh.grid_shape(2).x}


@sh.program
def near(c: sh.Point2f) -> sh.Attrib1b:
    return sh.dot(c, c) < 1


def case(share, shape=(70, 71)):
    rng = np.random.default_rng(5)
    c = rng.uniform(-2, 1, (*shape, 2)).astype(np.float32)
    mask = rng.random(shape) < share
    out = {"z": rng.random((*shape, 2), np.float32), "n": rng.integers(0, 9, shape).astype(np.int32)}
    return c, np.linspace(0, 1, 21, dtype=np.float32), mask, out


def bits(data):
    """The bytes of an array or a stream."""
    array = data.numpy() if isinstance(data, sh.Stream) else data
    return np.ascontiguousarray(array).view(np.uint8)


@pytest.mark.sampled(4)
@SHARES
@on_every_backend
def test_elements_that_do_not_run_keep_what_out_held(backend, share):
    c, weights, mask, out = case(share)
    kernel = iterate.compile(backend)
    whole = kernel(c, weights)
    expected = {name: np.where(mask[..., None] if name == "z" else mask, whole[name], out[name]) for name in out}
    given = {name: array.copy() for name, array in out.items()}
    result = kernel.run(c, weights, out=given, where=mask)
    np.testing.assert_array_equal(result.written, mask)
    assert result.count == mask.sum()
    for name in out:
        assert result.outputs[name] is given[name]
        np.testing.assert_array_equal(bits(given[name]), bits(expected[name]), err_msg=name)
    fresh = kernel.run(c, weights, where=mask).outputs
    np.testing.assert_array_equal(fresh["n"], np.where(mask, whole["n"], 0))
    # The same over streams.
    types = {"z": sh.Attrib2f, "n": sh.Attrib1i}
    held = {name: sh.Stream(array, types[name], backend=backend) for name, array in out.items()}
    points = sh.Stream(c, sh.Point2f, backend=backend)
    for condition in (mask, sh.Stream(mask, sh.Attrib1b, backend=backend)):
        streamed = kernel.run(points, weights, out=held, where=condition)
        assert streamed.count == mask.sum()
        np.testing.assert_array_equal(streamed.written, mask)
        for name in out:
            np.testing.assert_array_equal(bits(held[name].numpy()), bits(expected[name]), err_msg=name)


@pytest.mark.sampled(3)
@on_every_backend
def test_an_output_may_be_an_input(backend):
    @sh.program
    def double(x: sh.Attrib1f) -> sh.Attrib1f:
        return 2 * x

    x = np.arange(6, dtype=np.float32)
    double.compile(backend).run(x, out=x, where=x > 2)
    np.testing.assert_array_equal(x, [0, 1, 2, 6, 8, 10])
    np.testing.assert_array_equal(double.compile(backend).run(3, where=[True, False]).outputs, [6, 0])
    np.testing.assert_array_equal(double.compile(backend).run(x, where=False).outputs, np.zeros(6))
    np.testing.assert_array_equal(double.compile(backend).run(x, where=True).outputs, 2 * x)
    assert double.compile(backend).run(np.zeros((0,)), where=np.zeros(0, bool)).count == 0


@pytest.mark.sampled(6)
@SHARES
@on_every_backend
def test_kernels_that_do_not_know_their_place(backend, share):
    @sh.program
    def divide(x: sh.Attrib3f, by: sh.Attrib1i, t: sh.Table[sh.Attrib1f, 1]):
        n = sh.Attrib1i(by)
        total = sh.Attrib3f(0, 0, 0)
        sh.SH_DISCARD(by == 5)
        with sh.SH_WHILE(lambda: n > 0):
            total += x / sh.Attrib1f(n) + t[n]
            n -= 1
        return {"total": total, "odd": by % 2 == 1}

    rng = np.random.default_rng(7)
    x, by = rng.random((5000, 3), np.float32), rng.integers(0, 8, 5000)
    t, mask = rng.random(8, np.float32), rng.random(5000) < share
    out = {"total": rng.random((5000, 3), np.float32), "odd": rng.random(5000) < 0.5}
    kernel = divide.compile(backend)
    whole, runs = kernel(x, by, t), mask & (by != 5)
    expected = {n: np.where(runs[:, None] if n == "total" else runs, whole[n], out[n]) for n in out}
    result = kernel.run(x, by, t, where=mask, out=out)
    np.testing.assert_array_equal(result.written, runs)
    np.testing.assert_array_equal(bits(out["total"]), bits(expected["total"]))
    np.testing.assert_array_equal(out["odd"], expected["odd"])
    again = kernel.run(1.0 * x, by, t, where=mask)
    np.testing.assert_array_equal(bits(again.outputs["total"][runs]), bits(whole["total"][runs]))
    assert not again.outputs["total"][~runs].any()
    # The same over streams, three times: the first two runs over lists are measured.
    types = {"total": sh.Attrib3f, "odd": sh.Attrib1b}
    inputs = sh.Stream(x, sh.Attrib3f, backend), sh.Stream(by, sh.Attrib1i, backend)
    table, condition = sh.Table(sh.Stream(t, sh.Attrib1f, backend)), sh.Stream(mask, sh.Attrib1b, backend)
    for _ in range(3):
        held = {
            name: sh.Stream(rng.random((5000, 3)) if name == "total" else rng.random(5000) < 0.5, type_, backend)
            for name, type_ in types.items()
        }
        before = {name: stream.numpy() for name, stream in held.items()}
        streamed = kernel.run(*inputs, table, out=held, where=condition)
        assert streamed.count == runs.sum()
        np.testing.assert_array_equal(streamed.written.numpy(), runs)
        for name, stream in held.items():
            live = runs[:, None] if name == "total" else runs
            np.testing.assert_array_equal(bits(stream), bits(np.where(live, whole[name], before[name])))


@sh.program
def halve(x: sh.Attrib2f, by: sh.Attrib1f):
    n = sh.Attrib1i(0)
    with sh.SH_WHILE(lambda: x.x > 0.5):
        n += 1
    return {"half": x / by, "rest": x.x > by}


@pytest.mark.sampled(6)
@pytest.mark.parametrize("precision", ["f16", "f32", "f64"])
@pytest.mark.parametrize("pays", [True, False])
def test_lists_of_streams_give_what_all_give(monkeypatch, precision, pays):
    """A list or not, whichever takes less time: with uniform inputs, results of each size, and loops that stop."""
    from shpy.backend.device.listed import ListedKernel

    monkeypatch.setattr(ListedKernel, "_pays", lambda *_: pays)
    rng = np.random.default_rng(8)
    kernel = halve.compile("opencl", precision=precision, loop_limit=10)
    whole, mask = rng.random((6000, 2)) / 2, rng.random(6000) < 0.1
    x = sh.Stream(whole, sh.Attrib2f, "opencl", precision=precision)
    condition = sh.Stream(mask, sh.Attrib1b, "opencl", precision=precision)
    result = kernel.run(x, 3.0, where=condition)
    expected = kernel(x.numpy(), 3.0)
    np.testing.assert_array_equal(result.outputs["half"].numpy(), np.where(mask[:, None], expected["half"], 0))
    np.testing.assert_array_equal(result.outputs["rest"].numpy(), mask & expected["rest"])
    assert kernel.run(x, 3.0, where=sh.Stream(mask & False, sh.Attrib1b, "opencl", precision=precision)).count == 0
    stuck = np.flatnonzero(mask)[[3, 50]]
    whole[[*stuck, np.flatnonzero(~mask)[0]]] = 0.75
    x = sh.Stream(whole, sh.Attrib2f, "opencl", precision=precision)
    with pytest.raises(sh.LoopLimitExceeded, match="in 2 elements") as caught:
        kernel.run(x, 3.0, where=condition)
    np.testing.assert_array_equal(np.flatnonzero(mask & ~caught.value.result.written.numpy()), stuck)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("moving", [0.01, 100])
def test_a_list_is_made_where_moving_its_elements_takes_less_time_than_it_saves(monkeypatch, moving):
    """The clock says that an element runs for a second; the first list builds kernels, the second one is timed."""
    from shpy.backend.device.listed import ListedKernel

    run, lists, times = ListedKernel._run, [], []

    def now(self, live):
        times.append(len(times))
        return [0, moving * live.count, (moving + 1) * live.count, (moving + 1) * live.count][(len(times) - 1) % 4]

    monkeypatch.setattr(ListedKernel, "_now", now)
    monkeypatch.setattr(
        ListedKernel, "_run", lambda self, call, live: (lists.append(live.count), run(self, call, live))[1]
    )
    x = np.random.default_rng(8).random((6000, 2)) / 2
    kernel = halve.compile("opencl", loop_limit=int(100 + moving))  # one of its own, which knows no times yet
    mask = np.arange(6000) % 300 == 0
    for _ in range(3):
        found = kernel.run(sh.Stream(x, sh.Attrib2f, "opencl"), 3.0, where=sh.Stream(mask, sh.Attrib1b, "opencl"))
        assert found.count == 20
    assert lists == ([20] * 3 if moving < 1 else [20] * 2)


@pytest.mark.sampled(3)
@on_every_backend
def test_elements_know_their_place(backend):
    @sh.program
    def around(image: sh.Table[sh.Attrib3f, 2], add: sh.Attrib1f) -> sh.Attrib3f:
        i = sh.grid_index(2)
        far = image[i + (100, 0)] - image[i - (2**31 - 1, 0)]
        return image[i + (0, 1)] + 2 * image[i - (1, 0)].zxy + far + add

    rng = np.random.default_rng(6)
    image, add = rng.random((90, 64, 3), np.float32), rng.random((90, 64), np.float32)
    mask = rng.random((90, 64)) < 0.2
    kernel = around.compile(backend)
    found = kernel.run(image, add, where=mask).outputs
    np.testing.assert_array_equal(bits(found), bits(np.where(mask[..., None], kernel(image, add), 0)))


@pytest.mark.sampled(3)
@on_every_backend
def test_discards_and_conditions_add_up(backend):
    @sh.program
    def positive(x: sh.Attrib1f) -> sh.Attrib1f:
        sh.SH_DISCARD(x <= 0)
        return sh.sqrt(x)

    x = np.array([4, -4, 9, -9], np.float32)
    result = positive.compile(backend).run(x, where=[True, True, False, False])
    np.testing.assert_array_equal(result.outputs, [2, 0, 0, 0])
    np.testing.assert_array_equal(result.written, [True, False, False, False])


@pytest.mark.sampled(3)
@on_every_backend
def test_loops_that_run_out_in_a_list_of_elements(backend):
    @sh.program
    def spin(x: sh.Attrib1i) -> sh.Attrib1i:
        n = sh.Attrib1i(0)
        with sh.SH_WHILE(lambda: n < x):
            n += 1
        return n

    x, mask = np.full(6000, 5), np.arange(6000) % 10 == 0
    x[[10, 11]] = 50
    with pytest.raises(sh.LoopLimitExceeded, match="more than 20 iterations in 1 element") as caught:
        spin.compile(backend, loop_limit=20).run(x, where=mask)
    assert caught.value.result.count == 599
    np.testing.assert_array_equal(caught.value.result.outputs, np.where(mask & (x == 5), 5, 0))


def test_where_takes_bools():
    kernel = iterate.compile("numpy")
    c, weights, mask, _ = case(1.0)
    with pytest.raises(sh.ShpyTypeError, match="where"):
        kernel.run(c, weights, where=mask.astype(np.float32))
    with pytest.raises(sh.RecordError, match="where is a reserved name for an input"):

        @sh.program
        def clashing(where: sh.Attrib1b) -> sh.Attrib1b:
            return where


@pytest.mark.sampled(4)
@SHARES
@on_every_backend
def test_a_stream_is_the_condition_of_a_chain(backend, share):
    c, weights, mask, out = case(share)
    whole = iterate.compile(backend)(c, weights)
    result = sh.sequence(iterate, where="on").run(
        c=c, weights=weights, on=mask, z=out["z"], n=out["n"], backend=backend
    )
    np.testing.assert_array_equal(result.streams["n"].numpy(), np.where(mask, whole["n"], out["n"]))
    np.testing.assert_array_equal(bits(result.streams["z"]), bits(np.where(mask[..., None], whole["z"], out["z"])))
    assert result.counts == {"iterate": mask.sum()}


@pytest.mark.sampled(3)
@on_every_backend
def test_a_program_is_the_condition_of_a_chain(backend):
    c, weights, mask, out = case(0.5)
    inside = np.sum(c * c, axis=-1) < 1
    chain = sh.sequence(sh.sequence(iterate, where=near), where="on")
    result = chain.run(c=c, weights=weights, on=mask, **out, backend=backend)
    both = mask & inside
    whole = iterate.compile(backend)(c, weights)
    np.testing.assert_array_equal(result.streams["n"].numpy(), np.where(both, whole["n"], out["n"]))
    assert result.counts == {"iterate": both.sum()}


@pytest.mark.sampled(3)
@on_every_backend
def test_a_loop_ends_when_no_element_runs(backend):
    @sh.program
    def busy(x: sh.Attrib1i) -> sh.Attrib1b:
        return x > 1

    @sh.program
    def collatz(x: sh.Attrib1i, steps: sh.Attrib1i):
        return {"x": sh.cond(x % 2 == 0, x // 2, 3 * x + 1), "steps": steps + 1}

    result = sh.loop(collatz, where=busy).run(x=np.arange(1, 28), steps=0, backend=backend)
    assert result.executions == {"collatz": 112}
    steps = result.streams["steps"].numpy()
    assert steps[26] == 111
    assert result.counts == {"collatz": steps.sum()}
