"""Passes take time in proportion to the module, and as little stack as it is allowed to be deep."""

import random

import pytest
from effort import calls

from shpy.backend.base import Options
from shpy.ir.builder import Builder
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import MAX_LOOP_DEPTH, MAX_REGION_DEPTH, Module, Port
from shpy.ir.types import vec
from shpy.ir.verifier import verify
from shpy.passes.pipeline import Target, prepare

F = vec("f")


def program(fill):
    b = Builder("main")
    x, o = b.input(F, "x"), b.output(F, "o")
    fill(b, x, o)
    ports = (Port("x", "Attrib1f"),), (Port("o", "Attrib1f"),)
    return Module("scale", *ports, (), (), (b.finish(),))


def straight(count):
    """As recorded: a slot for every object, a load at every use."""

    def fill(b, x, o):
        r = random.Random(1)
        slots = [b.variable(F, name=f"s{k}") for k in range(8)]
        for slot in slots:
            b.store(slot, x)
        for _ in range(count):
            t = b.variable(F)
            b.store(t, b.let(r.choice(("add", "mul", "sub")), b.load(r.choice(slots)), b.load(r.choice(slots))))
            b.store(r.choice(slots), b.load(t))
        b.store(o, b.load(slots[0]))

    return program(fill)


def branchy(count):
    """As many variables as branches, each stored in branches of others."""

    def fill(b, x, o):
        r = random.Random(1)
        slots = []
        for k in range(count):
            slots.append(b.variable(F, name=f"s{k}"))
            b.store(slots[-1], x)
            with b.when(b.let("lt", b.load(r.choice(slots)), b.load(r.choice(slots)))):
                b.store(r.choice(slots), b.let("mul", b.load(r.choice(slots)), x))
        for slot in slots:
            b.store(o, b.let("add", b.load(o), b.load(slot)))

    return program(fill)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("make", "count"), [(straight, 500), (branchy, 250)])
def test_effort_is_linear(make, count):
    modules = make(count), make(4 * count)
    small, large = (calls(lambda module=module: prepare(module, Options(), Target("any"))) for module in modules)
    assert large < 4.2 * small


def nested(deepen, depth):
    def fill(b, x, o):
        def nest(left):
            if left == 0:
                b.store(o, b.let("add", b.load(o), x))
                return
            deepen(b, x, o, lambda: nest(left - 1))

        nest(depth)

    return program(fill)


def a_branch(b, x, o, inner):
    with b.when(b.let("lt", b.load(o), x)):
        inner()
    with b.otherwise():
        b.store(o, x)


def a_loop(b, x, o, inner):
    with b.loop() as loop:
        inner()
        loop.until(b.let("ge", b.load(o), x))


@pytest.mark.parametrize(("deepen", "depth"), [(a_branch, MAX_REGION_DEPTH - 2), (a_loop, MAX_LOOP_DEPTH)])
def test_the_deepest_nesting_is_no_problem(deepen, depth):
    module = nested(deepen, depth)
    verify(module)
    prepared = prepare(module, Options(), Target("flags", loop_flags=True))
    verify(prepared.module)
    (wanted,), _ = Interpreter(module).run_element([2.0])
    (got,), _ = Interpreter(prepared.module).run_element([2.0])
    assert wanted == got == 2
