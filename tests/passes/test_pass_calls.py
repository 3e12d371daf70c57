"""Subroutines that give and get values, and their copies for many lanes."""

import pytest
from passes.before_after import module

import shpy as sh
from shpy.backend.base import Options
from shpy.ir.nodes import Call, Let
from shpy.ir.traverse import walk
from shpy.ir.verifier import verify
from shpy.passes.by_value import pass_by_value
from shpy.passes.dead import remove_unused_inputs
from shpy.passes.pipeline import Target, prepare
from shpy.passes.vectorize import vectorize

ADVANCE = """
function advance($p.0: f, $spare.1: f, $only.2: f, %v.0: f) -> () {
  %1: f = load $p.0
  %2: f = load $only.2
  %3: f = add %1, %2
  store $p.0 = %3
  store $spare.1 = %v.0
}
"""
COUNT = """
function count(%n.0: i, %k.1: i) -> ($r.0: i) {
  %2: i = const 1
  %3: b = gt %n.0, %k.1
  if %3 {
    store $r.0 = %2
    return
  }
  %4: i = add %k.1, %2
  store $r.0 = %4
}
"""


def calls(function):
    return [s for s in walk(function.body) if isinstance(s, Call)]


def vectorised(functions, body, *, padded=False):
    prepared = prepare(module(body, functions), Options(), Target("vector", vector=True))
    made = vectorize(prepared.module, padded=padded)
    verify(made.module)
    return made


def test_a_variable_goes_in_if_it_is_read_and_comes_back_if_it_is_stored():
    body = """
    var $x.2: f
    var $y.3: f
    var $z.4: f
    store $x.2 = %a.0
    store $z.4 = %a.0
    call advance($x.2, $y.3, $z.4, %a.0)
    %4: f = load $x.2
    %5: f = load $y.3
    %6: f = add %4, %5
    store $o.0 = %6
    """
    made = pass_by_value(module(body, ADVANCE))
    verify(made)
    advance = made.functions[0]
    assert [port.name for port in advance.inputs] == ["p", "only", "v"]
    assert [output.name for output in advance.outputs] == ["p", "spare"]
    (call,) = calls(made.entry)
    assert len(call.args) == 3
    assert [r.name for r in call.results] == ["x", "y"]


def test_an_array_cannot_be_handed_over_by_value():
    takes = "function f($t.0: f [3]) -> () {\n  return\n}\n"
    with pytest.raises(TypeError, match="f takes an array"):
        pass_by_value(module("store $o.0 = %a.0", takes))


def test_there_is_a_copy_for_each_way_of_being_called():
    body = """
    %4: i = const 7
    call count(%k.2, %4) -> %5: i
    call count(%4, %4) -> %6: i
    call count(%k.2, %4) -> %7: i
    %8: i = add %5, %6
    %9: i = add %8, %7
    %10: f = convert %9
    store $o.0 = %10
    """
    made = vectorised(COUNT, body)
    assert [f.name for f in made.module.functions] == ["count", "count_2", "main"]
    first, uniform, again = calls(made.module.entry)
    assert (first.function, uniform.function, again.function) == ("count", "count_2", "count")
    assert first.results[0].id in made.entry.varying
    assert uniform.results[0].id not in made.entry.varying
    assert not made.facts["count_2"].varying


def test_a_copy_gets_the_mask_of_the_lanes_that_call_it():
    body = """
    %4: f = const 0.0
    %5: b = gt %a.0, %4
    if %5 {
      call count(%k.2, %k.2) -> %6: i
      %7: f = convert %6
      store $o.0 = %7
    }
    call count(%k.2, %k.2) -> %8: i
    %9: f = convert %8
    %10: f = load $o.0
    %11: f = add %9, %10
    store $o.0 = %11
    """
    made = vectorised(COUNT, body)
    inside, outside = calls(made.module.entry)
    ports = {f.name: [port.name for port in f.inputs] for f in made.module.functions}
    assert ports[inside.function] == ["n", "k", "active"]
    assert ports[outside.function] == ["n", "k"]
    padded = vectorised(COUNT, body, padded=True)
    assert len({call.function for call in calls(padded.module.entry)}) == 1  # every lane may hold no element


def test_a_status_is_the_last_result_of_what_may_end_the_element():
    drops = """
    function drops($p.0: f, %k.0: i) -> ($r.1: f) {
      %1: i = const 3
      %2: b = gt %k.0, %1
      if %2 {
        discard
      }
      %3: f = load $p.0
      store $r.1 = %3
      store $p.0 = %3
    }
    """
    body = """
    var $x.2: f
    store $x.2 = %a.0
    call drops($x.2, %k.2) -> %4: f
    store $o.0 = %4
    """
    made = vectorised(drops, body)
    callee, entry = made.module.functions
    assert [output.name for output in callee.outputs] == ["r", "p", "status"]
    (call,) = calls(entry)
    assert call.results[-1].id in made.entry.varying


def test_an_input_that_a_pure_function_does_not_read_goes_with_its_arguments():
    """A result varies where an argument does, so such an input would make a number of one lane vary."""
    functions = """
    pure function first(%a.0: f, %b.1: f) -> ($r.0: f) {
      %3: f = mul %a.0, %a.0
      store $r.0 = %3
    }
    pure function second(%a.0: f, %b.1: f, %c.2: f) -> ($r.0: f) {
      %4: f = add %b.1, %c.2
      %5: f = call first(%a.0, %4)
      store $r.0 = %5
    }
    """
    before = module(
        "%4: f = const 3.0\n%5: f = mul %a.0, %a.0\n%6: f = call second(%4, %5, %a.0)\nstore $o.0 = %6", functions
    )
    after = remove_unused_inputs(before)
    verify(after)
    assert [len(f.inputs) for f in after.functions] == [1, 1, 4]
    assert not any(isinstance(s, Let) and s.op in ("add", "mul") for f in after.functions[1:] for s in walk(f.body))
    assert remove_unused_inputs(after) is after
    assert 6 in vectorize(before).facts["main"].varying
    assert 6 not in vectorize(after).facts["main"].varying


def test_numbers_of_one_lane_may_change_in_a_loop_that_elements_leave_one_by_one():
    @sh.subroutine
    def weight(ray: sh.Attrib1f, share: sh.Attrib1f) -> sh.Attrib1f:
        return share * 0.5

    @sh.subroutine
    def plane(p: sh.Attrib3f) -> sh.Attrib1f:
        return sh.dot(p.xy, p.xy)

    @sh.program
    def doubled(x: sh.Attrib1f) -> tuple[sh.Attrib1f, sh.Attrib1f]:
        w, v = sh.Attrib1f(weight(x, 1.0)), sh.Attrib1f(plane(sh.vec3(0.5, 0.5, x)))
        with sh.SH_WHILE(lambda: w < x):
            w *= 2
            v *= 2
        return w, v

    for backend in ("numpy", "opencl", "glsl"):
        w, v = doubled.compile(backend)([1.0, 2.0, 3.0])
        assert w.tolist() == v.tolist() == [1, 2, 4]
        assert doubled.compile(backend)(5.0)[0] == 8
