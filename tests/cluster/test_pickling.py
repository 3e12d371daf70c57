"""Programs, kernels, chains, Params and streams travel to a process that knows nothing of the module they came from."""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import cloudpickle
import numpy as np
import pytest

import shpy as sh
from shpy.backend.registry import NAMES

every = pytest.mark.parametrize("name", NAMES)
X = np.linspace(-3, 3, 37, dtype=np.float32)


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector3f


class Pair(NamedTuple):
    near: sh.Attrib1f
    turned: sh.Matrix2f


gain = sh.Param(sh.Attrib1f, 0.1, range=(0, 9), title="Gain")
turn = sh.Param(sh.Matrix2f, [[0.5, 1], [2, 3]])
bias = sh.sqrt(gain) * 3
heights = sh.Table(np.linspace(0, 1, 7) ** 2, sh.Attrib1f)
rays = sh.Table({"o": np.arange(6).reshape(2, 3), "d": np.ones((2, 3))}, Ray)
image = sh.Texture2D(np.linspace(0, 1, 24).reshape(2, 4, 3), filter="cubic", wrap="mirror")


@sh.program
def everything(ray: Ray, x: sh.Attrib1f, k: sh.Attrib1i = 3) -> Pair:
    near = sh.sin(x * gain) + bias + heights[k] + rays[k % 2].d.y + image((x, 0.3)).y
    return Pair(near + sh.dot(ray.o, ray.d), turn * near)


@sh.program
def smooth(u: sh.Table[sh.Attrib1f]) -> sh.Attrib1f:
    i = sh.grid_index(1)
    return 0.5 * (u[i - 1] + u[i + 1])


@sh.program
def drift(u: sh.Attrib1f, count: sh.Attrib1i) -> sh.Attrib1f:
    return u + 0.25 * sh.Attrib1f(count)


@sh.program
def forever(x: sh.Attrib1f) -> sh.Attrib1f:
    y = x.copy()
    with sh.SH_WHILE(lambda: y < 1):
        y += 0
    return y


RAY = {"o": np.outer(X, [1, 2, 3]), "d": np.outer(X, [3, 1, -1])}
CHILD = """
import pickle, sys
import numpy as np
work = pickle.load(open(sys.argv[1], "rb"))
assert "tests.cluster.test_pickling" not in sys.modules
found = []
for make, args, named in work:
    try:
        result = make(*args, **named)
        result = result.streams if hasattr(result, "streams") else result
        result = {k: s.numpy() for k, s in result.items()} if isinstance(result, dict) else result
        result = result.numpy() if hasattr(result, "numpy") else result
        found.append([np.asarray(a) for a in (result.values() if isinstance(result, dict) else
                      result if isinstance(result, tuple) else [result])])
    except Exception as error:
        found.append(error)
pickle.dump(found, open(sys.argv[2], "wb"))
"""


def elsewhere(tmp_path, work, dumps=pickle.dumps):
    """Run each (callable, args, named) in a new process that cannot import this module; return its arrays."""
    given, got = tmp_path / "work", tmp_path / "found"
    given.write_bytes(dumps(work))
    environment = os.environ | {"PYTHONPATH": str(Path(sh.__file__).parents[1])}
    ran = subprocess.run(
        [sys.executable, "-c", CHILD, given, got], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    return pickle.loads(got.read_bytes())


def same(found, wanted):
    assert [a.dtype for a in found] == [np.asarray(w).dtype for w in wanted]
    assert [a.tobytes() for a in found] == [np.asarray(w).tobytes() for w in wanted]


@pytest.mark.sampled(6)
@pytest.mark.parametrize("dumps", [pickle.dumps, cloudpickle.dumps])
@every
def test_everything_travels_with_its_bits(tmp_path, name, dumps):
    class Local(NamedTuple):
        a: sh.Attrib1f
        b: sh.Attrib3i

    @sh.program
    def local(x: sh.Attrib1f, k: sh.Attrib1i) -> Local:
        return Local(x * sh.exp(x), sh.Attrib3i(k, k + 1, k * 2))

    kernel = everything.compile(name)
    chain = sh.repeat(sh.sequence(smooth.compile(name), drift.compile(name)), 5, index="count")
    stream = sh.Stream(X, sh.Attrib1f, name)
    pairs = sh.Stream({"near": X, "turned": np.ones((37, 2, 2))}, Pair, name)
    work = [
        (kernel, (RAY, X), {"k": np.arange(37) % 9}),
        (everything, (RAY, X), {}),
        (local.compile(name), (X, np.arange(37)), {}),
        (chain.run, (), {"u": X}),
        (stream.copy, (), {}),
        (pairs.copy, (), {}),
    ]
    results = elsewhere(tmp_path, work, dumps)
    same(results[0], kernel(RAY, X, k=np.arange(37) % 9))
    same(results[1], everything(RAY, X))
    same(results[2], local(X, np.arange(37)))
    same(results[3], [chain.run(u=X).streams["u"].numpy()])
    same(results[4], [X])
    same(results[5], pairs.numpy())


def test_a_line_of_an_error_travels_both_ways(tmp_path):
    (error,) = elsewhere(tmp_path, [(forever.compile("numpy", loop_limit=9), ([0.0, 2.0],), {})])
    assert isinstance(error, sh.LoopLimitExceeded)
    assert (error.loc.file, error.count) == (__file__, 1)
    with pytest.raises(sh.LoopLimitExceeded) as here:
        forever.compile("numpy", loop_limit=9)([0.0, 2.0])
    assert str(error) == str(here.value)
    assert error.result.outputs.tolist() == here.value.result.outputs.tolist()


@pytest.mark.sampled(3)
@every
def test_results_over_streams_and_errors_that_hold_them_travel(name):
    @sh.program
    def positive(x: sh.Attrib1f) -> sh.Attrib1f:
        sh.SH_DISCARD(x <= 0)
        return sh.sqrt(x)

    given = sh.Stream(X, sh.Attrib1f, name)
    result = positive.compile(name).run(given)
    for found in (pickle.loads(pickle.dumps(result)), copy.copy(result), copy.deepcopy(result)):
        assert found.outputs.numpy().tobytes() == result.outputs.numpy().tobytes()
        assert (found.count, found.written.numpy().tolist()) == (np.count_nonzero(X > 0), (X > 0).tolist())
    with pytest.raises(sh.LoopLimitExceeded) as caught:
        forever.compile(name, loop_limit=9)(given)
    error = pickle.loads(pickle.dumps(caught.value))
    assert (error.count, error.result.count) == (np.count_nonzero(X < 1), np.count_nonzero(X >= 1))


def test_params_keep_value_name_and_metadata():
    one = pickle.loads(pickle.dumps(gain))
    assert (one.value, one.name, one.range, one.title) == (gain.value, "gain", (0, 9), "Gain")
    with pytest.raises(sh.ShpyTypeError, match="outside of its range"):
        one.value = 10
    matrix = pickle.loads(pickle.dumps(turn))
    assert matrix.value.tolist() == [[0.5, 1], [2, 3]]


def test_a_param_that_two_programs_share_is_shared_on_the_other_side():
    one, two = pickle.loads(pickle.dumps((everything, everything.rename(x="y"))))
    (mine,), (other,) = ([p for p in q.params.values() if p.name == "gain"] for q in (one, two))
    assert mine is other
    assert set(one.params) == set(everything.params)
    before = one.compile("numpy")(RAY, X).near
    mine.value = 4.0
    assert (one.compile("numpy")(RAY, X).near != before).any()  # through gain, and through bias, which follows it
    assert gain.value == np.float32(0.1)


def test_structs_are_the_users_own_where_they_can_be_imported():
    kernel = pickle.loads(pickle.dumps(everything.compile("numpy")))
    assert kernel.recorded.output.cls is Pair
    assert type(kernel(RAY, X)) is Pair


def test_a_struct_of_the_same_name_with_other_fields_is_another(monkeypatch):
    sent = pickle.dumps(everything)
    monkeypatch.setattr(sys.modules[__name__], "Pair", NamedTuple("Pair", [("near", sh.Attrib1f)]))
    found = pickle.loads(sent)(RAY, X)
    assert type(found) is not Pair
    assert (type(found).__name__, found._fields) == ("Pair", ("near", "turned"))


@pytest.mark.sampled(3)
@every
def test_kernels_keep_their_options(name):
    kernel = everything.compile(name, math="relaxed", loop_limit=77)
    found = pickle.loads(pickle.dumps(kernel))
    assert (found.options, found.backend, found.source) == (kernel.options, name, kernel.source)
    assert str(found.recorded.module) == str(kernel.recorded.module)


@pytest.mark.parametrize("other", [copy.deepcopy, lambda texture: pickle.loads(pickle.dumps(texture))])
def test_a_texture_that_a_program_has_read_travels_and_is_one_of_its_own_there(other):
    picture = sh.Texture2D(np.zeros((2, 2)), filter="nearest", name="picture")

    def reading(texture):
        return sh.program(lambda: texture((0.5, 0.5)))

    assert reading(picture)() == 0
    there = other(picture)
    there.update(np.ones((2, 2)))
    assert (reading(there)(), reading(picture)()) == (1, 0)


def test_constants_are_copied_and_travel():
    for value in (sh.Attrib3f(1, 2, 3), sh.Matrix2f((1, 2), (3, 4)), Ray(sh.Point3f(1, 2, 3), sh.Vector3f(0, 0, 1))):
        for again in (pickle.loads(pickle.dumps(value)), copy.copy(value), copy.deepcopy(value)):
            assert repr(again) == repr(value)


def test_values_of_a_recording_cannot_travel():
    caught = []

    @sh.program
    def f(x: sh.Attrib1f) -> sh.Attrib1f:
        try:
            pickle.dumps(x)
        except sh.ShpyTypeError as error:
            caught.append(error)
        return x

    (error,) = caught
    assert error.message == (
        "a value of f cannot travel: the program is being recorded, and the value is known only when it runs"
    )
    assert error.cure == "an output of the program, whose arrays travel"


class Shader:
    @sh.program
    def shade(self, x: sh.Attrib1f) -> sh.Attrib1f:
        return 2 * x


def test_a_method_travels_once_it_is_recorded():
    with pytest.raises(sh.ShpyTypeError) as caught:
        pickle.dumps(Shader.shade)
    assert caught.value.message == "the method Shader.shade cannot travel: it is recorded for each instance"
    assert caught.value.cure == "instance.shade"
    assert pickle.loads(pickle.dumps(Shader().shade))([1, 2]).tolist() == [2, 4]


def test_a_device_that_the_other_process_lacks_is_an_error():
    kernel = smooth.compile("numpy", device=0)
    rebuild, (recorded, backend, options) = kernel.__reduce__()
    from dataclasses import replace

    with pytest.raises(sh.BackendUnavailable, match="numpy has no device 3, only 1"):
        rebuild(recorded, backend, replace(options, device=3))
