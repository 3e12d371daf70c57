"""Ctrl-C at each line of the way from numpy to OpenCL: it ends the call, whatever error it comes out as on its way.

Python's cycle collector is on afterwards: a process without it takes 17 MB more for each program that is compiled.
"""

import gc
import importlib
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from patience import HANGING
from stress.interrupts import hears_nothing
from test_auto import EAGER

import shpy as sh
from shpy.backend import registry
from shpy.backend.base import Call
from shpy.backend.opencl.device import building as opencl
from shpy.run import tiers

SHPY = str(Path(sh.__file__).parent)
TAKEOVER = ("run/tiers.py", "backend/slow.py", "backend/registry.py", "device/building.py", "device/driver.py")
COLLECTOR = "ir/collector.py"
"""The files of which one line in `OWN` is interrupted in every run, of others one in `OTHERS`."""
OWN, OTHERS = 40, 600
X = np.linspace(0, 1, 70_000, dtype=np.float32)


@sh.program
def wave(x: sh.Attrib1f):
    return sh.sin(x) * 3 + x


class Interrupts:
    """A trace function that raises KeyboardInterrupt at a line of shpy; without one it lists the lines that run."""

    def __init__(self, at=None):
        self.at, self.lines, self.done = at, {}, False

    def __call__(self, frame, event, _):
        if self.done or not frame.f_code.co_filename.startswith(SHPY):
            return None
        entered = set()

        def follow(frame, event, _):
            if event == "line" and not self.done and not hears_nothing(frame, entered):
                line = frame.f_code.co_filename, frame.f_lineno
                self.lines[line] = None
                if line == self.at:
                    self.done = True
                    raise KeyboardInterrupt
            return follow

        return follow


def taken_over(at=None):
    """Run a new executable until OpenCL has taken over, interrupted at a line; return it, its result and the lines."""
    executable = tiers.auto.compile(wave.ir, wave.compile("auto").options)
    interrupts, out = Interrupts(at), np.empty_like(X)
    before = sys.gettrace()
    sys.settrace(interrupts)
    try:
        executable.run(Call(X.shape, (X,), (out,), {}, {}))
    finally:
        sys.settrace(before)
    return executable, out, interrupts


@pytest.fixture
def eager(monkeypatch):
    for name, value in EAGER.items():
        monkeypatch.setattr(tiers, name, value)


def check_interrupted(lines):
    expected = wave.compile("numpy")(X).tobytes()
    wrong = []
    for line in lines:
        try:
            executable, _, interrupts = taken_over(line)
        except KeyboardInterrupt:
            continue
        # The way may leave out a line at another time, such as one that stores what is then known.
        wrong += [line] if interrupts.done else []
        out = np.empty_like(X)
        executable.run(Call(X.shape, (X,), (out,), {}, {}))
        wrong += [(line, "bits")] if out.tobytes() != expected else []
        wrong += [] if gc.isenabled() else [(line, "the cycle collector is off")]
    assert wrong == []


def lines_of_takeover():
    first, out, interrupts = taken_over()
    assert first.runs_on == "opencl"
    assert out.tobytes() == wave.compile("numpy")(X).tobytes()
    lines = list(interrupts.lines)
    assert len(lines) > 500
    return first, lines


def test_ctrl_c_at_a_line_of_the_takeover_ends_the_call(eager):
    first, lines = lines_of_takeover()  # which holds the driver's program, so that it is not built again
    own = [line for line in lines if line[0].endswith(TAKEOVER)]
    assert len(own) > 60
    collector = [line for line in lines if line[0].endswith(COLLECTOR)]
    assert len(collector) > 10
    check_interrupted([*own[::OWN], *collector, *[line for line in lines if line not in own][::OTHERS]])
    del first


@pytest.mark.slow
def test_ctrl_c_at_any_line_of_the_takeover_ends_the_call(eager):
    first, lines = lines_of_takeover()
    check_interrupted(lines)
    del first


def test_an_interrupt_that_became_another_error_is_no_refusal(eager, monkeypatch):
    """As where a lock is released that the interrupted thread has not taken again."""

    def interrupted(self, module, options):
        try:
            raise KeyboardInterrupt
        finally:
            raise RuntimeError("release unlocked lock")

    monkeypatch.setattr(opencl.OpenCLBackend, "compile", interrupted)
    with pytest.raises(KeyboardInterrupt):
        taken_over()


def test_an_earlier_interrupt_does_not_replace_a_refusal(eager, monkeypatch):
    def refuse(self, module, options):
        raise sh.CompileError("this driver refuses everything")

    monkeypatch.setattr(opencl.OpenCLBackend, "compile", refuse)
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt:
        executable, _, _ = taken_over()
    assert executable.notes[-1] == "runs on numpy: opencl does not take it (this driver refuses everything)"


def test_an_interrupt_while_a_class_is_made_stays_one(tmp_path, monkeypatch):
    """Before Python 3.12 RuntimeError replaces what a `__set_name__` raises, such as that of a cached_property."""
    (tmp_path / "interrupted_backend.py").write_text(
        textwrap.dedent("""
        class Name:
            def __set_name__(self, owner, name):
                raise KeyboardInterrupt

        class Machine:
            name = Name()
        """)
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(registry._MODULES, "numpy", "interrupted_backend")
    monkeypatch.setattr(registry, "_backends", {})
    importlib.invalidate_caches()
    with pytest.raises(KeyboardInterrupt):
        registry.backend("numpy")


def test_ctrl_c_while_pyopencl_is_imported_ends_the_process_by_sigint(tmp_path):
    """While another thread imports and calls `exec`, CPython forgets by what the main one ended."""
    (tmp_path / "long_import.py").write_text(
        textwrap.dedent("""
        import os, signal, time
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(100):
            exec("1")
            time.sleep(0.002)
        """)
    )
    text = (
        "import atexit, time; atexit.register(time.sleep, 0.3); "
        "from shpy.backend.opencl.device import loading; loading._imported('long_import')"
    )
    ended = subprocess.run(
        [sys.executable, "-c", text],
        env={
            **os.environ,
            "SHPY_CACHE_DIR": "",
            "PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path(SHPY).parent)]),
        },
        capture_output=True,
        text=True,
        timeout=HANGING,
        check=False,
    )
    assert ended.returncode == -signal.SIGINT, ended.stderr
    assert ended.stderr.rstrip().endswith("KeyboardInterrupt")


def test_the_caller_imports_nothing_of_pyopencl_after_it_is_loaded():
    """Ctrl-C in such an import left half an object of pytools: its destructor wrote a second error."""
    text = """
    import sys, numpy as np, shpy as sh
    from shpy.backend.opencl.device.loading import pyopencl
    pyopencl()
    before = set(sys.modules)
    @sh.program
    def twice(x: sh.Attrib1f):
        return x * 2
    twice.compile("opencl")(np.ones(100_000, np.float32))
    print([name for name in set(sys.modules) - before if name.startswith(("pyopencl", "pytools", "platformdirs"))])
    """
    ran = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(text)], capture_output=True, text=True, timeout=HANGING, check=True
    )
    assert ran.stdout == "[]\n"


@pytest.mark.parametrize("part", [range(0, 90, 6), pytest.param(range(90), marks=pytest.mark.slow)], ids=["few", "all"])
def test_ctrl_c_at_a_line_of_the_takeover_of_a_chain_ends_its_run(eager, monkeypatch, part):
    """The next run has the bits of numpy, on whichever backend it is."""
    monkeypatch.setenv("SHPY_BACKEND", "auto")
    monkeypatch.setattr(registry, "_default", None)
    few = X[:500]
    expected = sh.repeat(wave, 3).run(x=few, backend="numpy").streams["x"].numpy().tobytes()

    def run(chain, at=None):
        interrupts, before = Interrupts(at), sys.gettrace()
        sys.settrace(interrupts)
        try:
            chain.run(x=few)
        finally:
            sys.settrace(before)
        return interrupts

    chain = sh.repeat(wave, 3)
    own = [line for line in run(chain).lines if line[0].endswith("chains/takeover.py")]
    assert chain.runs_on == "opencl"
    assert 40 < len(own) < 90
    for line in (own[k] for k in part if k < len(own)):
        chain = sh.repeat(wave, 3)
        with pytest.raises(KeyboardInterrupt):
            run(chain, line)
        for _ in range(2):
            assert chain.run(x=few).streams["x"].numpy().tobytes() == expected, line
        assert chain.runs_on == "opencl", (line, chain.notes)
