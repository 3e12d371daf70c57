"""Variants of generated programs give what the programs give, to the last bit, on the interpreter and every backend.

40 variants in every run: all on the interpreter, a share on each backend. 10,700 others take some ten minutes:
`pytest -m slow tests/property/test_variants.py`.
"""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from property.metamorphic.changes import CHANGES
from property.metamorphic.variants import variants

import shpy as sh
from shpy import SH_BREAK, SH_FOR, SH_IF
from shpy.ir.builder import Builder
from shpy.ir.nodes import Module, Port
from shpy.ir.types import vec
from shpy.testing.generated.inputs import elements
from shpy.testing.observers import Setting
from shpy.testing.runs import parted, run

EACH = 10
"""Variants of a program."""

SHARES = {"numpy": (0.3, 4), "glsl": (0.2, 3), "opencl-1": (0.2, 2), "opencl-4": (0.05, 2)}
"""The numbers of programs and of variants of each that run on a backend; the interpreter runs all."""

INPUTS = tuple(elements(8))


def check(shard: int, programs: int, *, endless: bool) -> None:
    """`programs` programs of their own for each shard, EACH variants of each."""
    drawn = random.Random(shard)

    @seed(shard)
    @settings(
        max_examples=programs,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.generate],
    )
    @given(sh.testing.programs(endless=endless))
    def agree(program):
        options = {"loop_limit": program.tree.loop_limit or 1_048_576}
        made = list(variants(program, EACH, seed=shard))
        compare(program, made, "interpreter", options)
        for target, (share, count) in SHARES.items():
            if drawn.random() < share:
                compare(program, drawn.sample(made, count), target, options)

    agree()


def compare(program, made, target, options):
    """Every bit of every output, how each element ends, and how many a loop's limit stops."""
    right = run(Setting(program, INPUTS, {}, None, options), target)
    for variant in made:
        found = run(Setting(variant, INPUTS, {}, None, options), target)
        wrong = np.flatnonzero(parted(right, found))
        assert (wrong.size, found.stopped) == (0, right.stopped), (
            f"{variant.changes} changed elements {wrong} on {target}\n{program.text}\n{variant.ir}"
        )


@pytest.mark.sampled(8)
@pytest.mark.parametrize("shard", range(8))
def test_variants_give_the_same(shard):
    check(shard, 4, endless=False)


@pytest.mark.slow
@pytest.mark.parametrize("shard", range(8, 10))
def test_variants_of_programs_with_loops_beyond_their_limit_give_the_same(shard):
    check(shard, 10, endless=True)


@pytest.mark.slow
@pytest.mark.parametrize("shard", range(100, 200))
def test_many_variants_give_the_same(shard):
    check(shard, 10, endless=shard % 4 == 0)


def test_every_change_is_made_and_a_seed_gives_the_same_variants():
    def names(program):
        return [(variant.changes, str(variant.ir)) for variant in variants(program, 40, seed=3)]

    @sh.program
    def plain(x: sh.Attrib3f, n: sh.Attrib1i) -> sh.Attrib1f:
        with SH_FOR(0, n) as i:
            x[:] = x * 1.5 + sh.Attrib1f(i)
            with SH_IF(x.x > 100):
                SH_BREAK()
        return x.x * 2 + x.y * 3

    first = names(plain)
    assert first == names(plain)
    assert {change for changes, _ in first for change in changes} == CHANGES.keys()
    assert len({text for _, text in first}) > 30
    assert all(text != str(plain.ir) for changes, text in first if changes)


def test_a_wrong_operation_would_show(monkeypatch):
    """The other side of the opaque condition spoils: were the condition seen wrongly, results would change."""
    b = Builder("plain")
    x = b.input(vec("f"), "x")
    y = b.output(vec("f"), "y")
    b.store(y, b.let("mul", x, x))
    module = Module("plain", (Port("x", "Attrib1f"),), (Port("y", "Attrib1f"),), (), (), (b.finish(),))
    program = sh.Program.from_ir(module)
    spoiled = 0
    monkeypatch.setattr("property.metamorphic.changes.truth", lambda b, value: b.const(vec("b"), [False]))
    for variant in variants(program, 40):
        (found,) = variant(np.float32([3, 4]))
        spoiled += found.tolist() != [9, 16]
    assert spoiled >= 3
