"""A process that compiles: its tasks and their refusals, and that neither it nor its parent keeps the other alive."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial

import pytest
from pages import wait_until
from patience import HANGING

from shpy.backend.opencl.device.background import Background, Refused


@pytest.fixture
def elsewhere():
    made = Background()
    yield made
    made._end()


def test_tasks_run_in_one_other_process(elsewhere):
    found = [elsewhere.submit(os.getpid) for _ in range(2)]
    first, second = (answer.result(HANGING) for answer in found)
    assert first == second != os.getpid()


def test_a_task_that_raises_says_why_and_the_next_one_runs(elsewhere):
    with pytest.raises(Refused, match=r"^ValueError: invalid literal"):
        elsewhere.submit(partial(int, "x")).result(HANGING)
    assert elsewhere.submit(partial(int, "7")).result(HANGING) == 7


def test_what_is_printed_is_no_answer(elsewhere):
    assert elsewhere.submit(partial(os.write, 1, b"done")).result(HANGING) == 4


def test_a_task_may_end_the_process(elsewhere):
    """As a driver's compiler may: the next task has another process."""
    with pytest.raises(Refused, match=r"^the process that compiles ended$"):
        elsewhere.submit(partial(os._exit, 3)).result(HANGING)
    assert elsewhere.submit(partial(int, "7")).result(HANGING) == 7


def test_a_task_that_cannot_be_sent_is_refused(elsewhere):
    with pytest.raises(Refused, match="local object"):
        elsewhere.submit(lambda: 7).result(HANGING)


def test_a_program_without_a_python_has_no_process(elsewhere, monkeypatch):
    monkeypatch.setattr(sys, "executable", "")
    with pytest.raises(Refused, match=r"^there is no Python to compile in another process$"):
        elsewhere.submit(os.getpid).result(HANGING)


def test_nobody_waits_for_a_task_whose_result_nobody_wants(elsewhere, tmp_path):
    first = elsewhere.submit(partial(time.sleep, 0.1))
    unwanted = tmp_path / "unwanted"
    elsewhere.submit(partial(unwanted.mkdir))
    elsewhere.submit(os.getpid).result(HANGING)
    assert first.ended
    assert not unwanted.exists()


COMPILING = """
import os, signal, sys, time
from functools import partial
from patience import HANGING
from shpy.backend.opencl.device.background import background
found = background().submit(os.getpid)
pid = found.result(HANGING)
slow = background().submit(partial(time.sleep, 2 * HANGING))
while not background().busy:
    pass
print(pid, flush=True)
"""


def run(ending, *, stop=None):
    """Run a program whose background process has hours of work; return its exit status, that process and its words."""
    path = os.pathsep.join(p for p in sys.path if p)
    program = subprocess.Popen(
        # From Python 3.12 on a fork beside threads is warned of.
        [sys.executable, "-W", "ignore::DeprecationWarning", "-c", COMPILING + ending],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )
    pid = int(program.stdout.readline())
    if stop is not None:
        program.send_signal(stop)
    _, told = program.communicate(timeout=HANGING)
    return program.returncode, pid, told


def has_ended(pid):
    """Return whether a process is gone, or has a status that nobody has asked for yet."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


@pytest.mark.parametrize(
    ("ending", "stop", "status"),
    [
        ("", None, 0),
        ("sys.exit(3)", None, 3),
        ("os._exit(4)", None, 4),
        ("time.sleep(HANGING)", signal.SIGINT, -signal.SIGINT),
        ("time.sleep(HANGING)", signal.SIGKILL, -signal.SIGKILL),
        ("pid = os.fork()\nif pid: print(os.waitpid(pid, 0)[1], file=sys.stderr)\nelse: sys.exit(0)", None, 0),
        ("if not os.fork(): time.sleep(3); os._exit(0)", None, 0),
    ],
    ids=["the end", "exit", "at once", "Ctrl-C", "killed", "fork that ends", "fork that stays"],
)
def test_a_process_ends_while_another_one_compiles(ending, stop, status):
    """So does that one, without a word; a forked child ends too, and lets its parent's process be."""
    code, pid, told = run(ending, stop=stop)
    assert code == status
    if "waitpid" in ending:
        assert told == "0\n"
    elif stop != signal.SIGINT:
        assert told == ""
    wait_until(lambda: has_ended(pid))  # long before its task would end
