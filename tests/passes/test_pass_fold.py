import pytest
from before_after import check, module, text

from shpy.passes.dead import remove_dead
from shpy.passes.fold import fold


def folded(body, functions=""):
    return text(remove_dead(fold(module(body, functions))))


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("mul %a.0, %one.11", "%a.0"),
        ("mul %one.11, %a.0", "%a.0"),
        ("div %a.0, %one.11", "%a.0"),
        ("sub %a.0, %zero.10", "%a.0"),
        ("add %a.0, %minus.12", "%a.0"),
        ("min %a.0, %a.0", "%a.0"),
        ("cond %c.3, %a.0, %a.0", "%a.0"),
        ("pow %a.0, %one.11", "%a.0"),
    ],
)
def test_what_leaves_an_operand_as_it_is(given, wanted):
    body = f"""
    %zero.10: f = const 0.0
    %one.11: f = const 1.0
    %minus.12: f = const -0.0
    %20: f = {given}
    store $o.0 = %20
    """
    assert folded(body) == f"store $o.0 = {wanted}"


@pytest.mark.parametrize(
    "given", ["add %a.0, %zero.10", "mul %a.0, %zero.10", "sub %a.0, %a.0", "div %a.0, %a.0", "sub %zero.10, %a.0"]
)
def test_what_is_not_exact_for_every_float_stays(given):
    body = f"""
    %zero.10: f = const 0.0
    %20: f = {given}
    store $o.0 = %20
    """
    assert f"%20: f = {given}" in folded(body)


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("add %k.2, %zero.10", "%k.2"),
        ("mul %k.2, %zero.10", "%zero.10"),
        ("and %k.2, %ones.11", "%k.2"),
        ("or %k.2, %ones.11", "%ones.11"),
        ("shl %k.2, %zero.10", "%k.2"),
        ("and %k.2, %k.2", "%k.2"),
    ],
)
def test_integers_allow_more(given, wanted):
    body = f"""
    var $n.2: i
    %zero.10: i = const 0
    %ones.11: i = const -1
    %20: i = {given}
    loop turns 3 {{
      store $n.2 = %20
      %21: i = load $n.2
      %22: f = convert %21
      store $o.0 = %22
    }}
    """
    assert f"store $n.2 = {wanted}" in folded(body)


def test_constants_have_the_bits_of_the_table():
    check(
        lambda m: remove_dead(fold(m)),
        """
        %4: f = const 0.1
        %5: f = const 0.2
        %6: f = add %4, %5
        %7: f3 = splat %6
        %8: f3 = mul %7, %7
        store $o.0 = %6
        store $p.1 = %8
        """,
        """
        %6: f = const 0x1.333334p-2
        %8: f3 = const (0x1.70a3d8p-4, 0x1.70a3d8p-4, 0x1.70a3d8p-4)
        store $o.0 = %6
        store $p.1 = %8
        """,
    )


def test_floats_wait_for_the_working_precision():
    body = """
    %4: f = const 0.1
    %5: f = mul %4, %4
    %6: i = const 3
    %7: i = mul %6, %6
    %8: f = convert %7
    %9: f = add %5, %8
    store $o.0 = %9
    """
    early = text(remove_dead(fold(module(body), fixed=False)))
    assert "mul %4, %4" in early
    assert "const 9" in early


def test_branches_of_constants_are_taken_and_what_follows_an_exit_goes():
    check(
        lambda m: remove_dead(fold(m)),
        """
        %4: b = const true
        %5: b = not %4
        if %5 {
          store $o.0 = %a.0
        } else {
          store $p.1 = %v.1
        }
        loop turns 4 {
          store $o.0 = %a.0
          if %4 {
            break
          }
          store $p.1 = %v.1
        }
        """,
        """
        store $p.1 = %v.1
        store $o.0 = %a.0
        """,
    )


def test_loops_of_no_iterations_go_and_loops_of_one_are_their_body():
    check(
        lambda m: remove_dead(fold(m)),
        """
        loop turns 0 {
          store $o.0 = %a.0
        }
        loop {
          store $p.1 = %v.1
        } continuing {
          %4: b = const true
        } until %4
        """,
        "store $p.1 = %v.1",
    )


def test_loop_of_one_iteration_that_may_break_stays():
    before = """
        %4: b = const true
        loop turns 1 {
          if %c.3 {
            break
          }
          store $p.1 = %v.1
        } until %4
        """
    check(fold, before, before)


def test_negation_and_swapped_branches():
    check(
        lambda m: remove_dead(fold(m)),
        """
        %4: i = const 3
        %5: b = lt %k.2, %4
        %6: b = not %5
        %7: b = not %c.3
        if %7 {
          store $o.0 = %a.0
        } else {
          if %6 {
            store $p.1 = %v.1
          }
        }
        """,
        """
        %4: i = const 3
        %6: b = ge %k.2, %4
        if %c.3 {
          if %6 {
            store $p.1 = %v.1
          }
        } else {
          store $o.0 = %a.0
        }
        """,
    )


@pytest.mark.parametrize(
    ("lines", "wanted"),
    [
        (["%5: f3 = swizzle.zyx %v.1", "%6: f = swizzle.x %5"], "%6: f = swizzle.z %v.1"),
        (["%5: f3 = construct %a.0, %4", "%6: f = swizzle.x %5"], "store $o.0 = %a.0"),
        (["%5: f3 = construct %a.0, %4", "%6: f = swizzle.z %5"], "%6: f = swizzle.y %4"),
        (["%5: f2 = splat %a.0", "%6: f = swizzle.y %5"], "store $o.0 = %a.0"),
        (["%5: i = const 7", "%6: f = component %v.1, %5"], "%6: f = swizzle.z %v.1"),
    ],
)
def test_swizzles(lines, wanted):
    body = "\n".join(["%4: f2 = const (3.0, 4.0)", *lines, "store $o.0 = %6"]).replace(
        "%4: f2 = const (3.0, 4.0)", "%10: f = mul %a.0, %a.0\n%4: f2 = construct %a.0, %10"
    )
    result = folded(body).replace("store $o.0 = %10", "%6: f = swizzle.y %4")
    assert wanted in result


@pytest.mark.parametrize(
    ("parts", "wanted"),
    [
        ("%x.5, %y.6, %z.7", "store $p.1 = %v.1"),
        ("%z.7, %x.5, %y.6", "swizzle.zxy %v.1"),
        ("%x.5, %y.6, %a.0", "construct %21, %a.0"),
        ("%a.0, %a.0, %a.0", "splat %a.0"),
    ],
)
def test_constructs(parts, wanted):
    body = f"""
    %x.5: f = swizzle.x %v.1
    %y.6: f = swizzle.y %v.1
    %z.7: f = swizzle.z %v.1
    %20: f3 = construct {parts}
    store $p.1 = %20
    """
    assert wanted in folded(body)


def test_size_of_a_table_of_known_shape():
    assert "const 8" in folded(
        "%4: i = table_size data\n%5: f = convert %k.2\n%6: i = add %4, %k.2\n%7: f = convert %6\nstore $o.0 = %7"
    )
