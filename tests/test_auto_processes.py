"""The backend "auto" in other processes: workers, forks, without OpenCL, and ends at any moment."""

import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest
from dask.distributed import Client, LocalCluster
from patience import HANGING
from test_auto import EAGER, X

import shpy as sh
from shpy.backend.opencl.device.driver import machine_of
from shpy.run import tiers


def work_of_a_child(connection):
    for name, value in EAGER.items():
        setattr(tiers, name, value)

    @sh.program
    def child(x: sh.Attrib1f):
        return x * 3

    kernel = child.compile("auto")
    same = [kernel(X).tobytes() == (X * 3).tobytes() for _ in range(3)]
    connection.send((kernel.runs_on, same, kernel.notes[-1]))
    connection.send(machine_of(0).device.max_compute_units)


@pytest.mark.slow  # a worker of Dask is such a process
def test_worker_processes_go_on_with_opencl_on_one_core(monkeypatch):
    for name in ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT"):
        monkeypatch.delenv(name, raising=False)
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=work_of_a_child, args=(there,))
    process.start()
    assert here.poll(HANGING)
    runs_on, same, note = here.recv()
    assert (runs_on, same) == ("opencl", [True] * 3), note
    assert here.recv() == 1
    process.join()


def python(text, **settings):
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(text)],
        env={**os.environ, "SHPY_BACKEND": "", "SHPY_CACHE_DIR": "", **settings},
        capture_output=True,
        text=True,
        timeout=HANGING,
        check=False,
    )


def test_seconds_of_earlier_processes_pay_for_a_compilation(tmp_path, monkeypatch):
    """A new executable is what a new process has: of a text that costs a second, numpy's parts of it add up."""
    monkeypatch.setattr(tiers, "_PARTS", 4)
    monkeypatch.setattr(tiers.TieredExecutable, "expected", lambda self, *, cached: 0.1 if cached else 1.0)
    monkeypatch.setattr(tiers.TieredExecutable, "_shared", lambda self, *, cached: 0.0)

    def processes(number, *totals):
        @sh.program
        def scaled(x: sh.Attrib1f):
            return x * number

        executable = tiers.auto.compile(scaled.ir, scaled.compile("auto").options)
        return [executable._has_paid(total) for total in totals]

    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path))
    assert processes(2, 0.1, 0.3, 0.6) == [False] * 3  # two quarters
    assert processes(2, 0.2, 0.3) == [False, False]  # one more
    assert processes(2, 0.2, 0.3) == [False, True]
    assert processes(3, 0.1, 0.9, 1.0) == [False, False, True]
    monkeypatch.setenv("SHPY_CACHE_DIR", "")  # nothing is kept
    for _ in range(3):
        assert processes(2, 0.2, 0.6) == [False, False]


def test_programs_of_a_process_pay_together_for_the_start_of_opencl(tmp_path, monkeypatch):
    """The cost of a program beside it is paid by its own seconds alone."""
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path))
    for name, value in {"_START": 1.0, "_COMPILER": 2.0, "_CACHED": (0.1, 0.0), "_COLD": (0.5, 0.0)}.items():
        monkeypatch.setattr(tiers, name, value)
    monkeypatch.setattr(tiers, "_in_all", 0.0)
    monkeypatch.setattr(tiers, "is_open", lambda: False)

    @sh.program
    def one(x: sh.Attrib1f):
        return x / 3

    @sh.program
    def other(x: sh.Attrib1f):
        return x / 7

    first, second = (tiers.auto.compile(p.ir, p.compile("auto").options) for p in (one, other))
    assert not second._is_due(1.0)
    first._spend(0.75)
    assert not first._is_due(0.75)  # the seconds of one program count once
    assert second._is_due(0.375)
    assert not second._is_due(0.25)
    assert not second._has_paid(2.5)
    assert second._has_paid(2.75)
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "other"))
    first._spend(10)
    second = tiers.auto.compile(other.ir, other.compile("auto").options)
    assert second._is_due(0.125)
    assert not second._has_paid(0.375)
    assert second._has_paid(0.5)
    monkeypatch.setattr(tiers, "is_open", lambda: True)
    monkeypatch.setattr(tiers, "_in_all", 0.0)
    third = tiers.auto.compile(one.ir, one.compile("auto").options)
    assert third._is_due(0.125)
    assert not third._is_due(0.0625)


FORKED = """
import os, sys, threading, numpy as np, shpy as sh
from shpy.run import tiers
tiers._COLD = tiers._CACHED = (0, 0); tiers._START = tiers._COMPILER = tiers._LOOK = 0; tiers._TRIED = 1000
@sh.program
def f(x: sh.Attrib1f):
    return sh.sin(x)
kernel, x, results = f.compile(), np.linspace(0, 1, 100_000, dtype=np.float32), []
threads = [threading.Thread(target=lambda: results.extend(f(x) for _ in range(3))) for _ in range(2)]
assert "pyopencl" not in sys.modules
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
first = f.compile("numpy")(x)
assert [result.tobytes() == first.tobytes() for result in [*results, kernel(x)]] == [True] * 7
assert kernel.runs_on == "opencl"
chain = sh.repeat(f.rename(x="y"), 3)
last = [chain.run(y=x).streams["y"].numpy().tobytes() for _ in range(2)]
assert chain.runs_on == "opencl"
child = os.fork()
if not child:
    same = kernel(x).tobytes() == first.tobytes() and kernel.runs_on == "numpy"
    same &= chain.run(y=x).streams["y"].numpy().tobytes() == last[0] == last[1] and chain.runs_on == "numpy"
    @sh.program
    def g(x: sh.Attrib1f):
        return sh.cos(x)
    for _ in range(5):
        g(x)
    os._exit(0 if same and g.compile().runs_on == "numpy" else 1)
print(os.waitpid(child, 0)[1], kernel(x).tobytes() == first.tobytes(), kernel.runs_on)
"""


def test_threads_make_the_first_calls_of_a_process_and_a_forked_child_goes_on_with_numpy():
    ran = python(FORKED)
    assert (ran.stdout, ran.stderr) == ("0 True opencl\n", "")


def calls_in_a_worker(program, x):
    """Call a program that Dask has sent until OpenCL is in use, and once more; return the results and the backend."""
    for name, value in EAGER.items():
        setattr(tiers, name, value)
    kernel = program.compile("auto")
    results = [kernel(x)]
    while "follows where it pays" in kernel.notes[-1]:  # another thread may compile
        results.append(kernel(x))
    results.append(kernel(x))
    return results, kernel.runs_on, machine_of(0).device.max_compute_units


def test_a_worker_of_dask_goes_on_with_opencl_on_one_core(monkeypatch):
    for name in ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT"):
        monkeypatch.delenv(name, raising=False)

    @sh.program
    def sent(x: sh.Attrib1f):
        return sh.sin(x) * 3

    with (
        LocalCluster(n_workers=1, threads_per_worker=2, processes=True, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        parts = [X, X[:50_000], -X]  # two threads of the worker share the program's kernel
        for part, future in [(part, client.submit(calls_in_a_worker, sent, part)) for part in parts]:
            results, runs_on, cores = future.result(timeout=HANGING)
            expected = sent.compile("numpy")(part)
            assert (runs_on, cores) == ("opencl", 1)
            assert all(result.tobytes() == expected.tobytes() for result in results)


WITHOUT = """
import sys; sys.modules["pyopencl"] = None
import numpy as np, shpy as sh
from shpy.run import tiers
tiers._COLD = tiers._CACHED = (0, 0); tiers._START = tiers._COMPILER = tiers._LOOK = 0
@sh.program
def f(x: sh.Attrib1f):
    return x * 2
f(np.zeros(100_000, np.float32))
print(f.compile().notes[-1], sh.default_backend(long=True))
"""


def test_without_opencl_numpy_does_all():
    ran = python(WITHOUT)
    assert (ran.stdout, ran.stderr) == ("runs on numpy: there is no opencl here numpy\n", "")


ENDED = """
import os, random, sys, threading, time
import numpy as np, shpy as sh
from shpy.run import tiers
tiers._COLD = tiers._CACHED = (0, 0.0002); tiers._START = 0.1; tiers._COMPILER = 0
@sh.program
def f(x: sh.Attrib1f):
    t = sh.Attrib1f(0)
    with sh.SH_FOR(0, 40 + {seed}) as k:
        t += sh.sin(x * k)
    return t
x = np.linspace(0, 1, 200_000, dtype=np.float32)
def call():
    while True:
        f(x)
for _ in range({threads}):
    threading.Thread(target=call, daemon=True).start()
print("begun", flush=True)
end = time.monotonic() + {seconds}
children = []
while time.monotonic() < end:
    f(x)
    if {fork} and len(children) < 3 and random.random() < 0.3:
        child = os.fork()
        if not child:
            f(x)
            os._exit(0)
        children.append(child)
sys.exit(max([os.waitpid(child, 0)[1] for child in children], default=0))
"""


@pytest.mark.slow
@pytest.mark.parametrize("way", ["exit", "interrupt", "fork", "threads", "interrupted threads"])
@pytest.mark.parametrize("seed", range(41))
def test_processes_end_at_any_moment(way, seed):
    """While numpy runs, while OpenCL compiles, and after: no crash, no hang, and nothing on standard error.

    With threads, eight of them call the program beside the main thread.
    """
    seconds, interrupted = np.random.default_rng(seed).uniform(0, 1.6), way.startswith("interrupt")
    lasts = 3600 if interrupted else seconds
    text = ENDED.format(seed=seed, seconds=lasts, fork=way == "fork", threads=8 if way.endswith("threads") else 0)
    command = [sys.executable, "-c", text]
    settings = {**os.environ, "SHPY_BACKEND": "auto", "SHPY_CACHE_DIR": ""}
    with subprocess.Popen(command, env=settings, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "begun\n"
        if interrupted:
            time.sleep(seconds)
            process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=HANGING)
    if interrupted:
        # CPython forgets that Ctrl-C ends it if another thread calls `exec` meanwhile, and then ends with 1.
        statuses = {-signal.SIGINT, 1} if way.endswith("threads") else {-signal.SIGINT}
        assert process.returncode in statuses, errors
        assert errors.rstrip().endswith("KeyboardInterrupt")
    else:
        assert (process.returncode, errors) == (0, "")
