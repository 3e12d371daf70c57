"""While a driver compiles the wanted kernel, numpy draws the first frame alone, and others with rests between them."""

import asyncio
import os
import queue
import signal
import subprocess
import sys
import threading

import pytest
from pages import wait_until
from patience import HANGING

import shpy as sh
from shpy.programs import Program
from shpy.view import kernels, session, workers
from shpy.view.kernels import Form, Kernels

WANTED, QUICK = Form("opencl", "strict"), Form("numpy", "strict")
MOVING = """
import shpy as sh

@sh.program
def picture(uv: sh.TexCoord2f, time: sh.Attrib1f) -> sh.Color3f:
    return uv.x * sh.sin(time) * sh.Color3f(1, 1, 1)
"""


@sh.program
def bright(uv: sh.TexCoord2f) -> sh.Attrib1f:
    return uv.x


@pytest.fixture
def driver(monkeypatch):
    """Compile for numpy in place of OpenCL, once `ready` is set; `asked` has the backends in order."""

    class Driver:
        ready, asked = threading.Event(), []

    compiled = Program.compile

    def compile(program, target, **options):
        Driver.asked.append(target)
        if target == WANTED.backend:
            assert Driver.ready.wait(HANGING)
        return compiled(program, "numpy", **options)

    monkeypatch.setattr(Program, "compile", compile)
    yield Driver
    Driver.ready.set()


@pytest.fixture
def opened(tmp_path, driver):
    """Return a session whose picture moves, and the wakes that it was sent."""
    path = tmp_path / "shader.py"
    path.write_text(MOVING)
    wakes = queue.SimpleQueue()
    found = session.Session({"path": str(path)}, lambda: wakes.put(None), lambda header: None)
    found.set({"backend": "opencl", "size": [8, 8]})
    return found, wakes


SWAPPED = """
import shpy as sh

first = sh.Param(sh.Attrib1f, 0.5)
second = sh.Param(sh.Attrib1f, 0.5)

@sh.program
def picture(uv: sh.TexCoord2f) -> sh.Color3f:
    return second * first * sh.Color3f(uv, 1)
"""


def test_controls_stand_in_the_order_of_the_file(tmp_path):
    path = tmp_path / "shader.py"
    path.write_text(SWAPPED)
    found = session.Session({"path": str(path)}, lambda: None, lambda header: None)
    assert list(found.subject.params) == ["second", "first"]
    assert [control["name"] for control in found.describe()["controls"]] == ["first", "second"]


def form_of(frame):
    return frame[0]["form"]


def woken(view, wakes):
    """Take one wake, as the worker does."""
    wakes.get(timeout=HANGING)
    view.woken()


def test_the_wanted_kernel_compiles_behind_the_quick_one_s_first_frame(monkeypatch, driver):
    monkeypatch.setattr(kernels, "_HEAD_START", 3600)
    found = Kernels(bright, lambda: None)
    assert found.best(WANTED)[1] == QUICK
    assert driver.asked == ["numpy"]
    assert found.is_awaited(WANTED)  # so that the page says that it is to come
    assert found.best(WANTED)[1] == QUICK
    wait_until(lambda: driver.asked == ["numpy", "opencl"])
    driver.ready.set()
    wait_until(lambda: found.best(WANTED)[1] == WANTED)
    assert not found.is_awaited(WANTED)
    assert driver.asked == ["numpy", "opencl"]


def test_a_slow_first_frame_does_not_hold_the_wanted_kernel_back(monkeypatch, driver):
    monkeypatch.setattr(kernels, "_HEAD_START", 0.01)
    found = Kernels(bright, lambda: None)
    found.best(WANTED)
    wait_until(lambda: driver.asked == ["numpy", "opencl"])


def test_a_rest_lets_the_driver_compile_and_the_kernel_ends_it(monkeypatch, driver, opened):
    monkeypatch.setattr(kernels, "_HEAD_START", 3600)
    monkeypatch.setattr(session, "_REST", 1e6)
    view, wakes = opened
    assert form_of(view.next()) == "numpy"
    assert view.next() is None
    wait_until(lambda: driver.asked == ["numpy", "opencl"])  # at once, though the rest goes on
    woken(view, wakes)  # by numpy's kernel
    assert view.next() is None
    driver.ready.set()
    woken(view, wakes)
    assert form_of(view.next()) == "opencl"


def test_a_rest_ends_by_itself_and_by_whoever_changes_something(monkeypatch, driver, opened):
    monkeypatch.setattr(session, "_REST", 0.01)
    view, wakes = opened
    assert form_of(view.next()) == "numpy"
    woken(view, wakes)  # by numpy's kernel
    woken(view, wakes)
    assert form_of(view.next()) == "numpy"
    monkeypatch.setattr(session, "_REST", 1e6)
    view.set({})
    assert form_of(view.next()) == "numpy"
    assert view.next() is None
    view.set({"params": {}})
    assert form_of(view.next()) == "numpy"


def test_the_end_of_a_rest_computes_no_picture_again(monkeypatch, driver, opened):
    monkeypatch.setattr(session, "_REST", 1.0)
    view, _ = opened
    view.set({"playing": False})
    assert form_of(view.next()) == "numpy"
    driver.ready.set()
    wait_until(lambda: not view.subject.is_awaited(WANTED))
    view.woken()
    assert form_of(view.next()) == "opencl"
    assert view.next() is None
    view.woken()  # by the timer of the rest, which the kernel has ended
    assert view.next() is None


def test_a_replaced_worker_is_not_waited_for_until_the_pool_closes(monkeypatch):
    async def replace():
        pool = workers.Pool("shpy.view.session", lambda worker, message: None)
        worker = await pool.take()
        waits = []
        wait = worker.process.wait
        monkeypatch.setattr(worker.process, "wait", lambda: waits.append(wait()))
        worker.kill()
        assert waits == []
        pool.close()
        return waits, worker.status

    waits, status = asyncio.run(replace())
    assert waits == [-signal.SIGKILL] == [status]


SERVING = """
import sys, time
from pages import end_by_signal, viewed

end_by_signal()
with viewed(sys.argv[1], "--backend", "numpy") as view:
    print(view.process.pid, flush=True)
    time.sleep(3600)
"""


def test_a_benchmark_that_is_ended_ends_its_server(tmp_path):
    path = tmp_path / "shader.py"
    path.write_text(MOVING)
    command = [sys.executable, "-c", SERVING, str(path)]
    settings = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=settings) as process:
        server = int(process.stdout.readline())
        os.kill(server, 0)
        process.terminate()
        assert process.wait(HANGING) == 128 + signal.SIGTERM
    with pytest.raises(ProcessLookupError):
        os.kill(server, 0)
