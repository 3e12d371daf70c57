"""The plan of a function's text: which value gets a name, and what stands in the head of a loop."""

import numpy as np
import pytest

from shpy.backend.emit.plan import Wishes, _letters_of, plan
from shpy.backend.emit.tree import Literal
from shpy.backend.opencl.text.spell_cl import ClSpeller
from shpy.ir.constants import encode
from shpy.ir.nodes import Let, Store, Value
from shpy.ir.parser import parse
from shpy.ir.traverse import walk
from shpy.ir.types import Base, vec

BEGIN = """
module f
input a: Attrib1f
input n: Attrib1i
output "0": Attrib1f

function f(%a.0: f, %n.1: i) -> ($result.0: f) {
"""


def planned(body, **wishes):
    """Return the plan of a function of `a` and `n`, the function, and the plan's wishes applied."""
    module = parse(BEGIN + body + "}\n")
    return plan(module.entry, {f.name: f for f in module.functions}, Wishes(**wishes))


def test_a_value_with_one_use_stands_where_it_is_used():
    made = planned("""
  %2: f = mul %a.0, %a.0
  %3: f = add %2, %a.0
  store $result.0 = %3
""")
    assert made.named == set()
    assert made.settled == {}


def test_a_value_is_declared_before_a_store_that_changes_what_it_reads():
    made = planned("""
  var $x.1: f
  store $x.1 = %a.0
  %2: f = load $x.1
  %3: f = add %2, %a.0
  store $x.1 = %a.0
  store $result.0 = %3
""")
    assert made.settled == {(0, 3): [3]}


def test_a_variable_stands_for_the_value_that_was_just_stored_and_the_next_store_changes_nothing():
    made = planned("""
  var $x.1: f
  var $y.2: f
  %2: f = mul %a.0, %a.0
  store $x.1 = %2
  store $y.2 = %2
  %3: f = load $y.2
  %4: f = add %3, %2
  store $result.0 = %4
""")
    assert made.adopts == {(0, 1)}


LONG = "".join(f"  %{k + 1}: f = sqrt %{k}\n" for k in range(2, 40))


def test_long_expressions_get_names_but_not_where_they_are_returned():
    deep = "  %2: f = sqrt %a.0\n" + LONG
    made = planned(f"{deep}  store $result.0 = %40\n", result=0)
    assert made.unnamed == 0
    assert 0 < len(made.named) < 8
    wide = "  %2: f = mul %a.0, %a.0\n" + "".join(f"  %{k + 1}: f = add %{k}, %a.0\n" for k in range(2, 26))
    assert planned(f"{wide}  %27: f = sqrt %26\n  store $result.0 = %27\n", result=0).named == {26}
    assert planned(f"{wide}  store $result.0 = %26\n", result=0).named == set()


COUNTED = """
  var $i.1: i
  %2: i = const 0
  %3: i = const 1
  store $i.1 = %2
  loop {{
    %4: i = load $i.1
    %5: b = ge %4, %n.1
    if %5 {{
      break
    }}
    %6: f = load $result.0
    %7: f = add %6, %a.0
    store $result.0 = %7
  }} continuing {{
    %8: i = {step}
    %9: i = add %8, %3
    store $i.1 = %9
  }}
"""


def test_a_counter_and_its_test_and_step_stand_in_the_head():
    made = planned(COUNTED.format(step="load $i.1"))
    assert made.tests == {(0, 3): 3}
    assert made.steps == {(0, 3)}
    assert made.starts == {(0, 2)}


def test_a_step_that_reads_what_the_body_makes_stands_in_the_body():
    made = planned(COUNTED.format(step="convert %7"))
    assert made.steps == set()


def test_the_head_of_a_loop_takes_no_start_of_an_inner_counter():
    """The inner counter starts once, before both loops: its start is no part of the outer loop's head."""
    made = planned("""
  var $i.1: i
  var $j.2: i
  %2: i = const 0
  %3: i = const 1
  store $i.1 = %2
  store $j.2 = %2
  loop {
    %4: i = load $j.2
    %5: b = ge %4, %n.1
    if %5 {
      break
    }
    loop {
      %6: i = load $i.1
      %7: b = ge %6, %n.1
      if %7 {
        break
      }
      store $result.0 = %a.0
    } continuing {
      %8: i = load $i.1
      %9: i = add %8, %3
      store $i.1 = %9
    }
  } continuing {
    %10: i = load $j.2
    %11: i = add %10, %3
    store $j.2 = %11
  }
""")
    assert made.starts == {(0, 3)}


@pytest.mark.parametrize("early", [True, False])
def test_a_result_needs_no_variable_where_every_way_ends_with_a_store_of_it(early):
    leave = "    return\n" if early else ""
    made = planned(
        f"""
  %2: f = const 0x0p+0
  %3: b = lt %a.0, %2
  if %3 {{
    store $result.0 = %2
{leave}  }}
  store $result.0 = %a.0
""",
        result=0,
    )
    assert made.unnamed == (0 if early else None)


def test_a_plan_names_each_value_at_most_once():
    text = COUNTED.format(step="load $i.1")
    module = parse(BEGIN + text + "}\n")
    made = plan(module.entry, {})
    settled = [value for values in made.settled.values() for value in values]
    lets = {s.value.id for s in walk(module.entry.body) if isinstance(s, Let)}
    assert len(settled) == len(set(settled))
    assert made.named.isdisjoint(settled)
    assert made.named | set(settled) <= lets
    assert any(isinstance(s, Store) for s in walk(module.entry.body))


@pytest.mark.parametrize("x", [0.5, 2.0, -3.0, 1e10, 1.25e-7, 0.1, 65536.0, np.nan])
def test_the_letters_of_a_number_are_known_before_it_is_spelled(x):
    const = Let(Value(0, vec(Base.F)), "const", (), encode(vec(Base.F), [x]))
    spelled = ClSpeller().text(Literal(vec(Base.F), float(np.float32(x))))
    assert abs(_letters_of(const) - len(spelled)) <= 1, spelled
