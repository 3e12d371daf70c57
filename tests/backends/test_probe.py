"""Devices that round wrong: they are found by the probe, mended where that can be done, and else refused."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from backends.running import compiled_anew as compiled, differs, flushes_denormals

import shpy as sh
from shpy import SH_BREAK, SH_WHILE
from shpy.backend.base import Array, Options
from shpy.backend.device import probe
from shpy.backend.glsl.device.context import open_context
from shpy.backend.opencl.device import driver as device, trial
from shpy.backend.opencl.device.compiler_trials import TRIALS
from shpy.backend.opencl.device.driver import machine_of
from shpy.ir import ops
from shpy.ir.types import Base, vec
from shpy.passes.library import definition
from shpy.run.kernel import Kernel
from shpy.testing.conformance import zeros
from shpy.testing.conformance.exact import apply
from shpy.testing.reference import Reference


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


def test_devices_here_round_correctly() -> None:
    assert machine_of(None).wrong == frozenset()
    assert open_context(0).limits.wrong <= {"denormals", "exits", "fma"}


@pytest.mark.parametrize(
    ("right", "other", "fault"),
    [
        ("as_intWIDE(m < zero ? m : zero)", "as_intWIDE(m)", "zeros"),
        ("convert_intWIDE_sat(wide)", "(convert_intWIDE_sat(wide) | 1)", "convert_nan"),
    ],
)
def test_the_probe_tells_zeros_and_ints_of_nan_in_binary64(
    right: str, other: str, fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With another result in place of the device's, the fault is found, and no other."""
    assert device.EXACTNESS.count(right) == 1
    monkeypatch.setattr(device, "EXACTNESS", device.EXACTNESS.replace(right, other))
    machine = machine_of(None)
    assert machine._asked() == {fault}


def test_the_probe_finds_what_is_off_by_one() -> None:
    a, b, c = probe.hard_inputs()
    exact = {"add": a + b, "div": a / b, "sqrt": np.sqrt(a), "mul": a * b, "fma": ops.OPS["fma"].meaning(a, b, c)}
    assert probe.wrong_operations(exact) == frozenset()
    reciprocal = a * (np.float32(1) / b)
    assert probe.wrong_operations({"add": exact["add"], "div": reciprocal}) == {"div"}
    assert probe.wrong_operations({"sqrt": np.nextafter(exact["sqrt"], np.float32(0))}) == {"sqrt"}
    assert probe.wrong_operations({"fma": a * b + c}) == {"fma"}


def test_the_probe_knows_devices_that_flush_denormals() -> None:
    a, b, c = probe.hard_inputs()

    def flushed(x: Array) -> Array:
        return np.where(np.abs(x) < 2.0**-126, np.float32(0), x)

    fma = ops.OPS["fma"].meaning(a, b, c)
    assert (flushed(fma) != fma).any()
    assert probe.wrong_operations({"fma": flushed(fma), "mul": a * b}) == {"fma"}
    all_flushed = {"mul": flushed(a * b), "fma": np.where(c < 0, fma, 0)}
    assert probe.wrong_operations(all_flushed) == {"denormals"}
    assert probe.wrong_operations({**all_flushed, "fma": a * b + c}) == {"denormals", "fma"}


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("backend", "lanes"), [("opencl", 1), ("opencl", 8), ("glsl", "auto")])
def test_division_and_root_are_mended(backend: str, lanes: Any, wrong: Any) -> None:
    wrong("div", "sqrt")
    kernel = compiled(quotient, backend, lanes=lanes)
    assert "div_corrected(" in kernel.source
    assert "gets div and sqrt wrong" in kernel.notes[0]
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


def test_infinity_is_divided_where_reciprocals_underflow(monkeypatch: pytest.MonkeyPatch) -> None:
    """NVIDIA's GLSL multiplies by 1 / b, which is 0 for the largest numbers."""

    def by_reciprocal(a: Array, b: Array) -> Array:
        reciprocal = np.float32(1) / b
        return a * np.where(np.abs(reciprocal) < 2.0**-126, np.copysign(np.float32(0), reciprocal), reciprocal)

    special = np.float32([0, np.inf, np.nan, 1, 1.5, 2.0**-126, 2.0**126, 2.0**127, 3.4028235e38])
    a, b = (grid.ravel() for grid in np.meshgrid(*2 * [np.concatenate([special, -special])]))
    function = definition("div", (vec(Base.F),) * 2)
    with np.errstate(all="ignore"):
        wanted = a / b
        monkeypatch.setitem(ops.OPS, "div", replace(ops.OPS["div"], meaning=by_reciprocal))
        check(apply(function, a, b), wanted, flushed=True)


@sh.program
def fused(a: sh.Attrib1f, b: sh.Attrib1f, c: sh.Attrib1f) -> sh.Attrib1f:
    return sh.fma(a, b, c)


@sh.program
def whole(x: sh.Attrib1f, v: sh.Attrib3f):
    return sh.Attrib1i(x), sh.Attrib1u(x), sh.Attrib3i(v), sh.Attrib3u(v)


def triples() -> tuple[Array, Array, Array]:
    """Special numbers in all combinations, sums near a product, cancellation, denormals, and any bits."""
    rng = np.random.default_rng(4)
    edges = [0, 2.0**-149, 2.0**-127, 2.0**-126, 2.0**-75, 4097 * 2.0**-149, 3e-23, 0.1, 1, 1.5, 1 + 2.0**-23, 2.0**64]
    special = np.float32([*edges, 3.4028235e38, np.inf, np.nan])
    special = np.concatenate([special, -special])
    count = 1 << 15
    e, f = rng.integers(0, 255, (2, count))
    g = np.clip(e + f - 127 + rng.integers(-50, 30, count), 0, 254)
    low = rng.integers(0, 127, count)
    less = np.clip(126 - low - rng.integers(-5, 60, count), 0, 254)
    near, small = (
        [_numbers(rng, x) for x in exponents] for exponents in ((e, f, g), (low, less, rng.integers(0, 30, count)))
    )
    with np.errstate(all="ignore"):
        opposite = (near[0] * near[1]).view(np.uint32) + rng.integers(0, 3, count).astype(np.uint32)
    parts = [
        [grid.ravel() for grid in np.meshgrid(special, special, special)],
        near,
        small,
        [*near[:2], -opposite.view(np.float32)],
        list(rng.integers(0, 2**32, (3, count)).astype(np.uint32).view(np.float32)),
    ]
    a, b, c = (np.concatenate(list(arrays)) for arrays in zip(*parts, strict=True))
    return a, b, c


def _numbers(rng: np.random.Generator, exponent: Array) -> Array:
    """Numbers of these exponents, every third of which ends in zeros and every seventh in one or two bits."""
    m = rng.integers(0, 2**23, len(exponent))
    m[::3] &= 0x7FF000
    m[::7] &= 3
    return ((rng.integers(0, 2, len(exponent)) << 31) | (exponent << 23) | m).astype(np.uint32).view(np.float32)


def test_the_corrected_fma_is_exact() -> None:
    a, b, c = triples()
    with np.errstate(all="ignore"):
        wanted = ops.OPS["fma"].meaning(a, b, c)
    assert not differs(apply(definition("fma", (vec(Base.F),) * 3), a, b, c), wanted).any()


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("backend", "lanes"), [("opencl", 1), ("opencl", 8), ("glsl", "auto")])
def test_fma_is_corrected(backend: str, lanes: Any, wrong: Any) -> None:
    wrong("fma")
    kernel = compiled(fused, backend, lanes=lanes)
    assert "fma_corrected(" in kernel.source
    assert "gets fma wrong" in kernel.notes[0]
    given = triples()
    with np.errstate(all="ignore"):
        wanted = ops.OPS["fma"].meaning(*given)
    differ = differs(kernel(*given), wanted)
    if flushes_denormals(backend):
        differ &= ~np.any([(np.abs(x) < 2.0**-126) & (x != 0) for x in (*given, wanted)], axis=0)
    assert not differ.any()


def test_an_fma_of_the_device_is_used_where_it_rounds_once(wrong: Any) -> None:
    wrong()
    assert "= fma(a, b, c);" in compiled(fused, "glsl").source


def test_fast_mode_has_an_fma_on_a_device_that_lacks_one(wrong: Any) -> None:
    """GLSL 3.30 has no `fma`: such a device compiles fast mode alone, where the product may be rounded."""
    wrong(keeps_order=False)
    kernel = compiled(fused, "glsl", math="fast")
    assert "fma(" not in kernel.source
    assert kernel(np.float32(3), np.float32(0.5), np.float32(0.25)) == 1.75


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("backend", "lanes"), [("opencl", 1), ("opencl", 8), ("glsl", "auto")])
def test_an_int_of_nan_is_corrected(backend: str, lanes: Any, wrong: Any) -> None:
    wrong("convert_nan")
    kernel = compiled(whole, backend, lanes=lanes)
    assert "int of NaN" in kernel.notes[0]
    assert "x == x" in kernel.source
    x = np.float32([np.nan, -np.nan, 0, -0.0, 1.9, -1.9, 2.0**31, -(2.0**31), 4e9, 3e10, np.inf, -np.inf, 1e-45])
    given = x, np.stack([x, -x, x[::-1]], axis=-1)
    for found, wanted in zip(kernel(*given), Kernel(whole.recorded, Reference(), Options())(*given), strict=True):
        assert np.array_equal(found, wanted)


def test_first_values_of_a_loop_are_hidden_from_a_driver_that_misreads_its_exits(wrong: Any) -> None:
    @sh.program
    def stepping(a: sh.Attrib1f):
        v, n = sh.Attrib1i(0), sh.Attrib1i(0)
        with SH_WHILE(lambda: a > v):
            v += 1
            n += 2
            SH_BREAK(v == 0)
        return n

    for backend, zero in (("glsl", "int(zero)"), ("opencl", "sh_zero_i()")):
        wrong("exits")
        kernel = compiled(stepping, backend)
        assert [name for name in ("v", "n", "a") if f"    {name} += {zero};" in kernel.source] == ["v", "n"]
        assert "exits of loops" in " ".join(kernel.notes)
        wrong()
        assert zero not in compiled(stepping, backend).source


@pytest.mark.sampled(6)
@pytest.mark.parametrize("kind", [sh.Attrib1i, sh.Attrib1u, sh.Attrib2i, sh.Attrib1f])
@pytest.mark.parametrize(("lanes", "math"), [(1, "strict"), (1, "fast"), (8, "strict")])
def test_what_is_hidden_from_a_driver_that_misreads_exits_changes_no_result(
    kind: Any, lanes: int, math: Any, wrong: Any
) -> None:
    @sh.program
    def stepping(a: sh.Attrib1i):
        v, n, odd = kind(0), sh.Attrib1i(0), sh.Attrib1i(0)
        with SH_WHILE(lambda: n < 5):  # the same for all lanes
            n += 1
            SH_BREAK(n < 1)
        with SH_WHILE(lambda: odd < a):
            odd += 1
            v += 1
            SH_BREAK((v.x if kind is sh.Attrib2i else v) == kind(0).x)
        return n, odd, v

    wrong("exits")
    kernel = compiled(stepping, "opencl", lanes=lanes, math=math)
    assert "sh_zero" in kernel.source
    given = np.arange(11, dtype=np.int32)
    for found, wanted in zip(kernel(given), stepping.compile("numpy")(given), strict=True):
        assert np.array_equal(found, wanted)


@pytest.mark.sampled(2)
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


def test_a_trial_leaves_no_temporary_files(monkeypatch):
    """With drivers that keep no programs of their own, pyopencl writes a text that fails to a temporary file."""
    folders = []

    def failing(_command, *, env, **_options):
        folders.append(Path(env["TMPDIR"]))
        (folders[-1] / "text.cl").write_text("no such text")
        return subprocess.CompletedProcess((), 1, stdout="")

    monkeypatch.setattr(subprocess, "run", failing)
    with pytest.raises(trial.Unfinished, match="exit status 1"):
        trial.works((0, 0), [], {"any": trial.Trial("int", "", (3,), (6,))})
    assert not folders[0].exists()


def test_a_trial_that_does_not_end_has_failed_and_the_others_go_on(monkeypatch):
    asked = []

    def hanging(command, *, input, timeout, **_options):
        names = list(json.loads(input)["trials"])
        asked.append(names)
        if "endless" in names:
            told = b"trial first begun\ntrial first works\ntrial endless begun\n"
            raise subprocess.TimeoutExpired(command, timeout, output=told)
        return subprocess.CompletedProcess(command, 0, "trial last begun\ntrial last works\n", "")

    monkeypatch.setattr(subprocess, "run", hanging)
    any_trial = trial.Trial("int", "", (3,), (6,))
    assert trial.works((0, 0), [], dict.fromkeys(("first", "endless", "last"), any_trial)) == {"first", "last"}
    assert asked == [["first", "endless", "last"], ["last"]]


def test_abilities_that_could_not_be_tried_are_told_and_not_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "kept"))
    machine = device.Machine(machine_of(None).device)
    monkeypatch.setattr(machine, "_may_try", lambda key: False)

    def refused(*_command, **_options):
        raise OSError("no more processes")

    monkeypatch.setattr(subprocess, "run", refused)
    with pytest.warns(sh.ShpyWarning, match=r"may be slower than they could be: .* \(no more processes\)"):
        assert machine._succeeded == frozenset()
    assert not list((tmp_path / "kept").iterdir())


def test_abilities_are_tried_once_for_a_driver(tmp_path, monkeypatch):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "kept"))
    machine = machine_of(None)
    monkeypatch.delitem(vars(machine), "_succeeded", raising=False)
    asked = machine._succeeded
    assert {"shuffle", "elementwise", "wide32"} <= asked
    monkeypatch.delitem(vars(machine), "_succeeded")
    monkeypatch.setattr(device, "works", None)  # not to be called again
    assert machine._succeeded == asked


def counted(monkeypatch):
    """Return the list of the trials that other processes run from now on."""
    asked = []

    def works(place, options, trials):
        asked.append(list(trials))
        return trial.works(place, options, trials)

    monkeypatch.setattr(device, "works", works)
    return asked


@pytest.mark.sampled(2)
@pytest.mark.parametrize("nothing_kept", [False, True])
def test_pocl_is_tried_here_and_answers_as_another_process_does(tmp_path, monkeypatch, nothing_kept):
    """Another process runs them if nothing is kept on disk: no process could know that a trial ended one before."""
    monkeypatch.setenv("SHPY_CACHE_DIR", "" if nothing_kept else str(tmp_path))
    asked = counted(monkeypatch)
    machine = device.Machine(machine_of(None).device)
    assert machine._succeeded == trial.works(machine._place(), machine.options("strict"), TRIALS)
    assert bool(asked) == nothing_kept


def test_a_process_that_ended_by_a_trial_is_the_last_to_try_itself(tmp_path, monkeypatch):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path))
    asked = counted(monkeypatch)

    def end(*_):
        raise SystemExit

    with monkeypatch.context() as patch:
        patch.setattr(device, "outcomes_here", end)
        with pytest.raises(SystemExit):
            device.Machine(machine_of(None).device)._succeeded  # noqa: B018
    assert "wide32" in device.Machine(machine_of(None).device)._succeeded
    assert len(asked) == 1


def test_a_compiler_that_refuses_all_trials_at_once_is_asked_for_each(tmp_path, monkeypatch):
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path))
    whole = machine_of(None)._succeeded  # without AVX-512, two of the trials fail
    asked = counted(monkeypatch)
    broken = {**TRIALS, "reduce": trial.Trial("int8", "a[0] = no_such_function(a[0]);", (1,), (2,))}
    monkeypatch.setattr(device, "TRIALS", broken)
    assert "reduce" in whole
    assert device.Machine(machine_of(None).device)._succeeded == whole - {"reduce"}
    assert asked == [list(broken)]


def test_trials_in_one_kernel_fail_one_by_one():
    machine = machine_of(None)
    good = trial.Trial("int", "a[0] *= 2;", (3,), (6,))
    tried = {
        "first": good,
        "wrong": trial.Trial("int", "a[0] *= 2;", (3,), (7,)),
        "missing": trial.Trial("int", "a[0] = no_such_function(a[0]);", (3,), (4,), needs="__NO_SUCH_PROCESSOR__"),
        "floats": trial.Trial("float16", "a[0] *= 0.5f;", (3.0,) * 16, (1.5,) * 16),
        "last": good,
    }
    assert trial.outcomes(machine.cl, machine.context, [], tried, "") == {"first", "floats", "last"}
    tried["broken"] = trial.Trial("int", "a[0] = no_such_function(a[0]);", (3,), (3,))
    assert trial.outcomes(machine.cl, machine.context, [], tried, "") is None


def test_zeros_are_hidden_from_a_compiler_that_folds_them(wrong: Any) -> None:
    wrong("zeros")
    hidden = 0
    for number, case in enumerate(zeros.cases()[::2]):
        lanes = (1, 8)[number % 2]
        kernel = compiled(case.program, "opencl", lanes=lanes, **case.options)
        assert "confuses zeros" in kernel.notes[0]
        hidden += "sh_zero" in kernel.source
        assert not re.search(r"[^\w.]0\.0f", kernel.source), kernel.source
        case.check(case.run(f"opencl-{lanes}"), f"opencl-{lanes}")
    assert hidden > 5


def test_a_driver_that_refuses_the_kernel_of_the_probe_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oclgrind 21.10 builds it and then has no kernel of its name."""
    monkeypatch.setattr(device, "EXACTNESS", device.EXACTNESS.replace("void probe(", "void other("))
    with pytest.raises(sh.BackendUnavailable, match=r"refuses a small kernel of OpenCL C 1.2 \(.*KERNEL_NAME"):
        machine_of(None)._asked()
