"""The walk over a function: which value gets a name, and what stands in the head of a loop."""

import re

import pytest

from shpy.backend.emit.structure import MAX_DEPTH, MAX_WIDTH
from shpy.backend.emit.waiting import Waiting
from shpy.backend.opencl.text.kernel import print_kernel
from shpy.ir.parser import parse

BEGIN = """
module f
input a: Attrib1f
input n: Attrib1i
output "0": Attrib1f

function f(%a.0: f, %n.1: i) -> ($result.0: f) {
"""


def lines_of(body):
    """Return the lines of the kernel of a function of `a` and `n`, from those that read its inputs on."""
    text = print_kernel(parse(f"{BEGIN}{body}}}\n")).text
    lines = [line.strip() for line in text.splitlines()]
    return lines[lines.index("return;") + 2 : -1]


def declared(lines):
    return [line for line in lines if re.match(r"(float|int|bool) t\d* =", line)]


def test_a_value_with_one_use_stands_where_it_is_used():
    lines = lines_of("""
  %2: f = mul %a.0, %a.0
  %3: f = add %2, %a.0
  store $result.0 = %3
""")
    assert lines[-1].endswith("= a * a + a;")
    assert not declared(lines)


def test_a_value_is_declared_before_a_store_that_changes_what_it_reads():
    lines = lines_of("""
  var $x.1: f
  store $x.1 = %a.0
  %2: f = load $x.1
  %3: f = add %2, %a.0
  store $x.1 = %a.0
  store $result.0 = %3
""")
    assert lines[1:4] == ["float x = a;", "float t = x + a;", "x = a;"]


def test_a_variable_stands_for_the_value_that_was_just_stored_and_the_next_store_changes_nothing():
    lines = lines_of("""
  var $x.1: f
  var $y.2: f
  %2: f = mul %a.0, %a.0
  store $x.1 = %2
  store $y.2 = %2
  %3: f = load $y.2
  %4: f = add %3, %2
  store $result.0 = %4
""")
    assert lines[1:3] == ["float x = a * a;", "float y = x;"]
    assert lines[3].endswith("= y + x;")


def test_long_expressions_get_names_but_not_where_they_are_written():
    deep = "  %2: f = sqrt %a.0\n" + "".join(f"  %{k + 1}: f = sqrt %{k}\n" for k in range(2, 40))
    lines = lines_of(f"{deep}  store $result.0 = %40\n")
    assert 0 < len(declared(lines)) < 8
    assert max(line.count("sqrt") for line in lines) <= MAX_DEPTH
    wide = "  %2: f = mul %a.0, %a.0\n" + "".join(f"  %{k + 1}: f = add %{k}, %a.0\n" for k in range(2, 26))
    assert declared(lines_of(f"{wide}  %27: f = sqrt %26\n  store $result.0 = %27\n"))[0].count("a") > MAX_WIDTH // 5
    assert not declared(lines_of(f"{wide}  store $result.0 = %26\n"))


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
    lines = lines_of(COUNTED.format(step="load $i.1"))
    assert "for (int i = 0; i < n; i += 1) {" in lines


def test_a_step_that_reads_what_the_body_makes_stands_in_the_body():
    text = "\n".join(lines_of(COUNTED.format(step="convert %7")))
    assert "for (" not in text
    assert "while (i < n) {" in text


def test_the_head_of_a_loop_takes_no_start_of_an_inner_counter():
    """The inner counter starts once, before both loops: its start is no part of the outer loop's head."""
    lines = lines_of("""
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
    heads = [line for line in lines if line.startswith("for (")]
    assert [head.startswith("for (int ") for head in heads] == [True, False]


@pytest.mark.parametrize("inside", [True, False])
def test_the_values_of_a_region_wait_no_longer_than_the_region(inside):
    waiting = Waiting({1: 1, 2: 1})
    waiting.add(1, frozenset({7}))
    with waiting.region():
        waiting.add(2, frozenset({7, 8}))
        assert waiting.readers([8, 7]) == [1, 2]
        if inside:
            waiting.use([2])
    assert waiting.readers([7, 8]) == [1]
    waiting.use([1])
    assert waiting.readers([7]) == []
