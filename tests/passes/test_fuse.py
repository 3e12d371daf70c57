"""Sums of products become fused multiply-adds, by the rule of docs/numerics.md."""

import random

import pytest
from before_after import check, module, text

import shpy as sh
from shpy.ir.nodes import Let, Module
from shpy.ir.traverse import walk
from shpy.ir.verifier import verify
from shpy.passes.fuse import fuse
from shpy.passes.promote import promote

STAYS = [
    # a product of ints
    """
    %4: i = mul %k.2, %k.2
    %5: i = add %4, %k.2
    """,
    # the negative of a product, and a component of one
    """
    %4: f = mul %a.0, %a.0
    %5: f = neg %4
    %6: f = add %5, %a.0
    %7: f3 = mul %v.1, %v.1
    %8: f = swizzle.x %7
    %9: f = add %8, %6
    """,
    # a fused operation is no product
    """
    %4: f = fma %a.0, %a.0, %a.0
    %5: f = add %4, %a.0
    """,
]


@pytest.mark.parametrize("body", STAYS)
def test_other_sums_stay(body):
    check(fuse, body, body)


def test_a_product_on_either_side():
    check(
        fuse,
        """
        %4: f = mul %a.0, %a.0
        %5: f = add %4, %a.0
        %6: f = add %a.0, %4
        %7: f = sub %4, %a.0
        %8: f = sub %a.0, %4
        """,
        """
        %4: f = mul %a.0, %a.0
        %5: f = fma %a.0, %a.0, %a.0
        %6: f = fma %a.0, %a.0, %a.0
        %9: f = neg %a.0
        %7: f = fma %a.0, %a.0, %9
        %10: f = neg %a.0
        %8: f = fma %10, %a.0, %a.0
        """,
    )


def test_of_two_products_the_left_one_is_contracted():
    check(
        fuse,
        """
        %x.4: f = mul %a.0, %a.0
        %y.5: f = mul %x.4, %a.0
        %6: f = add %x.4, %y.5
        %7: f = sub %y.5, %x.4
        """,
        """
        %x.4: f = mul %a.0, %a.0
        %y.5: f = mul %x.4, %a.0
        %6: f = fma %a.0, %a.0, %y.5
        %8: f = neg %x.4
        %7: f = fma %x.4, %a.0, %8
        """,
    )


def test_vectors_and_a_scalar_product_that_is_repeated():
    check(
        fuse,
        """
        %4: f3 = mul %v.1, %v.1
        %5: f3 = add %4, %v.1
        %6: f = mul %a.0, %a.0
        %7: f3 = splat %6
        %8: f3 = add %v.1, %7
        """,
        """
        %4: f3 = mul %v.1, %v.1
        %5: f3 = fma %v.1, %v.1, %v.1
        %6: f = mul %a.0, %a.0
        %7: f3 = splat %6
        %9: f3 = splat %a.0
        %10: f3 = splat %a.0
        %8: f3 = fma %9, %10, %v.1
        """,
    )


def test_mad_is_a_sum_of_a_product():
    check(fuse, "%4: f = mad %a.0, %a.0, %a.0", "%4: f = fma %a.0, %a.0, %a.0")


def fused_after(statements: str) -> bool:
    """Return whether `$x.2 + a` is contracted after these statements, the first of which may store a product."""
    body = f"""
    var $x.2: f
    %4: f = mul %a.0, %a.0
    {statements}
    %90: f = load $x.2
    %91: f = add %90, %a.0
    store $o.0 = %91
    """
    changed = fuse(module(body))
    verify(changed)
    return "%91: f = fma %a.0, %a.0, %a.0" in text(changed)


PATHS = {
    "store $x.2 = %4": True,
    "store $x.2 = %4\nstore $x.2 = %a.0": False,
    "store $x.2 = %4\nif %c.3 {\nstore $x.2 = %a.0\n}": False,
    "store $x.2 = %4\nif %c.3 {\nstore $o.0 = %a.0\n}": True,
    "if %c.3 {\nstore $x.2 = %4\n}": False,
    "if %c.3 {\nstore $x.2 = %4\n} else {\nstore $x.2 = %4\n}": True,
    "store $x.2 = %4\nif %c.3 {\nstore $x.2 = %a.0\nreturn\n}": True,
    "if %c.3 {\nreturn\n} else {\n%5: f = mul %4, %4\nstore $x.2 = %5\n}": False,
    "store $x.2 = %4\nloop turns 4 {\nstore $x.2 = %a.0\nbreak\n}": False,
    "store $x.2 = %4\nloop turns 4 {\nstore $o.0 = %a.0\nbreak\n}": True,
    "loop turns 4 {\nstore $x.2 = %4\nbreak\n}": False,
    "store $x.2 = %4\n%5: f = load $x.2\nstore $o.0 = %5\nstore $x.2 = %5": True,
}


@pytest.mark.parametrize("statements", PATHS)
def test_a_variable_counts_as_the_product_that_it_was_assigned_on_every_path(statements):
    assert fused_after(statements) == PATHS[statements]


def test_in_a_loop_the_product_of_the_same_iteration_counts():
    check(
        fuse,
        """
        store $o.0 = %a.0
        loop turns 4 {
          %4: f = load $o.0
          %5: f = add %4, %a.0
          %6: f = mul %5, %a.0
          store $o.0 = %6
        } continuing {
          %7: f = load $o.0
          %8: f = add %7, %a.0
          store $o.0 = %8
        }
        """,
        """
        store $o.0 = %a.0
        loop turns 4 {
          %4: f = load $o.0
          %5: f = add %4, %a.0
          %6: f = mul %5, %a.0
          store $o.0 = %6
        } continuing {
          %7: f = load $o.0
          %8: f = fma %5, %a.0, %a.0
          store $o.0 = %8
        }
        """,
    )


def test_a_call_that_changes_the_variable():
    functions = """
    function change($x.0: f) -> () {
      %0: f = load $x.0
      %1: f = mul %0, %0
      %2: f = add %1, %0
      store $x.0 = %2
    }

    """
    changed = fuse(
        module(
            """
            var $x.2: f
            %4: f = mul %a.0, %a.0
            store $x.2 = %4
            call change($x.2)
            %5: f = load $x.2
            %6: f = add %5, %a.0
            store $o.0 = %6
            """,
            functions,
        )
    )
    verify(changed)
    assert "%6: f = add %5, %a.0" in text(changed)
    assert "%2: f = fma %0, %0, %0" in text(changed, "change")


class Body:
    """Random statements: products and sums of what variables hold, in branches and loops, with exits."""

    def __init__(self, seed: int) -> None:
        self.random, self.count = random.Random(seed), 3

    def value(self) -> str:
        self.count += 1
        return f"%{self.count}"

    def block(self, visible: list[str], depth: int, in_loop: bool) -> list[str]:
        visible, lines = list(visible), []
        for _ in range(self.random.randint(2, 7)):
            lines += self.statement(visible, depth, in_loop)
        if in_loop and depth and self.random.random() < 0.3:
            lines.append(self.random.choice(["break", "continue", "return"]))
        return lines

    def statement(self, visible: list[str], depth: int, in_loop: bool) -> list[str]:
        variable, kind = f"$x.{self.random.randint(2, 4)}", self.random.random()
        if kind < 0.12 and depth < 3:
            then, orelse = (self.block(visible, depth + 1, in_loop) for _ in range(2))
            return ["if %c.3 {", *then, "} else {", *orelse, "}"]
        if kind < 0.2 and depth < 3:
            return ["loop turns 3 {", *self.block(visible, depth + 1, True), "}"]
        if kind < 0.5:
            return [f"store {variable} = {self.random.choice(visible)}"]
        new = self.value()
        if kind < 0.7:
            line = f"{new}: f = load {variable}"
        else:
            op = self.random.choice(["mul", "mul", "add", "sub"])
            line = f"{new}: f = {op} {self.random.choice(visible[-4:])}, {self.random.choice(visible[-4:])}"
        visible.append(new)
        return [line]

    def module(self) -> Module:
        lines = self.block(["%a.0"], 0, False)
        return module("\n".join([*(f"var $x.{n}: f" for n in (2, 3, 4)), *lines, "store $o.0 = %a.0"]))


def fused_operations(module: Module) -> int:
    return sum(isinstance(s, Let) and s.op == "fma" for f in module.functions for s in walk(f.body))


@pytest.mark.slow
def test_no_other_pass_finds_more_to_contract():
    """The variables that `promote` turns into values hold no products that the rule did not see."""
    through_variables = 0
    for seed in range(400):
        module = Body(seed).module()
        contracted = fuse(module)
        verify(contracted)
        promoted = promote(contracted)
        assert fuse(promoted) == promoted, str(module)
        through_variables += fused_operations(contracted) > 2
    assert through_variables > 40


def test_programs_that_are_called_are_part_of_the_caller_and_subroutines_are_not():
    @sh.program
    def product(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
        return x * y

    @sh.subroutine
    def multiplied(x: sh.Attrib1f, y: sh.Attrib1f) -> sh.Attrib1f:
        return x * y

    @sh.program
    def inlined(x: sh.Attrib1f) -> sh.Attrib1f:
        return product(x, x) + 1

    @sh.program
    def called(x: sh.Attrib1f) -> sh.Attrib1f:
        return multiplied(x, x) + 1

    assert " fma " in str(fuse(inlined.ir))
    assert " fma " not in str(fuse(called.ir))
