"""Devices that round wrong: they are found by the probe, mended where that can be done, and else refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from backends.running import differs, flushes_denormals

import shpy as sh
from shpy.backends import probe
from shpy.backends.base import Array, Options
from shpy.backends.glsl.context import open_context
from shpy.backends.opencl import device, trial
from shpy.backends.opencl.device import machine_of
from shpy.backends.registry import backend as backend_named
from shpy.ir import ops
from shpy.ir.types import Base, vec
from shpy.kernel import Kernel
from shpy.passes.library import definition
from shpy.testing.conformance.exact import apply


@sh.program
def quotient(a: sh.Attrib1f, b: sh.Attrib1f):
    return a / b, sh.sqrt(sh.abs(a))


@sh.program
def spread(v: sh.Attrib3f, b: sh.Attrib1f) -> sh.Attrib3f:
    return sh.floor(v / b)


def inputs() -> tuple[Array, Array]:
    """The hard inputs, and others of every size, with special ones in pairs."""
    rng = np.random.default_rng(2)
    a, b = (rng.uniform(1, 2, (2, 1 << 16)) * 2.0 ** rng.integers(-60, 61, (2, 1 << 16))).astype(np.float32)
    special = np.float32([0, -0.0, np.inf, -np.inf, np.nan, 1, -1.5, 3, 2.0**-126, -3.4028235e38, 0.99999994])
    c, d = (grid.ravel() for grid in np.meshgrid(special, special))
    hard = probe.hard_inputs()
    return np.concatenate([a, -a, c, hard[0]]), np.concatenate([b, b, d, hard[1]])


def check(found: Array, wanted: Array, flushed: bool = False) -> None:
    wrong = differs(found, wanted)
    # The quotient of the least number may be a denormal, which is not corrected.
    wrong &= ~(np.abs(wanted) < 2.0**-125) if flushed else ~((np.abs(wanted) < 2.0**-126) & (wanted != 0))
    assert not wrong.any()


@pytest.fixture
def wrong(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Makes every device one that gets these operations wrong."""

    def pretend(*names: str) -> None:
        machine, context = machine_of(None), open_context(0)
        monkeypatch.setitem(machine.__dict__, "wrong", frozenset(names))
        monkeypatch.setattr(context, "limits", replace(context.limits, wrong=frozenset(names)))

    return pretend


def compiled(program: sh.Program, backend: str, **options: Any) -> Kernel:
    """Compiled anew: not the kernel that a device without faults has."""
    from shpy import kernel

    kernel._executables.clear()
    return Kernel(program._recorded, backend_named(backend), Options(**options))


def test_devices_here_round_correctly() -> None:
    assert machine_of(None).wrong == frozenset()
    assert open_context(0).limits.wrong == frozenset()


def test_the_probe_finds_what_is_off_by_one() -> None:
    a, b = probe.hard_inputs()
    exact = {"add": a + b, "div": a / b, "sqrt": np.sqrt(a)}
    assert probe.wrong_operations(exact) == frozenset()
    reciprocal = a * (np.float32(1) / b)
    assert probe.wrong_operations({"add": exact["add"], "div": reciprocal}) == {"div"}
    assert probe.wrong_operations({"sqrt": np.nextafter(exact["sqrt"], np.float32(0))}) == {"sqrt"}


@pytest.mark.parametrize(("backend", "lanes"), [("opencl", 1), ("opencl", 8), ("glsl", "auto")])
def test_division_and_root_are_mended(backend: str, lanes: Any, wrong: Any) -> None:
    wrong("div", "sqrt")
    kernel = compiled(quotient, backend, lanes=lanes)
    assert "div_corrected(" in kernel.source
    assert "rounds div and sqrt wrong" in kernel.notes[0]
    a, b = inputs()
    found = kernel(a, b)
    with np.errstate(all="ignore"):
        check(found[0], a / b, flushes_denormals(backend))
        check(found[1], np.sqrt(np.abs(a)))


@pytest.mark.parametrize(("name", "off"), [("div", 40), ("sqrt", 8)])
def test_they_are_right_from_a_start_that_is_far_off(name: str, off: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    exact = {"div": np.divide, "sqrt": np.sqrt}

    def vague(operation: str) -> Any:
        def meaning(*args: Array) -> Array:
            result = np.asarray(exact[operation](*args))
            return (result * (1 + rng.integers(-off, off + 1, result.shape) * 2.0**-24)).astype(np.float32)

        return meaning

    a, b = inputs()
    kept = np.isfinite(a) & np.isfinite(b) & (a != 0) & (b != 0)
    a, b = np.abs(a[kept]), b[kept]
    function = definition(name, (vec(Base.F),) * (2 if name == "div" else 1))
    with np.errstate(all="ignore"):
        wanted = exact[name](*((a, b) if name == "div" else (a,)))
        for operation in exact:
            monkeypatch.setitem(ops.OPS, operation, replace(ops.OPS[operation], meaning=vague(operation)))
        check(apply(function, *((a, b) if name == "div" else (a,))), wanted)


@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_what_cannot_be_mended_is_refused(backend: str, wrong: Any) -> None:
    wrong("floor")
    with pytest.raises(sh.CompileError, match="gets floor wrong") as error:
        compiled(spread, backend)
    assert error.value.cure == 'math="relaxed"'
    assert error.value.loc is not None
    assert error.value.loc.file == __file__
    assert "floor" in compiled(spread, backend, math="relaxed").notes[0]
    assert compiled(quotient, backend).notes


def test_a_trial_that_fails_is_silent_and_one_that_ends_the_process_costs_no_other(capfd):
    good = trial.Trial("int", "a[0] *= 2;", (3,), (6,))
    wrong = trial.Trial("int", "a[0] *= 2;", (3,), (7,))
    broken = trial.Trial("int", "a[0] = no_such_function(a[0]);", (3,), (3,))
    deadly = trial.Trial("int", "not a type", (3,), ("ends the process",))
    place = machine_of(None)._place()
    tried = {"first": good, "broken": broken, "deadly": deadly, "wrong": wrong, "last": good}
    assert trial.works(place, [], tried) == {"first", "last"}
    assert capfd.readouterr() == ("", "")


def test_abilities_are_tried_once_for_a_driver(tmp_path, monkeypatch):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "kept"))
    machine = machine_of(None)
    monkeypatch.delitem(vars(machine), "abilities", raising=False)
    asked = machine.abilities
    assert asked.shuffle
    monkeypatch.delitem(vars(machine), "abilities")
    monkeypatch.setattr(device, "works", None)  # not to be called again
    assert machine.abilities == asked
