import pytest
from before_after import module, text

from shpy.backend.base import Options
from shpy.errors import CompileError
from shpy.ir.builder import Builder
from shpy.ir.interpreter import Interpreter
from shpy.ir.nodes import Call, Discard, Module, Port, Return, Status
from shpy.ir.traverse import walk
from shpy.ir.types import vec
from shpy.ir.verifier import verify
from shpy.passes.exits import DEVICE_TURNS, Ending, few_turns, make_exits_explicit, may_be_stopped
from shpy.passes.inline import inline_calls
from shpy.passes.pipeline import Target, optimise, prepare

TABLE = {"data": [0.0] * 8}


def run(module, a=1.0, k=0, c=True):
    (o, p), status = Interpreter(module).run_element([a, [1, 2, 3], k, c], {}, TABLE)
    return o, list(p), status


def test_nothing_to_end_early_means_no_status():
    given = module("loop turns 4 {\nif %c.3 {\nbreak\n}\n}\nstore $o.0 = %a.0")
    assert make_exits_explicit(given) == Ending(given, status=False, loops=(), flagged=False)


def test_discard_becomes_a_status():
    ending = make_exits_explicit(module("if %c.3 {\ndiscard\n}\nstore $o.0 = %a.0"))
    changed = ending.module
    verify(changed)
    assert ending.status
    assert [o.name for o in changed.entry.outputs] == ["o", "p", "status"]
    assert not any(isinstance(s, Discard) for s in walk(changed.entry.body))
    assert run(changed, c=True)[2] == Status.DISCARDED
    assert run(changed, c=False) == (1, [0, 0, 0], Status.WRITTEN)


LOOP = """
var $n.2: i
loop {
  %4: i = load $n.2
  %5: i = const 1
  %6: i = add %4, %5
  store $n.2 = %6
  %7: b = ge %6, %k.2
} until %7
store $o.0 = %a.0
"""


@pytest.mark.parametrize("flags", [False, True])
def test_a_loop_takes_its_limit_and_no_iteration_more(flags):
    ending = make_exits_explicit(module(LOOP), 10, loop_flags=flags)
    changed = ending.module
    verify(changed)
    assert (ending.status, ending.flagged) == (True, flags)
    assert len(ending.loops) == 1
    assert run(changed, k=10)[2] == Status.WRITTEN
    assert run(changed, k=11)[2] == Status.FIRST_LOOP


def test_no_limit_means_no_counter():
    ending = make_exits_explicit(module(LOOP), None)
    assert (ending.module.entry.body, ending.status, ending.loops) == (module(LOOP).entry.body, False, ())


def test_loops_are_counted_across_functions():
    functions = """
    function f(%n.0: i) -> ($r.0: i) {
      loop {
        %1: i = load $r.0
        %2: i = const 1
        %3: i = add %1, %2
        store $r.0 = %3
        %4: b = ge %3, %n.0
      } until %4
    }
    """
    given = module(LOOP + "%20: i = const 20\ncall f(%20) -> %21: i\n%22: f = convert %21\nstore $o.0 = %22", functions)
    ending = make_exits_explicit(given, 10)
    changed = ending.module
    verify(changed)
    assert len(ending.loops) == 2
    assert [i.name for i in changed.functions[0].inputs] == ["n", "status"]
    assert run(changed, k=5)[2] == Status.FIRST_LOOP
    assert run(changed, k=50)[2] == Status.FIRST_LOOP + 1


def test_an_element_may_end_in_the_continuing_part():
    functions = """
    function stop(%n.0: i) -> () {
      %1: i = const 3
      %2: b = gt %n.0, %1
      if %2 {
        discard
      }
    }
    """
    body = """
    var $n.2: i
    var $m.3: i
    loop turns 9 {
      %4: i = load $n.2
      %5: i = const 1
      %6: i = add %4, %5
      store $n.2 = %6
      if %c.3 {
        continue
      }
      %7: b = ge %6, %k.2
      if %7 {
        break
      }
      %10: i = load $m.3
      %11: i = add %10, %5
      store $m.3 = %11
    } continuing {
      %8: i = load $n.2
      call stop(%8)
    }
    %9: i = load $n.2
    %12: i = load $m.3
    %13: i = add %9, %12
    %14: f = convert %13
    store $o.0 = %14
    """
    given = module(body, functions)
    for form in (make_exits_explicit(given).module, make_exits_explicit(inline_calls(given)).module):
        verify(form)
        assert run(form, c=True)[2] == Status.DISCARDED
        assert run(form, k=2, c=False)[::2] == (2 + 1, Status.WRITTEN)
        assert run(form, k=7, c=False)[2] == Status.DISCARDED


@pytest.mark.parametrize(("turns", "few"), [(200, True), (300, False)])
def test_flags_are_for_devices_that_could_stop(turns, few):
    given = module(f"loop turns {turns} {{\nloop turns 250 {{\nstore $o.0 = %a.0\n}}\n}}")
    assert (turns * 251 < DEVICE_TURNS) == few == few_turns(given)
    assert may_be_stopped(given) != few
    ending = make_exits_explicit(given, loop_flags=True)
    assert ending.status == ending.flagged == (not few)


def test_guards_are_inlined_as_branches():
    functions = """
    function f(%x.0: f, $r.0: f) -> () {
      %1: f = const 0.0
      %2: b = lt %x.0, %1
      if %2 {
        store $r.0 = %1
        return
      }
      %3: f = sqrt %x.0
      store $r.0 = %3
    }
    """
    changed = inline_calls(module("call f(%a.0, $o.0)", functions))
    verify(changed)
    assert [f.name for f in changed.functions] == ["main"]
    assert not any(isinstance(s, Call | Return) for s in walk(changed.entry.body))
    assert text(optimise(changed)) == "\n".join(
        [
            "%4: f = const 0x0p+0",
            "%5: b = lt %a.0, %4",
            "if %5 {",
            "  store $o.0 = %4",
            "} else {",
            "  %6: f = sqrt %a.0",
            "  store $o.0 = %6",
            "}",
        ]
    )
    assert run(changed, a=4.0)[0] == 2
    assert run(changed, a=-4.0)[0] == 0


def test_returns_from_branches_of_branches_leave_a_loop_of_one_turn():
    functions = """
    function f(%x.0: f, %c.1: b) -> ($r.0: f) {
      store $r.0 = %x.0
      if %c.1 {
        %2: b = isnan %x.0
        if %2 {
          return
        }
        %3: f = neg %x.0
        store $r.0 = %3
      }
      %4: f = load $r.0
      %5: f = add %4, %4
      store $r.0 = %5
    }
    """
    changed = inline_calls(module("call f(%a.0, %c.3) -> %4: f\nstore $o.0 = %4", functions))
    verify(changed)
    assert "loop turns 1 {" in text(changed)
    assert run(changed, a=3.0)[0] == -6
    assert run(changed, a=3.0, c=False)[0] == 6


def test_a_callees_variables_start_at_zero_each_time():
    functions = """
    function f(%x.0: f) -> ($r.0: f) {
      var $sum.1: f
      var $a.2: f[12]
      %1: i = const 11
      %2: f = load $a.2[%1]
      %3: f = load $sum.1
      %4: f = add %3, %x.0
      %5: f = add %4, %2
      store $sum.1 = %5
      store $a.2[%1] = %5
      store $r.0 = %5
    }
    """
    body = """
    var $n.2: i
    loop turns 3 {
      call f(%a.0) -> %4: f
      store $o.0 = %4
      %5: i = const 1
      %6: i = load $n.2
      %7: i = add %6, %5
      store $n.2 = %7
      %8: i = const 3
      %9: b = ge %7, %8
    } until %9
    """
    changed = inline_calls(module(body, functions))
    verify(changed)
    assert run(changed, a=2.0)[0] == 2
    assert run(optimise(changed), a=2.0)[0] == 2


def test_too_deep_an_inlining_names_the_line():
    b = Builder("f")
    slot = b.reference(vec("f"), "r")
    _nest_loops(b, slot, 8)
    f = b.finish()
    m = Builder("main")
    out = m.output(vec("f"), "o")
    _nest_loops(m, out, 8, f)
    given = Module("deep", (), (Port("o", "Attrib1f"),), (), (), (f, m.finish()))
    verify(given)
    with pytest.raises(CompileError, match="nests too deep"):
        inline_calls(given)


def _nest_loops(b, slot, depth, callee=None):
    with b.loop(turns=1):
        if depth > 1:
            _nest_loops(b, slot, depth - 1, callee)
        elif callee is not None:
            b.call(callee, slot)
        else:
            b.store(slot, b.const(vec("f"), [1.0]))


def test_prepare_leaves_what_a_backend_can_print():
    functions = """
    function f(%x.0: f3) -> ($r.0: f) {
      %1: f = length %x.0
      %2: b = isnan %1
      if %2 {
        discard
      }
      store $r.0 = %1
    }
    """
    given = module("call f(%v.1) -> %4: f\nstore $o.0 = %4", functions)
    with_functions = prepare(given, Options(), Target("glsl"))
    assert [f.name for f in with_functions.module.functions] == ["dot3", "length3", "f", "main"]
    assert with_functions.status
    by_value = prepare(given, Options(), Target("numpy", native=frozenset({"length"}), vector=True))
    assert [f.name for f in by_value.module.functions] == ["f", "main"]
    assert [o.name for o in by_value.module.functions[0].outputs] == ["r", "status"]
    for prepared in (with_functions, by_value):
        verify(prepared.module)
        assert run(prepared.module)[0] == pytest.approx(14**0.5)


def test_branches_that_constants_decide_make_variables_values():
    body = """
    var $x.2: f
    %4: b = const true
    store $x.2 = %a.0
    if %4 {
      %5: f = const 2.0
      store $x.2 = %5
    }
    %6: f = load $x.2
    %7: f = mul %6, %6
    store $o.0 = %7
    """
    assert text(optimise(module(body))) == "%7: f = const 0x1p+2\nstore $o.0 = %7"


def test_optimising_a_recorded_module_leaves_arithmetic_to_the_precision():
    body = "%4: f = const 0.1\n%5: f = mul %4, %4\nstore $o.0 = %5"
    assert "mul" in text(optimise(module(body), fixed=False))
    assert "mul" not in text(optimise(module(body)))
