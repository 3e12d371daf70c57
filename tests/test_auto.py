"""The backend "auto": the bits of numpy before, while and after OpenCL takes over, and numpy where OpenCL may not."""

import copy
import pickle
import sys
import threading

import dask.array as dask_array
import numpy as np
import pytest
from stress.mode import stressed

import shpy as sh
from raytracer import Scene, render
from raytracer.backends import chosen_backend
from raytracer.cli import main
from shpy.backend import registry
from shpy.backend.base import Call
from shpy.backend.opencl.device import building as opencl
from shpy.run import tiers

N = 70_000
"""Elements: more than two tiles of numpy's."""
X = np.linspace(-4, 4, N, dtype=np.float32)
EAGER = {
    "_COLD": (0.0, 0.0),
    "_CACHED": (0.0, 0.0),
    "_START": 0.0,
    "_COMPILER": 0.0,
    "_LOOK": 0.0,
    "_TRIED": 1000,
    "_LAUNCH": 0.0,
}
"""Constants with which OpenCL takes over at the first reading of the clock, and is not compared with numpy."""


@pytest.fixture(autouse=True)
def auto(monkeypatch):
    monkeypatch.setenv("SHPY_BACKEND", "auto")
    monkeypatch.setattr("shpy.backend.registry._default", None)


@pytest.fixture
def eager(monkeypatch):
    for name, value in EAGER.items():
        monkeypatch.setattr(tiers, name, value)


def same(a, b):
    """Return whether two results have the same structure and bits."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, tuple | list):
        return type(a) is type(b) and len(a) == len(b) and all(map(same, a, b))
    a, b = np.asarray(a), np.asarray(b)
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def check(program, *args, shape=None, **options):
    """Run a program three times; each time it has numpy's bits, and at the end it is on OpenCL. Return the kernel."""
    kernel = program.compile(**options)
    expected = program.compile("numpy", **options)(*args, shape=shape)
    assert kernel.runs_on == "numpy"
    for _ in range(3):
        assert same(kernel(*args, shape=shape), expected)
    assert (kernel.backend, kernel.runs_on) == ("auto", "opencl")
    return kernel


def test_plain_calls_follow_the_default(eager):
    @sh.program
    def wave(x: sh.Attrib1f):
        return sh.sin(x) * sh.exp(-x * x) + sh.pow(abs(x), 0.3)

    expected = wave.compile("numpy")(X)
    assert all(same(wave(X), expected) for _ in range(3))
    kernel = wave.compile()
    assert (kernel.backend, kernel.runs_on) == ("auto", "opencl")
    assert kernel.notes[-1].startswith("runs on opencl, after ")
    assert "__kernel" in kernel.source
    assert kernel.device == sh.backends()[1].devices[0]


def test_inputs_of_all_kinds(eager):
    gain = sh.Param(sh.Attrib1f, 1.5, name="gain")
    table = sh.Table(np.random.default_rng(1).random((50, 3), np.float32), sh.Attrib3f)
    picture = sh.Texture2D(np.random.default_rng(2).random((20, 30, 3), np.float32))

    @sh.struct
    class Ray:
        origin: sh.Point3f
        along: sh.Vector3f

    @sh.program
    def mixed(ray: Ray, n: sh.Attrib1i, flag: sh.Attrib1b, by: sh.Attrib1f = 2):
        at = ray.origin + gain * by * ray.along
        color = table[n] + picture((at.x, at.y))
        return {"at": at, "color": color, "flag": flag & (at.x > 0), "n": n * 3}

    rng = np.random.default_rng(3)
    ray = {"origin": rng.random((N, 3), np.float32), "along": rng.random((N, 3), np.float32)}
    n, flag = rng.integers(-5, 60, N).astype(np.int32), rng.random(N) < 0.5
    kernel = check(mixed, ray, n, flag)
    gain.value = -0.75  # Params and Tables may change after OpenCL has taken over
    table.update(np.random.default_rng(4).random((50, 3), np.float32))
    plain = mixed.compile("numpy")
    assert same(kernel(ray, n, flag), plain(ray, n, flag))
    assert same(kernel(ray, n, flag, 0.25), plain(ray, n, flag, 0.25))


@pytest.mark.parametrize("options", [{"precision": "f64"}, {"precision": "f16"}, {"math": "portable"}])
def test_precisions_and_portable_mode(eager, options):
    @sh.program
    def wide(x: sh.Attrib1f):
        return sh.sqrt(abs(x)) / (x * x + 1)

    check(wide, X, **options)


@pytest.mark.parametrize("math", ["relaxed", "fast"])
def test_modes_whose_bits_differ_stay_on_numpy(eager, math):
    @sh.program
    def loose(x: sh.Attrib1f):
        return sh.sin(x) + 1

    kernel = loose.compile(math=math)
    for _ in range(3):
        kernel(X)
    assert (kernel.backend, kernel.runs_on) == ("auto", "numpy")


def test_grids(eager):
    @sh.program
    def picture(scale: sh.Attrib1f):
        row, column = sh.grid_index(2)
        height, _ = sh.grid_shape(2)
        return sh.Color3f(row / height, sh.sin(column * scale), (row ^ column) % 7)

    check(picture, 0.1, shape=(301, 277))


def test_discarded_elements_and_out(eager):
    @sh.program
    def halves(x: sh.Attrib1f):
        with sh.SH_IF(x < 0):
            sh.SH_DISCARD()
        return sh.sqrt(x)

    kernel = check(halves, X)
    roots = np.sqrt(np.abs(X))
    old = np.full(N, 7, np.float32)
    result = kernel.run(X, out=old)
    assert result.outputs is old
    assert same(result.written, X >= 0)
    assert same(old, np.where(X >= 0, roots, np.float32(7)))
    data = X.copy()
    assert same(kernel.run(data, out=data).outputs, np.where(X >= 0, roots, X))
    assert same(kernel.run(X, where=X > 1).written, X > 1)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", range(6))
def test_changes_at_random_keep_the_bits(seed):
    """Kernels change while runs are split, memory holds garbage and elements run as lists."""

    @sh.program
    def kept(x: sh.Attrib1f, n: sh.Attrib1i):
        with sh.SH_IF(x < n):
            sh.SH_DISCARD()
        return {"root": sh.sqrt(x), "next": n + 1}

    n = np.arange(N, dtype=np.int32) % 5 - 3
    old = {"root": np.full(N, 7, np.float32), "next": np.full(N, 8, np.int32)}
    outs, reference = (old, None), kept.compile("numpy")
    expected = [reference.run(X, n, out=copy.deepcopy(out)) for out in outs]
    used = set()
    with stressed(seed):
        kernel = kept.compile()
        for k in range(24):
            result = kernel.run(X, n, out=copy.deepcopy(outs[k % 2]))
            assert same(result.outputs, expected[k % 2].outputs)
            assert same(result.written, expected[k % 2].written)
            used.add(kernel.runs_on)
    assert used == {"numpy", "opencl"}


def test_budgets_of_loops(eager):
    @sh.program
    def collatz(n: sh.Attrib1i) -> sh.Attrib1i:
        steps = sh.Attrib1i(0)
        with sh.SH_WHILE(lambda: n != 1):
            n[:] = sh.cond(n % 2 == 0, n // 2, 3 * n + 1)
            steps += 1
        return steps

    kernel, numbers, errors = collatz.compile(loop_limit=100), np.arange(1, N, dtype=np.int32), []
    for _ in range(3):
        with pytest.raises(sh.LoopLimitExceeded) as raised:
            kernel(numbers)
        errors.append((str(raised.value), raised.value.count, raised.value.result.outputs))
    assert kernel.runs_on == "opencl"
    assert len({error[:2] for error in errors}) == 1
    assert all(same(error[2], errors[0][2]) for error in errors)


def test_streams_and_chains_stay_where_they_are(eager):
    @sh.program
    def twice(x: sh.Attrib1f):
        return {"x": 2 * x + sh.sin(x)}

    for _ in range(3):
        twice(X)
    assert twice.compile().runs_on == "opencl"
    on_host, on_device = sh.Stream(X, sh.Attrib1f), sh.Stream(X, sh.Attrib1f, backend="opencl")
    assert [s.backend for s in (on_host, twice(on_host)["x"], twice(on_device)["x"])] == ["numpy", "numpy", "opencl"]
    assert same(twice(on_host)["x"].numpy(), twice(on_device)["x"].numpy())
    assert sh.repeat(twice, 2).run(x=X).streams["x"].backend == "numpy"


def test_opencl_goes_on_in_the_middle_of_a_call(eager, monkeypatch):
    """numpy leaves between two tiles, and OpenCL writes all elements of the call, with what `out` keeps."""

    @sh.program
    def long(x: sh.Attrib1f):
        total = sh.Attrib1f(0)
        with sh.SH_FOR(0, 200) as k:
            total += sh.sin(x * k)
        with sh.SH_IF(x > 3.9):
            sh.SH_DISCARD()
        return total

    kernel, x, ended = long.compile(), np.tile(X, 30), []
    quick = type(kernel._executable._quick)
    run_until = quick.run_until

    def watched(self, call, stop, first):
        result = run_until(self, call, stop, first)
        ended.append(result[0])
        return result

    out = np.full(len(x), -5, np.float32)
    with monkeypatch.context() as patch:
        patch.setattr(quick, "run_until", watched)
        kernel.run(x, out=out)
    assert (ended, kernel.runs_on) == ([False], "opencl")
    expected = np.full(N, -5, np.float32)
    long.compile("numpy").run(X, out=expected)
    assert same(out, np.tile(expected, 30))


def test_the_rest_of_a_call_counts_where_the_text_was_never_compiled(eager, monkeypatch):
    monkeypatch.setattr(tiers, "_COLD", (0.25, 0.0))

    @sh.program
    def longer(x: sh.Attrib1f):
        total = sh.Attrib1f(0)
        with sh.SH_FOR(0, 150) as k:
            total += sh.cos(x * k)
        return total

    kernel = longer.compile()
    kernel(np.tile(X, 20))  # more than a second of numpy's
    assert kernel.runs_on == "opencl"
    assert kernel._executable._spent < 0.25


def test_kernels_are_pickled_by_their_policy(eager):
    @sh.program
    def third(x: sh.Attrib1f):
        return x / 3

    kernel = third.compile()
    kernel(X)
    copy = pickle.loads(pickle.dumps(kernel))
    assert (copy.backend, same(copy(X), X / 3)) == ("auto", True)


def test_a_refusal_leaves_numpy_and_one_note(eager, monkeypatch):
    asked = []

    def refuse(self, module, options):
        asked.append(module.name)
        raise sh.CompileError("this driver refuses everything")

    monkeypatch.setattr(opencl.OpenCLBackend, "compile", refuse)

    @sh.program
    def quarter(x: sh.Attrib1f):
        return x / 4 + 0.125

    kernel = quarter.compile()
    for _ in range(3):
        assert same(kernel(X), X / 4 + np.float32(0.125))
    assert asked == ["quarter"]
    assert kernel.notes == ("runs on numpy: opencl does not take it (this driver refuses everything)",)


@pytest.mark.parametrize("fault", ["denormals", "add"])
def test_a_device_with_other_bits_leaves_numpy(eager, monkeypatch, fault):
    monkeypatch.setattr(opencl.OpenCLBackend, "faults", lambda self, device: frozenset({fault}))

    @sh.program
    def fifth(x: sh.Attrib1f):
        return x / len(fault)

    kernel = fifth.compile()
    assert same(kernel(X), X / np.float32(len(fault)))
    assert kernel.notes == (f"runs on numpy: opencl's device gets {fault} wrong",)
    assert sh.default_backend(long=True) == "numpy"


def test_a_run_that_fails_on_the_device_is_done_by_numpy(eager):
    @sh.program
    def sixth(x: sh.Attrib1f):
        return x / 6

    kernel = check(sixth, X)

    class Full:
        def run(self, call):
            raise MemoryError("the device is full")

    kernel._executable._better = Full()
    assert same(kernel(X), X / 6)
    assert kernel.runs_on == "numpy"
    assert kernel.notes[-1] == "runs on numpy: opencl gave an error (MemoryError: the device is full)"


def test_a_device_that_is_slower_gives_the_work_back(eager, monkeypatch):
    """As a graphics card does where copies take longer than numpy."""
    monkeypatch.setattr(tiers, "_TRIED", 3)

    @sh.program
    def seventh(x: sh.Attrib1f):
        return x / 7

    kernel = seventh.compile()
    kernel(X)
    assert kernel.runs_on == "opencl"
    kernel._executable._seconds = 1e-9
    for _ in range(4):
        assert same(kernel(X), X / 7)
    assert kernel.notes[-1] == "runs on numpy: opencl is slower here"


def test_short_calls_after_the_change_are_numpys(eager, monkeypatch):
    monkeypatch.setattr(tiers, "_LAUNCH", 1.0)

    @sh.program
    def eighth(x: sh.Attrib1f):
        return x / 8

    kernel, runs = eighth.compile(), []
    kernel(X)
    better = kernel._executable._better
    monkeypatch.setattr(type(better), "run", lambda self, call: runs.append(call.count))
    assert same(kernel(X[:1000]), X[:1000] / 8)
    assert runs == []


def test_small_calls_never_compile(monkeypatch):
    monkeypatch.setattr(opencl.OpenCLBackend, "compile", None)

    @sh.program
    def small(x: sh.Attrib1f):
        return x + 1

    kernel = small.compile()
    for _ in range(300):
        kernel(np.zeros(10, np.float32))
    assert kernel.runs_on == "numpy"
    assert 0 < kernel._executable._spent < kernel._executable._worth


def test_the_expectation_grows_with_the_program_and_is_less_where_the_text_was_compiled():
    @sh.program
    def one(x: sh.Attrib1f):
        return x + 1

    @sh.program
    def many(x: sh.Attrib1f):
        return sum((sh.sin(x * k) for k in range(40)), sh.Attrib1f(0))

    few, more = (program.compile()._executable for program in (one, many))
    assert few.expected(cached=False) < more.expected(cached=False)
    assert more.expected(cached=True) < more.expected(cached=False)


def test_a_text_that_was_compiled_here_is_compiled_earlier(monkeypatch, tmp_path):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path))
    for name, value in EAGER.items():
        monkeypatch.setattr(tiers, name, value)

    @sh.program
    def ninth(x: sh.Attrib1f):
        return x / 9

    module, options = ninth.compile()._executable._module, ninth.compile().options

    def runs_on(cold):
        """Return where a new process would run it after three calls; OpenCL's first compilation takes `cold` s."""
        monkeypatch.setattr(tiers, "_COLD", (cold, 0.0))
        executable = tiers.auto.compile(module, options)
        for _ in range(3):
            executable.run(Call((N,), (X,), (np.empty_like(X),), {}, {}))
        return executable.runs_on

    assert [runs_on(cold) for cold in (3600.0, 0.0, 3600.0)] == ["numpy", "opencl", "opencl"]


def test_threads_share_a_kernel_while_it_changes(eager):
    @sh.program
    def shared(x: sh.Attrib1f):
        return sh.exp(-x) + sh.log(abs(x) + 2)

    kernel, expected, wrong = shared.compile(), shared.compile("numpy")(X), []

    def work():
        for _ in range(30):
            if not same(kernel(X), expected):
                wrong.append(1)

    threads = [threading.Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (kernel.runs_on, wrong) == ("opencl", [])


def test_the_pin_of_a_user_is_never_left(eager, monkeypatch):
    @sh.program
    def tenth(x: sh.Attrib1f):
        return x / 10

    monkeypatch.setenv("SHPY_BACKEND", "numpy")
    kernel = tenth.compile()
    for _ in range(3):
        kernel(X)
    assert (kernel.backend, kernel.runs_on) == ("numpy", "numpy")
    assert sh.default_backend(long=True) == "numpy"
    assert sh.default_backend().why == "chosen by SHPY_BACKEND"
    monkeypatch.setenv("SHPY_BACKEND", "cuda")
    with pytest.raises(sh.BackendUnavailable, match="names no backend"):
        tenth.compile()


def test_the_default_says_what_is_in_force(monkeypatch):
    assert (sh.default_backend(), sh.default_backend(long=True)) == ("auto", "opencl")
    monkeypatch.setitem(sys.modules, "pyopencl", None)
    assert "OpenCL" in sh.default_backend().why


def test_blocks_of_dask(eager):
    @sh.program
    def ramp(x: sh.Attrib1f):
        return sh.sin(x) + sh.grid_index(1)

    x = np.linspace(0, 9, 4 * N, dtype=np.float32)
    expected = ramp.compile("numpy")(x)
    for _ in range(3):
        assert same(sh.map_blocks(ramp, dask_array.from_array(x, chunks=N)).compute(), expected)


def test_a_pause_says_what_the_caller_waits_for(eager, monkeypatch, capsys):
    monkeypatch.setattr("shpy.backend.slow.PATIENCE", 0.0)
    monkeypatch.delenv("SHPY_QUIET")

    @sh.program
    def eleventh(x: sh.Attrib1f):
        return x / 11

    eleventh(X)
    assert "shpy: compil" in (line := capsys.readouterr().err)
    assert "eleventh for opencl" in line


def test_the_ray_tracer_takes_opencl_at_once_and_workers_take_numpy(monkeypatch):
    names = (None, "auto", "glsl")
    assert [chosen_backend(name) for name in names] == ["opencl", "opencl", "glsl"]
    assert [chosen_backend(name, shares_cores=True) for name in names] == ["numpy", "numpy", "glsl"]
    image, expected = (render(Scene.builtin("boxes"), (24, 16), backend=name) for name in (None, "numpy"))
    assert (image.stats.backend, expected.stats.backend) == ("opencl", "numpy")
    assert same(image.pixels, expected.pixels)
    monkeypatch.setenv("SHPY_BACKEND", "glsl")
    assert [chosen_backend(None), chosen_backend(None, shares_cores=True)] == ["glsl", "glsl"]


@pytest.mark.parametrize(
    ("settings", "line"), [({}, "raytracer: numpy computes: opencl needs"), ({"SHPY_BACKEND": "numpy"}, "")]
)
def test_the_command_says_why_numpy_computes(monkeypatch, capsys, tmp_path, settings, line):
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(registry, "_fault_of_opencl", lambda: "opencl needs pyopencl")
    assert main(["render", "boxes", "--size", "8x8", "-o", str(tmp_path / "a.png")]) == 0
    errors = capsys.readouterr().err
    assert errors.startswith(line)
    assert bool(errors) == bool(line)
