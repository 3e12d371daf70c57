"""Processes: forks, Ctrl-C and the end of the process while a kernel runs. Each test runs scripts of its own."""

import json
import os
import signal
import subprocess
import sys
import textwrap

import pytest
from patience import HANGING

BACKENDS = ["numpy", "opencl", "glsl"]
ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))

HEAD = """
import json, os, signal, sys, threading, time
import numpy as np
import shpy as sh
from shpy import SH_FOR, SH_WHILE

@sh.program
def double(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * 2

@sh.program
def triple(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * 3

@sh.program
def long(x: sh.Attrib1f, n: sh.Attrib1i) -> sh.Attrib1f:
    with SH_FOR(n):
        with SH_FOR(0, 60):
            x[:] = x * 0.999 + 1
    return x
"""

FORKED = """
def forked(job):
    read, write = os.pipe()
    process = os.fork()
    if not process:
        signal.alarm(30)  # ends a child that hangs
        try:
            said = repr(job())
        except sh.ShpyError as error:
            said = f"{type(error).__name__}: {error}"
        os.write(write, said.encode())
        os._exit(0)
    os.close(write)
    with os.fdopen(read) as pipe:
        said = pipe.read()
    return said, os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
"""


def run(tmp_path, text, **options):
    script = tmp_path / "script.py"
    script.write_text(HEAD + FORKED + textwrap.dedent(text))
    return subprocess.run(
        [sys.executable, script], cwd=tmp_path, env=os.environ | {"PYTHONPATH": ROOT}, text=True, capture_output=True,
        timeout=HANGING, **options,
    )  # fmt: skip


def test_a_forked_child_says_that_drivers_do_not_survive(tmp_path):
    """Kernels of before and after the fork, while a thread of the parent is inside a run and holds its locks."""
    done = run(
        tmp_path,
        """
        x = np.arange(3, dtype=np.float32)
        kernels = {name: double.compile(name) for name in ("numpy", "opencl", "glsl")}
        for kernel in kernels.values():
            kernel(x)
        busy = long.compile("opencl"), long.compile("glsl")
        stop = threading.Event()

        def work(kernel):
            while not stop.is_set():
                kernel(np.zeros(20_000, np.float32), 300)

        threads = [threading.Thread(target=work, args=[kernel]) for kernel in busy]
        for thread in threads:
            thread.start()
        time.sleep(0.3)
        found = {"backends": forked(lambda: [info.name for info in sh.backends() if info.available])}
        for name, kernel in kernels.items():
            found[name] = [forked(job) for job in (
                lambda: kernel(x).tolist(),
                lambda: triple.compile(name)(x).tolist(),
                lambda: double.compile(name)(x).tolist(),
            )]
        stop.set()
        for thread in threads:
            thread.join()
        print(json.dumps(found))
        """,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["backends"] == ["['numpy']", 0]
    assert found["numpy"] == [["[0.0, 2.0, 4.0]", 0], ["[0.0, 3.0, 6.0]", 0], ["[0.0, 2.0, 4.0]", 0]]
    for name in ("opencl", "glsl"):
        for said, status in found[name]:
            assert said.startswith("BackendUnavailable: ")
            assert f"forked after its parent had used {name}" in said
            assert 'multiprocessing.get_context("spawn")' in said
            assert status == 0


def test_streams_of_before_a_fork_say_that_drivers_do_not_survive(tmp_path):
    """A forked child may drop the streams, and the parent still uses its own."""
    done = run(
        tmp_path,
        """
        import gc

        def jobs(name):
            stream, other = (sh.Stream(np.arange(n, dtype=np.float32), sh.Attrib1f, name) for n in (3, 100))
            kernel, chain = double.compile(name), sh.repeat(double, 2)
            kernel(stream)
            chain.run(x=stream)
            held = [sh.Stream(np.ones(9), sh.Attrib1f, name)]

            def drop():
                held.clear()
                gc.collect()
                return "dropped"

            return (
                lambda: kernel(stream).numpy().tolist(),
                lambda: kernel.run(stream, out=stream).outputs.numpy().tolist(),
                lambda: stream.numpy().tolist(),
                lambda: stream.update([7, 7, 7]) or stream[:1].tolist(),
                lambda: stream.copy().numpy().tolist(),
                lambda: sh.Stream([1.0], sh.Attrib1f, name).numpy().tolist(),
                lambda: float(other.sum()),
                lambda: sh.sort(other, descending=True)[:2].tolist(),
                lambda: chain.run(x=stream).streams["x"].numpy().tolist(),
                drop,
            )

        found = {}
        for name in ("numpy", "opencl", "glsl"):
            given = jobs(name)
            found[name] = [forked(job) for job in given] + [given[0]()]
        print(json.dumps(found))
        """,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    doubled = "[0.0, 2.0, 4.0]"
    alone = [doubled, doubled, "[0.0, 1.0, 2.0]", "[7.0]", "[0.0, 1.0, 2.0]", "[1.0]", "4950.0", "[99.0, 98.0]"]
    alone += ["[0.0, 4.0, 8.0]", "'dropped'"]
    assert found["numpy"] == [*([said, 0] for said in alone), [0, 2, 4]]
    for name in ("opencl", "glsl"):
        *refused, dropped, parent = found[name]
        for said, status in refused:
            assert said.startswith("BackendUnavailable: ")
            assert f"forked after its parent had used {name}" in said
            assert 'multiprocessing.get_context("spawn")' in said
            assert status == 0
        assert dropped == ["'dropped'", 0]
        assert parent == [0, 2, 4]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_a_forked_child_ends_with_its_status(tmp_path, backend):
    """After `os.fork` and in multiprocessing, while a thread of the parent runs kernels and compiles others."""
    done = run(
        tmp_path,
        f"""
        import ctypes, multiprocessing

        def refused():
            try:
                kernel(x)
            except sh.BackendUnavailable:
                sys.exit(3)

        def on_numpy():
            def tenfold(x: sh.Attrib1f) -> sh.Attrib1f:
                return x * 10

            found = sh.program(tenfold).compile("numpy").run(x, where=x > 0).outputs
            sys.exit(4 if found.tolist() == [0, 10, 20] else 1)

        def drop():
            global kernel, stream
            del kernel, stream
            sys.exit(5)

        def prints():
            ctypes.CDLL(None).printf(b"buffered by C\\n")
            sys.exit(6)

        def forks():
            grandchild = os.fork()
            if not grandchild:
                sys.exit(7)
            sys.exit(os.waitstatus_to_exitcode(os.waitpid(grandchild, 0)[1]))

        def ended(job):
            child = os.fork()
            if not child:
                signal.alarm(30)  # ends a child that hangs
                job()
            return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

        x = np.arange(3, dtype=np.float32)
        kernel, stream = double.compile({backend!r}), sh.Stream(x, sh.Attrib1f, {backend!r})
        kernel(stream)
        busy, stop = long.compile({backend!r}), threading.Event()

        def work():
            number = 0
            while not stop.is_set():
                busy(np.zeros(20_000, np.float32), 100)
                number += 1
                triple.compile({backend!r}, loop_limit=number)

        thread = threading.Thread(target=work)
        thread.start()
        try:
            found = [ended(job) for job in (sys.exit, refused, on_numpy, drop, prints, forks)]
            child = multiprocessing.get_context("fork").Process(target=on_numpy)
            child.start()
            child.join()
            print([*found, child.exitcode])
        finally:
            stop.set()
            thread.join()
        """,
    )
    assert done.stdout == "buffered by C\n[0, 3, 4, 5, 6, 7, 4]\n", done.stderr


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_a_child_may_use_what_its_parent_has_not(tmp_path, backend):
    done = run(tmp_path, f"print(*forked(lambda: double.compile({backend!r})(np.float32([1, 2])).tolist()))")
    assert done.stdout == "[2.0, 4.0] 0\n", done.stderr


def test_a_child_collects_garbage_though_a_thread_of_its_parent_compiled(tmp_path):
    """But not where the forking thread itself compiles: until that ends, in parent and child."""
    done = run(
        tmp_path,
        """
        import gc
        from shpy.ir.collector import uncollected

        inside, stop = threading.Event(), threading.Event()

        def work():
            with uncollected():
                inside.set()
                stop.wait()

        def after_a_block():
            with uncollected():
                pass
            return gc.isenabled()

        thread = threading.Thread(target=work)
        thread.start()
        inside.wait()
        found = [gc.isenabled(), forked(gc.isenabled), forked(after_a_block)]
        with uncollected():
            found += [forked(gc.isenabled), forked(after_a_block)]
        stop.set()
        thread.join()
        print(json.dumps([*found, gc.isenabled()]))
        """,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == [False, ["True", 0], ["True", 0], ["False", 0], ["False", 0], True]


INTERRUPTED = """
def interrupt(kernel, *inputs):
    def send():
        time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=send, daemon=True).start()
    try:
        kernel(*inputs)
    except KeyboardInterrupt:
        print("interrupted", flush=True)
        return
    sys.exit("the kernel ended")

TOO_LONG = {"numpy": (200_000, 2_000_000), "opencl": (200_000, 2_000_000), "glsl": (4_000_000, 1_000)}
"""
"""Elements and iterations of `long`: GLSL's device allows few iterations, so it gets many elements."""


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_ctrl_c_ends_a_long_run(tmp_path, backend):
    """The same process goes on, and a kernel whose calls were short until then is no slower to stop."""
    done = run(
        tmp_path,
        INTERRUPTED
        + f"""
count, n = TOO_LONG[{backend!r}]
x = np.zeros(count, np.float32)
kernel = long.compile({backend!r})
for _ in range(3):
    kernel(x, 0)
interrupt(kernel, x, n)
print(double.compile("numpy")(np.float32([1, 2])).tolist())
sys.exit(130)
""",
    )
    assert done.stdout == "interrupted\n[2.0, 4.0]\n", done.stderr
    assert done.returncode in (130, -signal.SIGINT)


def test_ctrl_c_ends_a_process_whose_device_goes_on(tmp_path):
    """10^12 iterations of one element: no dispatch is short enough, so the process ends by SIGINT."""
    done = run(
        tmp_path,
        INTERRUPTED
        + """
@sh.program
def endless(x: sh.Attrib1f) -> sh.Attrib1f:
    with SH_FOR(0, 1_000_000):
        with SH_FOR(0, 1_000_000):
            x[:] = x * 0.999 + 1
    return x

interrupt(endless.compile("opencl"), np.zeros(1000, np.float32))
print("ending")
""",
    )
    assert done.stdout == "interrupted\nending\n", done.stderr
    assert done.returncode == -signal.SIGINT


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_the_process_ends_while_a_daemon_runs_a_kernel(tmp_path, backend):
    done = run(
        tmp_path,
        INTERRUPTED
        + f"""
kernel = long.compile({backend!r})
count, n = (4_000_000, 200) if {backend!r} == "glsl" else (1_000_000, 20_000)
threading.Thread(target=lambda: kernel(np.zeros(count, np.float32), n), daemon=True).start()
time.sleep(0.3)
print("ending", flush=True)
""",
    )
    assert (done.returncode, done.stdout) == (0, "ending\n"), done.stderr


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_exit_handlers_run_kernels_after_daemons_were_stopped(tmp_path, backend):
    """Handlers that were registered before the device was opened come last. Daemons end without a word."""
    done = run(
        tmp_path,
        INTERRUPTED
        + f"""
import atexit

def last():
    time.sleep(0.5)  # in which a daemon would show its error
    print(len(long.compile({backend!r})(np.zeros(5, np.float32), 2)), flush=True)

atexit.register(last)
kernel = long.compile({backend!r})
count, n = (4_000_000, 200) if {backend!r} == "glsl" else (1_000_000, 20_000)
for _ in range(2):
    threading.Thread(target=lambda: kernel(np.zeros(count, np.float32), n), daemon=True).start()
time.sleep(0.3)
print("ending", flush=True)
""",
    )
    assert (done.returncode, done.stdout) == (0, "ending\n5\n"), done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.sampled(3)
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_stream_may_be_read_while_the_interpreter_ends(tmp_path, backend):
    """In `__del__` after the threads have stopped, and at exit before; or an error tells that it cannot be."""
    done = run(
        tmp_path,
        f"""
        import atexit

        kernel, stream = long.compile({backend!r}), sh.Stream(np.zeros(3000), sh.Attrib1f, {backend!r})

        class Last:
            def __del__(self):
                print("read", len(self.kernel(self.stream, 2).numpy()), flush=True)

        last = Last()
        last.kernel, last.stream = kernel, stream
        atexit.register(lambda: print("at exit", len(kernel(stream, 2).numpy()), flush=True))
        """,
    )
    assert done.returncode == 0, done.stderr
    if backend == "glsl":
        assert done.stdout == "at exit 3000\n"
        assert "ShpyError: glsl cannot be used while the interpreter ends: the thread of its context" in done.stderr
    else:
        assert done.stdout == "at exit 3000\nread 3000\n", done.stderr
