"""Selects that a branch has decided, on a target that runs each element by itself."""

from before_after import check

from shpy.passes.pipeline import remove_decided_selects


def test_under_any_lane_of_a_condition_a_select_by_it_takes_its_first_value():
    check(
        remove_decided_selects,
        """
        %4: b = any_lane %c.3
        %5: f = mul %a.0, %a.0
        if %4 {
          %6: f = cond %c.3, %5, %a.0
          %7: f = add %6, %a.0
          store $o.0 = %7
        }
        """,
        """
        %4: b = any_lane %c.3
        %5: f = mul %a.0, %a.0
        if %4 {
          %7: f = add %5, %a.0
          store $o.0 = %7
        }
        """,
    )


def test_under_the_condition_itself_and_in_inner_regions_too():
    check(
        remove_decided_selects,
        """
        %4: f = mul %a.0, %a.0
        %5: b = gt %4, %a.0
        if %c.3 {
          if %5 {
            %6: f = cond %c.3, %4, %a.0
            store $o.0 = %6
          }
        }
        """,
        """
        %4: f = mul %a.0, %a.0
        %5: b = gt %4, %a.0
        if %c.3 {
          if %5 {
            store $o.0 = %4
          }
        }
        """,
    )


def test_selects_that_no_branch_decides_stay():
    """The selects come after the branch, stand in its other side, or read another condition."""
    body = """
        %4: f = mul %a.0, %a.0
        %5: b = gt %4, %a.0
        %6: b = any_lane %c.3
        if %6 {
          %7: f = cond %5, %4, %a.0
          store $o.0 = %7
        } else {
          %8: f = cond %c.3, %4, %a.0
          store $o.0 = %8
        }
        %9: f = cond %c.3, %a.0, %4
        store $o.0 = %9
        """
    check(remove_decided_selects, body, body)
