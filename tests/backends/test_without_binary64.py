"""Devices without binary64: what is refused there, with which words, and what runs as everywhere."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from patience import HANGING

import shpy as sh
from shpy.backend.base import Options
from shpy.backend.device.probe import NO_BINARY64
from shpy.backend.glsl.device.context import open_context
from shpy.backend.opencl.device.driver import machine_of
from shpy.backend.registry import backend as backend_named
from shpy.ir.ops import TRANSCENDENTALS
from shpy.run import kernel as kernels
from shpy.run.kernel import Kernel
from shpy.testing.certify.findings import DeviceChoice, Section
from shpy.testing.certify.functions import function, sweep_checks
from shpy.testing.certify.sections import SectionRun, run_section

REFUSED = sorted(TRANSCENDENTALS)


@pytest.fixture
def without_binary64(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Takes binary64 from the devices of OpenCL and OpenGL; kernels of before are forgotten, and those compiled so."""
    context = open_context(0)
    monkeypatch.setitem(machine_of(None).__dict__, "binary64", frozenset())
    monkeypatch.setattr(context, "limits", replace(context.limits, doubles=False))
    _forget()
    yield
    _forget()


def _forget() -> None:
    kernels._executables.clear()
    function.cache_clear()


def compiled(program: sh.Program, backend: str, **options: Any) -> Kernel:
    """Compiled anew: not the kernel of a device with binary64."""
    kernels._executables.clear()
    if backend == "glsl":
        options.pop("lanes", None)
    return Kernel(program.recorded, backend_named(backend), Options(**options))


@pytest.mark.sampled(40)
@pytest.mark.parametrize("backend", ["opencl", "glsl"])
@pytest.mark.parametrize("name", REFUSED)
def test_functions_are_refused_and_run_in_portable_mode(name: str, backend: str, without_binary64: None) -> None:
    with pytest.raises(sh.CompileError, match=f"{name} needs binary64 in strict mode") as refused:
        compiled(function(name), backend)
    assert 'math="portable"' in str(refused.value)
    kernel = compiled(function(name), backend, math="portable")
    assert "double" not in kernel.source
    x = np.linspace(1.01, 1.99, 257, dtype=np.float32) - np.float32(name in ("asin", "acos", "atanh"))
    given = (x, x[::-1].copy())[: len(function(name).inputs)]
    wanted = function(name).compile("numpy", math="portable")(*given)
    np.testing.assert_array_equal(kernel(*given), wanted)


@sh.program
def slope(x: sh.Attrib1f) -> sh.Attrib1f:
    y = x + 1
    return sh.tan(y)  # the refused line


@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_the_refusal_names_the_line(backend: str, without_binary64: None) -> None:
    with pytest.raises(sh.CompileError) as refused:
        compiled(slope, backend)
    assert refused.value.loc is not None
    with open(__file__) as source:
        assert "the refused line" in source.readlines()[refused.value.loc.line - 1]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_other_modes_and_binary16_are_as_everywhere(backend: str, without_binary64: None) -> None:
    x = np.linspace(0.25, 1.25, 100, dtype=np.float32)
    for math in ("relaxed", "fast"):
        np.testing.assert_allclose(compiled(slope, backend, math=math)(x), np.tan(x + 1), rtol=2e-5)
    half = compiled(slope, backend, precision="f16")
    np.testing.assert_array_equal(half(x), slope.compile("numpy", precision="f16")(x))


def test_other_modes_do_not_ask_opencl_about_binary64(monkeypatch: pytest.MonkeyPatch) -> None:
    known = vars(machine_of(None))
    monkeypatch.delitem(known, "binary64", raising=False)
    for math in ("portable", "relaxed", "fast"):
        compiled(slope, "opencl", math=math)(np.float32([0.5]))
        assert "binary64" not in known
    compiled(slope, "opencl")
    assert "binary64" in known


@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_notes_say_what_a_device_lacks(backend: str, without_binary64: None, monkeypatch: pytest.MonkeyPatch) -> None:
    assert NO_BINARY64 in compiled(function("exp"), backend, math="portable").notes
    monkeypatch.undo()
    assert NO_BINARY64 not in compiled(function("exp"), backend).notes


@pytest.mark.parametrize("backend", ["opencl", "glsl"])
def test_certify_compares_what_there_is_and_names_what_is_refused(backend: str, without_binary64: None) -> None:
    names = ["tan", "tan, portable"]
    checks = [check for check in sweep_checks() if check.name in names]
    ran = SectionRun(Section("functions", "", None, checks))
    run_section(ran, DeviceChoice(backend), full=True, progress=lambda *_: None)
    refused = ran.findings.pop("tan")
    assert refused.verdict == "refused"
    assert refused.detail.startswith("tan needs binary64 in strict mode")
    assert ran.findings.keys() == {"tan, portable"}
    assert {finding.verdict for finding in ran.findings.values()} <= {"same", "denormals"}, ran.findings


LACKING = """
import sys

import numpy as np
import shpy as sh
from shpy.backend.glsl.device.context import open_context
assert not open_context(0).limits.doubles

@sh.program
def curve(x: sh.Attrib1f) -> sh.Attrib1f:
    return x * x + 1 / x

x = np.linspace(-3, 3, 1000, dtype=np.float32)
assert curve.compile("glsl")(x).tobytes() == curve.compile("numpy")(x).tobytes()

from raytracer import Scene, render
scene = Scene.builtin("mixed")
try:
    render(scene, (8, 8), backend="glsl")
except sh.ShpyError as error:
    print(error)
render(scene, (8, 8), backend="glsl", math="portable")

from raytracer import cli
words = ["render", "boxes", "--size", "8x8", "--backend", "glsl", "-o", sys.argv[1]]
assert cli.main(words) == 1
assert cli.main([*words, "--math", "portable"]) == 0
"""


def test_a_driver_without_the_extension(tmp_path: Path) -> None:
    environment = {**os.environ, "MESA_EXTENSION_OVERRIDE": "-GL_ARB_gpu_shader_fp64", "SHPY_CACHE_DIR": ""}

    def run(*command: str) -> str:
        done = subprocess.run(
            [sys.executable, *command], env=environment, capture_output=True, text=True, timeout=HANGING, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    said = run("-c", LACKING, str(tmp_path / "boxes.png"))
    assert "pow needs binary64 in strict mode" in said
    assert 'math="portable"' in said
    assert NO_BINARY64 in " ".join(run("-m", "shpy", "doctor").split())
