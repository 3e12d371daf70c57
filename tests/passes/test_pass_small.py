"""Precision, half, lower, cse, dead code, outputs, size: what each does, in text."""

import numpy as np
from before_after import check, module, text

import shpy as sh
from shpy.ir.interpreter import Interpreter
from shpy.ir.parser import parse
from shpy.ir.traverse import variables_of
from shpy.ir.types import vec
from shpy.ir.verifier import verify
from shpy.passes.cse import merge_common
from shpy.passes.dead import remove_dead, remove_unused_functions
from shpy.passes.dead_stores import select_outputs
from shpy.passes.half import lower_half
from shpy.passes.hide import hold_bools_as_ints
from shpy.passes.lower import lower
from shpy.passes.precision import set_precision


def test_f32_rounds_constants_and_params():
    given = module("%4: f = const 0.1\nstore $o.0 = %4")
    changed = set_precision(given)
    assert "const 0x1.99999ap-4" in text(changed)
    assert changed.params == given.params


def test_f64_makes_every_float_a_double():
    changed = set_precision(
        module(
            """
            %4: d = convert %a.0
            %5: f = convert %4
            %6: u = bits_from_float %5
            %7: f = float_from_bits %6
            %8: f = param sky
            %9: f = add %7, %8
            store $o.0 = %9
            """
        ),
        "f64",
    )
    verify(changed)
    assert text(changed).splitlines()[:4] == [
        "%6: u = bits_from_float %a.0",
        "%10: f = float_from_bits %6",
        "%7: d = convert %10",
        "%8: d = param sky",
    ]
    assert changed.params[0].type is vec("d")
    assert changed.tables[0].type is vec("d")


def test_f16_rounds_after_each_operation_but_not_after_a_choice():
    changed = lower_half(
        set_precision(
            module(
                """
                %4: f = mul %a.0, %a.0
                %5: f = max %4, %a.0
                %6: f = convert %k.2
                %7: f = add %5, %6
                store $o.0 = %7
                """
            ),
            "f16",
        )
    )
    verify(changed)
    assert text(changed) == "\n".join(
        [
            "%8: f = mul %a.0, %a.0",
            "%4: f = half %8",
            "%5: f = max %4, %a.0",
            "%9: f = convert %k.2",
            "%6: f = half %9",
            "%10: f = add %5, %6",
            "%7: f = half %10",
            "store $o.0 = %7",
        ]
    )


def test_fma_of_halves_is_rounded_once():
    """1 + 2**-11 is a tie; the 2**-24 that decides it is lost when the sum is first rounded to binary32."""
    fma = parse(
        """module m
        input a: Attrib1f
        input b: Attrib1f
        input c: Attrib1f
        output o: Attrib1f
        function main(%a.0: f, %b.1: f, %c.2: f) -> ($o.0: f) {
          %3: f = fma %a.0, %b.1, %c.2
          store $o.0 = %3
        }
        """
    )
    lowered = lower_half(set_precision(fma, "f16"))
    verify(lowered)
    a, b = 1 + 2**-10, 1 + 2**-10  # the product is 1 + 2**-9 + 2**-20
    cases = [(a, b, -(2.0**-24)), (1.0, 1 + 2**-10, 2.0**-11 - 2.0**-22), (3.0, 2**-24, 1.0), (65504.0, 2.0, 0.0)]
    rng = np.random.default_rng(1)
    cases += [tuple(rng.standard_normal(3) * 2.0 ** rng.integers(-12, 12, 3)) for _ in range(300)]
    run, reference = Interpreter(lowered), Interpreter(fma, "f16")
    for case in cases:
        halves = [np.float16(x) for x in case]
        (got,), _ = run.run_element([np.float32(h) for h in halves])
        (wanted,), _ = reference.run_element(halves)
        assert np.float16(got) == wanted
        assert np.float32(np.float16(got)) == got


def test_a_double_is_rounded_once_to_a_half():
    """1 + 2**-11 + 2**-30 lies above a tie, and on it once it is rounded to binary32."""
    converted = parse(
        """
        module converted
        input a: Attrib1f
        output o: Attrib1f
        function main(%a.0: f) -> ($o.0: f) {
          %1: d = convert %a.0
          %2: d = const 0x1.00002p-11
          %3: d = add %1, %2
          %4: f = convert %3
          store $o.0 = %4
        }
        """
    )
    lowered = lower_half(set_precision(converted, "f16"))
    verify(lowered)
    run, reference = Interpreter(lowered), Interpreter(converted, "f16")
    for a in np.float16([1, 1 + 2**-10, -1, 3, 0, np.inf, 2**-24, 65504]):
        (got,), _ = run.run_element([np.float32(a)])
        (wanted,), _ = reference.run_element([a])
        assert np.float16(got) == wanted == np.float16(np.float64(a) + float.fromhex("0x1.00002p-11"))


def test_composites_become_calls_or_short_code():
    lowered = lower(
        module(
            """
            %4: f = dot %v.1, %v.1
            %5: f = mad %4, %a.0, %a.0
            %6: f = dot %5, %a.0
            %7: f3 = normalize %v.1
            store $p.1 = %7
            store $o.0 = %6
            """
        )
    )
    verify(lowered)
    assert [f.name for f in lowered.functions] == ["dot3", "normalize3", "main"]
    assert text(lowered) == "\n".join(
        [
            "%4: f = call dot3(%v.1, %v.1)",
            "%8: f = mul %4, %a.0",
            "%5: f = add %8, %a.0",
            "%6: f = mul %5, %a.0",
            "%7: f3 = call normalize3(%v.1)",
            "store $p.1 = %7",
            "store $o.0 = %6",
        ]
    )


def test_what_is_native_stays_inside_the_library_too():
    lowered = lower(module("%4: f3 = reflect %v.1, %v.1\nstore $p.1 = %4"), frozenset({"dot"}))
    assert [f.name for f in lowered.functions] == ["reflect3", "main"]
    assert "dot %n.1, %i.0" in text(lowered, "reflect3")


def test_library_avoids_the_users_names():
    functions = """
    pure function dot3(%x.0: f) -> ($r.0: f) {
      store $r.0 = %x.0
    }
    """
    lowered = lower(module("%4: f = dot %v.1, %v.1\nstore $o.0 = %4", functions))
    verify(lowered)
    assert "call dot3_2(%v.1, %v.1)" in text(lowered)


def test_common_values_are_computed_once_and_lane_operations_twice():
    check(
        merge_common,
        """
        %4: f = mul %a.0, %a.0
        %5: b = any_lane %c.3
        if %5 {
          %6: f = mul %a.0, %a.0
          store $o.0 = %6
          %7: f = add %a.0, %4
          store.x $p.1 = %7
        } else {
          %8: f = add %4, %a.0
          %9: b = any_lane %c.3
          if %9 {
            store.y $p.1 = %8
          }
        }
        """,
        """
        %4: f = mul %a.0, %a.0
        %5: b = any_lane %c.3
        if %5 {
          store $o.0 = %4
          %7: f = add %a.0, %4
          store.x $p.1 = %7
        } else {
          %8: f = add %4, %a.0
          %9: b = any_lane %c.3
          if %9 {
            store.y $p.1 = %8
          }
        }
        """,
    )


def test_constants_are_merged_by_their_bits():
    check(
        merge_common,
        """
        %4: f = const 0.0
        %5: f = const -0.0
        %6: f = const 0.0
        %7: f = mul %4, %6
        %8: f = mul %5, %7
        store $o.0 = %8
        """,
        """
        %4: f = const 0x0p+0
        %5: f = const -0x0p+0
        %7: f = mul %4, %4
        %8: f = mul %5, %7
        store $o.0 = %8
        """,
    )


def test_what_only_feeds_itself_is_dead():
    check(
        remove_dead,
        """
        var $n.2: f
        var $unused.3: f3
        loop turns 8 {
          %4: f = load $n.2
          %5: f = add %4, %a.0
          store $n.2 = %5
          if %c.3 {
            continue
          }
          store.x $unused.3 = %a.0
        }
        store $o.0 = %a.0
        """,
        "store $o.0 = %a.0",
    )


def test_loops_that_may_run_out_of_iterations_and_exits_are_effects():
    before = """
        var $n.2: f
        loop {
          %4: f = load $n.2
          %5: f = add %4, %a.0
          store $n.2 = %5
          %6: b = gt %5, %a.0
          if %6 {
            break
          }
        }
        if %c.3 {
          discard
        }
        store $o.0 = %a.0
        """
    check(remove_dead, before, before)


def test_functions_stay_declared_until_the_module_is_printed():
    functions = """
    pure function f(%x.0: f) -> ($r.0: f) {
      store $r.0 = %x.0
    }
    """
    given = remove_dead(module("%4: f = call f(%a.0)\nstore $o.0 = %a.0", functions))
    assert [f.name for f in given.functions] == ["f", "main"]
    assert [f.name for f in remove_unused_functions(given).functions] == ["main"]


def test_select_outputs_drops_what_the_others_needed():
    given = module("%4: f = mul %a.0, %a.0\nstore $o.0 = %4\n%5: f3 = splat %a.0\nstore $p.1 = %5")
    second = select_outputs(given, [1])
    verify(second)
    assert [p.name for p in second.outputs] == ["p"]
    assert [type(s).__name__ for s in second.entry.body] == ["Let", "Store"]
    assert select_outputs(given, [1, 0]).outputs == given.outputs[::-1]


def test_arrays_of_bools_are_held_as_ints():
    @sh.program
    def marked(k: sh.Attrib1i, c: sh.Attrib1b):
        seen, kept = sh.Array(sh.Attrib2b, 3), sh.Attrib1b(c)
        seen[1] = sh.Attrib2b(c, ~c)
        seen[k] = sh.Attrib2b(kept, True)
        return seen[1], seen[k].y

    changed = hold_bools_as_ints(marked.ir)
    verify(changed)
    arrays = [v for f in changed.functions for v in variables_of(f) if v.length is not None]
    assert [v.type for v in arrays] == [vec("i", 2)]
    run, reference = Interpreter(changed), Interpreter(marked.ir)
    for k in range(-1, 4):
        given = [np.int32(k), np.bool_(k & 1)]
        for found, wanted in zip(run.run_element(given)[0], reference.run_element(given)[0], strict=True):
            assert np.array_equal(found, wanted)
    assert hold_bools_as_ints(changed) is changed


def test_an_int_of_nan_is_chosen_where_a_device_gets_it_wrong():
    def corrected(given):
        return lower(given, frozenset(), frozenset({"convert_nan"}))

    check(
        corrected,
        """
        %4: i = convert %a.0
        %5: f = convert %4
        store $o.0 = %5
        """,
        """
        %6: b = eq %a.0, %a.0
        %7: i = convert %a.0
        %8: i = const 0
        %4: i = cond %6, %7, %8
        %5: f = convert %4
        store $o.0 = %5
        """,
    )
