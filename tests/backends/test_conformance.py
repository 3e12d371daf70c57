"""The conformance list on the interpreter, numpy, OpenCL and GLSL: everything agrees, and nothing is skipped."""

from __future__ import annotations

import re
import zlib
from dataclasses import replace

import numpy as np
import pytest
from backends.running import LANES, PACKETS, TARGETS, TILES, WIDE, differs
from property.evaluate import evaluated
from stress.mode import stressed

import shpy as sh
from shpy.backend.opencl.device.driver import machine_of
from shpy.ir.nodes import Let
from shpy.ir.ops import MADE_BY_PASSES, OPS, STRUCTURAL, TRANSCENDENTALS
from shpy.ir.traverse import walk
from shpy.testing.conformance import operations, zeros
from shpy.testing.conformance.cases import INTERPRETED, THIN, Case
from shpy.testing.conformance.catalogue import all_cases
from shpy.testing.conformance.control import BRANCHES, LOOPS
from shpy.testing.generated.syntax import Tree

CASES = all_cases()
NAMES = [case.name for case in CASES]
STRUCTURED = [case for case in CASES if case not in operations.ROWS]


def each(cases: list[Case]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("case", cases, ids=[c.name for c in cases])


def drawn(case: Case) -> int:
    """Return a number that a case's name fixes."""
    return zlib.crc32(case.name.encode())


def exits(case: Case) -> tuple[str, str] | None:
    """Return the inner and the outer form of a case of exits from nested forms."""
    forms, _, rest = case.name.partition("-")
    inner, _, outer = forms.partition("_in_")
    return (inner, outer) if outer and rest.endswith("exits") else None


def in_turn(case: Case) -> bool:
    """Tell whether a case of exits has the turn: one of four has, so that each form is outside and inside in some."""
    forms = [*BRANCHES, *LOOPS]
    return (sum(map(forms.index, exits(case) or ())) + ("conditional" in case.name)) % 4 == 0


TYPED = {case.name for case in operations.cases()}
"""Cases of each type: conversions, vectors, Params, Tables of one to three axes."""
PRODUCTS = [case for case in STRUCTURED if exits(case) or case.name in TYPED]
"""Each form of control inside of each other one, and each operation on each type: 300 of 560 cases."""


def test_every_case_has_a_name_of_its_own() -> None:
    assert len(set(NAMES)) == len(NAMES)


def test_every_operation_is_in_the_list() -> None:
    found = set()
    for case in CASES:
        for function in case.program.ir.functions:
            found |= {s.op for s in walk(function.body) if isinstance(s, Let)}
    assert found == set(OPS) | set(STRUCTURAL) - MADE_BY_PASSES


@pytest.mark.sampled(5)
@each([case for case in STRUCTURED if case not in PRODUCTS])
def test_targets_agree_with_the_interpreter(case: Case) -> None:
    """Run a case on all targets but OpenCL, which the next tests run; how many are in a tile of numpy does not matter.

    A case is one test, not one for each target: pytest takes milliseconds for each of thousands.
    """
    agree(case, "prepared")
    agree_on_numpy_and_glsl(case)
    for width in TILES:
        case.check(case.run(width), width)
    if case.expected is not None:
        is_expected(case)


@pytest.mark.sampled(12)
@each(PRODUCTS)
def test_targets_agree_on_forms_in_forms_and_on_types(case: Case) -> None:
    test_targets_agree_with_the_interpreter(case)


@pytest.mark.sampled(20)
@each(operations.ROWS)
def test_targets_agree_with_the_meaning_of_an_operation(case: Case) -> None:
    """The reference is the row's meaning: the interpreter runs half of the rows as recorded, the others as prepared."""
    agree(case, INTERPRETED[drawn(case) // 2 % 2])
    agree_on_numpy_and_glsl(case)


def agree_on_numpy_and_glsl(case: Case) -> None:
    """One of the two is disturbed; the generated programs, chains and collectives are on both."""
    for number, target in enumerate(("numpy", "glsl")):
        agree(case, target, disturbed=drawn(case) % 2 == number)


SELDOM = [
    case
    for case in STRUCTURED
    if (exits(case) and not in_turn(case))
    or (case.name in TYPED and (drawn(case) % 2 or case.name.startswith("long-")))
]
"""Cases that OpenCL, whose driver compiles each for a quarter of a second, has in slow tests alone.

Long vectors, two seconds each in packets, are in `test_long_vectors.py`.
"""


@pytest.mark.slow
@each(SELDOM)
def test_opencl_agrees_on_the_other_exits_and_types(case: Case) -> None:
    agree(case, "opencl")


@pytest.mark.sampled(24)
@each([case for case in STRUCTURED if case not in SELDOM])
def test_opencl_agrees_with_the_interpreter(case: Case) -> None:
    """Each case takes one of the widths: the elements in a packet are independent.

    One case of 13 takes the width that a form of program gets by itself; at 64 lanes that compiles for seconds.
    """
    widths = ("opencl", *4 * PACKETS)
    agree(case, widths[drawn(case) % len(widths)])


RARELY_WIDE = ("opencl-1", "opencl-16", "opencl-1", "opencl")
"""One lane, as on a GPU, at every other case; a fourth at the width that a program gets by itself, which may be 64."""


@pytest.mark.slow  # its driver compiles each for half a second; `test_packet_operations.py` has all in few
@pytest.mark.parametrize("part", range(48))
def test_operations_by_themselves_agree_on_opencl(part: int) -> None:
    """One lane is what a GPU runs. Its compiler derives numbers too; `python -m tests.drivers` runs the whole list."""
    for case in operations.ROWS[part::48]:
        agree(case, RARELY_WIDE[drawn(case) % 4])


def agree(case: Case, target: str, *, disturbed: bool = True) -> None:
    backend = target.partition("-")[0]
    if backend in case.refused:
        with pytest.raises(sh.CompileError, match=case.refused[backend]):
            case.run(target)
        return
    case.check(case.run(target), target)
    if disturbed and backend in TARGETS:
        with stressed(drawn(case)):
            case.check(case.run(target), target)


@pytest.mark.slow
@pytest.mark.parametrize("width", LANES)
@pytest.mark.parametrize("part", range(16))
def test_every_case_agrees_in_packets_of_every_size(part: int, width: str) -> None:
    for case in STRUCTURED[part::16]:
        case.check(case.run(width), width)


def transcendental(case: Case) -> bool:
    """Tell whether a case at f32 in strict mode has functions with formulas of their own in portable mode."""
    lets = (s for f in case.program.ir.functions for s in walk(f.body) if isinstance(s, Let))
    return not case.options and any(s.op in TRANSCENDENTALS for s in lets)


PARTS = 12


@pytest.mark.sampled(12)
@pytest.mark.parametrize("part", range(PARTS))
def test_portable_mode_agrees_with_the_interpreter(part: int) -> None:
    """Every fourth case; which cases those are is known once all are recorded, so they are parts of one list."""
    cases = [case for case in CASES if transcendental(case)][::4][part::PARTS]
    assert len(cases) > 1
    for case in cases:
        agree_in_portable_mode(case)


def agree_in_portable_mode(case: Case) -> None:
    few = {name: array[::THIN] for name, array in case.arrays.items()} if case.meaning else case.inputs
    portable = replace(case, inputs=few, options={"math": "portable"}, meaning=None)
    for target in TARGETS:
        if target not in case.refused:
            portable.check(portable.run(target), target)


OUT_OF_RANGE = "is out of the range of f at precision f16"


@pytest.mark.sampled(200)
@pytest.mark.parametrize("part", range(200))
def test_other_working_precisions_agree_with_the_interpreter(part: int) -> None:
    for precision in ("f16", "f64"):
        for case in [case for case in CASES if "precision" not in case.options and not case.meaning][part::200]:
            agree_at(precision, case)


def agree_at(precision: str, case: Case) -> None:
    """GLSL has no f64, and f16 no constants above 65504: both are refused."""
    other = replace(case, options={**case.options, "precision": precision})
    refused = {"glsl": r"no 64-bit floats|has no f64"} if precision == "f64" else case.refused
    for target in ("numpy", RARELY_WIDE[drawn(case) % 4], "glsl"):
        try:
            found = other.run(target)
        except sh.CompileError as error:
            if not re.search(refused.get(target, OUT_OF_RANGE), error.message):
                raise
        else:
            other.check(found, target)


def wide() -> list[str]:
    """The widths beyond OpenCL C's vectors that the driver takes."""
    return [name for name, lanes in WIDE.items() if lanes in machine_of(None).widths]


@pytest.mark.slow
def test_packets_wider_than_vectors_of_opencl_agree() -> None:
    """Each case takes one of the widths that the driver has."""
    for number, case in enumerate(STRUCTURED[::96]):
        for width in wide()[number % 2 :][:1]:
            case.check(case.run(width), width)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(32))
def test_every_case_agrees_in_wide_packets(part: int) -> None:
    for case in CASES[part::32]:
        for width in wide():
            case.check(case.run(width), width)


@pytest.mark.sampled(2)
@each(zeros.cases())
def test_one_lane_has_the_same_zeros(case: Case) -> None:
    """At the width that a compiler for a GPU gets, which derives numbers most often."""
    case.check(case.run("opencl-1"), "opencl-1")


def is_expected(case: Case) -> None:
    """Raise AssertionError unless the interpreter gives the results that are written in the case."""
    outputs = case.reference.outputs
    expected = case.expected
    if isinstance(expected, Tree):
        expected = evaluated(expected, *case.arrays.values())
    elif callable(expected):
        expected = expected(**case.arrays)
    wanted = list(expected) if isinstance(expected, tuple) else [expected]
    assert len(outputs) == len(wanted)
    for found, want in zip(outputs, wanted, strict=True):
        whole = np.broadcast_to(np.asarray(want).astype(found.dtype), found.shape)
        wrong = np.argwhere(differs(found, whole, case.bound.ulp, case.bound.absolute))
        assert not len(wrong), f"element {wrong[0]}: {found[tuple(wrong[0])]!r}, not {whole[tuple(wrong[0])]!r}"


@pytest.mark.sampled(8)
@pytest.mark.parametrize("part", range(16))
def test_text_is_read_back_as_the_same_module(part: int) -> None:
    for case in CASES[part::16]:
        module = case.program.ir
        assert sh.parse(str(module)) == module, case.name
