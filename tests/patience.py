"""Give the limits of waiting tests, which only end what hangs: they are far above the time that a busy machine takes.

Clocks go on while a virtual machine is paused, for half an hour at times. So a loop that polls counts its pauses: it is
`wait_until` of `pages`.

This module is also a plugin of pytest, which ends a test that computes without an end.
"""

import signal
from typing import Final

import pytest

HANGING: Final = 900.0
"""Seconds after which a process hangs; `faulthandler_timeout` of pyproject ends a test that takes twice as long."""
PAGE: Final = 120_000
"""Milliseconds that a test waits for a change of a page."""
LONGEST: Final = 300.0
"""Seconds of CPU, of all threads, that a test may take unless it is marked slow. Pauses of the machine do not count."""


def pytest_addoption(parser):
    """Let a test of this limit set another one."""
    parser.addoption("--cpu-limit", type=float, default=LONGEST, help="seconds of CPU after which a test fails")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Fail a test that computes without an end, and go on with the next one."""
    if item.get_closest_marker("slow"):
        return (yield)
    limit = item.config.getoption("--cpu-limit")

    def end(signum, frame):
        pytest.fail(f"the test has taken {limit:g} seconds of CPU: it hangs, or is to be marked slow")

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
