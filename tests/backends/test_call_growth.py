"""Programs whose calls multiply: the text stays in proportion, or a clear error says what would grow."""

from __future__ import annotations

import numpy as np
import pytest

import shpy as sh
from shpy.passes.size import inlined_sizes, not_inlined

HALVE = " %1: f = const 0x1p-1\n %2: f = mul %0, %1\n store $0 = %2\n"
BRANCH = " %3: b = gt %0, %1\n if %3 {\n  %4: f = add %2, %1\n  store $0 = %4\n }\n"
AT_ONE = " %9: i = const 1\n"
KINDS = {
    "pure": ("pure function f0(%0: f) -> ($0: f) {\n" + HALVE, ""),
    "value": ("function f0(%0: f) -> ($0: f) {\n" + HALVE + BRANCH, ""),
    "reference": ("function f0($0: f) -> () {\n %0: f = load $0\n" + HALVE + BRANCH, ""),
    "array": (
        "function f0($0: f[2]) -> () {\n" + AT_ONE + " %0: f = load $0[%9]\n" + HALVE.replace("$0", "$0[%9]"), "[2]"
    ),
    "discard": ("function f0(%0: f) -> ($0: f) {\n" + HALVE + BRANCH.replace("store $0 = %4", "discard"), ""),
}  # fmt: skip


def chain(levels: int, kind: str) -> sh.Program:
    """A program of `levels` functions, each calling the one before twice."""
    first, array = KINDS[kind]
    lines = ["module chain\ninput x: Attrib1f\noutput y: Attrib1f\n", first + "}"]
    top = f"f{levels - 1}"
    for k in range(1, levels):
        if kind in ("reference", "array"):
            lines.append(f"function f{k}($0: f{array}) -> () {{\n call f{k - 1}($0)\n call f{k - 1}($0)\n}}")
        elif kind == "pure":
            head = f"pure function f{k}(%0: f) -> ($0: f) {{"
            lines.append(f"{head}\n %1: f = call f{k - 1}(%0)\n %2: f = call f{k - 1}(%1)\n store $0 = %2\n}}")
        else:
            head = f"function f{k}(%0: f) -> ($0: f) {{"
            lines.append(f"{head}\n call f{k - 1}(%0) -> %1: f\n call f{k - 1}(%1) -> %2: f\n store $0 = %2\n}}")
    if kind in ("reference", "array"):
        at = "[%9]" if array else ""
        lines.append(
            f"function main(%0: f) -> ($0: f) {{\n var $1: f{array}\n{AT_ONE} store $1{at} = %0\n"
            f" call {top}($1)\n %1: f = load $1{at}\n store $0 = %1\n}}"
        )
    elif kind == "pure":
        lines.append(f"function main(%0: f) -> ($0: f) {{\n %1: f = call {top}(%0)\n store $0 = %1\n}}")
    else:
        lines.append(f"function main(%0: f) -> ($0: f) {{\n call {top}(%0) -> %1: f\n store $0 = %1\n}}")
    return sh.Program.from_ir(sh.parse("\n".join(lines) + "\n"))


def halved(x: float, times: int, branch: bool) -> float:
    for _ in range(times):
        x = x * 0.5 + (0.5 if branch and x > 0.5 else 0)
    return x


@pytest.mark.sampled(12)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("target", ["numpy", "opencl-1", "opencl-8", "glsl"])
def test_a_short_chain_gives_its_numbers(kind, target):
    backend, _, lanes = target.partition("-")
    kernel = chain(6, kind).compile(backend, lanes=int(lanes or 0) or "auto")
    x = np.float32([0.375, 3])
    expected = [halved(v, 32, kind in ("value", "reference")) for v in x]
    if kind == "discard":
        expected[1] = 0
    np.testing.assert_array_equal(kernel(x).y, np.float32(expected))


@pytest.mark.sampled(6)
@pytest.mark.parametrize("kind", [k for k in KINDS if k != "array"])
@pytest.mark.parametrize("levels", [30, 60])
def test_numpys_text_is_as_long_as_the_program(kind, levels):
    assert len(chain(levels, kind).compile("numpy").source) < 4000 * levels


@pytest.mark.parametrize("lanes", [1, 8])
def test_opencl_keeps_functions_apart_where_they_would_multiply(lanes):
    source = chain(16, "value").compile("opencl", lanes=lanes).source
    assert "__attribute__((noinline)) " in source
    assert max(len(line) - len(line.lstrip()) for line in source.splitlines()) <= 16


@pytest.mark.sampled(6)
@pytest.mark.parametrize(
    ("target", "kind"), [("opencl-1", "value"), ("opencl-8", "discard"), ("opencl-8", "array"), ("numpy", "array"),
                     ("glsl", "value"), ("glsl", "pure"), ("glsl", "array")],
)  # fmt: skip
@pytest.mark.parametrize("levels", [40, 300])
def test_what_a_driver_cannot_take_is_refused_by_name(target, kind, levels):
    backend, _, lanes = target.partition("-")
    program = chain(levels, kind)
    with pytest.raises(sh.CompileError, match=r"it calls f\d+ .* times") as error:
        program.compile(backend, lanes=int(lanes or 0) or "auto")
    assert len(str(error.value)) < 500


def test_small_programs_keep_nothing_apart():
    small, large = (chain(levels, "value").ir for levels in (8, 20))
    assert not not_inlined(small)
    assert len(not_inlined(large)) > 3
    assert inlined_sizes(large, not_inlined(large))["main"] < 100 < 2**20 < inlined_sizes(large)["main"]
