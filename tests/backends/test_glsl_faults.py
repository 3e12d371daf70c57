"""Faults of OpenGL drivers that only their texts correct: found by what shaders draw, and hidden from compilers."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from backends.running import compiled_anew as compiled, differs, flushes_denormals
from patience import HANGING

import shpy as sh
from shpy import SH_ELSE, SH_IF
from shpy.backend import glsl
from shpy.backend.base import Options
from shpy.backend.device import probe
from shpy.backend.glsl.device import probes
from shpy.backend.glsl.device.context import open_context
from shpy.backend.registry import backend as backend_named
from shpy.ir.exact import hard_cases
from shpy.run.kernel import Kernel
from shpy.testing.arrays import flat_leaves
from shpy.testing.certify.functions import function
from shpy.testing.reference import Reference


@sh.program
def sorted_out(x: sh.Attrib1f, v: sh.Attrib2f, high: sh.Attrib1f) -> sh.Attrib3f:
    found = sh.Attrib3f(0)
    for n, holds in enumerate((x < high, x >= high, sh.all(v > high))):
        with SH_IF(holds):
            pass
        with SH_ELSE():
            found[n] = 1
    return found


def test_softpipe_is_refused() -> None:
    """It stores into the arrays of other elements, in silence."""
    environment = {**os.environ, "LIBGL_ALWAYS_SOFTWARE": "1", "GALLIUM_DRIVER": "softpipe"}
    command = [sys.executable, "-c", "import shpy as sh; print(sh.backends()[2].reason)"]
    process = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=HANGING, check=True)
    assert process.stdout.startswith("glsl needs OpenGL 3.3 without a window: Mesa's softpipe mixes up the arrays")


def test_a_device_without_precise_has_fast_mode_alone(wrong: Any) -> None:
    wrong(keeps_order=False)
    for math in ("strict", "portable", "relaxed"):
        with pytest.raises(sh.CompileError, match=f"{math} mode needs GL_ARB_gpu_shader5") as error:
            compiled(sorted_out, "glsl", math=math)
        assert error.value.cure == 'math="fast", or backend="numpy"'
        assert error.value.loc is not None
    kernel = compiled(sorted_out, "glsl", math="fast")
    assert 'programs compile with math="fast" alone' in " ".join(kernel.notes)
    assert kernel(1.0, (2.0, 3.0), 2.0).tolist() == [0, 1, 1]


def test_comparisons_are_hidden_where_a_driver_negates_them(wrong: Any) -> None:
    x, high = (grid.ravel() for grid in np.meshgrid(*2 * [np.float32([np.nan, 1, 2, np.inf, -np.inf])]))
    given = x, np.stack([x, -x], axis=-1), high
    wanted = Kernel(sorted_out.recorded, Reference(), Options())(*given)
    for hidden in (True, False):
        wrong(negates=not hidden, signs=True)
        kernel = compiled(sorted_out, "glsl")
        assert ("sh_keep(x < high)" in kernel.source) == hidden
        assert ("!(a < b)" in " ".join(kernel.notes)) == hidden
        if hidden:
            assert np.array_equal(kernel(*given), wanted)


@sh.program
def signs(m: sh.Attrib2f, z: sh.Attrib1f, x: sh.Attrib1f):
    """Zeros that are chosen, of which a product shows the sign."""
    kept = sh.Attrib1f(m.x)
    with SH_IF(~(m.x >= z)):
        kept[:] = z
    chosen = (
        *(sh.cond(c, m.x, z) for c in (m.x >= z, m.x <= z, m.x > z, ~(m.x < z), (m.x >= z) & ~sh.isnan(m.y))),
        sh.cond((m.x < z) | (m.x != m.x), z, m.x),
        *(f(*pair) for f in (sh.min, sh.max) for pair in ((m.x, z), (z, m.x), (m.x, 0.0))),
        sh.clamp(m.x, 0.0, 1.0),
        sh.clamp(m.x, -1.0, z),
        sh.max(m, z).y,
        kept,
    )
    return tuple(c * x for c in chosen)


def test_signs_of_zeros_are_kept_where_a_driver_takes_choices_for_maxima(wrong: Any) -> None:
    m, z, x = (grid.ravel() for grid in np.meshgrid(*2 * [np.float32([0.0, -0.0, 1, -1, np.nan])], np.float32([-2, 3])))
    given = np.stack([m, -m], axis=-1), z, x
    expected = flat_leaves(signs.compile("numpy")(*given))
    for device in ({}, {"signs": False}, {"signs": True}):
        if device:
            wrong(**device)
        kernel = compiled(signs, "glsl")
        if device:
            hidden = not device["signs"]
            assert ("sh_keep(m.x >= z)" in kernel.source) == hidden
            assert ("sh_keep(a < b) || a != a" in kernel.source) == hidden
            assert ("signs of zeros" in " ".join(kernel.notes)) == hidden
        if device != {"signs": True}:
            found = flat_leaves(kernel(*given))
            assert [k for k, (f, e) in enumerate(zip(found, expected, strict=True)) if differs(f, e).any()] == []


@pytest.mark.parametrize("fault", ["negates", "signs"])
def test_operands_of_a_hidden_comparison_keep_their_order(fault: str, wrong: Any) -> None:
    """They are arguments of a function then, and Mesa would compute 0.9 * x * x * x in another order there."""

    @sh.program
    def of_cube(x: sh.Attrib1f):
        y = 0.9 * x * x * x
        return sh.cond(y > 0.9 * (x * x * x), y, -y)

    x = np.linspace(0, 1, 5000, dtype=np.float32)
    expected = of_cube.compile("numpy")(x)
    assert set(np.sign(expected)) == {-1, 0, 1}
    wrong(**{fault: False})
    kernel = compiled(of_cube, "glsl")
    assert "sh_keep(" in kernel.source
    assert np.array_equal(kernel(x), expected)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", ["asin", "acos", "asinh", "acosh", "hypot"])
def test_square_roots_of_binary64_are_corrected(name: str, wrong: Any) -> None:
    wrong(roots=False)
    kernel = compiled(function(name), "glsl")
    assert "sh_sqrt(" in kernel.source
    assert "sqrt of binary64" in " ".join(kernel.notes)
    if name == "hypot":
        given = (*(np.float32(2) ** np.random.default_rng(6).uniform(-40, 40, (2, 1 << 16))).astype(np.float32),)
        [answers] = flat_leaves(function(name).compile("numpy")(*given))
    else:
        *given, answers = hard_cases(name)
    [found] = flat_leaves(kernel(*given))
    differ = differs(found, answers)
    if flushes_denormals("glsl"):
        differ &= ~np.any([(np.abs(x) < 2.0**-126) & (x != 0) for x in (*given, answers)], axis=0)
    assert not differ.any()


@pytest.mark.parametrize("name", ["sin", "exp", "log10", "sinh"])
def test_numbers_are_written_by_their_bits_where_a_compiler_misreads_decimals(name: str, wrong: Any) -> None:
    wrong(reads=False)
    kernel = compiled(function(name), "glsl")
    assert "packDouble2x32(uvec2(0x" in kernel.source
    assert not re.search(r"\b[\d.]+e[-+]?\d", kernel.source.split("void main")[0].replace("1e300lf", ""))
    assert "misreads decimal numbers" in " ".join(kernel.notes)
    x, answers = hard_cases(name)
    [found] = flat_leaves(kernel(x))
    differ = differs(found, answers)
    if flushes_denormals("glsl"):
        differ &= (np.abs(x) >= 2.0**-126) & (np.abs(answers) > 2.0**-126)
    assert not differ.any()


def test_answers_of_hard_cases_are_kept_on_disk(wrong: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "kept"))
    backend: Any = backend_named("glsl")
    wrong(roots=False)
    monkeypatch.setattr(glsl._judged, "_results", {})
    assert backend._limits(0).doubles
    glsl._judged.forget()
    monkeypatch.setattr(backend, "_compiled", None)  # not to be called again
    assert backend._limits(0).doubles


def test_corrected_binary64_that_fails_at_hard_cases_is_not_used(wrong: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(glsl, "hard_cases", lambda name: (np.float32([1.5]), np.float32([7])))
    monkeypatch.setattr(glsl._judged, "_results", {})
    wrong(roots=False)
    with pytest.raises(sh.CompileError, match="asin needs binary64 in strict mode"):
        compiled(function("asin"), "glsl")
    kernel = compiled(function("asin"), "glsl", math="portable")
    assert "double" not in kernel.source
    assert probe.NO_BINARY64 in kernel.notes


def test_comparisons_stand_apart_where_a_driver_makes_maxima_of_choices(wrong: Any) -> None:
    @sh.program
    def larger(a: sh.Attrib1f, b: sh.Attrib1f):
        return sh.cond(a < b, b, a)

    a, b = np.float32([np.nan, 1, 2]), np.float32([3, np.nan, 5])
    for chooses in (True, False):
        wrong(chooses=chooses, signs=True)
        kernel = compiled(larger, "glsl")
        assert ("precise bool" in kernel.source) is not chooses
        assert any("for a maximum" in note for note in kernel.notes) is not chooses
    assert np.array_equal(kernel(a, b), np.float32([np.nan, 1, 5]), equal_nan=True)


@pytest.mark.parametrize("off", [None, "choices", "exits", "negations", "signs", "decimals"])
def test_what_a_shader_draws_tells_the_faults_of_opengl(off: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """A driver that draws what it should has none of them, and one that draws something else has that one."""
    questions = {
        "choices": probes.CHOICES, "exits": probes.EXITS, "negations": probes.NEGATIONS,
        "signs": probes.SIGNS, "decimals": probes.decimal_floats(),
    }  # fmt: skip
    drawn = {text: [1.0] * 8 for text in questions.values()}
    drawn[probes.EXITS] = [5.0] * 8
    if off is not None:
        drawn[questions[off]][7] = 2.0
    context = open_context(0)
    monkeypatch.setattr(context, "_drawn", drawn.__getitem__)
    assert context.call(context._faults) & questions.keys() == ({off} if off else set())


def test_faults_of_opengl_are_kept_on_disk(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SHPY_CACHE_DIR", str(tmp_path / "kept"))
    context = open_context(0)
    asked = context.call(context._probe)
    monkeypatch.setattr(context, "_faults", None)  # not to be called again
    assert context.call(context._probe) == asked == context.limits
