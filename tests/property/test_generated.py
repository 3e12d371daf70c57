"""Generated programs agree on the interpreter, before and after the passes, on numpy, OpenCL and GLSL, bit by bit.

500 in every run. 5,000 others, which take an hour on two cores: `pytest -m slow -n 2` and the name of this file.
A failure prints the program as text that a person can run, the element and both answers.
"""

from __future__ import annotations

import pytest
from backends.running import BACKENDS
from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
from property.agreement import check

from shpy.testing.conformance.evaluate import DISCARDED, STOPPED, WRITTEN, Evaluator
from shpy.testing.generated.inputs import elements
from shpy.testing.generated.source import source
from shpy.testing.generated.strategy import trees
from shpy.testing.generated.syntax import Block, Do, Exit, For, If, Tree, While

SHARD = 25
INPUTS = elements(16)

quietly = settings(
    max_examples=SHARD,
    deadline=None,
    database=None,
    suppress_health_check=list(HealthCheck),
    print_blob=False,
)


def agree(shard: int, *, endless: bool) -> None:
    """SHARD programs of their own for each number."""

    @seed(shard)
    @quietly
    @given(trees(endless=endless))
    def run(program: Tree) -> None:
        check(program, INPUTS, BACKENDS)

    run()


@pytest.mark.parametrize("shard", range(12))
def test_programs_agree(shard: int) -> None:
    agree(shard, endless=False)


@pytest.mark.parametrize("shard", range(8))
def test_programs_with_loops_beyond_their_limit_agree(shard: int) -> None:
    agree(shard, endless=True)


@pytest.mark.slow
@pytest.mark.parametrize("shard", range(1000, 1140))
def test_many_programs_agree(shard: int) -> None:
    agree(shard, endless=False)


@pytest.mark.slow
@pytest.mark.parametrize("shard", range(1000, 1060))
def test_many_programs_with_loops_beyond_their_limit_agree(shard: int) -> None:
    agree(shard, endless=True)


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


def test_the_strategy_makes_what_matters() -> None:
    """Every loop in every loop with every exit, gathers, calls; elements that part; every end."""
    nests: set[tuple[str, ...]] = set()
    texts: list[str] = []
    ends: set[int] = set()
    parted = 0

    @seed(1)
    @settings(quietly, max_examples=200, phases=[Phase.generate], verbosity=Verbosity.quiet)
    @given(trees(endless=True))
    def look(program: Tree) -> None:
        nonlocal parted
        nests.update(forms(program.body))
        for function in program.functions:
            nests.update(forms(function.body))
        texts.append(source(program))
        evaluator = Evaluator(program)
        results = [evaluator.run([a[k] for a in INPUTS]) for k in range(6)]
        ends.update(end for _, end in results)
        parted += len({str(r) for r in results}) > 3

    look()
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
    ):
        assert wanted in everything
    assert ends == {DISCARDED, WRITTEN, STOPPED}
    assert parted > 120
