"""Ctrl-C ends a wait for a device also where its signal comes just before the wait, and does not interrupt it."""

import signal
import threading
from contextlib import contextmanager

import pytest
from patience import HANGING

from shpy.backend.glsl.device.context import open_context
from shpy.backend.opencl.device.waiting import Waiter


@contextmanager
def unheard():
    """Have signals reach other threads alone: Python notes them, and no wait of the main thread is interrupted."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Run:
    """A run of a device, in which Ctrl-C is pressed; it goes on until the caller has let go."""

    def __init__(self):
        self.let_go, self.ends = threading.Event(), []

    def wait(self):
        signal.raise_signal(signal.SIGINT)
        self.ends.append(self.let_go.wait(HANGING))


class Ended:
    """A run that has ended."""

    def wait(self):
        pass


def check(waits):
    """Interrupt the wait for a run; another wait follows, since a device's thread takes one after the other."""
    waits(Ended())
    run = Run()
    with unheard(), pytest.raises(KeyboardInterrupt):
        waits(run)
    run.let_go.set()
    waits(Ended())
    assert run.ends == [True]


def test_on_opencl():
    check(Waiter(threading.Lock()).wait)


def test_on_glsl():
    context = open_context(None)
    check(lambda run: context.call(run.wait))
