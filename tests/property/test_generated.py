"""Generated programs agree on the interpreter, before and after the passes, on numpy, OpenCL and GLSL, bit by bit.

16 in every run, each on one width of OpenCL and on GLSL.
460 more, and 6,300 on all of these, are `pytest -m slow -n 2` and the name of this file. Some of both compute at f64 or
f16, where the interpreter is the reference. A failure prints the program as text that a person can run, the element and
both answers.
"""

from __future__ import annotations

import numpy as np
import pytest
from backends.running import LANES, WIDE
from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
from hypothesis.strategies import integers
from property.agreement import Precision, check
from property.evaluate import DISCARDED, STOPPED, WRITTEN, Evaluator

from shpy.ir.ops import OPS
from shpy.testing.generated.inputs import elements
from shpy.testing.generated.operations import FUNCTIONS, drawn
from shpy.testing.generated.source import source
from shpy.testing.generated.strategy import trees
from shpy.testing.generated.syntax import Block, Do, Exit, For, If, Tree, While

INPUTS = elements(24)
RUN = 10
"""Programs of one run of Hypothesis. From the eleventh on it repeats parts of earlier ones, five times each."""
FEW = 4
"""Programs of one run of Hypothesis in every run of the tests."""
PARTS = range(2)
"""Runs of a shard."""

each_part = pytest.mark.parametrize("part", PARTS)

quietly = settings(
    max_examples=RUN,
    deadline=None,
    database=None,
    suppress_health_check=list(HealthCheck),
    print_blob=False,
)


def agree(
    shard: int,
    part: int,
    backends: tuple[str, ...],
    *,
    endless: bool = False,
    precision: Precision = "f32",
    programs: int = RUN,
) -> None:
    """All but one of the programs are of their own for each part of each number, and one is the simplest.

    In every third shard a driver's compiler can derive numbers.
    """

    @settings(quietly, max_examples=programs)
    @given(trees(endless=endless, derives=shard % 3 == 2))
    def run(program: Tree) -> None:
        check(program, INPUTS, backends, precision)

    seed(f"{shard}.{part}")(run)()


ROTATION = ("opencl-1", "opencl-8", "opencl-1", "opencl-4", "opencl-1", "opencl-16")
"""One element a work item in every other shard: it is what GPUs run, and compiles in half the time."""


def rotated(shard: int) -> tuple[str, ...]:
    """Every backend; OpenCL at one of its widths."""
    return ("interpreter", "prepared", "numpy", ROTATION[shard % len(ROTATION)], "glsl")


@pytest.mark.sampled(44)  # of all 24
@each_part
@pytest.mark.parametrize("shard", range(12))
def test_programs_agree(shard: int, part: int) -> None:
    agree(shard, part, rotated(shard), programs=FEW)


@pytest.mark.sampled(12)
@each_part
@pytest.mark.parametrize("shard", range(6))
def test_programs_with_loops_beyond_their_limit_agree(shard: int, part: int) -> None:
    agree(shard, part, rotated(shard), endless=True, programs=FEW)


CONSTANT = (("a",), ("n", "h"), ("a", "v"), ("a", "v", "n"), ("v", "n", "h"), ("h",))
"""Inputs that become constants of a program."""


def agree_specialized(shard: int, part: int, backends: tuple[str, ...], programs: int = RUN) -> None:
    """Programs in which some inputs and every uniform are constants."""

    @settings(quietly, max_examples=programs)
    @given(trees(), integers(0, len(INPUTS[0]) - 1))
    def run(program: Tree, first: int) -> None:
        check(program, [np.roll(a, -first, axis=0) for a in INPUTS], backends, constant=CONSTANT[shard % len(CONSTANT)])

    seed(f"specialized {shard}.{part}")(run)()


@pytest.mark.sampled(12)
@each_part
@pytest.mark.parametrize("shard", range(6))
def test_specialized_programs_agree(shard: int, part: int) -> None:
    agree_specialized(shard, part, ("prepared", "numpy", *["glsl"] * (shard % 3 == 0)), FEW)


@pytest.mark.slow
@pytest.mark.parametrize("shard", range(1000, 1045))
def test_many_specialized_programs_agree(shard: int) -> None:
    for part in PARTS:
        agree_specialized(shard, part, EVERYWHERE)


@pytest.mark.sampled(4)
@each_part
@pytest.mark.parametrize("precision", ["f16", "f64"])
def test_programs_agree_at_other_precisions(precision: Precision, part: int) -> None:
    """At one lane; the conformance list is at other widths, and `-m slow` has these at all of them."""
    agree(0, part, narrowed(precision, ("opencl-1",)), precision=precision, programs=FEW)


def narrowed(precision: Precision, opencl: tuple[str, ...]) -> tuple[str, ...]:
    """The backends that have a precision: GLSL has no f64."""
    return ("prepared", "numpy", *opencl, *["glsl"] * (precision == "f16"))


def agree_fused(shard: int, part: int, backends: tuple[str, ...], precision: Precision = "f32") -> None:
    """9 programs for each part of each number, with contracted sums."""

    @quietly
    @given(trees())
    def run(program: Tree) -> None:
        check(program, INPUTS, backends, precision, fuse=True)

    seed(f"fused {shard}.{part}")(run)()


@pytest.mark.slow
@each_part
@pytest.mark.parametrize("shard", range(6))
def test_fused_programs_agree(shard: int, part: int) -> None:
    agree_fused(shard, part, rotated(shard)[1:])


@pytest.mark.slow
@each_part
@pytest.mark.parametrize("precision", ["f16", "f64"])
def test_fused_programs_agree_at_other_precisions(precision: Precision, part: int) -> None:
    agree_fused(0, part, narrowed(precision, ("opencl-8",)), precision)


EVERYWHERE = ("interpreter", "prepared", "numpy", "numpy-5", *LANES, "glsl")


@pytest.mark.slow
@pytest.mark.parametrize("shard", range(1000, 1180))
def test_many_programs_agree(shard: int) -> None:
    for part in PARTS:
        agree(shard, part, EVERYWHERE)


@pytest.mark.slow
@pytest.mark.parametrize("shard", range(1000, 1090))
def test_many_programs_with_loops_beyond_their_limit_agree(shard: int) -> None:
    for part in PARTS:
        agree(shard, part, EVERYWHERE, endless=True)


@pytest.mark.slow
@pytest.mark.parametrize("shard", range(2000, 2006))
def test_many_programs_agree_in_wide_packets(shard: int) -> None:
    for part in PARTS:
        agree(shard, part, tuple(WIDE))


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["f16", "f64"])
@pytest.mark.parametrize("shard", range(1000, 1015))
def test_many_programs_agree_at_other_precisions(shard: int, precision: Precision) -> None:
    for part in PARTS:
        agree(shard, part, narrowed(precision, tuple(LANES)), precision=precision)


@pytest.mark.slow
@pytest.mark.parametrize("shard", range(1000, 1030))
def test_many_fused_programs_agree(shard: int) -> None:
    for part in PARTS:
        agree_fused(shard, part, EVERYWHERE[1:])


def test_every_row_of_the_table_is_drawn() -> None:
    assert drawn() == set(OPS)


def forms(block: Block, inside: tuple[str, ...] = ()) -> set[tuple[str, ...]]:
    """The nests of forms that a block has: `("For", "While", "break")` is a break in a while in a for."""
    found: set[tuple[str, ...]] = set()
    for s in block:
        match s:
            case Exit(kind):
                found.add((*inside, kind))
            case If(branches, orelse):
                for _, body in branches:
                    found |= forms(body, (*inside, "If"))
                found |= forms(orelse or (), (*inside, "If"))
            case While(_, body) | Do(body) | For(_, _, body):
                found.add((*inside, type(s).__name__))
                found |= forms(body, (*inside, type(s).__name__))
    return found


@pytest.mark.slow
def test_the_strategy_makes_what_matters() -> None:
    """Every loop in every loop with every exit, gathers, calls; elements that part; every end."""
    nests: set[tuple[str, ...]] = set()
    texts: list[str] = []
    ends: set[int] = set()
    parted = 0

    @settings(quietly, phases=[Phase.generate], verbosity=Verbosity.quiet)
    @given(trees(endless=True))
    def look(program: Tree) -> None:
        nonlocal parted
        nests.update(forms(program.body))
        for function in program.functions:
            nests.update(forms(function.body))
        texts.append(source(program))
        evaluator = Evaluator(program)
        results = [evaluator.run([a[k] for a in INPUTS]) for k in range(4)]
        ends.update(end for _, end in results)
        parted += len({str(r) for r in results}) > 2

    for part in range(12):
        seed(part)(look)()
    loops, exits = ("While", "Do", "For"), ("break", "continue", "return", "discard")
    for loop in loops:
        assert {exit for exit in exits if any(n[-2:] == (loop, exit) for n in nests)} == set(exits)
        assert {inner for inner in loops if any(n[-2:] == (loop, inner) for n in nests)} == set(loops)
    everything = "\n".join(texts)
    for wanted in (
        "line[",
        "grid[",
        "counts[",
        "own[",
        "sub0(",
        "any_lane(",
        "all_lanes(",
        "lambda:",
        "SH_ELIF",
        "SH_ELSE",
        "SH_FOR(",
        "Pair(",
        " @ ",
        "many[",
        "pairs[",
        "[h] =",
        "pf",
        "pb",
    ):
        assert wanted in everything
    assert sum(f"sh.{function}(" in everything for function in FUNCTIONS) > len(FUNCTIONS) - 4
    assert ends == {DISCARDED, WRITTEN, STOPPED}
    assert parted > 90
