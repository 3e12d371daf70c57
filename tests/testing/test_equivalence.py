"""assert_equivalent: what agrees, what a failure tells, bounds, denormals, ends, data; the strategy of programs."""

from __future__ import annotations

import math
import random
import subprocess
import sys

import mpmath
import numpy as np
import pytest
from hypothesis import HealthCheck, find, given, seed, settings
from patience import HANGING
from testing.faults import op, with_fault

import shpy as sh
from shpy import SH_DISCARD, SH_FOR, SH_IF, SH_WHILE
from shpy.testing.generated.source import source
from shpy.testing.generated.strategy import trees
from shpy.testing.generated.syntax import For, If

X = np.linspace(-4, 4, 17).astype(np.float32)


FEW = ("numpy", "opencl-1", "glsl")
"""A driver compiles for each width; tests of what is compared need no others."""


def rounded_program() -> sh.Program:
    @sh.program
    def rounded(x: sh.Attrib1f, y: sh.Attrib2f) -> tuple[sh.Attrib1f, sh.Attrib2f]:
        whole = sh.floor(x)
        return whole * 2, y + whole

    return rounded


def test_every_backend_and_lane_width_takes_part():
    found = sh.testing.assert_equivalent(rounded_program(), X, [1, 2])
    assert found.backends == ("numpy", "opencl-1", "opencl-4", "opencl-8", "opencl-16", "glsl")
    assert found.elements == 17
    assert str(found) == "numpy, opencl-1, opencl-4, opencl-8, opencl-16, glsl agree on 17 elements"


def test_wider_packets_take_part_where_they_are_named():
    found = sh.testing.assert_equivalent(rounded_program(), X, [1, 2], backends=["numpy", "opencl-64"])
    assert found.backends == ("numpy", "opencl-64")


@pytest.mark.sampled(3)
@pytest.mark.parametrize("faulty", ["numpy", "opencl", "glsl"])
def test_a_failure_names_element_inputs_values_distance_and_statement(monkeypatch, faulty):
    with_fault(monkeypatch, faulty, op("floor", "ceil"))
    with pytest.raises(AssertionError) as failure:
        sh.testing.assert_equivalent(rounded_program(), X, [1, 2])
    said = str(failure.value)
    other = "opencl-1" if faulty == "numpy" else faulty + "-1" * (faulty == "opencl")
    assert f"rounded: numpy and {other} differ in 8 of 17 elements, first in element 1" in said
    assert "  x = -3.5  (-0x1.c000000000000p+1)" in said
    assert "  y = 1.0, 2.0  (0x1.0000000000000p+0, 0x1.0000000000000p+1)" in said
    right, wrong = "-8.0  (-0x1.0000000000000p+3)", "-6.0  (-0x1.8000000000000p+2)"
    for name in ("numpy", "opencl-16", "glsl", "interpreter"):
        value = wrong if name.startswith(faulty) else right
        assert f"    {name:<12} {value}" in said
    assert "4194304 ULP from numpy" in said
    assert "the first statement at which they part:\nrounded: interpreter and " in said
    assert "whole = sh.floor(x)" in said


def test_a_zero_of_the_other_sign_is_a_difference(monkeypatch):
    with_fault(monkeypatch, "numpy", op("neg", "abs"))

    @sh.program
    def minus(x: sh.Attrib1f) -> sh.Attrib1f:
        return -x

    with pytest.raises(AssertionError, match="differ in 1 of 1 elements"):
        sh.testing.assert_equivalent(minus, np.float32([0]), backends=FEW)
    sh.testing.assert_equivalent(minus, np.float32([0]), backends=FEW, ulp=0.5)


def test_results_may_be_as_far_apart_as_the_bounds_say(monkeypatch):
    with_fault(monkeypatch, "numpy", op("max", "min"))

    @sh.program
    def close(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
        return sh.max(x, y)

    near = np.float32(1), np.float32(1 + 3 * 2**-23)
    sh.testing.assert_equivalent(close, *near, backends=FEW, ulp=3)
    sh.testing.assert_equivalent(close, *near, backends=FEW, atol=4e-7)
    sh.testing.assert_equivalent(close, *near, backends=FEW, rtol=4e-7)
    for bound in ({"ulp": 2}, {"atol": 3e-7}, {"rtol": 3e-7}, {}):
        with pytest.raises(AssertionError):
            sh.testing.assert_equivalent(close, *near, backends=FEW, **bound)


def small_program() -> sh.Program:
    @sh.program
    def small(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * 1e-20 * 1e-20 * 1e30

    return small


def test_denormals_that_a_device_flushes_are_counted():
    found = sh.testing.assert_equivalent(small_program(), X)
    assert found.flushed["glsl"] == 16
    assert "16 on glsl by flushed denormals alone" in str(found)


@sh.program
def quotient(s: sh.Attrib1f, t: sh.Attrib1f, power: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f]:
    p = 1 / (1 + sh.exp(-s))
    q = 1 / (1 + sh.exp(-t))
    n = p * sh.pow(1 - p, power)
    d = q * sh.pow(1 - q, power)  # a denormal
    return n + 0, n / d


def test_a_flushed_denormal_that_changes_other_numbers_is_named():
    s, t = np.float32([-1.3195162, 1, 2]), np.float32([9.431838, 9.431838, 0])
    found = sh.testing.assert_equivalent(quotient, s, t, np.float32(9.447411), backends=["numpy", "glsl"])
    (flush,) = found.flushes
    assert (flush.target, flush.reference, flush.count, flush.altered) == ("glsl", "numpy", 2, 2)
    assert (flush.element, flush.output) == ((0,), "1")
    assert flush.first > 1e37
    assert flush.second == np.inf
    assert flush.denormal.name == "pow"
    assert 0 < flush.denormal.value < 1e-38
    assert flush.denormal.loc.file == __file__
    said = str(found)
    assert "2 on glsl by flushed denormals alone\nglsl: 2 of these 2 change by more than a denormal" in said
    assert "on numpy, inf on glsl\n  the first denormal on its way: pow = 1.99" in said
    assert said.endswith("d = q * sh.pow(1 - q, power)  # a denormal")


def test_denormals_that_only_become_zero_are_told_from_others():
    @sh.program
    def tiny(x: sh.Attrib1f) -> sh.Attrib1f:
        return x * 1e-39

    (flush,) = sh.testing.assert_equivalent(tiny, X, backends=["numpy", "glsl"]).flushes
    assert (flush.count, flush.altered) == (16, 0)
    assert not sh.testing.assert_equivalent(tiny, X, backends=["numpy", "interpreter"]).flushes


def test_denormals_inside_of_operations_and_functions_count():
    """A step inside `reflect`, or inside a function of the IR, is flushed; operands and result are not denormal."""
    text = """module inner
input x: Attrib1f
output y: Attrib1f
pure function shrink(%0: f) -> ($0: f) {
 %1: f = const 0x1p-70
 %2: f = mul %0, %1
 %3: f = mul %2, %1
 %4: f = const 0x1p+100
 %5: f = mul %3, %4
 store $0 = %5
}
function inner(%0: f) -> ($0: f) {
 %1: f = call shrink(%0)
 store $0 = %1
}
"""
    inner = sh.Program.from_ir(sh.parse(text))
    (flush,) = sh.testing.assert_equivalent(inner, X, backends=["numpy", "glsl"]).flushes
    assert (flush.count, flush.altered, flush.denormal.name) == (16, 16, "mul")

    @sh.program
    def mirrored(i: sh.Attrib2f, n: sh.Attrib2f) -> sh.Attrib2f:
        return sh.reflect(i, n)

    (flush,) = sh.testing.assert_equivalent(mirrored, [1e-20, 0], [1e-20, 1e30], backends=["numpy", "glsl"]).flushes
    assert flush.first[1] < -1e-10
    assert flush.second[1] == 0
    found = sh.testing.first_divergence(mirrored, [1e-20, 0], [1e-20, 1e30], backends=["numpy", "glsl"])
    assert found.text.startswith("reflect")
    assert found.denormal
    assert 0 < found.within.value < 1e-38
    assert "on the way to it" in str(found)


def test_a_fault_is_not_excused_by_denormals_elsewhere(monkeypatch):
    """One of the 8 elements at which the fault shows has a denormal too."""
    with_fault(monkeypatch, "glsl", op("floor", "ceil"))
    beside = np.tile(np.float32([1, 2]), (17, 1))
    beside[1, 0] = 1e-40
    with pytest.raises(AssertionError, match="differ in 7 of 17 elements, first in element 3"):
        sh.testing.assert_equivalent(rounded_program(), X, beside, backends=["numpy", "glsl"])


def test_elements_must_end_alike(monkeypatch):
    with_fault(monkeypatch, "opencl", op("gt", "ge"))

    @sh.program
    def ends(x: sh.Attrib1f) -> sh.Attrib1f:
        SH_DISCARD(x > 1)
        return x

    with pytest.raises(AssertionError) as failure:
        sh.testing.assert_equivalent(ends, X, backends=["numpy", "opencl-4", "glsl"])
    assert "    opencl-4     not written" in str(failure.value)
    assert "    numpy        1.0" in str(failure.value)


def test_loops_beyond_their_limit_agree():
    @sh.program
    def endless(n: sh.Attrib1i) -> sh.Attrib1i:
        k = sh.Attrib1i(0)
        with SH_WHILE(lambda: k < n):
            k += 1
        return k

    sh.testing.assert_equivalent(endless, np.arange(20), backends=FEW, loop_limit=10)


def test_params_tables_grids_and_names():
    gain = sh.Param(sh.Attrib1f, 2.0, name="gain")
    table = sh.Table(np.arange(5, dtype=np.float32), sh.Attrib1f)

    @sh.program
    def picture(scale: sh.Attrib1f) -> sh.Attrib1f:
        at = sh.grid_index(2)
        total = sh.Attrib1f(0)
        with SH_FOR(0, at.y) as i:
            with SH_IF(i > at.x):
                total += table[i] * gain
        return total * scale

    gain.value = 3
    found = sh.testing.assert_equivalent(picture, scale=0.5, shape=(5, 7), backends=FEW)
    assert found.elements == 35


def test_a_name_that_is_neither_input_nor_option():
    with pytest.raises(sh.ShpyTypeError, match="speed is no input of rounded, and no option of compile"):
        sh.testing.assert_equivalent(rounded_program(), X, [1, 2], speed=2)


@sh.program
def growths(x: sh.Attrib1f, y: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f]:
    SH_DISCARD(x > 3)
    return sh.expm1(x), sh.hypot(x, y)


def agrees(reference, program=growths, inputs=(X, 2), **bound):
    return sh.testing.assert_equivalent(program, *inputs, reference=reference, backends=["numpy"], **bound)


def test_a_reference_is_a_function_of_numpy_or_mpmath_or_an_array():
    written = np.ma.masked_where(X > 3, np.float64(X))
    agreement = agrees(lambda x, y: (np.expm1(written), np.hypot(x, y)))
    assert str(agreement) == f"reference, numpy agree on {X.size} elements"
    agrees((np.ma.masked_where(X > 3, np.expm1(np.float64(X))), np.hypot(np.float64(X), 2)))

    @sh.program
    def error(x: sh.Attrib2f) -> sh.Attrib2f:
        return sh.erf(x)

    pairs = X[:16].reshape(8, 2)
    agrees(mpmath.erf, error, (pairs,))
    agrees(np.vectorize(math.erf), error, (pairs,))


def test_a_failure_shows_the_outputs_that_differ_from_the_reference():
    with pytest.raises(AssertionError) as failure:
        agrees(lambda x, y: (np.expm1(np.ma.masked_where(x > 3, x)), np.hypot(x, y + 1e-6)))
    message = str(failure.value)
    assert "  output 1:\n    reference    " in message
    assert "1 ULP from reference" in message
    assert "output 0" not in message
    agrees(lambda x, y: (np.expm1(np.ma.masked_where(x > 3, x)), np.hypot(x, y + 1e-6)), rtol=1e-6)


@pytest.mark.parametrize(
    ("reference", "problem", "cure"),
    [
        (math.hypot, "the reference hypot raises TypeError: it is called once, with arrays", "np.vectorize(hypot)"),
        ((X, "hypot"), "the reference of output 1 has 'hypot', no number", "an array or a function of the inputs"),
        (
            (X, X[:3]),
            r"the reference of output 1 has the shape \(3,\), and the output \(17,\)",
            "with a part for each output",
        ),
    ],
)
def test_a_reference_of_other_values_is_refused(reference, problem, cure):
    with pytest.raises(sh.ShpyTypeError, match=problem) as caught:
        agrees(reference)
    assert cure in caught.value.cure
    assert caught.value.loc.file == __file__


@pytest.mark.parametrize("bound", [{"ulp": -1}, {"ulp": "2"}, {"atol": np.nan}, {"rtol": -1e-6}])
def test_a_distance_is_a_number_from_0_on(bound):
    for compare in (sh.testing.assert_equivalent, sh.testing.first_divergence):
        with pytest.raises(sh.ShpyTypeError, match="is no distance of results"):
            compare(rounded_program(), X, [1, 2], **bound)


@pytest.mark.parametrize("given", [lambda x: x, rounded_program().compile("numpy")])
def test_anything_but_a_program_is_refused(given):
    for compare in (sh.testing.assert_equivalent, sh.testing.first_divergence):
        with pytest.raises(sh.ShpyTypeError, match="is no program"):
            compare(given, X, [1, 2])


@pytest.mark.slow
@pytest.mark.parametrize("derives", [False, True])
def test_generated_programs_are_recorded_and_agree(derives):
    seen = []

    @seed(3)
    @settings(max_examples=5, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(sh.testing.programs(derives=derives))
    def run(program):
        seen.append(program)
        sh.testing.assert_equivalent(
            program, *sh.testing.inputs(program, 8), backends=["numpy", "opencl-4", "interpreter"]
        )

    run()
    assert len(seen) >= 5
    assert all(isinstance(program, sh.Program) and "@sh.program" in program.text for program in seen)


@pytest.mark.slow
def test_a_failing_program_shrinks():
    """The shrunk program holds hardly more than what makes it fail."""
    found = find(
        trees(),
        lambda tree: any(isinstance(s, For) and any(isinstance(t, If) for t in s.body) for s in tree.body),
        settings=settings(max_examples=500, deadline=None, database=None, suppress_health_check=list(HealthCheck)),
        random=random.Random(1),
    )
    assert not found.functions
    assert len(source(found).splitlines()) <= 20


@sh.struct
class Ray:
    o: sh.Point3f
    d: sh.Vector3d


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((lambda x: x, 3), "is no program"),
        ((quotient, -1), "count is an int from 0 on, not -1"),
        ((quotient, 2.5), "count is an int from 0 on, not 2.5"),
        ((quotient, 3, "now"), "seed is an int from 0 on, not 'now'"),
    ],
)
def test_inputs_are_asked_for_by_a_program_and_numbers(given, said):
    with pytest.raises(sh.ShpyTypeError, match=said) as caught:
        sh.testing.inputs(*given)
    assert caught.value.loc.file == __file__


def test_inputs_fit_any_program():
    @sh.program
    def every(r: Ray, m: sh.Matrix3f, n: sh.Attrib2u, b: sh.Attrib1b, t: sh.Table[sh.Attrib2f, 2]) -> sh.Attrib1f:
        return sh.cond(b, r.o.x + m[0, 1], t[n.x & 3, 1].y)

    r, m, n, b, t = sh.testing.inputs(every, 9)
    assert (r.o.shape, r.d.dtype, m.shape, n.dtype, b.dtype, t.shape) == (
        (9, 3),
        np.float64,
        (9, 3, 3),
        np.uint32,
        np.bool_,
        (5, 5, 2),
    )
    sh.testing.assert_equivalent(every, r, m, n, b, t, backends=["numpy", "interpreter"])


WITHOUT = """
import sys
for name in ("hypothesis", "pytest", "mpmath", "matplotlib"):
    sys.modules[name] = None
import shpy as sh
print(sh.testing.assert_equivalent(sh.Program.from_ir(sh.parse(sys.argv[1])), [1.0], backends=["numpy", "interpreter"]))
try:
    sh.testing.programs()
except sh.ShpyError as error:
    print(error)
"""


def test_hypothesis_is_optional():
    text = str(small_program().ir)
    done = subprocess.run([sys.executable, "-c", WITHOUT, text], capture_output=True, text=True, timeout=HANGING)
    assert done.returncode == 0, done.stderr
    assert "agree on 1 elements" in done.stdout
    assert f"programs() needs hypothesis\n  write instead: {sh.packages.install('hypothesis')}" in done.stdout


@sh.program
def of_a_matrix(x: sh.Attrib1f) -> sh.Matrix2f:
    return sh.Matrix2f((x, sh.exp(x)), (sh.exp(x), 1))


def test_a_matrix_is_shown_by_its_rows():
    with pytest.raises(AssertionError, match=r"output \[0\]:(.|\n)*output \[1\]:"):
        sh.testing.assert_equivalent(of_a_matrix, np.linspace(0, 10, 50), math="fast", backends=("numpy", "glsl"))


@pytest.mark.parametrize("shape", [(0,), (3, 0)])
def test_backends_agree_on_no_elements(shape):
    for program in (small_program(), of_a_matrix):
        assert sh.testing.assert_equivalent(program, np.zeros(shape)).elements == 0


@pytest.mark.parametrize("precision", ["f32", "f16"])
def test_denormals_beside_operations_of_halves_are_found(precision):
    @sh.program
    def mixed(x: sh.Attrib1f) -> tuple[sh.Attrib1h, sh.Attrib1f, sh.Attrib1f]:
        half, least = sh.Attrib2h(x, 1), 1e-39 if precision == "f32" else 1e-7
        return sh.length(half), sh.length(sh.Attrib2f(x, 2)), x * least

    agreement = sh.testing.assert_equivalent(mixed, [1.0, 2.0], precision=precision, backends=("numpy", "glsl"))
    assert agreement.flushed == ({"glsl": 2} if precision == "f32" else {})
