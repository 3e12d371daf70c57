"""One bad module for each rule, and the exact message that it gets."""

import pytest

from shpy.errors import VerifyError
from shpy.ir import signatures
from shpy.ir.constants import encode
from shpy.ir.metadata import About
from shpy.ir.nodes import Function as Fn, If, Let, Loc, Loop, Module, Param, Port, Store, Table, Value, Variable
from shpy.ir.ops import STRUCTURAL
from shpy.ir.parser import parse
from shpy.ir.text import print_module
from shpy.ir.types import vec
from shpy.ir.verifier import verify

HEAD = """\
module m
input x: Attrib1f
input v: Attrib3f
input c: Attrib1b
output y: Attrib1f
param sky: Color3f f3 = (0x1p+0, 0x1p+0, 0x1p+0)
table line: f4[8]
table image: f3[?, ?]

pure function twice(%0: f) -> ($0: f) {
  %1: f = add %0, %0
  store $0 = %1
}

function count(%0: f, $n.0: i, $m.1: i, $list.2: f[4]) -> ($3: f, $4: i) {
  store $3 = %0
}

function main(%x.0: f, %v.1: f3, %c.2: b) -> ($y.0: f) {
  var $w.1: f3
  var $list.2: f[4]
  var $n.3: i
  var $m.4: i
  var $short.5: f[3]
  %i.3: i = const 1
"""


def module(lines):
    body = "\n".join("  " + line for line in lines.strip("\n").split("\n"))
    return parse(f"{HEAD}{body}\n}}\n")


GOOD = """\
%10: f = call twice(%x.0)
%11: f3 = param sky
%12: f4 = table line[%i.3]
%13: i2 = table_size image
%14: f3 = table image[%13]
%15: i = table_size line
%16: i4 = grid_index
%17: i = grid_shape
%18: b = any_lane %c.2
%19: b = all_lanes %18
%20: f = half %x.0
%21: f3 = half %v.1
%22: u3 = convert %v.1
%23: b3 = convert %22
%24: f = component %v.1, %i.3
%25: f2 = swizzle.zx %v.1
%26: f = swizzle.y %v.1
%27: f4 = construct %v.1, %x.0
%28: f3 = splat %x.0
%29: f = load $list.2[%i.3]
%30: u = const 4294967295
%31: u = popcount %30
%32: f3 = load $w.1
%33: f = dot %32, %v.1
store $list.2[%i.3] = %33
store.zx $w.1 = %25
call count(%33, $n.3, $m.4, $list.2) -> %34: f, %35: i
if %c.2 {
  %36: f = add %34, %x.0
  if %19 {
    store $y.0 = %36
    discard
  } else {
    return
  }
}
loop {
  %40: b = not %c.2
  if %c.2 {
    break
  }
  %41: b = not %40
} continuing {
  loop {
    if %41 {
      break
    }
    if %40 {
      continue
    }
  }
  %42: b = or %40, %41
} until %42
loop turns 0 {
  if %c.2 {
    continue
  }
} continuing {
  %43: b = not %c.2
} until %43
loop {
  loop {
    if %c.2 {
      continue
    }
  } until %c.2
  %44: b = not %c.2
} until %44
store $y.0 = %x.0
"""


def test_a_good_module_passes():
    verify(module(GOOD))


def refusal(module):
    try:
        verify(module)
    except VerifyError as error:
        return error.message
    return None


@pytest.mark.sampled(2)
@pytest.mark.parametrize("line", [line for line in GOOD.split("\n") if " = " in line])
def test_without_any_one_line_it_passes_or_lacks_a_value(line):
    message = refusal(module(GOOD.replace(line + "\n", "", 1)))
    assert message is None or "is not assigned before" in message


BAD = [
    # Values
    ("%0: f = const 0x0p+0", "%0 is assigned twice"),
    ("%4: f = neg %9", "%9 is not assigned before"),
    ("%4: f = neg %4", "%4 is not assigned before"),
    ("if %c.2 {\n  %4: f = neg %x.0\n}\n%5: f = neg %4", "%4 is not visible here"),
    ("if %c.2 {\n  %4: f = neg %x.0\n} else {\n  %5: f = neg %4\n}", "%4 is not visible here"),
    ("loop {\n  if %c.2 {\n    %4: b = not %c.2\n  }\n} until %4", "%4 is not visible here"),
    ("loop {\n  if %c.2 {\n    continue\n  }\n  %4: b = not %c.2\n} until %4", "%4 is not visible here"),
    (
        "loop {\n  %4: b = not %c.2\n  if %c.2 {\n    continue\n  }\n} continuing {\n  %5: b = not %4\n}",
        "%4 is not visible here",
    ),
    ("loop {\n  %4: b = not %c.2\n} until %4\nstore $y.0 = %x.0\nif %4 {\n}", "%4 is not visible here"),
    # Operations of the table
    ("%4: f = jump %x.0", "there is no operation jump"),
    ("%4: f = add %x.0, %i.3", "add takes (T, T) of floats or ints, not (f, i)"),
    ("%4: f3 = add %x.0, %x.0", "add gives f here, not f3"),
    ("%4: f = add %x.0", "add takes (T, T) of floats or ints, not (f)"),
    # Structural operations
    ("%4: f = param sky", "param gives f3 here, not f"),
    ("%4: f = param sea", "there is no param sea"),
    ("%4: f = table line[%13]", "%13 is not assigned before"),
    ("%4: f4 = table line[%x.0]", "table takes an index of i, because the table's rank is 1, not (f)"),
    ("%4: f3 = table image[%i.3]", "table takes an index of i2, because the table's rank is 2, not (i)"),
    ("%4: f = table plane[%i.3]", "there is no table plane"),
    ("%4: f = table line[%i.3]", "table gives f4 here, not f"),
    (
        "%4: f3 = neighbour image[%i.3]",
        "neighbour takes an i for each of the table's axes, 2, and a modulus for each or none, not (i)",
    ),
    ("%4: f4 = neighbour image[%i.3, %i.3]", "neighbour gives f3 here, not f4"),
    ("%4: i3 = table_size image", "table_size gives i2 here, not i3"),
    ("%4: i = table_size plane", "there is no table plane"),
    ("%4: u2 = grid_index", "grid_index gives i2 here, not u2"),
    ("%4: i = grid_shape %i.3", "grid_shape takes no operands, not (i)"),
    ("%4: b = any_lane %x.0", "any_lane takes one b, not (f)"),
    ("%4: i = half %i.3", "half takes one operand of f, not (i)"),
    ("%4: f = convert %x.0", "convert takes one operand of another base and as many components as f, not (f)"),
    ("%4: i = convert %v.1", "convert takes one operand of another base and as many components as i, not (f3)"),
    ("%4: f = component %v.1, %x.0", "component takes a vector and an i, not (f3, f)"),
    ("%4: f = component %x.0, %i.3", "component takes a vector and an i, not (f, i)"),
    ("%4: f2 = swizzle.xw %v.1", "f3 has components 0 to 2, not 3"),
    ("%4: f2 = swizzle.xx %x.0", "swizzle takes one vector (splat repeats a scalar), not (f)"),
    ("%4: f3 = swizzle.xy %v.1", "swizzle gives f2 here, not f3"),
    ("%4: f3 = construct %v.1, %x.0", "construct takes 3 components of f in all, not (f3, f)"),
    ("%4: f2 = construct %x.0, %i.3", "construct takes 2 components of f in all, not (f, i)"),
    ("%4: f = construct %x.0", "construct takes scalars and vectors to make a vector, not (f)"),
    ("%4: f3 = splat %v.1", "splat takes one scalar, not (f3)"),
    ("%4: f = splat %x.0", "splat gives f2 here, not f"),
    ("%4: f = load $9", "there is no variable $9"),
    ("%4: f = load $list.2", "load takes one index: the variable is an array, not ()"),
    ("%4: f3 = load $w.1[%i.3]", "load takes no index: the variable is no array, not (i)"),
    ("%4: f = load $list.2[%x.0]", "the index of $2 is an i, not f"),
    ("%4: f = load $w.1", "load gives f3 here, not f"),
    ("%4: f = call twice(%i.3)", "twice takes (f), not (i)"),
    ("%4: f = call thrice(%x.0)", "no function thrice is declared before this one"),
    ("%4: f = call count(%x.0)", "count is not pure: it is called by a statement"),
    ("%4: i = call twice(%x.0)", "call gives f here, not i"),
    # Stores
    ("store $9 = %x.0", "there is no variable $9"),
    ("store $w.1 = %x.0", "$1 takes f3 here, not f"),
    ("store.xy $w.1 = %v.1", "$1 takes f2 here, not f3"),
    ("store.xx $w.1 = %v.1", "xx stores a component twice"),
    ("store.w $w.1 = %x.0", "f3 has components 0 to 2, not (3,)"),
    ("store.x $y.0 = %x.0", "a scalar f is stored as a whole"),
    ("store $w.1[%i.3] = %v.1", "$1 is no array: it has no index"),
    ("store $list.2 = %x.0", "$2 is an array: a store needs an index"),
    ("store $list.2[%x.0] = %x.0", "the index of $2 is an i, not f"),
    # Calls
    ("call twice(%x.0) -> %4: f", "twice is pure: it is called by the operation `call`"),
    ("call nothing()", "no function nothing is declared before this one"),
    ("call main(%x.0, %v.1, %c.2)", "no function main is declared before this one"),
    ("call count(%x.0)", "count takes 4 arguments, not 1"),
    ("call count(%i.3, $n.3, $m.4, $list.2)", "count takes f here, %3 is i"),
    ("call count(%x.0, $n.3, $n.3, $list.2)", "$3 is passed by reference twice"),
    ("call count(%x.0, $n.3, $w.1, $list.2)", "count takes a variable of i here, $1 is of f3"),
    ("call count(%x.0, $n.3, $m.4, $short.5)", "count takes a variable of f[4] here, $5 is of f[3]"),
    ("call count(%x.0, $n.3, $m.4, $list.2) -> %4: f", "count gives (f, i), not (f)"),
    # Control flow
    ("if %x.0 {\n}", "a condition is a b, not f"),
    ("loop {\n} until %x.0", "a condition is a b, not f"),
    ("loop turns -1 {\n}", "a loop cannot take fewer than 0 iterations"),
    ("break", "break stands outside of any loop"),
    ("if %c.2 {\n  continue\n}", "continue stands outside of any loop"),
    ("return\nstore $y.0 = %x.0", "this is never reached: return is the last of its region"),
    ("loop {\n  break\n  break\n}", "this is never reached: break is the last of its region"),
    ("loop {\n} continuing {\n  break\n}", "break leaves the continuing part of a loop, which must run to its end"),
    (
        "loop {\n} continuing {\n  loop {\n    return\n  }\n}",
        "return leaves the continuing part of a loop, which must run to its end",
    ),
    (
        "loop {\n  loop {\n  } continuing {\n    if %c.2 {\n      discard\n    }\n  }\n}",
        "discard leaves the continuing part of a loop, which must run to its end",
    ),
    ("if %c.2 {\n" * 65 + "}\n" * 65, "regions are nested more than 64 deep"),
    ("loop {\n" * 13 + "}\n" * 13, "loops are nested more than 12 deep"),
    ("loop {\n} continuing {\n" * 13 + "}\n" * 13, "loops are nested more than 12 deep"),
]


@pytest.mark.parametrize(("lines", "message"), BAD, ids=[message for _, message in BAD])
def test_a_bad_line_is_refused(lines, message):
    with pytest.raises(VerifyError) as raised:
        verify(module(lines))
    assert raised.value.message.split("\n")[0] == message


def test_the_limits_themselves_are_allowed():
    verify(module("if %c.2 {\n" * 64 + "}\n" * 64))
    verify(module("loop {\n" * 12 + "}\n" * 12))
    with pytest.raises(VerifyError, match=r"write instead: put the inner part into a subroutine, or test several"):
        verify(module("if %c.2 {\n" * 3000 + "}\n" * 3000))
    with pytest.raises(VerifyError, match=r"write instead: put the inner loops into a subroutine"):
        verify(module("loop {\n" * 13 + "}\n" * 13))


def f(*body, inputs=(), outputs=(), variables=(), pure=False, name="main"):
    return Fn(name, tuple(inputs), tuple(outputs), tuple(variables), tuple(body), pure)


def whole(*functions, params=(), tables=(), inputs=(), outputs=()):
    return Module("m", tuple(inputs), tuple(outputs), tuple(params), tuple(tables), functions)


F, INT, B = vec("f"), vec("i"), vec("b")
X, Y = Port("x", "Attrib1f"), Port("y", "Attrib1f")
NAN = 0x7FF8000000000000
ASKING = {"pure": True, "inputs": (Value(0, B),), "outputs": (Variable(1, B),)}


def const(type, attr):
    return whole(f(Let(Value(0, type), "const", (), attr)))


HALF = encode(F, [0.5])


def told(about, base="f", value=HALF):
    """A module whose param says something of itself."""
    return whole(f(), params=(Param("gain", "Attrib1f", vec(base), value, about),))


BUILT = [
    (whole(), "a module has at least one function: the last is its entry"),
    (whole(f(name="a"), f(name="a")), "two functions are called a"),
    (whole(f(), inputs=(X, X)), "two inputs are called x"),
    (whole(f(), outputs=(X, X)), "two outputs are called x"),
    (whole(f(), params=(Param("p", "", F, (0,)),) * 2), "two params are called p"),
    (whole(f(), tables=(Table("t", F, 1),) * 2), "two tables are called t"),
    (whole(f(), tables=(Table("t", F, 0),)), "a table has 1 to 3 axes, not 0"),
    (whole(f(), tables=(Table("t", F, 4),)), "a table has 1 to 3 axes, not 4"),
    (whole(f(), tables=(Table("t", F, 2, (4,)),)), "a table of rank 2 has 2 extents"),
    (whole(f(), tables=(Table("t", F, 2, (4, 0)),)), "a table is not empty"),
    (whole(f(), params=(Param("p", "", F, (0, 0)),)), "a constant of f holds 1 component, not 2"),
    # The entry
    (whole(f(inputs=(Variable(0, F),)), inputs=(X,)), "the entry takes its inputs by value"),
    (whole(f(), inputs=(X,)), "the module has 1 input, its entry 0"),
    (whole(f(), outputs=(Y,)), "the module has 1 output, its entry 0"),
    (whole(f(outputs=(Variable(0, F),))), "the module has 0 outputs, its entry 1"),
    (whole(f(outputs=(Variable(0, INT), Variable(1, INT)))), "the module has 0 outputs, its entry 2"),
    # Declarations
    (whole(f(variables=(Variable(0, F), Variable(0, INT)))), "$0 is declared twice"),
    (whole(f(variables=(Variable(-1, F),))), "ids count from 0"),
    (whole(f(Let(Value(-1, F), "const", (), (0,)))), "ids count from 0"),
    (whole(f(variables=(Variable(0, F, 0),))), "an array has at least one element"),
    (whole(f(outputs=(Variable(0, F, 2),)), outputs=(Y,)), "an output is no array"),
    # Params
    (told(About((1, 0))), "range=(1, 0) is no pair of numbers, the lower first"),
    (told(About((0, 0.25))), "0.5 is outside of the range, 0 to 0.25"),
    (told(About(step=-1)), "step=-1 is no positive number"),
    (told(About((0, 1)), "b", (1,)), "a range or step is for numbers and vectors of numbers"),
    # Constants
    (const(F, None), "a constant holds a tuple of whole numbers, not None"),
    (const(F, (0.5,)), "a constant holds a tuple of whole numbers, not (0.5,)"),
    (const(vec("b"), (True,)), "a constant holds a tuple of whole numbers, not (True,)"),
    (const(vec("f", 3), (0,)), "a constant of f3 holds 3 components, not 1"),
    (const(INT, (2**31,)), "a component of i lies between -2147483648 and 2147483647, 2147483648 does not"),
    (const(vec("u"), (-1,)), "a component of u lies between 0 and 4294967295, -1 does not"),
    (const(vec("b"), (2,)), "a component of b lies between 0 and 1, 2 does not"),
    (const(F, (2**64,)), f"a component of f lies between 0 and {2**64 - 1}, {2**64} does not"),
    (const(F, (NAN + 1,)), "every NaN is held as 0x7ff8000000000000, not 0x7ff8000000000001"),
    # Attributes
    (whole(f(Let(Value(0, INT), "grid_index", (), 3))), "grid_index takes no attribute, not 3"),
    (whole(f(Let(Value(0, F), "neg", (), 3))), "neg takes no attribute, not 3"),
    (whole(f(Let(Value(0, F), "load", (), "x"))), "load names a variable by its id, not 'x'"),
    (whole(f(Let(Value(0, F), "param", (), None))), "there is no param None"),
    (
        whole(f(Let(Value(1, F), "swizzle", (0,), ()), inputs=(Value(0, vec("f", 2)),)), inputs=(X,)),
        "swizzle picks one to four components, or eight, not ()",
    ),
    (
        whole(f(Store(0, 0, ()), inputs=(Value(0, F),), variables=(Variable(0, vec("f", 2)),)), inputs=(X,)),
        "f2 has components 0 to 1, not ()",
    ),
    # Pure functions
    (whole(f(pure=True)), "a pure function has one output, not 0"),
    (
        whole(f(pure=True, inputs=(Variable(0, F),), outputs=(Variable(1, F),))),
        "a pure function takes its inputs by value",
    ),
    (
        whole(f(Loop(()), pure=True, outputs=(Variable(1, F),))),
        "a pure function has no control flow but `if` of an any_lane without `else`, and no call statement",
    ),
    (
        whole(f(Let(Value(1, B), "any_lane", (0,)), If(1, (), (Store(1, 0),)), **ASKING)),
        "a pure function has no control flow but `if` of an any_lane without `else`, and no call statement",
    ),
    (
        whole(f(If(0, (Store(1, 0),)), **ASKING)),
        "a pure function has no control flow but `if` of an any_lane without `else`, and no call statement",
    ),
    (whole(f(Let(Value(1, B), "all_lanes", (0,)), **ASKING)), "a pure function asks for any_lane only"),
]


@pytest.mark.parametrize(("bad", "message"), BUILT, ids=[message for _, message in BUILT])
def test_a_bad_module_is_refused(bad, message):
    with pytest.raises(VerifyError) as raised:
        verify(bad)
    assert raised.value.message.split("\n")[0] == message
    assert "^" in raised.value.message
    print_module(bad)


def test_a_lowered_entry_may_give_its_status():
    verify(whole(f(outputs=(Variable(0, F), Variable(1, INT))), outputs=(Y,)))


def test_every_structural_operation_has_its_rule():
    assert set(signatures._RULES) == set(STRUCTURAL)


def test_the_finding_is_shown_in_place():
    with pytest.raises(VerifyError) as raised:
        verify(module("if %c.2 {\n  %4: f = neg %x.0\n}\n%5: f = neg %4\nstore $y.0 = %5"))
    assert (
        str(raised.value)
        == """\
%4 is not visible here
    function main(%x.0: f, %v.1: f3, %c.2: b) -> ($y.0: f) {
      ...
      var $list.2: f[4]
      var $n.3: i
      var $m.4: i
      var $short.5: f[3]
      %i.3: i = const 1
      if %c.2 {
        %4: f = neg %x.0
      }
      %5: f = neg %4
      ^^^^^^^^^^^^^^
      store $y.0 = %5
    }
  write instead: store it in a variable where it is made, and load that"""
    )


def test_a_finding_in_an_until_is_shown_there_and_names_the_line():
    condition = Value(0, F, "x")
    loop = Loop((), (), 0, loc=Loc("user.py", 12))
    with pytest.raises(VerifyError) as raised:
        verify(whole(f(If(1, (loop,)), inputs=(condition, Value(1, vec("b"), "c"))), inputs=(X, Y)))
    assert (
        str(raised.value)
        == """\
user.py:12: a condition is a b, not f
    function main(%x.0: f, %c.1: b) -> () {
      if %c.1 {
        loop {
        } until %x.0
        ^^^^^^^^^^^^
      }
    }"""
    )
    assert raised.value.loc == Loc("user.py", 12)


def test_a_finding_in_a_declaration_is_shown_there():
    with pytest.raises(VerifyError) as raised:
        verify(whole(f(), tables=(Table("s", F, 1), Table("t", F, 5))))
    assert (
        str(raised.value)
        == """\
a table has 1 to 3 axes, not 5
    module m
    table s: f[?]
    table t: f[?, ?, ?, ?, ?]
    ^^^^^^^^^^^^^^^^^^^^^^^^^
    function main() -> () {
    }"""
    )
