from before_after import check, module, text

from shpy.ir.traverse import walk
from shpy.passes.promote import promote


def test_variable_stored_once_becomes_a_value_with_its_name():
    check(
        promote,
        """
        var $y.2: f
        %4: f = mul %a.0, %a.0
        store $y.2 = %4
        if %c.3 {
          %5: f = load $y.2
          store $o.0 = %5
        }
        """,
        """
        %y.4: f = mul %a.0, %a.0
        if %c.3 {
          store $o.0 = %y.4
        }
        """,
    )


def test_each_value_of_a_straight_line_is_forwarded():
    check(
        promote,
        """
        var $x.2: f
        store $x.2 = %a.0
        %4: f = load $x.2
        %5: f = add %4, %4
        store $x.2 = %5
        %6: f = load $x.2
        store $o.0 = %6
        """,
        """
        %x.5: f = add %a.0, %a.0
        store $o.0 = %x.5
        """,
    )


def test_load_at_a_loops_head_sees_the_iteration_before():
    before = """
        var $x.2: f
        store $x.2 = %a.0
        loop {
          %4: f = load $x.2
          %5: f = add %4, %a.0
          store $x.2 = %5
          %6: f = load $x.2
          %7: b = gt %6, %a.0
        } until %7
        %8: f = load $x.2
        store $o.0 = %8
        """
    check(promote, before, before)


def test_store_at_a_loops_head_is_seen_in_the_same_iteration_only():
    check(
        promote,
        """
        var $x.2: f
        loop turns 3 {
          %4: f = load $x.2
          store $o.0 = %4
          if %c.3 {
            continue
          }
          store $x.2 = %a.0
          %5: f = load $x.2
          store.x $p.1 = %5
        } continuing {
          %6: f = load $x.2
          store.y $p.1 = %6
        }
        """,
        """
        var $x.2: f
        loop turns 3 {
          %4: f = load $x.2
          store $o.0 = %4
          if %c.3 {
            continue
          }
          store $x.2 = %a.0
          %5: f = load $x.2
          store.x $p.1 = %5
        } continuing {
          %6: f = load $x.2
          store.y $p.1 = %6
        }
        """,
    )


def test_continuing_sees_the_bodys_value_when_nothing_skips_it():
    check(
        promote,
        """
        var $x.2: f
        loop {
          %4: f = mul %a.0, %a.0
          store $x.2 = %4
        } continuing {
          %5: f = load $x.2
          %6: b = gt %5, %a.0
        } until %6
        """,
        """
        loop {
          %x.4: f = mul %a.0, %a.0
        } continuing {
          %6: b = gt %x.4, %a.0
        } until %6
        """,
    )


def test_branches_that_disagree_keep_the_variable():
    before = """
        var $x.2: f
        store $x.2 = %a.0
        if %c.3 {
          %4: f = neg %a.0
          store $x.2 = %4
        }
        %5: f = load $x.2
        store $o.0 = %5
        """
    check(promote, before, before)


def test_branch_that_leaves_does_not_count():
    check(
        promote,
        """
        var $x.2: f
        store $x.2 = %a.0
        if %c.3 {
          %4: f = neg %a.0
          store $x.2 = %4
          %5: f = load $x.2
          store $o.0 = %5
          return
        }
        %6: f = load $x.2
        store $o.0 = %6
        """,
        """
        if %c.3 {
          %x.4: f = neg %a.0
          store $o.0 = %x.4
          return
        }
        store $o.0 = %a.0
        """,
    )


def test_vector_built_by_components_becomes_a_construct():
    check(
        promote,
        """
        var $x.2: f3
        store.y $x.2 = %a.0
        store.zx $x.2 = %4
        %5: f3 = load $x.2
        store $p.1 = %5
        """.replace("store.zx", "%4: f2 = swizzle.xy %v.1\nstore.zx"),
        """
        %4: f2 = swizzle.xy %v.1
        %6: f = swizzle.y %4
        %7: f = swizzle.x %4
        %5: f3 = construct %6, %a.0, %7
        store $p.1 = %5
        """,
    )


def test_variable_that_nobody_stored_is_zero():
    check(
        promote,
        """
        var $x.2: f3
        store.x $x.2 = %a.0
        %4: f3 = load $x.2
        store $p.1 = %4
        """,
        """
        %5: f2 = const (0x0p+0, 0x0p+0)
        %4: f3 = construct %a.0, %5
        store $p.1 = %4
        """,
    )


def test_loads_between_stores_are_merged():
    check(
        promote,
        """
        var $x.2: f
        loop turns 2 {
          %4: f = load $x.2
          %5: f = load $x.2
          %6: f = mul %4, %5
          store $x.2 = %6
        }
        %7: f = load $x.2
        store $o.0 = %7
        """,
        """
        var $x.2: f
        loop turns 2 {
          %4: f = load $x.2
          %6: f = mul %4, %4
          store $x.2 = %6
        }
        %7: f = load $x.2
        store $o.0 = %7
        """,
    )


def test_store_that_is_overwritten_goes_unless_something_may_read_it():
    check(
        promote,
        """
        store $o.0 = %a.0
        store.xy $p.1 = %4
        %5: f = neg %a.0
        if %c.3 {
          return
        }
        store $o.0 = %5
        store $p.1 = %v.1
        store $p.1 = %6
        """.replace("store.xy", "%4: f2 = swizzle.xy %v.1\nstore.xy").replace(
            "store $p.1 = %6", "%6: f3 = neg %v.1\nstore $p.1 = %6"
        ),
        """
        store $o.0 = %a.0
        %4: f2 = swizzle.xy %v.1
        store.xy $p.1 = %4
        %5: f = neg %a.0
        if %c.3 {
          return
        }
        store $o.0 = %5
        %6: f3 = neg %v.1
        store $p.1 = %6
        """,
    )


def test_arguments_by_reference_are_read_and_written():
    functions = """
    function f($r.0: f) -> () {
      %1: f = load $r.0
      %2: f = add %1, %1
      store $r.0 = %2
    }
    """
    before = """
        var $x.2: f
        store $x.2 = %a.0
        call f($x.2)
        %4: f = load $x.2
        store $o.0 = %4
        """
    check(promote, before, before, functions)


def test_name_of_a_results_variable_moves_to_the_result():
    functions = """
    function f(%x.0: f) -> ($r.0: f) {
      if %1 {
        return
      }
      store $r.0 = %x.0
    }
    """.replace("if %1", "%1: b = isnan %x.0\nif %1")
    check(
        promote,
        """
        var $w.2: f
        call f(%a.0) -> %4: f
        store $w.2 = %4
        %5: f = load $w.2
        store $o.0 = %5
        """,
        """
        call f(%a.0) -> %w.4: f
        store $o.0 = %w.4
        """,
        functions,
    )


def test_lane_operations_stay_where_they_are():
    promoted = promote(
        module(
            """
            var $x.2: b
            %4: b = any_lane %c.3
            store $x.2 = %4
            if %c.3 {
              %5: b = load $x.2
              if %5 {
                store $o.0 = %a.0
              }
            }
            """
        )
    )
    assert [type(s).__name__ for s in walk(promoted.entry.body)] == ["Let", "If", "If", "Store"]
    assert "any_lane" in text(promoted).splitlines()[0]
