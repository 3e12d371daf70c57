"""vectorize on small functions: uniformity, masks and exit copies in its output."""

from contextlib import contextmanager

import numpy as np
import pytest
from random_ir import LOOP_LIMIT, random_inputs, random_module

from shpy.backend.base import Options
from shpy.ir.builder import Builder
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Break, Continue, If, Let, Loop, Module, Port, Return, Store, Table
from shpy.ir.text import print_module
from shpy.ir.traverse import walk
from shpy.ir.types import vec
from shpy.ir.verifier import verify
from shpy.passes.pipeline import Target, optimise, prepare
from shpy.passes.returns import returns_outside_loops
from shpy.passes.vectorize import vectorize

F, F3, I, B = vec("f"), vec("f", 3), vec("i"), vec("b")  # noqa: E741
VECTOR = Target("vector", vector=True)


class Program:
    """One function of x (varying, f) and n (varying, i); `result` is its output."""

    def __init__(self, *tables):
        self.b = Builder("program")
        self.x, self.n = self.b.input(F, "x"), self.b.input(I, "n")
        self.result = self.b.output(F, "result")
        self.tables = tables

    def number(self, value):
        return self.b.const(F, [value])

    def count(self, value):
        return self.b.const(I, [value])

    def slot(self, name, value):
        variable = self.b.variable(value.type, name=name)
        self.b.store(variable, value)
        return variable

    def add(self, slot, value):
        self.b.store(slot, self.b.let("add", self.b.load(slot), value))

    @contextmanager
    def when_greater(self, limit):
        with self.b.when(self.b.let("gt", self.x, self.number(limit))):
            yield

    def vectorised(self, padded=False):
        ports = (Port("x", "Attrib1f"), Port("n", "Attrib1i"))
        module = Module("program", ports, (Port("result", "Attrib1f"),), (), self.tables, (self.b.finish(),))
        verify(module)
        return Vectorised(vectorize(module, padded=padded))


class Vectorised:
    def __init__(self, vector):
        verify(vector.module)
        self.vector = vector
        self.entry = vector.module.entry
        self.statements = list(walk(self.entry.body))
        self.names = {v.id: v.name for v in (*self.entry.outputs, *self.entry.variables)}

    def varies(self, name):
        """Return whether the slots of this name hold one value for every lane; both True and False for one of each."""
        found = {slot in self.vector.entry.slots for slot, known in self.names.items() if known == name}
        assert len(found) == 1, (name, sorted(self.names.values()))
        return found.pop()

    def ops(self, *names):
        return [s for s in self.statements if isinstance(s, Let) and s.op in names]

    def selects_into(self, name):
        """Count the stores into the slot that choose between the new and the old value."""
        selected = {s.value.id for s in self.ops("cond")}
        slots = {slot for slot, other in self.names.items() if other == name}
        return sum(isinstance(s, Store) and s.variable in slots and s.value in selected for s in self.statements)

    def conditions(self):
        return {s.condition for s in self.statements if isinstance(s, If)}


def test_every_condition_is_uniform_afterwards():
    for seed in range(30):
        module = random_module(seed)
        vectors = vectorize(prepare(module, Options(loop_limit=LOOP_LIMIT), VECTOR).module)
        verify(vectors.module)
        for function in vectors.module.functions:
            varying = vectors.facts[function.name].varying if not function.pure else ()
            for s in walk(function.body):
                if isinstance(s, If):
                    assert s.condition not in varying
                if isinstance(s, Loop) and s.until is not None:
                    assert s.until not in varying


@pytest.mark.slow
@pytest.mark.parametrize("padded", [False, True])
def test_with_one_lane_a_vectorised_module_means_what_it_did(padded):
    for seed in range(200):
        module = random_module(seed, lanes=True)
        prepared = prepare(module, Options(loop_limit=LOOP_LIMIT), VECTOR).module
        vectorised = Interpreter(vectorize(prepared, padded=padded).module, loop_limit=None)
        reference = Interpreter(prepared, loop_limit=None)
        for k in range(4):
            inputs, tables = random_inputs(4 * seed + k)
            outputs, status = reference.run_element(inputs, None, tables)
            results, ended = vectorised.run_element(inputs, None, tables)
            assert ended == status, seed
            for a, b in zip(results, outputs, strict=True):
                np.testing.assert_array_equal(a, b, f"seed {seed}")


def test_a_counter_in_a_loop_that_lanes_leave_one_by_one_stays_a_scalar():
    p = Program()
    z, n = p.slot("z", p.number(0)), p.slot("n", p.number(0))
    with p.b.loop() as loop:
        p.add(z, p.x)
        p.add(n, p.number(1))
        loop.until(p.b.let("gt", p.b.load(z), p.number(4)))
    p.b.store(p.result, p.b.load(n))
    vectors = p.vectorised()
    assert not vectors.varies("n")
    assert vectors.varies("n_out")
    assert vectors.varies("z")
    assert vectors.varies("live")
    assert vectors.selects_into("n_out") == 1, "one exit copy"
    assert vectors.selects_into("z") == 0, "not needed after the loop"
    counted = {s.value.id for s in vectors.ops("add")} - vectors.vector.entry.varying
    assert len(counted) == 1, "the counter is added to once, for all lanes"


def test_the_uniform_part_of_a_test_decides_a_branch_by_itself():
    p = Program()
    z, n = p.slot("z", p.number(0)), p.slot("n", p.count(0))
    with p.b.loop() as loop:
        p.add(z, p.x)
        p.add(n, p.count(1))
        greater, last = p.b.let("gt", p.b.load(z), p.number(4)), p.b.let("ge", p.b.load(n), p.count(9))
        loop.until(p.b.let("or", greater, last))
    p.b.store(p.result, p.b.load(z))
    for padded in (False, True):
        vectors = p.vectorised(padded)
        alone = [s.args[0] for s in vectors.ops("or") if s.value.id in vectors.conditions()]
        assert alone == [last.id] * padded
        for x, expected in ((0.25, 2.25), (3.0, 6.0), (np.nan, np.nan)):
            outputs, _ = Interpreter(vectors.vector.module, loop_limit=None).run_element([np.float32(x), np.int32(0)])
            np.testing.assert_array_equal(outputs[0], np.float32(expected))


def test_a_loop_that_all_lanes_leave_together_stays_as_it_is():
    p = Program()
    i, total = p.slot("i", p.count(0)), p.slot("total", p.number(0))
    with p.b.loop() as loop:
        p.add(total, p.x)
        p.add(i, p.count(1))
        loop.until(p.b.let("ge", p.b.load(i), p.count(9)))
    p.b.store(p.result, p.b.load(total))
    vectors = p.vectorised()
    assert not vectors.varies("i")
    assert vectors.varies("total")
    assert vectors.ops("cond", "lane_any", "lane_mask") == []
    (loop,) = [s for s in vectors.statements if isinstance(s, Loop)]
    assert loop.until is not None


def test_a_uniform_condition_stays_a_branch():
    p = Program()
    p.b.store(p.result, p.x)
    k = p.slot("k", p.count(3))
    with p.b.loop() as loop:
        with p.b.when(p.b.let("eq", p.b.load(k), p.count(2))):
            p.add(p.result, p.number(1))
        p.add(k, p.count(-1))
        loop.until(p.b.let("le", p.b.load(k), p.count(0)))
    vectors = p.vectorised()
    assert vectors.ops("cond", "lane_any") == []


def test_both_sides_of_an_if_store_with_one_select():
    p = Program()
    y = p.slot("y", p.number(0))
    with p.when_greater(1):
        p.b.store(y, p.b.let("mul", p.x, p.x))
    with p.b.otherwise():
        p.b.store(y, p.b.let("sqrt", p.x))
    p.b.store(p.result, p.b.load(y))
    vectors = p.vectorised()
    assert len(vectors.ops("cond")) == 1, "the other side stores it anyway, so the first store is plain"


def test_a_store_needed_after_a_continue_is_a_select():
    p = Program()
    kept, free, i = p.slot("kept", p.number(0)), p.slot("free", p.number(0)), p.slot("i", p.count(0))
    with p.b.loop() as loop:
        with p.when_greater(1):
            p.b.exit(Continue)
        p.add(kept, p.x)
        p.b.store(free, p.b.let("mul", p.x, p.x))
        p.add(kept, p.b.load(free))
        loop.continuing()
        p.add(i, p.count(1))
        loop.until(p.b.let("ge", p.b.load(i), p.count(4)))
    p.b.store(p.result, p.b.load(kept))
    vectors = p.vectorised()
    assert vectors.selects_into("kept") == 2
    assert vectors.selects_into("free") == 0
    assert not vectors.varies("i"), "what all lanes of the loop do in its continuing part is uniform"


def test_a_flag_is_stored_only_for_lanes_that_leave_there():
    p = Program()
    found, i = p.slot("found", p.b.const(B, [False])), p.slot("i", p.count(0))
    with p.b.loop() as loop:
        with p.b.when(p.b.let("gt", p.x, p.b.let("convert", p.b.load(i), type=F))):
            p.b.store(found, p.b.const(B, [True]))
            p.b.exit(Break)
        p.add(i, p.count(1))
        loop.until(p.b.let("gt", p.b.load(i), p.n))
    one, zero = p.number(1), p.number(0)
    p.b.store(p.result, p.b.let("cond", p.b.load(found), one, zero))
    vectors = p.vectorised()
    assert vectors.selects_into("found") == 1, "lanes that leave by `until` did not store it"


def test_a_table_read_at_a_uniform_index_is_uniform():
    p = Program(Table("nodes", F, 1))
    i = p.slot("i", p.count(0))
    read = p.b.let("table", p.b.load(i), type=F, attr="nodes")
    gathered = p.b.let("table", p.n, type=F, attr="nodes")
    p.b.store(p.result, p.b.let("add", read, gathered))
    vectors = p.vectorised()
    assert [s.value.id in vectors.vector.entry.varying for s in vectors.ops("table")] == [False, True]


def test_any_lane_asks_active_lanes_only_and_is_uniform():
    p = Program()
    p.b.store(p.result, p.x)
    with p.when_greater(1):
        some = p.b.let("any_lane", p.b.let("gt", p.n, p.count(3)), type=B)
        with p.b.when(some):
            p.b.store(p.result, p.number(2))
        every = p.b.let("all_lanes", p.b.let("gt", p.n, p.count(5)), type=B)
        with p.b.when(every):
            p.b.store(p.result, p.number(3))
    vectors = p.vectorised()
    assert vectors.ops("any_lane", "all_lanes") == []
    asked = {s.args[0] for s in vectors.ops("lane_any")}
    masks = {s.value.id for s in vectors.ops("and")}
    assert len(asked & masks) == 2, "and-ed with the lanes that are active"
    assert all(s.value.id not in vectors.vector.entry.varying for s in vectors.ops("lane_any"))


def test_any_lane_stays_uniform_where_its_argument_varies_from_the_second_iteration_on():
    p = Program()
    z, k = p.slot("z", p.number(0)), p.slot("k", p.count(0))
    with p.b.loop() as outer:
        with p.b.loop() as inner:
            with p.b.when(p.b.let("any_lane", p.b.let("gt", p.b.load(z), p.number(1)), type=B)):
                p.b.exit(Break)
            p.add(k, p.count(1))
            inner.until(p.b.let("ge", p.b.load(k), p.count(9)))
        p.b.store(z, p.x)
        p.add(k, p.count(1))
        outer.until(p.b.let("ge", p.b.load(k), p.count(20)))
    p.b.store(p.result, p.b.let("convert", p.b.load(k), type=F))
    vectors = p.vectorised()
    assert vectors.varies("z")
    assert not vectors.varies("k"), "all lanes leave the inner loop together"


def test_a_return_masks_what_follows():
    p = Program()
    with p.when_greater(1):
        p.b.store(p.result, p.number(1))
        p.b.exit(Return)
    p.b.store(p.result, p.number(2))
    vectors = p.vectorised()
    assert vectors.selects_into("result") == 1, "the first store is plain: other lanes store it later, as a whole"
    assert not [s for s in vectors.statements if isinstance(s, Return)], "what follows costs less than to ask"


def test_a_loop_is_not_entered_when_no_lane_is_left():
    p = Program()
    y = p.slot("y", p.x)
    with p.when_greater(1), p.b.loop() as loop:
        p.add(y, p.x)
        loop.until(p.b.let("gt", p.b.load(y), p.number(4)))
    p.b.store(p.result, p.b.load(y))
    vectors = p.vectorised()
    (guard,) = [s for s in vectors.entry.body if isinstance(s, If)]
    assert any(isinstance(s, Loop) for s in guard.then)
    asked = {s.value.id for s in vectors.ops("lane_any")}
    assert guard.condition in asked


def test_a_masked_store_into_an_array_goes_out_of_range_for_other_lanes():
    p = Program()
    array = p.b.variable(F, 4, "array")
    with p.when_greater(1):
        p.b.store(array, p.x, index=p.n)
    p.b.store(p.result, p.b.load(array, p.n))
    vectors = p.vectorised()
    (store,) = [s for s in vectors.statements if isinstance(s, Store) and s.index is not None]
    (select,) = vectors.ops("cond")
    assert store.index == select.value.id
    assert vectors.varies("array")


def test_an_array_of_uniform_values_is_uniform():
    p = Program()
    array = p.b.variable(F, 4, "array")
    p.b.store(array, p.number(2), index=p.count(1))
    p.b.store(p.result, p.b.load(array, p.n))
    assert not p.vectorised().varies("array")


def test_padding_lanes_are_never_active():
    p = Program()
    y = p.slot("y", p.x)
    with p.b.loop() as loop:
        p.add(y, p.x)
        loop.until(p.b.let("gt", p.b.load(y), p.number(4)))
    p.b.store(p.result, p.b.load(y))
    vectors = p.vectorised(padded=True)
    (mask,) = vectors.ops("lane_mask")
    assert any(isinstance(s, Store) and s.value == mask.value.id for s in vectors.statements)


def test_a_return_in_a_loop_becomes_a_break_and_a_flag():
    p = Program()
    with p.b.loop() as outer:
        with p.b.loop() as inner:
            with p.when_greater(1):
                p.b.exit(Return)
            inner.until(p.b.let("gt", p.n, p.count(1)))
        outer.until(p.b.let("gt", p.n, p.count(2)))
    function = returns_outside_loops(p.b.finish())
    for loop in (s for s in walk(function.body) if isinstance(s, Loop)):
        assert not any(isinstance(s, Return) for s in walk(loop.body))
    assert [v.name for v in function.variables] == ["returned"]
    assert sum(isinstance(s, Return) for s in walk(function.body)) == 1


def test_output_is_the_same_each_time():
    module = optimise(prepare(random_module(3), Options(), VECTOR).module)
    assert print_module(vectorize(module).module) == print_module(vectorize(module).module)
