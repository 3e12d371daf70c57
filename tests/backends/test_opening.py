"""A device is opened once, also where eight threads compile first: one context, one queue, one memory."""

import json
import os
import subprocess
import sys
import threading
import time

import pytest
from patience import HANGING
from test_processes import ROOT

from shpy.backend.device.once import once, once_of_each

THREADS = 8

SCRIPT = """
import collections, importlib, json, sys, threading
import numpy as np
import shpy as sh
from shpy.backend.registry import backend as named

name = sys.argv[1]
opened = collections.Counter()


def counting(path):
    module, _, kind = path.rpartition(".")
    cls = getattr(importlib.import_module("shpy.backend." + module), kind)
    make = cls.__init__

    def counted(self, *args, **options):
        make(self, *args, **options)
        opened[kind] += 1  # not for the first of EGL's devices that is not there

    cls.__init__ = counted


for path in {
    "opencl": ("opencl.device.driver.Machine", "opencl.device.memory.OpenCLSpace", "opencl.device.memory.Tables",
               "opencl.device.waiting.Waiter"),
    "glsl": ("glsl.device.context.Context", "glsl.device.run.Runtime", "glsl.device.memory.GlslSpace",
             "glsl.device.textures.Store"),
}[name]:
    counting(path)

TABLE = sh.Table(np.arange(4, dtype=np.float32), sh.Attrib1f)


@sh.program
def add(x: sh.Attrib1f) -> sh.Attrib1f:
    return x + TABLE[1]


start, wrong = threading.Barrier(8), []


def work(k):
    start.wait()
    try:
        kernel = add.compile(name)
        if k % 2:
            found = kernel(np.full(9, k, np.float32))
        else:
            stream = sh.Stream(np.full(9, k, np.float32), sh.Attrib1f, backend=name)
            found = kernel(kernel(stream)).numpy() - 1
        if (found != k + 1).any():
            wrong.append(found.tolist())
    except Exception as error:
        wrong.append(repr(error))


threads = [threading.Thread(target=work, args=(k,)) for k in range(8)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(json.dumps([wrong, opened]))
"""


def opened_by_threads(backend, tmp_path):
    environment = os.environ | {"PYTHONPATH": ROOT, "SHPY_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, backend], env=environment, text=True, capture_output=True, timeout=HANGING
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_eight_threads_open_a_device_once(backend, tmp_path):
    wrong, opened = opened_by_threads(backend, tmp_path)
    assert wrong == []
    assert opened
    assert set(opened.values()) == {1}, opened


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_fifty_processes_open_each_device_once(backend, tmp_path):
    for _ in range(50):
        wrong, opened = opened_by_threads(backend, tmp_path)
        assert wrong == []
        assert set(opened.values()) == {1}, opened


def at_once(work):
    start, found = threading.Barrier(THREADS), []

    def run():
        start.wait()
        found.append(work())

    threads = [threading.Thread(target=run) for _ in range(THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return found


def test_what_is_made_once_is_the_same_for_every_thread(impatient):
    class Opened:
        def __init__(self):
            self.lock, self.asked = threading.RLock(), 0

        @once_of_each
        def wrong(self):
            """The faults."""
            self.asked += 1
            time.sleep(1e-4)
            return object()

    @once
    def opened(index):
        made.append(index)
        time.sleep(1e-4)
        return Opened()

    for _ in range(50):
        made = []
        found = at_once(lambda: opened(0))
        assert len(set(map(id, found))) == len(made) == 1
        [*_, one] = found
        assert len(set(map(id, at_once(lambda one=one: one.wrong)))) == one.asked == 1
        opened.forget()
    assert Opened.wrong.__doc__ == "The faults."


def test_an_error_is_not_kept():
    @once
    def opened(index):
        tried.append(index)
        if len(tried) < 3:
            raise OSError("no device")
        return index

    tried = []
    for _ in range(2):
        with pytest.raises(OSError, match="no device"):
            opened(4)
    assert (opened(4), opened(4), tried) == (4, 4, [4, 4, 4])


def test_a_child_that_is_forked_while_a_thread_opens_a_device_does_not_wait_for_it():
    begun, end = threading.Event(), threading.Event()

    @once
    def opened(index):
        begun.set()
        end.wait(HANGING)
        return index

    thread = threading.Thread(target=opened, args=(1,))
    thread.start()
    begun.wait(HANGING)
    child = os.fork()
    if not child:
        end.set()
        os._exit(opened(1))
    try:
        waited = time.monotonic()
        while (ended := os.waitpid(child, os.WNOHANG)) == (0, 0) and time.monotonic() < waited + HANGING:
            time.sleep(0.01)
        assert os.waitstatus_to_exitcode(ended[1]) == 1
    finally:
        end.set()
        thread.join()
