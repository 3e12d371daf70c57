"""Every pass, and all of them together, leave random modules' outputs and statuses as they are, bit for bit."""

import numpy as np
import pytest
import random_ir
from random_ir import LOOP_LIMIT, Sizes, random_inputs, random_module

from shpy.backend.base import Options
from shpy.ir.interpreter import Interpreter
from shpy.ir.traverse import limited_loops
from shpy.ir.verifier import verify
from shpy.passes.by_value import pass_by_value, takes_array
from shpy.passes.cse import merge_common
from shpy.passes.dead import remove_dead
from shpy.passes.dead_stores import remove_dead_stores
from shpy.passes.exits import make_exits_explicit
from shpy.passes.fold import fold
from shpy.passes.inline import inline_calls
from shpy.passes.lower import lower
from shpy.passes.nesting import shelter_loops
from shpy.passes.pipeline import Target, optimise, prepare
from shpy.passes.precision import set_precision
from shpy.passes.promote import promote


def by_value(module):
    return pass_by_value(inline_calls(module, takes_array))


def shelter_all(module):
    return shelter_loops(module, 0, 0)


PASSES = (
    set_precision,
    lower,
    inline_calls,
    shelter_all,
    by_value,
    promote,
    remove_dead_stores,
    remove_dead,
    fold,
    merge_common,
    optimise,
)
TARGETS = (
    Target("plain"),
    Target("values", vector=True),
    Target("flags", native=frozenset({"dot", "mix"}), loop_flags=True, nesting=2),
)
SIZES = (Sizes(5, 3), Sizes(8, 2), Sizes(4, 4))
MODULES = 300
GROUP = 20


def results(module, precision, inputs, loops):
    """Return outputs and status for each input; a loop that ran out of iterations is named by its line."""
    interpreter = Interpreter(module, precision, loop_limit=LOOP_LIMIT)
    found = []
    for given, tables in inputs:
        outputs, status = interpreter.run_element(given, {}, tables)
        found.append(([np.asarray(o) for o in outputs], status if status < 2 else str(loops[status - 2])))
    return found


def lines(module):
    return [loop.loc for loop in limited_loops(module)]


def same(a, b):
    """Equal bit for bit, except that every NaN is the same."""
    nan = a != a
    return np.array_equal(nan, b != b) and np.where(nan, 0, a).tobytes() == np.where(nan, 0, b).tobytes()


def assert_same(wanted, got, what):
    for (outputs, status), (new_outputs, new_status) in zip(wanted, got, strict=True):
        assert status == new_status, what
        assert all(same(a, b.astype(a.dtype)) for a, b in zip(outputs, new_outputs, strict=True)), what


def cases(group):
    for seed in range(group * GROUP, (group + 1) * GROUP):
        yield seed, random_module(seed, SIZES[seed % 3], lanes=True), [random_inputs(4 * seed + k) for k in range(4)]


@pytest.mark.sampled(16)
@pytest.mark.parametrize("group", range(MODULES // GROUP))
def test_passes_keep_the_meaning(group):
    for seed, module, inputs in cases(group):
        verify(module)
        wanted = results(module, "f32", inputs, lines(module))
        for change in PASSES:
            changed = change(module)
            verify(changed)
            assert_same(wanted, results(changed, "f32", inputs, lines(changed)), f"{seed} {change.__name__}")
        for flags in (False, True):
            ending = make_exits_explicit(module, LOOP_LIMIT, loop_flags=flags)
            changed, loops = ending.module, ending.loops
            verify(changed)
            assert_same(wanted, results(changed, "f32", inputs, loops), f"{seed} exits {flags}")
        ending = make_exits_explicit(by_value(module), LOOP_LIMIT, by_value=True)
        changed, loops = ending.module, ending.loops
        verify(changed)
        assert_same(wanted, results(changed, "f32", inputs, loops), f"{seed} exits by value")


@pytest.mark.sampled(16)
@pytest.mark.parametrize("group", range(MODULES // GROUP))
def test_the_pipeline_keeps_the_meaning(group):
    for seed, module, inputs in cases(group):
        wanted = results(module, "f32", inputs, lines(module))
        for target in TARGETS:
            prepared = prepare(module, Options(loop_limit=LOOP_LIMIT), target)
            verify(prepared.module)
            got = results(prepared.module, "f32", inputs, prepared.loops)
            assert_same(wanted, got, f"{seed} {target.name}")


@pytest.mark.sampled(4)
@pytest.mark.parametrize("group", range(3))
@pytest.mark.parametrize("precision", ["f16", "f64"])
def test_other_precisions_keep_the_meaning(group, precision, monkeypatch):
    """At f16 the prepared module computes in binary32 and rounds; inputs and tables come as halves, constants fit."""
    if precision == "f16":
        monkeypatch.setattr(random_ir, "FLOATS", tuple(6e4 if x == 1e30 else x for x in random_ir.FLOATS))
    for seed, module, given in cases(group):
        inputs = given
        if precision == "f16":
            with np.errstate(over="ignore"):
                inputs = [
                    ([np.float32(np.float16(a)), np.float16(v).astype(np.float32), k, h], _halves(tables))
                    for (a, v, k, h), tables in given
                ]
        prepared = prepare(module, Options(precision=precision, loop_limit=LOOP_LIMIT), TARGETS[0])
        verify(prepared.module)
        wanted = results(module, precision, inputs, lines(module))
        assert_same(wanted, results(prepared.module, "f32", inputs, prepared.loops), f"{seed} {precision}")


def _halves(tables):
    return {name: data.astype(np.float16).astype(np.float32) for name, data in tables.items()}
